"""How a shadow is reported: during a run, in the viewer, in words, as a page."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.base.errors import plural
from twin.base.page import Block, Picture, Text, Verdict, html
from twin.base.writing import write_json, write_whole
from twin.identify.any_logs import read_any
from twin.identify.axis_logs import AnyLog
from twin.identify.balls import ball_factor
from twin.identify.end_stops import find_ends
from twin.identify.log_columns import wanted_columns
from twin.identify.logs import Log, read
from twin.identify.prepare import check_ranges
from twin.identify.windows import REPLAY_STEP_S
from twin.run.files import run_name
from twin.run.picture import RUN_COLOURS, styled_figure
from twin.run.plants import drawn_mechanism
from twin.scenario.schema import Scenario
from twin.shadow.alarms import resolution
from twin.shadow.belief import (
    BELIEF_TABLES,
    CAUSE_SIZES,
    Belief,
    belief_of,
    check_commands,
    twin_for_log,
)
from twin.shadow.causes import Alarm
from twin.shadow.follow import (
    DIAGNOSIS_S,
    LEAST_TOLD,
    PENDING_S,
    LiveFollower,
    Shadow,
    describe_recording,
    shadow,
)
from twin.shadow.horizon import HORIZON_S, PATH_STEPS, Replays
from twin.shadow.learning import LEARNING_S, SHOWN_LIMITS, HealthyTwin
from twin.sim.plant.rim import Ends
from twin.view.live_process import Address, SharedRingBuffer, step_back
from twin.view.recording import fix, new_stream, send
from twin.view.streams import BLACK, GREY, PINK, VERMILION, Batch, Scene, event_texts, in_view, line

Tell = Callable[[Replays | None, list[tuple[float, str]]], None]
"""Called with new replays, and times and texts of events."""


class Shown(NamedTuple):
    """Where the twin is drawn next to the run: the viewer, its recording, the run's name there."""

    url: str
    recording: str
    name: str


TWIN_COLOUR = (204, 121, 167, 150)
"""Colour of the twin's ball, half transparent."""


