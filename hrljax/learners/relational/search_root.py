"""A root that plans in Mario: best-first search on a model (thesis 4.2.3)."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import checks
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Experience, Moment
from hrljax.learners.hyperparameters import Hyperparameter, Settings, hyperparameter
from hrljax.learners.relational.given_model import MarioDynamics
from hrljax.learners.relational.learned_model import MarioModel
from hrljax.search.best_first import Answer, Count, Priority, SearchResult, best_first_search

Follow = Literal["every_step", "sequence"]


class Plan(NamedTuple):
    """What the root suggests now, and what it would then."""

    action: Array  # int32: suggested now
    rest: Array  # [depth] int32: the sequence that the search found
    used: Array  # int32: how much of it is used up
    length: Array  # int32


@dataclass(frozen=True)
class SearchRoot(Settings):
    """Suggests the first action of the best sequence that a search on a model finds.

    Attributes:
        stop_reward: the search ends when a sequence promises more.
        model: a model that is learned, and how, or one that is given.
        depth, max_nodes, count, priority, answer: see `hrljax.search.best_first.best_first_search`.
        follow: searches at ``"every_step"``, or follows a ``"sequence"`` to its end.
        refit_interval: episodes between two fits of the model.
    """

    stop_reward: Hyperparameter = hyperparameter(6.0)
    model: MarioModel | MarioDynamics = MarioModel()
    depth: int = 6
    max_nodes: int = 300
    count: Count = "generated"
    priority: Priority = "cumulative"
    answer: Answer = "any"
    follow: Follow = "every_step"
    refit_interval: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("depth", "max_nodes", "refit_interval"):
            self._check_integer(name, 1)
        for name, allowed in (("count", Count), ("priority", Priority), ("answer", Answer), ("follow", Follow)):
            self._check_choice(name, allowed)
        checks.instance("SearchRoot: model", self.model, (MarioModel, MarioDynamics), "a MarioModel or MarioDynamics")

    def init(self, env: Mario) -> Any:
        return self.model.init(env)

    def no_plan(self) -> Plan:
        nothing = jnp.int32(0)
        return Plan(nothing, jnp.zeros(self.depth, jnp.int32), nothing, nothing)

    def search(self, env: Mario, tables: Any, episode: Any) -> SearchResult:
        """The search from a moment of an episode, with its tree."""
        model, start = self.model.planned(env, tables, episode)
        return best_first_search(
            model,
            start,
            env.num_actions,
            depth=self.depth,
            max_nodes=self.max_nodes,
            count=self.count,
            priority=self.priority,
            answer=self.answer,
            stop_reward=jnp.asarray(self.stop_reward, jnp.float32),
        )

    def advise(self, env: Mario, tables: Any, plan: Plan, episode: Any, asked: Array) -> Plan:
        """The suggestion for a moment of an episode; `plan` as it is where nobody asked."""

        def fresh() -> Plan:
            found = self.search(env, tables, episode)
            return Plan(found.action, found.actions, jnp.int32(1), found.length)

        if self.follow == "every_step":
            return lax.cond(asked, fresh, lambda: plan)
        left = plan.used < plan.length
        following = plan._replace(action=plan.rest[lax.min(plan.used, self.depth - 1)], used=plan.used + 1)
        return lax.cond(asked & ~left, fresh, lambda: following)

    def observe(self, env: Mario, tables: Any, step: Experience, moment: Moment) -> Any:
        """Tells the model of a transition."""
        return self.model.observe(env, tables, step, moment.live)

    def refit(self, env: Mario, tables: Any, moment: Moment) -> Any:
        """Fits the model to what it was told."""
        refitted = self.model.refit(env, tables)
        return lax.cond(moment.live, lambda: refitted, lambda: tables) if moment.lockstep else refitted
