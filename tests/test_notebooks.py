"""The notebooks run from their first cell to the last in a kernel of their own, as a reader's do."""

from pathlib import Path

import nbclient
import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))
SMALLER = """
import hrljax

whole = hrljax.sweep


def sweep(*arguments, seeds, num_episodes, **options):
    return whole(*arguments, seeds=min(seeds, 2), num_episodes=min(num_episodes, 4), **options)


hrljax.sweep = sweep
"""
"""A cell in front of the others: sweeps with few seeds and episodes."""
PICTURES = {"first_picture": 1, "own_hierarchy": 2, "mario": 0}


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_runs_and_shows_its_pictures(file: Path, tmp_path: Path):
    notebook = nbformat.read(file, as_version=4)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(SMALLER))
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=900, resources=resources).execute()  # raises what a cell raises
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == PICTURES[file.stem]
    assert not [output for output in outputs if output.output_type == "error"]


def test_there_are_three():
    assert {file.stem for file in NOTEBOOKS} == set(PICTURES)
