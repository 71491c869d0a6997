"""A control law out of a function: the shortest way to one's own."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from twin.errors import ScenarioError

if TYPE_CHECKING:
    from controllers.interfaces import Law

GIVEN = ("t", "x", "reference")
"""What the function is given, in this order."""


def law(function: Callable[..., Any]) -> type[Law]:
    """A law that commands what a function gives.

        @bp.law
        def pd(t, x, reference, *, kp=6.0, kd=5.0):
            r = reference(t)
            goal = (kp * (r[0] - x[..., 0::4]) + kd * (r[1] - x[..., 1::4])) / 5.886
            return 100 * (goal * [1, -1] - x[..., 2::4]) - 20 * x[..., 3::4]

        bp.run("circle", controller=pd)

    Args:
        function: From time in s, state (..., 8) and reference to plate accelerations (phi'',
            theta'') in rad/s^2, shape (..., 2). Its keywords with defaults are the law's settings,
            its name is the law's.

    Raises:
        ScenarioError: If it takes other arguments, or a setting has no default.
    """
    from dataclasses import make_dataclass

    from controllers.interfaces import Law

    parameters = inspect.signature(function).parameters
    given = [name for name, each in parameters.items() if each.kind is not each.KEYWORD_ONLY]
    settings = {name: each for name, each in parameters.items() if name not in given}
    if len(given) != len(GIVEN) or any(each.default is each.empty for each in settings.values()):
        raise ScenarioError(
            f"law: {function.__name__} must take ({', '.join(GIVEN)}), and settings with defaults "
            "behind a *, as in def pd(t, x, reference, *, kp=6.0)"
        )

    def control(self: Any, t: float, x: Any, reference: Any, q: Any) -> Any:
        """What the function gives."""
        return function(t, x, reference, **{name: getattr(self, name) for name in settings})

    fields = [(name, type(each.default), each.default) for name, each in settings.items()]
    made = make_dataclass(
        function.__name__,
        fields,
        bases=(Law,),
        namespace={"name": function.__name__, "control": control, "__doc__": function.__doc__},
        frozen=True,
        kw_only=True,
    )
    made.__module__ = function.__module__
    return made
