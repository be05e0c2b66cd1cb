"""What a root that searches asks of its model."""

from typing import Any, Protocol, TypeVar, runtime_checkable

from jax import Array

from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Transition
from hrljax.search.best_first import ModelFn

Tables = TypeVar("Tables")


@runtime_checkable
class PlannerModel(Protocol[Tables]):
    """A model of Mario, learned or given. Hashable, and pure: what it learns is in its tables."""

    def init(self, env: Mario) -> Tables:
        """What it has learned before the first episode."""
        ...

    def observe(self, env: Mario, tables: Tables, transition: Transition, learns: Array) -> Tables:
        """The tables after a transition; as they were where not `learns`."""
        ...

    def refit(self, env: Mario, tables: Tables) -> Tables:
        """The tables fitted anew to what was observed."""
        ...

    def planned(self, env: Mario, tables: Tables, episode: Episode) -> tuple[ModelFn, Any]:
        """The model as a search asks it, and the state to search from at a moment of an episode.

        The model is ``model(state, action) -> next_state, reward`` or, of one that foresees ends,
        ``next_state, reward, ended``: what has ended is not looked beyond (`best_first_search`).
        """
        ...
