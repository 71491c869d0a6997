"""`ballplate`: the files of a release, and the installation that is light."""

import hashlib
import json
import os
import shlex
import subprocess
import sys
import tomllib
import zipfile

import pytest
from fresh_environment import PROJECT, ROOT, call, installed

import ballplate
from release import build
from twin.base.parts import PARTS
from twin.cli import COMMANDS

MAX_CORE_MB = 250
"""Most that an installation of the core may take on the disk, without bytecode."""
TEXT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_core_requires_what_no_part_has_and_each_part_is_an_extra_of_it():
    core = tomllib.loads(build.as_core(TEXT))["project"]
    assert core["name"] == "ballplate-core"
    assert core["version"] == PROJECT["version"]
    required = {build.name_of(each) for each in core["dependencies"]}
    extras = core["optional-dependencies"]
    parts = {part: {build.name_of(each) for each in extras[part]} for part in PARTS}
    assert required.union(*parts.values()) == {*map(build.name_of, PROJECT["dependencies"])}
    assert not required.intersection(*parts.values())
    assert extras.items() >= PROJECT["optional-dependencies"].items()
    left = set(PROJECT["dependencies"]) - set(core["dependencies"])
    assert left - {each for part in PARTS for each in extras[part]} == {
        "mujoco-core[rendering]>=4.0,<5"
    }


def test_a_requirement_that_is_not_listed_as_the_core_expects_it_is_not_left_out_silently():
    with pytest.raises(ValueError, match="a form that is not known"):
        build.as_core(TEXT.replace("dependencies = [\n", "dependencies = [ # which\n", 1))
    with pytest.raises(KeyError, match="pandas"):
        build.as_core(TEXT.replace('"pandas>=3.1"', '"polars>=1"', 1))


def test_the_version_stands_in_no_module_and_heads_the_changes():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()
    released = [each.split()[1] for each in changes if each.startswith("## ")]
    version = PROJECT["version"]
    assert released[:1] == [version] or f"[What {version} is]" in "".join(changes)
    code = [*(ROOT / "src").rglob("*.py"), *(ROOT / "controllers").rglob("*.py")]
    assert not [each for each in code if f'"{PROJECT["version"]}"' in each.read_text("utf-8")]


TIME = 1_790_000_000
"""Time of the files, in seconds since 1970."""


