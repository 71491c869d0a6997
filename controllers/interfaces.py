"""Interfaces of law, observer, reference and measurement; everything else builds on these.

Every array ends in its vector axis and may have any number of leading axes, one entry a rig:
``State`` (..., 8), ``Output`` (..., 4), ``Input`` (..., 2); their docstrings in
``controllers.arrays`` give order, units, signs and frames. SI units throughout.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

import numpy as np

from controllers.arrays import (
    Array,
    Input,
    Mask,
    NotNegative,
    Output,
    Positive,
    State,
    check,
)
from controllers.ballplate import BallPlate

Constants = TypeVar("Constants")
Numbers = TypeVar("Numbers")
_NO_SETTING = "no_setting"
"""Mark in the metadata of a field that no scenario may write."""
_ENTRIES = "entries"
"""Place of the ``Entries`` in the metadata of a field."""


class Entries(NamedTuple):
    """Meaning of the single numbers of a setting that is a list of them.

    Attributes:
        names: Name of each; empty where they have none.
        along_x: So many of them, the first, are of x and phi, and the others of y and theta; None
            where each is of both axes.
    """

    names: tuple[str, ...] = ()
    along_x: int | None = None


def with_entries(default: Numbers, *names: str, along_x: int | None = None) -> Numbers:
    """A field of a law or observer that is a list of numbers, with their meaning."""
    return field(default=default, metadata={_ENTRIES: Entries(names, along_x)})


def entries_of(setting: Field[Any]) -> Entries:
    """Meaning of the single numbers of a setting; none if it states none."""
    found: Entries = setting.metadata.get(_ENTRIES, Entries())
    return found


def algorithm_constants(default: Constants) -> Constants:
    """A field of a law or observer for the constants of an algorithm, a frozen dataclass.

    Tests and studies pass other constants as an argument; no scenario may write them.
    """
    return field(default=default, repr=False, metadata={_NO_SETTING: True})


def catalog_settings(cls: type) -> list[Field[Any]]:
    """The fields of a law, observer or reference that a scenario may write."""
    given = {
        item.name
        for base in (Law, Observer, DelayedObserver)
        if issubclass(cls, base)
        for item in fields(base)
    }
    return [
        item
        for item in fields(cls)
        if item.init and item.name not in given and _NO_SETTING not in item.metadata
    ]


class Measurement(NamedTuple):
    """Measurement that a rig hands over once a control period, simulated or real.

    Attributes:
        time: Seconds since the run started.
        y: x, phi, y, theta; the ball in m in plate axes, the plate in rad; shape (..., 4).
        age: Seconds since the ball position arrived, shape (...,).
        touched: Whether the screen feels the ball, shape (...,).
        state: The full state, shape (..., 8), from a simulated rig with ideal sensors; else None.
    """

    time: float
    y: Output
    age: Array
    touched: Mask
    state: State | None = None


class Reference(ABC):
    """A path of the ball that may be asked at any time, ahead too.

    A subclass is a frozen dataclass. Its fields are its settings: the names a scenario may write
    under ``[reference]``.
    """

    name: ClassVar[str]
    """Name of the reference in a scenario."""
    lengths: ClassVar[tuple[str, ...]] = ()
    """Settings in m; a rig with a smaller operating area makes them smaller."""

    def __post_init__(self) -> None:
        """Check the ranges of the settings."""
        check(self)

    @abstractmethod
    def __call__(self, t: float | Array) -> Array:
        """Position and four time derivatives of the desired ball position.

        Args:
            t: Time in s, a number or an array of any shape.

        Returns:
            Shape (5, *shape(t), 2): derivative order first, then time, then the axes x and y;
            in m, m/s, m/s^2, m/s^3, m/s^4. A reference of N rigs that differ has N before the
            last axis.
        """


class Quantity(NamedTuple):
    """Something an observer estimates beyond the state; a record has it as ``estimated_NAME``."""

    name: str
    unit: str


class Feedback(NamedTuple):
    """All that a law may act on at a tick; most need no more than ``Law.control`` is given.

    Attributes:
        time: Seconds since the run started.
        x: Estimated state, shape (..., 8).
        equivalent: The same with the plate angles and rates that would move a ball without
            friction on a level plate alike, shape (..., 8); x of an observer that knows neither.
        needed: The quantities beyond x that the law ``needs``, in that order, then those that it
            ``counts`` if the observer knows them, (..., len(needs) or more).
        rate: Plate rates the rig commanded last, after its clamps, rad/s, shape (..., 2).
        requested: Plate rates requested last, rad/s, shape (..., 2).
        reference: The path to follow; asked ahead with an array of times.
        memory: The law's memory q, shape (..., memory).
        plan: What the law's ``start`` returned.
        measurement: What the rig measured now, for a law with an observer of its own; None where a
            law is asked without a rig.
    """

    time: float
    x: State
    equivalent: State
    needed: Array
    rate: Array
    requested: Array
    reference: Reference
    memory: Array
    plan: Any = None
    measurement: Measurement | None = None

    @property
    def clamped(self) -> Mask:
        """Whether a clamp of the rig changed what was requested last, shape (..., 2)."""
        return np.abs(self.rate - self.requested) > 1e-9


@dataclass(frozen=True, kw_only=True)
class Law(ABC):
    """A state feedback law u = control(t, x, reference, q) with optional memory q.

    A subclass is a frozen dataclass. Its fields are its settings: the names a scenario may write
    under ``[controller]``. ``model`` is given by whoever builds the law. One that acts on more than
    the state, or plans ahead, overrides ``command`` and ``start``.
    """

    name: ClassVar[str]
    """Name of the law in a scenario."""
    memory: ClassVar[int] = 0
    """Length of q, the law's own integrator states; 0 for a static law."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Names of the quantities beyond the state without which the law cannot work."""
    counts: ClassVar[tuple[str, ...]] = ()
    """Names of further ones that it counts where an observer knows all of them."""
    replans: ClassVar[bool] = False
    """Whether its plan follows when the path ahead changes."""
    replaces: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({})
    """Setting to those that it stands in place of; a change to either side drops the other."""

    model: BallPlate = field(default_factory=BallPlate, repr=False)
    """The model the law is designed on."""

    def __post_init__(self) -> None:
        """Check the ranges of the settings."""
        check(self)

    def control(self, t: float, x: State, reference: Reference, q: Array) -> Input:
        """Plate accelerations u = (phi'', theta'') in rad/s^2, shape (..., 2).

        A law that overrides ``command`` may leave it out; it then has no linearisation.

        Args:
            t: Time in s.
            x: State or its estimate, shape (..., 8).
            reference: The path to follow.
            q: The law's memory, shape (..., memory).

        Raises:
            NotImplementedError: If the law acts by ``command`` alone.
        """
        raise NotImplementedError(f"law '{self.name}' acts by command alone")

    def memory_rate(self, t: float, x: State, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory q, shape (..., memory)."""
        return np.zeros_like(q)

    def start(self, x: State, reference: Reference, period: float) -> Any:
        """Work out a plan before the run; it is handed back with every ``Feedback``.

        A law has no state of its own, so that one may drive many runs: its plan is the run's.

        Args:
            x: First estimate, shape (..., 8).
            reference: The path to follow.
            period: Control period in s.
        """
        return None

    def replanned(self, plan: Any, t: float, x: State, reference: Reference, period: float) -> Any:
        """The plan of a law that takes over a run under way; by default the plan of its start.

        Args:
            plan: What ``start`` returned.
            t: Time in s at which it takes over.
            x: Estimate of then, shape (..., 8).
            reference: The path to follow.
            period: Control period in s.
        """
        return plan

    def command(self, now: Feedback) -> Input:
        """Plate accelerations u in rad/s^2, shape (..., 2), from all there is to act on.

        By default ``control`` of the equivalent state.
        """
        return self.control(now.time, now.equivalent, now.reference, now.memory)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the law with these settings for a report, in whole sentences."""
        return ()


class ControlLaw(Protocol):
    """What a controller and an analysis need of a law: a `Law`, or one around other laws."""

    @property
    def name(self) -> str:
        """Its name in messages."""

    @property
    def memory(self) -> int:
        """Length of the memory q."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the quantities beyond the state that it needs."""

    @property
    def counts(self) -> tuple[str, ...]:
        """Names of further ones that it counts where an observer knows all of them."""

    @property
    def model(self) -> BallPlate:
        """The model on which it is designed."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks for a report, in whole sentences."""

    def control(self, t: float, x: State, reference: Reference, q: Array) -> Input:
        """Plate accelerations u in rad/s^2, shape (..., 2), without a plan."""

    def start(self, x: State, reference: Reference, period: float) -> Any:
        """The plan of a run."""

    def replanned(self, plan: Any, t: float, x: State, reference: Reference, period: float) -> Any:
        """The plan of a law that takes over a run under way."""

    def command(self, now: Feedback) -> Input:
        """Plate accelerations u in rad/s^2, shape (..., 2)."""

    def memory_rate(self, t: float, x: State, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory q, shape (..., memory)."""


@dataclass(kw_only=True)
class Observer(ABC):
    """A state estimator at the control period: ``start``, then ``correct``, ``predict`` a tick.

    A subclass is a dataclass. Its fields are its settings, the names a scenario may write under
    ``[observer]``; ``model`` and ``period`` are given by whoever builds it.
    """

    name: ClassVar[str]
    """Name of the observer in a scenario."""
    knows: ClassVar[tuple[Quantity, ...]] = ()
    """Quantities that it estimates beyond the state."""

    model: BallPlate = field(default_factory=BallPlate, repr=False)
    """The model the observer is designed on."""
    period: Positive = 0.002
    """Control period in s."""

    x: Array = field(init=False, repr=False)
    """The present estimate, shape (..., 8)."""

    def __post_init__(self) -> None:
        """Check the ranges of the settings."""
        check(self)

    def start(self, x: State) -> None:
        """Begin at the state x, shape (..., 8)."""
        self.x = np.array(x, dtype=np.result_type(x, float), subok=True)

    @abstractmethod
    def correct(self, measurement: Measurement) -> State:
        """Take in a measurement and return the estimate at its time, shape (..., 8)."""

    @abstractmethod
    def predict(self, u: Input) -> None:
        """Carry the estimate one period ahead under the applied input u, shape (..., 2)."""

    @property
    def further(self) -> Array:
        """Estimates of the quantities ``knows``, in that order, shape (..., len(knows))."""
        return self.x[..., :0]

    @property
    def equivalent(self) -> State:
        """The estimate as ``Feedback.equivalent`` has it, shape (..., 8)."""
        return self.x


@dataclass(kw_only=True)
class DelayedObserver(Observer):
    """An observer that makes up for the dead time of the ball's position itself.

    It takes the place of a predictor, which must not be put around it.
    """

    delay: NotNegative = 0.0
    """Dead time of the ball's position in s; given by whoever builds the observer."""
    needed: tuple[str, ...] = ()
    """What the law behind it ``needs``, given likewise; the estimate may leave out what else is
    found."""
