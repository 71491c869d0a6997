"""`twin.identify.report`: What the errors on the held-out part are said to show."""

from dataclasses import replace

import numpy as np
import pytest

from twin.identify.parameters import IdentifiedParameter
from twin.identify.report import further_notes, reasons, sentences, write
from twin.identify.verdicts import Identification, ParameterVerdict, Predicted, score


def said(windows, *, seen_after=2.0, off=0.02):
    """Sentences on predictions whose ball goes on at 0.1 m/s, seen for so many s after each."""
    ahead = np.tile(np.linspace(-0.4, 2.0, 61), (windows, 1))
    ball = np.where(ahead <= seen_after + 1e-6, 0.1 * ahead, np.nan)
    model = 0.1 * ahead + off
    by = {"model": model, "without friction": model, "stays": 0 * ahead, "goes on": 0.1 * ahead}
    found = score({"x": Predicted(np.arange(windows) / 2.0, ahead, ball, by)})
    return " ".join(sentences(of_score(found)))


def of_score(found):
    return Identification(
        source="a.csv",
        seconds=10.0,
        verdicts=(),
        scores=(found,),
        predictions={},
        notes=(),
        extent="",
        remarks=(),
    )


def test_a_model_that_loses_in_enough_windows_is_worse_than_none():
    words = said(5)
    assert "20.0 mm off after 1 s (median of 5 windows" in words
    assert "WORSE THAN NO MODEL, x: after 0.5 s one that goes on" in words
    assert words.count("is 0.0 mm off, the model 20.0 mm") == 3
    assert "after 2 s" in words
    assert "too short" not in words


def test_a_model_that_loses_alone_is_told_to_follow_the_level_and_by_how_much():
    ahead = np.tile(np.linspace(-0.4, 2.0, 61), (5, 1))
    by = dict.fromkeys(("level followed", "without friction", "goes on"), 0.1 * ahead)
    by |= {"model": 0.1 * ahead + 0.02, "stays": 0 * ahead}
    levels = "level followed", "model"
    for better, worse in (levels, levels[::-1]):
        told = by | {better: by["level followed"], worse: by["model"]}
        found = score({"x": Predicted(np.arange(5) / 2.0, ahead, 0.1 * ahead, told)})
        words = " ".join(sentences(of_score(found)))
        assert "WORSE" not in words
        assert ("x: do not follow the level: with it," in words) == (better == "model")
        assert ("x: follow the level: without," in words) == (worse == "model")
        assert words.count("is 0.0 mm off, the model 20.0 mm") == 3


@pytest.mark.parametrize("windows", [1, 4])
def test_a_few_windows_decide_nothing_and_the_sentence_says_what_to_record(windows):
    words = said(windows)
    assert "20.0 mm off after 1 s" in words
    assert f"too short to show how well the model predicts: it has {windows} window" in words
    assert "at least 5 are needed. Record for longer" in words
    assert "WORSE" not in words


def test_a_held_out_part_that_ends_before_1_s_gives_no_number():
    words = said(9, seen_after=0.7)
    assert "nan" not in words
    assert "mm off" not in words
    assert "it has 0 windows in which the ball moves and is seen after 1 s" in words
    assert "WORSE" not in words


def test_a_horizon_that_only_a_few_windows_reach_decides_nothing():
    ahead = np.tile(np.linspace(-0.4, 2.0, 61), (8, 1))
    ball = np.where((ahead < 1.5) | (np.arange(8)[:, None] < 2), 0.1 * ahead, np.nan)
    by = dict.fromkeys(("model", "without friction", "goes on"), 0.1 * ahead)
    by["model"] = by["model"] + 0.05 * (ahead > 1.5)
    by["stays"] = 0 * ahead
    found = score({"x": Predicted(np.arange(8) / 2.0, ahead, ball, by)})
    assert list(found.known) == [8, 8, 2]
    assert "WORSE" not in " ".join(sentences(of_score(found)))


SHORT = "1 stretch of 0.87 s with the ball seen every 0.5 s, at least 3 are needed"
OPEN = "the full model leaves the gain open; "


def unfitted(whys, notes=()):
    """An identification whose parameters p0, p1, ... have these reasons."""
    verdicts = tuple(
        ParameterVerdict(about=IdentifiedParameter(f"p{n}", "", ""), name=f"p{n}", why=why)
        for n, why in enumerate(whys)
    )
    return replace(of_score(None), verdicts=verdicts, scores=(), notes=tuple(notes))


def test_a_reason_that_parameters_share_is_given_once(tmp_path):
    found = unfitted([SHORT, "", SHORT, "another", ""], [f"not identified: x: {SHORT}", "more"])
    assert reasons(found) == [f"p0, p2: {SHORT}", "p3: another"]
    assert further_notes(found) == ["more"]
    write(found, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert page.count(SHORT) == 1
    assert page.count("as for p0") == 1
    assert "as for p1" not in page


def test_a_note_is_left_out_only_where_a_parameter_has_its_reason():
    notes = [f"not identified: x: {SHORT}", "not identified: y: too quiet", "p: another"]
    assert further_notes(unfitted([OPEN + SHORT, "another"], notes)) == notes[1:]
    assert further_notes(unfitted([], notes)) == notes
