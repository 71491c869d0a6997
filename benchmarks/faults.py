"""Twenty deliberate faults that ``benchmarks.mutations`` puts into a copy of the tree."""

from __future__ import annotations

from typing import NamedTuple


class Fault(NamedTuple):
    """A mistake of the kind people make.

    Attributes:
        name: What it is called.
        file: Where it is made, from the root.
        text: What stands there, once.
        replacement: What is put in its place.
        meaning: What is wrong then, in one line.
        tests: Those that are asked first, from ``tests``.
    """

    name: str
    file: str
    text: str
    replacement: str
    meaning: str
    tests: tuple[str, ...]


PLANT = "src/twin/sim/plant"
FAULTS = (
    Fault(
        "gravity_axes",
        f"{PLANT}/level.py",
        "gravity * np.sin(phi) * down,",
        "gravity * np.sin(theta) * down,",
        "plant: the base's tilt about one axis pulls along the other",
        ("sim/test_rolling.py", "sim/test_contact.py"),
    ),
    Fault(
        "start_slides",
        f"{PLANT}/placing.py",
        "turn = (-vy / radius, vx / radius,",
        "turn = (vy / radius, -vx / radius,",
        "plant: a ball started in motion spins backwards",
        ("sim/test_mechanism.py",),
    ),
    Fault(
        "ageing_too_slow",
        f"{PLANT}/friction.py",
        "np.exp(-time / (goal * dwell))",
        "np.exp(-time / dwell)",
        "plant: a moving contact keeps its surplus of friction for too long",
        ("sim/test_friction.py",),
    ),
    Fault(
        "stiffer_wheels_overdamped",
        f"{PLANT}/fitted.py",
        "damping *= math.sqrt(parts.stiffness / stiffness)",
        "damping *= parts.stiffness / stiffness",
        "plant: the damping ratio does not stay when the wheels get stiffer",
        ("sim/test_mechanism_model.py",),
    ),
    Fault(
        "last_stage_of_rk4",
        f"{PLANT}/ball_motion.py",
        "acceleration(end, x + h * vx3",
        "acceleration(middle, x + h * vx3",
        "plant: the last stage of RK4 looks at the middle of the step",
        ("sim/test_exact_plant.py",),
    ),
    Fault(
        "play_twice",
        "src/twin/sim/drives.py",
        "Play(each(model.backlash) * ratio)",
        "Play(2 * each(model.backlash) * ratio)",
        "drives: the play is twice what is asked for",
        ("sim/test_drives.py",),
    ),
    Fault(
        "backstepping_sign",
        "controllers/backstepping.py",
        "alpha3_rate - a * e3 - c4 * e4",
        "alpha3_rate + a * e3 - c4 * e4",
        "law: a sign of (6.89)",
        ("controllers/test_backstepping.py",),
    ),
    Fault(
        "sliding_mode_order",
        "controllers/sliding_mode.py",
        "self._sigmoid(s[..., i] + pull[..., i - 1] * psi)",
        "self._sigmoid(s[..., i] + pull[..., 3 - i] * psi)",
        "law: the nested gains in the wrong order",
        ("controllers/test_sliding_mode.py",),
    ),
    Fault(
        "smith_one_tick_late",
        "controllers/smith.py",
        "newer: Array = self._past[(self._tick - self._whole) % self._length]",
        "newer: Array = self._past[(self._tick - self._whole - 1) % self._length]",
        "observer: the predictor looks back one tick too far",
        ("controllers/test_smith.py",),
    ),
    Fault(
        "unseen_ball_counts",
        "controllers/observers/innovation.py",
        "e[~measurement.touched, 0::2] = 0",
        "e[~measurement.touched, 1::2] = 0",
        "observer: without a ball on the screen the plate is disbelieved instead",
        ("controllers/test_luenberger.py", "controllers/test_observers.py"),
    ),
    Fault(
        "wish_for_applied",
        "src/twin/hal/rig.py",
        "        return applied\n",
        "        return rate\n",
        "seam: the wish is handed back for what was applied",
        ("hal/test_rig.py",),
    ),
    Fault(
        "braking_not_kept",
        "src/twin/hal/limits.py",
        "by.where(back, -size, size)",
        "by.where(back, -size, requested)",
        "seam: nothing keeps the plate from running into its upper angle limit",
        ("hal/test_supervisor.py",),
    ),
    Fault(
        "fault_keeps_moving",
        "src/twin/hal/supervisor.py",
        "np.where(dead, 0.0, self._clamp(requested, self.rate, self.angle))",
        "self._clamp(requested, self.rate, self.angle)",
        "seam: in a fault the plate brakes gently instead of stopping at once",
        ("hal/test_supervisor.py",),
    ),
    Fault(
        "screen_turned_back",
        "src/twin/sim/touch.py",
        "(x * cos + y * sin, y * cos - x * sin)",
        "(x * cos - y * sin, y * cos + x * sin)",
        "sensor: a screen mounted askew is turned the other way",
        ("sim/test_sensors.py",),
    ),
    Fault(
        "noise_held_once_more",
        "src/twin/sim/noise.py",
        "index, tick = (self._tick // self._hold) % self.BLOCK, self._tick",
        "index, tick = ((self._tick + 1) // self._hold) % self.BLOCK, self._tick",
        "sensor: held noise changes one tick early",
        ("sim/test_sensors.py",),
    ),
    Fault(
        "record_mixes_rigs",
        "src/twin/run/record.py",
        "values.T.ravel()",
        "values.ravel()",
        "record: the rows of several rigs are mixed",
        ("run/test_record.py",),
    ),
    Fault(
        "peak_is_least",
        "src/twin/run/record.py",
        "np.abs(applied) > np.abs(self._peak)",
        "np.abs(applied) < np.abs(self._peak)",
        "record: of a thinned record the smallest effort is kept, not the largest",
        ("run/test_record.py",),
    ),
    Fault(
        "settling_one_tick_late",
        "src/twin/run/metrics.py",
        "last = int(outside[-1]) + 1 if len(outside) else 0",
        "last = int(outside[-1]) + 2 if len(outside) else 0",
        "metric: settling times are one period too long",
        ("run/test_metrics.py",),
    ),
    Fault(
        "stale_key",
        "src/twin/study/work.py",
        "digest(code() + scenario.model_dump_json())",
        "digest(scenario.model_dump_json())",
        "study: results of older code are taken for today's",
        ("study/test_key.py",),
    ),
    Fault(
        "one_seed_for_all",
        "src/twin/study/work.py",
        'f"seed={seed}")',
        'f"seed={point}")',
        "study: runs that are to differ in their noise have the same",
        ("study/test_answers.py", "study/test_command.py"),
    ),
)
