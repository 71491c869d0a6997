"""`twin.identify.survey` and `read_any`: Files of oscilloscopes, recorders and PLCs.

Oscilloscopes record voltages of a sensor of 20 mm/V and of a drive of 4 deg/V. What is read is
compared with the motion that was written.
"""

import shlex
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from twin.base.errors import LogError
from twin.identify.any_logs import read_any
from twin.identify.clocks import find_stated_step
from twin.identify.log_columns import wanted_columns
from twin.identify.survey import survey

STEP = 0.02
T = STEP * np.arange(400)
X = 0.050 * np.sin(1.3 * T) + 0.020 * np.sin(3.1 * T + 0.4)
U = np.radians(4.0) * np.cos(1.9 * T) + np.radians(1.0) * np.sin(4.3 * T)
MM, DEG = 1e3 * X, np.degrees(U)
VOLTS = list(zip(T - 4.0, 50 * X, DEG / 4, strict=True))
ROWS = list(zip(T, MM, DEG, strict=True))


def rigol():
    head = ["X,CH1,CH2,Start,Increment,", "Sequence,Volt,Volt,-4.000000e+00,2.000000e-02,"]
    return [*head, *(f"{k},{v:.9e},{w:.9e},," for k, (_, v, w) in enumerate(VOLTS))]


def rigol_memory():
    head = "CH1,CH2,t0 =-4.000000e+00, tInc = 2.000000e-02,"
    return [head, *(f"{v:+.9e},{w:+.9e},," for _, v, w in VOLTS)]


def rigol_seconds():
    return ["X,CH1,CH2,", "Second,Volt,Volt,", *(f"{t:.6e},{v:.9e},{w:.9e}," for t, v, w in VOLTS)]


def siglent():
    head = ["Record Length,Analog:400,,", "Sample Interval,Analog:2.000000E-02,,"]
    head += ["Vertical Units,CH1:V CH2:V,,", "Vertical Scale,CH1:1.00 CH2:1.00,,"]
    head += ["Horizontal Units,s,,", "Model Number,SDS,,", "Source,CH1,CH2", "Second,Volt,Volt"]
    return [*head, *(f"{t:+.6E},{v:.9E},{w:.9E}" for t, v, w in VOLTS)]


def keysight():
    return ["x-axis,CH1,CH2", "second,Volt,Volt", *(f"{t:E},{v:.9E},{w:.9E}" for t, v, w in VOLTS)]


def tektronix():
    head = ["Model,MSO", "", "Point Format,Y,Y", "Horizontal Units,s", "Sample Interval,0.02"]
    head += ["Vertical Units,V,V", "Vertical Offset,0,0", "Vertical Scale,1,1", "Label,,"]
    return [*head, "TIME,CH1,CH2", *(f"{t:.6e},{v:.9f},{w:.9f}" for t, v, w in VOLTS)]


def picoscope():
    rows = [f"{1e3 * t:.6f};{v:.9f};{1e3 * w:.6f}".replace(".", ",") for t, v, w in VOLTS]
    return ["Zeit;CH1;CH2", "(ms);(V);(mV)", "", *rows]


def yokogawa():
    head = ['"Model Name","DLM",,', '"TraceName","CH1   ","CH2   "', '"BlockSize",400,400']
    head += ['"VUnit","V","V"', '"SampleRate",50.0,50.0', '"HResolution",2.0e-02,2.0e-02']
    head += ['"HOffset",-4.0,-4.0', '"HUnit","s","s"', '"DisplayPointNo.",1,1']
    head += ['"Date","2026/11/30","2026/11/30"', '"Time","10:11:12.5","10:11:12.5"', ""]
    return [*head, *(f",{v:.9E},{w:.9E}" for _, v, w in VOLTS)]


def owon():
    head = ["Channel :,CH1,CH2", "Frequency :,F1=?,F2=?", "Sample interval:,20.00ms,20.00ms"]
    rows = [f"{k},{v:.9f},{w:.9f}" for k, (_, v, w) in enumerate(VOLTS)]
    return [*head, "Point:,400,400", "index,CH1(V),CH2(V)", *rows]


