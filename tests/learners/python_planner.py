"""How RL-DT learns a model, plans and explores, in plain Python."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.core import random
from hrljax.learners.effects import FactoredModel
from hrljax.learners.tree_planner import TreePlanner
from tests.learners.python_run import settled
from tests.trees.python_trees import grown, leaves

F = np.float32


class Planner:
    """Trees as lists of nodes, outcomes combined one by one."""

    def __init__(self, planner: TreePlanner, model: FactoredModel, num_trees: int = 1):
        self.learner: Any = planner
        self.model, self.num_trees = model, num_trees
        self.spec, self.states, self.actions = model.trees, model.states, model.num_actions
        self.pairs = model.num_pairs
        pairs = np.arange(self.pairs)
        self.inputs = np.concatenate([self.states.values[pairs // self.actions], pairs[:, None] % self.actions], 1)
        self.allowed = np.ones(self.pairs, np.bool_) if model.allowed is None else model.allowed
        self.q = np.full(self.pairs, planner.least_value, F)
        self.exploring = np.full(self.pairs, planner.optimistic_value, F)
        self.counts = [np.zeros((self.pairs, n), int) for n in self.spec.num_classes]
        self.rewards: list[F] = []
        self.weights = [F(1), F(0)]
        self.forest: list[list[Any]] = []
        self.is_fresh, self.surprised, self.waited = True, False, 0
        self.plans = self.explored = 0

    def is_exploring(self, state: int) -> bool:
        promised = self.q[state * self.actions : (state + 1) * self.actions].max()
        return self.learner.explores and bool(promised < F(self.learner.satisfying_value))

    def worth(self, state: int) -> np.ndarray:
        """What to choose by in a state."""
        self.explored += self.is_exploring(state)
        return (self.exploring if self.is_exploring(state) else self.q)[state * self.actions :][: self.actions]

    def see(self, state: int, action: int, reward: F, after: int, weight: F, terminated: bool, words: Any = ()) -> None:
        """Of a step; plans if that is due."""
        pair, step = state * self.actions + action, self.classes(state, reward, after, weight, terminated)
        surprised = any(self.probability(kind, pair, which) < F(self.learner.refit_below) for kind, which in step)
        for kind, which in step:
            self.counts[kind][pair, which] += 1
        self.is_fresh &= self.visits()[pair] != self.learner.known_after
        self.surprised |= surprised
        self.waited += 1
        needs = self.surprised or (self.is_exploring(after) and not self.is_fresh)
        if needs and self.waited >= self.learner.refit_interval:
            self.plan(after, words)

    def visits(self) -> np.ndarray:
        return self.counts[-1].sum(1)

    def classes(self, state: int, reward: F, after: int, weight: F, terminated: bool) -> list[tuple[int, int]]:
        """Kinds of trees that learn from a step, and its class of each."""
        places = []
        for known, number, most in (
            (self.rewards, reward, self.learner.max_rewards),
            (self.weights, weight, self.model.num_weights),
        ):
            if number not in known and len(known) < most:
                known.append(number)
            places.append(int(np.argmin([abs(number - other) for other in known])))
        step = []
        for v, size in enumerate(self.states.sizes if not terminated else ()):
            change = self.states.values[after, v] - self.states.values[state, v] + size - 1
            step.append((v, int(change if self.learner.effects == "relative" else self.states.values[after, v])))
        kinds = len(self.counts)
        return [*step, (kinds - 2, places[0]), (kinds - 1, places[1])]

    def probability(self, kind: int, pair: int, which: int) -> F:
        if not self.forest:
            return F(0)
        chance = F(0)
        for nodes in self.forest[kind]:
            counts = nodes[int(leaves(nodes, self.inputs[pair : pair + 1])[0])][2]
            chance += F(counts[which]) * (F(1) / F(max(sum(counts), 1)))
        return chance * F(1 / len(self.forest[kind]))

    def plan(self, state: int, words: Any) -> None:
        self.plans += 1
        self.surprised, self.waited = False, 0
        self.forest = [
            [self.tree(kind, number, words) for number in range(self.num_trees)] for kind in range(len(self.counts))
        ]
        backed_up = self.outcomes()
        self.q, _ = settled(self.learner, self.q, backed_up)
        if self.learner.explores:
            self.is_fresh = self.is_exploring(state)
            if self.is_fresh:
                known = (self.visits() >= self.learner.known_after) | ~self.allowed
                optimistic = F(self.learner.optimistic_value)
                self.exploring, _ = settled(
                    self.learner, self.exploring, lambda q: np.where(known, backed_up(q), optimistic)
                )

    def tree(self, kind: int, number: int, words: Any) -> list[Any]:
        seen = np.flatnonzero(self.visits())
        kept = None
        if words:
            key = tuple(map(jnp.uint32, words))
            first = (number * len(self.counts) + kind) * self.learner.max_nodes
            numbers = jnp.arange(self.learner.max_nodes, dtype=jnp.uint32) + np.uint32(first)
            kept = np.asarray(drawn(key, numbers, len(self.spec.sizes))) >= F(self.learner.left_out) * 2**24
        return grown(self.spec, self.inputs[seen], self.counts[kind][seen], self.learner.least_score, kept)

    def outcomes(self) -> Any:
        """The backup of action values under the model."""
        chances = []
        for of_kind in self.forest:
            total = F(0)
            for nodes in of_kind:
                counts = np.array([node[2] for node in nodes])
                shares = counts.astype(F) * (F(1) / np.maximum(counts.sum(1), 1).astype(F))[:, None]
                total = total + shares[leaves(nodes, self.inputs)]
            chances.append(total * F(1 / len(of_kind)))
        *variables, of_rewards, of_ends = chances
        reward, goes_on = np.zeros(self.pairs, F), np.zeros(self.pairs, F)
        for number, value in enumerate(self.rewards):
            reward += value * of_rewards[:, number]
        for number, weight in enumerate(self.weights):
            goes_on += weight * of_ends[:, number]
        combined: list[list[tuple[F, int]]] = []
        for pair in range(self.pairs):
            options = [self.options(v, chance[pair], pair) for v, chance in enumerate(variables)]
            combined.append(self.combinations(options, pair // self.actions))
        sums = np.array([np.add.accumulate([F(0), *(w for w, _ in row)], dtype=F)[-1] for row in combined])
        follows = goes_on / np.maximum(sums, F(1e-6))
        discount = F(getattr(self.learner, "discount", 1))
        width = max(map(len, combined))
        padded = [row + [(F(0), 0)] * (width - len(row)) for row in combined]
        weights, states = (np.array([[o[i] for o in row] for row in padded], t) for i, t in ((0, F), (1, int)))

        def backed_up(q: np.ndarray) -> np.ndarray:
            value, after = q.reshape(-1, self.actions).max(1), np.zeros(self.pairs, F)
            for m in range(width):
                after += weights[:, m] * value[states[:, m]]
            q = np.clip(
                reward + discount * (follows * after), F(self.learner.least_value), F(self.learner.optimistic_value)
            )
            return np.where(self.allowed, q, F(self.learner.least_value))

        return backed_up

    def options(self, v: int, chance: np.ndarray, pair: int) -> list[tuple[Any, int]]:
        """The likeliest next values of a variable."""
        size, now = self.states.sizes[v], int(self.states.values[pair // self.actions, v])
        likeliest = [c for c in np.argsort(-chance, kind="stable")[:4].tolist() if chance[c] > 0]
        if self.learner.effects == "relative":
            return [(chance[c], min(max(now + c - size + 1, 0), size - 1)) for c in likeliest]
        return [(chance[c], c) for c in likeliest]

    def combinations(self, options: list[list[tuple[F, int]]], state: int) -> list[tuple[F, int]]:
        """Weights and next states, the first variable changing fastest."""
        rows: list[list[tuple[F, int]]] = [[]]
        for of_variable in options[::-1]:
            rows = [[option, *rest] for rest in rows for option in of_variable]
        result = []
        for row in rows[: self.learner.max_outcomes]:
            weight = F(1)
            for chance, _ in row:
                weight *= chance
            after = int(self.states.number[self.states.place([value for _, value in row])])
            result.append((weight, state if after < 0 else after))
        return result


def drawn(key: Any, numbers: jax.Array, count: int) -> jax.Array:
    return jax.jit(jax.vmap(lambda i: jnp.stack(random.words(key, i, count))))(numbers)
