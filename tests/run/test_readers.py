"""`twin.run.readers`.

Files that other programs write are read to the last digit; broken ones are one line."""

import pickle
import re
import zipfile
from contextlib import suppress

import numpy as np
import pyarrow as pa
import pytest
import scipy.io
from command_line import called
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from controllers.ballplate import BallPlate
from twin.base.errors import LogError, TwinError
from twin.identify.any_logs import read_any
from twin.identify.log_columns import wanted_columns
from twin.identify.logs import read as read_log_of_run
from twin.run.exporters import JSON_VARIABLE, export
from twin.run.exporters import WRITERS as EXPORTERS
from twin.run.foreign_logs import foreign_table
from twin.run.logs import COLUMN_UNITS, NEEDED_COLUMNS, read_columns
from twin.scenario.load import check

T = np.arange(0.0, 4.0, 0.02)
X = 0.05 * np.sin(1.3 * T) + 1e-9 * np.sin(1e4 * T)
U = 0.02 * np.cos(T)
DATA = {"t": T, "x": X, "u": U}


def write_npz(path):
    np.savez_compressed(path, **DATA)


def write_structured(path):
    rows = np.rec.fromarrays([*DATA.values()], names=[*DATA])
    np.save(path, rows)


def write_mat(path):
    savemat(path, DATA, oned_as="row")


def write_compressed_mat(path):
    savemat(path, DATA, do_compression=True)


def write_mat_of_7_3(path):
    """As MATLAB does it: 512 bytes of its own, then HDF5 with transposed arrays."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in DATA.items():
            data = file.create_dataset(name, data=values[None, :], compression="gzip")
            data.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


def write_hdf5(path):
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in DATA.items():
            file[name] = values


def write_excel(path):
    from openpyxl import Workbook

    book = Workbook()
    book.active.append(["Measured on Monday"])
    book.active.append([*DATA])
    for row in zip(*DATA.values(), strict=True):
        book.active.append([float(each) for each in row])
    book.save(path)


def write_tdms(path):
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("", name, values) for name, values in DATA.items()])


def write_mdf(path):
    from asammdf import MDF, Signal

    with MDF() as file:
        file.append([Signal(values, T, name=name) for name, values in DATA.items()])
        file.save(path)


def write_feather(path):
    table = pa.table(DATA)
    with pa.ipc.new_file(path, table.schema) as writer:
        writer.write_table(table)


WRITERS = {
    ".npz": write_npz,
    ".npy": write_structured,
    ".mat": write_mat,
    ".v7.mat": write_compressed_mat,
    ".v73.mat": write_mat_of_7_3,
    ".h5": write_hdf5,
    ".xlsx": write_excel,
    ".tdms": write_tdms,
    ".mf4": write_mdf,
    ".feather": write_feather,
}


@pytest.fixture(params=WRITERS)
def written(request, tmp_path):
    file = tmp_path / f"log{request.param}"
    WRITERS[request.param](file)
    return file


def test_every_format_is_read_to_the_last_digit_whatever_it_is_called(written):
    renamed = written.rename(written.with_name("a.csv"))
    columns = foreign_table(renamed).columns
    found = {name.removeprefix("/"): values for name, values in columns.items()}
    assert set(found) == set(DATA)
    digits = 1e-15 if written.suffix == ".xlsx" else 0.0  # openpyxl writes 16 of 17
    for name, values in DATA.items():
        np.testing.assert_allclose(found[name], values, rtol=digits, atol=0)


def test_a_log_of_any_format_is_one_of_a_rig(written):
    names = {name.removeprefix("/"): name for name in foreign_table(written).columns}
    asked = f"time={names['t']},measured_x={names['x']},command_phi={names['u']}"
    axis = read_any(written, wanted_columns(asked)).axes["x"]
    assert axis.time == pytest.approx(T, abs=1e-12)
    assert axis.ball == pytest.approx(X, abs=1e-12)
    assert axis.tilt == pytest.approx(U, abs=1e-12)


@pytest.mark.parametrize("kept", [30, 200, 700, -40])
def test_a_file_that_is_cut_or_spoilt_is_one_line(written, kept):
    content = written.read_bytes()
    for broken in (content[:kept], content[:kept] + b"\xff" * 64 + content[kept + 64 :]):
        written.write_bytes(broken)
        with suppress(TwinError):  # or what was spoilt is no part of a column, or is one number
            foreign_table(written)
            continue
        with pytest.raises(TwinError, match=rf"^{re.escape(written.name)}: [^\n]+$"):
            foreign_table(written)


class Runs:
    """Whoever unpickles it is found out."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('unpickled')",))


