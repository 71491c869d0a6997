"""What is said of a law that does not answer as one."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from controllers.catalog import wrong_answer
from controllers.interfaces import Law


def law(answer):
    @dataclass(frozen=True, kw_only=True)
    class Own(Law):
        name: ClassVar[str] = "own"

        def control(self, t, x, reference, q):
            return answer

    return Own()


@dataclass(frozen=True, kw_only=True)
class Short(Law):
    name: ClassVar[str] = "short"

    def control(self, t, x):
        return np.zeros((*x.shape[:-1], 2))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (law(np.zeros(3)), "it gave shape (3,)"),
        (law(None), "it gave None"),
        (Short(), "control takes (self, t, x, reference, q)"),
    ],
    ids=["shape", "none", "signature"],
)
def test_a_law_that_does_not_answer_is_one_line_with_its_own_file(wrong, says):
    found = wrong_answer(wrong)
    assert found.startswith(f"{__file__}, line ")
    assert found.endswith(says)


def test_a_law_that_answers_is_not_spoken_of():
    assert wrong_answer(law(np.zeros((1, 2)))) is None
