"""Errors a user can cause; the command line prints their one line and exits.

TwinError
+-- ScenarioError     a scenario file or an override is wrong
|   +-- LawError      a law, observer or reference of one's own raises an error
+-- ModelError        the MJCF model or its cam table does not fit
+-- ViewError         a viewer cannot be started or reached
+-- RecordError       a run folder cannot be written or read
+-- LogError          a log cannot be read, or nothing can be learned from it
+-- RigError          a rig cannot be switched on; also DriveError and ScreenError of its devices
+-- AbsentPartError   a package is needed that is not installed; in ``twin.base.parts``
"""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager


class TwinError(Exception):
    """Base of all errors with a one-line message: what, where, what is allowed.

    Examples:
        >>> import ballplate as bp
        >>> try:
        ...     bp.run("circle", duration=-1)
        ... except bp.TwinError as error:
        ...     print(error)
        circle.toml: duration: must be greater than 0, got -1
    """


class ScenarioError(TwinError, ValueError):
    """A scenario, study or override asks for something that does not exist or cannot be."""


class LawError(ScenarioError):
    """A law, observer or reference raises an error: its file, its line, the error."""


class ModelError(TwinError, ValueError):
    """The mechanism model or its cam table cannot be used as given."""


class ViewError(TwinError, RuntimeError):
    """A viewer cannot be started, reached or given a port."""


class RecordError(TwinError, OSError):
    """A run folder or its files cannot be written or read."""


class LogError(TwinError, ValueError):
    """A log cannot be read, or nothing can be learned from it."""


class RigError(TwinError, ConnectionError):
    """A rig, or one of its devices, cannot be brought up."""


def nearest(name: object, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: which is nearest, and which are known."""
    names = list(known)
    return f"{suggest(name, names)} (known: {', '.join(names) or 'none'})"


def suggest(name: object, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: which is nearest; empty if none is near.

    A name that differs in capital letters alone is the nearest.
    """
    names = list(known)
    close = [each for each in names if each.casefold() == str(name).casefold()]
    close = close or difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    return f"; did you mean '{close[0]}'?" if close else ""


def suggest_setting(word: str) -> str:
    """The end of a message about a word that may belong to ``--set``; empty if it does not."""
    if "=" in word:
        return f"; to change a key, write --set {shorten(word)}"
    if word.endswith(("]", "}")):
        return "; put a value with blanks or quotes in quotes, as in --set 'controller.Q=[1, 2]'"
    return ""


def shorten(text: str) -> str:
    """A text that fits into a message."""
    return text if len(text) <= 200 else f"{text[:200]}..."


def list_first(names: Sequence[str], most: int, separator: str = ", ") -> str:
    """The first of some names, and how many others there are, for a message in one line."""
    left_out = len(names) - most
    return separator.join(names[:most]) + (f" and {left_out} more" if left_out > 0 else "")


def plural(count: int, what: str, several: str = "") -> str:
    """A number of things in words, as ``1 run`` or ``2 runs``.

    Args:
        count: The number.
        what: The word for one.
        several: The word for several, if that is not ``what`` with an s.
    """
    return f"{count} {what if count == 1 else several or f'{what}s'}"


UNPRINTABLE_CATEGORIES = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode's categories of what is no letter: controls, directions, halves of pairs, line ends."""


def printable(text: str, keep: str = "") -> str:
    """A text of somebody else as it may go to a terminal or into a file.

    Control characters, among them the escape that begins a terminal's commands, marks that turn the
    direction of writing, and bytes that were no UTF-8 are written as Python writes them in quotes.

    Args:
        text: The text.
        keep: Control characters that stay.
    """
    return "".join(
        letter.encode("unicode_escape").decode()
        if unicodedata.category(letter) in UNPRINTABLE_CATEGORIES and letter not in keep
        else letter
        for letter in text
    )


def one_line(error: Exception) -> str:
    """The message of a library's error, in one line."""
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def naming(option: str) -> Iterator[None]:
    """Let errors about the value of an option begin with its name, as it is typed."""
    try:
        yield
    except (ScenarioError, RecordError, LogError) as error:
        raise type(error)(f"{option}: {error}") from error
