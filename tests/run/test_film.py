"""`twin.run.film`.

Moving pictures: what they show is what was recorded, and they are the same each time."""

import os
import subprocess
import sys

import av
import numpy as np
import pytest
from PIL import Image, ImageColor

import ballplate as bp
from twin.base.errors import RecordError
from twin.run import film as film_module
from twin.run.exporters import FILM_SUFFIXES
from twin.run.film import Cut, Film, Stage, moving
from twin.run.finished import Run, record_run, run
from twin.run.picture import RUN_COLOURS
from twin.scenario.load import check, load
from twin.scenario.merging import put

BLUE = np.array(ImageColor.getrgb(RUN_COLOURS[0]))
WHITE = (255, 255, 255)
PLATE = (0.70, 0.395)
TABLES = {
    "title": "told",
    "duration": 4.0,
    "plant": {"kind": "lagrange"},
    "controller": {"kind": "lqr", "rho": 300.0, "kappa": 0.3},
    "reference": {"kind": "hold", "x": 0.2, "y": -0.1},
}


def make_run(ball, tilt=(0.0, 0.0), outcome="finished", rig=(), **metrics):
    """A run whose ball was at places in m, (K, 2), 10 ms apart, on a plate of constant tilt.

    ``rig``: what else its plant is.
    """
    ball = np.asarray(ball, float)
    nothing = np.zeros(len(ball))
    rows = {f"true_{name}": nothing for name in ("x_rate", "y_rate", "phi_rate", "theta_rate")}
    rows |= {"true_x": ball[:, 0], "true_y": ball[:, 1]}
    rows |= {"true_phi": nothing + tilt[0], "true_theta": nothing + tilt[1]}
    rows |= {"reference_x": ball[:, 0], "reference_y": ball[:, 1]}
    rows |= {f"applied_{axis}_acc": nothing for axis in ("phi", "theta")}
    rows["time"] = 0.01 * np.arange(len(ball))
    room = [("rig.limits.area", [0.1, 0.1])] if rig else []
    tables = put(TABLES, [*room, *((f"plant.{key}", value) for key, value in dict(rig).items())])
    return Run("told", check(tables, "test"), rows, metrics={"outcome": outcome, **metrics})


def frames(one, *others, **cut):
    runs = {str(i): each for i, each in enumerate((one, *others))}
    return [
        np.asarray(frame.convert("RGB")).astype(int) for frame in Film(runs, Cut(**cut)).frames()
    ]


def whole(mask):
    """Left, top, right and bottom edge of what is marked, in pixels."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return columns[0], rows[0], columns[-1] + 1, rows[-1] + 1


def ground(picture):
    """The plate by its white: left, top, right and bottom edge in pixels, with its rim."""
    size = picture.shape[1] / 600
    white = (picture == WHITE).all(axis=2)
    left, _, right, _ = whole(white[int(150 * size) : int(170 * size), : int(518 * size)])
    column = white[:, left + 10]
    inner = int(200 * size)
    top = inner - int(np.argmin(column[inner::-1]))
    bottom = inner + int(np.argmin(column[inner:]))
    return left - 1, top, right + 1, bottom + 1


def find_colour(picture, colour=BLUE):
    """The middle of all of a colour on the plate in m, found by the plate's own edges."""
    left, top, right, bottom = ground(picture)
    part = picture[top:bottom, left:right]
    rows, columns = np.nonzero(np.abs(part - colour).max(axis=2) <= 4)
    # its edges are in the middle of the rim
    x = columns.mean() / (right - left - 1) - 0.5
    y = 0.5 - rows.mean() / (bottom - top - 1)
    return np.array((x, y)) * PLATE, len(rows)


PLACES = [(0.0, 0.0), (0.21, 0.0), (0.0, 0.12), (-0.25, -0.13), (0.3, 0.1), (0.3017, -0.0503)]


