"""`twin.board.source`: every law with every observer over a whole run, and broken C source."""

import re

import pytest
from board_source import (
    FRAMES,
    LIMITS,
    MAX_ROUNDINGS,
    SCREEN,
    compiled,
    replayed,
    scenario,
    single_roundings,
)

from twin.board.trace import LAWS
from twin.run.controller_source import export

pytestmark = pytest.mark.long

SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("observer", [*MAX_ROUNDINGS, "friction_kalman"])
@pytest.mark.parametrize("law", [each.name for each in LAWS[:-1]])
def test_a_controller_in_c_is_that_of_python_over_25_s(law, observer, real, tmp_path):
    screen = FRAMES if observer == "friction_kalman" else SCREEN
    chosen = scenario(controller__kind=law, observer__kind=observer, duration=25.0, **screen)
    folder = export(tmp_path / "plate.c", chosen, real=real)
    passed, difference = replayed(compiled(folder, *SANITIZERS))
    bound = 1e-9
    if real == "float":
        measured = observer in MAX_ROUNDINGS
        bound = MAX_ROUNDINGS[observer] * single_roundings(folder) if measured else 2e-3
    rows = (folder / "reference_run.csv").read_text("utf-8").count("\n") - 1
    assert passed
    assert difference < {"double": 1e-9, "float": 1e-2}[real]
    assert difference < bound
    assert rows > 1000


MUTATIONS = (
    (r"LAW_P\[3\]\)", "LAW_P[2])"),
    (r"LAW_P\[4\] \* q\[0\]", "LAW_P[4] * q[1]"),
    (r"sin\(x\[2\]\)", "x[2]"),
    (r"cos\(x\[6\]\)", "1.0"),
    (r"\(x\[4\] - r\[1\]\)", "(x[4] + r[1])"),
    (r"\(r\[8\] - (\w+)\)", r"(0.0 - \1)"),
    (r"(q_rate\[1\] = w\d \? )(w\d) : 0", r"\g<1>0 : \2"),
    (r"const real LAW_INTEGRAL_LIMIT = 0.002", "const real LAW_INTEGRAL_LIMIT = 0.004"),
    (r"OBSERVER_L\[9\]", "OBSERVER_L[8]"),
    (r"OBSERVER_B\[0\]", "OBSERVER_B[9]"),
    (r"OBSERVER_A\[10\]", "OBSERVER_A[2]"),
    (r"DRIFT_SHARE = 0.02", "DRIFT_SHARE = 0.2"),
    (r"CLAMP_PER_ANGLE \*", "-CLAMP_PER_ANGLE *"),
    (r"(CLAMP_MOST) < (\w+) \? CLAMP_MOST", r"\1 > \2 ? \1"),
    (r"rate\[1\] \+ CLAMP_STEP", "rate[1] + 2 * CLAMP_STEP"),
    (r"DELAY_PERIODS 20.65", "DELAY_PERIODS 20.35"),
    (r"const int older = \(newer - 1", "const int older = (newer + 1"),
    (r"y\[2\] \+= c->state\[4\] - then\[1\]", "y[2] += c->state[4] - then[0]"),
    (r"touched \? age / PERIOD_S : 0", "0"),
    (r"if \(touched\)\n", "if (1)\n"),
    (r"predict\(c->state, achieved", "predict(c->state, out->acceleration"),
    (r"(c->angle\[i\]) \+= PERIOD_S", r"\1 -= PERIOD_S"),
    (r"c->memory\[i\] \+= PERIOD_S", "c->memory[i] = PERIOD_S"),
)
"""Pattern in the C source and its replacement, at the first place."""


def test_the_test_program_notices_every_one_of_23_mutations_of_the_c_source(tmp_path):
    law = {"controller__kind": "afl_integral", "controller__integral_limit": 0.002}
    path = {"reference__omega": 2.0, "observer__kind": "luenberger"}
    chosen = scenario(duration=2.0, **law, **path, **SCREEN, **LIMITS)
    folder = export(tmp_path / "plate.c", chosen)
    source = folder / "plate.c"
    whole = source.read_text("utf-8")
    assert replayed(compiled(folder))[0]
    unnoticed = []
    for pattern, replacement in MUTATIONS:
        mutated, count = re.subn(pattern, replacement, whole, count=1)
        assert count, f"{pattern} is not in the source"
        source.write_text(mutated, "utf-8")
        if replayed(compiled(folder, "-Wno-error"))[0]:
            unnoticed.append(pattern)
    assert not unnoticed
