"""Tests of `twin.emulator.load`."""

import math

import pytest

from twin.emulator.load import Inertia, InertiaLoad, ShaftLoad

DT = 0.0005


def test_an_inertia_runs_out_by_its_friction_as_the_closed_form_has_it():
    load = InertiaLoad()
    load.body, load.rate = Inertia(2e-3, coulomb=0.05, viscous=0.0), 10.0
    for _ in range(round(1.0 / DT)):
        load.coast(DT)
    # w^2 J / (2 Mc): 10^2 * 2e-3 / 0.1
    assert load.rate == 0
    assert load.angle == pytest.approx(2.0, rel=1e-3)


def test_viscous_friction_lets_the_rate_decay_exponentially():
    load = InertiaLoad()
    load.body, load.rate = Inertia(1e-3, coulomb=0.0, viscous=2e-3), 10.0
    for _ in range(round(0.5 / DT)):
        load.coast(DT)
    assert load.rate == pytest.approx(10 * math.exp(-1), rel=1e-3)


@pytest.mark.parametrize(("torque", "moves"), [(0.049, False), (0.051, True)])
def test_coulomb_friction_holds_a_shaft_at_rest_up_to_its_torque(torque, moves):
    load = InertiaLoad()
    load.external = torque
    for _ in range(100):
        load.coast(DT)
    assert (load.rate > 0) is moves


def test_the_controller_reaches_an_angle_against_friction_and_torque():
    load = InertiaLoad()
    load.external = 0.2
    for _ in range(round(1.0 / DT)):
        load.drive(0.5, 0.0, 0.0, 3.0, DT)
    assert load.angle == pytest.approx(0.5, abs=1e-3)
    assert abs(load.rate) < 1e-2


def test_a_limited_torque_accelerates_as_newton_has_it():
    load = InertiaLoad()
    load.body = Inertia(1e-3, coulomb=0.05, viscous=0.0)
    for _ in range(100):
        load.drive(None, 1e3, 0.0, 0.15, DT)
    assert load.torque == 0.15
    assert load.rate == pytest.approx((0.15 - 0.05) / 1e-3 * 100 * DT, rel=1e-9)


def test_a_jammed_shaft_stands_whatever_the_torque():
    load = InertiaLoad()
    load.jammed = True
    for _ in range(100):
        load.drive(1.0, 0.0, 0.0, 3.0, DT)
    assert (load.angle, load.rate, load.torque) == (0.0, 0.0, 3.0)


def test_the_shaft_of_a_plant_is_commanded_a_rate_that_ends_the_lag():
    load = ShaftLoad(gain=10.0)
    load.sense(0.3, 0.0)
    load.drive(0.5, 2.0, 0.0, 1.0, DT)
    assert load.rate == pytest.approx(2.0 + 10.0 * (0.2 - 2.0 * DT))
    load.drive(None, 2.0, 0.0, 1.0, DT)
    assert load.rate == 2.0
