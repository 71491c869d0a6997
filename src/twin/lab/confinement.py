"""Rights that a process of an answer gives up before it reads a line of the answer, for good.

Three walls of Linux. A different user than root, where root grades. Landlock: which files may be
read, on newer kernels no connection by TCP and no signals to others. A filter of system calls
(seccomp): what Landlock leaves open, as sockets of any kind, memory and keys that outlive a
process, other processes, modes and times of files. Where the system lacks one, the others remain.
"""

from __future__ import annotations

import ctypes
import errno
import os
import pwd
import stat
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

PR_SET_KEEPCAPS, PR_SET_NO_NEW_PRIVS = 8, 38
"""Options of prctl (linux/prctl.h)."""
CAPABILITY_VERSION_3 = 0x20080522
"""Version in the header of capset (linux/capability.h)."""
CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 1 << 1, 1 << 2
"""Capabilities, as bits: to write and to read files of other users. In a container root may have
the first alone."""
UNPRIVILEGED_USER = "nobody"
"""User without rights on any Linux."""

SYS_LANDLOCK_CREATE_RULESET, SYS_LANDLOCK_ADD_RULE, SYS_LANDLOCK_RESTRICT_SELF = 444, 445, 446
"""System calls; the same numbers on every machine (asm-generic/unistd.h)."""
LANDLOCK_CREATE_RULESET_VERSION = 1 << 0
"""Flag of ``SYS_LANDLOCK_CREATE_RULESET``: return the version, create nothing."""
LANDLOCK_RULE_PATH_BENEATH = 1
"""Kind of a rule: rights for a file, or for all below a folder."""
LANDLOCK_ACCESS_FS = {
    name: 1 << bit
    for bit, name in enumerate(
        (
            *("EXECUTE", "WRITE_FILE", "READ_FILE", "READ_DIR", "REMOVE_DIR", "REMOVE_FILE"),
            *("MAKE_CHAR", "MAKE_DIR", "MAKE_REG", "MAKE_SOCK", "MAKE_FIFO", "MAKE_BLOCK"),
            *("MAKE_SYM", "REFER", "TRUNCATE"),
        )
    )
}
"""Rights of Landlock (linux/landlock.h); the last two came with its versions 2 and 3."""
LANDLOCK_RIGHTS_OF_VERSION = {
    1: len(LANDLOCK_ACCESS_FS) - 2,
    2: len(LANDLOCK_ACCESS_FS) - 1,
}
"""Number of these rights that an old version knows; a newer one knows all."""
LANDLOCK_ACCESS_NET_TCP = 1 << 0 | 1 << 1
"""Rights to bind and to connect."""
LANDLOCK_NET_VERSION = 4
"""First version with rights of the network."""
LANDLOCK_SCOPE = 1 << 0 | 1 << 1
"""Scopes of abstract Unix sockets and of signals."""
LANDLOCK_SCOPE_VERSION = 6
"""First version with scopes."""
TO_READ = ("EXECUTE", "READ_FILE", "READ_DIR")
"""Rights in the places that an answer needs."""
TO_OWN = (*TO_READ, "WRITE_FILE", "REMOVE_FILE", "MAKE_REG", "TRUNCATE")
"""Rights in its own folder: files, and neither folders nor links, pipes or sockets."""
NO_FLAGS = 0
"""Flags of a system call without any."""

