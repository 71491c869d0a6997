"""The workers of a Dask scheduler, as an executor that notices when the scheduler is gone."""

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

ANSWER = 5.0
"""Seconds within which a scheduler must answer at first."""
PATIENCE = 30.0
"""Seconds that one which is lost later is waited for."""


class Cluster(Executor):
    """Work for the workers of a scheduler.

    A scheduler that is lost and comes back within ``PATIENCE`` gets all unfinished work again; one
    that stays away fails it, where Dask alone would leave it waiting for ever.

    Args:
        address: Of the scheduler, as in tcp://HOST:8786.

    Attributes:
        workers: Chunks that can be under way at the same time, as the scheduler said at first; 1
            if there was nobody.

    Raises:
        ScenarioError: If nobody answers there, or the extra is not installed.
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
        for name in ("distributed", "distributed.client"):
            # it would tell of every lost connection with a traceback
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            place = get_address_host_port(address, strict=True)
            socket.create_connection(place, ANSWER).close()
            self._client = _within(PATIENCE, lambda: Client(address, timeout=PATIENCE))
            threads = _within(PATIENCE, self._client.nthreads)
        except Exception as error:  # anything may listen there, and say anything
            raise ScenarioError(f"--scheduler {address}: no scheduler answers there") from error
        self.workers = max(1, sum(threads.values()))
        self._address = address
        self._executor = self._client.get_executor(pure=False, retries=2)
        self._pending: set[Future[Any]] = set()
        self._over = Event()
        Thread(target=self._watch, name="scheduler", daemon=True).start()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Have a call made by a worker.

        Raises:
            ScenarioError: If the scheduler was given up before.
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
        """Leave the scheduler."""
        del wait, cancel_futures
        self._over.set()
        self._client.close()

    def _watch(self) -> None:
        """Fail what is under way once the client has given the scheduler up."""
        while not self._over.wait(1.0):
            if self._given_up:
                for future in list(self._pending):
                    with suppress(InvalidStateError):
                        future.set_exception(self._lost())

    @property
    def _given_up(self) -> bool:
        return self._client.status in {"closing", "closed"}

    def _lost(self) -> ScenarioError:
        return ScenarioError(
            f"--scheduler {self._address}: lost, and not back within {PATIENCE:g} s; "
            "the same command goes on from here"
        )


def _within(seconds: float, make: Callable[[], T]) -> T:
    """What is made in a thread of its own: Dask waits for ever for a scheduler that says nothing.

    Raises:
        TimeoutError: If it takes longer.
    """
    made: Future[T] = Future()

    def work() -> None:
        try:
            made.set_result(make())
        except Exception as error:  # noqa: BLE001 - whatever it is, the waiting thread is told
            made.set_exception(error)

    Thread(target=work, name="connect", daemon=True).start()
    return made.result(seconds)
