"""`ballplate.results`.

What runs give: columns with units, tables, pictures, folders, and a look in a notebook."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest

import ballplate
from twin.run.record import read_run

QUICK = {"plant": {"kind": "lagrange"}, "duration": 0.3, "metrics": {"start": 0}}


@pytest.fixture(scope="module")
def done():
    return ballplate.run("circle", baseline=False, **QUICK)


@pytest.fixture(scope="module")
def compared():
    laws = [ballplate.laws.AFL, {"kind": "lqr", "rho": 100.0}]
    return ballplate.compare("circle", vary={"controller": laws}, **QUICK)


class Tags(HTMLParser):
    """What a page is made of."""

    def __init__(self, text):
        super().__init__()
        self.open, self.cells, self.pictures = [], [], 0
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            assert dict(attrs)["src"].startswith("data:image/png;base64,")
            self.pictures += 1
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.cells += [data] if data.strip() else []


@pytest.mark.long
def test_the_columns_and_units_are_those_of_the_record(done, tmp_path):
    columns, units, _ = read_run(done.save(tmp_path) / "run.parquet")
    assert list(done) == list(columns)
    assert all(np.array_equal(done[name], columns[name], equal_nan=True) for name in done)
    assert done.units == units
    assert np.array_equal(done.ball, np.stack([done["true_x"], done["true_y"]], axis=1))
    assert np.array_equal(done.error, done.reference - done.ball)
    with pytest.raises(ballplate.TwinError, match="did you mean 'true_x'"):
        done["tru_x"]
    with pytest.raises(KeyError, match="no indicator 'e_tt'; did you mean 'tracking_error_perc"):
        done.metrics["e_tt"]
    assert done.metrics.get("e_tt") is None
    with pytest.raises(ballplate.TwinError, match="no column '0'"):
        done[0]


def test_a_table_for_pandas_has_the_columns_over_time_and_their_units(done):
    frame = done.to_pandas()
    assert frame.index.name == "time"
    assert frame["true_x"].to_numpy().tobytes() == done["true_x"].tobytes()
    assert frame.attrs["units"]["true_x"] == "m"


@pytest.mark.long
def test_a_saved_run_is_loaded_as_it_was(done, tmp_path):
    again = ballplate.load(done.save(tmp_path / "one"))
    assert again.scenario == done.scenario
    assert again.metrics == done.metrics
    assert np.array_equal(again.reference, done.reference)
    with pytest.raises(ballplate.TwinError, match="nothing new to save"):
        again.save(tmp_path / "two")
    reports = [each.report(tmp_path / "report.html").read_text() for each in (done, again)]
    assert all(f"<h1>{done.title}</h1>" in text for text in reports)


def test_an_exported_run_is_loaded_as_a_log_in_si_units(done, tmp_path):
    log = ballplate.load(done.export(tmp_path / "log.csv"))
    assert np.array_equal(log["measured_x"], done["measured_x"])
    assert log.units["applied_phi_rate"] == "rad/s"


@pytest.mark.long
def test_a_result_shows_its_title_indicators_and_picture(done):
    shown = Tags(done._repr_html_())
    assert shown.cells[0] == done.title
    at = shown.cells.index("tracking error e_tt")
    assert float(shown.cells[at + 1]) == pytest.approx(
        done.metrics["tracking_error_percent"], rel=1e-3
    )
    assert shown.pictures == 1
    assert repr(done).startswith("<Result 'Circle of 150 mm")


@pytest.mark.long
def test_variants_side_by_side_are_the_runs_themselves(compared, done):
    one, other = compared
    assert other == 'controller={kind="lqr", rho=100.0}'
    assert list(compared.names.values()) == ["afl", "lqr"]
    alone = ballplate.run("circle", controller=ballplate.laws.AFL, **QUICK)
    assert compared[one]["true_x"].tobytes() == alone["true_x"].tobytes()
    assert compared[other].scenario.controller.settings == {"rho": 100.0}
    frame = compared.to_pandas()
    assert frame.loc[other, "rms_error"] == compared[other].metrics["rms_error"]
    shown = Tags(compared._repr_html_())
    assert set(compared.names.values()) < set(shown.cells)


@pytest.mark.long
def test_a_comparison_is_saved_and_loaded_and_put_beside_other_runs(compared, done, tmp_path):
    again = ballplate.load(compared.save(tmp_path))
    assert len(again) == 2
    assert (tmp_path / "compare.png").is_file()
    both = ballplate.compare(done, next(iter(again.values())))
    assert list(both) == [done.name, next(iter(again))]
    assert list(ballplate.compare(done, done)) == [done.title, f"{done.title}~2"]


def test_a_sweep_is_a_run_for_every_combination(done):
    found = ballplate.sweep(
        "circle",
        {"controller.rho": np.array([100.0, 300.0]), "reference.omega": [0.75, 1.0]},
        controller="lqr",
        processes=1,
        **QUICK,
    )
    assert found.points == [(100.0, 0.75), (100.0, 1.0), (300.0, 0.75), (300.0, 1.0)]
    changes = {"controller": {"kind": "lqr", "rho": 300.0}, "reference": {"omega": 1.0}}
    alone = ballplate.run("circle", **changes, **QUICK)
    assert found["rms_error"][3] == alone.metrics["rms_error"]
    assert found.to_pandas()["reference.omega"].tolist() == [0.75, 1.0, 0.75, 1.0]
    (axes,) = found.plot("rms_error").axes
    assert [line.get_label() for line in axes.lines] == ["0.75", "1"]
    assert axes.lines[1].get_ydata()[1] == 1000 * found["rms_error"][3]
    assert Tags(found._repr_html_()).pictures == 1
    with pytest.raises(ballplate.TwinError, match="'rms_eror'; did you mean 'rms_error'"):
        found["rms_eror"]


STUDY = """
title = "short"
scenario = "hold"
set = ["plant.kind=lagrange", "duration=0.1", "metrics.start=0", "plant.start.x=0.01"]
method = "grid"
metrics = ["rms_error"]

