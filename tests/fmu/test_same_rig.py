"""`twin.fmu.export`.

The C rig against the twin's exact plant, drives, sensors and supervisor, effect by effect."""

import numpy as np
import pytest
from c_rig import CRig, counted, exact, made, normal
from c_source import offered, unread

from twin.hal.linkage import Linkage
from twin.hal.supervisor import State
from twin.run.assemble import assemble

EFFECTS = {
    "rolling": {},
    "none": {"plant__friction__rolling_mm": 0},
    "breakaway": {"plant__friction__breakaway_ratio": 3.0},
    "ageing": {"plant__friction__breakaway_ratio": 3.0, "plant__friction__dwell_time": 0.2},
    "viscous": {"plant__friction__viscous_mm": 5.0},
    "presliding": {"plant__friction__presliding_um": 50.0},
    "level": {"plant__level_deg": [0.4, -0.3]},
    "steel": {"plant__ball__kind": "steel"},
    "start": {"plant__start__x": 0.05, "plant__start__y_rate": -0.1},
    "slew": {"plant__servo__slew_deg": 6.0},
    "acceleration": {"plant__servo__acceleration_deg": 60.0},
    "deadband": {"plant__servo__deadband_deg": 0.3},
    "resolution": {"plant__servo__resolution_deg": 0.7},
    "late": {"plant__servo__dead_time": 0.0413},
    "servo": {
        "plant__servo__dead_time": 0.0213,
        "plant__servo__slew_deg": 10.0,
        "plant__servo__acceleration_deg": 150.0,
        "plant__servo__deadband_deg": 0.1,
        "plant__servo__resolution_deg": 0.17,
    },
    "bandwidth": {"plant__servo__bandwidth_hz": 8.0},
    "backlash": {"plant__servo__backlash_deg": 0.1},
    "hysteresis": {"plant__servo__hysteresis_deg": 0.2},
    "resonance": {"plant__servo__resonance_hz": 14.0},
    "train": {
        "plant__servo__bandwidth_hz": 8.0,
        "plant__servo__backlash_deg": 0.05,
        "plant__servo__hysteresis_deg": 0.1,
        "plant__servo__resonance_hz": 14.0,
        "plant__servo__resonance_damping": 0.2,
    },
    "vibration": {"plant__servo__vibration": 2.0},
    "wander": {"plant__servo__vibration": 2.0, "plant__servo__vibration_wander": 0.3},
    "disturbance": {"disturbance__variance": [1e-4, 3e-5], "sensors__noise_hold": 0.01},
    "frames": {
        "sensors__touch__frame_rate": 133.0,
        "sensors__touch__dead_time_spread": 0.002,
        "sensors__touch__dead_time": 0.0413,
    },
    "camera": {
        "sensors__touch__frame_rate": 47.0,
        "sensors__touch__jitter": 0.008,
        "sensors__touch__lost": 0.3,
    },
    "hidden": {"sensors__touch__hidden": [0.05, -0.2, 0.08, 0.2], "plant__start__x": 0.03},
    "begins_hidden": {"sensors__touch__hidden": [-0.01, -0.01, 0.01, 0.01]},
    "turned": {"sensors__touch__rotation_deg": 2.0, "sensors__touch__grid": 0},
    "encoders": {"sensors__encoders__counts": 0, "sensors__encoders__variance": [1e-8, 0.0]},
    "limits": {"rig__limits__acceleration": 3.0, "rig__limits__angle_deg": 3.0},
    "size": {
        "plant__size": [0.31, 0.47],
        "rig__limits__area": [0.15, 0.15],
        "sensors__touch__grid": 300,
    },
    "small": {
        "plant__size": [0.3, 0.2],
        "rig__limits__area": [0.14, 0.09],
        "reference__amplitude": 0.05,
        "plant__start__x": 0.13,
        "plant__start__x_rate": 0.2,
        "rig__limits__margin": 0.2,
    },
    "left": {"plant__start__x": 0.2, "plant__start__x_rate": 0.3},
    "fast": {"plant__start__x": -0.2, "plant__start__x_rate": 1.0, "rig__limits__ball_speed": 0.8},
    "fell": {"plant__start__x": 0.3, "plant__start__x_rate": 0.5, "rig__limits__margin": 0.2},
    "rim": {
        "plant__rim__size": [0.09, 0.08],
        "plant__rim__restitution": 0.6,
        "plant__start__x_rate": 0.2,
        "plant__start__y_rate": -0.3,
        "plant__level_deg": [1.5, 0.4],
    },
    "stops": {
        "plant__rim__size": [0.09, 0.0],
        "plant__friction__rolling_mm": 0,
        "plant__level_deg": [0.5, 0.0],
    },
    "bent": {
        "plant__rim__size": [0.07, 0.07],
        "plant__friction__presliding_um": 50.0,
        "plant__level_deg": [1.5, 0.0],
    },
    "cams": {"rig__cam_error_percent": [2.0, -3.0], "rig__cam_coupling_percent": 1.0},
}
EFFECTS["linkage"] = {
    "plant__linkage__crank_mm": [40.0, 28.0],
    "plant__linkage__rod_mm": [90.0, 95.0],
    "plant__linkage__arm_mm": [100.0, 70.0],
    "plant__linkage__distance_mm": [50.0, 42.0],
}
EFFECTS["linkage_ratio"] = EFFECTS["linkage"] | {"rig__cams": "ratio"} | EFFECTS["cams"]
EFFECTS["linkage_wrong"] = EFFECTS["linkage"] | EFFECTS["cams"] | EFFECTS["limits"]
for together, names in {
    "linkage_driven": "linkage servo train wander disturbance cams",
    "all": "ageing viscous level servo train wander disturbance frames cams",
}.items():
    EFFECTS[together] = dict(item for name in names.split() for item in EFFECTS[name].items())
