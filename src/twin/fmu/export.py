"""The FMU itself: description, sources, a binary where there is a compiler, a reference."""

from __future__ import annotations

import hashlib
import math
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from twin.errors import ScenarioError, TwinError
from twin.fmu.description import build_description, c_source, model_description, written
from twin.fmu.variables import Variable, variables
from twin.run.assemble import assemble
from twin.run.plants import build_friction
from twin.scenario.schema import Scenario
from twin.writing import write_whole

OWN = ("rig.c", "rig.h", "instance.c", "instance.h")
"""The C source that both versions share; ``fmi2.c`` or ``fmi3.c`` goes with it."""
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
"""How the binary is compiled: without fused operations, so that every processor rounds alike."""
REFERENCE = "extra/org.fmi-standard.fmi-ls-ref"
"""Folder of the reference, as the layered standard fmi-ls-ref has it."""
LASTS = 5.0
"""Longest time in s of the reference."""
REMEMBERED = 0.25
"""Least time in s for which the screen remembers the ball, so that its dead time may be set."""


class Export(NamedTuple):
    """What was written.

    Attributes:
        variables: Number of variables.
        binary: Platform it has a binary for, as the standard calls it; empty for none.
        lacking: Why there is none, in words.
    """

    variables: int
    binary: str
    lacking: str


def export(path: Path, scenario: Scenario, *, fmi: int = 2) -> Export:
    """Write the rig of a scenario as an FMU for co-simulation.

    Args:
        path: The file.
        scenario: On the exact equations; of its controller only the reference is made.
        fmi: Version of the standard, 2 or 3.

    Raises:
        TwinError: If the scenario is of another plant, changes while it runs or cannot be
            assembled, or the file cannot be written.
    """
    if fmi not in {2, 3}:
        raise TwinError(f"fmi: must be 2 or 3, got {fmi}")
    if scenario.plant.kind != "lagrange":
        raise ScenarioError("plant.kind: an FMU has the exact equations; set plant.kind=lagrange")
    if scenario.change:
        raise ScenarioError("change: an FMU does not change by itself; set its tunable parameters")
    held = variables(scenario, frame_phase(scenario))
    content = sources(scenario, held, fmi)
    token = token_of(content)
    compiled = [name for name in content if name.endswith(".c")]
    identifier = "ballplate_" + re.sub(r"\W", "_", path.stem)
    content = {f"sources/{name}": text for name, text in content.items()}
    content["modelDescription.xml"] = model_description(
        held, fmi=fmi, name=f"ballplate {path.stem}", identifier=identifier, token=token,
        description=f"Rig of: {scenario.title}. Ball and plate on the exact equations, with drives,"
        " touch screen, encoders and limits; without the mechanism.",
        version=version("ballplate"), period=scenario.rig.period, duration=scenario.duration,
        sources=compiled,
    )  # fmt: skip
    if fmi == 3:
        content["sources/buildDescription.xml"] = build_description(identifier, compiled)
    content |= {f"{REFERENCE}/{name}": text for name, text in reference(scenario).items()}
    place, library, lacking = _binary(content, compiled, identifier, fmi)
    write_whole(path, lambda temporary: _pack(temporary, content, place, library))
    return Export(len(held), place.split("/")[1] if place else "", lacking)


def frame_phase(scenario: Scenario) -> float:
    """At which share of a frame the first frame comes, as the twin draws it from the seed."""
    seed = np.random.SeedSequence(scenario.seed, spawn_key=(0,)).spawn(2)[1]
    return float(np.random.default_rng(seed).random())


def sources(scenario: Scenario, held: list[Variable], fmi: int) -> dict[str, str]:
    """The C source of a scenario's rig by the names of its files."""
    folder = files("twin.fmu") / "c"
    fixed = {name: (folder / name).read_text(encoding="utf-8") for name in (*OWN, f"fmi{fmi}.c")}
    friction = build_friction([scenario])
    surface = None if friction is None or friction.map is None else friction.map.grids[0]
    touch, period = scenario.sensors.touch, scenario.rig.period
    waits = touch.dead_time + 4 * touch.dead_time_spread
    waits += 1 / touch.frame_rate if touch.frame_rate else 0.0
    said = {
        "period": period,
        "step": scenario.plant.step,
        "ring": 2 + math.ceil(max(waits, REMEMBERED) / period),
        "surface": surface,
    }
    drawn = c_source(held, token="", kind=0, **said)
    token = token_of(fixed | drawn)
    kind = int(token.split("-")[0], 16)
    return fixed | c_source(held, token=token, kind=kind, **said)


