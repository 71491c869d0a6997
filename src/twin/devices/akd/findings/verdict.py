"""The verdict on a trace: all findings, the worst first, and what happened in one line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from twin.base.errors import plural
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings import bus, drives, network, pdos, states, transfers
from twin.devices.akd.findings.finding import Finding, Severity, count_words
from twin.devices.akd.observed import BUS, Rhythm, StreamKey

Find = Callable[[Conversation, Sequence[Finding]], Iterator[Finding]]
"""Finds one family of problems; is given those that were found before, which may explain them."""
FINDERS: tuple[Find, ...] = (
    bus.find_error_frames,
    bus.find_high_load,
    bus.find_guarding,
    drives.find_faults,
    network.find_pauses_of_the_bus,
    bus.find_other_hosts,
    network.find_silent_nodes,
    network.find_boot_ups,
    network.find_lost_nodes,
    network.find_wrong_network_states,
    network.find_late_sync,
    states.find_lost_torque,
    states.find_ignored_commands,
    states.find_wrong_modes,
    states.find_flags,
    states.find_following_errors,
    states.find_missed_targets,
    states.find_emergencies,
    pdos.find_missing_pdos,
    pdos.find_wrong_lengths,
    transfers.find_unanswered,
    transfers.find_unfinished,
    transfers.find_refused,
    transfers.find_overlaps,
    transfers.find_short_frames,
    transfers.find_lost_settings,
)
"""All families of findings, causes before consequences."""
ANY_BUS: tuple[Find, ...] = (bus.find_error_frames, bus.find_high_load)
"""Those that a bus of any protocol may have."""


@dataclass(frozen=True)
class Verdict:
    """What is wrong in a trace.

    Attributes:
        findings: The problems, the worst first.
        headline: What happened, in one line.
        places: Node and axis of each of them, in words.
        counts: How many problems there are of each severity.
        load: Of the bus within the busiest tenth of a second, bit/s, stuffed as badly as can be;
            None without times.
        heard: Whether any CANopen node is heard.
    """

    findings: tuple[Finding, ...]
    headline: str
    places: tuple[str, ...]
    counts: dict[Severity, int]
    load: float | None
    heard: bool

    @property
    def good(self) -> bool:
        """Whether a node is heard, and no problem is unresolved."""
        return self.heard and self.worst is not Severity.UNRESOLVED

    @property
    def worst(self) -> Severity | None:
        """The worst severity; None if nothing is wrong."""
        return self.findings[0].severity if self.findings else None

    @property
    def count(self) -> str:
        """How many problems there are of each severity, in words."""
        return count_words(self.counts)

    def as_dict(self) -> dict[str, Any]:
        """The verdict for ``--json``."""
        counts = {str(severity): count for severity, count in self.counts.items()}
        return {
            "verdict": {"headline": self.headline, **counts, "bus_load": self.load},
            "findings": [each.as_dict() for each in self.findings],
        }


def assess(trace: Conversation, remarks: Sequence[str] = ()) -> Verdict:
    """The verdict on a trace.

    Args:
        trace: The trace.
        remarks: What its reader remarked.
    """
    findings = list(bus.find_clock_steps(remarks))
    for find in FINDERS if trace.is_canopen else ANY_BUS:
        findings += find(trace, findings)
    findings.sort(key=lambda each: each.order)
    found = Counter(each.severity for each in findings)
    counts = {severity: found[severity] for severity in Severity}
    load = bus.busiest(trace)[1] if trace.timed else None
    places = tuple(where(trace, each) for each in findings)
    headline = _headline(trace, findings, counts, load)
    return Verdict(tuple(findings), headline, places, counts, load, bool(trace.nodes))


def where(trace: Conversation, finding: Finding) -> str:
    """Node and axis of a finding, in words."""
    if not finding.node:
        return "bus"
    axis = f", axis {finding.axis}" if finding.axis and trace.has_axes(finding.node) else ""
    return trace.called(finding.node) + axis


def _headline(
    trace: Conversation,
    findings: list[Finding],
    counts: dict[Severity, int],
    load: float | None,
) -> str:
    """What happened, in one line: the worst finding, and how many others there are."""
    if not trace.is_canopen:
        return (
            f"no CANopen recognised: {plural(len(trace.observed.times), 'frame')} without network "
            "management, heartbeat, SDO or SYNC; with --eds FILE or --rig FILE, PDOs and "
            "emergencies are read"
        )
    if not findings:
        found = "nothing wrong" if trace.nodes else "no CANopen node heard"
        return f"{found}: {_describe_checks(trace, load)}"
    first = findings[0]
    when = f"at {first.time:.3f} s" if trace.timed else f"in frame {first.time:.0f}"
    line = f"{first.severity}: {where(trace, first)} {when}: {first.text}"
    line += f"; {first.motion}" if first.motion else ""
    others = dict(counts)
    others[first.severity] -= 1
    more = count_words(others)
    return line + (f" (and {more})" if more else "")


def _describe_checks(trace: Conversation, load: float | None) -> str:
    """What was checked, in one line."""
    seen, parts = trace.observed, list[str]()
    beats = [its for stream, its in seen.rhythms.items() if stream.name == "heartbeat"]
    sync = seen.rhythms.get(StreamKey(BUS, "SYNC"))
    if beats:
        parts.append(f"{plural(len(beats), 'heartbeat')} {_every(trace, beats)}")
    if sync:
        parts.append(f"SYNC {_every(trace, [sync])}")
    pdos = sum(stream.name[1:4] == "PDO" for stream in seen.streams)
    parts += [plural(pdos, "PDO")] if pdos else []
    parts += [plural(len(seen.transfers), "SDO transfer")] if seen.transfers else []
    if trace.bitrate and load is not None:
        parts.append(f"bus load up to {100 * load / trace.bitrate:.0f} %")
    axes = len(drives.axes(trace))
    what = plural(len(trace.nodes), "node") + (f" and {plural(axes, 'drive')}" if axes else "")
    checked = f": {', '.join(parts)}" if parts else ""
    frames = plural(len(seen.times), "frame")
    lasting = f"for {trace.span(trace.duration)}" if trace.timed else f"in {frames}"
    return f"{what} {lasting}{checked}; no emergency, no error frame"


def _every(trace: Conversation, rhythms: Sequence[Rhythm]) -> str:
    """The period of some streams and their worst pause, in words."""
    periods = dict.fromkeys(trace.span(each.usual) for each in rhythms)
    worst = trace.span(max(each.worst for each in rhythms))
    return f"every {' or '.join(periods)} (worst {worst})"
