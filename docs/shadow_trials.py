"""Makes shadow.md: what the shadow says of many simulated rigs of which the truth is known.

uv run python docs/shadow_trials.py

Healthy rigs, and ones that something happens to (shadow.toml), under AFL and under every other law.
What has been simulated is kept in runs/shadow and used again while the code stays the same.
"""

from __future__ import annotations

import itertools
import json
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import pandas as pd
from scipy import stats

from controllers.arrays import Array
from controllers.ballplate import corner_frequency, time_constant
from docs.pages import HERE, filled, kept, planned
from twin.base.errors import plural
from twin.base.jobs import cores, results
from twin.base.writing import write_whole
from twin.cli.options import PROCESSES_OPTION
from twin.cli.output import progress
from twin.scenario.load import load
from twin.scenario.schema import Scenario, at_study_step
from twin.shadow.belief import TWIN_ERROR_STD, WATCHED_PARAMETERS, belief_of, logs
from twin.shadow.causes import likely
from twin.shadow.follow import shadow
from twin.shadow.horizon import CHI_SQUARE_95, CHI_SQUARE_MEDIAN
from twin.shadow.plate import PLAY_WIDTHS_RAD
from twin.study.schema import draw_rigs as drawn_rigs
from twin.study.schema import read_family
from twin.study.work import code, digest

FAMILY = "uncertain"
"""The family of rigs from which healthy ones are drawn,"""
DRAW = 1_802
"""and the draw."""
DURATION = 60.0
"""Seconds of a run."""
AT = 20.0
"""When something happens, s."""
RAMP = 10.0
"""How long a ramp takes, s."""
ROLLING, BREAKAWAY = "plant.friction.rolling_mm", "plant.friction.breakaway_ratio"
DELAY, LEVEL = "sensors.touch.dead_time", "plant.level_deg"
BANDWIDTH, BACKLASH = "plant.servo.bandwidth_hz", "plant.servo.backlash_deg"
CAMS = "rig.cam_error_percent"
TOGETHER = 20
"""Rigs that are simulated side by side."""
IN_TIME = 20.0
"""Seconds after a change is complete within which an alarm counts as in time."""
JUDGED = 20_000
"""Seeds of healthy rigs, on which all that is said of healthy running is judged."""
INJECTED = 80_000
"""Seeds of rigs that something happens to,"""
UNDER_LAWS = 200_000
"""and of those under other laws."""
HEALTHY_SCENARIOS = ("excite", "circle", "sine")
UNEVEN = (0, 2.5, 5, 10, 15, 20.1)
"""Percent by which screens are uneven, between which replays are told apart."""
GOALS = 4
"""Kinds, the first ones, that have goals."""
LAW = "afl"
"""The law of the scenarios."""
LAWS: dict[str, list[str]] = {
    LAW: [],
    **{
        path.stem: tomllib.loads(path.read_text(encoding="utf-8"))["set"]
        for path in sorted((HERE.parent / "scenarios" / "tunes").glob("*.toml"))
        if path.stem != LAW
    },
    "pid": ["controller.kind=pid"],
    "iterative_learning": ["controller.kind=iterative_learning"],
}
"""Settings of every law: those from which its gains are tuned; of the cure those it ships with."""
Drawn = Mapping[str, float | str]
Settings = dict[str, Any]
SPREADS = {"rolling": 0.15, "breakaway": 0.15, "delay": 0.003, "level": 0.05}
"""How rigs differ (standard deviations): rolling relative, breakaway ratio, s, deg."""


HEALTHY = "healthy"
KINDS: dict[str, Settings] = {each["name"]: each for each in planned("shadow")["kinds"]}
"""What happens to a rig, by its name."""


def slowly(seed: int, kind: str) -> bool:
    """Whether what happens to a rig comes along a ramp: to every second one, where it can."""
    return bool(seed % 2) and kind != HEALTHY and KINDS[kind].get("ramps", True)


