"""`twin.play`.

The page in a real browser without a window: dragging, clicking, looking on, and who is refused.

Needs Chromium at /usr/bin/chromium (Debian: apt-get install chromium); without it these fail.
"""

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import numpy as np
import psutil
import pytest
from playwright.sync_api import expect, sync_playwright

from docs.play_picture import drag
from twin.run.opened import open_run
from twin.whatif.futures import moment_of

CHROMIUM = Path("/usr/bin/chromium")
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
CALL = (sys.executable, "-c", "from twin.cli import main; main()", "play")
PATIENCE = 60.0
"""Seconds that a busy machine is given for what takes one or two."""

pytestmark = [pytest.mark.long, pytest.mark.real_time]


class Played:
    """A running command, its address, and all that it has printed."""

    def __init__(self, process):
        self.process, self.lines = process, []
        self._reader = Thread(target=self._read)
        self._reader.start()
        last = time.monotonic() + PATIENCE
        while not (found := re.search(r"http://\S+", "".join(self.lines))):
            assert process.poll() is None, self.lines
            assert time.monotonic() < last, self.lines
            time.sleep(0.05)
        self.url = found[0]

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(line)

    def ended(self):
        """Its exit code, once it has ended and all that it printed is read."""
        code = self.process.wait(PATIENCE)
        self._reader.join()
        return code


