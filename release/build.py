"""Builds the files of a release: archive of sources and wheel of ballplate and of ballplate-core.

uv run python -m release.build [FOLDER]

Both distributions have the same sources. The core is built of the archive of the other one, with
the requirements that ``[tool.ballplate-core]`` in pyproject.toml leaves it. The same commit gives
the same bytes wherever it is built: it is what is built, and its time is that of all files.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
CHECK = ("uvx", "twine==7.0.0", "check", "--strict")
"""Checks what an index would refuse, without sending anything."""


def core_project(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The table ``[project]`` of ballplate-core.

    Args:
        settings: Content of pyproject.toml.

    Raises:
        KeyError: If a part names no requirement of ballplate.
    """
    project, core = settings["project"], settings["tool"]["ballplate-core"]
    required = {name_of(each): each for each in project["dependencies"]}
    parts = {part: [required[name] for name in names] for part, names in core["parts"].items()}
    optional = {name for names in core["parts"].values() for name in names}
    kept = [each for name, each in required.items() if name not in optional]
    return {
        **project,
        "name": "ballplate-core",
        "description": core["description"],
        "dependencies": [core["replaced"].get(name_of(each), each) for each in kept],
        "optional-dependencies": {**parts, **project["optional-dependencies"]},
    }


def name_of(requirement: str) -> str:
    """The name that a requirement begins with."""
    found = re.match(r"[\w.-]+", requirement)
    assert found is not None, requirement
    return found[0]


def as_core(text: str) -> str:
    """The text of pyproject.toml as it is in the archive of ballplate-core.

    Raises:
        ValueError: If the text has a different form, so that the table would not be that of
            ``core_project``.
    """
    wanted = core_project(tomllib.loads(text))
    for key in ("name", "description"):
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {quoted(wanted[key])}", text, count=1)
    listed = "".join(f"  {quoted(each)},\n" for each in wanted["dependencies"])
    text = re.sub(r"(?ms)^dependencies = \[\n.*?^\]", f"dependencies = [\n{listed}]", text, count=1)
    extras = "".join(
        f"{name} = [{', '.join(map(quoted, each))}]\n"
        for name, each in wanted["optional-dependencies"].items()
    )
    head = "[project.optional-dependencies]\n"
    text = re.sub(rf"(?ms)^{re.escape(head)}.*?(?=^\[)", f"{head}{extras}\n", text, count=1)
    if tomllib.loads(text)["project"] != wanted:
        raise ValueError("pyproject.toml: its tables of the project have a form that is not known")
    return text


def quoted(text: str) -> str:
    """A text as a string of TOML, without escapes.

    Raises:
        ValueError: If it needs some.
    """
    if '"' in text or "\\" in text:
        raise ValueError(f"pyproject.toml: {text}: has a quote or a backslash")
    return f'"{text}"'


def build(folder: Path, source: Path) -> Iterator[Path]:
    """Build the four files of a release into a folder.

    Args:
        folder: Where; files of these names that are there are replaced.
        source: Folder of sources; any file of the packages and tests in it is part of the release.

    Raises:
        CalledProcessError: If a build fails.
    """
    with tempfile.TemporaryDirectory(prefix="ballplate-release-") as name:
        whole, core = Path(name) / "whole", Path(name) / "core"
        _uv_build(source, whole)
        (archive,) = whole.glob("*.tar.gz")
        with tarfile.open(archive) as packed:
            packed.extractall(core, filter="data")
        (unpacked,) = core.iterdir()
        project = unpacked / "pyproject.toml"
        project.write_text(as_core(project.read_text(encoding="utf-8")), encoding="utf-8")
        (unpacked / "PKG-INFO").unlink()
        _uv_build(unpacked, whole)
        folder.mkdir(parents=True, exist_ok=True)
        for each in sorted([*whole.glob("*.tar.gz"), *whole.glob("*.whl")]):
            yield Path(each.replace(folder / each.name))


def _uv_build(source: Path, folder: Path) -> None:
    """Build archive and wheel, the wheel of the archive, as those who install it do."""
    subprocess.run(["uv", "build", "--quiet", "--out-dir", folder, source], check=True)


def export_commit(folder: Path) -> str:
    """Write the files of the newest commit into a folder, and nothing else that lies here.

    Returns:
        The time of the commit, in seconds since 1970.

    Raises:
        SystemExit: If a file differs from the commit.
    """
    if changed := _git("status", "--porcelain", "--untracked-files=no"):
        sys.exit(f"release: not committed: {', '.join(changed.split()[1::2])}")
    archive = folder.with_suffix(".tar")
    _git("archive", "--output", str(archive), "HEAD")
    with tarfile.open(archive) as packed:
        packed.extractall(folder, filter="data")
    return _git("log", "-1", "--format=%ct")


def _git(*arguments: str) -> str:
    command = ["git", *arguments]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout.strip()


def main() -> None:
    """Build the newest commit, check the files and list them."""
    with tempfile.TemporaryDirectory(prefix="ballplate-release-") as name:
        source = Path(name) / "source"
        os.environ["SOURCE_DATE_EPOCH"] = export_commit(source)
        made = list(build(Path(sys.argv[1] if len(sys.argv) > 1 else "dist"), source))
    subprocess.run([*CHECK, *made], check=True)
    for each in made:
        print(f"{hashlib.sha256(each.read_bytes()).hexdigest()}  {each}")


if __name__ == "__main__":
    main()
