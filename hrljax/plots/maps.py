"""Maps: a state of an environment, and policies and values over its states, as the environment draws them."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from hrljax.core.environment import Dynamics


def state(env: Dynamics[Any, Any], state: Any = None, ax: Axes | None = None) -> Axes:
    """Draws the map of an environment and, with a `state`, who stands where.

    Args:
        env: an environment with a map: Bus, Gridworld, Maze, Taxi, or one whose `renderer` has a function ``draw_map``.
        state: of the environment, as `reset` and `step` return it.
        ax: where to draw; a new figure if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        TypeError: the environment has no map.
        ValueError: the state is none of its states.
    """
    return _function("draw_map", env)(env, ax, state)


def policy(env: Dynamics[Any, Any], policy: ArrayLike, ax: Axes | None = None, **rest: int) -> Axes:
    """Draws a policy over the cells of a map: moves as arrows, other actions by their names.

    Args:
        env: as of `state`; its `renderer` has a function ``draw_policy``.
        policy: ``[S]`` actions by number, -1 for none, such as ``value_iteration(env.model()).policy``.
        ax: where to draw; a new figure if None.
        rest: the rest of the state, if a cell is not all of it: `picked`, `road` and `damaged` of a Bus (0 each by
            default), `passenger` and `destination` of a Taxi.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        TypeError: the environment has no map, or `rest` is not the rest of its state.
        ValueError: the policy has another shape or names no actions, or a number of `rest` is out of range.
    """
    return _function("draw_policy", env)(env, policy, ax, **rest)


def value(env: Dynamics[Any, Any], value: ArrayLike, ax: Axes | None = None, **rest: int) -> Axes:
    """Draws values over the cells of a map as colours and numbers.

    Args:
        env: as of `state`; its `renderer` has a function ``draw_value``.
        value: ``[S]``, such as ``value_iteration(env.model()).value``.
        ax: where to draw; a new figure if None.
        rest: as of `policy`.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        TypeError: the environment has no map, or `rest` is not the rest of its state.
        ValueError: the values have another shape, or a number of `rest` is out of range.
    """
    return _function("draw_value", env)(env, value, ax, **rest)


def _function(name: str, env: object) -> Callable[..., Axes]:
    """A drawing function of the environment's renderer."""
    renderer = getattr(env, "renderer", None)
    draw = getattr(import_module(renderer), name, None) if renderer else None
    if draw is None:
        raise TypeError(f"env must be an environment whose renderer has a function {name}, such as a Maze, got {env!r}")
    return draw
