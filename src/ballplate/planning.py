"""An experiment planned before the rig moves: what a motion will tell of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter, default
from ballplate.results import HOLD_OUT_SHARE
from twin.base.errors import ScenarioError

if TYPE_CHECKING:
    from twin.plan.experiment import MotionForecast


@dataclass(repr=False, eq=False)
class Planned:
    """What motions will tell of a rig; shows itself in a notebook.

    Attributes:
        forecasts: Of each motion, the one that tells most first.
    """

    forecasts: list[MotionForecast]

    @property
    def best(self) -> MotionForecast:
        """The forecast of the motion that tells most."""
        return self.forecasts[0]

    def as_dict(self) -> dict[str, Any]:
        """The numbers, for ``--json``."""
        return {"best": self.best.scenario, "motions": [each.as_dict() for each in self.forecasts]}

    def _repr_html_(self) -> str:
        """For a notebook: the forecast of each motion."""
        from twin.base.page import fragment

        return fragment("Planned experiment", [each.table for each in self.forecasts])


def plan_experiment(
    scenarios: str | Path | Sequence[str | Path] = (),
    parameters: str | Iterable[str] = (),
    *,
    on: str | Path | None = None,
    seconds: float = 40.0,
    rigs: int = 4,
    hold_out: float = HOLD_OUT_SHARE,
    reporter: Reporter | None = None,
) -> Planned:
    """Forecast what motions will tell of a rig, before anything is recorded.

    Args:
        scenarios: Scenarios to compare; excite, circle and sine if none.
        parameters: Names of those to find, as ``identify`` takes them; the usual ones if none.
        on: A shipped rig, or a file of parameters; the thesis's rig if None.
        seconds: Length of the run, 5 to 600.
        rigs: Number of rigs that are drawn of what is not known of the rig, 0 to 200.
        hold_out: Share of the run that ``identify`` will hold out from the fit, 0 to 0.8.
        reporter: Receives progress; a notebook has its own.

    Raises:
        TwinError: If a scenario, rig or parameter is unknown, or a number out of range.

    Examples:
        >>> import ballplate as bp
        >>> plan = bp.plan_experiment("sine", "delay", on="hobby", seconds=8, rigs=0)
        >>> (delay,) = plan.best.nominal.verdicts
        >>> f"{delay.value:.2f} {delay.about.unit}"
        '0.03 s'
    """
    from twin.identify.parameters import choose_parameters
    from twin.plan.experiment import RigChoice, forecast_motions

    if not 0 <= hold_out <= 0.8:
        raise ScenarioError(f"hold_out: must be 0 to 0.8, got {hold_out:g}")
    names = [parameters] if isinstance(parameters, str) else parameters
    wanted = choose_parameters(",".join(names) or None)
    motions = [scenarios] if isinstance(scenarios, str | Path) else list(scenarios)
    choice = RigChoice(on=str(on or ""), rigs=rigs)
    report = reporter or default()
    with report.progress("forecasting", 1.0) as advance:
        return Planned(forecast_motions(motions, seconds, choice, wanted, 1 - hold_out, advance))
