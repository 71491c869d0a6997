"""The commands doctor, emulate, safety, trace and play: a rig, real or virtual."""

from __future__ import annotations

import csv
import io
import sys
import threading
import webbrowser
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ballplate.rig_access import EMULATED_RIG, rig_of
from twin.base.errors import LogError, RigError, ScenarioError, plural
from twin.base.jobs import cores
from twin.base.page import Table
from twin.base.writing import check_writable, write_whole
from twin.cli import options
from twin.cli.output import (
    TERMINAL,
    Shown,
    console,
    dim,
    json_wanted,
    progress,
    say,
    show,
    warn,
)
from twin.cli.trace_report import node_tables, verdict_lines
from twin.devices.akd import TRACE_FILE
from twin.doctor.check import CheckStatus, next_step
from twin.emulator.screen import Protocol
from twin.run.exporters import export
from twin.run.files import run_folder

if TYPE_CHECKING:
    from twin.devices.akd.config import AkdConfig
    from twin.devices.akd.object_names import Names
    from twin.devices.akd.traces import Trace
    from twin.doctor.check import Ask, CheckResult
    from twin.emulator.bus_name import BusName
    from twin.emulator.virtual_bus import VirtualBus
    from twin.safety.fault_row import FaultRow
    from twin.scenario import Scenario
    from twin.scenario.rig import RigFile


STATUS_COLOURS = {
    CheckStatus.PASS: "green",
    CheckStatus.WARN: "yellow",
    CheckStatus.FAIL: "bold red",
}


@options.command(example="doctor --rig emulated")
@options.EMPTY_RIG
@click.option(
    "--scenario",
    default="circle",
    callback=options.check_scenario_name,
    help="Scenario that the rig is to run [circle].",
)
@click.option("--move", is_flag=True, help="Enable the drives and tilt the plate by a degree.")
@click.option("--ball", is_flag=True, help="With --move: see by the ball how each axis tilts.")
@click.option("--reset", is_flag=True, help="Reset faults found in the drives.")
@click.option("--udev", is_flag=True, help="Only print the udev rules for a touch panel on USB.")
@options.SETTING
@options.JSON_OPTION
def doctor(
    rig: str,
    scenario: str,
    overrides: tuple[str, ...],
    *,
    move: bool,
    ball: bool,
    reset: bool,
    udev: bool,
) -> int:
    """Check everything that a rig needs before its bring-up, and state what to do.

    With --move --ball the ball lies at rest in the middle: each axis is tilted, by up to 4 deg,
    until the ball rolls 8 mm, and is tilted back to brake it.
    """
    if ball and not move:
        raise RigError("--ball: tilts the plate until the ball rolls; it needs --move")
    if udev:
        from twin.devices.lumio.config import UDEV_RULES

        click.echo(UDEV_RULES.read_text(encoding="utf-8"), nl=False)
        return 0
    from twin.doctor.examine import examine
    from twin.scenario import load
    from twin.scenario.passed import note_result

    chosen = load(scenario, overrides)
    with rig_file(rig, chosen) as (file, ask):
        found = _print_results(examine(chosen, file, ask, move=move, reset=reset, ball=ball))
        if move and rig != EMULATED_RIG:
            failed = any(each.status is CheckStatus.FAIL for each in found)
            note_result(file, passed=not failed)
    counts = {status: sum(each.status is status for each in found) for status in CheckStatus}
    counted = ", ".join(f"{count} {status}" for status, count in counts.items())
    on = click.get_current_context().meta.get("on")
    shown = (counted, next_step(found, f"{rig} --on {on}" if on else rig, move=move))
    show([each.as_dict() for each in found], shown)
    return 1 if counts[CheckStatus.FAIL] else 0


def _print_results(results: Iterable[CheckResult]) -> list[CheckResult]:
    """All results, each printed when it comes unless JSON is wanted."""
    found = []
    for result in results:
        found.append(result)
        if not json_wanted():
            colour = STATUS_COLOURS[result.status]
            console.print(f"[{colour}]{result.status}[/{colour}]  {result.what}: ", end="")
            advice = f" -> {result.advice}" if result.advice else ""
            say(f"{result.seen}{advice}")
    return found


@contextmanager
def rig_file(name: str, scenario: Scenario) -> Iterator[tuple[RigFile, Ask]]:
    """The rig file, and who puts and lifts the ball."""
    with rig_of(name, scenario, TERMINAL) as (file, virtual):
        yield file, _ask if virtual is None else virtual.tell


