"""What was learned: one run's tables, on disk and as a policy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hrljax.core import checks
from hrljax.core.environment import EpisodeState
from hrljax.engine.start import Start, described, learned_shapes, named_leaves, step_words, tree_of
from hrljax.envs.base import AnyEnvironment, Environment
from hrljax.hierarchy.numpy_policy import Policy, from_hierarchical
from hrljax.learners.base import AnyLearner, Learner, outside_of_training
from hrljax.learners.hyperparameters import with_tabulated_schedules
from hrljax.sweeps import learned_file
from hrljax.sweeps.axes import of_learner
from hrljax.sweeps.continuation import check_origin, episodes_of, names_of_tables, swept_along_points

if TYPE_CHECKING:
    import xarray as xr

_MOST_SHOWN = 12
"""Values of an axis that a message lists."""


class Learned:
    """What one run has learned.

    Attributes:
        env: the environment.
        learner: the learner, with the hyper-parameters that it learned with.
        tables: its tables, a tree of NumPy arrays; `hrljax.Run.learned`.
        episodes: how many it has learned from; 0 if that is not known.
        steps: primitive steps of these episodes.
    """

    def __init__(
        self, env: AnyEnvironment, learner: AnyLearner, tables: chex.ArrayTree, *, episodes: int = 0, steps: int = 0
    ):
        """
        Raises:
            TypeError: an argument is of the wrong kind.
            ValueError: `tables` are not those of one run of `learner` on `env`; `episodes` or `steps` is negative.
        """
        checks.instance("env", env, Environment, "an environment such as hrljax.make('Bus')")
        checks.instance("learner", learner, Learner, "a learner such as hrljax.QLearning()")
        episodes = checks.integer("episodes", episodes)
        steps = checks.integer("steps", steps, 0, 2**63 - 1)
        self.env, self.learner = env, learner
        self.episodes, self.steps = episodes, steps
        self.tables = jax.tree.map(np.asarray, tables)
        expected = learned_shapes(env, learner)
        if described(self.tables) != described(expected):
            raise ValueError(
                f"tables must be those of one run of {learner.name} on {env.name}, {described(expected)}, "
                f"got {described(self.tables)}"
            )

    def __repr__(self) -> str:
        return f"Learned({self.learner.name} on {self.env.name}, {self.episodes} episodes, {self.steps} steps)"

    @classmethod
    def of(
        cls,
        dataset: xr.Dataset,
        env: AnyEnvironment,
        learner: AnyLearner,
        *,
        seed: int = 0,
        at: Mapping[str, float] | None = None,
    ) -> Learned:
        """One run out of a sweep.

        Args:
            dataset: what ``hrljax.sweep(..., keep_learned=True)`` returned.
            env: the environment of the sweep.
            learner: the learner of the sweep.
            seed: number of the seed.
            at: the value along each axis; of `hrljax.points`, ``{"point": number}``.

        Raises:
            TypeError: an argument is of the wrong kind.
            ValueError: the dataset has no tables, is of something else, or has not finished this run.
            KeyError: a seed or a value that the dataset does not have; the message lists those that it has.
        """
        _check_dataset(dataset)
        checks.instance("env", env, Environment, "the environment of the sweep")
        checks.instance("learner", learner, Learner, "the learner of the sweep")
        at = dict(checks.instance("at", {} if at is None else at, Mapping, "a mapping such as {'step_size': 0.1}"))
        axes = [str(dim) for dim in dataset["steps"].dims if dim != "seed"]
        if set(at) != set(axes):
            raise ValueError(f"at must give a value for each of {axes}, got {at}")
        check_origin("the dataset", dataset, env, learner)
        point = {"seed": _on_grid("seed", seed, dataset)}
        point |= {axis: _on_grid(f"at: {axis}", at[axis], dataset, axis) for axis in axes}
        run = dataset.sel(point)
        if not np.isfinite(run["steps"]):
            raise ValueError(f"the run of seed {seed} at {at} is not finished")
        swept = {name: float(run[name]) for name in swept_along_points(dataset)} or at
        learner = learner.replaced(of_learner(swept))
        named = {name: run[name].values for name in names_of_tables("the dataset", run)}
        tables = tree_of(learned_shapes(env, learner), named)
        return cls(env, learner, tables, episodes=episodes_of(dataset), steps=int(run["steps"]))

    def as_start(self) -> Start:
        """Where `hrljax.train` and `hrljax.sweep` go on from it."""
        return Start(self.tables, self.episodes, step_words(self.steps))

    def policy(self, seed: int = 0) -> Policy | StatePolicy:
        """The greedy policy: in plain NumPy, over the numbers of states; or, of a learner that sees states, over these.

        Args:
            seed: of the choices of a root that chooses at random; other policies are deterministic.

        Raises:
            TypeError, ValueError: `seed` is no integer of at least 0.
            ValueError: a learner that sees states has a schedule; replace it by the number that is meant.
        """
        checks.integer("seed", seed, 0, 2**64 - 1)
        tables = jax.tree.map(jnp.asarray, self.tables)
        if not self.learner.is_tabular:
            return StatePolicy(self.env, self.learner, tables)
        prepared = self.learner.prepare(self.env)
        learner = with_tabulated_schedules(self.learner, max(1, self.episodes))
        context = outside_of_training(jnp.uint32(0), self.episodes)
        policy = learner.greedy_policy(self.env, prepared, tables, context)
        return from_hierarchical(policy, np.random.default_rng(seed))

    def save(self, path: str | Path) -> None:
        """Writes one file, whole or not at all: the tables and what they belong to. It holds no code.

        Raises:
            OSError: `path` cannot be written.
        """
        path = checks.path("path", path)
        tables = {name: np.asarray(leaf) for name, leaf in named_leaves(self.tables)}
        learned_file.write(path, self.env, self.learner, tables, self.episodes, self.steps)

    @classmethod
    def load(cls, path: str | Path, env: AnyEnvironment | None = None, learner: AnyLearner | None = None) -> Learned:
        """Reads a file that `save` wrote.

        Args:
            path: the file.
            env: the environment; has to be given unless it is registered.
            learner: the learner; has to be given if it has a schedule, options, or a hierarchy other
                than the environment's own.

        Raises:
            FileNotFoundError: there is no file.
            ValueError: the file is damaged, no such file, of a version that is not known, or of
                another environment or learner than those that are given. The message says which.
        """
        path = checks.path("path", path)
        header, tables = learned_file.read(path)
        env, learner = learned_file.owners(path, header, env, learner)
        if sorted(tables) != header["tables"]:
            raise ValueError(f"{path} is damaged: it has the tables {sorted(tables)} instead of {header['tables']}")
        trained = {name: int(header.get(name, 0)) for name in ("episodes", "steps")}  # older files do not say
        return cls(env, learner, tree_of(learned_shapes(env, learner), tables), **trained)


def _check_dataset(dataset: object) -> None:
    import xarray as xr

    checks.instance("dataset", dataset, xr.Dataset, "a dataset of hrljax.sweep(..., keep_learned=True)")
    assert isinstance(dataset, xr.Dataset)
    if "steps" not in dataset:
        variables = ", ".join(map(str, dataset.data_vars)) or "none"
        raise ValueError(f"dataset must have the variable 'steps', as hrljax.sweep gives it; it has {variables}")


def _on_grid(name: str, value: float, dataset: xr.Dataset, axis: str = "seed") -> float:
    """The value, if it is one of those along an axis of a dataset."""
    grid = dataset[axis].values
    value = checks.integer(name, value, -checks.LARGEST_INTEGER) if axis == "seed" else checks.number(name, value)
    if value not in grid:
        shown = ", ".join(f"{known:.12g}" for known in grid[:_MOST_SHOWN])
        more = f" and {len(grid) - _MOST_SHOWN} more, up to {grid.max():.12g}" if len(grid) > _MOST_SHOWN else ""
        raise KeyError(f"{name} must be one of {shown}{more}, got {checks.described(value)}")
    return value


class StatePolicy:
    """What a learner that sees states does without exploration: called with a state, it gives the number of an action.

    It decides in every state anew: a root that follows a sequence of actions searches in every step.
    """

    def __init__(self, env: AnyEnvironment, learner: AnyLearner, tables: chex.ArrayTree):
        """
        Raises:
            ValueError: the learner has a schedule.
        """
        greedy = learner.replaced({"epsilon": 0.0})
        for name, value in greedy.settings().items():
            if callable(value):
                raise ValueError(f"the policy of {learner.name} needs a number for {name}, which is a schedule")
        prepared, words = greedy.prepare(env), (jnp.uint32(0),) * greedy.num_begin_words
        context = outside_of_training(jnp.uint32(0), 0)

        def choose(tables: chex.ArrayTree, state: EpisodeState) -> jax.Array:
            return greedy.action(greedy.begin(prepared, tables, state, words, context))

        self._tables, self._choose = tables, jax.jit(choose)

    def reset(self) -> None:
        """Begins an episode; there is nothing to forget."""

    def __call__(self, state: EpisodeState) -> int:
        """The action (its number) in a state of the environment."""
        return int(self._choose(self._tables, state))
