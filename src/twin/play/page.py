"""The page of one browser: the plate, its motion, and the controls for a person."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from time import monotonic
from typing import Any, NamedTuple

from nicegui import ui
from nicegui.element import Element

from controllers.interfaces import catalog_settings, entries_of
from twin.play.driven import drivable
from twin.play.session import (
    PAGE_TABLES,
    PICTURE_COLUMNS,
    Back,
    Event,
    Goal,
    Pause,
    Push,
    Settings,
    Status,
)
from twin.run.record import of_axes
from twin.run.tables import flat
from twin.scenario.describe import every_kind
from twin.scenario.schema import Dimensions, choices

PLOT_STRIPS = PAGE_TABLES["strips"]
"""Title, columns with name and colour, scale, least height of the axis, whether it is about 0."""
Moved = Callable[[float, float], None]


class Drawn(Element):
    """A part of the page that is sent rows of numbers, oldest first."""

    def __init__(self, **props: Any) -> None:
        super().__init__()
        self.props.update({"columns": list(PICTURE_COLUMNS), **props})

    def show(self, rows: Sequence[Sequence[float]]) -> None:
        """Show them."""
        self.run_method("show", rows)


class Plate(Drawn, component="plate.js"):
    """The plate from above.

    Args:
        size: Screen, operating area and ball.
        goal: Called with the goal's x and y in m while a person drags it.
        push: Called with the push along x and y in m/s.
    """

    def __init__(self, size: Dimensions, goal: Moved, push: Moved) -> None:
        screen, area = size.screen, size.area
        if size.axes == 1:  # as wide as can be seen; goals lie on the line
            screen, area = (screen[0], max(screen[0] / 5, 4 * size.ball)), (area[0], 0.0)
        sizes = {"size": screen, "area": area, "ball": [size.ball]}
        millimetres = {name: [1000 * each for each in sides] for name, sides in sizes.items()}
        super().__init__(**millimetres, round=size.round, drives=False)
        self.on("goal", lambda event: _pass_pair(goal, event.args))
        self.on("push", lambda event: _pass_pair(push, event.args))

    def let_drive(self, drives: bool) -> None:
        """Enable or disable dragging."""
        self.props["drives"] = drives
        self.update()


DRAWN_SIDE = 700.0
"""Length of the longest side of a plate in the side views, in units of their picture."""


class Sides(Drawn, component="tilt.js"):
    """The plate from two sides, so that its tilt is seen: the last row."""


class Strips(Drawn, component="strips.js"):
    """Error, plate angle and effort over the last seconds."""


def strips_of(axes: int) -> list[dict[str, Any]]:
    """What the strips of a rig with so many axes show."""
    return [
        each | {"curves": [curve for curve in each["curves"] if of_axes(curve[:1], axes)]}
        for each in PLOT_STRIPS
    ]


def _pass_pair(done: Moved, given: Any) -> None:
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
        help: Its effect, in a sentence.
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


PLANT_SLIDERS, (PREDICTOR,) = (
    [Slider(**{"entry": None} | about) for about in PAGE_TABLES["sliders"][of]]
    for of in ("plant", "predictor")
)


def value_in(tables: Mapping[str, Any], key: str, entry: int | None = None) -> Any:
    """The value of a dotted key, or one of its numbers; None if there is none."""
    value = flat(tables).get(key)
    return value if entry is None or value is None else value[entry]


def setting_of_slider(tables: Mapping[str, Any], slider: Slider, shown: float) -> dict[str, Any]:
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


def sliders(tables: Mapping[str, Any]) -> list[Slider]:
    """The sliders of a scenario's plant, sensors and predictor."""
    predictor = [] if tables.get("predictor") is None else [PREDICTOR]
    axes = value_in(tables, "plant.axes") or 2
    plant = [each for each in PLANT_SLIDERS if each.entry is None or each.entry < axes]
    return [*plant, *predictor]


def complete(tables: Mapping[str, Any]) -> dict[str, Any]:
    """A scenario's tables in which law and observer have what they have by default, too."""
    own = {}
    for table in ("controller", "observer"):
        known = catalog_settings(choices(table)[tables[table]["kind"]])
        own[table] = {item.name: item.default for item in known} | tables[table]
    return {**tables, **own}


def gains(tables: Mapping[str, Any], table: str) -> list[Slider]:
    """Sliders of the numbers of the present law or observer, from a quarter of each to four times.

    Args:
        tables: Those of a scenario, complete.
        table: ``controller`` or ``observer``.
    """
    present = tables[table]
    one_axis = value_in(tables, "plant.axes") == 1
    meanings = {each.key: each.meaning for each in every_kind()[f"{table}.{present['kind']}"]}
    found: list[Slider] = []
    for item in catalog_settings(choices(table)[present["kind"]]):
        value = present.get(item.name)
        several = isinstance(value, list | tuple)
        numbers = list(value) if several else [value]
        replaced = item.name == "poles" and present.get("gains") is not None
        plain = all(type(n) in (int, float) and n for n in numbers)  # a slider multiplies
        if replaced or not plain:
            continue
        key = f"{table}.{item.name}"
        entries = entries_of(item)
        names = entries.names or range(1, len(numbers) + 1)
        for entry, number in enumerate(numbers[: entries.along_x] if one_axis else numbers):
            low, high = sorted((number / GAIN_SLIDER_FACTOR, number * GAIN_SLIDER_FACTOR))
            label = f"{item.name} {names[entry]}" if several else item.name
            meaning = "" if entry else meanings.get(key, "")
            found.append(
                Slider(key, entry if several else None, label, "", 1, low, high, 0, meaning)
            )
    return found


