"""Tests of `twin.run.picture`."""

import math
from dataclasses import replace
from io import BytesIO
from unittest import mock

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from twin.base.errors import ScenarioError
from twin.run import picture as pictures
from twin.run.metrics import Motion
from twin.run.picture import (
    LEAST_ERROR,
    LOOK_COUNT,
    NO_GLYPH_WARNING,
    PANEL_PLACES,
    REFERENCE_STYLE,
    RUN_COLOURS,
    STRIP_HEIGHT,
    PaperFigure,
    picture,
)
from twin.scenario.schema import Dimensions

TIME = np.arange(0.0, 4.0, 0.01)
PLATE = Dimensions((0.7, 0.395), (0.25, 0.15), 0.02)


def motion(radius=0.1, error=0.01, time=TIME, effort=0.0):
    """A ball that runs in a circle, off its reference by an error along x."""
    reference = radius * np.stack([np.cos(time), np.sin(time)], axis=1)
    return Motion(
        time=time,
        ball=reference + np.array([error, 0.0]),
        reference=reference,
        plate=np.zeros((len(time), 2)),
        u=np.full((len(time), 2), effort),
    )


def draw_picture(plate=PLATE, **runs):
    with mock.patch.object(Figure, "draw_without_rendering"):  # what is in it, not how it looks
        figure = picture(runs, "", plate)
    return figure, {panel.get_title().split(" (")[0]: panel for panel in figure.axes}


