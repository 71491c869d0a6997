"""Cost of a tick of each law, observer and predictor, beside the physics of a tick.

Run with ``uv run python -m benchmarks.stack``. Everything is timed in one run on one thread, best
of several rounds, so that the ratios hold on any machine; the two baselines are two physics steps
of the mechanism (one control period) and one call of scipy's algebraic Riccati solver, which an
extended Kalman filter written as the thesis writes it would call every tick.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from itertools import count

import numpy as np
from scipy.linalg import solve_continuous_are

from controllers.arrays import Array
from controllers.catalog import catalog
from controllers.feedback_linearization import AFL
from controllers.interfaces import DelayedObserver, Feedback, Law, Measurement, Observer
from controllers.observers import FrictionMapKalman, Luenberger
from controllers.predictive import MOST, Program
from controllers.references import Circle
from controllers.smith import Smith
from controllers.stable_inversion import StableInversion
from controllers.stack import Controller, SampledReference
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.sim.plant.mechanism import Mechanism

PERIOD = 0.002
RIGS = (1, 256)
CURE = 0.35
"""Most ms a tick of the cure may take for one rig."""
REQUIRED = {"feedforward": {"rho": 300.0, "kappa": 0.3}, "lqr": {"rho": 300.0, "kappa": 0.3}}


def best(
    work: Callable[[], None],
    calls: int,
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Least microseconds a call over several rounds."""
    times = []
    for _ in range(rounds):
        begin = clock()
        for _ in range(calls):
            work()
        times.append((clock() - begin) / calls)
    return 1e6 * min(times)


def law_tick(law: Law, rigs: int) -> Callable[[], None]:
    """One evaluation of a law as the stack does it."""
    reference = SampledReference(Circle(amplitude=0.15, omega=0.75), PERIOD)
    x = np.random.default_rng(1).normal(size=(rigs, 8)) * 0.02
    q, still = np.zeros((rigs, law.memory)), np.zeros((rigs, 2))
    needed = np.zeros((rigs, len(law.needs)))
    plan, ticks = law.start(x, reference, PERIOD), count()

    def tick() -> None:
        t = PERIOD * next(ticks)
        law.command(Feedback(t, x, x, needed, still, still, reference, q, plan))
        if law.memory:
            law.memory_rate(t, x, reference, q)

    return tick


def controller_tick(law: Law, observer: Observer) -> Callable[[], None]:
    """All that is calculated for one rig in a control period, of a ball that rolls."""
    controller = Controller(law, observer, Circle(amplitude=0.15, omega=0.75), PERIOD)
    y = np.random.default_rng(3).normal(size=(512, 1, 4)) * 1e-3
    fresh, ticks = (np.zeros(1), np.ones(1, bool)), count()
    controller.start(Measurement(0.0, y[0], *fresh))

    def tick() -> None:
        k = next(ticks)
        step = controller.command(Measurement(PERIOD * k, y[k % 512], *fresh))
        controller.applied(step.rate)

    return tick


def observer_tick(observer: Observer, rigs: int) -> Callable[[], None]:
    """One correction and one prediction."""
    x = np.random.default_rng(2).normal(size=(rigs, 8)) * 0.01
    observer.start(x)
    fresh = np.zeros(rigs), np.ones(rigs, bool)
    measurement = Measurement(0.0, x[:, 0::2].copy(), *fresh, x)
    u = np.full((rigs, 2), 0.01)

    def tick() -> None:
        observer.correct(measurement)
        observer.predict(u)

    return tick


def physics_tick(rigs: int) -> Callable[[], None]:
    """Two physics steps, on one thread, with the ball rolling on a plate in motion."""
    plant = Mechanism(rigs=rigs, threads=1)
    plant.start(np.tile([0.0, 0.1, 0.0, -0.1], (rigs, 1)))
    rate, sign = np.full((rigs, 2), 0.3), [1.0]

    def tick() -> None:
        sign[0] = -sign[0]
        plant.advance(sign[0] * rate, 2)

    return tick


