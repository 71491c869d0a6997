"""An FMU's variables as the model description of FMI 2.0 and 3.0, and as the C source has them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from controllers.arrays import Array
from twin.fmu.variables import Variable

TYPES = {
    2: {"Real": "Real", "Integer": "Integer", "Boolean": "Boolean"},
    3: {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"},
}
"""What each version calls a type."""
UNITS = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s^2": {"m": 1, "s": -2},
    "m^2": {"m": 2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s^2": {"rad": 1, "s": -2},
    "rad^2": {"rad": 2},
    "(rad/s^2)^2": {"rad": 2, "s": -4},
    "s": {"s": 1},
    "Hz": {"s": -1},
    "kg": {"kg": 1},
    "kg m^2": {"kg": 1, "m": 2},
}
"""Exponents of the base units; all factors are 1."""
LARGEST = float(np.finfo(float).max)
INTEGER = 2.0**31 - 1
Attributes = dict[str, Any]


def model_description(
    variables: Sequence[Variable],
    *,
    fmi: int,
    name: str,
    identifier: str,
    token: str,
    description: str,
    version: str,
    period: float,
    duration: float,
    sources: Sequence[str],
) -> str:
    """The model description of FMI 2.0 or 3.0, as XML.

    Args:
        variables: In the order of their value references.
        fmi: 2 or 3.
        name: What the model is called.
        identifier: What its binaries are called.
        token: By which FMU and description know each other.
        description: What it is, in a sentence.
        version: Of this program.
        period: Control period in s, which is the fixed step.
        duration: Of the default experiment in s.
        sources: Names of the source files, which FMI 2.0 lists here.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{fmi}.0",
            "modelName": name,
            "guid" if fmi == 2 else "instantiationToken": token,
            "description": description,
            "version": version,
            "generationTool": f"ballplate {version}",
            "variableNamingConvention": "structured",
        },
    )
    able = ("canHandleVariableCommunicationStepSize", "canBeInstantiatedOnlyOncePerProcess")
    state = ("canGetAndSetFMU{}tate", "canSerializeFMU{}tate")
    part = _add(root, "CoSimulation", modelIdentifier=identifier)
    part.attrib |= {able[0]: "true", able[1]: "false"}
    part.attrib |= {each.format("s" if fmi == 2 else "S"): "true" for each in state}
    if fmi == 2:
        files = _add(part, "SourceFiles")
        for source in sources:
            _add(files, "File", name=source)
    else:
        part.set("fixedInternalStepSize", repr(period))
    units = _add(root, "UnitDefinitions")
    for unit in sorted({each.unit for each in variables} - {""}):
        _add(_add(units, "Unit", name=unit), "BaseUnit", **UNITS[unit])
    _add(_add(root, "LogCategories"), "Category", name="logStatusError")
    _add(root, "DefaultExperiment", startTime="0", stopTime=repr(duration), stepSize=repr(period))
    listed = _add(root, "ModelVariables")
    for reference, each in enumerate(variables):
        (_variable2 if fmi == 2 else _variable3)(listed, reference, each)
    structure = _add(root, "ModelStructure")
    outputs = [i for i, each in enumerate(variables) if each.causality == "output"]
    if fmi == 2:
        for part in (_add(structure, "Outputs"), _add(structure, "InitialUnknowns")):
            for i in outputs:
                _add(part, "Unknown", index=i + 1)
    else:
        for kind in ("Output", "InitialUnknown"):
            for i in outputs:
                _add(structure, kind, valueReference=i)
    return written(root)


def build_description(identifier: str, sources: Sequence[str]) -> str:
    """How FMI 3.0 is told to compile the sources, as XML."""
    root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    files = _add(
        _add(root, "BuildConfiguration", modelIdentifier=identifier),
        "SourceFileSet",
        language="C99",
    )
    for source in sources:
        _add(files, "SourceFile", name=source)
    return written(root)


def written(root: ElementTree.Element) -> str:
    """An XML document."""
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _add(parent: ElementTree.Element, tag: str, /, **attributes: object) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, {key: str(a) for key, a in attributes.items()})