def rate_above_the_rows():
    return ["# Sample rate: 50 Hz", "CH1,CH2", *(f"{v:.9f},{w:.9f}" for _, v, w in VOLTS)]


def graphtec():
    """Its rows have dates in whole seconds, and milliseconds next to them."""
    head = ["Vendor,GRAPHTEC", "Sampling interval,20ms", "CH,Signal name,Input,Range", "Data"]
    head += ["Number,Date&Time,ms,CH1,CH2,Alarm1-10", "NO.,Time,ms,V,V,A1234567890"]
    rows = [
        f"{k + 1},2026-11-30 10:00:{k // 50:02d},{20 * (k % 50)},{v:+.9f},{w:+.9f},LLLLLLLLLL"
        for k, (_, v, w) in enumerate(VOLTS)
    ]
    return [*head, *rows]


SCOPES = {
    "rigol": (rigol, "time=time"),
    "rigol, whole memory": (rigol_memory, "time=time"),
    "rigol with seconds": (rigol_seconds, "time=X"),
    "siglent": (siglent, "time=Source"),
    "keysight": (keysight, "time=x-axis"),
    "tektronix": (tektronix, "time=TIME:s"),
    "picoscope": (picoscope, "time=Zeit"),
    "yokogawa": (yokogawa, "time=time"),
    "owon": (owon, "time=index:0.02s"),
    "rate above the rows": (rate_above_the_rows, "time=row:0.02s"),
    "graphtec": (graphtec, "time=Date&Time:s"),
}
"""What an oscilloscope writes, and the time that is proposed."""
UNITS = {
    "tektronix": ["", ""],
    "rigol, whole memory": ["", ""],
    "rate above the rows": ["", ""],
    "picoscope": ["V", "mV"],
}
"""Units of the two channels, by default volts."""


def assert_is_the_motion(log):
    axis = log.axes["x"]
    assert len(axis.sampled) == len(T)
    assert axis.sampled - axis.sampled[0] == pytest.approx(T, abs=2e-6)
    assert axis.ball == pytest.approx(X, abs=1e-8)
    assert axis.time - axis.time[0] == pytest.approx(T, abs=2e-6)
    assert axis.tilt == pytest.approx(U, abs=1e-8)


@pytest.mark.parametrize("scope", SCOPES)
def test_channels_of_an_oscilloscope_are_read_by_name_at_their_times(tmp_path, scope):
    write, time = SCOPES[scope]
    file = tmp_path / "a.csv"
    file.write_text("\r\n".join(write()), encoding="utf-8")
    seen = survey(file)
    units = {each.name: each.unit.replace("Volt", "V") for each in seen.columns}
    assert [units["CH1"], units["CH2"]] == UNITS.get(scope, ["V", "V"])
    assert shlex.split(seen.command)[-1].split(",")[0] == time
    drive = "0.004deg" if scope == "picoscope" else "4deg"
    told = f"{time},measured_x=CH1:0.02m,command_phi=CH2:{drive}"
    assert_is_the_motion(read_any(file, wanted_columns(told)))


def test_rows_beside_what_an_oscilloscope_states_are_all_read(tmp_path):
    """As old ones of Tektronix write them: no names, and the head in columns of its own."""
    stated = ["Record Length,400,Points", "Sample Interval,2.0e-02,s", "Vertical Units,V,"]
    beside = [*stated, *[",,"] * (len(T) - len(stated))]
    rows = zip(beside, VOLTS, strict=True)
    file = tmp_path / "a.csv"
    file.write_text("\n".join(f"{head},{t:.6f},{v:.9f},{w:.9f}," for head, (t, v, w) in rows))
    told = "time=4:s,measured_x=5:0.02m,command_phi=6:4deg"
    assert_is_the_motion(read_any(file, wanted_columns(told)))


def arff():
    head = [
        "% 1. Title: ball",
        "@RELATION rig",
        "@ATTRIBUTE time NUMERIC",
        "@attribute\t'ball mm' real",
    ]
    head += ['@attribute "servo deg" real', "@attribute mode {hand,auto}", "@DATA", "% rows"]
    return [*head, *(f"{t:.2f}, {x}, {u}, auto" for t, x, u in ROWS)]


