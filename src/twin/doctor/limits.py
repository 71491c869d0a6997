"""Whether the limits in the drives hold: set low, then asked for more than they allow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.conditions import INTERNAL_LIMIT, RUNAWAY
from twin.devices.akd.servos import AkdServos
from twin.doctor.check import CheckResult, CheckStatus, failed, passed, reported, warned
from twin.doctor.steps import enable, exchange
from twin.hal.interface import Severity

RATE, RAMP = 1.2, 50.0
"""Limits set for this, at the cam shafts in rad/s and rad/s^2."""
ASKED = 2.0
"""Rate asked for, rad/s: above the limit by less than what counts as not following."""
SECONDS = 0.1
"""Time in s; with the limit holding, the plate tilts by little more than a degree."""
SHARE = 0.25
"""Share by which the rate held may differ from the limit."""
FACTOR = 3.0
"""Factor by which the ramp may: the drive's own speed loop has a part in it."""
GAP = 0.01
"""Time in s between two answers above which nothing can be said of a ramp."""


@reported("limits in the drives", "see the fault")
def limits(servos: AkdServos) -> Iterator[CheckResult]:
    """Ask each drive for more than its limit; what it does tells what its counts mean.

    The drives are left started with the limits of their configuration, without torque.
    """
    usual = servos.config
    # A lower limit would narrow what counts as a plausible step of the encoder, too.
    watch = replace(usual.watch, jump=10.0, slack=(0.1, 0.1))
    servos.config = replace(usual, rate_limit=RATE, ramp=RAMP, watch=watch)
    try:
        servos.start()
        enable(servos)
        for index, axis in enumerate(servos.axes):
            times, rates = _asked(servos, index, ASKED)
            _asked(servos, index, -ASKED)
            faults = servos.faults()
            stops = (each for each in faults if each.condition.severity is Severity.STOP)
            stop = next(stops, None)
            if stop is None or stop.condition is RUNAWAY:
                shown = any(each.condition is INTERNAL_LIMIT for each in faults)
                result = _judged(axis.config.name, times, rates)
                bit = f"internal limit (bit 11) {'shown' if shown else 'not shown'}"
                result = result._replace(seen=f"{result.seen}; {bit}")
            else:
                result = failed(f"{axis.config.name} limits", str(stop), "see the fault")
            yield result
            if result.status is CheckStatus.FAIL:
                return
        servos.quick_stop()
        exchange(servos, 0.1)
    finally:
        servos.config = usual
        servos.stop()
    servos.start()


def _asked(servos: AkdServos, index: int, rate: float) -> tuple[Array, Array]:
    """Times in s and rates in rad/s while one axis is asked for a rate; then it stands again."""
    axis = servos.axes[index]
    samples: list[tuple[float, float]] = []
    for seconds, target in ((SECONDS, rate), (0.1, 0.0)):
        axis.target = target
        for _ in range(round(seconds / servos.config.period)):
            exchange(servos, servos.config.period)
            if target and (not samples or axis.plate.sampled > samples[-1][0]):
                samples.append((axis.plate.sampled, axis.rate))
    times, rates = np.array(samples).T
    return times, rates


def _judged(name: str, times: Array, rates: Array) -> CheckResult:
    what = f"{name} limits"
    if len(times) < 2 or np.diff(times).max() > GAP:
        apart = 1e3 * (np.diff(times).max() if len(times) > 1 else SECONDS)
        seen = f"answers up to {apart:.0f} ms apart: too irregular to judge"
        return warned(what, seen, "close other programs, then repeat")
    held = float(np.median(rates[len(rates) // 2 :]))
    begin, end = (float(times[np.argmax(rates >= share * held)]) for share in (0.1, 0.9))
    ramp = 0.8 * held / max(end - begin, 1e-3)
    text = f"held {held:.2f} rad/s of {ASKED:g} asked for, limit {RATE:g}; ramp {ramp:.0f} rad/s^2"
    if abs(held / RATE - 1) > SHARE:
        advice = f"do not run: set {name}.limit_unit to what a count of VL.LIMITP (3622h) means"
        return failed(what, text, advice)
    if not RAMP / FACTOR < ramp < RAMP * FACTOR:
        advice = f"set {name}.acceleration_unit to what a count of 6083h means"
        return failed(what, f"{text}, set {RAMP:g}", advice)
    return passed(what, text)
