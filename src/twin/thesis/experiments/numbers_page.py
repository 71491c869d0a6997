"""What the explanation of chapter 9 rests on, as sections of its page."""

from __future__ import annotations

import math

from controllers.observers.kalman import NOISE
from twin.markdown import table
from twin.sim.encoders import COUNTS
from twin.thesis.experiments import instruments
from twin.thesis.experiments.explained import stored
from twin.thesis.experiments.explanation import PARAMETERS


def defaults() -> list[str]:
    """What the thesis tells of its encoders and of its "disturbance"."""
    printed, own = instruments.printed_ratio(), instruments.own_ratio()
    soon, late = instruments.turned(1.0), instruments.turned(10.0)
    known = math.degrees(math.sqrt(NOISE[1]))
    return [
        "## Encoders and 'disturbance': two defaults of the twin\n",
        f"- **Plate encoders of {COUNTS} counts a turn.** The 48 printed plate angles are "
        f"{instruments.off_counts(COUNTS):.3f} counts from whole ones, as much as printing four "
        f"digits rounds; with 16384 (4096 pulses, fourfold) they are "
        f"{instruments.off_counts(16384):.2f} off, with any smaller number 0.03 or more. 245760 is "
        "15 times 16384: gears or interpolation between disc and counter.",
        "- **No disturbance.** What Table B.1 calls one is the variance of *control efforts* in a "
        "static state (caption of Fig. B.3). Their deviations are "
        f"{printed[0]:.1f} and {printed[1]:.1f} times those of the touch screen on x and y; LQR "
        f"(100, 0.1) behind observer (8.1) at 2 ms answers the screen's white noise with "
        f"{own[0]:.1f} and {own[1]:.1f} times. So it is the controller's output, and a twin that "
        "adds it to its own controller's counts it twice. A real one could not hide either: on "
        f"drives that follow rates it would turn a plate at rest by {soon[0]:.3f} deg in 1 s and "
        f"{late[0]:.2f} deg in 10 s, and Table B.1 found {known:.4f} deg. The other reading is "
        "`disturbance.variance = [1.0816e-4, 2.8090e-5]`; the thesis's own simulations of chapter "
        "8 had it, and `ballplate reproduce` has it there.\n",
    ]


def parameters() -> list[str]:
    """The numbers that are fitted."""
    known = stored()
    lines = []
    for name, about in PARAMETERS.items():
        folds = [fold[name] for fold in known["without"].values()]
        each = known["estimates"][name]
        lines.append(
            (
                name.replace("_", " "),
                f"{known['all'][name]:.4g}",
                f"{each['low']:.3g} to {each['high']:.3g}",
                f"{min(folds):.3g} to {max(folds):.3g}",
                about.unit or "1",
                each["verdict"],
            )
        )
    head = ("number", "value", "95 %, bootstrap", "without one table", "unit", "verdict")
    names = list(PARAMETERS)
    pairs = [
        (abs(value), f"{names[i]} and {names[j]} {value:+.2f}".replace("_", " "))
        for i, line in enumerate(known["correlation"])
        for j, value in enumerate(line[:i])
    ]
    ends = [each["chi2"] for each in known["searches"].values()]
    return [
        "## The four numbers\n",
        table(head, lines),
        f"Largest correlations: {', '.join(text for _, text in sorted(pairs)[::-1][:3])}. "
        f"{len(ends)} searches with different random numbers ended at chi-squared "
        f"{', '.join(f'{end:.1f}' for end in ends)} of 124 numbers; scales: 2 points, 0.35 in the "
        "logarithm of a maximum, and for Table 9.1 6 mm, 2 %, 0.2 and 0.1. They were chosen near "
        "what remains, so chi-squared compares models and tests none.\n",
    ]
