"""`twin.lab.grade`.

A class's answers: mutants, mixtures and worse, graded, killed, gone on with; and their pages."""

import csv
import os
import random
import re
import signal
import subprocess
import sys
import time
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import sync_playwright

from twin.lab.copies import find_alike
from twin.lab.deals import deal
from twin.lab.handed_in import Submission, collect
from twin.lab.handing_out import fill_answer, hand_out
from twin.lab.packs import begin as begin_lab
from twin.lab.pages import class_page
from twin.lab.schema import Lab, read
from twin.lab.selftest import candidates

MINI = Path(__file__).parent / "mini"
KEY = "the key of a course"
CHROMIUM = Path("/usr/bin/chromium")


def mixed(one: str, other: str, draw: random.Random) -> str:
    """A text with some of the lines in which another differs from it."""
    a, b = one.splitlines(keepends=True), other.splitlines(keepends=True)
    lines: list[str] = []
    for _, begin, end, start, stop in SequenceMatcher(None, a, b).get_opcodes():
        lines += a[begin:end] if draw.random() < 0.5 else b[start:stop]
    return "".join(lines)


def hand_in(lab: Lab, folder: Path, people: int) -> list[str]:
    """Submissions of a class: own answers of the lab, mixtures of two of them, and no answers."""
    draw, names = random.Random(1), [f"student{number:02}" for number in range(people)]
    hand_out(lab, {name: name for name in names}, KEY, folder)
    own = [each for each in candidates(lab) if each.name != "starter"]
    texts = [each.file.read_text() for each in own if each.file.suffix == ".py"]
    worse = ["def broken(:\n", "import mujoco\n", "", None]
    for number, name in enumerate(names):
        file = folder / name / lab.answer.file
        if number < people - len(worse):
            one, other = draw.choice(texts), draw.choice(texts)
            text = texts[number] if number < len(texts) else mixed(one, other, draw)
            file.write_text(fill_answer(text, deal(lab, name, KEY).known))
        elif (wrong := worse[people - 1 - number]) is None:
            file.unlink()
        else:
            file.write_text(wrong)
    return names


def command(*given: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [Path(sys.executable).with_name("ballplate"), "lab", "grade", *map(str, given)],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def marks(file: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(file.read_text().splitlines()))


@pytest.mark.long
def test_a_class_that_was_killed_in_the_middle_gets_the_same_marks(tmp_path: Path) -> None:
    lab, handed_in, key = read(MINI), tmp_path / "in", tmp_path / "key.txt"
    names = hand_in(lab, handed_in, 10)
    (handed_in / "stranger").mkdir()
    key.write_text(KEY)
    people = tmp_path / "class.csv"
    people.write_text("\n".join(["id", *names, "absent"]))
    given = (MINI, handed_in, "--key", key, "--class", people, "--processes", 2)
    whole, killed = tmp_path / "whole.csv", tmp_path / "killed.csv"
    assert command(*given, "--out", whole).wait() == 1
    kept = tmp_path / "killed.results"
    process = command(*given, "--out", killed)
    while len([*kept.glob("*.json")]) < 3:
        assert process.poll() is None
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not killed.exists()
    before = {file: file.stat().st_mtime_ns for file in kept.glob("*.json")}
    assert len(before) < len(names)
    assert command(*given, "--out", killed).wait() == 1
    assert marks(killed) == marks(whole)
    assert all(file.stat().st_mtime_ns == then for file, then in before.items())
    by_name = {each["student"]: each for each in marks(whole)}
    assert by_name["student00"]["score"] == by_name["student00"]["max_score"]
    assert by_name["absent"]["problem"] == "not handed in"
    assert "not in the class" in by_name["stranger"]["problem"]
    for name in names:
        page = (tmp_path / "whole.results" / f"{name}.html").read_text()
        assert ("<svg" in page) == (name < "student06"), name
    assert 'href="whole.results/student00.html"' in whole.with_suffix(".html").read_text()


def a_result(student: str, *scores: float) -> dict[str, Any]:
    results = [
        {
            "name": f"check {number}",
            "passed": score == 4,
            "score": score,
            "max_score": 4.0,
            "cause": None if score == 4 else {"rationale": "why", "help": ""},
            "data": {"value": 10 * score, "ending": "measured"},
        }
        for number, score in enumerate(scores)
    ]
    return {"student": student, "score": sum(scores), "max_score": 8.0, "results": results}


def test_the_page_of_a_class_counts_what_became_of_each_check(tmp_path: Path) -> None:
    lab = read(MINI)
    three = [(2.0, 4.0, 4.0), (2.0, 0.0, 1.0), (0.0, 4.0, 4.0), (2.0, 4.0, 4.0)]
    found = [a_result(f"<b>{number}", *each) for number, each in enumerate(three)]
    found[1]["results"][1]["passed"] = None
    found.append({"student": "eve", "score": None, "results": [], "problem": "no <key>"})
    page = class_page(lab, found, tmp_path)
    assert "<b>" not in page
    assert "no &lt;key&gt;" in page
    assert "5 students, 1 not graded; points of the others 3 to 10, median 9" in page
    alone = class_page(lab, found[:1], tmp_path)
    assert "1 students" not in alone
    assert "1 student, 0 not graded" in alone
    rows = re.findall(r"<tr>(.*?)</tr>", page, re.DOTALL)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL) for row in rows]
    row = next(row for row in cells if row and row[0] == "2 the ball is brought to the middle (4)")
    assert row[1:] == ["3", "0", "0", "1", "3"]