def rig(
    seed: int,
    scenario: str = "excite",
    kind: str = HEALTHY,
    drawn: Drawn | None = None,
    law: str = LAW,
    duration: float = DURATION,
) -> tuple[Scenario, Scenario]:
    """What the twin believes of a rig drawn at random, and the rig itself.

    The belief is what an identification would have found: the truth but for its own errors.

    Args:
        seed: Which rig; an odd one gets a ramp where there can be one.
        scenario: What it does.
        kind: What happens to it.
        drawn: What the rig is, by dotted keys, ``key.0`` the first number of a list; by default
            it is drawn as ``SPREADS`` says.
        law: Of ``LAWS``.
        duration: Of the run in s.
    """
    rng = np.random.default_rng([seed, 18])
    known = _usual(rng) if drawn is None else whole_settings(drawn)
    true = _with_errors(known, rng)
    common = [f"duration={duration}", f"seed={seed}", *LAWS[law]]
    more = []
    if kind != HEALTHY:
        over = RAMP if slowly(seed, kind) else 0.0
        changed = _changed(KINDS[kind], true, rng).items()
        values = ", ".join(f'"{key}"={json.dumps(value)}' for key, value in changed)
        more = [f"change=[{{at={AT}, over={over}, set={{{values}}}}}]"]
    belief, truth = ([f"{key}={value}" for key, value in each.items()] for each in (known, true))
    return (
        at_study_step(load(scenario, [*common, *belief])),
        at_study_step(load(scenario, [*common, *truth, *more])),
    )


def _usual(rng: np.random.Generator) -> Settings:
    """A rig like the one the project describes."""
    return {
        ROLLING: 0.18 * np.exp(SPREADS["rolling"] * rng.standard_normal()),
        BREAKAWAY: 1 + abs(SPREADS["breakaway"] * rng.standard_normal()),
        DELAY: 0.042 + SPREADS["delay"] * rng.standard_normal(),
        LEVEL: (SPREADS["level"] * rng.standard_normal(2)).tolist(),
    }


def whole_settings(drawn: Drawn) -> Settings:
    """Settings with the numbers of a list put together."""
    whole: Settings = {}
    for key, value in drawn.items():
        name, _, place = key.rpartition(".")
        if place.isdigit():
            whole.setdefault(name, []).append(value)
        else:
            whole[key] = value
    return whole


def _with_errors(known: Settings, rng: np.random.Generator) -> Settings:
    """A rig that differs from what is known of it by the errors of an identification."""
    off = dict(zip(WATCHED_PARAMETERS, rng.standard_normal(len(WATCHED_PARAMETERS)), strict=True))
    off = {name: TWIN_ERROR_STD[name] * error for name, error in off.items()}
    level = np.degrees([off["level_phi"], off["level_theta"]])
    true = {
        **known,
        ROLLING: known[ROLLING] * (1 + off["rolling"]),
        BREAKAWAY: max(1.0, known[BREAKAWAY] + off["breakaway"]),
        DELAY: known[DELAY] + off["delay"],
        LEVEL: (np.array(known[LEVEL]) + level).tolist(),
    }
    if BANDWIDTH in known:
        lag = time_constant(known[BANDWIDTH]) + off["lag"]
        true[BANDWIDTH] = corner_frequency(max(lag, 1e-3))
    if BACKLASH in known:
        true[BACKLASH] = max(
            0.0, known[BACKLASH] + np.degrees(PLAY_WIDTHS_RAD[0]) * off["narrow_play"]
        )
    if CAMS in known:
        true[CAMS] = [percent + float(100 * off["transmission"]) for percent in known[CAMS]]
    return true


