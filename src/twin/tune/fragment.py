"""What a tune leaves for others: keys that lie over any scenario."""

from __future__ import annotations

import json
from typing import Any

from twin.study.family import Point
from twin.tune.trials import Trials

CONTROLLER = ("controller", "observer", "predictor")
"""Tables of a scenario that belong together and are given as a whole."""


def settings(trials: Trials, fields: Point) -> dict[str, Any]:
    """The tuned controller as dotted scenario keys: all of it, and every other field.

    Args:
        trials: With the tune.
        fields: Values of its fields.
    """
    scenario = json.loads(trials.scenario(fields, 0).model_dump_json())
    found: dict[str, Any] = {}
    for table in CONTROLLER:
        for key, value in (scenario[table] or {}).items():
            inner = value if isinstance(value, dict) else {"": value}
            found |= {f"{table}.{key}.{name}".rstrip("."): each for name, each in inner.items()}
    for field in fields:
        parts = field.split(".")
        key = ".".join(parts[:-1] if parts[-1].isdigit() else parts)
        if parts[0] not in CONTROLLER:
            value = scenario
            for name in key.split("."):
                value = value[name]
            found[key] = value
    return {key: value for key, value in found.items() if value is not None}


def toml(settings: dict[str, Any], comment: list[str]) -> str:
    """Keys as a TOML file that ``--set parameters=FILE`` lays over a scenario.

    Args:
        settings: Values by dotted key: texts, numbers, truth values and lists of them.
        comment: Lines at its head.
    """
    lines = [f"# {line}".rstrip() for line in comment]
    # JSON of texts, numbers, truth values and lists of them is TOML, too
    lines += [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    return "\n".join(lines) + "\n"


def options(settings: dict[str, Any]) -> str:
    """The same as options of a command line."""
    return " ".join(f"--set '{key}={json.dumps(value)}'" for key, value in settings.items())
