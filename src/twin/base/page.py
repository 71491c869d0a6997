"""A result as a page: blocks of text, tables and pictures as HTML, on a terminal, in Markdown."""

from __future__ import annotations

import io
import math
from base64 import b64encode
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from markupsafe import Markup

from twin.base.errors import plural, printable

if TYPE_CHECKING:
    import rich.table
    from jinja2 import Template
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Text:
    """Sentences, or a list of them.

    Attributes:
        lines: The sentences.
        title: Above them.
        note: Below them.
    """

    lines: Sequence[str]
    title: str = ""
    note: str = ""


@dataclass(frozen=True)
class Verdict:
    """The statement of a result, in sentences.

    Attributes:
        lines: The sentences.
        good: Whether all is well.
        title: Above them.
    """

    lines: Sequence[str]
    good: bool
    title: str = ""


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes:
        title: Above it.
        heads: One per column.
        rows: One cell per column each.
        words: The columns of words, which stand to the left; from the end if negative.
        note: Below it.
        folded: What a page shows in its place until it is asked for; empty for no.
    """

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: Collection[int] = (0,)
    note: str = ""
    folded: str = ""

    @property
    def left(self) -> set[int]:
        """The columns of words, from the begin."""
        return {column % len(self.heads) for column in self.words}


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes:
        title: Title above it.
        content: A figure, a PNG, or SVG that was made of a figure.
        note: Below it.
    """

    title: str
    content: Figure | Markup | bytes
    note: str = ""

    @property
    def shown(self) -> Markup:
        """The picture, to stand within a page."""
        if isinstance(self.content, bytes):
            data = b64encode(self.content).decode()
            return Markup('<img src="data:image/png;base64,{}" alt="{}">').format(data, self.title)
        return self.content if isinstance(self.content, Markup) else inline(self.content)


@dataclass(frozen=True)
class Code:
    """A text as it was typed.

    Attributes:
        title: Above it.
        text: The text.
        note: Below it.
    """

    title: str
    text: str
    note: str = ""


Block = Text | Verdict | Table | Picture | Code


def html(title: str, blocks: Sequence[Block], language: str = "en") -> str:
    """One HTML file that needs nothing else, in a language."""
    return _template().render(title=title, blocks=blocks, language=language)


def fragment(title: str, blocks: Sequence[Block]) -> str:
    """The same without a page around it, for a notebook."""
    heading = Markup("<h4>{}</h4>").format(title) if title else ""
    page = _template()
    content = "".join(page.blocks["content"](page.new_context({"blocks": blocks})))
    return f"<div>{heading}{content}</div>"


@cache
def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  heavy

    loader = PackageLoader("twin.base", ".")
    pages = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return pages.get_template("page.html.j2")


TEXT_AS_TEXT: Any = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"}
"""TrueType fonts, which journals accept, and text in SVG files that can be edited."""


def encode_figure(
    figure: Figure,
    kind: str,
    dpi: float | Literal["figure"] = "figure",
    *,
    text_as_paths: bool = False,
) -> bytes:
    """A figure as a file's content; the same figure gives the same bytes.

    Args:
        figure: The figure.
        kind: ``png``, ``pdf`` or ``svg``.
        dpi: Pixels per inch of what is no vector.
        text_as_paths: Whether text looks the same where its font is missing, as within a page.
    """
    import matplotlib as mpl  # noqa: PLC0415  heavy: a page may show no figure

    store = io.BytesIO()
    left_out = {"svg": ("Date", "Creator", "Format", "Type"), "pdf": ("CreationDate",)}
    fixed = dict.fromkeys(left_out.get(kind, ()))
    text = TEXT_AS_TEXT | ({"svg.fonttype": "path"} if text_as_paths else {})
    with mpl.rc_context({"svg.hashsalt": "ballplate", **text}):
        figure.savefig(store, format=kind, dpi=dpi, metadata=fixed or None)
    return store.getvalue()


def inline(figure: Figure) -> Markup:
    """A figure as SVG to stand within a page."""
    text = encode_figure(figure, "svg", text_as_paths=True).decode()
    return Markup(text[text.index("<svg") :])  # matplotlib's own output needs no escaping


def terminal(table: Table) -> rich.table.Table:
    """A table for a terminal, which breaks its cells over lines itself."""
    from rich.markup import escape  # noqa: PLC0415  only where there is a terminal
    from rich.table import Table as Drawn  # noqa: PLC0415

    drawn = Drawn(header_style="bold")
    for at, head in enumerate(table.heads):
        side: Literal["left", "right"] = "left" if at in table.left else "right"
        drawn.add_column(escape(head), justify=side, overflow="fold")
    for row in table.rows:
        drawn.add_row(*(escape(printable(cell, keep="\n")) for cell in row))
    return drawn


def markdown(
    headings: Sequence[str], rows: Iterable[Sequence[str]], words: Collection[int] = (0,)
) -> str:
    """A table of a generated document in Markdown, and the empty line after it.

    Args:
        headings: One per column.
        rows: One cell per column each.
        words: The columns of words, which stand to the left; from the end if negative.
    """
    count = len(headings)
    left = {column % count for column in words}
    rule = ["---" if column in left else "--:" for column in range(count)]
    escaped = ([cell.replace("|", r"\|") for cell in cells] for cells in (headings, *rows))
    lines = [" | ".join(cells) for cells in escaped]
    first, *others = (f"| {line} |" for line in lines)
    return "\n".join([first, f"|{'|'.join(rule)}|", *others]) + "\n"


def render_template(template: Path, **parts: Any) -> str:
    """The document of a template in Jinja's language; every part that it names must be given.

    A template may call ``plural`` of ``twin.base.errors``.
    """
    return _compile_template(template.read_text(encoding="utf-8")).render(parts)


@cache
def _compile_template(text: str) -> Template:
    """A template of this text, compiled once."""
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415  heavy: a table needs none

    how = Environment(trim_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined)
    how.globals["plural"] = plural
    return how.from_string(text)


def write(path: Path, title: str, blocks: Sequence[Block]) -> None:
    """Write ``html`` into a file.

    Raises:
        RecordError: If it cannot be written.
    """
    from twin.base.writing import write_whole  # noqa: PLC0415  a notebook writes nothing

    write_whole(path, html(title, blocks))


def percent(share: float, decimals: int = 1) -> str:
    """A share in percent, as ``17.8 %``."""
    return f"{100 * share:.{decimals}f} %"


def round_plainly(value: float) -> str:
    """A number of two digits, and zeros where it is larger: 210, not 2.1e+02."""
    return f"{float(f'{value:.2g}'):.15g}"


def digits(value: Any, unit: str = "", places: int = 4) -> str:
    """A value in the digits a person wants to read; one in m as mm, if that is its unit."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return str(value)
    return f"{1000 * value:.3g}" if unit == "mm" else f"{value:.{places}g}"