AUDIT_ARCH = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
"""Machines with system calls that are known here (linux/audit.h)."""
REFUSED_CALLS: dict[str, tuple[int | None, int | None]] = {
    # sockets: also those by datagram, by a path, and between others
    "socket": (41, 198),
    "socketpair": (53, 199),
    "connect": (42, 203),
    "bind": (49, 200),
    # calls handed to the kernel past this filter
    "io_uring_setup": (425, 425),
    "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427),
    # memory, semaphores and queues of System V, queues of POSIX, keys: they outlive a process
    "shmget": (29, 194),
    "shmat": (30, 196),
    "shmctl": (31, 195),
    "semget": (64, 190),
    "semop": (65, 193),
    "semctl": (66, 191),
    "semtimedop": (220, 192),
    "msgget": (68, 186),
    "msgsnd": (69, 189),
    "msgrcv": (70, 188),
    "msgctl": (71, 187),
    "mq_open": (240, 180),
    "mq_unlink": (241, 181),
    "add_key": (248, 217),
    "request_key": (249, 218),
    "keyctl": (250, 219),
    # namespaces, mounts, a new root
    "unshare": (272, 97),
    "setns": (308, 268),
    "mount": (165, 40),
    "umount2": (166, 39),
    "pivot_root": (155, 41),
    "chroot": (161, 51),
    "open_tree": (428, 428),
    "move_mount": (429, 429),
    "fsopen": (430, 430),
    "fsconfig": (431, 431),
    "fsmount": (432, 432),
    "fspick": (433, 433),
    "mount_setattr": (442, 442),
    # new processes; threads are by clone, below
    "fork": (57, None),
    "vfork": (58, None),
    "execveat": (322, 281),
    # a session or group of its own, in which the grader would not end it
    "setsid": (112, 157),
    "setpgid": (109, 154),
    # other processes of the same user: their memory, files, pace and end
    "ptrace": (101, 117),
    "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271),
    "process_madvise": (440, 440),
    "process_mrelease": (448, 448),
    "pidfd_getfd": (438, 438),
    "pidfd_send_signal": (424, 424),
    "kcmp": (312, 272),
    "rt_sigqueueinfo": (129, 138),
    "rt_tgsigqueueinfo": (297, 240),
    "setpriority": (141, 140),
    "ioprio_set": (251, 30),
    "sched_setscheduler": (144, 119),
    "sched_setparam": (142, 118),
    "sched_setattr": (314, 274),
    "migrate_pages": (256, 238),
    "move_pages": (279, 239),
    # files by other ways than their path; modes, owners, times and notes of any file of this user
    "name_to_handle_at": (303, 264),
    "open_by_handle_at": (304, 265),
    "chmod": (90, None),
    "fchmod": (91, 52),
    "fchmodat": (268, 53),
    "fchmodat2": (452, 452),
    "chown": (92, None),
    "lchown": (94, None),
    "fchown": (93, 55),
    "fchownat": (260, 54),
    "utime": (132, None),
    "utimes": (235, None),
    "futimesat": (261, None),
    "utimensat": (280, 88),
    "setxattr": (188, 5),
    "lsetxattr": (189, 6),
    "fsetxattr": (190, 7),
    "removexattr": (197, 14),
    "lremovexattr": (198, 15),
    "fremovexattr": (199, 16),
    "inotify_init": (253, None),
    "inotify_init1": (294, 26),
    "fanotify_init": (300, 262),
    # the kernel's own machinery
    "bpf": (321, 280),
    "perf_event_open": (298, 241),
    "userfaultfd": (323, 282),
    "personality": (135, 92),
}
"""System calls that fail with EPERM: their numbers on x86_64 and on aarch64; None where there is no
such call (asm/unistd_64.h, asm-generic/unistd.h)."""
EXECVE_NUMBERS = (59, 221)
"""Refused, too, unless the answer is a program, which is started by it."""
CLONE, CLONE3 = (56, 220), (435, 435)
OWN_PROCESS_ONLY = {"kill": (62, 129), "tkill": (200, 130), "tgkill": (234, 131)}
"""System calls with this process as the only allowed first argument."""
OWN_OR_ZERO = {"prlimit64": (302, 261), "sched_setaffinity": (203, 122)}
"""System calls with this process, or 0 for it, as the only allowed first argument."""
FCNTL, F_SETOWN, F_SETOWN_EX = (72, 25), 8, 15
"""Call and commands that choose the process to which signals of a file are sent."""
FIRST_UNKNOWN_CALL = 457
"""System calls from here on are younger than this list, and fail as on a kernel without them."""
CLONE_THREAD = 0x00010000
CLONE_NEW_NAMESPACES = 0x7E020000
"""CLONE_NEWNS, NEWCGROUP, NEWUTS, NEWIPC, NEWUSER, NEWPID, NEWNET (linux/sched.h)."""

