"""The command group calibrate: cam table, level and touch screen of a rig, and its lost motion."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ballplate.rig_access import EMULATED_RIG
from twin.base.errors import RigError, plural
from twin.base.page import Table
from twin.base.writing import write_whole
from twin.cli import options
from twin.cli.output import Shown, progress, show
from twin.cli.rig import rig_file
from twin.run.files import log_file

if TYPE_CHECKING:
    from ballplate.reporter import Advance
    from twin.devices.akd.servos import AkdServos
    from twin.devices.lumio.config import CalibrationFit
    from twin.identify.verdicts import ParameterVerdict
    from twin.scenario import Scenario
    from twin.scenario.rig import RigFile

NO_PLATE_TEXT = (
    "turns both axes of a plate by two AKD drives; a rig of one axis (--on, plant.axes) has none"
)
"""Message for a rig of one axis."""
TILT_DIRECTIONS = (("x", "+x", "-x"), ("y", "-y", "+y"))
"""Axis, and the side that is low at a positive phi (about y) or theta (about x), else the other."""


@contextmanager
def _turn_plate(
    rig: str, scenario: Scenario, what: str, total: float
) -> Iterator[tuple[RigFile, AkdServos, Advance]]:
    """A rig with its plate turned in real time: its file, its servos, and progress.

    Raises:
        RigError: If the rig has one axis: its drives are not two.
    """
    if scenario.plant.axes == 1:
        raise RigError(f"calibrate: {NO_PLATE_TEXT}")
    from twin.devices.akd.servos import AkdServos
    from twin.devices.realtime import real_time

    with rig_file(rig, scenario) as (file, _), real_time(), progress(what, total) as advance:
        yield file, AkdServos(file.servos(scenario.rig.period)), advance


@options.command("lost-motion", example="calibrate lost-motion --set plant.servo.backlash_deg=0.44")
@options.EMPTY_RIG
@click.option(
    "--amplitude",
    type=options.Finite(0.2, 8),
    default=1.0,
    help="Of the triangle, deg of the plate [1].",
)
@options.SETTING
@options.JSON_OPTION
def lost_motion(rig: str, overrides: tuple[str, ...], amplitude: float) -> None:
    """Turn the plate by a slow triangle and measure what is lost between motor and plate.

    Settings are the control period, and those of the virtual rig.
    """
    from twin.doctor.calibrate import measure_lost_motion
    from twin.identify.plate_motion import PLAY_KEYS
    from twin.run.connect import cams_of
    from twin.scenario import load

    with _turn_plate(rig, load("circle", overrides), "turning the plate", 1.0) as (
        file,
        servos,
        tell,
    ):
        moved = math.radians(amplitude)
        found = measure_lost_motion(servos, cams_of(file), amplitude=moved, progress=tell)
        tell(1.0)
    lines = []
    for each in found:
        lines.append(f"{each.axis}: {each.words}")
        if each.shape in PLAY_KEYS:
            lines.append(f"  in the twin: {PLAY_KEYS[each.shape]} = {each.width:.3f}")
    show([each.as_dict() for each in found], lines)


@options.command(example="calibrate touch --out touch-of-rig.json")
@options.EMPTY_RIG
@click.option(
    "--out",
    type=options.WRITABLE_FILE,
    default=Path("touch-of-rig.json"),
    help="Calibration file [touch-of-rig.json].",
)
@options.JSON_OPTION
def touch(rig: str, out: Path) -> None:
    """Find scale, turn, mirror and offset of the touch screen from points touched in turn.

    Mark the points on the plate; touch each with a finger or the ball when asked, hold, let go.
    """
    from twin.doctor.calibrate import measure_touch, usual_points
    from twin.scenario import load

    points = usual_points()
    with rig_file(rig, load("circle")) as (file, ask):
        shown = (
            progress("calibrating the touch screen", len(points)) if rig == EMULATED_RIG else None
        )
        with shown or nullcontext(lambda _: None) as advance:
            found = measure_touch(file.uncalibrated_screen(), points, ask, file.patience, advance)
    write_whole(out, found.save)
    then = f'written to {out}; name it in the rig file, under [touch]: calibration_file = "{out}"'
    show({"file": str(out), **found.as_dict()}, (*_residuals(found), then))


def _residuals(found: CalibrationFit) -> tuple[Shown, ...]:
    from twin.doctor.calibrate import place

    rows = [
        (place(point), *(f"{1e3 * each:+.2f}" for each in off))
        for point, off in zip(found.points, found.left, strict=True)
    ]
    return (
        Table("", ("point", "off x / mm", "off y / mm"), rows),
        f"residuals: {1e3 * found.rms:.2f} mm RMS, largest {1e3 * found.distances.max():.2f} mm",
        *found.mounting.lines,
    )


@click.group(cls=options.Group, example="calibrate cams --lines 4")
def calibrate() -> None:
    """Calibrate cam table, level and touch screen of a rig; measure its lost motion."""


calibrate.add_command(touch)
calibrate.add_command(lost_motion)


@calibrate.command(cls=options.Command, example="calibrate cams --lines 4")
@options.EMPTY_RIG
@click.option(
    "--out",
    type=options.WRITABLE_FILE,
    default=Path("cams-of-rig.json"),
    help="File of the table [cams-of-rig.json].",
)
@click.option("--reach", type=options.Finite(0.5, 8), default=6.0, help="Largest angle, deg [6].")
@click.option("--lines", type=click.IntRange(4, 33), default=9, help="Points per axis [9].")
@options.SETTING
@options.JSON_OPTION
def cams(rig: str, out: Path, reach: float, lines: int, overrides: tuple[str, ...]) -> None:
    """Measure the cam table of a rig: what its motors must turn for angles of the plate.

    Settings are the control period, and those of the virtual rig.
    """
    from twin.doctor.calibrate import measure_cams
    from twin.scenario import load

    with _turn_plate(rig, load("circle", overrides), "measuring the cams", lines**2 + 1) as (
        _,
        servos,
        tell,
    ):
        found = measure_cams(servos, reach=math.radians(reach), lines=lines, progress=tell)
    write_whole(out, found.save)
    fit = {each: found.provenance[each] for each in ("points", "before_deg", "rms_deg")}
    words = (
        f"{plural(fit['points'], 'point')}: the table of the model errs by up to "
        f"{fit['before_deg']:.3f} deg, the measured one by {fit['rms_deg']:.3f} deg RMS",
        f'written to {out}; name it in the rig file: cams = "{out}"',
    )
    show({"table": str(out), **fit}, words)


@calibrate.command(cls=options.Command, example="calibrate level runs/excite")
@click.argument("log", type=options.PATH_TYPE)
@options.JSON_OPTION
def level(log: Path) -> int:
    """Estimate from a recorded run how far the base is off level, and say how to correct it.

    LOG is a run of the rig, preferably of the scenario `excite`: a run folder, run.parquet or CSV.
    """
    log = log_file(log)  # a wrong name is reported before anything heavy is imported
    from twin.identify.logs import read
    from twin.identify.twin_model import identify_twin
    from twin.identify.verdicts import IDENTIFIED_VERDICT

    recorded = read(log)
    with progress(f"levelling from {recorded.source}", 1.0) as advance:
        levels = identify_twin(recorded, ("level",), 1.0, advance).verdicts[: len(TILT_DIRECTIONS)]
    advice_lines = (
        f"{each.name}: {advice(each, foot)}"
        for each, foot in zip(levels, TILT_DIRECTIONS, strict=False)  # a rig of one axis has one
    )
    show([each.as_dict() for each in levels], advice_lines)
    return int(any(each.word != IDENTIFIED_VERDICT for each in levels))


def advice(found: ParameterVerdict, foot: tuple[str, str, str]) -> str:
    """Advice on the level of one axis, in words.

    Args:
        found: The tilt about the axis in deg.
        foot: Its entry of ``TILT_DIRECTIONS``.
    """
    from twin.identify.verdicts import IDENTIFIED_VERDICT

    if found.value is None or found.low is None or found.high is None:
        return found.why
    known = f"{found.value:+.4f} deg ({found.interval}, 95 %)"
    if found.low <= 0 <= found.high:
        if found.word == IDENTIFIED_VERDICT:
            return f"level within {max(-found.low, found.high):.2g} deg: nothing to do"
        return f"{known}: too uncertain to level by; {found.why}"
    along, lower, upper = foot
    rise = 1000 * math.tan(math.radians(abs(found.value)))
    side = lower if found.value > 0 else upper
    return f"{known}: raise the {side} side by {rise:.2f} mm per metre along {along}"
