"""`twin.lab.confinement`.

What the system refuses an answer, tried by harmless calls; tests of twin.lab.confinement."""

import ctypes
import errno
import os
import re
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from twin.base.errors import LawError
from twin.lab import confinement
from twin.lab.confinement import AUDIT_ARCH, REFUSED_CALLS, filter_of
from twin.lab.process import AnswerLimits, answering
from twin.lab.schema import AnswerTable

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
HELD = LINUX and pytest.mark.skipif(
    sys.platform != "linux" or os.uname().machine not in AUDIT_ARCH,
    reason="no table of system calls of this machine",
)
AT = [*AUDIT_ARCH].index(os.uname().machine) if os.uname().machine in AUDIT_ARCH else 0
NUMBERS = {name: numbers[AT] for name, numbers in REFUSED_CALLS.items() if numbers[AT] is not None}
NUMBERS |= {
    name: numbers[AT]
    for name, numbers in {
        **confinement.OWN_PROCESS_ONLY,
        **confinement.OWN_OR_ZERO,
        "clone": confinement.CLONE,
        "clone3": confinement.CLONE3,
        "execve": confinement.EXECVE_NUMBERS,
        "fcntl": confinement.FCNTL,
    }.items()
}
TRIES = """
import ctypes, os, resource, socket
libc = ctypes.CDLL(None, use_errno=True)
N = {numbers}

def call(name, *given):
    ctypes.set_errno(0)
    got = libc.syscall(ctypes.c_long(N[name]), *[ctypes.c_long(each) for each in given])
    return 0 if got >= 0 else ctypes.get_errno()

kept = []

def text(letters):
    kept.append(ctypes.create_string_buffer(letters))
    return ctypes.addressof(kept[-1])

def attempt(what):
    try:
        what()
    except OSError as error:
        return error.errno
    return 0

def tries(parent, secret):
    open('own.txt', 'w').write('mine')
    families = dict(tcp=(2, 1), udp=(2, 2), udp6=(10, 2), unix=(1, 1), unix_datagrams=(1, 2),
                    netlink=(16, 3), packets=(17, 3), vsock=(40, 1), crypto=(38, 5))
    found = {{name: attempt(lambda: socket.socket(*each)) for name, each in families.items()}}
    calls = dict(
        pair=lambda: socket.socketpair(),
        session=lambda: os.setsid(),
        group=lambda: os.setpgid(0, 0),
        signal=lambda: os.kill(parent, 0),
        everybody=lambda: os.kill(-1, 0),
        pace=lambda: os.setpriority(os.PRIO_PROCESS, parent, 19),
        limits=lambda: resource.prlimit(parent, resource.RLIMIT_CORE),
        processors=lambda: os.sched_setaffinity(parent, {{0}}),
        mode=lambda: os.chmod('own.txt', 0o777),
        times=lambda: os.utime('own.txt'),
        note=lambda: os.setxattr('own.txt', 'user.note', b'1'),
        folder=lambda: os.mkdir('folder'),
        link=lambda: os.symlink(secret, 'link.txt'),
        hard_link=lambda: os.link(secret, 'hard.txt'),
        pipe=lambda: os.mkfifo('pipe'),
        read=lambda: open(secret),
    )
    found |= {{name: attempt(each) for name, each in calls.items()}}
    found |= dict(
        memory=call('shmget', 0, 4096, 0o1600),
        semaphore=call('semget', 0, 1, 0o1600),
        queue=call('msgget', 0, 0o1600),
        posix_queue=call('mq_open', text(b'q'), 0o102, 0o600, 0),
        key=call('add_key', text(b'user'), text(b'k'), text(b'v'), 1, -1 & 0xffffffff),
        keyring=call('keyctl', 0, -3 & 0xffffffff, 1),
        users=call('unshare', 0x10000000),
        files=call('unshare', 0),
        clone_users=call('clone', 0x10000000 | 17, 0, 0, 0, 0),
        clone_process=call('clone', 17, 0, 0, 0, 0),
        clone3=call('clone3', 0, 0),
        ring=call('io_uring_setup', 0, 0),
        trace=call('ptrace', 16, parent, 0, 0),
        handle=call('open_by_handle_at', -100, 0, 0),
        program=call('execve', 0, 0, 0),
        owner=call('fcntl', 0, 8, parent),
        young=libc.syscall(ctypes.c_long(1000), 0) and ctypes.get_errno(),
    )
    return found
"""
ALLOWED = """
import os, resource
import numpy as np
import scipy.linalg

def works():
    a = np.random.default_rng(0).normal(size=(100, 100))
    np.save('a.npy', a)
    again = np.load('a.npy')
    os.remove('a.npy')
    os.kill(os.getpid(), 0)
    resource.getrlimit(resource.RLIMIT_CPU)
    resource.prlimit(0, resource.RLIMIT_CPU)
    _, values, _ = scipy.linalg.svd(again)
    return {'good': bool(np.isclose(np.log(values).sum(), np.linalg.slogdet(a)[1])),
            'here': sorted(os.listdir('.'))}
"""


