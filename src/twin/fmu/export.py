"""The rig of a scenario as an FMU: variables, description, C source, a binary, a reference.

The description follows FMI 2.0 and 3.0; a binary is made where there is a compiler.
"""

from __future__ import annotations

import hashlib
import json
import math
import platform
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.base.data_file import read_packaged
from twin.base.errors import ScenarioError, TwinError
from twin.base.followers import FOLLOWER_LABELS, FREE
from twin.base.page import render_template
from twin.base.parts import own_version
from twin.base.programs import find_c_compiler
from twin.base.settings import Setting, Unit, settings_of
from twin.base.writing import write_whole
from twin.hal.interface import Limits
from twin.hal.linkage import Linkage, TiltTable
from twin.run.assemble import assemble
from twin.run.controller_building import build_reference, own_errors
from twin.run.plants import build_friction, linkage_of
from twin.scenario.describe import UNIT_PATTERN, meanings
from twin.scenario.rig_tables import RIG_CLASSES, left_out
from twin.scenario.schema import Scenario, changed_in_vain
from twin.sim.drives import DriveModel
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import BallStart, Parts
from twin.sim.plant.rim import Rim
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission import TransmissionError

if TYPE_CHECKING:
    import pandas as pd

PARAMETER_CLASSES: tuple[type, ...] = (
    *(BallStart, Parts, Friction, DriveModel, TransmissionError),
    *(Limits, TouchModel, EncoderModel, Linkage, Rim),
)
"""Dataclasses in the order of the value references of their settings; all others come after."""
NO_SUFFIX = {Unit.MM: "_mm", Unit.UM: "_um", Unit.DEG: "_deg", Unit.PERCENT: "_percent"}
"""Units that end a key by their name; the parameter is in SI, so its name does without."""
TUNABLE_PREFIXES = ("plant.friction.", "plant.servo.", "plant.level", "disturbance.", "rig.cam_")
"""How the names of parameters begin that may be set while it runs; so may variances."""
VARIABLE_TABLES = read_packaged("twin.fmu", "variables.toml")
"""The other variables and units of every FMU; the file explains its entries."""
SEED_COUNT = 2**31
"""Number of seeds, which an integer of FMI 2.0 can be."""


class Variable(NamedTuple):
    """One variable of a model description; its value reference is its place in the list.

    Attributes:
        name: Its name; ``[1]`` and ``[2]`` end those of a pair (x, y) or (phi, theta).
        causality: As FMI has it: independent, input, output, local or parameter.
        variability: continuous, discrete, fixed, tunable or constant.
        meaning: Its meaning, in a sentence.
        unit: SI unit; empty for none.
        type: Real, Integer or Boolean.
        start: Its value at the beginning; None for what is calculated.
        low: The smallest number it may be.
        high: The largest.
    """

    name: str
    causality: str
    variability: str
    meaning: str
    unit: str = ""
    type: str = "Real"
    start: float | None = None
    low: float = -math.inf
    high: float = math.inf

    @property
    def numbers(self) -> dict[str, str]:
        """Attributes of its type in a description: minimum, maximum and first value, if any."""
        limits = {"min": self.low, "max": self.high} if self.type != "Boolean" else {}
        found = {name: limit for name, limit in limits.items() if abs(limit) < MAX_REAL}
        found |= {} if self.start is None else {"start": self.start}
        if self.type == "Boolean":
            return {name: "true" if value else "false" for name, value in found.items()}
        how = int if self.type == "Integer" else float
        return {name: str(how(value)) for name, value in found.items()}

    @property
    def settable(self) -> str:
        """When it may be set, in the words of the C source."""
        when = {"tunable": "ALWAYS", "fixed": "AT_START"}.get(self.variability, "NEVER")
        return "ALWAYS" if self.causality == "input" else when

    @property
    def range(self) -> tuple[float, float, float]:
        """Its first, least and largest value for the C source."""
        largest = MAX_INTEGER if self.type == "Integer" else MAX_REAL
        low, high = np.clip((self.low, self.high), -largest, largest).tolist()
        return float(self.start or 0.0), low, high


def variables(scenario: Scenario, phase: float, *, path: bool = False) -> list[Variable]:
    """All variables of the rig of a scenario on the exact equations.

    Args:
        scenario: The scenario.
        phase: At which share of a frame the first frame of the screen comes.
        path: Whether its reference is an output, too.
    """
    values = _own_values(scenario, phase)
    listed = [*VARIABLE_TABLES["signal"], *VARIABLE_TABLES["reference"] * path]
    found = [Variable(**each) for each in listed]
    found += [Variable(start=values[each["name"]], **each) for each in VARIABLE_TABLES["own"]]
    return [*found, *parameters(scenario)]


