"""Counts the code of every layer again and writes it into the table of ARCHITECTURE.md.

uv run python docs/code_lines.py

Comments, docstrings and blank lines are no code.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from pathlib import Path

ROOT = Path(__file__).parent.parent
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
ROW = re.compile(r"^\| `([^|]+)` \| ([\d,]+) \|", re.MULTILINE)
"""A row of the table: its folders and modules, and how many lines they have."""


def code_lines(source: str) -> int:
    """Lines of a module's text that hold code."""
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                code.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(code)


def counted(places: str) -> int:
    """Lines of folders and modules, as a row names them: parted by commas."""
    paths = [ROOT / place for place in places.split("`, `")]
    modules = [each for path in paths for each in ([path], path.rglob("*.py"))[path.is_dir()]]
    return sum(code_lines(module.read_text(encoding="utf-8")) for module in modules)


def up_to_date(text: str) -> str:
    """The page's text with every number counted again."""
    return ROW.sub(lambda row: f"| `{row[1]}` | {counted(row[1]):,} |", text)


if __name__ == "__main__":
    page = ROOT / "ARCHITECTURE.md"
    page.write_text(up_to_date(page.read_text(encoding="utf-8")), encoding="utf-8")