class TwinStream:
    """The twin of one run, drawn among the run's entities.

    Args:
        name: The run's name, the root of its entities.
        scenario: What is run.
    """

    def __init__(self, name: str, scenario: Scenario) -> None:
        self.root = f"/{rr.escape_entity_path_part(name)}"
        self._scene = Scene(drawn_mechanism(scenario), f"{self.root}/mechanism")
        self._ball = f"{self._scene.plate}/twin_ball"

    def fixed(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """The constant parts: the ghost's shape, and the looks of the lines."""
        radius = self._scene.radius
        solid = rr.components.FillMode.Solid
        yield (
            f"{self._ball}/ball",
            rr.Ellipsoids3D(half_sizes=[3 * [radius]], colors=[TWIN_COLOUR], fill_mode=solid),
        )
        yield (
            f"{self.root}/plate_mm/twin",
            rr.Points2D.from_fields(colors=[TWIN_COLOUR], radii=[9.0]),
        )
        for entity, colour, called in (
            ("twin_score/score", VERMILION, "score"),
            ("twin_error_mm/distance", GREY, "distance"),
        ):
            look = {"colors": [colour], "marker_sizes": [4.0], "markers": ["circle"]}
            yield f"{self.root}/{entity}", rr.SeriesPoints(names=[called], **look)
        yield f"{self.root}/twin_score/as_predicted", line(BLACK, 1.2, "as predicted")
        yield f"{self.root}/twin_error_mm/band", line(PINK, 1.2, "95 % band")

    def batches(
        self, found: Replays | None, events: Sequence[tuple[float, str]]
    ) -> Iterator[Batch]:
        """What is new, as columns for the viewer.

        Args:
            found: Replays; None for nothing.
            events: Time in s and text of what happened.
        """
        if found is not None and len(found.time):
            run, end = found.take(found.counted), found.time[found.counted] + HORIZON_S
            for entity, values in (
                ("twin_score/score", run.score),
                ("twin_score/as_predicted", np.ones(len(end))),
                ("twin_error_mm/distance", 1000 * run.distance),
                ("twin_error_mm/band", 1000 * run.band),
            ):
                yield Batch(f"{self.root}/{entity}", end, rr.Scalars.columns(scalars=values))
            steps = PATH_STEPS * REPLAY_STEP_S * np.arange(found.path.shape[1])
            time = (found.time[:, None] + steps).ravel()
            ball = found.path.reshape(-1, 2)
            high = np.full(len(ball), self._scene.surface + self._scene.radius)
            place = rr.Transform3D.columns(translation=np.column_stack((ball, high)))
            yield Batch(self._ball, time, place)
            above = rr.Points2D.columns(positions=in_view(ball))
            yield Batch(f"{self.root}/plate_mm/twin", time, above)
        yield from event_texts(self.root, events, "WARN")


def drawing(scenario: Scenario, shown: Shown) -> Tell:
    """What draws the twin of a run; it receives what is new."""
    twin = TwinStream(shown.name, scenario)
    stream = new_stream(shown.name, shown.recording)
    stream.connect_grpc(shown.url)
    fix(stream, twin.fixed())

    def tell(replays: Replays | None, events: list[tuple[float, str]]) -> None:
        send(stream, twin.batches(replays, events))
        stream.flush()

    return tell


ALARM_COLOUR = RUN_COLOURS[1]


def picture(found: Shadow) -> Figure:
    """Score, error with the 95 % band, and the statistic, over time."""
    with styled_figure(12, 7) as figure:
        panels = figure.subplots(3, 1, sharex=True)
        for panel, draw in zip(panels, (_score, _error, _test), strict=True):
            draw(panel, found)
            for begin, end in found.gaps:
                panel.axvspan(begin, end, color="0.8", lw=0)
            for alarm in found.alarms:
                panel.axvline(alarm.time, color=ALARM_COLOUR, lw=1.2)
                panel.axvline(alarm.since, color=ALARM_COLOUR, lw=1, ls=":")
        panels[2].set_xlabel("time [s]")
    return figure


def _score(panel: Axes, found: Shadow) -> None:
    panel.set(ylabel="score", title="Replay error over its predicted spread (1: as predicted)")
    run = found.replays
    panel.axhline(1, color="0.4", lw=1)
    if run is None:
        return
    moving, silent = run.counted, ~run.counted
    end = run.time + HORIZON_S
    panel.semilogy(end[moving], np.maximum(run.score[moving], 0.02), ".", color=RUN_COLOURS[0])
    if silent.any():
        label = "cannot tell: the ball rests, or was not seen"
        panel.plot(end[silent], np.full(silent.sum(), 0.02), "x", color="0.6", ms=4, label=label)
        panel.legend(fontsize=8, loc="upper left")


def _error(panel: Axes, found: Shadow) -> None:
    title = f"Measured ball and replay apart after {HORIZON_S:g} s; bars: the predicted 95 % band"
    panel.set(ylabel="error [mm]")
    panel.set_title(title, fontsize=9)
    run = found.replays
    if run is None or not run.counted.any():
        return
    end, error, band = (
        each[run.counted] for each in (run.time + HORIZON_S, 1000 * run.distance, 1000 * run.band)
    )
    panel.bar(end, band, 0.8 * HORIZON_S, color=RUN_COLOURS[5], alpha=0.35)
    panel.plot(end, error, ".", color=RUN_COLOURS[0])
    panel.set_ylim(0, max(3.0, *(1.2 * np.percentile(error, 95), 1.2 * np.percentile(band, 80))))


def _test(panel: Axes, found: Shadow) -> None:
    time, tests = found.tests.soft.end, found.tests
    every, late = np.maximum(tests.ratio, 0.1), np.maximum(tests.delayed, 0.1)
    panel.semilogy(time, every, color=RUN_COLOURS[0], lw=1.2, label="all causes")
    panel.semilogy(time, late, color=RUN_COLOURS[1], lw=1, label="dead time alone")
    for threshold in (tests.change.threshold_llr, tests.dead_time.threshold_llr):
        panel.axhline(threshold, color=ALARM_COLOUR, lw=1, ls="--")
    panel.legend(fontsize=7, loc="upper left")
    panel.set(ylabel="log likelihood ratio", title="A change against none; dashed: alarm")


MIN_MOVING_SHARE = 0.2
"""Share of the time for which a ball moves, below which a longer log is not what is missing."""


def sentences(found: Shadow) -> list[str]:
    """The verdict in words."""
    moved_s, length = found.moved_s, found.length
    words = []
    if found.foreign:
        words.append(
            f"Cannot tell: the twin does not follow the reference log itself: a replay strays "
            f"{found.reference_score:.1f} times as far as it predicts (median). It is the twin of "
            "a different rig: state the rig and its ball (--on, --ball)."
        )
    elif found.verdict == "healthy":
        since = f" after its first {LEARNING_S:g} s" if found.taught else ""
        words.append(
            f"Healthy as far as the log shows{since}: in {moved_s:.0f} of its {length:.0f} usable "
            "seconds the ball moved, and nothing but the twin is needed to explain it."
        )
    elif found.verdict == "cannot tell" and len(found.gaps):
        words.append(
            f"Cannot tell: gaps cut the log up, and only {moved_s:.3g} of its {length:.0f} usable "
            "seconds are long enough without one and have a ball that moves. That is no sign of "
            "health."
        )
    elif found.verdict == "cannot tell" and found.taught:
        words.append(
            f"Cannot tell: the twin learned from the first {LEARNING_S:g} of the log's "
            f"{length:.0f} usable seconds; after them the ball moved for less than the "
            f"{LEAST_TOLD:g} s that are needed ({moved_s:.3g} s). That is no sign of "
            f"health.{_advise_length(moved_s, length, LEARNING_S)}"
        )
    elif found.verdict == "cannot tell":
        words.append(
            f"Cannot tell: the ball moved for {moved_s:.3g} of the log's {length:.0f} usable "
            f"seconds; {LEAST_TOLD:g} s are needed, as a ball at rest shows neither friction nor "
            f"level nor dead time. That is no sign of health.{_advise_length(moved_s, length, 0)}"
        )
    if found.verdict == "healthy":
        words += indistinguishable(found)
    words += _describe_comparison(found)
    words += [found.taught] if found.taught and found.verdict != "cannot tell" else []
    if not found.foreign:
        words += [f"Reality has left the model. Alarm at {each.words}." for each in found.alarms]
    score, inside, error = found.score_median, found.inside_band, found.error_1s
    if found.replays is not None and score is not None:
        words.append(
            f"A replay of {HORIZON_S:g} s strays {score:.2f} times as far as the twin "
            f"predicts of itself (median), and {inside:.0f} % of them end in their 95 % band."
        )
    if error is not None:
        words.append(f"After 1 s a replay is {1000 * error:.2f} mm off (median).")
    if len(found.gaps):
        missing = float(np.diff(found.gaps, axis=1).sum())
        words.append(
            f"The log has {plural(len(found.gaps), 'gap')} of {missing:.2f} s in all, shown grey."
        )
    words += [f"{found.wall_note.capitalize()}."] if found.wall_note else []
    return words


def _advise_length(moved_s: float, length_s: float, learned_s: float) -> str:
    """How long to record a motion for a verdict, as a sentence; empty if the ball hardly moves.

    Args:
        moved_s: Time in s in which the ball moved after what was learned from.
        length_s: Length of the log, s.
        learned_s: Length of its beginning that the twin learned from, s.
    """
    if moved_s < MIN_MOVING_SHARE * (length_s - learned_s) or not moved_s:
        return ""
    needed_s = learned_s + LEAST_TOLD * (length_s - learned_s) / moved_s
    return f" {describe_recording(needed_s)}."


def _describe_comparison(found: Shadow) -> list[str]:
    """How the beginning of a log compares with its reference, in a sentence; none without one."""
    if not found.differences:
        return []
    changed = [each.words for each in found.differences if each.significant]
    if changed:
        return [
            f"Differs from the reference since its first row: {'; '.join(changed)}. A rig that is "
            f"the same differs by less in its first {LEARNING_S:g} s."
        ]
    sizes = [each.least for each in found.differences if each.name in SHOWN_LIMITS]
    words = [
        f"The first {LEARNING_S:g} s agree with the reference; not distinguishable from it: a "
        f"difference of {', of '.join(sizes)}."
    ]
    if not any(each.same_motion for each in found.differences):
        words.append(
            "Their motion differs from the reference; the same motion shows smaller differences "
            "of the dead time."
        )
    return words


def indistinguishable(found: Shadow) -> list[str]:
    """Limits of a healthy verdict: changes too small to be seen, and a suspicion."""
    words = []
    least = resolution(found.tests)
    if least:
        sizes = [
            f"{RESOLVED_CAUSES[cause]} below {_size(cause, value, found.tests.belief)}"
            for cause, value in least.items()
            if cause in RESOLVED_CAUSES
        ]
        words.append(f"Not distinguishable from healthy: a change of {', of '.join(sizes)}.")
    if found.tests.suspected:
        ratio, test = float(found.tests.delayed.max()), found.tests.dead_time
        words.append(
            f"A different dead time is possible: its log likelihood ratio was {ratio:.1f}, where "
            f"{test.threshold_llr:.1f} is an alarm and healthy rigs exceed "
            f"{test.suspected_llr:g} about twice an hour."
        )
    return words


RESOLVED_CAUSES = {
    "dead time": "the screen's dead time",
    "servo lag": "the drives' lag or dead time",
    "rolling friction": "rolling friction",
    "level": "the level",
    "tilt gain": "the tilt gain",
}
"""Causes with a reported smallest change that would be seen, in words."""


def _size(cause: str, value: float, belief: Belief) -> str:
    """The size of a change of one parameter in words."""
    about = BELIEF_TABLES["parameters"][next(iter(CAUSE_SIZES[cause]))]
    unit = belief.values["rolling"] if cause == "rolling friction" else 1.0
    words = {"dead time": "{:.1f} ms", "servo lag": "{:.1f} ms", "level": "{:.3f} deg"}
    return words.get(cause, "{:.0f} %").format(about["factor"] * value / unit)


def page(found: Shadow) -> str:
    """The report as one HTML file."""
    blocks: list[Block] = [
        Verdict(sentences(found), found.verdict == "healthy"),
        Picture(
            "Over time",
            picture(found),
            "Every replay begins in the smoothed state of the log and follows the recorded "
            "commands, the plate as its encoders correct it. Grey crosses: the ball rested, "
            "nothing can be concluded. Vertical lines: an alarm, and (dotted) when it most likely "
            "began. An alarm is raised where the logarithm of the likelihood ratio passes "
            f"{found.tests.change.threshold_llr:g}; the dead time has a test of its own with "
            f"{found.tests.dead_time.threshold_llr:.3g}. All causes count as equally likely a "
            "priori; those below 5 % are not named.",
        ),
    ]
    if found.notes:
        blocks.append(Text(found.notes, "The log"))
    return html(f"The twin of {found.source}", blocks)


WRITTEN_FILES = "shadow.html, shadow.json"
"""What is written."""


def write(found: Shadow, folder: Path) -> None:
    """Write shadow.html and shadow.json.

    Raises:
        RecordError: If a file cannot be written.
    """
    write_whole(folder / "shadow.html", page(found))
    write_json(folder / "shadow.json", found.as_dict())


def read_watched(
    log: Path, columns: str | None = None, separator: str | None = None
) -> Log | AnyLog:
    """A log that a twin is to follow; arguments as of ``examine``.

    Raises:
        LogError: If it cannot be used.
    """
    if columns is not None:
        return read_any(log, wanted_columns(columns), separator)
    recorded = replace(read(log), source=run_name(log))
    check_ranges(recorded)
    check_commands(recorded)
    return recorded


def make_twin(
    logged: Log | AnyLog, overrides: Sequence[str] = (), ball: str | float | None = None
) -> tuple[Log, Belief]:
    """A log as its twin sees it, and that twin; arguments as of ``examine``.

    Raises:
        TwinError: If an override is wrong, the log is not of this rig, or is a run and a ball is
            given.
    """
    factor = None if ball is None else ball_factor(ball)
    if isinstance(logged, Log):
        return logged, belief_of(logged, overrides, factor)
    return twin_for_log(logged, overrides, factor)


def examine(
    log: Path,
    folder: Path,
    overrides: Sequence[str] = (),
    *,
    columns: str | None = None,
    separator: str | None = None,
    ball: str | float | None = None,
    learning: bool = False,
) -> Shadow:
    """Run the twin on a recorded run, and write its report.

    Args:
        log: Run folder, ``run.parquet`` or CSV file.
        folder: Where ``FILES`` go.
        overrides: ``KEY=VALUE`` each, over what the run was simulated with or believed.
        columns: Of a log of any rig, as ``identify`` takes them.
        separator: Between these.
        ball: Of a log that is no run: hollow, solid, or the share of gravity that accelerates it;
            None for the ball of the overrides' rig.
        learning: Whether the twin learns what is not known of the rig before it evaluates; it does
            of one given by identified parameters, and on a log of any rig.

    Raises:
        TwinError: If the log cannot be used, an override is wrong, or a file cannot be written.
    """
    logged = read_watched(log, columns, separator)
    return examine_log(logged, folder, overrides, ball=ball, learning=learning)


def watched_twin(
    logged: Log | AnyLog,
    overrides: Sequence[str] = (),
    ball: str | float | None = None,
    ends: Sequence[Ends] = (),
) -> tuple[Log, Belief]:
    """A log as its twin sees it, with the walls that it shows, and that twin.

    Arguments and errors as of ``examine_log``.
    """
    recorded, belief = make_twin(logged, overrides, ball)
    walls = recorded.walls
    if isinstance(logged, AnyLog):
        walls = walls.narrowed(find_ends(logged.axes))
    elif not recorded.scenario:  # a run knows its walls
        walls = walls.narrowed(find_ends(recorded))
    return replace(recorded, walls=walls.narrowed(ends) if ends else walls), belief


def examine_log(
    logged: Log | AnyLog,
    folder: Path,
    overrides: Sequence[str] = (),
    *,
    ball: str | float | None = None,
    learning: bool = False,
    ends: Sequence[Ends] = (),
    reference: HealthyTwin | None = None,
) -> Shadow:
    """Run the twin on a log that was read by ``read_watched``, and write its report.

    Args:
        logged: The log.
        folder: As of ``examine``, like the overrides, the ball and learning.
        overrides: ``KEY=VALUE`` each.
        ball: Of a log that is no run.
        learning: Whether the twin learns before it evaluates.
        ends: Where end stops or rims stop the ball along x and y, m, as a second log shows them; a
            log that is no run may show more.
        reference: The twin learned from a reference log, with which the beginning is compared.

    Raises:
        TwinError: If the log cannot be used, an override is wrong, or a file cannot be written.
    """
    recorded, belief = watched_twin(logged, overrides, ball, ends)
    learning = learning or isinstance(logged, AnyLog)
    identified = any(text.partition("=")[0].strip() == "parameters" for text in overrides)
    found = shadow(recorded, belief, learning=learning or identified, reference=reference)
    write(found, folder)
    return found


FOLLOW_INTERVAL_S = 0.2
"""Seconds between two looks for new rows."""
MAX_FOLLOWED_ROWS = 1000
"""Rows taken at a time, so that one sees a twin that is behind a fast run go on."""
SCORE_EVERY = 10.0
"""Seconds of the run between two lines with its score."""


def work(buffer: Address, scenario: Scenario, shown: Shown | None, learning: bool = False) -> None:
    """Ask the twin until the writer has ended or died; the body of the process.

    Args:
        buffer: Where the rows come from.
        scenario: What is run.
        shown: Where the twin is drawn; None for nowhere.
        learning: Whether it learns before it judges.
    """
    step_back()
    tell: Tell = (lambda _, __: None) if shown is None else drawing(scenario, shown)
    follower = LiveFollower(scenario, "the run", learning=learning)
    if learning:
        _print(f"twin: learns for {LEARNING_S:g} s before it judges")
    commentary = Commentary(follower, _print)
    with closing(SharedRingBuffer(*buffer)) as ring:
        for block in ring.blocks(FOLLOW_INTERVAL_S, MAX_FOLLOWED_ROWS):
            if block:
                commentary.take(block, tell)
        commentary.end(tell, ring.dropped)


class Commentary:
    """What is printed of a run and its twin: a line now and then, one an alarm, one its causes.

    Args:
        follower: The twin.
        line: Prints a line.
    """

    def __init__(self, follower: LiveFollower, line: Callable[[str], None]) -> None:
        self._follower, self._line = follower, line
        self._replays, self._alarms, self._scored, self._taught = 0, 0, 0.0, ""

    def take(self, rows: dict[str, np.ndarray], tell: Tell) -> None:
        """Take in rows, and ask the twin if it is time, more than once if they are many.

        Args:
            rows: Columns of the record, shape (K,) each.
            tell: Receives what is new.
        """
        period = self._follower.period
        every = max(1, round(1.0 / period))
        for first in range(0, len(rows["time"]), every):
            part = {name: values[first : first + every] for name, values in rows.items()}
            if self._follower.take(part):
                self._say(self._follower.ask(), tell)

    def end(self, tell: Tell, dropped: int) -> None:
        """Report what is left.

        Args:
            tell: Receives what is new.
            dropped: Rows that were missed.
        """
        self._say(self._follower.ask(whole=True), tell)
        self._score(0.0)
        if dropped:
            self._line(
                f"twin: missed {plural(dropped, 'row')} of the run; its page has all of them"
            )

    def _say(self, explained: list[Alarm], tell: Tell) -> None:
        found = self._follower.result
        if found.taught != self._taught:
            self._taught = found.taught
            self._line(f"twin: {found.taught}")
        events = []
        for alarm in found.alarms[self._alarms :]:
            left = (
                "" if alarm.causes else f"; causes at {alarm.time + DIAGNOSIS_S + PENDING_S:.0f} s"
            )
            events.append(
                (alarm.time, f"alarm at {alarm.time:.1f} s: reality has left the model{left}")
            )
        events += [(alarm.time, f"alarm at {alarm.words}") for alarm in explained]
        self._alarms = len(found.alarms)
        for _, text in events:
            self._line(f"twin: {text}")
        new = None
        if found.replays is not None:
            which = np.arange(len(found.replays.time)) >= self._replays
            self._replays = len(which)
            new = found.replays.take(which)
        self._score(SCORE_EVERY)
        tell(new, events)

    def _score(self, every: float) -> None:
        """A line with the score since the last one, if that is long enough ago."""
        run = self._follower.result.replays
        if run is None or not len(run.time):
            return
        end = run.time + HORIZON_S
        if end[-1] - self._scored < max(every, 1e-9):
            return
        of_late = run.take(end > self._scored)
        late = replace(self._follower.result, replays=of_late)
        self._scored = float(end[-1])
        if late.score_median is None:
            self._line(f"twin: {end[-1]:.0f} s, cannot tell: the ball rests or is not seen")
            return
        self._line(
            f"twin: {end[-1]:.0f} s, score {late.score_median:.2f} (1: as predicted), "
            f"{late.inside_band:.0f} % of {of_late.counted.sum()} replays in their 95 % band"
        )


def _print(line: str) -> None:
    """A line of its own, over a progress bar if there is one."""
    over = "\r\x1b[K" if sys.stderr.isatty() else ""
    sys.stderr.write(f"{over}{line}\n")
    sys.stderr.flush()
