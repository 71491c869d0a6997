"""A law that is an FMU, as Simulink and other tools export one: in a process of its own.

Run by its path this file is that process: it reads numbers from standard input and answers on the
file that was its standard output.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any, ClassVar
from weakref import finalize

import numpy as np

from controllers.arrays import Array, Positive
from controllers.catalog import EXECUTION_LOG, AnswerError
from controllers.interfaces import Feedback, Law, Reference

STATE_COLUMNS = ("x", "x_rate", "phi", "phi_rate", "y", "y_rate", "theta", "theta_rate")
FMU_INPUT_NAMES = (
    *(f"estimated_{each}" for each in STATE_COLUMNS),
    *(f"equivalent_{each}" for each in STATE_COLUMNS),
    *(f"reference_{axis}{order}" for order in ("", "_rate", "_acc") for axis in "xy"),
    *("measured_x", "measured_phi", "measured_y", "measured_theta", "age", "touched"),
    *("applied_phi_rate", "applied_theta_rate"),
)
"""Inputs that an FMU may have, by name; SI units."""
RATE_OUTPUTS, ACCELERATION_OUTPUTS = (
    ("rate_phi", "rate_theta"),
    ("requested_phi_acc", "requested_theta_acc"),
)
"""The outputs that it may have: plate rates in rad/s, or plate accelerations in rad/s^2."""
FMU_START_TIMEOUT_S = 30.0
"""Seconds in which the process must be there."""
NUMBERS_MARK, ERROR_MARK = b"=", b"!"
"""First byte of an answer, and first byte of the error message that replaces one."""


@dataclass(frozen=True, kw_only=True)
class FmuLaw(Law):
    """A controller as an FMU for co-simulation, FMI 2.0 or 3.0, driven by FMPy (extra ``fmi``).

    It is stepped once in a control period; its output is the command of that period.

    Raises:
        ValueError: If there is no such file.
    """

    name: ClassVar[str] = "fmu"

    file: str
    """The FMU, a path; inputs are found by their names, outputs are rates or accelerations."""
    time_limit: Positive = 1.0
    """Longest time in s that it may take for an answer; on a rig in real time at most 0.04."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        if not Path(self.file).is_file():
            raise ValueError(f"file must name an FMU, there is no '{self.file}'")

    def start(self, x: Array, reference: Reference, period: float) -> FmuProcess:
        """Begin the process, with an instance for each rig."""
        return FmuProcess(self, math.prod(x.shape[:-1]), period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        path = (np.broadcast_to(r, now.rate.shape) for r in now.reference(now.time)[:3])
        given = np.concatenate(
            (now.x, now.equivalent, *path, _measured_numbers(now), now.rate), axis=-1
        )
        return now.plan.ask(now.time, given).reshape(now.rate.shape)


def _measured_numbers(now: Feedback) -> Array:
    """What a rig measured: x, phi, y, theta, age and touched, shape (..., 6)."""
    seen = now.measurement
    assert seen is not None, "a controller passes what was measured"
    shape = now.rate.shape[:-1]
    rest = (np.broadcast_to(each, shape)[..., np.newaxis] for each in (seen.age, seen.touched))
    return np.concatenate((seen.y, *rest), axis=-1)


class FmuProcess:
    """The process that has an FMU, ended when nobody needs it any more.

    Args:
        law: Has the file, and the longest time it may take.
        rigs: How many instances it makes.
        period: Of the law, s.

    Raises:
        AnswerError: If the FMU cannot be used: why, in one line.
    """

    def __init__(self, law: FmuLaw, rigs: int, period: float) -> None:
        self._law = law
        folder = TemporaryDirectory(prefix="ballplate-fmu-", ignore_cleanup_errors=True)
        file = str(Path(law.file).resolve())
        EXECUTION_LOG.info("runs the machine code in %s, a controller as an FMU", file)
        self._process = subprocess.Popen(
            [sys.executable, "-I", __file__, file, folder.name, str(rigs), repr(period)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._answers: SimpleQueue[bytes] = SimpleQueue()
        heard = self._process.stdout, 16 * rigs, self._answers
        self._reader = Thread(target=_read, args=heard, daemon=True)
        self._reader.start()
        self._asked = False
        finalize(self, _end, self._process, folder)
        self._hear(FMU_START_TIMEOUT_S)

    def ask(self, time: float, given: Array) -> Array:
        """The answer to what ``INPUTS`` has, shape (..., len(INPUTS)), at a time in s.

        Raises:
            AnswerError: If there is none within the time, or it is no number.
        """
        assert self._process.stdin is not None
        with suppress(OSError):  # it has ended: its last output is still to be read
            if not self._asked:
                self._asked = True
                keep_up(self._process, self._reader)
            self._process.stdin.write(np.float64(time).tobytes() + given.tobytes())
            self._process.stdin.flush()
        answer = np.frombuffer(self._hear(self._law.time_limit))
        if not np.isfinite(answer).all():
            raise self._failed(f"gave {answer} at {time:g} s, which are no numbers")
        return answer

    def saved_state(self) -> None:
        """None: what an FMU has within stays there."""

    def restore_state(self, state: None) -> None:
        """Refuse: an FMU begins at its beginning.

        Raises:
            ValueError: Always.
        """
        raise ValueError(f"{self._law.file} cannot be put back into a state")

    def _hear(self, seconds: float) -> bytes:
        try:
            answer = self._answers.get(timeout=seconds)
        except Empty:
            self._process.kill()
            raise self._failed(f"gave no answer within {seconds:g} s") from None
        if answer[:1] != NUMBERS_MARK:
            raise self._failed(answer[1:].decode(errors="replace").strip() or "its process ended")
        return answer[1:]

    def _failed(self, why: str) -> AnswerError:
        return AnswerError(f"controller.file {self._law.file}: {why}")


def keep_up(process: subprocess.Popen[bytes], reader: Thread) -> None:
    """Let what answers a real-time loop come before ordinary processes, too, just after it."""
    if sys.platform == "linux" and (priority := os.sched_getparam(0).sched_priority):
        for each in (process.pid, reader.native_id or 0):
            os.sched_setscheduler(each, os.SCHED_FIFO, os.sched_param(priority - 1))


def _read(pipe: Any, size: int, answers: SimpleQueue[bytes]) -> None:
    """Queue the output of a process until it ends."""
    with pipe:
        while (first := pipe.read(1)) == NUMBERS_MARK:
            answers.put(first + pipe.read(size))
        answers.put(first + pipe.read())


def _end(process: subprocess.Popen[bytes], folder: TemporaryDirectory[str]) -> None:
    process.kill()
    process.wait()
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.close()
    folder.cleanup()


def _find_ports(known: dict[str, Any]) -> tuple[list[str], list[str], tuple[str, str]]:
    """Names of the inputs that are numbers, of those that are flags, and of the two outputs.

    Args:
        known: The variables of an FMU by name.

    Raises:
        ValueError: If it has other inputs, or lacks the outputs: which there may be.
    """
    wanted = [each for each, variable in known.items() if variable.causality == "input"]
    if unknown := [each for each in wanted if each not in FMU_INPUT_NAMES]:
        raise ValueError(f"has the input {unknown[0]}; inputs may be {', '.join(FMU_INPUT_NAMES)}")
    flags = [each for each in wanted if known[each].type == "Boolean"]
    if flags not in ([], ["touched"]):
        raise ValueError(f"has the Boolean input {flags[0]}; only touched may be one")
    for pair in (RATE_OUTPUTS, ACCELERATION_OUTPUTS):
        if known.keys() >= {*pair}:
            return [each for each in wanted if each not in flags], flags, pair
    raise ValueError(
        f"must have the outputs {' and '.join(RATE_OUTPUTS)}, or {ACCELERATION_OUTPUTS}"
    )


def _serve(file: str, folder: str, rigs: int, period: float, out: int) -> None:
    """Have instances of an FMU, and answer with plate accelerations until nobody asks any more."""
    try:
        from fmpy import extract, instantiate_fmu, read_model_description  # noqa: PLC0415
    except ImportError:
        raise ValueError("needs FMPy: pip install 'ballplate[fmi]'") from None
    about = read_model_description(file)
    known = {each.name: each for each in about.modelVariables}
    if about.coSimulation is None:
        raise ValueError("is not for co-simulation; export it as such")
    numbers, flags, outputs = _find_ports(known)
    takes, takes_flags, gives = (
        [known[each].valueReference for each in names] for names in (numbers, flags, outputs)
    )
    places, touched = [*map(FMU_INPUT_NAMES.index, numbers)], FMU_INPUT_NAMES.index("touched")
    extract(file, folder)
    units = [instantiate_fmu(folder, about, "CoSimulation") for _ in range(rigs)]
    modern = about.fmiVersion.startswith("3")
    os.write(out, NUMBERS_MARK + np.zeros((rigs, 2)).tobytes())
    step = 0
    while text := sys.stdin.buffer.read(8 + 8 * rigs * len(FMU_INPUT_NAMES)):
        now, *rest = np.frombuffer(text)
        rows = np.reshape(rest, (rigs, -1))
        if step == 0:
            begun = now
        due = max(step, round((now - begun) / period)) + 1
        answers = []
        for unit, row in zip(units, rows, strict=True):
            values = row[places].tolist()
            put, get = (
                (unit.setFloat64, unit.getFloat64) if modern else (unit.setReal, unit.getReal)
            )
            if step == 0:
                if not modern:
                    unit.setupExperiment(startTime=begun)
                unit.enterInitializationMode(**({"startTime": begun} if modern else {}))
                put(takes, values)
                unit.exitInitializationMode()
            put(takes, values)
            for each in range(step, due):  # periods that were missed, too: its time is the loop's
                if flags:  # in those nobody has looked
                    unit.setBoolean(takes_flags, [bool(row[touched]) and each == due - 1])
                unit.doStep(begun + each * period, period)
            answers.append(get(gives))
        u = np.array(answers, dtype=float)
        if outputs is RATE_OUTPUTS:
            u = (u - rows[:, -2:]) / period
        os.write(out, NUMBERS_MARK + u.tobytes())
        step = due


if __name__ == "__main__":
    _out = os.dup(1)
    os.dup2(2, 1)  # what the FMU prints is no answer
    try:
        _serve(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), _out)
    except Exception as error:  # noqa: BLE001  an FMU may fail in any way
        os.write(_out, ERROR_MARK + " ".join(str(error).split()).encode())
    os._exit(0)
