"""`twin.identify.survey` and `read_any`: Files as programs of laboratories write them.

Each form states the columns that are proposed for it; what they read is compared with the motion
that was written.
"""

import json
import shlex

import h5py
import numpy as np
import pandas as pd
import pytest
from openpyxl import Workbook
from scipy.io import savemat

from twin.base.errors import LogError
from twin.identify.any_logs import read_any
from twin.identify.log_columns import wanted_columns
from twin.identify.survey import survey

T = 0.02 * np.arange(400)
X = 0.050 * np.sin(1.3 * T) + 0.020 * np.sin(3.1 * T + 0.4)
U = np.radians(4.0) * np.cos(1.9 * T) + np.radians(1.0) * np.sin(4.3 * T)
MM, DEG = 1e3 * X, np.degrees(U)
PULSES = np.round(1500 + 60 * DEG)
NOISY = X + 2e-4 * np.random.default_rng(20261201).standard_normal(len(T))
ROWS = list(zip(T, MM, DEG, strict=True))
START_S = 1764500000
STAMPS = [(START_S + k // 50, 20_000_000 * (k % 50)) for k in range(len(T))]


def clock(seconds, form="{h:02d}:{m:02d}:{s:06.3f}"):
    whole = round(1e3 * seconds)
    return form.format(h=whole // 3600000, m=whole // 60000 % 60, s=whole % 60000 / 1e3)


def platformio():
    rows = ["millis,x_mm,servo_deg", *(f"{1234 + 1e3 * t:.0f},{x},{u}" for t, x, u in ROWS)]
    return [f"{clock(69989.812 + 0.02 * k)} > {row}" for k, row in enumerate(rows)]


def putty():
    head = [
        "=~=~=~=~=~=~= PuTTY log 2026.11.30 14:33:17 =~=~=~=~=~=~=",
        "",
        "time_ms;pos_mm;servo_us",
    ]
    rows = zip(T, MM, PULSES, strict=True)
    return head + [f"{5021 + 1e3 * t:.0f};{x};{pulse:.0f}" for t, x, pulse in rows]


def labview():
    head = ["LabVIEW Measurement\t", "Separator\tTab", "Decimal_Separator\t,", "X_Columns\tOne"]
    head += ["***End_of_Header***\t", "\t", "Channels\t2\t\t", "Y_Unit_Label\tmm\tV\t"]
    head += ["***End_of_Header***\t\t\t", "X_Value\tBall Position\tServo Voltage\tComment"]
    return head + [f"{t:.6f}\t{x}\t{u}\t".replace(".", ",") for t, x, u in ROWS]


def rostopic():
    fields = "header.seq", "header.stamp", "header.frame_id", "ball_x", "cmd_roll"
    rows = zip(STAMPS, X, U, strict=True)
    return [",".join(("%time", *(f"field.{each}" for each in fields)))] + [
        f"{s}{ns:09d},{k},{s}{ns:09d},plate,{x},{u}" for k, ((s, ns), x, u) in enumerate(rows)
    ]


def plotjuggler():
    lines = ["__time,/rig/ball/x,/rig/cmd/roll"]
    for t, x, u in zip(T, X, U, strict=True):
        lines += [f"{START_S + t:.6f},{x},", f"{START_S + t + 0.004:.6f},,{u}"]
    return lines


def mcap():
    lines = []
    for (s, ns), x, u in zip(STAMPS, X, U, strict=True):
        head = f'"log_time":{s}.{ns:09d},"data":'
        lines.append(f'{{"topic":"/ball",{head}{{"point":{{"x":{x},"z":0}}}}}}')
        lines.append(f'{{"topic":"/cmd",{head}{{"data":{u}}}}}')
    return lines


def influx_csv():
    lines = []
    for k, (name, values) in enumerate((("ball_x", MM), ("servo", DEG))):
        lines += ["#group,false,false,false,false,true", "#datatype,string,long,dateTime:RFC3339"]
        lines += ["#default,_result,,,,", ",result,table,_time,_value,_field"]
        lines += [
            f",,{k},2026-11-30T10:00:{t:05.2f}Z,{value},{name}"
            for t, value in zip(T, values, strict=True)
        ]
        lines.append("")
    return lines


def mosquitto():
    return [
        f'{{"tst":"2026-11-30T10:11:{12 + t:09.6f}Z+0100","topic":"{topic}","qos":0,'
        f'"payload":{value}}}'
        for t, x, u in ROWS
        for topic, value in (("rig/ball", x), ("rig/servo", u))
    ]


def node_red():
    return [
        json.dumps({"topic": "rig", "payload": {"ts": 1764500000123 + 20 * k, "x": x, "servo": u}})
        for k, (_, x, u) in enumerate(ROWS)
    ]


def logger_pro():
    head = ["Vernier Format 2", "Untitled.cmbl 11/30/2026 14:12:07 .", "Run 1"]
    head += ["Time\tPosition\tServo Angle", "t\tx\ta", "s\tmm\tdeg", ""]
    return head + [f"{t:.2f}\t{x}\t{u}" for t, x, u in ROWS]


def kinovea():
    head = ["#Kinovea Trajectory data export", "#T X Servo", "", "# Trajectory 1"]
    return head + [
        f"0:00:{2 * k // 100:02d}:{2 * k % 100:02d} {x} {u} " for k, (_, x, u) in enumerate(ROWS)
    ]


def matlab_dates():
    rows = [f"30-Nov-2026 {clock(86300 + t)},{x},{u}" for t, x, u in ROWS]
    return ["Time,Ball,Servo", *rows]


def pasco():
    names = "Time (s)", "Position (mm)", "Angle (deg)"
    rows = [f"{t:.3f};{x};{u}".replace(".", ",") for t, x, u in ROWS]
    return [";".join(f'"{name} Run #1"' for name in names), *rows]


def octave():
    lines = ["# Created by Octave 8.4.0, Mon Nov 30 14:12:07 2026 CET <lab@pc>"]
    lines += ["# name: Ts", "# type: scalar", "0.02", "", ""]
    for name, values in (("t", T), ("x", X), ("u", U)):
        lines += [f"# name: {name}", "# type: matrix", "# rows: 400", "# columns: 1"]
        lines += [*(f" {value:.17g}" for value in values), "", ""]
    return lines


def octave_structure():
    lines = ["# Created by Octave 9.2.0", "# name: log", "# type: scalar struct", "# ndims: 2"]
    lines += [" 1 1", "# length: 3", "# name: t", "# type: double_range"]
    lines += ["# base, limit, increment", "0 7.98 0.02", "", "", "# name: x", "# type: matrix"]
    lines += ["# rows: 1", "# columns: 400", " " + " ".join(map(str, MM)), "", ""]
    lines += ["# name: u", "# type: int32 matrix", "# ndims: 2", " 400 1"]
    lines += [*(f"  {pulse:.0f}" for pulse in PULSES), "", "", "", ""]
    return [*lines, "# name: note", "# type: string", "# elements: 1", "# length: 4", "test"]


def twincat():
    """The two channels have times of their own: that of the servo is sampled half as often."""
    labels = ["Name", "Data-Type", "SampleTime[ms]", "BitMask", "Unit"]
    cells = [
        ["fBallX", "REAL64", "20", "0xffffffffffffffff", "mm (Length)"],
        ["fServo", "REAL64", "40", "0xffffffffffffffff", "deg (Angle)"],
    ]
    head = ["Name\tScope", "File\tC:\\scope.csv", "Starttime of export\t134000000000000000\tMontag"]
    head += [
        "\t".join((label, first, label, second))
        for label, first, second in zip(labels, *cells, strict=True)
    ]
    rows = []
    for k, (t, x, _) in enumerate(ROWS):
        servo = f"{2e3 * t:.0f}\t{DEG[2 * k]}" if 2 * k < len(T) else "\t"
        rows.append(f"{1e3 * t:.0f}\t{x}\t{servo}".replace(".", ","))
    return [*head, "", *rows, "EOF"]


def ros2_messages():
    lines = []
    for (s, ns), x, u in zip(STAMPS, X, U, strict=True):
        lines += ["header:", "  stamp:", f"    sec: {s}", f"    nanosec: {ns}"]
        lines += ["  frame_id: plate", "ball:", f"  x: {x}", "cmd:", f"- {u}", "- 0.5", "---"]
    return lines


def blackbox():
    head = ['"Product","Blackbox flight data recorder"', '"looptime","20000"']
    head += ['"loopIteration","time","ball[0]","ball[1]","servo[0]","servo[1]"']
    rows = zip(T, MM, PULSES, strict=True)
    return head + [
        f"{k},{5e6 + 1e6 * t:.0f},{x},0,{pulse:.0f},1500" for k, (t, x, pulse) in enumerate(rows)
    ]


def zephyr():
    return ["*** Booting Zephyr OS build v3.6.0 ***"] + [
        f"[{clock(3.25 + t)},000] <inf> rig: x={x:.6f} u={u:.6f}" for t, x, u in ROWS
    ]


def docker():
    return [f"2026-11-30T10:11:{12 + t:012.9f}Z x={x:.6f} u={u:.6f}" for t, x, u in ROWS]


def grafana():
    rows = [f'"2026-11-30 {clock(40272 + t)}","{x} mm","{u}°"' for t, x, u in ROWS]
    return ["sep=,", '"Time","ball x","servo"', *rows]


def cassy():
    names = "Sekunden / s", "Weg / mm", "Stellwinkel / °"
    head = ["MIN=0", "MAX=10", "DEF=" + "\t".join(f'"{name}"' for name in names), "\t".join(names)]
    return head + [f"{t:.3f}\t{x}\t{u}".replace(".", ",") for t, x, u in ROWS]


TEXTS = {
    "platformio": (platformio, "time=received:s,measured_x=x_mm:mm,command_phi=servo_deg:deg"),
    "putty": (putty, "time=time_ms:ms,measured_x=pos_mm:mm,command_phi=servo_us:counts"),
    "labview": (
        labview,
        "time=X_Value,measured_x=Ball Position,command_phi=Servo Voltage:counts",
    ),
    "rostopic echo -p": (
        rostopic,
        "time=time:ns,measured_x=field.ball_x:m,command_phi=field.cmd_roll:rad",
    ),
    "plotjuggler": (
        plotjuggler,
        "time=__time:s,measured_x=/rig/ball/x:m,command_phi=/rig/cmd/roll:rad",
    ),
    "mcap cat": (mcap, "time=log_time:s,measured_x=/ball/point.x:m,command_phi=/cmd/data:rad"),
    "influx": (
        lambda: [
            f"rig,host=pi4 x={x},u={u},loop=3i {s}{ns:09d}"
            for (s, ns), (_, x, u) in zip(STAMPS, ROWS, strict=True)
        ],
        "time=time,measured_x=x:mm,command_phi=u:deg",
    ),
    "influx in two series": (
        lambda: [
            line
            for (s, ns), (_, x, u) in zip(STAMPS, ROWS, strict=True)
            for line in (f"ball x={x} {s}{ns:09d}", f"servo u={u} {s}{ns:09d}")
        ],
        "time=time,measured_x=ball.x:mm,command_phi=servo.u:deg",
    ),
    "influx csv": (influx_csv, "time=_time:s,measured_x=ball_x:mm,command_phi=servo:deg"),
    "mosquitto": (mosquitto, "time=tst:s,measured_x=rig/ball:mm,command_phi=rig/servo:deg"),
    "node-red": (
        node_red,
        "time=payload.ts:ms,measured_x=payload.x:mm,command_phi=payload.servo:deg",
    ),
    "logger pro": (logger_pro, "time=Time,measured_x=Position,command_phi=Servo Angle"),
    "kinovea": (kinovea, "time=T:s,measured_x=X:mm,command_phi=Servo:deg"),
    "timetable": (
        lambda: ["Time,x_mm,u_deg"] + [f"{t:.5g} sec,{x},{u}" for t, x, u in ROWS],
        "time=Time,measured_x=x_mm:mm,command_phi=u_deg:deg",
    ),
    "dates of matlab": (
        matlab_dates,
        "time=Time:s,measured_x=Ball:mm,command_phi=Servo:deg",
    ),
    "octave": (octave, "time=t:s,measured_x=x:m,command_phi=u:rad"),
    "octave structure": (
        octave_structure,
        "time=log.t:s,measured_x=log.x:mm,command_phi=log.u:counts",
    ),
    "twincat": (twincat, "time=time,measured_x=fBallX,command_phi=fServo"),
    "ros2 topic echo": (
        ros2_messages,
        "time=header.stamp.sec:s,measured_x=ball.x:m,command_phi=cmd.0:rad",
    ),
    "opencv": (
        lambda: (
            ["[INFO] camera opened"]
            + [f"Frame: {k}, Ball: ({x}, 9.5), Angle: {u}" for k, (_, x, u) in enumerate(ROWS)]
        ),
        "time=Frame:RATEHz,measured_x=Ball.0:mm,command_phi=Angle:deg",
    ),
    "pasco": (
        pasco,
        "time=Time (s) Run #1:s,measured_x=Position (mm) Run #1:mm,"
        "command_phi=Angle (deg) Run #1:deg",
    ),
    "cassy lab": (cassy, "time=Sekunden,measured_x=Weg,command_phi=Stellwinkel"),
    "units behind labelled cells": (
        lambda: ["Init done", *(f"t: {1e3 * t:.0f} ms, x: {x} mm u: {u}°" for t, x, u in ROWS)],
        "time=t,measured_x=x,command_phi=u",
    ),
    "labels that are units": (
        lambda: [f"s: {t:.2f} x: {x / 1e3} m: 3 servo: {u}" for t, x, u in ROWS],
        "time=s:s,measured_x=x:m,command_phi=servo:deg",
    ),
    "two rows of names": (
        lambda: (
            ["Time,Ball,Ball,Plate", "Time,Ball.x,Ball.v,Plate.cmd"]
            + [f"{t},{x},0.1,{u}" for t, x, u in ROWS]
        ),
        "time=Time:s,measured_x=Ball.x:mm,command_phi=Plate.cmd:deg",
    ),
    "hexadecimal dump": (
        lambda: (
            ["t x servo_us"]
            + [
                f"{round(5e6 + 1e6 * t):08X} {round(1e3 * x) & 0xFFFFFFFF:08X} {int(pulse):04X}"
                for t, (_, x, _), pulse in zip(T, ROWS, PULSES, strict=True)
            ]
        ),
        "time=t:us,measured_x=x:mm,command_phi=servo_us:counts",
    ),
    "blackbox": (
        blackbox,
        "time=time:us,measured_x=ball[0]:mm,command_phi=servo[0]:counts",
    ),
    "zephyr": (zephyr, "time=received_s:s,measured_x=x:mm,command_phi=u:deg"),
    "docker": (docker, "time=received_s:s,measured_x=x:mm,command_phi=u:deg"),
    "grafana": (grafana, "time=Time:s,measured_x=ball x,command_phi=servo"),
}
"""What the program writes, and the columns that are proposed."""


def options_along_x(file):
    """The columns that are proposed for the time and the axis x."""
    given = shlex.split(survey(file).command)[-1].split(",")
    return ",".join(each for each in given if "theta=" not in each and "_y=" not in each)


def assert_is_the_motion(log, *, ball=X, tilt=U, tilt_step=1):
    axis = log.axes["x"]
    assert len(axis.sampled) == len(T)
    assert axis.sampled == pytest.approx(T, abs=2e-6)
    assert axis.ball == pytest.approx(ball, abs=1e-6)
    at = np.round((axis.time - axis.time[0]) / 0.02).astype(int)
    assert len(at) == len(T) // tilt_step
    assert axis.tilt == pytest.approx(tilt[at], abs=2e-6 * np.abs(tilt).max())


@pytest.mark.parametrize("program", TEXTS)
def test_a_text_of_a_program_is_read_with_the_columns_that_are_proposed(tmp_path, program):
    write, columns = TEXTS[program]
    file = tmp_path / "a.txt"
    file.write_text("\r\n".join(write()), encoding="utf-8")
    asked = shlex.split(survey(file).command)[-1]
    given = asked.split(",")
    assert [each for each in given if "theta" not in each and "_y" not in each] == columns.split(
        ","
    )
    told = columns.replace("RATE", "50")
    if program == "hexadecimal dump":
        told = told.replace("x:mm", "x:um")
    log = read_any(file, wanted_columns(told))
    assert not [note for note in log.notes if "without a number" in note]
    pulses = ("putty", "blackbox", "octave structure", "hexadecimal dump")
    tilts = dict.fromkeys(pulses, PULSES) | {"labview": DEG}
    step = 2 if program == "twincat" else 1
    assert_is_the_motion(log, tilt=tilts.get(program, U), tilt_step=step)


def test_the_clock_of_tera_term_counts_days_before_the_time(tmp_path):
    file = tmp_path / "a.log"
    lines = [f"[0 {clock(55.4 + t)}] {x},{u}" for t, x, u in ROWS]
    file.write_text("\n".join(lines))
    assert "time=1:s," in survey(file).command
    assert_is_the_motion(read_any(file, wanted_columns("time=1,measured_x=2:mm,command_phi=3:deg")))


def test_seconds_without_a_header_take_the_nanoseconds_next_to_them(tmp_path):
    """As ``ros2 topic echo --csv`` writes them."""
    file = tmp_path / "a.csv"
    uneven = [(s, ns + 4_000_000 * (k % 2)) for k, (s, ns) in enumerate(STAMPS)]
    rows = zip(uneven, X, U, strict=True)
    file.write_text("\n".join(f"{s},{ns},plate,{x},{u}" for (s, ns), x, u in rows))
    assert "time=1:s," in survey(file).command
    log = read_any(file, wanted_columns("time=1:s,measured_x=4:m,command_phi=5:rad"))
    assert "1: with the nanoseconds of 2" in log.notes
    assert log.axes["x"].sampled == pytest.approx(T + 4e-3 * (np.arange(len(T)) % 2), abs=2e-6)
    # whole numbers that are anything else stay apart
    counts = np.arange(len(T)) % 50
    others = counts, 20_000 * counts, np.random.default_rng(1).integers(0, 10**9, len(T))
    for whole in others:
        rows = zip(STAMPS, whole, X, U, strict=True)
        file.write_text("\n".join(f"{s},{each},{x},{u}" for (s, _), each, x, u in rows))
        assert not [note for note in survey(file).notes if "nanoseconds" in note]


def test_rows_with_lines_between_are_no_messages(tmp_path):
    file = tmp_path / "a.txt"
    rows = [f"{t},{x},{u}" for t, x, u in ROWS]
    for k in range(380, 0, -20):
        rows.insert(k, "---")
    file.write_text("\n".join(["t,x,u", *rows]))
    told = wanted_columns("time=t:s,measured_x=x:mm,command_phi=u:deg")
    assert_is_the_motion(read_any(file, told))


def test_a_matrix_of_octave_is_read_column_by_column_behind_its_size(tmp_path):
    file = tmp_path / "a.txt"
    numbers = np.stack((20 * np.arange(400), np.round(1e3 * MM), PULSES), 1)
    lines = ["# Created by Octave 9.2.0", "# name: m", "# type: int32 matrix", "# ndims: 2"]
    lines += [" 400 3", *(f"  {value:.0f}" for value in numbers.T.ravel())]
    file.write_text("\n".join(lines))
    log = read_any(
        file, wanted_columns("time=m(:,1):ms,measured_x=m(:,2):um,command_phi=m(:,3):counts")
    )
    assert log.axes["x"].sampled == pytest.approx(T)
    assert log.axes["x"].ball == pytest.approx(X, abs=1e-6)
    assert log.axes["x"].tilt == pytest.approx(PULSES)


def test_blocks_of_gnuplot_are_parts_of_their_own(tmp_path):
    file = tmp_path / "a.dat"
    lines = [f"{t} {x} {u}" for t, x, u in ROWS[:200]]
    again = [f"{T[k]} {MM[200 + k]} {DEG[200 + k]}" for k in range(200)]
    file.write_text("\n".join(["# t x u", *lines, "", "", "# run 2", *again]))
    log = read_any(file, wanted_columns("time=t:s,measured_x=x:mm,command_phi=u:deg"))
    assert log.axes["x"].ball == pytest.approx(X, abs=1e-9)
    assert any("begins anew 1 time" in note for note in log.notes)


def test_remarks_of_sigrok_are_no_names(tmp_path):
    file = tmp_path / "a.csv"
    head = ["; CSV generated by libsigrok 0.5.2", "; Channels (2/2): BALL, SERVO", "V DC,V DC"]
    file.write_text("\n".join([*head, *(f"{x},{u}" for _, x, u in ROWS)]))
    told = wanted_columns("time=row:50Hz,measured_x=1:mm,command_phi=2:deg")
    assert_is_the_motion(read_any(file, told))


def test_names_behind_an_empty_one_are_no_remark(tmp_path):
    file = tmp_path / "a.csv"
    rows = [f"{k}; {t}; {x}; {u}" for k, (t, x, u) in enumerate(ROWS)]
    file.write_text("\n".join(["; t; x; u", *rows]))
    told = wanted_columns("time=t:s,measured_x=x:mm,command_phi=u:deg")
    assert_is_the_motion(read_any(file, told))


def write_dspace(path):
    kinds = [(name, object) for name in ("Name", "Unit", "Data", "XIndex")]
    channels = np.zeros(2, dtype=kinds)
    channels[0] = ("ball_x", "mm", MM[None, :], 1.0)
    channels[1] = ("servo_cmd", "", DEG[None, :], 1.0)
    times = np.zeros(1, dtype=kinds[:3])
    times[0] = ("", "s", T[None, :])
    savemat(path, {"rec1_003": {"X": times, "Y": channels, "Capture": {"SamplingPeriod": 0.02}}})


def write_excel(path):
    book = Workbook()
    sheet = book.active
    for row in (["Versuch 3"], [], ["Zeit", "Position", "Stellgröße"], ["s", "mm", "°"]):
        sheet.append(row)
    for t, x, u in ROWS:
        sheet.append([float(t), float(x), float(u)])
    book.save(path)


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        file["run1/time"] = T
        file.create_dataset("run1/ball", data=np.stack((MM, MM[::-1]), 1)).attrs["units"] = "mm"
        file["run1/cmd"] = np.stack((DEG, DEG[::-1]), 1)


def write_quanser(path):
    goal = 0.05 * np.sign(np.sin(0.5 * T))
    scopes = {"data_x": np.stack((T, goal, NOISY), 1), "data_theta": np.stack((T, U), 1)}
    savemat(path, scopes)


def write_pandas(path, orient, *, dates=False):
    """A table with times since 1970 in ms as its index, or with dates."""
    index = pd.to_datetime(1764500000123 + 20 * np.arange(len(T)), unit="ms")
    if not dates:
        index = pd.Index(1764500000123 + 20 * np.arange(len(T)))
    table = pd.DataFrame({"x": MM, "servo": DEG}, index=index)
    table.to_json(path, orient=orient, date_format="iso", double_precision=15)


FILES = {
    "dspace.mat": (write_dspace, "measured_x=ball_x,command_phi=servo_cmd:deg"),
    "simulink.mat": (
        lambda path: savemat(path, {"ans": np.stack((T, X, U))}),
        "time=ans.1:s,measured_x=NAME:m,command_phi=NAME:deg",
    ),
    "quanser.mat": (
        write_quanser,
        "time=data_x.1:s,measured_x=data_x.3:m,command_phi=data_theta.2:rad",
    ),
    "a.xlsx": (write_excel, "time=Zeit,measured_x=Position,command_phi=Stellgröße"),
    "a.h5": (
        write_hdf5,
        "time=run1/time:s,measured_x=run1/ball.1:mm,command_phi=run1/cmd.1:deg",
    ),
    "split.json": (
        lambda path: write_pandas(path, "split"),
        "time=index:ms,measured_x=x:mm,command_phi=servo:deg",
    ),
    "columns.json": (
        lambda path: write_pandas(path, "columns"),
        "time=index:ms,measured_x=x:mm,command_phi=servo:deg",
    ),
    "dates.json": (
        lambda path: write_pandas(path, "columns", dates=True),
        "time=index:s,measured_x=x:mm,command_phi=servo:deg",
    ),
    "index.json": (
        lambda path: write_pandas(path, "index"),
        "time=index:ms,measured_x=x:mm,command_phi=servo:deg",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_a_program_is_read_with_the_columns_that_are_proposed(tmp_path, name):
    write, columns = FILES[name]
    write(tmp_path / name)
    given = shlex.split(survey(tmp_path / name).command)[-1].split(",")
    assert [each for each in given if "theta=" not in each and "_y" not in each] == columns.split(
        ","
    )
    if name == "simulink.mat":
        columns = "time=ans(:,1),measured_x=ans(:,2):m,command_phi=ans(:,3):rad"
    log = read_any(tmp_path / name, wanted_columns(columns))
    assert_is_the_motion(log, ball=NOISY if name == "quanser.mat" else X)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda text: text.replace("# rows: 400", "# rows: 401"),
            "t: has 400 numbers, states 401 x 1",
        ),
        (lambda text: text[:2000], "t: has .* numbers, states 400 x 1"),
        (
            lambda text: (
                text.partition("# name: t")[0]
                + "# name: t\n# type: range\n# base, limit, increment\n0 1e12 1\n"
            ),
            "t: has 1000000000001 numbers, at most",
        ),
        (
            lambda text: (
                text.partition("# name: t")[0]
                + "# name: t\n# type: range\n# base, limit, increment\n0 1 0\n"
            ),
            "t: a range with no step",
        ),
        (
            lambda text: text.partition("# name: t")[0] + "# name: c\n# type: cell\n",
            "without a column of numbers; c: left out: cell",
        ),
    ],
)
def test_a_text_of_octave_that_is_damaged_is_one_line(tmp_path, change, says):
    file = tmp_path / "a.mat"
    file.write_text(change("\n".join(octave())))
    with pytest.raises(LogError, match=says) as caught:
        read_any(file, wanted_columns("time=t,measured_x=x,command_phi=u"))
    assert "\n" not in str(caught.value)


def test_an_empty_row_above_the_rows_is_no_header(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("[]\n" + "\n".join(f"[{t} {x} {u}]" for t, x, u in ROWS))
    log = read_any(file, wanted_columns("time=1:s,measured_x=2:mm,command_phi=3:deg"))
    assert_is_the_motion(log)


def test_a_column_called_as_a_step_of_twincat_is_a_column(tmp_path):
    file = tmp_path / "a.csv"
    rows = (f"{1000 * t:.3f},{x},{u}" for t, x, u in ROWS)
    file.write_text("\n".join(("SampleTime[ms],ball_x[mm],servo_x[deg]", *rows)))
    columns = "time=SampleTime,measured_x=ball_x,command_phi=servo_x"
    assert_is_the_motion(read_any(file, wanted_columns(columns)))


def test_a_head_of_labview_without_times_is_one_line(tmp_path):
    file = tmp_path / "a.lvm"
    lines = ["LabVIEW Measurement", "X_Columns\tNo", "***End_of_Header***", "Channels\t1"]
    lines += ["***End_of_Header***", "X_Value\tx\tComment", *(f"\t{x}" for _, x, _ in ROWS)]
    file.write_text("\n".join(lines))
    with pytest.raises(LogError, match="rows have no times, and its head no X0") as caught:
        read_any(file, wanted_columns("time=X_Value,measured_x=x,command_phi=x"))
    assert "\n" not in str(caught.value)


def test_a_few_objects_of_one_form_are_no_rows(tmp_path):
    """Gains next to the log are neither its rows nor columns of its own."""
    file = tmp_path / "a.json"
    gains = {axis: {"kp": 1.0, "ki": 0.1, "kd": 0.2} for axis in "xy"}
    columns = {"t": T.tolist(), "x": MM.tolist(), "u": DEG.tolist()}
    file.write_text(json.dumps({"gains": gains, **columns}))
    assert [column.name for column in survey(file).columns] == ["t", "x", "u"]


def test_objects_of_one_name_in_rows_of_json_stay_as_they_are(tmp_path):
    file = tmp_path / "a.json"
    rows = [{"name": "rig", "t": t, "value": {"x": x, "u": u}} for t, x, u in ROWS]
    file.write_text("\n".join(map(json.dumps, rows)))
    told = wanted_columns("time=t,measured_x=value.x:mm,command_phi=value.u:deg")
    assert_is_the_motion(read_any(file, told))
