"""The C rig, driven through the functions of FMI 3.0, and a twin that has the same noise."""

import ctypes
import shutil
import sys
import zipfile
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from ballplate.changes import changes_of, scenario_of
from ballplate.rigs import fmu as export
from twin.base.errors import RecordError, ScenarioError
from twin.cli import ballplate as command
from twin.fmu.export import frame_phase, variables
from twin.hal.interface import Touch
from twin.run.controller_building import build_limits
from twin.run.loop import drive
from twin.run.metrics import Ending
from twin.run.record import Recorder
from twin.sim.rig import SimulatedRig

sys.modules["c_rig"] = sys.modules[__name__]  # by which name the tests beside import from it
TRUE = tuple(f"true_{each}{rate}" for each in ("x", "phi", "y", "theta") for rate in ("", "_rate"))


def pytest_collection_modifyitems(items):
    """Without a C compiler there is nothing to drive; that this is said needs none."""
    if shutil.which("cc") is None:
        for item in items:
            if item.path.parent == Path(__file__).parent and "without_a_compiler" not in item.name:
                item.add_marker(pytest.mark.skip(reason="no C compiler"))


@pytest.fixture
def refuse_export(tmp_path, monkeypatch):
    """Asks for an export that is refused: the one line of its error; nothing is written."""

    def refuse(*arguments):
        monkeypatch.chdir(tmp_path)
        answer = CliRunner().invoke(command, ["export", *arguments])
        assert isinstance(answer.exception, RecordError | ScenarioError)
        assert list(tmp_path.iterdir()) == []
        return str(answer.exception)

    return refuse


TYPES = {"Float64": ctypes.c_double, "Int32": ctypes.c_int32, "Boolean": ctypes.c_bool}


def exact(name="circle", **settings):
    """A shipped scenario on the exact equations, keys with __ for dots."""
    keys = {key.replace("__", "."): value for key, value in settings.items()}
    return scenario_of(name, changes_of(keys | {"plant.kind": "lagrange"}, {}))


def made(folder, name="circle", fmi=3, **settings):
    """An FMU of a scenario, unpacked, and the path of its library."""
    path = folder / f"rig{fmi}.fmu"
    export(name, path, {key.replace("__", "."): value for key, value in settings.items()}, fmi=fmi)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder / f"fmi{fmi}")
    (library,) = (folder / f"fmi{fmi}").rglob("*.so")
    return library


class CRig:
    """One instance in a library, of the parameters of a scenario where one is given."""

    def __init__(self, library, scenario=None, **values):
        self._lib = ctypes.CDLL(str(library))
        self._lib.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
        root = ElementTree.parse(library.parents[2] / "modelDescription.xml").getroot()
        self.names = {each.get("name"): each for each in root.find("ModelVariables")}
        self.said, self._known = [], {}
        kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, *2 * (ctypes.c_char_p,))
        self._log = kind(lambda *told: self.said.append(told[3].decode()))
        self.token = root.get("instantiationToken")
        null = ctypes.c_void_p()
        made = self._lib.fmi3InstantiateCoSimulation(
            b"rig", self.token.encode(), None, False, False, False, False, None,
            ctypes.c_size_t(0), null, self._log, null,
        )  # fmt: skip
        self.instance = ctypes.c_void_p(made)
        self.period = float(self.names["rig.period"].get("start"))
        self.tick = 0
        if scenario is not None:
            for each in variables(scenario, frame_phase(scenario)):
                if each.causality == "parameter":
                    assert self.set(each.name, each.start) == 0, self.said
        for name, value in values.items():
            assert self.set(name, value) == 0, self.said

    def enter(self):
        zero = ctypes.c_double(0.0)
        self.call("EnterInitializationMode", False, zero, zero, False, zero)

    def begin(self):
        self.enter()
        self.call("ExitInitializationMode")
        return self

    def call(self, name, *arguments):
        assert self.status(name, *arguments) == 0, self.said

    def status(self, name, *arguments):
        return getattr(self._lib, f"fmi3{name}")(self.instance, *arguments)

    def _at(self, names):
        if (found := self._known.get(names)) is None:
            references = [int(self.names[name].get("valueReference")) for name in names]
            found = self.names[names[0]].tag, (ctypes.c_uint32 * len(names))(*references)
            self._known[names] = found
        return *found, (TYPES[found[0]] * len(names))()

    def set(self, name, value):
        kind, references, values = self._at((name,))
        values[0] = int(value) if kind == "Int32" else value
        size = ctypes.c_size_t(1)
        return self.status(f"Set{kind}", references, size, values, size)

    def get(self, *names):
        kind, references, values = self._at(names)
        size = ctypes.c_size_t(len(names))
        self.call(f"Get{kind}", references, size, values, size)
        return np.array(values)

    def step(self, rate=None, periods=1):
        if rate is not None:
            for axis, each in zip(("phi", "theta"), np.ravel(rate), strict=True):
                self.set(f"rate_{axis}", each)
        assert self.go(self.tick * self.period, periods * self.period) == 0, self.said
        self.tick += periods

    def go(self, time, length):
        """The status of a step of a length from a time on, both in s."""
        flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
        now, length, last = map(ctypes.c_double, (time, length, 0.0))
        return self.status("DoStep", now, length, False, *flags, ctypes.byref(last))

    @property
    def measured(self):
        return self.get(*(f"measured_{name}" for name in ("x", "phi", "y", "theta")))

    @property
    def truth(self):
        return self.get(*TRUE)

    def __del__(self):
        self._lib.fmi3FreeInstance(self.instance)


