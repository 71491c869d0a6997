"""What the C source of an FMU reads of what its description offers."""

import re
from pathlib import Path

from twin.fmu import export
from twin.fmu.export import c_name, frame_phase, variables


def offered(scenario):
    """The parameters of a scenario's FMU."""
    found = variables(scenario, frame_phase(scenario))
    return [each for each in found if each.causality == "parameter"]


def unread(scenario):
    """What the C source calls those parameters that it reads nowhere, comments aside."""
    folder = Path(export.__file__).parent / "c"
    source = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.[ch]"))
    code = re.sub(r"/\*.*?\*/|//[^\n]*", " ", source, flags=re.DOTALL)
    names = {c_name(each.name) for each in offered(scenario)}
    # what follows the first of a pair or four is read by the first's place and so many
    singles = {name for name in names if not re.search(r"_\d$", name)}
    assert len(singles) > 50
    return {name for name in singles if not re.search(rf"\b{name}\b", code)}
