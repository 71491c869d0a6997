"""`twin.doctor`: The doctor on the touch screen: port, panels, protocol, calibration."""

import numpy as np
import pytest
from served_screen import EmulatedScreen

from twin.base.errors import RigError, TwinError
from twin.devices.lumio.config import Calibration, CalibrationError, LumioConfig, Mounting
from twin.devices.lumio.screen import LumioScreen
from twin.doctor.calibrate import fit_calibration, measure_touch, usual_points
from twin.doctor.check import CheckStatus
from twin.doctor.lumio import check_calibration, touch
from twin.emulator.lockstep import LockstepRig
from twin.emulator.screen import Protocol, ScreenLine
from twin.scenario.rig import check_rig

SERIAL = (Protocol.MICROTOUCH, Protocol.ELO)


def config(emulated, **options):
    transport = "serial" if emulated.protocol in SERIAL else "hidraw"
    spoken = {"protocol": str(emulated.protocol), **options}
    return LumioConfig(port=str(emulated.path), transport=transport, **spoken)


def last_said(line, set_to, within):
    """The last result on a screen that is listened to, set to a protocol."""
    with EmulatedScreen(line) as emulated:
        screen = LumioScreen(config(emulated, protocol=set_to))
        try:
            return list(touch(screen, lambda _: None, within))[-1]
        finally:
            screen.stop()


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.parametrize(("spoken", "set_to"), [SERIAL, SERIAL[::-1]])
def test_a_protocol_set_wrongly_is_answered_with_the_one_that_the_bytes_look_like(spoken, set_to):
    line = ScreenLine(lambda: [(0.1, 0.05)], protocol=spoken)
    found = last_said(line, str(set_to), 2.0)
    assert found.status is CheckStatus.FAIL
    assert found.advice == f"the bytes look like {spoken}: set touch.protocol to that"


@pytest.mark.real_time
def test_a_screen_that_sends_nothing_is_told_apart_from_one_that_is_not_understood():
    found = last_said(ScreenLine(list), "microtouch", 0.3)
    assert found.advice == "nothing heard: put the ball on, check the cable and the port"


def test_a_rig_switched_on_with_a_wrong_protocol_says_which_one_is_spoken(scenario):
    wrong = LumioConfig(port="emulated", protocol="elo")
    rig = LockstepRig(scenario(), touch=wrong)
    with pytest.raises(RigError, match="the bytes are of microtouch, not of elo"):
        rig.__enter__()


def rig_with(**keys):
    return check_rig({"touch": {"port": "/dev/null", **keys}}, "test")


INLINE = {"matrix": [[0.0, 0.301], [0.376, 0.0]], "origin": [0.0, 0.0]}


def test_a_screen_never_calibrated_is_a_warning_that_says_what_is_assumed():
    found = check_calibration(rig_with(), None)
    assert (found.status, "70.0 x 39.5 cm: assumed" in found.seen) == ("warn", True)
    assert (
        "37.6 x 30.1 cm that the panel reports"
        in check_calibration(rig_with(), (0.376, 0.301)).seen
    )


@pytest.mark.parametrize(
    ("extent", "status"),
    [(None, "pass"), ((0.376, 0.301), "pass"), ((0.301, 0.376), "warn"), ((0.7, 0.4), "warn")],
)
def test_a_calibration_that_does_not_fit_the_panels_own_size_is_a_warning(extent, status):
    found = check_calibration(rig_with(calibration=INLINE), extent)
    assert found.status == status
    assert "37.6 x 30.1 cm" in found.seen


def test_a_calibration_in_both_places_or_in_a_file_that_is_none_is_one_line(tmp_path):
    file = tmp_path / "touch.json"
    for keys, words in (
        ({"calibration_file": str(file)}, "touch.calibration_file: .*No such file"),
        ({"calibration_file": str(file), "calibration": INLINE}, ", not both"),
    ):
        with pytest.raises(TwinError, match=words):
            rig_with(**keys).screen()


class Hand:
    """Touches an emulated screen where it is asked to, with an unsteady finger."""

    def __init__(self, jitter=0.0):
        self.dice = np.random.default_rng(3)
        self.jitter, self.at = jitter, None

    def __call__(self):
        if self.at is None:
            return []
        return [tuple((self.at + self.dice.normal(0, self.jitter, 2)).tolist())]

    def ask(self, word):
        self.at = None
        match word.split():
            case ["touch", x, y]:
                self.at = np.array([float(x), float(y)]) / 1e3


