"""The viewer's program, started with usage reports off and reachable from this machine only."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from twin.base.errors import ViewError
from twin.base.jobs import wait_until

START_LIMIT_S = 10.0
"""Longest time in s that the server of a page may take to start."""


def program() -> Path:
    """The viewer that comes with the package."""
    import rerun_cli  # noqa: PLC0415  a missing viewer must not break what only writes files

    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    return Path(rerun_cli.__file__).parent / name


def environment() -> dict[str, str]:
    """The environment of a viewer that sends no usage reports.

    The viewer takes a machine with CI set for one that must not report; it then makes no
    identifier and no report file either.
    """
    kept = {key: value for key, value in os.environ.items() if key != "FORCE_RERUN_ANALYTICS"}
    return {**kept, "CI": "1", "TELEMETRY_ENABLED": "false"}


def bound(address: str, port: int) -> socket.socket:
    """A socket at an address of this machine and a port, 0 for a free one.

    Raises:
        ViewError: If it is taken or not allowed.
    """
    made = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((address, port))
    except OSError as error:
        made.close()
        reason = error.strerror or error
        raise ViewError(f"address {address}, port {port}: {reason}; choose another") from error
    return made


@dataclass(frozen=True)
class Opened:
    """A running viewer.

    Attributes:
        process: The program.
        port: Where it takes data.
        page: Where a browser finds it; empty for a window.
    """

    process: subprocess.Popen[bytes]
    port: int
    page: str = ""

    @property
    def url(self) -> str:
        """The address where it takes data, in its own form."""
        return f"rerun+http://127.0.0.1:{self.port}/proxy"

    @property
    def listens(self) -> bool:
        """Whether it has not ended and takes data."""
        with socket.socket() as probe:
            reached = probe.connect_ex(("127.0.0.1", self.port)) == 0
        return reached and self.process.poll() is None

    def wait(self) -> int:
        """Wait until it is closed, or Ctrl-C closes it; its exit code."""
        try:
            return self.process.wait()
        except KeyboardInterrupt:
            self.close()
            return 0

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait()


def start_viewer(*options: str | Path) -> Opened:
    """The viewer, listening on a free port of this machine only.

    Raises:
        ViewError: If it is missing or cannot be started.
    """
    path = str(program())
    with bound("127.0.0.1", 0) as probe:
        port = int(probe.getsockname()[1])
    try:
        process = subprocess.Popen(
            (path, "--bind", "127.0.0.1", "--port", str(port), *map(str, options)),
            env=environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the run
        )
    except OSError as error:
        why = f"{error.strerror}; reinstall rerun-sdk, or use --rrd FILE"
        raise ViewError(f"the viewer {path} cannot be started: {why}") from error
    return Opened(process, port)


def window(*files: Path) -> Opened:
    """A viewer window that shows files, or waits for data.

    Raises:
        ViewError: If there is no display, or no viewer.
    """
    needs_none = sys.platform in ("win32", "darwin")
    if not (needs_none or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewError("no display for a viewer window; use --rrd FILE or --serve")
    return start_viewer(*files or ("--expect-data-soon",))


def page(web_port: int, *files: Path) -> Opened:
    """A page of this machine, and only for it, that shows files or waits for data.

    Raises:
        ViewError: If the port is taken, or there is no viewer.
    """
    bound("127.0.0.1", web_port).close()
    made = start_viewer("--serve-web", "--web-viewer-port", str(web_port), *files)
    if hasattr(os, "setpriority"):
        os.setpriority(os.PRIO_PROCESS, made.process.pid, 15)  # the control loop comes first
    wait_until(lambda: made.listens or made.process.poll() is not None, START_LIMIT_S, 0.05)
    if not made.listens:
        made.close()
        raise ViewError(f"the viewer's server did not start at port {made.port}")
    data = quote(made.url, safe="")
    return replace(made, page=f"http://127.0.0.1:{web_port}/?url={data}")
