"""Belief of the twin about a rig: its parameters, and how certain they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.base.data_file import read_toml
from twin.base.errors import LogError
from twin.base.settings import from_scenarios
from twin.identify.axis_logs import AnyLog
from twin.identify.balls import ball_inertia
from twin.identify.logs import Log, of_columns
from twin.identify.prepare import prepare
from twin.identify.twin_fit import TwinProblem
from twin.identify.windows import Windows
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario.load import check, load_recorded, read, resolve
from twin.scenario.merging import put, setting
from twin.scenario.schema import Scenario
from twin.sim.drives import DriveModel
from twin.sim.plant.friction import Friction
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission import TransmissionError

BALL_BELIEFS = ("rolling", "breakaway", "delay", "level_phi", "level_theta", "gain")
"""Parameters that the ball's motion shows."""
DRIVE_BELIEFS = ("lag", "narrow_play", "wide_play", "transmission")
"""Parameters that the plate's motion shows: time constant in s, shares of lost motion as a narrow
and a wide gap would make it, and how much farther than commanded the plate turns."""
WATCHED_PARAMETERS = (*BALL_BELIEFS, *DRIVE_BELIEFS, "noise")
"""All; the last is the logarithm of the screen's noise over what is believed."""

FRICTION_EXTRAS = ("viscous", "stribeck", "dwell")
"""Further parameters of the friction, believed but not watched."""
FRICTION_FIELDS = {
    "rolling": "rolling",
    "breakaway": "breakaway_ratio",
    "viscous": "viscous",
    "stribeck": "stribeck_speed",
    "dwell": "dwell_time",
}
"""Parameters that are settings of the friction, by their names there."""
BELIEF_TABLES = read_toml(Path(__file__).with_suffix(".toml"))
"""Prior of parameters and causes; the file explains its entries."""
TWIN_ERROR_STD, ROLLING_SCATTER_STD, STOPPING_SCATTER_STD, DRIFT_STD = (
    {name: float(about[kind]) for name, about in BELIEF_TABLES["parameters"].items()}
    for kind in ("constant", "changing", "stopping", "drift")
)
"""Standard deviations of what an identified twin may be wrong by; of what differs from one window
to the next while the ball rolls, and where it stops; of what changes in minutes: rolling relative,
else SI."""

OPEN_STD = np.array([BELIEF_TABLES["parameters"][name]["open"] for name in WATCHED_PARAMETERS])
"""Standard deviations of what a log may leave open of a twin."""
CAUSE_SIZES: dict[str, dict[str, float]] = BELIEF_TABLES["causes"]
"""What each may change, by how much (standard deviation, rolling friction relative, else SI)."""
UNEVEN_DELAY, UNEVEN_GAIN = 0.05, 0.15
"""Apparent change of the dead time in s, and of the tilt gain as a share, on a screen as uneven as
its friction is large: the drives answer the screen's effect on the ball one dead time later."""
MIN_UNEVENNESS = 0.001
"""Share of the rolling friction that differs from place to place where it is held to be even."""


