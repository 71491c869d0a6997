"""Makes cure_attacks.md: whether the cure's result depends on how it is simulated.

uv run python docs/cure_attacks.py
What it runs is cure_attacks.toml. A task that is done is kept as in cure.py.
"""

from __future__ import annotations

from typing import Any

from docs.cure import known
from docs.pages import HERE, filled, planned, said, write
from twin.run.assemble import batch_keys
from twin.scenario.load import load


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan = planned("cure_attacks")
    table: dict[str, list[float | None]] = {attack["name"]: [] for attack in plan["attacks"]}
    for task in plan["tasks"]:
        batches: dict[str, dict[str, Any]] = {}
        for attack in plan["attacks"]:
            run = load(plan["scenario"], [*plan["set"], *task["set"], *attack["set"]])
            batches.setdefault(str(batch_keys(run)), {})[attack["name"]] = run
        for batch in batches.values():
            for name, value in zip(batch, known([*batch.values()], task["judged"]), strict=True):
                table[name].append(value)
    write(HERE / "cure_attacks.md", filled("cure_attacks", plan=plan, table=table, said=said))


if __name__ == "__main__":
    main()
