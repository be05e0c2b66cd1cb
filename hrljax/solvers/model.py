"""A known Markov decision process as arrays."""

from typing import NamedTuple

import numpy as np
from jax.core import Tracer

from hrljax.core import checks


class Model(NamedTuple):
    """Outcomes of every action in every state, sparse: K outcomes each, unused ones of probability 0.

    Arrays may be NumPy's or JAX's; probabilities of a (state, action) pair sum to one.
    """

    next_state: np.ndarray  # [S, A, K] int32
    probability: np.ndarray  # [S, A, K] float64
    reward: np.ndarray  # [S, A, K] float64
    terminated: np.ndarray  # [S, A, K] bool: the episode ends, the next state has no value

    def __repr__(self) -> str:
        states, actions, outcomes = self.next_state.shape
        return f"Model({states} states, {actions} actions, {outcomes} outcomes of each at most)"

    @property
    def num_states(self) -> int:
        return self.next_state.shape[0]

    @property
    def num_actions(self) -> int:
        return self.next_state.shape[1]

    @staticmethod
    def merged(next_state: np.ndarray, reward: np.ndarray, terminated: np.ndarray, probability: np.ndarray) -> "Model":
        """A model from N weighted outcomes per state and action; equal outcomes become one.

        Args:
            next_state, reward, terminated: ``[S, A, N]``.
            probability: ``[N]``, or ``[S, A, N]``.

        Raises:
            ValueError: a shape does not fit.
        """
        shape = next_state.shape
        if {reward.shape, terminated.shape} != {shape} or probability.shape not in (shape, shape[-1:]):
            shapes = [array.shape for array in (next_state, reward, terminated, probability)]
            raise ValueError(
                "next_state, reward and terminated must have one shape [S, A, N], and probability that one or [N], "
                f"got {shapes}"
            )
        flat_next, flat_reward = next_state.reshape(-1, shape[-1]), reward.reshape(-1, shape[-1])
        flat_end = terminated.reshape(-1, shape[-1])
        weight = np.broadcast_to(probability, shape).reshape(-1, shape[-1]).astype(np.float64)
        pair = np.broadcast_to(np.arange(len(flat_next))[:, None], flat_next.shape)
        order = np.lexsort((flat_reward.ravel(), flat_end.ravel(), flat_next.ravel(), pair.ravel()))
        columns = [a.ravel()[order] for a in (pair, flat_next, flat_end, flat_reward)]
        is_new = np.concatenate([[True], np.any([c[1:] != c[:-1] for c in columns], axis=0)])
        group = np.cumsum(is_new) - 1
        weight = np.bincount(group, weights=weight.ravel()[order])
        pair, flat_next, flat_end, flat_reward = (c[is_new] for c in columns)
        first_of_pair = np.searchsorted(pair, np.arange(shape[0] * shape[1]))
        rank = np.arange(len(pair)) - first_of_pair[pair]
        padded = (shape[0] * shape[1], int(rank.max()) + 1)

        def spread(values: np.ndarray, dtype: type) -> np.ndarray:
            table = np.zeros(padded, dtype)
            table[pair, rank] = values
            return table.reshape(*shape[:2], padded[1])

        return Model(
            spread(flat_next, np.int32),
            spread(weight, np.float64),
            spread(flat_reward, np.float64),
            spread(flat_end, np.bool_),
        )

    @staticmethod
    def from_dense(transition: np.ndarray, reward: np.ndarray) -> "Model":
        """A model from dense arrays, for example a textbook's.

        Args:
            transition: ``[S, A, S]`` probabilities; what a row lacks to one ends the episode.
            reward: ``[S, A]`` expected rewards, or ``[S, A, S]``.

        Raises:
            ValueError: a shape does not fit, or a row is negative or sums to more than one.
        """
        transition = checks.as_array("transition", transition, np.floating, (None, None, None), "probabilities")
        transition, reward = transition.astype(np.float64), np.asarray(reward, np.float64)
        if transition.shape[0] != transition.shape[2] or not transition.size:
            raise ValueError(f"transition must have shape [S, A, S], got {transition.shape}")
        if reward.shape not in (transition.shape, transition.shape[:2]):
            allowed = f"[S, A] or [S, A, S], here {transition.shape[:2]} or {transition.shape}"
            raise ValueError(f"reward must have shape {allowed}, got {reward.shape}")
        if not np.isfinite(reward).all():
            raise ValueError("reward must be finite")
        ends = 1.0 - transition.sum(-1, keepdims=True)
        if not (transition.min() >= 0 and ends.min() >= -1e-9):
            raise ValueError("transition must have non-negative rows that sum to at most one")
        size = transition.shape[0]
        expected = reward if reward.ndim == 2 else (transition * reward).sum(-1)
        states = np.broadcast_to(np.arange(size + 1, dtype=np.int32) % size, (*transition.shape[:2], size + 1))
        probability = np.concatenate([transition, np.clip(ends, 0.0, None)], axis=-1)
        terminated = np.broadcast_to(np.arange(size + 1) == size, probability.shape)
        return Model(states, probability, np.broadcast_to(expected[..., None], probability.shape), terminated)

    def successors(self) -> np.ndarray:
        """``[S, A, K]`` int32: next states that can follow and be acted in; -1 elsewhere."""
        return np.where((self.probability > 0) & ~self.terminated, self.next_state, -1)


def check_model(model: Model) -> None:
    """Raises unless a model describes a decision process, as far as its arrays are not traced.

    Raises:
        TypeError: it is no model, or an array holds numbers of the wrong kind.
        ValueError: the shapes do not fit, a next state does not exist, probabilities are negative or do not sum
            to one, or a reward is not finite.
    """
    checks.instance("model", model, Model, "a hrljax.solvers.Model such as env.model()")
    shapes = [np.shape(array) for array in model]
    if len(shapes[0]) != 3 or 0 in shapes[0] or len(set(shapes)) > 1:
        raise ValueError(f"the arrays of a model must have one shape [S, A, K], got {shapes}")
    if any(isinstance(array, Tracer) for array in model):
        return
    arrays = Model(*map(np.asarray, model))
    for name, kind in (("next_state", np.integer), ("terminated", np.bool_)):
        if not np.issubdtype(getattr(arrays, name).dtype, kind):
            raise TypeError(f"{name} must be {kind.__name__.rstrip('_')}s, got {getattr(arrays, name).dtype}")
    if not (arrays.next_state.min() >= 0 and arrays.next_state.max() < arrays.num_states):
        raise ValueError(f"next states must be from 0 to {arrays.num_states - 1}")
    if not np.isfinite(arrays.reward).all():
        raise ValueError("rewards must be finite")
    rounding = 1e-6 if arrays.probability.dtype == np.float64 else 1e-4
    total = arrays.probability.sum(-1)
    if not (arrays.probability.min() >= 0 and np.allclose(total, 1, rtol=0, atol=rounding)):
        raise ValueError("probability must have rows that are not negative and sum to one")