def first_values(scenario: Scenario, phase: float) -> Array:
    """The first values of ``variables`` in their order, 0 of those that have none."""
    own = _own_values(scenario, phase)
    found = [each.get("start", 0.0) for each in VARIABLE_TABLES["signal"]]
    found += [own[each["name"]] for each in VARIABLE_TABLES["own"]]
    for about, _ in _open_settings("source"):
        values = about.unit.to_si(about.of(scenario))
        found += values if isinstance(values, tuple) else (values,)
    return np.array([each or 0.0 for each in found], float)


def _own_values(scenario: Scenario, phase: float) -> dict[str, float]:
    """The first values of the variables that are no settings of a dataclass, by name."""
    model: BallPlate = scenario.plant.model
    return {
        "rig.period": scenario.rig.period,
        "plant.step": scenario.plant.step,
        "gravity": model.gravity,
        "rig.knows_linkage": scenario.rig.cams != "ratio",
        "noise": 1,
        "seed": scenario.seed % SEED_COUNT,
        "sensors.noise_hold": scenario.sensors.noise_hold,
        "sensors.touch.frame_phase": phase,
    }


def parameters(scenario: Scenario, part: str = "source") -> Iterator[Variable]:
    """The settings of a scenario that a part of the project leaves open, in SI.

    Args:
        scenario: The scenario.
        part: The C source of an FMU, or a different one of ``twin.base.followers.FOLLOWER_LABELS``.
    """
    for about, meaning in _open_settings(part):
        yield from _parameter(scenario, about, meaning)


@cache
def _open_settings(part: str) -> tuple[tuple[Setting, str], ...]:
    """The settings that a part leaves open, and what they mean."""
    return tuple(
        (about, meanings(source).get(field, ""))
        for source in dict.fromkeys((*PARAMETER_CLASSES, *RIG_CLASSES))
        for field, about in settings_of(source).items()
        if getattr(about.followed_by, part) is FREE
    )


def _parameter(scenario: Scenario, about: Setting, meaning: str) -> Iterator[Variable]:
    suffix = NO_SUFFIX.get(about.unit, "")
    base = about.key.removesuffix(suffix)
    values: Any = about.unit.to_si(about.of(scenario))
    pair = isinstance(values, tuple)
    found = UNIT_PATTERN.search(meaning)
    unit = VARIABLE_TABLES["units"].get(base, found["unit"] if found else "")
    tunable = base.startswith(TUNABLE_PREFIXES) or base.endswith(".variance")
    kind = "Integer" if isinstance(about.default, int) else "Real"
    limits = {name: about.unit.to_si(limit) for name, limit in about.bounds.items()}
    low = limits.get("ge", math.nextafter(limits.get("gt", -math.inf), math.inf))
    high = limits.get("le", math.nextafter(limits.get("lt", math.inf), -math.inf))
    meaning += f" Key of `ballplate describe`: {about.key}." if suffix else ""
    for i, value in enumerate(values if pair else (values,)):
        name = f"{base}[{i + 1}]" if pair else base
        how = "tunable" if tunable else "fixed"
        yield Variable(name, "parameter", how, meaning, unit, kind, value, low, high)


MAX_REAL = float(np.finfo(float).max)
MAX_INTEGER = 2.0**31 - 1
C_BRACES = str.maketrans("[]", "{}")
MIN_TOUCH_MEMORY_S = 0.25
"""Least time in s for which the screen remembers the ball, so that its dead time may be set."""


TEMPLATE_FOLDER = Path(__file__).with_name("templates")


class Bus(NamedTuple):
    """A terminal of FMI-LS-BUS in a model description.

    Attributes:
        name: Name of the network.
        mime_type: Type of the operations that go over it.
        max_bytes: The most bytes of operations that go in or out at one event.
    """

    name: str
    mime_type: str
    max_bytes: int


