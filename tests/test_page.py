from io import StringIO

import pytest
from rich.console import Console

from twin.page import WIDE, Code, Picture, Table, Text, Verdict, digits, html, markdown, terminal

NAMES = [f"law_number_{number}" for number in range(12)]
BROAD = Table(
    "Laws <all>",
    ("indicator", *NAMES, "unit"),
    [("error", *(f"{at}.25" for at in range(12)), "mm")],
    words=(0, -1),
    again=(0, -1),
)


def test_a_table_too_wide_for_a_page_goes_on_below_with_every_column_once():
    parts = list(BROAD.parts)
    assert len(parts) > 1
    heads = [[text for text, _ in head] for head, _ in parts]
    assert [each[0] for each in heads] == ["indicator"] * len(parts)
    assert [each[-1] for each in heads] == ["unit"] * len(parts)
    assert [text for each in heads for text in each[1:-1]] == NAMES
    for head, (row,) in parts:
        assert sum(max(len(a), len(b)) for (a, _), (b, _) in zip(head, row, strict=True)) <= WIDE
        assert [words for _, words in head] == [words for _, words in row]
        assert [words for _, words in row][:2] == [True, False]


def test_a_narrow_table_is_one():
    assert len(list(Table("", ("a", "b"), [("1", "2")]).parts)) == 1
    assert len(list(Table("", ("only",), [("x",)]).parts)) == 1


def test_words_are_broken_over_lines_before_a_table_is():
    rows = [("rolling", "0.13", "why " * 40)]
    assert len(list(Table("", ("name", "value", "remark"), rows, words=(0, 2)).parts)) == 1
    assert len(list(Table("", ("name", "value", "remark"), rows).parts)) == 2


def test_the_same_blocks_are_a_page_and_a_terminals_table():
    blocks = [
        Verdict(["It went <well>."], good=False, title="run"),
        BROAD,
        Text(["first", "second"], "Said", note="so"),
        Code("law.py", "a < b"),
        Picture("What it did", b"png"),
    ]
    page = html("Title", blocks)
    for text in ("&lt;well&gt;", 'class="verdict bad"', "<li>second</li>", "a &lt; b", "base64"):
        assert text in page
    assert all(name in page for name in NAMES)
    console = Console(width=140, file=StringIO())
    console.print(terminal(BROAD))
    assert "11.25" in console.file.getvalue()


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(None, "mm", "-"), (float("nan"), "", "-"), (0.012345, "mm", "12.3"), (12.3456, "%", "12.35")],
)
def test_values_have_the_digits_a_person_reads(value, unit, text):
    assert digits(value, unit) == text


def test_a_table_has_words_to_the_left_numbers_to_the_right_and_an_empty_line_after_it():
    text = markdown(("name", "a", "remark"), [("x", "1", "good"), ("y", "2", "")], words=(0, -1))
    assert text.splitlines() == [
        "| name | a | remark |",
        "|---|--:|---|",
        "| x | 1 | good |",
        "| y | 2 |  |",
    ]
    assert "\n".join([text, "next"]).endswith("|\n\nnext")
    assert markdown(("a", "b", "c"), []) == "| a | b | c |\n|---|--:|--:|\n"
