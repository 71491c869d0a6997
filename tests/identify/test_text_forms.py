"""`twin.identify.text_forms`: Texts as boards and programs print them."""

import numpy as np
import pytest

from twin.base.errors import LogError
from twin.identify.any_logs import read_any
from twin.identify.cells import parse_numbers
from twin.identify.log_columns import wanted_columns
from twin.identify.survey import survey
from twin.identify.text_forms import plain_lines

T = np.arange(0.0, 4.0, 0.02)
X = np.round(50 * np.sin(1.3 * T), 2)
U = np.round(5 * np.cos(T), 2)
NAMED = "time=t:ms,measured_x=x:mm,command_phi=u:deg"
NUMBERED = "time=1:ms,measured_x=2:mm,command_phi=3:deg"


def rows(form, before=()):
    return [*before, *(form.format(t=1e3 * t, x=x, u=u) for t, x, u in zip(T, X, U, strict=True))]


def dated(form, before=()):
    """Lines with date and time in the place of ``{t}``."""
    clocks = (f"2024-05-01 23:59:{57 + t:06.3f}" if t < 3 else f"2024-05-02 00:00:{t - 3:06.3f}"
              for t in T.round(3))  # fmt: skip
    cells = zip(clocks, T, X, U, strict=True)
    return [*before, *(form.format(t=c, s=1.5e9 + t, ms=1e3 * t, x=x, u=u) for c, t, x, u in cells)]


def german(lines):
    return [line.replace(".", ",") for line in lines]


LABVIEW = """LabVIEW Measurement
Writer_Version|2
Separator|Tab
X_Columns|{columns}
***End_of_Header***

Channels|2
Samples|200{other}|200
Date|2024/05/01{other}|2024/05/01
Y_Unit_Label|mm{other}|deg
X0|0.0E+0{other}|0.0E+0
Delta_X|0.02{other}|0.02
***End_of_Header***||
{names}|Comment""".replace("|", "\t")
"""Heads of a LabVIEW measurement file."""


def labview(columns, names, form, *, again=False):
    other = "\t" if columns == "Multi" else ""  # what a head states stands above the values
    names = names.replace(" ", "\t")
    head = LABVIEW.format(columns=columns, names=names, other=other).split("\n")
    found = [*head, *rows(form, ())]
    if again:  # a new head in the middle
        found[len(head) + 70 : len(head) + 70] = head[head.index("Channels\t2") :]
    return found


def received(lines, sign="."):
    """As the Arduino IDE shows lines, with the clock of the computer."""
    clocks = (f"10:11:{12 + k // 50:02d}{sign}{20 * (k % 50):03d}" for k in range(len(lines)))
    return [f"{clock} -> {line}" for clock, line in zip(clocks, lines, strict=True)]


