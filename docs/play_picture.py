"""Regenerates the picture of the page that `ballplate play` serves: python docs/play_picture.py.

Needs Chromium at /usr/bin/chromium (Debian: apt-get install chromium) and half a minute.
"""

import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import FloatRect, Locator, Page, sync_playwright

HERE = Path(__file__).parent
CHROMIUM = "/usr/bin/chromium"
CALL = (sys.executable, "-m", "twin", "play", "circle")
OPTIONS = ("--port", "0", "--no-browser", "--seconds", "300")
PATIENCE = 60_000
"""Longest time in ms for anything."""
PLATE = "svg[data-time]"
PASSED = f"at => Number(document.querySelector('{PLATE}')?.dataset.time) >= at"


def main() -> None:
    """Drive the circle's rig for some seconds as a person does, and take the picture."""
    with (
        TemporaryDirectory() as folder,
        subprocess.Popen(
            [*CALL, *OPTIONS, "--out", f"{folder}/run"], stdout=subprocess.PIPE, text=True
        ) as command,
    ):
        try:
            assert command.stdout is not None
            url = re.search(r"http://\S+", command.stdout.readline())
            assert url is not None
            with sync_playwright() as engine:
                browser = engine.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
                page = browser.new_page(viewport={"width": 1360, "height": 900})
                page.set_default_timeout(PATIENCE)
                page.goto(url[0])
                drive(page)
                page.screenshot(path=HERE / "play.png")
                browser.close()
        finally:
            command.terminate()


def drive(page: Page) -> None:
    """Move the goal twice, raise friction, push the ball."""
    page.wait_for_function(PASSED, arg=5.0)
    drag(page, (-60, 60), (-150, -50))
    friction = page.get_by_test_id("plant.friction.rolling_mm")
    page.wait_for_function(PASSED, arg=9.0)
    friction.click(position={"x": box_of(friction)["width"] * 0.6, "y": 5})
    drag(page, (-150, -50), (150, 70))
    page.wait_for_function(PASSED, arg=13.5)
    page.get_by_test_id("pause").click()
    plate = page.locator(PLATE)
    x, y = (1000 * number_of(plate, f"data-{axis}") for axis in "xy")
    page.get_by_test_id("pause").click()
    drag(page, (x, y), (x - 30, y - 40), steps=3)
    page.wait_for_function(PASSED, arg=number_of(plate, "data-time") + 0.6)
    page.mouse.move(5, 5)


def box_of(element: Locator) -> FloatRect:
    """Where an element is on the page, pixels."""
    found = element.bounding_box()
    assert found is not None, "not visible"
    return found


def number_of(element: Locator, attribute: str) -> float:
    """An attribute of an element as a number."""
    found = element.get_attribute(attribute)
    assert found is not None, attribute
    return float(found)


def drag(page: Page, begin: tuple[float, float], end: tuple[float, float], steps: int = 20) -> None:
    """Drag from one place of the plate, mm, to another."""
    box = box_of(page.locator(PLATE))
    scale = min(box["width"] / 708, box["height"] / 403)
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for step in range(steps + 1):
        x, y = (a + step / steps * (b - a) for a, b in zip(begin, end, strict=True))
        page.mouse.move(middle[0] + scale * x, middle[1] - scale * y)
        if step == 0:
            page.mouse.down()
        page.wait_for_timeout(30)
    page.mouse.up()


if __name__ == "__main__":
    main()