def function(name: str, seconds: float = 5.0) -> AnswerTable:
    return AnswerTable(kind="function", function=name, asked={"x": "m"}, seconds=seconds)


@HELD
def test_what_no_answer_needs_is_refused_by_the_system(tmp_path: Path) -> None:
    file, secret = tmp_path / "answer.py", tmp_path / "secret.txt"
    secret.write_text("truth")
    file.write_text(TRIES.format(numbers=NUMBERS))
    with answering(file, function("tries")) as process:
        found = process.call("function", {"parent": os.getpid(), "secret": str(secret)})
    unknown = {name: found.pop(name) for name in ("clone3", "young")}
    assert unknown == dict.fromkeys(unknown, errno.ENOSYS)
    by_path = {name: found.pop(name) for name in ("folder", "link", "hard_link", "pipe", "read")}
    assert set(by_path.values()) <= {errno.EACCES, errno.EPERM, errno.EXDEV}
    assert found == dict.fromkeys(found, errno.EPERM)


def test_what_an_answer_needs_works(tmp_path: Path) -> None:
    file = tmp_path / "answer.py"
    file.write_text(ALLOWED)
    with answering(file, function("works")) as process:
        assert process.call("function", {}) == {"good": True, "here": ["answer.py"]}


@pytest.mark.long
def test_an_answer_may_use_control_and_what_that_imports(tmp_path: Path) -> None:
    file = tmp_path / "answer.py"
    file.write_text("""
import control
import numpy as np
import pandas as pd
import scipy.optimize, scipy.signal
from matplotlib.figure import Figure

def f():
    gain, _, _ = control.lqr([[0, 1], [0, 0]], [[0], [1]], np.eye(2), [[1]])
    Figure().subplots().plot([1, 2])
    return {'gain': np.round(gain[0], 6), 'rows': len(pd.DataFrame({'a': [1]}))}
""")
    with answering(file, function("f", 60.0)) as process:
        found = process.call("function", {})
    assert found == {"gain": [1.0, 1.732051], "rows": 1}  # 1 and the root of 3


@HELD
def test_a_program_may_have_threads_and_no_process(tmp_path: Path) -> None:
    (tmp_path / "law.txt").write_text("""
import os, sys, threading
found = []
for begin in (threading.Thread(target=found.append, args=(1,)).start, os.fork, os.setsid):
    try:
        begin()
    except OSError as error:
        found.append(type(error).__name__)
print('Error', found, file=sys.stderr)
""")
    command = (sys.executable, "-IS", "law.txt")
    about = AnswerTable(kind="law", file="law.txt", command=command, seconds=5.0)
    with answering(tmp_path / "law.txt", about) as process:
        process.process.wait(10)
        assert process.last_printed() == ["Error [1, 'PermissionError', 'PermissionError']"]


def run_filter(steps: list[tuple[int, int, int, int]], call: int, arch: int, *given: int) -> int:
    """The answer of a filter, by the semantics of classic BPF in the kernel's documentation."""
    data = {0: call, 4: arch} | {16 + 8 * at: each & 0xFFFFFFFF for at, each in enumerate(given)}
    at, held = 0, 0
    while True:
        code, then, otherwise, number = steps[at]
        at += 1
        if code == 0x20:
            held = data.get(number, 0)
        elif code == 0x06:
            return number
        else:
            met = {0x15: held == number, 0x35: held >= number, 0x45: bool(held & number)}[code]
            at += then if met else otherwise


def headers() -> Iterator[Any]:
    """The kernel's tables of system calls, as far as their headers are here."""
    places = {
        "x86_64": Path("/usr/include/x86_64-linux-gnu/asm/unistd_64.h"),
        "aarch64": Path("/usr/include/asm-generic/unistd.h"),
    }
    for machine, place in places.items():
        reason = "the kernel's headers are not here"
        missing = pytest.mark.skipif(not place.is_file(), reason=reason)
        yield pytest.param(machine, place, marks=missing, id=machine)


def known_calls() -> dict[str, Any]:
    """The numbers of all system calls that are named, on either machine."""
    return {
        **REFUSED_CALLS,
        **confinement.OWN_PROCESS_ONLY,
        **confinement.OWN_OR_ZERO,
        "clone": confinement.CLONE,
        "clone3": confinement.CLONE3,
        "execve": confinement.EXECVE_NUMBERS,
        "fcntl": confinement.FCNTL,
        "seccomp": tuple(confinement.SYS_SECCOMP.values()),
    }


