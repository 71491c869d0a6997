"""`twin.scenario.schema`: rigs of one axis, from their scenario to what is shown of a run."""

import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import ballplate as bp
from controllers.references import Circle, Hold, Lissajous, Sine, closed_form
from twin.base.errors import RecordError, ScenarioError
from twin.base.followers import FOLLOWER_LABELS
from twin.play.driven import Driven
from twin.run.controller_building import build_reference
from twin.scenario.derived import clean
from twin.scenario.load import check, load, read, resolve
from twin.view.html import html
from twin.view.streams import signals

TUBE = {"parameters": "tube", "duration": 1.0, "metrics.start": 0.0}
SHARE = 0.03 / 0.25
"""By which the tube makes lengths smaller."""
SHAKEN = {
    "plant.servo.vibration": 2.0,
    "disturbance.variance": [1e-3, 1e-3],
    "sensors.encoders.variance": [1e-7, 1e-7],
    "sensors.touch.variance": [1e-6, 1e-6],
}
"""What disturbs both axes of a plate."""


def test_what_is_set_across_a_tube_changes_nothing():
    across = {"plant.level_deg": [0.3, 0.5], "plant.start.y": 0.02, "plant.start.y_rate": 0.1}
    level = bp.run("line", TUBE | {"plant.level_deg": [0.3, 0.0]})
    askew = bp.run("line", TUBE | across)
    assert level["true_x"].tolist() == askew["true_x"].tolist()
    assert not askew.rows["true_y"].any()


@pytest.mark.parametrize("law", ["lqr", "pid"])
def test_of_a_tube_the_second_axis_stays_at_rest_whatever_disturbs_it(law):
    done = bp.run("step", TUBE | SHAKEN | {"controller.kind": law, "seed": 3})
    assert done.outcome == "finished"
    still = ("true_y", "true_y_rate", "true_theta", "true_theta_rate")
    for name in (*still, "measured_y", "measured_theta", "applied_theta_acc"):
        assert not done.rows[name].any()
    assert done.rows["true_phi"].any()
    assert done.rows["measured_x"].any()


def test_a_tube_is_the_x_axis_of_a_plate():
    """Where nothing is done along y, the devices are the same, and no friction joins the axes."""
    quiet = {
        "parameters": "tube",
        "reference.y": 0.0,
        "plant.friction.rolling_mm": 0.0,
        "sensors.encoders.counts": 0,
        "sensors.touch.variance": [0.0, 0.0],
        "sensors.touch.grid": 0,
        "duration": 1.0,
    }
    one = bp.run("step", quiet)
    both = bp.run("step", quiet | {"plant.axes": 2})
    assert one["true_x"] == pytest.approx(both["true_x"], abs=1e-12)
    assert one["true_phi"] == pytest.approx(both["true_phi"], abs=1e-12)
    assert np.ptp(one["true_x"]) > 0.001


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            {"plant.kind": "mujoco"},
            f"plant.axes: {FOLLOWER_LABELS['mechanism']} is a plate that tilts about",
        ),
        ({"plant.axes": 3}, "plant.axes: must be 1 or 2, got 3"),
        ({"plant.shape": "round", "plant.size": [0.1, 0.1]}, "plant.shape: must be 'rectangle'"),
        ({"plant.start.spin": 1.0}, "plant.start.spin: leave it out with plant.axes = 1"),
        ({"plant.camber": [0.0, 0.1]}, "plant.camber.1: leave it out"),
        ({"plant.surface.slope_deg": 0.1}, "plant.surface.slope_deg: leave it out"),
        ({"plant.surface.height_um": [[0, 9], [9, 0]]}, "plant.surface.height_um: leave it out"),
        ({"sensors.touch.rotation_deg": 1.0}, "sensors.touch.rotation_deg: must be 0 with"),
        ({"rig.cam_coupling_percent": 1.0}, "rig.cam_coupling_percent: must be 0 with"),
        ({"rig.limits.area": [0.06, 0.02]}, "rig.limits.area: the plate's half is 0.05 m"),
        ({"plant.rim.size": [0.08, 0.01]}, "plant.rim.size.1: leave it out with plant.axes = 1"),
        ({"plant.start.x": 0.045}, "plant.start.x: walls let the ball's middle go 0.04 m"),
    ],
)
def test_what_a_rig_of_one_axis_cannot_have_is_refused_in_one_line(settings, said):
    with pytest.raises(ScenarioError) as refused:
        load(
            "hold", ["parameters=tube", *(f"{key}={json.dumps(settings[key])}" for key in settings)]
        )
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "reference", "title"),
    [
        (
            "circle",
            Circle(amplitude=0.15 * SHARE, omega=0.75),
            "Circle of 18 mm at 0.75 rad/s, along x",
        ),
        ("step", Hold(x=0.15 * SHARE), "Step to 18 mm, along x"),
        ("sine", Sine(amplitude=0.15 * SHARE, omega=0.5), "Sine, 18 mm at 0.5 rad/s, along x"),
        (
            "line",
            Lissajous(amplitude=0.15 * SHARE, omega=(1.0, 1.0), phase=0.0),
            "Sine of 18 mm along x at 1 rad/s",
        ),
    ],
)
def test_on_a_tube_a_reference_is_what_it_is_along_x(name, reference, title):
    scenario = load(name, ["parameters=tube"])
    time = np.linspace(0, 20, 401)
    motion = build_reference(scenario)(time)
    assert motion[..., 0] == pytest.approx(reference(time)[..., 0], abs=1e-15)
    assert not motion[..., 1].any()
    assert scenario.title == title