def _changed(kind: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """What becomes of a rig to which something of a kind happens."""
    heading = rng.uniform(0, 2 * np.pi)
    found = {**kind.get("set", {})}
    found |= {key: factor * true[key] for key, factor in kind.get("factor", {}).items()}
    found |= {key: true[key] + more for key, more in kind.get("more", {}).items()}
    if "tilt" in kind:
        way = np.array([np.cos(heading), np.sin(heading)])
        found[LEVEL] = (np.array(true[LEVEL]) + kind["tilt"] * way).tolist()
    if "patch" in kind:
        grid = np.ones((7, 5))
        grid[rng.integers(3, 5), rng.integers(2, 4)] = kind["patch"]
        found["plant.surface.relative"] = grid.tolist()
    return found


class Member(NamedTuple):
    """One rig of a job: its seed, what happens to it, and what it is if it is not as usual."""

    seed: int
    kind: str = HEALTHY
    drawn: Drawn | None = None


class Job(NamedTuple):
    """Rigs that are simulated side by side, under one law."""

    scenario: str
    rigs: tuple[Member, ...]
    law: str = LAW


def known(job: Job) -> list[dict[str, Any]]:
    """What is said of the rigs of a job: as kept, or tried and then kept."""
    how = texts(Path(__file__), HERE / "shadow.toml", *shadow_files())
    return kept("shadow", digest(f"{code()} {how} {job!r}"), lambda: carry_out(job))


def shadow_files() -> list[Path]:
    """All files on which it depends what the shadow says: its modules and their tables."""
    folder = Path(str(files("twin.shadow")))
    return sorted([*folder.rglob("*.py"), *folder.rglob("*.toml")])


def texts(*paths: Path) -> str:
    """The texts of files, one after the other."""
    return " ".join(each.read_text(encoding="utf-8") for each in paths)


def carry_out(job: Job) -> list[dict[str, Any]]:
    """Simulate the rigs of a job and let the twin run beside each: a row for each in JSON.

    Which rig it is, what happens to it and its law; the largest log-likelihood ratio of all causes
    and of the dead time alone; when there was the first alarm in s, and what it was held to be;
    squared replay errors in units of their spread, and the errors after 1 s in m; by how many
    percent the screen's friction differs from place to place.
    """
    found = []
    pairs = [rig(each.seed, job.scenario, each.kind, each.drawn, job.law) for each in job.rigs]
    for each, (_, truth), log in zip(job.rigs, pairs, logs(pairs), strict=True):
        said = shadow(log, belief_of(log))
        first = said.alarms[0] if said.alarms else None
        run = None if said.replays is None else said.replays.take(said.replays.counted)
        found.append(
            {
                "seed": each.seed,
                "kind": each.kind,
                "law": job.law,
                "every": float(said.tests.ratio.max(initial=0.0)),
                "late": float(said.tests.delayed.max(initial=0.0)),
                "alarm": None if first is None else first.time,
                "causes": [] if first is None else [cause.name for cause in likely(first.causes)],
                "squares": [] if run is None else run.square.tolist(),
                "errors": [] if run is None else run.distance.tolist(),
                "uneven": truth.plant.surface.spread_percent,
            }
        )
    return found


def judged_rigs(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Rows with what came of the first alarm.

    Seconds from the complete change (``after``), whether it came before anything had happened
    (``early``) or soon enough (``in_time``), and whether a right cause is among those named.
    """
    found = pd.DataFrame(rows).sort_values("seed", kind="stable").astype({"alarm": float})
    ramps = map(slowly, found["seed"], found["kind"])
    complete = AT + RAMP * np.array([*ramps], float)
    right = ([] if kind == HEALTHY else KINDS[kind]["causes"] for kind in found["kind"])
    return found.assign(
        after=found["alarm"] - complete,
        early=found["alarm"] < AT,
        in_time=(found["alarm"] >= AT) & (found["alarm"] <= complete + IN_TIME),
        named=[bool({*a} & {*b}) for a, b in zip(found["causes"], right, strict=True)],
    )


def trials(
    each: int,
    hours: float,
    laws: int,
    processes: int,
    progress: Callable[[float], None] = lambda _: None,
) -> pd.DataFrame:
    """Rigs of every kind, healthy ones, and both under every other law.

    Args:
        each: Rigs of each kind; every second one changes along a ramp, where there can be one.
        hours: Of healthy running to judge on.
        laws: Rigs of each kind with goals, under each of the other laws.
        processes: That work side by side.
        progress: Called with the share of the work done.
    """
    jobs = list(enumerate(_jobs(each, hours, laws)))
    found: list[dict[str, Any]] = []
    for done, (_, some) in enumerate(results(known, jobs, processes)):
        found += some
        progress((done + 1) / len(jobs))
    return judged_rigs(found)


def _jobs(each: int, hours: float, laws: int) -> Iterator[Job]:
    kinds = [*enumerate(KINDS)]
    changed = [Member(INJECTED + 1000 * k + n, kind) for n in range(each) for k, kind in kinds]
    judged = max(len(HEALTHY_SCENARIOS), round(hours * 3600 / DURATION))
    healthy = [each.point for each in drawn_rigs(read_family(FAMILY), DRAW, judged)]
    for number, law in enumerate(each for each in LAWS if each != LAW):
        first = UNDER_LAWS + 10_000 * number
        rigs = [
            Member(first + 1000 * (k + 1) + n, kind)
            for n in range(laws)
            for k, kind in kinds[:GOALS]
        ]
        yield from (Job("excite", group, law) for group in _groups(rigs))
    yield from (Job("excite", group) for group in _groups(changed))
    rigs = [Member(JUDGED + index, HEALTHY, point) for index, point in enumerate(healthy)]
    for place, scenario in enumerate(HEALTHY_SCENARIOS):
        chosen = rigs[place :: len(HEALTHY_SCENARIOS)]
        yield from (Job(scenario, part) for part in _groups(chosen))


def _groups(rigs: Sequence[Member]) -> Iterator[tuple[Member, ...]]:
    for begin in range(0, len(rigs), TOGETHER):
        yield tuple(rigs[begin : begin + TOGETHER])


def bounds(hits: int, count: int) -> tuple[float, float]:
    """The 95 % interval of a share (Clopper and Pearson), in percent."""
    low, high = stats.binomtest(hits, count).proportion_ci(method="exact")
    return 100 * float(low), 100 * float(high)


def interval(hits: int, count: int) -> str:
    """A share with its 95 % interval, in percent."""
    if count == 0:
        return "-"
    low, high = bounds(hits, count)
    return f"{100 * hits / count:.0f} ({low:.0f} to {high:.0f})"


def rates(alarms: int, hours: float) -> tuple[float, float]:
    """The exact 95 % interval of a rate per hour (Poisson)."""
    low = stats.chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
    return float(low) / hours, float(stats.chi2.ppf(0.975, 2 * alarms + 2)) / 2 / hours


def counted(alarms: int, hours: float) -> str:
    """False alarms, and how many an hour that means."""
    low, high = rates(alarms, hours)
    return f"{alarms} in {hours:.2f} h ({low:.2f} to {high:.2f} per hour)"


def alarms(rigs: pd.DataFrame) -> tuple[int, int, int]:
    """Rigs without an early alarm, those of them with one in time, and with the right cause."""
    rest = rigs[~rigs["early"]]
    return len(rest), int(rest["in_time"].sum()), int((rest["in_time"] & rest["named"]).sum())


def cells(rigs: pd.DataFrame) -> tuple[str, ...]:
    """Rigs, in time, right, wrong, early, and after how many s half and 95 % had an alarm."""
    rest, timely, right = alarms(rigs)
    after = "-"
    if rest:
        late = rigs["after"][~rigs["early"]].fillna(np.inf)
        ends = np.quantile(late, (0.5, 0.95), method="inverted_cdf")
        after = ", ".join("never" if np.isinf(each) else f"{each:.0f}" for each in ends)
    shares = interval(timely, rest), interval(right, timely), interval(timely - right, timely)
    return str(len(rigs)), *shares, str(rigs["early"].sum()), after


def goals(found: pd.DataFrame, judged: pd.DataFrame) -> list[tuple[str, str, str]]:
    """What was to be reached, what was, and whether so few rigs can tell."""
    rows = []

    def said(low: float, high: float, least: float, most: float, unsure: str) -> str:
        if low >= least and high <= most:
            return "met"
        return "**not met**" if high < least or low > most else unsure

    def share(name: str, hits: int, count: int, least: float = 0.0, most: float = 100.0) -> None:
        if count == 0:
            rows.append((name, "-", "no rig"))
            return
        word = said(*bounds(hits, count), least, most, "too few rigs to tell")
        rows.append((name, f"{interval(hits, count)} % of {count}", word))

    for kind in [*KINDS][:GOALS]:
        rest, timely, right = alarms(found[found["kind"] == kind])
        share(f"alarm in time for 95 %: {kind}", timely, rest, least=95)
        share(f"right cause in 90 %: {kind}", right, timely, least=90)
        share(f"wrong cause below 3 %: {kind}", timely - right, timely, most=3)
    error, within = 1000 * float(np.median(_every(judged, "errors"))), inside(judged)
    name = "healthy: replay error at 1 s at most 1 mm (median)"
    rows.append((name, f"{error:.2f} mm", said(error, error, 0.0, 1.0, "")))
    name = "healthy: 93 to 97 % inside the 95 % band"
    rows.append((name, f"{within:.1f} %", said(within, within, 93, 97, "")))
    return rows


def _every(some: pd.DataFrame, name: str) -> Array:
    """Squares or errors of all rigs, one behind the other."""
    return np.concatenate([[], *some[name]])


def inside(found: pd.DataFrame) -> float:
    """Percentage of replays that end in their 95 % band."""
    return float(100 * (_every(found, "squares") <= CHI_SQUARE_95).mean())


def _healthy(found: pd.DataFrame, judged: pd.DataFrame) -> list[tuple[str, str]]:
    def median(some: pd.DataFrame) -> str:
        errors = _every(some, "errors")
        return f"{1000 * np.median(errors):.2f} mm" if len(errors) else "-"

    changed = found[found["kind"] != HEALTHY]
    before = int(changed["early"].sum()), len(changed) * AT / 3600
    squares = _every(judged, "squares")
    rows = [
        (
            "false alarms on the rigs of this section",
            counted(int(judged["alarm"].notna().sum()), len(judged) * DURATION / 3600),
        ),
        ("false alarms on the rigs below before anything happens", counted(*before)),
        (
            "median score (1: as predicted)",
            f"{np.sqrt(np.median(squares) / CHI_SQUARE_MEDIAN):.2f}",
        ),
        ("replays of 1 s inside their 95 % band", f"{inside(judged):.1f} % of {len(squares)}"),
        ("replay error after 1 s, median", median(judged)),
    ]
    for least, most in itertools.pairwise(UNEVEN):
        some = judged[(judged["uneven"] >= least) & (judged["uneven"] < most)]
        name = f"on screens uneven by {least:g} to {most:g} % ({plural(len(some), 'rig')}), median"
        rows.append((name, median(some)))
    return rows


def _confusion(found: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """The causes of first alarms in time, and of every kind how often each was named."""
    first = found["causes"].str[0].where(found["in_time"]).fillna("no alarm in time")
    changed = found["kind"] != HEALTHY
    table = pd.crosstab(found["kind"][changed], first[changed]).reindex(KINDS, fill_value=0)
    rows = [[kind, *(str(each or "") for each in row)] for kind, row in table.T.items()]
    return list(table.columns), rows


def _laws(found: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row for every law: alarms after a change."""
    tried = [law for law in LAWS if law in {*found["law"]}]
    rows = []
    for law in (*tried, *(("all of these",) if tried else ())):
        some = found[found["law"].isin(tried if law == "all of these" else [law])]
        rows.append((law, *cells(some)))
    return rows


def page(every: pd.DataFrame, command: str) -> str:
    """The page in Markdown.

    Args:
        every: What was said of every rig.
        command: That makes this page.
    """
    found = every[every["law"] == LAW]
    seeds = found["seed"]
    judged = found[seeds.between(JUDGED, INJECTED, inclusive="left")]
    return filled(
        "shadow",
        command=command,
        goals=goals(found, judged),
        scenarios=HEALTHY_SCENARIOS,
        seconds=DURATION,
        judged=len(judged),
        healthy=_healthy(found, judged),
        ramp=RAMP,
        in_time=IN_TIME,
        kinds=[(kind, *cells(found[found["kind"] == kind])) for kind in KINDS],
        confusion=_confusion(found),
        laws=_laws(every[every["law"] != LAW]),
    )


@click.command()
@click.option("--each", type=click.IntRange(min=2), default=72, help="Rigs of each kind.")
@click.option("--hours", type=click.FloatRange(min=0.1), default=4.0, help="Of healthy running.")
@click.option("--laws", type=click.IntRange(min=0), default=2, help="Rigs of a kind for each law.")
@click.option("--doc", type=click.Path(path_type=Path), default=HERE / "shadow.md")
@PROCESSES_OPTION
def main(each: int, hours: float, laws: int, doc: Path, processes: int | None) -> None:
    """Try the shadow on simulated rigs, and write how good it is."""
    command = f"uv run python docs/shadow_trials.py --each {each} --hours {hours:g} --laws {laws}"
    with progress("rigs that something happens to, and healthy ones", 1.0) as advance:
        text = page(trials(each, hours, laws, processes or cores(), advance), command)
    write_whole(doc, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    # what other processes work on has to lie in a module
    from docs.shadow_trials import main as of_module

    of_module()
