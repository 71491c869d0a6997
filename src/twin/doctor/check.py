"""Results of checks, one line each, and the next step that follows from all of them."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from enum import StrEnum
from typing import NamedTuple

from twin.base.errors import TwinError, plural


def next_step(found: Sequence[CheckResult], rig: str, *, move: bool) -> str:
    """The last line of the doctor.

    Args:
        found: Every result, in order.
        rig: Argument of ``--rig``.
        move: Whether the drives were allowed to move.
    """
    failures = [each for each in found if each.status is CheckStatus.FAIL]
    if failures:
        first = failures[0]
        step = first.advice or first.seen
        return f"not ready; next step ({first.what}): {step}"
    if not move:
        command = f"ballplate doctor --rig {rig} --move"
        return (
            "not ready: the checks that move the plate are left; "
            f"next step: hands off the plate, then {command}"
        )
    warnings = sum(each.status is CheckStatus.WARN for each in found)
    some = f", with {plural(warnings, 'reservation')} above" if warnings else ""
    return (
        f"ready{some}: put the ball on, then ballplate run excite --rig {rig}, and "
        "ballplate identify runs/excite for the dead time and the friction"
    )


class CheckStatus(StrEnum):
    """PASS: correct. WARN: it works, with reservations. FAIL: a run would not work."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"


class CheckResult(NamedTuple):
    """The result of one check.

    Attributes:
        what: The device or property that was checked.
        status: Whether it passed.
        seen: The observation.
        advice: Advice to the person; empty if there is none.
    """

    what: str
    status: CheckStatus
    seen: str
    advice: str = ""

    def as_dict(self) -> dict[str, str]:
        """The result for ``--json``; the status is called verdict there."""
        return dict(zip(("what", "verdict", "seen", "advice"), map(str, self), strict=True))


Ask = Callable[[str], object]
"""Request to a person or an emulated rig: ``lift`` or ``put`` the ball, or ``touch X Y`` in mm."""


def pass_check(what: str, seen: str) -> CheckResult:
    """A check that passed."""
    return CheckResult(what, CheckStatus.PASS, seen)


def warn_check(what: str, seen: str, advice: str) -> CheckResult:
    """A check that passed with reservations."""
    return CheckResult(what, CheckStatus.WARN, seen, advice)


def fail_check(what: str, seen: str, advice: str) -> CheckResult:
    """A check that failed: a run would not work."""
    return CheckResult(what, CheckStatus.FAIL, seen, advice)


def note_check(what: str, seen: str, advice: str) -> CheckResult:
    """A check that passed; with reservations if there is advice."""
    return warn_check(what, seen, advice) if advice else pass_check(what, seen)


def report_errors(
    check: Iterator[CheckResult],
    what: str,
    advice: str = "see the fault; close STO, reset the faults (--reset)",
) -> Generator[CheckResult, None, bool]:
    """The results of a check, an error as the last of them; returns whether none is a failure.

    Args:
        check: The check.
        what: Name of the check that fails with the error.
        advice: Advice for that.
    """
    good = True
    try:
        for result in check:
            good = good and result.status is not CheckStatus.FAIL
            yield result
    except TwinError as error:
        yield fail_check(what, str(error), advice)
        good = False
    return good
