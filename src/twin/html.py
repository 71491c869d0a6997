"""One look for everything that is written as an HTML file that needs nothing else."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def render(template: str, **content: Any) -> str:
    """A page from a template of this package, which extends ``page.html.j2``.

    Args:
        template: Its path below the package, as ``identify/report.html.j2``.
        content: What it shows; ``title`` among it.
    """
    return _template(template).render(**content)


def inner(template: str, **content: Any) -> str:
    """What such a page shows, without the page around it."""
    page = _template(template)
    return "".join(page.blocks["content"](page.new_context(content)))


def _template(name: str) -> Template:
    pages = Environment(
        loader=PackageLoader("twin", "."), autoescape=True, undefined=StrictUndefined
    )
    return pages.get_template(name)


def inline(figure: Figure) -> Markup:
    """A figure as SVG to stand within a page, the same bytes every time."""
    import matplotlib as mpl  # noqa: PLC0415  heavy: a page may show no figure

    out = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "ballplate", "svg.fonttype": "path"}):
        figure.savefig(
            out, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type"))
        )
    text = out.getvalue()
    return Markup(text[text.index("<svg") :])  # matplotlib's own output needs no escaping
