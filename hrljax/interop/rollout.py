"""One episode of a policy, step by step: a table of what happened, and a film of it."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from hrljax.core import checks, random
from hrljax.core.environment import EpisodeState, Numbers
from hrljax.envs.base import AnyEnvironment, Environment, TabularEnvironment, numbers_of
from hrljax.envs.film import save_gif
from hrljax.interop import episodes

if TYPE_CHECKING:
    import xarray as xr

Policy: TypeAlias = "Callable[[Any], Any] | ArrayLike"
"""Actions by the number of the state, or a function of it; of an environment that is not tabular, of its state."""


class Rollout:
    """One episode.

    Attributes:
        env: the environment.
        states: the states that were visited, the first and the last one included.
        table: a dataset with the dimension ``step``: ``action``, ``reward``, ``return`` (the rewards so far),
            the environment's events, and of a tabular environment ``state`` and ``next_state``; and,
            without a dimension, ``terminated`` and ``truncated``. If neither holds, the episode was left.
    """

    def __init__(self, env: AnyEnvironment, states: list[EpisodeState], table: xr.Dataset):
        self.env, self.states, self.table = env, states, table

    def __len__(self) -> int:
        """The steps."""
        return len(self.states) - 1

    def __repr__(self) -> str:
        ending = next((name for name in ("terminated", "truncated") if self.table[name]), "left")
        total = float(self.table["reward"].sum())
        return f"<Rollout on {self.env.name}: {len(self)} steps, return {total:g}, {ending}>"

    def film(self, path: str | PathLike[str], fps: float = 4) -> None:
        """Writes a GIF that shows every state.

        Args:
            path: where to.
            fps: states a second, over 0 and up to 50.

        Raises:
            ValueError: the environment has no pictures, or `fps` is out of range.
            OSError: `path` cannot be written.
        """
        save_gif((np.asarray(self.env.render(state, "rgb_array")) for state in self.states), path, fps)


def rollout(
    env: AnyEnvironment,
    policy: Policy,
    key: Array | int = 0,
    *,
    params: Numbers | None = None,
    max_steps: int | None = None,
) -> Rollout:
    """Follows a policy through one episode.

    Args:
        env: an environment.
        policy: a function that gives the number of an action, such as ``hrljax.Learned.policy()``; it is called
            with the number of the state, or with the state itself where the environment is not tabular,
            and `reset` before, if it can be. Or ``[S]`` actions of a tabular environment, such as
            ``hrljax.solvers.value_iteration(env.model()).policy``.
        key: a new-style key, or an integer for ``jax.random.key``.
        params: numbers of the environment, `env.default_params` if None.
        max_steps: leaves the episode after so many steps; it goes on to its end if None.

    Raises:
        TypeError, ValueError: a bad argument, or the policy gives no action of the environment.
    """
    checks.instance("env", env, Environment, "an environment such as hrljax.make('Bus')")
    choose = _chooser(env, policy)
    words = jax.random.key_data(random.as_key(key))
    numbers = numbers_of(env, params)
    limit = numbers.max_steps if max_steps is None else checks.integer("max_steps", max_steps, 1)
    observation, state = episodes.begin(env, numbers, words)
    states, rows, is_over = [state], [], False
    while not is_over and len(rows) < limit:
        seen = int(observation) if isinstance(env, TabularEnvironment) else state
        action = checks.integer("policy: action", choose(seen), 0, env.num_actions - 1)
        stepped = episodes.advance(env, numbers, words, state, np.int32(action))
        observation, state, reward, terminated, truncated, info = stepped
        row = {"action": action, "reward": reward, **{name: info[name] for name in env.metrics}}
        if isinstance(env, TabularEnvironment):
            row |= {"state": seen, "next_state": observation}
        rows.append(row | {"terminated": terminated, "truncated": truncated})
        is_over = bool(terminated | truncated)
        states.append(state)
    return Rollout(env, states, _table(env, jax.device_get(rows)))


def _chooser(env: AnyEnvironment, policy: Policy) -> Callable[[Any], Any]:
    """The policy as a function."""
    if callable(policy):
        if callable(reset := getattr(policy, "reset", None)):
            reset()
        return policy
    if not isinstance(env, TabularEnvironment):
        raise TypeError(f"policy must be a function of the state of {env.name}, got {checks.described(policy)}")
    actions = np.asarray(policy)
    if actions.shape != (env.num_states,) or actions.dtype.kind not in "iu":
        raise ValueError(
            f"policy must be a function, or integers of shape ({env.num_states},), got {actions.dtype} of shape "
            f"{actions.shape}"
        )
    return lambda state: actions[state]


def _table(env: AnyEnvironment, rows: list[dict[str, Any]]) -> xr.Dataset:
    """What happened, step by step."""
    import xarray as xr

    names = ["state", "next_state", "action", "reward", *env.metrics]
    columns = {name: ("step", np.array([row[name] for row in rows])) for name in names if name in rows[0]}
    ends = {name: bool(rows[-1][name]) for name in ("terminated", "truncated")}
    so_far = ("step", np.cumsum([row["reward"] for row in rows], dtype=np.float64))
    return xr.Dataset(columns | {"return": so_far} | ends, {"step": np.arange(len(rows))}, {"env": env.name})
