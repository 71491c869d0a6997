# %% [markdown]
# # A policy that PPO learns
# This page shows what PPO of Stable-Baselines3 reaches on `ballplate/Track-v0`, compared with the
# law of the thesis and the cure. PPO gets no law, no observer and no model. Its network of two
# layers sees the ball as the screen reports it, 42 ms old and with noise, the motion of the ball
# since the last step, the plate, and the goal now and up to 0.4 s ahead. Its action is a pair of
# plate rates, held for 20 ms. It learns on the exact equations of the rig, with friction, dead time
# and noise; the table is of the mechanism in MuJoCo. It needs the extra `gym`, and
# `pip install stable-baselines3`, which installs PyTorch: 6.5 GB on Linux, most of it for graphics
# cards, which this program does not use.

# %%
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from matplotlib.figure import Figure
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import ballplate as bp
from twin.base.page import markdown
from twin.run.metrics import tracking_error

SEEDS, RIGS, LOOKS, STEPS, FAMILY_RIGS = 2, 128, 8, 131_072, 4  # STEPS from one look to the next
RATE = 0.6  # rad/s of the plate that an action of 1 means
SCALES = np.array([0.05] * 8 + [0.1] * 2 + [0.3] * 2 + [0.01] * 2 + [0.1] * 2)  # that count as one
FAST = ("plant.kind=lagrange", "plant.step=0.002", "metrics.start=0")


def vector(count, *settings, **family):
    """Rigs of one batch; each begins its next episode when it is reset."""
    how = {"rate": RATE, "autoreset_mode": "Disabled", "settings": list(settings)}
    return gymnasium.make_vec("ballplate/Track-v0", count, **how, **family)


