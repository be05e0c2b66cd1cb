"""Pictures of the Bus domain: text that reads back, and drawings that show what they should."""

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib._pylab_helpers import Gcf
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrljax.envs.bus.env import Bus, BusState
from hrljax.envs.bus.map import KAO_V1, parse
from hrljax.envs.bus.render import draw_map, draw_policy, draw_value, rgb_array, text
from tests.maps import occurring
from tests.pictures import arrows, image_of, strings

CORRIDOR = """\
+---+---+---+---+
| xS  x A yP  y |
+---+---+---+---+


"""
"""One site, one passenger; the last cell lies behind the passenger."""

TOWN = """\
+---+---+---+---+---+---+---+---+
| a   a | b   bP| c   c | d   d |
+       +   +---+---+ D +   +   +
| a   a A b   b   c   c C d   dP|
+ B +---+   +---+   +   +   +---+
| e   eS  f   f   g   g | h   hP|
+   +   +---+   +   +---+ A +   +
| eP  e   f   fP| gP  gP  h   hP|
+---+---+---+---+---+---+---+---+
| 1   1   1   1   1   1   1   1 |
+---+---+---+---+---+---+---+---+
"""
"""Four sites (one on two edges), eight passengers, eight areas, and one that cannot be reached."""

NO_SITES = """\
+---+---+
| 1S  1 |
+       +
| 2   2P|
+---+---+
"""
MAPS = {"shipped": KAO_V1, "corridor": CORRIDOR, "town": TOWN, "no sites": NO_SITES}
each_map = pytest.mark.parametrize("source", MAPS.values(), ids=MAPS)


def state(cell: int, damaged: int = 0, picked: int = 0, road: int = 0) -> BusState:
    return BusState(*(jnp.int32(value) for value in (cell, damaged, picked, road, 0)))


def at(env: Bus, table: np.ndarray, cell: int, **flags: int) -> float:
    return table[int(env.encode(state(cell, **flags)))].item()


@each_map
def test_text_of_a_map_is_read_back_as_the_same_map(source: str) -> None:
    env = Bus(map=source)
    for before, after in zip(env.layout, parse(text(env)), strict=True):
        np.testing.assert_array_equal(before, after)


def test_text_of_the_shipped_map_is_its_source() -> None:
    assert text(Bus()) == KAO_V1


