"""Hardware of one's own: a class that a rig file names, or a kind of devices in a package.

Derive from ``Hardware`` for servos and screen in one, from ``ServoHardware`` or ``ScreenHardware``
for one half. A package gives a ``ServosKind`` or a ``ScreenKind`` to an entry point of the group
``ballplate.devices``, and makes devices that follow ``PoweredServos`` or ``PoweredScreen``; what
they report is a ``Fault`` of a ``Condition``.

`docs/your-rig.md` leads from unpacking to a run, `docs/extending.md` to a package.
"""

from twin.devices.kinds import ScreenKind, ServosKind, Surroundings
from twin.devices.own_hardware import Hardware, Reading, ScreenHardware, ServoHardware
from twin.hal.interface import Condition, Fault, PoweredScreen, PoweredServos, Severity, Touch

__all__ = [
    "Condition",
    "Fault",
    "Hardware",
    "PoweredScreen",
    "PoweredServos",
    "Reading",
    "ScreenHardware",
    "ScreenKind",
    "ServoHardware",
    "ServosKind",
    "Severity",
    "Surroundings",
    "Touch",
]