# %% [markdown]
# Stable-Baselines3 has its own form of vectors: a rig at the end of an episode begins the next one
# in the same step, and `infos` has its last observation. The network sees errors instead of places,
# each divided by its scale.
# %%
# ruff: noqa: D102
class Batch(VecEnv):
    """A batch of rigs for Stable-Baselines3."""

    def __init__(self, env):
        self.env, self.ball = env, np.zeros((env.num_envs, 2))
        seen = Box(-np.inf, np.inf, SCALES.shape, dtype=np.float32)
        super().__init__(env.num_envs, seen, env.single_action_space)

    def features(self, seen, began):
        """Errors now and ahead, plate, its rates, motion since the last step, ball."""
        ball = seen[:, 0:4:2]
        motion = np.where(began[:, None], 0.0, ball - self.ball)
        errors = (seen[:, 8:].reshape(len(seen), -1, 2) - ball[:, None]).reshape(len(seen), -1)
        parts = (errors, seen[:, 1:4:2], seen[:, 4:6], motion, ball)
        return (np.concatenate(parts, axis=1) / SCALES).astype(np.float32)

    def reset(self):
        seen, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        self.ball = seen[:, 0:4:2]
        return self.features(seen, np.ones(self.num_envs, bool))

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        seen, reward, terminated, truncated, info = self.env.step(self.actions)
        now, over = self.features(seen, np.zeros(self.num_envs, bool)), terminated | truncated
        self.error, self.goal = info["state"][:, 0::4] - seen[:, 8:10], seen[:, 8:10]
        infos = [
            {"terminal_observation": row, "TimeLimit.truncated": bool(late)} if done else {}
            for row, done, late in zip(now, over, truncated, strict=True)
        ]
        if over.any():
            seen, _ = self.env.reset(options={"reset_mask": over})
            now = np.where(over[:, None], self.features(seen, over), now)
        self.ball = seen[:, 0:4:2]
        return now, reward.astype(np.float32), over, infos

    def close(self):
        self.env.close()

    def get_attr(self, attr_name, indices=None):
        return [getattr(self.env, attr_name)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        setattr(self.env, attr_name, value)

    def env_method(self, method_name, *args, indices=None, **kwargs):
        return [getattr(self.env, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


def errors(ppo, env, start):
    """Tracking error of (C.7) in % of each rig from a time in s on; nan where the ball was lost."""
    batch, task, found = Batch(env), env.rigs.task, []
    batch.seed(90_000)
    seen, lost = batch.reset(), np.zeros(env.num_envs, bool)
    for step in range(task.ticks // task.hold - 1):
        batch.step_async(ppo.predict(seen, deterministic=True)[0])
        seen, _, over, _ = batch.step_wait()
        lost |= over
        if (step + 1) * task.hold * task.period > start:
            found.append((batch.error, batch.goal))
    ways = zip(*(np.stack(each, axis=1) for each in zip(*found, strict=True)), strict=True)
    return np.where(lost, np.nan, [tracking_error(*each) for each in ways])


# %% [markdown]
# PPO learns on the exact equations of the rig, with its friction, dead time and noise, in episodes
# of 10 s. Every 131,072 steps its policy without exploration runs once on noise that is new to it.
# %%
curve, policies = np.full((SEEDS, LOOKS), np.nan), []
for seed in range(SEEDS):
    batch = Batch(vector(RIGS, "duration=10", *FAST))
    policies.append(PPO(
        "MlpPolicy", batch, n_steps=128, batch_size=2048, n_epochs=8, gamma=0.99, seed=seed,
        learning_rate=lambda left: 5e-4 * left, policy_kwargs={"log_std_init": -1.0}, device="cpu",
    ))  # fmt: skip

    def look(seen, _, found=curve[seed]):
        """Run the policy of now where a look is due."""
        number, rest = divmod(seen["self"].num_timesteps, STEPS)
        if rest == 0:
            found[number - 1] = errors(seen["self"], vector(1, "duration=14", *FAST), 5.6)[0]
        return True

    policies[-1].learn(LOOKS * STEPS, callback=look)


# %% [markdown]
# The verdict is on the mechanism in MuJoCo, which learning did not have: the shipped circle, and
# rigs of the family `uncertain`. The laws run on the same rigs.
# %%
def row(name, nominal, family):
    """A row of the table, errors in %."""
    ran = family[~np.isnan(family)]
    told = (nominal, *((ran.mean(), ran.max()) if len(ran) else (np.nan, np.nan)))
    return (name, *(f"{value:.3g}" for value in told), str(len(family) - len(ran)))


def of_law(scenario, **settings):
    """Tracking error of a shipped scenario in %; nan where the ball was lost."""
    found = bp.run(scenario, baseline=False, **settings).metrics["tracking_error_percent"]
    return np.nan if found is None else found


rigs = [bp.family("uncertain", 1, draw=90_000 + rig)[0] for rig in range(FAMILY_RIGS)]
rows = [
    row(f"PPO, seed {seed}", errors(ppo, vector(1), 10.0)[0],
        errors(ppo, vector(FAMILY_RIGS, family="uncertain"), 10.0))
    for seed, ppo in enumerate(policies)
]  # fmt: skip
laws = {"law of the thesis": "circle", "cure": "cure"}
nominal = {name: of_law(scenario) for name, scenario in laws.items()}
for name, scenario in laws.items():
    several = np.array([of_law(scenario, settings=each) for each in rigs])
    rows.append(row(name, nominal[name], several))
heads = ("", "circle of 25 s, nominal rig [%]", f"mean of {FAMILY_RIGS} uncertain rigs [%]",
         "largest [%]", "rigs lost")  # fmt: skip
last, far = curve[:, -1], nominal["cure"]
text = f"""
![Tracking error over steps of learning](learning_ppo.png)

{markdown(heads, rows)}
After {LOOKS * STEPS:,} steps the tracking error in the last look is {np.nanmin(last):.2f} to
{np.nanmax(last):.2f} % over {SEEDS} seeds of learning, with {int(np.isnan(last).sum())} lost.
{"No seed reaches" if not (last <= far).any() else "A seed reaches"} the error of the cure,
{far:.3g} %. PPO has no memory of friction, so it cannot learn a rig's friction while it runs,
as the observer of the cure does.

Budget: {SEEDS} seeds, {LOOKS * STEPS * 0.02 / 3600:.1f} h of simulated time each.
"""
print(text)

# %% Its page, and the learning curve as a picture
made = (
    "Made by `uv run python docs/regenerate.py learning_ppo` with Stable-Baselines3 installed; the"
)
about = [line[2:] for line in Path(__file__).read_text("utf-8").split("# %%")[1].splitlines()[1:]]
page = "\n".join([about[0], "", made, "program is `examples/learning_ppo.py`.", "", *about[1:]])
more = "\nNext: [eight numbers that are learned](learning.md).\n"
Path("learning_ppo.md").write_text(page.rstrip() + "\n" + text + more, "utf-8")
figure = Figure(figsize=(8, 4.2), layout="constrained")
axes, count = figure.subplots(), STEPS * np.arange(1, LOOKS + 1) / 1e6
for seed, each in enumerate(curve):
    axes.semilogy(
        count, each, color="tab:blue", alpha=0.7, label="PPO, each seed" if not seed else ""
    )
for (name, value), color in zip(nominal.items(), ("tab:orange", "tab:green"), strict=True):
    axes.axhline(value, color=color, label=name)
axes.set(xlabel="million steps of learning; no line where the ball was lost", xlim=(0, count[-1]),
         ylabel="tracking error [%]")  # fmt: skip
axes.grid(color="0.9", which="both")
axes.legend()
figure.savefig("learning_ppo.png", dpi=110)
