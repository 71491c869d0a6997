"""`twin.run.assemble`.

Snapshots: what goes on after one is restored is the uninterrupted run, to the last bit."""

import numpy as np
import pytest

from controllers.catalog import catalog
from controllers.interfaces import Law, Observer
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.run.state import Snapshot, SnapshotError
from twin.scenario.load import load as load_scenario
from twin.sim.sensors import Noise

DURATION, AT = 0.3, 0.2
TICK = round(AT / 0.002)
RICH = (
    "sensors.touch.frame_rate=120",
    "sensors.touch.jitter=0.003",
    "sensors.touch.lost=0.2",
    "sensors.touch.hidden=[0.045, -0.1, 0.05, 0.1]",
    "sensors.touch.dead_time_spread=0.002",
    "sensors.noise_hold=0.006",
    "plant.servo.slew_deg=5",
    "plant.servo.acceleration_deg=60",
    "plant.servo.deadband_deg=0.03",
    "plant.servo.resolution_deg=0.02",
    "plant.servo.dead_time=0.0113",
    "plant.servo.bandwidth_hz=20",
    "plant.servo.backlash_deg=0.02",
    "plant.servo.hysteresis_deg=0.02",
    "plant.servo.resonance_hz=20",
    "plant.servo.vibration=0.5",
    "plant.friction.breakaway_ratio=1.4",
    "plant.friction.dwell_time=0.3",
    "plant.friction.presliding_um=20",
    "plant.surface.slope_deg=0.1",
    "plant.start.x=0.05",
    "plant.start.y=0.03",
    'change=[{at=0.1, set={"plant.friction.viscous_mm"=1.0, "rig.cam_error_percent"=[9.0, 5.0]}}, '
    '{at=0.15, over=0.1, set={"plant.level_deg"=[0.1, 0.2], "sensors.touch.dead_time"=0.05}}]',
)
"""Every effect that has a state of its own."""


@pytest.fixture(autouse=True)
def drawn_often(monkeypatch):
    """Let random streams be drawn from every few periods, so that their state counts."""
    monkeypatch.setattr(Noise, "BLOCK", 16)


def recorded(scenarios, keep_at=None, snapshot=None):
    rig, controller = assemble(scenarios, threads=1)
    rig.levelling_s = 0.0  # the time after the run is not recorded
    record = Recorder(round(DURATION / 0.002), len(scenarios), 0.002, rig.channels)
    kept = []

    def keep(tick, measurement):
        if tick == keep_at:
            kept.append(Snapshot.take(rig, controller, measurement))

    drive(
        rig,
        controller,
        DURATION,
        record,
        begin=snapshot and (lambda _: snapshot.restore(rig, controller)),
        keep=keep,
    )
    return record, kept


def goes_on_the_same(scenarios, *, twice=False):
    whole, (snapshot,) = recorded(scenarios, TICK)
    for _ in range(1 + twice):
        rest, _ = recorded(scenarios, snapshot=snapshot)
        assert rest.length == whole.length - TICK
        for name in whole.data:
            assert np.array_equal(whole[name][TICK:], rest[name], equal_nan=True), name
        assert np.abs(rest["state"]).max() > 0


def scenario(*keys):
    return load_scenario("circle", [f"duration={DURATION}", "metrics.start=0.0", *keys])


def informed(law):
    """What a law needs that no observer of the thesis estimates comes from the one that does."""
    return ("observer.kind=friction_kalman",) if law.needs else ()


QUICK = {"afl_integral", "sliding_mode", "stable_inversion"}
OBSERVERS = sorted(catalog(Observer))


@pytest.mark.short(
    "lagrange-keys1",
    "lagrange-keys17",
    "lagrange-keys19",
    "mujoco-keys29",
    "lagrange-keys32",
    "lagrange-keys14",
)
@pytest.mark.parametrize(
    ("plant", "keys"),
    [
        *(
            pytest.param(
                "lagrange",
                (f"controller.kind={name}", *informed(law)),
                marks=() if name in QUICK else pytest.mark.long,
            )
            for name, law in sorted(catalog(Law).items())
            if name != "fmu"  # an FMU keeps to itself what it remembers
        ),
        *(("lagrange", (f"observer.kind={observer}",)) for observer in OBSERVERS),
        *(
            pytest.param("lagrange", (f"observer.kind={observer}", *RICH), marks=pytest.mark.long)
            for observer in OBSERVERS
        ),
        ("mujoco", ()),
        ("mujoco", RICH),
        ("mujoco", ("controller.kind=afl_integral",)),
        ("lagrange", ("controller.kind=afl_integral", "controller.period=0.014")),
        ("lagrange", ("controller.kind=afl_integral", "controller.computing_time=0.005")),
    ],
)
def test_a_restored_run_goes_on_to_the_bit(plant, keys):
    ideal = ("sensors.ideal=true",) if "observer.kind=ideal" in keys else ()
    every = [f"plant.kind={plant}", "predictor.delay=0.042", *keys, *ideal]
    goes_on_the_same([scenario(*every)], twice=set(RICH) < set(every))


@pytest.mark.long
@pytest.mark.parametrize(("plant", "rigs"), [("lagrange", 3), ("mujoco", 3), ("mujoco", 17)])
def test_rigs_side_by_side_go_on_to_the_bit(plant, rigs):
    laws = ("controller.kind=lqr", "controller.kind=afl_integral", "seed=3")
    kinds = (
        (laws[0], "controller.period=0.014"),
        (laws[1], *RICH),
        (laws[2], "observer.kind=kalman"),
    )
    each = [
        (*kinds[number % 3], f"plant.friction.rolling_mm=0.{number + 10}") for number in range(rigs)
    ]
    goes_on_the_same([scenario(f"plant.kind={plant}", *keys) for keys in each])


def test_a_snapshot_of_another_rig_is_refused():
    _, (snapshot,) = recorded([scenario("plant.kind=lagrange")], TICK)
    rig, controller = assemble([scenario("plant.kind=mujoco")])
    with pytest.raises(SnapshotError, match="belongs to another kind of rig"):
        snapshot.restore(rig, controller)
