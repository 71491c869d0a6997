"""The commands lab and bench: answers and laws of others, graded and compared."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.base.errors import RecordError, ScenarioError, naming, plural, suggest
from twin.base.jobs import cores
from twin.base.page import Table
from twin.base.shipped import shipped_labs, titles
from twin.base.writing import check_writable
from twin.cli import options
from twin.cli.options import JSON_OPTION, PATH_TYPE, PROCESSES_OPTION, Command, Group
from twin.cli.output import TERMINAL, progress, say, show, show_titles, warn
from twin.lab import SCORES_FILE

if TYPE_CHECKING:
    from twin.lab.bench import Benchmark
    from twin.lab.bench_scores import BenchScore
    from twin.lab.schema import Lab
    from twin.lab.selftest import Finding


BENCHMARK_HEADINGS = (
    "task",
    "error",
    "95 % interval",
    "worst tenth",
    "balls kept",
    "95 % interval",
    "effort",
)
BENCHMARK_NOTE = (
    "error: relative to the reference law on the same rig and noise, interquartile mean; "
    "effort: median of the RMS plate acceleration, rad/s^2"
)
SEASON_OPTION = click.option(
    "--season", metavar="KEY", help="Take the 64 rigs that this key draws, not the frozen ones."
)


@click.group(cls=Group, example="bench run my_law.py --out entry")
def bench() -> None:
    """The public benchmark: the same tasks on the same 128 rigs for every law."""


@bench.command("list", cls=Command, example="bench list", reads=True)
@SEASON_OPTION
@JSON_OPTION
def list_laws(season: str | None) -> int:
    """List the laws of this project, which are the first entries.

    With the key of a season print the key's fingerprint instead, with --json also the rigs.
    """
    from twin.lab.bench import Benchmark, rigs_of

    benchmark = Benchmark(key=season)
    if season is None:
        show_titles({name: law.title for name, law in benchmark.about.laws.items()})
        return 0
    found = {"season": benchmark.season, "rigs": benchmark.points, "seeds": benchmark.seeds}
    show(found, [rigs_of(benchmark.season)])
    return 0


@contextmanager
def _count_runs(title: str, benchmark: Benchmark) -> Iterator[Callable[[int, int], None]]:
    count = len(benchmark.points) * benchmark.about.seeds * len(benchmark.about.tasks)
    with progress(title, count, "runs") as advance:
        yield lambda done, lost: advance(done, f"{lost} not finished")


def _refuse_rig(_: click.Context, __: click.Parameter, rig: str | None) -> None:
    """Report that the benchmark has rigs of its own, of two axes."""
    if rig is not None:
        compared = f"""ballplate compare line --on {rig} --vary 'controller.kind=["pid", "lqr"]'"""
        raise ScenarioError(
            f"--on {rig}: the benchmark has rigs of its own, plates of two axes; to compare laws "
            f"on this rig: {compared}"
        )


@bench.command(cls=Command, example="bench run my_law.py --out entry")
@click.argument("entry")
@click.option("--on", hidden=True, expose_value=False, callback=_refuse_rig)
@click.option("--out", type=PATH_TYPE, help="Folder of the entry [runs/bench-ENTRY].")
@SEASON_OPTION
@PROCESSES_OPTION
@options.SCHEDULER_OPTION
@JSON_OPTION
def run(
    entry: str, out: Path | None, season: str | None, processes: int | None, scheduler: str | None
) -> int:
    """Run an entry: a law's file, a folder with an entry.toml, or a law of ``bench list``.

    Code of an entry runs in a process of its own that sees measurements and nothing else.
    Finished runs are kept: an interrupted command continues. On the rigs of a season the
    reference law is run first, once for all entries.
    """
    from twin.lab.bench import Benchmark, rigs_of
    from twin.study.experiments import Store, executors

    benchmark = Benchmark(key=season)
    name, about, place = benchmark.entry(entry)
    folder = check_writable(out or benchmark.out(name))
    with executors(processes, scheduler) as (executor, count):
        how: dict[str, Any] = {"executor": executor, "processes": count}
        if season:
            with _count_runs("reference law", benchmark) as progress:
                benchmark.known(progress=progress, **how)
        minutes = max(1, round(benchmark.processor_time(about, place) / count / 60))
        TERMINAL.note(f"{about.title}: all runs take about {minutes} min, {count} side by side")
        with _count_runs(about.title, benchmark) as progress:
            rows = benchmark.run_entry(about, place, Store(folder), progress=progress, **how)
    found = benchmark.write(folder, about, place, rows)
    files = "entry.toml, runs.parquet, scores.json, commands.npz"
    shown = _table(f"{about.title}, on {rigs_of(benchmark.season)}", found)
    show([each._asdict() for each in found], [shown], folder, files)
    return 0


def _check_finished(entries: Iterable[Path]) -> None:
    """Check that folders hold finished entries, before anything heavy is loaded.

    Raises:
        RecordError: If one holds no scores.
    """
    for each in entries:
        if not (each / SCORES_FILE).exists():
            where = f"it has no {SCORES_FILE}" if each.exists() else "no such folder"
            raise RecordError(f"{each}: no finished entry: {where}; ballplate bench run writes one")


@bench.command(cls=Command, example="bench verify entry", reads=True)
@click.argument("entry", required=False, type=PATH_TYPE)
@SEASON_OPTION
@JSON_OPTION
def verify(entry: Path | None, season: str | None) -> int:
    """Verify an entry: its scores, and its commands replayed; none of its code is run.

    Only the commands on the first rigs are replayed; for the others the file of runs is
    trusted. Without an ENTRY the benchmark itself is verified: its files, and errors of its
    laws on the first rigs. Exit code 1 where anything differs. An entry of a season needs its
    key, and the reference law is run once.
    """
    if season is not None and entry is None:
        raise click.UsageError("--season: needs the ENTRY to verify")
    _check_finished([entry] if entry else ())
    from twin.lab.bench import Benchmark

    benchmark = Benchmark(key=season)
    with _count_runs("reference law", benchmark) if season else nullcontext() as progress:
        replayed = benchmark.replay(entry, progress=progress) if entry else benchmark.differences()
        wrong = list(replayed)
    right = (
        "the benchmark: as it was frozen" if entry is None else f"{entry}: {benchmark.confirmed}"
    )
    show(wrong, wrong or [right])
    return 1 if wrong else 0


@bench.command(cls=Command, example="bench table runs/bench-lqr runs/bench-afl", reads=True)
@click.argument("entries", nargs=-1, required=True, type=PATH_TYPE)
@JSON_OPTION
def table(entries: Sequence[Path]) -> int:
    """Compare finished entries: the relative error of each in each task."""
    _check_finished(entries)
    from twin.lab.bench import rigs_of, scores_side_by_side

    found, season = scores_side_by_side(entries)
    tasks = [each["task"] for each in next(iter(found.values()))]
    cells = [
        (name, *(f"{each['error']:.3g} ({each['kept']} kept)" for each in its))
        for name, its in found.items()
    ]
    show(found, [Table(f"On {rigs_of(season)}", ("entry", *tasks), cells, words=(0,))])
    return 0


def _table(title: str, scores: Sequence[BenchScore]) -> Table:
    cells = [
        (
            each.task,
            f"{each.error:.3f}",
            f"{each.low:.3f} to {each.high:.3f}",
            f"{each.worst:.3f}",
            str(each.kept),
            f"{100 * each.kept_low:.1f} to {100 * each.kept_high:.1f} %",
            f"{each.effort:.2f}",
        )
        for each in scores
    ]
    return Table(title, BENCHMARK_HEADINGS, cells, words=(0,), note=BENCHMARK_NOTE)


def _lab(_: click.Context, __: click.Parameter, name: str) -> Lab:
    """The lab of a name or a folder."""
    from twin.lab.schema import read

    return read(name)


def _text(key: Path | None) -> str | None:
    """The course's key out of its file."""
    if key is None:
        return None
    from twin.lab.schema import text_of

    text = text_of(key, f"--key {key}").strip()
    if len(text) < 8:
        raise ScenarioError(f"--key {key}: a key has at least 8 characters")
    return text


