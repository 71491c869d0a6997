"""Receivers of progress and warnings, and the display of results in a notebook."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from numbers import Integral
from os import PathLike
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol

from twin.base.errors import ScenarioError
from twin.base.writing import check_writable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from twin.run.finished import Run


OWN_PACKAGES = ("ballplate", "twin", "contextlib")
"""Packages that a warning is not attributed to."""
LINE_EVERY = 10.0
"""Seconds between two lines of progress where there is no terminal."""


class BallplateWarning(UserWarning):
    """Something is allowed but not wise, as an unstable loop.

    Examples:
        >>> import warnings
        >>> import ballplate as bp
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always", bp.BallplateWarning)
        ...     done = bp.run("circle", ["plant.kind=lagrange", "reference.omega=5"], duration=1)
        >>> print(caught[0].message)
        reference: it asks for up to 3.99 m/s^2, a plate at 10 deg gives 1.02: no law can follow it
    """


class Advance(Protocol):
    """Shows how much of the total is done, and perhaps a note."""

    def __call__(self, done: float, note: str = "", /) -> None:
        """Show it."""


class Reporter:
    """Shows no progress and passes warnings on to Python's; subclass it to show more.

    Examples:
        >>> import ballplate as bp
        >>> class Printed(bp.Reporter):
        ...     def warn(self, message):
        ...         print("Warning:", message)
        >>> settings = ["plant.kind=lagrange", "reference.omega=5"]
        >>> done = bp.run("circle", settings, duration=1, reporter=Printed())
        Warning: reference: it asks for up to 3.99 m/s^2, a plate at 10 deg gives 1.02: no law ...
    """

    def progress(self, what: str, total: float, unit: str = "") -> AbstractContextManager[Advance]:
        """The progress of some work, shown within the context.

        Args:
            what: Label of the work.
            total: What ``done`` is when all is done.
            unit: What is counted, as ``runs``; without one the share done is meant.
        """
        del what, total, unit
        return nullcontext(lambda *_: None)

    def warn(self, message: str) -> None:
        """Something is allowed but not wise."""
        warnings.warn(message, BallplateWarning, stacklevel=_outside())

    def note(self, line: str, *, weighty: bool = False) -> None:
        """A line about a run on a rig: its timing, or, weightier, what was detected."""

    def name_of(self, argument: str) -> str:
        """Name of an argument in messages to the user."""
        return argument


class Notebook(Reporter):
    """Tells progress below the cell of a notebook, a line now and then."""

    def progress(self, what: str, total: float, unit: str = "") -> AbstractContextManager[Advance]:
        """Lines while the work goes on."""
        return nullcontext(now_and_then(what, total, unit, print))


def now_and_then(what: str, total: float, unit: str, say: Callable[[str], object]) -> Advance:
    """Progress, printed in a line every ``LINE_EVERY`` seconds; what, total and unit as there.

    Args:
        what: Label of the work.
        total: What ``done`` is when all is done.
        unit: What is counted.
        say: Is given the lines.
    """
    last = monotonic()

    def line(done: float, note: str = "", /) -> None:
        nonlocal last
        if monotonic() - last > LINE_EVERY:
            say(f"{what}: {format_progress(done, total, unit, note)}")
            last = monotonic()

    return line


def format_progress(done: float, total: float, unit: str, note: str) -> str:
    """How far some work is, in words; arguments as for ``Reporter.progress``."""
    share = f"{done:.0f} of {total:.0f} {unit}" if unit else f"{min(done / total, 1):.0%}"
    return f"{share}, {note}" if note else share


def writable(out: str | Path | None, reporter: Reporter) -> Path | None:
    """The folder to save in, after a look whether that can be written; None for none.

    Raises:
        ScenarioError: If it cannot, or is no path.
    """
    if out is None:
        return None
    option = reporter.name_of("out")
    if not isinstance(out, str | PathLike):
        raise ScenarioError(f"{option}: must be a path, got {out!r:.40}")
    return check_writable(Path(out), option)


def check_processes(processes: object, reporter: Reporter) -> None:
    """Check how many processes are asked for; None means one for each processor.

    Raises:
        ScenarioError: If it is no whole number of at least 1.
    """
    if processes is None:
        return
    if not isinstance(processes, Integral) or processes < 1:
        what = reporter.name_of("processes")
        raise ScenarioError(f"{what}: must be a whole number of at least 1, got {processes!r:.40}")


def default() -> Reporter:
    """The reporter of where this program runs: a notebook has its own."""
    return Notebook() if hasattr(shell(), "kernel") else Reporter()


def _outside() -> int:
    """How many levels above the caller the first line of a user's program is."""
    frame, level = sys._getframe(1), 1
    while (
        frame.f_back is not None and frame.f_globals["__name__"].partition(".")[0] in OWN_PACKAGES
    ):
        frame, level = frame.f_back, level + 1
    return level


NOTEBOOK_DPI = 80
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


def overview(title: str, runs: Mapping[str, Run], figure: Figure) -> str:
    """Runs by their headings for a notebook: their indicators and a picture."""
    from twin.base.page import Picture, fragment
    from twin.run.tables import indicators

    table = indicators("", {heading: each.metrics for heading, each in runs.items()})
    return fragment(title, [table, Picture("", png(figure))])


def png(figure: Figure) -> bytes:
    """A figure as a PNG."""
    from twin.base.page import encode_figure

    return encode_figure(figure, "png", NOTEBOOK_DPI)
