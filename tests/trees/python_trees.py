"""Classification trees in plain Python."""

from typing import Any

import numpy as np

from hrljax.trees.classification import ClassificationTrees
from hrljax.trees.scores import LOG_BITS

F = np.float32
Node = tuple[Any, list[int], list[int]]
"""Its test (input, value, whether ``<=``) or None, the numbers of its children, its counts."""


def log_of(n: int) -> F:
    """``n log2 n`` in the steps of the table."""
    if n == 0:
        return F(0)
    mantissa, exponent = np.frexp(F(n))
    place = (F(mantissa) * F(2) - F(1)) * F(1 << LOG_BITS)
    entry = int(place)
    low, high = (F(np.log2(1 + (entry + i) / (1 << LOG_BITS))) for i in (0, 1))
    return F(n) * (F(exponent - 1) + (low + (place - F(entry)) * (high - low)))


def total(values: list[F]) -> F:
    result = values[0]
    for value in values[1:]:
        result = result + value
    return result


def entropy(parts: list[int]) -> F:
    return log_of(sum(parts)) - total([log_of(part) for part in parts])


def gain_ratio(passing: list[int], everything: list[int]) -> F:
    failing = [a - b for a, b in zip(everything, passing, strict=True)]
    return (entropy(everything) - entropy(passing) - entropy(failing)) / entropy([sum(passing), sum(failing)])


def chi_squared(passing: list[int], everything: list[int]) -> F:
    terms = []
    for p, n in zip(passing, everything, strict=True):
        one_nth = F(1) / F(sum(everything))
        first = F(sum(passing)) * one_nth * F(n)
        second = (F(sum(everything)) - F(sum(passing))) * one_nth * F(n)
        off = F(p) - first
        terms.append(off * off / first + off * off / second if n else F(0))
    return total(terms)


SCORES = {"gain_ratio": gain_ratio, "chi_squared": chi_squared}


def passes(values: np.ndarray, test: tuple[int, int, bool]) -> np.ndarray:
    """Which rows of inputs (``[R, F]``) pass a test."""
    which, value, is_range = test
    return values[:, which] <= value if is_range else values[:, which] == value


def grown(
    spec: ClassificationTrees, values: np.ndarray, counts: np.ndarray, least: float, kept: Any = None
) -> list[Node]:
    """The nodes of one tree; `kept` says of each node which inputs it looks at."""
    nodes, rows = [], [np.arange(len(values))]
    tests = [
        (f, value, is_range)
        for f, size in enumerate(spec.sizes)
        for value in range(size)
        for is_range in (False, True)[: 1 + spec.ordered[f]]
    ]
    while len(nodes) < len(rows):
        of_node = rows[len(nodes)]
        everything = counts[of_node].sum(0).tolist()
        best, chosen, passed = F(-1), None, np.zeros(0, bool)
        for test in tests if np.count_nonzero(everything) > 1 else []:
            if kept is not None and not kept[len(nodes)][test[0]]:
                continue
            passing = passes(values[of_node], test)
            sums = counts[of_node[passing]].sum(0).tolist()
            if 0 < sum(sums) < sum(everything) and (score := SCORES[spec.score](sums, everything)) > best:
                best, chosen, passed = score, test, passing
        if chosen and best >= F(least) and best > 0 and len(rows) + 2 <= spec.max_nodes:
            nodes.append((chosen, [len(rows), len(rows) + 1], everything))
            rows += [of_node[passed], of_node[~passed]]
        else:
            nodes.append((None, [], everything))
    return nodes


def leaves(nodes: list[Node], values: np.ndarray) -> np.ndarray:
    """The numbers of the leaves of rows of inputs."""
    reached = np.zeros(len(values), int)
    for number, (test, children, _) in enumerate(nodes):  # children come after their parents
        if test:
            here = reached == number
            reached[here] = np.where(passes(values[here], test), *children)
    return reached
