"""`twin.tune.report`: Tunes of real runs: small ones, on the exact equations."""

import dataclasses
import json
import math
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from controllers.classical import Pid
from twin.base.errors import ScenarioError, TwinError
from twin.base.shipped import shipped_in
from twin.cli.studies import tune as command
from twin.scenario import load
from twin.scenario.schema import choices
from twin.study.experiments import Store
from twin.study.schema import draw_rigs, read_family
from twin.tune.report import describe_failures, settings, toml
from twin.tune.search import certify, upper_bound
from twin.tune.trials import Indicators, Trials, Tune, read

TUNE = """
title = "small"
family = "uncertain"
set = [
  "controller.kind=afl",
  "controller.gains=[180.0, 162.0, 66.0, 13.0]",
  "predictor.delay=0.042",
]
verdict = ["plant.kind=lagrange", "plant.step=0.002"]
rigs = [2, 4]
candidates = 4
round = 2
eta = 2
finalists = 1
certificate = 5

[fields."controller.gains.0"]
loguniform = [60.0, 600.0]

[fields."controller.gains.1"]
loguniform = [50.0, 500.0]

[limits]
disk = 0.1
delay = 0.01

[[tasks]]
name = "circle"
scenario = "circle"
set = ["duration=0.2", "metrics.start=0.1", "baseline=false"]
scale = 0.01

[[tasks]]
name = "push"
scenario = "hold"
set = ["duration=0.2", "plant.start.x_rate=0.1"]
scale = 0.01
"""


