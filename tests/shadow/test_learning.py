"""`twin.shadow.learning`: What the beginning of a log teaches, and how a reference differs."""

from dataclasses import replace

import numpy as np
import pytest

from twin.identify.logs import of_columns
from twin.run.logs import NEEDED_COLUMNS
from twin.scenario.load import load
from twin.shadow import learning
from twin.shadow.alarms import SequentialTests
from twin.shadow.belief import WATCHED_PARAMETERS, Belief
from twin.shadow.follow import Shadow
from twin.shadow.learning import (
    COMPARED_PARAMETERS,
    HEALTHY_CHANGE_STDS,
    MAX_CHANCE_STDS,
    Difference,
    compare_with_reference,
    shift_parameters,
)
from twin.shadow.report import sentences

LOG = of_columns(dict.fromkeys(NEEDED_COLUMNS, np.zeros(0)), {}, "log")


def believed(*settings):
    return Belief.of(load("circle", list(settings)), LOG)


def shift(**by):
    return np.array([by.get(name, 0.0) for name in WATCHED_PARAMETERS])


def compared(monkeypatch, belief, **by):
    """What is said of a log to which the fit moves the twin by so much."""

    def fitted(_log, given, _gaps):
        return replace(shift_parameters(given, shift(**by)), constant=np.full(11, 1e-6)), 0.0

    monkeypatch.setattr(learning, "fit_belief", fitted)
    return compare_with_reference(None, belief, None)


@pytest.mark.parametrize(
    ("name", "by", "said"),
    [
        ("rolling", 1.8e-4, "rolling friction 0.180 -> 0.360 mm (+100 %)"),
        ("delay", 0.03, "dead time +30.0 ms"),
        ("level_phi", np.radians(0.5), "level phi 0.100 -> 0.600 deg"),
        ("level_theta", np.radians(-0.5), "level theta -0.200 -> -0.700 deg"),
        ("gain", -0.15, "tilt gain -15.0 %"),
        ("breakaway", 0.5, "breakaway ratio +0.50"),
        ("lag", 0.02, "drive lag +20.0 ms"),
        ("transmission", 0.1, "plate angle over command +10.0 %"),
        ("noise", np.log(3.0), "screen noise x 3.00"),
    ],
)
def test_a_parameter_that_has_moved_is_said_first(monkeypatch, name, by, said):
    belief = believed("plant.friction.rolling_mm=0.18", "plant.level_deg=[0.1, -0.2]")
    found = compared(monkeypatch, belief, **{name: by})
    assert {each.name for each in found} == {*COMPARED_PARAMETERS}
    assert [each.name for each in found if each.significant] == [name]
    assert (found[0].name, found[0].words) == (name, said)
    assert found[0].change == pytest.approx(by, rel=1e-6)


def test_a_rig_of_one_axis_has_one_level(monkeypatch):
    found = compared(monkeypatch, believed("parameters=tube"), delay=0.03)
    assert "level_theta" not in {each.name for each in found}
    assert "level_phi" in {each.name for each in found}


def rolling_std(value, fit_std):
    """Standard deviation of a difference of the rolling friction."""
    about = HEALTHY_CHANGE_STDS["rolling"]
    return np.sqrt((about["scale"] * fit_std) ** 2 + (about["between"] * value) ** 2)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_chance_is_what_both_fits_and_healthy_logs_leave_open(share):
    """A change of a share of the limit, which is the root of the sum of squares."""
    limit = MAX_CHANCE_STDS * rolling_std(2e-4, 3e-6)
    found = Difference("rolling", 2e-4, -share * limit, 3e-6, 2e-4)
    assert found.significant == (share > 1)
    assert found.deviation == pytest.approx(-share * MAX_CHANCE_STDS)


def report(*differences):
    return Shadow(SequentialTests(believed()), moved_s=20.0, length=30.0, differences=differences)


def test_a_log_that_differs_is_not_called_healthy():
    fine = Difference("delay", 0.04, 0.0, 1e-3, 1.0)
    doubled = Difference("rolling", 1.8e-4, 1.8e-4, 1e-6, 1.8e-4)
    assert not report(fine).differs
    assert report(fine).verdict == "healthy"
    found = report(doubled, fine)
    assert found.differs
    assert found.verdict == found.as_dict()["verdict"] == "differs"
    said = " ".join(sentences(found))
    assert "Healthy" not in said
    assert (
        "Differs from the reference since its first row: rolling friction 0.180 -> 0.360 mm "
        "(+100 %)" in said
    )
    assert "dead time" not in said
    assert [each["significant"] for each in found.as_dict()["differences"]] == [True, False]


def test_a_log_that_agrees_states_what_would_not_be_seen():
    std = 1e-6
    limit = MAX_CHANCE_STDS * rolling_std(1.8e-4, std) / 1.8e-4
    said = " ".join(sentences(report(Difference("rolling", 1.8e-4, 0.0, std, 1.8e-4))))
    assert "agree with the reference" in said
    assert f"rolling friction below {100 * limit:.0f} %" in said
    assert "reference" not in " ".join(sentences(report()))
