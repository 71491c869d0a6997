"""`ballplate.gym`.

Environments of Gymnasium: the rigs of a run, bit for bit, by the rules of Gymnasium."""

import subprocess
import sys
from importlib import import_module

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import SyncVectorEnv

import ballplate
import ballplate.gym
from ballplate.gym import RigEnv, RigVectorEnv
from twin.base.errors import TwinError

EXACT = {"plant.kind": "lagrange", "duration": 1.4, "metrics.start": 0.0}
"""A plant whose rigs have the same bits alone and beside any others."""
LARGE = {"plant.size": [1.6, 0.79]}
RATE = 0.5
"""A power of two, so that dividing a rate by it and multiplying again gives the rate."""


@pytest.mark.long
@pytest.mark.parametrize("name", ballplate.gym.ENVIRONMENTS)
def test_gymnasiums_own_checker_has_nothing_to_say(name):
    check_env(gymnasium.make(f"ballplate.gym:{name}").unwrapped)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:Your action space has dtype float64")
@pytest.mark.parametrize("name", ballplate.gym.ENVIRONMENTS)
def test_the_checker_of_stable_baselines_finds_no_error_where_that_is_installed(name):
    """It recommends numbers of 32 bits for actions; these have 64, as the rig's commands."""
    checker = pytest.importorskip(
        "stable_baselines3.common.env_checker", reason="pip install stable-baselines3"
    )
    checker.check_env(gymnasium.make(f"ballplate.gym:{name}").unwrapped)


@pytest.mark.long
@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_a_vector_does_what_gymnasiums_own_does_with_as_many_single_environments(mode):
    about = {"settings": EXACT, "family": "placed", "hold": 20, "preview": (0.3,)}
    name = "ballplate.gym:ballplate/Track-v0"
    own = gymnasium.make_vec(name, 3, autoreset_mode=mode, **about)
    singles = SyncVectorEnv([lambda: gymnasium.make(name, **about)] * 3, autoreset_mode=mode)
    assert own.metadata["autoreset_mode"] is singles.metadata["autoreset_mode"]
    assert own.observation_space == singles.observation_space
    assert own.action_space == singles.action_space
    ends, actions = np.zeros(2, int), np.random.default_rng(0)
    assert data_equivalence(own.reset(seed=5), singles.reset(seed=5), exact=True)
    for _ in range(80):
        action = actions.uniform(-1, 1, (3, 2)) * [[0.02], [0.5], [0.2]]
        action[1] += 0.5
        found, wanted = own.step(action), singles.step(action)
        assert data_equivalence(found, wanted, exact=True)
        ends += [found[2].sum(), found[3].sum()]
        over = found[2] | found[3]
        if mode == "Disabled" and over.any():
            again = [each.reset(options={"reset_mask": over}) for each in (own, singles)]
            assert data_equivalence(*again, exact=True)
    assert (ends > 1).all()


@pytest.mark.parametrize(
    ("rig", "half"), [({}, 0.02), ({"parameters": "hobby"}, 0.02 * 3 / 7), (LARGE, 0.04)]
)
def test_a_ball_that_rests_off_its_goal_has_half_a_reward_where_the_plate_says(rig, half):
    there = {"plant.start.x": half, "plant.friction.breakaway_ratio": 10.0}
    rests = EXACT | {"sensors.touch.dead_time": 0.0} | rig | there
    env = gymnasium.make("ballplate.gym:ballplate/Hold-v0", settings=rests, family=None)
    env.reset(seed=1)
    for _ in range(3):
        _, reward, *_, info = env.step([0.0, 0.0])
        assert info["error"] == pytest.approx(half, rel=1e-12)
        assert reward == pytest.approx(0.5, rel=1e-12)


def test_the_reward_is_the_mean_over_the_periods_for_which_an_action_is_held():
    name, more = "ballplate.gym:ballplate/Step-v0", {"settings": EXACT, "rate": RATE}
    fine, coarse = (gymnasium.make(name, hold=hold, **more) for hold in (1, 4))
    fine.reset(seed=1), coarse.reset(seed=1)
    rewards = []
    for _ in range(4):
        *_, info = fine.step([0.3, 0.1])
        rewards.append(1 / (1 + (info["error"] / 0.02) ** 2))
        assert info["error"] == pytest.approx(np.hypot(*(info["state"][0::4] - 0.15)), rel=1e-12)
    assert coarse.step([0.3, 0.1])[1] == pytest.approx(np.mean(rewards), rel=1e-12)
    assert 0 < rewards[0] < 0.01


def test_an_action_that_is_computed_for_long_takes_the_place_of_the_one_before_so_much_later():
    """Held for 5 periods, 2.5 of them computed: as actions of single periods, two of them old."""
    name, more = "ballplate.gym:ballplate/Track-v0", {"settings": EXACT, "rate": RATE}
    late = gymnasium.make_vec(name, 2, hold=5, computing_time=0.005, **more)
    fine = gymnasium.make_vec(name, 2, hold=1, **more)
    late.reset(seed=3), fine.reset(seed=3)
    before, actions = np.zeros((2, 2)), np.random.default_rng(2)
    for _ in range(8):
        action = actions.uniform(-0.1, 0.1, (2, 2))
        seen, reward, *_ = late.step(action)
        singles = [fine.step(each) for each in (before, before, action, action, action)]
        np.testing.assert_array_equal(seen, singles[-1][0])
        np.testing.assert_allclose(reward, np.mean([each[1] for each in singles], axis=0))
        before = action
    with pytest.raises(TwinError, match=r"computing_time: must be 0 to 0\.01 s"):
        gymnasium.make(name, hold=5, computing_time=0.0101, **more)


