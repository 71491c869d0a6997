"""The page of one browser: the plate, what it does, and what a person may change."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from time import monotonic
from typing import Any, NamedTuple

from nicegui import ui
from nicegui.element import Element

from controllers.interfaces import DelayedObserver, Law, Observer
from twin.hal.interface import SCREEN
from twin.play.driven import drivable
from twin.play.session import (
    COLUMNS,
    PAGE,
    Back,
    Errors,
    Event,
    Goal,
    Pause,
    Push,
    Settings,
    Status,
)
from twin.scenario.describe import every_kind
from twin.scenario.schema import choices

STRIPS = PAGE["strips"]
"""Title, columns with name and colour, scale, least height of the axis, whether it is about 0."""
SIDES = [each | {"half": 500 * side} for each, side in zip(PAGE["sides"], SCREEN, strict=True)]
"""The plate's side along an axis: positive phi lowers its end at +x, positive theta lifts that at
+y; half its length in mm."""

Moved = Callable[[float, float], None]


class Drawn(Element):
    """A part of the page that is sent rows of numbers, oldest first."""

    def __init__(self, **props: Any) -> None:
        super().__init__()
        self.props.update({"columns": list(COLUMNS), **props})

    def show(self, rows: Sequence[Sequence[float]]) -> None:
        """Show them."""
        self.run_method("show", rows)


class Plate(Drawn, component="plate.js"):
    """The plate from above.

    Args:
        area: Operating area |x|, |y| in m.
        goal: Called with the goal's x and y in m while a person drags it.
        push: Called with the push along x and y in m/s.
    """

    def __init__(self, area: tuple[float, float], goal: Moved, push: Moved) -> None:
        sizes = {"size": SCREEN, "area": area}
        millimetres = {name: [1000 * each for each in sides] for name, sides in sizes.items()}
        super().__init__(**millimetres, drives=False)
        self.on("goal", lambda event: _called(goal, event.args))
        self.on("push", lambda event: _called(push, event.args))

    def let_drive(self, drives: bool) -> None:
        """Whether who looks may drag."""
        self.props["drives"] = drives
        self.update()


class Sides(Drawn, component="tilt.js"):
    """The plate from two sides, so that its tilt is seen: the last row."""


class Strips(Drawn, component="strips.js"):
    """Error, plate angle and effort over the last seconds."""


def _called(done: Moved, given: Any) -> None:
    """Hand over what a browser has sent, if it is two numbers."""
    try:
        x, y = float(given["x"]), float(given["y"])
    except (TypeError, ValueError, KeyError):
        return
    if math.isfinite(x) and math.isfinite(y):
        done(x, y)


class Slider(NamedTuple):
    """A slider.

    Attributes:
        key: Of the scenario.
        entry: Which of the key's numbers; None if it has one.
        label: In words.
        unit: Of what is shown.
        scale: What is shown of one of the key's own unit.
        low: Least of what is shown.
        high: Largest.
        step: From one value to the next.
        help: What it does, in a sentence.
    """

    key: str
    entry: int | None
    label: str
    unit: str
    scale: float
    low: float
    high: float
    step: float
    help: str


PLANT, (PREDICTOR,) = (
    [Slider(**{"entry": None} | about) for about in PAGE["sliders"][of]]
    for of in ("plant", "predictor")
)


class Gain(NamedTuple):
    """A number of a law or an observer that a slider multiplies.

    Attributes:
        key: Of the scenario.
        entry: Which of its numbers; None if it has one.
        label: In words.
        value: As it is now.
        help: What it is, in words; of several numbers of a key the first has it.
    """

    key: str
    entry: int | None
    label: str
    value: float
    help: str = ""


def value_in(tables: Mapping[str, Any], key: str, entry: int | None = None) -> Any:
    """The value of a dotted key, or one of its numbers; None if there is none."""
    value: Any = tables
    for name in key.split("."):
        value = value.get(name) if isinstance(value, Mapping) else None
    return value if entry is None or value is None else value[entry]


def moved(tables: Mapping[str, Any], slider: Slider, shown: float) -> dict[str, Any]:
    """The setting that a slider stands for when it shows a value."""
    value = shown / slider.scale
    if slider.entry is None:
        return {slider.key: value}
    values = list(value_in(tables, slider.key))
    values[slider.entry] = value
    return {slider.key: values}


def shown_by(tables: Mapping[str, Any], slider: Slider) -> float:
    """The value that a slider shows of a scenario."""
    return slider.scale * float(value_in(tables, slider.key, slider.entry))


def multiplied(found: Sequence[Gain], gain: Gain, factor: float) -> dict[str, Any]:
    """The setting in which one of the numbers found is multiplied."""
    values = [
        each.value * (factor if each == gain else 1.0) for each in found if each.key == gain.key
    ]
    return {gain.key: values[0] if gain.entry is None else values}


def sliders(tables: Mapping[str, Any]) -> list[Slider]:
    """The sliders of a scenario's plant, sensors and predictor."""
    predictor = [] if tables.get("predictor") is None else [PREDICTOR]
    return [*PLANT, *predictor]


