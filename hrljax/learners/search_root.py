"""A root that plans in Mario: best-first search on a learned model (thesis 4.2.3)."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Experience, Hyperparameter, Moment, Settings, hyperparameter
from hrljax.models.mario_model import Learned, MarioModel, Replay, body_of
from hrljax.planners.best_first import Answer, Count, Priority, SearchResult, best_first_search


class SearchTables(NamedTuple):
    """What a `SearchRoot` has learned."""

    replay: Replay
    learned: Learned


class Plan(NamedTuple):
    """What the root suggests now, and what it would then."""

    action: Array  # int32: suggested now
    rest: Array  # [depth] int32: the sequence that the search found
    used: Array  # int32: how much of it is used up
    length: Array  # int32


@dataclass(frozen=True)
class SearchRoot(Settings):
    """Suggests the first action of the best sequence that a search on a learned model finds.

    Attributes:
        stop_reward: the search ends when a sequence promises more.
        model: how the model is learned.
        depth, max_nodes, count, priority, answer: see `hrljax.planners.best_first.best_first_search`.
        follow: searches at ``"every_step"``, or follows a ``"sequence"`` to its end.
        refit_interval: episodes between two fits of the model.
    """

    stop_reward: Hyperparameter = hyperparameter(6.0)
    model: MarioModel = MarioModel()
    depth: int = 6
    max_nodes: int = 300
    count: Count = "generated"
    priority: Priority = "cumulative"
    answer: Answer = "any"
    follow: Literal["every_step", "sequence"] = "every_step"
    refit_interval: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("depth", "max_nodes", "refit_interval"):
            self._check_integer(name, 1)
        if self.follow not in ("every_step", "sequence"):
            raise ValueError(f"SearchRoot: follow must be 'every_step' or 'sequence', got {self.follow!r}")
        if not isinstance(self.model, MarioModel):
            raise TypeError(f"SearchRoot: model must be a MarioModel, got {self.model!r}")

    def init(self, env: Mario) -> SearchTables:
        return SearchTables(self.model.empty(), self.model.unfitted(env.num_actions))

    def no_plan(self) -> Plan:
        nothing = jnp.int32(0)
        return Plan(nothing, jnp.zeros(self.depth, jnp.int32), nothing, nothing)

    def search(self, env: Mario, tables: SearchTables, episode: Any) -> SearchResult:
        """The search from a moment of an episode, with its tree."""
        model = self.model.look_ahead(tables.learned, env.course, episode)
        return best_first_search(
            model,
            body_of(episode.world),
            env.num_actions,
            depth=self.depth,
            max_nodes=self.max_nodes,
            count=self.count,
            priority=self.priority,
            answer=self.answer,
            stop_reward=jnp.asarray(self.stop_reward, jnp.float32),
        )

    def advise(self, env: Mario, tables: SearchTables, plan: Plan, episode: Any, asked: Array) -> Plan:
        """The suggestion for a moment of an episode; `plan` as it is where nobody asked."""

        def fresh() -> Plan:
            found = self.search(env, tables, episode)
            return Plan(found.action, found.actions, jnp.int32(1), found.length)

        if self.follow == "every_step":
            return lax.cond(asked, fresh, lambda: plan)
        left = plan.used < plan.length
        following = plan._replace(action=plan.rest[lax.min(plan.used, self.depth - 1)], used=plan.used + 1)
        return lax.cond(asked & ~left, fresh, lambda: following)

    def observe(self, env: Mario, tables: SearchTables, step: Experience, moment: Moment) -> SearchTables:
        """Keeps a transition for the next fit."""
        before, after = step.state.world, step.next_state.world
        replay = self.model.add(
            tables.replay,
            self.model.inputs(env.course, before),
            step.action,
            body_of(before),
            body_of(after),
            step.reward,
            step.terminated,
            env.num_actions,
            moment.live,
        )
        return tables._replace(replay=replay)

    def refit(self, env: Mario, tables: SearchTables, moment: Moment) -> SearchTables:
        """Fits the model to what is kept."""
        learned = self.model.fit(tables.replay, env.num_actions)
        if moment.lockstep:
            learned = lax.cond(moment.live, lambda: learned, lambda: tables.learned)
        return tables._replace(learned=learned)