CELLS = "{t:.0f},{x:.2f},{u:.2f}"
FORMS = {
    "numpy": (rows("{t:.3e} {x:.8e} {u:.8e}", ["# Rig 3", "# t x u"]), NAMED),
    "labels": (rows("t:{t:.0f},x:{x:.2f},u:{u:.2f}"), NAMED),
    "labels apart": (rows("t: {t:.0f} x: {x:.2f} u: {u:.2f}", ["boot", "x: calibrating"]), NAMED),
    "equal signs": (rows("t={t:.0f}\tx={x:.2f}\tu={u:.2f}"), NAMED),
    "list of Python": (rows("[{t:.0f}, {x:.2f}, {u:.2f}]"), NUMBERED),
    "bytes of Python": (rows(rf"b'{CELLS}\r\n'"), NUMBERED),
    "semicolons": (rows(f"{CELLS};"), NUMBERED),
    "clock and names": (received(rows(CELLS, ["t,x,u"])), NAMED),
    "clock and labels": (received(rows("t:{t:.0f},x:{x:.2f},u:{u:.2f}")), NAMED),
    "clock alone": (
        received(rows("{x:.2f}\t{u:.2f}")),
        "time=1:s,measured_x=2:mm,command_phi=3:deg",
    ),
    "clock with colons": (
        received(rows("{x:.2f} {u:.2f}"), ":"),
        "time=1:s,measured_x=2:mm,command_phi=3:deg",
    ),
    "words before the rows": (rows(CELLS, ["Ball ready", "calibrating..."]), NUMBERED),
    "Tera Term": (dated("[{t}] {x},{u}"), "time=1,measured_x=2:mm,command_phi=3:deg"),
    "CoolTerm": (dated("{t} {x}\t{u}"), "time=1,measured_x=2:mm,command_phi=3:deg"),
    "CoolTerm and blanks": (dated("[{t}] {x} {u}"), "time=1,measured_x=2:mm,command_phi=3:deg"),
    "logging of Python": (
        dated("{t} - rig - INFO - x={x} u={u}"),
        "time=received_s,measured_x=x:mm,command_phi=u:deg",
    ),
    "logging without times": (rows("INFO:root:t={t:.0f}, x={x}, u={u}"), NAMED),
    "ROS console": (
        dated("[INFO] [{s:.6f}] [rig]: {x},{u}"),
        "time=1:s,measured_x=2:mm,command_phi=3:deg",
    ),
    "ESP32 console": (
        dated("I ({ms:.0f}) rig: {x},{u}"),
        "time=1:s,measured_x=2:mm,command_phi=3:deg",
    ),
    "log with Unix times": (
        dated("{s:.3f} INFO rig x={x} u={u}"),
        "time=received_s,measured_x=x:mm,command_phi=u:deg",
    ),
    "syslog": (rows("May  1 12:34:56 pi rig[123]: {t:.0f},{x},{u}"), NUMBERED),
    "colours of a terminal": (rows(f"\x1b[32m{CELLS}\x1b[0m"), NUMBERED),
    "angle brackets": (rows(f"<{CELLS}>"), NUMBERED),
    "check sums": (
        rows(f"$BALL,{CELLS}*5F"),
        "time=2:ms,measured_x=3:mm,command_phi=4:deg",
    ),
    "dictionaries of Python": (rows("{{'t': {t}, 'x': {x}, 'u': {u}}}"), NAMED),
    "bars": (rows("| {t:.0f} | {x} | {u} |", ["| t | x | u |", "|---|--:|---|"]), NAMED),
    "bars between": (rows("{t:.0f}|{x}|{u}", ["t|x|u"]), NAMED),
    "tabs and blanks": (rows("{t:8.0f}\t{x:.2f}  {u:.2f}", ["t \tx  u"]), NAMED),
    "units apart": (
        rows("{t:.0f} {x} {u}", ["% Rig 3", "% t [ms]  x (mm)  u [°]"]),
        "time=t,measured_x=x,command_phi=u",
    ),
    "units in cells": (
        rows("{t:.0f} ms,{x} mm,{u}°", ["t,x,u"]),
        "time=t,measured_x=x,command_phi=u",
    ),
    "Fortran": ([each.replace("e", "D") for each in rows("{t:.6e} {x:.6e} {u:.6e}")], NUMBERED),
    "another minus": ([each.replace("-", "\u2212") for each in rows(CELLS)], NUMBERED),
    "blanks of thousands": (german(rows("{t:_.1f};{x};{u}")), NUMBERED),
    "tuples": (rows("{t:.0f},({x}, {u})", ["t,x,u"]), NAMED),
    "lists": (
        rows('{t:.0f},"[{x} {u}]"', ["t,state"]),
        "time=t:ms,measured_x=state.0:mm,command_phi=state.1:deg",
    ),
    "one value a row": (
        [line for each in rows("{t:.0f},x,{x};{t:.0f},u,{u}") for line in each.split(";")],
        NAMED,
    ),
    "Teleplot": (
        [line for each in rows(">x:{t:.0f}:{x};>u:{t:.0f}:{u}|g") for line in each.split(";")],
        "time=time,measured_x=x:mm,command_phi=u:deg",
    ),
    "Teleplot without times": (
        [line for each in rows(">x:{x}§mm;>u:{u}") for line in each.split(";")],
        "time=row:50Hz,measured_x=x,command_phi=u:deg",
    ),
    "LabVIEW": (
        labview("One", "X_Value x u", "{t:.1f}e-3\t{x}\t{u}"),
        "time=X_Value,measured_x=x,command_phi=u",
    ),
    "LabVIEW with a comma": (
        german(labview("One", "X_Value x u", "{t:.1f}e-3\t{x}\t{u}", again=True)),
        "time=X_Value,measured_x=x,command_phi=u",
    ),
    "LabVIEW without times": (
        labview("No", "X_Value x u", "\t{x}\t{u}"),
        "time=X_Value,measured_x=x,command_phi=u",
    ),
    "LabVIEW with many times": (
        labview("Multi", "X_Value x X_Value u", "{t:.1f}e-3\t{x}\t{t:.1f}e-3\t{u}"),
        "time=X_Value,measured_x=x,command_phi=u",
    ),
    "names again": (
        [each for k, line in enumerate(rows(CELLS)) for each in ["t,x,u"] * (k % 70 == 0) + [line]],
        NAMED,
    ),
    "seconds and nanoseconds": (
        [
            f"17{k // 50:02d},{20_000_000 * (k % 50)},{x},{u}"
            for k, (x, u) in enumerate(zip(X, U, strict=True))
        ],
        "time=stamp.secs,measured_x=x:mm,command_phi=u:deg",
    ),
    "zeros at the end": (rows(CELLS, ["t,x,u"]) + ["0,0,0"] * 30, NAMED),
    "units in a line": (rows(CELLS, ["t,x,u", "ms,mm,deg"]), "time=t,measured_x=x,command_phi=u"),
}


