"""Makes notebooks of pages: ``python docs/make_notebooks.py``. The tests run the examples of these pages."""

import json
import os
import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
FOLDER = DOCS / "notebooks"
NOTEBOOKS = {"first_picture": "start", "own_hierarchy": "guides/own_hierarchy", "mario": "guides/mario"}
"""The page of each notebook."""


def notebook(page: str) -> str:
    """A page as a notebook: its text, and its examples in cells, in which pictures show themselves."""
    text = (DOCS / f"{page}.md").read_text()
    parts = re.split(r"^```python\n(.*?)^```\n", text, flags=re.M | re.S)
    cells = [_code(part) if i % 2 else _text(part, (DOCS / page).parent) for i, part in enumerate(parts)]
    shown = [cell | {"id": f"cell-{i}"} for i, cell in enumerate(cells) if cell["source"]]
    about = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return json.dumps({"cells": shown, "metadata": about, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def _text(text: str, folder: Path) -> dict[str, Any]:
    """Text; links lead from the folder of notebooks to where they led."""

    def moved(link: re.Match[str]) -> str:
        return f"]({os.path.relpath(folder / link[1], FOLDER)})"

    text = re.sub(r"\]\((?![\w+]+://|#)([^)]+)\)", moved, text)
    return {"cell_type": "markdown", "metadata": {}, "source": text.strip()}


def _code(code: str) -> dict[str, Any]:
    """Code; a cell that ends with a picture shows it."""
    code = re.sub(r"(\.figure)?\.savefig\([^()]*\)\s*$", "", code)
    return {"cell_type": "code", "metadata": {}, "source": code.strip(), "outputs": [], "execution_count": None}


if __name__ == "__main__":
    for name, page in NOTEBOOKS.items():
        (FOLDER / f"{name}.ipynb").write_text(notebook(page))
