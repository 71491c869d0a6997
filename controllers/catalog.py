"""Laws, observers and references by the name a scenario calls them.

Whatever module lies in this package or in the folder ``laws`` of the working folder, is named by
an entry point of the group ``ballplate.controllers``, or was added, contributes its concrete
subclasses; nothing is listed by hand. One that cannot be imported, or takes a name that is taken,
is left out and named by ``broken``. A class of a running program is taken in by ``register``.

A program that only reads leaves the folder ``laws`` alone: to import a file is to run it, and
whoever sent the folder has written it.

Whether a law answers as a law does: asked once, when it is built.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import importlib.util
import inspect
import logging
import os
import pkgutil
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from enum import Enum
from functools import cache, partial
from importlib.metadata import entry_points
from itertools import chain
from pathlib import Path, PurePath
from types import ModuleType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

import controllers
from controllers import LAWS_CLOSED_VARIABLE
from controllers.arrays import Array
from controllers.interfaces import ControlLaw, Law, Observer, Reference

Kind = TypeVar("Kind", Law, Observer, Reference)
_SETTING_TYPES = (bool, int, float, complex, str, PurePath, Enum, tuple, list, dict, type(None))
"""What a scenario can hold."""

CONTROLLER_ENTRY_POINTS = "ballplate.controllers"
LAWS_FOLDER = "laws"
"""Folder of the working folder; laws in its files are part of the catalog."""
EXECUTION_LOG = logging.getLogger("ballplate.executes")
"""Logs each file of other authors before this program runs it."""
ADDED_FILES_VARIABLE = "BALLPLATE_LAWS"
"""Environment variable with the files that were added, so that child processes have them."""
_registered: dict[str, type[Law | Observer | Reference]] = {}
_looked: dict[bool, tuple[tuple[ModuleType, ...], tuple[str, ...]]] = {}
"""Cached modules, without the folder of laws and with it."""
_texts: dict[str, str] = {}
"""The source of a module that lies in no package, as it was when it was imported."""


def _modules() -> tuple[tuple[ModuleType, ...], tuple[str, ...]]:
    """Every module of this package, then those of outside packages; a line for each broken one."""
    closed = bool(os.environ.get(LAWS_CLOSED_VARIABLE))
    if closed not in _looked:
        _looked[closed] = _look()
    return _looked[closed]


def _look() -> tuple[tuple[ModuleType, ...], tuple[str, ...]]:
    modules: list[ModuleType] = []
    lines: list[str] = []
    taken: dict[str, type] = {}
    # entry points of outside packages: what to call them, and how to import them
    outside = (
        (f"entry point '{e.name}' ({e.value})", e.load)
        for e in entry_points(group=CONTROLLER_ENTRY_POINTS)
    )
    for place, load in chain(_own(controllers.__path__, "controllers."), outside, _files()):
        try:
            module = load()
            for item in _classes(module):
                _check_fields(item)
                if taken.setdefault(item.name, item) is not item:
                    other = sys.modules[taken[item.name].__module__].__file__
                    raise ValueError(f"the name '{item.name}' is taken by {other}")
            modules.append(module)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's file may do anything
            lines.append(failed_line(error, {place}) or f"{place}: {error_words(error)}")
    return tuple(modules), tuple(lines)


@cache
def _check_fields(cls: type) -> None:
    """Make sure that a scenario can hold every field of a class.

    Raises:
        TypeError: If it cannot hold one: which, and what to write instead.
        NameError: If a type is not there.
    """
    hints = get_type_hints(cls)
    if not dataclasses.is_dataclass(cls):
        return
    for each in dataclasses.fields(cls):
        if each.init and not _holds(hints[each.name]):
            kind = getattr(hints[each.name], "__name__", str(hints[each.name]))
            raise TypeError(
                f"{cls.__name__}.{each.name}: no scenario can hold a "
                f"{kind}; write {each.name}: tuple[float, ...] and np.array(self.{each.name}) "
                "where it is used"
            )


def _holds(kind: Any) -> bool:
    """Whether a scenario can hold a value of a type: numbers, texts, and tables and lists of them.

    Types that say no more than that, as Any or a type variable, are taken at their word.
    """
    if parts := get_args(kind):
        return get_origin(kind) is Literal or all(_holds(part) for part in parts)
    if kind is Any or not isinstance(kind, type) or dataclasses.is_dataclass(kind):
        return True
    return issubclass(kind, _SETTING_TYPES)


def _own(path: Iterable[str], prefix: str) -> Iterator[tuple[str, Callable[[], ModuleType]]]:
    """Modules below a path: file, and how to import it; a package's once it is imported."""
    for found in pkgutil.iter_modules(path, prefix):
        spec = found.module_finder.find_spec(found.name, None)
        origin = spec.origin if spec else None
        yield origin or found.name, partial(importlib.import_module, found.name)
        if found.ispkg and found.name in sys.modules:
            yield from _own(sys.modules[found.name].__path__, f"{found.name}.")