def token_of(content: Mapping[str, str]) -> str:
    """The token in a source, or, where there is none yet, what it is to be: a hash of it all."""
    found = re.search(r'#define TOKEN "(.+)"', content["scenario.h"])
    if found:
        return found[1]
    mark = hashlib.sha256("\0".join(f"{a}\0{b}" for a, b in sorted(content.items())).encode())
    digits = mark.hexdigest()
    return f"{digits[:8]}-{digits[8:12]}-{digits[12:16]}-{digits[16:20]}-{digits[20:32]}"


def quiet(scenario: Scenario) -> Scenario:
    """The scenario without any noise, as an FMU is whose parameter ``noise`` is false."""
    none, sensors, plant = (0.0, 0.0), scenario.sensors, scenario.plant
    touch = {"variance": none, "dead_time_spread": 0.0}
    still = {"vibration": 0.0} if plant.servo.vibration_wander else {}
    return scenario.model_copy(
        update={
            "disturbance": scenario.disturbance.model_copy(update={"variance": none}),
            "plant": plant.model_copy(update={"servo": plant.servo.model_copy(update=still)}),
            "sensors": sensors.model_copy(
                update={
                    "touch": sensors.touch.model_copy(update=touch),
                    "encoders": sensors.encoders.model_copy(update={"variance": none}),
                }
            ),
        }
    )


def reference(scenario: Scenario) -> dict[str, str]:
    """Commands and what the twin answers without noise, to check an import against: CSV by name.

    The scenario's own controller commands; the numbers are those of the twin in Python.
    """
    rig, controller = assemble(quiet(scenario))
    commands, answers = ["time,rate_phi,rate_theta"], []
    names = [f"measured_{name}" for name in ("x", "phi", "y", "theta")]
    answers.append(",".join(["time", *names, "true_x", "true_y"]))
    with rig:
        measured = rig.read()
        controller.start(measured)
        rig.start()
        for tick in range(1 + round(min(scenario.duration, LASTS) / rig.period)):
            rate = rig.write(controller.command(measured).rate)
            controller.applied(rate)
            now = [tick * rig.period]
            commands.append(_line([*now, *rate[0]]))
            answers.append(_line([*now, *measured.y[0], *rig.devices.state[0, 0::4]]))
            rig.wait()
            measured = rig.read()
    root = ElementTree.Element(
        "fmiReferences",
        {
            "xmlns:fmi-ls": "http://fmi-standard.org/fmi-ls-manifest",
            "fmi-ls:fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
            "fmi-ls:fmi-ls-version": "1.0.0-alpha.1",
            "fmi-ls:fmi-ls-description": "With noise = false; made by the twin, not by this FMU",
        },
    )
    listed = {"reference_in.csv": commands, "reference_out.csv": answers}
    for (name, lines), role in zip(listed.items(), ("input", "result"), strict=True):
        about = {"type": "text/csv", "source": name, "role": role}
        about["description"] = f"{len(lines) - 1} control periods with noise = false"
        ElementTree.SubElement(root, "Related", about)
    tables = {name: "\n".join(lines) + "\n" for name, lines in listed.items()}
    return tables | {"fmi-ls-manifest.xml": written(root)}


def _line(values: list[float]) -> str:
    return ",".join(repr(float(value)) for value in values)


def _binary(
    content: Mapping[str, str], compiled: list[str], identifier: str, fmi: int
) -> tuple[str, bytes, str]:
    """Where a binary for this machine goes and its bytes; else why there is none."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    machine = platform.machine()
    if not sys.platform.startswith("linux") or (fmi == 2 and machine != "x86_64"):
        return "", b"", f"binaries are made on Linux, not on {sys.platform} {machine}"
    if compiler is None:
        return "", b"", "there is no C compiler (cc, gcc or clang)"
    place = f"binaries/{'linux64' if fmi == 2 else f'{machine}-linux'}/{identifier}.so"
    with tempfile.TemporaryDirectory(prefix="ballplate-") as folder:
        for name, text in content.items():
            if name.startswith("sources/"):
                Path(folder, name.removeprefix("sources/")).write_text(text, encoding="utf-8")
        command = [compiler, *FLAGS, "-o", "rig.so", *compiled, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            line = (done.stderr.strip().splitlines() or ["it said nothing"])[0]
            return "", b"", f"{compiler} failed: {line}"
        return place, Path(folder, "rig.so").read_bytes(), ""


def _pack(path: Path, content: Mapping[str, str], place: str, library: bytes) -> None:
    """Write the archive; equal contents give equal bytes."""
    everything = {name: text.encode() for name, text in content.items()}
    if place:
        everything[place] = library
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in sorted(everything.items()):
            about = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            archive.writestr(about, text, zipfile.ZIP_DEFLATED)
