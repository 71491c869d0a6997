"""`twin.shadow`: The page of false alarms counts every alarm of every healthy rig."""

from __future__ import annotations

import pytest

from docs import shadow_healthy as healthy
from docs.shadow_trials import LAW, LAWS
from twin.base.errors import LogError

HOUR = 3600.0


def watched(
    number, screens="even", law=LAW, alarms=(), length=healthy.RUN_S, largest=1.0, play=0.1
):
    """What is said of a rig."""
    about = healthy.Watched(number, screens, law)
    alarms = [{"time": time, "causes": [*causes]} for time, causes in alarms]
    times = {"length": length, "simulating": 2.0, "watching": 1.0}
    scenario = {"scenario": about.scenario, "why": "", "play": play}
    return {**about._asdict(), **scenario, **times, "alarms": alarms, "every": largest, "late": 0.5}


def rows_of(text, name):
    found = [line for line in text.splitlines() if line.startswith(f"| {name} |")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in found]


def test_hours_alarms_and_the_interval_of_the_rate_are_those_of_poisson():
    twice = [(7.0, ("level",)), (90.0, ("cams", "dead time"))]
    found = [watched(n, alarms=twice if n == 3 else ()) for n in range(40)]
    found += [watched(n, "uneven", length=HOUR) for n in range(24)]
    text = healthy.page_of_afl(found, "shadow_healthy.py")
    # 2 alarms: 0.2422 to 7.2247, here of 2 h; none: at most -log(0.025) = 3.689, of 24 h
    assert rows_of(text, "even")[0] == [
        "even",
        "40",
        "2.0",
        "2",
        "24 (2.91 to 86.7)",
        "**refuted**",
    ]
    none = ["uneven", "24", "24.0", "0", "0 (0 to 3.69)", "not shown"]
    assert rows_of(text, "uneven")[0] == none
    assert rows_of(text, "both")[0][:4] == ["both", "64", "26.0", "2"]
    assert rows_of(text, LAW) == [
        [LAW, "even", "excite", "3", "7", "level"],
        [LAW, "even", "excite", "3", "90", "cams, dead time"],
    ]
    assert "that takes 89 h" in text  # 3.689 * 24 = 88.5


def test_each_other_law_has_its_hours_alarms_and_largest_ratios():
    found = [watched(n, "uneven", "pid", length=HOUR, largest=n / 2) for n in range(3)]
    found += [watched(0, "uneven", "lqr", [(7.0, ("level",))], HOUR, 13.0)]
    text = healthy.page_of_laws(found, "shadow_healthy.py")
    none = ["pid", "3", "3.0", "0", "0 (0 to 29.5)", "not shown", "1.0", "0.5"]  # 24 * 3.689 / 3
    assert rows_of(text, "pid") == [[*none, "40", "20"]]  # 20 runs of 180 s are an hour
    assert rows_of(text, "all")[0][:4] == ["all", "4", "4.0", "1"]
    assert rows_of(text, "lqr")[1] == ["lqr", "uneven", "excite", "0", "7", "level"]
    assert "without a verdict" not in text


def test_the_cure_is_counted_apart_on_rigs_with_wide_play():
    found = [watched(n, "uneven", "cure", length=HOUR, play=0.1 * n) for n in range(4)]
    found += [watched(0, "uneven", "lqr", [(7.0, ("level",))], 2 * HOUR, play=0.3)]
    text = healthy.page_of_laws(found, "shadow_healthy.py")
    groups = ("cure, play up to", "cure, play above", "all, play up to", "all, play above")
    assert [rows_of(text, f"{each} 0.15 deg")[0][1:4] for each in groups] == [
        ["2", "2.0", "0"],
        ["2", "2.0", "0"],
        ["2", "2.0", "0"],
        ["3", "4.0", "1"],
    ]
    assert "is 0.00 to 0.30 deg of plate angle, median 0.20." in text


@pytest.mark.parametrize(
    ("alarms", "hours", "word"),
    [(0, 88.6, "shown"), (0, 88.4, "not shown"), (2, 5.8, "**refuted**"), (2, 5.9, "not shown")],
)
def test_a_rate_is_shown_or_refuted_only_where_its_whole_interval_is(alarms, hours, word):
    # chi^2 / 2: 3.6889 above none, 0.2422 below two; of one in 24 h
    assert healthy.verdict(alarms, hours) == word


def test_more_hours_keep_the_rigs_of_fewer():
    few, many = (list(healthy.jobs(*hours)) for hours in ((3, 2), (6, 6)))
    assert {*few} < {*many}
    assert all(len({each.law for each in job}) == 1 for job in many)
    rigs = [each for job in many for each in job]
    assert len({each.seed for each in rigs}) == len(rigs)
    own = [each for each in rigs if each.law == LAW]
    assert len(own) * healthy.RUN_S / HOUR == 12
    for law in LAWS:
        assert law == LAW or sum(each.law == law for each in rigs) * healthy.RUN_S / HOUR == 6


@pytest.mark.long
def test_a_rig_of_a_batch_of_laws_and_scenarios_is_watched_as_alone(monkeypatch):
    monkeypatch.setattr(healthy, "RUN_S", 9.0)
    job = tuple(healthy.Watched(n, s, w) for n, s, w in ((0, "even", LAW), (1, "uneven", "pid")))
    together = healthy.carry_out(job)
    alone = [row for each in job for row in healthy.carry_out([each])]
    told = ("number", "law", "scenario", "length", "alarms", "every", "late")
    assert [[row[name] for name in told] for row in together] == [
        [row[name] for name in told] for row in alone
    ]
    assert together[0]["every"] > 0


def test_a_log_without_verdict_counts_no_hours(monkeypatch):
    def broken(*_, **__):
        raise LogError("ball off the screen")

    monkeypatch.setattr(healthy, "RUN_S", 1.0)
    monkeypatch.setattr(healthy, "shadow", broken)
    (row,) = healthy.carry_out([healthy.Watched(0, "even")])
    assert (row["why"], row["length"], row["alarms"]) == ("ball off the screen", 0.0, [])


@pytest.mark.parametrize("name", ["DRAWS", "UNDER_LAWS", "PER_LAW", "RUN_S"])
def test_rigs_of_other_draws_seeds_or_lengths_are_kept_under_another_name(monkeypatch, name):
    job = [healthy.Watched(3, "uneven", "pid")]
    before, value = healthy.key_of(job), getattr(healthy, name)
    assert healthy.key_of(job) == before
    monkeypatch.setattr(healthy, name, {"others": 1} if name == "DRAWS" else value + 1)
    assert healthy.key_of(job) != before


def test_a_changed_table_of_the_shadow_keeps_nothing(monkeypatch, tmp_path):
    job, files = [healthy.Watched(3, "uneven", "pid")], healthy.shadow_files()
    (table,) = (each for each in files if each.name == "belief.toml")
    other = tmp_path / "belief.toml"
    other.write_text(table.read_text(encoding="utf-8") + "\n# changed", encoding="utf-8")
    before, others = healthy.key_of(job), [other if each == table else each for each in files]
    monkeypatch.setattr(healthy, "shadow_files", lambda: others)
    assert healthy.key_of(job) != before
