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


def all_names() -> set[str]:
    """Whole names of the public classes and functions; what the package itself offers too has that name only."""
    top_level = import_module("hrljax").__all__
    names = set()
    for module in map(import_module, MODULES):
        offered = [name for name in module.__all__ if module.__name__ == "hrljax" or name not in top_level]
        things = ((name, getattr(module, name)) for name in offered)
        names |= {f"{module.__name__}.{name}" for name, thing in things if isclass(thing) or isroutine(thing)}
    return names
