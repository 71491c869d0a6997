"""`docs`.

The pages for maintainers: what they show works, and every generated page can be made again."""

import importlib.util
import re
import shlex
import subprocess
import sys
import tomllib
from collections import Counter
from itertools import pairwise
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from controllers import catalog as catalog_module
from docs import board, code_lines, cure, cure_attacks, regenerate, tuned
from twin.cli import ballplate
from twin.cli.new import new
from twin.run.finished import run
from twin.scenario import load
from twin.scenario.load import check, read, resolve
from twin.scenario.merging import setting
from twin.scenario.variations import parse_variations, variants

ROOT = Path(__file__).parent.parent
EXTENDING = "\n".join(
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in ("law", "extending")
)
SHOWING = (
    "README",
    *(f"docs/{name}" for name in ("run", "see", "own-rig", "one-axis", "law", "wire", "thesis")),
)
"""The pages whose commands change scenarios."""
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
WRITTEN = {
    "board-cure.md", "bus-node.md", "can-findings.md", "can-trace.md", "connect.md",
    "controller-fmu.md", "core.md", "course-in-ten-steps.md", "explained.md", "extending.md",
    "fit.md", "from-matlab.md",
    "glossary.md", "identify.md", "index.md", "installation.md", "labs.md", "law.md", "one-axis.md",
    "own-rig.md", "python.md",
    "rig-in-ten-steps.md", "run.md", "see.md", "simulink.md", "solvers.md", "studies.md",
    "thesis.md", "troubleshooting.md", "tune.md", "tutorial.md", "version-0.1.0.md", "whatif.md",
    "wire.md", "your-rig.md",
}  # fmt: skip
"""Pages without a template that nothing makes."""
SMOOTH = "plant.friction.rolling_mm=0"


def test_the_page_about_the_cure_hides_no_lost_ball_and_no_missed_goal():
    plan = cure.planned("cure")
    plan = {**plan, "laws": plan["laws"][:2], "tasks": plan["tasks"][:2], "rigs": 2}
    plan["noises"] = 2
    first, last = cure.cells(plan, [0.1, 0.3, 0.3, None, 6.0, 4.0, 1.5, 0.9])
    assert first == (0.2, None, 1, (0.1, 0.3), [0.3, None])
    assert last == (5.0, 1.5, 0, (4.0, 6.0), [1.5, 0.9])
    assert cure.cells(plan, [None, 0.3, 0.3, 0.3] * 2)[0].nominal is None
    page = cure.page(plan, {task["name"]: [first, last] for task in plan["tasks"]})
    assert "0.20 / - (1 of 2)" in page
    assert "5.00 / 1.50" in page
    assert "5.00 (4.00 to 6.00), missed" in page
    assert "1.50, missed" in page
    assert cure.verdict(1.0, 1.0) == "1.00, reached"
    assert cure.verdict(None, 1.0) == "-, missed"


def test_the_page_of_attacks_on_the_cure_hides_no_lost_ball_and_every_attack_is_a_scenario():
    plan = tomllib.loads((ROOT / "docs" / "cure_attacks.toml").read_text(encoding="utf-8"))
    page = cure_attacks.filled(
        "cure_attacks", plan=plan, table={"one": [0.123, None]}, said=cure_attacks.said
    )
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
    found = {"failures": failures, "failure_rate_below": 0.2, "cost": cost, "tasks": tasks}
    return found | {"rigs": 12}


@pytest.fixture
def plan():
    return tomllib.loads((ROOT / "docs" / "tuned.toml").read_text(encoding="utf-8"))


@pytest.fixture
def found(plan):
    """What two laws found with the budget of the plan."""
    names = ["AFL, thesis", "AFL, friction known"]
    sides = [(certified(12, None, None), certified(0, 9.0, 0.004))]
    sides.append((certified(0, 3.0, 0.002), certified(1, None, 0.001)))
    chosen = {"chosen": {"fields": {"controller.gains.0": 180.0}}, "kept": False}
    return {
        name: {"before": before, "after": after, **chosen, "search_rigs": 8,
               "candidates": [{"rigs": 0}] + [{"rigs": 4}] * 23 + [{"rigs": 8}]}
        for name, (before, after) in zip(names, sides, strict=True)
    }  # fmt: skip