def wincc():
    """Its times called ms are millionths of a day since 1899."""
    lines = ['"VarName";"TimeString";"VarValue";"Validity";"Time_ms"']
    for t, x, u in ROWS:
        stamp = f"{1e6 * (46356.4 + t / 86400):.6f}".replace(".", ",")
        for name, value in (("Ball_mm", x), ("Servo_deg", u)):
            number = f"{value}".replace(".", ",")
            lines.append(f'"{name}";"30.11.2026 09:36:{int(t):02d}";{number};1;{stamp}')
    return [*lines, f'"$RT_OFF$";"30.11.2026 09:36:09";0;2;{stamp}']


def twincat_since_1601():
    """With full time stamps, which count 100 ns."""
    labels = "Name", "SampleTime[ms]", "Unit"
    cells = ("fBallX", "20", "mm"), ("fServo", "20", "deg")
    head = ["Name;Scope", "Starttime of export;134000000000000000;Montag"]
    head += [";".join((e, a, e, b)) for e, a, b in zip(labels, *cells, strict=True)]
    stamps = [134000000000000000 + 200_000 * k for k in range(len(T))]
    rows = zip(stamps, MM, DEG, strict=True)
    return [*head, *(f"{s};{x};{s};{u}".replace(".", ",") for s, x, u in rows), "EOF"]


def codesys():
    stamps = (1764500000123 + 20 * k for k in range(len(T)))
    return [
        line
        for stamp, (_, x, u) in zip(stamps, ROWS, strict=True)
        for line in (f"{stamp}|App.PLC.ball|{x}|LREAL", f"{stamp}|App.PLC.servo|{u}|LREAL")
    ]


def names_before_values():
    begin = datetime(2026, 11, 30, 10, tzinfo=UTC)
    stamps = ((begin + timedelta(seconds=t)).strftime("%Y-%m-%d %H:%M:%S.%f") for t in T)
    rows = zip(stamps, MM, DEG, strict=True)
    return [f"{stamp};plc.ball;{x};plc.servo;{u};" for stamp, x, u in rows]


def campbell():
    """Its names have their units and what was sampled in rows of their own."""
    head = ['"TOA5","CR6","CR6","1234"', '"TIMESTAMP","RECORD","Ball_x","Servo"']
    head += ['"TS","RN","mm","deg"', '"","","Smp","Smp"']
    return head + [f'"2026-11-30 10:00:{t:05.2f}",{k},{x},{u}' for k, (t, x, u) in enumerate(ROWS)]


def two_rows_of_names():
    """The first two columns have their names in the row above those of the others."""
    head = ["Date,Time,1,2", ",,Ball,Servo", ",,mm,deg"]
    return head + [f"2026/11/30,10:00:{t:05.2f},{x},{u}" for t, x, u in ROWS]


PLCS = {
    "two rows of names": (two_rows_of_names, "time=Time:s,measured_x=Ball,command_phi=Servo"),
    "arff": (arff, "time=time:s,measured_x=ball mm:mm,command_phi=servo deg:deg"),
    "simatic panel": (wincc, "time=time,measured_x=Ball_mm:mm,command_phi=Servo_deg:deg"),
    "twincat since 1601": (twincat_since_1601, "time=time,measured_x=fBallX,command_phi=fServo"),
    "codesys": (
        codesys,
        "time=time:ms,measured_x=App.PLC.ball:mm,command_phi=App.PLC.servo:deg",
    ),
    "names before values": (
        names_before_values,
        "time=1:s,measured_x=plc.ball:mm,command_phi=plc.servo:deg",
    ),
    "campbell": (campbell, "time=TIMESTAMP:s,measured_x=Ball_x,command_phi=Servo"),
}
"""What a PLC, a data logger or another program writes, and the columns that are proposed."""


@pytest.mark.parametrize("plc", PLCS)
def test_a_log_of_a_plc_is_read_with_the_columns_that_are_proposed(tmp_path, plc):
    write, columns = PLCS[plc]
    file = tmp_path / "a.txt"
    file.write_text("\r\n".join(write()), encoding="utf-8")
    seen = survey(file)
    assert shlex.split(seen.command)[-1] == columns
    assert not [column.name for column in seen.columns if column.name.startswith("$")]
    log = read_any(file, wanted_columns(columns))
    assert not [note for note in log.notes if "without a number" in note]
    assert_is_the_motion(log)


