"""A node FMU, driven through the functions of FMI 3.0 as an importer with event mode does it."""

import ctypes
import struct
import zipfile
from xml.etree import ElementTree

from ballplate.rigs import drive_fmu
from twin.emulator.drive_objects import Frame

TRANSMIT = 0x10
HEAD = struct.Struct("<II")
TRANSMITTED = struct.Struct("<IBBH")
TYPES = {"Float64": ctypes.c_double, "Int32": ctypes.c_int32, "Boolean": ctypes.c_bool}


def operation(code, arguments=b""):
    """The bytes of an operation on the bus."""
    return HEAD.pack(code, 8 + len(arguments)) + arguments


def transmit(frame):
    """The operation that puts a frame on the bus."""
    head = TRANSMITTED.pack(frame.cob_id, frame.extended, frame.remote, len(frame.data))
    return operation(TRANSMIT, head + frame.data)


def split(data):
    """Code and arguments of each operation in some bytes."""
    found = []
    while data:
        code, length = HEAD.unpack_from(data)
        assert 8 <= length <= len(data)
        found.append((code, data[8:length]))
        data = data[length:]
    return found


def frames_of(data):
    """The frames in the operations of some bytes, which are all transmissions."""
    frames = []
    for code, arguments in split(data):
        assert code == TRANSMIT
        cob_id, extended, remote, length = TRANSMITTED.unpack_from(arguments)
        assert length == len(arguments) - TRANSMITTED.size
        frames.append(Frame(cob_id, arguments[TRANSMITTED.size :], bool(remote), bool(extended)))
    return frames


def make_library(folder):
    """The drive as an FMU, and unpacked in the same folder; its library."""
    path = drive_fmu("akd", folder / "drive.fmu")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder / "drive")
    (library,) = (folder / "drive").rglob("*.so")
    return library


class BusNode:
    """One instance in a library; it is in event mode between two calls."""

    def __init__(self, library, *, events=True, **values):
        self._lib = ctypes.CDLL(str(library))
        self._lib.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
        root = ElementTree.parse(library.parents[2] / "modelDescription.xml").getroot()
        self.variables = {each.get("name"): each for each in root.find("ModelVariables")}
        self.lines = []
        kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, *2 * (ctypes.c_char_p,))
        self._log = kind(lambda *logged: self.lines.append(logged[3].decode()))
        null = ctypes.c_void_p()
        token = root.get("instantiationToken").encode()
        made = self._lib.fmi3InstantiateCoSimulation(
            b"drive", token, None, False, False, events, False, None,
            ctypes.c_size_t(0), null, self._log, null,
        )  # fmt: skip
        self.instance = ctypes.c_void_p(made)
        self.time = 0.0
        for name, value in values.items():
            assert self.set(name.replace("__", "."), value) == 0, self.lines

    def begin(self):
        """Go through initialization; what is sent in the first event mode."""
        zero = ctypes.c_double(0.0)
        self.call("EnterInitializationMode", False, zero, zero, False, zero)
        self.call("ExitInitializationMode")
        return self.sent

    def call(self, name, *arguments):
        assert self.status(name, *arguments) == 0, self.lines

    def status(self, name, *arguments):
        return getattr(self._lib, f"fmi3{name}")(self.instance, *arguments)

    def reference(self, name):
        """The value reference of a variable as an array of one."""
        return (ctypes.c_uint32 * 1)(int(self.variables[name].get("valueReference")))

    def set(self, name, value):
        kind = self.variables[name].tag
        one = ctypes.c_size_t(1)
        return self.status(f"Set{kind}", self.reference(name), one, (TYPES[kind] * 1)(value), one)

    def get(self, name):
        kind = self.variables[name].tag
        value, one = (TYPES[kind] * 1)(), ctypes.c_size_t(1)
        self.call(f"Get{kind}", self.reference(name), one, value, one)
        return value[0]

    @property
    def ticks(self):
        """Whether Tx_Clock is active."""
        value = (ctypes.c_bool * 1)()
        self.call("GetClock", self.reference("can.Tx_Clock"), ctypes.c_size_t(1), value)
        return value[0]

    @property
    def sent(self):
        """The bytes of Tx_Data in this event mode; none while its clock is not active."""
        size, data, one = (ctypes.c_size_t * 1)(), (ctypes.c_void_p * 1)(), ctypes.c_size_t(1)
        self.call("GetBinary", self.reference("can.Tx_Data"), one, size, data, one)
        found = ctypes.string_at(data[0], size[0])
        assert self.ticks == bool(found)
        return found

    def activate(self, active=True):
        """Set Rx_Clock."""
        one = ctypes.c_size_t(1)
        return self.status(
            "SetClock", self.reference("can.Rx_Clock"), one, (ctypes.c_bool * 1)(active)
        )

    def put(self, data):
        """Set Rx_Data."""
        held = ctypes.create_string_buffer(data, len(data))
        pointer, one = (ctypes.c_void_p * 1)(ctypes.addressof(held)), ctypes.c_size_t(1)
        size = (ctypes.c_size_t * 1)(len(data))
        return self.status("SetBinary", self.reference("can.Rx_Data"), one, size, pointer, one)

    def update(self):
        flags = [ctypes.byref(ctypes.c_bool()) for _ in range(5)]
        self.call("UpdateDiscreteStates", *flags, ctypes.byref(ctypes.c_double()))

    def step(self, length):
        """Status and need of an event mode of a step in step mode."""
        event, *flags = (ctypes.c_bool() for _ in range(3))
        time, last = ctypes.c_double(self.time), ctypes.c_double(0.0)
        pointers = [ctypes.byref(each) for each in (event, *flags)]
        status = self.status(
            "DoStep", time, ctypes.c_double(length), False, *pointers, ctypes.byref(last)
        )
        self.time += length if status < 2 else 0.0
        return status, event.value

    def exchange(self, data, dt):
        """Receive operations, go on by dt in s, enter event mode: the bytes that are sent."""
        if data:
            assert self.activate() == 0, self.lines
            assert self.put(data) == 0, self.lines
        self.update()
        self.call("EnterStepMode")
        status, event = self.step(dt)
        assert status == 0, self.lines
        self.call("EnterEventMode")
        assert event == self.ticks
        return self.sent

    def __del__(self):
        self._lib.fmi3FreeInstance(self.instance)
