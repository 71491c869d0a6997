"""`ballplate.systems`.

The systems for python-control are the rig's: its figures come out of them from outside."""

import control
import numpy as np
import pytest

import ballplate as bp
from ballplate.systems import INPUT_NAMES, REFERENCE_NAMES
from controllers.analysis import margins, sampled_loop, state_feedback_loop
from controllers.ballplate import STATE_NAMES
from controllers.classical import AFL, LQR, AFLIntegral, Backstepping, PolePlacement
from twin.run.controller_building import build_controller
from twin.sim.plant.friction import Friction
from twin.sim.plant.mechanism import Mechanism

AXIS_X = list(STATE_NAMES[:4])
FREE = {"plant": {"kind": "lagrange", "friction": {"rolling_mm": 0}}}
IDEAL = {"observer": "ideal", "predictor": None, "sensors": {"ideal": True}, **FREE}
T = 0.002


def controlled(law):
    """The closed loop of the state feedback, from the desired position to the ball."""
    return control.interconnect(
        [bp.systems.linear(), law], inputs=list(REFERENCE_NAMES), outputs=["x", "y"]
    )


def along_x(law):
    """Loop gain cut at u1: axis x alone, which axis y does not touch."""
    plant = control.model_reduction(
        bp.systems.linear(), keep_states=AXIS_X, keep_inputs=["phi_acc"], keep_outputs=AXIS_X,
        method="truncate", warn_unstable=False,
    )  # fmt: skip
    return -law["phi_acc", AXIS_X] * plant


def matched(found, expected):
    """Each expected pole's distance from the nearest found one, relative."""
    found = np.asarray(found)
    return max(np.abs(found - pole).min() / (1 + abs(pole)) for pole in expected)


def test_the_linear_plant_is_the_derivative_of_the_equations():
    plant = bp.systems.linear("circle", plant={"ball": {"kind": "steel"}})
    equations = bp.systems.equations("circle", plant={"ball": {"kind": "steel"}})
    found = control.linearize(equations, np.zeros(8), np.zeros(2))
    assert np.allclose(found.A, plant.A, atol=1e-9)
    assert np.allclose(found.B, plant.B, atol=1e-9)
    assert plant.state_labels == equations.output_labels == list(STATE_NAMES)
    assert plant.A[1, 2] == pytest.approx(5 / 7 * 9.81, rel=1e-3)


def test_every_signal_has_a_unit_and_a_column_of_the_record():
    done = bp.run("hold", duration=0.05, **FREE)
    for name in (*STATE_NAMES, *INPUT_NAMES):
        prefix = "applied" if name in INPUT_NAMES else "true"
        assert done.units[f"{prefix}_{name}"] == bp.systems.UNITS[name]
    for each in (bp.systems.law("circle"), bp.systems.sampled("circle")):
        assert {*each.input_labels, *each.output_labels} <= set(bp.systems.UNITS)


@pytest.mark.parametrize(
    "design",
    [
        *(PolePlacement(poles=p) for p in ((-1, -1.5, -2, -2.5), (-1, -2, -5, -6))),
        *(LQR(rho=rho, kappa=0.1) for rho in (100, 300, 1000)),
        LQR(rho=300, kappa=0.3),
        *(AFL(poles=p) for p in ((-2, -2.5, -3.5, -4), (-3, -4, -5, -6))),
        AFL(gains=(180, 162, 66, 13)),
        *(AFLIntegral(poles=p) for p in ((-0.5, -1, -1.5, -2, -2.5), (-2, -2.5, -3.5, -4, -5))),
        AFLIntegral(gains=(200, 132, 51, 12, 4)),
        *(Backstepping(c=c) for c in ((0.1, 1, 1.5, 2), (1, 4, 5, 6), (2, 3, 4, 5.5))),
    ],
    ids=lambda law: str(law)[:60],
)
def test_poles_and_margins_of_designs_of_the_thesis(design):
    law = bp.systems.law("circle", controller=design)
    loop = state_feedback_loop(design)
    # a pole of a multiplicity beyond one is found to the root of the rounding
    assert matched(controlled(law).poles(), loop.poles()) < 1e-4
    if design.name == "pole_placement":
        assert matched(controlled(law).poles(), design.poles) < 1e-4
    found = margins(loop, "u1")
    if law.nstates:
        return
    gain, phase, _, _, crossover, _ = control.stability_margins(along_x(law))
    # the analysis interpolates between its 300 frequencies
    assert found.phase == pytest.approx(abs(phase), rel=1e-3)
    if found.gain_down is not None or found.gain_up is not None:
        assert min(abs(gain / each - 1) for each in found[:2] if each is not None) < 1e-3
    if design.name == "lqr":
        assert found.crossover == pytest.approx(crossover, rel=1e-3)


