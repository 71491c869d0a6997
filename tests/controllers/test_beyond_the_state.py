"""`controllers.references`.

What a law may know beyond the state: handed over, refused, recorded, the same in a batch."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pyarrow.parquet as pq
import pytest
from observing import measured

from controllers.classical import AFL
from controllers.controller import Controller
from controllers.interfaces import Law
from controllers.observers import FrictionKalman, Luenberger
from controllers.observers.plate_estimates import LagSearch
from controllers.references import Circle, Hold
from controllers.smith import Smith
from controllers.stable_inversion import StableInversion
from twin.base.errors import ScenarioError
from twin.run.assemble import assemble
from twin.run.controller_building import build_controller
from twin.run.loop import drive
from twin.run.record import Recorder, write_run
from twin.scenario import load
from twin.scenario.derived import clean

T = 0.002
CURE = ("observer.kind=friction_kalman", "controller.kind=stable_inversion")


def measurement_at(tick, x=0.0):
    return measured(np.array([[x, 0.0, 0.0, 0.0]]))._replace(time=tick * T)


@dataclass(frozen=True, kw_only=True)
class Asking(Law):
    """Keeps what it was handed."""

    name: ClassVar[str] = "asking"
    needs: ClassVar[tuple[str, ...]] = ("friction", "tilt_gain_x_spread", "disturbance_y")

    def start(self, x, reference, period):
        """Laid once, from the future of the reference."""
        return {"first": x.copy(), "ahead": reference(np.arange(3) * period), "seen": []}

    def control(self, t, x, reference, q):
        """Pulls at the plate without end."""
        return np.full((*x.shape[:-1], 2), 50.0)

    def command(self, now):
        """As control."""
        now.plan["seen"].append(now)
        return self.control(now.time, now.x, now.reference, now.memory)


def test_a_law_is_handed_what_it_needs_in_its_order_and_its_plan():
    observer = FrictionKalman()
    controller = Controller(Asking(), observer, Circle(), T)
    controller.start(measurement_at(0, x=0.02))
    controller.command(measurement_at(0, x=0.02))
    (now,) = controller.plan["seen"]
    known = [quantity.name for quantity in observer.knows]
    expected = observer.further[:, [known.index(name) for name in Asking.needs]]
    np.testing.assert_array_equal(now.needed, expected)
    assert now.needed[0, 1] == pytest.approx(0.02, rel=1e-5)
    assert now.needed[0, 0] == pytest.approx(0.6 * 0.18 / 20 * 9.81)
    assert controller.plan["first"][0, 0] == 0.02
    np.testing.assert_array_equal(controller.plan["ahead"], Circle()(np.arange(3) * T))


def test_a_law_sees_the_rate_really_commanded_and_that_a_clamp_acted():
    controller = Controller(Asking(), FrictionKalman(), Hold(), T)
    controller.start(measurement_at(0))
    step = controller.command(measurement_at(0))
    controller.applied(step.rate * [[0.5, 1.0]])
    controller.command(measurement_at(1))
    first, now = controller.plan["seen"]
    assert not first.clamped.any()
    assert now.clamped.tolist() == [[True, False]]
    np.testing.assert_allclose(now.rate, [[0.05, 0.1]])
    np.testing.assert_allclose(now.requested, [[0.1, 0.1]])


def test_what_an_observer_does_not_estimate_is_refused_in_one_line():
    with pytest.raises(ScenarioError, match=r"needs an observer that estimates friction") as told:
        build_controller(load("circle", ["controller.kind=stable_inversion"]))
    assert "\n" not in str(told.value)
    # behind a predictor it is still the observer that lacks it
    assert str(told.value).endswith("'luenberger' does not")
    with pytest.raises(ValueError, match="'luenberger' does not"):
        Controller(StableInversion(), Luenberger(), Hold(), T)


def test_the_dead_time_goes_to_one_alone():
    cure = load("cure")
    assert build_controller(cure).observer.delay == cure.predictor.delay == 0.042
    thesis = build_controller(load("circle")).observer
    assert isinstance(thesis, Smith)
    assert thesis.delay == 0.042
    assert build_controller(clean(cure)).observer.delay == 0.0
    with pytest.raises(ScenarioError, match=r"predictor\.kind: .* compensates the dead time"):
        build_controller(load("cure", ['predictor.kind="smith"']))
    with pytest.raises(ScenarioError, match=r"observer\.delay: unknown key"):
        load("cure", ["observer.delay=0.01"])


def run(scenarios, ticks=300, lag_search=None):
    rig, controller = assemble(scenarios)
    for _, observer in controller.observer.groups.each if lag_search else ():
        observer.lag_search = lag_search
    record = Recorder(ticks, len(scenarios), T, further=controller.observer.knows)
    drive(rig, controller, ticks * T, record)
    return record


@pytest.mark.long
def test_rigs_of_differing_observers_and_laws_run_side_by_side_as_alone():
    on = ["plant.kind=lagrange", "plant.step=0.002", "duration=0.6", "metrics.start=0"]
    jump = 'reference={kind="step",end=[0.1,0.05],time=0.1}'
    each = [
        load("circle", on),
        load("circle", [*on, *CURE]),
        load("circle", [*on, "observer.kind=friction_kalman", "seed=3"]),
        load("circle", [*on, *CURE, jump, "sensors.touch.frame_rate=58"]),
    ]
    together = run(each)
    for rig, scenario in enumerate(each):
        alone = run([scenario])
        for name in ("state", "estimate", "applied"):
            # rounding differs: numbers for one rig, arrays for several
            np.testing.assert_allclose(together[name][:, rig], alone[name][:, 0], atol=1e-7)
    assert np.isnan(together["further"][:, 0]).all()
    assert np.isfinite(together["further"][:, 1:]).all()
    # the jump was known ahead in the batch, too: the plate moves before it
    before = round(0.08 / T)
    assert np.abs(together["applied"][:before, 3]).max() > 0.02


@pytest.mark.long
def test_a_law_that_counts_no_lag_of_the_drives_is_given_none_that_is_found():
    on = ["plant.kind=lagrange", "plant.step=0.002", "plant.servo.bandwidth_hz=8", "duration=0.8"]
    on += ["metrics.start=0", "plant.start.x=0.03", "observer.kind=friction_map_kalman"]
    laws = "stable_inversion", "afl", "backstepping", "mpc"
    each = [load("circle", [*on, f"controller.kind={law}"]) for law in laws]
    found = run(each, ticks=400)
    assert (found["further"][-1, :, -1] > 0).all()
    without = run(each, ticks=400, lag_search=LagSearch(max_lag_s=0.0))
    assert not without["further"][:, :, -1].any()
    for name in ("state", "estimate", "applied"):
        same = (found[name] == without[name]).all(axis=(0, 2))
        assert same.tolist() == [False, True, True, True]


def write_and_read(folder, record):
    write_run(folder, record, {})
    return pq.read_table(folder / "run.parquet")


def test_what_is_known_beyond_the_state_is_recorded_with_its_unit(tmp_path):
    on = ["plant.kind=lagrange", "duration=0.6", "metrics.start=0"]
    cured = write_and_read(tmp_path, run([load("circle", [*on, *CURE])], ticks=20))
    units = {field.name: field.metadata[b"unit"] for field in cured.schema}
    assert units["estimated_friction"] == b"m/s^2"
    assert units["estimated_tilt_gain_x_spread"] == b"1"
    assert cured["estimated_friction"][0].as_py() == pytest.approx(0.053, abs=1e-3)
    thesis = write_and_read(tmp_path, run([load("circle", on)], ticks=20))
    assert not any("friction" in name for name in thesis.column_names)


def test_laws_of_the_state_alone_get_the_state_that_a_ball_without_friction_would_have():
    observer, law = FrictionKalman(), AFL()
    controller = Controller(law, observer, Circle(), T)
    controller.start(measurement_at(0, x=0.01))
    for tick in range(5):
        u = controller.command(measurement_at(tick, x=0.01)).acceleration
        expected = law.control(tick * T, observer.equivalent, Circle(), np.zeros((1, 0)))
        np.testing.assert_allclose(u, expected, rtol=1e-12)
        controller.applied(controller.requested)
    assert np.abs(observer.equivalent - observer.x).max() > 1e-6
