"""Writes the page of a study into studies/ of this folder: python docs/study_page.py NAME."""

import sys
from pathlib import Path

from ballplate import study
from docs.pages import HERE, filled
from twin.base.page import markdown
from twin.base.writing import write_whole
from twin.study import report


def write(name: str, folder: Path) -> None:
    """Run a study, or what is missing of it, and write its page and figures into a folder."""
    stem = Path(name).stem
    done = study(name, out=Path("runs") / f"study-{stem}")
    asked, found = done.work.study, done.answers
    pictures = report.inline_figures(done.work, found)
    for each, picture in pictures.items():
        write_whole(folder / f"{stem}-{each}.svg", picture)
    compared = report.compare_variants(asked, found)
    text = filled(
        "study", title=asked.title, about=report.what_ran(done.work),
        sentences=report.sentences(asked, found), stem=stem,
        pictures={each: report.REPORT_WORDS["figures"][each] for each in pictures},
        heading=compared.title, compared=markdown(compared.heads, compared.rows),
    )  # fmt: skip
    write_whole(folder / f"{stem}.md", text)


if __name__ == "__main__":
    write(sys.argv[1], HERE / "studies")
