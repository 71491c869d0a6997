"""`twin.run.together`: Runs that share a batch are, to the bit, the runs that they are alone."""

from __future__ import annotations

import numpy as np
import pytest

from twin.run import finished
from twin.run.finished import Run
from twin.run.together import batch_key, group, run_together
from twin.scenario import Scenario, load

LAWS = {
    "luenberger": (
        *("afl", "afl_integral", "backstepping", "feedforward", "internal_model", "lqr", "mpc"),
        *("pid", "pole_placement", "sliding_mode", "tvlqr"),
    ),
    "kalman": ("lqr", "afl"),
    "ekf": ("lqr", "afl"),
    "nonlinear_luenberger": ("lqr", "afl"),
    "friction_kalman": ("stable_inversion", "lqr"),
}
REFERENCES = (
    ("reference.kind=circle",),
    ("reference.kind=hold", "reference.x=0.1"),
    ("reference.kind=sine", "reference.amplitude=0.1", "reference.omega=2.0"),
)


def scenarios(kind: str, observer: str, duration: float = 0.2) -> list[Scenario]:
    """One of each law at least, on rigs that differ."""
    rng, laws = np.random.default_rng(7), LAWS[observer]
    found = []
    for index in range(max(len(laws), 4)):
        own = [
            f"controller.kind={laws[index % len(laws)]}",
            f"seed={index}",
            f"plant.friction.rolling_mm={rng.uniform(0.05, 0.4)}",
            f"plant.servo.bandwidth_hz={rng.uniform(8, 50)}",
            f"plant.start.x={rng.uniform(-0.1, 0.1)}",
        ]
        base = [f"plant.kind={kind}", f"observer.kind={observer}", f"duration={duration}"]
        found.append(load("circle", [*base, *own, *REFERENCES[index % 3], "metrics.start=0"]))
    return found


def same(one: Run, other: Run) -> bool:
    """Whether two runs have the same columns, bits, indicators and units."""
    bits = all(
        np.array_equal(values, other.rows[name], equal_nan=True)
        for name, values in one.rows.items()
    )
    return bits and [*one.rows] == [*other.rows] and one.metrics == other.metrics


@pytest.mark.short("kalman-mujoco", "kalman-lagrange", "ekf-lagrange")
@pytest.mark.parametrize("kind", ["mujoco", "lagrange"])
@pytest.mark.parametrize("observer", LAWS)
def test_runs_of_a_batch_have_the_bits_that_they_have_alone(kind: str, observer: str) -> None:
    some = scenarios(kind, observer)
    batches = group(dict(enumerate(some)))
    assert all(len(batch) > 1 for batch in batches)
    for batch in batches:
        for number, done in zip(batch, run_together([some[i] for i in batch]), strict=True):
            assert isinstance(done, Run)
            assert same(done, finished.run(some[number]))


def test_a_large_batch_of_mechanisms_has_the_bits_of_each_alone() -> None:
    some = [load("circle", [f"seed={seed}", "duration=0.1"]) for seed in range(20)]
    found = list(run_together(some))
    for number in (0, 19):
        done = found[number]
        assert isinstance(done, Run)
        assert same(done, finished.run(some[number]))


@pytest.mark.long
def test_a_ball_that_falls_has_the_record_that_it_has_alone_and_spares_its_neighbours() -> None:
    still = scenarios("lagrange", "luenberger", 0.5)[:3]
    fast = ["plant.kind=lagrange", "duration=0.5", "plant.start.x=0.34", "plant.start.x_rate=2.0"]
    some = [*still, load("circle", [*fast, "metrics.start=0"])]
    found = list(run_together(some))
    for scenario, done in zip(some, found, strict=True):
        assert isinstance(done, Run)
        assert same(done, finished.run(scenario))
    assert isinstance(found[3], Run)
    assert found[3].outcome != "finished"


def test_runs_that_differ_in_what_a_batch_shares_are_in_groups_of_their_own() -> None:
    texts = (["seed=1"], ["duration=3"], ["seed=2"], ["plant.kind=lagrange"], ["duration=3"])
    some = {name: load("circle", text) for name, text in zip("abcde", texts, strict=True)}
    assert group(some) == [["a", "c"], ["b", "e"], ["d"]]
    assert sorted(map(len, group(dict.fromkeys(range(100), some["a"])))) == [36, 64]
    assert sorted(map(len, group(dict.fromkeys(range(10), some["a"]), 2))) == [5, 5]


def test_a_law_with_a_computing_time_runs_alone() -> None:
    assert batch_key(load("circle", ["controller.computing_time=0.001"])) is None
