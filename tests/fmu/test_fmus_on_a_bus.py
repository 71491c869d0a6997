"""`twin.fmu.bus_node`.

Rig, controller and two drives as four FMUs: the example with the drives on one simulated bus."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli import ballplate as command

SCRIPT = Path(__file__).parents[2] / "examples" / "fmus_on_a_bus" / "circle.py"
PERIODS = 1000


@pytest.fixture(scope="module")
def example():
    """The example as a module."""
    spec = importlib.util.spec_from_file_location("fmus_on_a_bus", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def files(example, tmp_path_factory):
    """Its FMUs."""
    return example.make_fmus(tmp_path_factory.mktemp("pair"), PERIODS * example.PERIOD_S)


@pytest.fixture(scope="module")
def on_bus(example, files):
    """Path of ball and reference over the bus, and the bus."""
    return example.over_the_bus(files, PERIODS)


@pytest.mark.long
def test_delay_and_counts_are_all_that_the_bus_changes(example, files, on_bus):
    known = {"late": True, "counted": True, "ramped": True}
    path, _ = on_bus
    whole = example.connected_directly(files, PERIODS, **known)
    np.testing.assert_allclose(path, whole, rtol=0, atol=1e-9)
    for each in known:
        part = example.connected_directly(files, PERIODS, **known | {each: False})
        assert np.abs(path - part).max() > 1e-7, each


def checked(bus, folder, keep=lambda _time, _frame: True):
    """Exit code and first line of the trace's check, of some frames of a bus."""
    trace = folder / "bus.log"
    trace.write_text("".join(line for *each, line in lines(bus) if keep(*each)), "ascii")
    found = CliRunner().invoke(command, ["trace", str(trace), "--check"])
    return found.exit_code, found.output.splitlines()[0]


def lines(bus):
    """Time, frame, and line of each entry of a log."""
    for time, frame in bus.log:
        yield time, frame, f"({time:.6f}) can0 {frame.cob_id:03X}#{frame.data.hex().upper()}\n"


@pytest.mark.long
def test_the_trace_of_the_bus_has_nothing_wrong_unless_frames_are_missing(on_bus, tmp_path):
    _, bus = on_bus
    code, line = checked(bus, tmp_path)
    assert code == 0
    assert line.startswith("nothing wrong: 3 nodes and 2 drives for 2.1 s")
    without_sync = checked(bus, tmp_path, lambda t, f: f.cob_id != 0x080 or not 1.0 < t < 1.1)
    without_angle = checked(bus, tmp_path, lambda t, f: f.cob_id != 0x182 or not 1.0 < t < 1.1)
    assert all("nothing wrong" not in line for _, line in (without_sync, without_angle))


def test_the_lowest_identifier_goes_first_and_a_frame_takes_its_time(example):
    sent = {1: [example.Frame(0x181, bytes(6))], 2: [example.Frame(0x182, bytes(6))]}
    sent[127] = [example.Frame(0x080)]
    heard = {node: [] for node in sent}

    def node(which):
        def exchange(time, received):
            heard[which] += [(time, frame.cob_id) for frame in received]
            return sent.pop(which, [])

        return exchange

    bus = example.Bus({which: node(which) for which in (2, 1, 127)})
    for step in range(4):
        bus.step(step * example.STEP_S)
    # 47 bits and 8 stuff bits, 95 and 20; what does not fit into a step waits for the next
    expected = [(55e-6, 0x080), (170e-6, 0x181), (example.STEP_S + 115e-6, 0x182)]
    assert [frame.cob_id for _, frame in bus.log] == [each for _, each in expected]
    assert [time for time, _ in bus.log] == pytest.approx([time for time, _ in expected])
    assert heard[127] == [(example.STEP_S, 0x181), (2 * example.STEP_S, 0x182)]
    assert heard[1] == [(example.STEP_S, 0x080), (2 * example.STEP_S, 0x182)]


def test_an_emergency_ends_the_example(example):
    with pytest.raises(RuntimeError, match="emergency of node 2: 8110"):
        example.Master().exchange(0.0, [example.Frame(0x082, bytes.fromhex("8110014636303200"))])
