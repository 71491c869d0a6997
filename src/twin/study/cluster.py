"""The workers of a Dask scheduler as an executor that notices when the scheduler is lost."""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import suppress
from threading import Event, Thread
from typing import Any, TypeVar

from twin.errors import ScenarioError

T = TypeVar("T")

CONNECT_TIMEOUT = 5.0
"""Seconds within which a scheduler must accept a connection."""
TIMEOUT = 30.0
"""Seconds within which it must answer, and come back after it was lost."""


class Cluster(Executor):
    """Executor of calls on the workers of a scheduler.

    A scheduler that is lost and comes back within ``TIMEOUT`` gets all unfinished calls again; if
    it stays away they fail, where Dask alone would leave them waiting for ever.

    Args:
        address: Of the scheduler, as in tcp://HOST:8786.

    Attributes:
        workers: Calls that can run at the same time, as reported when connecting; 1 if the
            scheduler had no workers.

    Raises:
        ScenarioError: If no scheduler answers there, or the extra is not installed.
    """

    workers: int

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client  # noqa: PLC0415 - an extra
            from distributed.comm import get_address_host_port  # noqa: PLC0415
        except ImportError as error:
            raise ScenarioError(
                "--scheduler: needs the extra cluster: pip install 'ballplate[cluster]'"
            ) from error
        for name in ("distributed", "distributed.client", "tornado.application"):
            # it would log every lost connection with a traceback
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            place = get_address_host_port(address, strict=True)
            socket.create_connection(place, CONNECT_TIMEOUT).close()
            self._client = _with_timeout(TIMEOUT, lambda: Client(address, timeout=TIMEOUT))
            threads = _with_timeout(TIMEOUT, self._client.nthreads)
        except Exception as error:  # anything may listen there, and say anything
            raise ScenarioError(f"--scheduler {address}: no scheduler answers there") from error
        self.workers = max(1, sum(threads.values()))
        self._address = address
        self._executor = self._client.get_executor(pure=False, retries=2)
        self._pending: set[Future[Any]] = set()
        self._closed = Event()
        Thread(target=self._watch, name="scheduler", daemon=True).start()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit a call to the workers.

        Raises:
            ScenarioError: If the scheduler is lost.
        """
        try:
            future: Future[T] = self._executor.submit(fn, *args, **kwargs)
        except Exception as error:
            if self._given_up:
                raise self._lost() from error
            raise
        self._pending.add(future)
        future.add_done_callback(self._pending.discard)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Disconnect from the scheduler."""
        del wait, cancel_futures
        self._closed.set()
        self._client.close()

    def _watch(self) -> None:
        """Fail all pending calls once the client has given up on the scheduler."""
        while not self._closed.wait(1.0):
            if self._given_up:
                for future in list(self._pending):
                    with suppress(InvalidStateError):
                        future.set_exception(self._lost())

    @property
    def _given_up(self) -> bool:
        return self._client.status in {"closing", "closed"}

    def _lost(self) -> ScenarioError:
        return ScenarioError(
            f"--scheduler {self._address}: lost, and not back within {TIMEOUT:g} s; "
            "the same command goes on from here"
        )


def _with_timeout(seconds: float, make: Callable[[], T]) -> T:
    """Result of a call in a separate thread, since Dask waits for ever for a silent scheduler.

    Raises:
        TimeoutError: If it takes longer.
    """
    made: Future[T] = Future()

    def work() -> None:
        try:
            made.set_result(make())
        except Exception as error:  # noqa: BLE001 - passed on to the waiting thread
            made.set_exception(error)

    Thread(target=work, name="connect", daemon=True).start()
    return made.result(seconds)