@dataclass(frozen=True)
class Belief:
    """The twin of one rig.

    Attributes:
        scenario: What was or is believed, as a scenario.
        model: The ball.
        values: Ball parameters in SI units by their name in ``identify``.
        lag: Time constant in s of the drives.
        own_lag: Lag in s of the twin's own drives without a bandwidth limit.
        play: Width in rad of the gap in the drives, as plate angle.
        turned: How far the plate turns over how far it is commanded to, phi and theta, shape (2,).
        grip: Time in s within which friction stops a ball, see ``replay``.
        screen: Variance of a sample along x and y in m^2, shape (2,).
        encoders: Variance of a reading of phi and theta in rad^2, shape (2,).
        disturbance: Variance of a period's acceleration of the plate, (rad/s^2)^2, shape (2,).
        unit: Unit of each parameter; ``constant`` and the sizes of causes are multiples, (P,).
        constant: Standard deviations of ``PARAMETERS`` over a whole log, shape (P,).
        changing: The same from window to window, while the ball rolls and where it stops,
            shape (2, P).
        uneven: The part of it that an uneven screen makes, shape (P,).
        drift: The same of what changes in the course of minutes on a healthy rig, shape (P,).
        rough: Standard deviation in m/s^2 of the braking that is unknown from place to place.
        sloped: The same of what the screen's slope does, which acts in any direction.
    """

    scenario: Scenario
    model: BallPlate
    values: Mapping[str, float]
    lag: float
    own_lag: float
    play: float
    turned: Array
    grip: float
    screen: Array
    encoders: Array
    disturbance: Array
    unit: Array
    constant: Array
    changing: Array
    uneven: Array
    drift: Array
    rough: float
    sloped: float

    @classmethod
    def of(cls, scenario: Scenario, log: Log | Belief) -> Belief:
        """The twin that a scenario describes, for a log.

        Args:
            scenario: The belief.
            log: Gives what of the plant follows from its kind alone; so does a different twin.
        """
        friction = from_scenarios(Friction, [scenario])
        touch, encoders = (
            from_scenarios(TouchModel, [scenario]),
            from_scenarios(EncoderModel, [scenario]),
        )
        drives = from_scenarios(DriveModel, [scenario])
        surface = scenario.plant.surface
        level = np.radians(scenario.plant.level_deg)
        values = {
            **{
                name: float(np.ravel(getattr(friction, key))[0])
                for name, key in FRICTION_FIELDS.items()
            },
            "delay": float(np.ravel(touch.dead_time)[0]),
            "level_phi": float(level[0]),
            "level_theta": float(level[1]),
            "gain": 1.0,
        }
        grid = float(np.ravel(touch.grid)[0])
        pitch = np.divide(touch.size, grid) if grid else np.zeros(2)
        counts = float(np.ravel(encoders.counts)[0])
        count = 2 * np.pi / counts if counts else 0.0
        scale = np.array(
            [values["rolling"] if name == "rolling" else 1.0 for name in WATCHED_PARAMETERS]
        )
        # a window crosses a few patches of an uneven screen, which average out in part
        uneven = np.array(
            [
                {
                    "rolling": surface.spread_percent / 200,
                    "delay": UNEVEN_DELAY * surface.spread_percent / 100,
                    "gain": UNEVEN_GAIN * surface.spread_percent / 100,
                    "level_phi": np.radians(surface.slope_deg) / 2,
                    "level_theta": np.radians(surface.slope_deg) / 2,
                }.get(name, 0.0)
                for name in WATCHED_PARAMETERS
            ]
        )
        model: BallPlate = scenario.plant.model
        braking = model.k1 * values["rolling"] / model.radius
        windows = [
            [of[name] for name in WATCHED_PARAMETERS]
            for of in (ROLLING_SCATTER_STD, STOPPING_SCATTER_STD)
        ]
        return cls(
            scenario=scenario,
            model=model,
            values=values,
            lag=scenario.lateness[1],
            own_lag=log.own_lag,
            play=float(np.ravel(drives.backlash)[0]),
            turned=1 + _pair(from_scenarios(TransmissionError, [scenario]).slope),
            grip=log.grips[0],
            screen=_pair(touch.variance) + pitch**2 / 12,
            encoders=_pair(encoders.variance) + count**2 / 12,
            disturbance=_pair(drives.disturbance),
            unit=scale,
            constant=scale * np.array([TWIN_ERROR_STD[name] for name in WATCHED_PARAMETERS]),
            changing=scale * np.hypot(windows, uneven),
            uneven=scale * uneven,
            drift=scale * np.hypot([DRIFT_STD[name] for name in WATCHED_PARAMETERS], uneven),
            rough=float(braking * np.hypot(MIN_UNEVENNESS, surface.spread_percent / 100)),
            sloped=float(model.k1 * np.radians(surface.slope_deg)),
        )

    @property
    def grips(self) -> tuple[float, ...]:
        """As a log has them."""
        return (self.grip,)

    @property
    def changes(self) -> Array:
        """Covariance of what each cause changes, shape (H, P, P)."""
        sizes = np.array(
            [[sizes.get(p, 0.0) for p in WATCHED_PARAMETERS] for sizes in CAUSE_SIZES.values()]
        )
        variances = (self.unit * sizes) ** 2
        return np.asarray(variances[..., None] * np.eye(len(WATCHED_PARAMETERS)))

    @property
    def uncertainty(self) -> Array:
        """Covariance of what the belief may be wrong by, shape (P, P)."""
        return np.asarray(np.diag(self.constant**2))

    @property
    def names(self) -> tuple[str, ...]:
        """The ball's parameters of a replay: those watched, and the others that are not zero."""
        return (*BALL_BELIEFS, *(name for name in FRICTION_EXTRAS if self.values[name]))

    @property
    def theta(self) -> Array:
        """Their values, shape (1, len(names))."""
        return np.array([[self.values[name] for name in self.names]])

    def problem(self, windows: Windows) -> TwinProblem:
        """Replays of windows with this twin; its plate may be cambered."""
        field, camber = windows.field, np.array(self.scenario.plant.camber)[:, None, None]
        own = field.own + camber * field.normal[:, None] / self.model.gravity
        bowed = replace(windows, field=field._replace(own=own))
        return TwinProblem(bowed, self.names, self.model, self.grip)


