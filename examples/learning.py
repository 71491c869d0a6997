# %% [markdown]
# # A baseline that learns
# This page shows how much CMA-ES improves approximate feedback linearisation on the circle. The law
# of the shipped scenario runs unchanged in every control period, with its observer and predictor.
# Eight numbers add a plate acceleration: from the error, its rate, its leaky integral and the
# direction in which the goal moves, each along and across. So few numbers need neither gradient nor
# network: a search that ranks policies by their reward finds them in a few hundred episodes.
# Everything uses `gymnasium.make_vec("ballplate.gym:ballplate/Track-v0")`: the policies of all
# learning seeds are rigs of one vector environment, and the search maximises its reward. It needs
# the extra `gym`, and `pip install cmaes`.

# %%
from pathlib import Path

import gymnasium
import numpy as np
from cmaes import CMA
from matplotlib.figure import Figure
from scipy.stats import t as student

from controllers.interfaces import Measurement
from twin.base.page import markdown
from twin.run.controller_building import build_controllers
from twin.run.metrics import tracking_error

SEEDS, POLICIES, GENERATIONS, FAMILY_RIGS = 5, 10, 12, 8
DURATION, JUDGED = 14.0, 5.6  # s, of an episode of learning; its reward is that of the last turn
LARGEST = 2.0  # rad/s^2, of what is added
SCALES = np.array([0.02, 0.1, 0.02, 0.05])  # m, m/s, m s, m/s that count as one


def vector(count, *settings, **family):
    """Rigs whose actions hold for one control period."""
    name, how = "ballplate.gym:ballplate/Track-v0", {"hold": 1, "autoreset_mode": "Disabled"}
    return gymnasium.make_vec(name, count, settings=list(settings), **how, **family)


# %% [markdown]
# An episode of N policies, each on its rig. What turning about phi and theta does to the ball along
# x and y has opposite signs.
# %%
def added(weights, x, goal, integral, period):
    """Plate accelerations to add at estimates x (N, 8) for goals (5, N, 2); leads the integral."""
    error, rate = goal[0] - x[:, 0::4], goal[1] - x[:, 1::4]
    integral += period * (error - integral)
    heading = goal[1] / (np.hypot(*goal[1].T)[:, None] + SCALES[3])
    parts = (error / SCALES[0], rate / SCALES[1], integral / SCALES[2], heading)
    along, across = np.einsum("nkf,nfa->kna", weights, np.stack(parts, axis=1))
    return LARGEST * np.tanh(along + across[:, ::-1] * [-1.0, 1.0]) * [1.0, -1.0]


def episodes(env, policies, seeds, judged):
    """Mean reward of each, and tracking error of (C.7) in %, nan where the ball was lost."""
    seen, _ = env.reset(seed=[int(seed) for seed in seeds])
    task, count = env.rigs.task, len(policies)
    controller = build_controllers(env.rigs.episodes.scenarios)
    weights, integral = policies.reshape(-1, 2, 4), np.zeros((count, 2))
    rewards, errors, goals, ended = [], [], [], np.zeros(count, bool)
    for tick in range(task.ticks):
        now = Measurement(tick * task.period, seen[:, :4], seen[:, 6], seen[:, 7] > 0)
        if tick == 0:
            controller.start(now)
        step = controller.command(now)
        goal = np.broadcast_to(controller.reference(now.time), (5, count, 2))
        more = task.period * added(weights, step.estimate, goal, integral, task.period)
        seen, reward, terminated, _, info = env.step((step.rate + more) / task.rate)
        controller.applied(seen[:, 4:6])
        ended |= terminated
        if (tick + 1) * task.period > judged:
            rewards.append(reward)
            errors.append(info["state"][:, 0::4] - seen[:, 8:10])
            goals.append(seen[:, 8:10])
    ways = zip(*(np.stack(each, axis=1) for each in (errors, goals)), strict=True)
    found = [tracking_error(*each) for each in ways]
    return np.mean(rewards, axis=0), np.where(ended, np.nan, found)