def gains(tables: Mapping[str, Any], table: str) -> list[Gain]:
    """The numbers of the present law or observer other than 0, as written or by default.

    Args:
        tables: A scenario's.
        table: ``controller`` or ``observer``.
    """
    present = tables[table]
    cls = choices(table)[present["kind"]]
    given = {item.name for base in (Law, Observer, DelayedObserver) for item in fields(base)}
    found: list[Gain] = []
    meanings = {each.key: each.meaning for each in every_kind()[f"{table}.{present['kind']}"]}
    for item in fields(cls):
        if item.name in given or not item.init:
            continue
        value = present.get(item.name, item.default)
        several = isinstance(value, list | tuple)
        numbers = list(value) if several else [value]
        replaced = item.name == "poles" and present.get("gains") is not None
        if replaced or not all(map(_multipliable, numbers)):
            continue
        key = f"{table}.{item.name}"
        meaning = meanings.get(key, "")
        labels = [item.name]
        if several:
            labels = [f"{item.name}: {part}" for part in _parts(meaning, len(numbers))]
        for entry, (label, number) in enumerate(zip(labels, numbers, strict=True)):
            more = "" if entry else meaning
            found.append(Gain(key, entry if several else None, label, float(number), more))
    return found


def _multipliable(value: Any) -> bool:
    """Whether a value is a number other than 0."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value != 0


def _parts(meaning: str, count: int) -> list[str]:
    """What each of a key's numbers is, if its meaning lists as many things; else their numbers."""
    for listed in re.findall(r"\(([^()]+,[^()]+)\)|(?:of|on) ([^;:.]+)", meaning):
        whole = re.sub(r" in [^,]*$", "", "".join(listed))
        for text in (whole, whole.partition(",")[0]):  # a comma may be followed by units
            parts = re.split(r",? and |, ", text)
            if len(parts) == count:
                return [part.removeprefix("the ") for part in parts]
    return [str(number) for number in range(1, count + 1)]


Do = Callable[[Event], None]
WIDEST = 2.0
"""A gain's slider goes from 1/4 to 4 times its value: so many powers of two either way."""
SETTLED = 0.5
"""Seconds after which a slider is no longer being moved."""
THROTTLE = 0.05
"""Seconds from one value of a moving slider to the next that is sent."""


