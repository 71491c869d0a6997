"""Makes cure_attacks.md: whether the cure's result depends on how it is simulated.

uv run python docs/cure_attacks.py
What it runs is cure_attacks.toml. A task that is done is kept as in cure.py.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import click
from cure import known, said
from pages import filled

HERE = Path(__file__).parent


def page(plan: dict[str, Any], table: dict[str, list[float | None]]) -> str:
    """The page as Markdown."""
    rows = {name: [said(value) for value in row] for name, row in table.items()}
    return filled("cure_attacks", tasks=[task["name"] for task in plan["tasks"]], table=rows)


@click.command()
def main() -> None:
    """Simulate what is not kept, then write the page."""
    from twin.scenario.load import load  # noqa: PLC0415

    plan = tomllib.loads((HERE / "cure_attacks.toml").read_text(encoding="utf-8"))
    table: dict[str, list[float | None]] = {}
    for attack in plan["attacks"]:
        table[attack["name"]] = []
        for task in plan["tasks"]:
            run = load(plan["scenario"], [*plan["set"], *task["set"], *attack["set"]])
            table[attack["name"]] += known([run], task["judged"]) or [None]
        click.echo(f"{attack['name']}: {table[attack['name']]}")
    (HERE / "cure_attacks.md").write_text(page(plan, table), encoding="utf-8")


if __name__ == "__main__":
    main()
