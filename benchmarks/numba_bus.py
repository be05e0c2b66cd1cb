"""The Bus learners as hand-written numba loops: the practical limit of one core.

One seed after the other, one row of a table a state, inline xorshift random numbers. The
algorithms, the initial values and the planning work are those of hrljax's learners; the random
numbers are not, so that curves agree in distribution only.
"""

import numba
import numpy as np

EPS = np.float32(0.1)
ALPHA = np.float32(0.1)
MAX_STEPS = 1000


@numba.njit(inline="always")
def _next(x):
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    return x ^ (x << np.uint64(17))


@numba.njit(inline="always")
def _below(bits, p):
    return (bits & np.uint64(0xFFFFFF)) < np.uint64(p * 16777216.0)


@numba.njit(inline="always")
def _initial(moves_start, x):
    return (moves_start << 6) | np.int32((x >> np.uint64(32)) % np.uint64(3))


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


@numba.njit
def q_learning(seed, episodes, bins, initial, moves, start):
    q = np.full((2304, 4), initial, np.float32)
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
            if _below(x, EPS):
                a = np.int32((x >> np.uint64(24)) & np.uint64(3))
            else:
                best = q[s, 0]
                for b in range(1, 4):
                    if q[s, b] > best:
                        best, a = q[s, b], b
            s2, r, end, hit, broke = _step(moves, start, s, a, x, y)
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
def hordq(seed, episodes, bins, initial, kappa, plan, interval, sweeps, unknown,
          moves, start, active, goal, children, counts,
          point, planning, tasks, can_invoke, outcomes, num_y):
    """HORDQ under a random root (`plan` False) or the planning root."""
    size = 2304
    width = children.shape[1]
    q = np.zeros((6 * size, 4, 4), np.float32)
    q[:, :, 2] = initial
    out = np.zeros((bins, 4), np.float64)
    kappa = np.float32(kappa)
    num_x, slots, num_m = outcomes.shape
    rows = np.zeros((num_x, slots, num_y, num_m + 2), np.float32)
    values = np.full((num_x, num_y), unknown, np.float32)
    fresh = np.zeros((num_x, num_y), np.float32)
    worth = np.zeros(slots, np.float32)
    x = np.uint64(seed * 2654435761 + 88172645463325252)
    steps = 0
    task = slot = px = py = 0
    for episode in range(episodes):
        if plan and episode % interval == 0:
            for _ in range(sweeps):
                for i in range(num_x):
                    for j in range(num_y):
                        best = np.float32(-np.inf)
                        for k in range(slots):
                            if can_invoke[i, k, j]:
                                v = np.float32(unknown)
                                if rows[i, k, j, num_m] > 0:
                                    v = rows[i, k, j, num_m + 1]
                                    for m in range(num_m):
                                        o = outcomes[i, k, m]
                                        if o < 0:
                                            break
                                        v += rows[i, k, j, m] * values[o, j]
                                best = max(best, v)
                        fresh[i, j] = best
                values, fresh = fresh, values
        x = _next(x)
        s = _initial(start, x)
        decide = True
        out_row = out[episode * bins // episodes]
        for _ in range(MAX_STEPS):
            x = _next(x)
            y = _next(x)
            if decide:
                if plan:
                    p = point[s]
                    px, py = p // num_y, p % num_y
                    best, slot, allowed = np.float32(-np.inf), 0, 0
                    for k in range(slots):
                        if not can_invoke[px, k, py]:
                            continue
                        allowed += 1
                        row = tasks[px * slots + k] * size + s
                        b = _greedy(q, row)
                        until_end = q[row, b, 0] + q[row, b, 1]
                        rows[px, k, py, num_m + 1] = until_end
                        v = np.float32(unknown)
                        if rows[px, k, py, num_m] > 0:
                            v = until_end
                            for m in range(num_m):
                                o = outcomes[px, k, m]
                                if o < 0:
                                    break
                                v += rows[px, k, py, m] * values[o, py]
                        if v > best:
                            best, slot = v, k
                    values[px, py] = best
                    if _below(x >> np.uint64(20), EPS):
                        skip = np.int32((y >> np.uint64(30)) & np.uint64(0xFFFF)) % allowed
                        for k in range(slots):
                            if can_invoke[px, k, py]:
                                if skip == 0:
                                    slot = k
                                skip -= 1
                    task = tasks[px * slots + slot]
                else:
                    task = children[s, np.int32((y >> np.uint64(30)) & np.uint64(0xFFFF)) % counts[s]] - 1
            row = task * size + s
            if _below(x, EPS):
                a = np.int32((x >> np.uint64(24)) & np.uint64(3))
            else:
                a = _greedy(q, row)
            s2, r, end, hit, broke = _step(moves, start, s, a, x, y)
            x = y
            exited = (active[s2] >> task) & 1 == 0
            row2 = task * size + s2
            decide = exited
            ends = 0
            if exited or end:
                if plan:
                    model = rows[px, slot, py]
                    n = model[num_m] + 1
                    step_size = max(ALPHA, 1 / n)
                    x2 = planning[s2]
                    for m in range(num_m):
                        hit_m = np.float32(0)
                        if outcomes[px, slot, m] == x2 and not end:
                            hit_m = np.float32(1)
                        model[m] += step_size * (hit_m - model[m])
                    model[num_m] = n
            if exited and not end:
                # The next subtask is chosen before the bootstrap; it is what runs next.
                if plan:
                    p = point[s2]
                    px, py = p // num_y, p % num_y
                    best, slot, allowed = np.float32(-np.inf), 0, 0
                    for k in range(slots):
                        if not can_invoke[px, k, py]:
                            continue
                        allowed += 1
                        row3 = tasks[px * slots + k] * size + s2
                        b = _greedy(q, row3)
                        until_end = q[row3, b, 0] + q[row3, b, 1]
                        rows[px, k, py, num_m + 1] = until_end
                        v = np.float32(unknown)
                        if rows[px, k, py, num_m] > 0:
                            v = until_end
                            for m in range(num_m):
                                o = outcomes[px, k, m]
                                if o < 0:
                                    break
                                v += rows[px, k, py, m] * values[o, py]
                        if v > best:
                            best, slot = v, k
                    values[px, py] = best
                    if _below(x >> np.uint64(20), EPS):
                        skip = np.int32((x >> np.uint64(44)) & np.uint64(0xFFFF)) % allowed
                        for k in range(slots):
                            if can_invoke[px, k, py]:
                                if skip == 0:
                                    slot = k
                                skip -= 1
                    next_task = tasks[px * slots + slot]
                else:
                    next_task = children[s2, np.int32((x >> np.uint64(44)) & np.uint64(0xFFFF)) % counts[s2]] - 1
                row2 = next_task * size + s2
            else:
                next_task = task
            b = _greedy(q, row2)
            q_r, q_c, q_e, q_p = q[row2, b, 0], q[row2, b, 1], q[row2, b, 2], q[row2, b, 3]
            t_c, t_e, t_p = q_r + q_c, q_e, q_p
            if exited:
                t_e += t_c
                t_c = np.float32(0)
                t_p = kappa * goal[task, s2]
            if end:
                t_c = np.float32(0)
                t_e = np.float32(0)
                if not exited:
                    t_p = np.float32(0)
            q[row, a, 0] += ALPHA * (r - q[row, a, 0])
            q[row, a, 1] += ALPHA * (t_c - q[row, a, 1])
            q[row, a, 2] += ALPHA * (t_e - q[row, a, 2])
            q[row, a, 3] += ALPHA * (t_p - q[row, a, 3])
            out_row[0] += r
            out_row[1] += 1
            out_row[2] += hit
            out_row[3] += broke
            task = next_task
            decide = False
            s = s2
            steps += 1
            if end:
                break
    return out, steps