@pytest.mark.short("place0-*", "place6-*")
@pytest.mark.parametrize(("place", "size"), [*((place, 600) for place in PLACES), (PLACES[1], 480)])
def test_the_ball_is_seen_where_it_was_recorded(place, size):
    picture = frames(make_run([place] * 30), size=size, seconds=0.05)[0]  # at rest: without a trail
    left, top, right, bottom = ground(picture)
    assert (right - left) / size == pytest.approx(498 / 600, abs=0.01)
    found, _ = find_colour(picture)
    one = PLATE[0] / (right - left)
    np.testing.assert_allclose(found, place, atol=0.8 * one)
    left, top, right, bottom = whole(
        (picture[..., 2] - picture[..., 0] > 90)[top:bottom, left:right]
    )
    assert (right - left, bottom - top) == pytest.approx((0.04 / one,) * 2, abs=1.5)


@pytest.mark.parametrize("size", [(0.3, 0.3), (0.6, 0.2)])
def test_a_plate_of_another_shape_is_not_stretched(size):
    rig = {"size": size, "ball": {"radius": 0.03, "inertia": 1e-6}}
    picture = frames(make_run([(0.1, 0.05)] * 30, rig=rig), seconds=0.05)[0]
    left, top, right, bottom = whole(np.abs(picture[100:390, :520] - BLUE).max(axis=2) <= 4)
    assert right - left == pytest.approx(bottom - top, abs=1.5)
    per_metre = min(498 / size[0], 281 / size[1])
    assert right - left == pytest.approx(0.06 * per_metre, abs=1.5)
    assert (left + right) / 2 == pytest.approx(16 + 249 + 0.1 * per_metre, abs=1.5)


@pytest.mark.long
def test_a_round_plate_is_a_circle_and_a_fallen_ball_lies_at_its_rim():
    rig = {"size": (0.3, 0.3), "shape": "round", "ball": {"radius": 0.005, "inertia": 1e-7}}
    rolls = make_run([(0.10, 0.10), (0.12, 0.12)], rig=rig, outcome="fell")
    longer = make_run([(0.0, 0.0)] * 60, rig=rig)
    picture = frames(rolls, longer, since=0.0, until=0.5)[-1]
    per_metre = 281 / 0.3
    _, columns = np.nonzero(np.abs(picture[90:373, 20:510] - BLUE).max(axis=2) <= 60)
    x = (columns.mean() + 20 - (16 + 249)) / per_metre
    assert x == pytest.approx((0.15 - 0.013) / np.sqrt(2), abs=3e-3)
    # the rim cuts each row of the panel where the circle does
    panel = picture[91:372, 17:513]
    middle, dark = panel.shape[0] / 2, (panel.max(axis=2) < 190) & (np.ptp(panel, axis=2) < 30)
    for up in (30, 80, 120):
        (at,) = np.nonzero(dark[round(middle + up)])
        half = np.sqrt((0.15 * per_metre) ** 2 - up**2)
        assert np.ptp(at) == pytest.approx(2 * half, abs=5)


def test_the_ball_moves_from_frame_to_frame_as_recorded():
    time = 0.01 * np.arange(301)
    way = np.stack((0.2 * np.sin(2 * time), 0.1 * np.cos(time)), axis=1)
    film = Film({"a": make_run(way)}, Cut(since=0.5, until=2.5, seconds=0.5))
    assert film.count == 10
    for at, picture in zip(film.times, film.frames(), strict=True):
        found, _ = find_colour(np.asarray(picture.convert("RGB")).astype(int))
        expected = (0.2 * np.sin(2 * at), 0.1 * np.cos(at))
        np.testing.assert_allclose(found, expected, atol=2e-3)


