"""`twin.identify.corrections`: clocks, turned axes and bent gains, taken out of logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from docs.identify_errors import Rig, draw_rig, simulate_log, simulate_turned
from twin.identify import model_choice
from twin.identify.any_rig import identify_axes, join_logs
from twin.identify.axis_logs import AnyLog, AxisLog
from twin.identify.corrections import (
    Correction,
    describe_bend,
    describe_crossed,
    describe_drift,
    find_correction,
)
from twin.identify.first_look import look_first
from twin.identify.further_terms import find_admixture
from twin.identify.plain_model import fit_axis


def test_a_correction_undoes_clock_turned_axes_and_a_bent_gain():
    time = np.arange(0.0, 10.0, 0.1)
    x = AxisLog(time, 0.1 * np.sin(time), True, 1.001 * time, np.cos(time))
    y = replace(x, tilt=0.1 * np.cos(3 * time))
    log = AnyLog("a.csv", {"x": x, "y": y}, {"x": "rad", "y": "rad"}, ())
    found = Correction(1e-3, {"x": 0.05}, {"y": -2.0}).apply(log)
    np.testing.assert_allclose(found.axes["x"].sampled, time, atol=1e-12)
    np.testing.assert_allclose(found.axes["x"].tilt, x.tilt + 0.05 * y.tilt)
    np.testing.assert_allclose(found.axes["y"].tilt, y.tilt * (1 - 2 * np.abs(y.tilt)))
    assert (found.axes["x"].time == time).all()
    np.testing.assert_allclose(found.axes["x"].added, [y.tilt])
    np.testing.assert_allclose(found.axes["y"].added, [y.tilt * np.abs(y.tilt)])
    none = Correction().apply(log).axes["x"]
    assert (none.tilt == x.tilt).all()
    np.testing.assert_allclose(none.sampled, x.sampled)


def test_notes_say_what_was_found_with_its_interval():
    assert "+500 ppm (400 to 600)" in describe_drift(5e-4, 1e-4)
    assert "by -0.052 (-0.062 to -0.042), as of axes that are turned by 3.0 deg" in (
        describe_crossed("y", -0.0524, 0.01)
    )
    assert "7 at small tilts and 5.5 at the largest" in describe_bend("x", 7.0, 5.5)


def fits_of(axes):
    names = ("gain", "dead_time", "lag", "level", "friction")
    return {
        axis: fit_axis(log, names, 2.5, (0.0, 0.5), look=look_first(log))
        for axis, log in axes.items()
    }


def axis_of(simulated):
    time, sampled, ball, command, _ = simulated
    return AxisLog(time, command, True, sampled, ball)


def find(seed, rig):
    return find_correction(fits_of({"x": axis_of(simulate_log(seed, rig))}), {"x": "rad"})


@pytest.mark.long
@pytest.mark.parametrize(("drift", "seed"), [(5e-4, 1), (-3e-4, 2), (0.0, 3)])
def test_a_clock_that_drifts_is_found(drift, seed):
    found = find(seed, Rig(seconds=30.0, drift=drift))
    assert found.drift == pytest.approx(drift, abs=1e-4)
    assert len(found.notes) == (drift != 0)


def with_offset(log, seconds):
    """The log with the clock of its positions ahead by so much."""
    return replace(log, sampled=log.sampled + seconds)


@pytest.mark.short("0.04")
@pytest.mark.parametrize("offset", [0.04, -0.03])
def test_clocks_that_differ_by_recording_are_no_drift_at_first_sight(offset):
    first, second = (axis_of(simulate_log(seed, Rig(seconds=30.0))) for seed in (1, 2))
    joined = join_logs([first, with_offset(second, offset)])
    look = look_first(joined)
    assert not look.drifts()
    assert abs(look.drift) < 3 * look.drift_std
    assert joined.recordings == pytest.approx([35.0], abs=6.0)


@pytest.mark.long
@pytest.mark.parametrize("drift", [0.0, 5e-4])
@pytest.mark.parametrize("offset", [0.02, -0.02])
def test_a_drift_is_found_in_recordings_with_clocks_of_their_own(offset, drift):
    rig = Rig(seconds=30.0, drift=drift)
    first, second = (axis_of(simulate_log(seed, rig)) for seed in (1, 2))
    found = find_correction(
        fits_of({"x": join_logs([first, with_offset(second, offset)])}), {"x": "rad"}
    )
    assert found.drift == pytest.approx(drift, abs=1e-4)
    assert len(found.notes) == (drift != 0)


def bend_of(rig, seed):
    """Bend, its half-width, and the gain next to it that the first fit of a rig shows."""
    fit = fits_of({"x": axis_of(simulate_log(seed, rig))})["x"]
    return find_admixture(fit, fit.log.tilt * np.abs(fit.log.tilt))


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 7, 13])
def test_the_interval_of_a_bend_holds_the_truth(seed):
    rig = draw_rig("softening", seed)
    bend, half, gain = bend_of(rig, seed)
    assert abs(bend + rig.softening) < half
    assert half < 0.25
    assert gain == pytest.approx(rig.gain, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize(("softening", "seed"), [(1.5, 1), (-1.0, 1)])
def test_a_gain_that_changes_with_the_angle_is_found(softening, seed):
    rig = Rig(seconds=30.0, softening=softening)
    bend, half, _ = bend_of(rig, seed)
    assert abs(bend + softening) < half
    found = find(seed, rig)
    assert abs(found.bends["x"] + softening) < min(half, 0.1)
    (note,) = found.notes
    assert float(note.split("gain is ")[1].split(" at small")[0]) == pytest.approx(7.007, rel=0.01)


@pytest.mark.short("1")
@pytest.mark.parametrize("seed", [1, 2])
def test_next_to_a_bend_the_intervals_hold_what_it_leaves_open(seed):
    rig = draw_rig("softening", seed)
    log = AnyLog("a.csv", {"x": axis_of(simulate_log(seed, rig))}, {"x": "rad"}, ())
    fits = fits_of({"x": join_logs([log.axes["x"]])})
    found = find_correction(fits, {"x": "rad"})
    assert found.bends["x"] == pytest.approx(-rig.softening, abs=0.1)
    fit = fits_of({"x": join_logs([found.apply(log).axes["x"]])})["x"]
    free, tied = fit.estimate(), replace(fit, log=replace(fit.log, added=())).estimate()
    for name, truth in (("gain", rig.gain * fit.problem.tilt.scale), ("friction", rig.friction)):
        at = fit.problem.names.index(name)
        assert abs(free.value[at] - truth) < free.half_width[at]
    at = fit.problem.names.index("gain")
    assert free.half_width[at] > 1.4 * tied.half_width[at]


@pytest.mark.long
@pytest.mark.parametrize("rig", [Rig(), Rig(presliding=1e-3, friction=0.05), Rig(filtered=0.08)])
def test_nothing_is_taken_out_of_a_log_that_has_none_of_it(rig):
    assert find(4, rig) == Correction()


@pytest.mark.long
def test_axes_that_are_turned_are_turned_back():
    turned = simulate_turned(1, Rig(seconds=30.0), np.radians(3.0))
    axes = {axis: axis_of(each) for axis, each in turned.items()}
    found = find_correction(fits_of(axes), dict.fromkeys("xy", "rad"))
    assert set(found.crossed) == {"x", "y"}
    for share in found.crossed.values():
        assert abs(share) == pytest.approx(np.sin(np.radians(3.0)), abs=0.01)
    back = found.apply(AnyLog("rig.csv", axes, dict.fromkeys("xy", "rad"), ())).axes
    assert find_correction(fits_of(back), dict.fromkeys("xy", "rad")).crossed == {}


@pytest.mark.long
def test_identify_fits_the_log_that_is_corrected():
    said, log = [], axis_of(simulate_log(1, Rig(drift=5e-4)))
    found = identify_axes([AnyLog("rig.csv", {"x": log}, {"x": "rad"}, ())], 1 / 3, say=said.append)
    (note,) = [note for note in found.notes if "the clock of the positions is" in note]
    assert f"warning: {note}" in said
    (delay,) = [each for each in found.verdicts if each.name == "delay_x"]
    assert delay.value == pytest.approx(0.1, abs=0.003)
    (score,) = found.scores
    assert score.median["model"][1] < 1e-3


@pytest.mark.long
@pytest.mark.parametrize(("softening", "fits"), [(0.0, 1), (1.5, 2)])
def test_a_log_without_corrections_is_fitted_once_from_no_first_guess(softening, fits, monkeypatch):
    fitted, stages = [], []

    def count(*given):
        fitted.append(given)
        return fit_axis(*given)

    monkeypatch.setattr(model_choice, "fit_axis", count)
    log = axis_of(simulate_log(1, Rig(seconds=30.0, softening=softening)))
    identify_axes(
        [AnyLog("rig.csv", {"x": log}, {"x": "rad"}, ())],
        0.0,
        progress=lambda share, stage: stages.append((share, stage)),
    )
    assert len(fitted) == fits
    assert stages[0] == (0.0, "x: clock, other axis and a gain that bends")
    shares = [share for share, _ in stages]
    assert shares == sorted(shares)