SYS_SECCOMP = {"x86_64": 317, "aarch64": 277}
SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC = 1, 1
SECCOMP_RET_ALLOW, SECCOMP_RET_ERRNO = 0x7FFF0000, 0x00050000
"""Answers of a filter (linux/seccomp.h); an error has its number in the lower bits."""
BPF_LOAD_WORD, BPF_RETURN = 0x20, 0x06
BPF_JUMP_EQUAL, BPF_JUMP_GREATER_EQUAL, BPF_JUMP_ANY_BIT = 0x15, 0x35, 0x45
"""Instructions of classic BPF (linux/bpf_common.h)."""
AT_NUMBER, AT_ARCH, AT_ARGUMENTS = 0, 4, 16
"""Places in struct seccomp_data, bytes. An argument has 8, the lower half first on both."""


def be_nobody(places: Sequence[str]) -> None:
    """Where root grades, on Linux: become a user who owns nothing but this process's own folder.

    No capability of root is left, or the one to read, where one of the places that it needs is in a
    folder that is closed to others; Landlock narrows it.

    Args:
        places: Paths that it needs to read.
    """
    if sys.platform != "linux" or os.geteuid():
        return
    folders = {folder for each in places for folder in Path(each).resolve().parents}
    closed = any(not folder.stat().st_mode & stat.S_IXOTH for folder in folders)
    libc = ctypes.CDLL(None)
    with suppress(KeyError, OSError):  # no such user, or root may not change: as before
        nobody = pwd.getpwnam(UNPRIVILEGED_USER)
        os.chown(".", nobody.pw_uid, nobody.pw_gid)
        libc.prctl(PR_SET_KEEPCAPS, 1, 0, 0, 0)  # the permitted ones, until capset chooses
        os.setgroups([])
        os.setgid(nobody.pw_gid)
        os.setuid(nobody.pw_uid)
        this_process = 0
        header = struct.pack("Ii", CAPABILITY_VERSION_3, this_process)
        none = 0
        for left in (CAP_DAC_READ_SEARCH, CAP_DAC_OVERRIDE, none) if closed else (none,):
            # effective, permitted, inheritable; first the lower 32 capabilities, then the others
            data = struct.pack("6I", left, left, none, none, none, none)
            if libc.capset(header, data) == 0:
                break


def shut_in(places: Sequence[str]) -> bool:
    """Let this process read these places, write files in its own folder, and no more.

    Args:
        places: Paths that it needs to read.

    Returns:
        Whether the system can do it: Linux of 2021 or later.
    """
    if sys.platform != "linux":
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    version = libc.syscall(
        SYS_LANDLOCK_CREATE_RULESET, None, ctypes.c_size_t(0), LANDLOCK_CREATE_RULESET_VERSION
    )
    if version < 1:
        return False
    known = LANDLOCK_RIGHTS_OF_VERSION.get(version, len(LANDLOCK_ACCESS_FS))
    every = (1 << known) - 1
    # a system that knows fewer rights accepts zeros for those of later versions
    net = LANDLOCK_ACCESS_NET_TCP if version >= LANDLOCK_NET_VERSION else 0
    scope = LANDLOCK_SCOPE if version >= LANDLOCK_SCOPE_VERSION else 0
    rules = struct.pack("<QQQ", every, net, scope)
    ruleset = libc.syscall(
        SYS_LANDLOCK_CREATE_RULESET, rules, ctypes.c_size_t(len(rules)), NO_FLAGS
    )
    to_read, to_own = (sum(LANDLOCK_ACCESS_FS[name] for name in each) for each in (TO_READ, TO_OWN))
    of_file = to_read & ~LANDLOCK_ACCESS_FS["READ_DIR"]
    for path, rights in {**dict.fromkeys(places, to_read), ".": to_own & every}.items():
        with suppress(OSError):
            place = os.open(path, os.O_PATH)
            given = rights if Path(path).is_dir() else of_file
            rule = struct.pack("<Qi", given, place)
            kind = LANDLOCK_RULE_PATH_BENEATH
            libc.syscall(SYS_LANDLOCK_ADD_RULE, ruleset, kind, rule, NO_FLAGS)
            os.close(place)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)  # required by the next call
    return bool(libc.syscall(SYS_LANDLOCK_RESTRICT_SELF, ruleset, NO_FLAGS) == 0)


