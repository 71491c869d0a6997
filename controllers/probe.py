"""Whether a law answers as a law does: asked once, when it is built."""

from __future__ import annotations

import inspect

import numpy as np

from controllers.interfaces import Law
from controllers.references.point import Hold


def wrong_answer(law: Law) -> str | None:
    """Where and how the answer of a law is none, in one line; None if it is one.

    The ball rests on the centre of a level plate and shall stay. Errors that the law's own lines
    raise are theirs and come out of it; a law that commands otherwise than by ``control`` is not
    asked.
    """
    if type(law).command is not Law.command:
        return None
    asked = (0.0, np.zeros((1, 8)), Hold(), np.zeros((1, law.memory)))
    try:
        inspect.signature(law.control).bind(*asked)
    except TypeError:
        return f"{_place(law)}: control takes (self, t, x, reference, q)"
    answer = law.control(*asked)
    if np.shape(answer) != (1, 2):
        said = "None" if answer is None else f"shape {np.shape(answer)}"
        return (
            f"{_place(law)}: control must give plate accelerations of shape (..., 2), for a state "
            f"of shape (1, 8) so (1, 2); it gave {said}"
        )
    return None


def _place(law: Law) -> str:
    """File and line of a law's ``control``."""
    own = type(law).control
    return f"{inspect.getsourcefile(own)}, line {inspect.getsourcelines(own)[1]}"
