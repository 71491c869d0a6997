"""Writes the page of a study into studies/ of this folder: python docs/study_page.py NAME."""

import sys
from pathlib import Path

from ballplate import study
from twin.study.report import document


def write(name: str, folder: Path) -> None:
    """Run a study, or what is missing of it, and write its page and figures into a folder."""
    done = study(name, out=Path("runs") / f"study-{Path(name).stem}")
    document(done.work, done.answers, folder / f"{Path(name).stem}.md")


if __name__ == "__main__":
    write(sys.argv[1], Path(__file__).parent / "studies")