def _files() -> Iterator[tuple[str, Callable[[], ModuleType]]]:
    """Files of the folder of laws, and added ones: path, and how to import it."""
    added = [
        Path(text) for text in os.environ.get(ADDED_FILES_VARIABLE, "").split(os.pathsep) if text
    ]
    own = [] if os.environ.get(LAWS_CLOSED_VARIABLE) else in_folder()
    if own:
        EXECUTION_LOG.info(
            "runs what lies in %s: %s", own[0].parent, ", ".join(p.stem for p in own)
        )
    for path in dict.fromkeys((*own, *added)):
        yield str(path), partial(import_file, path)


def in_folder() -> list[Path]:
    """The files of the folder of laws; none is opened."""
    return sorted(Path(LAWS_FOLDER).resolve().glob("*.py"))


def left_alone() -> list[Path]:
    """The files of the folder of laws that a program which only reads does not run."""
    return in_folder() if os.environ.get(LAWS_CLOSED_VARIABLE) else []


def import_file(path: Path) -> ModuleType:
    """The module of a file that lies in no package."""
    name = f"{LAWS_FOLDER}_{path.stem}"
    if getattr(sys.modules.get(name), "__file__", str(path)) != str(path):
        name += (
            f"_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"  # a second file of this name
        )
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    try:
        _texts[name] = _text(path)
        # not by its bytecode: Python takes it for current if the file was changed within a second
        # and kept its size
        exec(compile(path.read_bytes(), str(path), "exec", dont_inherit=True), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def add(file: Path) -> list[str]:
    """Take in the laws, observers and references of a file, in this process and its children.

    Returns:
        Their names.

    Raises:
        ValueError: If it cannot be imported, or has none: the file, its line and what is wrong.
    """
    path = file.resolve()
    if not path.is_file() or path.suffix != ".py":
        raise ValueError(f"{file}: {'not a Python file' if file.exists() else 'no such file'}")
    before = os.environ.get(ADDED_FILES_VARIABLE, "")
    os.environ[ADDED_FILES_VARIABLE] = os.pathsep.join(filter(None, (before, str(path))))
    forget()
    wrong = next((line for line in broken() if line.startswith(str(path))), "")
    found = [module for module in outside() if module.__file__ == str(path)]
    if not wrong and not any(map(_classes, found)):
        wrong = f"{file}: no law, observer or reference in it has a name"
    if wrong:
        os.environ[ADDED_FILES_VARIABLE] = before
        forget()
        raise ValueError(wrong)
    return [cls.name for module in found for cls in _classes(module)]


def register(cls: type[Law | Observer | Reference]) -> None:
    """Take in a class that lies in no file of the catalog, as one of a notebook, or its new form.

    Only this process knows it: its children cannot import it.

    Raises:
        ValueError: If it is abstract, has no name, or has the name of a class of the catalog.
    """
    if lacking := _lacking(cls):
        raise ValueError(f"{cls.__name__} lacks {lacking}")
    name = cls.name
    known = {item.name: item for module in _modules()[0] for item in _classes(module)}
    if name in known and _home(known[name]) == _home(cls):
        if _is_stale(known[name]):
            forget()
        return  # the same class, imported a second time
    if known.get(name, cls) is not cls:
        raise ValueError(f"{cls.__name__}: the name '{name}' is taken by {known[name].__name__}")
    if name not in known:
        _check_fields(cls)
        _registered[name] = cls
        _forget_classes()


def unregister(name: str) -> None:
    """Forget a class that was taken in."""
    _registered.pop(name, None)
    _forget_classes()


def _is_stale(cls: type) -> bool:
    """Whether a class's file, outside any package, has changed since it was imported."""
    held, module = _texts.get(cls.__module__), sys.modules.get(cls.__module__)
    file = Path(getattr(module, "__file__", None) or "")
    return held is not None and file.is_file() and held != _text(file)


def _text(file: Path) -> str:
    """A source file's text, whatever bytes are in it."""
    return file.read_text(encoding="utf-8", errors="replace")


def _home(cls: type) -> tuple[str, str]:
    """File and name of a class; of one without a file its module."""
    module = sys.modules.get(cls.__module__)
    file = getattr(module, "__file__", None)
    return (str(Path(file).resolve()) if file else cls.__module__), cls.__qualname__


def registered_names() -> frozenset[str]:
    """Names of the classes that only this process knows."""
    return frozenset(_registered)


@contextmanager
def in_files_only() -> Iterator[None]:
    """Within this context the catalog has only what every process finds."""
    kept = dict(_registered)
    _registered.clear()
    _forget_classes()
    try:
        yield
    finally:
        _registered.update(kept)
        _forget_classes()


def outside() -> list[ModuleType]:
    """The modules that do not lie in this package."""
    return [each for each in _modules()[0] if not each.__name__.startswith("controllers.")]


def catalog(kind: type[Kind]) -> dict[str, type[Kind]]:
    """All concrete classes of a kind (Law, Observer or Reference) by their name."""
    return dict(_of_kind(kind, os.environ.get(LAWS_CLOSED_VARIABLE, "")))


def origin(cls: type) -> tuple[str, str] | None:
    """File name and source text of a class that lies outside this package; else None.

    The text is the source of its module, empty where there is none, as of a class typed at a
    prompt.
    """
    if cls.__module__.startswith("controllers."):
        return None
    module = sys.modules.get(cls.__module__)
    file = Path(getattr(module, "__file__", None) or "").name
    if cls.__module__ in _texts:
        return file, _texts[cls.__module__]
    try:
        return file, inspect.getsource(module if module is not None and file else cls)
    except (OSError, TypeError):
        return file, ""


def forget() -> None:
    """Look through all modules again when next asked."""
    _looked.clear()
    _forget_classes()


def _forget_classes() -> None:
    _all_classes.cache_clear()
    _of_kind.cache_clear()


@cache
def _of_kind(kind: type[Kind], closed: str) -> dict[str, type[Kind]]:
    """The classes of a kind by their names, in the order of these."""
    found = {item.name: item for item in _all_classes(closed) if issubclass(item, kind)}
    return dict(sorted(found.items()))


@cache
def _all_classes(closed: str) -> list[type[Law | Observer | Reference]]:
    """The classes of all modules; looking through them takes longer than most that asks."""
    del closed  # but other modules
    found = [item for module in _modules()[0] for item in _classes(module)]
    return [*found, *_registered.values()]


def _classes(module: ModuleType) -> list[type[Law | Observer | Reference]]:
    """The concrete laws, observers and references that a module names."""
    return [item for item in _kinds(module) if not _lacking(item)]


def _kinds(module: ModuleType) -> list[type[Law | Observer | Reference]]:
    """The laws, observers and references in a module, whole or not."""
    every = inspect.getmembers(module, inspect.isclass)
    return [item for _, item in every if issubclass(item, Law | Observer | Reference)]


def _lacking(cls: type[Law | Observer | Reference]) -> str:
    """Members that a class lacks to be of its kind; a law acts by ``control`` or ``command``."""
    if not isinstance(vars(cls).get("name"), str):
        return 'a name of its own, as in name: ClassVar[str] = "mine"'
    idle = issubclass(cls, Law) and cls.control is Law.control and cls.command is Law.command
    return "control" if idle else ", ".join(sorted(getattr(cls, "__abstractmethods__", ())))


def broken() -> tuple[str, ...]:
    """A line for each module that could not be imported: file, line and error."""
    return _modules()[1]


def broken_so_far() -> tuple[str, ...]:
    """As ``broken``, of what was looked through already; nothing is imported for it."""
    return tuple(dict.fromkeys(line for _, lines in _looked.values() for line in lines))


def describe_incomplete_classes() -> list[str]:
    """A line for each external class that lacks a member or its base class: file, class and why."""
    lines = []
    for module in outside():
        for _, item in inspect.getmembers(module, inspect.isclass):
            if item.__module__ != module.__name__:
                continue
            if not issubclass(item, Law | Observer | Reference):
                base = next((each for member, each in _BASE_OF.items() if member in vars(item)), "")
                if base:
                    line = (
                        f"{item.__name__} is not derived from {base}; write class {item.__name__}"
                    )
                    lines.append(f"{module.__file__}: {line}({base})")
            elif lacking := _lacking(item):
                lines.append(f"{module.__file__}: {item.__name__} lacks {lacking}")
    return lines


_BASE_OF = {"control": "Law", "command": "Law", "correct": "Observer"}
"""A member of an external class to the base class that it seems to need."""


def locate_error(error: BaseException) -> str | None:
    """File, line and error in one line, if the error came out of a module of the catalog."""
    modules = [module for found, _ in _looked.values() for module in found]
    files = {getattr(module, "__file__", None) for module in modules}
    homes = [sys.modules.get(cls.__module__) for cls in _registered.values()]
    own = [each for each in modules if not each.__name__.startswith("controllers.")]
    outer = {getattr(module, "__file__", None) for module in (*own, *homes)} - {None}
    return failed_line(error, outer) or failed_line(error, files)


def failed_line(error: BaseException, files: Collection[str | None]) -> str | None:
    """Innermost line of the files that an error came through, and the error; None if through none.

    A file that Python cannot read as a program has the line that it stumbled over.
    """
    if isinstance(error, SyntaxError) and error.filename in files:
        return f"{error.filename}, line {error.lineno}: {type(error).__name__}: {error.msg}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.filename in files:
            return f"{frame.filename}, line {frame.lineno}: {error_words(error)}"
    return None


def error_words(error: BaseException) -> str:
    """Kind and text of an error."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def wrong_answer(law: ControlLaw) -> str | None:
    """Where and how the answer of a law is none, in one line; None if it is one.

    The ball rests on the centre of a level plate and shall stay. Errors that the law's own lines
    raise are theirs and come out of it; a law that commands otherwise than by ``control`` is not
    asked.
    """
    if type(law).command is not Law.command:
        return None
    hold: Reference = dict(catalog(Reference))["hold"]()  # type: ignore[type-abstract]
    asked = (0.0, np.zeros((1, 8)), hold, np.zeros((1, law.memory)))
    try:
        inspect.signature(law.control).bind(*asked)
    except TypeError:
        return f"{_place(law)}: control takes (self, t, x, reference, q)"
    given = law.control(*asked)
    try:
        answer = check_command(law, given, np.zeros((1, 2)))
    except AnswerError as error:
        return str(error)
    if not np.isfinite(answer).all():
        return f"{_place(law)}: control must give numbers; of a ball at rest it makes {answer[0]}"
    return None


class AnswerError(ValueError):
    """A law or observer returned a value of the wrong type or shape: file, line, value, rule."""


def check_command(law: ControlLaw, u: Any, like: Array) -> Array:
    """The plate accelerations that a law gave, of the shape of an array.

    Raises:
        AnswerError: If they are none.
    """
    if getattr(u, "shape", None) != like.shape or u.dtype.kind not in "fi":
        method = "control" if type(law).command is Law.command else "command"
        raise _wrong(law, method, "plate accelerations (..., 2)", u, like)
    return u


def check_memory_rate(law: ControlLaw, slope: Any, like: Array) -> Array:
    """The rate of a law's memory that it gave, of the shape of an array.

    Raises:
        AnswerError: If it is none.
    """
    if np.shape(slope) != like.shape or np.iscomplexobj(slope):
        raise _wrong(law, "memory_rate", "the rate of the memory (..., memory)", slope, like)
    return slope


def check_estimate(observer: Observer, x: Any, like: Array) -> Array:
    """The estimate that an observer gave, for as many rigs as an array (..., 2).

    Raises:
        AnswerError: If it is none.
    """
    expected = (*like.shape[:-1], 8)
    if getattr(x, "shape", None) != expected or x.dtype.kind not in "fi":
        raise _wrong(observer, "correct", "the estimate (..., 8)", x, np.empty(expected))
    return x


def _wrong(
    law: ControlLaw | Observer, method: str, what: str, given: Any, expected: Array
) -> AnswerError:
    found = "None" if given is None else f"a {type(given).__name__}"
    if isinstance(given, np.ndarray | np.generic):
        kind = {"f": "", "i": "", "c": "complex numbers of "}
        found = f"{kind.get(given.dtype.kind, f'{given.dtype} of ')}shape {given.shape}"
    return AnswerError(
        f"{_place(law, method)}: {method} must give {what}, here real numbers of shape "
        f"{expected.shape} in an array; it gave {found}"
    )


def _place(law: ControlLaw | Observer, method: str = "control") -> str:
    """File and line of a method, or of the function that a law is made of.

    Of a held law or a predictor they are those of the wrapped one.
    """
    while within := getattr(law, "law", None) or getattr(law, "observer", None):
        law = within
    code = getattr(type(law), "control_function", getattr(type(law), method)).__code__
    return f"{code.co_filename}, line {code.co_firstlineno}"
