"""Whether a law answers as a law does: asked once, when it is built."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

from controllers.arrays import Array
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


class AnswerError(ValueError):
    """A law answers otherwise than a law does: file, line, what it must give and what it gave."""


def commanded(law: Law, u: Any, like: Array) -> Array:
    """The plate accelerations that a law gave, of the shape of an array.

    Raises:
        AnswerError: If they are none.
    """
    if getattr(u, "shape", None) != like.shape or u.dtype.kind not in "fi":
        method = "control" if type(law).command is Law.command else "command"
        raise _wrong(law, method, "plate accelerations (..., 2)", u, like)
    answer: Array = u
    return answer


def remembered(law: Law, slope: Any, like: Array) -> Array:
    """The rate of a law's memory that it gave, of the shape of an array.

    Raises:
        AnswerError: If it is none.
    """
    if np.shape(slope) != like.shape or np.iscomplexobj(slope):
        raise _wrong(law, "memory_rate", "the rate of the memory (..., memory)", slope, like)
    answer: Array = slope
    return answer


def _wrong(law: Law, method: str, what: str, given: Any, expected: Array) -> AnswerError:
    kind = "complex numbers of " if np.iscomplexobj(given) else ""
    said = "None" if given is None else f"{kind}shape {np.shape(given)}"
    return AnswerError(
        f"{_place(law, method)}: {method} must give {what}, here real numbers of shape "
        f"{expected.shape}; it gave {said}"
    )


def _place(law: Law, method: str = "control") -> str:
    """File and line of a law's method; of one that holds another's command, of that."""
    while hasattr(law, "law"):
        law = law.law
    own = getattr(type(law), method)
    return f"{inspect.getsourcefile(own)}, line {inspect.getsourcelines(own)[1]}"
