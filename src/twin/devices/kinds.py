"""Kinds of drives and touch screens that a rig file may name: shipped ones, and those of packages.

A rig file has ``[drives] kind = "akd"`` or ``[touch] kind = "own"``. An installed package adds a
kind by an entry point of the group ``ballplate.devices`` that is called ``drives.NAME`` or
``touch.NAME`` and leads to a `ServosKind` or a `ScreenKind`. Only the package of a kind that a rig
file names is imported.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, NamedTuple, Protocol

from controllers.catalog import error_words
from twin.base.errors import ScenarioError, nearest
from twin.devices.akd.config import AkdConfig, DriveSettings
from twin.devices.lumio.config import LumioConfig
from twin.devices.own import OwnServos, SeparateScreen
from twin.devices.own_config import OwnScreenConfig, OwnServosConfig
from twin.devices.own_loading import load_screen, load_servos
from twin.hal.interface import Limits, PoweredScreen, PoweredServos

DEVICE_ENTRY_POINTS = "ballplate.devices"
Role = Literal["drives", "touch"]
"""The two devices of a rig, as the tables of a rig file call them."""


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """The rig that a device is built for, as far as the device needs to know it.

    Attributes:
        period: Control period in s.
        limits: What may be commanded.
        now: Monotonic time of the rig in s; for a screen, the time of its servos.
        hear: Is given every frame on a CAN bus of the drives, as python-can has it; must not wait.
    """

    period: float
    limits: Limits
    now: Callable[[], float] = time.monotonic
    hear: Callable[[Any], None] | None = None


@dataclass(frozen=True, kw_only=True)
class ServosKind:
    """A kind of drives.

    Attributes:
        settings: Dataclass of the keys that the table ``[drives]`` may have besides ``kind``. A
            key without a default must be given. Its attribute ``relaxed``, a tuple of texts, is
            a warning in every run.
        build: Makes the servos of such settings; nothing is opened. Those of AKD drives are an
            `AkdConfig`, which has the bus and both axes as well.
        cams: Whether they are commanded rates of motors that turn the plate by cams, by the cam
            table of the rig; else rates of the plate.
    """

    settings: type
    build: Callable[[Any, Surroundings], PoweredServos]
    cams: bool = False


@dataclass(frozen=True, kw_only=True)
class ScreenKind:
    """A kind of touch screens.

    Attributes:
        settings: Dataclass of the keys that the table ``[touch]`` may have besides ``kind``, as of
            `ServosKind`.
        build: Makes the screen of such settings; nothing is opened.
    """

    settings: type
    build: Callable[[Any, Surroundings], PoweredScreen]


class Found(NamedTuple):
    """A kind, and the package that it is from.

    Attributes:
        name: What rig files call it.
        kind: The kind itself.
        package: Name and version; empty for a shipped kind.
    """

    name: str
    kind: Any
    package: str = ""


def _build_akd(settings: AkdConfig, around: Surroundings) -> PoweredServos:
    from twin.devices.akd.bus import open_bus  # noqa: PLC0415  loads python-can
    from twin.devices.akd.recording import TracedBus  # noqa: PLC0415
    from twin.devices.akd.servos import AkdServos  # noqa: PLC0415

    hear = around.hear
    if hear is None:
        return AkdServos(settings)
    return AkdServos(settings, opener=lambda config: TracedBus(open_bus(config), hear))


def _build_own_servos(settings: OwnServosConfig, around: Surroundings) -> PoweredServos:
    return OwnServos(load_servos(settings), settings, around.limits, around.period)


def _build_lumio(settings: LumioConfig, around: Surroundings) -> PoweredScreen:
    from twin.devices.lumio.screen import LumioScreen  # noqa: PLC0415

    return LumioScreen(settings, around.now)


def _build_own_screen(settings: OwnScreenConfig, _: Surroundings) -> PoweredScreen:
    return SeparateScreen(load_screen(settings), settings)


SHIPPED_KINDS: Mapping[Role, Mapping[str, ServosKind | ScreenKind]] = {
    "drives": {
        "akd": ServosKind(settings=DriveSettings, build=_build_akd, cams=True),
        "own": ServosKind(settings=OwnServosConfig, build=_build_own_servos),
    },
    "touch": {
        "lumio": ScreenKind(settings=LumioConfig, build=_build_lumio),
        "own": ScreenKind(settings=OwnScreenConfig, build=_build_own_screen),
    },
}
"""The kinds that need no other package; the first of each device is the default."""
DEFAULT_KINDS: Mapping[Role, str] = {
    role: next(iter(kinds)) for role, kinds in SHIPPED_KINDS.items()
}
_KIND_CLASSES: Mapping[Role, type] = {"drives": ServosKind, "touch": ScreenKind}
_DEVICE_PROTOCOLS: Mapping[Role, type] = {"drives": PoweredServos, "touch": PoweredScreen}


def find_kind(role: Role, name: object) -> Found:
    """The kind of a device that a rig file names.

    Args:
        role: Which device.
        name: Value of ``kind`` in the rig file.

    Raises:
        ScenarioError: If there is none of this name, several packages have one or take the name of
            a shipped one, or the package cannot be loaded: one line.
    """
    key, shipped = f"{role}.kind = {name!r}", SHIPPED_KINDS[role]
    added = _find_entry_points(role)
    claims = added.get(name, []) if isinstance(name, str) else []
    if isinstance(name, str) and name in shipped:
        if claims:
            raise ScenarioError(
                f"{key}: {_cite(claims[0])} takes the name of a kind that is shipped; uninstall "
                "it, or ask its author for a new name"
            )
        return Found(name, shipped[name])
    if not claims or not isinstance(name, str):
        known = [*shipped, *(each for each in sorted(added) if each not in shipped)]
        raise ScenarioError(f"{key}: no such kind{nearest(name, known)}")
    if len(claims) > 1:
        packages = " and ".join(map(_cite, claims))
        raise ScenarioError(f"{key}: {packages} both have that name; uninstall one of them")
    return Found(name, _load(role, key, claims[0]), _package(claims[0]))


def _find_entry_points(role: Role) -> dict[str, list[EntryPoint]]:
    """The entry points of other packages for a device, by the name of the kind."""
    found: dict[str, list[EntryPoint]] = {}
    for each in entry_points(group=DEVICE_ENTRY_POINTS):
        device, _, name = each.name.partition(".")
        if device == role and name:
            found.setdefault(name, []).append(each)
    return found


def _package(point: EntryPoint) -> str:
    """Name and version of the package of an entry point."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def _cite(point: EntryPoint) -> str:
    return f"the package {_package(point)}"