def _ask(word: str) -> None:
    click.echo(f"please {request(word)} now", err=True)


def request(word: str) -> str:
    """Instruction to a person, in words."""
    match word.split():
        case ["touch", x, y]:
            return f"touch the plate at x {float(x):+g}, y {float(y):+g} mm and hold"
        case ["put"]:
            return "put the ball on the plate"
    return "lift the ball or the finger off"


@options.command(example="emulate circle --write rig.toml")
@options.SCENARIO(default="circle")
@options.SETTING
@click.option(
    "--drive",
    "kind",
    type=click.Choice(["akd", "cia402"]),
    help="Drives: AKD, or plain drives of CiA 402 with an EDS of their own [akd].",
)
@click.option(
    "--mechanism",
    type=click.Choice(["plate", "inertia"]),
    default="plate",
    help="Load of the drives: the scenario's plate, or an inertia with friction each [plate].",
)
@click.option(
    "--bus",
    default="slcan",
    metavar="NAME",
    help="Bus they are on: an slcan adapter on a pty, or a bus of python-can as vcan0, "
    "udp_multicast, slcan:/dev/ttyACM0 [slcan].",
)
@click.option(
    "--node",
    "nodes",
    type=click.IntRange(1, 127),
    multiple=True,
    help="CANopen node of a drive, once for each drive [1 and 2; with an inertia 1].",
)
@click.option("--control", type=options.PATH_TYPE, help="Unix socket that accepts such lines.")
@click.option(
    "--eds",
    type=options.WRITABLE_FILE,
    help="Only write the EDS of the cia402 drives there.",
)
@click.option(
    "--protocol",
    type=click.Choice([str(protocol) for protocol in Protocol]),
    default=str(Protocol.MICROTOUCH),
    help="Protocol of the touch screen [microtouch].",
)
@click.option(
    "--write",
    "file",
    type=options.WRITABLE_FILE,
    help="Where to write the rig file of AKD drives [emulated.toml].",
)
def emulate(
    scenario: str,
    overrides: tuple[str, ...],
    kind: str | None,
    mechanism: str,
    bus: str,
    nodes: tuple[int, ...],
    control: Path | None,
    eds: Path | None,
    protocol: str,
    file: Path | None,
) -> int:
    """Serve emulated drives on a CAN bus and, with a plate, its touch screen on a pty.

    The drives are two AKD on a USB-CAN adapter, also on a pty, unless an option changes it.

    It simulates what they turn in real time. Typed lines, or lines sent to the socket of
    --control, act on it: sto and release for the STO button, lift and put for the ball, touch X
    Y (mm) for a finger, unplug and plug for the screen, lag for how far it is behind the clock;
    faults of drives and frames: an unknown word lists them. Ctrl-C ends it.
    """
    if eds is not None:
        if kind == "akd":
            raise RigError("--eds: needs --drive cia402; the EDS of an AKD comes from its maker")
        from twin.emulator.profile_eds import eds_text

        write_whole(eds, eds_text())
        say(f"written to {eds}")
        return 0
    from contextlib import ExitStack

    from twin.emulator.bus_name import PSEUDO_TERMINAL, parse_bus

    name = None if bus == PSEUDO_TERMINAL else parse_bus(bus)
    from twin.emulator.control import control_socket
    from twin.emulator.serve import VirtualRig, come_forward

    kind = kind or "akd"
    own_host = kind == "akd" and (name is None or name.interface != "udp_multicast")
    if file is not None and not own_host:
        raise RigError("--write: a rig file is for AKD drives only, and not for udp_multicast")
    served = _virtual_bus(scenario, overrides, kind, mechanism, name, nodes, protocol)
    with ExitStack() as opened:
        rig = opened.enter_context(served)
        if control is not None:
            opened.enter_context(control_socket(control, rig.control))
        if isinstance(rig, VirtualRig) and own_host:
            text, file = rig.rig_file(), file or Path("emulated.toml")
            write_whole(file, text)
            console.print(text, markup=False)
            say(f"written to {file}; use it with: ballplate run circle --rig {file}")
        else:
            listed = ", ".join(str(drive.node) for drive in rig.drives)
            hint = "; their EDS: --eds FILE" if kind == "cia402" else ""
            say(f"{kind} drives, node {listed}, on {rig.place}{hint}")
            if isinstance(rig, VirtualRig):
                say(f"touch screen ({protocol}) on {rig.screen.path}")
        come_forward()
        threading.Thread(target=_listen, args=(rig,), daemon=True).start()
        try:
            rig.server.run()
        except KeyboardInterrupt:
            console.print("ended")
    return 0