PUSHES = {
    "ann": """        v = r[1]
        n = np.sqrt(v[..., :1] ** 2 + v[..., 1:] ** 2)
        push = 1.35 * 5.886 * self.arm_mm * 1e-3 / 0.02 * v / (n + 1e-6)
""",
    "bob": """        F = self.model.k1 * (self.arm_mm * 1e-3) / self.model.radius
        norm = np.linalg.norm(r[1], axis=-1, keepdims=True)
        direction = np.where(norm > 1e-3, r[1] / np.maximum(norm, 1e-3), 0.0)
        push = self.factor * F * direction
""",
    "cem": """        friction = self.model.k1 * self.arm_mm / (1000 * self.model.radius)
        speed = np.hypot(r[1][..., 0], r[1][..., 1])[..., None]
        if np.any(speed > 0.001):
            push = self.factor * friction * r[1] / np.clip(speed, 0.001, None)
""",
    "dora": """        friction = self.model.k1 * self.arm_mm / 1000 / self.model.radius
        length = np.linalg.norm(r[1], axis=-1, keepdims=True)
        push = self.factor * friction * r[1] / (length + 1e-3)
""",
}
"""Answers to the lab friction that were written independently, below the same line."""


def hand_in_pushes(folder: Path, **more: str) -> list[Submission]:
    """Submissions of the lab friction: the independent answers, the solution, the starter twice."""
    lab = read("friction")
    line = "        push = np.zeros_like(wanted)\n"
    texts = {name: lab.text("answer.py").replace(line, line + own) for name, own in PUSHES.items()}
    texts |= {"eve": lab.text("solution.py"), "finn": lab.text("answer.py")}
    texts |= {"gil": lab.text("answer.py"), **more}
    folder.mkdir()
    for name, text in texts.items():
        filled = text if name in more else fill_answer(text, deal(lab, name, KEY).known)
        (folder / f"{name}.py").write_text(filled)
    return collect(lab, folder).submissions


def test_independent_answers_from_one_starter_are_not_alike(tmp_path: Path) -> None:
    handed_in = hand_in_pushes(tmp_path / "in")
    assert find_alike(read("friction"), KEY, (), handed_in) == []


