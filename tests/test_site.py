"""`docs.build`.

The site of the pages: its menu, and how it looks in a browser as wide as a telephone."""

import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from docs import build

CHROMIUM = Path("/usr/bin/chromium")
MADE_BY_SPHINX = {"search.html", "genindex.html", "py-modindex.html"}
INDEX = (build.HERE / "index.md").read_text(encoding="utf-8")


def test_the_menu_has_eight_entries_each_a_page_of_a_list():
    pages = build.sections(INDEX)
    menu = pages["index.md"].partition("```{toctree}")[2]
    entries = [line for line in menu.splitlines() if line.endswith(">")]
    assert len(entries) == 8
    assert "Teach a class <teach-a-class.md>" in entries
    assert "(labs.md)" in pages["teach-a-class.md"]
    assert build.sections("# A\n\n## B\n\n- [C](c.md)\n").keys() == {"index.md"}
    assert "[Every command](reference-commands.md)" in pages["reference.md"]


def test_the_start_page_has_two_films_two_commands_and_six_doors_and_no_list():
    start = build.sections(INDEX)["index.md"]
    assert start.count("(circle.webp)") == start.count("(mechanism.webp)") == 1
    assert sum(" ballplate " in line for line in start.splitlines()) == 2
    assert start.count("- **[") == start.count("](") - 2 == 6
    assert "\n## " not in start


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    subprocess.run([sys.executable, build.__file__, out], check=True)
    return out


OUTSIDE = """() => [...document.querySelectorAll("article td")]
  .filter(cell => cell.getBoundingClientRect().right > window.innerWidth).length"""


@pytest.mark.long
@pytest.mark.skipif(not CHROMIUM.exists(), reason="needs chromium (Debian: chromium)")
def test_no_page_is_wider_than_a_telephone_and_every_cell_of_its_tables_is_seen(site):
    pages = [each for each in site.rglob("*.html") if each.name not in MADE_BY_SPHINX]
    assert len(pages) > 60
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--headless", "--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 400, "height": 900})
        for each in pages:
            page.goto(each.as_uri())
            assert page.evaluate("document.documentElement.scrollWidth") <= 400, each.name
            assert page.evaluate(OUTSIDE) == 0, each.name
        page.set_viewport_size({"width": 1400, "height": 900})
        page.goto((site / "settings.html").as_uri())
        assert page.locator("table.cards").count() == 0
        assert page.locator(".toctree-l1").count() == 8
        browser.close()