def _warn_of_practice(lab: Lab, key: Path | None) -> None:
    """Warn a lecturer who draws or grades the rigs of a class without its key."""
    if key is None and lab.variant is not None:
        warn("without --key the rigs are for practice: every student can draw all of them")


def _refuse_missing(answer: Path | None, name: str, *, graded: bool) -> None:
    """Report an answer that does not exist, before anything heavy is loaded.

    Args:
        answer: The file, or a folder with it; None for the current folder.
        name: The lab.
        graded: Whether a folder without an answer is graded, as a course's program wants it.
    """
    if (answer is None or answer.is_dir()) and not graded:
        from twin.lab.schema import read

        file = (answer or Path()) / read(name).answer.file
        if not file.exists():
            there = f"{answer}/" if answer else "this folder"
            raise ScenarioError(
                f"{file.name}: not in {there}; give the folder that `ballplate lab start` wrote, "
                f"or go into it: cd {shlex.quote(name)}-STUDENT"
            )
    elif answer is not None and not answer.exists():
        files = sorted(each.name for each in answer.parent.glob(f"*{answer.suffix}"))
        meant = suggest(answer.name, files)
        raise ScenarioError(f"{answer}: no such file{meant}")


LAB_ARGUMENT = click.argument("lab", callback=_lab)
KEY_OPTION = click.option("--key", type=PATH_TYPE, help="File with the course's key.")
NOTEBOOK_OPTION = click.option(
    "--notebook", is_flag=True, help="Also a notebook of sheet, starter and check."
)


