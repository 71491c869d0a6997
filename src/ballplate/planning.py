"""An experiment planned before the rig moves: what a motion will tell of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.identifying import HOLD_OUT_SHARE, check_hold_out
from ballplate.reporter import Reporter, default
from twin.base.errors import ScenarioError

if TYPE_CHECKING:
    from twin.plan.experiment import MotionForecast
    from twin.plan.motion import OptimisedMotion


@dataclass(repr=False, eq=False)
class Planned:
    """What motions will tell of a rig; shows itself in a notebook.

    Attributes:
        forecasts: Of each motion, the one that tells most first.
        optimised: The motion that was optimised; None if none was asked for.

    Examples:
        >>> import ballplate as bp
        >>> plan = bp.plan_experiment("hold", "delay", seconds=5, rigs=0)
        >>> plan.best.nominal.why[:9]  # the ball rests
        'too quiet'
    """

    forecasts: list[MotionForecast]
    optimised: OptimisedMotion | None = None

    @property
    def best(self) -> MotionForecast:
        """The forecast of the motion that tells most."""
        return self.forecasts[0]

    def as_dict(self) -> dict[str, Any]:
        """The numbers, for ``--json``."""
        found: dict[str, Any] = {"best": self.best.scenario}
        found["motions"] = [each.as_dict() for each in self.forecasts]
        if self.optimised is not None:
            found["optimised"] = {
                "base": self.optimised.base,
                "kept": self.optimised.kept,
                "tested": self.optimised.tested,
                "scenario": self.optimised.text,
            }
        return found

    def save(self, file: str | Path) -> Path:
        """Write the optimised motion: a scenario, or a table of the reference if it ends in .csv.

        Raises:
            TwinError: If no motion was optimised, the ending is wrong, or the file cannot be
                written.
        """
        from twin.plan.motion import write_motion

        if self.optimised is None:
            raise ScenarioError(f"{file}: no motion was optimised; plan with optimise=True")
        write_motion(Path(file), self.optimised)
        return Path(file)

    def _repr_html_(self) -> str:
        """For a notebook: the forecast of each motion."""
        from twin.base.page import fragment

        return fragment("Planned experiment", [each.table for each in self.forecasts])


def plan_experiment(
    scenarios: str | Path | Sequence[str | Path] = (),
    parameters: str | Iterable[str] = (),
    *,
    on: str | Path | None = None,
    axes: int | None = None,
    seconds: float = 40.0,
    rigs: int = 4,
    hold_out: float = HOLD_OUT_SHARE,
    optimise: bool = False,
    reporter: Reporter | None = None,
) -> Planned:
    """Forecast what motions will tell of a rig, before anything is recorded.

    Args:
        scenarios: Scenarios to compare; excite, circle and sine if none, on one axis line and
            excite.
        parameters: Names of those to find, as ``identify`` takes them; the usual ones if none.
        on: A shipped rig, or a file of parameters; the thesis's rig if None.
        axes: Number of axes of the rig, 1 or 2; those that it has if None.
        seconds: Length of the run, 5 to 600.
        rigs: Number of rigs that are drawn of what is not known of the rig, 0 to 200.
        hold_out: Share of the run that ``identify`` will hold out from the fit, 0 to 0.8.
        optimise: Whether a motion is sought that tells more, under the law of the best scenario.
        reporter: Receives progress; a notebook has its own.

    Raises:
        TwinError: If a scenario, rig or parameter is unknown, or a number out of range.

    Examples:
        >>> import ballplate as bp
        >>> plan = bp.plan_experiment("sine", "delay", seconds=12, rigs=0, hold_out=0)
        >>> (delay,) = plan.best.nominal.verdicts
        >>> f"{delay.value:.3f} {delay.about.unit}: {delay.word}"
        '0.042 s: identified'
    """
    from twin.base.shipped import find
    from twin.identify.parameters import choose_parameters
    from twin.plan.experiment import RigChoice, axes_settings, check_plan, forecast_motions
    from twin.plan.motion import describe_work, optimise_motion

    report = reporter or default()
    check_hold_out(hold_out, report)
    names = [parameters] if isinstance(parameters, str) else parameters
    wanted = choose_parameters(",".join(names) or None)
    motions = [scenarios] if isinstance(scenarios, str | Path) else list(scenarios)
    rig = str(on or "")
    choice = RigChoice(on=rig, rigs=rigs, settings=axes_settings(axes, rig))
    check_plan(seconds, choice, wanted, report.name_of)
    for name in motions:
        find(str(name))
    report.note(describe_work(len(motions), seconds, choice, optimise=optimise))
    with report.progress("forecasting", 1.0) as advance:
        found = forecast_motions(motions, seconds, choice, wanted, 1 - hold_out, advance)
    if not optimise:
        return Planned(found)
    with report.progress("optimising", 1.0) as advance:
        best = optimise_motion(found[0].scenario, seconds, choice, wanted, 1 - hold_out, advance)
    every = sorted([*found, best.forecast], key=lambda each: each.score)
    return Planned(every, best)
