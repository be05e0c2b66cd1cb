"""Every example of the documentation runs, block after block, with fewer seeds and episodes than it says."""

import importlib
import inspect
import json
import pkgutil
import re
import shutil
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium
import make_notebooks
import public_names
import pytest
from matplotlib.image import imread

import hrljax
from hrljax.envs import registry

ROOT = Path(__file__).parents[1]
PAGES = [
    page for page in sorted((ROOT / "docs").rglob("*.md")) if page.relative_to(ROOT).parts[1] not in ("_build", "api")
]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]
FENCE = re.compile(r"^```(.*)\n((?:.*\n)*?)```$", re.M)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
SEEDS, EPISODES = 4, 40
each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


def blocks(document: Path, language: str) -> list[str]:
    """Code of the fenced blocks in a language, below as many empty lines as there are lines above it."""
    text = document.read_text()
    actual = (match for match in FENCE.finditer(text) if match[1] == language)
    return ["\n" * text.count("\n", 0, match.start(2)) + match[2] for match in actual]


def small(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same with few seeds and episodes."""

    @wraps(function)
    def call(*arguments: Any, seeds: int, num_episodes: int, **options: Any) -> Any:
        return function(*arguments, seeds=min(seeds, SEEDS), num_episodes=min(num_episodes, EPISODES), **options)

    return call


class Printed:
    """`print` for examples: what a line prints first has the numbers that its comment says, if it has a comment."""

    def __init__(self, document: Path):
        self._lines = dict(enumerate(document.read_text().splitlines(), start=1))

    def __call__(self, *values: Any) -> None:
        frame = inspect.currentframe()
        assert frame is not None
        assert frame.f_back is not None
        line = self._lines.pop(frame.f_back.f_lineno, "")
        if comment := re.search(r"  # (.+)", line):
            printed = NUMBER.findall(" ".join(map(str, values)))
            assert set(printed) <= set(NUMBER.findall(comment[1])), f"{line}\nprints {values}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Port 8787 is already in use")  # of Dask's pages
@each_document
def test_examples_run(document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    code = blocks(document, "python")
    if any("dask" in block for block in code):
        pytest.importorskip("distributed", reason="the extra 'distributed' is not installed")
    monkeypatch.chdir(tmp_path)
    for name in ("sweep", "estimate"):
        monkeypatch.setattr(hrljax, name, small(getattr(hrljax, name)))
    namespace: dict[str, Any] = {"__name__": "__main__", "print": Printed(document)}
    with patch.dict(registry._ENVIRONMENTS), patch.dict(gymnasium.registry):
        for block in code:
            shutil.rmtree("runs", ignore_errors=True)  # so that nobody finds the work done
            exec(compile(block, document, "exec"), namespace)
    for picture in tmp_path.glob("*.png"):
        assert imread(picture).std() > 0.05


@each_document
def test_every_block_says_what_it_is(document: Path):
    """So that no example escapes the test above."""
    for match in FENCE.finditer(document.read_text()):
        assert match[1] in ("python", "sh", "text"), match[0]


@each_document
def test_files_that_are_named_exist(document: Path):
    text = document.read_text()
    links = [link for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text) if "://" not in link]
    for link in links:
        assert (document.parent / link).exists(), link
    for program in re.findall(r"\b(?:scripts|benchmarks)/\w+\.py", text):
        assert (ROOT / program).exists(), program


def test_every_public_module_is_in_the_api():
    """Sphinx then makes a page for each of its names, and ends with an error if one is missing (docs/conf.py)."""
    inner = {"hrljax.envs.bus.map"}
    modules = {module.name for module in pkgutil.walk_packages(hrljax.__path__, "hrljax.")} | {"hrljax"}
    offer = {name for name in modules if hasattr(importlib.import_module(name), "__all__")} - inner
    assert offer == set(public_names.MODULES)
    listed = re.findall(r"^   (hrljax[\w.]*)$", (ROOT / "docs" / "api.rst").read_text(), re.M)
    assert sorted(listed) == sorted(offer)
    names = public_names.all_names()
    assert {"hrljax.QLearning", "hrljax.sweep", "hrljax.stats.mean", "hrljax.envs.below"} <= names
    assert {"hrljax.make", "hrljax.interop.gymnax.make"} <= names, "two functions of one name"
    assert "hrljax.envs.Environment" not in names, "one class that two modules offer"


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 180


@pytest.mark.parametrize("page", ["own_environment.md", "guides/first_project.md"])
def test_an_own_environment_and_an_own_project_take_no_more_than_40_lines(page: str):
    first, *_ = blocks(ROOT / "docs" / page, "python")
    assert len([line for line in first.splitlines() if line.strip()]) <= 40


def test_a_block_is_found_with_its_place(tmp_path: Path):
    """The extraction itself."""
    document = tmp_path / "x.md"
    document.write_text("text\n```python\nx = 1\n```\n```sh\npython x\n```\n```python\nraise ValueError(x)\n```\n")
    first, second = blocks(document, "python")
    assert (first, second) == ("\n\nx = 1\n", "\n" * 8 + "raise ValueError(x)\n")


def test_what_an_example_prints_is_what_it_says(tmp_path: Path):
    document = tmp_path / "x.md"
    document.write_text("print(f'{x:.2f}')  # about -2.50\nprint(x)\n")
    code = compile(document.read_text(), document, "exec")
    exec(code, {"print": Printed(document), "x": -2.5})
    with pytest.raises(AssertionError, match="prints"):
        exec(code, {"print": Printed(document), "x": 2.5})


@pytest.mark.parametrize("name", hrljax.registered())
def test_every_environment_has_a_page_with_its_picture_numbers_and_options(name: str):
    page = ROOT / "docs" / "environments" / f"{name.lower()}.md"
    text, env = page.read_text(), hrljax.make(name)
    assert text.splitlines()[2].startswith("!["), "a picture comes first"
    missing = [word for word in (*env.default_params._fields, *env.__dataclass_fields__) if f"`{word}`" not in text]
    assert not missing


LEARNERS = sorted(
    name
    for name in hrljax.__all__
    if isinstance(thing := getattr(hrljax, name), type) and issubclass(thing, hrljax.learners.Learner)
)


ROOTS = ["LinearRoot", "ModelRoot", "RandomRoot", "RLDTRoot", "SearchRoot"]


@pytest.mark.parametrize("name", [*LEARNERS, *ROOTS, "Fading"])
def test_every_learner_has_a_page_with_its_curve_and_its_rule(name: str):
    """A page in docs/learners that points to its API."""
    pages = [page.read_text() for page in (ROOT / "docs" / "learners").glob("*.md")]
    text = next(text for text in pages if f"<hrljax.{name}>`" in text)
    assert text.splitlines()[2].startswith("!["), "a picture comes first"
    assert "$$" in text
    assert "**Source**" in text


@pytest.mark.parametrize("name", make_notebooks.NOTEBOOKS)
def test_notebooks_are_those_of_their_pages(name: str):
    """Their code is run with the pages'; here, that it is Python, and that links lead somewhere."""
    file = make_notebooks.FOLDER / f"{name}.ipynb"
    assert file.read_text() == make_notebooks.notebook(make_notebooks.NOTEBOOKS[name])
    cells = json.loads(file.read_text())["cells"]
    for cell in cells:
        if cell["cell_type"] == "code":
            compile(cell["source"], file, "exec")
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", cell["source"]):
            assert "://" in link or (file.parent / link).exists(), link
    assert sum(cell["cell_type"] == "code" for cell in cells) >= 2


def test_a_page_becomes_cells_that_show_their_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(make_notebooks, "DOCS", tmp_path)
    monkeypatch.setattr(make_notebooks, "FOLDER", tmp_path / "notebooks")
    (tmp_path / "guides").mkdir()
    code = 'ax = f()\nax.figure.savefig("a.png")\ng(ax).figure.savefig("b.png")\n'
    (tmp_path / "guides" / "x.md").write_text(f"# X\n\n![y](../y.png) [z](z.md)\n\n```python\n{code}```\n\nend\n")
    cells = json.loads(make_notebooks.notebook("guides/x"))["cells"]
    assert [cell["source"] for cell in cells] == [
        "# X\n\n![y](../y.png) [z](../guides/z.md)",
        'ax = f()\nax.figure.savefig("a.png")\ng(ax)',
        "end",
    ]


def test_docstrings_name_sections_that_exist():
    """Modules point to sections of documents by their titles: docs/page.md, "Title"."""
    named = set()
    for module in (ROOT / "hrljax").rglob("*.py"):
        named |= set(re.findall(r'(docs/\w+\.md), "([^"]+)"', module.read_text()))
    assert len(named) >= 6
    for document, title in named:
        titles = re.findall(r"^#+ (?:\d+\. )?(.+)$", (ROOT / document).read_text(), re.M)
        assert title in titles, (document, title)


EQUATIONS = ROOT / "docs" / "equations.md"


def rows_of_tables(document: Path) -> list[list[str]]:
    """The cells of every row, headings aside, of tables with four columns."""
    lines = [line for line in document.read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    heads = {i for i in range(len(cells) - 1) if set("".join(cells[i + 1])) == {"-"}}
    return [row for i, row in enumerate(cells) if len(row) == 4 and not {i, i - 1} & heads]


def exists(name: str) -> bool:
    """Whether a dotted name leads to something."""
    thing, path = hrljax, "hrljax"
    for part in name.split(".")[1:]:
        path += f".{part}"
        try:
            thing = getattr(thing, part) if hasattr(thing, part) else importlib.import_module(path)
        except ImportError:
            return False
    return True


def test_equations_name_code_and_tests_that_exist():
    rows = rows_of_tables(EQUATIONS)
    assert len(rows) > 60
    for equation, _, code, tests in rows:
        names = re.findall(r"`(hrl(?:jax)?\.[\w.]+)`", code)
        assert names, equation
        assert not [name for name in names if not exists(name)], equation
        places = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", tests)
        assert places, equation
        for file, test in places:
            assert re.search(rf"^def {test}", (ROOT / file).read_text(), re.M), (equation, file, test)


def test_every_numbered_equation_of_the_thesis_is_there():
    """2.1 to 2.23, 3.1 to 3.12, 4.1 to 4.4, eight definitions and three theorems."""
    text = EQUATIONS.read_text().split("## MAXQ (Dietterich")[0]
    labels = [line.split("|")[1] for line in text.splitlines() if line.startswith("|")]
    named: set[str] = set()
    for chapter, first, _, last in re.findall(r"\b([234])\.(\d+)(?: to ([234])\.(\d+))?", " ".join(labels)):
        named |= {f"{chapter}.{number}" for number in range(int(first), int(last or first) + 1)}
    for chapter, count in (("2", 23), ("3", 12), ("4", 4)):
        assert named >= {f"{chapter}.{number}" for number in range(1, count + 1)}
    for label in [f"Definition {i}" for i in range(1, 9)] + [f"Theorem {i}" for i in (1, 2, 3)]:
        assert any(label in text for text in labels), label
