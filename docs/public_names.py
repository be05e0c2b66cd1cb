"""What the package offers, for the API pages and the tests of them."""

from importlib import import_module
from inspect import isclass, isroutine

MODULES = (
    "hrljax",
    "hrljax.envs",
    "hrljax.interop.gymnasium",
    "hrljax.interop.gymnax",
    "hrljax.learners",
    "hrljax.plots",
    "hrljax.solvers",
    "hrljax.stats",
)
"""Modules whose ``__all__`` is public."""


def of_module(name: str) -> list[str]:
    """What a module offers, but for what the package itself offers too: that has its place there only."""
    package, module = import_module("hrljax"), import_module(name)
    return [
        offered
        for offered in module.__all__
        if module is package or getattr(module, offered) is not getattr(package, offered, None)
    ]


def all_names() -> set[str]:
    """Whole names of the public classes and functions."""
    names = set()
    for module in MODULES:
        things = ((name, getattr(import_module(module), name)) for name in of_module(module))
        names |= {f"{module}.{name}" for name, thing in things if isclass(thing) or isroutine(thing)}
    return names
