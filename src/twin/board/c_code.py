"""C functions from CasADi expressions.

CasADi's own generator is not used: it calls the functions of ``double`` in code for ``float`` (see
``findings/casadi_single_precision_calls_double.sh``), its signatures have unused parameters, and it
writes constants as bare numbers. The graph is CasADi's, with equal terms calculated once.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca

REALS = {"double": "", "float": "f"}
"""Types of numbers, and what ends a constant and a function of ``math.h`` of that type."""
MAX_INLINE = 48
"""Maximum length in characters of a term that is written in place, if it is used once."""

_COMPARISONS = {"OP_LT": "({} < {})", "OP_LE": "({} <= {})", "OP_NE": "({} != {})"}
_LOGIC = {"OP_AND": "({} && {})", "OP_OR": "({} || {})", "OP_NOT": "(!{})"}
_FORMS = _COMPARISONS | {
    "OP_ADD": "({} + {})",
    "OP_SUB": "({} - {})",
    "OP_MUL": "({} * {})",
    "OP_DIV": "({} / {})",
    "OP_POW": "pow§({}, {})",
    "OP_CONSTPOW": "pow§({}, {})",
    "OP_FMIN": "({1} < {0} ? {1} : {0})",
    "OP_FMAX": "({1} > {0} ? {1} : {0})",
    "OP_NEG": "(-{0})",
    "OP_SQ": "({0} * {0})",
    "OP_TWICE": "({0} + {0})",
    "OP_INV": "(1 / {0})",
    "OP_SQRT": "sqrt§({0})",
    "OP_SIN": "sin§({0})",
    "OP_COS": "cos§({0})",
    "OP_TAN": "tan§({0})",
    "OP_ASIN": "asin§({0})",
    "OP_FABS": "fabs§({0})",
    "OP_SIGN": "(real)(({0} > 0) - ({0} < 0))",
}
"""What CasADi's operations are in C; the ending of the type replaces the sign of a paragraph."""
_REPEATED = {"OP_SQ", "OP_TWICE", "OP_FMIN", "OP_FMAX", "OP_SIGN"}
"""Operations that have an operand twice in C, which must then be a name."""
OPERATIONS = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}


class Constant(NamedTuple):
    """A named table of constants in the C source.

    Attributes:
        name: Its name in C.
        values: Its numbers, in the order of the symbols.
        meaning: In a sentence, with the unit.
        symbols: The CasADi symbols of its numbers, a column.
        scalar: Whether it is one number and no table.
    """

    name: str
    values: Sequence[float]
    meaning: str
    symbols: Any
    scalar: bool = False


class _Term(NamedTuple):
    """A term in C: its text, whether it is a truth value, and whether it is a name or number."""

    text: str
    truth: bool = False
    simple: bool = True


def number(value: float, real: str) -> str:
    """A number in C, with its type's ending; every digit that the type needs.

    Raises:
        ValueError: If it is not a number.
    """
    if math.isnan(value):
        raise ValueError(f"{value} is no constant")
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    text = repr(float(value)) if real == "double" else f"{value:.9g}"
    if not re.search(r"[.e]", text):
        text += ".0"
    return text + REALS[real]


def c_function(
    name: str,
    inputs: Mapping[str, Any],
    outputs: Mapping[str, Sequence[Any]],
    constants: Sequence[Constant],
    real: str,
) -> str:
    """A static C function of arrays.

    Args:
        name: Its name.
        inputs: Columns of symbols by the names of its arguments.
        outputs: Expressions by the names of the arrays that it fills; no two arguments may overlap.
        constants: Named tables of which the expressions may have symbols.
        real: ``double`` or ``float``.

    Raises:
        ValueError: If an operation has no form in C.
    """
    given = [*inputs.values(), *(each.symbols for each in constants)]
    results = [
        ca.densify(each) for each in ca.cse([ca.vertcat(*each) for each in outputs.values()])
    ]
    graph = ca.Function("graph", given, results)
    names = [[f"{each}[{i}]" for i in range(len(ca.vertsplit(inputs[each])))] for each in inputs]
    for each in constants:
        whole = (
            [each.name] if each.scalar else [f"{each.name}[{i}]" for i in range(len(each.values))]
        )
        names.append(whole)
    body = "\n".join(_Body(graph, names, list(outputs), real).lines)
    arguments = [f"const real {each}[]" for each in inputs]
    arguments += [f"real {each}[]" for each in outputs]
    unused = [each for each in inputs if not re.search(rf"\b{each}\[", body)]
    ignored = "".join(f"    (void){each};\n" for each in unused)
    return f"static void {name}({', '.join(arguments)})\n{{\n{ignored}{body}\n}}\n"