@click.group(cls=Group, example="lab check signs answer.py")
def lab() -> None:
    """Labs that grade themselves; each student has a rig of their own."""


@lab.command("list", cls=Command, example="lab list", reads=True)
@JSON_OPTION
def list_labs() -> int:
    """List the shipped labs."""
    files = {name: place / "lab.toml" for name, place in shipped_labs().items()}
    show_titles(titles(files))
    return 0


@lab.command(cls=Command, example="lab new friction2 --like friction")
@click.argument("name")
@click.option("--like", help="Lab to copy whole, a name or a folder [a small one].")
@click.option("--out", type=PATH_TYPE, help="New folder [NAME].")
def new(name: str, like: str | None, out: Path | None) -> int:
    """Write a lab of your own that passes its selftest, to be changed piece by piece.

    With --like it is a whole copy: sheet, checks, hidden checks, solution and mutants.
    """
    from twin.lab.packs import begin
    from twin.lab.schema import read

    folder = out or Path(name)
    with naming("--like"):
        copied = read(like) if like else None
    begin(name, folder, copied)
    if not any(folder.glob("solution.*")):
        warn("the copy has no solution and no mutants: only a clone of the repository has them")
    say(f"{folder}/: begin with lab.toml and solution.py; then: ballplate lab selftest {folder}")
    return 0


@lab.command(cls=Command, example="lab start signs --student ann")
@LAB_ARGUMENT
@click.option("--student", required=True, help="Your name or number, as --student 123456.")
@click.option("--out", type=PATH_TYPE, help="New folder [LAB-STUDENT].")
@KEY_OPTION
@NOTEBOOK_OPTION
def start(lab: Lab, student: str, out: Path | None, key: Path | None, *, notebook: bool) -> int:
    """Begin a lab: the sheet, a starter that runs, the rig of your own.

    Without the course's key the rig is one to practise on; your lecturer hands out yours.
    """
    from twin.lab.handing_out import hand_out

    folder = out or Path(f"{lab.name}-{student}")
    hand_out(lab, {student: "."}, _text(key), folder, notebook=notebook)
    files = f"task.md, {lab.answer.file}, rig.toml{f', {lab.name}.ipynb' if notebook else ''}"
    into = f"cd {shlex.quote(str(folder))}"
    say(f"{folder}/: {files}; then: {into}; ballplate lab check {lab.called}")
    return 0


