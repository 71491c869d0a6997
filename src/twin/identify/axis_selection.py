"""Constants of the choice of windows and model of a fit of an axis."""

from __future__ import annotations

from dataclasses import dataclass

from twin.identify.axis_fitting import AXIS_FITTING, AxisFitting


@dataclass(frozen=True, kw_only=True)
class AxisSelection:
    """Constants of the choice of windows and model of a fit of an axis.

    Attributes:
        window_s: Length of the windows.
        min_windows: Smallest number of windows of this length; with fewer they are shorter.
        least_window_s: Smallest length of the windows where they are shortened: between end stops,
            or where too few windows of ``window_s`` are without a gap.
        shorter_window_shares: Lengths of the windows of further fits, as shares of it: a model
            error shows as a different value there.
        optional_parameters: Fitted if they reduce the prediction error, unless requested.
        accepted_error_share: A parameter is accepted if it reduces the error of cross-validation to
            this share.
        max_compared_s: Longest part of a log by which models are compared.
        min_term_stds: Standard deviations of a parameter from zero below which it is not tried.
        accepted_drive_error_share: The same for dead band, play or slew: a hand resembles them.
        max_drive_error_m: Accept dead band, play or slew only below this error: a touched plate, or
            a ball that sticks, resembles them.
        conditional_scatter_share: Share of the scatter of a parameter above which it is known only
            together with a parameter that is not fitted.
        bound_probability: Share of the bootstrap draws that a bound contains.
        pause_between_logs_s: Pause put between two logs that are fitted as one.
        earlier_commands_s: Time for which commands before a log or a pause may move the ball: its
            samples are left out.
        fitting: Constants of the fits.
    """

    window_s: float = 2.5
    min_windows: int = 3
    least_window_s: float = 0.3
    shorter_window_shares: tuple[float, ...] = (0.5, 0.32)
    optional_parameters: tuple[str, ...] = ("camber", "viscous")
    accepted_error_share: float = 0.9
    max_compared_s: float = 75.0
    min_term_stds: float = 3.0
    accepted_drive_error_share: float = 0.8
    max_drive_error_m: float = 0.01
    conditional_scatter_share: float = 0.5
    bound_probability: float = 0.95
    pause_between_logs_s: float = 10.0
    earlier_commands_s: float = 0.5
    fitting: AxisFitting = AXIS_FITTING


AXIS_SELECTION = AxisSelection()
DELAYS_S = {True: (0.0, 0.5), False: (-0.1, 0.5)}
"""Smallest and largest dead time of commands, and of angles that are measured."""
