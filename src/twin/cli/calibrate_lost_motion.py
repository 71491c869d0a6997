"""The command calibrate lost-motion: motors against plate encoders on a slow triangle."""

from __future__ import annotations

import math
from pathlib import Path

import click

from twin.cli.doctor import rig_file
from twin.cli.options import JSON, SETTING
from twin.cli.output import console, print_json, progress
from twin.cli.rigs import EMPTY_RIG
from twin.paths import model_path


@click.command("lost-motion")
@EMPTY_RIG
@click.option(
    "--amplitude",
    type=click.FloatRange(0.2, 8),
    default=1.0,
    help="Of the triangle, deg of the plate [1].",
)
@click.option("--rate", type=click.FloatRange(0.1, 5), default=1.0, help="Of the plate, deg/s [1].")
@click.option("--cycles", type=click.IntRange(2, 20), default=3, help="Of each axis [3].")
@SETTING
@JSON
def lost_motion(
    rig: str,
    amplitude: float,
    rate: float,
    cycles: int,
    overrides: tuple[str, ...],
    *,
    as_json: bool,
) -> None:
    """Turn the plate by a slow triangle; say what is lost between motor and plate, and where.

    Settings are those of the virtual rig.
    """
    from twin.devices.akd.servos import AkdServos
    from twin.devices.scheduling import real_time
    from twin.doctor.lost_motion import measure
    from twin.hal.cams import CamTable
    from twin.identify.lost_motion import KEYS
    from twin.scenario import load

    with (
        rig_file(rig, load("circle", overrides)) as (file, _),
        real_time(),
        progress("turning the plate", 1.0) as advance,
    ):
        found = measure(
            AkdServos(file.servos(0.002)),
            CamTable.from_file(Path(file.cams) if file.cams else model_path("cams.json")),
            amplitude=math.radians(amplitude),
            rate=math.radians(rate),
            cycles=cycles,
            progress=advance,
        )
        advance(1.0)
    if as_json:
        print_json([each.as_dict() for each in found])
        return
    for each in found:
        console.print(f"{each.axis}: {each.words}", markup=False, soft_wrap=True)
        if each.shape in KEYS:
            console.print(f"  in the twin: {KEYS[each.shape]} = {each.width:.3f}", markup=False)
