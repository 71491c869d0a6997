"""Constants of the fit of an axis: the search, drive effects, and predictions."""

from __future__ import annotations

from dataclasses import dataclass

from twin.identify.command_model import DEAD_BAND_SCAN, DeadBandScan
from twin.identify.least_squares import StepControl
from twin.identify.verdicts import HOLD_OUT, HoldOutPrediction

AXIS_STEP_CONTROL = StepControl(drops_idle=True)


@dataclass(frozen=True, kw_only=True)
class AxisSearch:
    """Constants of the fit of an axis from no first guess.

    Attributes:
        friction_guesses_m_s2: First guesses of friction.
        delay_guesses_s: First guesses of the dead time.
        lag_guesses_s: Lags that are tried instead of dead time.
        tilt_gain_m_s2: First guess of the gain per rad: between a hollow ball and a solid one.
        first_window_s: Length of the windows of the first fit, which converges from any guess.
        disturbed_residual_ratio: Residual of such a window over the usual one above which a hand,
            the rim or a false sample disturbed it: no longer window contains it.
        outlier_ratio: Residual of a sample over its window's residual above which it is left out.
        lag_steps: Steps after which only the best lags are continued: most lead to the same fit.
        continued_lags: Number of these.
        control: Constants of the minimisations.
    """

    friction_guesses_m_s2: tuple[float, ...] = (0.0, 0.02, 0.08, 0.25)
    delay_guesses_s: tuple[float, ...] = (0.02, 0.1, 0.2, 0.35)
    lag_guesses_s: tuple[float, ...] = (0.02, 0.045, 0.07, 0.1, 0.14)
    tilt_gain_m_s2: float = 6.5
    first_window_s: float = 0.8
    disturbed_residual_ratio: float = 5.0
    outlier_ratio: float = 4.0
    lag_steps: int = 4
    continued_lags: int = 2
    control: StepControl = AXIS_STEP_CONTROL


@dataclass(frozen=True, kw_only=True)
class DriveSearch:
    """Constants of the search for drive effects, and of likelihood profiles.

    Attributes:
        value_factors: Factors on the fitted value for the likelihood profile.
        interpolated_points: Values between those tried at which the costs of windows are
            interpolated.
        height_std_m: Standard deviation of a given height.
        accepted_residual_share: A drive effect is accepted if it reduces the residual to this
            share.
        rival_residual_ratio: A drive effect is a rival of the accepted one if its residual is less
            than this multiple: the two are not distinguished.
        dead_band_residual_share: A dead band is fitted if its regression leaves no more than this
            share of what an ideal drive leaves.
        fitted_dead_bands: Number of dead bands with the smallest residuals that are fitted.
        useful_cost_share: An effect whose first fits do not reduce the cost to this share is not
            fitted further: it would not reduce the residual to ``accepted_residual_share``.
        white_share: The residuals count as white if the scatter of successive ones, over the
            scatter of white ones, is above this, or is what few white ones may have by chance. It
            exceeds ``accepted_residual_share``: no drive effect would then be accepted. Of a log
            so short that chance alone allows less, a drive effect is not tried.
        white_stds: Standard deviations of that ratio below one that count as chance.
        scan_windows: Number of windows by which values of a profile are rejected in advance.
        bracket_rise: Smallest rise of the cost in any draw at which the profile of a fit with white
            residuals ends: twice the largest difference of Gumbel numbers of a lever.
        scan: Constants of that regression.
    """

    value_factors: tuple[float, ...] = (
        *(0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 1.0),
        *(1.005, 1.01, 1.02, 1.05, 1.1, 1.2),
    )
    interpolated_points: int = 200
    height_std_m: float = 0.005
    accepted_residual_share: float = 0.9
    rival_residual_ratio: float = 1.5
    dead_band_residual_share: float = 0.7
    fitted_dead_bands: int = 8
    useful_cost_share: float = 0.97
    white_share: float = 0.95
    white_stds: float = 2.0
    scan_windows: int = 20
    bracket_rise: float = 32.0
    scan: DeadBandScan = DEAD_BAND_SCAN


@dataclass(frozen=True, kw_only=True)
class PredictionFit:
    """Constants of the fit to predictions, and of a level that is followed.

    Attributes:
        level_history_s: Length of the samples from which a followed level is estimated.
        level_std_m_s2: Standard deviation of a followed level about the level of the fit.
        huber_error_m: Error of a prediction above which its cost is linear, not quadratic.
        max_delay_and_lag_s: Largest dead time and lag of this fit: above those of a fit to windows,
            for five numbers have no lag, and their dead time stands for that as well.
        initial_values: First guesses of this fit, next to those of a fit to windows.
        max_predictions: Largest number of predictions by which fits are compared.
        continued_guesses: Number of the best first guesses that are continued.
        max_evaluations: Largest number of evaluations from each.
        cost_tolerance: Relative decrease of the cost by a step below which a fit ends.
    """

    level_history_s: float = 2.4
    level_std_m_s2: float = 0.1
    huber_error_m: float = 0.003
    max_delay_and_lag_s: float = 0.7
    initial_values: tuple[tuple[str, float], ...] = (
        ("dead_time", 0.1),
        ("lag", 0.1),
        ("friction", 0.03),
    )
    max_predictions: int = 150
    continued_guesses: int = 2
    max_evaluations: int = 40
    cost_tolerance: float = AXIS_STEP_CONTROL.cost_tolerance


@dataclass(frozen=True, kw_only=True)
class AxisFitting:
    """All constants of the fit of an axis.

    Attributes:
        search: Of the fit from no first guess.
        drives: Of the search for drive effects.
        prediction: Of the fit to predictions.
        hold_out: Of the predictions.
    """

    search: AxisSearch = AxisSearch()
    drives: DriveSearch = DriveSearch()
    prediction: PredictionFit = PredictionFit()
    hold_out: HoldOutPrediction = HOLD_OUT


AXIS_FITTING = AxisFitting()