@pytest.mark.parametrize(("machine", "header"), [*headers()])
def test_the_numbers_of_system_calls_are_those_of_the_kernel(machine: str, header: Path) -> None:
    found = dict(re.findall(r"#define __NR(?:3264)?_(\w+)\s+(\d+)", header.read_text()))
    at = [*AUDIT_ARCH].index(machine)
    compared = 0
    for name, numbers in known_calls().items():
        if name in found:
            assert numbers[at] == int(found[name]), name
            compared += 1
        else:  # younger than these headers, or not of this machine
            assert numbers[at] is None or numbers[at] > 440, name
    assert compared > 90 if machine == "x86_64" else compared > 80


@pytest.mark.parametrize("machine", [*AUDIT_ARCH])
@pytest.mark.parametrize("program", [False, True])
def test_the_filter_decides_call_by_call(machine: str, program: bool) -> None:
    at, arch, me = [*AUDIT_ARCH].index(machine), AUDIT_ARCH[machine], os.getpid()
    steps = [*filter_of(machine, program=program)]
    assert len(steps) < 4096  # the kernel takes no more
    eperm, enosys, allow = 0x50000 | errno.EPERM, 0x50000 | errno.ENOSYS, 0x7FFF0000
    other = {"x86_64": 0x40000003, "aarch64": 0x40000028}[machine]  # i386, ARM of 32 bit

    def decided(call: int, *given: int) -> int:
        return run_filter(steps, call, arch, *given)

    for numbers in REFUSED_CALLS.values():
        if numbers[at] is not None:
            assert decided(numbers[at]) == eperm
    reads, writes, mmap, futex = {
        "x86_64": (0, 1, 9, 202), "aarch64": (63, 64, 222, 98)
    }[machine]  # fmt: skip
    for call in (reads, writes, mmap, futex):
        assert decided(call) == allow
        assert run_filter(steps, call, other) == eperm
    assert decided(confinement.EXECVE_NUMBERS[at]) == (allow if program else eperm)
    thread, process, users = 0x3D0F00, 0x11, 0x10000000
    clone = confinement.CLONE[at]
    assert decided(clone, thread) == allow
    for flags in (process, users | process, users | thread, 0x4111, 0x20000 | thread):
        assert decided(clone, flags) == eperm
    for call in (confinement.CLONE3[at], 0x40000000 | reads, 470):
        assert decided(call) == enosys
    for numbers in confinement.OWN_PROCESS_ONLY.values():
        assert decided(numbers[at], me) == allow
        for whom in (0, -1, me + 1, -me):
            assert decided(numbers[at], whom) == eperm
    for numbers in confinement.OWN_OR_ZERO.values():
        assert [decided(numbers[at], whom) for whom in (0, me)] == [allow, allow]
        assert decided(numbers[at], me + 1) == eperm
    fcntl = confinement.FCNTL[at]
    assert [decided(fcntl, 0, what) for what in (1, 8, 15, 3)] == [allow, eperm, eperm, allow]


@LINUX
def test_a_place_that_is_a_file_can_be_read_and_no_other(tmp_path: Path) -> None:
    for name in ("given", "other"):
        (tmp_path / name).write_text(name)
    (tmp_path / "own").mkdir()
    program = """
import sys
from twin.lab.confinement import shut_in
if not shut_in([sys.argv[1]]):
    sys.exit(3)
print(open(sys.argv[1]).read())
try:
    open(sys.argv[2])
except PermissionError:
    print("refused")
"""
    files = [str(tmp_path / name) for name in ("given", "other")]
    done = subprocess.run(
        [sys.executable, "-c", program, *files],
        cwd=tmp_path / "own",
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 3:
        pytest.skip("this kernel has no Landlock")
    assert done.stdout.split() == ["given", "refused"]


SO_ATTACH_FILTER = 26
"""Option of a socket on Linux (asm-generic/socket.h): a filter in classic BPF of what arrives."""
KEPT_BYTES = {0x50000 | errno.EPERM: 1, 0x50000 | errno.ENOSYS: 38, 0x7FFF0000: 64}
"""So many bytes of a message are kept in place of each answer."""


@pytest.mark.skipif(sys.platform != "linux", reason="filters of sockets are Linux's")
@pytest.mark.parametrize("machine", [*AUDIT_ARCH])
def test_the_kernel_executes_the_filter_of_either_machine_as_it_is_interpreted_here(
    machine: str,
) -> None:
    # struct seccomp_data as a message, which a filter reads word by word, the highest byte first
    at, steps = [*AUDIT_ARCH].index(machine), [*filter_of(machine, program=False)]
    kept = [(*step[:3], KEPT_BYTES[step[3]] if step[0] == 0x06 else step[3]) for step in steps]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in kept))
    fprog = struct.pack("HxxxxxxQ", len(kept), ctypes.addressof(code))
    clone, me = confinement.CLONE[at], os.getpid()
    asked = [(call, first, second) for call in range(600) for first, second in ((0, 0), (me, 8))]
    asked += [(clone, flags, 0) for flags in (0x3D0F00, 0x11, 0x10010000)]
    sender, receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with sender, receiver:
        receiver.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, fprog)
        seen = set()
        for arch in (AUDIT_ARCH[machine], 0x40000003):
            for call, first, second in asked:
                sender.send(struct.pack(">16I", call, arch, 0, 0, first, 0, second, *[0] * 9))
                wanted = run_filter(steps, call, arch, first, second)
                assert len(receiver.recv(100)) == KEPT_BYTES[wanted], (call, first, second)
                seen.add(wanted)
        assert seen == set(KEPT_BYTES)


