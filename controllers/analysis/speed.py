"""Whether an observer is faster than the loop it serves, as (7.3) demands."""

from __future__ import annotations

import numpy as np

from controllers.analysis.loops import state_feedback_loop
from controllers.interfaces import Law, Observer
from controllers.smith import Smith


def slow_observer(law: Law, observer: Observer) -> str | None:
    """One line if the observer's chosen poles are slower than the controlled system's, else None.

    None as well for an observer without chosen poles, or a law without linearisation.

    Args:
        law: Any law.
        observer: Any observer, or a Smith predictor around one.
    """
    inner = observer.observer if isinstance(observer, Smith) else observer
    chosen = getattr(inner, "poles", None)
    if chosen is None:
        return None
    try:
        controlled = state_feedback_loop(law).poles().real.max()
    except ValueError:
        return None
    slowest = max(np.real(complex(pole)) for pole in chosen)
    if slowest <= controlled:
        return None
    return (
        f"observer is slower than the loop it serves: its slowest pole is {slowest:g} 1/s, that of "
        f"the controlled system {controlled:.3g} 1/s; (7.3) wants the observer faster"
    )
