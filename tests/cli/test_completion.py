"""`twin.cli.options`: What the Tab key offers, and that it comes fast."""

import shutil
import subprocess
import sys

import pytest
from click.shell_completion import BashComplete

from twin.cli import ballplate
from twin.cli.options import COMPLETION_VARIABLE


def offered(*words):
    """What is offered for the last word."""
    shell = BashComplete(ballplate, {}, "ballplate", COMPLETION_VARIABLE)
    return [each.value for each in shell.get_completions(list(words[:-1]), words[-1])]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("compl",), ["completion"]),
        (("run", "ci"), ["circle"]),
        (("compare", "circle", "thesis/9_2_0"), ["thesis/9_2_050", "thesis/9_2_075"]),
        (("run", "circle", "--set", "plant.friction.rol"), ["plant.friction.rolling_mm="]),
        (("sweep", "circle", "controller.rho"), ["controller.rho="]),
        (("run", "x", "--set", "controller.kind=afl_"), ["controller.kind=afl_integral"]),
        (("study", "fric"), ["friction"]),
        (("describe", "plant.friction.rol"), ["plant.friction.rolling_mm"]),
    ],
)
def test_commands_scenarios_studies_and_keys_are_offered(words, expected):
    assert offered(*words)[: len(expected)] == expected


def test_runs_are_offered_once_they_are_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "circle-a=1").mkdir(parents=True)
    (tmp_path / "runs" / "study-x").mkdir()
    (tmp_path / "runs" / "circle-a=1" / "run.parquet").touch()
    assert offered("report", "runs/ci") == ["runs/circle-a=1"]
    assert offered("report", "la") == ["last"]
    assert offered("compare", "runs/") == ["runs/circle-a=1"]
    assert "runs/study-x" not in offered("view", "runs/")


@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash here")
def test_the_script_for_bash_completes_in_bash(tmp_path):
    program = tmp_path / "ballplate"
    program.write_text(f"#!{sys.executable}\nfrom twin.cli import main\nmain()\n")
    program.chmod(0o755)
    script = (
        f'PATH="{tmp_path}:$PATH"; eval "$(ballplate completion bash)"\n'
        "COMP_WORDS=(ballplate run ci); COMP_CWORD=2; _ballplate_completion ballplate\n"
        'echo "${COMPREPLY[@]}"'
    )
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "circle"