def model_description(
    variables: Sequence[Variable], *, fmi: int, bus: Bus | None = None, **about: Any
) -> dict[str, str]:
    """The descriptions of FMI 2.0 or 3.0 as XML, by the names of their files.

    Args:
        variables: In the order of their value references; those of a bus come after them.
        fmi: 2 or 3.
        bus: The bus that the FMU is a node of; of FMI 3.0 only.
        about: ``name`` of the model and its binaries; ``token``, by which FMU and description know
            each other; ``compiled``, the source files; ``description`` in words; ``step`` and
            ``duration`` in s of a default experiment; ``independent``, which of the lists Outputs
            and InitialUnknowns name no dependency, as its outputs have none.
    """
    given = {"variables": variables, "fmi": fmi, "bus": bus, **about}
    given |= {"version": own_version(), "exponents": exponents}
    places = {"modelDescription.xml": ""}
    if fmi == 3:
        places["buildDescription.xml"] = "sources/"
    return {
        f"{place}{file}": render_template(TEMPLATE_FOLDER / f"{file}.j2", **given)
        for file, place in places.items()
    }


DERIVED_UNITS = {"Hz": "/s", "N m": "kg m^2/s^2", "N m s/rad": "kg m^2/s/rad"}
"""Units with a derived one in them, by base units."""


def exponents(unit: str) -> dict[str, int]:
    """Those of the base units in an SI unit, as ``kg m^2`` or ``rad/s^2``; all factors are 1."""
    unit = DERIVED_UNITS.get(unit, unit)
    found = re.findall(r"(/?)([a-z]+)\^?(\d?)", unit)
    return {base: int(power or 1) * (-1 if over else 1) for over, base, power in found}


def c_name(variable: str) -> str:
    """What the C source calls a variable: the first of a pair without number, ``PLANT_LEVEL``."""
    bare = re.sub(r"\[(\d+)\]$", lambda n: "" if n[1] == "1" else f"_{n[1]}", variable)
    return bare.replace(".", "_").upper()


def c_source(scenario: Scenario, surface: Array | None, path: Array | None) -> dict[str, str]:
    """The two files with what the scenario fixes, by name.

    Args:
        scenario: The owner of the rig.
        surface: Its ``surface_of``.
        path: The reference at the control periods, x, y and their first and second derivatives,
            shape (K, 6); None where it is no output.
    """
    rows = np.zeros((1, 6)) if path is None else path
    grid = np.zeros((1, 1, 3)) if surface is None else surface
    given = compiled_in(scenario, surface) | {
        "path_rows": 0 if path is None else len(path),
        "surface": json.dumps(grid.tolist()).translate(C_BRACES),
        "path": json.dumps(rows.tolist()).translate(C_BRACES),
    }
    names = ("scenario.h", "scenario.c")
    return {name: render_template(TEMPLATE_FOLDER / f"{name}.j2", **given) for name in names}


def surface_of(scenario: Scenario) -> Array | None:
    """Relative friction and slope along x and y over the screen, shape (n, m, 3); None if even."""
    friction = build_friction([scenario])
    return None if friction is None or friction.map is None else friction.map.grids[0]


def compiled_in(scenario: Scenario, surface: Array | None) -> dict[str, Any]:
    """What of a rig is compiled in, but for the numbers of its surface, by names in the templates.

    Args and shapes are those of ``c_source``.
    """
    table = linkage_of(scenario)
    curves = table.curves if isinstance(table, TiltTable) else 2 * [np.empty((3, 0))]
    curve = np.concatenate([*map(np.transpose, curves), np.zeros((1, 3))])
    touch, plant, period = scenario.sensors.touch, scenario.plant, scenario.rig.period
    waits = touch.dead_time + 4 * touch.dead_time_spread
    waits += 1 / touch.frame_rate if touch.frame_rate else 0.0
    return {
        "period": period,
        "step": plant.step,
        "steps": round(period / plant.step),
        "ring": 2 + math.ceil(max(waits, MIN_TOUCH_MEMORY_S) / period),
        "spin": plant.ball_spin.upper(),
        "axes": plant.axes,
        "round": int(plant.shape == "round"),
        "size": (0, 0) if surface is None else surface.shape,
        "sloping": int(surface is not None and bool(surface[..., 1:].any())),
        "curve_phi": len(curves[0][0]),
        "curve": json.dumps(curve.tolist()).translate(C_BRACES),
        "curve_rows": len(curve) - 1,
    }


