"""One scenario run: on its plant, or a real or emulated rig, with the clean model as well."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from ballplate.changes import (
    Changes,
    KeyChange,
    Settings,
    changes_of,
    scenario_of,
    warn_of_replaced,
)
from ballplate.dangers import warn_of_dangers, warn_of_path
from ballplate.evidence import Attach, stream_record, trace_file, write_trace
from ballplate.rehearsing import rehearse
from ballplate.reporter import Reporter, default, writable
from ballplate.rig_access import open_rig, plan_faults_of_run, rig_label, tell_timing
from twin.base.errors import LawError, naming
from twin.base.shipped import find
from twin.base.writing import written_alone
from twin.run.files import free

if TYPE_CHECKING:
    from ballplate.results import Result
    from twin.base.jobs import SecondProcess
    from twin.devices.rig import HardwareRig
    from twin.hal.rig import Rig
    from twin.run.finished import Run
    from twin.scenario.schema import Scenario


CLEAN_LABEL = "clean model"
"""The same controller on the frictionless equations (5.9) it was designed on."""
PYTHON_LABEL = "Python"
"""The run of the controller in Python, shown with a program's."""
WORTH_PROCESS = 5.0
"""Simulated seconds from which a process of its own saves time."""


def run(
    scenario: str | Path,
    settings: Settings = (),
    *,
    beside: str | Path | Sequence[str | Path] = (),
    out: str | Path | None = None,
    on: str | None = None,
    reset: bool = False,
    faults: Sequence[str] = (),
    trace: str | Path | None = None,
    watch: Callable[[Scenario], AbstractContextManager[Attach]] | None = None,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Result:
    """Run a scenario, and the clean model as well if the scenario compares with it.

    If the controller is a program, ``board``, the one in Python is run as well, simulated.

    ``run("circle", controller={"kind": "lqr"}, duration=12)`` and ``ballplate run circle --set
    controller.kind=lqr --set duration=12`` give the same record, bit for bit. Ctrl-C ends the run
    in order: the result has what was recorded, with the outcome ``aborted``.

    Args:
        scenario: A shipped scenario, one of ``scenarios()``, or a TOML file.
        settings: Changes of it, by dotted keys or as texts ``KEY=VALUE``.
        beside: Scenarios to run as well, simulated and changed alike, for table and picture.
        out: Folder to save in; see ``Result.save`` for later. An interrupted run replaces no
            finished one there, and a run on a rig replaces none at all: they go to the next free
            folder of the name.
        on: Rig file, or ``emulated`` for the virtual rig; simulated by default. A scenario that is
            ``rehearsed`` must keep its ball on the twin first.
        reset: Whether faults found in the drives of a rig are reset when switching on.
        faults: Faults of the virtual rig during the run, ``SECONDS LINE`` each, as ``3 unplug``;
            the lines are those of ``ballplate emulate``.
        trace: File for all frames of the CAN bus of a rig, in a format of python-can by its ending;
            ``trace.log`` in the run's folder by default.
        watch: Makes the context of the run, which gives a function that receives the recorder.
        reporter: Receives progress and warnings; a notebook has its own.
        changes: Changes of it, by tables: ``plant={"friction": {"rolling_mm": 0}}``.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown, out of range or
            cannot be assembled: one line with what, where, and what is allowed.

    Examples:
        >>> import ballplate as bp
        >>> bp.run("circle", ["plant.kind=lagrange"], controller={"kind": "lqr"}, duration=4)
        <Result 'Circle ... (...controller.kind=lqr, duration=4)': finished, tracking error 53.4 %>
    """
    report = reporter or default()
    others = [beside] if isinstance(beside, str | Path) else beside
    _check_names(scenario, others, report)
    changed = changes_of(settings, changes)
    chosen = scenario_of(scenario, changed)
    planned = plan_faults_of_run(on, chosen, faults, report)  # a wrong name, too
    further = _further_scenarios(chosen, others, changed)
    warn_of_replaced((scenario, *others), changed, report)
    from ballplate.results import Result, save_without_picture
    from twin.run.plants import PLANTS

    folder = writable(out, report)
    if folder is not None and on is not None:
        folder = free(folder)  # a measurement cannot be repeated
    file = trace_file(trace, folder, on, report)
    keys = [each.key for each in changed]
    kind = "mujoco" if "parameters" in keys else chosen.plant.kind  # the twin of a foreign rig, too
    label = PLANTS[kind].label if on is None else rig_label(on)
    compared = chosen.baseline and kind == "mujoco"
    alone = nullcontext() if folder is None else written_alone(folder, report.name_of("out"))
    rehearsal = partial(rehearse, scenario, changed, report)
    opening = partial(open_rig, on, chosen, keys, report, reset=reset, planned=planned)
    incomplete: list[str] = []
    parallel = _second_process(chosen, wanted=compared and on is None)
    with alone, parallel as second, ExitStack() as written:
        attached = watch(chosen) if watch is not None else nullcontext(lambda _: None)
        with write_trace(file, report, bounded=trace is None, incomplete=incomplete) as heard:
            rig = opening(hear=heard, try_first=rehearsal)
            with rig as (real, chosen), attached as attach:
                baseline = _begin_clean_run(chosen, second, report) if compared else None
                observed = attach
                if real is not None and folder is not None:
                    observed = written.enter_context(stream_record(chosen, folder, attach))
                done = one_run(chosen, label, report, observed, real)
                result = Result.from_run(done, Path(scenario).stem, label)
                if folder is not None:
                    folder = _save_record(result, folder, simulated=on is None)
        if incomplete and folder is not None:
            result.incomplete = tuple(incomplete)
            save_without_picture(result, folder)
        _complete(result, folder, baseline, further, second, report, real)
        return result


def _second_process(scenario: Scenario, *, wanted: bool) -> SecondProcess:
    """A process for the clean model, if there is one to run and a process of its own saves time."""
    from twin.base.jobs import SecondProcess, cores

    saves = scenario.duration >= WORTH_PROCESS and cores() > 1 and importable(scenario)
    return SecondProcess(wanted=wanted and saves)


def _save_record(result: Result, folder: Path, *, simulated: bool) -> Path:
    """Save a run as soon as it has ended, so that no later step can lose its record.

    Args:
        result: The run.
        folder: Folder to save in; an interrupted simulation replaces no finished run there but goes
            to the next free folder of the name.
        simulated: Whether the run is simulated, so that it could be repeated.

    Returns:
        The folder with the run.

    Raises:
        RecordError: If it cannot be written.
    """
    from ballplate.results import save_without_picture
    from twin.run.opened import holds_finished

    if simulated and result.interrupted and holds_finished(folder):
        folder = free(folder)
    save_without_picture(result, folder)
    return folder


def _further_scenarios(
    chosen: Scenario, others: Sequence[str | Path], changed: Sequence[KeyChange]
) -> dict[str, Scenario]:
    """What runs next to a scenario, by label: the controller in Python if it is a program, others.

    Args:
        chosen: The scenario.
        others: Names or files of further ones.
        changed: What is changed of all.

    Raises:
        ScenarioError: If there is no such scenario, or anything in it is unknown or out of range.
    """
    found = {}
    if chosen.board is not None:
        found[PYTHON_LABEL] = chosen.model_copy(update={"board": None, "fault": ()})
    return found | {Path(name).stem: scenario_of(name, changed) for name in others}


def _complete(
    result: Result,
    folder: Path | None,
    baseline: Callable[[Run], Run] | None,
    further: Mapping[str, Scenario],
    second: SecondProcess,
    reporter: Reporter,
    rig: HardwareRig | None,
) -> None:
    """Complete a run that is saved: timing of the rig, the runs that are shown with it, picture.

    Args:
        result: The run; receives the runs that are shown with it.
        folder: Folder to draw in; None for nowhere.
        baseline: Waits for the run of the clean model; None if there is none.
        further: Scenarios to run as well, by label.
        second: The process of the clean model, which can draw, too.
        reporter: Receives the timing, progress and warnings.
        rig: The real rig of the run; None if it was simulated.
    """
    from twin.run.finished import draw

    if rig is not None:
        tell_timing(rig, reporter)
    if not result.interrupted:
        _run_others(result, baseline, further, reporter, rig)
    if folder is not None:
        # if the run did not finish, the second process may still be busy with the clean model
        draw(result, folder, result.motions, second if result.finished else None)


def _run_others(
    result: Result,
    baseline: Callable[[Run], Run] | None,
    further: Mapping[str, Scenario],
    reporter: Reporter,
    rig: Rig | None,
) -> None:
    """Run the clean model, if there is one, and further scenarios for the picture of a run."""
    from ballplate.results import Result

    if baseline is not None:
        with suppress(KeyboardInterrupt), _keep_rig_outcome(reporter, rig):
            result.baseline = Result.from_run(baseline(result), result.name, CLEAN_LABEL)
    for name, its in further.items():
        with suppress(KeyboardInterrupt):
            result.beside[name] = Result.from_run(one_run(its, name, reporter), name)


def _check_names(scenario: str | Path, others: Sequence[str | Path], reporter: Reporter) -> None:
    """Check names of scenarios before anything heavy is imported.

    Raises:
        ScenarioError: If there is no such scenario; for one of ``others`` it names the argument.
    """
    find(str(scenario))
    with naming(reporter.name_of("beside")):
        for each in others:
            find(str(each))


@contextmanager
def _keep_rig_outcome(reporter: Reporter, rig: Rig | None) -> Iterator[None]:
    """Only report an error of a law: the record of the rig is kept."""
    try:
        yield
    except LawError as error:
        if rig is None:
            raise
        reporter.warn(f"{CLEAN_LABEL}: {error}")


def one_run(
    scenario: Scenario,
    label: str,
    reporter: Reporter,
    attach: Attach = lambda _: None,
    rig: Rig | None = None,
    *,
    path: bool = True,
) -> Run:
    """Run a scenario with its warnings and its progress.

    Args:
        scenario: What to run.
        label: What the progress calls it.
        reporter: Receives progress and warnings.
        attach: Is given the recorder before the run.
        rig: A real rig; simulated by default.
        path: Whether to warn of a reference that the plate cannot give.

    Raises:
        TwinError: If the scenario cannot be assembled.
    """
    from twin.run import finished

    warn_of_dangers(scenario, reporter)
    if path:
        warn_of_path(scenario, reporter)
    with reporter.progress(label, scenario.duration) as advance:
        return finished.run(scenario, advance, attach, rig)


def importable(scenario: Scenario) -> bool:
    """Whether a second process knows the scenario's law, observer and reference, too."""
    from controllers.catalog import registered_names

    kinds = (scenario.controller.kind, scenario.observer.kind, scenario.reference.kind)
    return registered_names().isdisjoint(kinds)


def _begin_clean_run(
    scenario: Scenario, helper: SecondProcess, reporter: Reporter
) -> Callable[[Run], Run]:
    """Begin the run of the clean model in the second process, if there is one.

    Returns:
        A function of the finished run: it waits for the run of the clean model and returns it, cut
        to the duration of the finished run.
    """
    import scipy.linalg  # noqa: F401  both processes need it: once, where the second is a fork

    from twin.run import finished
    from twin.scenario.derived import clean, cut_short

    model = clean(scenario)
    if helper.there:
        result = helper.begin(finished.run, model)
        helper.begin(finished.load_drawing)

    def ended(done: Run) -> Run:
        if done.outcome != "finished":
            return one_run(cut_short(model, done.end), CLEAN_LABEL, reporter, path=False)
        if not helper.there:
            return one_run(model, CLEAN_LABEL, reporter, path=False)
        warn_of_dangers(model, reporter)
        with reporter.progress(CLEAN_LABEL, model.duration):
            return result()

    return ended
