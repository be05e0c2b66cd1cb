"""A finished search tree on the host: Python objects to walk through, index arrays to draw."""

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from hrljax.search.best_first import Tree


@dataclass(eq=False)
class Node:
    """A node of a search tree and its place in it."""

    index: int
    state: Any = field(repr=False)  # pytree of NumPy arrays
    value: float
    reward: float
    depth: int
    action: int  # -1 for the root
    expansion: int  # -1 if it was never expanded
    parent: "Node | None" = field(repr=False)
    children: list["Node"] = field(default_factory=list, repr=False)

    def path(self) -> list["Node"]:
        """The nodes from the root to this one."""
        return [*(self.parent.path() if self.parent else []), self]


def to_nodes(tree: Tree) -> list[Node]:
    """The nodes of one search in the order in which they were generated, the root first.

    Raises:
        ValueError: `tree` holds a batch of searches.
    """
    tree, count = _fetch(tree)
    nodes: list[Node] = []
    for i in range(count):
        parent = nodes[tree.parent[i]] if i else None
        node = Node(
            index=i,
            state=jax.tree.map(lambda rows, i=i: rows[i], tree.state),
            value=float(tree.value[i]),
            reward=float(tree.reward[i]),
            depth=int(tree.depth[i]),
            action=int(tree.action[i]),
            expansion=int(tree.expansion[i]),
            parent=parent,
        )
        if parent is not None:
            parent.children.append(node)
        nodes.append(node)
    return nodes


def edges(tree: Tree) -> np.ndarray:
    """Parent and child of every edge, ``[num_nodes - 1, 2]``.

    ``positions[edges(tree)]``, with the ``[N, 2]`` positions of the nodes, are the segments of a
    matplotlib ``LineCollection``.

    Raises:
        ValueError: `tree` holds a batch of searches.
    """
    tree, count = _fetch(tree)
    children = np.arange(1, count, dtype=np.int32)
    return np.stack([tree.parent[1:count], children], axis=1)


def _fetch(tree: Tree) -> tuple[Tree, int]:
    if np.ndim(tree.num_nodes) != 0:
        raise ValueError(
            f"tree must be of one search, got a batch of shape {np.shape(tree.num_nodes)}; "
            "take one with jax.tree.map(lambda x: x[i], tree)"
        )
    return jax.tree.map(np.asarray, tree), int(tree.num_nodes)