RIG_SOURCES = (
    "rig.c",
    "rig.h",
    "rig_shared.h",
    "rig_friction.h",
    "rig_linkage.h",
    "rig_ball.h",
    "rig_walls.h",
    "rig_motion.h",
    "rig_drives.h",
    "rig_sensors.h",
    "rig_supervisor.h",
    "noise.c",
    "model.h",
)
"""The C source of the rig that no template makes."""
FMI_SOURCES = {
    2: ("instance.c", "instance.h", "fmi.h", "fmi2.c"),
    3: ("instance.c", "instance.h", "fmi.h", "fmi3.c", "fmi3.h", "fmi3_absent.c"),
}
"""The C source around a model with time in periods, by the version of the standard."""
RIG_PARTS = "Exact equations, drives, touch screen, encoders and limits; without the mechanism."
"""What of a rig is in the FMU, for its description."""
COMPILER_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
"""How the binary is compiled: without fused operations, so that every processor rounds alike."""
REFERENCE_FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
"""Folder of the reference, as the layered standard fmi-ls-ref has it."""
QUIET_REFERENCE = "With noise = false; made by the twin, not by this FMU"
"""Description of the reference of a rig."""
MAX_REFERENCE_S = 5.0
"""Longest time in s of the reference."""


def export(
    path: Path, scenario: Scenario, quiet: Scenario, *, fmi: int = 2, with_reference: bool = False
) -> str:
    """Write the rig of a scenario as an FMU for co-simulation.

    Args:
        path: The file.
        scenario: On the exact equations; of its controller only the reference is made.
        quiet: The same without any noise, as an FMU with the parameter ``noise`` false.
        fmi: Version of the standard, 2 or 3.
        with_reference: Whether the reference is an output, too.

    Returns:
        The reason why there is no binary in it, in words; empty if there is one.

    Raises:
        TwinError: If the scenario changes while it runs, changes a setting that the C source does
            not follow, or cannot be assembled, or the file cannot be written.
    """
    if fmi not in {2, 3}:
        raise TwinError(f"fmi: must be 2 or 3, got {fmi}")
    if scenario.fault:
        raise ScenarioError("[[fault]]: an FMU has none of the virtual rig's faults; leave it out")
    if scenario.change:
        raise ScenarioError("change: an FMU does not change by itself; set its tunable parameters")
    unfollowed = left_out("source")
    for key in changed_in_vain(scenario, unfollowed):
        raise ScenarioError(f"{key}: {FOLLOWER_LABELS['source']} {unfollowed[key]}")
    held = variables(scenario, frame_phase(scenario), path=with_reference)
    return write_fmu(
        path,
        held,
        *sources(scenario, held, fmi),
        reference(quiet),
        fmi=fmi,
        description=f"Rig of: {scenario.title}. {RIG_PARTS}",
        independent=("Outputs",),
        step=scenario.rig.period,
        duration=scenario.duration,
    )


def write_fmu(
    path: Path,
    variables: Sequence[Variable],
    source: Mapping[str, str],
    token: str,
    more: Mapping[str, str],
    *,
    fmi: int,
    **about: Any,
) -> str:
    """Write an FMU: descriptions, C source, and a binary where one can be made.

    Args:
        path: The file; its name without the ending names the model.
        variables: In the order of their value references.
        source: The C source by the names of its files.
        token: By which FMU and description know each other.
        more: All other files of the archive, by name.
        fmi: 2 or 3.
        about: The rest of `model_description`.

    Returns:
        Why there is no binary in it, in words; empty if there is one.

    Raises:
        TwinError: If the file cannot be written.
    """
    compiled = [name for name in source if name.endswith(".c")]
    name = "ballplate_" + re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    about |= {"name": name, "token": token, "compiled": compiled}
    binary, lacking = compile_binary(source, name, fmi)
    content: dict[str, str | bytes] = {
        **{f"sources/{file}": text for file, text in source.items()},
        **model_description(variables, fmi=fmi, **about),
        **more,
        **binary,
    }
    write_whole(path, lambda temporary: write_archive(temporary, content))
    return lacking


def frame_phase(scenario: Scenario) -> float:
    """At which share of a frame the first frame comes, as the twin draws it from the seed."""
    seed = np.random.SeedSequence(scenario.seed, spawn_key=(0,)).spawn(2)[1]
    return float(np.random.default_rng(seed).random())


def sources(scenario: Scenario, held: Sequence[Variable], fmi: int) -> tuple[dict[str, str], str]:
    """The C source of a scenario's rig by the names of its files, and its token, a hash of it."""
    written = read_sources(*RIG_SOURCES, *FMI_SOURCES[fmi])
    path = path_of(scenario) if any(each.name == "reference_x" for each in held) else None
    return add_token(written | c_source(scenario, surface_of(scenario), path), held)


