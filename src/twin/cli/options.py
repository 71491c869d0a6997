"""Options that several commands have, what the Tab key offers, and how a run is watched."""

from __future__ import annotations

import functools
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import click
from click.shell_completion import CompletionItem, get_completion_class

from ballplate.rig_access import EMULATED_RIG
from controllers import LAWS_CLOSED_VARIABLE
from twin.base.data_file import read_tables
from twin.base.errors import ScenarioError, ViewError, naming, plural, shorten, suggest_setting
from twin.base.shipped import chosen, find, shipped_in, shipped_scenarios
from twin.cli.output import warn
from twin.run.files import NEWEST_RUN, RUNS_FOLDER, run_folders

if TYPE_CHECKING:
    from ballplate.evidence import Attach
    from twin.run.record import Recorder
    from twin.scenario import Scenario
    from twin.view.live_process import LiveProcess
    from twin.view.viewer import Opened


class Finite(click.FloatRange):
    """A number between limits, which are true of none that is NaN or infinite."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number of a text."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class Command(click.Command):
    """A command with a help that begins with an example that works.

    Args:
        example: What is typed after ``ballplate``; other arguments are those of click.
        reads: Whether it only reads, so that nothing of the folder ``laws`` is run; or the option
            with which it does.
    """

    def __init__(self, *given: Any, example: str, reads: bool | str = False, **more: Any) -> None:
        super().__init__(*given, **more)
        self.example, self.reads = example, reads

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments, with the folder ``laws`` left alone where the command only reads.

        Raises:
            ScenarioError: If an option that takes one value is given more than once, or a word
                belongs to ``--set``.
        """
        ctx.meta["typed"] = list(args)
        given: list[click.Parameter] = []
        left: list[str] = []
        if not ctx.resilient_parsing:  # as while a line is completed
            _, left, given = self.make_parser(ctx).parse_args(args=list(args))
        has_set = any("--set" in option.opts for option in self.params)
        if has_set and left and (hint := suggest_setting(left[0])):
            raise ScenarioError(f"unexpected '{shorten(left[0])}'{hint}")
        for option in set(given):
            if not isinstance(option, click.Option) or option.multiple or option.is_flag:
                continue
            if not option.count and (times := given.count(option)) > 1:
                raise ScenarioError(f"{option.opts[0]}: given {times} times; give it once")
        if self.reads in args or self.reads is True:
            ctx.with_resource(laws_left_alone())
        return super().parse_args(ctx, args)

    def format_usage(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the example, then how the command is called."""
        formatter.write(f"Example: ballplate {self.example}\n\n")
        super().format_usage(ctx, formatter)


@contextmanager
def laws_left_alone() -> Iterator[None]:
    """Within this, no file of the folder ``laws`` is run; files given by ``--law`` are."""
    before = os.environ.get(LAWS_CLOSED_VARIABLE)
    os.environ[LAWS_CLOSED_VARIABLE] = "yes"
    try:
        yield
    finally:
        os.environ.pop(LAWS_CLOSED_VARIABLE)
        if before is not None:
            os.environ[LAWS_CLOSED_VARIABLE] = before


command = functools.partial(click.command, cls=Command)
"""Makes a function a command: ``@command(example="run circle")``, or with a name before it."""


class Group(Command, click.Group):
    """A group of commands; its help begins with an example, too."""


COMPLETION_VARIABLE = "_BALLPLATE_COMPLETE"


@click.command(cls=Command, example="completion bash")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> int:
    """Print the script that completes commands, scenarios, runs and keys in a shell.

    In ~/.bashrc: eval "$(ballplate completion bash)". In ~/.zshrc, after compinit: eval
    "$(ballplate completion zsh)". In ~/.config/fish/config.fish: ballplate completion fish | source
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "ballplate", COMPLETION_VARIABLE).source())
    return 0


def _completes(known: Callable[[], Iterable[str]]) -> Any:
    """Completion of known names from the beginning of a word; of files where there are no names."""
    return lambda _, __, incomplete: _complete_names(incomplete, known())


def _list_run_folders() -> list[str]:
    """The word for the newest run, and the folders of runs/."""
    made = [path for path in RUNS_FOLDER.glob("*") if path.is_dir() and run_folders(path)]
    return [NEWEST_RUN, *(path.as_posix() for path in sorted(made))]


