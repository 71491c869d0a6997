"""`twin.base.parts`: a package that is missing is named by what imports it, and how to get it."""

import ast
import itertools
import json
import sys
from importlib.machinery import PathFinder
from importlib.metadata import packages_distributions
from importlib.util import find_spec

import pytest
from fresh_environment import PROJECT, ROOT, SETTINGS

import ballplate
from release.build import name_of
from twin.base import parts
from twin.cli import main

MODULES = [(part, module) for part, its in parts.PARTS.items() for module in its.modules]
OWN_PICTURE_MAKERS = ("twin.run.picture",)


class Without:
    """Finds what is installed but for the modules of all parts."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {module for _, module in MODULES}:
            return None
        return PathFinder.find_spec(name, path, target)


@pytest.fixture
def core(monkeypatch, tmp_path):
    """This process as one of an installation without any part."""
    finders = [Without if each is PathFinder else each for each in sys.meta_path]
    assert Without in finders
    monkeypatch.setattr(sys, "meta_path", finders)
    hidden = {module for _, module in MODULES}
    for name in [*sys.modules]:
        if name.partition(".")[0] in hidden or name in OWN_PICTURE_MAKERS:
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(parts, "own_distribution", lambda: "ballplate-core")
    monkeypatch.setattr("twin.run.finished.own_version", lambda: "1")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize(("part", "module"), MODULES)
def test_a_module_of_ours_that_imports_a_missing_package_names_the_extra(part, module):
    with pytest.raises(ballplate.TwinError) as caught:
        exec(f"import {module}.some.thing", {"__name__": "twin.run.anything"})
    assert isinstance(caught.value, ModuleNotFoundError)
    assert str(caught.value).startswith(f"needs {module}, for ")
    assert str(caught.value).endswith(f": pip install 'ballplate-core[{part}]'")


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize(("part", "module"), MODULES)
def test_other_programs_find_it_missing_in_the_ordinary_way(part, module):
    del part
    assert find_spec(module) is None
    for name in ("numpy.anything", "twins", "__main__"):
        with pytest.raises(ModuleNotFoundError, match="No module named") as caught:
            exec(f"import {module}", {"__name__": name})
        assert not isinstance(caught.value, ballplate.TwinError)


@pytest.mark.usefixtures("core")
def test_a_whole_installation_that_lost_a_package_is_completed(monkeypatch):
    monkeypatch.setattr(parts, "own_distribution", lambda: "ballplate")
    with pytest.raises(ballplate.TwinError, match=r": pip install ballplate$"):
        exec("import pandas", {"__name__": "ballplate"})


@pytest.mark.usefixtures("core")
def test_a_run_leaves_out_what_it_cannot_write_and_no_file_of_an_earlier_one(tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    for name in ("run.parquet", "picture.png"):
        (folder / name).write_text("of an earlier run")
    done = ballplate.run("hold", ["plant.kind=lagrange"], duration=0.1)
    with pytest.warns(UserWarning, match="not written: needs") as caught:
        done.save(folder)
    told = [str(each.message).partition(",")[0] for each in caught]
    assert told == [
        "run.parquet: not written: needs pyarrow",
        "picture.png: not written: needs matplotlib",
    ]
    assert [each.name for each in folder.iterdir()] == ["metrics.json"]
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["rms_error"] == done.metrics["rms_error"]


@pytest.mark.usefixtures("core")
def test_a_command_says_in_one_line_what_it_needs(tmp_path, capsys):
    (tmp_path / "run.parquet").write_text("of a whole installation")
    with pytest.raises(SystemExit) as ended:
        main(["report", str(tmp_path)])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("ballplate: needs pyarrow, for records")


def imported(file):
    """Top-level modules that a source file imports."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (each.name.partition(".")[0] for each in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]


BROUGHT_ALONG = {"pydantic_core", "fastapi", "uvicorn", "starlette", "dask"}
"""Modules of packages that pydantic, nicegui and distributed require."""
BROUGHT_BY_USERS = {"acados_template", "do_mpc"}
"""Modules that only users of these programs need: they are the makers of a problem for them."""


def normalized(name):
    return name.lower().replace("_", "-")


@pytest.mark.long
def test_every_package_that_the_code_imports_is_required_of_a_part_or_of_an_extra():
    listed = SETTINGS["tool"]["ballplate-core"]["parts"]
    assert listed.keys() == parts.PARTS.keys()
    owners = {name: {*map(normalized, its)} for name, its in packages_distributions().items()}
    for part, its in parts.PARTS.items():
        for module in its.modules:
            assert owners[module] <= {*listed[part]}, module
    extras = itertools.chain(*PROJECT["optional-dependencies"].values())
    required = {normalized(name_of(each)) for each in (*PROJECT["dependencies"], *extras)}
    left_out = {name for names in listed.values() for name in names}
    known = {name for name, its in owners.items() if its & (required - left_out)}
    known |= {module for its in parts.PARTS.values() for module in its.modules}
    known |= {*sys.stdlib_module_names, "ballplate", "twin", "controllers"}
    known |= BROUGHT_ALONG | BROUGHT_BY_USERS
    code = [*(ROOT / "src").rglob("*.py"), *(ROOT / "controllers").rglob("*.py")]
    found = {(name, str(file.relative_to(ROOT))) for file in code for name in imported(file)}
    assert {each for each in found if each[0] not in known} == set()