def mixed(z):
    """SplitMix64's finaliser, in numpy."""
    with np.errstate(over="ignore"):
        z = z + np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def normal(seed, stream, number):
    """The FMU's noise, in numpy."""
    with np.errstate(over="ignore"):
        bits = mixed(mixed(mixed(np.uint64(seed)) + np.uint64(stream)) + np.uint64(number))
        u = np.float64((mixed(bits) >> np.uint64(11)) + np.uint64(1)) * 2.0**-53
        v = np.float64(mixed(bits + np.uint64(1)) >> np.uint64(11)) * 2.0**-53
    return np.sqrt(-2 * np.log(u)) * np.cos(2 * np.pi * v)


BLOCK = 256


@cache
def normal_block(seed, stream, count, block):
    """The noise of some streams for as many numbers as a block has, shape (BLOCK, count)."""
    numbers = BLOCK * block + np.arange(BLOCK)
    return normal(seed, stream + np.arange(count), numbers[:, None])


class CountedNoise:
    """In place of ``Noise``: numbers of the FMU's generator, by the tick of the devices."""

    def __init__(self, noise, tick, seed, stream):
        self._noise, self._tick, self._seed, self._stream = noise, tick, seed, stream
        self._hold = noise._hold

    @property
    def silent(self):
        return self._noise.silent

    def change(self, variance):
        self._noise.change(variance)

    def draw(self):
        number = self._tick() // self._hold
        scale = self._noise._scale[0]
        block, row = divmod(number, BLOCK)
        return scale * normal_block(self._seed, self._stream, len(scale), block)[None, row]


def counted(rig, seed):
    """Let a simulated rig, not yet read, have the FMU's noise."""
    devices, tick = rig.devices, lambda: rig.devices._tick
    vibration = devices._drives._vibration
    for owner, name, stream, count in (
        (devices._screen, "_noise", 0, tick),
        (devices._encoders, "_noise", 2, tick),
        (devices, "_disturbance", 4, tick),
        (devices._screen, "_spread", 6, tick),
        (devices._screen, "_clock", 11, tick),
        (vibration, "_noise", 7, lambda: vibration._tick - 1),
    ):
        setattr(owner, name, CountedNoise(getattr(owner, name), count, seed, stream))
    return rig


class CDevices:
    """The C rig in the place of the twin's simulated devices."""

    class Plant:
        rigs, ratio, channels = 1, 1.0, ()
        diverged = np.zeros(1, bool)

        def telemetry(self):
            return np.zeros((1, 0))

    def __init__(self, rig):
        self.rig, self.plant, self._rate = rig, self.Plant(), np.zeros(2)

    time = property(lambda self: self.rig.tick * self.rig.period)
    state = property(lambda self: self.rig.truth[None])
    on_plate = property(lambda self: self.rig.get("true_on_plate"))

    def plate(self):
        return self.rig.measured[None, 1::2]

    def motor(self):
        return self.state[:, 2::4]

    def read(self):
        return Touch(self.rig.measured[None, 0::2], self.rig.get("age"), self.rig.get("touched"))

    def command(self, rate):
        self._rate = rate

    def wait(self):
        self.rig.step(self._rate)


def behind_the_seam(rig, scenario):
    """The C rig where the twin's loop has its simulated one."""
    from twin.hal.cams import FixedRatio

    return SimulatedRig(
        CDevices(rig), transmission=FixedRatio(), limits=build_limits(scenario),
        period=scenario.rig.period,
    )  # fmt: skip


def followed(rig, controller, scenario):
    """The true states of a run, shape (ticks, 8)."""
    ticks = round(scenario.duration / scenario.rig.period)
    recorder = Recorder(ticks, 1, scenario.rig.period, rig.channels, controller.observer.knows)
    (outcome,) = drive(rig, controller, scenario.duration, recorder)
    assert outcome.ending is Ending.FINISHED
    return recorder["state"][:, 0]


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """Folder of an FMU of both versions, unpacked beside it."""
    folder = tmp_path_factory.mktemp("fmu")
    for fmi in (2, 3):
        made(folder, fmi=fmi, duration=0.4, plant__start__x=0.05, plant__start__y=0.03)
    return folder


@pytest.fixture(scope="session")
def library(exported):
    """One that any even screen's rig can be made of by its parameters."""
    (path,) = (exported / "fmi3").rglob("*.so")
    return path
