import numpy as np
import pytest
from matplotlib.colors import to_hex

from twin.run.metrics import Motion
from twin.run.overview_plot import COLOURS, LEAST_ERROR, WINDOW, picture

TIME = np.arange(0.0, 4.0, 0.01)


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


def drawn(**runs):
    figure = picture(runs, "", (0.25, 0.15))
    return figure, {panel.get_title().split(" (")[0]: panel for panel in figure.axes}


def references(panel):
    return [line for line in panel.lines if "reference" in str(line.get_label())]


def test_a_reference_of_all_runs_is_drawn_once_as_long_as_the_longest():
    figure, panels = drawn(long=motion(), short=motion(error=0.02, time=TIME[:100]))
    (line,) = references(panels["Ball on the screen, from above"])
    assert line.get_color() == "black"
    assert len(line.get_xdata()) == len(TIME)
    assert [text.get_text() for text in figure.legends[0].get_texts()].count("reference") == 1


def test_runs_with_references_of_their_own_show_each_in_the_colour_of_its_run():
    _, panels = drawn(wide=motion(0.1), narrow=motion(0.05))
    first, second = references(panels["Ball on the screen, from above"])
    assert [to_hex(line.get_color()).upper() for line in (first, second)] == list(COLOURS[:2])
    assert np.abs(first.get_xdata()).max() == pytest.approx(100)
    assert np.abs(second.get_xdata()).max() == pytest.approx(50)
    in_time = [line for line in panels["Position"].lines if line.get_zorder() == first.get_zorder()]
    assert [np.abs(line.get_ydata()).max() for line in in_time] == [
        pytest.approx(100),
        pytest.approx(50),
    ]


def test_the_legend_covers_no_curve():
    figure, _ = drawn(**{f"run {number}": motion(0.01 * number) for number in range(1, 8)})
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert len(legend.get_texts()) == 14
    for panel in figure.axes:
        assert panel.get_legend() is None
        assert not box.overlaps(panel.get_tightbbox())


@pytest.mark.parametrize(("error", "top"), [(1e-9, LEAST_ERROR), (0.02, 21.0)])
def test_the_axis_of_the_error_has_a_floor(error, top):
    _, panels = drawn(run=motion(error=error))
    assert panels["Tracking error"].get_ylim() == (0, pytest.approx(top))


def test_numbers_that_ran_away_are_drawn_as_far_as_they_go():
    lost = motion(error=0.02)
    lost.ball[50:] = np.inf
    lost.ball[60:] = np.nan
    _, panels = drawn(run=lost)
    assert panels["Tracking error"].get_ylim() == (0, pytest.approx(21.0))


@pytest.mark.long
def test_of_many_runs_the_running_effort_is_drawn():
    step = np.where(TIME < 2.0, 0.0, 1.0)

    def effort(count):
        runs = {f"run {index}": motion() for index in range(count)}
        for each in runs.values():
            each.u[:] = step[:, None]
        figure, _ = drawn(**runs)
        (panel,) = [axes for axes in figure.axes if "rad/s²" in axes.get_ylabel()]
        return panel.lines[0].get_ydata()

    np.testing.assert_array_equal(effort(2), step)
    smooth = effort(3)
    early, late = TIME < 2.0 - WINDOW / 2 - 0.02, TIME > 2.0 + WINDOW / 2 + 0.02
    assert np.allclose(smooth[early], 0.0)
    assert np.allclose(smooth[late], 1.0)
    assert smooth[200] == pytest.approx(np.sqrt(0.5), abs=0.02)  # half of the window
