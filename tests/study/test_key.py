"""`twin.study.work`.

A finished run is used again if and only if nothing that it executes has changed."""

import grimp
import pytest

from twin.study import work
from twin.study.schema import Study


@pytest.fixture
def key(monkeypatch):
    """The key of the code, as if some files or library versions were others."""

    def of(changed=None, version=None):
        with monkeypatch.context() as patch:
            if changed is not None:
                read = type(changed).read_bytes
                patch.setattr(
                    type(changed),
                    "read_bytes",
                    lambda path: read(path) + b"#" if path == changed else read(path),
                )
            if version is not None:
                known = work.version
                patch.setattr(work, "version", lambda name: "9" if name == version else known(name))
            return work.code.__wrapped__()

    return of


def source(*parts):
    return work.Path(str(work.files("twin"))).joinpath(*parts)


def test_the_same_code_has_the_same_key(key):
    work.code.cache_clear()  # a test before may have had laws of its own
    assert key() == key() == work.code()


@pytest.mark.parametrize("parts", [("run", "record.py"), ("base", "settings.py")], ids="/".join)
def test_what_a_run_executes_is_in_the_key(key, parts):
    assert source(*parts).is_file()
    assert key(changed=source(*parts)) != key()


@pytest.mark.parametrize("library", ["mujoco-core", "numpy", "scipy", "control"])
def test_the_versions_of_what_it_calculates_with_are_in_the_key(key, library):
    assert key(version=library) != key()


@pytest.mark.parametrize(
    "parts",
    [
        ("devices", "akd", "config.py"),
        ("view", "streams.py"),
        ("run", "picture.py"),
        ("scenario", "describe.py"),
        ("study", "report.py"),
    ],
    ids="/".join,
)
def test_what_a_simulated_run_never_sees_is_not(key, parts):
    assert source(*parts).is_file()
    assert key(changed=source(*parts)) == key()


BESIDE = {
    "base/data_file",
    "base/errors",
    "base/foreign",
    "base/parts",
    "base/programs",
    "base/shipped",
    "base/validation",
    "base/writing",
    "installation",
    "run/exporters",
    "run/files",
    "scenario/__init__",
    "scenario/describe",
}
"""Modules of ``twin`` that find, read, refuse and write files, and words of comments."""


def test_all_that_a_run_imports_is_in_the_key_but_what_reads_its_files():
    imported = grimp.build_graph(
        "ballplate", "twin", "controllers", cache_dir=None
    ).find_upstream_modules("twin.run.loop")
    files = {source(*name.split(".")[1:]) for name in imported if name.startswith("twin.")}
    files = {path / "__init__" if path.is_dir() else path for path in files}
    known = {path.with_suffix("") for path in work.sources() if path.suffix == ".py"}
    assert files - known == {source(name) for name in BESIDE}


def test_a_run_of_other_code_is_another_run(monkeypatch):
    about = {"title": "code", "scenario": "circle", "method": "grid"}
    about["parameters"] = {"plant.friction.rolling_mm": {"values": [0.1]}}
    keys = []
    for code in ("one", "other"):
        monkeypatch.setattr(work, "code", lambda code=code: code)
        keys.append(work.Work(Study.model_validate(about)).tasks[0].key)
    assert keys[0] != keys[1]