def turned(turn, *, mirrored=1.0, size=(0.68, 0.41)):
    """A screen turned by an angle, its first axis mirrored or not, off the middle."""
    c, s = np.cos(turn), np.sin(turn)
    matrix = np.array([[c, -s], [s, c]]) @ np.diag([mirrored * size[0], -size[1]])
    origin = np.array([0.012, -0.007]) - matrix @ [0.5, 0.5]
    return Calibration(tuple(map(tuple, matrix.tolist())), tuple(origin.tolist()))


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.parametrize(
    ("true", "protocol"),
    [
        (turned(np.radians(1.7)), Protocol.MICROTOUCH),
        (turned(np.radians(-3.0), mirrored=-1.0), Protocol.HID_0007),
        (turned(np.radians(90.0), size=(0.42, 0.72)), Protocol.HID_0006),
    ],
)
def test_a_screen_mounted_in_any_way_is_found_again_within_the_noise(true, protocol):
    jitter = 3e-4
    hand = Hand(jitter)
    line = ScreenLine(hand, protocol=protocol, calibration=true)
    points = usual_points()[::2]
    with EmulatedScreen(line) as emulated:
        found = measure_touch(config(emulated), points, hand.ask, 20.0)
    # a point is the mean of 20 reports, each with the jitter and half a native count
    error = np.hypot(jitter, 0.7 / 4096 / np.sqrt(12)) / np.sqrt(20)
    system = np.column_stack([points, np.ones(len(points))])
    spread = np.linalg.inv(system.T @ system)
    for share in ((0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5)):
        place = np.array([*true.plate(*share), 1.0])
        off = np.subtract(found.calibration.plate(*share), place[:2])
        assert np.abs(off).max() < 5 * error * np.sqrt(place @ spread @ place)
    assert found.rms < 3 * error
    mounting, meant = found.mounting, Mounting.of(true)
    assert (mounting.swapped, mounting.mirrored_x, mounting.mirrored_y) == (
        meant.swapped, meant.mirrored_x, meant.mirrored_y,
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.real_time
def test_a_point_that_is_not_touched_is_named_in_one_line_and_so_is_a_wrong_protocol():
    hand = Hand()
    with EmulatedScreen(ScreenLine(hand)) as emulated:
        with pytest.raises(RigError, match=r"x -280, y -158 mm was not touched within 0.3 s"):
            measure_touch(config(emulated), usual_points(), lambda _: None, 0.3)
        wrong = config(emulated, protocol="elo")
        with pytest.raises(RigError, match=r"not touched within 2 s; the bytes look like micro"):
            measure_touch(wrong, usual_points(), hand.ask, 2.0)


def measure_points(points):
    dice = np.random.default_rng(0)
    screen = Calibration.nominal()
    return np.array([screen.screen(*(point + dice.normal(0, 5e-4, 2))) for point in points])


@pytest.mark.parametrize("wrong", range(9))
def test_a_point_touched_elsewhere_is_named_in_one_line(wrong):
    points = np.array(usual_points())
    said = measure_points(points)
    said[wrong] = measure_points(points + np.array([0.0, 0.03]))[wrong]
    with pytest.raises(CalibrationError, match=rf"contradict one another: {wrong + 1}, x .* order"):
        fit_calibration(said, points)


def test_points_touched_by_hand_are_seldom_refused():
    points, dice = np.array(usual_points()), np.random.default_rng(1)
    screen, refused = Calibration.nominal(), 0
    for _ in range(100):
        said = [screen.screen(*(point + dice.normal(0, 1e-3, 2))) for point in points]
        try:
            fit_calibration(np.array(said), points)
        except CalibrationError:
            refused += 1
    assert refused < 10


def test_the_fewest_points_that_are_taken_leave_something_to_judge_by():
    points = np.array(usual_points())[[0, 2, 6, 8]]
    said = measure_points(points)
    assert fit_calibration(said, points).rms < 1e-3
    said[0] += 0.05
    with pytest.raises(CalibrationError, match="contradict one another"):
        fit_calibration(said, points)


def test_a_measured_calibration_is_what_a_rig_file_that_names_it_has(tmp_path):
    points = np.array(usual_points())
    found = fit_calibration(measure_points(points), points)
    file = tmp_path / "touch.json"
    found.save(file)
    rig = rig_with(calibration_file=str(file))
    assert rig.screen().calibration == found.calibration
    check = check_calibration(rig, None)
    assert (check.status, "touch.json" in check.seen) == ("pass", True)