@pytest.mark.parametrize(
    ("name", "settings", "title"),
    [
        ("circle", ["reference.amplitude=0.05"], "Circle of 50 mm at 0.75 rad/s"),
        ("circle", ["reference.omega=1"], "Circle of 150 mm at 1 rad/s"),
        ("step", ["reference.x=0.1", "reference.y=0.05"], "Step to (100, 50) mm"),
        ("step", ["reference.x=0.1"], "Step to (100, 150) mm"),
        (
            "sine",
            ["reference.amplitude=[0.1, 0.05]"],
            "Sine on both axes, (100, 50) mm at 0.5 rad/s",
        ),
        ("thesis/9_1", ["reference.end=[0.1, 0.1]"], "LQR, step to (100, 100) mm"),
        ("line", ["reference.amplitude=[0.05,0]"], "Sine of 50 mm along x at 1 rad/s"),
        ("line", ["reference.amplitude=[0,0.05]"], "Sine of (0, 50) mm at 1 rad/s"),
        ("line", ["reference.amplitude=[0.1,0.1]"], "Sine of 100 mm at 1 rad/s"),
        ("line", ["reference.omega=[2,2]"], "Sine of 150 mm along x at 2 rad/s"),
        ("line", ["reference.omega=[2,3]"], "Sine of 150 mm along x at (2, 3) rad/s"),
        ("sine", ["reference.amplitude=[0.1,0]"], "Sine, (100, 0) mm at 0.5 rad/s"),
        ("step", ["reference.x=-0.1"], "Step to (-100, 150) mm"),
        ("step", ["parameters=hobby", "reference.x=0.1"], "Step to (100, 60) mm"),
        (
            "circle",
            ["parameters=hobby", "reference.amplitude=0.05"],
            "Circle of 50 mm at 0.75 rad/s",
        ),
        (
            "circle",
            ["parameters=hobby", "reference.omega=1"],
            "Circle of 150 mm at 1 rad/s, lengths x 0.4",
        ),
        ("step", ["parameters=tube", "reference.x=0.1"], "Step to 100 mm, along x"),
        (
            "sine",
            ["parameters=tube", "reference.amplitude=0.02"],
            "Sine, 20 mm at 0.5 rad/s, along x",
        ),
        ("line", ["parameters=tube", "reference.omega=[2,2]"], "Sine of 18 mm along x at 2 rad/s"),
        ("hold", ["reference.x=0.1"], "Hold"),
        ("hold", ["parameters=hobby"], "Hold on the centre"),
        ("circle", ["reference.amplitude=0.05", "title=A"], "A"),
        ("circle", ["duration=20"], "Circle of 150 mm at 0.75 rad/s"),
    ],
)
def test_a_title_states_the_reference_as_it_is_set(name, settings, title):
    assert load(name, settings).title == title


