"""`ballplate`.

The symbols of the equations, held against the numpy model that everything else uses."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import ballplate as bp
from controllers.ballplate import BallPlate
from twin.hal.interface import Limits
from twin.sim.plant.friction import Friction

ca = pytest.importorskip("casadi")
STATES = np.random.default_rng(4).uniform(-1, 1, (20, 8)) * [0.3, 0.5, 0.2, 0.6, 0.2, 0.5, 0.2, 0.6]
INPUTS = np.random.default_rng(5).uniform(-7, 7, (20, 2))


def numbers(model, **changes):
    """The parameters with some of them changed."""
    p = model.nominal.copy()
    for name, value in changes.items():
        p[[each.rpartition(".")[2] for each in model.names["p"]].index(name)] = value
    return p


@pytest.fixture(scope="module")
def model():
    return bp.symbolic("circle")


@pytest.mark.parametrize("ball", [{}, {"mass": 0.263, "radius": 0.021, "inertia": 4.2e-5}])
def test_of_the_thesis_values_and_jacobians_are_those_of_the_model_of_laws(ball):
    model = bp.symbolic("circle", plant={"kind": "lagrange", "ball_spin": "thesis"})
    exact, p = BallPlate(**ball), numbers(model, rolling=0.0, **ball)
    by_state = ca.Function("A", [model.x, model.u, model.p], [ca.jacobian(model.xdot, model.x)])
    by_input = ca.Function("B", [model.x, model.u, model.p], [ca.jacobian(model.xdot, model.u)])
    for x, u in zip(STATES, INPUTS, strict=True):
        near = {"rtol": 1e-12, "atol": 1e-12}
        np.testing.assert_allclose(model.f(x, u, p).full()[:, 0], exact.derivative(x, u), **near)
        np.testing.assert_allclose(by_state(x, u, p).full(), exact.jacobian(x, u), **near)
        np.testing.assert_allclose(by_input(x, u, p).full(), exact.g(x), **near)
        np.testing.assert_array_equal(
            ca.Function("y", [model.x], [model.y])(x).full()[:, 0], exact.output(x)
        )


def test_friction_is_that_of_the_plant_but_for_the_share_that_smoothing_leaves(model):
    """Rolling resistance by the twin's own ``Friction``; the viscous part is not smoothed."""
    arms = {"rolling": 2e-4, "breakaway_ratio": 1.6, "stribeck_speed": 0.006}
    p = numbers(model, **arms, viscous=0.01)
    free, exact, friction = numbers(model, rolling=0.0), BallPlate(), Friction(**arms)
    for x, u in zip(STATES, INPUTS, strict=True):
        v = x[1::4]
        share = v / math.hypot(*v, model.width)
        normal = exact.gravity * math.cos(x[2]) * math.cos(x[6])
        lost = friction.deceleration(exact, x) * share
        lost = lost + exact.c1 * 0.01 / exact.radius * normal * v
        found = (model.f(x, u, free) - model.f(x, u, p)).full()[1::4, 0]
        np.testing.assert_allclose(found, lost, rtol=1e-10, atol=1e-12)


def test_a_tilted_base_is_gravity_that_leans(model):
    tilt = np.array([0.01, -0.02])
    names = [name for name in model.names["p"] if name.startswith("plant.level")]
    p = numbers(model, rolling=0.0, **{"level[1]": tilt[0], "level[2]": tilt[1]})
    assert names == ["plant.level[1]", "plant.level[2]"]
    found = model.f(np.zeros(8), np.zeros(2), p).full()[[1, 5], 0]
    share = 3 / 5  # of gravity that a thin hollow ball of its radius is accelerated by
    lean = 9.81 * np.array([math.sin(tilt[0]) * math.cos(tilt[1]), -math.sin(tilt[1])])
    np.testing.assert_allclose(found, share * lean, rtol=1e-12)


