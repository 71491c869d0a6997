"""`twin.run.json_logs`: Measurements in the forms of JSON that programs write."""

import json

import numpy as np
import pandas as pd
import pytest

from twin.base.errors import LogError
from twin.run.foreign_logs import foreign_table

T = np.arange(100) / 50
X = np.sin(T)
ROWS = [
    {"t": t, "ball": {"x": x, "seen": True}, "u": [0.1 * t, 1.0]} for t, x in zip(T, X, strict=True)
]
FRAME = pd.DataFrame({"t": T, "x": X})
FORMS = {
    "rows": (json.dumps(ROWS), "ball.x"),
    "rows in an object": (json.dumps({"rig": "a", "log": ROWS}), "log.ball.x"),
    "lines": ("\n".join(map(json.dumps, ROWS)), "ball.x"),
    "columns": (json.dumps({"t": T.tolist(), "ball": {"x": X.tolist()}}), "ball.x"),
    "matrix": (json.dumps([[t, x] for t, x in zip(T, X, strict=True)]), "2"),
    "pandas": (FRAME.to_json(double_precision=15), "x"),
    "pandas, records": (FRAME.to_json(orient="records", double_precision=15), "x"),
    "pandas, split": (FRAME.to_json(orient="split", double_precision=15), "x"),
    "pandas, lines": (FRAME.to_json(orient="records", lines=True, double_precision=15), "x"),
}


@pytest.mark.parametrize("form", FORMS)
def test_columns_are_read_of_every_form(tmp_path, form):
    text, name = FORMS[form]
    file = tmp_path / "a.json"
    file.write_text(text, encoding="utf-8")
    assert foreign_table(file).columns[name] == pytest.approx(X)


def test_fields_within_fields_and_rows_without_a_value_are_kept(tmp_path):
    file = tmp_path / "a.json"
    file.write_text(json.dumps([*ROWS, {"t": 2.0, "ball": None}]), encoding="utf-8")
    columns = foreign_table(file).columns
    assert columns["u.0"][:-1] == pytest.approx(0.1 * T)
    assert columns["ball.seen"][0] == 1.0
    assert np.isnan(columns["ball.x"][-1])
    assert columns["t"][-1] == 2.0


def test_lines_that_are_cut_are_left_out(tmp_path):
    lines = [json.dumps(row) for row in ROWS]
    file = tmp_path / "a.json"
    file.write_text("\n".join([*lines[:-1], lines[-1][:9]]), encoding="utf-8")
    table = foreign_table(file)
    assert len(table.columns["t"]) == len(T) - 1
    assert table.notes == ("1 line left out: not JSON",)


@pytest.mark.parametrize("no_value", ["{[1]: 2}", "{1: {[2]}}", "f(1)", "{'t': 1"])
def test_a_line_that_is_no_value_costs_itself_among_lines_that_python_printed(tmp_path, no_value):
    file = tmp_path / "a.json"
    file.write_text(
        "\n".join([*map(repr, json.loads(json.dumps(ROWS))), no_value]), encoding="utf-8"
    )
    table = foreign_table(file)
    assert table.columns["ball.x"] == pytest.approx(X)
    assert table.notes == ("1 line left out: not JSON",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"t": [1, 2', "cannot be read: Expecting"),
        ('{"rig": "a"}', "a JSON file without a column of numbers"),
        ("[" * 2000 + "]" * 2000, "cannot be read|without a column"),
        (json.dumps([{f"c{k}": 1 for k in range(9000)}] * 2), "cannot be read"),
    ],
)
def test_what_is_no_log_is_refused_in_a_line(tmp_path, text, says):
    file = tmp_path / "a.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(LogError, match=says) as caught:
        foreign_table(file)
    assert "\n" not in str(caught.value)
