"""Makes cure_margins.md: how wrong a rig may be for the cure, one thing at a time, and all at once.

uv run python docs/cure_margins.py
What has been simulated is kept in runs/cure and used again while scenarios and code stay the same.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from docs.cure import known
from docs.pages import HERE, clopper_pearson, filled, planned, said, write
from twin.devices.lumio.config import fit
from twin.doctor.calibrate import usual_points
from twin.study.schema import FamilyRig, draw_rigs, read_family
from twin.study.work import Builder

CURE = planned("cure")
KNOWN = {each["name"]: each["set"] for each in CURE["laws"]}
LAWS = {
    "the cure": list(KNOWN.values())[-1],
    "LQR": ["controller.kind=lqr"],
    "AFL": KNOWN["AFL, thesis"],
}
VARIANCE = (7.2538e-7, 1.7721e-7)
"""Of a touch sample along x and y in m^2, Table B.1."""


def setting(margin: dict[str, Any], value: float) -> list[str]:
    """What is set of the nominal rig for one value of what is wrong."""
    key, real = margin["key"], value * margin.get("factor", 1.0)
    if margin.get("noise"):
        return [f"{key}={[real**2 * each for each in VARIANCE]}"]
    pair = [real * each for each in margin.get("pair", ())]
    return [*margin.get("also", []), f"{key}={pair or real}"]


def cases(plan: dict[str, Any]) -> list[tuple[str, str, list[str]]]:
    """What is wrong, how much, and what is set for it."""
    return [("nothing", "", [])] + [
        (margin["name"], f"{value:g}", setting(margin, value))
        for margin in plan["margins"]
        for value in margin["values"]
    ]


ROTATION_KEY = "sensors.touch.rotation_deg"


def calibrate_screen(rig: FamilyRig, finger_mm: float) -> dict[str, Any]:
    """The point of a rig after `ballplate calibrate touch`: its screen is turned by what is left.

    Nine points are touched, each missed along x and y by a normal error with a standard deviation
    of ``finger_mm``. Only the turn of the fitted calibration is used.
    """
    marks = np.array(usual_points())
    misses = np.random.default_rng([rig.seed, 9]).normal(scale=1e-3 * finger_mm, size=marks.shape)
    true_deg = float(rig.point[ROTATION_KEY])
    turn = np.radians(true_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    back_deg = fit((marks + misses) @ rotation.T, marks).mounting.turn_deg
    return rig.point | {ROTATION_KEY: true_deg + back_deg}


def found(plan: dict[str, Any]) -> dict[str, list[float | None]]:
    """Of each law e_tt in % with one thing wrong after the other, then on the family's rigs.

    ``calibrated`` is the cure on the same rigs after their screens were calibrated. None for a lost
    ball; all of a law as one batch.
    """
    about, build, values = plan["family"], Builder(CURE["scenario"]), {}
    rigs = draw_rigs(read_family(about["name"]), about["draw"], about["rigs"])

    def on_rigs(law: str, points: list[dict[str, Any]]) -> list[Any]:
        fixed = [*plan["set"], *LAWS[law]]
        pairs = zip(rigs, points, strict=True)
        return [build([*fixed, f"seed={rig.seed}"], point) for rig, point in pairs]

    for law in plan["laws"]:
        fixed = [*plan["set"], *LAWS[law], "seed=1"]
        runs = [build([*fixed, *keys], {}) for _, _, keys in cases(plan)]
        values[law] = known(runs + on_rigs(law, [rig.point for rig in rigs]))
        click.echo(f"{law}: {values[law].count(None)} of {len(values[law])} lost")
    calibrated = [calibrate_screen(rig, about["finger_mm"]) for rig in rigs]
    values["calibrated"] = known(on_rigs("the cure", calibrated))
    return values


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan = planned("cure_margins")
    about, wrong, values = plan["family"], cases(plan), found(plan)
    rigs = draw_rigs(read_family(about["name"]), about["draw"], about["rigs"])
    rows = [
        (what, much, [values[law][at] for law in plan["laws"]])
        for at, (what, much, _) in enumerate(wrong)
    ]
    on = {law: each[-len(rigs) :] for law, each in values.items()}
    kept_by_others = [
        any(on[law][at] is not None for law in plan["laws"][1:]) for at in range(len(rigs))
    ]
    cure, calibrated = (
        np.array([np.inf if each is None else each for each in on[name]])
        for name in ("the cure", "calibrated")
    )
    held = int((cure <= about["worst"]).sum())
    words = {
        "calibrated": {
            "median": float(np.median(calibrated)),
            "largest": float(calibrated.max()),
            "held": int((calibrated <= about["worst"]).sum()),
            "kept": int((np.isinf(calibrated) & kept_by_others).sum()),
        },
        "held": held,
        "share": clopper_pearson(held, len(rigs)),
        "median": float(np.median(cure)),
        "largest": float(cure.max()),
        "kept": int((np.isinf(cure) & kept_by_others).sum()),
        "worst": [(cure[at], rigs[at].point) for at in np.argsort(-cure)[:5].tolist()],
        "lost": {law: on[law].count(None) for law in plan["laws"]},
    }
    text = filled("cure_margins", plan=plan, rows=rows, said=said, laws=plan["laws"], **words)
    write(HERE / "cure_margins.md", text)


if __name__ == "__main__":
    main()