@pytest.mark.short("lqr")
@pytest.mark.parametrize("kind", ["lqr", "pole_placement"])
def test_a_step_response_is_the_run_of_the_step(kind):
    """A step of a millimetre, so small that sines are their angles."""
    done = bp.run(
        "step", duration=4, baseline=False, controller=kind, reference={"x": 1e-3, "y": 0.0},
        metrics={"start": 0}, **IDEAL,
    )  # fmt: skip
    law = bp.systems.law("step", controller=kind)
    plant = control.sample_system(bp.systems.linear(), T, "zoh", copy_names=True)
    whole = control.interconnect([plant, law], inputs=list(REFERENCE_NAMES), outputs=["x"])
    found = control.step_response(whole["x", "reference_x"], timepts=done.time)
    assert done["true_x"].max() > 9e-4
    assert np.abs(1e-3 * found.outputs - done["true_x"]).max() < 1e-8
    settled = control.step_info(found.outputs, done.time, yfinal=1.0)["SettlingTime"]
    outside = np.abs(done["true_x"] - 1e-3) > 2e-5
    assert settled == pytest.approx(done.time[outside].max(), abs=2 * T)


@pytest.mark.parametrize(
    "chosen",
    [
        {"controller": "lqr", "predictor": None},
        {"controller": "afl_integral", "observer": "kalman", "predictor": {"delay": 0.042}},
    ],
    ids=["lqr", "afl_integral"],
)
def test_the_sampled_loop_with_observer_and_dead_time_is_that_of_the_analysis(chosen):
    plant = bp.systems.sampled("circle", **chosen)
    feedback = bp.systems.controller("circle", **chosen)
    built = build_controller(bp.rig("circle", **chosen).scenarios[0])
    loop = sampled_loop(built.law, built.observer, dead_time=0.042)
    omega = np.geomspace(0.1, 1000, 8)
    L = -(feedback * plant)[0, 0](np.exp(1j * omega * T))
    assert np.allclose(1 / (1 + L), loop.sensitivity("u1", omega), rtol=1e-6)
    z = control.feedback(plant, feedback, sign=1).poles()
    assert np.abs(z).max() == pytest.approx(np.abs(np.linalg.eigvals(loop.A)).max(), abs=1e-9)


@pytest.mark.parametrize(("dead_time", "states"), [(0.0, 8), (0.042, 50), (0.043, 52)])
def test_dead_time_is_whole_periods_of_delay_of_the_ball_alone(dead_time, states):
    late, prompt = (
        bp.systems.sampled("circle", sensors={"touch": {"dead_time": each}})
        for each in (dead_time, 0.0)
    )
    assert late.nstates == states
    z = np.exp(1j * T * np.array([1.0, 10.0]))
    whole = round(dead_time / T - 0.1)
    rest = dead_time / T - whole
    ball = (1 - rest) * z**-whole + rest * z ** -(whole + 1)
    for output in ("x", "phi", "y", "theta"):
        u = "phi_acc" if output in {"x", "phi"} else "theta_acc"
        delay = ball if output in {"x", "y"} else 1.0
        assert np.allclose(late[output, u](z), delay * prompt[output, u](z), rtol=1e-9), output


def pulse(sign):
    """Plate accelerations of a pulse about both axes, what is measured then, and motor angles."""
    u = np.zeros((500, 2))
    u[10:20], u[20:30] = (2.0, -1.0), (-2.0, 1.0)
    plant = Mechanism(friction=Friction(rolling=0.0), step=0.001)
    path = []
    for rate in sign * np.cumsum(T * u, axis=0):
        path.append(np.append(plant.state[0, 0::2], plant.motor[0]))
        plant.advance(plant.ratio * rate[np.newaxis], 2)
    return u, np.array(path)


def test_the_linear_mechanism_moves_as_the_mechanism_does():
    u, forth = pulse(1.0)
    _, back = pulse(-1.0)
    path = (forth - back) / 2
    plant = bp.systems.mechanism("circle", sensors={"touch": {"dead_time": 0.0}})
    response = control.forced_response(plant, np.arange(500) * T, u.T)
    motors = [plant.state_labels.index(f"motor_{axis}") for axis in ("phi", "theta")]
    found = np.vstack((response.outputs, response.states[motors])).T
    assert (np.ptp(found[50:, [1, 3]], axis=0) > 1e-4).all()  # the plate still rings
    assert np.allclose(found, path, rtol=0, atol=1e-5 * np.abs(path).max(axis=0))


def test_what_dry_friction_holds_and_a_tilted_base_are_left_out_of_the_mechanism():
    stuck = {"plate": {"joint_friction": 2.0}, "level_deg": [0.5, 0.0]}
    with_both = bp.systems.mechanism("circle", plant=stuck)
    assert np.array_equal(with_both.A, bp.systems.mechanism("circle").A)


