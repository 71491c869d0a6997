"""Loads hardware of one's own: the class that a rig file names, with its options.

One class may be both devices, ``backend = "my_rig.py:Arduino"`` in a rig file, or one half only:
servos, ``[drives] kind = "own"``, or a screen, ``[touch] kind = "own"``, each with its ``backend``.
"""

from __future__ import annotations

import inspect
import runpy
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from controllers.catalog import EXECUTION_LOG, error_words, failed_line
from twin.base.errors import ScenarioError
from twin.devices.own_config import OwnConfig, OwnScreenConfig, OwnServosConfig
from twin.devices.own_hardware import Hardware, OwnDevice, ScreenHardware, ServoHardware

Own = TypeVar("Own", bound="OwnDevice")


def load_backend(named: str, config: OwnConfig) -> Hardware:
    """The hardware that a rig file names, servos and screen in one; nothing is opened.

    Args:
        named: File and class, ``my_rig.py:Arduino``.
        config: Its options.

    Raises:
        ScenarioError: If there is no such class, or it cannot be made.
    """
    return _load(named, config.options, Hardware, "backend")  # type: ignore[type-abstract]


def load_servos(config: OwnServosConfig) -> ServoHardware:
    """The servos that the table ``[drives]`` names; nothing is opened.

    A class that is a screen as well serves as servos; nobody reads where it sees the ball.

    Raises:
        ScenarioError: If there is no such class, or it cannot be made.
    """
    return _load(config.backend, config.options, ServoHardware, "drives.backend")  # type: ignore[type-abstract]


def load_screen(config: OwnScreenConfig) -> ScreenHardware:
    """The screen that the table ``[touch]`` names; nothing is opened.

    Raises:
        ScenarioError: If there is no such class, it cannot be made, or it would move the plate.
    """
    key = "touch.backend"
    made = _load(config.backend, config.options, ScreenHardware, key)  # type: ignore[type-abstract]
    if isinstance(made, ServoHardware):
        raise ScenarioError(
            f"{key}: {config.backend} includes servos and would move the plate when it "
            "starts; a class for both devices is named as backend, above the tables"
        )
    return made


def _load(named: str, options: Mapping[str, Any], base: type[Own], key: str) -> Own:
    """The object of a class that a key of a rig file names."""
    file, _, name = named.rpartition(":")
    if not file.endswith(".py") or not Path(file).is_file():
        raise ScenarioError(f"{key}: {named!r} must be FILE.py:CLASS; no file {file!r}")
    EXECUTION_LOG.info("runs %s, the hardware of the rig file", file)
    sys.path.append(str(Path(file).resolve().parent))  # modules that it imports may lie there
    try:
        kind = runpy.run_path(file).get(name)
        if isinstance(kind, type) and issubclass(kind, base):
            _check_options(kind, options, key)
            return kind(**options)
    except ScenarioError:
        raise
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"{key}: {describe_error(error, file)}") from error
    raise ScenarioError(
        f"{key}: {file} has no class {name!r} derived from ballplate.hardware.{base.__name__}"
    )


def _check_options(kind: type, options: Mapping[str, Any], key: str) -> None:
    """Make sure that a class can be made with its options of the rig file.

    Raises:
        ScenarioError: If one is missing, or one too many.
    """
    signature = inspect.signature(kind)
    try:
        signature.bind(**options)
    except TypeError as error:
        where = "own.options" if key == "backend" else key.replace("backend", "options")
        takes = ", ".join(signature.parameters) or "none"
        raise ScenarioError(f"{where}: {error} (options of {kind.__name__}: {takes})") from None


def describe_error(error: BaseException, file: str) -> str:
    """File, line and error in one line; the error alone if it came from elsewhere."""
    return failed_line(error, {file}) or error_words(error)
