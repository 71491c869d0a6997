"""Writes settings.md and settings-*.md of this folder: python docs/settings.py."""

from itertools import groupby

from docs.pages import HERE, filled, write
from twin.scenario.describe import about, every_kind, find_keys


def page() -> str:
    """Every setting, as Markdown of several pages."""
    tables = groupby(find_keys(), lambda key: key.key.rpartition(".")[0])
    groups = [(name, list(keys)) for name, keys in tables]
    kinds = groupby(every_kind().items(), lambda kind: kind[0].partition(".")[0])
    return filled("settings", groups=groups, kinds=kinds, about=about)


if __name__ == "__main__":
    write(HERE / "settings.md", page())