def test_the_mechanism_is_slowly_the_linear_plant_and_rings_where_the_model_file_says():
    plant = bp.systems.mechanism("circle", sensors={"touch": {"dead_time": 0.0}})
    rigid = bp.systems.sampled("circle", sensors={"touch": {"dead_time": 0.0}})
    z = np.exp(1j * T * 1.0)
    for pair in (("x", "phi_acc"), ("phi", "phi_acc"), ("y", "theta_acc"), ("theta", "theta_acc")):
        assert abs(plant[pair](z) / rigid[pair](z) - 1) < 0.01
    poles = np.log(plant.poles()[np.abs(plant.poles()) > 0.5]) / T
    ringing = sorted(poles[poles.imag > 30], key=np.imag)
    # of models/ballplate.xml, from a tap
    assert [p.imag / (2 * np.pi) for p in ringing] == pytest.approx([12.9, 18.9], rel=0.005)
    assert [-p.real / abs(p) for p in ringing] == pytest.approx([0.080, 0.084], rel=0.02)


@pytest.mark.long
def test_the_exact_plant_carries_the_age_of_a_contact_that_holds_the_ball():
    sticky = {"rolling_mm": 0.18, "breakaway_ratio": 3.0, "dwell_time": 0.5}
    start = {"x_rate": 0.02}
    plant = {"kind": "lagrange", "friction": sticky, "start": start}
    how = {"duration": 0.6, "baseline": False, "metrics": {"start": 0}, "plant": plant}
    done = bp.run("hold", **how)
    plant = bp.systems.exact("hold", **how)
    begin = [0, 0.02, 0, 0, 0, 0, 0, 0, 1 / (1 + (0.02 / 0.005) ** 2), 0]
    u = np.stack([done["applied_phi_acc"], done["applied_theta_acc"]])
    found = control.input_output_response(plant, done.time, u, begin).outputs
    assert plant.output_labels[8:] == ["contact_age", "spin"]
    assert done["true_x_rate"][-1] == 0
    assert found[8, -1] > 0.3
    assert np.abs(found[[0, 4]].T - done.ball).max() < 1e-12


@pytest.mark.parametrize("ball_spin", ["free", "locked", "thesis"])
def test_the_exact_plant_and_the_equations_have_the_spin_of_the_scenario(ball_spin):
    free = ball_spin == "free"
    start = {"x_rate": 0.3, "y_rate": -0.2, "spin": 9.0 if free else 0.0}
    plant = {"kind": "lagrange", "ball_spin": ball_spin, "start": start}
    how = {"plant": plant | {"friction": {"rolling_mm": 0.0}}, "duration": 0.3, "baseline": False}
    done = bp.run("hold", metrics={"start": 0}, **how)
    u = np.stack([done["applied_phi_acc"], done["applied_theta_acc"]])
    begin = [0, 0.3, 0, 0, 0, -0.2, 0, 0, *([9.0] if free else [])]
    exact = bp.systems.exact("hold", **how)
    found = control.input_output_response(exact, done.time, u, begin).outputs
    assert exact.output_labels[8:] == (["spin"] if free else [])
    assert np.abs(found[[0, 4]].T - done.ball).max() < 1e-12
    equations = bp.systems.equations("hold", spin=free, plant=how["plant"])
    at = done.time[::10]
    held = u[:, ::10]
    coarse = control.input_output_response(exact, done.time, np.repeat(held, 10, axis=1), begin)
    x = np.array(begin, float)
    for k, now in enumerate(held.T[:-1]):
        np.testing.assert_allclose(x, coarse.states[:, 10 * k], rtol=0, atol=1e-9)
        h = (at[1] - at[0]) / 20
        for _ in range(20):  # a rule of its own: Runge and Kutta's, five times finer
            k1 = equations.dynamics(0.0, x, now)
            k2 = equations.dynamics(0.0, x + h / 2 * k1, now)
            k3 = equations.dynamics(0.0, x + h / 2 * k2, now)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + equations.dynamics(0.0, x + h * k3, now))


def test_a_push_at_rest_acts_on_the_equations_with_the_step_of_their_docstring():
    steps, push = 1000, slice(500, 510)
    t, u = np.arange(steps) * T, np.zeros((2, steps))
    u[0, push] = 5.0
    options = {"max_step": T}
    assert f"solve_ivp_kwargs={options}".replace("'", '"') in bp.systems.equations.__doc__
    found = control.input_output_response(
        bp.systems.equations(), t, u, np.zeros(8), solve_ivp_kwargs=options
    ).states
    rate = u[0].sum() * T  # of the plate, rad/s, after it
    assert found[3, -1] == pytest.approx(rate, rel=1e-3)
    assert found[2, -1] == pytest.approx(rate * (t[-1] - t[push].mean()), rel=1e-3)


def test_a_spin_that_is_not_free_is_no_state():
    locked = {"kind": "lagrange", "ball_spin": "locked"}
    with pytest.raises(bp.TwinError, match=r"spin: needs plant\.ball_spin 'free'"):
        bp.systems.equations("hold", spin=True, plant=locked)