@pytest.mark.parametrize("machine", [*AUDIT_ARCH])
def test_the_numbers_of_system_calls_are_those_of_libseccomp(machine: str) -> None:
    try:
        resolve = ctypes.CDLL("libseccomp.so.2").seccomp_syscall_resolve_name_arch
    except OSError:
        pytest.skip("libseccomp is not installed")
    at, arch = [*AUDIT_ARCH].index(machine), ctypes.c_uint32(AUDIT_ARCH[machine])
    compared = 0
    for name, numbers in known_calls().items():
        number = resolve(arch, name.encode())
        if number >= 0:
            assert numbers[at] == number, name
            compared += 1
        else:  # younger than the library, or not of this machine
            assert numbers[at] is None or numbers[at] > 440, name
    assert compared > 80


def test_a_machine_without_a_table_of_calls_goes_on_without(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    strange = os.uname_result(("Linux", "here", "6", "1", "riscv64"))
    monkeypatch.setattr(os, "uname", lambda: strange)
    assert not confinement.refuse_calls(program=False)


def test_what_is_printed_is_read_from_a_file_without_a_name(tmp_path: Path) -> None:
    file, secret = tmp_path / "answer.py", tmp_path / "secret.txt"
    secret.write_text("truth")
    file.write_text(f"""
import os
def f():
    print('mine')
    before = sorted(os.listdir('.'))
    for name in ('printed.txt', 'stderr', 'stdout'):
        try:
            os.symlink({str(secret)!r}, name)
        except OSError:
            pass
    return {{'here': before}}
""")
    with answering(file, function("f")) as process:
        assert process.call("function", {}) == {"here": ["answer.py"]}
        assert process.last_printed() == ["mine"]


@pytest.mark.short("open(f'{n}.txt'*")
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("open(f'{n}.txt', 'w').write('x')", "it writes more than 32 files of 4 MB together"),
        ("open(f'{n % 20}.txt', 'a').write('x' * 1000 * (n < 5000))", "32 files of 4 MB together"),
    ],
)
def test_an_answer_that_fills_its_folder_is_stopped(tmp_path: Path, line: str, said: str) -> None:
    file = tmp_path / "answer.py"
    text = f"def f():\n    for n in range(10**9):\n        {line}\n"
    file.write_text(text)
    with answering(file, function("f")) as process, pytest.raises(LawError) as caught:
        process.call("function", {})
    assert said in str(caught.value)


@pytest.mark.short("while*")
@pytest.mark.parametrize("line", ["while True: pass", "__import__('time').sleep(60)"])
def test_a_loop_at_import_is_named_as_one(tmp_path: Path, line: str) -> None:
    file, limits = tmp_path / "answer.py", AnswerLimits(loading_s=0.3)
    file.write_text(f"{line}\n")
    with pytest.raises(LawError) as caught, answering(file, function("f", 0.3), limits):
        pass
    words = "it took longer than 0.3 s to be loaded: a loop outside of its functions?"
    assert str(caught.value) == f"answer.py: {words}"


def test_an_answer_cannot_command_a_terminal(tmp_path: Path) -> None:
    file = tmp_path / "answer.py"
    file.write_text(
        "def f():\n    print('\\x1b]0;title\\x07')\n    raise ValueError('\\x1b[31mred\\u202e')\n"
    )
    with answering(file, function("f")) as process:
        with pytest.raises(LawError) as caught:
            process.call("function", {})
        assert process.last_printed() == ["\\x1b]0;title\\x07"]
    assert str(caught.value) == "answer.py, line 3: ValueError: \\x1b[31mred\\u202e"
