"""The Bus learners as hand-written numba loops: the practical limit of one core.

One seed after the other, one row of a table a state, inline xorshift random numbers. Algorithms,
initial values and planning work are those of hrljax's learners; random numbers are not, so that
curves agree in distribution only.
"""

import numba
import numpy as np

EPSILON = 0.1
ALPHA = np.float32(0.1)
MAX_STEPS = 1000
STATES = 2304
TASKS = 6


@numba.njit(inline="always")
def _next(x):
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    return x ^ (x << np.uint64(17))


@numba.njit(inline="always")
def _below(bits, p):
    return (bits & np.uint64(0xFFFFFF)) < np.uint64(p * 16777216.0)


@numba.njit(inline="always")
def _initial(start, x):
    return (start << 6) | np.int32((x >> np.uint64(32)) % np.uint64(3))


@numba.njit(inline="always")
def _step(moves, start, state, action, x, y):
    """One step of the Bus from two random words: next state, reward, terminated, damaged now, broke."""
    cell, damaged, picked, road = state >> 6, (state >> 5) & 1, (state >> 2) & 7, state & 3
    if damaged == 1 and _below(y >> np.uint64(40), 0.25):
        return state, np.float32(-51), True, 0, 1
    direction = action
    if _below(x >> np.uint64(30), 0.1):
        direction = np.int32(x >> np.uint64(62))
    move = moves[cell * 4 + direction]
    cell, site = move & 0xFFF, (move >> 12) & 0xF
    picked |= move >> 16
    hit = np.int32(site != 0 and site == road and damaged == 0)
    if _below(y, 0.05):
        road += 1 + np.int32((y >> np.uint64(24)) & np.uint64(1))
        if road > 2:
            road -= 3
    after = (cell << 6) | ((damaged | hit) << 5) | (picked << 2) | road
    return after, np.float32(-1), picked == 7 and cell == start, hit, 0


@numba.njit(inline="always")
def _look_up(tables, start, state, action, x, y):
    """As `_step`, from the table of outcomes that hrljax makes (`hrljax.envs.outcomes`)."""
    entries, rewards = tables
    slip, mishap, road = x >> np.uint64(40), y & np.uint64(0xFFFFFF), y >> np.uint64(40)
    kind = np.int32(slip >= _word(0.025)) + np.int32(slip >= _word(0.05)) + np.int32(slip >= _word(0.075))
    kind = kind * 2 + np.int32(mishap >= _word(0.25))
    kind = kind * 3 + np.int32(road >= _word(0.025)) + np.int32(road >= _word(0.05))
    entry = np.int32(entries[kind * STATES * 4 + state * 4 + action])
    flags, rest = entry & 7, entry >> 3
    return rest >> 1, rewards[rest & 1], flags & 1 == 1, (flags >> 1) & 1, flags >> 2


@numba.njit(inline="always")
def _word(probability):
    return np.uint64(probability * 16777216.0)