def test_the_page_of_the_tuned_laws_hides_no_lost_ball(plan, found):
    page = tuned.page(plan, found, tuned.asked(plan)["AFL, thesis"])
    assert "| AFL, thesis | 12 → 0 (below 20 %) | - → 9 | - → 4, 8 |" in page
    assert "| AFL, friction known | 0 → 1 (below 20 %) | 3 → - | 2, 4 → 1, 2 |" in page
    # who loses a rig stands behind whoever loses none
    assert page.index("| AFL, thesis") < page.index("| AFL, friction known")
    assert "| AFL | - (12) | 9 (0) | 3 (0) | - (1) |" in page
    assert "Fewer candidates" not in page


def test_every_law_of_that_page_has_a_tune_of_its_own_and_the_same_budget(plan):
    tunes = tuned.asked(plan)
    assert list(tunes) == [law["name"] for law in plan["laws"]]
    assert len({tune.model_dump_json() for tune in tunes.values()}) == len(tunes)
    assert len({tune.model_dump_json(exclude=tuned.FREE) for tune in tunes.values()}) == 1
    assert all(getattr(tunes["AFL, thesis"], key) is not None for key in tuned.BUDGET)


@pytest.mark.parametrize("more", ["eta = 2", "round = 4", "tail = 0.2", "certificate_draw = 9"])
def test_a_law_that_is_given_more_than_the_others_makes_no_page(plan, tmp_path, more):
    title = 'title = "more"\nlike = "afl"\n'
    (tmp_path / "more.toml").write_text(f"{title}{more}\n", encoding="utf-8")
    law = {"name": "favourite", "tune": str(tmp_path / "more.toml")}
    with pytest.raises(click.ClickException, match=f"favourite: other {more.split()[0]} than"):
        tuned.asked(plan | {"laws": [*plan["laws"], law]})


@pytest.mark.parametrize(
    "more",
    [
        {"candidates": [{"rigs": 8}] * 25},
        {"search_rigs": 16},
        {"after": certified(0, 1.0, 0.001) | {"rigs": 24}},
    ],
    ids=["candidates", "rigs", "fresh rigs"],
)
def test_a_result_of_more_than_the_budget_makes_no_page(plan, found, more):
    found["AFL, thesis"] |= more
    with pytest.raises(click.ClickException, match="AFL, thesis: not the budget of the others"):
        tuned.page(plan, found, tuned.asked(plan)["AFL, thesis"])


def test_a_law_that_ran_fewer_candidates_is_named(plan, found):
    found["AFL, thesis"]["candidates"] = [{"rigs": 0}] * 5 + [{"rigs": 4}] * 20
    assert tuned.fewer(plan, found) == ["AFL, thesis (20)"]


