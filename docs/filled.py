"""A page of this folder from its template and what was found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

HERE = Path(__file__).parent


def filled(name: str, **parts: Any) -> str:
    """The page of a template in this folder."""
    text = (HERE / f"{name}.template.md").read_text(encoding="utf-8")
    strict = jinja2.StrictUndefined
    how = jinja2.Environment(trim_blocks=True, keep_trailing_newline=True, undefined=strict)
    return how.from_string(text).render(parts)
