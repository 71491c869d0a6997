"""Tests of `twin.view.recording`."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from rerun.experimental import ViewerClient

from docs.screenshots import headless
from twin.base.errors import RecordError, ViewError
from twin.run.finished import record_run, run
from twin.run.opened import open_run, open_runs
from twin.scenario import load
from twin.view import recording, viewer
from twin.view.recording import blueprint, write
from twin.view.streams import LINE_TABLES, PLOT_TABLES, TIMELINE_NAME, Batch, signals, telling
from twin.view.viewer import program

PROMISED = (
    "mechanism/base/base",
    "mechanism/cardan/plate/plate",
    "mechanism/cardan/plate/ball/ball",
    "mechanism/cardan/plate/trail",
    "mechanism/cardan/plate/reference_path",
    "mechanism/cardan/cross_phi",
    "mechanism/motor_phi/cam_phi",
    "mechanism/cardan/plate/wheel_phi_disc",
    "mechanism/spring",
    "plate_mm/screen",
    "plate_mm/operating_area",
    "plate_mm/reference_path",
    "plate_mm/reference",
    "plate_mm/ball",
    "plate_mm/estimate",
    "plate_mm/measured",
    "plate_mm/trail",
    "position_x_mm/reference",
    "position_y_mm/ball",
    "error_mm/distance",
    "angle_deg/phi",
    "rate_deg_per_s/theta",
    "effort_rad_per_s2/phi",
    "estimation_error_mm/x",
    "delay_ms/age",
    "wheel_force_N/wheel_phi",
    "torque_Nm/torque_theta",
    "states/supervisor",
    "states/ball",
    "states/screen",
    "states/effort",
    "states/wheels",
    "events",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    chosen = load(
        "circle",
        ("duration=1.2", "metrics.start=0", "baseline=false", "plant.surface.spread_percent=30"),
    )
    place = tmp_path_factory.mktemp("runs") / "circle"
    record_run(run(chosen), place)
    return place


def numbers(printed, path, entity, part):
    """The numbers of the only component of an entity that is called so."""
    text = printed(path, "-vvv", "--entity", entity)
    cells = [line.split("┆") for line in text.splitlines() if re.search("RowId|row_", line)]
    (found,) = (v for name, v in zip(*cells, strict=True) if part in name)
    return [float(each) for each in re.findall(r"-?[\d.]+", found)]


def test_a_recording_holds_everything_promised_on_one_time_line(folder, tmp_path, printed):
    write(tmp_path / "view.rrd", open_run(folder))
    text = printed(tmp_path / "view.rrd")
    missing = [entity for entity in PROMISED if f"/circle/{entity}" not in text]
    assert missing == []
    assert "log_time" not in text
    assert "log_tick" not in text
    command = [str(program()), "rrd", "verify", str(tmp_path / "view.rrd")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def drawn(tmp_path, printed):
    """Draws a moment of a circle: all that is printed of it, its root, numbers of its entities."""

    def draw(*settings):
        path, about = tmp_path / "view.rrd", (*settings, "duration=0.1", "metrics.start=0")
        write(path, [run(load("circle", about))])
        text = printed(path)
        (root,) = set(re.findall(r"(/\S+)/mechanism/base/base", text))
        return text, root, lambda entity, part: numbers(printed, path, f"{root}/{entity}", part)

    return draw


MECHANISM = ("motor_phi", "motor_theta", "spring", "wheel_", "cam_", "shaft_", "spring_anchor")


@pytest.mark.long
def test_a_plate_of_another_size_is_drawn_without_what_only_the_thesis_has(drawn):
    settings = ("parameters=course", "plant.linkage.crank_mm=[0,0]", "rig.cams=table")
    text, root, of = drawn(*settings)

    def half(entity):
        return pytest.approx(of(entity, "half_sizes"), abs=1e-6)

    plate = "mechanism/cardan/plate"
    assert half(f"{plate}/plate") == [0.15, 0.1, 0.005]
    assert half(f"{plate}/area_front") == [0.12, 0.001, 0.0002]
    assert half(f"{plate}/area_left") == [0.001, 0.08, 0.0002]
    assert half("plate_mm/screen") == [150, 100]
    assert half("plate_mm/operating_area") == [120, 80]
    assert [each for each in MECHANISM if f"{root}/mechanism/{each}" in text] == []
    assert [each for each in MECHANISM if f"{root}/{plate}/{each}" in text] == []
    assert f"{root}/mechanism/base/post" in text


@pytest.mark.short("lagrange")
@pytest.mark.parametrize("kind", ["lagrange", "mujoco"])
def test_a_plate_on_rods_is_drawn_with_them(drawn, kind):
    text, *_ = drawn("parameters=course", f"plant.kind={kind}")
    for each in ("rod_phi", "rod_theta", "motor_phi/crank_phi", "cardan/plate/arm_theta"):
        assert f"/mechanism/{each}" in text
    assert not re.search(r"/mechanism/\S*(spring|wheel|cam_)", text)


@pytest.mark.short("rig1-*")
@pytest.mark.parametrize(
    ("rig", "thick"),
    [
        (("parameters=hobby",), 0.01),
        (("parameters=course", "plant.size=[0.3,0.3]"), 0.003),
        (("parameters=course", "plant.size=[0.3,0.3]", "plant.kind=mujoco"), 0.003),
    ],
)
def test_a_round_plate_is_drawn_round(drawn, rig, thick):
    _, _, of = drawn(*rig, "rig.limits.area=[0.1,0.1]", "plant.shape=round")
    assert of("mechanism/cardan/plate/plate", "radii") == pytest.approx([0.15])
    assert of("mechanism/cardan/plate/plate", "lengths") == pytest.approx([thick])
    rim = np.reshape(of("plate_mm/screen", "strips")[:8], (-1, 2))  # the rest is cut short
    assert np.hypot(*rim.T) == pytest.approx(np.full(len(rim), 150), abs=1e-3)


@pytest.mark.long
def test_several_runs_stand_side_by_side_under_names_of_their_own(folder, tmp_path, printed):
    runs = open_runs((folder, folder / "run.parquet"))
    assert [each.name for each in runs] == ["circle", "circle~2"]
    write(tmp_path / "view.rrd", runs)
    text = printed(tmp_path / "view.rrd")
    assert "/circle/position_x_mm/ball" in text
    assert "2/position_x_mm/ball" in text


def test_a_recording_that_cannot_be_written_leaves_nothing(folder, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match="cannot write"):
        write(tmp_path / "file" / "view.rrd", open_run(folder))


def test_without_a_display_a_window_is_refused_in_one_line(monkeypatch):
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ViewError, match="no display"):
        viewer.window()


def test_a_viewer_that_dies_while_it_loads_is_one_line(monkeypatch, folder):
    class Dying:
        """A viewer without a graphics driver: it answers, and is gone at the first file."""

        def get_state(self):
            return None

        def open(self, _):
            raise ConnectionError("transport error")

    monkeypatch.setattr(ViewerClient, "connect", lambda _: Dying())
    with (
        pytest.raises(ViewError, match="ended by itself; it needs a Vulkan driver"),
        headless(folder / "run.parquet"),
    ):
        pass


def test_a_missing_viewer_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr("rerun_cli.__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(ViewError, match="No such file or directory; reinstall rerun-sdk"):
        viewer.start_viewer()


def test_the_viewer_is_told_to_report_nothing(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    told = viewer.environment()
    assert told["CI"] == "1"
    assert "FORCE_RERUN_ANALYTICS" not in told


@pytest.mark.long
def test_the_viewer_opens_a_recording_without_a_warning_of_our_making(folder, tmp_path):
    write(tmp_path / "view.rrd", open_run(folder))
    try:
        with headless(tmp_path / "view.rrd") as (client, _):
            client.set_time(TIMELINE_NAME, duration=1.0)
            client.save_screenshot(str(tmp_path / "view.png"))
            state = client.get_state()
            warnings = [entry.message for entry in client.get_logs() if entry.level != "INFO"]
    except ViewError as error:
        pytest.skip(str(error))
    ours = [line for line in warnings if "rasterizer" not in line and "examples" not in line]
    assert ours == []
    assert [report for view in state.views for report in view.reports] == []
    assert len(state.views) > 8
    assert os.path.getsize(tmp_path / "view.png") > 10_000  # noqa: PTH202


NO_LINES = ("TextLogView", "StateTimelineView")
"""Views that show words in the colours of the viewer's own theme."""


