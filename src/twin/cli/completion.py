"""The command completion, and what the Tab key offers for scenarios, runs, studies and keys."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem, get_completion_class

from twin.shipped import folder, shipped

VARIABLE = "_BALLPLATE_COMPLETE"


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> int:
    """Print the script that completes commands, scenarios, runs and keys in a shell.

    In ~/.bashrc: eval "$(ballplate completion bash)". In ~/.zshrc, after compinit: eval
    "$(ballplate completion zsh)". In ~/.config/fish/config.fish: ballplate completion fish | source
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "ballplate", VARIABLE).source())
    return 0


def scenarios(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Shipped scenarios, and TOML files."""
    return _offered(incomplete, shipped())


def studies(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Shipped studies, and TOML files."""
    return _offered(incomplete, (path.stem for path in (folder() / "studies").glob("*.toml")))


def runs(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Folders of runs/, the newest run, and other files."""
    from twin.run.files import LAST, ROOT, run_folders

    made = [path for path in ROOT.glob("*") if path.is_dir() and run_folders(path)]
    return _offered(incomplete, (LAST, *(path.as_posix() for path in sorted(made))))


def sources(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Scenarios and runs."""
    both = scenarios(context, parameter, incomplete) + runs(context, parameter, incomplete)
    return [each for each in both if each.type == "plain"] or both[-1:]


def settings(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Keys of a scenario; after the sign of equality the kinds of a law, observer or reference."""
    from twin.scenario.load import every_key
    from twin.scenario.schema import KINDS, choices

    key, equals, _start = incomplete.partition("=")
    table = key.removesuffix(".kind")
    if equals:
        known = choices(table) if table in KINDS and key != table else {}
        return _offered(incomplete, (f"{key}={kind}" for kind in known), files=False)
    return _offered(incomplete, (f"{each}=" for each in every_key()), files=False)


def names(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """What can be described: keys, tables and kinds."""
    from twin.scenario.load import every_key
    from twin.scenario.schema import KINDS, choices

    known = dict.fromkeys(every_key())
    tables = {".".join(key.split(".")[:n]) for key in known for n in range(1, key.count(".") + 1)}
    kinds = [kind for table in KINDS for kind in choices(table)]
    return _offered(incomplete, (*sorted(tables), *kinds, *known), files=False)


def _offered(incomplete: str, known: Iterable[str], *, files: bool = True) -> list[CompletionItem]:
    """Known names that begin so; files where there are none."""
    found = [CompletionItem(name) for name in known if name.startswith(incomplete)]
    if found or not files:
        return found
    return [CompletionItem(Path(incomplete).as_posix() if incomplete else "", type="file")]