def test_a_picture_shows_the_true_ball_the_goal_and_the_plate_where_they_are():
    start = {"plant.start.x": 0.1, "plant.start.y": -0.05}
    env = RigEnv("hold", {**EXACT, **start}, render_mode="rgb_array")
    env.reset(seed=1)
    image = env.render()
    pixel = 0.7 / image.shape[1]
    assert image.shape == (round(0.395 / pixel), 480, 3)
    assert env.metadata["render_fps"] == 50

    def middle(colour):
        rows, columns = np.nonzero((image == colour).all(axis=-1))
        return (columns.mean() + 0.5) * pixel - 0.35, 0.1975 - (rows.mean() + 0.5) * pixel

    assert middle((230, 159, 0)) == pytest.approx((0.1, -0.05), abs=pixel)
    assert middle((0, 158, 115)) == pytest.approx((0.0, 0.0), abs=pixel)
    assert RigEnv("hold", EXACT).render() is None
    with pytest.raises(TwinError, match="render_mode: must be 'rgb_array' or None, got 'human'"):
        RigEnv("hold", render_mode="human")
    with pytest.raises(TwinError, match="render_mode: must be None for several rigs"):
        gymnasium.make_vec("ballplate.gym:ballplate/Track-v0", 2, render_mode="rgb_array")


def test_the_goal_is_seen_as_far_ahead_as_is_asked_for():
    circle = {"settings": EXACT | {"duration": 4.0}, "preview": (0.2, 0.5), "hold": 100}
    env = gymnasium.make("ballplate.gym:ballplate/Track-v0", **circle)
    observation, _ = env.reset(seed=0)
    observation = env.step([0.0, 0.0])[0]
    reference = ballplate.rig("circle").reference
    wanted = reference(np.array([0.2, 0.4, 0.7]))[0]
    np.testing.assert_allclose(
        observation[8:].reshape(3, 2), wanted.reshape(3, 2), rtol=0, atol=1e-12
    )


NOTHING_LOADED = """
import sys, ballplate
assert not {"gymnasium", "numpy", "ballplate.gym", "importlib.abc"} & sys.modules.keys()
from importlib.util import find_spec
assert find_spec("gymnasium") and "gymnasium" not in sys.modules  # a look that loads nothing
import gymnasium, pkgutil
assert pkgutil.get_data("gymnasium", "__init__.py")  # gymnasium keeps its own loader
assert gymnasium.__spec__.loader is gymnasium.__loader__
ours = {"ballplate/Track-v0", "ballplate/Hold-v0", "ballplate/Step-v0"}
assert ours <= gymnasium.registry.keys()
assert not {"mujoco", "ballplate.gym.environments"} & sys.modules.keys()
"""
RELOADED = """
import importlib, ballplate
importlib.reload(ballplate)
import gymnasium
assert "ballplate/Track-v0" in gymnasium.registry
"""
BROKEN = """
import sys, warnings, ballplate
sys.modules["ballplate.gym"] = None
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    import gymnasium
assert "environments are not registered" in str(said[0].message)
assert "ballplate/Track-v0" not in gymnasium.registry
"""
SCRIPT = """
{}
for name in ("ballplate/Hold-v0", "ballplate:ballplate/Hold-v0", "ballplate.gym:ballplate/Hold-v0"):
    assert gymnasium.make(name).spec.id == "ballplate/Hold-v0"
"""
ORDERS = (
    "import ballplate, gymnasium",
    "import gymnasium, ballplate",
    "import ballplate.gym, gymnasium",
    "import ballplate\nfrom gymnasium.envs.registration import registry\nimport gymnasium",
)


@pytest.mark.short("program0")
@pytest.mark.parametrize(
    "program",
    [NOTHING_LOADED, RELOADED, BROKEN, *(pytest.param(SCRIPT.format(order), marks=pytest.mark.long)
     for order in ORDERS)],
)  # fmt: skip
def test_the_environments_are_there_in_any_order_of_imports(program):
    """Importing ballplate loads nothing for that; gymnasium itself reads no entry points."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_without_the_extra_one_line_says_what_to_install(monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "gymnasium"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "ballplate.gym")
    with pytest.raises(ballplate.TwinError, match=r"extra gym: pip install 'ballplate\[gym\]'"):
        import_module("ballplate.gym")


def test_a_reset_that_cannot_be_is_refused():
    envs = gymnasium.make_vec("ballplate.gym:ballplate/Step-v0", 2, settings=EXACT)
    with pytest.raises(ballplate.TwinError, match="reset once before"):
        envs.step(np.zeros((2, 2)))
    with pytest.raises(ballplate.TwinError, match="reset_mask: must be 2 truth values"):
        envs.reset(options={"reset_mask": np.array([True])})
    with pytest.raises(ballplate.TwinError, match="one for each of 2 rigs, got 3"):
        envs.reset(seed=[1, 2, 3])


@pytest.mark.parametrize("action", [np.zeros(3), np.zeros(4), 0.5, None, np.zeros((1, 2))])
def test_an_action_of_another_shape_is_refused(action):
    env = RigEnv("hold", EXACT)
    env.reset(seed=1)
    with pytest.raises(TwinError, match=r"action: must be numbers of shape \(2,\), got"):
        env.step(action)
    envs = RigVectorEnv("hold", EXACT, num_envs=2)
    envs.reset(seed=1)
    with pytest.raises(TwinError, match=r"actions: must be numbers of shape \(2, 2\), got"):
        envs.step(np.zeros(2) if action is None else action)
