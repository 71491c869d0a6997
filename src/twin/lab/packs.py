"""Writes folders of labs: a start for a new one, and packs for students and course systems."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from twin.base.errors import ScenarioError, shorten
from twin.base.page import render_template as rendered
from twin.base.parts import own_version
from twin.base.shipped import folder as shipped
from twin.base.writing import write_folder, write_whole
from twin.lab.handing_out import make_starter, write_notebook
from twin.lab.result_files import LAB_TEMPLATE_FOLDER
from twin.lab.schema import LAB_NAME_PATTERN, PRIVATE_FILES, Lab

KEY_FOLDER = "secret"
"""Folder of the course's key in a pack, closed to others than its owner."""


def begin(name: str, folder: Path, like: Lab | None = None) -> None:
    """Write a lab as a start for a new one: a small one that passes its selftest, or a copy.

    Args:
        name: Its name.
        folder: Where to; must not exist.
        like: The lab to copy whole: solution, mutants, hidden checks and notes, as far as this
            installation has them; never a key.

    Raises:
        TwinError: If no lab can have that name, or it cannot be written.
    """
    if not re.fullmatch(LAB_NAME_PATTERN, name):
        allowed = "lower-case letters, digits, - and _, a letter or digit first, as in friction2"
        raise ScenarioError(f"NAME '{shorten(name)}': must be {allowed}")
    words, start = name.replace("_", " ").capitalize(), shipped() / "starts" / "lab"

    def fill(inner: Path) -> None:
        for file in filter(Path.is_file, start.rglob("*.*")):
            text = file.read_text(encoding="utf-8").replace("NAME", name)
            write_whole(inner / file.relative_to(start), text.replace("TITLE", words))
        write_whole(inner / "answer.py", make_starter((inner / "solution.py").read_text("utf-8")))

    def copy(inner: Path) -> None:
        assert like is not None
        for file in filter(Path.is_file, like.folder.rglob("*")):
            if "__pycache__" not in file.parts and not file.name.endswith("key.txt"):
                content = file.read_bytes()
                if file.suffix in (".md", ".toml", ".py"):
                    content = _rename_in(file, like.name, name).encode()
                write_whole(inner / file.relative_to(like.folder), content)

    write_folder(folder, fill if like is None else copy)


def _rename_in(file: Path, old: str, new: str) -> str:
    """The text of a file of a lab for the lab's copy: its name wherever it is named."""
    text = file.read_text(encoding="utf-8-sig")
    if file.name == "lab.toml":
        text = re.sub(r"(?m)^name\s*=.*$", f'name = "{new}"', text, count=1)
    return re.sub(rf"(ballplate lab \w+ |\bcd |\bLab `){re.escape(old)}\b", rf"\g<1>{new}", text)


def pack(lab: Lab, system: str, out: Path, key: str | None, wheel: Path | None) -> None:
    """Write a lab for a course system.

    Args:
        lab: The lab.
        system: ``folder``, all that students may have; ``gradescope``, a zip file; ``classroom50``,
            a folder for the autograder.
        out: File or folder; must not exist.
        key: The key of the course.
        wheel: Wheel of this program, where it is not to come from a package index.

    Raises:
        TwinError: If something of the lab is missing, or it cannot be written.
    """
    if wheel is not None and not wheel.is_file():
        raise ScenarioError(f"--wheel {wheel}: not found")
    if out.exists():
        raise ScenarioError(f"--out {out}: exists; give a new one")
    if system == "gradescope" and out.suffix != ".zip":
        raise ScenarioError(f"--out {out}: must end in .zip")
    if system != "gradescope":
        write_folder(out, lambda inner: _fill(lab, system, inner, key, wheel))
        return
    with TemporaryDirectory(prefix="ballplate-pack-") as name:
        inner = Path(name) / "zip"
        _fill(lab, system, inner, key, wheel)
        made = Path(shutil.make_archive(str(Path(name) / "made"), "zip", inner))
        write_whole(out, made.read_bytes())


def _fill(lab: Lab, system: str, inner: Path, key: str | None, wheel: Path | None) -> None:
    """Write the lab and the files of a system's templates into a folder."""
    graded = system != "folder"
    wanted = f"/autograder/source/{wheel.name}" if wheel else f"ballplate=={own_version()}"
    closed = {*PRIVATE_FILES, "__pycache__"} - ({"hidden.toml", "truth.py"} if graded else set())
    place = inner / "lab" if graded else inner
    shutil.copytree(lab.folder, place, dirs_exist_ok=True, ignore=shutil.ignore_patterns(*closed))
    check_without_key(place, key)
    if not graded:
        write_notebook(lab, inner, lab.sheet, lab.text(lab.answer.file))
        return
    for template in (LAB_TEMPLATE_FOLDER / system).iterdir():
        made = inner / template.stem
        write_whole(made, rendered(template, lab=lab, key=key, requirement=wanted))
        made.chmod(0o755)
    if key:  # in a folder of its own, from which no answer is copied
        write_whole(inner / KEY_FOLDER / "key.txt", key)
        (inner / KEY_FOLDER / "key.txt").chmod(0o600)
        (inner / KEY_FOLDER).chmod(0o700)
    if wheel:
        shutil.copy(wheel, inner)


def check_without_key(folder: Path, key: str | None) -> None:
    """Make sure that the key is in no file of a lab that is exported.

    Raises:
        ScenarioError: If it is in one.
    """
    for file in filter(Path.is_file, folder.rglob("*")):
        if key and key.encode() in file.read_bytes():
            name = file.relative_to(folder)
            raise ScenarioError(
                f"{name}: contains the course's key; move it out of the lab's folder"
            )
