"""The pages for maintainers: what they show works, and every generated page can be made again."""

import importlib.util
import re
import tomllib
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from controllers import catalog as catalog_module
from controllers.catalog import catalog
from controllers.interfaces import Observer, Reference
from twin.cli import COMMANDS, ballplate
from twin.cli.new import new
from twin.run.execute import run
from twin.scenario import load

ROOT = Path(__file__).parent.parent
EXTENDING = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
WRITTEN = {
    "extending.md",
    "fit.md",
    "glossary.md",
    "studies.md",
    "tune.md",
    "whatif.md",
    "regenerate.py",
    "play_picture.py",
    "screenshots.py",
} | {
    "bring_up.py",
    "bring-up.template.md",
    "cure.py",
    "cure.toml",
    "cure_floor.py",
    "cure_attacks.py",
    "cure_attacks.toml",
    "shadow_trials.py",
    "tuned.py",
    "tuned.toml",
}
SMOOTH = "plant.friction.rolling_mm=0"


def script(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def regenerate():
    return script("regenerate")


def test_the_page_about_the_cure_hides_no_lost_ball_and_no_missed_goal():
    cure = script("cure")
    plan = tomllib.loads((ROOT / "docs" / "cure.toml").read_text(encoding="utf-8"))
    plan = {**plan, "laws": plan["laws"][:2], "tasks": plan["tasks"][:2], "rigs": 2}
    plan["noises"] = 2
    first, last = cure.cells(plan, [0.1, 0.3, 0.3, None, 6.0, 4.0, 1.5, 0.9])
    assert first == (0.2, None, 1, (0.1, 0.3), [0.3, None])
    assert last == (5.0, 1.5, 0, (4.0, 6.0), [1.5, 0.9])
    assert cure.cells(plan, [None, 0.3, 0.3, 0.3] * 2)[0].nominal is None
    page = cure.page(plan, {plan["tasks"][0]["name"]: [first, last]})
    assert "0.20 / - (1 of 2)" in page
    assert "5.00 / 1.50" in page
    assert "5.00 (4.00 to 6.00), missed" in page
    assert "1.50, missed" in page
    assert "Not simulated for this page: circle 0.75 rad/s." in page
    assert cure.verdict(1.0, 1.0) == "1.00, reached"
    assert cure.verdict(None, 1.0) == "-, missed"


def test_the_page_of_attacks_on_the_cure_hides_no_lost_ball_and_every_attack_is_a_scenario():
    attacks = script("cure_attacks")
    plan = tomllib.loads((ROOT / "docs" / "cure_attacks.toml").read_text(encoding="utf-8"))
    page = attacks.page(plan, {"one": [0.123, None]})
    assert "| one | 0.12 | - |" in page
    every = {
        load(plan["scenario"], [*plan["set"], *task["set"], *attack["set"]]).model_dump_json()
        for task in plan["tasks"]
        for attack in plan["attacks"]
    }
    assert len(every) == len(plan["tasks"]) * len(plan["attacks"])


def certified(failures, cost, median):
    task = {"median": median, "largest": None if median is None else 2 * median}
    tasks = dict.fromkeys(("circle", "line", "hold", "step"), task)
    return {"failures": failures, "failure_rate_below": 0.2, "cost": cost, "tasks": tasks}


def test_the_page_of_the_tuned_laws_hides_no_lost_ball_and_no_law_that_is_left_out():
    tuned = script("tuned")
    plan = tomllib.loads((ROOT / "docs" / "tuned.toml").read_text(encoding="utf-8"))
    names = ["AFL, thesis", "AFL, friction known"]
    sides = [(certified(12, None, None), certified(0, 9.0, 0.004))]
    sides.append((certified(0, 3.0, 0.002), certified(1, None, 0.001)))
    chosen = {"chosen": {"fields": {"controller.gains.0": 180.0}}, "kept": False}
    found = {
        name: {"before": before, "after": after, **chosen}
        for name, (before, after) in zip(names, sides, strict=True)
    }
    page = tuned.page(plan, found, tuned.asked(plan, plan["laws"][0]))
    assert "| AFL, thesis | 12 → 0 (below 20 %) | - → 9 | - → 4, 8 |" in page
    assert "| AFL, friction known | 0 → 1 (below 20 %) | 3 → - | 2, 4 → 1, 2 |" in page
    # who loses a rig wins nothing, and stands behind whoever loses none
    assert page.index("| AFL, thesis") < page.index("| AFL, friction known")
    row = "| hold | AFL, friction known: 2 | AFL, thesis: 4 | AFL, friction known: 4 |"
    assert f"{row} AFL, thesis: 8 |" in page
    assert "| AFL | - (12) | 9 (0) | 3 (0) | - (1) |" in page
    left = page[page.index("Not tuned for this page:") :]
    assert all(law["name"] in left for law in plan["laws"] if law["name"] not in names)


def test_every_law_of_that_page_has_a_tune_and_the_same_budget():
    tuned = script("tuned")
    plan = tomllib.loads((ROOT / "docs" / "tuned.toml").read_text(encoding="utf-8"))
    tunes = [tuned.asked(plan, law) for law in plan["laws"]]
    alike = {"tasks", "limits", "tail", "family", "draw", "certificate_draw", *tuned.BUDGET}
    assert len({tune.model_dump_json(include=alike) for tune in tunes}) == 1
    assert len({tune.model_dump_json() for tune in tunes}) == len(tunes)


@pytest.mark.parametrize("number", [4, 6])
def test_every_law_of_the_page_about_the_cure_is_made_for_a_task(number):
    cure = script("cure")
    plan = tomllib.loads((ROOT / "docs" / "cure.toml").read_text(encoding="utf-8")) | {"rigs": 1}
    runs = cure.scenarios(plan, plan["tasks"][number])
    assert len(runs) == (plan["noises"] + 1) * len(plan["laws"])
    kinds = {run.controller.kind for run in runs}
    assert {"stable_inversion", "tvlqr", "internal_model", "iterative_learning", "mpc"} < kinds


def test_every_file_of_docs_is_written_by_hand_or_made_by_one_command(regenerate):
    docs = ROOT / "docs"
    made = [
        path
        for page in regenerate.PAGES.values()
        for pattern in page.files
        for path in docs.glob(pattern)
    ]
    assert len(made) == len(set(made))
    assert all(list(docs.glob(each)) for page in regenerate.PAGES.values() for each in page.files)
    here = {path for path in docs.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert here - set(made) == {docs / name for name in WRITTEN}


def test_every_command_that_makes_a_page_can_be_parsed(regenerate):
    for page in regenerate.PAGES.values():
        name, *arguments = page.command
        if name.endswith(".py"):
            assert (ROOT / "docs" / name).is_file()
            continue
        if name == "-m":
            package = importlib.util.find_spec(arguments[0]).submodule_search_locations is not None
            module = importlib.import_module(arguments[0] + ".__main__" * package)
            assert module.parser().parse_args(arguments[1:]).doc == Path("docs", page.files[0])
            continue
        command = ballplate.get_command(click.Context(ballplate), name)
        command.make_context(name, list(arguments))


def test_a_page_of_an_unknown_name_is_refused_and_the_known_ones_are_listed(regenerate):
    with pytest.raises(click.BadParameter, match=r"'saftey' is not .*'safety'"):
        regenerate.main.make_context("regenerate", ["saftey"])


def test_every_file_that_a_page_links_to_exists():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_command_that_a_page_shows_exists():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert set(re.findall(r"uv run ballplate (\w+)", text)) <= set(COMMANDS), page.name


@pytest.fixture
def dropped(tmp_path, monkeypatch):
    """The observer and the reference of docs/extending.md, written as the page says."""
    monkeypatch.chdir(tmp_path)
    page = EXTENDING
    for kind, name in re.findall(r"`ballplate new (observer|reference) (\w+)`", page):
        assert CliRunner().invoke(new, [kind, name]).exit_code == 0
    catalog_module.forget()
    yield
    catalog_module.forget()


@pytest.mark.long
def test_the_observer_of_the_page_is_found_and_drives_the_ball_to_its_place(dropped, scenario):
    assert "alpha_beta" in catalog(Observer)
    done = run(scenario(SMOOTH, "observer.kind=alpha_beta", "duration=8", "metrics.start=6"))
    assert done.outcome.ending == "finished"
    assert done.metrics.tracking_error_percent < 2


def test_the_settings_of_the_observer_of_the_page_are_checked_like_all_others(dropped, scenario):
    with pytest.raises(ValueError, match=r"observer\.bal: unknown key; did you mean 'ball'"):
        scenario("observer.kind=alpha_beta", "observer.bal=[0.1, 0.1]")


@pytest.mark.long
def test_the_reference_of_the_page_is_found_and_followed(dropped, scenario):
    assert "drift" in catalog(Reference)
    done = run(scenario(SMOOTH, "reference.kind=drift", "reference.rate=[0.01, 0]", "duration=6"))
    assert done.motion.reference[-1] == pytest.approx([0.06, 0.0], abs=1e-3)
    assert done.motion.ball[-1] == pytest.approx([0.06, 0.0], abs=0.02)
