"""The FMU itself: description, sources, a binary where there is a compiler, a reference."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd

from controllers.arrays import Array
from twin.errors import ScenarioError, TwinError
from twin.fmu.description import TEMPLATES, Variable, c_source, model_description, variables
from twin.run.assemble import assemble, build_friction, build_reference, linkage_of, own_errors
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


def export(
    path: Path, scenario: Scenario, quiet: Scenario, *, fmi: int = 2, wished: bool = False
) -> str:
    """Write the rig of a scenario as an FMU for co-simulation.

    Args:
        path: The file.
        scenario: On the exact equations; of its controller only the reference is made.
        quiet: The same without any noise, as an FMU is whose parameter ``noise`` is false.
        fmi: Version of the standard, 2 or 3.
        wished: Whether the reference is an output, too.

    Returns:
        Why there is no binary in it, in words; empty if there is one.

    Raises:
        TwinError: If the scenario changes while it runs, has a linkage or cannot be assembled, or
            the file cannot be written.
    """
    if fmi not in {2, 3}:
        raise TwinError(f"fmi: must be 2 or 3, got {fmi}")
    if scenario.change:
        raise ScenarioError("change: an FMU does not change by itself; set its tunable parameters")
    if linkage_of(scenario):
        raise ScenarioError(
            "plant.linkage: the servos of an FMU turn the plate itself; set "
            "plant.linkage.crank_mm=[0,0] and rig.cams=table (of a table phi_deg=[], theta_deg=[])"
        )
    held = variables(scenario, frame_phase(scenario), path=wished)
    source, token = sources(scenario, held, fmi)
    compiled = [name for name in source if name.endswith(".c")]
    name = "ballplate_" + re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    content: dict[str, str | bytes] = {f"sources/{file}": source[file] for file in source}
    content |= model_description(scenario, held, fmi=fmi, name=name, token=token, compiled=compiled)
    content |= {f"{REFERENCE}/{file}": text for file, text in reference(quiet).items()}
    binary, lacking = _binary(source, name, fmi)
    write_whole(path, lambda temporary: _pack(temporary, content | binary))
    return lacking


def frame_phase(scenario: Scenario) -> float:
    """At which share of a frame the first frame comes, as the twin draws it from the seed."""
    seed = np.random.SeedSequence(scenario.seed, spawn_key=(0,)).spawn(2)[1]
    return float(np.random.default_rng(seed).random())


def sources(scenario: Scenario, held: Sequence[Variable], fmi: int) -> tuple[dict[str, str], str]:
    """The C source of a scenario's rig by the names of its files, and its token, a hash of it."""
    folder = files("twin.fmu") / "c"
    said = {name: (folder / name).read_text(encoding="utf-8") for name in (*OWN, f"fmi{fmi}.c")}
    friction = build_friction([scenario])
    surface = None if friction is None or friction.map is None else friction.map.grids[0]
    path = path_of(scenario) if any(each.name == "reference_x" for each in held) else None
    bare = said | c_source(scenario, held, 16 * "0", surface, path)
    token = hashlib.sha256(json.dumps(bare).encode()).hexdigest()[:32]
    return said | c_source(scenario, held, token, surface, path), token


def path_of(scenario: Scenario) -> Array:
    """The reference at every control period, shape (K, 6): x, y, their rates and accelerations."""
    ticks = 1 + round(scenario.duration / scenario.rig.period)
    along = build_reference(scenario)(scenario.rig.period * np.arange(ticks))
    return np.concatenate([np.broadcast_to(each, (ticks, 2)) for each in along[:3]], axis=-1)


def reference(scenario: Scenario) -> dict[str, str]:
    """Commands and what the twin answers, to check an import against: CSV by name.

    The scenario's own controller commands; the numbers are those of the twin in Python.
    """
    rig, controller = assemble(scenario)
    rows = list[list[float]]()
    with own_errors(), rig:
        measured = rig.read()
        controller.start(measured)
        rig.start()
        for tick in range(1 + round(min(scenario.duration, LASTS) / rig.period)):
            rate = rig.write(controller.command(measured).rate)
            controller.applied(rate)
            ball = rig.devices.state[0, 0::4]
            rows.append([tick * rig.period, *rate[0], *measured.y[0], *ball])
            rig.wait()
            measured = rig.read()
    commands = ["rate_phi", "rate_theta"]
    answers = ["measured_x", "measured_phi", "measured_y", "measured_theta", "true_x", "true_y"]
    whole = pd.DataFrame(rows, columns=["time", *commands, *answers])
    tables = {
        f"reference_{part}.csv": whole[["time", *names]].to_csv(index=False, lineterminator="\n")
        for part, names in {"in": commands, "out": answers}.items()
    }
    manifest = "fmi-ls-manifest.xml"
    return tables | {manifest: (TEMPLATES / manifest).read_text(encoding="utf-8")}


def _binary(source: Mapping[str, str], identifier: str, fmi: int) -> tuple[dict[str, bytes], str]:
    """A binary for this machine by its place; else why there is none."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
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
        command = [compiler, *FLAGS, "-o", "rig.so", *compiled, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            line = (done.stderr.strip().splitlines() or ["it said nothing"])[0]
            return {}, f"{compiler} failed: {line}"
        return {place: Path(folder, "rig.so").read_bytes()}, ""


def _pack(path: Path, content: Mapping[str, str | bytes]) -> None:
    """Write the archive; equal contents give equal bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in sorted(content.items()):
            about = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            archive.writestr(about, text, zipfile.ZIP_DEFLATED)
