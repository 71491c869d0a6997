"""The options --watch, --view, --connect, --serve and --rrd: look at a run, or keep a recording."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli.output import warn
from twin.errors import ScenarioError, TwinError, ViewError
from twin.run.record import Recorder
from twin.scenario import Scenario

if TYPE_CHECKING:
    from twin.view.tap import Tap
    from twin.view.viewer import Opened

WEB_PORT = 9090
SUMMING = 30.0
"""Most seconds that the summary is given for its last lines: it has the least priority."""
Watch = Callable[[Recorder], None]

OPTIONS = (
    click.option("--watch", is_flag=True, help="Sum the run up on the terminal as it goes on."),
    click.option("--view", "window", is_flag=True, help="Watch the run in a viewer window."),
    click.option("--connect", metavar="HOST:PORT", help="Watch it in a viewer that is running."),
    click.option(
        "--serve",
        type=click.IntRange(1, 65535),
        is_flag=False,
        flag_value=WEB_PORT,
        metavar="[PORT]",
        help=f"Watch it in a browser of this machine [{WEB_PORT}].",
    ),
    click.option("--rrd", type=click.Path(path_type=Path), help="Keep a recording for the viewer."),
)


class Viewing:
    """How a run is to be watched; whatever goes wrong with that, the run is done and kept.

    Args:
        watch: On the terminal.
        window: In a window of its own.
        connect: In the viewer at HOST:PORT.
        serve: In a browser, at this port.
        rrd: File for a recording.

    Raises:
        ScenarioError: If these exclude each other, or the recording has no place.
    """

    def __init__(
        self, *, watch: bool, window: bool, connect: str | None, serve: int | None, rrd: Path | None
    ) -> None:
        if sum((window, connect is not None, serve is not None)) > 1:
            raise ScenarioError("--view, --connect and --serve: choose one")
        if rrd is not None and not rrd.resolve().parent.is_dir():
            raise ScenarioError(f"--rrd {rrd}: there is no such folder")
        self.watch = watch
        self._window, self._connect, self._serve, self._rrd = window, connect, serve, rrd
        self._opened: Opened | None = None

    @contextmanager
    def of(self, scenario: Scenario, folder: Path) -> Iterator[Watch]:
        """Watch the run made within, which is called like its folder."""
        with ExitStack() as open_taps:
            taps = []
            if self.watch:
                from twin.view import tap, terminal  # noqa: PLC0415  loaded when asked for

                taps.append(tap.Tap(terminal.work, (scenario,)))
                open_taps.callback(taps[-1].close)
            shown = self._open(scenario, folder.name)
            if shown is not None:
                open_taps.callback(shown.close)
                taps.append(shown)

            def watch(recorder: Recorder) -> None:
                for each in taps:
                    each.watch(recorder)

            yield watch
            if self.watch:
                taps[0].finish(SUMMING)
            if shown is not None:
                self._end(shown)

    def _end(self, shown: Tap) -> None:
        """Let the view catch up and tell what it missed."""
        if not shown.finish():
            warn("the view stopped before the end; the run and its record are complete")
        elif shown.dropped:
            warn(f"the view missed {shown.dropped} rows; the record has them all")

    def keep(self, folder: Path) -> None:
        """Write the recording of the saved run; keep a page until Ctrl-C."""
        if self._rrd is not None:
            from twin.run.replay import open_run  # noqa: PLC0415  loaded when asked for
            from twin.view.recording import write  # noqa: PLC0415

            try:
                write(self._rrd, open_run(folder))
                click.echo(f"written to {self._rrd}", err=True)
            except TwinError as error:
                warn(f"{error}; the run itself is in {folder}/")
        if self._opened is not None and self._opened.page:
            click.echo("the page stays until Ctrl-C", err=True)
            try:
                self._opened.process.wait()
            except KeyboardInterrupt:
                self._opened.close()

    def _open(self, scenario: Scenario, name: str) -> Tap | None:
        """Start the view that was asked for; None if there is none or it cannot be."""
        if not (self._window or self._connect or self._serve):
            return None
        from twin.view import live, viewer  # noqa: PLC0415  loaded when asked for

        url = live.address(self._connect) if self._connect is not None else ""
        try:
            if url:
                live.reach(url)
            else:
                self._opened = viewer.page(self._serve) if self._serve else viewer.window()
                url = self._opened.url
        except ViewError as error:
            warn(f"{error}; the run goes on without a view")
            return None
        if self._opened is not None and self._opened.page:
            click.echo(f"open {self._opened.page} in a browser", err=True)
        return live.live(scenario, name, url)


def VIEWING(command: Callable[..., Any]) -> Callable[..., Any]:  # noqa: N802  an option, like JSON
    """Give a command the options above, as one argument ``viewing``."""

    @functools.wraps(command)
    def wrapped(
        *args: Any,
        watch: bool,
        window: bool,
        connect: str | None,
        serve: int | None,
        rrd: Path | None,
        **kwargs: Any,
    ) -> Any:
        viewing = Viewing(watch=watch, window=window, connect=connect, serve=serve, rrd=rrd)
        return command(*args, viewing=viewing, **kwargs)

    for option in reversed(OPTIONS):
        wrapped = option(wrapped)
    return wrapped
