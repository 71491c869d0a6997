"""A digital twin of a cam-driven ball-and-plate rig, for scripts and notebooks.

Runs: ``run``, ``compare``, ``sweep``, ``study``; they do what the commands of these names do, bit
for bit. Rigs drawn from a family: ``family``. What was recorded: ``load``, ``identify``; what a run
would tell: ``plan_experiment``. A rig to step with a controller of one's own: ``rig``; a control
law out of a function: ``law``. The model behind it: ``model``, and the classes of ``laws``,
``observers``, ``references``; plants and controllers for python-control: ``systems``; a rig for
Simulink and others: ``fmu``; a drive for simulated CAN buses: ``drive_fmu``; a controller in C for
a board: ``controller_source``, as an FMU: ``controller_fmu``; the equations as CasADi symbols:
``symbolic``. What there is to run and to set: ``scenarios``, ``describe``.

SI units; the last axis of an array is the vector, all leading axes are rigs or instants. A mistake
is a ``TwinError`` of one line: what, where, and what is allowed. Importing this package loads no
numerical library: what works with one loads it when called.

Examples:
    >>> import ballplate as bp
    >>> result = bp.run("circle", controller={"kind": "lqr"}, duration=2)
    >>> result.outcome
    'finished'
    >>> f"{result.metrics['tracking_error_percent']:.0f} %"
    '100 %'
    >>> figure = result.plot()  # path of the ball, error, plate angles, effort
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast
from warnings import warn

from ballplate import own as own
from ballplate.changes import Changes, Keys, describe, law, model, scenarios
from ballplate.reporter import BallplateWarning, Reporter
from ballplate.running import run
from twin.base.errors import TwinError
from twin.run.exporters import Signals

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec
    from types import ModuleType

    from ballplate import lab, laws, observers, references, systems
    from ballplate.comparing import compare
    from ballplate.comparison import Comparison, load
    from ballplate.identifying import Identified, identify
    from ballplate.planning import Planned, plan_experiment
    from ballplate.results import Log, Result
    from ballplate.rigs import Rig, controller_fmu, controller_source, drive_fmu, fmu, rig
    from ballplate.solvers import Symbolic, symbolic
    from ballplate.studies import StudyResult, family, study
    from ballplate.sweeps import Sweep, sweep

__all__ = [
    "BallplateWarning",
    "Changes",
    "Comparison",
    "Identified",
    "Keys",
    "Log",
    "Planned",
    "Reporter",
    "Result",
    "Rig",
    "Signals",
    "StudyResult",
    "Sweep",
    "Symbolic",
    "TwinError",
    "compare",
    "controller_fmu",
    "controller_source",
    "describe",
    "drive_fmu",
    "family",
    "fmu",
    "identify",
    "lab",
    "law",
    "laws",
    "load",
    "model",
    "observers",
    "plan_experiment",
    "references",
    "rig",
    "run",
    "scenarios",
    "study",
    "sweep",
    "symbolic",
    "systems",
]

_LAZY_MODULES = ("gym", "lab", "laws", "observers", "references", "systems")
"""Modules that load numpy, and so are loaded when they are named."""
_LAZY_NAMES = {
    "comparing": ("compare",),
    "comparison": ("Comparison", "load"),
    "identifying": ("Identified", "identify"),
    "planning": ("Planned", "plan_experiment"),
    "results": ("Log", "Result"),
    "rigs": ("Rig", "controller_fmu", "controller_source", "drive_fmu", "fmu", "rig"),
    "solvers": ("Symbolic", "symbolic"),
    "studies": ("StudyResult", "family", "study"),
    "sweeps": ("Sweep", "sweep"),
}
"""Modules that not every program needs, and what is in them."""


# Both have the methods of the classes in importlib.abc, which each start would otherwise import.
class _RegisterAfterwards:
    """Loads gymnasium by its own loader, then registers the environments."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        # gymnasium's own loader knows its files and sources
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        try:
            import_module("ballplate.gym")
        except Exception as error:  # noqa: BLE001  gymnasium itself must load whatever it is
            warn(f"ballplate's environments are not registered: {error}", stacklevel=2)


class _EnvironmentsWithGymnasium:
    """Registers the environments as soon as gymnasium is loaded, which reads no entry points."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        others = sys.meta_path[sys.meta_path.index(self) + 1 :]
        found = (
            each.find_spec(name, path, target) for each in others if hasattr(each, "find_spec")
        )
        spec = next((each for each in found if each is not None), None)
        if spec is not None and spec.loader is not None:
            spec.loader = cast("Loader", _RegisterAfterwards(spec.loader))
        return spec


if "gymnasium" in sys.modules:
    import_module("ballplate.gym")
elif not any(type(each).__name__ == _EnvironmentsWithGymnasium.__name__ for each in sys.meta_path):
    sys.meta_path.insert(0, _EnvironmentsWithGymnasium())


def __getattr__(name: str) -> Any:
    if name in _LAZY_MODULES:
        return import_module(f"ballplate.{name}")
    for module, names in _LAZY_NAMES.items():
        if name in names:
            return getattr(import_module(f"ballplate.{module}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
