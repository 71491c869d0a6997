"""Changes of a scenario by tables, keys or texts, and lists of what can be run and set."""

from __future__ import annotations

import dataclasses
import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack

from twin.base.errors import ScenarioError
from twin.base.shipped import shipped_scenarios, titles

if TYPE_CHECKING:
    from ballplate.reporter import Reporter
    from controllers.ballplate import BallPlate
    from controllers.interfaces import Law, Observer, Reference
    from twin.scenario.describe import Key
    from twin.scenario.schema import Scenario


Table = Mapping[str, Any]
"""A table of a scenario: keys to values or further tables."""
Settings = Mapping[str, Any] | Sequence[str]
"""Dotted keys to values, ``{"plant.friction.rolling_mm": 0.1}``, or texts ``"duration=10"``."""
Vary = Mapping[str, Iterable[Any]] | Sequence[str]
"""Dotted key, or a table as ``controller``, to the values that it takes in turn, or texts
``KEY=[A, B, ...]``."""


class Changes(TypedDict, total=False):
    """Keys of a scenario, as keyword arguments; ``describe()`` lists every key in them.

    A table changes only the keys it names. ``controller``, ``observer`` and ``reference`` take a
    table with its ``kind``, a kind alone, or an object or class of ``ballplate.laws``,
    ``ballplate.observers``, ``ballplate.references`` or of your own.

    Examples:
        >>> import ballplate as bp
        >>> changes: bp.Changes = {"controller": "lqr", "plant": {"friction": {"rolling_mm": 0.1}}}
        >>> done = bp.run("hold", ["plant.kind=lagrange"], duration=0.1, **changes)
        >>> done.scenario.controller.kind, done.scenario.plant.friction.rolling_mm
        ('lqr', 0.1)
    """

    title: str
    """Title in tables and pictures."""
    duration: float
    """Duration of the run, in s."""
    seed: int
    """Seed of the noise."""
    baseline: bool
    """Whether the clean model runs as well."""
    plant: Table
    """Changes of the plant: ball, friction, surface, drives, start."""
    rig: Table
    """Control period, limits, what the rig knows of its cams."""
    sensors: Table
    """Touch screen and plate encoders."""
    disturbance: Table
    """Disturbance of the plate."""
    controller: Table | str | Law | type[Law]
    """The control law and its settings."""
    observer: Table | str | Observer | type[Observer]
    """The observer and its settings."""
    predictor: Table | None
    """The Smith predictor; None for none."""
    board: Table | None
    """The processor that has the controller; None for Python on this one."""
    reference: Table | str | Reference | type[Reference]
    """The path of the ball and its settings."""
    metrics: Table
    """Changes of the evaluation: start of steady tracking, and settling band."""
    parameters: str
    """File of identified parameters that lie over the scenario's own."""


class KeyChange(NamedTuple):
    """One key of a scenario and its new value.

    Attributes:
        key: Dotted key.
        value: As JSON and TOML have it.
        text: ``KEY=VALUE``, as given or as one would write it on the command line.
    """

    key: str
    value: Any
    text: str

    @classmethod
    def of(cls, key: str, value: Any) -> KeyChange:
        """The change of a key to a plain value."""
        from twin.scenario.variations import format_toml_value

        return cls(key, value, f"{key}={format_toml_value(value)}")


def changes_of(settings: Settings, tables: Mapping[str, Any]) -> list[KeyChange]:
    """Changes by dotted keys or texts, and over those by tables.

    An object or class of a law, observer or reference is all of it: it comes before the keys.

    Raises:
        ScenarioError: If a text is not ``KEY=VALUE``, or a value none that a scenario can hold.
    """
    from twin.scenario.merging import setting
    from twin.scenario.schema import CATALOG_TABLES

    if isinstance(settings, str) or not isinstance(settings, Iterable):
        raise ScenarioError(f"settings: must be a table or a list of texts, got {settings!r}")
    if isinstance(settings, Mapping):
        found = [KeyChange.of(*pair) for pair in flatten(settings)]
    else:
        found = [KeyChange(*setting(text), text) for text in map(str, settings)]
    own = [KeyChange.of(*pair) for pair in flatten(tables)]
    whole = [each for each in own if each.key in CATALOG_TABLES]
    return [*whole, *found, *(each for each in own if each not in whole)]


