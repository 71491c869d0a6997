"""Checks without a device: scheduling, timer, law, cam table, safety nets, settings, bus load."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from twin.base.errors import TwinError
from twin.devices.akd.config import list_unconfirmed
from twin.devices.akd.protocol import table
from twin.devices.realtime import RealTimeClock, real_time
from twin.doctor.check import CheckResult, fail_check, note_check, pass_check, warn_check
from twin.run.connect import ComputingTime, cams_of
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario


@dataclass(frozen=True, kw_only=True)
class ComputerCheck:
    """How the computer is checked.

    Attributes:
        timer_s: Time in s for which the timer is watched.
        lateness_quantile: Quantile of the timer's lateness that is compared with the period.
        max_lateness_periods: Largest lateness at that quantile, in control periods.
        max_missed_percent: Largest share of missed periods, %.
        max_bus_load: Share of a period's time on the bus above which heartbeats and SDOs are late.
    """

    timer_s: float = 1.0
    lateness_quantile: float = 0.99
    max_lateness_periods: float = 0.25
    max_missed_percent: float = 0.5
    max_bus_load: float = 0.6


COMPUTER_CHECK = ComputerCheck()


def computer(
    scenario: Scenario, rig: RigFile, check: ComputerCheck = COMPUTER_CHECK
) -> Iterator[CheckResult]:
    """Everything that can be checked without a device."""
    yield from _check_scheduling(scenario.rig.period, check)
    yield _check_computing_time(scenario)
    if rig.has_cams:
        yield _check_cams(rig)
    relaxed = ", ".join(rig.relaxed(scenario.rig.period))
    advice = "take these keys out of the rig file; every run is warned of them"
    seen = f"relaxed: {relaxed}" if relaxed else "as by default, or tighter"
    yield note_check("safety nets", seen, advice if relaxed else "")
    if not rig.has_akd:
        return
    yield warn_check(
        "settings of the drives",
        f"never confirmed on a rig: {', '.join(list_unconfirmed())}",
        "compare them with the drives' manual and setup software",
    )
    by_hand = "; ".join(table()["by_hand"])
    yield warn_check("to be looked at by hand", by_hand, "see docs/bring-up.md")
    load, bus = rig.servos(scenario.rig.period).bus_load, rig.bus
    seen = f"{100 * load:.0f} % at {bus.bitrate / 1e6:g} Mbit/s, stuffed at worst"
    advice = "set drives and adapter to 1 Mbit/s"
    yield note_check("bus load", seen, advice if load > check.max_bus_load else "")


def _check_computing_time(scenario: Scenario) -> CheckResult:
    found = ComputingTime.measured(scenario)
    what = "computing time of the law"
    if found.enough:
        return pass_check(what, f"{found.text}: will do")
    if found.never:
        return fail_check(what, f"{found.text}: will not do", found.advice)
    return warn_check(what, f"{found.text}: may be too late now and then", found.advice)


def _check_scheduling(period: float, check: ComputerCheck) -> Iterator[CheckResult]:
    clock = RealTimeClock(period)
    timing = clock.timing
    with real_time() as obtained:
        for words in obtained.words[:2]:
            seen, _, advice = words.partition(": ")
            yield note_check("real-time priority" if "priority" in seen else "memory", seen, advice)
        clock.start()
        for _ in range(round(check.timer_s / period)):
            clock.wait()
    late = timing.lateness.quantile(check.lateness_quantile)
    share = 100 * timing.missed / max(1, timing.ticks + timing.missed)
    quantile = f"p{100 * check.lateness_quantile:g}"
    missed = f"{share:.2f} % of {1e3 * period:g} ms periods missed"
    seen = f"{quantile} {1e6 * late:.0f} us late, {missed}"
    advice = "close other programs; use a kernel with PREEMPT_RT"
    bad = share > check.max_missed_percent or late > check.max_lateness_periods * period
    yield note_check("timer", seen, advice if bad else "")


def _check_cams(rig: RigFile) -> CheckResult:
    own = rig.cams or "cams.json"
    try:
        table = cams_of(rig)
    except TwinError as error:
        advice = f"run `ballplate calibrate cams --rig FILE --out {own}`"
        return fail_check("cam table", str(error), advice)
    seen = f"{Path(own).name}: ratio {table.ratio:.2f}"
    if not rig.cams:
        advice = "name a table measured on this rig as 'cams' in the rig file"
        return warn_check("cam table", f"{seen}, computed from the model", advice)
    return pass_check("cam table", seen)