@pytest.mark.short("phi-1", "theta--1")
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", ["phi", "theta"])
def test_a_positive_phi_lowers_the_right_end_and_a_positive_theta_raises_the_far_one(axis, sign):
    tilt = (0.03 * sign, 0.0) if axis == "phi" else (0.0, 0.03 * sign)
    picture = frames(make_run([(0.0, 0.0)] * 9, tilt), seconds=0.05)[0]
    _, top, right, bottom = ground(picture)
    blue = np.abs(picture - BLUE).max(axis=2) <= 4
    if axis == "phi":  # in the view from the front
        down, along = np.nonzero(blue[bottom + 5 : bottom + 75, :right])
    else:  # in the view from the right, where outwards is downwards
        along, down = np.nonzero(blue[top:bottom, right + 5 :])
    first, last = down[along < along.min() + 9].mean(), down[along > along.max() - 9].mean()
    assert (last - first) * sign > 0


@pytest.mark.long
def test_balls_in_one_place_are_all_seen_in_their_colours():
    picture = frames(*[make_run([(0.1, 0.05)] * 9)] * 6, seconds=0.05)[0]
    for colour in RUN_COLOURS[1:6]:
        found, pixels = find_colour(picture, ImageColor.getrgb(colour))
        assert pixels > 20
        np.testing.assert_allclose(found, (0.1, 0.05), atol=2e-3)


def test_one_sample_is_one_frame_that_lasts_one_period(tmp_path):
    film = Film({"one": make_run([(0.1, 0.1)])}, Cut(fps=10))
    assert film.count == 1
    moving(tmp_path / "one.webp", film)
    with Image.open(tmp_path / "one.webp") as picture:
        assert picture.size == film.size


def test_a_ball_that_fell_is_a_cross_where_it_was_seen_last_while_the_others_go_on():
    fell = make_run([(0.1 + 0.02 * k, 0.0) for k in range(10)], outcome="fell")
    goes = make_run([(-0.1, 0.1)] * 200)
    first, *_, last = frames(fell, goes, fps=5)
    assert find_colour(first)[0][0] == pytest.approx(0.1, abs=0.02)
    found, pixels = find_colour(last)
    assert 20 < pixels < 200
    np.testing.assert_allclose(found, (0.28, 0.0), atol=2e-3)


@pytest.mark.long
def test_where_nothing_is_known_nothing_is_drawn_and_the_rest_is():
    ball = np.full((200, 2), np.nan)
    ball[:50] = ball[150:] = (-0.1, 0.05)
    shown = frames(make_run(ball), fps=5)
    assert len(shown) == 10
    assert find_colour(shown[0])[1] > 300
    left, top, right, bottom = ground(shown[5])
    assert not (np.abs(shown[5][top:bottom, left:right] - BLUE).max(axis=2) <= 4).any()
    assert find_colour(shown[-1])[1] > 300
    assert len(frames(make_run(np.full((30, 2), np.nan)), fps=10)) == 3


CIRCLE = ("plant.kind=lagrange", "duration=0.6", "metrics.start=0")


@pytest.fixture(scope="module")
def circle():
    return run(load("circle", CIRCLE))


