"""The house: which module may use which, and that what is said of the modules is true."""

import ast
import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "hrljax"
COMPILER = "hrljax.engine.compiler"
LAYOUT = re.compile(r"^\| `hrljax/([\w/]+)/` \| .+ \| (.+) \|$", re.M)
Graph = dict[str, set[str]]


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


@cache
def imports(module: str) -> frozenset[str]:
    """The modules of the package that a module imports, inside of functions too."""
    named = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} has a relative import"
            name = str(node.module)
            named |= {inner if (inner := f"{name}.{alias.name}") in MODULES else name for alias in node.names}
    return frozenset(named & MODULES.keys())


def children(package: str) -> Graph:
    """Which of a package's modules and folders use which."""
    inside = f"{package}."
    graph: Graph = {}

    def child(module: str) -> str:
        return module.removeprefix(inside).split(".")[0]

    for module in MODULES:
        if module.startswith(inside):
            used = {child(name) for name in imports(module) if name.startswith(inside)}
            graph.setdefault(child(module), set()).update(used - {child(module)})
    return graph


def circle(graph: Graph) -> list[str]:
    """Nodes that lead back to the first of them; none if the graph has no circle."""
    left = dict(graph)
    while leaves := [node for node, used in left.items() if not used & left.keys()]:
        for node in leaves:
            del left[node]
    path = [*left][:1]
    while path and path[-1] not in path[:-1]:
        path.append(min(left[path[-1]] & left.keys()))
    return path[path.index(path[-1]) :] if path else []


@pytest.mark.parametrize(
    "package", sorted({name.rsplit(".", 1)[0] for name in MODULES if "." in name}), ids=lambda name: name
)
def test_neither_files_nor_folders_form_a_circle(package: str):
    assert not circle(children(package))


def test_a_circle_is_seen():
    assert circle({"a": {"b"}, "b": {"c", "d"}, "c": {"b"}, "d": set()}) in (["b", "c", "b"], ["c", "b", "c"])
    assert not circle({"a": {"b", "c"}, "b": {"c"}, "c": set()})


def test_only_the_engine_and_what_runs_it_know_the_compiler():
    users = {module for module in MODULES if COMPILER in imports(module)}
    rooms = {module.split(".")[1] for module in users if "." in module}
    assert rooms <= {"engine", "experiments"}, users


def test_the_layout_in_contributing_is_true():
    """Every folder has a row, and uses no folder that the row does not name."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    rows = {f"hrljax.{folder.replace('/', '.')}": cell for folder, cell in LAYOUT.findall(text)}
    folders = {name for name in children("hrljax") if (PACKAGE / name).is_dir()}
    assert {f"hrljax.{name}" for name in folders} <= rows.keys()
    for room, cell in rows.items():
        allowed = {f"hrljax.{name}" for name in re.findall(r"`([\w/]+)`", cell.replace("/", "."))}
        if cell == "everything":
            continue
        assert allowed or cell == "nothing", room
        for module in MODULES:
            if f"{module}.".startswith(f"{room}."):
                others = {name for name in imports(module) if not f"{name}.".startswith(f"{room}.")}
                wrong = {name for name in others if not any(f"{name}.".startswith(f"{a}.") for a in allowed)}
                assert not wrong, f"{module} uses {sorted(wrong)}, which the layout does not allow"


def names(text: str) -> Iterator[str]:
    yield from re.findall(r"(?<![\w/.`])`?`(hrljax(?:\.\w+)+)(?:\(.*?\))?`", text)


def exists(name: str) -> bool:
    """Whether a dotted name leads to a module or to something in one."""
    *_, parts = [name.split(".")]
    for length in range(len(parts), 0, -1):
        module = ".".join(parts[:length])
        try:
            thing = importlib.import_module(module)
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            fields = getattr(thing, "__dataclass_fields__", {}) | getattr(thing, "__annotations__", {})
            if not hasattr(thing, part):
                return part in fields
            thing = getattr(thing, part)
        return True
    return False


@pytest.mark.parametrize("folder", ["hrljax", "docs", "tests", "scripts", "benchmarks"])
def test_names_in_texts_lead_to_something(folder: str):
    """Docstrings and documents name modules, functions and classes by their whole path."""
    files = [path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".md")]
    files += [ROOT / "README.md", ROOT / "CONTRIBUTING.md"] if folder == "docs" else []
    stale = [(path.name, name) for path in files for name in names(path.read_text()) if not exists(name)]
    assert not stale
