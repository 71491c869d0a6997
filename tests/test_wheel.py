"""Tests of `ballplate`."""

import json
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from fresh_environment import PROJECT, ROOT, UV, call, here, installed, pins_in


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    assert UV, "the tests are run with uv"
    folder = tmp_path_factory.mktemp("wheel")
    call(UV, "build", "--wheel", "--out-dir", folder, ROOT)
    (path,) = folder.glob("*.whl")
    return path


@pytest.mark.long
def test_the_wheel_installs_code_model_and_scenarios_typed_and_nothing_else(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "twin/models/ballplate.xml",
        "twin/models/cams.json",
        "scenarios/circle.toml",
        "controllers/controller.py",
        "twin/cli/__init__.py",
        "twin/devices/lumio/70-ballplate-touch.rules",
        "twin/fmu/c/rig.c",
        *(f"{name}/py.typed" for name in ("ballplate", "twin", "controllers")),
    } <= names
    assert not [
        name
        for name in names
        if name.startswith("src/") or any(part.startswith("test") for part in name.split("/"))
    ]
    data = f"{PROJECT['name']}-{PROJECT['version']}.dist-info"
    assert {name.split("/")[0] for name in names} == {
        "ballplate", "controllers", "scenarios", "twin", data,
    }  # fmt: skip


@pytest.mark.long
def test_the_archive_of_sources_has_nothing_that_no_student_is_handed(wheel, tmp_path):
    call(UV, "build", "--sdist", "--out-dir", tmp_path, ROOT)
    (path,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
        archive.extractall(tmp_path / "out", filter="data")
    labs = [Path(name) for name in names if name.startswith("scenarios/labs/")]
    assert {each.parts[2] for each in labs} == {
        each.name for each in (ROOT / "scenarios" / "labs").iterdir()
    }
    closed = {"mutants", "hidden.toml", "truth.py", "notes.md", "key.txt"}
    assert not [each for each in labs if closed.intersection(each.parts) or each.stem == "solution"]
    assert {"src/twin/lab/judge.py", "scenarios/labs/signs/task.md", "pyproject.toml"} <= set(names)
    (inner,) = (tmp_path / "out").iterdir()
    call(UV, "build", "--wheel", "--out-dir", tmp_path, inner)
    (again,) = tmp_path.glob("*.whl")
    assert zipfile.ZipFile(again).namelist() == zipfile.ZipFile(wheel).namelist()


@pytest.mark.long
def test_installed_into_a_fresh_environment_it_runs_from_any_folder(wheel, tmp_path):
    programs, clean = installed(tmp_path, sys.executable, wheel, "pyyaml", "toolz")
    python = programs / "python"
    anywhere = tmp_path / "anywhere"
    anywhere.mkdir()
    for name in ("controllers", "scenarios", "models", "twin"):
        # strangers of our names, which Python finds first
        (anywhere / name).mkdir()
        (anywhere / name / "__init__.py").write_text(f"raise RuntimeError('a stranger: {name}')")
        (anywhere / name / "circle.toml").write_text("a stranger")
    ballplate = programs / "ballplate"
    listed = call(ballplate, "list", cwd=anywhere, env=clean)
    assert "circle" in listed
    printed = call(
        ballplate, "run", "circle", "--set", "duration=2", "--json", "--out", "runs/circle",
        cwd=anywhere, env=clean,
    )  # fmt: skip
    assert json.loads(printed)["outcome"] == "finished"
    assert (anywhere / "runs" / "circle" / "picture.png").is_file()
    varied = ("--vary", 'controller.kind=["afl", "lqr"]', "--set", "duration=1")
    compared = call(ballplate, "compare", "circle", *varied, "--json", cwd=anywhere, env=clean)
    assert {each["outcome"] for each in json.loads(compared).values()} == {"finished"}
    code = """
import ballplate
print(ballplate.run("hold", duration=0.1).outcome)
print(*ballplate.compare("hold", vary={"seed": [1, 2]}, processes=2, duration=0.1).values())
print(ballplate.systems.linear().state_labels[0])
"""
    said = call(python, "-c", code, cwd=anywhere, env=clean)
    assert said.startswith("finished\n")
    assert said.endswith("x\n")
    where = "import ballplate, controllers, twin; print(controllers.__file__, twin.__file__)"
    for file in call(python, "-c", where, cwd=anywhere, env=clean).split():
        assert Path(file).is_relative_to(programs.parent)


@pytest.mark.long
@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13", "3.14"])
def test_with_every_extra_it_runs_and_draws_on_each_python_that_is_here(wheel, tmp_path, python):
    interpreter = here(python)
    if interpreter is None:
        pytest.skip(f"no Python {python} here")
    extras = ",".join(PROJECT["optional-dependencies"])
    folder, clean = installed(tmp_path, interpreter, f"{wheel}[{extras}]")
    run = ("run", "circle", "--set", "duration=2", "--out", "runs/circle")
    call(folder / "ballplate", *run, cwd=tmp_path, env=clean)
    assert (tmp_path / "runs" / "circle" / "picture.png").is_file()
    library = {
        "cluster": "distributed",
        "fmi": "fmpy",
        "gym": "gymnasium",
        "logs": "asammdf, h5py, nptdms, openpyxl",
        "mpc": "daqp",
    }
    library |= {"play": "nicegui", "tune": "optuna", "video": "av"}
    imports = ", ".join(library.get(each, each) for each in extras.split(","))
    call(folder / "python", "-c", f"import {imports}", cwd=tmp_path, env=clean)


@pytest.mark.long
@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13", "3.14"])
def test_a_runner_of_tools_runs_it_from_the_wheel_alone(wheel, tmp_path, python):
    interpreter = here(python)
    if interpreter is None:
        pytest.skip(f"no Python {python} here")
    tool = (UV, "tool", "run", "--python", interpreter, "--constraints", pins_in(tmp_path))
    run = ("--from", wheel, "ballplate", "run", "circle", "--set", "duration=2", "--json")
    printed = call(*tool, *run, cwd=tmp_path)  # its settings say where packages come from
    assert json.loads(printed)["outcome"] == "finished"
