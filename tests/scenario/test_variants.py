import pytest

from twin.errors import ScenarioError
from twin.scenario.load import comparison, parsed, variants


def names(*vary):
    return [variant.name for variant in variants(parsed(vary))]


def test_tables_are_values_with_the_shortest_name_that_tells_them_apart():
    two = variants(parsed(['controller=[{kind="afl"}, {kind="lqr", rho=100}]']))
    assert [variant.name for variant in two] == ["afl", "lqr"]
    assert two[1].settings == (("controller", {"kind": "lqr", "rho": 100}),)
    alike = 'controller=[{kind="lqr", rho=100}, {kind="lqr", rho=300}, {kind="afl"}]'
    assert names(alike) == ["lqr rho=100", "lqr rho=300", "afl"]


def test_values_may_be_written_without_brackets_and_combine():
    assert names("controller.kind=afl,lqr", "duration=[5, 10.0]") == [
        "afl duration=5",
        "afl duration=10.0",
        "lqr duration=5",
        "lqr duration=10.0",
    ]
    labels = [variant.label for variant in variants(parsed(["seed=[1,2]"]))]
    assert labels == ["seed=1", "seed=2"]
    assert variants({})[0].settings == ()


def test_a_comparison_is_titled_by_what_ran():
    assert comparison("Circle", ["controller.kind"], ["duration=5"]) == (
        "Circle over controller.kind (duration=5)"
    )
    assert comparison("Mine", [], ["title=Mine"]) == "Mine"


@pytest.mark.parametrize(
    "text", ["duration", "=5", "duration=", "a..b=[1]", "seed=[1, 2", "seed=1]"]
)
def test_what_is_no_variation_is_one_line(text):
    with pytest.raises(ScenarioError):
        parsed([text])