def refuse_calls(*, program: bool) -> bool:
    """Have the system refuse calls that an answer does not need, in this process and its threads.

    Args:
        program: Whether this process is about to start a program that is not Python.

    Returns:
        Whether the system can do it: Linux with seccomp, on x86_64 or aarch64.
    """
    machine = os.uname().machine
    if sys.platform != "linux" or machine not in AUDIT_ARCH or sys.maxsize < 1 << 32:
        return False
    steps = b"".join(struct.pack("HBBI", *step) for step in filter_of(machine, program=program))
    kept = ctypes.create_string_buffer(steps, len(steps))
    whole = struct.pack("HxxxxxxQ", len(steps) // 8, ctypes.addressof(kept))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    how = (SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC)
    return bool(libc.syscall(SYS_SECCOMP[machine], *how, whole) == 0)


Step = tuple[int, int, int, int]
"""An instruction of classic BPF: code, steps to jump if true, steps if false, operand."""


def filter_of(machine: str, *, program: bool) -> Iterator[Step]:
    """The filter of system calls, in classic BPF.

    Args:
        machine: As of ``uname``.
        program: Whether a program is to be started.
    """
    at = [*AUDIT_ARCH].index(machine)
    refuse: Step = (BPF_RETURN, 0, 0, SECCOMP_RET_ERRNO | errno.EPERM)
    unknown: Step = (BPF_RETURN, 0, 0, SECCOMP_RET_ERRNO | errno.ENOSYS)
    allow: Step = (BPF_RETURN, 0, 0, SECCOMP_RET_ALLOW)

    def argument(number: int) -> Step:
        return (BPF_LOAD_WORD, 0, 0, AT_ARGUMENTS + 8 * number)

    def where(call: int, *steps: Step) -> Iterator[Step]:
        """Steps that end with an answer, for one call alone."""
        yield (BPF_JUMP_EQUAL, 0, len(steps), call)
        yield from steps

    yield (BPF_LOAD_WORD, 0, 0, AT_ARCH)
    yield (BPF_JUMP_EQUAL, 1, 0, AUDIT_ARCH[machine])
    yield refuse  # calls of a different machine, as those of 32 bit
    yield (BPF_LOAD_WORD, 0, 0, AT_NUMBER)
    yield (BPF_JUMP_GREATER_EQUAL, 0, 1, FIRST_UNKNOWN_CALL)  # those of x32 among them
    yield unknown
    yield from where(CLONE3[at], unknown)  # its flags cannot be read: clone is used instead
    threads_alone = (
        argument(0),
        (BPF_JUMP_ANY_BIT, 2, 0, CLONE_NEW_NAMESPACES),
        (BPF_JUMP_ANY_BIT, 0, 1, CLONE_THREAD),
        allow,
        refuse,
    )
    yield from where(CLONE[at], *threads_alone)
    me = os.getpid()
    for own in OWN_PROCESS_ONLY.values():
        yield from where(own[at], argument(0), (BPF_JUMP_EQUAL, 0, 1, me), allow, refuse)
    for own in OWN_OR_ZERO.values():
        zero = (BPF_JUMP_EQUAL, 1, 0, 0)
        yield from where(own[at], argument(0), zero, (BPF_JUMP_EQUAL, 0, 1, me), allow, refuse)
    owners = ((BPF_JUMP_EQUAL, 2, 0, F_SETOWN), (BPF_JUMP_EQUAL, 1, 0, F_SETOWN_EX))
    yield from where(FCNTL[at], argument(1), *owners, allow, refuse)
    for number in (
        each[at] for each in (*REFUSED_CALLS.values(), *([] if program else [EXECVE_NUMBERS]))
    ):
        if number is not None:
            yield from where(number, refuse)
    yield allow