def _common(each: Variable, reference: int) -> tuple[Attributes, Attributes]:
    """What a variable says of itself in both versions, and what belongs to its type."""
    own: Attributes = {"name": each.name, "valueReference": reference}
    own |= {"description": each.meaning, "causality": each.causality}
    own["variability"] = each.variability
    if each.causality not in {"independent", "input"}:
        own["initial"] = "calculated" if each.start is None else "exact"
    typed: Attributes = {}
    if each.type != "Boolean":
        for end, bounds in (("min", ("ge", "gt")), ("max", ("le", "lt"))):
            found = [limit for bound, limit in each.bounds if bound in bounds]
            typed |= {end: _number(each, limit) for limit in found}
    if each.unit and each.type == "Real":
        typed["unit"] = each.unit
    if each.start is not None:
        typed["start"] = _number(each, each.start)
    return own, typed


def _number(each: Variable, value: float) -> str:
    if each.type == "Boolean":
        return "true" if value else "false"
    return str(int(value)) if each.type == "Integer" else repr(float(value))


def _variable2(parent: ElementTree.Element, reference: int, each: Variable) -> None:
    own, typed = _common(each, reference)
    _add(_add(parent, "ScalarVariable", **own), TYPES[2][each.type], **typed)


def _variable3(parent: ElementTree.Element, reference: int, each: Variable) -> None:
    own, typed = _common(each, reference)
    _add(parent, TYPES[3][each.type], **own | typed)


def c_name(variable: str) -> str:
    """What the C source calls a variable: the first of a pair without number, ``PLANT_LEVEL``."""
    bare = re.sub(r"\[(\d+)\]$", lambda n: "" if n[1] == "1" else f"_{n[1]}", variable)
    return bare.replace(".", "_").upper()


def c_source(
    variables: Sequence[Variable],
    *,
    token: str,
    kind: int,
    period: float,
    step: float,
    ring: int,
    surface: Array | None,
) -> dict[str, str]:
    """The two files that tell the C source of its scenario, by name.

    Args:
        variables: In the order of their value references.
        token: By which FMU and description know each other.
        kind: A number that no other FMU has, below 2^64.
        period: Control period in s.
        step: Time step of the simulation in s.
        ring: Control periods for which the screen remembers the ball.
        surface: Relative friction and slope along x and y over the screen, shape (n, m, 3).
    """
    grid = np.zeros((1, 1, 3)) if surface is None else surface
    size = (0, 0) if surface is None else surface.shape
    defined = {
        "TOKEN": f'"{token}"',
        "KIND": f"UINT64_C({kind})",
        "PERIOD": repr(period),
        "STEP": repr(step),
        "STEPS": round(period / step),
        "RING": ring,
        "SURFACE_X": size[0],
        "SURFACE_Y": size[1],
        "SLOPING": int(bool(grid[..., 1:].any())),
    }
    names = [c_name(each.name) for each in variables]
    header = [
        "/* Written by ballplate: the variables of this FMU, and what its scenario fixes. */",
        "#ifndef SCENARIO_H\n#define SCENARIO_H\n",
        *(f"#define {name} {value}" for name, value in defined.items()),
        "\nenum Variable {",
        *(f"    {name}," for name in names),
        "    VARIABLES\n};\n\n#endif\n",
    ]
    points = ",\n".join("{" + ", ".join(_row(point) for point in line) + "}" for line in grid)
    tables = [
        "/* Written by ballplate. */",
        '#include "rig.h"\n',
        "const Kind KINDS[VARIABLES] = {",
        *(f"    {_kind(each)}," for each in variables),
        "};\n",
        f"const double SURFACE[{len(grid)}][{grid.shape[1]}][3] = {{\n{points}\n}};\n",
    ]
    return {"scenario.h": "\n".join(header), "scenario.c": "\n".join(tables)}


def _row(point: Array) -> str:
    return "{" + ", ".join(repr(float(value)) for value in point) + "}"


def _kind(each: Variable) -> str:
    when = {"tunable": "ALWAYS", "fixed": "AT_START"}.get(each.variability, "NEVER")
    settable = "ALWAYS" if each.causality == "input" else when
    largest = INTEGER if each.type == "Integer" else LARGEST
    low, high = np.clip(each.range, -largest, largest)
    numbers = ", ".join(repr(float(value)) for value in (each.start or 0.0, low, high))
    return f'{{"{each.name}", {each.type.upper()}, {settable}, {numbers}}}'