def riccati() -> None:
    """The algebraic Riccati equation (7.16) by scipy, outputs scaled to unit variance."""
    A, B, C = RICCATI  # noqa: N806
    solve_continuous_are(A.T, C.T, B @ B.T * 1e-4 + np.eye(8) * 1e-9, np.eye(4) * 1e-6)


def solve_times() -> list[float]:
    """Microseconds of processor time of every quadratic program of ``mpc`` on two hard tasks.

    A jump over most of the screen, and a circle so fast that the limits act all the time.
    """
    solve, taken = Program.solve, []

    def timed(self: Program, z: Array, motion: Array) -> Array | None:
        begin = time.thread_time()
        found = solve(self, z, motion)
        taken.append(1e6 * (time.thread_time() - begin))
        return found

    Program.solve = timed  # type: ignore[method-assign]
    try:
        for path in ('{kind="hold",x=0.15,y=0.15}', '{kind="circle",amplitude=0.15,omega=4.5}'):
            keys = ['controller={kind="mpc"}', f"reference={path}", "plant.kind=lagrange"]
            scenario = load("cure", [*keys, "duration=6.0", "metrics.start=0.0"])
            rig, controller = assemble(scenario, threads=1)
            drive(rig, controller, 6.0, Recorder(3000, 1, PERIOD))
    finally:
        Program.solve = solve  # type: ignore[method-assign]
    return taken


RICCATI = catalog(Observer)["kalman"]().model.linear()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    parts: dict[str, Callable[[int], Callable[[], None]]] = {
        "physics, two steps": physics_tick,
    }
    for name, law in catalog(Law).items():
        built = law(**REQUIRED.get(name, {}))
        parts[f"law {name}"] = lambda rigs, built=built: law_tick(built, rigs)
    for name, observer in catalog(Observer).items():
        if observer is Smith:
            continue
        parts[f"observer {name}"] = lambda rigs, kind=observer: observer_tick(kind(), rigs)
        if not issubclass(observer, DelayedObserver):
            parts[f"observer {name} + Smith"] = lambda rigs, kind=observer: observer_tick(
                Smith(observer=kind()), rigs
            )
    solve = best(riccati, 20, rounds)
    print(f"scipy's algebraic Riccati equation: {solve:.0f} us a call")
    print(f"{'':34} {'one rig':>12} {'us':>4} {'N = 256':>10} us a rig")
    physics = {}
    for name, make in parts.items():
        cost = {rigs: best(make(rigs), 400 if rigs == 1 else 40, rounds) / rigs for rigs in RIGS}
        physics = physics or cost
        shares = [f"{cost[rigs]:8.2f} ({cost[rigs] / physics[rigs]:5.2f})" for rigs in RIGS]
        print(f"{name:34} {shares[0]:>17} {shares[1]:>17}")
    print("in brackets: share of the physics of one control period in the same run")
    ekf = best(observer_tick(Smith(observer=catalog(Observer)["ekf"]()), 1), 400, rounds)
    print(
        f"EKF with predictor, one rig: {ekf:.0f} us a tick, {ekf / solve:.2f} of one Riccati solve"
        f" (goal: at most {150 / 620:.2f})"
    )
    clock = time.process_time
    thesis = best(controller_tick(AFL(), Smith(observer=Luenberger())), 400, rounds, clock)
    tick = controller_tick(StableInversion(), FrictionMapKalman(delay=0.042))
    cure = best(tick, 400, rounds, clock)
    print(
        "whole controller, one rig, processor time: AFL behind Luenberger and predictor "
        f"{thesis:.0f} us a tick, "
        f"stable inversion behind friction_map_kalman {cure:.0f} us, "
        f"{cure / thesis:.1f} times as much (goal: at most {1e3 * CURE:.0f} us)"
    )
    taken = solve_times()
    middle, high = np.percentile(taken, [50, 99])
    print(
        f"mpc, processor time of {len(taken)} quadratic programs beyond the limits, an axis each: "
        f"median {middle:.0f} us, p99 {high:.0f} us, worst {max(taken):.0f} us; the solver is "
        f"stopped after {MOST} iterations, and the last plan goes on"
    )


if __name__ == "__main__":
    main()
