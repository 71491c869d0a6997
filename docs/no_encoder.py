"""Makes no_encoder.md: what the lack of a plate encoder costs the cure, why, and what helps.

uv run python docs/no_encoder.py            # what no_encoder.toml says: 5 minutes of a core
Runs are in C (``twin.study.compiled``), one rig after the other. Finished ones are kept in
runs/no_encoder and used again while scenarios and code stay the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import click

from docs.cure_family import quantile, radius
from docs.cure_floor import Screen, floor
from docs.pages import HERE, compiled_rows, filled, planned, said, write
from twin.scenario.schema import Scenario
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder

Values = list[float | None]
"""An indicator of each rig; None of a ball that was lost."""
SHOWN = {"tracking_error_percent": 1.0, "rms_distance": 1e3, "u_rms": 1.0}
"""Indicators on the page, and the factors to its units."""


class Reached(NamedTuple):
    """An indicator of the laws on a task of a rig, in their order: encoder, none, with dither."""

    each: list[Values]

    def median(self, law: int) -> float | None:
        """Median of the rigs."""
        return quantile(self.each[law], 0.5)

    def worst(self, law: int) -> float | None:
        """Largest of the rigs; None if a ball was lost."""
        return quantile(self.each[law], 1.0)

    def lost(self, law: int) -> int:
        """Number of balls lost."""
        return self.each[law].count(None)

    def ratios(self, law: int) -> tuple[float | None, float | None]:
        """Median and worst as multiples of those with an encoder."""
        pairs = (self.median(law), self.median(0)), (self.worst(law), self.worst(0))
        return tuple(a / b if a and b else None for a, b in pairs)  # type: ignore[return-value]


def scaled(task: dict[str, Any], value: float | None) -> float | None:
    """A value of a task's indicator in the unit of the page."""
    return None if value is None else SHOWN[task["indicator"]] * value


def verdicts(
    plan: dict[str, Any], task: dict[str, Any], reached: Reached
) -> list[tuple[str, str, str]]:
    """What is a goal of a task, what the dither reached, and whether the goal is met."""
    goals, law = plan["goals"], len(plan["laws"]) - 1
    if task["indicator"] == "rms_distance":
        found = scaled(task, reached.median(law)), scaled(task, reached.worst(law))
        goal, unit = goals["hold_mm"], "mm"
    else:
        found, goal, unit = reached.ratios(law), goals["ratio"], "times"
    rows = [
        (name, f"{said(value, '.2f')} {unit}", "yes" if value and value <= goal else "no")
        for name, value in zip(("median", "worst"), found, strict=True)
    ]
    if unit == "mm":
        factor = SHOWN[task["indicator"]]
        within = [
            sum(factor * value <= goal for value in values if value is not None)
            for values in (reached.each[law], reached.each[0])
        ]
        rows.append(("each", f"{within[0]} of {plan['count']} rigs; {within[1]} with encoder", ""))
    return rows


def scenarios(
    plan: dict[str, Any],
    rig: str,
    task: dict[str, Any],
    law: Sequence[str],
    about: dict[str, Any],
    cause: dict[str, Any] | None = None,
) -> list[Scenario]:
    """A law on a task, on rigs about a shipped one.

    Args:
        plan: Of this page.
        rig: Name of the shipped rig.
        task: One of the plan.
        law: What the law sets; DITHER stands for that of the rig.
        about: Draw and count of the rigs.
        cause: Keys that have the nominal value in all rigs, and what is set of all.
    """
    family, build = read_family(plan["family"]), Builder("cure")
    relative = [key for key, each in family.parameters.items() if each.relative]
    nominal, more = tuple(cause["nominal"]) if cause else (), cause["set"] if cause else ()
    amplitude, rate = plan["dither"][rig]
    dither = f"controller.dither_deg={amplitude}", f"controller.dither_hz={rate}"
    sets = [each for text in law for each in (dither if text == "DITHER" else (text,))]
    own = [text.replace("RADIUS", str(radius(rig))) for text in task["set"]]
    fixed = [f"parameters={rig}", *plan["set"], *own, *sets, *more]
    found = []
    for each in draw_rigs(family, about["draw"], about["count"]):
        point = {key: value for key, value in each.point.items() if not key.startswith(nominal)}
        found.append(build([*fixed, f"seed={each.seed}"], point, relative))
    return found


def rest_floor(plan: dict[str, Any], rig: str) -> tuple[float, float]:
    """What is left of hold on a shipped rig in m: the floor of its screen, and the dither's circle.

    The floor is the linear-quadratic Gaussian one of a ball that creeps over the most uneven screen
    of the family. The circle is that on which the dither moves a ball without friction,
    x = -(c2 + k1 / w^2) a, on the plate that turns by the dither less half the play.
    """
    scenario = Builder("cure")([f"parameters={rig}"], {}, [])
    plant, touch, about = scenario.plant, scenario.sensors.touch, plan["floor"]
    rolling, model = plant.friction.rolling_mm, plant.model
    screen = Screen(rolling, about["spread"], touch.frame_rate, touch.dead_time)
    noise = sum(touch.variance) / len(touch.variance)
    least = floor(screen, about["creep"], model, noise)
    amplitude, rate = plan["dither"][rig]
    slope = math.radians(amplitude - plant.servo.backlash_deg / 2)
    return least, (model.c2 + model.k1 / (2 * math.pi * rate) ** 2) * slope


def known(runs: list[Scenario], indicator: str) -> Values:
    """An indicator of runs, on the true ball; None for a ball that was lost."""
    return [row[indicator] for row in compiled_rows("no_encoder", runs, SHOWN)]


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan, table, effort, causes = planned("no_encoder"), {}, {}, {}
    for rig in plan["rigs"]:
        for task in plan["tasks"]:
            found = [scenarios(plan, rig, task, law["set"], plan) for law in plan["laws"]]
            place = rig, task["name"]
            table[place] = Reached([known(runs, task["indicator"]) for runs in found])
            effort[place] = Reached([known(runs, "u_rms") for runs in found])
            click.echo(f"{place}: {table[place].ratios(1)}, {table[place].ratios(2)}")
        for cause, how in plan["causes"]["each"].items():
            for at, law in enumerate(plan["laws"][:2]):
                runs = scenarios(plan, rig, plan["tasks"][0], law["set"], plan["causes"], how)
                values = known(runs, "tracking_error_percent")
                causes[rig, cause, at] = quantile(values, 0.5), quantile(values, 1.0)
    words = {"said": said, "scaled": scaled, "verdicts": verdicts}
    floors = {rig: rest_floor(plan, rig) for rig in plan["rigs"]}
    parts = {"table": table, "effort": effort, "causes": causes, "floors": floors}
    write(HERE / "no_encoder.md", filled("no_encoder", plan=plan, **parts, **words))


if __name__ == "__main__":
    main()
