"""How results show themselves in a notebook: a heading, tables, pictures."""

from __future__ import annotations

import sys
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from twin.run.finished import Run

DPI = 80
"""Resolution of pictures in a notebook."""


def shell() -> Any:
    """The IPython that this program runs in; None outside of one."""
    package: Any = sys.modules.get("IPython")
    return package.get_ipython() if package is not None else None


def showable(figure: Figure) -> Figure:
    """The figure, which a notebook shows as a picture even if pyplot was never imported."""
    running = shell()
    if running is not None:
        pictures = running.display_formatter.formatters["image/png"]
        try:
            pictures.lookup_by_type(type(figure))
        except KeyError:
            pictures.for_type(type(figure), png)
    return figure


def page(title: str, *parts: str) -> str:
    """A heading above parts in HTML."""
    heading = f"<h4>{escape(title)}</h4>" if title else ""
    return f"<div>{heading}{''.join(parts)}</div>"


def paragraphs(lines: Iterable[str]) -> str:
    """A paragraph a line."""
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of texts, the first column aligned left."""
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = "".join(f"<tr>{_cells(row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def indicators(runs: Mapping[str, Run]) -> str:
    """The indicators of runs as a table, a column for each by its heading."""
    from twin.report.numbers import rows

    lines = [(row.label, *row.values, row.unit) for row in rows(list(runs.values()))]
    return table(("", *runs, "unit"), lines)


def png_image(figure: Figure) -> str:
    """A figure as a picture that stands within the page."""
    data = b64encode(png(figure)).decode()
    return f'<img style="max-width: 100%" src="data:image/png;base64,{data}">'


def png(figure: Figure) -> bytes:
    """A figure as a PNG."""
    content = BytesIO()
    figure.savefig(content, dpi=DPI, format="png")
    return content.getvalue()


def _cells(row: Sequence[str]) -> str:
    return "".join(
        f'<td style="text-align: {"right" if index else "left"}">{escape(text)}</td>'
        for index, text in enumerate(row)
    )