@each_map
@pytest.mark.parametrize("damaged", [0, 1])
def test_text_of_a_state_is_the_map_with_the_bus_and_the_waiting_passengers(source: str, damaged: int) -> None:
    env = Bus(map=source)
    layout, mark = env.layout, "@!"[damaged]
    everyone = (1 << len(layout.passengers)) - 1
    for cell in (0, layout.start, layout.num_cells - 1):
        for picked in {0, everyone >> 1, everyone - 1} - {everyone}:
            *lines, status = text(env, state(cell, damaged, picked, env.num_sites)).splitlines()
            places = [(row, column) for row, line in enumerate(lines) for column, c in enumerate(line) if c in "@!"]
            assert places == [(2 * (cell // layout.width) + 1, 4 * (cell % layout.width) + 1)]
            waiting = tuple(c for i, c in enumerate(layout.passengers) if not picked >> i & 1)
            without_bus = parse("\n".join(lines).replace(mark, " "))
            expected = layout._replace(passengers=waiting)
            for before, after in zip(expected, without_bus, strict=True):
                np.testing.assert_array_equal(before, after)
            assert ("damaged" in status) == bool(damaged)


def test_text_tells_the_rest_of_the_state() -> None:
    def status(*flags: int) -> str:
        return text(Bus(), state(20, *flags)).splitlines()[-1]

    assert status() == "construction: none | bus: sound | picked: none"
    assert status(1, 0b101, 2) == "construction: B | bus: damaged | picked: 0, 2"


def test_text_shows_the_start_under_the_bus() -> None:
    assert "| 3  @3S  3 |" in text(Bus(), state(Bus().layout.start))


@each_map
def test_map_has_one_image_and_the_names_of_everything(source: str) -> None:
    env = Bus(map=source)
    layout = env.layout
    axes = draw_map(env)
    assert isinstance(axes, Axes)
    assert image_of(axes).shape == (layout.height, layout.width, 3)
    edges = [layout.site_names[i - 1] for i in layout.site[:, 1:3].ravel() if i > 0]
    passengers = [f"P{i}" for i in range(len(layout.passengers))]
    assert sorted(strings(axes)) == sorted([*layout.area_names, *edges, *passengers, "S"])
    assert axes.get_title() == ""


def test_map_gives_each_area_its_colour() -> None:
    env = Bus()
    image = np.asarray(image_of(draw_map(env))).reshape(36, 3)
    colours = [np.unique(image[env.layout.area == area], axis=0) for area in range(6)]
    assert all(len(colour) == 1 for colour in colours)
    assert len(np.unique(np.concatenate(colours), axis=0)) == 6


def test_map_draws_every_wall() -> None:
    layout = Bus().layout
    grid, doors, walls = draw_map(Bus()).collections
    is_wall = layout.neighbour == np.arange(36)[:, None]
    is_door = ~is_wall & (layout.area[layout.neighbour] != layout.area[:, None])
    drawn = [len(lines.get_paths()) for lines in (grid, doors, walls)]
    assert drawn == [(~is_wall & ~is_door).sum(), is_door.sum(), is_wall.sum()]
    middles = {tuple(np.mean(np.asarray(path.vertices), 0).tolist()) for path in walls.get_paths()}
    assert (0.0, -0.5) in middles  # the border north of the first cell
    assert (2.5, 0.0) in middles  # between the areas 1 and 2
    assert (2.5, 1.0) not in middles  # the door under it


def test_map_of_a_state_lacks_passengers_on_board_and_marks_construction_and_damage() -> None:
    env = Bus()
    plain = draw_map(env, state=state(0))
    later = draw_map(env, state=state(0, damaged=1, picked=0b010, road=1))
    assert {"P0", "P1", "P2"} <= set(strings(plain))
    assert "!" not in strings(plain)
    assert "P1" not in strings(later)
    assert "!" in strings(later)
    assert not any(patch.get_hatch() for patch in plain.patches)
    (hatched,) = (patch for patch in later.patches if patch.get_hatch())
    assert hatched.get_extents().width < hatched.get_extents().height  # site A lies on a vertical edge
    assert "construction: A" in later.get_title()


def test_hatching_covers_what_damages_the_bus() -> None:
    layout = Bus().layout
    cell, move = np.argwhere(layout.site == 1)[0].tolist()
    assert move == 1
    for env, middle, width in ((Bus(), cell + 0.5, 0.16), (Bus(site="cell"), cell + 1, 1.0)):
        axes = draw_map(env, state=state(0, road=1))
        (hatched,) = (patch for patch in axes.patches if patch.get_hatch())
        box = hatched.get_path().transformed(hatched.get_patch_transform()).get_extents()
        assert (box.x0 + box.x1) / 2 == pytest.approx(middle % layout.width)
        assert box.width == pytest.approx(width)


@pytest.mark.parametrize("source", [KAO_V1, CORRIDOR, NO_SITES], ids=["shipped", "corridor", "no sites"])
def test_policy_and_value_are_drawn_exactly_where_the_state_occurs(source: str) -> None:
    env = Bus(map=source)
    occurs = set(np.flatnonzero(occurring(env.model(), env.initial_distribution())).tolist())
    table = np.zeros(env.num_states, np.int32)
    for picked in range(1 << len(env.layout.passengers)):
        cells = range(env.layout.num_cells)
        expected = {c for c in cells if int(env.encode(state(c, picked=picked, road=env.num_sites))) in occurs}
        offsets = np.asarray(arrows(draw_policy(env, table, picked=picked, road=env.num_sites)).get_offsets(), int)
        assert len(offsets) == len(expected)
        assert set(offsets @ (1, env.layout.width)) == expected
        values = image_of(draw_value(env, table, picked=picked, road=env.num_sites))
        assert set(np.flatnonzero(~np.ma.getmaskarray(values))) == expected


@each_map
def test_policy_is_drawn_as_arrows_in_the_direction_of_the_action(source: str) -> None:
    env = Bus(map=source)
    policy = np.random.default_rng(0).integers(0, 4, env.num_states)
    everyone = (1 << len(env.layout.passengers)) - 1
    quiver = arrows(draw_policy(env, policy, picked=everyone, road=env.num_sites, damaged=1))
    cells = (np.asarray(quiver.get_offsets(), int) @ (1, env.layout.width)).tolist()
    assert len(cells) == (31 if source == TOWN else env.layout.num_cells - 1)
    for cell, right, down in zip(cells, np.asarray(quiver.U), np.asarray(quiver.V), strict=True):
        action = int(at(env, policy, cell, picked=everyone, road=env.num_sites, damaged=1))
        assert (np.sign(down), np.sign(right)) == ((-1, 0), (0, 1), (1, 0), (0, -1))[action]


@each_map
def test_value_is_a_heat_map_of_the_slice_with_numbers_and_a_colour_bar(source: str) -> None:
    env = Bus(map=source)
    value = np.random.default_rng(0).uniform(-50, -10, env.num_states).astype(np.float32)
    axes = draw_value(env, jnp.asarray(value), picked=1, road=env.num_sites, damaged=1)
    drawn = image_of(axes).ravel()
    shown = np.flatnonzero(~np.ma.getmaskarray(drawn)).tolist()
    expected = [at(env, value, cell, picked=1, road=env.num_sites, damaged=1) for cell in shown]
    np.testing.assert_array_equal(np.asarray(drawn[shown]), expected)
    assert sorted(s for s in strings(axes) if "." in s) == sorted(f"{v:.1f}" for v in expected)
    (bar,) = (child for child in axes.child_axes if isinstance(child, Axes))
    assert bar.get_ylabel() == "expected return"


def test_value_chooses_decimals_and_leaves_infinite_values_uncoloured() -> None:
    env = Bus()
    for scale, written in ((0.25, "0.250"), (2.5, "2.50"), (25.0, "25.0"), (2500.0, "2500")):
        assert strings(draw_value(env, np.full(env.num_states, scale))).count(written) == 33
    value = np.zeros(env.num_states)
    value[int(env.encode(state(0)))] = -np.inf
    axes = draw_value(env, value)
    assert "-inf" in strings(axes)
    assert np.ma.getmaskarray(image_of(axes))[0, 0]


def test_drawing_on_given_axes() -> None:
    env = Bus()
    figure = Figure()
    (part,) = figure.subfigures(1, 1, squeeze=False).ravel()
    axes = part.subplots(1, 3)
    table = np.zeros(env.num_states, np.int32)
    assert draw_map(env, axes[0]) is axes[0]
    assert draw_policy(env, table, axes[1]) is axes[1]
    assert draw_value(env, table, axes[2]) is axes[2]
    figure.canvas.draw()


def test_rgb_array_changes_with_the_state_and_not_in_size() -> None:
    env = Bus()
    first = rgb_array(env, state(0))
    assert first.dtype == np.uint8
    assert first.ndim == 3
    assert first.shape[2] == 3
    np.testing.assert_array_equal(first, rgb_array(env, state(0)))
    pictures = [first, *(rgb_array(env, s) for s in (state(1), state(0, 1), state(0, 0, 1), state(0, 0, 0, 1)))]
    assert {p.shape for p in pictures} == {first.shape}
    assert all((a != b).any() for i, a in enumerate(pictures) for b in pictures[:i])


def test_rgb_array_shows_the_bus_where_it_is() -> None:
    env = Bus()
    changed = (rgb_array(env, state(0)) != rgb_array(env, state(35))).any(-1)
    height, width = changed.shape
    rows, columns = np.nonzero(changed)
    is_first = (rows < height / 3) & (columns < width / 3)
    is_last = (rows > height * 2 / 3) & (columns > width * 2 / 3)
    assert is_first.any()
    assert is_last.any()
    assert (is_first | is_last).all()


def test_errors_name_the_argument_the_value_and_what_is_allowed() -> None:
    env = Bus()
    policy, value = np.zeros(env.num_states, np.int32), np.zeros(env.num_states)
    for call, message in (
        (
            lambda: draw_policy(env, policy[:7]),
            r"policy must be integers of shape \(2304,\), got int32 of shape \(7,\)",
        ),
        (lambda: draw_policy(env, value), r"policy must be integers of shape \(2304,\), got float64"),
        (lambda: draw_policy(env, policy + 4), "policy must have actions 0 to 3, or -1 for none, got 4 to 4"),
        (lambda: draw_policy(env, policy - 2), "policy must have actions 0 to 3, or -1 for none, got -2 to -2"),
        (lambda: draw_policy(env, policy, picked=8), "^picked must be an integer from 0 to 7 .*passenger.*, got 8"),
        (lambda: draw_policy(env, policy, damaged=2), "^damaged must be an integer from 0 to 1 .*, got 2"),
        (lambda: draw_value(env, value[None]), r"value must be real numbers of shape \(2304,\), got .* \(1, 2304\)"),
        (lambda: draw_value(env, value > 0), r"value must be real numbers of shape \(2304,\), got bool"),
        (lambda: draw_value(env, value, road=3), "^road must be .* 0 to 2 .0: no construction, 1: A, 2: B., got 3"),
        (lambda: draw_value(env, value, road=-1), "^road must be an integer from 0 to 2 .*, got -1"),
        (lambda: draw_map(env, state=state(36)), "^state.cell must be an integer from 0 to 35 .*, got 36"),
        (lambda: rgb_array(env, state(-1)), "^state.cell must be an integer from 0 to 35 .*, got -1"),
        (lambda: text(env, state(0, picked=8)), "^state.picked must be an integer from 0 to 7 .*, got 8"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    with pytest.raises(TypeError, match=r"^road must be an integer from 0 to 2 .*, got 1.5"):
        draw_value(env, value, road=1.5)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^state.road must be .*, got Array\(\[0, 0\]"):
        text(env, state(0)._replace(road=jnp.zeros(2, int)))


def test_no_figure_is_registered_with_pyplot() -> None:
    before = set(Gcf.figs)
    rgb_array(Bus(), state(0))
    draw_value(Bus(), np.zeros(Bus().num_states))
    assert set(Gcf.figs) == before
