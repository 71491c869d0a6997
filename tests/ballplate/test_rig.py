"""`ballplate`: A rig stepped by hand does what a run does with the same controller."""

import numpy as np
import pytest

import ballplate

SHORT = {"duration": 0.3, "metrics": {"start": 0}, "baseline": False}


def driven(rig):
    """The rig, driven by the scenario's own controller."""
    with rig:
        while not rig.done:
            step = rig.controller.command(rig.measurement)
            rig.step(step.rate, step.estimate, step.further)
            rig.controller.applied(rig.applied)
    return rig


@pytest.mark.short("circle")
@pytest.mark.parametrize("scenario", ["circle", "cure"])
def test_stepped_with_the_scenarios_own_controller_it_gives_the_record_of_the_run(scenario):
    alone = ballplate.run(scenario, **SHORT)
    found = driven(ballplate.rig(scenario, **SHORT)).result()
    assert list(found) == list(alone)
    for name in found:
        # what was requested is told in rates
        near = 1e-9 if name.startswith("requested") else 0.0
        np.testing.assert_allclose(found[name], alone[name], rtol=0, atol=near, err_msg=name)
    assert found.metrics["outcome"] == "finished"
    assert found.metrics["rms_error"] == alone.metrics["rms_error"]


def test_many_rigs_of_one_scenario_differ_in_their_noise_and_in_nothing_else():
    rig = driven(ballplate.rig("circle", plant={"kind": "lagrange"}, count=3, **SHORT))
    assert rig.state.shape == (3, 8)
    each = [rig.result(number) for number in range(3)]
    assert [one.scenario.seed for one in each] == [0, 1, 2]
    assert not np.array_equal(each[0]["measured_x"], each[1]["measured_x"])
    alone = ballplate.run("circle", plant={"kind": "lagrange"}, seed=2, **SHORT)
    np.testing.assert_allclose(each[2]["measured_x"], alone["measured_x"], atol=1e-9)


def test_a_rate_beyond_the_limits_is_applied_as_far_as_they_allow():
    with ballplate.rig("hold", plant={"kind": "lagrange"}, **SHORT) as rig:
        rig.step([1e3, 0.0])
        most = rig.scenarios[0].rig.limits.acceleration * rig.period
        assert 0 < rig.applied[0, 0] <= most * (1 + 1e-12)
        assert rig.time == pytest.approx(rig.period)


def test_a_ball_that_falls_ends_its_rig():
    start = {"kind": "lagrange", "start": {"x": 0.3, "x_rate": 1.0}}
    with ballplate.rig("hold", plant=start, duration=2, metrics={"start": 0}) as rig:
        while not rig.done:
            rig.step([0.0, 0.0])
    assert rig.result().outcome == "fell"
    assert rig.time < 1


def test_out_of_its_context_and_after_its_end_a_rig_is_not_stepped(tmp_path):
    rig = ballplate.rig("hold", plant={"kind": "lagrange"}, duration=0.004, metrics={"start": 0})
    with pytest.raises(ballplate.TwinError, match="inside its with block"):
        rig.step([0, 0])
    with rig:
        while not rig.done:
            rig.step([0, 0])
        with pytest.raises(ballplate.TwinError, match="is over"):
            rig.step([0, 0])
        with pytest.raises(ballplate.TwinError, match="after the with block"):
            rig.result()
    assert rig.result().finished
    assert ballplate.load(rig.result().save(tmp_path)).finished


def test_a_rig_left_early_was_aborted():
    with ballplate.rig("hold", plant={"kind": "lagrange"}, **SHORT) as rig:
        rig.step([0, 0])
    assert rig.result().outcome == "aborted"
    assert len(rig.result().time) == 1


WRONG = {
    "rate": [
        (np.zeros((3, 2)), r"must be numbers of shape \(2,\) or \(1, 2\), got shape \(3, 2\)"),
        (None, "got None"),
        (5.0, "got 5.0"),
        ("a", "got 'a'"),
        ([[1, 2], [3]], "must be numbers"),
        ([1j, 2], "must be numbers"),
    ],
    "estimate": [([1, 2, 3], r"of shape \(8,\) or \(1, 8\), got shape \(3,\)")],
    "further": [([1.0], r"of shape \(0,\) or \(1, 0\), got shape \(1,\)")],
    "computed_s": [(each, "must be") for each in (-1e-3, np.nan, np.inf, [0.1], "soon")],
}


@pytest.mark.parametrize(
    ("name", "given", "told"), [(name, *each) for name, every in WRONG.items() for each in every]
)
def test_numbers_of_another_shape_are_named_and_nothing_moves(name, given, told):
    with ballplate.rig("hold", plant={"kind": "lagrange"}, **SHORT) as rig:
        with pytest.raises(ballplate.TwinError, match=f"{name}: .*{told}"):
            rig.step(**({"rate": [0, 0]} | {name: given}))
        assert rig.time == 0
        rig.step([0, 0])
    for number in (1, -1, "a", None):
        with pytest.raises(ballplate.TwinError, match="rig: must be 0 to 0"):
            rig.result(number)


def test_rates_that_are_computed_for_long_come_late_and_the_record_says_by_how_much():
    """2.5 periods of computing: two are held, as if the caller had commanded them himself."""
    exact, rates = {"plant": {"kind": "lagrange"}, **SHORT}, np.random.default_rng(1)
    with ballplate.rig("circle", **exact) as late, ballplate.rig("circle", **exact) as plain:
        period = late.period
        for number in range(20):
            wanted = rates.uniform(-0.1, 0.1, 2)
            computed = 2.5 * period if number % 2 else 0.5 * period
            begin = late.time
            seen = late.step(wanted, computed_s=computed)
            assert late.time - begin == pytest.approx(period * (3 if number % 2 else 1))
            for _ in range(2 * (number % 2)):
                plain.step(plain.applied)
            np.testing.assert_array_equal(seen.y, plain.step(wanted).y)
    one, other = late.result(), plain.result()
    for name in other:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    assert "computing_time" not in other
    lateness = np.array([0, 1, 2, 2] * 10) * period
    np.testing.assert_allclose(one["command_lateness"], lateness, atol=1e-12)
    nan = np.nan
    np.testing.assert_allclose(one["computing_time"] / period, [0.5, 2.5, nan, nan] * 10)
    assert one.metrics["late_percent"] == 75
