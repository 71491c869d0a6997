"""Tables in files of any program: their columns, with or without a header, and numbers of cells."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError, plural, suggest
from twin.base.foreign import decode_text
from twin.identify.cells import (
    BLANK_CELLS,
    LIST_CELL,
    NUMBER,
    NUMBER_WITH_UNIT,
    is_number,
    is_time,
    parse_numbers,
)
from twin.identify.clocks import MILLISECONDS, pair_seconds
from twin.identify.column_names import suggest_kinds
from twin.identify.log_columns import ROLE_UNITS, ROW_NAME, ColumnWanted
from twin.identify.text_forms import plain_lines, split_at_blanks
from twin.run.foreign_logs import foreign_table
from twin.run.logs import NEEDED_COLUMNS, SECOND_AXIS_COLUMNS
from twin.run.readers import ForeignTable
from twin.run.units import is_unit, split_unit, with_unit

SEPARATOR_NAMES = {
    "tab": "\t",
    "\\t": "\t",
    "space": " ",
    "comma": ",",
    "semicolon": ";",
    "pipe": "|",
}
"""Names of separators that a command line may give instead of the sign."""
UNITS_OF_EXAMPLES = {"m": "mm", "rad": "deg", "s": "ms", "1": "1"}
"""SI unit to the unit that an example of an option has."""
FEW_ODD_ROWS = 0.02
"""Up to this share of rows, a row with a different number of cells counts as damaged."""
MIN_SHARE_OF_UNITS = 0.8
"""Share of the cells of a column that have to have its unit."""
VALUE_NAME_COLUMNS = frozenset(
    ("signal", "name", "variable", "channel", "key", "field", "topic", "metric", "label", "kanal")
)
"""Names of a column with the name of what a row is of, in small letters."""
VALUE_COLUMNS = frozenset({"value", "val", "wert", "data", "reading"})
"""Names of the column with its value."""
MIN_UNIX_TIME_S, MAX_UNIX_TIME_S = 1e9, 4e9
"""From and to which time since 1970 in s a log is assumed to be, from 2001 to 2096."""
MIN_NANOSECONDS = 1e8
"""Least largest number of nanoseconds, which smaller whole numbers are not."""
MAX_NAME_ROWS = 3
"""Rows above the numbers of which one may have the names, and one the units."""
MAX_PIVOTED = 50
"""Largest number of names for which one of them is taken for a column."""
MAX_CUT_ROWS = 0.2
"""The same of rows with several different numbers of cells, as of a line that loses letters."""


def open_content(path: Path) -> ForeignTable | str:
    """The table of a file of one of ``foreign_logs.READERS_BY_KIND``, or else its text.

    Raises:
        TwinError: If it cannot be read.
    """
    try:
        table = foreign_table(path)
        return decode_text(path.read_bytes()) if table is None else table
    except OSError as error:
        raise LogError(f"{path.name}: cannot be read: {error.strerror or error}") from error


def split_content(
    source: str,
    content: ForeignTable | str,
    wanted: Mapping[str, ColumnWanted],
    separator: str | None = None,
) -> tuple[list[str], list[Array | list[str]], dict[int, Array], list[str]]:
    """Every column of a log.

    Args:
        source: What to call the file in messages.
        content: Its table or its text.
        wanted: Role to column; names that may be in the header.
        separator: Between columns of text; None to find it.

    Returns:
        Headers, empty of a text without them; numbers or texts of each column; number of a column
        to its own times in s; notes.

    Raises:
        LogError: If a text is empty, or its header does not fit its rows.
    """
    if isinstance(content, str):
        header, cells, notes = _split_columns(source, content, wanted, separator)
        return header, cells, {}, notes
    header = [with_unit(name, content.units.get(name)) for name in content.columns]
    clocks = {k: content.clocks[n] for k, n in enumerate(content.columns) if n in content.clocks}
    return header, list(content.columns.values()), clocks, list(content.notes)


def has_known_columns(source: str, content: ForeignTable | str) -> bool:
    """Whether a log has the columns of one axis by the names that this program knows.

    Args:
        source: What to call the file in messages.
        content: Its table or its text.

    Raises:
        LogError: If a text is empty, or its header does not fit its rows.
    """
    known = {name: ColumnWanted(name, "", 1.0) for name in NEEDED_COLUMNS}
    header, *_ = split_content(source, content, known)
    names = {split_unit(each)[0] for each in header}
    axes = (NEEDED_COLUMNS[1:3], SECOND_AXIS_COLUMNS)
    return "time" in names and any(names >= set(each) for each in axes)


def find_column(source: str, header: list[str], role: str, column: ColumnWanted) -> tuple[int, str]:
    """Place of a column, and the unit that the header gives it.

    Args:
        source: What to call the file in messages.
        header: The names of its columns; empty without any.
        role: What the column is wanted for, in messages.
        column: The column; a name in the header, with or without its unit, or a number.

    Returns:
        Index from 0, and the unit; empty if the header gives none.

    Raises:
        LogError: If no column has this name, or two have it.
    """
    for names in _name_columns(header):
        if names.count(column.name.casefold()) > 1:
            raise LogError(f"{source}: {role}: two columns are called {column.name}; give a number")
        if column.name.casefold() in names:
            index = names.index(column.name.casefold())
            return index, split_unit(header[index])[1] or ""
    if column.name.isdecimal() and int(column.name) >= 1:
        return int(column.name) - 1, ""
    name, at, zero = column.name.rpartition("@")
    if (
        at
        and not column.unit
        and (name.isdecimal() or name.casefold() in names)
        and (number := NUMBER_WITH_UNIT.fullmatch(zero))
    ):
        unit = UNITS_OF_EXAMPLES[ROLE_UNITS[role]]
        raise LogError(
            f"--columns: {role}={column.name}: a number at zero needs the unit before it, as "
            f"{role}={name}:{unit}@{number[1]}"
        )
    has = ", ".join(header[:20]) or "no header: give numbers of columns, 1 for the first"
    meant = suggest(column.name, (split_unit(each)[0] for each in header))
    raise LogError(f"{source}: {role}: no column {column.name}{meant} (it has {has})")


def counts_rows(header: list[str], column: ColumnWanted) -> bool:
    """Whether the column of a time stands for the number of the row: none of a header has its name.

    Args:
        header: The names of the columns; empty without any.
        column: The column of the time.
    """
    return column.name == ROW_NAME and ROW_NAME not in _known_names(header)


def _split_columns(
    source: str,
    text: str,
    wanted: Mapping[str, ColumnWanted],
    separator: str | None,
) -> tuple[list[str], list[Array | list[str]], list[str]]:
    """The header and the columns of a text, as texts, and notes on rows that are left out.

    Rows that are cut are left out: the first and the last if they are shorter than usual, and
    others that are shorter or longer where these are few. Where the time is the number of the row,
    they are empty instead. A header that names more or fewer columns than the rows have is not used
    where no wanted column is of its names.

    Args:
        source: What to call the file in messages.
        text: All of it.
        wanted: Role to column.
        separator: Between columns; None to find it.

    Raises:
        LogError: If it is empty, or its header does not fit its rows.
    """
    lines = plain_lines(text)
    if not lines:
        raise LogError(f"{source}: is empty")
    split = _make_splitter(lines, SEPARATOR_NAMES.get(separator or "", separator))
    rows = [[cell.strip().strip("\"'") for cell in split(line)] for line in lines]
    header, at = _find_header(rows, wanted)
    above = rows[at - 1] if at and not header and split is not split_at_blanks else []
    notes = []
    heads = rows[:at]
    if again := sum(len(row) > 1 and row in heads for row in rows[at:]):
        notes.append(f"the line of names is repeated {plural(again, 'time')}: left out")
    rows = [row for row in rows[at:] if len(row) < 2 or row not in heads]
    counts = np.array([len(row) for row in rows], dtype=int)
    usual = int(np.bincount(counts).argmax()) if rows else 0
    named = len(header)
    known = _known_names(header)
    by_name = any(each.name.casefold() in known for each in wanted.values())
    more = any(any(row[named:]) for row in rows if len(row) == usual)
    if by_name and (more or (named > usual > 0 and split is split_at_blanks)):
        raise LogError(
            f"{source}: its header names {plural(named, 'column')}, its rows have {usual}: give "
            "the header a name for each, or take it out and give numbers of columns"
        )
    if named and (more or named > max(counts, default=named)):
        remark = "the last of its names have none" if by_name else "no name of it is used"
        notes.append(
            f"the header names {plural(named, 'column')}, the rows have {plural(usual, 'cell')}: "
            f"{remark}; if the names do not fit, give numbers of columns"
        )
        header = header if by_name else []
    elif unfit := _find_unfit_names(above, usual):
        notes.append(
            f"the line above the numbers has {plural(unfit, 'name')}, the rows have "
            f"{plural(usual, 'cell')}: no name of it is used; give numbers of columns"
        )
    odd = counts != usual
    share = float(odd.sum()) / max(len(odd), 1)
    several = len(set(counts[odd])) > 1 and share < MAX_CUT_ROWS
    if share > FEW_ODD_ROWS and not several:  # then the writing program pads rows like this
        odd[1:-1] = False
        odd &= counts < usual
    if odd.any():
        cut = "the first row" if odd[0] and odd.sum() == 1 else plural(int(odd.sum()), "row")
        notes.append(f"{cut} left out: not the usual {plural(usual, 'cell')}")
    numbered = "time" in wanted and counts_rows(header, wanted["time"])
    kept = [
        [] if is_odd else row
        for row, is_odd in zip(rows, odd, strict=True)
        if numbered or not is_odd
    ]
    width = max(usual, named)
    columns = [[row[k] if k < len(row) else "" for row in kept] for k in range(width)]
    header, columns = _spread_lists(header or _name_by_words(columns), columns)
    header, columns = _pivot(*_take_units_out(header, columns))
    return header, _join_fractions(header, columns, notes), notes


def _spread_lists(header: list[str], columns: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Header and columns with those of lists, as ``[1.5 2.5]``, one for each of their numbers."""
    names, spread = list[str](), list[list[str]]()
    for k, cells in enumerate(columns):
        lists = [re.findall(NUMBER, cell) if LIST_CELL.fullmatch(cell) else [] for cell in cells]
        size = int(np.bincount([len(each) for each in lists] or [0]).argmax())
        if size > 1:
            name = header[k] if k < len(header) else str(k + 1)
            names += [f"{name}.{i}" for i in range(size)]
            spread += [
                [each[i] if len(each) == size else "" for each in lists] for i in range(size)
            ]
        else:
            names += header[k : k + 1]
            spread.append(cells)
    return (names if header else header), spread


