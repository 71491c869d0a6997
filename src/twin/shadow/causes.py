"""Why reality has left the model: hypotheses, weighed by what the log says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.shadow.belief import PARAMETERS, TABLES, Belief
from twin.shadow.plate import GAPS

CAUSES: dict[str, dict[str, float]] = TABLES["causes"]
"""What each may change, by how much (standard deviation, rolling friction relative, else SI)."""
LEAST = 0.05
"""Probability below which a cause counts as ruled out."""


@dataclass(frozen=True)
class Cause:
    """A hypothesis and how probable it is, all of them being equally likely beforehand.

    Attributes:
        name: What has changed.
        probability: 0 to 1.
        change: By how much, in words.
    """

    name: str
    probability: float
    change: str

    def as_dict(self) -> dict[str, str | float]:
        """For ``--json``."""
        return {"name": self.name, "probability": self.probability, "change": self.change}


def changes(belief: Belief) -> Array:
    """Covariance of what each cause changes, shape (H, P, P)."""
    sizes = np.array([[sizes.get(p, 0.0) for p in PARAMETERS] for sizes in CAUSES.values()])
    variances = (belief.unit * sizes) ** 2
    return np.asarray(variances[..., None] * np.eye(len(PARAMETERS)))


def likely(causes: Sequence[Cause]) -> list[Cause]:
    """Those that cannot be ruled out; of more than one it is not told which it is."""
    return [each for each in causes if each.probability >= LEAST]


def in_words(causes: Sequence[Cause]) -> str:
    """What has changed, or between what the log does not tell."""
    left = likely(causes)
    if len(left) == 1:
        return f"{left[0].name} ({left[0].change})"
    names = [f"{each.name} ({each.change}; {100 * each.probability:.0f} %)" for each in left]
    return f"not told apart: {', '.join(names[:-1])} or {names[-1]}"


def words_of(name: str, moved: Array, belief: Belief) -> str:
    """The size of a change in words.

    Args:
        name: Of the cause.
        moved: Change of the parameters, shape (P,).
        belief: What held before.
    """
    at = {p: float(moved[PARAMETERS.index(p)]) for p in CAUSES[name]}
    if name == "lost motion":
        gap = sum(share * width for share, width in zip(at.values(), GAPS, strict=True))
        return f"{np.degrees(gap):+.2f} deg"
    parts = [
        _in_words(p, v / belief.values["rolling"] if p == "rolling" else v) for p, v in at.items()
    ]
    if name == "another ball":
        return f"tilt gain {parts[0]}, rolling friction {parts[1]}"
    return ", ".join(parts)


def _in_words(parameter: str, value: float) -> str:
    """A change of a parameter in words, that of the rolling friction as a share."""
    about = TABLES["parameters"][parameter]
    size = np.exp(value) if parameter == "noise" else about["factor"] * value
    text: str = about["words"].format(size)
    return text


def one_sided(belief: Belief) -> list[str]:
    """Parameters that can only have grown, since they are believed to be at their least."""
    least = {
        "breakaway": belief.values["breakaway"] <= 1,
        "lag": belief.lag <= 0,
        "narrow_play": belief.play <= 0,
        "wide_play": belief.play <= 0,
    }
    return [name for name, there in least.items() if there]
