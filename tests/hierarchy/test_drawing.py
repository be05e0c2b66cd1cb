"""Drawings of task graphs: what is on them, and that lines do not run through boxes."""

from pathlib import Path

import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from hrljax.envs.bus.env import Bus
from hrljax.envs.taxi.env import Taxi
from hrljax.hierarchy import drawing
from hrljax.hierarchy.leaf_cover import total_leaf_cover


def arrows(ax) -> list[FancyArrowPatch]:
    return [patch for patch in ax.patches if isinstance(patch, FancyArrowPatch)]


def test_a_task_graph_as_text():
    total = total_leaf_cover(Taxi().hierarchy())
    lines = drawing.text(total.hierarchy, total.added).splitlines()
    assert lines[0] == "Root         -> Get, Put"
    assert lines[1].startswith("Get*         -> pickup, Navigate(R), ")
    moves = ", ".join(Taxi.action_names[:4])
    assert lines[3] == f"Navigate(R)* -> {moves} + pickup + putdown"
    assert "+" not in drawing.text(total.hierarchy)


def test_a_drawing_has_a_box_for_every_name_and_an_arrow_for_every_child():
    hierarchy = Bus().hierarchy()
    ax = drawing.draw(hierarchy, title="The Bus")
    assert ax.get_title() == "The Bus"
    assert {text.get_text() for text in ax.texts} == {*hierarchy.actions, *(t.name for t in hierarchy.subtasks)}
    assert len(arrows(ax)) == sum(len(task.children) for task in hierarchy.subtasks)


def test_what_a_total_leaf_cover_adds_is_highlighted(tmp_path: Path):
    before = Taxi().hierarchy()
    total = total_leaf_cover(before)
    figure = drawing.draw_completion(before, total)
    assert isinstance(figure, Figure)
    upper, lower = figure.axes
    colours = [to_hex(arrow.get_edgecolor()) for arrow in arrows(lower)]
    new = max(set(colours), key=lambda colour: -colours.count(colour))
    assert colours.count(new) == 8
    assert len(arrows(lower)) == len(arrows(upper)) + 8
    assert new not in [to_hex(arrow.get_edgecolor()) for arrow in arrows(upper)]
    legends = [[text.get_text() for text in ax.get_legend().get_texts()] for ax in (upper, lower)]
    assert ["added child" in legend for legend in legends] == [False, True]
    figure.savefig(tmp_path / "taxi.png")
    assert (tmp_path / "taxi.png").stat().st_size > 10_000


def test_lines_over_several_layers_pass_between_the_boxes():
    """From Get to pickup, two layers below, the straight line would cut Navigate(R)."""
    layers = [["Root"], ["Get", "Put"], [f"Navigate({depot})" for depot in "RGYB"], ["pickup", "north", "putdown"]]
    corners = drawing._route((0.25, -1), (1 / 6, -3), layers, 5.5)
    assert [x for x, _ in corners] == [0.25, 0.25, 0.25, 1 / 6]
    assert [y for _, y in corners] == sorted((y for _, y in corners), reverse=True)
    assert corners[1][1] > -2 > corners[2][1]
    assert len(drawing._route((0.25, -1), (0.125, -2), layers, 5.5)) == 2
    alone = drawing._route((0.5, 0), (0.5, -2), [["Root"], ["Middle"], ["go"]], 5.5)
    assert [x for x, _ in alone] == [0.5, 0.25, 0.25, 0.5]


def test_only_hierarchies_are_drawn():
    for call, message in (
        (lambda: drawing.text("x"), "hierarchy must be a Hierarchy such as .*got 'x'"),
        (lambda: drawing.draw(5), "hierarchy must be a Hierarchy such as .*got 5"),
        (
            lambda: drawing.draw_completion(Taxi().hierarchy(), Taxi().hierarchy()),  # type: ignore[arg-type]
            "total must be what hrljax.total_leaf_cover returned, got Hierarchy",
        ),
    ):
        with pytest.raises(TypeError, match=message):
            call()