def test_a_ball_creeps_on_a_slope_that_holds_the_twins_as_is_told(model):
    """Friction holds c1 arm/r g cos; a slope of half of it: 0.5 w / sqrt(0.75)."""
    arm = 2e-4
    angle = math.atan(0.5 * arm / BallPlate().radius)
    x = np.zeros(8)
    x[2] = angle
    step = model.F.mapaccum(int(4 / model.period))
    p, still = numbers(model, rolling=arm), np.zeros((2, int(4 / model.period)))
    creeping = step(x, still, np.tile(p[:, None], still.shape[1])).full()[1, -1]
    assert creeping == pytest.approx(0.5 * model.width / math.sqrt(0.75), rel=1e-3)


@pytest.mark.parametrize("ball_spin", ["free", "locked", "thesis"])
def test_over_a_period_it_goes_where_the_twin_goes(ball_spin):
    """The exact plant under the same inputs, rolling with friction, well above the width."""
    spun = 9.0 if ball_spin == "free" else 0.0
    start = {"x_rate": 0.3, "y_rate": -0.2, "spin": spun}
    plant = {"kind": "lagrange", "ball_spin": ball_spin, "start": start}
    model = bp.symbolic("hold", plant=plant, spin=ball_spin == "free")
    with bp.rig("hold", plant=plant, duration=0.1) as rig:
        p = numbers(model)
        x = np.append(rig.state[0], spun)[: len(model.names["x"])]
        rate = np.zeros(2)
        for tick in range(40):
            u = np.array([3.0, -2.0]) * math.cos(0.1 * tick)
            rate = rate + rig.period * u
            rig.step(rate)
            x = model.F(x, u, p).full()[:, 0]
            np.testing.assert_allclose(x[:8], rig.state[0], atol=2e-7)
    assert model.names["x"][8:] == (("spin",) if spun else ())


def test_a_spin_is_a_state_where_it_is_asked_for_and_free():
    model = bp.symbolic("circle", spin=True, period=0.02)
    assert (model.names["x"][-1], model.units["spin"], model.x.shape) == ("spin", "rad/s", (9, 1))
    late = model.delayed()
    assert late.names[8:11] == ("spin", "phi_acc_2", "theta_acc_2")
    z, p = np.arange(13) / 100, model.nominal
    after = model.F(z[:9], z[9:11], p).full()[:, 0]
    np.testing.assert_array_equal(late.F(z, INPUTS[0], p).full()[:9, 0], after)
    # about the level plate no input moves it, and it moves nothing
    jacobian = ca.Function("A", [model.x, model.u, model.p], [ca.jacobian(model.xdot, model.x)])
    level = jacobian(np.zeros(9), np.zeros(2), numbers(model, rolling=0.0)).full()
    assert not level[8].any()
    assert not level[:, 8].any()
    with pytest.raises(bp.TwinError, match=r"spin: needs plant\.ball_spin 'free'"):
        bp.symbolic("circle", plant={"kind": "lagrange", "ball_spin": "locked"}, spin=True)


def test_names_units_bounds_and_what_is_known_are_those_of_the_scenario():
    known = {
        "plant.friction.rolling_mm": 0.3,
        "plant.level_deg": [0.1, 0.2],
        "controller.period": 0.02,
    }
    model = bp.symbolic(
        "cure", known, plant={"ball": {"kind": "steel"}}, controller={"model": "nominal"}
    )
    names = dict(zip(model.names["p"], model.nominal, strict=True))
    assert names["plant.friction.rolling"] == pytest.approx(3e-4)
    assert names["plant.level[2]"] == pytest.approx(math.radians(0.2))
    assert names["plant.ball.mass"] == BallPlate().mass  # what the designer knows
    assert (model.period, model.dead_time) == (0.02, 0.042)
    record = bp.run("hold", plant={"kind": "lagrange"}, duration=0.01, metrics={"start": 0})
    for name in (*model.names["x"], *model.names["y"]):
        assert model.units[name] == record.units[f"true_{name}"]
    for name in model.names["u"]:
        assert model.units[name] == record.units[f"applied_{name}"]
        assert model.bounds[name] == (-Limits().acceleration, Limits().acceleration)
    assert model.bounds["phi"][1] == pytest.approx(math.radians(10))
    assert model.bounds["y"] == (-0.15, 0.15)
    assert model.units["plant.ball.inertia"] == "kg m^2"
    assert model.units["plant.friction.breakaway_ratio"] == "1"


