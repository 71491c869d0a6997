"""Tests of `twin.view.summary`."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from click.testing import CliRunner
from markupsafe import Markup

from twin.base.errors import RecordError
from twin.base.writing import write_json
from twin.cli.see import report as command
from twin.devices.realtime import TimingLog
from twin.run.finished import Run, record_run, run
from twin.run.indicators import INDICATOR_UNITS
from twin.run.opened import open_run, open_runs
from twin.run.tables import INDICATOR_LABELS, TIMING_NAMES
from twin.scenario.load import check
from twin.view.html import details, html
from twin.view.streams import signals
from twin.view.summary import ENDING_TEXTS, Diagnosis, spectrum, summary, verdict

pytestmark = pytest.mark.usefixtures("quick_pictures")

TABLES = {
    "title": "sine <&> test",
    "duration": 20.0,
    "plant": {"kind": "lagrange"},
    "controller": {"kind": "lqr", "rho": 300.0, "kappa": 0.3},
    "reference": {"kind": "sine", "amplitude": 0.1, "omega": 1.0},
    "metrics": {"start": 6.0},
}


def make_run(ball, tables=TABLES, **columns):
    """A run whose ball moved as a function of time says, with nothing at its limits."""
    scenario = check(tables, "test")
    time = np.arange(round(scenario.duration / 0.002)) * 0.002
    rows = {"time": time, "supervisor": np.full(len(time), 3.0), "touched": np.ones(len(time))}
    for kind in ("true", "estimated"):
        for part in ("x", "x_rate", "phi", "phi_rate", "y", "y_rate", "theta", "theta_rate"):
            rows[f"{kind}_{part}"] = np.zeros(len(time))
    for axis in ("phi", "theta"):
        for kind in ("requested", "applied"):
            rows[f"{kind}_{axis}_acc"] = np.zeros(len(time))
    for kind in ("true", "estimated"):
        rows[f"{kind}_x"], rows[f"{kind}_y"] = ball(time).T
    metrics = {"outcome": "finished", "outcome_time": 20.0, "tracking_error_percent": 12.5}
    return Run("run_1", scenario, rows | columns, metrics=metrics, versions={"python": "3"})


def rest(time):
    return np.zeros((len(time), 2))


def reference(time):
    return make_run(rest).followed(time)[0]


def on_x(values):
    return np.column_stack((values, np.zeros_like(values)))


def test_lag_and_gain_of_a_known_motion_are_found():
    found = Diagnosis.of(make_run(lambda t: 0.9 * reference(np.maximum(t - 0.1813, 0))))
    assert found.lag == pytest.approx(0.1813, abs=2e-4)
    assert found.gain == pytest.approx(0.9, abs=1e-3)
    assert found.rest < 1e-4


def test_a_delay_longer_than_any_tried_is_none():
    found = Diagnosis.of(make_run(lambda t: reference(np.maximum(t - 2.2, 0))))
    assert (found.lag, found.gain, found.rest) == (None, None, None)


def test_a_resting_reference_has_no_lag():
    tables = {**TABLES, "reference": {"kind": "hold"}}
    found = Diagnosis.of(make_run(lambda t: on_x(0.01 * np.sin(t)), tables))
    assert (found.lag, found.gain, found.rest) == (None, None, None)


def test_the_error_is_the_root_mean_square_from_the_start_of_the_metrics():
    found = Diagnosis.of(make_run(lambda t: reference(t) + on_x(np.where(t < 6, 0.2, 0.004))))
    assert found.rms == pytest.approx(0.004)


def test_cut_effort_is_counted_and_told():
    some = make_run(reference)
    requested = some.rows["requested_phi_acc"].copy()
    requested[:2500] = 9.0
    cut = make_run(reference, requested_phi_acc=requested)
    assert Diagnosis.of(cut).cut == pytest.approx(0.25)
    assert any("cut the effort 25.0 %" in line for line in summary(cut, Diagnosis.of(cut)))
    rolling = make_run(reference, true_x_rate=np.full(10000, 0.1))
    sentences = summary(rolling, Diagnosis.of(rolling))
    assert any("No limit was in the way" in line for line in sentences)


def test_what_held_the_ball_is_said_in_place_of_no_limit():
    """On a rig where friction or an end stop holds the ball, that is what was in the way."""
    speed = np.full(10000, 0.1)
    speed[:500] = 0.0
    sticks = make_run(reference, true_x_rate=speed)
    told = verdict(sticks, replace(Diagnosis.of(sticks), lag=None, gain=None, rest=None))
    assert told.endswith(": friction held the ball at rest 5.0 % of the time.")
    sentences = summary(sticks, Diagnosis.of(sticks))
    assert any(each.startswith("No limit of the plate was reached") for each in sentences)
    radius = sticks.scenario.plant.ball.radius
    walls = TABLES | {"plant": {"kind": "lagrange", "rim": {"size": [0.14, 0.0]}}}
    walled = make_run(
        lambda t: on_x(np.where(t < 5, 0.07 - radius, 0.0)), walls, true_x_rate=np.full(10000, 0.1)
    )
    assert Diagnosis.of(walled).walled == pytest.approx(0.25)
    assert "the ball was at a wall 25.0 % of the time" in verdict(walled, Diagnosis.of(walled))
    assert any("at a wall 25.0 %" in each for each in summary(walled, Diagnosis.of(walled)))


HOLD = TABLES | {"reference": {"kind": "hold", "x": 0.03}}


def test_what_the_observer_made_of_friction_is_drawn():
    names = ("friction", "tilt_gain_x", "tilt_gain_y", "disturbance_x", "disturbance_y")
    known = {f"estimated_{name}": np.full(10000, 0.053) for name in names}
    known |= {f"estimated_{name}_spread": np.full(10000, 0.004) for name in names[:3]}
    measured = {f"measured_{axis}": np.zeros(10000) for axis in "xy"}
    one = make_run(rest, **known, **measured)
    plots = signals(one.rows, one.motion.reference)
    assert plots["friction_mm_per_s2"]["friction"][0] == pytest.approx(53)
    silent = make_run(rest, **measured)
    assert "friction_mm_per_s2" not in signals(silent.rows, silent.motion.reference)


def test_a_ball_stuck_by_friction_is_called_stuck():
    still = make_run(rest, HOLD, true_phi=np.full(10_000, np.radians(0.3)))
    found = Diagnosis.of(still)
    assert found.stuck == pytest.approx(0.03)
    (sentence,) = [text for text in summary(still, found) if "stuck" in text]
    # 0.18 mm on 20 mm
    assert "30 mm away from its reference" in sentence
    assert "tilted by 0.3 deg" in sentence


def test_how_long_friction_held_the_ball_is_told():
    moving = np.where(np.arange(10000) < 3000, 0.0, 0.02)
    held = make_run(rest, true_x_rate=moving)
    assert any("at rest 30.0 % of the whole" in line for line in summary(held, Diagnosis.of(held)))
    smooth = {**TABLES, "plant": {"kind": "lagrange", "friction": {"rolling_mm": 0.0}}}
    freed = {**TABLES, "change": [{"at": 5.0, "set": {"plant.friction.rolling_mm": 0.0}}]}
    for tables in (smooth, freed):  # without friction a ball may rest, too
        free = make_run(rest, tables, true_x_rate=moving)
        assert free.motion.held is None
        assert not any("held" in line for line in summary(free, Diagnosis.of(free)))


def test_a_ball_that_creeps_or_lies_where_it_should_is_not_stuck():
    assert Diagnosis.of(make_run(lambda t: on_x(0.2e-3 * t), HOLD)).stuck is None
    assert Diagnosis.of(make_run(lambda t: on_x(np.full(len(t), 0.0295)), HOLD)).stuck is None
    assert Diagnosis.of(make_run(rest)).stuck is None  # its reference moves


def test_the_verdict_is_one_sentence_led_by_the_error():
    behind = make_run(lambda t: 0.9 * reference(np.maximum(t - 0.18, 0)))
    late = np.arange(3000, 10_000) * 0.002
    error = 0.1 * np.sqrt(2) * (np.sin(late) - 0.9 * np.sin(late - 0.18))  # on x and y alike
    assert verdict(behind, Diagnosis.of(behind), 0.25).startswith(
        "Tracking error e_tt 12.5 % (0.25 % on the clean model), "
        f"{1000 * np.sqrt((error**2).mean()):.3g} mm RMS over x and y from 6 s on: "
        "the ball ran 180 ms behind its reference on a path 10.0 % smaller; apart from these two "
        "the error is "
    )
    still = make_run(rest, HOLD)
    still.metrics["tracking_error_percent"] = None
    assert verdict(still, Diagnosis.of(still)).startswith(
        "30 mm RMS over x and y from 6 s on: at the end the ball lay stuck by friction 30 mm away"
    )
    metrics = {"outcome": "fell", "outcome_time": 3.25, "reason": "ball left the plate"}
    fell = replace(make_run(reference), metrics=metrics)
    told = "The ball fell off the plate after 3.25 s: ball left the plate."
    assert verdict(fell, Diagnosis.of(fell)) == summary(fell, Diagnosis.of(fell))[0] == told


def test_a_fault_of_a_late_computer_is_put_down_to_it_first():
    metrics = {"outcome": "fault", "outcome_time": 3.706, "reason": "PDOs unsteady"}

    def told(lateness, metrics):
        log = TimingLog(0.002)
        for _ in range(50):
            log.tick(lateness)
        run = replace(make_run(reference), metrics=metrics, ledger=log.as_dict())
        return verdict(run, Diagnosis.of(run))

    assert told(0.003, metrics) == (
        "This computer was too late, not the rig: 50 of 50 periods were late or missed, one by "
        "3 ms; close other programs, or allow real-time priority (docs/wire.md), and run it again. "
        "A device failed after 3.706 s: PDOs unsteady."
    )
    assert told(0.0001, metrics) == "A device failed after 3.706 s: PDOs unsteady."
    fell = {**metrics, "outcome": "fell"}
    assert told(0.003, fell).startswith("The ball fell")


def test_the_spectrum_of_a_sine_reads_its_amplitude_at_its_frequency():
    frequency, amplitude = spectrum(
        make_run(lambda t: reference(t) - on_x(0.003 * np.sin(20 * np.pi * t)))
    )
    at = int(np.argmax(amplitude[:, 0]))
    assert frequency[at] == pytest.approx(10.0, abs=0.05)
    assert amplitude[at, 0] == pytest.approx(0.003, rel=0.01)


class Links(HTMLParser):
    """Collects what a page would load, and checks that every tag is closed."""

    def __init__(self):
        super().__init__()
        self.loaded, self.open = [], []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.loaded += [given[key] for key in ("src", "href", "xlink:href") if key in given]
        if tag not in ("meta", "br", "link", "img"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def runs():
    return [make_run(reference), make_run(lambda t: 0.5 * reference(t))]


@pytest.fixture(scope="module")
def page(runs):
    return html(runs)


def test_a_page_is_whole_and_needs_nothing_else(page):
    links = Links()
    links.feed(page)
    assert links.open == []
    assert [link for link in links.loaded if not link.startswith("#")] == []
    assert "<script" not in page
    assert "url(http" not in page
    assert all(text in page for text in ("controller.rho", "300.0", "python 3"))
    assert "sine <&> test" not in page


@pytest.mark.long
def test_the_same_runs_give_the_same_page(page, runs):
    assert html(runs) == page


@pytest.mark.long
def test_every_format_is_written_beside_the_run(scenario, tmp_path):
    record_run(run(scenario()), tmp_path)
    ran = CliRunner().invoke(command, [str(tmp_path), "--format", "html,png,pdf,svg"])
    assert ran.exit_code == 0, ran.output
    starts = {
        "report.html": b"<!DOCTYPE html>",
        "report.png": b"\x89PNG",
        "report-details.png": b"\x89PNG",
        "report.pdf": b"%PDF",
        "report-details.pdf": b"%PDF",
        "report.svg": b"<?xml",
    }
    for name, start in starts.items():
        assert (tmp_path / name).read_bytes().startswith(start), name


def test_runs_of_a_comparison_come_in_its_order_and_by_its_names(scenario, tmp_path):
    done = run(scenario("duration=0.02"))
    for name in ("b-ki=0", "a-ki=1", "0-other"):
        record_run(done, tmp_path / name)
    listed = {"folders": ["b-ki=0", "a-ki=1"], "names": ["b ki=0", "a ki=1"]}
    write_json(tmp_path / "compare.json", listed)
    assert [each.name for each in open_runs((tmp_path,))] == ["b ki=0", "a ki=1", "0-other"]
    assert [each.name for each in open_runs((tmp_path / "a-ki=1",))] == ["a ki=1"]
    write_json(tmp_path / "compare.json", {"folders": ["b-ki=0", "a-ki=1"]})  # of an older version
    assert [each.name for each in open_runs((tmp_path,))] == ["b-ki=0", "a-ki=1", "0-other"]


@pytest.mark.long
def test_of_many_runs_each_is_told_in_a_sentence(page, runs, monkeypatch):
    monkeypatch.setattr("twin.base.page.inline", lambda _: Markup("<svg></svg>"))
    many = html([*runs, *runs])
    assert "<h3>run_1</h3>" in page
    assert "<h3>" not in many
    assert many.count("run_1: Tracking error e_tt") == 4


@pytest.mark.long
def test_where_nobody_knows_the_truth_no_error_of_the_estimate_is_drawn(runs):
    one = runs[0]
    real = {name: rows for name, rows in one.rows.items() if not name.startswith("true")}
    for shown, panels in ((runs, 3), ([replace(one, rows=real)], 2)):
        titles = [panel.get_title() for panel in details(shown).axes]
        assert len(titles) == panels
        assert any("estimated" in title for title in titles) == (panels == 3)


def test_an_unknown_format_names_the_known_ones(tmp_path):
    ran = CliRunner().invoke(command, [str(tmp_path), "--format", "docx"])
    assert ran.exit_code == 2
    assert "no format 'docx' (known: html, png, pdf, svg)" in ran.output


@pytest.mark.long
def test_a_full_disk_is_one_line_and_leaves_nothing(scenario, tmp_path, monkeypatch):
    record_run(run(scenario()), tmp_path / "run")

    def full(path, content):
        path.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    (tmp_path / "out").mkdir()
    ran = CliRunner().invoke(
        command, [str(tmp_path / "run"), "--format", "png", "--out", str(tmp_path / "out" / "page")]
    )
    assert isinstance(ran.exception, RecordError)
    assert "No space left on device" in str(ran.exception)
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.long
def test_a_fallen_run_can_be_reported(scenario, tmp_path):
    fallen = scenario("duration=8", "plant.start.x_rate=1.2", "plant.start.x=0.2")
    record_run(run(fallen), tmp_path)
    (again,) = open_run(tmp_path)
    assert "The ball fell off the plate" in html([again])


def test_an_indicator_is_printed_in_its_own_unit_or_in_millimetres():
    printed = {"m": "mm", "rad/s^2": "rad/s²"}
    assert {
        name: unit for name, (_, unit) in INDICATOR_LABELS.items() if name in INDICATOR_UNITS
    } == {
        name: printed.get(unit, unit)
        for name, unit in INDICATOR_UNITS.items()
        if name not in TIMING_NAMES
    }


def test_no_ending_speaks_of_a_screen_that_a_rig_with_a_camera_has_not():
    assert not [said for said in ENDING_TEXTS.values() if "screen" in said]