def tuned(file, *options):
    """What the command comes to."""
    return CliRunner().invoke(command, [str(file), "--processes", "1", *map(str, options)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tune")


@pytest.fixture(scope="module")
def file(folder):
    path = folder / "small.toml"
    path.write_text(TUNE)
    return path


@pytest.fixture(scope="module")
def made(file, folder):
    """What the command leaves: exit code, what it prints, and its folder."""
    out = folder / "out"
    result = tuned(file, "--json", "--out", out)
    assert result.exit_code in {0, 1}, result.output
    return result.exit_code, json.loads(result.stdout), out


@pytest.mark.long
def test_a_tune_ends_with_a_certificate_and_a_page(made):
    code, found, out = made
    after = found["after"]
    assert after["rigs"] == 5
    assert code == int(not (found["kept"] and after["failures"] == 0))
    assert [len(task["values"]) for task in after["tasks"].values()] == [5, 5]
    assert found["candidates"][0]["fields"] == {
        "controller.gains.0": 180.0, "controller.gains.1": 162.0,
    }  # fmt: skip
    page = (out / "report.html").read_text()
    assert "controller.gains.1" in page
    assert json.loads((out / "tune.json").read_text()).items() >= found.items()


@pytest.mark.long
def test_the_tuned_controller_lies_over_any_scenario(made):
    _, found, out = made
    tables = tomllib.loads((out / "tuned.toml").read_text())
    assert tables["controller"]["kind"] == "afl"
    for scenario in ("circle", "hold", "thesis/9_6_050"):
        got = load(scenario, [f"parameters={out / 'tuned.toml'}"])
        assert got.controller.kind == "afl"
        gains = got.controller.settings["gains"]
        assert gains[0] == found["chosen"]["fields"]["controller.gains.0"]
        assert gains[2:] == [66.0, 13.0]
        assert got.predictor.delay == 0.042
        assert got.reference == load(scenario).reference


@pytest.mark.long
def test_an_interrupted_tune_goes_on_and_gives_the_same(made, file, folder, monkeypatch):
    _, found, out = made
    some = folder / "some"
    chunks = sorted((out / "chunks").iterdir())
    (some / "chunks").mkdir(parents=True)
    for chunk in chunks[::2]:
        (some / "chunks" / chunk.name).write_bytes(chunk.read_bytes())
    assert json.loads(tuned(file, "--json", "--out", some).stdout) == found
    monkeypatch.setattr("twin.study.work.simulate", None)  # no finished run is made again
    assert json.loads(tuned(file, "--json", "--out", out).stdout) == found


@pytest.mark.long
def test_the_search_never_sees_a_rig_of_the_certificate(file, folder, monkeypatch):
    seen = {}
    indicators = Trials.indicators

    def watched(self, wanted, draw, on):
        wanted = list(wanted)
        rigs = draw_rigs(read_family(self.tune.family), draw, max(n for _, n in wanted))
        scenario = self.scenario(self.start, 0, rigs[0], on)
        assert scenario.seed == rigs[0].seed
        assert scenario.plant.friction.rolling_mm == rigs[0].point["plant.friction.rolling_mm"]
        seen.setdefault(draw, set()).update((rig.seed, *rig.point.values()) for rig in rigs)
        return indicators(self, wanted, draw, on)

    monkeypatch.setattr(Trials, "indicators", watched)
    tuned(file, "--json", "--out", folder / "out")
    assert set(seen) == {1, 2}
    assert len(seen[1]) == 4
    assert len(seen[2]) == 5
    assert not {rig[0] for rig in seen[1]} & {rig[0] for rig in seen[2]}, "seeds"
    assert not seen[1] & seen[2]


@pytest.mark.long
def test_no_more_runs_are_made_than_rungs_and_finalists_have(made):
    _, found, _ = made
    tune = Tune.model_validate(tomllib.loads(TUNE))
    # rung by rung: a run on few rigs is asked for, though not made, again on more
    search = 2 * (4 * 2 + 2 * 4) + 2 * tune.rigs[-1]
    assert found["runs"] <= search + 2 * 2 * tune.rigs[-1] + 2 * 2 * tune.certificate


@pytest.mark.parametrize("failures", [0, 1, 3, 59])
def test_the_bound_is_that_of_clopper_and_pearson(failures):
    # its definition, by the binomial distribution itself
    assert stats.binom.cdf(failures, 60, upper_bound(failures, 60)) == pytest.approx(0.05)
    assert upper_bound(failures, 60) > upper_bound(failures, 61)
    assert upper_bound(60, 60) == 1.0


def test_a_certificate_in_words_excludes_what_it_does_and_no_more():
    def words(failures, rigs):
        bound = upper_bound(failures, rigs)
        certificate = {"failures": failures, "rigs": rigs, "failure_rate_below": bound}
        return describe_failures(certificate)

    assert words(3, 3) == "3 of 3 lost, which excludes no share of all such rigs"
    assert words(0, 60) == (
        "0 of 60 lost, so with 95 % confidence fewer than 4.9 % of all such rigs are"
    )
    assert "fewer than 99.9 % of" in words(59, 60)


def test_a_certificate_counts_a_rig_once_and_keeps_what_it_finished():
    tune = Tune.model_validate(tomllib.loads(TUNE))
    values = np.array([[0.01, 0.02], [np.nan, np.nan], [0.03, np.nan], [0.02, 0.04]])
    found = certify(tune, Indicators(values, values, ("circle: fell: why",)))
    assert (found["rigs"], found["failures"], found["cost"]) == (4, 2, None)
    circle, push = (found["tasks"][name] for name in ("circle", "push"))
    assert (circle["finished"], push["finished"]) == (3, 2)
    numbers = ("median", "quantile_90", "largest")
    assert [circle[each] for each in numbers] == pytest.approx([0.02, 0.028, 0.03])
    assert [push[each] for each in numbers] == pytest.approx([0.03, 0.038, 0.04])
    assert push["values"] == [0.02, None, None, 0.04]
    assert push["effort"] == pytest.approx(0.03)
    none = certify(tune, Indicators(np.full((2, 2), np.nan), np.full((2, 2), np.nan), ()))
    assert [none["tasks"]["push"][each] for each in (*numbers, "effort")] == [None] * 4


@pytest.mark.long
def test_every_shipped_tune_can_be_carried_out(folder):
    assert len(shipped_in("tunes")) >= 7
    first = read("afl")
    for name in shipped_in("tunes"):
        about = read(name)
        trials = Trials(about, Store(folder / "shipped"))
        assert trials.loops([trials.start])[0].refused is None, "the beginning is refused"
        equal = ["family", "tasks", "limits", "rigs", "round", "certificate", "draw"]
        if name != "cure":  # dearer a run, and not among those that docs/tuned.md compares
            equal.append("candidates")
        assert all(getattr(about, key) == getattr(first, key) for key in equal), "equal terms"


def test_a_tune_named_like_a_law_tunes_that_law():
    """A warning of an unstable loop names the tune by the law."""
    named = set(shipped_in("tunes")) & set(choices("controller"))
    assert {"afl", "lqr", "pid"} <= named
    for name in named:
        assert f"controller.kind={name}" in read(name).set


def test_the_tune_of_the_pid_begins_with_gains_that_hold_a_late_rig(folder):
    """Its shipped gains do not: servos of 70 ms, a picture of 40 ms. About the level plate."""
    late = ["plant.servo.bandwidth_hz=2.27", "sensors.touch.dead_time=0.04", "rig.plate_lag=0.07"]
    trials = Trials(read("pid", set=["parameters=hobby", *late]), Store(folder / "late"))
    limits, shipped = trials.tune.limits, dataclasses.asdict(Pid())
    keys = {key: key.split(".")[1:] for key in trials.start}
    as_shipped = {
        key: shipped[name[0]][int(name[1])] if len(name) > 1 else shipped[name[0]]
        for key, name in keys.items()
    }
    begins, before = trials.loops([trials.start, as_shipped])
    assert (begins.disk > limits.disk, begins.delay > limits.delay) == (True, True)
    assert before.disk == 0


def test_a_tune_like_another_has_its_keys_where_it_has_none():
    like, other = read("lqr", candidates=7), read("afl")
    assert like.fields.keys() == {"controller.rho", "controller.kappa"}
    assert (like.candidates, like.tasks) == (7, other.tasks)
    assert like.title != other.title


def test_overrides_of_the_command_come_last(file):
    about = read(str(file), set=("predictor.delay=0.01",))
    trials = Trials(about, Store(file.parent / "overridden"))
    assert trials.scenario(trials.start, 0).predictor.delay == 0.01


GAIN, RANGE = '"controller.gains.0"', "loguniform = [60.0, 600.0]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (GAIN, '"controller.gain.0"', "fields.controller.gain.0: circle.toml: controller.gain"),
        (GAIN, '"controller.gains.9"', "gains.9: no such number (0 to 3)"),
        (
            GAIN,
            '"controller.kind"',
            "fields.controller.kind: its first value 'afl' must be one of 60.0 to 600.0",
        ),
        (GAIN, '"baseline"', "fields.baseline: its first value False must be one of 60.0"),
        (GAIN, '"plant.friction.rolling_mm"', "family 'uncertain' draws it, too"),
        (RANGE, "uniform = [200.0, 600.0]", "its first value 180.0 must be one of 200.0 to 600.0"),
        (RANGE, "values = [100.0, 200.0]", "its first value 180.0 must be one of 100.0, 200.0"),
        (RANGE, "normal = [1.0, 1.0, 0.0, 2.0]", "has no range to search"),
        (RANGE, "unifrom = [1.0, 2.0]", "unifrom: unknown key; did you mean 'uniform'"),
        ('"uncertain"', '"certain"', "family 'certain': not found; did you mean 'uncertain'"),
        ('name = "push"', 'name = "circle"', "two of them are called 'circle'"),
        ("scale = 0.01", "scale = 0.0", "scale: must be greater than 0, got 0.0"),
        ("scale = 0.01", 'scale = 0.01\nindicator = "rms"', "no 'rms'; did you mean 'u_rms'"),
        ("rigs = [2, 4]", "rigs = [4, 2]", "every rung needs more than the last"),
        (
            "rigs = [2, 4]",
            "draw = 3\ncertificate_draw = 3",
            "must differ from the draw of the search",
        ),
        ("rigs = [2, 4]", "rig = 2", "rig: unknown key; did you mean 'rigs'"),
        ("rigs = [2, 4]", 'like = "small.toml"', "refers to itself"),
        ("rigs = [2, 4]", 'like = "alf"', "tune 'alf': not found; did you mean 'afl'"),
        ("predictor.delay=0.042", "predictor.dely=0.042", "predictor.dely: unknown key"),
        (TUNE[TUNE.index("[[tasks]]") :], "", "tasks: missing; it has no default"),
        (TUNE[TUNE.index("[fields") : TUNE.index("[limits")], "[fields]\n", "fields: name at"),
        ('title = "small"', 'title = "small"\ntasks = []', "small.toml: not a TOML file"),
    ],
)
def test_a_mistake_in_a_tune_is_one_line(tmp_path, monkeypatch, old, new, message):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    assert old in TUNE
    path.write_text(TUNE.replace(old, new, 1))
    result = tuned("small.toml")
    assert isinstance(result.exception, ScenarioError), result.output
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)


