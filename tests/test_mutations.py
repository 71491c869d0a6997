"""Deliberate faults: each can still be made, so that ``mutations.py`` tests what it says."""

import ast
from pathlib import Path

import pytest

from benchmarks import mutations

HERE = Path(__file__).parent


def test_there_are_twenty_faults_of_different_names():
    assert len({fault.name for fault in mutations.FAULTS}) == len(mutations.FAULTS) == 20


def test_every_fault_can_be_made_and_the_file_is_python_still():
    assert not mutations.stale(mutations.FAULTS)
    for fault in mutations.FAULTS:
        text = (mutations.ROOT / fault.file).read_text(encoding="utf-8")
        changed = text.replace(fault.text, fault.replacement)
        assert changed != text
        ast.parse(changed)


def test_every_fault_names_tests_that_exist():
    for fault in mutations.FAULTS:
        assert all((HERE / each).exists() for each in fault.tests), fault.name


def test_a_fault_whose_text_is_gone_is_told():
    (gone,) = mutations.stale([mutations.FAULTS[0]._replace(text="is not there")])
    assert "stands there 0 times" in gone


def test_a_fault_is_taken_out_again_whatever_happens(tmp_path):
    fault = mutations.FAULTS[0]
    place = tmp_path / fault.file
    place.parent.mkdir(parents=True)
    before = (mutations.ROOT / fault.file).read_text(encoding="utf-8")
    place.write_text(before, encoding="utf-8")
    seen = []

    def interrupted():
        with mutations.made(fault, tmp_path):
            seen.append(place.read_text(encoding="utf-8"))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert seen == [before.replace(fault.text, fault.replacement)]
    assert place.read_text(encoding="utf-8") == before