Do = Callable[[Event], None]
GAIN_SLIDER_FACTOR = 4.0
"""A gain's slider goes from its value over this to so many times its value."""
SLIDER_SETTLE_S = 0.5
"""Seconds after which a slider is no longer being moved."""
SLIDER_INTERVAL_S = 0.05
"""Seconds from one value of a moving slider to the next that is sent."""
MOVING, MOVED = "update:model-value", "change"
"""Events of a slider."""


class Page:
    """View of one browser.

    Args:
        status: How things are.
        size: Screen, operating area and ball.
        do: Lets something happen, if this browser drives.
        save: Saves what was driven, if this browser drives.
    """

    def __init__(self, status: Status, size: Dimensions, do: Do, save: Callable[[], None]) -> None:
        self._status, self._do, self._save = status, do, save
        self._tables = complete(status.tables)
        self._sliders: list[tuple[Slider, Any, Any]] = []
        self._inputs: list[Any] = []
        self._drives: bool | None = None
        self._touched = 0.0
        ui.add_css(PAGE_TABLES["style"])
        ui.query(".nicegui-content").style("padding:.6rem;gap:.5rem")
        with ui.row().classes("items-center").style("width:100%;gap:.1rem 1rem;padding:0 .5rem"):
            title = f"Driven by hand: {status.tables['title']}"
            ui.label(title).style("font-size:1.2rem;font-weight:600")
            self._ended = ui.label().style("color:var(--wrong);font-weight:600")
            ui.space()
            figures = "font-variant-numeric:tabular-nums"
            self._error = ui.label().style(figures).props("data-testid=error")
            self._clock = ui.label().style(figures)
            self._role = ui.label().style("color:var(--faint)")
        # a narrow page, as on a phone, stacks these in a column
        with ui.row().style("width:100%;gap:1rem;align-items:stretch"):
            with ui.column().style("flex:99 1 20rem;min-width:0;gap:.5rem"):
                with ui.card().style("width:100%;padding:.6rem"):
                    with ui.row().classes("items-center").style("width:100%;gap:.4rem .8rem"):
                        plate = Plate(size, lambda *to: do(Goal(*to)), lambda *by: do(Push(*by)))
                        self.plate = plate.style("flex:99 1 18rem;min-width:0")
                        halves = zip(PAGE_TABLES["sides"], size.screen, strict=True)
                        scale = DRAWN_SIDE / max(size.screen[: size.axes])
                        sides = [
                            each | {"half": scale * side / 2, "scale": scale}
                            for each, side in halves
                        ]
                        shown = Sides(sides=sides[: size.axes])
                        self.sides = shown.style("flex:1 1 16rem;min-width:0")
                    self._legend()
                self._buttons()
                with ui.card().style("width:100%;padding:.6rem;height:19rem"):
                    strips = Strips(strips=strips_of(size.axes))
                    self.strips = strips.style("width:100%;height:100%")
            with ui.card().style("flex:1 1 20rem;gap:.35rem;padding:.8rem"):
                self._choices()
        self._say()

    def _legend(self) -> None:
        sign = "display:inline-block;width:.9rem;height:.9rem;border-radius:50%;margin-right:.3rem"
        with ui.row().style("gap:.2rem 1.1rem;font-size:.85rem;color:var(--text)"):
            for style, text in PAGE_TABLES["legend"]:
                html = f'<span class="drawn" style="{sign};{style}"></span>{text}'
                ui.html(html, sanitize=False).style("display:flex;align-items:center")

    def _buttons(self) -> None:
        with ui.row().classes("items-center").style("width:100%;gap:.5rem"):
            turn = lambda: self._do(Pause(not self._status.paused))  # noqa: E731
            self._pause = self._button("Pause", "pause", turn, "pause")
            self._button("Back 1 s", "replay", lambda: self._do(Back(1.0)), "back")
            self._button("Back 5 s", "replay_5", lambda: self._do(Back(5.0)), "back-5")
            self._button("To the start", "first_page", lambda: self._do(Back(math.inf)), "start")
            self._button("Save run", "save", self._save, "save")
            self._message = ui.label().style("font-size:.9rem")

    def _button(self, text: str, icon: str, act: Callable[[], None], mark: str) -> Any:
        button = ui.button(text, icon=icon, on_click=lambda _: act()).style("padding:.1rem .6rem")
        self._inputs.append(button)
        return button.props(f"dense no-caps outline data-testid={mark}")

    def _choices(self) -> None:
        present = value_in(self._tables, "controller.kind")
        known = choices("controller").items()
        laws = [name for name, law in known if drivable(law) or name == present]
        ui.label("Rig").style("font-weight:600")
        for slider in sliders(self._tables):
            with ui.column().style("width:100%;gap:0").tooltip(slider.help):
                self._sliders.append((slider, *self._slider(slider, MOVING)))
                self._inputs.append(self._sliders[-1][1])
        ui.separator()
        self._law = self._select("Law", laws, "controller.kind")
        law_gains = ui.column().style("width:100%;gap:0")
        self._observer = self._select("Observer", list(choices("observer")), "observer.kind")
        with ui.expansion("Observer's numbers").style("width:100%").props("dense"):
            self._gains = {"controller": law_gains, "observer": ui.column().style("gap:0")}
        self._shown_gains: dict[str, Any] = {}

    def _select(self, label: str, options: list[str], key: str) -> Any:
        def choose(event: Any) -> None:
            if event.value != value_in(self._tables, key):
                self._do(Settings({key: event.value}))

        select = ui.select(
            options, label=label, value=value_in(self._tables, key), on_change=choose
        )
        self._inputs.append(select)
        return select.props(f"dense outlined options-dense data-testid={key}").style("width:100%")

    def _slider(self, slider: Slider, when: str) -> tuple[Any, Any]:
        """A slider and its number; its setting is sent at an event, moving or moved."""
        with ui.row().classes("justify-between").style("width:100%;font-size:.85rem"):
            ui.label(slider.label)
            text = ui.label()
        bar = ui.slider(min=slider.low, max=slider.high, step=slider.step)
        entry = "" if slider.entry is None else f".{slider.entry}"
        bar.props(f'dense data-testid="{slider.key}{entry}"')

        def show(event: Any) -> None:
            self._touched = monotonic()
            text.text = _number(float(event.args), slider.unit)

        def act(event: Any) -> None:
            self._do(Settings(setting_of_slider(self._tables, slider, float(event.args))))

        bar.on(MOVING, show, throttle=SLIDER_INTERVAL_S)
        bar.on(when, act, throttle=SLIDER_INTERVAL_S)
        self._set(slider, bar, text)
        return bar, text

    def _set(self, slider: Slider, bar: Any, text: Any) -> None:
        """Update a slider."""
        bar.value = shown_by(self._tables, slider)
        text.text = _number(bar.value, slider.unit)

    def _show_gains(self, table: str) -> None:
        """Sliders of what the present law or observer has for numbers."""
        present = self._tables[table]
        if self._shown_gains.get(table) == present:
            return
        self._shown_gains[table] = present
        self._gains[table].clear()
        with self._gains[table]:
            for gain in gains(self._tables, table):
                if gain.help:
                    about = ui.label(gain.help)
                    about.style("font-size:.72rem;line-height:1.25;color:var(--faint)")
                bar, _ = self._slider(gain, MOVED)
                bar.set_enabled(bool(self._drives))

    def show(self, rows: list[list[float]], rms: tuple[float, float]) -> None:
        """Show pictures, oldest first, and the errors of rig and clean model so far, m."""
        self.plate.show(rows)
        self.sides.show(rows[-1:])
        self.strips.show(rows)
        now = dict(zip(PICTURE_COLUMNS, rows[-1], strict=True))
        rig, clean = (f"{1000 * each:.3g} mm" for each in rms)
        self._error.text = f"error {1000 * now['error']:.0f} mm, RMS so far {rig} (clean {clean})"
        self._clock.text = f"{now['time']:.1f} s, {now['factor']:.2f} × real time"

    def say(self, status: Status, *, drives: bool) -> None:
        """Say how things are, and whether this browser drives."""
        changed = drives != self._drives
        if changed:
            self._drives = drives
            self.plate.let_drive(drives)
            for each in self._inputs:
                each.set_enabled(drives)
            self._shown_gains.clear()
            self._role.text = "you drive" if drives else "you look: another browser drives"
        settled = self._touched and monotonic() - self._touched > SLIDER_SETTLE_S
        if settled:
            self._touched = 0.0
        if changed or settled or status is not self._status:
            self._status, self._tables = status, complete(status.tables)
            self._say()

    def _say(self) -> None:
        status = self._status
        self._ended.text = f"The run has ended: {status.ended}" if status.ended else ""
        self._pause.set_text("Go on" if status.paused else "Pause")
        self._pause.props(f"icon={'play_arrow' if status.paused else 'pause'}")
        self._message.text = status.message
        self._message.style(f"color:var({'--wrong' if status.wrong else '--text'})")
        if not self._touched:  # else one is just being moved
            for each in self._sliders:
                self._set(*each)
        self._law.value = value_in(self._tables, "controller.kind")
        self._observer.value = value_in(self._tables, "observer.kind")
        for table in self._gains:
            self._show_gains(table)


def _number(value: float, unit: str) -> str:
    """A value of a slider with its unit."""
    return f"{value:.4g} {unit}"
