"""A model of a jump-and-run game for `mario_planner.py`: regression trees, fitted by scikit-learn on simulated steps.

The game is a stand-in with the shape of thesis 4.2.3: nine actions, a screen of 16 x 21 symbols,
inputs of a 5 x 5 patch and two speeds, four trees an action and one for the reward.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from sklearn.tree import DecisionTreeRegressor

from hrljax.core.numerics import take

ACTIONS, HEIGHT, WIDTH, PATCH, MAX_DEPTH = 9, 16, 21, 5, 12
MARGIN = PATCH // 2
_EMPTY, _SOLID, _COIN, _MONSTER = range(4)


class Node(NamedTuple):
    """What the model predicts: position and speed, in tiles and tiles a step."""

    x: Any
    y: Any
    dx: Any
    dy: Any


class Trees(NamedTuple):
    """Binary trees as arrays of C nodes: tree 4 * action + target, and the reward's as the last.

    An input that is greater than a node's number goes to the left child + 1, another one to the left
    child. A leaf has the word 0 and its prediction as its number.
    """

    words: Any  # [37, C] int32: left child << 8 | input
    numbers: Any  # [37, C] float32


def screens(count: int, seed: int) -> np.ndarray:
    """Random screens ``[count, 20, 25]`` float32, with a margin of empty symbols."""
    generator = np.random.default_rng(seed)
    cells = generator.choice(4, (count, HEIGHT, WIDTH), p=[0.84, 0.1, 0.04, 0.02])
    cells[:, -2:] = np.where(generator.random((count, 2, WIDTH)) < 0.9, _SOLID, _EMPTY)
    return np.pad(cells, ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN))).astype(np.float32)


def starts(count: int, seed: int) -> Node:
    """Random positions and speeds, each ``[count]`` float32."""
    generator = np.random.default_rng(seed)
    limits = ((2, 12), (2, 13), (-1, 2), (-1, 1))
    return Node(*(generator.uniform(low, high, count).astype(np.float32) for low, high in limits))


def cut(screen: np.ndarray, x: float, y: float) -> np.ndarray:
    """The 25 symbols around a position."""
    column, row = min(max(round(float(x)), 0), WIDTH - 1), min(max(round(float(y)), 0), HEIGHT - 1)
    return screen[row : row + PATCH, column : column + PATCH].ravel()


def _step(screen: np.ndarray, node: Node, action: int) -> tuple[np.ndarray, float]:
    """The real game: changes of position, new speeds, and the reward."""
    patch = cut(screen, node.x, node.y).reshape(PATCH, PATCH)
    direction, power = action % 3 - 1, action // 3
    dx = 0.85 * node.dx + direction * (0.2 + 0.15 * power)
    dy = -1.2 if power and patch[MARGIN + 1, MARGIN] == _SOLID else 0.8 * node.dy + 0.2
    if patch[MARGIN, MARGIN + int(np.sign(dx))] == _SOLID:
        dx = 0.0
    if patch[MARGIN + int(np.sign(dy)), MARGIN] == _SOLID:
        dy = 0.0
    touched = patch[MARGIN + int(np.sign(dy)), MARGIN + int(np.sign(dx))]
    return np.array([dx, dy, dx, dy]), dx - 0.01 + (touched == _COIN) - 50.0 * (touched == _MONSTER)


def fit(rows: int = 20_000) -> list[DecisionTreeRegressor]:
    """The 37 trees, fitted on `rows` random steps."""
    seen, nodes = screens(rows, 0), starts(rows, 1)
    actions = np.random.default_rng(2).integers(0, ACTIONS, rows)
    inputs, targets, rewards = [], [], []
    for i in range(rows):
        node = Node(*(float(values[i]) for values in nodes))
        target, reward = _step(seen[i], node, int(actions[i]))
        inputs.append([*cut(seen[i], node.x, node.y), node.dx, node.dy, actions[i]])
        targets.append(target)
        rewards.append(reward)
    data, outputs = np.array(inputs, np.float32), np.array(targets)

    def tree(x: np.ndarray, y: np.ndarray) -> DecisionTreeRegressor:
        return DecisionTreeRegressor(max_depth=MAX_DEPTH, min_samples_leaf=5, random_state=0).fit(x, y)

    fitted = [tree(data[actions == a, :-1], outputs[actions == a, k]) for a in range(ACTIONS) for k in range(4)]
    return [*fitted, tree(data, np.array(rewards))]


def packed(fitted: list[DecisionTreeRegressor]) -> Trees:
    """The same trees in arrays, children side by side; float32 thresholds decide as scikit-learn's do."""
    capacity = max(tree.tree_.node_count for tree in fitted)
    shape = len(fitted), capacity
    trees = Trees(np.zeros(shape, np.int32), np.zeros(shape, np.float32))
    for number, tree in enumerate(fitted):
        theirs, order = tree.tree_, [0]
        for place in range(theirs.node_count):
            node = order[place]
            if theirs.children_left[node] < 0:
                trees.numbers[number, place] = theirs.value[node, 0, 0]
                continue
            threshold = np.float32(theirs.threshold[node])
            if threshold > theirs.threshold[node]:
                threshold = np.nextafter(threshold, np.float32(-np.inf))
            trees.numbers[number, place] = threshold
            trees.words[number, place] = len(order) << 8 | theirs.feature[node]
            order += [theirs.children_left[node], theirs.children_right[node]]
    return trees


def model(trees: Trees, screen: Array) -> Callable[[Node, Array], tuple[Node, Array]]:
    """The trees as a model for `hrljax.search.best_first`: five descents side by side."""
    num_trees, capacity = trees.words.shape
    words, numbers = (values.reshape(-1) for values in trees)

    def descend(chosen: list[Array], inputs: Array) -> list[Array]:
        """Side by side, so that one descent goes on while another waits for memory; down to the leaf of the last."""
        roots = [tree * np.int32(capacity) for tree in chosen]

        def level(carry: tuple[list[Array], list[Array]]) -> tuple[list[Array], list[Array]]:
            places, at = carry
            after = []
            for root, place, word in zip(roots, places, at, strict=True):
                is_right = take(inputs, word & np.int32(0xFF)) > take(numbers, place)
                child = root + (word >> np.int32(8)) + is_right.astype(jnp.int32)
                after.append(lax.select(word == 0, place, child))
            return after, [take(words, place) for place in after]

        def is_inside(carry: tuple[list[Array], list[Array]]) -> Array:
            return functools.reduce(jnp.bitwise_or, carry[1]) != 0

        places, _ = lax.while_loop(is_inside, level, (roots, [take(words, root) for root in roots]))
        return [take(numbers, place) for place in places]

    def step(node: Node, action: Array) -> tuple[Node, Array]:
        row = jnp.clip(jnp.round(node.y).astype(jnp.int32), 0, HEIGHT - 1)
        column = jnp.clip(jnp.round(node.x).astype(jnp.int32), 0, WIDTH - 1)
        patch = lax.dynamic_slice(screen, (row.astype(jnp.uint32), column.astype(jnp.uint32)), (PATCH, PATCH))
        speeds = jnp.stack([node.dx, node.dy, action.astype(jnp.float32)])
        inputs = jnp.concatenate([patch.reshape(-1), speeds])
        motion = [action * np.int32(4) + np.int32(i) for i in range(4)]
        move_x, move_y, dx, dy, reward = descend([*motion, jnp.int32(num_trees - 1)], inputs)
        return Node(node.x + move_x, node.y + move_y, dx, dy), reward

    return step
