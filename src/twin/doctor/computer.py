"""The computer and its installation: scheduling, timer, cam table, limits, extras, ports."""

from __future__ import annotations

import time
from collections.abc import Iterator
from math import degrees
from pathlib import Path

from twin.devices.akd.config import AkdConfig, unconfirmed
from twin.devices.akd.protocol import table
from twin.devices.realtime import RealTimeClock, TimingLog, real_time
from twin.doctor.check import CheckResult, failed, noted, passed, warned
from twin.errors import TwinError
from twin.hal.cams import CamTable
from twin.paths import model_path
from twin.run.assemble import build_limits
from twin.run.connect import ComputingTime, narrower
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario

TIMED = 1.0
"""Seconds that the timer is watched."""
FULL_BUS = 0.6
"""Share of a period's time on the bus above which heartbeats and SDOs come late."""
OLD = 365
"""Days after which a cam table should be measured again; wheels and cams wear."""


def computer(scenario: Scenario, rig: RigFile) -> Iterator[CheckResult]:
    """Everything that can be checked without a device."""
    yield from _scheduling(scenario.rig.period)
    yield _law(scenario)
    if rig.backend is None:
        yield _cams(rig)
    limits = narrower(build_limits(scenario.rig.limits), build_limits(rig.limits))
    yield passed(
        "limits",
        f"{degrees(limits.angle):.3g} deg, {degrees(limits.rate):.3g} deg/s, "
        f"{limits.acceleration:g} rad/s^2, ball within {limits.area[0]:g} x {limits.area[1]:g} m "
        f"and {limits.margin:g} m beyond",
    )
    relaxed = ", ".join(rig.relaxed(scenario.rig.period))
    advice = "take these keys out of the rig file; every run is warned of them"
    seen = f"relaxed: {relaxed}" if relaxed else "as by default, or tighter"
    yield noted("safety nets", seen, advice if relaxed else "")
    if rig.backend is not None:
        return
    yield warned(
        "settings of the drives",
        f"never confirmed on a rig: {', '.join(unconfirmed())}",
        "compare them with the drives' manual and setup software",
    )
    by_hand = "; ".join(table()["by_hand"])
    yield warned("to be looked at by hand", by_hand, "see docs/bring-up.md")
    yield _bus_load(rig.servos(scenario.rig.period))


def _law(scenario: Scenario) -> CheckResult:
    found = ComputingTime.measured(scenario)
    what = "computing time of the law"
    if found.enough:
        return passed(what, f"{found.text}: will do")
    if found.never:
        return failed(what, f"{found.text}: will not do", found.advice)
    return warned(what, f"{found.text}: may be too late now and then", found.advice)


def _bus_load(drives: AkdConfig) -> CheckResult:
    seen = f"{100 * drives.bus_load:.0f} % at {drives.bus.bitrate / 1e6:g} Mbit/s, stuffed at worst"
    advice = "set drives and adapter to 1 Mbit/s"
    return noted("bus load", seen, advice if drives.bus_load > FULL_BUS else "")


def _scheduling(period: float) -> Iterator[CheckResult]:
    timing = TimingLog(period)
    clock = RealTimeClock(period, timing)
    with real_time() as obtained:
        for words in obtained.words[:2]:
            seen, _, advice = words.partition(": ")
            yield noted("real-time priority" if "priority" in seen else "memory", seen, advice)
        clock.start()
        for _ in range(round(TIMED / period)):
            clock.wait()
    late = timing.lateness.quantile(0.99)
    share = 100 * timing.missed / max(1, timing.ticks + timing.missed)
    seen = f"p99 {1e6 * late:.0f} us late, {share:.2f} % of {1e3 * period:g} ms periods missed"
    advice = "close other programs; use a kernel with PREEMPT_RT"
    yield noted("timer", seen, advice if share > 0.5 or late > period / 4 else "")


def _cams(rig: RigFile) -> CheckResult:
    file = Path(rig.cams) if rig.cams else model_path("cams.json")
    try:
        table = CamTable.from_file(file)
        if not rig.cams:
            table.check(model_path())
    except TwinError as error:
        own = rig.cams or "cams.json"
        advice = f"run `ballplate calibrate cams --rig FILE --out {own}`"
        return failed("cam table", str(error), advice)
    days = (time.time() - file.stat().st_mtime) / 86400
    seen = f"{file.name}: ratio {table.ratio:.2f}, {days:.0f} days old"
    if not rig.cams:
        advice = "name a table measured on this rig as 'cams' in the rig file"
        return warned("cam table", f"{seen}, computed from the model", advice)
    return noted("cam table", seen, "measure it again" if days > OLD else "")
