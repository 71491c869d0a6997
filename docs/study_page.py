"""Writes the page of a study into studies/ of this folder.

python docs/study_page.py NAME
python docs/study_page.py NAME SCREEN SAMPLES     screened, as NAME_screened.md
"""

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from ballplate import study
from docs.pages import HERE, filled
from twin.base.page import Table, Text, markdown
from twin.base.writing import write_whole
from twin.study import report
from twin.study.schema import read
from twin.study.screen_report import blocks


def write(name: str, folder: Path, screen: int | None = None, samples: int | None = None) -> None:
    """Run a study, or what is missing of it, and write its page and figures into a folder.

    Args:
        name: Its name or file.
        folder: Where.
        screen: Points on the exact equations for each on the mechanism; None for none.
        samples: In place of the study's own.
    """
    stem, minutes = Path(name).stem, list[float]()
    if screen is None:
        done = study(name, out=Path("runs") / f"study-{stem}")
    else:
        with TemporaryDirectory() as fresh:  # a kept run would cost nothing
            for times in (None, screen):
                begin = time.process_time()
                done = study(name, out=fresh, screen=times, samples=samples, processes=1)
                minutes.append((time.process_time() - begin) / 60)
        stem += "_screened"
    asked, found = done.work.study, done.answers
    pictures = report.inline_figures(done.work, found)
    for each, picture in pictures.items():
        write_whole(folder / f"{stem}-{each}.svg", picture)
    compared = report.compare_variants(asked, found)
    screened = blocks(asked, done.screened) if done.screened else []
    text = filled(
        "study", title=asked.title, about=report.what_ran(done.work),
        sentences=report.sentences(asked, found), stem=stem,
        study_name=Path(name).stem, screen=screen, asked=samples,
        pictures={each: report.REPORT_WORDS["figures"][each] for each in pictures},
        heading=compared.title, compared=markdown(compared.heads, compared.rows),
        lines=[line for each in screened if isinstance(each, Text) for line in each.lines],
        tables=[(each.title, markdown(each.heads, each.rows))
                for each in screened if isinstance(each, Table)],
        samples=(asked.samples, read(name).samples),
        minutes=[f"{each:.1f}" for each in minutes],
    )  # fmt: skip
    write_whole(folder / f"{stem}.md", text)


if __name__ == "__main__":
    write(sys.argv[1], HERE / "studies", *map(int, sys.argv[2:]))
