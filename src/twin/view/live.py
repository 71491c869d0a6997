"""Where a running experiment can be watched: a window, a page, a viewer elsewhere."""

from __future__ import annotations

import re
import socket

from twin.errors import ScenarioError, ViewError
from twin.scenario.schema import Scenario
from twin.view.layout import Layout
from twin.view.sender import work
from twin.view.tap import Tap


def live(
    scenario: Scenario,
    name: str,
    url: str,
    *,
    rigs: tuple[int, ...] = (0,),
    layout: Layout = "showing",
) -> Tap:
    """Show a run while it goes on.

    Args:
        scenario: What is run.
        name: What the run is called.
        url: Address of the viewer, or of the server of a page.
        rigs: Which of N rigs are shown, over each other.
        layout: Which tab is open.
    """
    names = (name,) if len(rigs) == 1 else tuple(f"{name}-rig-{rig}" for rig in rigs)
    return Tap(work, (scenario, names, url, layout), rigs)


def address(text: str) -> str:
    """The address of a viewer as it wants it, for HOST:PORT or a complete one.

    Raises:
        ScenarioError: If it is none.
    """
    host = r"[\w.\-]+|\[[0-9a-fA-F:]+\]"
    found = re.fullmatch(rf"(?:rerun\+http://)?({host}):(\d{{1,5}})(?:/proxy)?", text)
    if found is None or not 0 < int(found[2]) < 65536:
        raise ScenarioError(f"--connect '{text}': write HOST:PORT, as in 127.0.0.1:9876")
    return f"rerun+http://{found[1]}:{found[2]}/proxy"


def reach(url: str) -> str:
    """The address itself, if somebody listens there.

    Raises:
        ViewError: If nobody does.
    """
    host, _, port = url.removeprefix("rerun+http://").removesuffix("/proxy").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=2.0).close()
    except OSError as error:
        raise ViewError(f"{host}:{port}: no viewer there ({error.strerror or error})") from error
    return url