@pytest.mark.parametrize(
    ("name", "settings", "title"),
    [
        ("circle", ["reference.kind=lissajous"], "Lissajous"),
        ("cure", ["reference.kind=hold"], "Hold, friction known"),
        ("sine", ["reference.kind=circle"], "Circle"),
        ("step", ["reference.kind=circle"], "Circle"),
        ("hold", ["reference.kind=circle"], "Circle"),
        ("thesis/9_1", ["reference.kind=circle"], "LQR, circle"),
        ("excite", ["reference.kind=circle"], "Excitation for identification, reference circle"),
        ("thesis/9_1", ["controller.kind=sliding_mode"], "Sliding mode, step to (0.15, 0.15) m"),
        ("thesis/9_3_050", ["controller.kind=lqr"], "LQR and Smith predictor, circle at 0.5 rad/s"),
        ("circle", ["controller.kind=lqr"], "Circle of 150 mm at 0.75 rad/s"),
        ("circle", ["reference.kind=circle"], "Circle of 150 mm at 0.75 rad/s"),
        ("circle", ["reference.kind=hold", "title=A circle"], "A circle"),
    ],
)
def test_a_title_names_the_reference_and_the_law_that_are_set(name, settings, title):
    assert load(name, settings).title == title


def test_a_number_too_large_for_a_title_is_refused_in_one_line():
    with pytest.raises(ScenarioError, match=r"\A.*reference\.omega: must be a finite number.*\Z"):
        check(*resolve(*read("circle"), [("reference.omega", 10**400)]))


def test_a_title_without_lengths_states_the_factor_and_another_length_stays():
    excite = load("excite", ["parameters=tube"])
    assert excite.title == f"Excitation for identification, lengths x {SHARE:g}, along x"
    own = load("circle", ["parameters=tube", 'title="Circle of 150 mm"'])
    assert own.title == "Circle of 150 mm"


@pytest.mark.parametrize("name", ["circle", "step", "sine"])
def test_for_a_board_a_reference_is_what_it_is_along_x(name):
    """The first piece of a closed form holds before its start, too: nothing of it is along y."""
    form = closed_form(build_reference(load(name, ["parameters=tube"])))
    assert not form.offsets[:, 1].any()
    assert not form.terms[..., 1].any()
    whole = closed_form(build_reference(load(name, ["parameters=tube", "plant.axes=2"])))
    assert form.offsets[:, 0].tolist() == whole.offsets[:, 0].tolist()
    if form.harmonic is not None:
        assert not np.stack((form.harmonic.sine, form.harmonic.cosine))[..., 1].any()
        assert form.harmonic.sine[:, 0].tolist() == whole.harmonic.sine[:, 0].tolist()


def test_a_scenario_made_for_one_axis_is_not_said_to_lose_one():
    one = load("circle", ["plant.axes=1", "plant.kind=lagrange"])
    assert one.title == load("circle").title
    assert not build_reference(one)(np.linspace(0, 9, 99))[..., 1].any()


def test_the_clean_model_of_a_tube_has_one_axis_and_no_walls():
    model = clean(load("circle", ["parameters=beam", "reference.amplitude=0.05"]))
    assert model.plant.axes == 1
    assert model.plant.rim.size == (0.0, 0.0)
    assert not build_reference(model)(np.linspace(0, 20, 99))[..., 1].any()


def test_what_a_scenario_starts_with_along_y_is_left_out_on_a_tube():
    tables, _ = read("hold")
    tables["plant"] = {"start": {"x": 0.1, "y": 0.05, "y_rate": 0.2}}
    found = check(*resolve(tables, "t", [("parameters", "tube")]))
    assert (found.plant.start.x, found.plant.start.y) == (pytest.approx(0.1 * SHARE), 0.0)


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """A run on a tube, in a folder."""
    folder = tmp_path_factory.mktemp("one") / "line"
    done = bp.run("line", {"parameters": "tube"}, duration=1.5)
    done.save(folder)
    return folder


def of_y(names):
    """Those of some names that are of y or theta."""
    return [name for name in names if {"y", "theta"} & set(name.split("_"))]