@pytest.mark.short("three_legs", "tube")
@pytest.mark.parametrize("rig", sorted(shipped_in("rigs")))
def test_a_tune_on_another_rig_has_rigs_about_that_one_and_what_its_file_says(folder, rig):
    alone = load("hold", [f"parameters={rig}"])
    trials = Trials(read("afl", set=[f"parameters={rig}"]), Store(folder))
    for each in draw_rigs(read_family("own"), 1, 5):
        its = trials.scenario(trials.start, 2, each, trials.tune.verdict)
        assert 0.74 < its.plant.servo.bandwidth_hz / alone.plant.servo.bandwidth_hz < 1.34
        assert 0.84 < its.sensors.touch.dead_time / alone.sensors.touch.dead_time < 1.16
        assert its.sensors.touch.frame_rate == alone.sensors.touch.frame_rate
        assert (its.plant.kind, its.plant.size) == (alone.plant.kind, alone.plant.size)
        assert its.predictor == alone.predictor


def test_a_tune_on_another_rig_keeps_a_family_and_a_verdict_of_its_own(file):
    tune = read(str(file), set=["parameters=hobby"])
    assert tune.family == "own"
    assert tune.verdict == ("plant.kind=lagrange", "plant.step=0.002")
    assert read(str(file), set=["parameters=hobby"], family="placed").family == "placed"


