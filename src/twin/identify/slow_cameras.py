"""Lengths of windows for cameras so slow that the usual windows have too few samples.

At more than 20 samples per second all lengths stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from twin.identify.axis_selection import AXIS_SELECTION, AxisSelection
from twin.identify.weak_form import WEAK_FORM, WeakForm


@dataclass(frozen=True, kw_only=True)
class MinSamples:
    """Samples that lengths have at least.

    Attributes:
        window: Windows of a fit.
        first_window: Windows of its first fit.
        least_window: Shortened windows.
        lead: What a prediction starts from.
        baseline: The same of a ball that stays or goes on.
        horizon_tolerance: Between a horizon and the sample that stands for it.
        plain_windows: Windows of any motion of a first look.
    """

    window: float = 20
    first_window: float = 8
    least_window: float = 6
    lead: float = 5
    baseline: float = 3
    horizon_tolerance: float = 0.6
    plain_windows: tuple[float, ...] = (12, 8)


MIN_SAMPLES = MinSamples()


def scale_to_samples(step_s: float, selection: AxisSelection) -> tuple[AxisSelection, WeakForm]:
    """The constants of a fit and of a first look with lengths that have enough samples.

    Args:
        step_s: Usual time between two samples.
        selection: The constants of the fit.
    """
    return scale_selection(step_s, selection), scale_weak_form(step_s)


def scale_selection(
    step_s: float, selection: AxisSelection = AXIS_SELECTION, least: MinSamples = MIN_SAMPLES
) -> AxisSelection:
    """The constants of a fit with lengths that have enough samples.

    Args:
        step_s: Usual time between two samples.
        selection: The constants.
        least: Samples that the lengths have at least.
    """
    fitting = selection.fitting
    search, hold_out = fitting.search, fitting.hold_out
    search = replace(search, first_window_s=max(search.first_window_s, least.first_window * step_s))
    hold_out = replace(
        hold_out,
        lead_s=max(hold_out.lead_s, least.lead * step_s),
        baseline_s=max(hold_out.baseline_s, least.baseline * step_s),
        horizon_tolerance_s=max(hold_out.horizon_tolerance_s, least.horizon_tolerance * step_s),
    )
    return replace(
        selection,
        window_s=max(selection.window_s, least.window * step_s),
        least_window_s=max(selection.least_window_s, least.least_window * step_s),
        fitting=replace(fitting, search=search, hold_out=hold_out),
    )


def scale_weak_form(
    step_s: float, form: WeakForm = WEAK_FORM, least: MinSamples = MIN_SAMPLES
) -> WeakForm:
    """The constants of a first look with windows that have enough samples.

    Windows of a ball that rolls in one direction stay brief: long ones have no damping, which acts
    on a ball that rolls for long.

    Args:
        step_s: Usual time between two samples.
        form: The constants.
        least: Samples that the windows have at least.
    """
    pairs = zip(form.plain_windows_s, least.plain_windows, strict=True)
    return replace(form, plain_windows_s=tuple(max(s, n * step_s) for s, n in pairs))