def q_learning_by(step):
    """Q-learning with one of the two ways to make a step."""

    def q_learning(seed, episodes, bins, initial, tables, start):
        """Q-learning: sums of return, steps, damage and breakdowns by bin; steps."""
        q = np.full((STATES, 4), initial, np.float32)
        out = np.zeros((bins, 4), np.float64)
        x = np.uint64(seed * 2654435761 + 88172645463325252)
        steps = 0
        for episode in range(episodes):
            x = _next(x)
            s = _initial(start, x)
            row = out[episode * bins // episodes]
            for _ in range(MAX_STEPS):
                x = _next(x)
                y = _next(x)
                a = 0
                if _below(x, EPSILON):
                    a = np.int32((x >> np.uint64(24)) & np.uint64(3))
                else:
                    best = q[s, 0]
                    for b in range(1, 4):
                        if q[s, b] > best:
                            best, a = q[s, b], b
                s2, r, end, hit, broke = step(tables, start, s, a, x, y)
                x = y
                target = r
                if not end:
                    target += max(max(q[s2, 0], q[s2, 1]), max(q[s2, 2], q[s2, 3]))
                q[s, a] += ALPHA * (target - q[s, a])
                row[0] += r
                row[1] += 1
                row[2] += hit
                row[3] += broke
                s = s2
                steps += 1
                if end:
                    break
        return out, steps

    return numba.njit(q_learning)


q_learning = q_learning_by(_step)
q_learning_looked_up = q_learning_by(_look_up)


@numba.njit(inline="always")
def _greedy(q, row):
    a = 0
    best = q[row, 0, 0] + q[row, 0, 1] + q[row, 0, 2] + q[row, 0, 3]
    for b in range(1, 4):
        v = q[row, b, 0] + q[row, b, 1] + q[row, b, 2] + q[row, b, 3]
        if v > best:
            best, a = v, b
    return a


@numba.njit
def _sweep(model, until_end, values, fresh, outcomes, can_invoke, unknown):
    num_x, slots, num_m = outcomes.shape
    for i in range(num_x):
        for j in range(values.shape[1]):
            best = np.float32(-np.inf)
            for k in range(slots):
                if can_invoke[i, k, j]:
                    value = unknown
                    if model[i, k, num_m, j] > 0:
                        value = until_end[i, k, j]
                        for m in range(num_m):
                            if outcomes[i, k, m] < 0:
                                break
                            value += model[i, k, m, j] * values[outcomes[i, k, m], j]
                    best = max(best, value)
            fresh[i, j] = best


@numba.njit(inline="always")
def _invoked(model, until_end, values, outcomes, can_invoke, unknown, i, j, x):
    """The slot of the subtask that the planning root invokes in a decision point."""
    _, slots, num_m = outcomes.shape
    best, slot, allowed = np.float32(-np.inf), 0, 0
    for k in range(slots):
        if not can_invoke[i, k, j]:
            continue
        allowed += 1
        value = unknown
        if model[i, k, num_m, j] > 0:
            value = until_end[i, k, j]
            for m in range(num_m):
                if outcomes[i, k, m] < 0:
                    break
                value += model[i, k, m, j] * values[outcomes[i, k, m], j]
        if value > best:
            best, slot = value, k
    values[i, j] = best
    if _below(x >> np.uint64(20), EPSILON):
        skip = np.int32((x >> np.uint64(44)) & np.uint64(0xFFFF)) % allowed
        for k in range(slots):
            if can_invoke[i, k, j]:
                if skip == 0:
                    slot = k
                skip -= 1
    return slot


@numba.njit(inline="always")
def _observed(model, outcomes, i, slot, j, ended_in):
    """Updates the planning root's model after a subtask has ended in a planning part, -1 with the episode."""
    num_m = outcomes.shape[2]
    count = model[i, slot, num_m, j] + np.float32(1)
    step_size = max(ALPHA, np.float32(1) / count)
    for m in range(num_m):
        reached = np.float32(outcomes[i, slot, m] == ended_in and ended_in >= 0)
        model[i, slot, m, j] += step_size * (reached - model[i, slot, m, j])
    model[i, slot, num_m, j] = count


@numba.njit
def hordq(
    seed, episodes, bins, initial, kappa, plan, interval, sweeps, unknown,
    moves, start, active, goal, children, counts, point, planning, tasks, can_invoke, outcomes,
):  # fmt: skip
    """HORDQ under a random root, or if `plan` under the planning root; results as `q_learning`."""
    q = np.zeros((TASKS * STATES, 4, 4), np.float32)
    q[:, :, 2] = initial
    out = np.zeros((bins, 4), np.float64)
    num_x, slots, num_m = outcomes.shape
    num_y = can_invoke.shape[2]
    model = np.zeros((num_x, slots, num_m + 1, num_y), np.float32)
    until_end = np.zeros((num_x, slots, num_y), np.float32)
    values = np.full((num_x, num_y), unknown, np.float32)
    fresh = np.zeros((num_x, num_y), np.float32)
    x = np.uint64(seed * 2654435761 + 88172645463325252)
    steps = 0
    task = next_task = i = j = slot = a = row = 0
    r = np.float32(0)
    for episode in range(episodes):
        if plan and episode % interval == 0:
            for _ in range(sweeps):
                _sweep(model, until_end, values, fresh, outcomes, can_invoke, unknown)
                values, fresh = fresh, values
        x = _next(x)
        s = _initial(start, x)
        x = _next(x)
        out_row = out[episode * bins // episodes]
        first, exited, end = True, False, False
        for step in range(MAX_STEPS + 1):
            # Here the bus has arrived at s. The next subtask is chosen before the bootstrap on it.
            if first or (exited and not end):
                if plan:
                    i, j = point[s] // num_y, point[s] % num_y
                    for k in range(slots):
                        if can_invoke[i, k, j]:
                            place = tasks[i * slots + k] * STATES + s
                            b = _greedy(q, place)
                            until_end[i, k, j] = q[place, b, 0] + q[place, b, 1]
                    slot = _invoked(model, until_end, values, outcomes, can_invoke, unknown, i, j, x)
                    next_task = tasks[i * slots + slot]
                else:
                    next_task = children[s, np.int32((x >> np.uint64(44)) & np.uint64(0xFFFF)) % counts[s]] - 1
            if not first:
                row2 = next_task * STATES + s
                b = _greedy(q, row2)
                q_r, q_c, q_e, q_p = q[row2, b, 0], q[row2, b, 1], q[row2, b, 2], q[row2, b, 3]
                t_c, t_e, t_p = q_r + q_c, q_e, q_p
                if exited:
                    t_e += t_c
                    t_c = np.float32(0)
                    t_p = np.float32(kappa) * goal[task, s]
                if end:
                    t_c = t_e = np.float32(0)
                    if not exited:
                        t_p = np.float32(0)
                q[row, a, 0] += ALPHA * (r - q[row, a, 0])
                q[row, a, 1] += ALPHA * (t_c - q[row, a, 1])
                q[row, a, 2] += ALPHA * (t_e - q[row, a, 2])
                q[row, a, 3] += ALPHA * (t_p - q[row, a, 3])
            if end or step == MAX_STEPS:
                break
            first = False
            task = next_task
            x = _next(x)
            y = _next(x)
            row = task * STATES + s
            a = np.int32((x >> np.uint64(24)) & np.uint64(3)) if _below(x, EPSILON) else _greedy(q, row)
            s, r, end, hit, broke = _step(moves, start, s, a, x, y)
            x = y
            exited = (active[s] >> task) & 1 == 0
            if plan and (exited or end):
                _observed(model, outcomes, i, slot, j, np.int32(-1) if end else planning[s])
            out_row[0] += r
            out_row[1] += 1
            out_row[2] += hit
            out_row[3] += broke
            steps += 1
    return out, steps


@numba.njit(inline="always")
def _biased(q, p, kappa, s, place):
    a = 0
    best = q[s, 0] + kappa * p[place, 0, 0]
    for b in range(1, 4):
        v = q[s, b] + kappa * p[place, b, 0]
        if v > best:
            best, a = v, b
    return a


@numba.njit
def shared_hordq(
    seed, episodes, bins, initial, worth, after, plan, interval, sweeps, unknown,
    moves, start, active, goal, children, counts, point, planning, tasks, can_invoke, outcomes,
):  # fmt: skip
    """HORDQ with shared values and a pseudo-reward that fades; roots and results as of `hordq`."""
    q = np.full((STATES, 4), initial, np.float32)
    p = np.zeros((TASKS * STATES, 4, 2), np.float32)  # values of a pseudo-reward of 1, returns until the end
    visits = np.zeros(STATES, np.float32)
    mean_reward, taken = np.float32(0), np.float32(0)
    out = np.zeros((bins, 4), np.float64)
    num_x, slots, num_m = outcomes.shape
    num_y = can_invoke.shape[2]
    model = np.zeros((num_x, slots, num_m + 1, num_y), np.float32)
    until_end = np.zeros((num_x, slots, num_y), np.float32)
    values = np.full((num_x, num_y), unknown, np.float32)
    fresh = np.zeros((num_x, num_y), np.float32)
    x = np.uint64(seed * 2654435761 + 88172645463325252)
    steps = 0
    task = next_task = i = j = slot = a = row = before = 0
    r = np.float32(0)
    for episode in range(episodes):
        if plan and episode % interval == 0:
            for _ in range(sweeps):
                _sweep(model, until_end, values, fresh, outcomes, can_invoke, unknown)
                values, fresh = fresh, values
        x = _next(x)
        s = _initial(start, x)
        x = _next(x)
        out_row = out[episode * bins // episodes]
        first, exited, end = True, False, False
        for step in range(MAX_STEPS + 1):
            # By what was seen before the step.
            kappa = worth * after * mean_reward / (after + visits[s])
            if not first:
                visits[before] += np.float32(1)
                taken += np.float32(1)
                mean_reward += (abs(r) - mean_reward) / taken
            if first or (exited and not end):
                if plan:
                    i, j = point[s] // num_y, point[s] % num_y
                    for k in range(slots):
                        if can_invoke[i, k, j]:
                            place = tasks[i * slots + k] * STATES + s
                            until_end[i, k, j] = p[place, _biased(q, p, kappa, s, place), 1]
                    slot = _invoked(model, until_end, values, outcomes, can_invoke, unknown, i, j, x)
                    next_task = tasks[i * slots + slot]
                else:
                    next_task = children[s, np.int32((x >> np.uint64(44)) & np.uint64(0xFFFF)) % counts[s]] - 1
            if not first:
                best = max(max(q[s, 0], q[s, 1]), max(q[s, 2], q[s, 3]))
                target, t_p, t_u = r, np.float32(0), r
                if not end:
                    target += best
                if exited:
                    t_p = goal[task, s]
                elif not end:
                    row2 = task * STATES + s
                    b = _biased(q, p, kappa, s, row2)
                    t_p = p[row2, b, 0]
                    t_u += p[row2, b, 1]
                q[before, a] += ALPHA * (target - q[before, a])
                p[row, a, 0] += ALPHA * (t_p - p[row, a, 0])
                if plan:
                    p[row, a, 1] += ALPHA * (t_u - p[row, a, 1])
            if end or step == MAX_STEPS:
                break
            first = False
            task = next_task
            x = _next(x)
            y = _next(x)
            row, before = task * STATES + s, s
            a = np.int32((x >> np.uint64(24)) & np.uint64(3)) if _below(x, EPSILON) else _biased(q, p, kappa, s, row)
            s, r, end, hit, broke = _step(moves, start, s, a, x, y)
            x = y
            exited = (active[s] >> task) & 1 == 0
            if plan and (exited or end):
                _observed(model, outcomes, i, slot, j, np.int32(-1) if end else planning[s])
            out_row[0] += r
            out_row[1] += 1
            out_row[2] += hit
            out_row[3] += broke
            steps += 1
    return out, steps