@pytest.mark.short(".gif")
@pytest.mark.parametrize("ending", FILM_SUFFIXES)
def test_frames_and_duration_are_as_stated_and_the_bytes_are_the_same_twice(
    circle, tmp_path, ending
):
    one, two = (tmp_path / f"{name}{ending}" for name in ("one", "two"))
    for file in (one, two):
        film = Film({"circle": circle}, Cut(fps=30, seconds=0.5, size=300))
        moving(file, film)
    assert one.read_bytes() == two.read_bytes()
    if ending == ".mp4":
        with av.open(str(one)) as video:
            shapes = [frame.to_ndarray(format="rgb24").shape for frame in video.decode(video=0)]
            assert video.streams.video[0].average_rate == 30
        assert shapes == [(film.size[1] // 2 * 2, 300, 3)] * 15
        return
    with Image.open(one) as picture:
        assert picture.n_frames == 15
        assert picture.info["loop"] == 0
        lasts = []
        for number in range(picture.n_frames):
            picture.seek(number)
            picture.load()
            lasts.append(picture.info["duration"])
    assert sum(lasts) == pytest.approx(500)


def test_an_mp4_shows_what_the_frames_do_and_names_the_extra_it_needs(
    circle, tmp_path, monkeypatch
):
    film = Film({"circle": circle}, Cut(seconds=0.2, size=301))
    moving(tmp_path / "a.mp4", film)
    (first, *_) = film.frames()
    with av.open(str(tmp_path / "a.mp4")) as video:
        frame = next(video.decode(video=0)).to_ndarray(format="rgb24").astype(int)
    wide, high = 300, film.size[1] // 2 * 2
    drawn = np.asarray(first.convert("RGB"), int)[:high, :wide]
    assert frame.shape == drawn.shape
    assert np.abs(frame - drawn).mean() < 3
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(
        RecordError, match=r"needs the extra video: pip install 'ballplate\[video\]'"
    ):
        moving(tmp_path / "b.mp4", film)
    assert not (tmp_path / "b.mp4").exists()


@pytest.mark.long
def test_the_mechanism_in_3d_shows_ball_and_tilt_or_says_what_it_needs(circle):
    try:
        stage = Stage(circle, (640, 360))
    except RecordError as error:
        pytest.skip(str(error))
    level = np.zeros(2)

    def orange(ball, tilt):
        picture = np.asarray(stage.drawn(np.array(ball), tilt, np.zeros((0, 2))), int)
        red, green, blue = np.moveaxis(picture, -1, 0)
        rows, columns = np.nonzero((red > 150) & (green > 80) & (blue < 60))
        return np.array((columns.mean(), rows.mean())) if len(rows) else None

    middle, right, far = (orange(at, level) for at in ((0, 0), (0.15, 0), (0, 0.1)))
    assert right[0] > middle[0] + 20
    assert far[1] < middle[1] - 5
    # a positive phi lowers the right end, a positive theta raises the far one
    assert orange((0.15, 0), np.array((0.1, 0)))[1] > right[1] + 2
    assert orange((0, 0.1), np.array((0, 0.1)))[1] < far[1] - 2
    assert orange((np.nan, np.nan), level) is None


@pytest.mark.parametrize("tilt", [(0, 0), (0.15, -0.1)])
def test_in_3d_the_path_lies_on_the_plate_without_a_gap(circle, tilt):
    try:
        stage = Stage(circle, (640, 360))
    except RecordError as error:
        pytest.skip(str(error))
    path = np.stack((np.linspace(-0.2, 0.2, 150), np.full(150, -0.05)), axis=1)

    def shown(ball, path):
        return np.asarray(stage.drawn(np.array(ball), np.array(tilt), path), int)

    bare = shown((np.nan, np.nan), path[:0])

    def columns_changed(picture):
        return np.unique(np.nonzero(np.abs(picture - bare).max(axis=2) > 40)[1])

    # balls at its ends show where it begins and ends
    begin, end = (columns_changed(shown(path[k], path[:0])).mean() for k in (0, -1))
    covered = columns_changed(shown((np.nan, np.nan), path))
    assert covered[[0, -1]] == pytest.approx((begin, end), abs=6)
    assert (np.diff(covered) == 1).all()


def test_in_3d_cranks_stand_where_their_rods_have_their_lengths():
    keys = ("parameters=course", "duration=0.1", "metrics.start=0")
    try:
        stage = Stage(run(load("circle", keys)), (64, 48))
    except RecordError as error:
        pytest.skip(str(error))
    stage.drawn(np.zeros(2), np.array((0.15, -0.1)), np.zeros((0, 2)))
    assert stage._data.ten_length == pytest.approx([0.09, 0.09], rel=1e-5)


def test_without_opengl_a_picture_in_3d_is_one_line(circle, monkeypatch):
    def missing(name):
        raise AttributeError(f"{name} is not there")

    monkeypatch.setattr(film_module, "import_module", missing)
    words = (
        r"^render mujoco: needs EGL or OSMesa \(libegl1 or libosmesa6\) \(egl: mujoco.egl is not"
    )
    with pytest.raises(RecordError, match=words):
        Film({"circle": circle}, Cut(seconds=0.1, render="mujoco"))


@pytest.mark.parametrize(
    ("cut", "words"),
    [
        ({"fps": 0}, "fps 0: must be from 1 to 50"),
        ({"size": 10}, "size 10: must be from 300 to 1200"),
        ({"seconds": float("nan")}, "seconds nan: must be from"),
        ({"since": 9.0}, "since 9, until 0.598 s: must be within 0 to 0.598 s"),
        ({"since": float("nan")}, "must be within"),
        ({"since": 0.4, "until": 0.2}, "since 0.4, until 0.2 s"),
        ({"until": 2.0}, "since 0, until 2 s"),
        ({"seconds": 1000.0}, "20000 frames: at most 2000"),
    ],
)
def test_what_no_picture_can_be_is_refused(circle, cut, words):
    with pytest.raises(RecordError, match=words):
        Film({"circle": circle}, Cut(**cut))


def test_more_runs_than_colours_are_refused(circle):
    with pytest.raises(RecordError, match="7 runs: at most 6"):
        Film({str(i): circle for i in range(7)}, Cut())


@pytest.mark.long
def test_a_run_is_shown_beside_a_run(circle, tmp_path, ballplate):
    record_run(circle, tmp_path / "runs" / "circle")
    code, out, _ = ballplate(
        "export", "last", "a.webp", "--beside", "runs/circle",
        "--from", "0.2", "--to", "0.4", "--fps", "10", "--size", "300",
    )  # fmt: skip
    assert (code, out) == (0, "written to a.webp\n")
    with Image.open("a.webp") as picture:
        assert (picture.n_frames, picture.size[0]) == (2, 300)
    again = bp.load("runs/circle")
    assert again.export("b.gif", seconds=0.2).is_file()


def test_what_export_cannot_do_is_one_line_and_writes_nothing(circle, tmp_path, ballplate):
    record_run(circle, tmp_path / "made")
    (tmp_path / "there").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for line, words in {
        "there": "there: unknown ending; known: .csv, .mat, .parquet, .mcap",
        "a.csv --render mujoco": "are of moving pictures",
        "a.csv --fps 10": "are of moving pictures",
        "a.csv --beside made": "are of moving pictures",
        "a.webp --fps 99": "fps 99: must be from 1 to 50",
        "a.webp --from 3": "must be within 0 to 0.598 s",
        "a.webp --beside no": "no: no such run folder",
        "a.webp --beside cure": "cure is a scenario, not a run",
        "a.webp --beside log.csv": "log.csv: a log, not a run",
        "made/run.parquet/a.webp": "a file is where a folder should be",
    }.items():
        code, out, err = ballplate("export", "made", *line.split())
        assert (code, out) == (2, ""), line
        (told,) = [text for text in err.splitlines() if text.startswith("ballplate: ")]
        assert words in told
        assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.long
def test_neither_a_screen_nor_opengl_is_needed(circle, tmp_path):
    record_run(circle, tmp_path / "made")
    program = "import sys; from twin.cli import main\ntry: main(sys.argv[1:])\n"
    program += "finally: print(*sys.modules)"
    quiet = {name: text for name, text in os.environ.items() if "DISPLAY" not in name}
    done = subprocess.run(
        [sys.executable, "-c", program, "export", "made", "a.webp", "--seconds", "0.1"],
        cwd=tmp_path, env=quiet, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (tmp_path / "a.webp").is_file(), done.stderr
    assert not {"OpenGL", "glfw", "matplotlib.pyplot", "rerun"} & set(done.stdout.split())


@pytest.mark.long
def test_eight_seconds_of_three_runs_are_at_most_one_and_a_half_megabytes(tmp_path):
    done = bp.run("circle", beside="cure")
    assert len(done.shown) == 3
    file = done.export(tmp_path / "a.webp", since=2, until=10)
    assert file.stat().st_size < 1.5e6
