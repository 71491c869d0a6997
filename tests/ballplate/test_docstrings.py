"""`ballplate`: the examples in the docstrings of its public names run and give what they show."""

import doctest
import inspect

import pytest

import ballplate as bp
from twin.fmu import export

DOCUMENTED = {"ballplate": bp} | {name: getattr(bp, name) for name in bp.__all__}
"""The package and its public names, each with a docstring."""
LONG = {
    *("identify", "Identified", "plan_experiment", "Planned"),  # a fit to a log of 10 s
    *("ballplate", "compare", "sweep", "Sweep", "StudyResult"),  # several runs, as `run` has one
    *("fmu", "controller_fmu"),  # compiled, as `drive_fmu` is
}
"""Those with examples that take longest, each a slower form of one that is short."""


def examples_of(name):
    """The doctest of a docstring: its lines after ``>>>``, and what each shows."""
    text = inspect.cleandoc(DOCUMENTED[name].__doc__)
    return doctest.DocTestParser().get_doctest(text, {"__name__": "__main__"}, name, None, None)


@pytest.mark.parametrize(
    "name",
    [pytest.param(each, marks=pytest.mark.long if each in LONG else ()) for each in DOCUMENTED],
)
def test_the_examples_of_a_public_name_give_what_its_docstring_shows(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flags = ["-O0" if flag == "-O2" else flag for flag in export.COMPILER_FLAGS]
    monkeypatch.setattr(export, "COMPILER_FLAGS", flags)  # to optimise is most of compiling
    found, lines = examples_of(name), []
    assert any(each.want for each in found.examples), "an example with an output is needed"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    assert runner.run(found, out=lines.append).failed == 0, "".join(lines)
