"""What to do after the checks: run, or the next step towards it."""

from __future__ import annotations

from collections.abc import Sequence

from twin.doctor.check import CheckResult, CheckStatus


def next_step(found: Sequence[CheckResult], rig: str, *, move: bool) -> str:
    """The last line of the doctor.

    Args:
        found: Every result, in order.
        rig: What was given as ``--rig``.
        move: Whether the drives were allowed to move.
    """
    failures = [each for each in found if each.status is CheckStatus.FAIL]
    if failures:
        first = failures[0]
        step = first.advice or first.seen
        return f"not ready; next step ({first.what}): {step}"
    if not move:
        command = f"ballplate doctor --rig {rig} --move"
        return f"not ready; next step: hands off the plate, then {command}"
    warnings = sum(each.status is CheckStatus.WARN for each in found)
    some = f", with {warnings} reservations above" if warnings else ""
    return (
        f"ready{some}: put the ball on, then ballplate run excite --rig {rig}, and "
        "ballplate identify runs/excite for the dead time and the friction"
    )