def test_what_was_tuned_on_another_rig_runs_on_that_one(file, folder, tmp_path):
    trials = Trials(read(str(file), set=["parameters=course"]), Store(folder))
    path = tmp_path / "tuned.toml"
    path.write_text(toml(settings(trials, trials.start), ["tuned"]))
    now = load("circle", [f"parameters={path}"])
    assert now.plant == load("circle", ["parameters=course"]).plant
    assert now.controller.settings["gains"][0] == 180.0


def test_of_a_run_that_does_not_finish_its_task_and_the_reason_are_told(tmp_path):
    path = tmp_path / "small.toml"
    flung = 'plant.start.x=0.34", "plant.start.x_rate=2.0'
    path.write_text(TUNE.replace("plant.start.x_rate=0.1", flung))
    trials = Trials(read(str(path)), Store(tmp_path))
    (found,) = trials.indicators([(trials.start, 2)], 1, trials.tune.verdict)
    assert np.isnan(found.values).tolist() == [[False, True]] * 2
    assert [each.rpartition(": ")[0] for each in found.reasons] == ["push: fell"] * 2


@pytest.mark.long
def test_a_task_without_its_indicator_is_refused(tmp_path):
    path = tmp_path / "small.toml"
    text = TUNE.replace('x_rate=0.1"]', 'x_rate=0.1"]\nindicator = "tracking_error_percent"')
    path.write_text(text)
    result = tuned(path, "--out", tmp_path / "out")
    assert "task push: its reference has no tracking_error_percent" in str(result.exception)


def test_a_tune_without_optuna_says_what_to_install(file, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "optuna", None)
    result = tuned(file)
    assert isinstance(result.exception, TwinError)
    assert "pip install 'ballplate[tune]'" in str(result.exception)


def test_nothing_is_said_of_a_loop_that_has_no_linearisation(folder):
    about = read("sliding_mode")
    trials = Trials(about, Store(folder / "sliding"))
    (loop,) = trials.loops([trials.start])
    assert loop.disk is None
    assert math.isfinite(about.limits.disk)
