"""The best-first search on regression trees as a hand-written numba loop with a binary heap."""

import numba
import numpy as np


@numba.njit(inline="always")
def _first(priority, a, b):
    return priority[a] > priority[b] or (priority[a] == priority[b] and a < b)


@numba.njit
def _push(heap, size, priority, node):
    i = size
    while i > 0:
        up = (i - 1) >> 1
        if not _first(priority, node, heap[up]):
            break
        heap[i] = heap[up]
        i = up
    heap[i] = node


@numba.njit
def _pop(heap, size, priority):
    """Takes the first of `size` nodes off the heap."""
    top, last = heap[0], heap[size - 1]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size - 1:
            break
        if child + 1 < size - 1 and _first(priority, heap[child + 1], heap[child]):
            child += 1
        if not _first(priority, heap[child], last):
            break
        heap[i] = heap[child]
        i = child
    heap[i] = last
    return top


@numba.njit(inline="always")
def _predict(words, numbers, tree, inputs):
    place = np.int32(0)
    word = words[tree, place]
    while word != 0:
        place = (word >> 8) + np.int32(inputs[word & 0xFF] > numbers[tree, place])
        word = words[tree, place]
    return numbers[tree, place]


@numba.njit
def search(words, numbers, screen, start, actions, depth_limit, expansions, stop_reward):
    """One search from position and speed `start`: nodes generated, first action, value of the best node."""
    nodes = 1 + actions * expansions
    state = np.empty((nodes, 4), np.float32)
    value = np.empty(nodes, np.float32)
    depth = np.empty(nodes, np.int32)
    first_action = np.empty(nodes, np.int32)
    heap = np.empty(nodes, np.int32)
    inputs = np.empty(28, np.float32)
    state[0] = start
    value[0], depth[0] = 0, 0
    heap[0] = 0
    size, count, best = 1, 1, 1
    best_value = np.float32(-np.inf)
    for _ in range(expansions):
        if size == 0 or best_value > stop_reward:
            break
        node = _pop(heap, size, value)
        size -= 1
        column = min(max(np.int32(np.rint(state[node, 0])), 0), screen.shape[1] - 5)
        row = min(max(np.int32(np.rint(state[node, 1])), 0), screen.shape[0] - 5)
        for i in range(5):
            for j in range(5):
                inputs[5 * i + j] = screen[row + i, column + j]
        inputs[25], inputs[26] = state[node, 2], state[node, 3]
        for a in range(actions):
            inputs[27] = a
            child = count
            count += 1
            state[child, 0] = state[node, 0] + _predict(words, numbers, 4 * a, inputs)
            state[child, 1] = state[node, 1] + _predict(words, numbers, 4 * a + 1, inputs)
            state[child, 2] = _predict(words, numbers, 4 * a + 2, inputs)
            state[child, 3] = _predict(words, numbers, 4 * a + 3, inputs)
            value[child] = value[node] + _predict(words, numbers, 4 * actions, inputs)
            depth[child] = depth[node] + 1
            first_action[child] = a if node == 0 else first_action[node]
            if value[child] > best_value:
                best, best_value = child, value[child]
            if depth[child] < depth_limit:
                _push(heap, size, value, child)
                size += 1
    return count - 1, first_action[best], best_value


@numba.njit
def search_all(words, numbers, screens, starts, actions, depth, expansions, stop_reward):
    """One search after the other: counts, first actions and values."""
    n = len(starts)
    counts, firsts, values = np.empty(n, np.int64), np.empty(n, np.int32), np.empty(n, np.float32)
    for i in range(n):
        counts[i], firsts[i], values[i] = search(
            words, numbers, screens[i], starts[i], actions, depth, expansions, stop_reward
        )
    return counts, firsts, values
