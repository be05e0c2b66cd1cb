"""Pictures of the Taxi domain: text, the map, and policies and values on it.

The drawing functions follow `hrljax.envs.grid.render`. A policy or a value is drawn for all cells at
once, with the rest of the state given: `passenger` (0 to 3: waits at that depot, 4: in the taxi),
`destination` (0 to 3) and `fickle` (1: may still change it). Cells where no such state occurs stay
empty: where the passenger may still change the destination, all but the depot of the pickup.

All functions raise ValueError where an argument has the wrong shape or type or is out of range.
"""

from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Circle
from numpy.typing import ArrayLike

from hrljax.envs.grid import render as grid
from hrljax.envs.grid.ascii_map import MOVES, read_boxes
from hrljax.envs.taxi.env import ABOARD, DEPOTS, DIRECTIONS, MAP, SIZE, Taxi, TaxiState, taxi_layout

_SIGNS = (*(MOVES[direction] for direction in DIRECTIONS[:4]), "pick\nup", "put\ndown")
_CELLS = SIZE * SIZE


class _Scene(NamedTuple):
    """What a picture shows, in integers that have been checked; -1: nothing of the kind."""

    passenger: int = -1
    destination: int = -1
    fickle: int = 0
    cell: int = -1


def text(env: Taxi, state: TaxiState | None = None) -> str:
    """The map as text.

    With a state, the taxi stands in front of the depot's name, as ``@`` or, with the passenger, as
    ``&``; a waiting passenger stands behind it as ``p``, and a last line tells the rest of the state.
    """
    if state is None:
        return grid.text_with(MAP, [])
    scene, boxes = _scene_of(env, state), read_boxes(MAP)
    line, column = boxes.place(scene.cell)
    marks = [(line, column, "&" if scene.passenger == ABOARD else "@")]
    if scene.passenger != ABOARD:
        line, column = boxes.place(taxi_layout().depots[scene.passenger])
        marks.append((line, column + 2, "p"))
    return grid.text_with(MAP, marks, _status(scene))


def draw_map(env: Taxi, ax: Axes | None = None, state: TaxiState | None = None) -> Axes:
    """Draws the map and, with a `state`, the taxi, the waiting passenger and the destination."""
    scene = _Scene() if state is None else _scene_of(env, state)
    return _draw_ground(ax, scene).axes


def draw_policy(
    env: Taxi, policy: ArrayLike, ax: Axes | None = None, *, passenger: int, destination: int, fickle: int = 0
) -> Axes:
    """Draws the actions of an ``[S]`` policy: moves as arrows, pickup and putdown in words."""
    scene = _scene(env, passenger, destination, fickle)
    states = _states(env, scene)
    actions = grid.policy_at(env, policy, states)
    axes = _draw_ground(ax, scene).axes
    grid.draw_actions(axes, _ground(), actions, _occurring(env)[states], _SIGNS)
    return axes


def draw_value(
    env: Taxi, value: ArrayLike, ax: Axes | None = None, *, passenger: int, destination: int, fickle: int = 0
) -> Axes:
    """Draws an ``[S]`` value function as a heat map with numbers, and a colour bar beside `ax`."""
    scene = _scene(env, passenger, destination, fickle)
    states = _states(env, scene)
    values, shown = grid.value_at(env, value, states), _occurring(env)[states]
    image = _draw_ground(ax, scene, grid.shown_values(values, shown))
    grid.draw_numbers(image, _ground(), values, shown)
    return image.axes


def rgb_array(env: Taxi, state: TaxiState) -> np.ndarray:
    """The picture of a state as ``[H, W, 3]`` uint8, always of one size."""
    return grid.pixels(draw_map(env, state=state))


def _scene(env: Taxi, passenger: ArrayLike, destination: ArrayLike, fickle: ArrayLike, prefix: str = "") -> _Scene:
    depots = ", ".join(f"{i}: {name}" for i, name in enumerate(DEPOTS))
    return _Scene(
        passenger=grid.checked_integer(f"{prefix}passenger", passenger, ABOARD, f"{depots}, {ABOARD}: in the taxi"),
        destination=grid.checked_integer(f"{prefix}destination", destination, len(DEPOTS) - 1, depots),
        fickle=grid.checked_integer(f"{prefix}fickle", fickle, int(env.fickle), "1: may change, in a fickle Taxi"),
    )


def _scene_of(env: Taxi, state: TaxiState) -> _Scene:
    scene = _scene(env, state.passenger, state.destination, state.fickle, "state.")
    return scene._replace(cell=grid.checked_integer("state.cell", state.cell, _CELLS - 1, "row * 5 + column"))


def _states(env: Taxi, scene: _Scene) -> np.ndarray:
    """``[cells]``: numbers of the states of all cells with the rest as in a scene."""
    passenger, destination, fickle, time = map(jnp.int32, (scene.passenger, scene.destination, scene.fickle, 0))
    cells = jnp.arange(_CELLS, dtype=jnp.int32)
    return np.asarray(env.encode(TaxiState(cells, passenger, destination, fickle, time)))


@lru_cache(maxsize=16)
def _occurring(env: Taxi) -> np.ndarray:
    """As `grid.occurring_states`, with the default parameters."""
    return grid.occurring_states(env.model(), env.initial_distribution())


def _status(scene: _Scene) -> str:
    passenger = (*DEPOTS, "in the taxi")[scene.passenger]
    return f"passenger: {passenger} | destination: {DEPOTS[scene.destination]}" + " | may change" * scene.fickle


def _ground() -> grid.Ground:
    return grid.Ground(SIZE, SIZE, taxi_layout().neighbour, np.zeros(_CELLS, np.int32))


def _draw_ground(ax: Axes | None, scene: _Scene, values: np.ndarray | None = None) -> AxesImage:
    ground, depots = _ground(), taxi_layout().depots
    image = grid.draw_ground(ground, ax, "" if scene == _Scene() else _status(scene), values)
    ax = image.axes
    for cell, name in zip(depots, DEPOTS, strict=True):
        x, y = ground.centre(cell)
        grid.write(ax, x - 0.34, y - 0.32, name, 0.24, weight="bold")
    if scene.destination >= 0:
        width = 0.05 * grid.cell_points(ax)
        ring = Circle(ground.centre(depots[scene.destination]), 0.4, fill=False, edgecolor=grid.ALARM, linewidth=width)
        ax.add_patch(ring)
    if 0 <= scene.passenger < ABOARD:
        x, y = ground.centre(depots[scene.passenger])
        grid.draw_disc(ax, x + 0.3, y + 0.3, "P", radius=0.17)
    if scene.cell >= 0:
        x, y = ground.centre(scene.cell)
        grid.draw_vehicle(ax, x, y)
        if scene.passenger == ABOARD:
            grid.draw_disc(ax, x + 0.3, y - 0.3, "P", radius=0.17, layer=6)
    return image
