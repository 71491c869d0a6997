"""The page's server, and the simulation in a process of its own that neither stalls."""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import logging
import multiprocessing
import secrets
from collections.abc import Awaitable, Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from time import monotonic
from typing import Any
from urllib.parse import urlsplit

from controllers import catalog
from controllers.arrays import Array
from controllers.catalog import error_words
from twin.base.errors import TwinError, printable, shorten
from twin.base.jobs import SecondProcess, let_go, settle, spawn
from twin.base.parts import extra
from twin.play.driven import Part, save_driven
from twin.play.session import (
    PICTURE_COLUMNS,
    End,
    Errors,
    Event,
    Notification,
    Pause,
    Save,
    Session,
    Status,
)
from twin.run.files import free
from twin.scenario.schema import Scenario
from twin.view.live_process import SharedRingBuffer
from twin.view.viewer import bound

PICTURE_BUFFER_ROWS = 1024
"""Pictures that wait to be fetched: 20 s of them."""
SERVER_START_TIMEOUT_S = 60.0
"""Seconds that the process may take to start."""
STOP_TIMEOUT_S = 30.0
"""Seconds that it may take to end, with what is still to be saved."""


class Failure(str):
    """Why the simulation could not begin, or go on, in a line."""

    __slots__ = ()


class Simulation:
    """A driven rig in a separate process, in which time stands still until it is released.

    Args:
        scenario: What to begin with.

    Raises:
        TwinError: If it cannot be driven by hand.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._ring = SharedRingBuffer(PICTURE_BUFFER_ROWS, len(PICTURE_COLUMNS))
        self._ring.name(PICTURE_COLUMNS)
        self._pipe, its = multiprocessing.Pipe()
        self.failure: Failure | None = None
        """Why it ended by itself."""
        self._process = spawn(_work, self._ring.address, scenario, its, daemon=False)
        its.close()
        begun = monotonic()
        statuses: list[Status] = []
        try:
            while not statuses and self.failure is None:
                statuses = self.news(wait=0.1)
                if monotonic() - begun > SERVER_START_TIMEOUT_S:
                    raise TwinError(
                        f"the simulation does not start within {SERVER_START_TIMEOUT_S:g} s"
                    )
            if self.failure is not None:
                raise TwinError(self.failure)
        except BaseException:
            self.close()
            raise
        self.first: Status = statuses[-1]
        """How things are to begin with."""

    def send(self, event: Event) -> None:
        """Let something happen."""
        try:
            self._pipe.send(event)
        except OSError:
            self._fail("the simulation's process was ended")

    def pictures(self) -> Array:
        """The pictures since the last call, shape (K, len(COLUMNS))."""
        return self._ring.take()

    def news(self, wait: float = 0.0) -> list[Status]:
        """The messages since the last call, oldest first."""
        found: list[Status] = []
        try:
            while self._pipe.poll(wait):
                message = self._pipe.recv()
                wait = 0.0
                if isinstance(message, Failure):
                    self._fail(message)
                else:
                    found.append(message)
        except (EOFError, OSError):
            self._fail("the simulation's process was ended")
        return found

    def _fail(self, why: str) -> None:
        self.failure = self.failure or Failure(why)

    def close(self, folder: Path | None = None) -> Status | None:
        """End it, once what is being saved is written.

        Args:
            folder: Where what was driven since it was last saved is kept; None to drop it.

        Returns:
            The last status, if there is one; the result of saving.
        """
        last: list[Status] = []
        if self._process.is_alive() and self.failure is None:
            self.send(End(folder))
            until = monotonic() + STOP_TIMEOUT_S
            while self.failure is None and monotonic() < until:
                last = self.news(wait=0.1) or last
            self._process.join(STOP_TIMEOUT_S)
        let_go(self._process)
        self._pipe.close()
        self._ring.close()
        return last[-1] if last else None


def _work(address: tuple[int, int, str], scenario: Scenario, pipe: Connection) -> None:
    """The body of the process."""
    settle()
    ring = SharedRingBuffer(*address)

    def tell(message: Status | Failure) -> None:
        with suppress(OSError):  # nobody is there any more: the next look for events ends it
            pipe.send(message)

    def show(numbers: tuple[float, ...]) -> None:
        ring.slot()[: len(PICTURE_COLUMNS)] = numbers
        ring.put()

    notes: SimpleQueue[Notification] = SimpleQueue()

    def news() -> Sequence[Notification]:
        return [notes.get() for _ in range(notes.qsize())]

    try:
        with SecondProcess(wanted=True) as drawing, ThreadPoolExecutor() as writers:

            def saved(part: Part, folder: Path) -> None:
                try:
                    drawing.begin(save_driven, part, folder)()
                    notes.put(Notification(f"saved as {folder}/"))
                except TwinError as error:
                    notes.put(Notification(str(error), wrong=True))

            def inbox(wait: float) -> Sequence[Event]:
                found: list[Event] = []
                try:
                    while pipe.poll(wait):
                        wait = 0.0
                        found.append(pipe.recv())
                except (EOFError, OSError):
                    found.append(End())
                return [*found, *news()]

            Session(
                scenario,
                inbox=inbox,
                show=show,
                tell=tell,
                write=lambda part, folder: writers.submit(saved, part, folder),
                paused=True,
            ).run()
            writers.shutdown()
            for message, wrong in news():
                tell(Status({}, message=message, wrong=wrong))
    except TwinError as error:
        tell(Failure(error))
    except Exception as error:  # noqa: BLE001 - a law of one's own may raise anything
        tell(Failure(catalog.locate_error(error) or f"the simulation failed: {error!r}"))
    ring.close()


App = Callable[[Any, Any, Any], Awaitable[None]]

TOKEN_COOKIE = "ballplate_token"
REFUSED_MESSAGE = "refused: the address needs ?token=..., as ballplate play has printed it\n"


def is_loopback(host: str) -> bool:
    """Whether a host, by name or address, is this machine and nothing else."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def require_token(app: App, token: str = "") -> App:
    """An ASGI application that passes only permitted requests to the application it wraps.

    A page of a foreign origin may not, whatever browser it runs in: neither open a connection nor,
    by a name that leads to this machine, read the served files.

    Args:
        app: Who answers.
        token: What the address must carry as ``?token=``, or a cookie that is set then; empty for
            a server that is reached from this machine only.
    """
    from starlette.requests import HTTPConnection  # noqa: PLC0415 - of the extra
    from starlette.responses import PlainTextResponse  # noqa: PLC0415

    def may(asked: HTTPConnection, given: str) -> bool:
        host, origin = asked.headers.get("host", ""), asked.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return False
        if not token:
            return is_loopback(urlsplit(f"//{host}").hostname or "")
        both = (asked.cookies.get(TOKEN_COOKIE, ""), given)
        return any(hmac.compare_digest(each.encode(), token.encode()) for each in both)

    async def answer(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] not in {"http", "websocket"}:
            await app(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        given = asked.query_params.get("token", "")

        async def marked(message: Any) -> None:
            """Send a cookie along to who has come with the token in the address."""
            if token and given and message["type"] == "http.response.start":
                cookie = f"{TOKEN_COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict"
                headers = [*message.get("headers", ()), (b"set-cookie", cookie.encode())]
                message = {**message, "headers": headers}
            await send(message)

        if may(asked, given):
            await app(scope, receive, marked)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await PlainTextResponse(REFUSED_MESSAGE, 403)(scope, receive, send)

    return answer


class Audience:
    """Browsers that look, in the order in which they came.

    Args:
        clock: Seconds.
        patience: Seconds without anybody, once somebody was there, until all are taken to have
            have left for good: a page that is loaded again is away for a moment.
    """

    def __init__(self, clock: Callable[[], float], patience: float = 5.0) -> None:
        self._clock, self._patience = clock, patience
        self._there: list[str] = []
        self._left: float | None = None

    @property
    def driver(self) -> str | None:
        """The browser that drives."""
        return self._there[0] if self._there else None

    def come(self, who: str) -> None:
        """Somebody looks from now on."""
        if who not in self._there:
            self._there.append(who)
        self._left = None

    def go(self, who: str) -> None:
        """Somebody looks no more."""
        if who in self._there:
            self._there.remove(who)
        if not self._there and self._left is None:
            self._left = self._clock()

    @property
    def has_left(self) -> bool:
        """Whether all browsers have left for good."""
        return self._left is not None and self._clock() - self._left > self._patience


MIN_SENDING_INTERVAL_S = 1 / 32
"""Shortest time in s between two pictures that are sent."""
RECONNECT_TIMEOUT_S = 15.0
"""Seconds to wait for a browser that does not answer, on a busy machine; a closed one counts as
disconnected at once."""


def library() -> None:
    """Make sure that the extra is installed.

    Raises:
        TwinError: If it is not.
    """
    with extra("play", "play"):
        import nicegui  # noqa: F401, PLC0415


MAX_LINES = 10
"""Lines about what browsers sent; what follows is counted."""
SERVER_LOGGERS = ("nicegui", "socketio.server", "engineio.server", "uvicorn.error", "asyncio")
"""Loggers of the server's libraries that report errors, each with a stack trace."""


class Lines(logging.Handler):
    """Passes the log messages of libraries on, each in one line and few of them.

    Args:
        tell: Receives a line.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._tell, self._count = tell, 0

    def emit(self, record: logging.LogRecord) -> None:
        """Tell a line, if they are not too many yet."""
        self._count += 1
        if self._count > MAX_LINES:
            return
        error = record.exc_info[1] if record.exc_info else None
        words = error_words(error) if error is not None else " ".join(record.getMessage().split())
        self._tell(shorten(printable(f"the page was sent something that it cannot do: {words}")))

    def close(self) -> None:
        """Tell how many more there were."""
        if self._count > MAX_LINES:
            self._tell(f"and {self._count - MAX_LINES} more of these")
            self._count = 0
        super().close()


@contextmanager
def in_lines(tell: Callable[[str], None]) -> Iterator[None]:
    """Report each log message of the server's libraries as a line, without stacks of calls.

    Args:
        tell: Receives a line.
    """
    lines, loggers = Lines(tell), [logging.getLogger(name) for name in SERVER_LOGGERS]
    before = [(each, each.handlers[:], each.propagate) for each in loggers]
    try:
        for each in loggers:
            each.handlers[:], each.propagate = [lines], False
        yield
    finally:
        for each, handlers, propagate in before:
            each.handlers[:], each.propagate = handlers, propagate
        lines.close()


class Server:
    """Serves the page until it is ended, its time is up, or nobody looks any more.

    Args:
        scenario: What to begin with.
        folder: Of the runs that are saved; the next ones have a number behind it.
        address: Where to listen.
        port: Port; 0 for a free one.
        seconds: After which it ends by itself; None for never.

        warn: Receives, as a line, whatever a browser sends that is no event.

    Attributes:
        url: Address of the page, with the token.
        token: What the address must carry: others work on this computer, too.
        failure: Why the simulation ended by itself; None if it did not.
        kept: What became at the end of what was driven and not saved; empty if there is none.
        lost: Whether that could not be written.

    Raises:
        TwinError: If the extra is missing, the port is taken, or the scenario cannot be driven.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        *,
        address: str,
        port: int,
        seconds: float | None,
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:
        library()
        self._warn = warn
        self._scenario, self._folder, self._seconds = scenario, folder, seconds
        self.token = secrets.token_urlsafe(18)
        self._socket = bound(address, port)
        host = f"[{address}]" if ":" in address else address
        self.url = f"http://{host}:{self._socket.getsockname()[1]}/?token={self.token}"
        self.failure: str | None = None
        self.kept, self.lost = "", False
        self._pages: dict[str, Any] = {}
        self._audience, self._errors = Audience(monotonic), Errors()
        try:
            self._simulation = Simulation(scenario)
        except BaseException:
            self._socket.close()
            raise
        self._status = self._simulation.first
        self._taken: set[Path] = set()
        self._begun = False

    def run(self, begun: Callable[[], None] = lambda: None) -> None:
        """Serve; returns when it is over. Ctrl-C ends it in order.

        Args:
            begun: Called when the page can be loaded.
        """
        try:
            with suppress(KeyboardInterrupt), in_lines(self._warn):
                self._serve(begun)
        finally:
            self._socket.close()
            last = self._simulation.close(self._next_folder())
            if last is not None and not last.tables:
                self.kept, self.lost = last.message, last.wrong

    def _serve(self, begun: Callable[[], None]) -> None:
        import uvicorn  # noqa: PLC0415 - of the extra
        from fastapi import FastAPI  # noqa: PLC0415
        from nicegui import ui  # noqa: PLC0415

        app = FastAPI(openapi_url=None)
        ui.page("/")(self._page)
        ui.run_with(
            app,
            title="ballplate play",
            favicon="⚪",
            dark=None,  # as the browser asks for
            tailwind=False,
            message_history_length=50,
            reconnect_timeout=RECONNECT_TIMEOUT_S,
            show_welcome_message=False,
        )
        config = uvicorn.Config(
            require_token(app, self.token),
            log_config=None,
            log_level="error",
            ws="wsproto",
            timeout_graceful_shutdown=1,
        )
        server = uvicorn.Server(config)

        async def serve() -> None:
            feeding = asyncio.create_task(self._feed(server, begun))
            await server.serve(sockets=[self._socket])
            feeding.cancel()

        asyncio.run(serve())

    async def _page(self, client: Any) -> None:
        """Build the page of a browser."""
        from twin.play.page import Page  # noqa: PLC0415

        who = client.id

        def do(event: Event) -> None:
            if self._audience.driver == who:
                self._simulation.send(event)

        page = Page(
            self._status, self._scenario.dimensions, do, lambda: do(Save(self._next_folder()))
        )
        self._pages[who] = page
        client.on_connect(lambda: self._come(who))
        client.on_disconnect(lambda: self._audience.go(who))
        client.on_delete(lambda: self._pages.pop(who, None))

    def _come(self, who: str) -> None:
        """A browser shows its page; time goes on when the first one does."""
        self._audience.come(who)
        if not self._begun:
            self._begun = True
            self._simulation.send(Pause(False))

    def _next_folder(self) -> Path:
        """A folder that no run is in or being written to."""
        folder, number = free(self._folder), 1
        while folder in self._taken:
            number += 1
            folder = free(self._folder.with_name(f"{self._folder.name}~{number}"))
        self._taken.add(folder)
        return folder

    async def _feed(self, server: Any, begun: Callable[[], None]) -> None:
        """Hand what is new to every page, and end the server when it is over."""
        while not server.started:
            await asyncio.sleep(0.01)
        begun()
        begin = monotonic()
        while True:
            await asyncio.sleep(MIN_SENDING_INTERVAL_S)
            self._hand_on()
            out_of_time = self._seconds is not None and monotonic() - begin > self._seconds
            self.failure = self._simulation.failure
            if self._audience.has_left or out_of_time or self.failure is not None:
                server.should_exit = True
                return

    def _hand_on(self) -> None:
        rows = self._simulation.pictures().tolist()
        self._errors.add(rows)
        for status in self._simulation.news():
            self._status = status
        for who, page in list(self._pages.items()):
            with page.plate.client:
                page.say(self._status, drives=who == self._audience.driver)
                if rows:
                    page.show(rows, self._errors.rms)