@pytest.mark.long
def test_the_second_axis_is_in_no_column_table_or_indicator(line, tmp_path):
    names = pq.read_schema(line / "run.parquet").names
    assert "true_x" in names
    assert of_y(names) == []
    metrics = json.loads((line / "metrics.json").read_text("utf-8"))
    assert metrics["theta_max_deg"] is metrics["u2_max"] is None
    assert metrics["phi_max_deg"] > 0
    opened = bp.load(line)
    assert opened.metrics == bp.run("line", {"parameters": "tube", "duration": 1.5}).metrics
    assert of_y(opened) == []
    assert "measured_y" not in opened
    assert len(opened) == len(names)
    with pytest.raises(RecordError, match="no column 'measured_y'"):
        opened["measured_y"]
    for name in ("line.csv", "line.mat", "line.parquet"):
        opened.export(tmp_path / name)
    assert of_y(each.split(" ")[0] for each in pd.read_csv(tmp_path / "line.csv").columns) == []
    assert of_y(pq.read_schema(tmp_path / "line.parquet").names) == []


def test_an_opened_run_of_one_axis_is_the_run_that_was_made(line):
    opened = bp.load(line)
    made = bp.run("line", {"parameters": "tube", "duration": 1.5})
    assert opened.motion.ball.tolist() == made.motion.ball.tolist()
    assert opened.motion.u.tolist() == made.motion.u.tolist()
    assert set(opened.rows) >= {"true_y", "measured_theta", "applied_theta_acc"}


@pytest.mark.long
def test_its_picture_has_neither_plate_nor_y(line):
    opened = bp.load(line)
    figure = opened.plot()
    titles = [panel.get_title() for panel in figure.axes]
    assert titles == [
        "Tracking error",
        "Position (dotted: reference)",
        "Angle φ",
        "Angular acceleration",
    ]
    assert [len(panel.lines) for panel in figure.axes[2:]] == [1, 1]
    walls = [each.get_ydata()[0] for each in figure.axes[1].lines[:2]]
    assert walls == pytest.approx([-40, 40])
    opened.plot("angle")
    with pytest.raises(ScenarioError, match="panel 'y': a rig of one axis has none"):
        opened.plot("y")


@pytest.mark.long
def test_its_report_and_its_sentences_speak_of_x_alone(line):
    page = html([bp.load(line)])
    assert "RMS over x from" in page
    for words in ("x and y", "theta", "dashed"):
        assert words not in page.partition("<svg")[0]


@pytest.mark.long
def test_of_a_ball_that_left_the_area_one_number_is_given():
    kicked = {"parameters": "beam", "plant.start.x_rate": 0.5, "rig.limits.margin": 0.0}
    done = bp.run("hold", kicked)
    assert done.metrics["reason"].startswith("ball at 0.0")
    assert done.metrics["reason"].endswith(" m left the area")


def test_the_lines_of_its_view_are_of_x_alone(line):
    opened = bp.load(line)
    plots = signals(opened.rows, opened.motion.reference, axes=1)
    assert {"position_x_mm", "error_mm", "angle_deg", "rate_deg_per_s"} <= plots.keys()
    assert "position_y_mm" not in plots
    assert of_y(name for lines in plots.values() for name in lines) == []


def test_a_person_drives_it_along_x_alone():
    driven = Driven.begun(load("hold", ["parameters=tube"])).goal(0.5, 0.02, 0.01)
    driven = driven.push(0.6, 0.1, -0.2)
    assert driven.goals.points[-1][1:] == (0.02, 0.0)
    assert driven.pushes == ((0.6, 0.1, 0.0),)
    assert not driven.reference(np.linspace(0, 5, 51))[..., 1].any()
    circled = Driven.begun(load("circle", ["parameters=tube"])).goal(0.5, 0.02, 0.01)
    assert not circled.reference(np.linspace(0, 5, 51))[..., 1].any()
    assert circled.reference(5.0)[0, 0] == pytest.approx(0.02, abs=1e-3)


def test_the_page_on_which_it_is_driven_has_no_second_axis():
    page = pytest.importorskip("twin.play.page", reason="no nicegui")
    tables = load("hold", ["parameters=tube"]).model_dump(mode="json")
    labels = [each.label for each in page.sliders(tables)]
    assert "tilted base, along x" in labels
    assert "tilted base, along y" not in labels
    assert [len(each["curves"]) for each in page.strips_of(1)] == [2, 1, 1]
    assert [len(each["curves"]) for each in page.strips_of(2)] == [2, 2, 1]
