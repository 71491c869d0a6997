"""`twin.lab`.

The shipped labs: whole, their starters made from their solutions, and rigs that matter."""

import re
from pathlib import Path

import can
import numpy as np
import pytest

from twin.lab.deals import LOG_FILE, deal, write_log
from twin.lab.handing_out import make_starter
from twin.lab.judge import judge_answer
from twin.lab.schema import read, shipped_labs
from twin.lab.selftest import candidates, prepare_answer

LABS = sorted(shipped_labs())
KEY = "of a test"


@pytest.mark.parametrize("name", LABS)
def test_a_lab_has_sheet_notes_and_mutants_that_name_checks_which_can_fail(name: str) -> None:
    lab = read(name)
    sheet = (lab.folder / "task.md").read_text("utf-8")
    assert len(sheet.splitlines()) <= 120
    assert "## What you must be able to explain" in sheet
    notes = (lab.folder / "notes.md").read_text("utf-8")
    assert "## Oral questions, with answers" in notes
    mutants = [each for each in candidates(lab) if each.fails]
    assert 3 <= len(mutants) <= 6
    for mutant in mutants:
        assert f"`{mutant.name}`" in notes, f"the notes do not name {mutant.name}"
        for check in mutant.fails:
            assert check in notes


@pytest.mark.parametrize("name", LABS)
def test_the_sheet_tells_the_limits_that_are_marked_by(name: str) -> None:
    lab = read(name)
    rows = re.findall(r"^\| (.+?) \| (\d+) \| (.*?) \|", sheet_of(lab.folder), re.MULTILINE)
    assert [int(points) for _, points, _ in rows] == [
        check.points for check in lab.checks(hidden=True)
    ]
    for (_, _, told), check in zip(rows, lab.checks(hidden=True), strict=True):
        if check.metric and check.limit is None:
            number = float(re.findall(r"[\d.]+", told)[0])
            assert any(number == pytest.approx(scale * check.full) for scale in (1, 1000))


@pytest.mark.parametrize("name", LABS)
def test_a_starter_is_what_remains_of_its_solution(name: str) -> None:
    lab = read(name)
    if lab.answer.data:
        pytest.skip("its starter is data")
    made = make_starter((lab.folder / "solution.py").read_text("utf-8"))
    assert made == (lab.folder / "answer.py").read_text("utf-8")


@pytest.mark.long
@pytest.mark.parametrize("name", ["deadtime", "friction", "identify", "wire"])
def test_an_answer_handed_on_scores_visibly_worse(name: str, tmp_path: Path) -> None:
    lab = read(name)
    solution = next(each.file for each in candidates(lab) if each.name == "solution")
    rigs = [deal(lab, f"student{number}", KEY) for number in range(12)]
    dealt = lab.variant.keys[0]  # type: ignore[union-attr]
    least, most = (end(rigs, key=lambda rig: rig.point[dealt]) for end in (min, max))
    for own, other in ((least, most), (most, least)):
        folder = tmp_path / own.student
        folder.mkdir()
        write_log(lab, own, folder / LOG_FILE)
        answer = prepare_answer(lab, solution, own, folder)
        found, copied = (judge_answer(lab, each, answer, hidden=False) for each in (own, other))
        assert found["score"] == found["max_score"]
        assert copied["score"] <= 0.75 * found["score"]


@pytest.mark.parametrize("name", ["identify", "wire"])
def test_an_interval_that_holds_everything_earns_nothing(name: str, tmp_path: Path) -> None:
    lab, file = read(name), tmp_path / "answer.toml"
    for student in ("ann", "bob", "cid"):
        dealt = deal(lab, student, KEY)
        file.write_text("".join(f"{key} = [-1e9, 1e9]\n" for key in lab.answer.asked))
        assert judge_answer(lab, dealt, file, hidden=True)["score"] == 0


def test_the_ranges_that_the_sheet_of_identify_tells_earn_nothing_for_the_log(
    tmp_path: Path,
) -> None:
    lab, file = read("identify"), tmp_path / "answer.toml"
    file.write_text(
        'rolling_mm = [0.20, 0.26]\ndead_time = [0.03, 0.08]\nbreakaway_ratio = "not determined"\n'
    )
    for student in ("ann", "bob", "cid"):
        found = judge_answer(lab, deal(lab, student, KEY), file, hidden=True)["results"]
        assert [each["score"] for each in found[:4]] == [0, 0, 0, 0]


BEGINS = 2.1005
"""When the fault of that test begins, s: between two periods."""


@pytest.mark.long
@pytest.mark.parametrize(
    "fault", ["silent", "heartbeat", "drive fault", "reboot", "pre-operational"]
)
def test_a_trace_of_the_wire_shows_the_fault_that_was_dealt(fault: str, tmp_path: Path) -> None:
    lab = read("wire")
    point = {"wire.fault": fault, "wire.node": 2.0, "wire.begins": BEGINS, "wire.lost": 3.0}
    write_log(lab, deal(lab, "ann", KEY)._replace(point=point), tmp_path / LOG_FILE)
    with can.CanutilsLogReader(tmp_path / "bus.log") as frames:  # another's reader of this format
        said = [(each.timestamp, each.arbitration_id, bytes(each.data)) for each in frames]
    pdos, beats = (
        [(time, data) for time, identifier, data in said if identifier == service + 2]
        for service in (0x180, 0x700)
    )
    before = [time for time, _ in pdos if time < 2.1]
    gaps = np.diff(before)
    assert max(gaps) == pytest.approx(0.008)  # three frames of 2 ms each are lost, once
    assert 1.59 < before[int(np.argmax(gaps))] < 1.61
    stopped = next(
        time
        for time, identifier, data in said
        if time > BEGINS and identifier in {0x201, 0x202} and data[0] != 0x0F
    )
    later = [(time, data) for time, data in beats if time > BEGINS]
    shown = {
        "silent": not later and pdos[-1][0] < BEGINS,
        "heartbeat": not later and pdos[-1][0] > stopped > 2.13,
        "drive fault": any(data[0] & 8 for time, data in pdos if time <= stopped),
        "reboot": later[:1] != [] and later[0][1] == bytes(1),
        "pre-operational": later[:1] != [] and later[0][1] == b"\x7f" and pdos[-1][0] < BEGINS,
    }
    assert [name for name, there in shown.items() if there] == [fault]


def sheet_of(folder: Path) -> str:
    """The part of a sheet that says how it is marked."""
    text = (folder / "task.md").read_text("utf-8")
    return text.split("## How it is marked")[1].split("## What you must")[0]
