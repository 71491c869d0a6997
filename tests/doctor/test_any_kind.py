"""`twin.doctor.any_kind`: checks of devices of any kind, on own devices in virtual time.

The classes are files that a rig file names; their plate integrates the commanded rates.
"""

import sys

import numpy as np
import pytest

from twin.devices.own import OwnServos
from twin.doctor import examine as examination
from twin.doctor.any_kind import ANY_KIND_ADVICE, DeviceCheck, any_screen, any_servos
from twin.doctor.check import CheckStatus, report_errors
from twin.doctor.examine import examine
from twin.scenario import load
from twin.scenario.rig import check_rig

CLOCK = """
class Clock:
    def __init__(self):
        self.now, self.plate, self.rates = 0.0, [0.0, 0.0], (0.0, 0.0)
        self.largest, self.stopped, self.torque, self.words = [0.0, 0.0], [], False, ()

    def wait(self, seconds):
        self.now += seconds + 1e-9
        for axis in (0, 1):
            self.plate[axis] += seconds * self.rates[axis]
            self.largest[axis] = max(self.largest[axis], abs(self.plate[axis]))

CLOCK = Clock()
"""
SERVOS = """
from ballplate.hardware import Reading, ServoHardware
from virtual_bench import CLOCK

class Servos(ServoHardware):
    def __init__(self, matrix=((1.0, 0.0), (0.0, 1.0)), encoders=True):
        self.matrix, self.encoders = matrix, encoders

    def start(self):
        CLOCK.torque = True

    def measure(self):
        if not self.encoders:
            return super().measure()
        angles = [a * CLOCK.plate[0] + b * CLOCK.plate[1] for a, b in self.matrix]
        return Reading.of_plate(*angles, CLOCK.now)

    def command(self, rates, angles):
        CLOCK.rates = rates

    def stop(self):
        CLOCK.rates, CLOCK.torque = (0.0, 0.0), False
        CLOCK.stopped.append("servos")

    def faults(self):
        return CLOCK.words

    def time(self):
        return CLOCK.now

    def wait(self, seconds):
        CLOCK.wait(seconds)
"""
CAMERA = """
import math
from ballplate.hardware import Reading, ScreenHardware
from virtual_bench import CLOCK

class Camera(ScreenHardware):
    def __init__(self, rate=50.0, ball=(0.05, -0.02), silent_after=math.inf):
        self.rate, self.ball, self.silent_after = rate, ball or (math.nan, math.nan), silent_after

    def start(self):
        pass

    def measure(self):
        at = min(CLOCK.now, self.silent_after)
        return Reading(*self.ball, math.floor(at * self.rate + 1e-6) / self.rate)

    def stop(self):
        CLOCK.stopped.append("camera")

    def time(self):
        return CLOCK.now
"""
IDENTITY = [[1.0, 0.0], [0.0, 1.0]]


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Files of own devices that share one virtual time; makes a rig file of their options."""
    for name, text in (("virtual_bench", CLOCK), ("servos", SERVOS), ("camera", CAMERA)):
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "virtual_bench", raising=False)

    class Bench:
        scenario = load("hold")

        @property
        def clock(self):
            return sys.modules["virtual_bench"].CLOCK

        def rig(self, camera=(), servos=()):
            return check_rig(
                {
                    "drives": {"kind": "own", "backend": f"{tmp_path}/servos.py:Servos"}
                    | {"options": dict(servos)},
                    "touch": {"kind": "own", "backend": f"{tmp_path}/camera.py:Camera"}
                    | {"options": dict(camera)},
                },
                "rig.toml",
            )

        def screen(self, check=None, **camera):
            given = [check] if check else []
            return any_screen(self.scenario, self.rig(camera=camera), *given)

        def servos(self, *, move=True, **servos):
            rig = self.rig(servos=servos)
            return any_servos(self.scenario, rig, move=move, reset=False)

    yield Bench()
    sys.modules.pop("virtual_bench", None)


def reported(check):
    """The results of a check by what was checked, its error under ``device``."""
    return {each.what: each for each in report_errors(check, "device", ANY_KIND_ADVICE)}


def test_a_screen_of_any_kind_passes_with_its_rate_and_the_place_of_the_ball(bench):
    found = reported(bench.screen(rate=50.0))
    assert {each.status for each in found.values()} == {CheckStatus.PASS}
    assert found["touch screen"].seen == "Camera of kind 'own' starts"
    assert found["measurements"].seen == "50 a second, longest gap 20 ms"
    assert found["ball"].seen.startswith("x +50.0, y -20.0 mm, spread 0.00, 0.00 mm")
    assert bench.clock.stopped == ["camera"]
    assert bench.clock.now == pytest.approx(DeviceCheck().watch_s, abs=0.01)


def test_a_screen_that_sees_no_ball_fails_with_what_to_do(bench):
    found = reported(bench.screen(ball=None))
    assert list(found) == ["touch screen", "ball"]  # nothing shows how often it measures
    assert found["ball"].status is CheckStatus.FAIL
    assert found["ball"].seen == "seen in 0 % of the time"
    assert found["ball"].advice == "put it on the plate"


def test_a_screen_that_measures_too_rarely_fails(bench):
    brief = DeviceCheck(watch_s=0.03)
    found = reported(bench.screen(brief, rate=50.0))
    assert found["measurements"].status is CheckStatus.FAIL
    assert "ball" not in found
    assert bench.clock.stopped == ["camera"]


def test_a_screen_whose_measurements_end_is_a_failure_and_is_closed(bench):
    found = reported(bench.screen(silent_after=1.0))
    assert found["device"].status is CheckStatus.FAIL
    assert found["device"].seen.startswith("Camera: measurements ended: none for 0.25 s")
    assert found["device"].advice == ANY_KIND_ADVICE
    assert bench.clock.stopped == ["camera"]


def test_servos_without_leave_to_move_are_started_and_stopped_only(bench):
    found = reported(bench.servos(move=False))
    assert found["drives"].seen == "of kind 'own' start"
    assert found["safety net"].status is CheckStatus.WARN
    assert "nothing stops the plate if this program dies" in found["safety net"].seen
    assert (found["tilt"].status, found["tilt"].seen) == (CheckStatus.WARN, "not tested")
    assert bench.clock.largest == [0.0, 0.0]
    assert bench.clock.stopped == ["servos"]


def test_servos_tilt_each_axis_by_a_degree_and_back(bench):
    found = reported(bench.servos())
    for axis, look in (("phi", "the end at larger x goes down"), ("theta", "larger y goes up")):
        tilt = found[f"tilt of {axis}"]
        assert tilt.status is CheckStatus.PASS
        assert tilt.seen.startswith("+1.00 deg for +1 deg")
        assert look in tilt.seen
    assert np.degrees(bench.clock.largest) == pytest.approx([1.0, 1.0], abs=0.01)
    assert np.degrees(bench.clock.plate) == pytest.approx([0.0, 0.0], abs=0.01)
    assert not bench.clock.torque


def test_of_servos_of_one_axis_phi_alone_is_tilted(bench):
    bench.scenario = load("hold", ["plant.kind=lagrange", "plant.axes=1"])
    assert [each for each in reported(bench.servos()) if "tilt" in each] == ["tilt of phi"]
    assert np.degrees(bench.clock.largest) == pytest.approx([1.0, 0.0], abs=0.01)


@pytest.mark.short("*-pass-pass", "*-fail-pass")
@pytest.mark.parametrize(
    ("matrix", "phi", "theta"),
    [
        ([[-1.0, 0.0], [0.0, 1.0]], "fail", "pass"),  # sign
        ([[1.0, 0.0], [0.0, 0.5]], "pass", "fail"),  # scale beyond 40 %
        ([[1.0, 0.0], [0.0, 0.7]], "pass", "pass"),  # scale within
        ([[0.0, 1.0], [1.0, 0.0]], "fail", "fail"),  # plugs exchanged
    ],
)
def test_wrong_encoders_of_any_servos_fail_axis_by_axis(bench, matrix, phi, theta):
    found = reported(bench.servos(matrix=matrix))
    assert [found[f"tilt of {axis}"].status for axis in ("phi", "theta")] == [phi, theta]
    for each in found.values():
        if each.status is CheckStatus.FAIL:
            assert each.advice == "check sign and scale of the command and of the encoder"


def test_a_plate_without_encoders_is_to_be_watched(bench):
    found = reported(bench.servos(encoders=False))
    tilt = found["tilt of theta"]
    assert (tilt.status, tilt.seen) == (CheckStatus.WARN, "no encoder measures it")
    assert tilt.advice == "the end at larger y goes up: did it? or let the ball show it, by --ball"


def test_servos_that_never_have_torque_fail_and_are_not_moved(bench, monkeypatch):
    monkeypatch.setattr(OwnServos, "enable", lambda self: None)
    found = reported(bench.servos())
    assert found["torque"].seen == "none within 1 s of the request"
    assert not any(what.startswith("tilt") for what in found)
    assert bench.clock.largest == [0.0, 0.0]
    assert bench.clock.stopped == ["servos"]


def test_a_fault_of_the_servos_ends_their_tilt(bench):
    check = bench.servos()
    found = []
    for each in report_errors(check, "device", ANY_KIND_ADVICE):
        found.append(each)
        if each.what == "tilt of phi":
            bench.clock.words = ("too hot",)
    assert found[-1].status is CheckStatus.FAIL
    assert "own hardware reports: too hot" in found[-1].seen
    assert "tilt of theta" not in {each.what for each in found}
    assert not bench.clock.torque


def test_both_devices_of_own_kinds_are_examined_in_the_order_of_a_bring_up(bench, monkeypatch):
    monkeypatch.setattr(examination, "computer", lambda *_: iter(()))
    asked = []
    found = list(
        examine(bench.scenario, bench.rig(servos={"matrix": IDENTITY}), asked.append, move=True,
                reset=False)
    )  # fmt: skip
    assert asked == ["put"]
    assert [each.what for each in found] == [
        "touch screen", "measurements", "ball", "drives", "safety net", "tilt of phi",
        "tilt of theta",
    ]  # fmt: skip
    assert {each.status for each in found} == {CheckStatus.PASS, CheckStatus.WARN}
    assert bench.clock.stopped == ["camera", "servos"]