def scenario_of(name: str | Path, changed: Sequence[KeyChange], *, titled: bool = True) -> Scenario:
    """The checked scenario.

    Args:
        name: A shipped scenario, or a TOML file.
        changed: What is changed of it.
        titled: Whether its title states it.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    from twin.scenario.load import check, read, resolve
    from twin.scenario.variations import comparison

    chosen = check(*resolve(*read(str(name)), [(each.key, each.value) for each in changed]))
    title = comparison(chosen.title, (), [each.text for each in changed])
    return chosen.model_copy(update={"title": title}) if titled else chosen


def warn_of_replaced(
    names: Iterable[str | Path], changed: Sequence[KeyChange], reporter: Reporter
) -> None:
    """State which settings of scenarios the changes replace, as poles do gains.

    Args:
        names: Shipped scenarios, or TOML files.
        changed: What is changed of each.
        reporter: Receives a line of each in which something is replaced.

    Raises:
        ScenarioError: If a scenario cannot be read, or a key leads through a value.
    """
    from twin.scenario.load import describe_replaced

    for name in names:
        if line := describe_replaced(str(name), [(each.key, each.value) for each in changed]):
            reporter.warn(line)


def flatten(tables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and plain values of nested tables.

    Raises:
        ScenarioError: If a value is none that a scenario can hold.
    """
    from twin.scenario.schema import CATALOG_TABLES

    for name, value in tables.items():
        key = f"{prefix}{name}"
        if key in CATALOG_TABLES and not isinstance(value, Mapping):
            yield from _choice(key, CATALOG_TABLES[key], value)
        elif isinstance(value, Mapping):
            yield from flatten(value, f"{key}.")
        else:
            yield key, _plain(key, value)


def varied_of(vary: Vary, name: str = "vary") -> dict[str, list[Any]]:
    """Varied keys with plain values; a law, observer or reference is its table.

    Args:
        vary: Keys and values, or a text of each.
        name: What to call them in messages, as ``--vary``.

    Raises:
        ScenarioError: If a value is none that a scenario can hold, or there is no list of values,
            none in it, or one twice.
    """
    from twin.scenario.variations import parse_variations

    if isinstance(vary, list | tuple):
        vary = parse_variations(vary, name)
    if not isinstance(vary, Mapping):
        raise ScenarioError(f"{name}: give a table of keys and their values, got {vary!r}")
    for key, values in vary.items():
        if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
            raise ScenarioError(f"{name} {key}: give a list of values, as in [{values!r}]")
    found = {
        key: [_normalise_variation(key, value) for value in values] for key, values in vary.items()
    }
    for key, values in found.items():
        if not values:
            raise ScenarioError(f"{name} {key}: give at least one value")
        for number, value in enumerate(values):
            if value in values[:number]:
                raise ScenarioError(f"{name} {key}: {json.dumps(value)} is given twice")
    return found


