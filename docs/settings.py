"""Writes settings.md of this folder: python docs/settings.py."""

from itertools import groupby

from pages import HERE, filled

from twin.scenario.describe import about, described, every_kind
from twin.writing import write_whole


def page() -> str:
    """Every setting, as Markdown."""
    tables = groupby(described(), lambda key: key.key.rpartition(".")[0])
    groups = [(name, list(keys)) for name, keys in tables]
    return filled("settings", groups=groups, kinds=every_kind(), about=about).rstrip() + "\n"


if __name__ == "__main__":
    write_whole(HERE / "settings.md", page())
