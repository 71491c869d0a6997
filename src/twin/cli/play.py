"""The command play: the rig in real time in a browser window, driven by a person."""

from __future__ import annotations

from pathlib import Path

import click

from twin.cli import completion as tab
from twin.cli.options import LAW, PLANT, SETTING, load_scenario, with_plant
from twin.cli.output import console, warn
from twin.shipped import find
from twin.writing import check_writable

PORT = 8090


@click.command()
@click.argument("scenario", default="hold", shell_complete=tab.scenarios)
@LAW
@SETTING
@PLANT
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [runs/play-SCENARIO].")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=PORT,
    show_default=True,
    help="Port of the page; 0 for a free one.",
)
@click.option(
    "--address",
    default="127.0.0.1",
    show_default=True,
    help="Serve there, behind a token; otherwise on this machine alone.",
)
@click.option("--no-browser", is_flag=True, help="Open no window; print the address only.")
@click.option("--seconds", type=click.FloatRange(min=0), help="End by itself after this time, s.")
def play(
    scenario: str,
    overrides: tuple[str, ...],
    plant: str | None,
    out: Path | None,
    port: int,
    address: str,
    seconds: float | None,
    *,
    no_browser: bool,
) -> int:
    """Drive the rig yourself, in real time, in a browser window.

    Drag the goal, push the ball, move friction, dead time, level and gains by sliders, choose
    another law or observer, pause, go back; the clean model goes beside. A saved run is a run
    folder like any other. It ends with Ctrl-C, or when the page is closed; what was driven and not
    saved is saved then.
    """
    find(scenario)  # a wrong name is told before anything heavy is imported
    from twin.play.serve import Server, folder_of, library, open_browser

    library()
    chosen = load_scenario(scenario, with_plant(overrides, plant))
    folder = out or folder_of(scenario)
    check_writable(folder)
    server = Server(chosen, folder, address=address, port=port, seconds=seconds)
    if server.token:
        warn(f"the page can be reached from other machines, by whoever has this address: {address}")

    def begun() -> None:
        console.print(f"open {server.url} in a browser; Ctrl-C ends it", soft_wrap=True)
        if not no_browser:
            open_browser(server.url)

    server.run(begun)
    if server.failure is not None:
        lost = "what was driven since it was last saved is lost"
        click.echo(f"ballplate: {server.failure}; {lost}", err=True)
        return 1
    if server.lost:
        click.echo(f"ballplate: {server.kept}", err=True)
        return 1
    if server.kept:
        console.print(f"ended without saving, so {server.kept}", soft_wrap=True, markup=False)
    return 0