def test_objects_of_numpy_are_not_unpickled(tmp_path):
    array = np.array([Runs(), Runs()], dtype=object)
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "b.npz", evil=array, x=X)
    np.savez(tmp_path / "c.npz", evil=array)
    (tmp_path / "d.npy").write_bytes(pickle.dumps(Runs()))
    for name in ("a.npy", "c.npz", "d.npy"):
        with pytest.raises(LogError, match=r"Python objects|pickle|not known here"):
            foreign_table(tmp_path / name)
    table = foreign_table(tmp_path / "b.npz")
    assert list(table.columns) == ["x"]
    assert "evil: left out: holds Python objects" in table.notes[0]


def bomb_npz(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open(
        "x.npy", "w", force_zip64=True
    ) as file:  # fmt: skip
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f8", "fortran_order": False, "shape": (10_000_000,)}
        )
        for _ in range(80):
            file.write(bytes(1_000_000))


def bomb_npy(path):
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f8", "fortran_order": False, "shape": (10**13,)}
        )


def bomb_mat(path):
    savemat(path, {"x": np.zeros(10_000_000)}, do_compression=True)


def bomb_hdf5(path):
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(10**12,), dtype="f8", chunks=(1 << 16,), compression="gzip")


BOMBS = {".npz": bomb_npz, ".npy": bomb_npy, ".mat": bomb_mat, ".h5": bomb_hdf5}


@pytest.mark.short(".npy", ".h5", ".npz")
@pytest.mark.parametrize("ending", BOMBS)
def test_a_small_file_that_would_fill_the_memory_is_refused(tmp_path, ending, monkeypatch):
    file = tmp_path / f"bomb{ending}"
    BOMBS[ending](file)
    assert file.stat().st_size < 500_000
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: 1 / 0)
    monkeypatch.setattr("numpy.lib.format.read_array", lambda *_, **__: 1 / 0)
    with pytest.raises(LogError, match=r"cannot be read: (would take \d+ MB|is incomplete)"):
        foreign_table(file)


def test_links_of_an_hdf5_file_lead_nowhere(tmp_path):
    import h5py

    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["secret"] = X
    X.tofile(tmp_path / "secret.raw")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["own"] = X
        file["out"] = h5py.ExternalLink("secret.h5", "secret")
        raw = [(str(tmp_path / "secret.raw"), 0, X.nbytes)]
        file.create_dataset("raw", shape=X.shape, dtype="f8", external=raw)
        layout = h5py.VirtualLayout(shape=X.shape, dtype="f8")
        layout[:] = h5py.VirtualSource(tmp_path / "secret.h5", "secret", shape=X.shape)
        file.create_virtual_dataset("virtual", layout)
    assert list(foreign_table(tmp_path / "a.h5").columns) == ["own"]


def test_simulink_s_structure_with_time_is_read_by_label(tmp_path):
    signals = np.array(
        [(X[:, None], "ball"), (np.stack((U, 2 * U), axis=1), "servo")],
        dtype=[("values", object), ("label", object)],
    )
    slow = {"time": T[::4], "signals": {"values": X[::4], "label": ""}}
    savemat(tmp_path / "a.mat", {"out": {"time": T, "signals": signals}, "camera": slow})
    table = foreign_table(tmp_path / "a.mat")
    assert {*table.columns} == {
        "out.time", "out.ball", "out.servo.1", "out.servo.2", "camera.time", "camera.signals.1",
    }  # fmt: skip
    np.testing.assert_array_equal(table.columns["out.servo.2"], 2 * U)
    wanted = wanted_columns("measured_x=camera.signals.1,command_phi=-out.servo.2")
    log = read_any(tmp_path / "a.mat", wanted)
    assert log.axes["x"].ball == pytest.approx(X[::4])
    assert log.axes["x"].sampled == pytest.approx(T[::4])
    assert log.axes["x"].tilt == pytest.approx(-2 * U)
    assert "columns have times of their own, at 12.5 Hz, 50 Hz" in log.notes