FORMS["one value a row"][0].insert(0, "time,signal,value")
FORMS["one value a row"] = FORMS["one value a row"][0], NAMED.replace("=t:", "=time:")
FORMS["seconds and nanoseconds"][0].insert(0, "stamp.secs,stamp.nsecs,x,u")
FORMS["blanks of thousands"] = (
    [line.replace("_", "\u202f") for line in FORMS["blanks of thousands"][0]],
    NUMBERED,
)


@pytest.mark.parametrize("form", FORMS)
def test_a_text_is_read_in_the_form_in_which_it_was_printed(tmp_path, form):
    lines, columns = FORMS[form]
    file = tmp_path / "a.txt"
    file.write_text("\r\n".join(lines), encoding="utf-8")
    axis = read_any(file, wanted_columns(columns)).axes["x"]
    at = np.round(axis.sampled / 0.02).astype(int)
    assert len(at) == len(T)
    assert axis.sampled == pytest.approx(T[at], abs=1e-6)
    assert axis.ball == pytest.approx(1e-3 * X[at], abs=1e-9)
    assert axis.tilt == pytest.approx(np.radians(U[at]), abs=1e-9)


@pytest.mark.parametrize("form", ["labels apart", "words before the rows", "units in a line"])
def test_the_line_that_is_suggested_reads_what_stands_before_the_rows(tmp_path, form):
    lines, _ = FORMS[form]
    file = tmp_path / "a.txt"
    file.write_text("\n".join(lines), encoding="utf-8")
    asked = survey(file).command
    named = {"labels apart": "t:ms", "words before the rows": "1:ms", "units in a line": "t"}
    assert f"time={named[form]}," in asked


def test_labelled_lines_that_are_cut_are_left_out(tmp_path):
    lines = rows("t:{t:.0f},x:{x:.2f},u:{u:.2f}")
    lines[60], lines[90] = lines[60][:9], lines[90][5:]
    file = tmp_path / "a.txt"
    file.write_text("\n".join(lines), encoding="utf-8")
    log = read_any(file, wanted_columns(NAMED))
    assert len(log.axes["x"].time) == len(T) - 2
    assert any("2 rows left out" in note for note in log.notes)


