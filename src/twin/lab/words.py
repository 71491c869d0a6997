"""The sentences of a lab's results and pages in its language: the table ``words.toml``."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from twin.base.data_file import read_toml
from twin.run.indicators import INDICATORS

WORD_TABLES: dict[str, dict[str, Any]] = read_toml(Path(__file__).with_name("words.toml"))
LANGUAGES = tuple(WORD_TABLES)


class Words:
    """The sentences of one language.

    Args:
        language: One of ``LANGUAGES``.
    """

    def __init__(self, language: str) -> None:
        self.table = WORD_TABLES[language]

    def __call__(self, name: str, **parts: Any) -> str:
        """A sentence, its names in braces filled in; numbers in the digits that matter."""
        texts = {
            key: f"{value:g}" if isinstance(value, float) else value for key, value in parts.items()
        }
        return str(self.table[name]).format(**texts)

    def count(self, name: str, count: int) -> str:
        """A number of things in the singular or plural."""
        one, several = self.table[name]
        return str(one if count == 1 else several).format(count=count)

    def metric(self, name: str) -> str:
        """The words for an indicator of a run."""
        return str(self.table["metrics"].get(name) or INDICATORS[name]["words"])


@cache
def words(language: str) -> Words:
    """The sentences of a language."""
    return Words(language)
