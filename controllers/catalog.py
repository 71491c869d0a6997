"""Laws, observers and references by the name a scenario calls them.

Whatever module lies in this package, or is named by an entry point of the group
``ballplate.controllers``, contributes its concrete subclasses; nothing is listed by hand. One that
cannot be imported is left out and named by ``broken``.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import cache, partial
from importlib.metadata import entry_points
from itertools import chain
from types import ModuleType
from typing import TypeVar, get_type_hints

import controllers
from controllers.interfaces import Law, Observer, Reference

Kind = TypeVar("Kind", Law, Observer, Reference)

GROUP = "ballplate.controllers"


@cache
def _modules() -> tuple[tuple[ModuleType, ...], tuple[str, ...]]:
    """Every module of this package, then those of outside packages; a line for each broken one."""
    modules: list[ModuleType] = []
    lines: list[str] = []
    for place, load in chain(_own(controllers.__path__, "controllers."), _outside()):
        try:
            module = load()
            for item in _classes(module):
                get_type_hints(item)  # as whoever checks its settings will
            modules.append(module)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's file may do anything
            lines.append(_line(error, {place}) or f"{place}: {_words(error)}")
    return tuple(modules), tuple(lines)


def _own(path: Iterable[str], prefix: str) -> Iterator[tuple[str, Callable[[], ModuleType]]]:
    """Modules below a path: file, and how to import it; a package's once it is imported."""
    for found in pkgutil.iter_modules(path, prefix):
        spec = found.module_finder.find_spec(found.name, None)
        origin = spec.origin if spec else None
        yield origin or found.name, partial(importlib.import_module, found.name)
        if found.ispkg and found.name in sys.modules:
            yield from _own(sys.modules[found.name].__path__, f"{found.name}.")


def _outside() -> Iterator[tuple[str, Callable[[], ModuleType]]]:
    """Entry points of outside packages: what to call them, and how to import them."""
    for entry in entry_points(group=GROUP):
        yield f"entry point '{entry.name}' ({entry.value})", entry.load


def catalog(kind: type[Kind]) -> dict[str, type[Kind]]:
    """All concrete classes of a kind (Law, Observer or Reference) by their name."""
    found: dict[str, type[Kind]] = {}
    for module in _modules()[0]:
        for item in _classes(module):
            if issubclass(item, kind):
                found[item.name] = item
    return dict(sorted(found.items()))


def _classes(module: ModuleType) -> list[type[Law | Observer | Reference]]:
    """The concrete laws, observers and references that a module names."""
    return [
        item
        for _, item in inspect.getmembers(module, inspect.isclass)
        if issubclass(item, Law | Observer | Reference)
        and isinstance(vars(item).get("name"), str)
        and not inspect.isabstract(item)
    ]


def broken() -> tuple[str, ...]:
    """A line for each module that could not be imported: file, line and error."""
    return _modules()[1]


def blamed(error: BaseException) -> str | None:
    """File, line and error in one line, if the error came out of a module of the catalog."""
    return _line(error, {getattr(module, "__file__", None) for module in _modules()[0]})


def _line(error: BaseException, files: Collection[str | None]) -> str | None:
    """Innermost line of the files that an error came through, and the error; None if through none.

    A file that Python cannot read as a program has the line that it stumbled over.
    """
    if isinstance(error, SyntaxError) and error.filename in files:
        return f"{error.filename}, line {error.lineno}: {type(error).__name__}: {error.msg}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.filename in files:
            return f"{frame.filename}, line {frame.lineno}: {_words(error)}"
    return None


def _words(error: BaseException) -> str:
    """Kind and text of an error."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
