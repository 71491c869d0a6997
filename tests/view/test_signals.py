import numpy as np
import pytest

from twin.view.recording import blueprint
from twin.view.signals import BLACK, BLUE, ORANGE, PINK, Signal, explained, shown_range, tinted

ANGLE = {
    "phi": Signal(np.array([-1.0, np.nan, 3.0]), BLUE),
    "limit_high": Signal(np.full(3, 10.0), PINK),
    "limit_low": Signal(np.full(3, -10.0), PINK),
}

NO_LINES = ("StateTimelineView", "TextLogView")
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


def test_limits_do_not_squash_the_lines_and_a_flat_line_has_room():
    assert shown_range([ANGLE]) == pytest.approx((-1.2, 3.2))
    assert shown_range([{"phi": Signal(np.full(3, np.nan), BLUE)}]) == (-0.05, 0.05)
    assert shown_range([{"phi": Signal(np.zeros(3), BLUE)}]) == (-0.05, 0.05)


def test_of_several_runs_the_error_is_as_high_as_the_distance():
    plot = {"distance": Signal(np.array([0.0, 1.0]), BLUE), "x": Signal(np.array([-9.0, 0]), BLUE)}
    assert shown_range([plot])[0] < -9
    assert shown_range([plot, plot])[0] == pytest.approx(-0.05)


def test_titles_say_in_words_which_line_is_which():
    position = {"ball": Signal(np.zeros(2), BLUE), "estimate": Signal(np.zeros(2), ORANGE)}
    position["reference"] = Signal(np.zeros(2), BLACK)
    assert explained([position], ["run"]) == "ball blue, estimate gold, reference white"
    assert explained([ANGLE], ["run"]) == "phi blue, limit pink"
    two = {"phi": ANGLE["phi"], "theta": ANGLE["phi"]}
    assert explained([two, two], ["afl", "lqr"]) == "afl blue, lqr orange, theta lighter"
    alone = tinted({"friction": ANGLE["phi"], "disturbance_x": ANGLE["phi"]}, 1)
    assert explained([{}, alone], ["circle", "cure"]) == "cure orange"


def test_no_legend_covers_a_plot_and_everything_drawn_brings_its_own_ground():
    plan = blueprint(["/run"], {"angle_deg": "phi blue", "position_x_mm": "ball blue"}, "time")
    plots = [each for each in views(plan) if type(each).__name__ == "TimeSeriesView"]
    assert plots
    for plot in plots:
        legend = plot.properties["PlotLegend"]
        assert legend.visible.as_arrow_array().to_pylist() == [False]
        assert "blue" in plot.name
    brought = {"TimeSeriesView": "PlotBackground"}
    drawn = [each for each in views(plan) if type(each).__name__ not in NO_LINES]
    assert len({type(each).__name__ for each in drawn}) == 3
    for each in drawn:
        ground = each.properties[brought.get(type(each).__name__, "Background")]
        assert len(ground.color.as_arrow_array()) == 1
