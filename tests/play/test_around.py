"""`twin.play.serve`.

What stands around a driven rig: who may ask, who drives, the clock, the sliders, the command."""

import asyncio
import logging
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from twin.base.errors import TwinError
from twin.cli.rig import play
from twin.play import serve
from twin.play.page import PLANT_SLIDERS, complete, gains, setting_of_slider, shown_by
from twin.play.serve import (
    MAX_LINES,
    SERVER_LOGGERS,
    Audience,
    in_lines,
    is_loopback,
    require_token,
)
from twin.play.session import MAX_AHEAD_S, MAX_BEHIND_S, PICTURE_COLUMNS, Errors, Pace
from twin.scenario.load import load

HERE = {"host": "127.0.0.1:8090"}
THERE = {"host": "10.0.0.5:8090"}


def asked(token="", *, headers=HERE, query="", kind="http"):
    """What somebody gets who asks: the messages that are sent, and whether the page answered."""
    sent, answered = [], []

    async def app(scope, receive, send):
        answered.append(scope["type"])
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    scope = {
        "type": kind,
        "query_string": query.encode(),
        "headers": [(name.encode(), text.encode()) for name, text in headers.items()],
    }
    asyncio.run(require_token(app, token)(scope, None, send))
    return sent, bool(answered)


def test_this_machine_is_answered_and_told_of_no_token():
    sent, answered = asked()
    assert answered
    assert sent[0]["headers"] == []


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("token", "headers", "query"),
    [
        ("", {"host": "evil.example:8090"}, ""),  # a name that leads here
        ("", {**HERE, "origin": "http://evil.example"}, ""),
        ("secret", THERE, ""),
        ("secret", THERE, "token=wrong"),
        ("secret", THERE, "token="),
        ("secret", {**THERE, "cookie": "ballplate_token=wrong"}, ""),
        ("secret", {**THERE, "origin": "http://evil.example"}, "token=secret"),
    ],
)
def test_others_are_refused(token, headers, query, kind):
    sent, answered = asked(token, headers=headers, query=query, kind=kind)
    assert not answered
    if kind == "http":
        assert sent[0]["status"] == 403
    else:
        assert sent == [{"type": "websocket.close", "code": 1008}]


def test_who_has_the_token_is_answered_and_gets_a_cookie_that_will_do():
    sent, answered = asked("secret", headers=THERE, query="token=secret")
    assert answered
    ((name, cookie),) = sent[0]["headers"]
    assert name == b"set-cookie"
    assert b"HttpOnly" in cookie
    again = {**THERE, "cookie": cookie.decode().partition(";")[0]}
    _, answered = asked("secret", headers=again, kind="websocket")
    assert answered


@pytest.mark.parametrize(
    ("host", "here"),
    [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False), ("x.y", False)],
)
def test_what_is_this_machine_alone(host, here):
    assert is_loopback(host) == here


def test_the_first_drives_and_the_next_takes_over_when_it_has_gone():
    now = 0.0
    audience = Audience(lambda: now, patience=5.0)
    assert not audience.has_left
    audience.come("one")
    audience.come("two")
    assert audience.driver == "one"
    audience.go("one")
    assert audience.driver == "two"
    audience.come("one")
    assert audience.driver == "two"
    audience.go("two")
    audience.go("one")
    now = 4.0
    assert not audience.has_left
    audience.come("three")  # a page that was loaded again
    now = 20.0
    assert not audience.has_left
    audience.go("three")
    now = 26.0
    assert audience.has_left


def test_a_clock_holds_the_simulation_to_real_time_and_says_when_it_cannot():
    now = 100.0
    pace = Pace(lambda: now)
    assert pace.early(0.0) == 0.0
    assert pace.early(MAX_AHEAD_S / 2) == 0.0
    assert pace.early(0.5) == pytest.approx(0.5)
    now = 101.0
    assert pace.early(0.5) == 0.0  # half a second late: not all of it is caught up with
    assert pace.early(0.5 + MAX_BEHIND_S + 0.01) == pytest.approx(0.01)
    now = 101.5
    pace.early(0.75)
    assert pace.factor == pytest.approx(0.5)


def test_a_slider_moves_its_number_and_shows_it():
    tables = load("circle").model_dump(mode="json")
    dead_time = next(each for each in PLANT_SLIDERS if each.unit == "ms")
    assert shown_by(tables, dead_time) == pytest.approx(42)
    assert setting_of_slider(tables, dead_time, 60.0) == {
        "sensors.touch.dead_time": pytest.approx(0.06)
    }
    along_y = next(each for each in PLANT_SLIDERS if each.entry == 1)
    assert setting_of_slider(tables, along_y, 0.3) == {"plant.level_deg": [0.0, 0.3]}


def of_law(name, *settings):
    """A scenario's tables and the sliders of its law."""
    tables = complete(load(name, settings).model_dump(mode="json"))
    return tables, gains(tables, "controller")


def test_a_gain_is_moved_and_the_others_of_its_key_stay():
    tables, found = of_law("circle")
    assert [shown_by(tables, each) for each in found] == [180, 162, 66, 13]
    assert (found[0].low, found[0].high) == (45, 720)
    assert setting_of_slider(tables, found[1], 81.0) == {"controller.gains": [180, 81, 66, 13]}
    tables, (rho, *_) = of_law("hold")
    assert setting_of_slider(tables, rho, 600.0) == {"controller.rho": 600.0}


