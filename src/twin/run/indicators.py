"""The units of the indicators of a run; nothing heavy is imported with them."""

UNITS = {
    "outcome_time": "s",
    "tracking_error_percent": "%",
    "rms_error": "m",
    "mean_error": "m",
    "max_steady_error": "m",
    "rms_distance": "m",
    "overshoot_percent": "%",
    "settling_time": "s",
    "steady_error": "m",
    "phi_max_deg": "deg",
    "theta_max_deg": "deg",
    "u1_max": "rad/s^2",
    "u2_max": "rad/s^2",
    "u_rms": "rad/s^2",
    "judged_from": "s",
    "real_time_factor": "1",
}
"""Unit of every indicator as JSON has it."""
LEFT = ("fell", "lost", "diverged")
"""Endings after which no error is told: that of a ball that is gone would flatter its run."""