def views(plan):
    """The views of a blueprint, whatever tabs and columns they are in."""
    found, waiting = [], [plan.root_container]
    while waiting:
        each = waiting.pop()
        inner = getattr(each, "contents", []) if hasattr(each, "kind") else None
        waiting += inner or []
        if inner is None:
            found.append(each)
    return found


def test_of_several_runs_a_plot_has_what_tells_them_apart():
    position = dict.fromkeys(("ball", "estimate", "reference"), np.zeros(2))
    assert [[*telling(position, run)] for run in (0, 1)] == [["ball", "reference"], ["ball"]]


def test_plots_have_legends_and_everything_drawn_brings_its_own_ground():
    plan = blueprint(["/run"], {"angle_deg", "position_x_mm"})
    plots = [each for each in views(plan) if type(each).__name__ == "TimeSeriesView"]
    assert [each.name for each in plots] == ["plate angles [deg]", "x [mm]"]
    assert all("PlotLegend" not in each.properties for each in plots)  # the viewer's own, shown
    brought = {"TimeSeriesView": "PlotBackground"}
    drawn = [each for each in views(plan) if type(each).__name__ not in NO_LINES]
    assert len({type(each).__name__ for each in drawn}) == 3
    for each in drawn:
        ground = each.properties[brought.get(type(each).__name__, "Background")]
        assert len(ground.color.as_arrow_array()) == 1


def test_every_plot_of_columns_has_a_title_and_its_columns_are_those_of_records(folder):
    titles = {entity for tab in PLOT_TABLES.values() for entity in tab}
    assert LINE_TABLES.keys() <= titles
    (opened,) = open_run(folder)
    found = signals(opened.rows, np.zeros((len(opened.rows["time"]), 2)))
    further = {"friction_mm_per_s2", "tilt_gain_percent", "timing_ms"}  # of other observers, rigs
    assert LINE_TABLES.keys() - further <= found.keys()
    phi = found["angle_deg"]["phi"]
    assert phi == pytest.approx(np.degrees(opened.rows["true_phi"]))
    torque = found["torque_Nm"]["torque_theta"]
    assert np.array_equal(torque, opened.rows["torque_theta_Nm"])


@pytest.mark.long
def test_runs_are_drawn_without_the_library_that_reads_a_bus():
    done = subprocess.run(
        [sys.executable, "-c", "import sys, twin.view.recording; print('can' in sys.modules)"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == "False"


def test_no_time_is_cut_to_the_nanosecond_below(monkeypatch):
    sent = []
    take = lambda *_, indexes, **__: sent.append(indexes)  # noqa: E731
    monkeypatch.setattr(recording.rr, "send_columns", take)
    ticks = np.arange(20_000)
    recording.send(None, [Batch("ball", ticks * 0.002, [])])
    ((column,),) = sent
    assert column.as_arrow_array().cast("int64").to_pylist() == (ticks * 2_000_000).tolist()
