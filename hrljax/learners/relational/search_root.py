"""Roots that plan in Mario on a model: what they have in common, and best-first search (thesis 4.2.3)."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import chex
import jax.numpy as jnp
from jax import Array, lax
from jax.core import Tracer

from hrljax.core import checks
from hrljax.core.flags import Flag, both
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Context, Transition
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.learners.relational.learned_model import MarioModel
from hrljax.learners.relational.planner_model import PlannerModel
from hrljax.learners.roots.base import Decision, Root
from hrljax.search.a_star import AStarResult
from hrljax.search.best_first import Answer, Count, Loop, Priority, SearchResult, best_first_search, check_room

Follow = Literal["every_step", "sequence"]


class Plan(NamedTuple):
    """What is left of a sequence of actions that a search has suggested."""

    actions: Array  # [depth] int32
    used: Array  # int32: how many of them were suggested
    length: Array  # int32


@dataclass(frozen=True)
class PlanningRoot(Root[Mario, chex.ArrayTree, Plan, Episode]):
    """Suggests the first action of the best sequence that a search on a model finds.

    Attributes:
        model: a model that is learned, and how, or one that is given.
        depth: of a sequence, at most.
        follow: searches at ``"every_step"``, or follows a ``"sequence"`` to its end.
        refit_interval: episodes between two fits of the model.
    """

    model: PlannerModel[Any] = MarioModel()
    depth: int = 6
    follow: Follow = "every_step"
    refit_interval: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("depth", "refit_interval"):
            self._check_integer(name, 1)
        self._check_choice("follow", Follow)

    @property
    def planning_interval(self) -> int:
        return self.refit_interval

    def init(self, prepared: Mario) -> chex.ArrayTree:
        return self.model.init(prepared)

    def begin(self, prepared: Mario, tables: chex.ArrayTree, asked: Episode, context: Context) -> Decision[Plan]:
        none = jnp.int32(0)
        no_plan = Decision(none, Plan(jnp.zeros(self.depth, jnp.int32), none, none))
        return self._suggested(prepared, tables, no_plan, asked, jnp.bool_(True), context)

    def step(
        self,
        prepared: Mario,
        tables: chex.ArrayTree,
        decision: Decision[Plan],
        transition: Transition,
        ended: Flag,
        discount: Array,
        asked: Episode,
        context: Context,
    ) -> tuple[chex.ArrayTree, Decision[Plan]]:
        observed = self.model.observe(prepared, tables, transition, context.learns)
        decides = both(ended, ~transition.terminated & context.learns)
        # With what was observed: a search in the tables from before would make a native loop copy them in every step.
        return observed, self._suggested(prepared, observed, decision, asked, jnp.asarray(decides), context)

    def plan(self, prepared: Mario, tables: chex.ArrayTree, context: Context) -> chex.ArrayTree:
        """Fits the model to what it was told."""
        refitted = self.model.refit(prepared, tables)
        return lax.cond(context.learns, lambda: refitted, lambda: tables) if context.vmapped else refitted

    @abstractmethod
    def search(
        self, env: Mario, tables: chex.ArrayTree, episode: Episode, loop: Loop = "while"
    ) -> SearchResult | AStarResult:
        """The search from a moment of an episode, with what it looked at; `loop` as of `best_first_search`."""

    def _suggested(
        self,
        env: Mario,
        tables: chex.ArrayTree,
        decision: Decision[Plan],
        episode: Episode,
        decides: Array,
        context: Context,
    ) -> Decision[Plan]:
        """The suggestion for a moment of an episode; `decision` as it is where the root does not decide."""
        plan = decision.memory

        def searched() -> Decision[Plan]:
            # Runs that take their steps together wait for the longest search, so it may as well have a fixed length.
            result = self.search(env, tables, episode, "scan" if context.vmapped else "while")
            return Decision(result.action, Plan(result.actions, jnp.int32(1), result.length))

        if self.follow == "every_step":
            return lax.cond(decides, searched, lambda: decision)
        is_left = plan.used < plan.length
        next_action = plan.actions[lax.min(plan.used, self.depth - 1)]
        following = Decision(next_action, plan._replace(used=plan.used + 1))
        return lax.cond(decides & ~is_left, searched, lambda: following)


@dataclass(frozen=True)
class SearchRoot(PlanningRoot):
    """Suggests the first action of the best sequence that a best-first search on a model finds.

    Attributes:
        stop_reward: the search ends when a sequence promises more.
        model: a model that is learned, and how, or one that is given.
        depth, max_nodes, room, count, priority, answer: see `hrljax.search.best_first.best_first_search`. Where
            `max_nodes` is swept, `room` has to be given.
        follow, refit_interval: see `PlanningRoot`.
    """

    stop_reward: Hyperparameter = hyperparameter(6.0)
    max_nodes: Hyperparameter = hyperparameter(300, 1)
    room: int | None = None
    count: Count = "generated"
    priority: Priority = "cumulative"
    answer: Answer = "any"

    name = "search"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, allowed in (("count", Count), ("priority", Priority), ("answer", Answer)):
            self._check_choice(name, allowed)
        nodes: Any = self.max_nodes
        if not isinstance(nodes, Tracer) and nodes == int(nodes):
            self._set("max_nodes", int(nodes))  # an axis has floats
        check_room(self.max_nodes, self.room, "SearchRoot: ")
        checks.instance("SearchRoot: model", self.model, PlannerModel, "a MarioModel, MultiwayModel or MarioDynamics")

    def search(self, env: Mario, tables: chex.ArrayTree, episode: Episode, loop: Loop = "while") -> SearchResult:
        """The search from a moment of an episode, with its tree."""
        model, start = self.model.planned(env, tables, episode)
        return best_first_search(
            model,
            start,
            env.num_actions,
            depth=self.depth,
            max_nodes=self.max_nodes,
            room=self.room,
            count=self.count,
            priority=self.priority,
            answer=self.answer,
            stop_reward=jnp.asarray(self.stop_reward, jnp.float32),
            loop=loop,
        )
