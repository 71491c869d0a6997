"""The simulation in a process of its own, so that neither drawing nor a server can stall it."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from time import monotonic

from controllers import catalog
from controllers.arrays import Array
from twin.errors import TwinError
from twin.jobs import SecondProcess, let_go, settle, undisturbed
from twin.play.driven import Part, save_driven
from twin.play.session import COLUMNS, End, Event, Session, Status, Told
from twin.scenario.schema import Scenario
from twin.view.live_process import SharedRingBuffer

ROWS = 1024
"""Pictures that wait to be fetched: 20 s of them."""
START = 60.0
"""Seconds that the process may take to start."""
LAST = 30.0
"""Seconds that it may take to end, with what is still to be saved."""


class Failure(str):
    """Why the simulation could not begin, or go on, in a line."""

    __slots__ = ()


class Simulation:
    """A driven rig in another process, where time stands still until it is let go on.

    Args:
        scenario: What to begin with.

    Raises:
        TwinError: If it cannot be driven by hand.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._ring = SharedRingBuffer(ROWS, len(COLUMNS))
        self._ring.name(COLUMNS)
        context = multiprocessing.get_context("spawn")
        self._pipe, its = context.Pipe()
        self._process = context.Process(target=_work, args=(self._ring.address, scenario, its))
        self.failure: Failure | None = None
        """Why it ended by itself."""
        with undisturbed():
            self._process.start()
        its.close()
        begun = monotonic()
        said: list[Status] = []
        try:
            while not said and self.failure is None:
                said = self.news(wait=0.1)
                if monotonic() - begun > START:
                    raise TwinError(f"the simulation does not start within {START:g} s")
            if self.failure is not None:
                raise TwinError(self.failure)
        except BaseException:
            self.close()
            raise
        self.first: Status = said[-1]
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
        """What is to be said since the last call, oldest first."""
        found: list[Status] = []
        try:
            while self._pipe.poll(wait):
                said = self._pipe.recv()
                wait = 0.0
                if isinstance(said, Failure):
                    self._fail(said)
                else:
                    found.append(said)
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
            What it said last, if anything; how that saving went.
        """
        last: list[Status] = []
        if self._process.is_alive() and self.failure is None:
            self.send(End(folder))
            until = monotonic() + LAST
            while self.failure is None and monotonic() < until:
                last = self.news(wait=0.1) or last
            self._process.join(LAST)
        let_go(self._process)
        self._pipe.close()
        self._ring.close()
        return last[-1] if last else None


class _Writer:
    """Has run folders written by another process, and tells when that is done."""

    def __init__(self, beside: SecondProcess) -> None:
        self._beside = beside
        self.told: SimpleQueue[Told] = SimpleQueue()
        self._under_way: list[Thread] = []

    def __call__(self, part: Part, folder: Path) -> None:
        """Begin to write a part into a run folder."""
        self._under_way.append(Thread(target=self._wait, args=(part, folder)))
        self._under_way[-1].start()

    def _wait(self, part: Part, folder: Path) -> None:
        try:
            self._beside.begin(save_driven, part, folder)()
            self.told.put(Told(f"saved as {folder}/"))
        except TwinError as error:
            self.told.put(Told(str(error), wrong=True))

    def finish(self) -> None:
        """Wait until all is written."""
        for thread in self._under_way:
            thread.join()


def _work(address: tuple[int, int, str], scenario: Scenario, pipe: Connection) -> None:
    """The body of the process."""
    settle()
    said: SimpleQueue[Status | Failure | None] = SimpleQueue()
    speaker = Thread(target=_speak, args=(said, pipe), daemon=True)
    speaker.start()
    ring = SharedRingBuffer(*address)

    def show(numbers: tuple[float, ...]) -> None:
        ring.slot()[: len(COLUMNS)] = numbers
        ring.put()

    try:
        with SecondProcess(wanted=True) as beside:
            write = _Writer(beside)

            def inbox(wait: float) -> Sequence[Event]:
                found: list[Event] = []
                try:
                    while pipe.poll(wait):
                        wait = 0.0
                        found.append(pipe.recv())
                except (EOFError, OSError):
                    found.append(End())
                while not write.told.empty():
                    found.append(write.told.get())
                return found

            Session(scenario, inbox=inbox, show=show, tell=said.put, write=write, paused=True).run()
            write.finish()
            while not write.told.empty():
                message, wrong = write.told.get()
                said.put(Status({}, message=message, wrong=wrong))
    except TwinError as error:
        said.put(Failure(error))
    except Exception as error:  # noqa: BLE001 - a law of one's own may raise anything
        said.put(Failure(catalog.blamed(error) or f"the simulation failed: {error!r}"))
    said.put(None)
    speaker.join(1.0)
    ring.close()


def _speak(said: SimpleQueue[Status | Failure | None], pipe: Connection) -> None:
    """Send what is said, however long the other side lets it wait."""
    while (each := said.get()) is not None:
        try:
            pipe.send(each)
        except OSError:
            return