def test_a_column_of_a_different_length_is_named(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, x=X[:-3], u=U)
    with pytest.raises(LogError, match="measured_x: has 197 rows, time 200"):
        read_any(tmp_path / "a.npz", wanted_columns("time=t,measured_x=x,command_phi=u"))


def opaque_element(name):
    """A variable of a class of MATLAB, as a MATLAB 5 file has it."""

    def element(kind, data):
        return np.array([kind, len(data)], "<u4").tobytes() + data + bytes(-len(data) % 8)

    inner = element(6, np.array([13, 0], "<u4").tobytes()) + element(
        5, bytes([2, 0, 0, 0, 1, 0, 0, 0])
    )
    inner += element(1, b"") + element(6, np.array([1, 2], "<u4").tobytes())
    parts = element(6, np.array([17, 0], "<u4").tobytes())
    parts += b"".join(element(1, text) for text in (name, b"MCOS", b"timeseries"))
    return element(14, parts + element(14, inner))


def test_an_object_of_matlab_is_one_line_that_makes_a_readable_file(tmp_path):
    savemat(tmp_path / "a.mat", {"x": X})
    both = (tmp_path / "a.mat").read_bytes() + opaque_element(b"ts")
    (tmp_path / "a.mat").write_bytes(both)
    (tmp_path / "b.mat").write_bytes(both[:128] + opaque_element(b"ts"))
    with pytest.raises(LogError, match=r"MATLAB object.*x = .*\.Data; save\('log.mat'") as caught:
        foreign_table(tmp_path / "b.mat")
    assert "\n" not in str(caught.value)
    table = foreign_table(tmp_path / "a.mat")
    assert list(table.columns) == ["x"]
    assert "is a MATLAB object" in table.notes[0]


def test_groups_of_a_measurement_file_keep_their_times_and_units(tmp_path):
    from asammdf import MDF, Signal

    late = 0.01 + 0.05 * np.arange(60)
    with MDF() as file:
        file.append([Signal(1e3 * X, T, unit="mm", name="x"), Signal(U, T, unit="rad", name="u")])
        file.append([Signal(np.cos(late), late, name="u"), Signal(late > 1, late, name="seen")])
        text = np.array([b"a", b"b"] * 30)
        file.append([Signal(text, late, name="text", encoding="utf-8")])
        file.save(tmp_path / "a.mf4")
    found = foreign_table(tmp_path / "a.mf4")
    assert set(found.columns) == {"x", "u.1", "u.2", "seen"}
    assert found.units == {"x": "mm", "u.1": "rad"}
    np.testing.assert_allclose(found.clocks["u.1"], T, atol=1e-12)
    np.testing.assert_allclose(found.clocks["u.2"], late, atol=1e-12)
    np.testing.assert_array_equal(found.columns["seen"], late > 1)
    columns = wanted_columns("measured_x=x,command_phi=u.1")
    axis = read_any(tmp_path / "a.mf4", columns).axes["x"]
    np.testing.assert_allclose(axis.ball, X, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("u1", [-1, 0.5, 0.5, 0.5, 1.25, 1.25, -1]), ("f8", [-1, 0.5, 0.5, -1, 1.25, -1, -1])],
)
def test_integers_within_a_range_of_a_measurement_file_have_its_number(tmp_path, kind, expected):
    from asammdf import MDF, Signal
    from asammdf.blocks.conversion_utils import from_dict

    raw = np.array([2, 3, 5, 9, 10, 20, 25], dtype=kind)
    ranges = from_dict(
        {"lower_0": 3, "upper_0": 9, "phys_0": 0.5, "lower_1": 10, "upper_1": 20, "phys_1": 1.25}
        | {"default": -1}
    )
    with MDF() as file:
        file.append([Signal(raw, T[: len(raw)], name="x", conversion=ranges)])
        file.save(tmp_path / "a.mf4")
    np.testing.assert_array_equal(foreign_table(tmp_path / "a.mf4").columns["x"], expected)