def built(folder, source, time=TIME):
    """The files of a release by their names."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", str(time))
        return {each.name: each for each in build.build(folder, source)}


def copy_checkout(folder):
    """The files that git knows, as they are."""
    for name in call("git", "ls-files", cwd=ROOT).splitlines():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes((ROOT / name).read_bytes())
    return folder


@pytest.fixture(scope="module")
def release(tmp_path_factory):
    place = tmp_path_factory.mktemp("release")
    made = built(place / "made", copy_checkout(place / "source"))
    assert len(made) == 4
    return made


def one(release, begin, end):
    names = [each for each in release if each.startswith(begin) and each.endswith(end)]
    assert len(names) == 1
    return release[names[0]]


@pytest.mark.long
def test_both_wheels_have_the_same_code(release):
    def files(begin):
        with zipfile.ZipFile(one(release, begin, ".whl")) as wheel:
            code = [each for each in wheel.infolist() if ".dist-info/" not in each.filename]
            return {each.filename: each.CRC for each in code}

    assert files("ballplate-") == files("ballplate_core-")


@pytest.mark.long
def test_a_checkout_elsewhere_with_other_times_and_rights_gives_the_same_bytes(release, tmp_path):
    source = copy_checkout(tmp_path / "elsewhere")
    for each in source.rglob("*"):
        os.utime(each, (1, 1))
        each.chmod(0o600 if each.is_file() else 0o700)

    def sums(files):
        return {name: hashlib.sha256(each.read_bytes()).hexdigest() for name, each in files.items()}

    first = sums(release)
    assert sums(built(tmp_path / "again", source)) == first
    later = sums(built(tmp_path / "later", source, TIME + 2))
    assert all(later[name] != first[name] for name in first)


@pytest.mark.long
def test_an_index_would_take_every_file(release):
    call(*build.CHECK, *release.values())


@pytest.fixture(scope="module")
def core(release, tmp_path_factory):
    """Programs of an environment with the core alone, their variables, and an empty folder."""
    place = tmp_path_factory.mktemp("core")
    wheel = one(release, "ballplate_core-", ".whl")
    programs, clean = installed(place, sys.executable, wheel)
    size = int(call("du", "-sk", programs.parent).split()[0])
    assert size < 1000 * MAX_CORE_MB
    (place / "empty").mkdir()
    return programs, clean, place / "empty"


def run_core(core, *arguments):
    programs, clean, folder = core
    command = [str(programs / "ballplate"), *arguments]
    return subprocess.run(
        command, cwd=folder, env=clean, capture_output=True, text=True, check=False, timeout=300
    )


@pytest.mark.long
def test_the_core_runs_a_scenario_as_the_whole_does_and_says_what_it_leaves_out(core):
    done = run_core(core, "run", "circle", "--json", "--out", "runs/circle")
    assert done.returncode == 0, done.stderr
    found, whole = json.loads(done.stdout), ballplate.run("circle")
    assert {key: found[key] for key in whole.metrics} == whole.metrics
    assert (
        found["baseline"]["tracking_error_percent"]
        == whole.baseline.metrics["tracking_error_percent"]
    )
    assert [each.name for each in (core[2] / "runs" / "circle").iterdir()] == ["metrics.json"]
    warned = [line for line in done.stderr.splitlines() if "warning" in line]
    assert [line.partition(": not written: needs ")[0] for line in warned] == [
        "ballplate: warning: run.parquet",
        "ballplate: warning: picture.png",
    ]
    assert warned[0].endswith("pip install 'ballplate-core[records]'")
    assert run_core(core, "--version").stdout == f"ballplate, version {PROJECT['version']}\n"


SHORT = "--set duration=1 --set metrics.start=0"
LINES = {
    "list": ("list", ""),
    "describe": ("describe plant.friction", ""),
    "run": (f"run sine --beside hold {SHORT}", ""),
    "compare": (f"compare hold sine {SHORT}", ""),
    "sweep": (f"sweep hold plant.friction.rolling_mm=0:0.5:2 {SHORT}", ""),
    "play": ("play circle", "play"),
    "view": ("view kept --rrd kept.rrd", "records"),
    "report": ("report kept", "records"),
    "export": ("export kept kept.csv", "records"),
    "explain": (f"explain hold {SHORT}", ""),
    "study": ("study friction --plan", "records"),
    "whatif": ("whatif kept --at 0.5 --set controller.kind=lqr", "records"),
    "analyse": ("analyse circle", "control"),
    "reproduce": ("reproduce 8.1", "records"),
    "tune": ("tune afl --candidates 16", "records"),
    "identify": ("identify kept", "records"),
    "fit": ("fit friction_of_two_series", "records"),
    "doctor": ("doctor --rig emulated", "can"),
    "calibrate": ("calibrate lost-motion", "can"),
    "shadow": ("shadow kept", "pictures"),
    "emulate": ("emulate circle --bus vcan0", "can"),
    "trace": ("trace kept.log", ""),
    "safety": ("safety --only heartbeat", "can"),
    "lab": ("lab check signs answer.py --student 7", ""),
    "bench": ("bench run my_law.py --out entry", "tables"),
    "new": ("new law mine --like pid", ""),
    "completion": ("completion bash", ""),
    "docs": ("docs", None),
}
"""A line for each command, and the extra without which it cannot be carried out; None for the
pages, which only a checkout has."""


@pytest.fixture(scope="module")
def inputs(core):
    """What a whole installation made: a run, a trace, an answer to a lab."""
    folder = core[2]
    ballplate.run("hold", duration=1.0, out=folder / "kept")
    (folder / "kept.log").write_text("(0.000000) can0 080#\n(0.002000) can0 080#\n")
    answer = ROOT / "scenarios" / "labs" / "signs" / "answer.py"
    (folder / "answer.py").write_bytes(answer.read_bytes())


@pytest.mark.long
@pytest.mark.usefixtures("inputs")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_core_does_its_work_or_says_in_one_line_what_it_needs(core, command):
    line, extra = LINES[command]
    done = run_core(core, *shlex.split(line))
    assert "Traceback" not in done.stderr
    if extra == "":
        assert done.returncode == int(command == "lab"), done.stderr  # its answer is an empty one
        return
    assert done.returncode == 2
    (said,) = done.stderr.splitlines()
    assert extra is None or said.endswith(f": pip install 'ballplate-core[{extra}]'")


PUBLIC = """
import sys
import ballplate
for name in ballplate.__all__:
    try:
        getattr(ballplate, name)
    except ballplate.TwinError as error:
        assert isinstance(error, ModuleNotFoundError)
        print(name, error)
"""


@pytest.mark.long
def test_every_public_name_of_the_core_is_there_or_says_what_it_needs(core):
    programs, clean, folder = core
    lines = call(programs / "python", "-c", PUBLIC, cwd=folder, env=clean).splitlines()
    assert all("pip install 'ballplate-core[" in line for line in lines)
    assert {line.split()[0] for line in lines} == set()
