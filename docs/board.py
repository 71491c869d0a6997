"""Makes board.md: laws in C on this computer and on an emulated Cortex-M4F, next to Python.

uv run python docs/board.py
It needs gcc, gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm, and takes minutes.
What has been run is kept in runs/board and used again while the code stays the same.
"""

from __future__ import annotations

import re
import subprocess
import tomllib
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from ballplate.changes import changes_of, scenario_of
from controllers.stable_inversion import StableInversion
from docs.pages import HERE, filled, kept, write
from twin.board.footprint import measure_footprint
from twin.board.program import CONTROLLER_NAME, command_of, compile_controller, size_of
from twin.board.protocol import encode
from twin.board.source import sources
from twin.board.trace import LAWS
from twin.run.controller_building import control_of
from twin.run.finished import Run, run
from twin.scenario.schema import Board, Scenario
from twin.study.work import code, digest

FURTHER = (
    ("afl", "kalman"),
    ("afl", "ekf"),
    ("lqr", "nonlinear_luenberger"),
    ("afl", "friction_kalman"),
    ("afl", "friction_map_kalman"),
    ("stable_inversion", "friction_map_kalman"),
)
"""Laws with observers other than the Luenberger one."""
CURES = dict(zip(FURTHER[-2:], ("cure_afl", "cure"), strict=True))
"""Scenarios that have a law and an observer, other than the circle with their defaults."""
ROWS = (*((law.name, "luenberger") for law in LAWS if law is not StableInversion), *FURTHER)
PROGRAMS = (("host", "double"), ("host", "float"), ("cortex-m4", "float"))
PERIODS_MS = (2, 5, 10)
DURATION_S = 15.0
CLOCKS_HZ = (0.5e6, 1e6, 2e6, 4e6, 16e6, 84e6, 168e6)
SLOW = ("afl", "luenberger")
"""The law and the observer that are run at these clocks."""
MEASURED = (0.01, 0.001, 0.02, -0.001, 0.0, 1.0, 0.1, 0.0, 0.0, 0.1, -0.1, 0.0, 0.0, -0.1, 0.1, 0.0)
"""A measurement whose period is traced, without its time."""
CYCLES = {
    re.compile(f"({names})(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?s?"): about
    for names, about in tomllib.loads((HERE / "board.toml").read_text("utf-8"))["cycles"].items()
}


class Instruction(NamedTuple):
    """An instruction of a listing.

    Attributes:
        name: Its name, without width and type; ending in ``double`` for registers of 64 bits.
        registers: How many registers are in its list.
        size: Its size in bytes.
        function: The function that it belongs to.
    """

    name: str
    registers: int
    size: int
    function: str


TEXT = Path(__file__).read_text(encoding="utf-8") + str(CYCLES)
"""What, besides the program, the rows depend on."""


def scenario(law: str, observer: str, **board: Any) -> Scenario:
    """The circle under a law, its controller a program if there are settings of a board."""
    keys: dict[str, Any] = {"plant.kind": "lagrange", "duration": DURATION_S}
    name = CURES.get((law, observer), "circle")
    if name == "circle":
        keys |= {"controller.kind": law, "observer.kind": observer}
    keys |= {f"board.{key}": value for key, value in board.items()}
    return scenario_of(name, changes_of(keys, {}))


def listing(program: Path) -> dict[int, Instruction]:
    """The instructions of a program by their addresses."""
    text = subprocess.run(
        ["arm-none-eabi-objdump", "-d", str(program)], capture_output=True, text=True, check=True
    ).stdout
    found, function = dict[int, Instruction](), ""
    for line in text.splitlines():
        if begin := re.match(r"[0-9a-f]+ <(\w+)>:", line):
            function = begin[1]
        elif parts := re.match(r"\s*([0-9a-f]+):\t([0-9a-f ]+?)\s*\t(\S+)\s*([^;]*)", line):
            address, code, name, what = parts.groups()
            size = len(code.replace(" ", "")) // 2
            bare = name.partition(".")[0] + ("double" if name[0] == "v" and what[0] == "d" else "")
            found[int(address, 16)] = Instruction(bare, count_registers(what), size, function)
    return found


def count_registers(what: str) -> int:
    """How many registers are in the list of an instruction, as ``{r4, s16-s20}``."""
    count = 0
    for each in re.sub(r".*\{|\}.*", "", what).split(",") if "{" in what else ():
        first, _, last = (part.strip(" rsd") for part in each.partition("-"))
        count += int(last) - int(first) + 1 if last else 1
    return count