def test_samples_that_a_measurement_file_marks_as_invalid_are_left_out(tmp_path):
    from asammdf import MDF, Signal

    lost = (T > 1) & (T < 1.5)
    x = Signal(np.where(lost, 9.0, X), T, unit="m", name="x", invalidation_bits=lost)
    with MDF() as file:
        file.append([x, Signal(U, T, unit="rad", name="u")], common_timebase=True)
        file.save(tmp_path / "a.mf4")
    columns = wanted_columns("measured_x=x,command_phi=u")
    axis = read_any(tmp_path / "a.mf4", columns).axes["x"]
    np.testing.assert_allclose(axis.sampled, T[~lost], atol=1e-12)
    np.testing.assert_array_equal(axis.ball, X[~lost])
    assert len(axis.tilt) == len(T)


@pytest.mark.parametrize(
    ("starts", "shift"),
    [
        (("2026-01-01T10:00:00.0", "2026-01-01T10:00:00.3"), 0.3),
        (("2026-01-01T10:00:00.3", "2026-01-01T10:00:00.0"), -0.3),
        (("2026-01-01T10:00:00.0", "1904-01-01T00:00:00.0"), 0.0),
        (("2026-01-01T10:00:00.0", None), 0.0),
    ],
)
def test_waveforms_of_labview_that_start_apart_keep_their_distance(tmp_path, starts, shift):
    from nptdms import ChannelObject, TdmsWriter

    channels = []
    for name, values, start in zip("xu", (X, U), starts, strict=True):
        properties = {"wf_increment": T[1] - T[0], "wf_start_offset": 0.0}
        if start is not None:
            properties["wf_start_time"] = np.datetime64(start)
        channels.append(ChannelObject("rig", name, values, properties))
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(channels)
    table = foreign_table(tmp_path / "a.tdms")
    apart = table.clocks["rig/u"] - table.clocks["rig/x"]
    np.testing.assert_allclose(apart, shift, atol=1e-9)
    assert min(clock[0] for clock in table.clocks.values()) == 0
    assert [f"{abs(shift):g} s apart" in note for note in table.notes] == [True] * (shift != 0)
    axis = read_any(tmp_path / "a.tdms", wanted_columns("measured_x=rig/x,command_phi=rig/u")).axes
    assert axis["x"].sampled[0] - axis["x"].time[0] == pytest.approx(-shift, abs=1e-9)


@pytest.mark.parametrize(
    ("module", "ending"),
    [("h5py", ".h5"), ("openpyxl", ".xlsx"), ("nptdms", ".tdms"), ("asammdf", ".mf4")],
)
def test_without_its_library_a_file_names_the_extra(tmp_path, monkeypatch, module, ending):
    WRITERS[ending](tmp_path / f"a{ending}")
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(TwinError, match=r"needs the extra logs: pip install 'ballplate\[logs\]'"):
        foreign_table(tmp_path / f"a{ending}")


NUMBERS = st.floats(allow_nan=True, allow_infinity=False, allow_subnormal=False)
ROWS = st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), min_size=2, max_size=20)


