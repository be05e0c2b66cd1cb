"""Kinds of random words: an environment treats all words of one kind alike."""

import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core import random
from hrljax.core.environment import Cuts, Words


class WordKinds:
    """The kinds of an environment's random words; combinations of them are numbered, the last word's kind fastest."""

    def __init__(self, cuts: Cuts):
        """The kinds that the given cuts make, see `TabularEnvironment.word_cuts`."""
        # No word reaches a cut above 1.
        thresholds = ([min(int(random.threshold(cut)), random.WORD_RANGE) for cut in word_cuts] for word_cuts in cuts)
        # Where each word's kinds begin, and where the last one ends.
        self._edges = [np.unique([0, *word_thresholds, random.WORD_RANGE]) for word_thresholds in thresholds]

    @property
    def count(self) -> int:
        """N, the combinations."""
        return math.prod(len(edges) - 1 for edges in self._edges)

    def weights(self) -> np.ndarray:
        """``[N]`` float64: the probability of each combination."""
        weights = np.ones(1)
        for edges in self._edges:
            weights = np.outer(weights, np.diff(edges) / random.WORD_RANGE).ravel()
        return weights

    def first_words(self) -> tuple[np.ndarray, ...]:
        """For each word, the least of the kind that a combination has: ``[N]`` uint32."""
        return _combined([edges[:-1] for edges in self._edges])

    def last_words(self) -> tuple[np.ndarray, ...]:
        """The same for the greatest."""
        return _combined([edges[1:] - 1 for edges in self._edges])

    def number(self, words: Words) -> Array:
        """The number of the combination of kinds that the words have, int32 of their shape."""
        number = jnp.zeros_like(words[0], jnp.int32)
        for word, edges in zip(words, self._edges, strict=True):
            number = number * np.int32(len(edges) - 1)
            for first in edges[1:-1]:
                number += (word >= np.uint32(first)).astype(jnp.int32)
        return number


def _combined(words: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    return tuple(grid.ravel().astype(np.uint32) for grid in np.meshgrid(*words, indexing="ij"))
