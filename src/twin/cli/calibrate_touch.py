"""The command calibrate touch: how the touch screen is mounted, from points touched in turn."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.doctor import rig_file
from twin.cli.options import JSON
from twin.cli.output import console, print_json, print_table, progress, say
from twin.cli.rigs import EMPTY_RIG, EMULATED
from twin.errors import ScenarioError
from twin.writing import write_whole

if TYPE_CHECKING:
    from twin.doctor.touch_calibration import MeasuredTouch


@click.command()
@EMPTY_RIG
@click.option(
    "--at",
    "places",
    multiple=True,
    metavar="X,Y",
    help="A point to touch, mm in plate axes; again for each [nine over the screen].",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("touch-of-rig.json"),
    help="Calibration file [touch-of-rig.json].",
)
@JSON
def touch(rig: str, places: tuple[str, ...], out: Path, *, as_json: bool) -> None:
    """Find scale, turn, mirror and offset of the touch screen from points touched in turn.

    Mark the points on the plate; touch each with a finger or the ball when asked, hold, let go.
    """
    from twin.doctor.touch_calibration import measure, usual_points
    from twin.scenario import load

    points = [_point(text) for text in places] or usual_points()
    with rig_file(rig, load("circle")) as (file, ask):
        shown = progress("calibrating the touch screen", len(points)) if rig == EMULATED else None
        with shown or nullcontext(lambda _: None) as advance:
            found = measure(file.uncalibrated_screen(), points, ask, file.patience, advance)
    write_whole(out, found.save)
    if as_json:
        print_json({"file": str(out), **found.as_dict()})
        return
    _print(found)
    console.print(
        f'written to {out}; name it in the rig file, under [touch]: calibration_file = "{out}"',
        markup=False,
        soft_wrap=True,
    )


def _point(text: str) -> tuple[float, float]:
    """A point in m of one in mm as it is typed.

    Raises:
        ScenarioError: It is none, or is not on the plate.
    """
    try:
        x, y = (float(part) / 1e3 for part in text.split(","))
        near = max(abs(x), abs(y)) < 1
    except ValueError:
        near = False
    if not near:
        raise ScenarioError(
            f"--at {text}: must be X,Y in mm from the plate's middle, as in --at 280,-158"
        )
    return x, y


def _print(found: MeasuredTouch) -> None:
    import numpy as np

    from twin.doctor.touch_calibration import place

    rows = (
        (place(point), *(f"{1e3 * each:+.2f}" for each in off))
        for point, off in zip(found.points, found.fit.left, strict=True)
    )
    print_table(("point", "off x / mm", "off y / mm"), rows)
    worst = int(np.argmax(found.fit.distances))
    console.print(
        f"residuals: {1e3 * found.fit.rms:.2f} mm RMS, largest "
        f"{1e3 * found.fit.distances[worst]:.2f} mm at {place(found.points[worst])}"
    )
    say(*found.mounting.lines)