def words(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def references(panel):
    return [
        line
        for line in panel.lines
        if line.get_zorder() == REFERENCE_STYLE["zorder"] and len(line.get_xdata())
    ]


def test_a_reference_of_all_runs_is_drawn_once_as_long_as_the_longest():
    figure, panels = draw_picture(long=motion(), short=motion(error=0.02, time=TIME[:100]))
    (line,) = references(panels["Ball on the plate, from above"])
    assert line.get_color() == "black"
    assert len(line.get_xdata()) == len(TIME)
    assert words(figure).count("reference") == 1


def test_runs_with_references_of_their_own_show_each():
    figure, panels = draw_picture(wide=motion(0.1), narrow=motion(0.05))
    assert sum("reference" in text for text in words(figure)) == 1
    first, second = references(panels["Ball on the plate, from above"])
    assert np.abs(first.get_xdata()).max() == pytest.approx(100)
    assert np.abs(second.get_xdata()).max() == pytest.approx(50)
    in_time = [line for line in panels["Position"].lines if line.get_zorder() == first.get_zorder()]
    assert [np.abs(line.get_ydata()).max() for line in in_time] == [
        pytest.approx(100),
        pytest.approx(50),
    ]


def test_the_legend_has_the_runs_that_can_be_told_apart():
    runs = {f"lqr kappa={number}": motion(0.01 * number) for number in range(1, 28)}
    figure, panels = draw_picture(**runs)
    curves = panels["Tracking error"].lines
    looks = {(line.get_color(), line.get_linestyle()) for line in curves}
    assert len(looks) == LOOK_COUNT
    assert words(figure)[:LOOK_COUNT] == list(runs)[:LOOK_COUNT]
    assert not {*words(figure)} & {*list(runs)[LOOK_COUNT:]}
    assert words(figure)[LOOK_COUNT].startswith("reference")


@pytest.mark.short("cost $5, $6_2", "__")
@pytest.mark.parametrize("name", ["$\\foo$", "\\frac{", "cost $5, $6_2", "_a", "__", "a$", "x_1^{"])
def test_a_run_s_name_stands_in_the_legend_as_it_was_typed(name):
    figure = picture({name: motion(), "b": motion(0.05)}, name, PLATE)
    assert [each.replace("\\$", "$").strip() for each in words(figure)[:2]] == [name, "b"]
    figure.draw_without_rendering()  # its text is laid out, a formula would be refused


@pytest.mark.long
def test_characters_that_no_font_has_are_boxes_and_one_warning():
    pictures._warn_of_glyphs.cache_clear()
    runs = {"\u7403 \xe9\u03bb": motion(), "b": motion(0.05)}
    with pytest.warns(UserWarning, match="no font in use") as caught:
        figure = picture(runs, "\u4e2d\u6587", PLATE)
    figure.savefig(BytesIO())
    assert [str(each.message) for each in caught] == [NO_GLYPH_WARNING]
    assert words(figure)[0] == "\u25a1 \xe9\u03bb"
    assert figure.get_suptitle() == "\u25a1\u25a1"


@pytest.mark.parametrize(
    ("error", "ended", "top"), [(1e-9, None, LEAST_ERROR), (0.02, None, 21.0), (0.02, 50, 21.0)]
)
def test_the_axis_of_the_error_has_a_floor_and_leaves_out_what_ran_away(error, ended, top):
    run = motion(error=error)
    if ended:
        run.ball[ended:] = np.inf
        run.ball[ended + 10 :] = np.nan
    _, panels = draw_picture(run=run)
    assert panels["Tracking error"].get_ylim() == (0, pytest.approx(top))


def parts(figure):
    """What may not overlap: panels with all their texts, the title of all, the legend."""
    titles = [figure._suptitle] if figure._suptitle else []
    return [
        *(panel.get_tightbbox() for panel in figure.axes),
        *(part.get_window_extent() for part in (*figure.legends, *titles)),
    ]


@pytest.mark.short("many")
@pytest.mark.parametrize(
    ("runs", "title"),
    [
        ({"run": motion()}, "Circle"),
        ({f"controller.kind=lqr,plant.friction.rolling_mm={n}": motion() for n in range(9)}, ""),
        ({"far": motion(error=3e4), "near": motion(1e-5, 1e-9)}, "As long as a title can be " * 12),
        ({"steep": motion(effort=-12345.6)}, "Two lines " * 15),
    ],
    ids=["one", "many", "far", "steep"],
)
def test_no_text_is_cut_or_overlaps_another(runs, title):
    figure = picture(runs, title, PLATE)
    whole = figure.bbox
    boxes = parts(figure)
    for index, box in enumerate(boxes):
        assert whole.x0 <= box.x0 < box.x1 <= whole.x1
        assert whole.y0 <= box.y0 < box.y1 <= whole.y1
        assert not any(box.overlaps(other) for other in boxes[:index])
    for panel in figure.axes:
        ticks = [text.get_window_extent() for text in panel.get_yticklabels() if text.get_text()]
        label = panel.yaxis.label.get_window_extent()
        assert not any(label.overlaps(tick) for tick in ticks)
        below = [text.get_window_extent() for text in panel.get_xticklabels() if text.get_text()]
        assert not any(panel.xaxis.label.get_window_extent().overlaps(tick) for tick in below)


def resting(first, last):
    """A run whose ball friction holds between two times."""
    return replace(motion(), held=(first <= TIME) & (last > TIME))


def bands(panel):
    return [(patch.get_paths(), to_hex(patch.get_facecolor())) for patch in panel.collections]


def test_where_friction_holds_the_ball_is_shaded_and_said():
    runs = {"honest twin": resting(1.0, 2.0), "clean model": motion(), "free": resting(9.0, 9.0)}
    figure, panels = draw_picture(**runs)
    for name in ("Position", "Tracking error"):
        ((paths, colour),) = bands(panels[name])
        (path,) = paths
        assert colour.upper() == RUN_COLOURS[0]
        assert path.get_extents().extents == pytest.approx([1.0, 0.0, 1.99, STRIP_HEIGHT])
    assert "held by friction, 25.0 % of the time" in words(figure)


def test_each_run_has_a_strip_of_its_own_colour_under_one_entry():
    figure, panels = draw_picture(one=resting(0.0, 1.0), free=motion(), other=resting(1.0, 3.0))
    found = [colour.upper() for _, colour in bands(panels["Tracking error"])]
    assert found == [RUN_COLOURS[0], RUN_COLOURS[2]]
    assert "held by friction, one 25.0 %, other 50.0 % of the time" in words(figure)


def test_shares_of_more_runs_than_the_legend_names_are_a_range():
    figure, _ = draw_picture(
        **{name: resting(0.0, 0.4 * k) for k, name in enumerate("abcd", start=1)}
    )
    assert "held by friction, 10.0 to 40.0 % of the time" in words(figure)


def test_the_run_with_less_effort_is_drawn_in_front():
    calm, noisy = (replace(motion(), u=np.full((len(TIME), 2), size)) for size in (0.1, 2.0))
    _, panels = draw_picture(calm=calm, noisy=noisy)
    lines = panels["Plate acceleration"].lines
    order = {line.get_color(): line.get_zorder() for line in lines}
    assert order[RUN_COLOURS[0]] > order[RUN_COLOURS[1]]
    assert max(order.values()) < REFERENCE_STYLE["zorder"]


def test_a_ball_that_left_the_plate_ends_in_a_cross():
    ends = {}
    for name, x in (("left", 0.349), ("stays", 0.2)):
        still = motion()
        ball = still.ball.copy()
        ball[-1] = x, 0.0
        figure, panels = draw_picture(**{name: replace(still, ball=ball)})
        ends[name] = {line.get_marker() for line in panels["Ball on the plate, from above"].lines}
        ended = {line.get_marker() for line in panels["Tracking error"].lines}
        assert ("X" in ended) == ("left the plate" in words(figure)) == (name == "left")
    assert "X" in ends["left"] - ends["stays"]
    assert "s" in ends["stays"] - ends["left"]


def test_from_a_round_plate_a_ball_has_gone_beyond_its_circle():
    disc = Dimensions((0.3, 0.3), (0.1, 0.1), 0.02, round=True)
    for reach, gone in ((0.149, True), (0.146, False)):
        ball = motion().ball.copy()
        ball[-1] = reach * np.array([np.cos(0.7), -np.sin(0.7)])
        figure, panels = draw_picture(disc, one=replace(motion(), ball=ball))
        assert ("left the plate" in words(figure)) == gone
    patches = panels["Ball on the plate, from above"].patches
    (rim,) = (each for each in patches if isinstance(each, Ellipse))
    assert (rim.width, rim.height, *rim.center) == (300, 300, 0, 0)


@pytest.mark.short("plate", "effort")
@pytest.mark.parametrize("name", PANEL_PLACES)
def test_a_single_panel_has_the_width_asked_for_its_lines_and_their_legend(name):
    figure = pictures.panel({"one": motion(), "two": motion(0.05)}, name, PLATE, 88)
    (axes,) = figure.axes
    assert figure.get_figwidth() == pytest.approx(88 / 25.4)
    assert axes.get_title() == ""
    assert "[" in axes.get_ylabel()
    assert axes.get_xlabel() == ("x [mm]" if name == "plate" else "time [s]")
    (legend,) = figure.legends
    labels = [each.get_text() for each in legend.get_texts()]
    assert labels[:2] == ["one", "two"]
    assert ("reference" in labels) == (name in ("plate", "x", "y"))
    assert ("θ" in labels) == (name in ("angle", "effort"))


def test_a_single_panel_shows_what_the_picture_shows():
    runs = {"one": motion(), "two": motion(0.05)}
    _, panels = draw_picture(**runs)
    (axes,) = pictures.panel(runs, "error", PLATE, 120).axes
    for mine, whole in zip(axes.lines, panels["Tracking error"].lines, strict=True):
        assert np.array_equal(mine.get_xydata(), whole.get_xydata())


@pytest.mark.long
def test_panels_of_a_list_stand_below_each_other_with_one_legend_of_all():
    runs = {"one": motion(), "two": motion(0.05)}
    single = [pictures.panel(runs, name, PLATE, 88) for name in ("plate", "angle")]
    figure = pictures.panel(runs, ["plate", "angle"], PLATE, 88)
    upper, lower = sorted(figure.axes, key=lambda axes: -axes.get_position().y0)
    assert (upper.get_xlabel(), lower.get_xlabel()) == ("x [mm]", "time [s]")
    assert upper.get_position().y0 > lower.get_position().y1
    assert figure.get_figwidth() == pytest.approx(88 / 25.4)
    assert figure.get_figheight() == pytest.approx(sum(each.get_figheight() for each in single))
    (legend,) = figure.legends
    assert [each.get_text() for each in legend.get_texts()] == ["one", "two", "reference", "φ", "θ"]
    for axes, alone in zip((upper, lower), single, strict=True):
        for mine, whole in zip(axes.lines, alone.axes[0].lines, strict=True):
            assert np.array_equal(mine.get_xydata(), whole.get_xydata())


def saved(figure, kind):
    content = BytesIO()
    figure.savefig(content, format=kind)
    return content.getvalue()


@pytest.mark.long
def test_text_of_a_saved_figure_is_text_in_fonts_that_journals_accept():
    for figure in (
        pictures.panel({"one": motion()}, "error", PLATE, 88),
        picture({"one": motion()}, "", PLATE, PaperFigure),
    ):
        assert b">error [mm]<" in saved(figure, "svg") or b"Tracking error" in saved(figure, "svg")
        assert b"/Type3" not in saved(figure, "pdf")
    with mock.patch.dict("twin.run.picture.TEXT_AS_TEXT", {"svg.fonttype": "path"}):
        assert b">error [mm]<" not in saved(
            pictures.panel({"one": motion()}, "error", PLATE, 88), "svg"
        )


def test_a_panel_that_is_none_and_a_width_of_no_page_are_one_line():
    runs = {"one": motion()}
    with pytest.raises(ScenarioError, match=r"panel 'err': unknown; did you mean 'error'\?"):
        pictures.panel(runs, "err", PLATE, 88)
    with pytest.raises(ScenarioError, match=r"panel '3': unknown"):
        pictures.panel(runs, 3, PLATE, 88)
    for names in ([], ["error", "error"]):
        with pytest.raises(ScenarioError, match="give one or more panels, each once"):
            pictures.panel(runs, names, PLATE, 88)
    with pytest.raises(ScenarioError, match="panel 'path': unknown"):
        pictures.panel(runs, ("error", "path"), PLATE, 88)
    for width in (math.nan, 0, 401, "88", None):
        with pytest.raises(ScenarioError, match="width_mm: must be 30 to 400"):
            pictures.panel(runs, "error", PLATE, width)
