"""A law of one's own is a law: its record says what it was, and opens where it is not."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import ballplate as bp
from controllers.catalog import forget

SHORT = ("--set", "controller.kind=mine", "--set", "duration=0.1", "--set", "plant.kind=lagrange")
RUN = Path("runs/circle-controller=mine-duration=0.1-plant=lagrange")


@pytest.fixture
def mine(ballplate):
    """A law in the folder of laws of the current folder."""
    forget()
    assert ballplate("new", "law", "mine")[0] == 0
    forget()
    yield Path("laws/mine.py")
    forget()


@pytest.fixture
def gone(ballplate, mine):
    """A run whose law is gone."""
    assert ballplate("run", "circle", *SHORT)[0] == 0
    shutil.rmtree("laws")
    forget()
    return RUN


def metadata(folder):
    return json.loads(pq.read_schema(folder / "run.parquet").metadata[b"ballplate"])


def test_a_record_says_what_the_law_was(ballplate, mine):
    ballplate("run", "circle", *SHORT)
    was = metadata(RUN)["classes"]["controller"]
    assert was["settings"] == {"ball": [2.0, 2.4], "plate": [60.0, 14.0]}
    assert (was["file"], was["source"]) == ("mine.py", mine.read_text())
    assert len(was["sha256"]) == 64


def test_of_a_shipped_law_all_settings_are_recorded(ballplate):
    ballplate("run", "circle", "--set", "duration=0.1", "--set", "plant.kind=lagrange")
    assert set(
        metadata(Path("runs/circle-duration=0.1-plant=lagrange"))["classes"]["observer"]
    ) == {"settings"}


@pytest.mark.parametrize(
    "command",
    [
        ("report", RUN),
        ("export", RUN, "signals.csv"),
        ("view", RUN, "--rrd", "view.rrd"),
        ("compare", RUN),
    ],
    ids=lambda command: command[0],
)
def test_a_record_is_shown_without_its_law_and_that_is_said_once(ballplate, gone, command):
    code, _, err = ballplate(*map(str, command))
    assert code == 0
    assert err.count("controller 'mine' (it was in mine.py): not here") == 1
    assert "another version" not in err


def test_nothing_goes_on_from_a_record_without_its_law(ballplate, gone):
    code, _, err = ballplate("whatif", str(gone), "--at", "0.05")
    assert code == 2
    assert "what-if need it" in err
    assert err.count("\n") == 1


def test_nothing_goes_on_with_another_law_of_the_name(ballplate, mine):
    ballplate("run", "circle", *SHORT)
    mine.write_text(mine.read_text().replace("60.0", "61.0"))
    forget()
    code, _, err = ballplate("whatif", str(RUN), "--at", "0.05")
    assert (code, err.count("\n")) == (2, 1)
    assert "mine.py has changed since" in err


def test_a_record_whose_law_takes_other_settings_is_shown(ballplate, mine):
    ballplate("run", "circle", *SHORT, "--set", "controller.plate=[50,10]", "--out", "x")
    mine.write_text(mine.read_text().replace("plate", "angle"))
    forget()
    code, _, err = ballplate("report", "x")
    assert code == 0
    assert "does not take its settings" in err


def test_from_python_a_record_opens_without_its_law(gone):
    with pytest.warns(UserWarning, match="controller 'mine'"):
        found = bp.load(gone)
    assert found.finished
    assert found.replay.classes["controller"]["settings"]["ball"] == [2.0, 2.4]


def test_a_run_that_cannot_be_opened_does_not_stop_a_comparison(ballplate, gone):
    bad = Path("runs/bad")
    bad.mkdir()
    (bad / "run.parquet").write_text("no Parquet")
    code, _, err = ballplate("compare", str(gone), str(bad))
    assert code == 0
    assert "bad/run.parquet: not a readable Parquet file" in err
    assert ballplate("compare", str(bad))[0] == 2


def test_a_run_with_another_law_does_not_replace_the_folder(ballplate, mine):
    ballplate("run", "circle", *SHORT)
    assert "replaced the run" in ballplate("run", "circle", *SHORT)[1]
    mine.write_text(mine.read_text().replace("60.0", "61.0"))
    forget()
    out = ballplate("run", "circle", *SHORT)[1]
    assert "was another: it stays" in out
    assert metadata(RUN.with_name(f"{RUN.name}~2"))["classes"]["controller"]["settings"][
        "plate"
    ] == [61.0, 14.0]
    assert metadata(RUN)["classes"]["controller"]["settings"]["plate"] == [60.0, 14.0]


def test_a_comparison_and_a_report_tell_what_differs_in_a_law(ballplate, mine):
    ballplate("run", "circle", *SHORT)
    mine.write_text(mine.read_text().replace("60.0", "61.0"))
    forget()
    ballplate("run", "circle", *SHORT)
    other = RUN.with_name(f"{RUN.name}~2")
    out = ballplate("compare", str(RUN), str(other))[1]
    assert f"controller.plate: {RUN.name} [60.0, 14.0]" in out.replace("\n", " ")
    ballplate("report", str(other), "--out", "page")
    page = Path("page.html").read_text()
    assert "controller.plate" in page
    assert "Inner loop on the plate angle, outer loop on the ball." in page


OWN_REFERENCE = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from controllers.interfaces import Reference

@dataclass(frozen=True)
class Slope(Reference):
    name: ClassVar[str] = "slope"
    speed: float = 0.1

    def __call__(self, t):
        t = np.asarray(t, float)
        p = np.stack([self.speed * t, 0 * t], axis=-1)
        return np.stack([p, np.broadcast_to([self.speed, 0.0], p.shape), 0 * p, 0 * p, 0 * p])
"""


def test_where_a_reference_of_ones_own_led_is_in_the_record(ballplate):
    forget()
    Path("laws").mkdir()
    Path("laws/slope.py").write_text(OWN_REFERENCE)
    ballplate(
        "run", "circle", "--set", "reference.kind=slope", "--set", "duration=0.1", "--out", "x"
    )
    shutil.rmtree("laws")
    forget()
    with pytest.warns(UserWarning, match="reference 'slope'"):
        found = bp.load("x")
    np.testing.assert_allclose(found.reference[:, 0], 0.1 * found.motion.time, atol=1e-12)
    np.testing.assert_allclose(found.replay.reference(0.05)[1], [0.1, 0.0], atol=1e-9)
    assert found.replay.reference(found.motion.time).shape == (5, len(found.motion.time), 2)
    assert ballplate("view", "x", "--rrd", "x.rrd")[0] == 0