def _virtual_bus(
    scenario: str,
    overrides: tuple[str, ...],
    kind: str,
    mechanism: str,
    bus: BusName | None,
    nodes: tuple[int, ...],
    protocol: str,
) -> VirtualBus:
    """The devices that `emulate` serves, by its options.

    Raises:
        RigError: Options that do not go together, or a bus that cannot be opened.
    """
    from twin.emulator.load import InertiaLoad, ShaftLoad
    from twin.emulator.profile_drive import ProfileDrive
    from twin.emulator.virtual_bus import VirtualBus

    if len(set(nodes)) < len(nodes):
        raise RigError("--node: each drive needs a different node")
    if mechanism == "inertia":
        if kind == "akd":
            raise RigError("--mechanism inertia: needs --drive cia402; AKD drives turn the plate")
        if overrides:
            raise RigError("--set: changes the scenario of a plate; --mechanism inertia has none")
        return VirtualBus([ProfileDrive(node, InertiaLoad()) for node in nodes or (1,)], bus)
    from twin.emulator.drive import EmulatedDrive
    from twin.emulator.serve import VirtualRig
    from twin.scenario import load

    nodes = nodes or (1, 2)
    if len(nodes) != 2:
        raise RigError("--node: a plate has two drives, of phi and theta; name two nodes")
    drives: list[EmulatedDrive | ProfileDrive[ShaftLoad]] = [
        EmulatedDrive(node) if kind == "akd" else ProfileDrive(node, ShaftLoad()) for node in nodes
    ]
    return VirtualRig(load(scenario, overrides), Protocol(protocol), drives, bus)


def _listen(rig: VirtualBus) -> None:
    for line in sys.stdin:
        if line.strip():
            console.print(rig.obey(line.strip()), markup=False)


@options.command(example="safety --only heartbeat")
@click.option("--list", "only_list", is_flag=True, help="List the faults and run none.")
@click.option(
    "--only",
    "words",
    multiple=True,
    metavar="WORDS",
    help="Inject only faults with these words in name or condition; repeatable.",
)
@click.option(
    "--out",
    type=options.WRITABLE_FILE,
    help="Also write a failure mode sheet, .csv.",
)
@options.PROCESSES_OPTION
@options.JSON_OPTION
def safety(
    words: tuple[str, ...], out: Path | None, processes: int | None, *, only_list: bool
) -> int:
    """Inject faults into a rig on emulated devices, and evaluate detection and reaction."""
    from twin.emulator.fault_lines import MATRIX_ROWS
    from twin.safety.faults import CASES, choose_cases

    cases = choose_cases(words)
    if out is not None and only_list:
        raise ScenarioError("--out: not allowed with --list, which injects no fault")
    if only_list:
        named = {row: name for name, row in MATRIX_ROWS.items()}
        listed = [
            {
                "name": each.name,
                "condition": each.expected.name if each.expected else "",
                "fault": named.get(each.name, ""),
            }
            for each in (CASES[index] for index in cases)
        ]
        heads = ("fault", "condition reported", "run --fault 'SECONDS ...'")
        shown_rows = [(each["name"], each["condition"] or "none", each["fault"]) for each in listed]
        show(listed, (Table("", heads, shown_rows, words=(0, 1, 2)),))
        return 0
    from twin.safety.fault_row import failure_sheet
    from twin.safety.trial import run_all

    with progress("fault matrix", len(cases)) as advance:
        rows = run_all(processes or cores(), advance, cases)
    if out is not None:
        headings, lines = failure_sheet(rows)
        _write_sheet(out, [headings, *lines])
    good = sum(row.good for row in rows)
    shown = [
        _table(rows),
        f"{good} of {plural(len(rows), 'fault')} detected in time, safe, and recovered",
        *((f"written to {out}",) if out is not None else ()),
    ]
    show([row.as_dict() for row in rows], shown)
    return int(good < len(rows))