def executed(program: Path, known: dict[int, Instruction]) -> list[int]:
    """The addresses of the instructions of the controller in its third period, as QEMU has them.

    The last one is where it returns to.
    """
    asked = b"".join(encode(k + 1, (0.002 * k, *MEASURED)) for k in range(3))
    with TemporaryDirectory() as folder:
        trace = Path(folder, "trace")
        more = ["-singlestep", "-d", "exec,nochain", "-D", str(trace)]
        subprocess.run([*command_of(program), *more], input=asked, capture_output=True, check=True)
        found = re.findall(r"^Trace \d+: \S+ \[\w+/(\w+)/", trace.read_text(), re.MULTILINE)
    addresses = [int(each, 16) for each in found]
    functions = [known[each].function for each in addresses]
    entry = min(
        each for each, about in known.items() if about.function == f"{CONTROLLER_NAME}_reference_at"
    )
    begin = len(addresses) - 1 - addresses[::-1].index(entry)
    end = functions.index("main", functions.index(f"{CONTROLLER_NAME}_step", begin))
    return addresses[begin : end + 1]


def cycles(passed: Sequence[int], known: dict[int, Instruction]) -> tuple[float, float]:
    """Least and most cycles per instruction, by the manual's table.

    Raises:
        ValueError: If an instruction is not in the table.
    """
    least = most = 0
    for address, after in pairwise(passed):
        each = known[address]
        about = next((of for names, of in CYCLES.items() if names.fullmatch(each.name)), None)
        if about is None:
            raise ValueError(f"board.toml: no cycles of {each.name}")
        jumped = after != address + each.size
        listed = each.registers * about.get("registers", 0)
        more = about.get("taken", (0, 0)) if jumped else (0, 0)
        least += about["least"] + listed + more[0]
        most += about["most"] + listed + more[1]
    return least / (len(passed) - 1), most / (len(passed) - 1)


def row(law: str, observer: str) -> dict[str, Any]:
    """All that the page has of a law with an observer."""
    python = run(scenario(law, observer))
    done = [run(scenario(law, observer, program=p, real=r)) for p, r in PROGRAMS]
    slow = scenario(law, observer, real="double").model_copy(update={"duration": 1.0})
    double = run(slow).metrics
    control = control_of(scenario(law, observer))
    program = compile_controller(control, "cortex-m4", "float")
    known = listing(program)
    passed = executed(program, known)
    footprint = measure_footprint(CONTROLLER_NAME, sources(CONTROLLER_NAME, control, "float"))
    assert footprint is not None
    first, *others = done[-1].rows["instructions"]
    largest = max(others)
    _, most = Board().cycles_per_instruction
    return {
        "law": law,
        "observer": observer,
        "python": error(python),
        "errors": [error(each, python) for each in done],
        "differences": [each.metrics["command_difference"] for each in done],
        "median": done[-1].metrics["instructions_median"],
        "first": first,
        "largest": largest,
        "double": double["instructions_median"],
        "reference": share_of_reference(passed, known),
        "cycles": cycles(passed, known),
        "size": size_of(program, "cortex-m4")._asdict(),
        "stack": footprint.stack_bytes,
        "clocks": [largest * most / (1000 * period) for period in PERIODS_MS],
    }


def error(done: Run, of: Run | None = None) -> str:
    """Tracking error of a run in %, or how much it differs from another one's; or how it ended."""
    if done.outcome != "finished":
        return f"{done.outcome} at {done.metrics['outcome_time']:.2f} s"
    own = done.metrics["tracking_error_percent"]
    if of is None or of.outcome != "finished":
        return f"{own:.2f} %"
    return f"{own - of.metrics['tracking_error_percent']:+.1e} %"


def share_of_reference(passed: Sequence[int], known: dict[int, Instruction]) -> float:
    """Share of the reference in the instructions of a period, with its functions of math.h, %."""
    functions = [known[each].function for each in passed]
    return 100 * functions.index(f"{CONTROLLER_NAME}_step") / len(functions)


def at_clocks() -> list[dict[str, Any]]:
    """What time costs a program at several clocks, and the same time a law in Python."""
    found = []
    for clock in CLOCKS_HZ:
        done = run(scenario(*SLOW, clock_hz=clock))
        took = float(np.nanmax(done.rows["computing_time"]))
        python = scenario(*SLOW)
        law = python.controller.model_copy(update={"computing_time": took})
        found.append(
            {
                "clock": clock / 1e6,
                "took": 1000 * took,
                "late": done.metrics["late_percent"],
                "error": error(done),
                "python": error(run(python.model_copy(update={"controller": law}))),
            }
        )
    return found


def version(program: str) -> str:
    """The first line that a program says of its version."""
    said = subprocess.run([program, "--version"], capture_output=True, text=True, check=True)
    return said.stdout.splitlines()[0]


if __name__ == "__main__":
    rows = [kept("board", digest(f"{code()} {TEXT} {each}"), partial(row, *each)) for each in ROWS]
    page = filled(
        "board",
        rows=rows,
        slow=SLOW,
        duration=DURATION_S,
        clocks=at_clocks(),
        range=Board().cycles_per_instruction,
        found=(min(each["cycles"][0] for each in rows), max(each["cycles"][1] for each in rows)),
        versions=[version(each) for each in ("arm-none-eabi-gcc", "qemu-system-arm")],
    )
    write(HERE / "board.md", page)