@pytest.mark.parametrize("ending", EXPORTERS)
@given(rows=ROWS)
@settings(max_examples=15, deadline=None)
def test_what_is_exported_is_read_back_to_the_last_digit(tmp_path_factory, ending, rows):
    file = tmp_path_factory.mktemp("exported") / f"log{ending}"
    columns = {"time": 0.002 * np.arange(len(rows))}
    columns |= dict(zip(NEEDED_COLUMNS[1:], np.array(rows).T, strict=True))
    export(file, columns, {name: COLUMN_UNITS[name] for name in columns})
    found, _ = read_columns(file, COLUMN_UNITS, NEEDED_COLUMNS)
    assert set(found) == set(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_run_exported_for_matlab_holds_what_ran_and_is_read_as_its_columns(tmp_path):
    import ballplate

    gains = ["controller={kind='afl', gains=[60,54,30,8]}", "plant.kind=lagrange"]
    done = ballplate.run("circle", gains, duration=0.1, baseline=False)
    file = done.export(tmp_path / "run.mat")
    found = scipy.io.loadmat(file, simplify_cells=True)
    assert found["scenario"]["controller"]["gains"].tolist() == [60, 54, 30, 8]
    assert found["scenario"]["predictor"]["delay"] == 0.042
    assert found["scenario"]["change"].size == 0
    assert found["metrics"]["outcome"] == "finished"
    assert found["metrics"]["rms_error"] == done.metrics["rms_error"]
    assert found["units"]["measured_x"] == "m"
    assert set(foreign_table(file).columns) == set(done)


@pytest.mark.parametrize("ending", [".mat", ".parquet", ".mcap"])
def test_an_exported_run_keeps_its_ball_and_its_scenario(tmp_path, ending):
    import ballplate

    ball = {"mass": 0.0027, "radius": 0.02, "inertia": 7.2e-7}
    plant = {"kind": "lagrange", "ball": ball, "friction": {"rolling_mm": 0.07}}
    done = ballplate.run("hold", plant=plant, duration=0.1, baseline=False)
    log = read_log_of_run(done.export(tmp_path / f"log{ending}"))
    model = log.model
    assert {name: getattr(model, name) for name in ball} == ball
    assert check(log.scenario, "log") == done.scenario
    with pytest.raises(LogError, match="--ball: not allowed; a run states its ball"):
        log.with_ball(5 / 7)


def test_a_csv_file_has_columns_alone_and_its_reader_the_ball_that_is_given(tmp_path):
    import ballplate

    ball = {"mass": 0.0027, "radius": 0.02, "inertia": 7.2e-7}
    plant = {"kind": "lagrange", "ball": ball}
    done = ballplate.run("hold", plant=plant, duration=0.1, baseline=False)
    log = read_log_of_run(done.export(tmp_path / "log.csv"))
    assert not log.scenario
    assert log.model == BallPlate()
    hollow = log.with_ball(3 / 5).model
    assert 1 / (1 + hollow.inertia / (hollow.mass * hollow.radius**2)) == pytest.approx(3 / 5)


@pytest.mark.parametrize("text", ["{", "[1]", '{"scenario": 3}'])
def test_damaged_metadata_of_an_exported_run_are_one_line(tmp_path, text):
    import ballplate

    done = ballplate.run("hold", plant={"kind": "lagrange"}, duration=0.1, baseline=False)
    file = done.export(tmp_path / "log.mat")
    found = scipy.io.loadmat(file)
    own = {name: value for name, value in found.items() if not name.startswith("__")}
    scipy.io.savemat(file, own | {JSON_VARIABLE: text}, long_field_names=True)
    with pytest.raises(LogError, match=r"\Alog.mat: [^\n]*\Z"):
        read_log_of_run(file)


@pytest.mark.short("True")
@pytest.mark.parametrize("own", [True, False])
def test_the_export_to_csv_states_that_it_leaves_out_a_ball_of_ones_own(tmp_path, capsys, own):
    import ballplate

    ball = {"mass": 0.0027, "radius": 0.02, "inertia": 7.2e-7} if own else {}
    plant = {"kind": "lagrange", "ball": ball}
    ballplate.run("hold", plant=plant, duration=0.1, baseline=False, out=tmp_path / "run")
    code, shown, _ = called(capsys, "export", tmp_path / "run", tmp_path / "log.csv")
    assert code == 0
    assert ("does not state the run's ball" in shown) is own
