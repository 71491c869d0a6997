"""A run in plain sentences: how it ended, how large the error was, what limited it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.devices.realtime import blamed
from twin.report.diagnosis import Diagnosis
from twin.run.assemble import build_law
from twin.run.finished import Run

ENDINGS = {
    "finished": "The run went to its end",
    "fell": "The ball fell off the plate",
    "diverged": "The simulation failed",
    "lost": "The screen lost the ball",
    "fault": "A device failed",
    "aborted": "The run was stopped",
}


LEAST = 1e-6
"""Distance in m below which a number of it says nothing."""
SMALL = 1e-4
"""Error in m, less than the screen can tell, of which nothing needs to be said."""
CUT = 0.001
"""Share of time in which a limit cut the effort from which on it is said."""
FREE = "no limit was in the way"
STEEP = 0.95
"""Share of the angle limit from which on the plate is said to have reached it."""


def summary(run: Run, found: Diagnosis) -> list[str]:
    """How it ended, how large the error was, and what limited it: one sentence each."""
    told = [
        _ending(run),
        *_by_hand(run),
        _error(run, found),
        *_rested(found),
        *(fact.sentence for fact in _limits(run, found)),
        *_estimated(found),
    ]
    remarks = () if "controller" in run.absent else build_law(run.scenario).remarks
    return [*told, *_known(run), *remarks]


def judged(run: Run, clean: float | None = None) -> str:
    """The verdict on a run; arguments as for ``verdict``."""
    if not len(run.rows["time"]):
        return f"{ENDINGS[run.metrics['outcome']]}: {run.metrics['reason']}."
    return verdict(run, Diagnosis.of(run), clean)


def verdict(run: Run, found: Diagnosis, clean: float | None = None) -> str:
    """A run in one sentence: its tracking error, and what limited it most.

    Args:
        run: The run.
        found: What its record shows.
        clean: Tracking error e_tt of the same controller on the clean model in %, if it ran.
    """
    if run.metrics.get("outcome") != "finished":
        return _ending(run)
    percent = run.metrics.get("tracking_error_percent")
    beside = f" ({clean:.3g} % on the clean model)" if clean is not None else ""
    share = f"Tracking error e_tt {percent:.3g} %{beside}, " if percent is not None else ""
    rms = f"{_mm(found.rms)} RMS over x and y"
    start = run.scenario.metrics.start
    since = f" from {start:.4g} s on" if start else ""
    limits = [fact.words for fact in _limits(run, found)]
    limits = [words for words in limits if words != FREE] or limits
    return f"{share}{rms}{since}: {'; '.join(limits)}."


class Fact(NamedTuple):
    """Something that limited a run: in half a sentence, and what the report says besides."""

    words: str
    more: str = ""

    @property
    def sentence(self) -> str:
        """Both as a sentence."""
        return f"{self.words[0].upper()}{self.words[1:]}{self.more}."


def _limits(run: Run, found: Diagnosis) -> list[Fact]:
    """What limited a run, the weightiest first."""
    facts = _shaped(run)
    if found.stuck is not None:
        facts.append(_stuck(run, found, found.stuck))
    if found.lag is not None and found.gain is not None and found.rest is not None:
        way = "behind" if found.lag >= 0 else "ahead of"
        size = "smaller" if found.gain <= 1 else "larger"
        share = "most of the error" if found.rest < 0.5 * found.rms else "a part of the error"
        behind = Fact(
            f"the ball ran {1000 * abs(found.lag):.0f} ms {way} its reference on a path "
            f"{abs(1 - found.gain):.1%} {size}",
            f"; this is {share}: without both, {1000 * found.rest:.2g} mm (RMS) would be left",
        )
        facts += [behind] if found.stuck is None and found.rms > SMALL else []
    if found.cut is not None and found.cut > CUT:
        facts.append(
            Fact(
                f"a limit of rate, acceleration or angle cut the effort {found.cut:.1%} of the time"
            )
        )
    limit = run.scenario.rig.limits.angle_deg
    used = found.angle * limit
    if found.angle > STEEP:
        facts.append(Fact("the plate reached its angle limit", f": {used:.3g} of {limit:g} deg"))
    if found.cut is not None and found.cut <= CUT and found.angle <= STEEP:
        facts.append(
            Fact(
                FREE, f": the effort was never cut, and the plate used {used:.2g} of {limit:g} deg"
            )
        )
    if found.lifted:
        facts.append(Fact(f"a wheel left its cam {found.lifted:.1%} of the time"))
    if found.untouched:
        facts.append(Fact(f"the screen detected no ball {found.untouched:.1%} of the time"))
    return facts or [Fact(FREE)]


def _shaped(run: Run) -> list[Fact]:
    """A reference that the plate cannot give, if the law laid another path for that reason."""
    if "laid_x" not in run.rows:
        return []
    laid, time = np.stack((run.rows["laid_x"], run.rows["laid_y"]), axis=1), run.rows["time"]
    away = np.nanmax(np.hypot(*(laid - run.followed(time)[0]).T))
    seconds = np.isfinite(laid[:, 0]).mean() * (time[-1] - time[0])
    return [
        Fact(
            "the plate cannot give this reference: the path laid instead was up to "
            f"{_mm(away)} away from it",
            f", for {seconds:.3g} s in all",
        )
    ]


def _stuck(run: Run, found: Diagnosis, away: float) -> Fact:
    """A ball that lies still away from its reference: by what, and what would free it."""
    plant = run.scenario.plant
    arm = plant.friction.rolling_mm
    simulated = "true_x" in run.rows
    holds = math.degrees(
        math.atan(arm * plant.friction.breakaway_ratio / (1000 * plant.ball.radius))
    )
    known = f"; its friction holds it up to {holds:.2g} deg" if arm > 0 and simulated else ""
    return Fact(
        f"at the end the ball lay stuck{' by friction' if arm > 0 or not simulated else ''} "
        f"{1000 * away:.3g} mm away",
        f" from its reference, on a plate tilted by {math.degrees(found.tilt):.2g} deg{known}. "
        "A law with integral action or a higher gain, or a reference that keeps moving, would "
        "free it",
    )


def _ending(run: Run) -> str:
    outcome = str(run.metrics.get("outcome", ""))
    end = float(run.metrics.get("outcome_time", run.rows["time"][-1]))
    reason = run.metrics.get("reason")
    ending = ENDINGS.get(outcome, "The run ended")
    told = f"{ending} after {end:.4g} s{f': {reason}' if reason else ''}."
    late = blamed(run.ledger) if outcome == "fault" and run.ledger else ""
    return f"{late[0].upper()}{late[1:]}. {told}" if late else told


def _by_hand(run: Run) -> list[str]:
    """Of a run that a person drove: what they did."""
    if not run.driven:
        return []
    done = [
        _counted(number, word)
        for number, word in (
            (run.driven["goals"], "goal"),
            (len(run.driven["pushes"]), "push"),
            (run.driven["changes"], "change of the rig"),
            (len(run.driven["controllers"]) - 1, "change of the controller"),
        )
        if number > 0
    ]
    return [f"It was driven by hand: {', '.join(done) or 'nothing was done'}."]


def _counted(number: int, word: str) -> str:
    """A number of things, in words."""
    if number == 1:
        return f"1 {word}"
    head, _, rest = word.partition(" ")
    plural = f"{head}{'es' if head.endswith('sh') else 's'}"
    return f"{number} {plural} {rest}".strip()


def _mm(distance: float) -> str:
    """A distance in m, in words; nothing that no rig could tell from none."""
    return f"{1000 * distance:.3g} mm" if distance >= LEAST else f"below {1000 * LEAST:g} mm"


def _error(run: Run, found: Diagnosis) -> str:
    start = run.scenario.metrics.start
    judged = 0 < start < (run.metrics.get("outcome_time") or run.scenario.duration)
    since = f"From {start:.4g} s on the" if judged else "The"
    percent = run.metrics.get("tracking_error_percent")
    share = f", {percent:.3g} % of the reference (e_tt)" if percent is not None else ""
    return f"{since} ball was {_mm(found.rms)} (RMS) from its reference{share}."


def _rested(found: Diagnosis) -> list[str]:
    """How long friction held the ball."""
    if not found.held:
        return []
    return [f"Friction held the ball at rest {found.held:.1%} of the whole run's time (shaded)."]


def _estimated(found: Diagnosis) -> list[str]:
    """How far off the observer was."""
    if found.estimation is None or found.estimation < LEAST:
        return []
    size = "large" if found.estimation > 0.5 * found.rms else "small"
    return [
        f"The observer's position of the ball was off by {1000 * found.estimation:.2g} mm "
        f"(RMS), a {size} part of it."
    ]


def _known(run: Run) -> list[str]:
    """What the observer made of friction and tilt gain, where it estimates them."""
    rows = run.rows
    if "estimated_friction_spread" not in rows:
        return []
    friction, spread = (1000 * rows[f"estimated_friction{end}"][-1] for end in ("", "_spread"))
    gains = [
        f"{100 * rows[f'estimated_tilt_gain_{axis}'][-1]:+.2g} ± "
        f"{100 * rows[f'estimated_tilt_gain_{axis}_spread'][-1]:.2g} %"
        for axis in "xy"
    ]
    return [
        f"At the end the observer took friction to slow the ball by {friction:.3g} ± "
        f"{spread:.2g} mm/s² (one standard deviation), and the tilt to act by "
        f"{gains[0]} along x and {gains[1]} along y more than nominal."
    ]
