"""A lab as a course system takes it: for Gradescope, for Classroom 50, or a folder for students."""

from __future__ import annotations

import json
import re
import shutil
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from twin.errors import ScenarioError
from twin.lab.schema import PRIVATE, Lab
from twin.lab.variants import text_of
from twin.writing import write_folder, write_whole

TEMPLATES = Path(__file__).with_name("templates")


def pack(lab: Lab, system: str, out: Path, key: str | None, wheel: Path | None) -> None:
    """Write a lab as a course system takes it.

    Args:
        lab: The lab.
        system: ``folder``, all that students may have; ``gradescope``, a zip file; ``classroom50``,
            a folder for the autograder.
        out: File or folder; must not exist.
        key: The course's.
        wheel: Of this program, where it is not to come from a package index.

    Raises:
        TwinError: If something of the lab is missing, or it cannot be written.
    """
    if wheel is not None and not wheel.is_file():
        raise ScenarioError(f"--wheel {wheel}: not found")
    if out.exists():
        raise ScenarioError(f"--out {out}: exists; name a new one")
    if system != "gradescope":
        write_folder(out, lambda inner: _fill(lab, system, inner, key, wheel))
        return
    with TemporaryDirectory(prefix="ballplate-pack-") as name:
        inner = Path(name) / "zip"
        _fill(lab, system, inner, key, wheel)
        made = Path(shutil.make_archive(str(Path(name) / "made"), "zip", inner))
        write_whole(out, made.read_bytes())


def _fill(lab: Lab, system: str, inner: Path, key: str | None, wheel: Path | None) -> None:
    """Put what a system wants into a folder."""
    closed = {*PRIVATE, "__pycache__"} - (
        set() if system == "folder" else {"hidden.toml", "truth.py"}
    )
    place = inner if system == "folder" else inner / "lab"
    shutil.copytree(lab.folder, place, dirs_exist_ok=True, ignore=shutil.ignore_patterns(*closed))
    if system == "folder":
        write_whole(inner / f"{lab.about.name}.ipynb", notebook(lab))
        return
    where = f"/autograder/source/{wheel.name}" if wheel else f"ballplate=={version('ballplate')}"
    said = {"@REQUIREMENT@": where, "@KEY@": " --key key.txt" if key else ""}
    names = ("setup.sh", "run_autograder") if system == "gradescope" else ("autograder.txt",)
    for name in names:
        text = (TEMPLATES / name).read_text(encoding="utf-8")
        for word, meant in said.items():
            text = text.replace(word, meant)
        made = inner / name.replace(".txt", ".py")
        write_whole(made, text)
        made.chmod(0o755)
    if key:
        write_whole(inner / "key.txt", key)
    if wheel:
        shutil.copy(wheel, inner)


def notebook(lab: Lab) -> str:
    """A lab as a notebook: its sheet, the starter in a cell that writes it, and the check."""
    file = lab.about.answer.file
    texts = [("markdown", each) for each in re.split(r"(?m)^(?=## )", text_of(lab, "task.md"))]
    texts.append(("code", f"%%writefile {file}\n{text_of(lab, file)}"))
    texts.append(("code", f'import ballplate as bp\n\nbp.lab.check("{lab.about.name}")'))
    cells = []
    for number, (kind, text) in enumerate(texts):
        cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}}
        if kind == "code":
            cell |= {"execution_count": None, "outputs": []}
        cells.append(cell | {"source": text.strip().splitlines(keepends=True)})
    about = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    whole = {"cells": cells, "metadata": about, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"