@lab.command(cls=Command, example="lab check signs answer.py")
@click.argument("lab")
@click.argument("answer", required=False, type=PATH_TYPE)
@click.option("--student", help="Owner of the rig if no rig.toml next to the answer names one.")
@KEY_OPTION
@click.option("--hidden", is_flag=True, help="Grade hidden checks, too, if they are there.")
@click.option("--as", "form", type=click.Choice(["json", "gradescope", "classroom50", "junit"]))
@click.option("--out", type=options.WRITABLE_FILE, help="File to write the result to.")
@click.option(
    "--page",
    type=options.WRITABLE_FILE,
    help="HTML page to write, with a picture of the worst run.",
)
@JSON_OPTION
def check(key: Path | None, form: str | None, out: Path | None, **how: Any) -> int:
    """Grade an answer: what passed, why not, where to look; exit code 1 if a check did not pass.

    The answer is a file, or a folder with it; by default the current folder.
    """
    _refuse_missing(how["answer"], how["lab"], graded=form is not None)
    from ballplate.lab import check as judge
    from twin.base.writing import write_whole

    if form is not None and out is None:
        raise ScenarioError(f"--as {form}: needs --out, the file to write the result to")
    from twin.lab.result_files import format_result
    from twin.lab.result_texts import table

    result = judge(**how, key=_text(key))
    if out is not None:
        write_whole(out, format_result(result, form or "json"))
    show(result, [table(result)], out and out.parent, out.name if out else "")
    return 0 if all(each["passed"] for each in result["results"]) else 1


@lab.command(cls=Command, example="lab variants signs class.csv --key key.txt")
@LAB_ARGUMENT
@click.argument("students", type=PATH_TYPE)
@KEY_OPTION
@click.option("--out", type=PATH_TYPE, help="New folder with one a student [variants-LAB].")
@NOTEBOOK_OPTION
def variants(
    lab: Lab, students: Path, key: Path | None, out: Path | None, *, notebook: bool
) -> int:
    """Draw a rig for every student of a class, and write the folder that each begins with.

    The class is a CSV file; its first column names the students, below a heading.
    """
    from twin.lab.handing_out import hand_out, read_class

    _warn_of_practice(lab, key)
    people, folder = read_class(students), out or Path(f"variants-{lab.name}")
    places = {student: student for student in people}
    hand_out(lab, places, _text(key), folder, notebook=notebook)
    say(f"{folder}/: {plural(len(people), 'rig')}")
    return 0


@lab.command(cls=Command, example="lab grade signs submissions --key key.txt --out marks.csv")
@LAB_ARGUMENT
@click.argument("folder", metavar="SUBMISSIONS", type=PATH_TYPE)
@KEY_OPTION
@click.option("--class", "people", type=PATH_TYPE, help="CSV file of the class: who may hand in.")
@click.option(
    "--out",
    type=options.WRITABLE_FILE,
    default=Path("marks.csv"),
    help="File of the marks [marks.csv].",
)
@PROCESSES_OPTION
@JSON_OPTION
def grade(lab: Lab, folder: Path, people: Path | None, out: Path, **given: Any) -> int:
    """Grade the answers of a class, a folder or a file per student, on the rigs the key deals.

    Every result and its page are kept when they are finished, in a folder next to the marks: a
    killed command continues where it was, an unchanged answer is not evaluated again. A page next
    to the marks has the class.
    """
    from twin.base.writing import write_whole, written_alone
    from twin.lab.copies import find_alike
    from twin.lab.grade import grade as grade_class
    from twin.lab.handed_in import collect
    from twin.lab.handing_out import read_class
    from twin.lab.pages import class_page
    from twin.lab.result_files import marks
    from twin.lab.result_texts import summary

    if out.suffix != ".csv":
        raise ScenarioError(f"--out {out}: must end in .csv")
    with naming("--class"):
        names = read_class(people) if people else None
    _warn_of_practice(lab, given["key"])
    processes, key = given["processes"] or cores(), _text(given["key"])
    collected, kept = collect(lab, folder, names or ()), out.with_suffix(".results")
    handed_in = collected.submissions
    for line in collected.left_out:
        warn(f"among the submissions: {line}")
    with written_alone(kept), progress("grade", len(handed_in), "answers") as advance:
        found = grade_class(lab, key, names, handed_in, kept, processes, advance)
    write_whole(out, marks(lab, found))
    page = out.with_suffix(".html")
    alike = [each.text(lab.language) for each in find_alike(lab, key, names or (), handed_in)]
    left_out = collected.left_out
    text = class_page(lab, found, kept, left_out, people=names, alike=alike)
    write_whole(page, text)
    files = f"{out.name}, {page.name}; of each student {kept.name}/"
    show(found, [summary(found, lab.language), *alike], out.parent, files)
    return 1 if any("problem" in each for each in found) else 0