scenarios = _completes(shipped_scenarios)
studies = _completes(functools.partial(shipped_in, "studies"))
rigs = _completes(functools.partial(shipped_in, "rigs"))
runs = _completes(_list_run_folders)
sources = _completes(lambda: [*shipped_scenarios(), *_list_run_folders()])


def settings(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Keys of a scenario; after the sign of equality the kinds of a law, observer or reference."""
    from twin.scenario.load import every_key
    from twin.scenario.schema import CATALOG_TABLES, choices

    key, equals, _start = incomplete.partition("=")
    table = key.removesuffix(".kind")
    if equals:
        known = choices(table) if table in CATALOG_TABLES and key != table else {}
        return _complete_names(incomplete, (f"{key}={kind}" for kind in known), files=False)
    return _complete_names(incomplete, (f"{each}=" for each in every_key()), files=False)


def names(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Keys, which can be described."""
    from twin.scenario.load import every_key

    return _complete_names(incomplete, every_key(), files=False)


def _complete_names(
    incomplete: str, known: Iterable[str], *, files: bool = True
) -> list[CompletionItem]:
    """Known names that begin so; files where there are none."""
    found = [CompletionItem(name) for name in known if name.startswith(incomplete)]
    if found or not files:
        return found
    return [CompletionItem(Path(incomplete).as_posix() if incomplete else "", type="file")]


def _note(context: click.Context, option: click.Parameter, value: object) -> None:
    """Keep the value of an option for later readers, by its name."""
    context.meta[str(option.name)] = value


def _nothing_else(context: click.Context, option: click.Parameter, value: object) -> None:
    """Keep whether JSON is wanted; what laws print goes to standard error then."""
    _note(context, option, value)
    if value:
        context.meta["output"] = sys.stdout
        context.with_resource(redirect_stdout(sys.stderr))


def _settings(
    context: click.Context, __: click.Parameter, values: tuple[str, ...]
) -> tuple[str, ...]:
    """The settings and what options set; a key given twice means nobody knows which."""
    check_settings(values, "--set")
    keys = [text.partition("=")[0].strip() for text in values]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise ScenarioError(f"--set {twice[0]}: given {keys.count(twice[0])} times; give it once")
    for option, key in (("plant", "plant.kind"), ("on", "parameters"), ("board", "board.program")):
        if (chosen := context.meta.get(option)) is not None:
            values = (*values, f"{key}={chosen}")
    return values


def check_settings(texts: Iterable[str], option: str) -> None:
    """Make sure that each text is of the form ``key=value``.

    Args:
        texts: The texts.
        option: The option that they were given by.

    Raises:
        ScenarioError: If one is not.
    """
    for text in texts:
        from twin.scenario.merging import setting

        setting(text, option)


def check_scenario_name(_: click.Context, given: click.Parameter, name: Any) -> Any:
    """The name of a scenario, or names; a wrong one is reported before anything heavy is imported.

    Raises:
        ScenarioError: If there is no such scenario; it names the option, if it is one.
    """
    names = name if isinstance(name, tuple) else () if name is None else (name,)
    with naming(given.opts[-1]) if isinstance(given, click.Option) else nullcontext():
        for each in names:
            find(each)
    return name


def check_rig_name(context: click.Context, option: click.Parameter, name: str | None) -> str | None:
    """The name of a rig, kept for later readers; a wrong one is reported at once.

    Raises:
        ScenarioError: If there is no such rig, or its file is none.
    """
    if name is not None:
        with naming(option.opts[-1]):
            read_tables(chosen("rig", name, shipped_in("rigs")), name)
    _note(context, option, name)
    return name


def _note_board(context: click.Context, option: click.Parameter, program: str | None) -> None:
    """Keep the program of ``--board``; a wrong one is reported by the option's name."""
    if program is not None:
        from twin.board.program import check_program

        check_program(program, "--board")
    _note(context, option, program)


PATH_TYPE = click.Path(path_type=Path)
"""A file or folder, there or not."""


class WritableFile(click.Path):
    """A file to be written; whether it can be is checked before the work, when it is parsed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The file.

        Raises:
            ScenarioError: If it cannot be written.
        """
        file = Path(os.fsdecode(super().convert(value, param, ctx)))
        if ctx is None or ctx.resilient_parsing:  # the Tab key writes nothing
            return file
        from twin.base.writing import check_writable_file

        return check_writable_file(file, param.opts[-1] if param else "file")


WRITABLE_FILE = WritableFile()
"""A file to be written."""
SCENARIO = functools.partial(
    click.argument, "scenario", callback=check_scenario_name, shell_complete=scenarios
)
_SET_OPTION = click.option(
    "--set",
    "overrides",
    multiple=True,
    callback=_settings,
    metavar="KEY=VALUE",
    help="Change a key of the scenario.",
    shell_complete=settings,
)
_ON_OPTION = click.option(
    "--on",
    metavar="RIG",
    expose_value=False,
    is_eager=True,
    callback=check_rig_name,
    help="A shipped rig, a file of identified parameters, or a lab's rig.toml [the thesis's rig].",
    shell_complete=rigs,
)


def SETTING(command: Any) -> Any:  # noqa: N802 - an option, as the others
    """The options that change a scenario: ``--on`` and ``--set``."""
    return _SET_OPTION(_ON_OPTION(command))


_COLUMNS_OPTION = click.option(
    "--columns",
    metavar="ROLE=NAME:UNIT,...",
    help="Columns of a log of any rig: time, measured_x, measured_y, command_phi, command_theta.",
)
_SEPARATOR_OPTION = click.option(
    "--separator", help="Separator of its columns, such as ; or tab [detected]."
)


BALL_OPTION = click.option(
    "--ball", metavar="BALL", help="hollow, solid, or its share of gravity [hollow]."
)


def typed_line() -> list[str]:
    """Words of the command line as it was typed, but for an output in JSON."""
    context = click.get_current_context()
    words = [word for word in context.meta["typed"] if word != "--json"]
    return [*context.command_path.split(), *words]


def COLUMNS(command: Any) -> Any:  # noqa: N802 - an option, as the others
    """The options that tell what a log of any rig holds."""
    return _COLUMNS_OPTION(_SEPARATOR_OPTION(command))


PLANT_OPTION = click.option(
    "--plant",
    type=click.Choice(["mujoco", "lagrange"]),
    expose_value=False,
    is_eager=True,
    callback=_note,
    help="Simulate the mechanism, or the exact equations.",
)
BOARD_OPTION = click.option(
    "--board",
    metavar="PROCESSOR",
    expose_value=False,
    is_eager=True,
    callback=_note_board,
    help="Run the controller as C code on an emulated processor, cortex-m4, or on this computer, "
    "host; or as the program FILE.elf.",
)
PROCESSES_OPTION = click.option(
    "--processes", "-j", type=click.IntRange(min=1), help="Processors to use [all]."
)


VARY_OPTION = click.option(
    "--vary",
    multiple=True,
    metavar="KEY=[A,B,...]",
    shell_complete=settings,
    help="Run once for each value of a key; repeat the option for all combinations.",
)
WITH_OPTION = click.option(
    "--with",
    "variants",
    multiple=True,
    metavar="NAME='KEY=VALUE; ...'",
    help="Run the first scenario with these changes, under this name; repeatable.",
)
SCHEDULER_OPTION = click.option(
    "--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler."
)


def _add_laws(context: click.Context, __: click.Parameter, laws: tuple[Path, ...]) -> None:
    if laws:
        from controllers.catalog import add

        for file in laws:
            try:
                context.meta.setdefault("laws", {})[file] = add(file)
            except ValueError as error:
                raise ScenarioError(f"--law {error}") from None


def describe_unused_files(scenario: Scenario) -> list[str]:
    """What to say of files given by ``--law`` of which a run of the scenario takes nothing."""
    from twin.scenario.schema import CATALOG_TABLES, choices

    used = {getattr(scenario, table).kind for table in CATALOG_TABLES}
    return [
        f"--law {file}: nothing of it is used; name it, as --set {table}.kind={names[0]}"
        for file, names in click.get_current_context().meta.get("laws", {}).items()
        if used.isdisjoint(names)
        for table in CATALOG_TABLES
        if names[0] in choices(table)
    ]


LAW_OPTION = click.option(
    "--law",
    multiple=True,
    type=PATH_TYPE,
    expose_value=False,
    is_eager=True,
    callback=_add_laws,
    help="Load laws, observers and references from a Python file; those in laws/ are loaded "
    "without it, except by commands that only read.",
)
JSON_OPTION = click.option(
    "--json",
    is_flag=True,
    expose_value=False,
    callback=_nothing_else,
    help="Print JSON and nothing else.",
)

ALL_OPTION = click.option("--all", "everything", is_flag=True, help="Print every indicator.")


RIG_OPTION = click.option(
    "--rig", metavar="FILE", help="Rig file, or `emulated` for the virtual rig."
)
EMPTY_RIG = click.option(
    "--rig",
    metavar="FILE",
    default=EMULATED_RIG,
    help="Rig file [`emulated`, the virtual rig]; calibrated with the ball off, the plate level.",
)
RESET_OPTION = click.option(
    "--reset", is_flag=True, help="With --rig: reset faults found in the drives when switching on."
)


WEB_PORT = 9090
TWIN_TIMEOUT_S = 60.0
"""Most seconds that the twin gets for its last report: it has the lowest priority."""

SERVE_OPTION = click.option(
    "--serve",
    type=click.IntRange(1, 65535),
    is_flag=False,
    flag_value=WEB_PORT,
    metavar="[PORT]",
    help=f"Watch in a browser of this machine [{WEB_PORT}].",
)
LEARN_OPTION = click.option(
    "--learn", is_flag=True, help="Let the twin learn for 20 s before it evaluates: an unknown rig."
)
WATCH_OPTIONS = (
    click.option("--shadow", is_flag=True, help="Run the twin along: alarms with causes."),
    LEARN_OPTION,
    click.option("--view", "window", is_flag=True, help="Watch in a viewer window."),
    SERVE_OPTION,
)


@dataclass
class Viewing:
    """How a run is watched; whatever goes wrong with that, the run itself is done and kept.

    Args:
        window: In a viewer window.
        serve: In a browser, at this port.
        shadow: Whether its twin runs along.
        learn: Whether that learns at first what is not known of the rig.

    Raises:
        ScenarioError: If these exclude each other.
    """

    window: bool
    serve: int | None
    shadow: bool
    learn: bool

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.window and self.serve is not None:
            raise ScenarioError("--view and --serve: choose one")
        if self.learn and not self.shadow:
            raise ScenarioError("--learn: only with --shadow, which starts the twin that learns")
        self._opened: Opened | None = None
        self._url, self._recording = "", str(uuid4())

    @contextmanager
    def of(self, scenario: Scenario, folder: Path) -> Iterator[Attach]:
        """Watch the run made within.

        Args:
            scenario: What is run.
            folder: Its folder, after which the view names it.
        """
        with ExitStack() as running:
            view = self._open(scenario, folder.name)
            shown = view and running.enter_context(closing(view))
            twin = self._twin(scenario, folder.name) if self.shadow else None
            shadow = twin and running.enter_context(closing(twin))

            def watch(recorder: Recorder) -> None:
                for each in filter(None, (shown, shadow)):
                    each.watch(recorder)

            yield watch
            if shadow is not None and not shadow.finish(TWIN_TIMEOUT_S):
                warn("the twin stopped before the end; the run and its record are complete")
            if shown is not None and not shown.finish():
                warn("the view stopped before the end; the run and its record are complete")
            elif shown is not None and shown.dropped:
                warn(f"the view missed {plural(shown.dropped, 'row')}; the record has all of them")

    def _twin(self, scenario: Scenario, name: str) -> LiveProcess:
        """Start the twin of the run, drawn in the view if there is one."""
        from twin.shadow import report
        from twin.view.live_process import LiveProcess

        shown = report.Shown(self._url, self._recording, name) if self._url else None
        return LiveProcess(report.work, (scenario, shown, self.learn))

    def keep(self) -> None:
        """Keep a page until Ctrl-C."""
        if self._opened is not None and self._opened.page:
            click.echo("the page stays until Ctrl-C", err=True)
            self._opened.wait()

    def _open(self, scenario: Scenario, name: str) -> LiveProcess | None:
        """Start the view that was asked for; None if none was, or it cannot start."""
        if not (self.window or self.serve):
            return None
        from twin.view import recording, viewer
        from twin.view.live_process import LiveProcess

        try:
            self._opened = viewer.page(self.serve) if self.serve else viewer.window()
        except ViewError as error:
            warn(f"{error}; the run continues without a view")
            return None
        if self._opened.page:
            click.echo(f"open {self._opened.page} in a browser", err=True)
        self._url = self._opened.url
        shown = (scenario, name, self._url, self._recording, self.shadow)
        return LiveProcess(recording.work, shown)


def VIEWING(command: Callable[..., Any]) -> Callable[..., Any]:  # noqa: N802  an option, like JSON
    """Give a command the options above, which are the arguments of ``Viewing``."""
    return functools.reduce(lambda whole, option: option(whole), reversed(WATCH_OPTIONS), command)