@contextmanager
def playing(*arguments):
    env = {name: text for name, text in os.environ.items() if not name.startswith("PYTEST")}
    process = subprocess.Popen(
        [*CALL, *arguments, "--port", "0", "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=env,
    )
    with process:
        played = Played(process)
        try:
            yield played
        finally:
            process.terminate()
            played.ended()


@pytest.fixture(scope="module")
def browser():
    """Opens browsers of their own, each with nothing in its profile."""
    assert CHROMIUM.exists(), "no Chromium: apt-get install chromium"
    with sync_playwright() as engine:
        opened = []

        def open_one(folder, url):
            one = engine.chromium.launch_persistent_context(
                folder,
                executable_path=CHROMIUM,
                args=QUIET,
                headless=True,
                viewport={"width": 1360, "height": 900},
            )
            opened.append(one)
            page = one.new_page()
            page.asked, page.wrong = [], []
            page.on("request", lambda request: page.asked.append(request.url))
            page.on("websocket", lambda socket: page.asked.append(socket.url))
            page.on("pageerror", lambda error: page.wrong.append(str(error)))
            page.goto(url)
            page.wait_for_selector("svg[data-time]", timeout=1000 * PATIENCE)
            return page

        yield open_one
        for one in opened:
            one.close()


def read_number(page, name):
    """A number that the plate shows."""
    return float(page.locator("svg[data-time]").get_attribute(f"data-{name}"))


SIDES = """() => ["x", "y"].map((axis) => {
    const view = document.querySelector(`[data-testid=side-${axis}]`);
    const told = [...view.querySelectorAll("text")].find((each) => each.textContent.includes("°"));
    return [told.textContent, view.querySelector("g[transform^=rotate]").getAttribute("transform")];
})"""


def sides(page):
    """The time that is shown, and for each side view what it tells and turns by, both in deg."""
    time.sleep(0.1)
    found = [
        [float(re.search(r"-?\d+\.\d+", text)[0]) for text in each] for each in page.evaluate(SIDES)
    ]
    return read_number(page, "time"), dict(zip("xy", found, strict=True))


def until(condition):
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def later(page, seconds, condition=lambda: False):
    """Wait until something holds, at most so many simulated seconds; whether it does.

    A busy machine may take as long as it likes for them, if only they go on.
    """
    end = read_number(page, "time") + seconds
    while not (held := condition()) and (now := read_number(page, "time")) < end:
        until(lambda now=now: read_number(page, "time") > now)
    return held


def test_a_person_drives_the_rig(browser, tmp_path):
    folder = tmp_path / "run"
    with playing("circle", "--out", str(folder)) as played:
        page = browser(tmp_path / "one", played.url)
        expect(page.get_by_text("you drive")).to_be_visible(timeout=1000 * PATIENCE)
        later(page, 2.0)

        drag(page, (-100, -60), (120, 60))
        until(lambda: abs(read_number(page, "goal-x") - 0.12) < 0.002)
        assert read_number(page, "goal-y") == pytest.approx(0.06, abs=0.002)
        tilts = [sides(page) for _ in range(15)]
        assert later(page, 10.0, lambda: abs(read_number(page, "x") - 0.12) < 0.04)

        friction = page.get_by_test_id("plant.friction.rolling_mm")
        friction.click(position={"x": friction.bounding_box()["width"] * 0.8, "y": 5})
        page.get_by_test_id("controller.kind").click()
        page.get_by_role("option", name="lqr").click()
        expect(page.get_by_text("kappa")).to_be_visible(timeout=1000 * PATIENCE)

        page.get_by_test_id("pause").click()
        expect(page.get_by_test_id("pause")).to_contain_text("Go on")
        time.sleep(0.5)
        stood = read_number(page, "time")
        time.sleep(1.0)
        assert read_number(page, "time") == stood
        page.get_by_test_id("save").click()
        expect(page.get_by_text(f"saved as {folder}/")).to_be_visible(timeout=1000 * PATIENCE)

        page.get_by_test_id("back").click()
        until(lambda: read_number(page, "time") <= stood - 1.0 + 1e-6)
        page.get_by_test_id("pause").click()
        later(page, 1.5)
        drag(page, (1000 * read_number(page, "x"), 1000 * read_number(page, "y")), (0, 0), steps=5)
        expect(page.get_by_text("pushed by")).to_be_visible(timeout=1000 * PATIENCE)

        assert {re.match(r"\w+://([\d.]+):", url)[1] for url in page.asked} == {"127.0.0.1"}
        assert page.wrong == []
        page.context.close()
        assert played.ended() == 0
        assert played.lines[1:] == [f"ended without saving, so saved as {folder}~2/\n"]

    assert open_run(tmp_path / "run~2")[0].driven["pushes"]  # after the first was saved
    (run,) = open_run(folder)
    assert run.driven["goals"] > 3
    assert run.scenario.change[-1].set["plant.friction.rolling_mm"] == pytest.approx(0.4, abs=0.02)
    assert run.scenario.controller.kind == "lqr"
    end = float(run.rows["time"][-1])
    assert end == pytest.approx(stood, abs=0.05)
    assert not moment_of(folder, end - 0.1).exact  # another law was chosen
    assert max(np.ptp([tilt[axis][0] for _, tilt in tilts]) for axis in "xy") > 0.5
    for time_shown, tilt in tilts:  # a picture or two apart
        near = np.abs(run.rows["time"] - time_shown) < 0.15
        # positive phi lowers the end at +x, positive theta lifts the one at +y
        for axis, name, sense in (("x", "phi", 1), ("y", "theta", -1)):
            told, clockwise = tilt[axis]
            real = np.degrees(run.rows[f"true_{name}"][near])
            assert real.min() - 0.06 < told < real.max() + 0.06
            assert clockwise == pytest.approx(4 * sense * told, abs=0.25)


@pytest.mark.parametrize("width", [420, 1024])
def test_all_is_reached_on_a_narrow_window(browser, tmp_path, width):
    with playing("circle", "--out", str(tmp_path / "run")) as played:
        page = browser(tmp_path / "one", played.url)
        page.set_viewport_size({"width": width, "height": 900})
        expect(page.get_by_test_id("error")).to_contain_text("RMS so far", timeout=1000 * PATIENCE)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        plate = page.locator("svg[data-time]").bounding_box()
        assert plate["width"] > 0.8 * min(width, 450)
        for each in ("pause", "save", "plant.friction.rolling_mm", "controller.kind"):
            box = page.get_by_test_id(each).bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width
        page.context.close()
        assert played.ended() == 0
        assert len(played.lines) == 1, played.lines  # nothing was done, so nothing is kept


BRIGHTNESS = """() => [...document.querySelectorAll("body, .q-card")].map((each) => {
    const shades = getComputedStyle(each).backgroundColor.match(/\\d+/g).map(Number);
    return (shades[0] + shades[1] + shades[2]) / 3;
})"""
DRAWN = """() => [...document.querySelectorAll("svg[data-time], svg[data-testid], canvas")].map(
    (each) => getComputedStyle(each).filter)"""


def test_the_page_is_as_dark_as_the_browser_asks_for(browser, tmp_path):
    with playing("circle", "--out", str(tmp_path / "run")) as played:
        page = browser(tmp_path / "one", played.url)
        page.emulate_media(color_scheme="dark")
        until(lambda: max(page.evaluate(BRIGHTNESS)) < 40)
        drawn = page.evaluate(DRAWN)
        assert len(drawn) == 4
        assert all(each.startswith("invert(0.9)") for each in drawn)
        page.emulate_media(color_scheme="light")
        until(lambda: min(page.evaluate(BRIGHTNESS)) > 230)
        assert set(page.evaluate(DRAWN)) == {"none"}


def test_one_drives_and_the_other_looks_until_the_first_has_gone(browser, tmp_path):
    with playing("hold", "--out", str(tmp_path / "run")) as played:
        first = browser(tmp_path / "one", played.url)
        expect(first.get_by_text("you drive")).to_be_visible(timeout=1000 * PATIENCE)
        second = browser(tmp_path / "two", played.url)
        expect(second.get_by_text("another browser drives")).to_be_visible(timeout=1000 * PATIENCE)
        drag(second, (50, 50), (120, 60), steps=5)
        time.sleep(1.0)
        assert read_number(first, "goal-x") == 0.0
        first.context.close()
        expect(second.get_by_text("you drive")).to_be_visible(timeout=1000 * PATIENCE)
        drag(second, (50, 50), (120, 60), steps=5)
        until(lambda: abs(read_number(second, "goal-x") - 0.12) < 0.002)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_in_order_when_it_is_told_to(number, tmp_path):
    with playing("hold", "--out", str(tmp_path / "run")) as played:
        played.process.send_signal(number)
        assert played.ended() == 0
        assert len(played.lines) == 1, played.lines


def test_it_ends_by_itself_when_its_time_is_up(tmp_path):
    with playing("hold", "--seconds", "1", "--out", str(tmp_path / "run")) as played:
        assert played.ended() == 0


def test_a_simulation_that_dies_is_one_line_and_exit_code_1(tmp_path):
    with playing("hold", "--out", str(tmp_path / "run")) as played:
        children = psutil.Process(played.process.pid).children()
        max(children, key=lambda each: sum(each.cpu_times()[:2])).kill()
        assert played.ended() == 1
        # what follows is Python's own: semaphores of a process that was killed are taken back
        assert played.lines[1] == (
            "ballplate: the simulation's process was ended; "
            "what was driven since it was last saved is lost\n"
        )
        assert "Traceback" not in "".join(played.lines)


def answer(url):
    """The status of an answer."""
    try:
        with urllib.request.urlopen(url) as response:
            return response.status
    except urllib.error.HTTPError as error:
        return error.code


def test_the_page_needs_its_token_on_this_machine_too(tmp_path):
    with playing("hold", "--out", str(tmp_path / "run")) as played:
        bare, _, token = played.url.partition("?token=")
        assert len(token) >= 20
        assert (answer(played.url), answer(bare)) == (200, 403)


NO_EVENTS = (
    None,
    1,
    "x",
    [],
    {},
    {"id": {}, "args": 1},
    {"id": 5, "listener_id": "no", "args": ["{"]},
)


def test_what_is_sent_and_is_no_event_costs_lines_and_no_stack_of_calls(tmp_path):
    socketio = pytest.importorskip("socketio")

    async def send(base, token, client):
        sender = socketio.AsyncClient()
        query = f"token={token}&client_id={client}&implicit_handshake=true&next_message_id=0"
        await sender.connect(
            f"{base}?{query}&document_id=d&tab_id=t&old_tab_id=",
            headers={"Cookie": f"ballplate_token={token}"},
            socketio_path="/_nicegui_ws/socket.io",
            transports=["websocket"],
        )
        for event in ("event", "javascript_response", "handshake", "ack", "log_message", "none"):
            for given in NO_EVENTS:
                more = {"client_id": client} if isinstance(given, dict) and given else {}
                await sender.emit(event, {**given, **more} if more else given)
        await asyncio.sleep(1.0)
        await sender.disconnect()

    with playing("hold", "--out", str(tmp_path / "run")) as played:
        base, _, token = played.url.partition("?token=")
        with urllib.request.urlopen(played.url) as response:
            page = response.read().decode()
        client = re.search(r"'client_id':\s*'([^']+)'|\"client_id\":\s*\"([^\"]+)\"", page)
        sent = send(base, token, next(filter(None, client.groups())))
        with ThreadPoolExecutor(1) as thread:  # in this one the browser's own loop may be running
            thread.submit(asyncio.run, sent).result()
        assert played.process.poll() is None
        played.process.send_signal(signal.SIGINT)
        assert played.ended() == 0
    said = "".join(played.lines)
    assert "Traceback" not in said
    assert 2 < said.count("the page was sent something that it cannot do: ") <= 10
    assert " more of these" in said


def test_another_address_needs_the_token_and_is_warned_of(tmp_path):
    with playing("hold", "--address", "0.0.0.0", "--out", str(tmp_path / "run")) as played:
        assert any("can be reached from other machines" in line for line in played.lines)
        here = played.url.replace("0.0.0.0", "127.0.0.1")
        bare, _, token = here.partition("?token=")
        assert len(token) >= 20
        assert answer(here) == 200
        assert answer(bare) == 403
        assert answer(f"{bare}_nicegui_ws/socket.io/?EIO=4&transport=polling") == 403


MARKS = """() => {
    const plate = document.querySelector("svg[data-time]");
    const wide = (each) => each.getBoundingClientRect().width / plate.getBoundingClientRect().width;
    const words = [...document.querySelectorAll("svg text")].map((each) => each.textContent.trim());
    const bar = document.querySelector("[data-testid=side-x] rect");
    return {
        goal: wide(plate.querySelector("g[transform] path").parentNode),
        widest: Math.max(...[...plate.querySelectorAll("text")].map(wide)),
        side: bar.getBoundingClientRect().width / bar.ownerSVGElement.getBoundingClientRect().width,
        words,
        page: document.documentElement.scrollWidth,
    };
}"""


ARROW = """() => {
    const arrow = document.querySelector("svg[data-time] line[stroke='#c2185b']");
    const [x1, y1, x2, y2] = ["x1", "y1", "x2", "y2"].map(name => Number(arrow.getAttribute(name)));
    return {along: x2 - x1, down: y2 - y1};
}"""
"""How far the arrow of a push goes to the right and down."""


@pytest.mark.parametrize("rig", ["tube", "beam"])
def test_on_one_axis_marks_are_as_small_as_on_the_plate_and_y_is_nowhere(browser, tmp_path, rig):
    with playing("line", "--on", rig, "--out", str(tmp_path / "run")) as played:
        page = browser(str(tmp_path / "profile"), played.url)
        for width in (1400, 400):
            page.set_viewport_size({"width": width, "height": 900})
            page.wait_for_timeout(500)
            found = page.evaluate(MARKS)
            assert found["page"] <= width
            assert found["goal"] < 0.07
            assert found["widest"] < 0.3
            assert found["side"] > 0.8
            assert not {"y", "theta"} & set(found["words"])
            assert not any(word.startswith("theta") for word in found["words"])
        page.set_viewport_size({"width": 1400, "height": 900})
        page.get_by_test_id("pause").click()
        page.wait_for_timeout(500)
        ball = page.locator("svg[data-time] circle[style]").bounding_box()
        x, y = ball["x"] + ball["width"] / 2, ball["y"] + ball["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 30, y + 60)
        arrow = page.evaluate(ARROW)
        assert arrow["down"] == 0
        assert arrow["along"] > 0
        assert page.wrong == []
