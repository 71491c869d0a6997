"""What the Tab key offers, and that it comes fast."""

import os
import re
import select
import shutil
import subprocess
import sys
import time

import pytest
from click.shell_completion import BashComplete

from twin.cli import ballplate
from twin.cli.completion import VARIABLE


def offered(*words):
    """What is offered for the last word."""
    shell = BashComplete(ballplate, {}, "ballplate", VARIABLE)
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
        (("describe", "plant.fric"), ["plant.friction"]),
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


@pytest.mark.parametrize("command", ["run", "compare", "report", "view", "sweep", "export"])
def test_offering_scenarios_and_runs_imports_nothing_heavy(command):
    code = (
        "import sys; from twin.cli import ballplate; from click.shell_completion import *\n"
        f"shell = BashComplete(ballplate, {{}}, 'ballplate', '{VARIABLE}')\n"
        f"shell.get_completions(['{command}'], 'x')\n"
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "matplotlib", "pydantic", "rerun", "mujoco", "pyarrow"}
    assert not heavy & set(done.stdout.split())


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


TYPED = [
    ("ballplate compl", "ballplate completion "),
    ("ballplate run ci", "ballplate run circle "),
    ("ballplate compare circle thesis/9_2_05", "ballplate compare circle thesis/9_2_050 "),
    ("ballplate run circle --set plant.friction.rol", "plant.friction.rolling_mm="),
    ("ballplate run circle --set controller.kind=afl_", "controller.kind=afl_integral "),
    ("ballplate run circle --set controller.kind=back", "controller.kind=backstepping "),
    ("ballplate report runs/ci", "ballplate report runs/circle-a=1,b=2 "),
    ("ballplate report runs/circle-a=1,", "ballplate report runs/circle-a=1,b=2 "),
    ("ballplate report oth", "ballplate report other/"),
]
"""What is typed before the Tab key, and how the line ends after it."""
START = {
    "bash": (("--norc", "-i"), 'eval "$(ballplate completion bash)"; PS1=', "echo"),
    "zsh": (
        ("-f", "-i"),
        'autoload -Uz compinit; compinit -u -D; eval "$(ballplate completion zsh)"; PS1=',
        "print -r --",
    ),
}


class Shell:
    """An interactive shell at a terminal."""

    def __init__(self, shell, folder):
        import pty

        arguments, setup, self.echo = START[shell]
        self.process, self.terminal = pty.fork()
        if self.process == 0:
            os.chdir(folder)
            path = f"{folder}:{os.environ['PATH']}"
            os.environ.update(PATH=path, TERM="dumb", HOME=str(folder), PS1="")
            os.execvp(shell, [shell, *arguments])
        self.seen = b""
        self.write(f"{setup}; stty -echo cols 400; {self.echo} rea''dy\n")
        self.until(b"ready\r\n")

    def write(self, text):
        os.write(self.terminal, text.encode())

    def until(self, mark, within=120.0):
        end = time.monotonic() + within
        while mark not in self.seen:
            assert time.monotonic() < end, f"no {mark!r} in {self.seen[-500:]!r}"
            if select.select([self.terminal], [], [], 0.2)[0]:
                self.seen += os.read(self.terminal, 65536)
        found, _, self.seen = self.seen.partition(mark)
        return found.decode()

    def completed(self, line):
        """The line after the Tab key, which the shell then prints instead of running it."""
        self.write(f"{line}\tEND\x01{self.echo} '\x05'\n")
        return self.until(b"END\r\n").splitlines()[-1]

    def close(self):
        os.close(self.terminal)
        os.kill(self.process, 9)
        os.waitpid(self.process, 0)


@pytest.fixture
def place(tmp_path):
    """A working folder with the program, a run and another folder."""
    program = tmp_path / "ballplate"
    program.write_text(f"#!{sys.executable}\nfrom twin.cli import main\nmain()\n")
    program.chmod(0o755)
    (tmp_path / "runs" / "circle-a=1,b=2").mkdir(parents=True)
    (tmp_path / "runs" / "circle-a=1,b=2" / "run.parquet").touch()
    (tmp_path / "other").mkdir()
    return tmp_path


@pytest.mark.long
@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_tab_key_completes_at_a_terminal(shell, place):
    if not shutil.which(shell):
        pytest.skip(f"there is no {shell} here")
    terminal = Shell(shell, place)
    try:
        for line, end in TYPED:
            assert terminal.completed(line).endswith(end), line
    finally:
        terminal.close()


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("fish"), reason="there is no fish here")
def test_the_tab_key_completes_in_fish(place):
    environment = {**os.environ, "PATH": f"{place}:{os.environ['PATH']}", "HOME": str(place)}
    for line, end in TYPED:
        script = f"ballplate completion fish | source; complete -C '{line}'"
        done = subprocess.run(
            ["fish", "--no-config", "-c", script],
            capture_output=True, text=True, check=True, cwd=place, env=environment,
        )  # fmt: skip
        (offer,) = done.stdout.splitlines()
        assert end.split()[-1] == offer.partition("\t")[0], line


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_the_other_scripts_call_the_program_back(shell, capsys):
    ballplate.main(["completion", shell], standalone_mode=False)
    assert re.search(rf"{VARIABLE}={shell}_complete", capsys.readouterr().out)