def add_token(
    written: Mapping[str, str], variables: Sequence[Variable]
) -> tuple[dict[str, str], str]:
    """All C source by the names of its files, and its token, a hash of it.

    Args:
        written: The files without token and variables.
        variables: In the order of their value references.
    """

    def make(token: str) -> dict[str, str]:
        given = {"variables": variables, "token": token, "c_name": c_name}
        names = ("variables.h", "variables.c")
        return {name: render_template(TEMPLATE_FOLDER / f"{name}.j2", **given) for name in names}

    bare = {**written, **make(16 * "0")}
    token = hashlib.sha256(json.dumps(bare).encode()).hexdigest()[:32]
    return {**written, **make(token)}, token


def read_sources(*names: str, package: str = "twin.fmu") -> dict[str, str]:
    """C source of a package, by the names of its files."""
    folder = files(package) / "c"
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def path_of(scenario: Scenario) -> Array:
    """The reference at every control period, shape (K, 6): x, y, their rates and accelerations."""
    ticks = 1 + round(scenario.duration / scenario.rig.period)
    along = build_reference(scenario)(scenario.rig.period * np.arange(ticks))
    return np.concatenate([np.broadcast_to(each, (ticks, 2)) for each in along[:3]], axis=-1)


def reference(scenario: Scenario) -> dict[str, str]:
    """Commands and the twin's answers, to check an import against, by the names of their files.

    The scenario's own controller commands; the numbers are those of the twin in Python.
    """
    import pandas as pd  # noqa: PLC0415  not in ballplate-core

    rig, controller = assemble(scenario)
    rows = list[list[float]]()
    with own_errors(), rig:
        measured = rig.read()
        controller.start(measured)
        rig.start()
        for tick in range(1 + round(min(scenario.duration, MAX_REFERENCE_S) / rig.period)):
            rate = rig.write(controller.command(measured).rate)
            controller.applied(rate)
            ball = rig.devices.state[0, 0::4]
            rows.append([tick * rig.period, *rate[0], *measured.y[0], *ball])
            rig.wait()
            measured = rig.read()
    commands = ["rate_phi", "rate_theta"]
    answers = ["measured_x", "measured_phi", "measured_y", "measured_theta", "true_x", "true_y"]
    whole = pd.DataFrame(rows, columns=["time", *commands, *answers])
    return reference_files(whole[["time", *commands]], whole[["time", *answers]], QUIET_REFERENCE)


def reference_files(given: pd.DataFrame, expected: pd.DataFrame, about: str) -> dict[str, str]:
    """Inputs and the outputs that belong to them, as fmi-ls-ref has them, by names in an archive.

    Args:
        given: Inputs, ``time`` first; a row holds until the next.
        expected: Outputs, ``time`` first.
        about: A description in words.
    """
    found = {
        f"reference_{part}.csv": table.to_csv(index=False, lineterminator="\n")
        for part, table in (("in", given), ("out", expected))
    }
    manifest = TEMPLATE_FOLDER / "fmi-ls-manifest.xml.j2"
    found[manifest.stem] = render_template(manifest, about=about)
    return {f"{REFERENCE_FOLDER}/{file}": text for file, text in found.items()}


def compile_binary(
    source: Mapping[str, str], identifier: str, fmi: int
) -> tuple[dict[str, bytes], str]:
    """A binary for this machine by its place in the archive; else why there is none.

    Args:
        source: The C source by the names of its files.
        identifier: Name of the binary.
        fmi: 2 or 3.
    """
    compiler = find_c_compiler()
    machine = platform.machine()
    if not sys.platform.startswith("linux") or (fmi == 2 and machine != "x86_64"):
        return {}, f"binaries are made on Linux, not on {sys.platform} {machine}"
    if compiler is None:
        return {}, "there is no C compiler (cc, gcc or clang)"
    place = f"binaries/{'linux64' if fmi == 2 else f'{machine}-linux'}/{identifier}.so"
    with tempfile.TemporaryDirectory(prefix="ballplate-") as folder:
        for name, text in source.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        compiled = [name for name in source if name.endswith(".c")]
        command = [compiler, *COMPILER_FLAGS, "-o", "rig.so", *compiled, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            line = (done.stderr.strip().splitlines() or ["no message"])[0]
            return {}, f"{compiler} failed: {line}"
        return {place: Path(folder, "rig.so").read_bytes()}, ""


def write_archive(path: Path, content: Mapping[str, str | bytes]) -> None:
    """Write the archive; equal contents give equal bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in sorted(content.items()):
            about = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            archive.writestr(about, text, zipfile.ZIP_DEFLATED)
