"""`twin.board.symbols`: the arithmetic of symbols gives the numbers of the others."""

import casadi as ca
import numpy as np
import pytest

from controllers.arrays import ARRAY_ARITHMETIC, NUMBER_ARITHMETIC, arithmetic_of
from twin.board.symbols import (
    SYMBOL_ARITHMETIC,
    NoSymbolicFormError,
    Setting,
    expressions,
    new_symbols,
)

NUMBERS = (-1.5, 0.0, 0.3, 2.0)


def value(symbol, column, numbers):
    return float(ca.Function("f", [column], expressions([symbol]))(ca.DM(numbers)))


@pytest.mark.parametrize("a", NUMBERS)
@pytest.mark.parametrize("b", NUMBERS)
def test_formulas_of_symbols_are_those_of_numbers(a, b):
    def formula(by, one, two):
        smaller, larger = by.least(one, two), by.most(one, two)
        chosen = by.where((one < two) & (one != 0.3), by.sin(one), by.cos(two))
        return chosen + smaller * 3 - larger / 7 + by.sqrt(one * one + two * two)

    column, (x, y) = new_symbols("x", 2)
    expected = formula(NUMBER_ARITHMETIC, a, b)
    assert value(formula(SYMBOL_ARITHMETIC, x, y), column, [a, b]) == pytest.approx(expected)
    assert formula(ARRAY_ARITHMETIC, np.array([a]), np.array([b])) == pytest.approx(expected)


def test_what_is_not_known_leaves_nothing_out():
    _, (x,) = new_symbols("x", 1)
    assert SYMBOL_ARITHMETIC.any(x > 0)
    assert not SYMBOL_ARITHMETIC.all(x > 0)
    assert not SYMBOL_ARITHMETIC.any(False & (x > 0))
    assert SYMBOL_ARITHMETIC.all(True)
    with pytest.raises(NoSymbolicFormError, match="known at run time only"):
        bool(x > 0)


def test_a_setting_that_is_a_symbol_decides_a_branch_and_what_follows_from_it_does_not():
    _, (setting,) = new_symbols("setting", 1, kind=Setting)
    assert setting
    with pytest.raises(NoSymbolicFormError):
        bool(setting - 1)


def test_a_symbol_chooses_between_arrays_of_numbers():
    column, (x,) = new_symbols("x", 1)
    chosen = np.where(x > 0, np.array([1.0, 2.0]), 3.0)
    assert [value(each, column, [1.0]) for each in chosen] == [1.0, 2.0]
    assert [value(each, column, [-1.0]) for each in chosen] == [3.0, 3.0]


def test_the_arithmetic_is_that_of_the_rows():
    assert arithmetic_of(np.zeros((1, 3))) is NUMBER_ARITHMETIC
    assert arithmetic_of(np.zeros((2, 3))) is ARRAY_ARITHMETIC
    assert arithmetic_of(new_symbols("x", 1, 3)[1]) is SYMBOL_ARITHMETIC
