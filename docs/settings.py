"""Writes settings.md and settings-*.md of this folder: python docs/settings.py."""

from itertools import groupby

from docs.pages import HERE, filled, write
from twin.base.followers import FOLLOWER_LABELS, FREE, Effect, Followers
from twin.scenario.describe import Key, about, every_kind, find_keys
from twin.scenario.rig_tables import REGISTER, left_out

OPEN_WORDS = {"source": "parameter", "identify": "fitted", "symbols": "symbol"}
"""What a part makes of a setting that it leaves open."""


def page() -> str:
    """Every setting, as Markdown of several pages."""
    groups: dict[str, list[Key]] = {}
    for key in find_keys():
        groups.setdefault(key.key.rpartition(".")[0], []).append(key)
    kinds = groupby(every_kind().items(), lambda kind: kind[0].partition(".")[0])
    followers = {
        key: {part: word(setting.followed_by, part) for part in FOLLOWER_LABELS}
        for key, setting in sorted(REGISTER.items())
    }
    reasons = {part: grouped(left_out(part)) for part in FOLLOWER_LABELS}
    return filled(
        "settings",
        groups=list(groups.items()),
        kinds=kinds,
        about=about,
        followers=followers,
        reasons=reasons,
        parts=FOLLOWER_LABELS,
    )


def word(followers: Followers, part: str) -> str:
    """How a part follows a setting, in a word; empty if it does not."""
    how = getattr(followers, part)
    if isinstance(how, Effect):
        return how.name
    if isinstance(how, str):
        return ""
    return OPEN_WORDS[part] if how is FREE else "yes"


def grouped(reasons: dict[str, str]) -> dict[str, list[str]]:
    """The settings that a part leaves out, by reason."""
    found = dict[str, list[str]]()
    for key, why in sorted(reasons.items()):
        found.setdefault(why, []).append(key)
    return found


if __name__ == "__main__":
    write(HERE / "settings.md", page())