[parameters."plant.friction.rolling_mm"]
values = [0.0, 0.2]
"""


@pytest.mark.long
def test_a_study_gives_rows_answers_and_figures_and_goes_on_where_it_stopped(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text(STUDY)
    found = ballplate.study(file, out=tmp_path / "out", processes=1, seeds=2)
    frame = found.to_pandas()
    assert frame["seed"].tolist() == [0, 1, 0, 1]
    assert frame["plant.friction.rolling_mm"].tolist() == [0.0, 0.0, 0.2, 0.2]
    assert (tmp_path / "out" / "report.html").is_file()
    assert Tags(found._repr_html_()).pictures == len(found.plot())
    again = ballplate.study(file, out=tmp_path / "out", processes=1, seeds=2)
    assert again.rows.equals(found.rows)


def test_what_there_is_to_run_and_to_set():
    assert ballplate.scenarios()["hold"].startswith("Hold on the centre")
    found = ballplate.describe("rolling_mm")
    assert found[0].unit == "mm"
    assert re.search(r"<td[^>]*>plant.friction.rolling_mm</td>", found._repr_html_())
    assert str(ballplate.describe("lqr")).startswith("State feedback that minimises")


@pytest.mark.long
def test_runs_and_logs_stand_beside_scenarios_as_on_the_command_line(done, tmp_path):
    done.save(tmp_path / "run")
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        done.export(tmp_path / place / "log.csv")
    logs = [tmp_path / place / "log.csv" for place in ("a", "b")]
    found = ballplate.compare(tmp_path / "run", *logs, "circle", baseline=False, **QUICK)
    assert list(found) == ["run", "log", "log~2", "circle"]  # as given
    assert found.logs == ("log", "log~2")
    assert np.array_equal(found["circle"].ball, done.ball)


@pytest.mark.long
def test_a_run_that_was_just_made_is_identified_as_the_one_that_was_saved(tmp_path):
    made = ballplate.run("excite", duration=16, baseline=False, plant={"kind": "lagrange"})
    words = [ballplate.identify(made, "rolling").found.as_dict()]
    made.save(tmp_path / made.name)
    words.append(ballplate.identify(tmp_path / made.name, ["rolling"]).found.as_dict())
    assert words[0]["parameters"] == words[1]["parameters"]