FAULTS = ["", "ball at", "plate at", "no longer detected", "too fast"]


def wish(time):
    """Plate rates that tilt it to and fro so that the ball rolls, turns and rests, rad/s."""
    on = (time % 1.6) < 1.1
    return 0.25 * on * np.array([np.sin(9 * time), np.cos(7 * time + 0.4)])


def both(scenario, c, ticks, rates=wish, seed=0):
    """The same wishes to twin and C rig: what both measure, are, and have commanded, by period.

    And whether and why the twin has levelled its plate, and the fault that the C rig tells.
    """
    rig = counted(assemble(scenario).rig, seed)
    twin, ours, notes = [], [], []
    with rig:
        measured = rig.read()
        rig.start()
        c.begin()
        for tick in range(ticks):
            state, supervisor = rig.devices.state[0], rig.supervisor
            twin.append([*measured.y[0], measured.age[0], measured.touched[0], *state])
            ours.append([*c.measured, *c.get("age"), *c.get("touched"), *c.truth])
            stopped = supervisor.state[0] == State.HOLDING
            notes.append((stopped, supervisor.reason[0], int(c.get("fault")[0])))
            wanted = rates(tick * rig.period)
            twin[-1] += [*rig.write(wanted[None])[0]]
            c.step(wanted)
            ours[-1] += [*c.get("applied_phi_rate", "applied_theta_rate")]
            rig.wait()
            measured = rig.read()
    np.testing.assert_allclose(ours, twin, rtol=0, atol=1e-11)
    return np.array(ours), notes


@pytest.mark.parametrize(
    "effect",
    [pytest.param(each, marks=[pytest.mark.long] if each == "all" else []) for each in EFFECTS],
)
def test_every_effect_is_that_of_the_twin(library, effect):
    scenario = exact(seed=7, **EFFECTS[effect])
    _, notes = both(scenario, CRig(library, scenario), 700, seed=7)
    for stopped, reason, fault in notes:
        assert (fault > 0) == stopped
        assert FAULTS[fault] in reason


@pytest.mark.parametrize(("effect", "fault"), [("left", 1), ("fast", 4), ("fell", 3)])
def test_the_rig_levels_its_plate_for_the_reason_that_the_twin_gives(library, effect, fault):
    scenario = exact(**EFFECTS[effect])
    c = CRig(library, scenario, noise=False).begin()
    c.step(np.zeros(2), 700)
    assert c.get("fault")[0] == fault


def test_a_command_that_is_no_number_levels_the_plate(library):
    c = CRig(library).begin()
    c.step(np.array([0.3, 0.0]), 50)
    c.step(np.array([np.nan, 0.0]), 400)
    assert c.get("fault")[0] == 5
    assert abs(c.truth[2]) < 1e-3