def test_channels_of_labview_with_times_of_their_own_are_joined_by_time(tmp_path):
    head = ["LabVIEW Measurement\t", "X_Columns\tMulti", "***End_of_Header***\t"]
    head += ["Channels\t2\t\t", "Y_Unit_Label\tmm\t\tdeg", "***End_of_Header***\t\t\t"]
    head += ["X_Value\tball\tX_Value\tservo\tComment"]
    servo = [f"{2 * t:.6f}\t{u}" for t, u in zip(T[:200], DEG[::2], strict=True)]
    rows = [
        f"{t:.6f}\t{x}\t{servo[k] if k < len(servo) else chr(9)}"
        for k, (t, x, _) in enumerate(ROWS)
    ]
    file = tmp_path / "a.lvm"
    file.write_text("\n".join([*head, *rows]))
    axis = read_any(file, wanted_columns("time=X_Value,measured_x=ball,command_phi=servo")).axes[
        "x"
    ]
    assert axis.ball == pytest.approx(X, abs=1e-8)
    assert axis.time == pytest.approx(T[::2], abs=1e-6)
    assert axis.tilt == pytest.approx(U[::2], abs=1e-8)


def test_channels_of_labview_have_the_steps_that_its_head_states_for_each(tmp_path):
    head = ["LabVIEW Measurement\t", "X_Columns\tNo", "***End_of_Header***\t", "Channels\t2\t"]
    head += ["Y_Unit_Label\tmm\tdeg", "X0\t0.0\t0.0", "Delta_X\t0.02\t0.04"]
    head += ["***End_of_Header***\t\t", "X_Value\tball\tservo\tComment"]
    servo = [*map(str, DEG[::2]), *[""] * 200]
    rows = [f"\t{x}\t{u}" for x, u in zip(MM, servo, strict=True)]
    file = tmp_path / "a.lvm"
    file.write_text("\n".join([*head, *rows]))
    axis = read_any(file, wanted_columns("time=X_Value,measured_x=ball,command_phi=servo")).axes[
        "x"
    ]
    assert axis.sampled == pytest.approx(T, abs=1e-6)
    assert axis.time == pytest.approx(T[::2], abs=1e-6)
    assert axis.tilt == pytest.approx(U[::2], abs=1e-8)


def test_an_export_of_twincat_without_times_says_what_it_lacks(tmp_path):
    file = tmp_path / "a.csv"
    head = ["Name;Scope", "Name;fBallX;fServo", "SampleTime[ms];20;20", "Unit;mm;deg"]
    file.write_text("\n".join([*head, *(f";{x};{u}" for _, x, u in ROWS)]))
    with pytest.raises(LogError, match="no row has a time; export it again with time columns"):
        survey(file)


def test_a_state_next_to_the_numbers_names_no_column(tmp_path):
    """A word that stays for a while in a log without names is no name of the number behind it."""
    file = tmp_path / "a.csv"
    rows = [f"{t:.2f},{'hand' if t < 3 else 'auto'},{x},{u}" for t, x, u in ROWS]
    file.write_text("\n".join(rows))
    assert [column.name for column in survey(file).columns] == ["1", "3", "4"]
    assert_is_the_motion(read_any(file, wanted_columns("time=1,measured_x=3:mm,command_phi=4:deg")))


@pytest.mark.parametrize(
    ("head", "step"),
    [
        ("Sample Interval,Analog:2.000000E-02,,", 0.02),
        ("Sampling interval,20ms", 0.02),
        ("Sample interval:,20.00us,20.00us", 2e-5),
        ("#Sample rate: 1e+06Hz", 1e-6),
        ("Sampling rate;2.5 kHz", 4e-4),
        ("SampleRate\t50", 0.02),
        ("Sample rate: 0 Hz", None),
        ("sample,rate,x", None),
        ("x: 0.02", None),
    ],
)
def test_a_head_states_the_time_between_two_rows(head, step):
    found = find_stated_step(f"Model,A\n{head}\n1,2\n")
    assert found is None if step is None else found == pytest.approx(step)