def test_gains_have_the_names_that_their_law_gives_them():
    def labels(*settings):
        return [each.label for each in of_law("circle", *settings)[1]]

    assert labels() == ["gains p0", "gains p1", "gains p2", "gains p3"]
    assert labels("controller.kind=backstepping")[:4] == ["c c1", "c c2", "c c3", "c c4"]
    betas = ["betas beta1", "betas beta2", "betas beta3"]
    assert labels("controller.kind=sliding_mode")[1:4] == betas
    assert labels("controller.kind=pid")[-2:] == ["plate 1", "plate 2"]


def test_gains_by_default_can_be_moved_too():
    tables, found = of_law("circle", "controller.kind=pole_placement")
    assert [shown_by(tables, each) for each in found] == [-2, -2.5, -3.5, -4]
    assert (found[0].low, found[0].high) == (-8, -0.5)
    assert setting_of_slider(tables, found[3], -5.0) == {"controller.poles": [-2, -2.5, -3.5, -5]}


@pytest.mark.parametrize(
    ("kind", "name", "along_x"),
    [("friction_kalman", "R", 1), ("friction_map_kalman", "map_sides", 1), ("kalman", "R", 2)],
)
def test_no_slider_of_one_axis_is_of_the_second(kind, name, along_x):
    def entries(rig):
        set_ = [f"parameters={rig}", f'observer={{kind="{kind}"}}', "predictor.delay=0.04"]
        tables = complete(load("circle", set_).model_dump(mode="json"))
        key = f"observer.{name}"
        return [each.entry for each in gains(tables, "observer") if each.key == key]

    assert entries("tube") == list(range(along_x))
    assert entries("course") == list(range(2 * along_x))


def test_the_error_so_far_is_that_of_all_pictures_and_forgets_what_was_undone():
    def row(time, error, clean):
        now = {
            **dict.fromkeys(PICTURE_COLUMNS, 0.0),
            "time": time,
            "error": error,
            "ghost_error": clean,
        }
        return [now[name] for name in PICTURE_COLUMNS]

    errors = Errors()
    assert errors.rms == (0.0, 0.0)
    errors.add([row(0.0, 0.03, 0.0), row(0.02, 0.04, 0.01)])
    assert errors.rms == pytest.approx((np.sqrt(0.0025 / 2), np.sqrt(0.0001 / 2)))
    errors.add([row(0.04, 9.0, np.nan)])
    assert np.isnan(errors.rms[1])
    errors.add([row(0.02, 0.04, 0.01)])  # somebody went back
    assert errors.rms == pytest.approx((np.sqrt(0.0025 / 2), np.sqrt(0.0001 / 2)))


def test_gains_are_called_by_their_key_and_told_what_they_are():
    _, found = of_law("circle", "controller.kind=pid")
    help_of = {gain.label: gain.help for gain in found}
    assert {"kp", "plate 1", "plate 2"} < set(help_of)
    assert help_of["kp"] == "Gain on the error, 1/s^2."
    assert help_of["plate 2"] == ""  # the first of several has it


def test_a_missing_extra_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    with pytest.raises(TwinError, match=r"needs the extra play: pip install 'ballplate\[play\]'"):
        serve.library()


@pytest.mark.long
def test_a_port_that_is_taken_is_one_line_and_starts_nothing(tmp_path):
    taken = serve.bound("127.0.0.1", 0)
    port = taken.getsockname()[1]
    taken.listen()
    try:
        done = CliRunner().invoke(play, ["hold", "--port", str(port), "--out", str(tmp_path / "x")])
    finally:
        taken.close()
    assert isinstance(done.exception, TwinError)
    assert str(done.exception) == (
        f"address 127.0.0.1, port {port}: Address already in use; choose another"
    )


def test_what_a_browser_sends_and_is_no_event_costs_a_line_and_no_stack_of_calls(capsys):
    told = []
    with in_lines(told.append):
        for name in SERVER_LOGGERS:
            try:
                {}["id"]
            except KeyError as error:
                logging.getLogger(name).exception(error)
        logging.getLogger("nicegui").error("\x1b[31mred\nand more" + "!" * 1000)
        logging.getLogger("nicegui").info("quiet")
    assert len(told) == len(SERVER_LOGGERS) + 1
    begin = "the page was sent something that it cannot do: "
    assert told[:-1] == [f"{begin}KeyError: 'id'"] * len(SERVER_LOGGERS)
    assert told[-1].startswith(f"{begin}\\x1b[31mred and more!!!")
    assert len(told[-1]) < 250
    assert capsys.readouterr().err == ""


def test_of_many_things_that_are_no_event_the_first_are_told_and_the_others_counted():
    told, logger = [], logging.getLogger("asyncio")
    before = logger.handlers[:], logger.propagate
    with in_lines(told.append):
        for number in range(268):
            logger.error("no event %d", number)
    assert len(told) == MAX_LINES + 1
    assert told[-1] == f"and {268 - MAX_LINES} more of these"
    assert (logger.handlers, logger.propagate) == before
