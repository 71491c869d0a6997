"""Makes cure_attacks.md: whether the cure's result depends on how it is simulated.

uv run python docs/cure_attacks.py
What it runs is cure_attacks.toml. A task that is done is kept as in cure.py.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import click

HERE = Path(__file__).parent
KEPT = HERE.parent / "runs" / "cure"


def value(scenario: Any, judged: str) -> float | None:
    """What a scenario is judged by, simulated or kept; None if the ball was lost."""
    from cure import known  # noqa: PLC0415  the script beside this one

    found: list[float | None] = known([scenario], judged, KEPT)
    return found[0]


def page(plan: dict[str, Any], table: dict[str, list[float | None]]) -> str:
    """The page as Markdown."""
    heads = [task["name"] for task in plan["tasks"]]
    lines = [
        "# The cure under attack: does its result depend on how it is simulated?",
        "",
        "Made by `uv run python docs/regenerate.py cure_attacks`; what it runs is "
        "`docs/cure_attacks.toml`.",
        "",
        "Law `stable_inversion` behind observer `friction_map_kalman`, gains as shipped, on the "
        "nominal rig, one run a cell, judged by the true ball. Laws and observer know nothing of "
        "presliding, by which the contact bends before friction resists in full (Dahl's model). "
        "`-`: ball lost.",
        "",
        f"| changed | {' | '.join(heads)} |",
        "|---" + "|--:" * len(heads) + "|",
    ]
    for name, row in table.items():
        texts = ["-" if found is None else f"{found:.2f}" for found in row]
        lines.append(f"| {name} | {' | '.join(texts)} |")
    return "\n".join([*lines, ""])


@click.command()
def main() -> None:
    """Simulate what is not kept, then write the page."""
    from twin.scenario.load import load  # noqa: PLC0415

    plan = tomllib.loads((HERE / "cure_attacks.toml").read_text(encoding="utf-8"))
    table: dict[str, list[float | None]] = {}
    for attack in plan["attacks"]:
        keys = [[*plan["set"], *task["set"], *attack["set"]] for task in plan["tasks"]]
        table[attack["name"]] = [
            value(load(plan["scenario"], each), task["judged"])
            for each, task in zip(keys, plan["tasks"], strict=True)
        ]
        click.echo(f"{attack['name']}: {table[attack['name']]}")
    (HERE / "cure_attacks.md").write_text(page(plan, table), encoding="utf-8")


if __name__ == "__main__":
    main()
