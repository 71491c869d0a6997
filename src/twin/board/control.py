"""What a controller in C is made of."""

from typing import NamedTuple

from controllers.interfaces import ControlLaw, Observer, Reference
from twin.hal.interface import Limits


class Control(NamedTuple):
    """What a controller in C is made of.

    Attributes:
        title: What comments call it.
        law: The law.
        observer: The observer, or a predictor around it.
        reference: The reference.
        limits: Limits of the commands.
        period: Control period in s.
        duration: How long a reference without a closed form is tabled, s.
        start: Where the ball begins, m.
    """

    title: str
    law: ControlLaw
    observer: Observer
    reference: Reference
    limits: Limits
    period: float
    duration: float
    start: tuple[float, float]
