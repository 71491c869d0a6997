"""A baseline that learns: what CMA-ES adds to approximate feedback linearisation on the circle.

Run with ``uv run python -m benchmarks.gym_learning --doc docs/learning.md``; the page says what is
learned and how.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from cmaes import CMA
from scipy.stats import t as student

from benchmarks.gym_residual import NUMBERS, episodes, vector
from controllers.arrays import Array
from twin.markdown import table
from twin.writing import write_whole

ABOUT = """\
What CMA-ES adds to approximate feedback linearisation on the circle. The law of the shipped
scenario runs as it is, every control period, behind its observer and predictor; eight numbers say
what plate acceleration is added to it: from the error, its rate, its leaky integral and the
direction in which the goal moves, each along and across. So few numbers need neither gradient nor
network: a search that ranks policies by their reward finds them in a few hundred episodes.
Everything is done through
`gymnasium.make_vec("ballplate.gym:ballplate/Track-v0")`: the policies of all learning seeds are
rigs of one vector environment, and its reward is what is searched for.
"""
SEEDS = 5
"""Times that learning begins anew."""
POLICIES = 10
"""Policies that are tried in a generation, besides the mean of them."""
DURATION = 14.0
"""Of an episode of learning, s."""
JUDGED = 5.6
"""Time in s from which such an episode is rewarded: the last whole turn of it."""
FAMILY_RIGS = 8
GOAL = 5.0
"""Tracking error in % that is aimed at."""


def learn(generations: int) -> tuple[Array, Array, Array]:
    """Search for policies.

    Returns:
        The mean policy of each learning seed, (SEEDS, NUMBERS); its tracking errors in % on noise
        it has not seen, (SEEDS, generations); those of the law alone, (generations,).
    """
    searches = [
        CMA(mean=np.zeros(NUMBERS), sigma=0.3, seed=seed, population_size=POLICIES)
        for seed in range(SEEDS)
    ]
    each = POLICIES + 1
    short = (f"duration={DURATION}", "metrics.start=0", "plant.step=0.002")
    env = vector(SEEDS * each + 1, short)
    curve, alone = np.empty((SEEDS, generations)), np.empty(generations)
    for generation in range(generations):
        noise = np.random.SeedSequence(generation).generate_state(SEEDS + 1) >> 1
        asked = [[search.ask() for _ in range(POLICIES)] for search in searches]
        tried = [[*own, search.mean] for own, search in zip(asked, searches, strict=True)]
        weights = np.array([*(one for own in tried for one in own), np.zeros(NUMBERS)])
        seeds = [*np.repeat(noise[:SEEDS], each).tolist(), int(noise[SEEDS])]
        found = episodes(env, weights, seeds, JUDGED)
        for seed, search in enumerate(searches):
            own = found.reward[seed * each :][:POLICIES]
            search.tell([(one, -float(value)) for one, value in zip(asked[seed], own, strict=True)])
        curve[:, generation] = found.error[each - 1 : -1 : each]
        alone[generation] = found.error[-1]
        print(
            f"generation {generation}: {np.array2string(curve[:, generation], precision=2)} %, "
            f"the law alone {alone[generation]:.2f} %",
            flush=True,
        )
    return np.array([search.mean for search in searches]), curve, alone


def verdict(policies: Array, **more: Any) -> Array:
    """Tracking errors in % of policies on the shipped circle of 25 s, (policies, rigs).

    Args:
        policies: Each runs on the same rigs.
        more: ``family`` and ``rigs``; without, one nominal rig.
    """
    rigs = more.pop("rigs", 1)
    env = vector(len(policies) * rigs, (), **more)
    weights = np.repeat(policies, rigs, axis=0)
    seeds = [900_000 + rig for rig in range(rigs)] * len(policies)
    return episodes(env, weights, seeds, 10.0).error.reshape(len(policies), rigs)


def interval(values: Array) -> tuple[Array, Array]:
    """Mean over the first axis and half the width of its 95 % interval (Student)."""
    count = len(values)
    half = student.ppf(0.975, count - 1) * values.std(axis=0, ddof=1) / np.sqrt(count)
    return values.mean(axis=0), half


def draw(path: Path, curve: Array, alone: Array) -> None:
    """The learning curve as a picture."""
    import matplotlib as mpl  # noqa: PLC0415  as everywhere, when it is drawn
    from matplotlib.figure import Figure  # noqa: PLC0415

    from twin.run.overview_plot import LOOK  # noqa: PLC0415

    count = POLICIES * np.arange(curve.shape[1])
    mean, half = interval(curve)
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(8, 4.2), layout="constrained")
        axes = figure.subplots()
        axes.plot(count, alone, color="tab:orange", label="the law alone")
        axes.plot(count, curve.T, color="tab:blue", alpha=0.3, linewidth=0.8)
        axes.plot(count, mean, color="tab:blue", label=f"with what was learned, mean of {SEEDS}")
        axes.fill_between(count, mean - half, mean + half, color="tab:blue", alpha=0.2,
                          label="95 % interval of the mean")  # fmt: skip
        axes.axhline(GOAL, color="black", linewidth=1, linestyle=":", label=f"{GOAL:g} %")
        axes.set(xlabel="episodes tried before, of each learning seed",
                 ylabel="tracking error [%]", ylim=(0, None))  # fmt: skip
        axes.legend()
        write_whole(path, lambda file: figure.savefig(file, format="png", dpi=110))


def page(curve: Array, alone: Array, nominal: Array, family: Array, about: str) -> str:
    """docs/learning.md; the last row of the verdicts is the law alone."""
    last, half = interval(curve[:, -1])
    mean, width = interval(curve)
    first, whole = (
        f"after {POLICIES * int(found[0])} episodes of each seed" if len(found) else "never"
        for found in (np.flatnonzero(mean < GOAL), np.flatnonzero(mean + width < GOAL))
    )
    reached = f"The mean was first below {GOAL:g} % {first}, the whole interval {whole}."
    heads = ("policy", "circle of 25 s, nominal rig [%]",
             f"mean of {FAMILY_RIGS} uncertain rigs [%]",
             "largest [%]", "rigs lost")  # fmt: skip
    names = [*(f"learned, seed {seed}" for seed in range(SEEDS)), "the law alone"]
    rows = []
    for name, one, several in zip(names, nominal[:, 0], family, strict=True):
        lost = int(np.isnan(several).sum())
        ran = several[~np.isnan(several)]
        told = (f"{ran.mean():.2f}", f"{ran.max():.2f}") if len(ran) else ("-", "-")
        rows.append((name, "lost" if np.isnan(one) else f"{one:.2f}", *told, str(lost)))
    return "\n".join(
        (
            "# A baseline that learns\n",
            "Made by `uv run python docs/regenerate.py learning`.\n",
            ABOUT,
            "![Tracking error over episodes](learning.png)\n",
            f"Of the law alone the episodes of learning have {alone.mean():.2f} %, of the mean "
            f"policies after the last generation {last:.2f} % +- {half:.2f} % (95 % interval of "
            f"the mean of {SEEDS} learning seeds, each generation on noise not seen before). "
            f"{reached} "
            "That is one circle on one nominal rig, and no more.\n",
            "The verdict: the shipped circle, its physics step and its judging, on noise never "
            "seen; then rigs of the family `uncertain`, which learning never saw either.\n",
            table(heads, rows),
            about,
        )
    )


def parser() -> argparse.ArgumentParser:
    """What the command line may say."""
    about = argparse.ArgumentParser(description=__doc__)
    about.add_argument("--generations", type=int, default=12)
    about.add_argument("--doc", type=Path)
    return about


def main() -> None:
    """Learn, and write the page and its picture."""
    options = parser().parse_args()
    begin, spent = time.monotonic(), time.process_time()
    policies, curve, alone = learn(options.generations)
    judged = np.array([*policies, np.zeros(NUMBERS)])
    nominal, family = verdict(judged), verdict(judged, family="uncertain", rigs=FAMILY_RIGS)
    minutes = (time.monotonic() - begin) / 60, (time.process_time() - spent) / 60
    count = SEEDS * options.generations * POLICIES
    about = (
        f"Budget: {SEEDS} learning seeds, {options.generations} generations of {POLICIES} episodes "
        f"of {DURATION:g} s each ({count} episodes, {count * DURATION / 3600:.1f} h of simulated "
        f"time); with the verdict {minutes[0]:.0f} minutes by the clock of a machine with other "
        f"work, {minutes[1]:.0f} of processor time.\n"
    )
    text = page(curve, alone, nominal, family, about)
    print(text)
    if options.doc is not None:
        draw(options.doc.with_suffix(".png"), curve, alone)
        write_whole(options.doc, lambda file: file.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    main()