def test_columns_of_a_usual_table_stay_as_they_are():
    lines = ["# a, b, c", "t,x,u", "0,1,2", "# later", "1,2,3"]
    assert plain_lines("\n".join(lines)) == ["t,x,u", "0,1,2", "1,2,3"]


def test_a_comment_that_names_other_columns_than_there_are_is_no_header(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("\n".join(rows(CELLS, ["# t,x"])), encoding="utf-8")
    with pytest.raises(LogError, match="no header: give numbers of columns"):
        read_any(file, wanted_columns(NAMED))


@pytest.mark.parametrize(
    ("cells", "seconds"),
    [
        (["0 days 00:00:01.5", "1 days 00:00:01.75"], 86400.25),
        (["04.05.2026 23:59:59,5", "05.05.2026 00:00:00,25"], 0.75),
        (["5/4/2026, 11:59:59 AM", "5/4/2026, 12:00:01 PM"], 2.0),
        (["2026-05-04T10:11:12.5Z", "2026-05-04T10:11:13Z"], 0.5),
        (["9:59:59.5", "10:00:01"], 1.5),
        (["1.234,5", "1.236,75"], 2.25),
        (["1,234.5", "1,236.75"], 2.25),
        (["1234,5", "1236,75"], 2.25),
        (["59:58.5", "59:59.75"], 1.25),
        (["59:58,5", "59:59,75"], 1.25),
        (["01:58.5 PM", "01:59.75 PM"], 1.25),
    ],
)
def test_dates_times_and_decimal_signs_of_many_countries_are_numbers(cells, seconds):
    (first, last), broken = parse_numbers(cells)
    assert last - first == pytest.approx(seconds, abs=1e-6)
    assert not broken


def test_words_are_no_times():
    values, broken = parse_numbers(["10:61", "31.31.2026 10:00:00", "1:2:3:4", "-"])
    assert np.isnan(values).all()
    assert broken == 3


@pytest.mark.parametrize(("coarse", "first"), [(1.0, 0.0), (1.0, 0.37), (0.05, 0.0)])
def test_rows_that_share_the_stamps_of_a_coarse_clock_are_spread_evenly(tmp_path, coarse, first):
    stamps = coarse * np.floor((T + first) / coarse + 1e-9)
    file = tmp_path / "a.csv"
    lines = [f"{t:.2f},{x},{u}" for t, x, u in zip(stamps, X, U, strict=True)]
    file.write_text("\n".join(["t,x,u", *lines]), encoding="utf-8")
    log = read_any(file, wanted_columns("time=t:s,measured_x=x:mm,command_phi=u:deg"))
    axis = log.axes["x"]
    assert len(axis.sampled) == len(T)
    assert axis.sampled - axis.sampled[0] == pytest.approx(T, abs=0.021)
    assert any("rows share each stamp" in note for note in log.notes)
    assert not any("without rows" in note for note in log.notes)


def test_rows_before_a_pause_of_a_coarse_clock_do_not_fill_it(tmp_path):
    t = np.where(T < 2.0, T, T + 20.0)
    file = tmp_path / "a.csv"
    lines = [f"{np.floor(at + 1e-9):.0f},{x},{u}" for at, x, u in zip(t, X, U, strict=True)]
    file.write_text("\n".join(["t,x,u", *lines]), encoding="utf-8")
    log = read_any(file, wanted_columns("time=t:s,measured_x=x:mm,command_phi=u:deg"))
    assert log.axes["x"].sampled == pytest.approx(t, abs=0.021)
    assert [note for note in log.notes if note.startswith("1 gap of 20")]


def test_single_stamps_that_repeat_are_left_out_as_before(tmp_path):
    stamps = T.copy()
    stamps[101::50] = stamps[100::50][: len(stamps[101::50])]
    file = tmp_path / "a.csv"
    lines = [f"{t:.2f},{x},{u}" for t, x, u in zip(stamps, X, U, strict=True)]
    file.write_text("\n".join(["t,x,u", *lines]), encoding="utf-8")
    log = read_any(file, wanted_columns("time=t:s,measured_x=x:mm,command_phi=u:deg"))
    assert len(log.axes["x"].sampled) == len(T) - len(stamps[101::50])


def test_lines_that_lose_letters_are_left_out_and_begin_no_new_clock(tmp_path):
    """Each ninth line of a serial connection is cut, or the next one runs into it."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 20.0, 0.02)
    x, u = 50 * np.sin(1.3 * t), 5 * np.cos(2 * t)
    lines = [f"{5e3 + 1e3 * a:.0f},{b:.2f},{c:.2f}" for a, b, c in zip(t, x, u, strict=True)]
    cut = range(5, len(lines) - 5, 9)
    for k in cut:
        part = lines[k][: rng.integers(1, len(lines[k]))]
        lines[k] = part if k % 2 else part + lines[k]
    lines[79] = lines[79][2:]  # a time without its first digits
    file = tmp_path / "a.txt"
    file.write_text("\n".join(lines), encoding="utf-8")
    log = read_any(file, wanted_columns(NUMBERED))
    axis = log.axes["x"]
    assert len(t) - len(cut) - 1 <= len(axis.sampled) < len(t)
    false = np.abs(axis.ball - 1e-3 * np.interp(axis.sampled, t, x)) > 1e-3
    assert false.sum() < 0.1 * len(cut)
    assert axis.sampled[-1] == pytest.approx(t[-1])
    assert not any("begins anew" in note for note in log.notes)


def test_rows_that_a_program_pads_at_their_end_are_kept(tmp_path):
    lines = [line if k % 6 else line.rpartition(",")[0] for k, line in enumerate(rows(CELLS))]
    file = tmp_path / "a.txt"
    file.write_text("\n".join(["t,x,u", *lines]), encoding="utf-8")
    axis = read_any(file, wanted_columns(NAMED)).axes["x"]
    assert len(axis.sampled) == len(T) - 1  # the first row may be cut


@pytest.mark.parametrize("mark", ",.")
def test_marks_of_thousands_are_seen_by_the_whole_column(mark):
    numbers = np.arange(-1500.0, 1500000.0, 777.0).round(-1)
    few = np.arange(0, 1000, 50)
    cells = [f"{n:,.0f}".replace(",", mark) for n in (*numbers, *few)]
    assert parse_numbers(cells)[0] == pytest.approx([*numbers, *few])
    # the same marks are decimal signs where a cell is no whole number of thousands
    for others in (["0,125"], ["12,5"], ["1,2345"]):
        values, _ = parse_numbers([*cells[:3], *others, *cells[3:]])
        assert values[0] == pytest.approx(-1.5)


def test_a_table_of_dates_and_words_keeps_its_header(tmp_path):
    """As InfluxDB writes it: one value a row, next to words."""
    lines = [",result,table,_time,_value,_field"]
    for k, (name, values) in enumerate((("x", X), ("u", U))):
        lines += [
            f",_result,{k},2024-05-01T10:11:{t:06.3f}Z,{value},{name}"
            for t, value in zip(T, values, strict=True)
        ]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(lines), encoding="utf-8")
    log = read_any(file, wanted_columns("time=_time,measured_x=x:mm,command_phi=u:deg"))
    axis = log.axes["x"]
    assert axis.sampled == pytest.approx(T)
    assert axis.ball == pytest.approx(1e-3 * X)
    assert axis.time == pytest.approx(T)
    assert axis.tilt == pytest.approx(np.radians(U))


def test_a_line_of_a_date_that_does_not_exist_is_no_error():
    lines = [f"2026-02-03 10:00:{k:02d}.500 -> x:{k} y:2" for k in range(40)]
    damaged = [*lines[:20], lines[20].replace("02-03", "02-30"), *lines[21:]]
    whole = plain_lines("\n".join(lines))
    assert [row for row in plain_lines("\n".join(damaged)) if row in whole] == [
        row for k, row in enumerate(whole) if k != 21
    ]