def _write_sheet(out: Path, rows: Iterable[Iterable[object]]) -> None:
    """Write rows of cells into a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_whole(out, text.getvalue())


def _table(rows: list[FaultRow]) -> Table:
    from twin.safety.fault_row import FAULT_HEADINGS, cells

    lines = [
        (*cells(row), "good" if row.good else f"BAD: {', '.join(row.failures)}") for row in rows
    ]
    return Table("", (*FAULT_HEADINGS, "verdict"), lines, words=range(len(FAULT_HEADINGS) + 1))


@options.command(example="trace runs/circle-rig=emulated", reads=True)
@click.argument("file", type=options.PATH_TYPE)
@click.option(
    "--rig", type=options.PATH_TYPE, help="Rig file: names, scales and mapping of its drives."
)
@click.option(
    "--eds", type=options.PATH_TYPE, help="EDS file of the drives: what objects are called."
)
@click.option("--channel", help="Channel of the trace [the one with most frames].")
@click.option(
    "--bitrate", type=click.IntRange(10_000, 1_000_000), help="Bit/s, for its load [from --rig]."
)
@click.option(
    "--replay", "again", is_flag=True, help="Send the host's frames to emulated drives and compare."
)
@click.option(
    "--out",
    type=options.WRITABLE_FILE,
    help="Also write the events there, a CSV file.",
)
@click.option("--all", "everything", is_flag=True, help="Also what nodes sent, values and events.")
@click.option(
    "--check",
    is_flag=True,
    help="Exit with 1 if a problem is unresolved at the end, or no node is heard.",
)
@click.option("--touch", type=options.PATH_TYPE, help="The data of the touch screen, a CSV file.")
@click.option(
    "--log",
    type=options.WRITABLE_FILE,
    help="With --rig and --touch: write a log there, .csv.",
)
@options.JSON_OPTION
def trace(
    file: Path,
    rig: Path | None,
    eds: Path | None,
    channel: str | None,
    bitrate: int | None,
    out: Path | None,
    touch: Path | None,
    log: Path | None,
    *,
    again: bool,
    everything: bool,
    check: bool,
) -> int:
    """State what went wrong on a CAN bus, from a trace of it: what happened, and each problem.

    FILE is a trace of any program (candump, .asc, .blf, .trc, .csv, .pcap, also .gz), or the folder
    of a run on the wire. --all also decodes what the drives and their host sent; of PDOs only
    changes are reported. --log makes a log of it, which compare, identify and shadow take:
    encoders, motors and commands, whoever drove.
    --replay sends the host's frames to emulated drives, and reports different answers.
    """
    from twin.devices.akd.conversation_summary import list_remarks, summarise
    from twin.devices.akd.decoding import Conversation, TracedEvent
    from twin.devices.akd.findings import assess
    from twin.devices.akd.object_names import Names
    from twin.devices.akd.rhythms import sync_period
    from twin.devices.akd.traces import read_trace

    if log is not None and (rig is None or touch is None):
        raise LogError("--log: needs --rig (scales) and --touch (the ball's positions)")
    place = file / TRACE_FILE if file.is_dir() else file
    found = read_trace(place, channel)
    if again and check:
        raise LogError("--check: not allowed with --replay, which sets the exit code")
    if not found.timed and (again or log):
        raise LogError(f"{'--replay' if again else '--log'}: {file} has no times")
    if place.name == TRACE_FILE:
        from twin.run.opened import incomplete_of

        found.remarks[:0] = incomplete_of(place.parent)
    if rig:
        from twin.scenario.rig import read_rig
    own = read_rig(rig) if rig else None
    drives = own.servos(sync_period(found.frames)) if own else None
    names = Names(eds)
    if again:
        return _replay(file, found, names, drives)
    conversation = Conversation(found.frames, names, drives, timed=found.timed)
    summary = {
        "trace": str(file),
        "channel": found.channel,
        "frames": len(found.frames),
        "timed": found.timed,
    }
    remarks = [*found.remarks, *names.sheet.remarks, *list_remarks(conversation)]
    conversation.bitrate = bitrate or conversation.bitrate
    verdict = assess(conversation, found.remarks)
    summary |= verdict.as_dict() | summarise(conversation) | {"remarks": remarks}
    events = [event._asdict() for event in conversation.events]
    written = [each for each in (out, log) if each is not None]
    if log and own and drives and touch:
        import numpy as np

        from twin.run.connect import TRACE_UNITS, cams_of, log_of_trace

        home = np.radians(own.home_deg)
        export(log, log_of_trace(conversation, drives, cams_of(own), home, touch), TRACE_UNITS)
    rows = [(f"{each.time:.{6 * found.timed}f}", *each[1:4]) for each in conversation.events]
    when = "time [s]" if found.timed else "frame"
    span = f" in {conversation.duration:.3f} s" if found.timed else ", without times"
    if out is not None:
        _write_sheet(out, [(when, *TracedEvent._fields[1:4]), *rows])
    heading = f"{file}: {plural(len(found.frames), 'frame')} on {found.channel}{span}"
    shown: list[Shown] = [*verdict_lines(verdict, heading, timed=found.timed), *remarks]
    if everything:
        shown += node_tables(summary)
        shown.append(Table("", (when, "who", "kind", "what"), rows, words=(1, 2, 3)))
    else:
        shown.append(dim("more: --all for what each node sent, values and events"))
    show({**summary, "events": events}, (*shown, *(f"written to {each}" for each in written)))
    return int(check and not verdict.good)


def _replay(file: Path, trace: Trace, names: Names, drives: AkdConfig | None) -> int:
    """Show where the answers of emulated drives differ from those of a trace."""
    from twin.doctor.replay import REPLAY_TOLERANCES, replay

    found = replay(trace.frames, names, drives)
    first, allowed = found.difference, REPLAY_TOLERANCES
    compared_text = (
        f"{file}: {plural(found.sent, 'frame')} of the host sent to emulated drives, "
        f"{plural(found.compared, 'frame')} "
        "of drives compared: states, transfers, emergencies, number of PDOs; "
        f"within {1e3 * allowed.time_s:g} ms and {allowed.pdos} PDOs, motors within "
        f"{allowed.position_rad:g} rad and {allowed.speed_rad_s:g} rad/s; "
        "not the plate, which they do not have"
    )
    same = "the emulated drives answer the same"
    shown = f"first difference, at {first.time:.6f} s, {first.who}: {first.text}" if first else same
    remarks = [*trace.remarks, *names.sheet.remarks, *found.remarks]
    numbers = {"trace": str(file), **found._asdict(), "remarks": remarks}
    show(numbers | {"difference": first and first._asdict()}, (compared_text, *remarks, shown))
    return int(first is not None)


DEFAULT_PORT = 8090
"""Port of the page of play."""


@options.command(example="play circle")
@options.SCENARIO(default="hold")
@options.LAW_OPTION
@options.SETTING
@options.PLANT_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Run folder [runs/play-SCENARIO].")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=DEFAULT_PORT,
    show_default=True,
    help="Port of the page; 0 for a free one.",
)
@click.option(
    "--address",
    default="127.0.0.1",
    show_default=True,
    help="Serve there; by default on this machine alone. The page is behind a token.",
)
@click.option("--no-browser", is_flag=True, help="Open no window; print the address only.")
@click.option("--seconds", type=options.Finite(min=0), help="End by itself after this time, s.")
def play(
    scenario: str, overrides: tuple[str, ...], out: Path | None, *, no_browser: bool, **how: Any
) -> int:
    """Drive the rig yourself, in real time, in a browser window.

    Drag the goal, push the ball, move friction, dead time, level and gains by sliders, choose
    a different law or observer, pause, go back; the clean model runs along. A saved run is a run
    folder like any other. It ends with Ctrl-C, or when the page is closed; what was driven and not
    saved is saved then.
    """
    from twin.play.serve import Server, is_loopback, library
    from twin.scenario import load

    library()
    chosen = load(scenario, overrides)
    folder = check_writable(out or run_folder(f"play-{Path(scenario).stem}"))
    server = Server(chosen, folder, warn=warn, **how)
    if not is_loopback(where := how["address"]):
        warn(
            f"the page can be reached from other machines, by anyone who has this address: {where}"
        )

    def begun() -> None:
        say(f"open {server.url} in a browser; Ctrl-C ends it")
        if not no_browser:
            webbrowser.open(server.url)

    server.run(begun)
    if server.failure is not None or server.lost:
        lost = "what was driven since it was last saved is lost"
        problem = f"{server.failure}; {lost}" if server.failure else server.kept
        click.echo(f"ballplate: {problem}", err=True)
        return 1
    if server.kept:
        say(f"ended without saving, so {server.kept}")
    return 0
