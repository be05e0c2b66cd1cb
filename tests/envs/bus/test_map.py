"""Maps of the Bus domain: what the text says, and errors that name the place."""

import re
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hrljax.envs.bus.map import KAO_V1, MOVES, BusMap, MapError, parse
from tests.maps import written_over

NORTH, EAST, SOUTH, WEST = range(4)
OPPOSITE = (SOUTH, WEST, NORTH, EAST)
SMALL = """\
+---+---+
| 1S  2 |
+   +---+
| 1   2P|
+---+---+
"""


def doors(bus_map: BusMap) -> set[tuple[int, int]]:
    """Pairs of neighbouring cells in different areas that a move joins, smaller cell first."""
    pairs = {(min(c, n), max(c, n)) for c in range(bus_map.num_cells) for n in bus_map.neighbour[c].tolist()}
    return {(a, b) for a, b in pairs if bus_map.area[a] != bus_map.area[b]}


def test_the_shipped_map_has_six_areas_of_six_cells():
    bus_map = parse(KAO_V1)
    assert (bus_map.height, bus_map.width, bus_map.num_cells) == (6, 6, 36)
    assert bus_map.area_names == ("1", "2", "3", "4", "5", "6")
    row, column = np.divmod(np.arange(36), 6)
    np.testing.assert_array_equal(bus_map.area, 2 * (row // 2) + column // 3)


def test_the_shipped_map_has_its_start_and_passengers():
    bus_map = parse(KAO_V1)
    assert bus_map.start == 3 * 6 + 1
    assert bus_map.passengers == (1 * 6 + 5, 2 * 6 + 4, 4 * 6 + 4)


def test_the_shipped_map_has_two_sites_seen_from_both_sides():
    bus_map = parse(KAO_V1)
    assert bus_map.site_names == ("A", "B")
    sites = {(c, m): int(bus_map.site[c, m]) for c, m in np.argwhere(bus_map.site).tolist()}
    assert sites == {(14, EAST): 1, (15, WEST): 1, (23, SOUTH): 2, (29, NORTH): 2}
    assert bus_map.neighbour[14, EAST] == 15
    assert bus_map.neighbour[23, SOUTH] == 29


def test_the_shipped_map_has_seven_doors():
    bus_map = parse(KAO_V1)
    assert doors(bus_map) == {(8, 9), (8, 14), (11, 17), (14, 15), (18, 24), (23, 29), (32, 33)}
    adjacent = {(int(i) + 1, int(j) + 1) for i, j in np.argwhere(np.triu(bus_map.adjacent_areas()))}
    assert adjacent == {(1, 2), (1, 3), (3, 4), (3, 5), (2, 4), (4, 6), (5, 6)}
    np.testing.assert_array_equal(bus_map.adjacent_areas(), bus_map.adjacent_areas().T)


def test_cells_of_one_area_are_joined_on_the_shipped_map():
    bus_map = parse(KAO_V1)
    for cell in range(36):
        for move, (down, right) in enumerate(MOVES):
            row, column = cell // 6 + down, cell % 6 + right
            if 0 <= row < 6 and 0 <= column < 6 and bus_map.area[6 * row + column] == bus_map.area[cell]:
                assert bus_map.neighbour[cell, move] == 6 * row + column


def test_without_sites_has_walls_where_the_sites_were():
    walled = KAO_V1.replace("A", "|").replace(" B ", "---")
    assert parse(KAO_V1).site_names == ("A", "B")
    assert parse(walled).site_names == ()
    np.testing.assert_array_equal(parse(KAO_V1).without_sites().neighbour, parse(walled).neighbour)
    assert not parse(KAO_V1).without_sites().site.any()


def test_arrays_are_int32():
    bus_map = parse(SMALL)
    assert {bus_map.neighbour.dtype, bus_map.site.dtype, bus_map.area.dtype} == {np.dtype(np.int32)}


def test_names_are_numbered_in_their_own_order_whatever_the_reading_order():
    text = SMALL.replace("1", "b").replace("2", "a")
    text = written_over(written_over(text, 3, 2, " Z "), 4, 5, "C")
    bus_map = parse(text)
    assert bus_map.area_names == ("a", "b")
    assert bus_map.site_names == ("C", "Z")
    np.testing.assert_array_equal(bus_map.area, [1, 0, 1, 0])
    assert bus_map.site[0, SOUTH] == 2
    assert bus_map.site[2, EAST] == 1


def test_one_site_may_span_several_edges():
    bus_map = parse(written_over(written_over(SMALL, 2, 5, "A"), 4, 5, "A"))
    assert bus_map.site_names == ("A",)
    assert np.argwhere(bus_map.site).tolist() == [[0, EAST], [1, WEST], [2, EAST], [3, WEST]]


def test_blank_corners_and_blank_ends_are_allowed():
    blank = SMALL.replace("+   +---+", "     ---+") + "\n   \n\n"
    np.testing.assert_array_equal(parse(blank).neighbour, parse(SMALL).neighbour)


class Drawing(NamedTuple):
    """A map as it is meant: what stands to the east and to the south of each cell."""

    height: int
    width: int
    areas: list[str]
    east: list[str]  # one character a cell; the last column's are walls
    south: list[str]
    start: int
    passengers: set[int]

    def text(self) -> str:
        lines = ["+---" * self.width + "+"]
        for row in range(self.height):
            cells, floor = "|", "+"
            for cell in range(row * self.width, (row + 1) * self.width):
                mark = "S" if cell == self.start else "P" if cell in self.passengers else " "
                cells += f" {self.areas[cell]}{mark}{self.east[cell]}"
                floor += ("---" if self.south[cell] == "|" else f" {self.south[cell]} ") + "+"
            lines += [cells, floor]
        return "\n".join(lines)


@st.composite
def drawings(draw: st.DrawFn) -> Drawing:
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    count = height * width
    assume(count > 1)
    edge = st.lists(st.sampled_from(["|", " ", " ", "A", "B"]), min_size=count, max_size=count)
    east, south = draw(edge), draw(edge)
    for cell in range(count):
        east[cell] = "|" if cell % width == width - 1 else east[cell]
        south[cell] = "|" if cell // width == height - 1 else south[cell]
    areas = draw(st.lists(st.sampled_from("12xy"), min_size=count, max_size=count))
    cells = draw(st.permutations(range(count)))
    return Drawing(height, width, areas, east, south, cells[0], set(cells[1 : 1 + draw(st.integers(1, count - 1))]))


def _reached(drawing: Drawing) -> set[int]:
    """Cells joined to the start, by growing the set until it stays as it is."""
    joined = [(c, c + 1) for c in range(len(drawing.east)) if drawing.east[c] != "|"]
    joined += [(c, c + drawing.width) for c in range(len(drawing.south)) if drawing.south[c] != "|"]
    reached, before = {drawing.start}, set()
    while reached != before:
        before = set(reached)
        reached |= {b for a, b in joined if a in reached} | {a for a, b in joined if b in reached}
    return reached


@given(drawing=drawings())
@settings(deadline=None, max_examples=150)
def test_any_map_reads_as_it_was_drawn(drawing: Drawing):
    if not drawing.passengers <= _reached(drawing):
        with pytest.raises(MapError, match="cannot be reached"):
            parse(drawing.text())
        return
    bus_map = parse(drawing.text())
    cells = np.arange(bus_map.num_cells)
    assert bus_map.start == drawing.start
    assert bus_map.passengers == tuple(sorted(drawing.passengers))
    assert [bus_map.area_names[a] for a in bus_map.area] == drawing.areas
    for move, edges, offset in ((EAST, drawing.east, 1), (SOUTH, drawing.south, drawing.width)):
        expected = [c if e == "|" else c + offset for c, e in zip(cells, edges, strict=True)]
        np.testing.assert_array_equal(bus_map.neighbour[:, move], expected)
        names = [("", *bus_map.site_names)[s] for s in bus_map.site[:, move]]
        assert names == [e.strip(" |") for e in edges]


@given(drawing=drawings())
@settings(deadline=None, max_examples=100)
def test_the_opposite_move_leads_back_over_the_same_site(drawing: Drawing):
    assume(drawing.passengers <= _reached(drawing))
    bus_map = parse(drawing.text())
    for cell in range(bus_map.num_cells):
        for move, other in enumerate(OPPOSITE):
            beyond = bus_map.neighbour[cell, move]
            if beyond != cell:
                assert bus_map.neighbour[beyond, other] == cell
                assert bus_map.site[beyond, other] == bus_map.site[cell, move]
            else:
                assert bus_map.site[cell, move] == 0


@pytest.mark.parametrize(
    ("text", "row", "column", "problem"),
    [
        pytest.param(written_over(KAO_V1, 6, 15, "?"), 6, 15, "unknown character '?'; an area", id="area"),
        pytest.param(written_over(KAO_V1, 6, 15, "É"), 6, 15, "unknown character 'É'; an area", id="area-not-ascii"),
        pytest.param(written_over(KAO_V1, 6, 14, "x"), 6, 14, "unknown character 'x'; a cell begins", id="cell-begin"),
        pytest.param(written_over(KAO_V1, 12, 24, "Q"), 12, 24, "unknown character 'Q'; a cell ends", id="cell-end"),
        pytest.param(written_over(KAO_V1, 2, 5, "a"), 2, 5, "unknown characters 'a'; between", id="edge-small-letter"),
        pytest.param(written_over(KAO_V1, 2, 13, "-"), 2, 13, "unknown characters '-'; between", id="edge-dash"),
        pytest.param(
            written_over(KAO_V1, 3, 14, "A  "), 3, 14, "unknown characters 'A  '; between", id="site-not-centred"
        ),
        pytest.param(written_over(KAO_V1, 5, 14, "-- "), 5, 14, "unknown characters '-- '; between", id="broken-wall"),
        pytest.param(written_over(KAO_V1, 5, 14, "AB "), 5, 14, "unknown characters 'AB '; between", id="two-letters"),
        pytest.param(
            written_over(KAO_V1, 5, 14, " É "), 5, 14, "unknown characters ' É '; between", id="site-not-ascii"
        ),
        pytest.param(written_over(KAO_V1, 7, 13, "-"), 7, 13, "unknown character '-'; a corner", id="corner"),
        pytest.param(written_over(KAO_V1, 10, 16, "S"), 10, 16, "a second start S", id="two-starts"),
        pytest.param(KAO_V1.replace("S", " "), 1, 1, "no start", id="no-start"),
        pytest.param(KAO_V1.replace("P", " "), 1, 1, "no passenger", id="no-passenger"),
        pytest.param(written_over(KAO_V1, 8, 25, "+"), 8, 25, "unknown characters '+'; between", id="border-corner"),
        pytest.param(written_over(KAO_V1, 1, 10, "   "), 1, 11, "an opening in the border", id="open-north"),
        pytest.param(written_over(KAO_V1, 13, 10, " C "), 13, 11, "an opening in the border", id="site-south"),
        pytest.param(written_over(KAO_V1, 4, 1, " "), 4, 1, "an opening in the border", id="open-west"),
        pytest.param(written_over(KAO_V1, 4, 25, "D"), 4, 25, "an opening in the border", id="site-east"),
        pytest.param(written_over(KAO_V1, 6, 23, "   "), 6, 21, "wrong size: 20 characters", id="short-line"),
        pytest.param("\n".join(line[:-1] for line in KAO_V1.splitlines()), 1, 24, "wrong size: 24", id="width"),
        pytest.param("+\n|\n+", 1, 1, "wrong size: 1 characters; a map of w columns", id="no-columns"),
        pytest.param("\n".join(KAO_V1.splitlines()[:-1]), 12, 1, "wrong size: 12 lines", id="height"),
        pytest.param("+---+", 1, 1, "wrong size: 1 lines; a map of h rows", id="no-rows"),
        pytest.param("", 1, 1, "wrong size: 0 lines", id="empty"),
        pytest.param(written_over(SMALL, 4, 5, "|"), 4, 8, "a passenger that cannot be reached", id="unreachable"),
    ],
)
def test_errors_name_the_row_and_the_column(text: str, row: int, column: int, problem: str):
    with pytest.raises(MapError, match=re.escape(f"map, row {row}, column {column}: {problem}")):
        parse(text)


def test_a_map_may_begin_with_a_newline():
    for with_blank_line, expected in zip(parse("\n" + SMALL), parse(SMALL), strict=True):
        np.testing.assert_array_equal(with_blank_line, expected)


def test_a_line_longer_than_the_first_is_named():
    with pytest.raises(MapError, match=r"row 6, column \d+: wrong size: 27 characters; the first line has 25"):
        parse(written_over(KAO_V1, 6, 26, " |"))


def test_map_errors_are_value_errors():
    assert issubclass(MapError, ValueError)
