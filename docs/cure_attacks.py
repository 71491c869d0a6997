"""Makes cure_attacks.md: whether the cure's result depends on how it is simulated.

uv run python docs/cure_attacks.py
What it runs is cure_attacks.toml. A task that is done is kept as in cure.py.
"""

from __future__ import annotations

import click
from cure import known
from pages import HERE, filled, planned, said

from twin.writing import write_whole


@click.command()
def main() -> None:
    """Simulate what is not kept, then write the page."""
    from twin.scenario.load import load  # noqa: PLC0415

    plan = planned("cure_attacks")
    table: dict[str, list[float | None]] = {}
    for attack in plan["attacks"]:
        table[attack["name"]] = []
        for task in plan["tasks"]:
            run = load(plan["scenario"], [*plan["set"], *task["set"], *attack["set"]])
            table[attack["name"]] += known([run], task["judged"]) or [None]
        click.echo(f"{attack['name']}: {table[attack['name']]}")
    write_whole(HERE / "cure_attacks.md", filled("cure_attacks", plan=plan, table=table, said=said))


if __name__ == "__main__":
    main()
