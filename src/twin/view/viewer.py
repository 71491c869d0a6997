"""The viewer's program, started with usage reports off and reachable from this machine only."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from rerun.experimental import ViewerClient

from twin.errors import ViewError
from twin.jobs import wait_until

NEEDS = "it needs a Vulkan driver (Debian: mesa-vulkan-drivers)"


def program() -> Path:
    """The viewer that comes with the package.

    Raises:
        ViewError: If it is missing.
    """
    import rerun_cli  # noqa: PLC0415  a missing viewer must not break what only writes files

    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(rerun_cli.__file__).parent / name
    if not path.is_file():
        raise ViewError(f"the viewer is missing at {path}; reinstall rerun-sdk, or use --rrd FILE")
    return path


def environment() -> dict[str, str]:
    """The environment of a viewer that sends no usage reports.

    The viewer takes a machine with CI set for one that must not report; it then makes no
    identifier and no report file either.
    """
    kept = {key: value for key, value in os.environ.items() if key != "FORCE_RERUN_ANALYTICS"}
    return {**kept, "CI": "1", "TELEMETRY_ENABLED": "false"}


def has_display() -> bool:
    """Whether a window can be opened."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def free_port() -> int:
    """A port of this machine that nobody uses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def check_free(port: int) -> None:
    """Find out whether a port of this machine can be used.

    Raises:
        ViewError: If it is taken or not allowed.
    """
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", port))
    except OSError as error:
        raise ViewError(f"port {port}: {error.strerror}; choose another") from error


@dataclass(frozen=True)
class Opened:
    """A running viewer.

    Attributes:
        process: The program.
        url: Where it takes data.
        page: Where a browser finds it; empty for a window.
    """

    process: subprocess.Popen[bytes]
    url: str
    page: str = ""

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait()


def window(*files: Path) -> Opened:
    """A viewer window that shows files, or waits for data.

    Raises:
        ViewError: If there is no display, or no viewer.
    """
    if not has_display():
        raise ViewError("no display for a viewer window; use --rrd FILE, --serve or --connect")
    port = free_port()
    more = [*map(str, files)] or ["--expect-data-soon"]
    return Opened(_start(*_local(port), *more), _url(port))


def page(web_port: int, *files: Path) -> Opened:
    """A page of this machine, and only for it, that shows files or waits for data.

    Raises:
        ViewError: If the port is taken, or there is no viewer.
    """
    check_free(web_port)
    port = free_port()
    command = [*_local(port), "--serve-web", "--web-viewer-port", str(web_port)]
    process = _start(*command, *map(str, files))
    if hasattr(os, "setpriority"):
        os.setpriority(os.PRIO_PROCESS, process.pid, 15)  # the control loop comes first
    _wait_for(process, port)
    data = quote(_url(port), safe="")
    return Opened(process, _url(port), f"http://127.0.0.1:{web_port}/?url={data}")


@contextmanager
def headless(
    path: Path, size: tuple[int, int] = (1600, 900), wait: float = 30.0
) -> Iterator[ViewerClient]:
    """A viewer without a window that has loaded a file.

    Args:
        path: The ``.rrd`` file.
        size: Width and height in points.
        wait: Longest time in s for starting and for loading.

    Raises:
        ViewError: If it does not start, does not load the file, or ends by itself.
    """
    port = free_port()
    viewer = _start(*_local(port), "--headless", "--window-size", f"{size[0]}x{size[1]}")
    try:
        client = _connect(viewer, port, wait)
        client.open(str(path.resolve()))
        if not wait_until(lambda: _loaded(client), wait, 0.1):
            raise ViewError(f"the viewer did not load {path} within {wait:g} s")
        yield client
    except ConnectionError as error:
        raise ViewError(f"the viewer ended by itself; {NEEDS}") from error
    finally:
        viewer.terminate()
        viewer.wait()


def _loaded(client: ViewerClient) -> bool:
    state = client.get_state()
    return not state.loading and any(each.timelines for each in state.recordings)


def _connect(viewer: subprocess.Popen[bytes], port: int, wait: float) -> ViewerClient:
    until = time.monotonic() + wait
    while viewer.poll() is None and time.monotonic() < until:
        try:
            client = ViewerClient.connect(_url(port))
            client.get_state()
        except (RuntimeError, ValueError, OSError):
            time.sleep(0.1)
        else:
            return client
    raise ViewError(f"the viewer did not start; {NEEDS}")


def _local(port: int) -> list[str]:
    """The command that starts the viewer, listening on this machine only."""
    return [str(program()), "--bind", "127.0.0.1", "--port", str(port)]


def _url(port: int) -> str:
    return f"rerun+http://127.0.0.1:{port}/proxy"


def _wait_for(process: subprocess.Popen[bytes], port: int, wait: float = 10.0) -> None:
    """Return when a program listens at a port."""
    until = time.monotonic() + wait
    while process.poll() is None and time.monotonic() < until:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    process.terminate()
    process.wait()
    raise ViewError(f"the viewer's server did not start at port {port}")


def _start(*command: str) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(
            command,
            env=environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the run
        )
    except OSError as error:
        raise ViewError(f"the viewer {command[0]} cannot be started: {error.strerror}") from error
