"""Yardsticks for `cargo bench --bench simulation`: pedestrian-steps a second of two other programs on this machine.

    python3 -m venv v; v/bin/pip install pysocialforce numba
    NUDGE_PYTHON=$PWD/v/bin/python cargo bench --bench simulation

Prints one line a yardstick: name, pedestrians, pedestrian-steps a second (median of several runs, compiled before), with tabs between.
"""

import logging
import statistics
import time

import numba
import numpy as np
import pysocialforce

WIDTH, DT, STEPS, ROUNDS = 4.0, 0.05, 200, 7


def crowd(n, seed=1):
    """Returns places, velocities, desired directions and desired speeds of n pedestrians, 2 m of hallway each, in counter-flow."""
    random = np.random.default_rng(seed)
    places = np.column_stack([random.uniform(0, 2 * n, n), random.uniform(0.3, WIDTH - 0.3, n)])
    directions = np.column_stack([np.where(np.arange(n) % 2, -1.0, 1.0), np.zeros(n)])
    speeds = np.clip(random.normal(1.34, 0.26, n), 0.3, None)
    return places, speeds[:, None] * directions, directions, speeds


@numba.njit(fastmath=True)
def walk(places, velocities, directions, speeds, steps):
    """Walks by the model of Helbing & Molnar 1995: the drive, two walls, every pair, noise, the speed cap."""
    n = len(places)
    forces = np.empty_like(places)
    sight = np.cos(np.radians(100.0))
    for _ in range(steps):
        for i in range(n):
            fx = (speeds[i] * directions[i, 0] - velocities[i, 0]) / 0.5
            fy = (speeds[i] * directions[i, 1] - velocities[i, 1]) / 0.5
            y = places[i, 1]
            fy += 50.0 * np.exp(-abs(y) / 0.2) * np.sign(y) + 50.0 * np.exp(-abs(y - WIDTH) / 0.2) * np.sign(y - WIDTH)
            for j in range(n):
                if j == i:
                    continue
                s = 2.0 * np.sqrt(velocities[j, 0] ** 2 + velocities[j, 1] ** 2)
                rx, ry = places[i, 0] - places[j, 0], places[i, 1] - places[j, 1]
                ax, ay = rx - s * directions[j, 0], ry - s * directions[j, 1]
                p, q = np.sqrt(rx * rx + ry * ry), np.sqrt(ax * ax + ay * ay)
                b = 0.5 * np.sqrt(max((p + q) ** 2 - s * s, 1e-18))
                k = 7.0 * np.exp(-b / 0.3) * (p + q) / (4.0 * b)
                gx, gy = k * (rx / p + ax / q), k * (ry / p + ay / q)
                seen = -(directions[i, 0] * gx + directions[i, 1] * gy) >= np.sqrt(gx * gx + gy * gy) * sight
                w = 1.0 if seen else 0.5
                fx += w * gx
                fy += w * gy
            forces[i, 0], forces[i, 1] = fx, fy
        for i in range(n):
            vx = velocities[i, 0] + DT * forces[i, 0] + 0.1 * np.sqrt(DT) * np.random.normal()
            vy = velocities[i, 1] + DT * forces[i, 1] + 0.1 * np.sqrt(DT) * np.random.normal()
            speed, cap = np.sqrt(vx * vx + vy * vy), 1.3 * speeds[i]
            scale = cap / speed if speed > cap else 1.0
            velocities[i, 0], velocities[i, 1] = scale * vx, scale * vy
            places[i, 0] += DT * velocities[i, 0]
            places[i, 1] = min(max(places[i, 1] + DT * velocities[i, 1], 0.01), WIDTH - 0.01)


def with_numba(n):
    state = crowd(n)
    return lambda: walk(*state, STEPS)


def with_pysocialforce(n):
    places, velocities, directions, _ = crowd(n)
    goals = places + 100.0 * directions
    walls = [[0.0, 2.0 * n, y, y] for y in (0.0, WIDTH)]
    simulator = pysocialforce.Simulator(np.hstack([places, velocities, goals]), obstacles=walls)
    return lambda: simulator.step(STEPS)


def measure(name, prepare, n):
    prepare(n)()
    took = []
    for _ in range(ROUNDS):
        run = prepare(n)
        started = time.perf_counter()
        run()
        took.append(time.perf_counter() - started)
    print(name, n, n * STEPS / statistics.median(took), sep="\t")


# PySocialForce and numba tell every step they take.
logging.disable(logging.CRITICAL)
measure("pysocialforce", with_pysocialforce, 10)
measure("numba", with_numba, 10)
measure("numba", with_numba, 100)