def _normalise_variation(key: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return _plain(key, value)
    ((named, found),) = flatten({key: value})
    return found if named == key else {"kind": found}


def _choice(table: str, kind: type, value: Any) -> Iterator[tuple[str, Any]]:
    """What names a law, observer or reference: a kind alone, or an object, which is all of it."""
    if isinstance(value, str):
        yield f"{table}.kind", value
        return
    cls = value if isinstance(value, type) else type(value)
    if not issubclass(cls, kind):
        allowed = f"a table, the name of a kind, or a {kind.__name__.lower()}"
        raise ScenarioError(f"{table}: must be {allowed}, got {value!r}")
    yield table, _table_of(table, cls, value)


def _table_of(table: str, cls: Any, value: Any) -> Table:
    """A class, or an object with its settings, known to the catalog by its name."""
    from controllers.ballplate import BallPlate
    from controllers.catalog import register
    from twin.scenario.schema import settings_model

    try:
        register(cls)
    except ValueError as error:
        raise ScenarioError(f"{table}: {error}") from None
    found = {"kind": cls.name}
    if value is cls:
        return found
    if getattr(value, "model", BallPlate()) != BallPlate():
        raise ScenarioError(f"{table}: runs design on controller.model; leave its model out")
    for name, field in settings_model(cls).model_fields.items():
        given = _plain(f"{table}.{name}", getattr(value, name))
        default = field.get_default(call_default_factory=True)
        if field.is_required() or given != _plain(name, default):
            found[name] = given
    return found


def _plain(key: str, value: Any) -> Any:
    """A value as JSON and TOML have it."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain(key, dataclasses.asdict(value))
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # an array or number of numpy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(f"{key}.{name}", each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(key, each) for each in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ScenarioError(f"{key}: must be a number, a text, a list or a table, got {value!r}")


class Keys(list["Key"]):
    """Settings with type, unit, default, range and meaning; a table in a notebook.

    Attributes:
        sentence: What the law, observer or reference is; empty for anything else.

    Examples:
        >>> import ballplate as bp
        >>> keys = bp.describe("kalman")
        >>> type(keys) is bp.Keys, keys.sentence
        (True, 'Linear observer with the gain that is best for white disturbance and noise.')
        >>> [each.key for each in keys]
        ['observer.Q', 'observer.R']
    """

    sentence = ""

    def __repr__(self) -> str:
        lines = [f"{key.key} = {key.value} {key.unit}".rstrip() for key in self]
        return "\n".join(filter(None, (self.sentence, *lines)))

    def _repr_html_(self) -> str:
        """For a notebook."""
        from twin.base.page import Table, Text, fragment

        heads = ("key", "default", "unit", "type", "allowed", "meaning")
        lines = [
            (each.key, each.value, each.unit, each.type, each.allowed, each.meaning)
            for each in self
        ]
        about = [Text([self.sentence])] if self.sentence else []
        return fragment("", [*about, Table("", heads, lines, words=range(len(heads)))])


def describe(name: str = "") -> Keys:
    """Every key that may be set.

    Args:
        name: A key (``plant.friction.rolling_mm``) or its last part, a table
            (``plant.friction``), or a law, observer or reference (``lqr``); empty for the keys of
            every scenario.

    Raises:
        ScenarioError: If there is nothing of that name.

    Examples:
        >>> import ballplate as bp
        >>> bp.describe("rolling_mm")
        plant.friction.rolling_mm = 0.18 mm
        >>> (key,) = bp.describe("rolling_mm")
        >>> key.default, key.unit, key.allowed
        (0.18, 'mm', '>= 0, <= 10')
    """
    from twin.scenario.describe import about, find_keys

    if not isinstance(name, str):
        raise ScenarioError(f"describe: give a key, a table or a kind as a text, got {name!r}")
    found = Keys(find_keys(name))
    found.sentence = about(name)
    return found


def scenarios() -> dict[str, str]:
    """The shipped scenarios: name to title.

    Examples:
        >>> import ballplate as bp
        >>> bp.scenarios()["circle"]
        'Circle of 150 mm at 0.75 rad/s'
    """
    return titles(shipped_scenarios())


def model(
    scenario: str | Path | None = None, settings: Settings = (), **changes: Unpack[Changes]
) -> BallPlate:
    """The equations (5.9) of ball and plate, the model that controllers are designed on.

    ``A, B, C = model().linear()`` about the level plate; ``derivative(x, u)``, ``jacobian(x)`` and
    more are functions of any state.

    Args:
        scenario: Scenario with the ball on which its controller is designed, unless
            ``controller.model`` is set; the nominal one by default.
        settings: What is changed of that scenario, by dotted keys or as texts ``KEY=VALUE``.
        changes: What is changed of that scenario, by tables.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown or out of range.

    Examples:
        >>> import ballplate as bp
        >>> A, B, C = bp.model().linear()
        >>> A.shape, B.shape, C.shape
        ((8, 8), (8, 2), (4, 8))
        >>> round(float(A[1, 2]), 3)  # m/s^2 of the ball per rad of phi: 3/5 of gravity
        5.886
    """
    from controllers.ballplate import BallPlate

    if scenario is None:
        return BallPlate()
    return scenario_of(scenario, changes_of(settings, changes)).plant.model


LAW_ARGUMENTS = ("t", "x", "reference")
"""Arguments of the function, in this order."""


def law(function: Callable[..., Any]) -> type[Law]:
    """A law that commands what a function gives.

    Args:
        function: From time in s, state (..., 8) and reference to plate accelerations (phi'',
            theta'') in rad/s^2, shape (..., 2). Its keywords with defaults are the law's settings,
            its name is the law's.

    Raises:
        ScenarioError: If it takes other arguments, or a setting has no default.

    Examples:
        >>> import ballplate as bp
        >>> @bp.law
        ... def pd(t, x, reference, *, kp=6.0, kd=5.0):
        ...     r = reference(t)
        ...     goal = (kp * (r[0] - x[..., 0::4]) + kd * (r[1] - x[..., 1::4])) / 5.886
        ...     return 100 * (goal * [1, -1] - x[..., 2::4]) - 20 * x[..., 3::4]
        >>> pd(kp=8.0)
        pd(kp=8.0, kd=5.0)
        >>> bp.run("hold", ["plant.kind=lagrange"], controller=pd(kp=8.0), duration=0.1).outcome
        'finished'
    """
    from controllers.interfaces import Law

    parameters = inspect.signature(function).parameters
    given = [name for name, each in parameters.items() if each.kind is not each.KEYWORD_ONLY]
    settings = {name: each for name, each in parameters.items() if name not in given}
    if len(given) != len(LAW_ARGUMENTS) or any(
        each.default is each.empty for each in settings.values()
    ):
        raise ScenarioError(
            f"law: {function.__name__} must take ({', '.join(LAW_ARGUMENTS)}), and settings with "
            "defaults behind a *, as in def pd(t, x, reference, *, kp=6.0)"
        )

    def control(self: Any, t: float, x: Any, reference: Any, q: Any) -> Any:
        """Return value of the function."""
        return function(t, x, reference, **{name: getattr(self, name) for name in settings})

    fields = [  # of kp=6 as well 6.5
        (name, int | float if type(each.default) is int else type(each.default), each.default)
        for name, each in settings.items()
    ]
    made = dataclasses.make_dataclass(
        function.__name__,
        fields,
        bases=(Law,),
        namespace={
            "name": function.__name__,
            "control": control,
            "control_function": staticmethod(function),  # whose line messages name
            "__doc__": function.__doc__,
        },
        frozen=True,
        kw_only=True,
    )
    made.__module__ = function.__module__
    return made