def test_delayed_it_carries_the_inputs_of_the_dead_time_along():
    model = bp.symbolic("circle", period=0.02)
    late = model.delayed()
    assert late.periods == 2
    assert late.names[8:] == ("phi_acc_2", "theta_acc_2", "phi_acc_1", "theta_acc_1")
    p, path, z = model.nominal, [STATES[0]], np.concatenate([STATES[0], INPUTS[:2].ravel()])
    for u in INPUTS[:10]:
        path.append(model.F(path[-1], u, p).full()[:, 0])
    for number, u in enumerate(INPUTS[2:10]):
        now, then = path[number + 2], path[number]
        np.testing.assert_allclose(late.now(z, p).full()[:, 0], now, atol=1e-12)
        seen = [then[0], now[2], then[4], now[6]]
        np.testing.assert_allclose(late.y(z, p).full()[:, 0], seen, atol=1e-12)
        z = late.F(z, u, p).full()[:, 0]


class StandIn:
    """What do-mpc 5.1.2 has of a model, where it is not installed."""

    def __init__(self, kind, symbols):
        assert (kind, symbols) == ("continuous", "SX")
        self.symbols, self.rates, self.made = {"_x": {}, "_u": {}, "_p": {}, "_tvp": {}}, {}, False

    def set_variable(self, kind, name):
        return self.symbols[kind].setdefault(name, ca.SX.sym(name))

    def set_rhs(self, name, rate):
        assert name in self.symbols["_x"]
        self.rates[name] = rate

    def setup(self):
        self.made = True


def test_the_model_of_do_mpc_has_the_same_equations(model, monkeypatch):
    """With do-mpc 5.1.2 itself its simulator is 5e-10 from ``F`` after 20 ms."""
    monkeypatch.setitem(sys.modules, "do_mpc", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "do_mpc.model", SimpleNamespace(Model=StandIn))
    made = model.do_mpc(("wished_x",))
    assert made.made
    assert [*made.symbols["_tvp"]] == ["wished_x"]
    assert [*made.symbols["_x"]] == [*made.rates] == list(model.names["x"])
    assert "plant_friction_rolling" in made.symbols["_p"]
    given = [ca.vertcat(*made.symbols[kind].values()) for kind in ("_x", "_u", "_p")]
    rates = ca.Function("f", given, [ca.vertcat(*made.rates.values())])
    for x, u in zip(STATES, INPUTS, strict=True):
        wanted = model.f(x, u, model.nominal).full()
        np.testing.assert_array_equal(rates(x, u, model.nominal).full(), wanted)


def test_the_model_of_acados_has_the_same_equations(model, monkeypatch):
    """With acados itself the example's solver was made of it, compiled and run."""
    stand_in = SimpleNamespace(AcadosModel=SimpleNamespace)
    monkeypatch.setitem(sys.modules, "acados_template", stand_in)
    made = model.acados("ball")
    assert made.name == "ball"
    given = [made.x, made.u, made.p]
    explicit = ca.Function("f", given, [made.f_expl_expr])
    implicit = ca.Function("g", [*given, made.xdot], [made.f_impl_expr])
    for x, u in zip(STATES, INPUTS, strict=True):
        wanted = model.f(x, u, model.nominal)
        np.testing.assert_array_equal(explicit(x, u, model.nominal).full(), wanted.full())
        assert implicit(x, u, model.nominal, wanted).is_zero()


@pytest.mark.parametrize("wrong", [{"period": 0.0}, {"width": -1.0}, {"period": math.nan}])
def test_what_is_out_of_range_is_refused(wrong):
    with pytest.raises(bp.TwinError, match="must be more than 0"):
        bp.symbolic("circle", **wrong)


def test_without_casadi_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(bp.TwinError, match=r"extra casadi: pip install 'ballplate\[casadi\]'"):
        bp.symbolic("circle")
