"""Answers that are equal or nearly so, and values in an answer that belong to a fellow student.

They are named to the lecturer and cost no points: who had what from whom is not in a file.
"""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import SequenceMatcher
from itertools import combinations
from keyword import iskeyword
from typing import NamedTuple

from twin.base.data_file import DataError, read_regular
from twin.lab.deals import deal
from twin.lab.handed_in import Submission
from twin.lab.handing_out import fill_answer
from twin.lab.schema import Lab
from twin.lab.words import words

LAYOUT_TOKENS = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
    tokenize.STRING,
}
"""Tokens that change nothing of what a program computes, and texts."""
TOKEN_PATTERN = re.compile(r"[A-Za-z_]\w*|\d[\w.]*|[^\w\s]")
"""A token of a file that is no Python, or none that can be read."""
NAME_TOKEN = "name"
"""Stands for every name, so that renaming a variable makes no difference."""


@dataclass(frozen=True, kw_only=True)
class Likeness:
    """When two answers are alike.

    Attributes:
        ratio: Smallest share of equal tokens, as ``SequenceMatcher.ratio`` has it, of what two
            students added to the starter.
        min_tokens: Smallest number of tokens that each of them added: two short additions may be
            nearly equal by chance.
        digits: Smallest number of significant digits of a value that identifies its student.
    """

    ratio: float = 0.95
    min_tokens: int = 30
    digits: int = 5


LIKENESS = Likeness()


class Alike(NamedTuple):
    """Two answers that are alike, or an answer with a value of a fellow student.

    Attributes:
        kind: ``same`` file, ``near`` to each other, or a ``value``.
        one: A student.
        other: The other student; of a value, the student with that rig.
        detail: The share of equal tokens in percent, or the value.
    """

    kind: str
    one: str
    other: str
    detail: str = ""

    def text(self, language: str) -> str:
        """It in words of a language."""
        return words(language)(self.kind, one=self.one, other=self.other, detail=self.detail)


def tokens_of(text: str, *, python: bool = True) -> list[str]:
    """The tokens of an answer without layout, comments and texts, every name replaced by one."""
    found = TOKEN_PATTERN.findall(text)
    if python:
        with suppress(tokenize.TokenError, SyntaxError):
            every = tokenize.generate_tokens(io.StringIO(text).readline)
            found = [each.string for each in every if each.type not in LAYOUT_TOKENS]
    names = re.compile(r"[^\W\d]\w*")
    return [NAME_TOKEN if names.fullmatch(each) and not iskeyword(each) else each for each in found]


def added_to(starter: Sequence[str], answer: Sequence[str]) -> list[str]:
    """The tokens of an answer that are not those of the starter."""
    matcher = SequenceMatcher(None, starter, answer, autojunk=False)
    return [
        token
        for kind, _, _, begin, end in matcher.get_opcodes()
        if kind in ("insert", "replace")
        for token in answer[begin:end]
    ]


def likeness(one: Sequence[str], other: Sequence[str], least: float) -> float:
    """The share of equal tokens of two answers; 0 if it is certainly below a least one."""
    matcher = SequenceMatcher(None, one, other, autojunk=False)
    bounds = (matcher.real_quick_ratio, matcher.quick_ratio)
    return matcher.ratio() if all(bound() >= least for bound in bounds) else 0.0


def find_alike(
    lab: Lab,
    key: str | None,
    people: Collection[str],
    handed_in: Sequence[Submission],
    how: Likeness = LIKENESS,
) -> list[Alike]:
    """Equal and near-equal answers of a class, and values that belong to a fellow student.

    Args:
        lab: The lab.
        key: The key of the course.
        people: Further students of the class; their values are searched for as well.
        handed_in: The submissions.
        how: When two answers are alike.
    """
    texts = dict[str, str]()
    for each in handed_in:
        if each.named and not each.problem:
            with suppress(DataError):
                texts[each.student] = read_regular(each.answer).decode(errors="replace")
    students = sorted({*texts, *people})
    known = {student: deal(lab, student, key).known for student in students}
    return [*_pairs(lab, texts, known, how), *_values_of_others(texts, known, how)]


def _pairs(
    lab: Lab, texts: Mapping[str, str], known: Mapping[str, Mapping[str, object]], how: Likeness
) -> Iterator[Alike]:
    """Students with answers that are alike, in pairs; an unchanged starter does not count."""
    python = lab.answer.file.endswith(".py")
    own = lab.answer.file
    template = lab.text(own) if (lab.folder / own).is_file() else ""  # a lab may have no starter
    given = tokens_of(template, python=python)
    added = {
        student: []
        if text in (template, fill_answer(template, known[student]))
        else added_to(given, tokens_of(text, python=python))
        for student, text in texts.items()
    }
    for one, other in combinations(sorted(texts), 2):
        if not (added[one] and added[other]):
            continue
        if texts[one] == texts[other]:
            if lab.family is not None or not lab.answer.data:  # else all have the same solution
                yield Alike("same", one, other)
        elif not lab.answer.data and min(len(added[one]), len(added[other])) >= how.min_tokens:
            share = likeness(added[one], added[other], how.ratio)
            if share >= how.ratio:
                yield Alike("near", one, other, f"{100 * share:.0f}")


def _values_of_others(
    texts: Mapping[str, str], known: Mapping[str, Mapping[str, object]], how: Likeness
) -> Iterator[Alike]:
    """Numbers of an answer that were given to a fellow student, and not to its own."""
    given = {
        student: [value for value in values.values() if isinstance(value, float)]
        for student, values in known.items()
    }
    for student, text in texts.items():
        numbers = set(re.findall(r"\d+\.\d+(?:[eE][-+]?\d+)?", text))
        for number in sorted(numbers):
            mantissa = number.lower().partition("e")[0].replace(".", "").lstrip("0")
            if len(mantissa) < how.digits:
                continue
            owners = [
                owner
                for owner, values in given.items()
                if any(
                    f"{abs(each):.{len(mantissa) - 1}e}" == format_exponential(number, mantissa)
                    for each in values
                )
            ]
            if owners and student not in owners:
                yield from (Alike("value", student, owner, number) for owner in owners)


def format_exponential(number: str, mantissa: str) -> str:
    """A number in the form of ``e`` with all its digits."""
    return f"{float(number):.{len(mantissa) - 1}e}"