def belief_of(log: Log, overrides: Sequence[str] = (), factor: float | None = None) -> Belief:
    """The twin of a log: what its run was simulated with or believed, and over that the overrides.

    Args:
        log: A run of this program contains its scenario; any other log is taken to be of the rig
            as the project describes it.
        overrides: ``KEY=VALUE`` each; ``parameters=FILE`` among them.
        factor: Share of gravity that accelerates the ball of a log that is no run; None for the
            rig's ball.

    Raises:
        ScenarioError: If a key or value is wrong, or the log's scenario is of a different version.
        LogError: If a ball is given for a run, which states its own.
    """
    if factor is not None:
        log = log.with_ball(factor)
    tables: Mapping[str, Any] = log.scenario or read("circle")[0]
    tables = {key: value for key, value in tables.items() if key not in {"change", "fault"}}
    source = log.source if log.scenario else "the twin"
    followed = [(key, tables[key]) for key in ("title", "reference") if key in tables]  # as it was
    found = resolve(tables, source, [*followed, *map(setting, overrides)])
    scenario = load_recorded(*found)[0]  # what commands came, not from which law
    return Belief.of(_with_ball(scenario, factor), log)


def _with_ball(scenario: Scenario, factor: float | None) -> Scenario:
    """The twin of a scenario with a ball that so large a share of gravity accelerates, if given."""
    if factor is None:
        return scenario
    ball = scenario.plant.ball
    inertia = ball_inertia(ball.mass, ball.radius, factor)
    tables = put(scenario.model_dump(mode="json"), [("plant.ball.inertia", inertia)])
    return check(tables, "the twin")


MAX_DEAD_TIME_S = 0.1
"""Longest dead time in s of the twin of a log of any rig: any excess is attributed to the plate."""


def twin_for_log(
    log: AnyLog, overrides: Sequence[str] = (), factor: float | None = None
) -> tuple[Log, Belief]:
    """A log of any rig as a twin of it sees it, and that twin.

    Args:
        log: With commands or angles of the plate.
        overrides: ``KEY=VALUE`` each over the rig as the project describes it, as
            ``parameters=FILE`` of what ``identify`` found.
        factor: Share of gravity that accelerates the ball; None for the rig's ball.

    Raises:
        TwinError: If a key or value is wrong, or the log is not of this rig.
    """
    found = resolve(read("circle")[0], "the twin", [setting(text) for text in overrides])
    scenario = _with_ball(load_recorded(*found)[0], factor)
    dead_time = scenario.sensors.touch.dead_time
    later = max(0.0, dead_time - MAX_DEAD_TIME_S)
    tables = put(scenario.model_dump(mode="json"), [("sensors.touch.dead_time", dead_time - later)])
    own = replace(log.on(scenario, later), command=None)
    belief = Belief.of(check(tables, "the twin"), own)
    return own, replace(belief, screen=prepare(own).sigma ** 2)


def logs(pairs: Sequence[tuple[Scenario, Scenario]]) -> list[Log]:
    """Logs of simulated rigs that run side by side, each with what is believed of it.

    Args:
        pairs: Belief and truth of each.
    """
    truths = [truth for _, truth in pairs]
    duration, period = truths[0].duration, truths[0].rig.period
    keep = ("measured", "age", "touched", "applied")
    record = Recorder(round(duration / period), len(pairs), period, keep=keep)
    drive(*assemble(truths, threads=1, unseen=True), duration, record)
    columns = {name: values.reshape(len(pairs), -1) for name, _, values in record.columns()}
    return [
        of_columns(
            {"time": record.time.copy(), **{name: v[number] for name, v in columns.items()}},
            {"scenario": belief.model_dump(mode="json")},
            f"rig {number}",
        )
        for number, (belief, _) in enumerate(pairs)
    ]


def check_commands(log: Log) -> None:
    """Make sure that a log contains the commands.

    Raises:
        LogError: If it does not.
    """
    if log.command is None:
        raise LogError(
            f"{log.source}: no columns applied_phi_acc and applied_theta_acc (or applied_..._rate):"
            " the twin of a rig needs the rig's commands; to take the plate's measured angles for"
            " them, give --columns time=time,measured_x=measured_x,measured_phi=measured_phi"
        )


def _pair(value: Any) -> Array:
    return np.broadcast_to(np.asarray(value, float).reshape(-1, 2)[0], (2,)).astype(float)
