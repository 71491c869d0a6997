"""`twin.cli`: The pages for beginners: typed as they stand, they print what they say."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import scipy.io
from command_line import called

from controllers.catalog import forget
from twin.run.opened import open_run
from twin.scenario import load

ROOT = Path(__file__).parents[2]
PAGES = {
    name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("bus-node", "controller-fmu", "tutorial", "from-matlab", "simulink")
}
BEFORE = ["pip install uv", "uv sync", "source .venv/bin/activate"]
"""What the tutorial has typed in a shell before the first command."""
LAW = Path("laws/mine.py")
EXAMPLE = "python examples/"
WIRE = "--rig emulated"
"""What takes its time by the clock, and prints other last digits each time."""
PARTS = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def commands(text):
    """Lines to be typed, without their ``ballplate``."""
    lines = [
        line for kind, block in PARTS.findall(text) if kind == "sh" for line in block.split("\n")
    ]
    typed = [line for line in lines if line and line not in BEFORE]
    assert all(line.startswith(("ballplate ", EXAMPLE)) for line in typed)
    return [line.removeprefix("ballplate ") for line in typed]


def squeezed(text):
    """A text whose line breaks and spaces are one space each, without the frames of tables."""
    return " ".join(re.sub(r"[│┃]", " ", text).split())


def typed(arguments):
    """What a command prints, which ends as it should."""
    done = subprocess.run(
        arguments, capture_output=True, text=True, check=False, env={**os.environ, "COLUMNS": "200"}
    )
    assert done.returncode == 0, f"{arguments}: {done.stderr}"
    return squeezed(f"{done.stdout}\n{done.stderr}")


def ballplate(line):
    """What ``ballplate`` prints, or an example's program."""
    if line.startswith(EXAMPLE):
        program, *words = line.removeprefix("python ").split()
        return typed([sys.executable, str(ROOT / program), *words])
    program = "import shlex, sys; from twin.cli import main; main(shlex.split(sys.argv[1]))"
    return typed([sys.executable, "-c", program, line])


def walked(text):
    """Do what a page says, in this folder; all that was printed.

    Every line of a text block must have been printed since the block before, and every percentage
    of the prose at any time until then.
    """
    printed, latest, end = "", "", 0
    for part in PARTS.finditer(text):
        prose, (kind, block), end = text[end : part.start()], part.groups(), part.end()
        check_percentages(prose, printed)
        match kind:
            case "sh":
                lines = [line for line in commands(part.group()) if WIRE not in line]
                latest = " ".join(map(ballplate, lines))
            case "py":
                Path("design.py").write_text(block, encoding="utf-8")
                latest = typed([sys.executable, "design.py"])
            case "diff":
                added(block)
                continue
            case "toml":
                Path("luck.toml").write_text(block, encoding="utf-8")
                continue
            case "text":
                for line in block.splitlines():
                    assert printed_in(squeezed(line), latest), line
                continue
        printed += latest
    check_percentages(text[end:], printed)
    return printed


def added(block):
    """Add lines to the law as a page shows them, each below the one that it has."""
    lines, at = LAW.read_text(encoding="utf-8").splitlines(), 0
    for shown in filter(None, block.splitlines()):
        if shown.startswith("+"):
            at += 1
            lines.insert(at, shown[1:])
        else:
            at = lines.index(shown[1:], at)
    LAW.write_text("\n".join(lines), encoding="utf-8")


def check_percentages(prose, printed):
    """Every percentage of the prose has been printed."""
    numbers = re.findall(r"[\d.]+(?= %)", prose)
    assert [each for each in numbers if not printed_in(each, printed)] == []


NUMBER = re.compile(r"(?<![\d.])\d+(?:\.\d+)?(?![\d.])")


def printed_in(line, printed):
    """Whether a line was printed, its decimals to one unit of the last: kernels round otherwise."""
    parts = NUMBER.split(line)
    pattern = re.compile(rf"(?<![\d.])({NUMBER.pattern})".join(map(re.escape, parts)))
    wanted = NUMBER.findall(line)
    return any(
        all(
            abs(float(a) - float(b)) <= 1.01 * ("." in a) * 10.0 ** -len(a.partition(".")[2])
            for a, b in zip(wanted, found.groups(), strict=True)
        )
        for found in pattern.finditer(printed)
    )


def test_a_line_is_printed_where_its_decimals_are_but_for_the_last_one():
    assert printed_in("error 1.252 %", "the error 1.253 % of 3")
    assert not printed_in("error 1.252 %", "the error 1.254 % of 3")
    assert printed_in("3 runs", "13 runs, 3 runs")
    assert not printed_in("3 runs", "13 runs, 4 runs")


def test_what_the_tutorial_says_before_its_first_command_is_so():
    scenario, text = load("circle"), squeezed(PAGES["tutorial"])
    assert f"{1000 * scenario.sensors.touch.dead_time:g} ms late" in text
    assert f"a circle of {1000 * scenario.reference.amplitude:g} mm" in text
    assert scenario.predictor.delay == scenario.sensors.touch.dead_time
    assert f"takes its {scenario.duration:g} s by the clock" in text


@pytest.mark.usefixtures("own_laws")
def test_the_lines_that_the_tutorial_adds_to_the_law_make_a_setting(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    called(capsys, "new", "law", "mine")
    added(dict(PARTS.findall(PAGES["tutorial"]))["diff"])
    forget()
    _, told, _ = called(capsys, "describe", "mine", "--law", "laws/mine.py")
    assert "controller.push = 0.0 m/s^2 Push against friction" in squeezed(told)


@pytest.mark.long
def test_the_tutorial_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed = walked(PAGES["tutorial"])
    assert "18 runs of Circle" in printed


@pytest.mark.long
def test_the_page_for_those_who_come_from_matlab_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed = walked(PAGES["from-matlab"])
    assert printed.count("tracking error e_tt 14.73 11.8 %") == 2
    found = scipy.io.loadmat("circle.mat")
    assert found["time"].shape == found["true_x"].shape == (12500, 1)
    assert found["units"]["true_x"][0, 0] == "m"


@pytest.mark.long
def test_the_page_about_simulink_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    walked(PAGES["simulink"])
    assert {path.name for path in Path().glob("*.fmu")} == {"rig.fmu", "rig3.fmu", "quiet.fmu"}


@pytest.mark.long
def test_the_page_about_a_drive_on_a_simulated_bus_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    walked(PAGES["bus-node"])


@pytest.mark.long
def test_the_page_about_a_controller_as_an_fmu_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    walked(PAGES["controller-fmu"])


@pytest.mark.long
@pytest.mark.real_time
def test_the_law_of_the_tutorial_does_the_same_over_the_wire(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ballplate("new law mine")
    added(dict(PARTS.findall(PAGES["tutorial"]))["diff"])
    (line,) = (each for each in commands(PAGES["tutorial"]) if WIRE in each)
    for attempt in range(3):  # the computer may be too busy for real time
        try:
            ballplate(f"{line} --out wire")
            break
        except AssertionError:
            if attempt == 2:
                raise
    (run,) = open_run(Path("wire"))
    assert 1 <= run.metrics["tracking_error_percent"] <= 2
