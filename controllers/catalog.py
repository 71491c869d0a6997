"""Laws, observers and references by the name a scenario calls them.

Whatever module lies in this package, or is named by an entry point of the group
``ballplate.controllers``, contributes its concrete subclasses; nothing is listed by hand.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from importlib.metadata import entry_points
from types import ModuleType
from typing import TypeVar

import controllers
from controllers.interfaces import Law, Observer, Reference

Kind = TypeVar("Kind", Law, Observer, Reference)

GROUP = "ballplate.controllers"


@cache
def _modules() -> tuple[ModuleType, ...]:
    """Every module of this package, then those of outside packages."""
    walk = pkgutil.walk_packages(controllers.__path__, "controllers.")
    own = [importlib.import_module(found.name) for found in walk]
    return (*own, *(entry.load() for entry in entry_points(group=GROUP)))


def catalog(kind: type[Kind]) -> dict[str, type[Kind]]:
    """All concrete classes of a kind (Law, Observer or Reference) by their name."""
    found: dict[str, type[Kind]] = {}
    for module in _modules():
        for _, item in inspect.getmembers(module, inspect.isclass):
            if issubclass(item, kind) and "name" in vars(item) and not inspect.isabstract(item):
                found[item.name] = item
    return dict(sorted(found.items()))
