"""`twin.identify.cells`: Numbers of the cells of a log, of many forms."""

import numpy as np
import pytest

from twin.base.errors import LogError
from twin.identify.any_logs import read_any
from twin.identify.cells import describe_hexadecimal, is_number, parse_numbers
from twin.identify.log_columns import unit_factor, wanted_columns
from twin.identify.survey import survey

T = np.arange(0.0, 8.0, 0.02)
X = 50 * np.sin(1.3 * T)
U = 300 * np.cos(1.9 * T)


def hexadecimal(values, digits, before=""):
    """Two's complement of whole numbers in so many digits."""
    return [f"{before}{int(v) % 16**digits:0{digits}X}" for v in values]


@pytest.mark.parametrize("before", ["0x", ""])
@pytest.mark.parametrize("digits", [4, 8])
def test_hexadecimal_numbers_around_zero_are_signed(digits, before):
    numbers = np.round(U)
    cells = hexadecimal(numbers, digits, before)
    values, broken = parse_numbers(cells)
    assert values == pytest.approx(numbers)
    assert not broken
    assert describe_hexadecimal(cells) == (
        f"hexadecimal, read as signed counts of {4 * digits} bits"
    )


def test_hexadecimal_numbers_across_the_middle_of_their_range_are_not_signed():
    numbers = np.round(0x8000 + 20 * U)
    cells = hexadecimal(numbers, 4, "0x")
    assert parse_numbers(cells)[0] == pytest.approx(numbers)
    assert describe_hexadecimal(cells) == "hexadecimal, read as counts"


@pytest.mark.parametrize(
    "cells",
    [
        ["0012", "0100", "0999"],  # zeros before a decimal number
        ["1.5", "0x1A"],
        ["cafe", "babe"],  # words
        ["12AB", "12A"],
        ["1e-3", "2e+5"],
    ],
)
def test_other_cells_are_not_hexadecimal(cells):
    assert describe_hexadecimal(cells) == ""


def test_hexadecimal_cells_may_be_empty():
    values, broken = parse_numbers(["0x10", "", "0x12", "nan"])
    assert values[[0, 2]] == pytest.approx([16, 18])
    assert np.isnan(values[[1, 3]]).all()
    assert not broken


@pytest.mark.parametrize("form", ["{t:#010x},{x},{u}", "t={t:#x} x={x} u={u}"])
def test_a_log_in_hexadecimal_numbers_is_read_as_counts_and_says_so(tmp_path, form):
    columns = hexadecimal(X * 10, 4, "0x"), hexadecimal(U, 4, "0x")
    lines = [
        form.format(t=5000 + round(1e3 * t), x=x, u=u) for t, x, u in zip(T, *columns, strict=True)
    ]
    named = "=" in form
    file = tmp_path / "a.txt"
    file.write_text("\n".join(lines if named else ["t,x,u", *lines]))
    log = read_any(file, wanted_columns("time=t:ms,measured_x=x:0.1mm,command_phi=u:counts"))
    axis = log.axes["x"]
    assert axis.sampled == pytest.approx(T)
    assert axis.ball == pytest.approx(1e-4 * np.trunc(10 * X))
    assert axis.tilt == pytest.approx(np.trunc(U))
    assert "x: hexadecimal, read as signed counts of 16 bits" in log.notes
    assert "u: hexadecimal, read as signed counts of 16 bits" in survey(file).notes


def test_names_are_no_hexadecimal_numbers():
    assert not any(map(is_number, ("acc1", "dac0", "FACE", "a1", "x2")))
    assert is_number("0x1a2b")
    assert is_number("1A2B")


@pytest.mark.parametrize(
    ("first", "last", "seconds"),
    [
        ("30-Nov-2026 23:59:59.5", "01-Dec-2026 00:00:00.75", 1.25),
        ("2026/11/30 10:00:00.5", "2026/11/30 10:00:01.75", 1.25),
        ("2026-11-30T10:11:12.500000Z+0100", "2026-11-30T10:11:13.750000Z+0100", 1.25),
        ("30-11-2026 10:11:12.5", "30-11-2026 10:11:13.75", 1.25),
        ("0:00:01:50", "0:00:02:75", 1.25),
        ("0:00:01:500", "0:00:02:750", 1.25),
    ],
)
def test_times_as_further_programs_write_them_are_seconds(first, last, seconds):
    (early, late), broken = parse_numbers([first, last])
    assert late - early == pytest.approx(seconds, abs=1e-6)
    assert not broken


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("sec", "s", 1.0),
        ("Seconds", "s", 1.0),
        ("msec", "s", 1e-3),
        ("\u03bcs", "s", 1e-6),
        ("\u00b5s", "s", 1e-6),
        ("0.5 meters", "m", 0.5),
        ("degrees", "rad", np.radians(1)),
        ("Grad", "rad", np.radians(1)),
        ("\u00b0", "rad", np.radians(1)),
        ("0.24\u00b0", "rad", np.radians(0.24)),
        ("degreez", "rad", None),
        ("sec", "m", None),
    ],
)
def test_words_and_signs_of_units_are_known(unit, si, factor):
    assert unit_factor(unit, si) == (None if factor is None else pytest.approx(factor))


def test_a_command_in_radians_by_their_name_is_an_angle_and_one_in_volts_asks_for_a_unit(tmp_path):
    file = tmp_path / "a.csv"
    rows = [f"{t:.2f} sec,{x:.3f},{1e-4 * u:.6f}" for t, x, u in zip(T, X, U, strict=True)]
    file.write_text("\n".join(["t,x [mm],u [radians]", *rows]))
    log = read_any(file, wanted_columns("time=t,measured_x=x,command_phi=u"))
    assert log.axes["x"].sampled == pytest.approx(T)
    assert log.axes["x"].tilt == pytest.approx(1e-4 * U, abs=1e-6)
    assert log.unit["x"] == "rad"
    by_count = read_any(file, wanted_columns("time=t,measured_x=x,command_phi=u:2counts"))
    assert by_count.unit["x"] == "count"
    assert by_count.axes["x"].tilt == pytest.approx(2e-4 * U, abs=2e-6)
    file.write_text(file.read_text().replace("radians", "V"))
    with pytest.raises(LogError, match="command_phi: unit 'V' of u; give it"):
        read_any(file, wanted_columns("time=t,measured_x=x,command_phi=u"))
