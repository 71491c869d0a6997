"""`twin.shadow`: The confusion matrix counts what was said of each rig."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.catalog import catalog
from controllers.interfaces import Law
from docs import shadow_identified as identified
from docs import shadow_reference as references
from docs import shadow_trials as trials
from twin.scenario.load import load

INJECTED, JUDGED = trials.INJECTED, trials.JUDGED
HEALTHY, KINDS, LAWS, UNDER_LAWS = trials.HEALTHY, [*trials.KINDS], trials.LAWS, trials.UNDER_LAWS
page, rig = trials.page, trials.rig


def trial(seed, kind, alarm=None, causes=(), largest=1.0, law=trials.LAW):
    about = {"seed": seed, "kind": kind, "law": law, "alarm": alarm, "causes": [*causes]}
    replayed = {"squares": [1.0, 7.0], "errors": [5e-4, 7e-4], "uneven": 0.0}
    return {**about, "every": largest, "late": 0.3 * largest, **replayed}


def test_alarms_count_in_time_right_wrong_and_early():
    friction = KINDS[0]
    found = [
        trial(JUDGED, HEALTHY),
        trial(JUDGED + 1, HEALTHY, alarm=30.0, causes=("level",)),
        trial(INJECTED, friction, 25.0, ("rolling friction",)),
        trial(INJECTED + 2, friction, 39.0, ("another ball", "rolling friction")),
        trial(INJECTED + 4, friction, 26.0, ("level",)),
        trial(INJECTED + 6, friction, 41.0, ("rolling friction",)),
        trial(INJECTED + 1, friction, 49.0, ("rolling friction",)),  # a ramp is complete at 30 s
        trial(INJECTED + 8, friction, 12.0, ("rolling friction",)),
        trial(UNDER_LAWS + 1000, friction, 25.0, ("rolling friction",), law="cure"),
    ]
    text = page(trials.judged_rigs(found), "shadow_trials.py")
    cure = next(line for line in text.splitlines() if line.startswith("| cure |"))
    assert cure == "| cure | 1 | 100 (3 to 100) | 100 (3 to 100) | 0 (0 to 98) | 0 | 5, 5 |"
    row = next(line for line in text.splitlines() if line.startswith("| rolling friction +30 %"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1] == "6"
    assert cells[2].startswith("80 ")  # 4 of 5, one came early
    assert cells[3].startswith("75 ")  # 3 of 4, one of them among those not told apart
    assert cells[4].startswith("25 ")
    assert cells[5] == "1"
    assert cells[6] == "19, 21"  # 5, 6, 19, 19 and 21 s
    alarms = [line for line in text.splitlines() if line.startswith("| false alarms on ")]
    assert "| 1 in 0.03 h (" in alarms[0]  # 2 times 60 s
    assert "| 1 in 0.03 h (" in alarms[1]  # the early one is false, too; 6 times 20 s
    assert "50.0 % of 4" in text
    assert "0.60 mm" in text


def test_every_kind_is_a_rig_that_can_be_simulated_jump_or_ramp():
    for kind in KINDS:
        for seed in (2, 3):
            belief, truth = rig(seed, "excite", kind)
            assert not belief.change
            assert len(truth.change) == 1
            assert (truth.change[0].over > 0) == trials.slowly(seed, kind)
    assert [trials.slowly(3, kind) for kind in KINDS].count(False) == 3


def verdicts(found, healthy):
    """Goal to what was found and the verdict."""
    tables = map(trials.judged_rigs, (found + healthy, healthy))
    return {name: rest for name, *rest in trials.goals(*tables)}


def test_a_goal_is_met_or_missed_only_where_the_interval_says_so():
    healthy = [trial(JUDGED + k, HEALTHY) for k in range(60)]
    few = [trial(INJECTED + 2 * k, KINDS[0], 25.0, ("rolling friction",)) for k in range(4)]
    many = [trial(INJECTED + 2 * k, KINDS[0], 25.0, ("rolling friction",)) for k in range(100)]
    late = [trial(INJECTED + 2 * k, KINDS[0], 45.0, ("rolling friction",)) for k in range(100)]
    for some, word in ((few, "too few rigs to tell"), (many, "met"), (late, "**not met**")):
        assert verdicts(some, healthy)["alarm in time for 95 %: rolling friction +30 %"][1] == word


def test_a_rig_of_a_family_is_what_was_drawn_and_believed_but_for_the_errors_of_a_fit():
    drawn = {
        "plant.friction.rolling_mm": 0.2, "plant.friction.breakaway_ratio": 1.5,
        "sensors.touch.dead_time": 0.04, "plant.level_deg.0": 0.1, "plant.level_deg.1": -0.2,
        "plant.servo.backlash_deg": 0.2, "rig.cam_error_percent.0": 1.0,
        "rig.cam_error_percent.1": -2.0,
    }  # fmt: skip
    belief, truth = rig(4, "circle", HEALTHY, drawn)
    assert belief.plant.level_deg == (0.1, -0.2)
    assert belief.plant.servo.backlash_deg == 0.2
    assert truth.plant.level_deg != belief.plant.level_deg
    assert truth.plant.level_deg == pytest.approx(belief.plant.level_deg, abs=0.01)
    assert truth.plant.friction.rolling_mm == pytest.approx(0.2, rel=0.03)


def test_every_law_that_is_shipped_is_tried_and_runs_as_told():
    shipped = {k for k, v in catalog(Law).items() if v.__module__.startswith("controllers.")}
    shipped -= {"fmu"}  # a law of somebody else
    assert shipped <= {*LAWS}
    for law in LAWS:
        _, truth = rig(2, law=law)
        assert truth.controller.kind == {"cure": "stable_inversion"}.get(law, law)
    assert rig(2, law="cure")[1].observer.kind == "friction_map_kalman"


def test_the_page_tells_of_no_rate_beyond_what_was_counted():
    healthy = [trial(JUDGED + k, HEALTHY) for k in range(60)]
    changed = [trial(INJECTED + 2 * k, KINDS[0], 25.0, ("rolling friction",)) for k in range(9)]
    text = page(trials.judged_rigs(healthy + changed), "shadow_trials.py")
    assert "fit" not in text.split("## Healthy rigs")[1].split("## ")[0]
    rows = [line for line in text.splitlines() if line.startswith("| false alarms on ")]
    assert "| 0 in 1.00 h (0.00 to 3.69 per hour)" in rows[0]  # none: at most -log(0.025)
    assert "| 0 in 0.05 h (" in rows[1]


def test_what_has_been_tried_is_kept_whole_and_only_for_the_same_job(monkeypatch, tmp_path):
    found = [trial(INJECTED + 1, KINDS[2], 49.0, ("dead time", "level")), trial(JUDGED, HEALTHY)]
    asked = []
    monkeypatch.setattr(trials, "carry_out", lambda job: asked.append(job) or found)
    monkeypatch.setitem(trials.kept.__globals__, "HERE", tmp_path / "docs")
    jobs = [trials.Job("excite", (trials.Member(seed),)) for seed in (1, 2)]
    again = [trials.known(job) for job in (*jobs, jobs[0])]
    assert asked == jobs
    assert again == 3 * [found]


def make_result(number, place, learning, alarm=None, causes=(), **more):
    """What a twin said of a run of a rig."""
    about = identified.watched(number)[place]._asdict()
    about |= {"learning": learning, "alarm": alarm, "causes": [*causes]}
    return {**about, "identified": ["rolling"], "score": 1.5, "why": "", **more}


def test_the_page_of_identified_twins_counts_alarms_and_hides_no_rig():
    found = [
        make_result(0, 0, True), make_result(0, 0, False, 3.0, score=7.0),
        make_result(1, 0, True, 33.3, ("cams",)), make_result(1, 0, False, 5.0),
        make_result(2, 0, True, identified=[], score=2.5), make_result(2, 0, False, 4.0),
        make_result(4, 0, True, score=None, why="too short"),
        make_result(0, 1, True, 25.0, ("another ball", "rolling friction")),
        make_result(3, 1, True, 49.0, ("cams",)),  # a ramp is complete at 30 s
        make_result(6, 1, True, 41.0, ("dead time",)),
    ]  # fmt: skip
    errors = {"model": 7e-4, "nominal": 0.014, "without friction": 0.02, "stays": 0.03}
    errors["goes on"] = 0.04
    fresh = [
        {
            "why": "", "white": white, "uneven": not white,
            "errors": errors | {"nominal": nominal},
            "verdicts": dict.fromkeys(
                identified.TRUTHS, (identified.IDENTIFIED_VERDICT, 1.0, *numbers)
            ),
        }
        for white, nominal, *numbers in ((True, 5e-4, 1.1, 0.9, 1.3), (False, 0.03, 1.5, 1.2, 1.8))
    ]  # fmt: skip
    text = identified.page(found, [*fresh, {"why": "too quiet"}], "shadow_identified.py")
    assert "3 simulated rigs of" in text
    assert "1 log was refused, 1 fit was rejected by the residuals; 1 log was not" in text
    (key, unit), *_ = identified.TRUTHS.values()
    half = "1 of 2 (9 to 91 %)"
    assert f"| {key} | {unit} | 2 of 2 | {half} | {half} | 0.25 | 0.3 |" in text
    assert f"better than the nominal one on {half} rigs" in text
    # Wilson: (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n) with z = 1.96
    assert "| learning | 1 of 3 (6 to 79 %) | 1.50 | 1.50 to 2.50 |" in text
    assert "| the same runs without learning | 3 of 3 (44 to 100 %) | 1.50 | 1.50 to 7.00 |" in text
    assert "| learning, nothing was identified | 0 of 1 (0 to 79 %) | 2.50 |" in text
    assert "| 1 | circle | 33.3 | cams |" in text
    assert "1 rigs gave no verdict" in text
    assert "Of the others in time (within " in text
    right = "2 of 3 (21 to 94 %); of these with the right cause among those named: 1 of 2"
    assert f": {right}" in text
    assert "| 0 | rolling | rolling friction +30 % | 5.0 | yes |" in text
    assert "| 3 | rolling | level 0.1 deg, along a ramp | 29.0 | yes | cams | no |" in text


def test_whatever_happens_to_a_rig_of_the_family_can_be_simulated():
    rigs = identified.draw_rigs(identified.read_family(identified.FAMILY), identified.DRAW, 1)
    true = identified.whole_settings(rigs[0].point)
    for kind in identified.HAPPENS:
        run = identified.Watched(identified.FIRST, "excite", kind)
        belief, truth = identified.simulated(true, run, 1)
        assert not belief.change
        assert len(truth.change) == 1
        assert belief.plant.friction.rolling_mm != truth.plant.friction.rolling_mm


def compared(number, kind, *parameters, scenario="circle", at=0.0, alarms=(), same=False):
    """A log of a rig with (name, change, fit_std) of parameters with a reference value of 1.

    Alarms are pairs of a time in s and a cause; the same motion is that of the reference.
    """
    keys, more = ("name", "change", "fit_std"), {"reference": 1.0, "unit": 1.0, "same_motion": same}
    found = [dict(zip(keys, each, strict=True)) | more for each in parameters]
    about = {"number": number, "kind": kind, "scenario": scenario, "identified": False}
    alarms = [{"time": time, "causes": [cause]} for time, cause in alarms]
    watched = {"at": at, "alarms": alarms, "watched": 40.0}
    return {**about, **watched, "why": "", "differences": found}


def test_the_page_of_references_counts_every_log_that_is_told_to_differ():
    doubled, quiet = ("rolling", 1.0, 0.01), ("rolling", 0.001, 0.01)
    late = ("delay", 0.1, 1e-4)
    same = [(name, 1e-9, 1.0) for name in references.COMPARED_PARAMETERS if name != "rolling"]
    kinds = list(references.CHANGES)
    judged = [
        compared(0, HEALTHY, quiet), compared(1, HEALTHY, doubled, scenario="sine"),
        compared(2, HEALTHY, quiet, scenario="sine"),
        compared(0, kinds[0], doubled), compared(1, kinds[0], late, doubled),
        compared(2, kinds[0], quiet),
        {**compared(2, HEALTHY), "why": "too short"},
    ]  # fmt: skip
    calibration = [compared(k, HEALTHY, quiet, *same, same=k == 0) for k in range(3)]
    text = references.page(judged, calibration, [], [], "shadow_reference.py")
    # Wilson: (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n) with z = 1.96
    assert "| all | 1 of 3 (6 to 79 %) |" in text
    assert "| sine | 1 of 2 (9 to 91 %) |" in text
    assert "| circle | 0 of 1 (0 to 79 %) |" in text
    assert f"| {kinds[0]} | 2 of 3 (21 to 94 %) | 2 | 1 |" in text
    assert "| 1 | sine | rolling friction 1000.000 -> 2000.000 mm (+100 %) |" in text
    assert "3 simulated rigs of" in text
    assert "1 log was refused" in text


def cells_of(text, name):
    """The cells of the last row of a table that begins so."""
    line = [each for each in text.splitlines() if each.startswith(f"| {name} |")][-1]
    return [cell.strip() for cell in line.strip("|").split("|")][1:]


def test_the_page_of_references_counts_alarms_before_and_after_a_later_change():
    kind = next(iter(references.CHANGES))
    quiet = [(name, 1e-9, 1.0) for name in references.COMPARED_PARAMETERS]
    calibration = [compared(k, HEALTHY, *quiet, same=k == 0) for k in range(3)]
    watched = [compared(k, HEALTHY) for k in range(89)]
    watched += [compared(89, HEALTHY, scenario="sine", alarms=[(30.0, "level"), (50.0, "cams")])]
    watched += [
        compared(0, kind, at=40.0, alarms=[(44.0, "rolling friction")]),
        compared(1, kind, at=40.0, alarms=[(48.0, "level")]),
        compared(2, kind, at=40.0, alarms=[(31.0, "level"), (44.0, "rolling friction")]),
        compared(3, kind, at=40.0),
        {**compared(4, kind, at=40.0), "why": "too short"},
    ]
    text = references.page([], calibration, [], watched, "shadow_reference.py")
    # 90 logs of 40 s are an hour; Poisson: 2 alarms are 0.24 to 7.22
    assert cells_of(text, "all") == ["1 of 90 (0 to 6 %)", "2 in 1.00 h (0.24 to 7.22 per hour)"]
    assert cells_of(text, "89") == ["sine", "50", "cams"]
    assert cells_of(text, kind) == ["4", "1", "2 of 3 (21 to 94 %)", "1", "6"]


def test_dead_times_are_calibrated_for_the_same_and_for_another_motion():
    rng = np.random.default_rng(4)
    # only fits of unlike errors tell their scale from what differs between logs
    stds = rng.choice([0.1, 1.0, 10.0], 8000)
    changes = stds * rng.standard_normal(len(stds))
    changes[::2] *= 2
    rows = [
        compared(0, HEALTHY, ("delay", change, std), same=k % 2 == 0)
        for k, (change, std) in enumerate(zip(changes, stds, strict=True))
    ]
    same, other = (references.fit_chance(rows, "delay", same_motion=each) for each in (True, False))
    assert same == pytest.approx((2.0, 0.0), abs=0.1)  # 4.5 standard deviations
    assert other == pytest.approx((1.0, 0.0), abs=0.1)


def test_a_later_change_is_one_of_the_scenario_and_no_other_of_its_settings():
    true = {references.ROLLING: 0.2, references.LEVEL: [0.1, 0.0]}
    rig = references.Rig(true, "sine", 3, {**true, references.LEVEL: [0.1, 0.5]})
    known, own = (load(rig.scenario, each) for each in rig.overrides(50.0))
    assert (known.duration, own.duration, own.seed) == (50.0, 50.0, 3)
    assert not known.change
    assert known.plant.friction.rolling_mm != own.plant.friction.rolling_mm == 0.2
    (change,) = own.change
    assert (change.at, change.set) == (references.LATER_S, {references.LEVEL: [0.1, 0.5]})


@pytest.mark.parametrize(("scale", "between"), [(3.0, 0.0), (1.0, 0.05), (2.0, 0.02)])
def test_the_calibration_finds_by_what_changes_scatter(scale, between):
    rng = np.random.default_rng(4)
    errors = np.exp(rng.uniform(np.log(1e-3), np.log(0.1), 4000))
    changes = rng.standard_normal(4000) * np.hypot(scale * errors, between)
    each = zip(changes, errors, strict=True)
    rows = [compared(0, HEALTHY, ("delay", *numbers)) for numbers in each]
    found = references.fit_chance(rows, "delay")
    assert found == pytest.approx((scale, between), rel=0.1, abs=2e-3)


def test_every_change_before_a_first_row_is_of_the_stated_size():
    true = {references.ROLLING: 0.2, references.DELAY: 0.04, references.LEVEL: [0.1, 0.0]}
    rough, tilted, late, heavy = (
        references.change(true, kind, np.random.default_rng(1)) for kind in references.CHANGES
    )
    assert rough[references.ROLLING] == pytest.approx(0.4)
    assert late[references.DELAY] == pytest.approx(0.07)
    assert np.hypot(tilted[references.LEVEL][0] - 0.1, tilted[references.LEVEL][1]) == (
        pytest.approx(0.5)
    )
    # a hollow ball takes 3/5 of gravity: 1 / (1 + J / (m r^2))
    ball = load("circle").plant.ball
    share = 1 / (1 + heavy["plant.ball.inertia"] / (ball.mass * ball.radius**2))
    assert share == pytest.approx(0.85 * 3 / 5, rel=1e-3)
    assert references.change(true, HEALTHY, np.random.default_rng(1)) == true