def _take_units_out(
    header: list[str], columns: list[list[str]]
) -> tuple[list[str], list[list[str]]]:
    """Header and columns with the unit of cells such as ``12.5 mm`` in the header alone."""
    names, bare = list(header), list(columns)
    for k, cells in enumerate(columns[: len(header)]):
        found = [each for each in map(NUMBER_WITH_UNIT.fullmatch, cells) if each and each[2]]
        units = {each[2] for each in found}
        if len(units) == 1 and len(found) > MIN_SHARE_OF_UNITS * len(cells):
            unit = units.pop()
            names[k] = with_unit(split_unit(header[k])[0], unit)
            bare[k] = [cell.removesuffix(unit).strip() for cell in cells]
    return names, bare


def _pivot(header: list[str], columns: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """A table of one value a row, with its name, as one with a column for each name.

    A table of other columns stays as it is. Rows stay rows, and have one value each.
    """
    names = [split_unit(each)[0].casefold().strip("_") for each in header]
    by_name = [k for k, name in enumerate(names) if name in VALUE_NAME_COLUMNS]
    by_value = [k for k, name in enumerate(names) if name in VALUE_COLUMNS]
    if len(by_name) != 1 or len(by_value) != 1 or len(columns) != len(header):
        return header, columns
    labels, values = columns[by_name[0]], columns[by_value[0]]
    known = dict.fromkeys(filter(None, labels))
    if not 2 <= len(known) <= MAX_PIVOTED or all(map(is_number, known)):
        return header, columns
    others = [k for k in range(len(header)) if k not in (*by_name, *by_value)]
    spread = [
        [value if label == name else "" for label, value in zip(labels, values, strict=True)]
        for name in known
    ]
    found = [*(columns[k] for k in others), *spread]
    order = _order_by_time([columns[k] for k in others], labels)
    return [*(header[k] for k in others), *known], [[cells[k] for k in order] for cells in found]


def _name_by_words(columns: list[list[str]]) -> list[str]:
    """Names of the columns of a table without a header, of which some cells are names.

    Either each number but the first has its name before it, the same in every row, or a row has a
    time, a name and one value. Any other table has none.
    """
    some = [cells[len(cells) // 2 :][:50] for cells in columns]
    words = [sum(map(_is_word, cells)) > MIN_SHARE_OF_UNITS * len(cells) for cells in some]
    filled = [k for k, cells in enumerate(columns) if any(cells)]
    names = [str(k + 1) for k in range(len(columns))]
    pairs = [k for k in filled if words[k] and len(set(columns[k])) == 1]
    if len(pairs) > 1 and filled == [0, *(k + i for k in pairs for i in (0, 1))]:
        for k in pairs:
            names[k + 1] = columns[k][0]
        return names
    numbers = [k for k in filled if not words[k]]
    labels = [k for k in filled if words[k] and len(set(columns[k])) > 1]
    if len(numbers) == 2 and len(labels) == 1 and numbers[0] < labels[0] < numbers[1]:
        names[numbers[0]], names[labels[0]], names[numbers[1]] = "time", "name", "value"
        return names
    return []


def _order_by_time(columns: list[list[str]], labels: list[str]) -> list[int]:
    """The order of rows by the first column that rises within the rows of each label.

    Where one series follows the other, their rows are mixed by it; without such a column rows
    stay as they are.

    Args:
        columns: Cells of each.
        labels: Label of each row.
    """
    which = np.unique(labels, return_inverse=True)[1]
    grouped = np.argsort(which, kind="stable")
    same = np.diff(which[grouped]) == 0
    for cells in columns:
        numbers = parse_numbers(cells)[0]
        steps = np.diff(numbers[grouped])[same]
        if np.isfinite(numbers).all() and (steps >= 0).all() and (steps > 0).any():
            return [int(k) for k in np.argsort(numbers, kind="stable")]
    return list(range(len(labels)))


def _join_fractions(
    header: list[str], columns: list[list[str]], notes: list[str]
) -> list[Array | list[str]]:
    """The columns with the nanoseconds or milliseconds of a stamp added to its whole seconds.

    Args:
        header: Their names.
        columns: Texts of each.
        notes: Receives what was added.
    """
    joined = list[Array | list[str]](columns)
    pairs = pair_seconds([split_unit(name)[0] for name in header])
    for whole, rest in pairs if header else _pair_numbers(columns):
        (seconds, _), (added, _) = parse_numbers(columns[whole]), parse_numbers(columns[rest])
        joined[whole] = seconds + 1e-9 * added
        first, second = (header[whole], header[rest]) if header else (whole + 1, rest + 1)
        notes.append(f"{first}: with the nanoseconds of {second}")
    for k, name in enumerate(header[1:]):
        if MILLISECONDS.fullmatch(split_unit(name)[0]) and all(map(is_time, columns[k])):
            stamps, millis = (parse_numbers(columns[each])[0] for each in (k, k + 1))
            if (np.mod(stamps, 1) == 0).all() and ((millis >= 0) & (millis < 1000)).all():
                joined[k], joined[k + 1] = stamps + 1e-3 * millis, []
                notes.append(f"{header[k]}: with the milliseconds of {name}")
    return joined


def _pair_numbers(columns: list[list[str]]) -> Iterator[tuple[int, int]]:
    """Columns of whole seconds since 1970, each with that of nanoseconds behind it, by numbers."""
    for k, (first, second) in enumerate(pairwise(columns)):
        if all(map(str.isdecimal, first)) and all(map(str.isdecimal, second)):
            seconds, rest = (np.array(each, dtype=float) for each in (first, second))
            steps, going = np.diff(seconds), np.diff(seconds + 1e-9 * rest)
            if (
                len(steps)
                and min(seconds) >= MIN_UNIX_TIME_S
                and max(seconds) < MAX_UNIX_TIME_S
                and MIN_NANOSECONDS < max(rest) < 1e9
                and (steps == 0).any()
                and (going > 0).all()
            ):
                yield k, k + 1


def _find_unfit_names(above: list[str], usual: int) -> int:
    """How many names a line above the numbers has, if these are fewer than the usual cells.

    Args:
        above: Its cells; empty where it is the header, or no separator shows what is a name.
        usual: Usual number of cells of a row.
    """
    names = 1 < len(above) < usual and not any(map(is_number, above))
    return len(above) if names else 0


def _make_splitter(lines: list[str], separator: str | None) -> Callable[[str], list[str]]:
    """Function that splits a line into cells: by the separator that most lines have equally often.

    Raises:
        LogError: If the given separator does not separate the columns.
    """
    if separator is None:
        some = lines[len(lines) // 2 :][:50]

        def alike(each: str) -> float:
            counts = [line.count(each) for line in some]
            usual = int(np.median(counts))
            return float(np.mean([count == usual for count in counts])) if usual else 0.0

        separator = next((s for s in (";", "\t", ",", "|") if alike(s) > 0.8), " ")
        if separator == "\t" and any(map(_has_pairs_of_numbers, some)):
            separator = " "
    if separator == " ":
        return split_at_blanks
    if not separator or set(separator) & set('"\r\n'):
        raise LogError(
            f"--separator {separator!r}: separates no columns; give a sign such as ; or "
            f"one of the words {', '.join(word for word in SEPARATOR_NAMES if word.isalpha())}"
        )
    between = separator

    def split(line: str) -> list[str]:
        if '"' not in line or len(between) > 1:
            return line.split(between)
        return next(csv.reader([line], delimiter=between, skipinitialspace=True))

    return split


def _has_pairs_of_numbers(line: str) -> bool:
    """Whether between two tabs of a line are two numbers, so that blanks separate them as well."""
    pairs = (cell.split() for cell in line.split("\t"))
    return any(len(cells) > 1 and all(map(is_number, cells)) for cells in pairs)


def _find_header(
    rows: list[list[str]], wanted: Mapping[str, ColumnWanted]
) -> tuple[list[str], int]:
    """The names of the columns, empty without any, and the row at which numbers begin."""
    names = {column.name.casefold() for column in wanted.values()}
    known = [
        0 if not row or is_number(row[0]) or is_time(row[0]) else len(names & _known_names(row))
        for row in rows[:50]
    ]
    if any(known):
        at = known.index(max(known))
        below = list(takewhile(_is_without_numbers, rows[at + 1 : at + 1 + MAX_NAME_ROWS]))
        units = next((each for each in below if any(map(_is_unit_cell, each))), [])
        names_here = _fill_from_above(rows[at], rows[max(at + 1 - MAX_NAME_ROWS, 0) : at])
        return _join_units(names_here, units), at + 1 + len(below)
    label = _find_labels(rows)
    for at, row in enumerate(rows[:50]):
        numbers = sum(is_number(cell) or is_time(cell) for cell in row)
        labelled = label is not None and label < len(row) and _is_word(row[label])
        if numbers > sum(map(bool, row)) / 2 and not labelled:
            before = [each for each in rows[:at] if min(len(row), 2) <= len(each) >= len(row) - 1]
            if not before or before[-1] != rows[at - 1]:
                return [], at
            return _name_by(before[-MAX_NAME_ROWS:]), at
    return [], 0


def _find_labels(rows: list[list[str]]) -> int | None:
    """Place of the cell in which rows of a head have words and those of numbers none; None without.

    It is the first cell that is seldom blank in the middle of the table.
    """
    some = rows[len(rows) // 2 :][:50]
    for k in range(min(map(len, some), default=0)):
        cells = [row[k] for row in some if row[k].casefold() not in BLANK_CELLS]
        if len(cells) > len(some) / 2:
            return None if sum(map(_is_word, cells)) > len(cells) / 2 else k
    return None


def _is_word(cell: str) -> bool:
    """Whether a cell is not blank, no number and no time."""
    return cell.casefold() not in BLANK_CELLS and not is_number(cell) and not is_time(cell)


def _name_by(rows: list[list[str]]) -> list[str]:
    """The names of columns by the rows above the numbers, with the units of a row below them.

    Names differ from each other, units are repeated. An empty name is that of the row above.

    Args:
        rows: Up to ``MAX_NAME_ROWS``, the last one next to the numbers.
    """
    usual = len(rows[-1])
    at = max(
        range(len(rows)),
        key=lambda k: (len(rows[k]) == usual, _are_names(rows[k]), _count_suggestions(rows[k]), k),
    )
    units = next((row for row in rows[at + 1 :] if any(map(_is_unit_cell, row))), [])
    return _join_units(_fill_from_above(rows[at], rows[:at]), units)


def _fill_from_above(names: list[str], above: list[list[str]]) -> list[str]:
    """Names, the empty ones those of the nearest row above that has as many cells.

    Args:
        names: The row of the names.
        above: The rows above it, in their order.
    """
    for row in reversed(above):
        if len(row) == len(names):
            names = [name or other for name, other in zip(names, row, strict=True)]
    return names


def _are_names(row: list[str]) -> bool:
    """Whether the cells of a row that are not blank differ, and none is a unit or a fraction."""
    words = list(filter(None, row))
    fractions = any(re.search(r"\d[.,]\d", word) for word in words)
    return len(set(words)) == len(words) and not fractions and not all(map(_is_unit_cell, words))


def _is_without_numbers(row: list[str]) -> bool:
    """Whether a row has several cells, and none is a number or a time."""
    words = [cell for cell in row if cell.casefold() not in BLANK_CELLS]
    return len(row) > 1 and bool(words) and not any(is_number(e) or is_time(e) for e in words)


def _count_suggestions(header: list[str]) -> int:
    """How many names of a header suggest a role."""
    return sum(each is not None for each in suggest_kinds([split_unit(e)[0] for e in header]))


def _join_units(header: list[str], units: list[str]) -> list[str]:
    """Names with the units that a row of as many cells has.

    Args:
        header: The names.
        units: The cells of that row; empty without one.
    """
    if len(units) != len(header):
        return header
    known = [cell.strip("[]()") if _is_unit_cell(cell) else "" for cell in units]
    return [with_unit(name, unit) for name, unit in zip(header, known, strict=True)]


def _is_unit_cell(cell: str) -> bool:
    """Whether a cell is a unit, with or without brackets."""
    return is_unit(cell.strip("[]()"))


def _known_names(header: list[str]) -> set[str]:
    """By which names columns may be wanted, in small letters."""
    return set().union(*_name_columns(header))


def _name_columns(header: list[str]) -> tuple[list[str], list[str]]:
    """The names of columns as they stand and without their units, in small letters."""
    return [c.casefold() for c in header], [split_unit(c)[0].casefold() for c in header]