class _Body:
    """The statements of a C function.

    Args:
        graph: The CasADi function.
        names: Names in C of the numbers of each of its inputs.
        filled: Names of the arrays that it fills.
        real: ``double`` or ``float``.
    """

    def __init__(
        self, graph: Any, names: Sequence[Sequence[str]], filled: Sequence[str], real: str
    ) -> None:
        self.lines = list[str]()
        self._graph, self._names, self._filled, self._real = graph, names, filled, real
        self._uses = _count_uses(graph)
        terms, stores = dict[int, _Term](), list[str]()
        for i in range(graph.n_instructions()):
            operands, targets = graph.instruction_input(i), graph.instruction_output(i)
            operation = OPERATIONS[graph.instruction_id(i)]
            if operation == "OP_OUTPUT":
                result, index = targets
                text = _strip_brackets(_as_real(terms[operands[0]]))
                stores.append(f"    {filled[result]}[{index}] = {text};")
            else:
                terms[targets[0]] = self._term(i, operation, operands, terms)
        self.lines += stores

    def _term(
        self, i: int, operation: str, operands: Sequence[int], terms: Mapping[int, _Term]
    ) -> _Term:
        """The term of an instruction; a long one, or one used twice, gets a name of its own."""
        if operation == "OP_INPUT":
            source, index = operands
            return _Term(self._names[source][index])
        if operation == "OP_CONST":
            return _Term(number(self._graph.instruction_constant(i), self._real))
        of = [terms[each] for each in operands]
        if operation in _REPEATED:
            of = [each if each.simple else self._keep(each.text, each.truth) for each in of]
        truth = operation in _COMPARISONS or operation in _LOGIC
        if operation == "OP_IF_ELSE_ZERO":
            text = f"({_as_truth(of[0])} ? {_as_real(of[1])} : 0)"
        elif operation in _LOGIC:
            text = _LOGIC[operation].format(*map(_as_truth, of))
        elif operation in _FORMS:
            text = _FORMS[operation].format(*map(_as_real, of)).replace("§", REALS[self._real])
        else:
            raise ValueError(f"operation {operation} has no form in C")
        if self._uses[i] == 1 and len(text) <= MAX_INLINE:
            return _Term(text, truth, simple=False)
        return self._keep(text, truth)

    def _keep(self, text: str, truth: bool) -> _Term:
        name, kind = f"w{len(self.lines)}", "int" if truth else "real"
        self.lines.append(f"    const {kind} {name} = {_strip_brackets(text)};")
        return _Term(name, truth)


def _count_uses(graph: Any) -> Counter[int]:
    """How often the value of each instruction is used; registers hold several in turn."""
    uses, holder = Counter[int](), dict[int, int]()
    for i in range(graph.n_instructions()):
        operation = OPERATIONS[graph.instruction_id(i)]
        if operation not in {"OP_INPUT", "OP_CONST"}:
            uses.update(holder[each] for each in graph.instruction_input(i))
        if operation != "OP_OUTPUT":
            holder[graph.instruction_output(i)[0]] = i
    return uses


def _strip_brackets(text: str) -> str:
    """A term without the brackets around the whole of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if place == len(text) - 1 else text
    return text


def _as_real(term: _Term) -> str:
    return f"(real){term.text}" if term.truth else term.text


def _as_truth(term: _Term) -> str:
    return term.text if term.truth else f"({term.text} != 0)"
