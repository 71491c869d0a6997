"""Tests of `twin.base.page`."""

import re
from io import StringIO

import pytest
from rich.console import Console

from twin.base.page import (
    Code,
    Picture,
    Table,
    Text,
    Verdict,
    digits,
    html,
    markdown,
    render_template,
    terminal,
)

NAMES = [f"law_number_{number}" for number in range(12)]
BROAD = Table(
    "Laws <all>",
    ("indicator", *NAMES, "unit"),
    [("error", *(f"{at}.25" for at in range(12)), "mm")],
    words=(0, -1),
)


def test_a_page_has_every_cell_once_and_words_to_the_left():
    page = html("", [BROAD])
    assert page.count("<table>") == 1
    heads, row = re.findall(r"<tr>(.*?)</tr>", page)
    cells = re.findall(r"<th( class=\"words\")?>(.*?)</th>", heads)
    assert [text for _, text in cells] == ["indicator", *NAMES, "unit"]
    assert [bool(words) for words, _ in cells] == [True, *[False] * 12, True]
    assert re.findall(r"<td(?: class=\"words\")?>(.*?)</td>", row) == [*BROAD.rows[0]]


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


def test_a_bar_in_a_cell_of_markdown_ends_no_column() -> None:
    assert markdown(("|x|", "b"), [("|a", "1")]) == "| \\|x\\| | b |\n|---|--:|\n| \\|a | 1 |\n"


def test_what_somebody_else_wrote_commands_no_terminal():
    written = StringIO()
    cells = ("\x1b[2Jaway", "two\nlines", "\u202egnp", "\x9b1m", "\udcff", "a\rb")
    table = Table("", ("one",), [(cell,) for cell in cells])
    Console(file=written, width=60, force_terminal=True, color_system=None).print(terminal(table))
    said = re.sub(r"\x1b\[[01]m", "", written.getvalue())  # the heading is bold
    assert not set("\x1b\x9b\u202e\r\udcff") & set(said)
    for shown in ("\\x1b[2Jaway", "two", "lines", "\\u202egnp", "\\x9b1m", "\\udcff", "a\\rb"):
        assert shown in said


@pytest.mark.parametrize(("count", "text"), [(0, "0 logs were"), (1, "1 log was")])
def test_a_template_counts_one_thing_in_the_singular(tmp_path, count, text):
    template = tmp_path / "page.template.md"
    template.write_text('{{ plural(count, "log was", "logs were") }} refused')
    assert render_template(template, count=count) == f"{text} refused"
