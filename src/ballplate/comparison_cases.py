"""The scenarios of a comparison: named variants, and all combinations of varied values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from ballplate.changes import KeyChange, Settings, changes_of, scenario_of
from twin.base.errors import ScenarioError

if TYPE_CHECKING:
    from ballplate.reporter import Reporter
    from twin.scenario.schema import Scenario


MAX_NAME_LETTERS = 60
"""Most letters of a variant's name: it stands in legends, tables and folders."""


class Case(NamedTuple):
    """A run of a comparison.

    Attributes:
        scenario: What is run.
        name: What tables and pictures call it.
        source: Name or file of the scenario that it is a variant of.
    """

    scenario: Scenario
    name: str
    source: str


def cases_of(
    names: Sequence[str],
    base: Sequence[KeyChange],
    varied: Mapping[str, Sequence[Any]],
    chosen: Mapping[str, Sequence[KeyChange]] | None = None,
    *,
    alone: bool = True,
    what: str = "variants",
) -> dict[str, Case]:
    """Label to case of every run: each scenario with each combination of what is varied.

    Args:
        names: Scenarios.
        base: What is changed of all of them.
        varied: Key to plain values.
        chosen: Changes of the first scenario by the name of the variant, in place of that scenario.
        alone: Whether nothing else is shown.
        what: The argument of the variants in messages.

    Raises:
        ScenarioError: If anything in them is unknown or out of range, or a variant has the name of
            a scenario that is run as it is.
    """
    from twin.scenario.variations import variants

    cases: dict[str, Case] = {}
    for called, changed in (chosen or {}).items():
        scenario = scenario_of(names[0], [*base, *changed], titled=False)
        cases[called] = Case(scenario, called, names[0])
    for name in names[1:] if chosen else names:
        if name in (chosen or {}):
            raise ScenarioError(
                f"{what} '{name}': a scenario of this comparison has this name; give another one"
            )
        named = (name,) if len(names) > 1 or not varied or not alone else ()
        for variant in variants(varied):
            label, called = (
                " ".join(filter(None, (*named, text))) for text in (variant.label, variant.name)
            )
            changed = changes_of((), dict(variant.settings))
            scenario = scenario_of(name, [*base, *changed], titled=False)
            cases[label] = Case(scenario, called, name)
    return cases


def variants_of(
    variants: Mapping[str, Settings] | Sequence[str], names: Sequence[str], reporter: Reporter
) -> dict[str, list[KeyChange]]:
    """The changes of each named variant.

    Args:
        variants: Name to settings, or texts ``NAME=KEY=VALUE; KEY=VALUE``.
        names: Scenarios, of which the first has variants.
        reporter: Knows what the argument is called.

    Raises:
        ScenarioError: If there is no scenario, or a name is empty, too long or there twice.
    """
    what = reporter.name_of("variants")
    if not names:
        raise ScenarioError(f"{what}: nothing to run; name a scenario, such as circle")
    given_names = [variants] if isinstance(variants, str) else variants
    if not isinstance(given_names, Mapping | Sequence) or not all(
        isinstance(each, str) for each in given_names
    ):
        raise ScenarioError(
            f"{what}: must be a table of names, or texts NAME='KEY=VALUE; KEY=VALUE', "
            f"got {variants!r:.60}"
        )
    if isinstance(given_names, Mapping):
        pairs: list[tuple[str, Settings]] = list(given_names.items())
    else:
        pairs = [_parse_variant(text, what) for text in given_names]
    found: dict[str, list[KeyChange]] = {}
    for given, settings in pairs:
        name = given.strip()
        if not name or len(name) > MAX_NAME_LETTERS or not name.isprintable():
            raise ScenarioError(f"{what} '{name:.80}': a name has 1 to {MAX_NAME_LETTERS} letters")
        if name in found:
            raise ScenarioError(f"{what} '{name}': two variants have this name")
        try:
            found[name] = changes_of(settings, {})
        except ScenarioError as error:
            raise ScenarioError(f"{what} '{name}': {error}") from None
    return found


def _parse_variant(text: str, what: str) -> tuple[str, Settings]:
    """Name and settings in a text ``NAME=KEY=VALUE; KEY=VALUE``; what: the argument in messages."""
    from twin.scenario.merging import split_settings

    name, equals, rest = text.partition("=")
    if not equals:
        raise ScenarioError(f"{what} '{text:.80}': write NAME='KEY=VALUE; KEY=VALUE'")
    return name, split_settings(rest)