@pytest.mark.long
def test_an_uneven_screen_is_that_of_the_twin(library, tmp_path):
    uneven = {
        "plant__surface__spread_percent": 30.0,
        "plant__surface__slope_deg": 0.1,
        "plant__surface__seed": 3,
        "plant__camber": [0.4, -0.3],
        "plant__size": [0.5, 0.3],
    }
    ours, _ = both(exact(**uneven), CRig(made(tmp_path, duration=0.02, **uneven)), 700)
    flat, _ = both(exact(), CRig(library, exact()), 700)
    assert abs(flat - ours).max() > 1e-3
    round_one = {
        "plant__shape": "round",
        "plant__size": [0.3, 0.3],
        "rig__limits__area": [0.1, 0.1],
        "rig__limits__margin": 0.2,
        "reference__amplitude": 0.05,
        "plant__start__x": 0.09,
        "plant__start__y": 0.09,
        "plant__start__y_rate": 0.2,
        "plant__start__x_rate": 0.2,
    }
    (tmp_path / "round").mkdir()
    path = made(tmp_path / "round", duration=0.02, **round_one)
    disc = CRig(path)
    both(exact(**round_one), disc, 200)
    assert disc.get("true_on_plate")[0] == 0
    walled = exact(plant__rim__size=[0.3, 0.3], plant__level_deg=[0.6, 0.2], **round_one)
    disc = CRig(path, walled)
    ours, _ = both(walled, disc, 700)
    assert disc.get("true_on_plate")[0] == 1
    assert np.hypot(ours[:, 6], ours[:, 10]).max() == pytest.approx(0.13)


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"plant.rim.size[1]": 0.03}, "above the ball's diameter"),
        ({"plant.rim.size[2]": 0.6}, "at most the plate's side"),
        ({"plant.rim.size[1]": 0.1, "plant.start.x": 0.05}, "begins beyond a wall"),
        ({"plant.rim.size[1]": 0.1, "plant.start.x": 0.02}, ""),
    ],
)
def test_walls_that_cannot_be_are_refused_in_c_as_well(library, values, word):
    c = CRig(library, **values)
    c.enter()
    assert (c.status("ExitInitializationMode") != 0) == bool(word)
    assert word in "".join(c.said)


ROWS = [[-50, -14.5], [-25, -8], [0, 0.3], [25, 8.5], [50, 15.5]]
TABLE = {
    "plant__linkage__phi_deg": ROWS,
    "plant__linkage__theta_deg": [[-50, -15], [0, 0], [40, 14]],
}


FAR = {
    "rig__limits__angle_deg": 12.7,
    "rig__limits__acceleration": 60.0,
    "rig__limits__rate_deg": 120.0,
    "rig__limits__margin": 2.0,
    "rig__limits__ball_speed": 20.0,
    "rig__cam_error_percent": [20.0, 20.0],
    "plant__size": [5.0, 5.0],
}
"""A wide plate that goes to the ends of its table, for its rig believes in too small a gain."""


BEYOND = FAR | {"rig__cams": "ratio"}


@pytest.mark.long
@pytest.mark.parametrize("more", [BEYOND, FAR, EFFECTS["linkage_ratio"], EFFECTS["linkage_driven"]])
def test_a_typed_table_tilts_the_plate_as_in_the_twin(tmp_path, more):
    typed = TABLE | {key: more[key] for key in more.keys() - EFFECTS["linkage"].keys()}
    c = CRig(made(tmp_path, duration=0.02, **typed))
    ours, _ = both(exact(**typed), c, 300, lambda time: 12 * wish(time))
    tilt = np.degrees(np.abs(ours[:, [8, 12]]).max(axis=0))
    if more is BEYOND:
        assert tilt[1] == pytest.approx(14.0)  # the end of its table
    assert tilt.max() > 3


def test_cranks_and_rods_turn_the_plate_far_as_in_the_twin(library):
    wide = FAR | EFFECTS["linkage"] | {"rig__cam_error_percent": [2.0, -3.0]}
    scenario = exact(**wide)
    ours, _ = both(scenario, CRig(library, scenario), 300, lambda time: 12 * wish(time))
    assert np.degrees(np.abs(ours[:, [8, 12]]).max(axis=0)).min() > 10


@pytest.mark.parametrize(
    ("lengths", "word"),
    [
        ({"rod": (0.0, 0.09)}, "above 0"),
        ({"distance": (0.2, 0.05)}, "longer"),
        ({"crank": (0.01, 0.03)}, "locks"),
        ({"rod": (0.071, 0.0605), "distance": (0.0, 0.0)}, "locks"),
        ({}, ""),
    ],
)
def test_lengths_that_do_not_fit_are_refused_by_both(library, lengths, word):
    given = {"crank": (0.04, 0.03), "rod": (0.09, 0.1), "arm": (0.1, 0.07)}
    given |= {"distance": (0.05, 0.045)} | lengths
    problem = Linkage(**given).problem(np.radians(12))
    assert word in problem
    assert bool(word) == bool(problem)
    c = CRig(library, **{"rig.limits.angle": np.radians(12)})
    for name, pair in given.items():
        for i, length in enumerate(pair):
            assert c.set(f"plant.linkage.{name}[{i + 1}]", length) == 0
    c.enter()
    assert (c.status("ExitInitializationMode") != 0) == bool(word)
    assert word in "".join(c.said)