# %% [markdown]
# Learning begins anew with each seed. A generation meets noise that none has seen before; beside
# its policies runs the mean of them, by which it is judged, and the law alone.
# %%
searches = [CMA(np.zeros(8), 0.3, seed=s, population_size=POLICIES) for s in range(SEEDS)]
env = vector(
    SEEDS * (POLICIES + 1) + 1, f"duration={DURATION}", "metrics.start=0", "plant.step=0.002"
)
curve, alone = np.empty((SEEDS, GENERATIONS)), np.empty(GENERATIONS)
for generation in range(GENERATIONS):
    asked = [[search.ask() for _ in range(POLICIES)] for search in searches]
    tried = [one for own, s in zip(asked, searches, strict=True) for one in (*own, s.mean)]
    noise = np.random.SeedSequence(generation).generate_state(SEEDS + 1) >> 1
    seeds = [*np.repeat(noise[:-1], POLICIES + 1), noise[-1]]
    reward, error = episodes(env, np.array([*tried, np.zeros(8)]), seeds, JUDGED)
    for search, own, got in zip(
        searches, asked, reward[:-1].reshape(SEEDS, -1).tolist(), strict=True
    ):
        search.tell([(one, -value) for one, value in zip(own, got[:-1], strict=True)])
    curve[:, generation], alone[generation] = error[:-1].reshape(SEEDS, -1)[:, -1], error[-1]

# %% The verdict: the shipped circle on noise never seen, then rigs that learning never saw either
policies = np.array([*(search.mean for search in searches), np.zeros(8)])
names, rows = [*(f"learned, seed {seed}" for seed in range(SEEDS)), "the law alone"], []
_, nominal = episodes(vector(len(policies)), policies, [900_000] * len(policies), 10.0)
env = vector(len(policies) * FAMILY_RIGS, family="uncertain")
seeds = [900_000 + rig for rig in range(FAMILY_RIGS)] * len(policies)
_, family = episodes(env, np.repeat(policies, FAMILY_RIGS, axis=0), seeds, 10.0)
for name, one, several in zip(names, nominal, family.reshape(len(policies), -1), strict=True):
    ran = several[~np.isnan(several)]
    told = (one, ran.mean(), ran.max()) if len(ran) else (one, np.nan, np.nan)
    rows.append((name, *(f"{value:.2f}" for value in told), str(len(several) - len(ran))))
heads = ("policy", "circle of 25 s, nominal rig [%]", f"mean of {FAMILY_RIGS} uncertain rigs [%]",
         "largest [%]", "rigs lost")  # fmt: skip
mean = curve.mean(axis=0)
half = student.ppf(0.975, SEEDS - 1) * curve.std(axis=0, ddof=1) / np.sqrt(SEEDS)
text = f"""
![Tracking error over episodes](learning.png)

Tracking error in the episodes of learning: {alone.mean():.2f} % with the law alone, and with the
mean policies after the last generation {mean[-1]:.2f} % +- {half[-1]:.2f} % (95 % interval of the
mean of {SEEDS} learning seeds, each generation on new noise). This holds for one circle on one
nominal rig.

The table shows the shipped circle with its physics step and indicator, on new noise, and rigs of
the family `uncertain`, which are new to the learned policies, too.

{markdown(heads, rows)}
Budget: {SEEDS} learning seeds, {GENERATIONS} generations of {POLICIES} episodes of {DURATION:g} s
each.
"""
print(text)

# %% Its page, and the learning curve as a picture
made = "Made by `uv run python docs/regenerate.py learning`; the program is `examples/learning.py`."
about = [line[2:] for line in Path(__file__).read_text("utf-8").split("# %%")[1].splitlines()[1:]]
page = "\n".join([about[0], "", made, "", *about[1:]])
Path("learning.md").write_text(page.rstrip() + "\n" + text, "utf-8")
figure = Figure(figsize=(8, 4.2), layout="constrained")
axes, count = figure.subplots(), POLICIES * np.arange(GENERATIONS)
axes.plot(count, alone, color="tab:orange", label="the law alone")
axes.plot(count, curve.T, color="tab:blue", alpha=0.3, linewidth=0.8)
axes.plot(count, mean, color="tab:blue", label=f"with what was learned, mean of {SEEDS}")
axes.fill_between(count, mean - half, mean + half, color="tab:blue", alpha=0.2,
                  label="95 % interval of the mean")  # fmt: skip
axes.set(xlabel="episodes tried before, of each learning seed", ylabel="tracking error [%]",
         ylim=(0, None))  # fmt: skip
axes.grid(color="0.9")
axes.legend()
figure.savefig("learning.png", dpi=110)