class Page:
    """What one browser shows.

    Args:
        status: How things are.
        area: Operating area |x|, |y| in m.
        do: Lets something happen, if this browser drives.
        save: Saves what was driven, if this browser drives.
    """

    def __init__(
        self, status: Status, area: tuple[float, float], do: Do, save: Callable[[], None]
    ) -> None:
        self._status, self._do, self._save = status, do, save
        self._inputs: list[Any] = []
        self._sliders: list[tuple[Slider, Any, Any]] = []
        self._drives = False
        self._others = -1
        self._touched = 0.0
        ui.query("body").style("background:#eef1f4")
        ui.query(".nicegui-content").style("padding:.6rem;gap:.5rem")
        with ui.row().classes("items-center").style("width:100%;gap:.1rem 1rem;padding:0 .5rem"):
            title = f"Driven by hand: {status.tables['title']}"
            ui.label(title).style("font-size:1.2rem;font-weight:600")
            self._ended = ui.label().style("color:#b00020;font-weight:600")
            ui.space()
            figures = "font-variant-numeric:tabular-nums"
            self._error = ui.label().style(figures).props("data-testid=error")
            self._clock = ui.label().style(figures).mark("clock")
            self._role = ui.label().style("color:#5b6770").mark("role")
        # what does not fit beside each other, on a phone, stands below each other
        with ui.row().style("width:100%;gap:1rem;align-items:stretch"):
            with ui.column().style("flex:99 1 20rem;min-width:0;gap:.5rem"):
                with ui.card().style("width:100%;padding:.6rem"):
                    with ui.row().classes("items-center").style("width:100%;gap:.4rem .8rem"):
                        plate = Plate(area, lambda *to: do(Goal(*to)), lambda *by: do(Push(*by)))
                        self.plate = plate.style("flex:99 1 18rem;min-width:0")
                        self.sides = Sides(sides=SIDES).style("flex:1 1 16rem;min-width:0")
                    self._legend()
                self._buttons()
                with ui.card().style("width:100%;padding:.6rem;height:19rem"):
                    self.strips = Strips(strips=STRIPS).style("width:100%;height:100%")
            with ui.card().style("flex:1 1 20rem;gap:.35rem;padding:.8rem"):
                self._choices()
        self._say(status)

    def _legend(self) -> None:
        sign = "display:inline-block;width:.9rem;height:.9rem;border-radius:50%;margin-right:.3rem"
        with ui.row().style("gap:.2rem 1.1rem;font-size:.85rem;color:#37424a"):
            for style, text in PAGE["legend"]:
                html = f'<span style="{sign};{style}"></span>{text}'
                ui.html(html, sanitize=False).style("display:flex;align-items:center")

    def _buttons(self) -> None:
        with ui.row().classes("items-center").style("width:100%;gap:.5rem"):
            self._pause = self._button("Pause", "pause", self._turn_pause, "pause")
            self._button("Back 1 s", "replay", lambda: self._do(Back(1.0)), "back")
            self._button("Back 5 s", "replay_5", lambda: self._do(Back(5.0)), "back-5")
            start = partial(self._do, Back(math.inf))
            self._button("To the start", "first_page", start, "start")
            self._button("Save run", "save", self._save, "save")
            self._message = ui.label().style("font-size:.9rem").mark("message")

    def _button(self, text: str, icon: str, act: Callable[[], None], mark: str) -> Any:
        button = ui.button(text, icon=icon, on_click=lambda _: act()).props(
            f"dense no-caps outline data-testid={mark}"
        )
        self._inputs.append(button)
        return button.style("padding:.1rem .6rem")

    def _choices(self) -> None:
        present = value_in(self._status.tables, "controller.kind")
        known = choices("controller").items()
        laws = [name for name, law in known if drivable(law) or name == present]
        ui.label("Rig").style("font-weight:600")
        for slider in sliders(self._status.tables):
            self._slider(slider)
        ui.separator()
        self._law = self._select("Law", laws, "controller.kind")
        self._law_gains = ui.column().style("width:100%;gap:0")
        observers = list(choices("observer"))
        self._observer = self._select("Observer", observers, "observer.kind")
        with ui.expansion("Observer's numbers").style("width:100%").props("dense"):
            self._observer_gains = ui.column().style("width:100%;gap:0")
        self._shown_gains: dict[str, Any] = {}

    def _select(self, label: str, options: Sequence[str], key: str) -> Any:
        select = ui.select(list(options), label=label, value=value_in(self._status.tables, key))
        select.props(f"dense outlined options-dense data-testid={key}").style("width:100%")
        select.on_value_change(lambda event: self._choose(key, event.value))
        self._inputs.append(select)
        return select

    def _choose(self, key: str, value: str) -> None:
        if value != value_in(self._status.tables, key):
            self._do(Settings({key: value}))

    def _bar(
        self, label: str, name: str, ends: tuple[float, float, float], caption: str = ""
    ) -> tuple[Any, Any]:
        """A slider from an end to another in steps, under its label and beside it its value."""
        if caption:
            ui.label(caption).style("font-size:.72rem;line-height:1.25;color:#5b6770")
        with ui.row().classes("justify-between").style("width:100%;font-size:.85rem"):
            ui.label(label)
            text = ui.label()
        low, high, step = ends
        bar = ui.slider(min=low, max=high, step=step, value=min(max(0.0, low), high))
        return bar.props(f'dense data-testid="{name}"'), text

    def _slider(self, slider: Slider) -> None:
        name = f"{slider.key}" + ("" if slider.entry is None else f".{slider.entry}")
        with ui.column().style("width:100%;gap:0").tooltip(slider.help):
            bar, text = self._bar(slider.label, name, (slider.low, slider.high, slider.step))

        def act(event: Any) -> None:
            self._touched = monotonic()
            text.text = _number(float(event.args), slider.unit)
            self._do(Settings(moved(self._status.tables, slider, float(event.args))))

        bar.on("update:model-value", act, throttle=THROTTLE)
        self._inputs.append(bar)
        self._sliders.append((slider, bar, text))

    def _show_gains(self, table: str, column: Any) -> None:
        """Sliders of what the present law or observer has for numbers."""
        present = self._status.tables[table]
        if self._shown_gains.get(table) == present:
            return
        self._shown_gains[table] = present
        found = gains(self._status.tables, table)
        column.clear()
        with column:
            for gain in found:
                ends = (-WIDEST, WIDEST, 0.1)
                bar, text = self._bar(gain.label, gain.label, ends, gain.help)
                text.text = f"{gain.value:.4g}"

                def told(event: Any, text: Any = text, value: float = gain.value) -> None:
                    text.text = f"{value * 2 ** float(event.args):.4g}"

                def act(event: Any, found: Any = found, gain: Any = gain) -> None:
                    self._do(Settings(multiplied(found, gain, 2 ** float(event.args))))

                bar.on("update:model-value", told, throttle=THROTTLE)
                bar.on("change", act)
                bar.set_enabled(self._drives)

    def _turn_pause(self) -> None:
        self._do(Pause(not self._status.paused))

    def show(self, rows: list[list[float]], errors: Errors) -> None:
        """Show pictures, oldest first, and the errors so far."""
        self.plate.show(rows)
        self.sides.show(rows[-1:])
        self.strips.show(rows)
        now = dict(zip(COLUMNS, rows[-1], strict=True))
        rig, clean = (f"{1000 * each:.3g} mm" for each in errors.rms)
        self._error.text = f"error {1000 * now['error']:.0f} mm, RMS so far {rig} (clean {clean})"
        self._clock.text = f"{now['time']:.1f} s, {now['factor']:.2f} × real time"

    def say(self, status: Status, *, drives: bool, others: int) -> None:
        """Say how things are, and whether this browser drives."""
        if drives != self._drives or others != self._others:
            self._drives, self._others = drives, others
            self.plate.let_drive(drives)
            for each in self._inputs:
                each.set_enabled(drives)
            self._shown_gains.clear()
            more = f", {others} more look" if others > 1 else f"{', 1 more looks' * others}"
            self._role.text = f"you drive{more}" if drives else "you look: another browser drives"
        if status is not self._status:
            self._say(status)
        elif self._touched and monotonic() - self._touched > SETTLED:
            self._touched = 0.0
            self._set_sliders()

    def _say(self, status: Status) -> None:
        self._status = status
        self._ended.text = f"The run has ended: {status.ended}" if status.ended else ""
        self._pause.set_text("Go on" if status.paused else "Pause")
        self._pause.props(f"icon={'play_arrow' if status.paused else 'pause'}")
        self._message.text = status.message
        self._message.style(f"color:{'#b00020' if status.wrong else '#37424a'}")
        if not self._touched:
            self._set_sliders()
        self._law.value = value_in(status.tables, "controller.kind")
        self._observer.value = value_in(status.tables, "observer.kind")
        self._show_gains("controller", self._law_gains)
        self._show_gains("observer", self._observer_gains)

    def _set_sliders(self) -> None:
        """Let the sliders show what is, unless one is just being moved."""
        for slider, bar, text in self._sliders:
            value = shown_by(self._status.tables, slider)
            text.text = _number(value, slider.unit)
            bar.value = value


def _number(value: float, unit: str) -> str:
    """A value of a slider with its unit."""
    return f"{value:.3g} {unit}"