@pytest.mark.long
def test_a_tunable_parameter_acts_as_a_change_of_the_scenario_does(library):
    said = {
        "plant.friction.breakaway_ratio": 2.0,
        "plant.friction.dwell_time": 0.1,
        "plant.servo.resonance_hz": 12.0,
        "plant.servo.bandwidth_hz": 9.0,
        "sensors.encoders.variance": [1e-8, 1e-9],
    }
    c = CRig(library, exact())
    before = c.step

    def step(rate):
        if c.tick == 250:
            for name, value in said.items():
                for i, each in enumerate(np.ravel(value)):
                    full = f"{name}[{i + 1}]" if isinstance(value, list) else name
                    assert c.set(full, each) == 0, c.said
        before(rate)

    c.step = step
    ours, _ = both(exact(change=[{"at": 0.5, "set": said}]), c, 700)
    same, _ = both(exact(), CRig(library, exact()), 700)
    assert abs(same - ours).max() > 1e-4


SPUN = {"plant__start__spin": 15.0, "plant__start__x_rate": 0.2, "plant__start__y_rate": -0.1}


def test_every_parameter_is_read_by_the_c_source():
    assert unread(exact()) == set()


def answers(library, scenario, speed, ticks=400, **changed):
    """What a rig measures and does under one sequence of commands; why it refuses to begin."""
    c = CRig(library, scenario, **changed)
    c.enter()
    if c.status("ExitInitializationMode"):
        return "".join(c.said)
    rows = []
    for tick in range(ticks):
        rows.append([*c.measured, *c.get("age"), *c.truth, *c.get("fault")])
        c.step(speed * wish(tick * c.period))
    return np.array(rows)


EDGE = {"plant__start__x": 0.2, "plant__start__y": 0.1, "plant__start__x_rate": 0.15}
BOX = {"sensors__touch__hidden": [-0.01, -0.01, 0.01, 0.01]}
PLACES = (
    (EFFECTS["all"] | SPUN, 1.0),
    (EFFECTS["linkage_wrong"], 1.0),
    (EFFECTS["linkage_ratio"], 1.0),
    (EFFECTS["cams"] | {"plant__plate__height": 0.05}, 1.0),
    (EFFECTS["deadband"], 1.0),
    (EFFECTS["rim"], 1.0),
    (EFFECTS["presliding"], 1.0),
    (BOX | {"plant__start__x_rate": 0.1, "plant__start__y_rate": 0.03}, 1.0),
    (BOX | {"plant__start__x_rate": 0.03, "plant__start__y_rate": 0.1}, 1.0),
    (BOX | {"plant__start__x_rate": -0.1, "plant__start__y_rate": -0.03}, 1.0),
    (BOX | {"plant__start__x_rate": -0.03, "plant__start__y_rate": -0.1}, 1.0),
    (EDGE, 1.0),
    (EDGE | {"plant__start__y_rate": 0.15, "rig__limits__area": [0.3, 0.12]}, 1.0),
    (EFFECTS["fast"] | {"rig__limits__ball_speed": 0.95}, 1.0),
    (FAR | {"rig__limits__angle_deg": 6.0}, 12.0),
    (FAR | {"rig__limits__rate_deg": 20.0}, 12.0),
)
"""Rigs, and how many times as fast their plates are commanded, so that each parameter matters."""


def other(parameter):
    """A value near a parameter's own that is allowed."""
    value = parameter.start
    if parameter.type == "Boolean":
        return 1 - value
    if parameter.type == "Integer":
        return value + 1000
    near = 1.1 * value if value else 0.01
    return near if parameter.low <= near <= parameter.high else 0.9 * value


@pytest.mark.long
def test_every_parameter_changes_what_the_rig_does(library):
    """Of those that are 0 where they do nothing, where they are not."""
    dead = {each.name for each in offered(exact())}
    for settings, speed in PLACES:
        scenario = exact(seed=7, **settings)
        plain = answers(library, scenario, speed)
        for each in offered(scenario):
            if each.name not in dead:
                continue
            found = answers(library, scenario, speed, **{each.name: other(each)})
            if not isinstance(found, str) and not np.array_equal(found, plain):
                dead.remove(each.name)
    assert dead == set()


