"""`twin.study`: Runs that share a batch: each gives what it gives alone."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from controllers.classical import LQR
from twin.run.loop import alike, simulate
from twin.scenario import Scenario, load
from twin.sim.plant.exact import ExactPlant

LAWS = (
    ("controller.kind=backstepping",),
    (),
    ("controller.kind=afl_integral",),
    ("controller.kind=lqr", "controller.computing_time=0.007"),
    ("controller.kind=sliding_mode", "controller.betas=[1.5,3.0,5.0]"),
)


def scenarios(kind: str, count: int, duration: float, *more: str) -> list[Scenario]:
    rng = np.random.default_rng(3)
    found = []
    for index in range(count):
        own = [
            f"seed={index % 3}",
            f"plant.friction.rolling_mm={rng.uniform(0.05, 0.4)}",
            f"plant.friction.breakaway_ratio={rng.uniform(1.1, 2)}",
            f"plant.servo.bandwidth_hz={rng.uniform(8, 50)}",
            f"sensors.touch.dead_time={0.042 if index % 4 else rng.uniform(0.02, 0.07)}",
        ]
        if kind == "mujoco":
            own.append(f"plant.spring.preload={rng.uniform(40, 140)}")
        given = [f"plant.kind={kind}", f"duration={duration}", *LAWS[index % len(LAWS)], *own]
        found.append(load("circle", [*given, "metrics.start=0.2", *more]))
    return found


@pytest.mark.short("mujoco")
@pytest.mark.parametrize("kind", ["mujoco", "lagrange"])
def test_a_run_gives_the_same_bits_whatever_shares_its_batch(kind: str) -> None:
    all_of_them = scenarios(kind, 10, 0.24)
    whole = simulate(all_of_them)
    for some in ([0], [3, 7], list(range(9, -1, -1))):
        assert simulate([all_of_them[i] for i in some]) == [whole[i] for i in some]


@pytest.mark.long
def test_the_cure_gives_the_same_bits_beside_other_references() -> None:
    short = ["plant.kind=lagrange", "duration=0.3", "metrics.start=0"]
    kinds = (
        ["reference.kind=lissajous", "reference.amplitude=0.12"],
        ["reference.kind=hold", "reference.x=0.1"],
        ["reference.kind=sine", "reference.amplitude=0.12", "reference.omega=2.0"],
        ["reference.kind=step", "reference.end=[0.1,0.05]", "reference.time=0.2"],
    )
    rigs = [load("cure", [*short, *each]) for each in kinds]
    assert simulate(rigs) == [simulate([rig])[0] for rig in rigs]


@pytest.mark.long
def test_a_ball_that_falls_leaves_its_neighbours_alone() -> None:
    still = scenarios("lagrange", 3, 0.5)
    (flung,) = scenarios("lagrange", 1, 0.5, "plant.start.x=0.34", "plant.start.x_rate=2.0")
    alone, beside = simulate(still), simulate([*still, flung])
    assert beside[:3] == alone
    assert beside[3]["outcome"] != "finished"


def test_a_law_that_asks_for_nonsense_is_stopped_and_spoils_no_neighbour(take_in) -> None:
    take_in(Broken)
    good, bad = scenarios("lagrange", 4, 0.3)[::3]
    broken = load("circle", ["controller.kind=broken"]).controller
    found = simulate([good, bad.model_copy(update={"controller": broken})])
    assert found[0] == simulate([good])[0]
    assert (found[1]["outcome"], found[1]["rms_error"]) == ("aborted", None)


@pytest.mark.long
def test_a_foreign_law_that_multiplies_all_rows_at_once_has_the_same_bits_in_any_batch(
    take_in,
) -> None:
    take_in(AllRowsAtOnce)
    law = load("circle", ["controller.kind=all_rows_at_once"]).controller
    some = [
        each.model_copy(update={"controller": law, "seed": seed})
        for seed, each in enumerate(scenarios("lagrange", 3, 0.3))
    ]
    together = simulate(some)
    assert [simulate([each])[0] for each in some] == together
    assert simulate(some[1:]) == together[1:]


def test_numbers_that_run_away_are_an_outcome_of_their_own(monkeypatch) -> None:
    some = sorted(scenarios("lagrange", 4, 0.3)[:2], key=lambda s: s.controller.kind)
    advance, ticks = ExactPlant.advance, itertools.count()

    def overflow(self: ExactPlant, *given: object) -> None:
        advance(self, *given)
        if next(ticks) > 50:
            self._x[1:] = np.nan

    alone = simulate(some[:1])
    monkeypatch.setattr(ExactPlant, "advance", overflow)
    found = simulate(some)
    assert found[0] == alone[0]
    assert (found[1]["outcome"], found[1]["rms_error"]) == ("diverged", None)


@dataclass(frozen=True, kw_only=True)
class AllRowsAtOnce(LQR):
    """The same law by one product of matrices, which BLAS rounds by the number of rows."""

    name: ClassVar[str] = "all_rows_at_once"

    def control(self, t, x, reference, q):
        r = reference(t)
        desired = np.zeros((*r.shape[1:-1], 8))
        desired[..., 0::4], desired[..., 1::4] = r[0], r[1]
        return (desired - x) @ self.K.T


@dataclass(frozen=True, kw_only=True)
class Broken(LQR):
    """A law that gives no number after 0.2 s."""

    name: ClassVar[str] = "broken"

    def control(self, t, x, reference, q):
        out = super().control(t, x, reference, q)
        return out * np.nan if t > 0.2 else out


def test_what_a_batch_has_only_once_keeps_runs_apart() -> None:
    base = load("circle")
    for change in (
        "duration=20",
        "predictor.delay=0.03",
        "plant.friction.dwell_time=0.1 plant.friction.breakaway_ratio=1.5",
        "plant.kind=lagrange",
    ):
        assert alike(load("circle", change.split())) != alike(base)
    for change in (
        "seed=4",
        "controller.kind=lqr",
        "plant.spring.preload=70",
        "reference.omega=1",
        "rig.limits.rate_deg=20",
        "sensors.touch.grid=64",
    ):
        assert alike(load("circle", [change])) == alike(base)
