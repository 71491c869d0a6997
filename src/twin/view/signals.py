"""The time plots of a run: which signals, in which units, grouped as a control engineer reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from twin.data_file import read_toml
from twin.hal.interface import Limits
from twin.run.finished import states_of

Colour = tuple[int, int, int]

# Okabe and Ito's colours: told apart with any colour vision.
WORDS: dict[Colour, str] = {
    (0, 114, 178): "blue",
    (213, 94, 0): "orange",
    (0, 158, 115): "green",
    (204, 121, 167): "pink",
    (230, 159, 0): "gold",
    (86, 180, 233): "light blue",
    (150, 150, 150): "grey",
    (235, 235, 235): "white",
}
"""What a person calls these, on the dark ground of the viewer."""
BLUE, VERMILION, GREEN, PINK, ORANGE, SKY, GREY, BLACK = WORDS


AXES = ("phi", "theta")
ROOM = 0.05
"""Room above and below the lines of a plot, as a share of its height."""
LEAST = 0.05
"""Least half of the height of a plot, in its unit."""


@dataclass(frozen=True)
class Signal:
    """One line of a plot: its values (K,), colour, width, and whether it is drawn as points."""

    values: Array
    colour: Colour
    width: float = 1.5
    points: bool = False


RUNS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
"""The colours of runs that are shown together."""


def tinted(plot: Mapping[str, Signal], run: int) -> dict[str, Signal]:
    """The lines of a plot in shades of one run's colour; what is no run's own keeps its colour."""
    found = {}
    shade = 0
    for name, signal in plot.items():
        if name == "reference" or name.startswith("limit"):
            found[name] = signal
            continue
        share = (0.0, 0.35, 0.6)[shade % 3]
        red, green, blue = (round(c + share * (255 - c)) for c in RUNS[run % len(RUNS)])
        found[name] = replace(signal, colour=(red, green, blue))
        shade += 1
    return found


PLOTS: dict[str, dict[str, str]] = read_toml(Path(__file__).with_name("plots.toml"))
"""Entity of each plot and its title with the unit, by the tab it stands in."""

FORCES = (
    ("wheel_force_N", "wheel_", "_N"),
    ("ball_force_N", "ball_", "_N"),
    ("torque_Nm", "torque_", "_Nm"),
)
"""Group, and how the names of its columns begin and end."""


BEYOND = (
    ("friction_mm_per_s2", 1000.0, ("friction", "disturbance_x", "disturbance_y")),
    ("tilt_gain_percent", 100.0, ("tilt_gain_x", "tilt_gain_y")),
)
"""Group, factor to its unit, and what an observer may estimate beyond the state."""


def signals(
    rows: Mapping[str, Array], reference: Array, limits: Limits, dead_time: float = 0.0
) -> dict[str, dict[str, Signal]]:
    """Group entity to its signals by name.

    Args:
        rows: Recorded columns, (K,) each.
        reference: Desired ball position in m, shape (K, 2).
        limits: Limits of the rig's commands.
        dead_time: Dead time of the simulated screen, s.
    """
    state = states_of(rows)
    true = "true_x" in rows
    found: dict[str, dict[str, Signal]] = {}
    error = 1000 * (reference - state[:, 0::4])
    for axis, name in enumerate("xy"):
        plot = {}
        touched = np.where(rows.get("touched", 1.0) > 0, rows[f"measured_{name}"], np.nan)
        if true:
            plot["ball"] = Signal(1000 * state[:, 4 * axis], BLUE, 2.0)
        plot["estimate"] = Signal(1000 * rows[f"estimated_{name}"], ORANGE, 1.5)
        plot["measured"] = Signal(1000 * touched, GREY, 1.0)
        plot["reference"] = Signal(1000 * reference[:, axis], BLACK, 1.0)
        found[f"position_{name}_mm"] = plot
    found["error_mm"] = {
        "distance": Signal(np.hypot(*error.T), GREY, 1.0),
        **_lines("xy", error.T),
    }
    angles, rates = np.degrees(state[:, 2::4].T), np.degrees(state[:, 3::4].T)
    most = np.full(len(state), np.degrees(limits.angle))
    ends = {"limit_high": Signal(most, PINK, 0.8), "limit_low": Signal(-most, PINK, 0.8)}
    found["angle_deg"] = _lines(AXES, angles) | ends
    found["rate_deg_per_s"] = _lines(AXES, rates)
    found["effort_rad_per_s2"] = _effort(rows)
    if true:
        wrong = 1000 * (state[:, 0::4] - _pair(rows, "estimated_{}", "xy"))
        found["estimation_error_mm"] = _lines("xy", wrong.T)
    for entity, factor, parts in BEYOND:
        if all(f"estimated_{name}" in rows for name in parts):
            found[entity] = _lines(parts, [factor * rows[f"estimated_{name}"] for name in parts])
    if "age" in rows:
        found["delay_ms"] = {
            "age": Signal(1000 * rows["age"], GREEN),
            "dead_time": Signal(np.full(len(state), 1000 * dead_time), PINK, 0.8),
        }
    for entity, beginning, unit in FORCES:
        names = [name for name in rows if name.startswith(beginning) and name.endswith(unit)]
        if names:
            called = [name.removesuffix(unit) for name in names]
            found[entity] = _lines(called, [rows[name] for name in names])
    late = [name for name in rows if name.startswith(("late", "compute", "tick_"))]
    if late:
        found["timing_ms"] = _lines(late, [1000 * rows[name] for name in late])
    return found


def explained(plots: Sequence[Mapping[str, Signal]], names: Sequence[str]) -> str:
    """Which line of a plot has which colour, in words.

    Args:
        plots: The lines of each run; none of one that has no such plot.
        names: What the runs are called.
    """
    if len(plots) > 1:
        own = [i for i, plot in enumerate(plots) if plot]
        words = [f"{names[i]} {WORDS[RUNS[i % len(RUNS)]]}" for i in own]
        second = [f"{name} lighter" for name in ("theta", "y") if name in plots[own[0]]]
        return ", ".join(words if "distance" in plots[own[0]] else words + second)
    lines = {name: signal for name, signal in plots[0].items() if not name.endswith("_low")}
    return ", ".join(
        f"{name.removesuffix('_high').replace('_', ' ')} {WORDS[signal.colour]}"
        for name, signal in lines.items()
        if not name.endswith("_saturated")
    )


def shown_range(plots: Sequence[Mapping[str, Signal]]) -> tuple[float, float]:
    """What the axis of a plot of one or several runs shows: its lines, but not their limits.

    Of several runs the tracking error is drawn as a distance alone.
    """
    only = "distance" if len(plots) > 1 and "distance" in plots[0] else ""
    lines = [
        signal.values[np.isfinite(signal.values)]
        for plot in plots
        for name, signal in plot.items()
        if not name.startswith("limit") and only in ("", name)
    ]
    values = np.concatenate([*lines, np.zeros(0 if any(map(len, lines)) else 1)])
    low, high = float(values.min()), float(values.max())
    room = max(ROOM * (high - low), LEAST - (high - low) / 2)
    return low - room, high + room


def _effort(rows: Mapping[str, Array]) -> dict[str, Signal]:
    """Applied accelerations, and a mark where a clamp made them less than requested."""
    applied = _pair(rows, "applied_{}_acc", AXES)
    requested = _pair(rows, "requested_{}_acc", AXES)
    cut = np.abs(applied - requested) > 1e-6 + 1e-6 * np.abs(requested)
    plot = _lines(AXES, applied.T)
    for axis, (name, colour) in enumerate(((AXES[0], SKY), (AXES[1], ORANGE))):
        marks = np.where(cut[:, axis], applied[:, axis], np.nan)
        plot[f"{name}_saturated"] = Signal(marks, colour, 3.0, points=True)
    return plot


def _pair(rows: Mapping[str, Array], pattern: str, names: str | tuple[str, str]) -> Array:
    return np.stack([rows[pattern.format(name)] for name in names], axis=1)


def _lines(names: Sequence[str], values: Sequence[Array] | Array) -> dict[str, Signal]:
    """Lines of a plot, each in the next colour; no more than there are colours."""
    colours = (BLUE, VERMILION, GREEN, PINK)
    return {n: Signal(v, colour) for n, v, colour in zip(names, values, colours, strict=False)}