def test_copies_and_values_of_another_student_are_named(tmp_path: Path) -> None:
    lab = read("friction")
    hand_in_pushes(tmp_path / "first")
    copied = (tmp_path / "first" / "cem.py").read_text()
    renamed = copied.replace("speed", "tempo").replace("friction *", "friction  *")
    renamed = renamed.replace("tempo = ", "# my own idea\n        tempo = ")
    found = find_alike(lab, KEY, ["gone"], hand_in_pushes(tmp_path / "in", hal=copied, ida=renamed))
    value = repr(deal(lab, "cem", KEY).known["plant.friction.rolling_mm"])
    assert {each[:3] for each in found if each.kind != "value"} == {
        ("same", "cem", "hal"),
        ("near", "cem", "ida"),
        ("near", "hal", "ida"),
    }
    values = [each for each in found if each.kind == "value"]
    assert values == [("value", "hal", "cem", value), ("value", "ida", "cem", value)]
    assert values[0].text("en") == f"hal: {value} is a value of the rig of cem"


def test_the_page_of_a_class_has_names_and_the_reason_of_each_0(tmp_path: Path) -> None:
    lab = read(MINI)
    found = [a_result(name, 2.0, 0.0, 0.0) for name in ("ann", "bob", "cem", "dan")]
    for each, end in zip(found, ("measured", "broken", "timed out", "not graded"), strict=True):
        each["results"][1]["data"]["ending"] = end
    found.append({"student": "eve", "score": 0.0, "results": [], "problem": "not handed in"})
    names = {"ann": "Ann Lee", "eve": "Eve <b>"}
    page = class_page(lab, found, tmp_path, people=names, alike=["ann and bob: the same file"])
    text = re.sub(r"\s*<[^>]+>\s*", "|", page)
    cells = [each for each in text.split("|") if each]
    for row in (
        ["ann Ann Lee", "2", "2", "0 wrong", "0 wrong"],
        ["bob", "2", "2", "0 broken"],
        ["cem", "2", "2", "0 timed out"],
        ["dan", "2", "2", "0 skipped"],
        ["eve Eve &lt;b&gt;", "0 not handed in"],
        ["2 - 3", "4", "\u2588" * 4],
        ["ann and bob: the same file"],
    ):
        at = cells.index(row[0], cells.index("Marks, check by check") if len(row) > 3 else 0)
        assert cells[at : at + len(row)] == row


@pytest.mark.long
@pytest.mark.skipif(not CHROMIUM.exists(), reason="needs chromium (Debian: chromium)")
def test_every_cell_of_the_page_of_a_class_is_seen_on_a_telephone(tmp_path: Path) -> None:
    begin_lab("reibung", tmp_path / "lab", read("friction"))
    text = (tmp_path / "lab" / "lab.toml").read_text("utf-8")
    (tmp_path / "lab" / "lab.toml").write_text(text.replace('"en"', '"de"', 1), "utf-8")
    lab, found = read(tmp_path / "lab"), []
    for end in ("measured", "broken", "timed out", "not graded"):
        about = {"data": {"ending": end}, "cause": {"rationale": "answer.py, line 3: NameError"}}
        checks = lab.checks(hidden=True)
        its = [{**about, "name": each.name, "passed": False, "score": 0.0} for each in checks]
        found.append({"student": f"student{len(found)}", "score": 0.0, "results": its})
    found.append({"student": "hans", "score": 0.0, "results": [], "problem": "not handed in"})
    page = class_page(lab, found, tmp_path, people={"student1": "Anna Groß"})
    assert '<html lang="de">' in page
    assert "not handed in" not in page
    (tmp_path / "page.html").write_text(page, "utf-8")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": 400, "height": 900})
        shown.goto((tmp_path / "page.html").as_uri())
        ends = "[...document.querySelectorAll('td')].map(c => c.getBoundingClientRect().right)"
        right = max(shown.evaluate(ends))
        browser.close()
    assert right <= 400