@pytest.mark.long
def test_a_result_of_the_tuned_laws_is_kept_only_while_all_that_a_search_reads_is_the_same(
    plan, monkeypatch
):
    tune = tuned.asked(plan)["AFL, thesis"]
    keys = [tuned.key(tune), tuned.key(tuned.asked(plan | {"candidates": 25})["AFL, thesis"])]
    assert tuned.key(tune) == keys[0]
    read = Path.read_bytes
    for file in (
        "scenarios/families/uncertain.toml",
        "scenarios/tunes/afl.toml",
        "src/twin/tune/search.py",
        "controllers/analysis.py",
        "models/ballplate.xml",
    ):
        changed = (ROOT / file).resolve(strict=True)
        with monkeypatch.context() as patch:
            patch.setattr(
                Path,
                "read_bytes",
                lambda path, changed=changed: read(path) + b"#" * (path.resolve() == changed),
            )
            keys.append(tuned.key(tune))
    for where, other in (
        ((tuned, "version"), lambda _: "9"),
        ((tuned, "code"), lambda: "other"),
        ((tuned, "result"), tuned.order),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(*where, other)
            keys.append(tuned.key(tune))
    assert len(set(keys)) == len(keys) == 10


def test_what_is_kept_for_the_page_of_the_cure_has_all_that_it_depends_on_in_its_key(monkeypatch):
    plan = cure.planned("cure")
    plan = plan | {"rigs": 1, "noises": 1, "laws": plan["laws"][:1]}
    task = plan["tasks"][0]
    runs = cure.scenarios(plan, task)
    keys = [cure.key(runs, "tracking"), cure.key(runs, "median"), cure.key(runs[:1], "tracking")]
    keys += [
        cure.key(cure.scenarios(plan | changed, task), "tracking")
        for changed in (
            {"draw": 8},
            {"family": "placed"},
            {"scenario": "cure"},
            {"set": [*plan["set"], "plant.friction.rolling_mm=0.2"]},
            {"laws": [{"set": ['controller={kind="afl",gains=[181.0,162.0,66.0,13.0]}']}]},
        )
    ]
    for name, other in (("BAND", 0.006), ("EVERY", 1), ("simulated", cure.cells)):
        with monkeypatch.context() as patch:
            patch.setattr(cure, name, other)
            keys.append(cure.key(runs, "tracking"))
    with monkeypatch.context() as patch:
        patch.setattr(cure, "code", lambda: "other")
        keys.append(cure.key(runs, "tracking"))
    assert cure.key(cure.scenarios(plan, task), "tracking") == keys[0]
    assert len(set(keys)) == len(keys) == 12


@pytest.mark.parametrize("number", [4, 6])
def test_every_law_of_the_page_about_the_cure_is_made_for_a_task(number):
    plan = cure.planned("cure") | {"rigs": 1}
    runs = cure.scenarios(plan, plan["tasks"][number])
    assert len(runs) == (plan["noises"] + 1) * len(plan["laws"])
    kinds = {run.controller.kind for run in runs}
    assert {"stable_inversion", "tvlqr", "internal_model", "iterative_learning", "mpc"} < kinds


def test_every_file_of_docs_is_written_by_hand_or_made_by_one_command():
    docs = ROOT / "docs"
    made = [
        path
        for page in regenerate.PAGES.values()
        for pattern in page.files
        for path in docs.glob(pattern)
    ]
    assert len(made) == len(set(made))
    assert all(list(docs.glob(each)) for page in regenerate.PAGES.values() for each in page.files)
    left_out = {"__pycache__", "changes"}
    here = {path for path in docs.rglob("*") if path.is_file() and not left_out & {*path.parts}}
    left = here - set(made)
    suffixes = {".py", ".toml", ".css", ".js"}
    makers = {each for each in left if each.suffix in suffixes or ".template." in each.name}
    assert left - makers == {docs / name for name in WRITTEN}


def test_cycles_of_a_processor_are_those_of_its_manual():
    """One period of five instructions, as the manual counts them: 1, 14, 1 + 2, 1 + P, 1."""
    names = (("adds", ""), ("vdiv", ""), ("push", "{r4, lr}"), ("bne", ""), ("vmulgt", ""))
    known = {
        2 * place: board.Instruction(name, board.count_registers(what), 2, "step")
        for place, (name, what) in enumerate(names)
    }
    for after, jump in ((8, 0), (100, 1)):
        known[100] = known[8]
        passed = [0, 2, 4, 6, after, after + 2]
        least, most = (5 * each for each in board.cycles(passed, known))
        assert least == pytest.approx(1 + 14 + 3 + 1 + jump + 1)
        assert most == pytest.approx(1 + 15 + 3 + 1 + 3 * jump + 2)
    assert board.count_registers("{r4, s16-s20, pc}") == 7
    known[2] = known[2]._replace(name="sha256h")
    with pytest.raises(ValueError, match=r"no cycles of sha256h"):
        board.cycles([0, 2, 4], known)


RETURNING = re.compile(
    r"\b(?:told|judge[ds]?|beside|whoever|wished|laid|anew)\b|\bfrom which on\b"
    r"|\bwhat\b[^.,;:|]{0,40}\b(?:makes?|tells?|says?|said|did|knows?|becomes?|is|was) of\b",
    re.IGNORECASE,
)
"""Words and a turn of phrase that came back into the pages; CONTRIBUTING.md has plain ones."""
STAYS = {
    "CONTRIBUTING.md": "its table lists the words",
    "fault-matrix.md": "texts of conditions and of causes, which tables of the program give",
    "safety.md": "names of conditions, which tables of the program give",
}


def written_words(page):
    """The prose of a page: without code, places of a template, and targets of links."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`]*`|\{\{.*?\}\}|\{%.*?%\}|\]\([^)]*\)", "", text)


def test_words_that_have_a_plain_one_stand_on_no_page_without_a_reason():
    pages = {page.name: RETURNING.findall(written_words(page)) for page in PAGES}
    assert {name: found for name, found in pages.items() if found and name not in STAYS} == {}
    assert STAYS.keys() <= {name for name, found in pages.items() if found}


def test_messages_and_options_of_the_page_of_problems_are_those_of_the_program():
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    sources = "\n".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "src" / "twin").rglob("*.py")
    )
    messages = re.findall(r"(?<!\*)\*([a-z][^*]+)\*(?!\*)", page)
    options = re.findall(r"--[a-z]+", page)
    assert len(messages) > 4
    assert len(options) > 4
    assert [each for each in messages if each not in sources] == []
    assert [each for each in options if f'"{each}' not in sources and each != "--extra"] == []


def test_every_note_of_a_change_becomes_a_part_of_the_changelog():
    notes = ROOT / "docs" / "changes"
    kinds = "added|changed|fixed|removed"
    for note in notes.iterdir():
        assert note.name == "README.md" or re.fullmatch(rf"\+[\w-]+\.({kinds})\.md", note.name)
    command = [sys.executable, "-m", "towncrier", "build", "--draft", "--version", "9.9.9"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    for note in notes.glob("+*.md"):
        assert note.read_text(encoding="utf-8").split()[-1] in done.stdout, note.name
    assert done.stdout.startswith("## 9.9.9")


def test_no_page_is_longer_than_250_lines():
    pages = [path for path in (ROOT / "docs").rglob("*.md") if ".template" not in path.name]
    lines = {path.name: path.read_text(encoding="utf-8").count("\n") for path in pages}
    del lines["fault-matrix.md"]  # one row for each fault
    assert {name: count for name, count in lines.items() if count > 250} == {}


def test_every_command_that_makes_a_page_can_be_parsed():
    for page in regenerate.PAGES.values():
        name, *arguments = page.command
        if name.endswith(".py"):
            assert (ROOT / "docs" / name).is_file()
            assert regenerate.program(page, "")[2:] == arguments
            continue
        if name == "-m":
            package = importlib.util.find_spec(arguments[0]).submodule_search_locations is not None
            module = importlib.import_module(arguments[0] + ".__main__" * package)
            assert module.parser().parse_args(arguments[1:]).doc == Path("docs", page.files[0])
            continue
        command = ballplate.get_command(click.Context(ballplate), name)
        command.make_context(name, list(arguments))


def test_a_page_of_an_unknown_name_is_refused_and_the_known_ones_are_listed():
    with pytest.raises(click.BadParameter, match=r"'saftey' is not .*'safety'"):
        regenerate.main.make_context("regenerate", ["saftey"])


def anchors(page):
    """What a link may name of a page: its headings, as GitHub and MyST write them."""
    text = re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    heads = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}


def test_every_file_and_heading_that_a_page_links_to_exists():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)]+)", page.read_text(encoding="utf-8")):
            if "://" in target or "{{" in target:  # elsewhere, or of a template
                continue
            name, _, anchor = target.partition("#")
            file = page.parent / name if name else page
            assert file.exists(), f"{page.name}: {target}"
            assert not anchor or anchor in anchors(file), f"{page.name}: {target}"


def test_every_module_that_the_architecture_names_exists():
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    folders = ("src", "controllers", "docs", "tests", "benchmarks", "release")
    there = [f"/{file.as_posix()}" for each in folders for file in (ROOT / each).rglob("*.py")]
    named = re.findall(r"`([\w-]+(?:/[\w-]+)*\.py)`", text)
    assert len(named) > 10
    assert not [each for each in named if not any(file.endswith(f"/{each}") for file in there)]


def test_the_index_lists_every_page_once():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    lists = index[index.index("\n## ") :]
    linked = Counter(re.findall(r"\]\((?!\.\.)([^)]+)\)", lists))
    here = (path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md"))
    pages = {path.as_posix() for path in here if ".template" not in path.name} - {"index.md"}
    pages = {page for page in pages if not page.startswith("changes/")}
    assert linked == dict.fromkeys(pages, 1)


@pytest.fixture
def dropped(tmp_path, monkeypatch):
    """The law of docs/law.md, observer and reference of docs/extending.md, as they say."""
    monkeypatch.chdir(tmp_path)
    for kind, name in re.findall(r"`(?:uv run )?ballplate new (\w+) (?!NAME)(\w+)`", EXTENDING):
        assert CliRunner().invoke(new, [kind, name]).exit_code == 0
    catalog_module.forget()
    yield
    catalog_module.forget()


CIRCLE = "reference.kind=circle reference.amplitude=0.1 duration=10 metrics.start=7"


@pytest.mark.parametrize(
    ("keys", "most"),
    [
        (f"controller.kind=cascade {CIRCLE}", 15),
        pytest.param(
            "observer.kind=alpha_beta duration=8 metrics.start=6", 2, marks=pytest.mark.long
        ),
    ],
)
def test_law_and_observer_of_the_pages_are_found_and_lead_the_ball(dropped, scenario, keys, most):
    done = run(scenario(SMOOTH, *keys.split()))
    assert done.outcome == "finished"
    assert done.metrics["tracking_error_percent"] < most


def test_the_settings_of_the_pages_law_are_checked_like_all_others(dropped, scenario):
    with pytest.raises(ValueError, match=r"controller\.bal: unknown key; did you mean 'ball'"):
        scenario("controller.kind=cascade", "controller.bal=[1,1]")


@pytest.mark.long
def test_the_reference_of_the_page_is_found_and_followed(dropped, scenario):
    done = run(scenario(SMOOTH, "reference.kind=drift", "reference.rate=[0.01, 0]", "duration=6"))
    assert done.motion.reference[-1] == pytest.approx([0.06, 0.0], abs=1e-3)
    assert done.motion.ball[-1] == pytest.approx([0.06, 0.0], abs=0.02)


@pytest.mark.long
def test_the_lines_that_the_architecture_gives_a_layer_are_those_it_has_within_a_tenth():
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = {places: int(count.replace(",", "")) for places, count in code_lines.ROW.findall(text)}
    layers = (ROOT / "src" / "twin").glob("*/__init__.py")
    assert {f"src/twin/{each.parent.name}" for each in layers} <= set(rows)
    for places, count in rows.items():
        assert count == pytest.approx(code_lines.counted(places), rel=0.1), places


def test_every_change_of_a_scenario_that_a_page_shows_is_accepted(dropped, tmp_path):
    fitted = tmp_path / "runs" / "identify-excite" / "parameters.toml"
    fitted.parent.mkdir(parents=True)
    fitted.write_text("[plant.friction]\nrolling_mm = 0.2\n", encoding="utf-8")
    changed = set()
    shown = "\n".join((ROOT / f"{name}.md").read_text(encoding="utf-8") for name in SHOWING)
    for line in re.findall(r"^uv run ballplate ((?:run|compare) .*)", shown, re.MULTILINE):
        _, scenario, *options = shlex.split(line, comments=True)
        given = list(pairwise(options))
        fixed = [text for option, text in given if option == "--set"]
        varied = [text for option, text in given if option == "--vary"]
        if scenario.startswith("runs/") or scenario.endswith(".csv"):
            continue  # finished runs and logs
        for variant in variants(parse_variations(varied)):
            changes = [*map(setting, fixed), *variant.settings]
            check(*resolve(*read(scenario), changes))
        changed |= {text.partition("=")[0] for text in (*fixed, *varied)}
    assert changed == {
        "controller", "controller.ball", "controller.kind", "parameters",
        "plant.friction.rolling_mm", "seed",
    }  # fmt: skip


def folders_made(command):
    """The run folders that a command writes, by its words."""
    verb, *words = command
    if "--out" in words:
        return {words[words.index("--out") + 1]}
    if verb == "run" and not {"--set", "--on", "--plant", "--rig", "--board"} & set(words):
        return {f"runs/{words[0]}"}
    if verb in ("identify", "whatif"):
        return {f"runs/{verb}-{Path(words[0]).stem}"}
    return set()


@pytest.mark.parametrize("page", ["own-rig", "whatif", "from-matlab", "rig-in-ten-steps"])
def test_every_run_that_a_page_opens_was_made_by_a_command_above(page):
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    blocks = "".join(re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    lines = re.findall(r"^(?:uv run )?ballplate (.*)", blocks.replace("\\\n", ""), re.MULTILINE)
    made = set()
    for line in lines:
        command = shlex.split(line, comments=True)
        opened = set(re.findall(r"(?<![\w/])runs/[\w-]+", line.partition("#")[0]))
        assert opened <= made | folders_made(command), line
        made |= folders_made(command)
    assert made