def _show_findings(lab: Lab, found: Iterable[Finding]) -> int:
    """Show what was found of a lab; the exit code."""
    every = list(found)
    rows = [(each.what, "yes" if each.good else "NO", each.found) for each in every]
    shown = Table(f"Lab {lab.called}", ("what", "", "found"), rows, words=(0, 1, 2))
    show([each._asdict() for each in every], [shown])
    return 0 if all(each.good for each in every) else 1


@lab.command(cls=Command, example="lab selftest signs")
@LAB_ARGUMENT
@click.option("--starter", is_flag=True, help="Make the starter from the solution first.")
@PROCESSES_OPTION
@JSON_OPTION
def selftest(lab: Lab, starter: bool, processes: int | None) -> int:
    """Test a lab before a class uses it: solution with all points, mutants that fail."""
    from twin.base.writing import write_whole
    from twin.lab.handing_out import make_starter
    from twin.lab.selftest import selftest as run_selftest

    if starter and not lab.answer.data:
        write_whole(lab.folder / lab.answer.file, make_starter(lab.text("solution.py")))
    return _show_findings(lab, run_selftest(lab, processes or cores()))


@lab.command(cls=Command, example="lab calibrate signs --rigs 30")
@LAB_ARGUMENT
@click.option("--rigs", type=click.IntRange(min=3), default=30, help="Rigs a candidate [30].")
@PROCESSES_OPTION
@JSON_OPTION
def calibrate(lab: Lab, rigs: int, processes: int | None) -> int:
    """Propose the limits of every check from what solution, starter and mutants reach.

    Each is evaluated on so many rigs; exit code 1 where a mutant cannot be distinguished from the
    solution.
    """
    from twin.lab.selftest import calibrate as propose_all
    from twin.lab.selftest import candidates

    with progress("calibrate", rigs * len(candidates(lab)), "answers") as advance:
        found = list(propose_all(lab, rigs, processes or cores(), advance))
    return _show_findings(lab, found)


@lab.command(cls=Command, example="lab pack signs --for gradescope --key key.txt --out signs.zip")
@LAB_ARGUMENT
@click.option(
    "--for",
    "system",
    type=click.Choice(["folder", "gradescope", "classroom50"]),
    default="folder",
)
@KEY_OPTION
@click.option(
    "--wheel", type=PATH_TYPE, help="Wheel of ballplate that the image installs [the index]."
)
@click.option("--out", type=PATH_TYPE, required=True, help="New file (gradescope) or folder.")
def pack(out: Path, key: Path | None, **given: Any) -> int:
    """Pack a lab for students (folder, with a notebook) or for the grader of a course system."""
    from twin.lab.packs import pack as packed

    packed(out=out, key=_text(key), **given)
    if given["system"] != "folder":
        _warn_of_practice(given["lab"], key)
    say(f"{out} written")
    return 0
