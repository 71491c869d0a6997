"""Logs that tests write, break and read."""

import csv
import math

import numpy as np
import pyarrow.parquet as pq
import pytest

from twin.identify.logs import COLUMNS


@pytest.fixture(scope="session")
def columns_of():
    """Gives the columns of a run folder's log in SI units by name."""

    def of(folder):
        table = pq.read_table(folder / "run.parquet")
        return {
            name: table[name].to_numpy().copy() for name in COLUMNS if name in table.column_names
        }

    return of


@pytest.fixture(scope="session")
def write():
    """Writes a CSV file of columns; ``texts`` replaces cells (row, name) by words."""

    def written(path, columns, *, rows=None, headers=None, texts=None):
        headers, texts = headers or {}, texts or {}
        with path.open("w", newline="", encoding="utf-8") as file:
            out = csv.writer(file)
            out.writerow([headers.get(name, name) for name in columns])
            for k in range(len(columns["time"])) if rows is None else rows:
                out.writerow(
                    [
                        texts.get((k, name), repr(float(values[k])))
                        for name, values in columns.items()
                    ]
                )
        return path

    return written


@pytest.fixture(scope="session")
def broken():
    """Columns of which some are changed by a function each."""

    def changed(columns, **changes):
        new = {name: change(columns[name].copy()) for name, change in changes.items()}
        return {**columns, **new}

    return changed


@pytest.fixture(scope="session")
def axis_log():
    """Gives logs of a rig that is simulated without any of the twin's code."""
    return _axis_log


def _axis_log(
    seed,
    *,
    seconds=60.0,
    rate=30.0,
    gain=6.0,
    dead_time=0.1,
    lag=0.08,
    level=0.05,
    friction=0.03,
    camber=0.0,
    pixel=5e-4,
    noise=2e-4,
    jitter=0.1,
    swing=0.06,
    excited=True,
):
    """Time in s, position in m and command in rad of one axis under a clumsy controller.

    Forward Euler at 0.25 ms. Half of the dead time lies between command and servo, half in the
    camera. The controller, PD on noisy readings, follows steps and sines that change with the seed.
    """
    rng = np.random.default_rng(seed)
    h = 2.5e-4
    steps = round(seconds / h)
    frames = [0.0]
    while frames[-1] < seconds:
        frames.append(frames[-1] + max(0.2, 1 + jitter * rng.standard_normal()) / rate)
    at = np.round(np.array(frames[:-1]) / h).astype(int)
    at = np.unique(at[at < steps])
    before, after = round(dead_time / 2 / h), round(dead_time / h) - round(dead_time / 2 / h)
    x, v, u = 0.3 * swing * rng.standard_normal(), 0.0, 0.0
    places, sent = np.zeros(steps), np.zeros(steps)
    command, reading, last, speed = 0.0, 0.0, 0.0, 0.0
    target, until = 0.0, 0.0
    times, readings, commands, frame = [], [], [], 0
    for k in range(steps):
        places[k] = x
        if frame < len(at) and k == at[frame]:
            seen = places[max(0, k - after)] + noise * rng.standard_normal()
            reading = round(seen / pixel) * pixel if pixel else seen
            t = k * h
            if t >= until:
                target = swing * rng.uniform(-1, 1)
                until = t + rng.uniform(0.8, 3.0)
            dt = (at[frame] - at[frame - 1]) * h if frame else 1 / rate
            speed += min(1.0, dt / 0.08) * ((reading - last) / dt - speed)
            last = reading
            wave = 0.02 * math.sin(2.1 * t) + 0.015 * math.sin(5.3 * t + seed)
            slow = 1.0 / (1.0 + 4.0 * (dead_time + lag))
            command = slow * (0.9 * (target - reading) - 0.45 * slow * speed) + wave
            command = float(np.clip(command, -0.14, 0.14)) if excited else 0.0
            times.append(t)
            readings.append(reading)
            commands.append(command)
            frame += 1
        sent[k] = command
        u += h / lag * (sent[max(0, k - before)] - u) if lag else sent[max(0, k - before)] - u
        a = gain * u + level + camber * x
        if v == 0.0 and abs(a) <= friction:
            continue
        a -= friction * math.copysign(1.0, v if v else a)
        new = v + h * a
        v = 0.0 if v * new < 0 else new
        x += h * v
    return np.array(times), np.array(readings), np.array(commands)