def test_the_plates_height_is_that_of_the_twin(library):
    high = EFFECTS["none"] | {"plant__plate__height": 0.3}
    scenario = exact(**high)
    there, _ = both(scenario, CRig(library, scenario), 300)
    usual, _ = both(exact(**EFFECTS["none"]), CRig(library, exact(**EFFECTS["none"])), 300)
    assert np.abs(there - usual).max() > 1e-4


@pytest.mark.short("more0")
@pytest.mark.parametrize("more", [SPUN, FAR | SPUN])
def test_a_spin_that_is_free_is_that_of_the_twin(library, more):
    scenario = exact(**more)
    speed = 12 if "plant__size" in more else 1
    ours, _ = both(scenario, CRig(library, scenario), 300, lambda time: speed * wish(time))
    none = exact(**(more | {"plant__start__spin": 0.0}))
    still, _ = both(none, CRig(library, none), 300, lambda time: speed * wish(time))
    assert np.abs(ours - still).max() > 1e-5


@pytest.fixture
def quickly_compiled(monkeypatch):
    """To optimise is most of what an FMU takes to be made."""
    monkeypatch.setattr("twin.fmu.export.COMPILER_FLAGS", ("-std=c99", "-fPIC", "-shared"))


ONE_AXIS = {
    "plant__axes": 1,
    "reference__kind": "hold",
    "plant__rim__size": [0.09, 0.0],
    "plant__level_deg": [0.5, 0.4],
    "plant__start__y": 0.01,
    "plant__servo__vibration": 2.0,
    "disturbance__variance": [1e-4, 3e-5],
    "sensors__encoders__variance": [1e-8, 1e-8],
}


@pytest.mark.long
@pytest.mark.usefixtures("quickly_compiled")
def test_a_rig_of_one_axis_is_that_of_the_twin(tmp_path):
    path = made(tmp_path, duration=0.02, **ONE_AXIS)
    c = CRig(path, exact(seed=7, **ONE_AXIS))
    ours, notes = both(exact(seed=7, **ONE_AXIS), c, 700, seed=7)
    x, phi, y, theta = ours[:, 6], ours[:, 8], ours[:, 10], ours[:, 12]
    assert x.any()
    assert phi.any()
    assert not np.stack((y, theta, *ours[:, 2:4].T)).any()
    assert not any(stopped for stopped, _, _ in notes)
    for values, word in (
        ({"plant.rim.size[2]": 0.01}, "must be 0 along y"),
        ({"plant.rim.size[1]": 0.03}, "above the ball's diameter"),
        ({"plant.rim.size[1]": 0.08, "plant.start.y": 0.4}, ""),
    ):
        c = CRig(path, **values)
        c.enter()
        assert (c.status("ExitInitializationMode") != 0) == bool(word)
        assert word in "".join(c.said)


@pytest.mark.usefixtures("quickly_compiled")
@pytest.mark.parametrize("ball_spin", ["locked", pytest.param("thesis", marks=pytest.mark.long)])
def test_a_ball_without_a_free_spin_is_that_of_the_twin(library, tmp_path, ball_spin):
    wide = FAR | {"plant__start__x_rate": 0.2, "plant__start__y_rate": -0.1}
    chosen = wide | {"plant__ball_spin": ball_spin}
    path = made(tmp_path, duration=0.02, **chosen)
    ours, _ = both(exact(**chosen), CRig(path), 300, lambda time: 12 * wish(time))
    free = exact(**wide)
    same, _ = both(free, CRig(library, free), 300, lambda time: 12 * wish(time))
    assert np.abs(ours - same).max() > 1e-5
    spun = CRig(path, **{"plant.start.spin": 2.0})
    spun.enter()
    assert spun.status("ExitInitializationMode") != 0
    assert "plant.start.spin must be 0" in "".join(spun.said)


def test_noise_is_white_normal_and_of_the_variance_asked_for():
    drawn = np.array([normal(3, stream, np.arange(20_000)) for stream in range(3)])
    assert np.abs(drawn.mean(axis=1)).max() < 4 / np.sqrt(20_000)
    assert np.abs(drawn.var(axis=1) - 1).max() < 4 * np.sqrt(2 / 20_000)
    assert np.abs((drawn[:, 1:] * drawn[:, :-1]).mean(axis=1)).max() < 4 / np.sqrt(20_000)
    assert np.abs(np.corrcoef(drawn)[np.triu_indices(3, 1)]).max() < 4 / np.sqrt(20_000)
    assert abs((drawn**4).mean() - 3) < 0.1