def _load(role: Role, key: str, point: EntryPoint) -> ServosKind | ScreenKind:
    """What an entry point leads to.

    Raises:
        ScenarioError: If it cannot be imported, or is no kind of this device.
    """
    try:
        found = point.load()
    except (Exception, SystemExit) as error:
        raise ScenarioError(
            f"{key}: {_cite(point)} cannot be loaded ({point.value}): {error_words(error)}"
        ) from error
    wanted = _KIND_CLASSES[role]
    if not isinstance(found, ServosKind | ScreenKind) or not isinstance(found, wanted):
        raise ScenarioError(
            f"{key}: {_cite(point)}: {point.value} must be a ballplate.hardware."
            f"{wanted.__name__}, not {type(found).__name__}"
        )
    if not (isinstance(found.settings, type) and dataclasses.is_dataclass(found.settings)):
        raise ScenarioError(f"{key}: {_cite(point)}: its settings must be a dataclass")
    return found


def build_device(role: Role, found: Found, settings: Any, around: Surroundings) -> Any:
    """The device of a kind with some settings; nothing is opened.

    Raises:
        ScenarioError: If the package of the kind cannot make it, or makes something else.
    """
    if not found.package:
        return found.kind.build(settings, around)
    what = f"{role}.kind = {found.name!r}: the package {found.package}"
    try:
        made = found.kind.build(settings, around)
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"{what} cannot make the device: {error_words(error)}") from error
    needed = _DEVICE_PROTOCOLS[role]
    lacking = [name for name in sorted(members(needed)) if not hasattr(made, name)]
    if lacking:
        raise ScenarioError(f"{what}: its device lacks {', '.join(lacking)} of {needed.__name__}")
    return made


def members(protocol: type) -> set[str]:
    """The names that an object must have to follow a protocol."""
    bases = [each for each in protocol.__mro__ if each not in (object, Protocol)]
    return {name for each in bases for name in vars(each) if not name.startswith("_")}
