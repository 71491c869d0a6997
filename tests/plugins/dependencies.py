"""What the results of a test file depend on, as one hash.

Found by the graph of imports, not by hand: the modules that the file and its conftests import,
those they import, and so on. A module that imports by name (the catalog of laws, the command line)
counts for everything in its package, and a test that starts programs for everything there is.
"""

import ast
import hashlib
import platform
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from importlib import metadata
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
PLUGINS = TESTS / "plugins"
PACKAGES = {
    "ballplate": ROOT / "src" / "ballplate",
    "twin": ROOT / "src" / "twin",
    "controllers": ROOT / "controllers",
}
DATA = ("models", "scenarios")
"""Folders that whatever runs a scenario may read."""
BY_NAME = re.compile(r"\b(import_module|__import__|pkgutil)\b")
PROGRAMS = {"subprocess", "multiprocessing"}
version = cache(metadata.version)
"""That of a library; what is installed stays while tests run."""


@cache
def import_graph() -> grimp.ImportGraph:
    return grimp.build_graph(*PACKAGES, cache_dir=None)


def _file(module: str) -> Path:
    package, *rest = module.split(".")
    path = PACKAGES[package].joinpath(*rest)
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


@cache
def _imported(source: str) -> frozenset[str]:
    """Every module that a source file names in an import, wherever it stands."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    return frozenset(names)


@cache
def _texts(source: str) -> frozenset[str]:
    """Every text that stands in a source file by itself."""
    return frozenset(
        node.value
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


@cache
def _imports_by_name(source: str) -> bool:
    """Whether a source file imports what no line of it names."""
    return bool(BY_NAME.search(source))


def _named(test: Path) -> set[Path]:
    """A test file, the conftests it has, and the plugins that these import."""
    above = [folder / "conftest.py" for folder in test.parents if ROOT in folder.parents]
    own = {test, *(path for path in above if path.is_file())}
    named = set().union(*(_imported(path.read_text("utf-8")) for path in own))
    return own | {path for path in PLUGINS.glob("*.py") if path.stem in named}


def _tests(test: Path) -> set[Path]:
    """Those, and the plugins that have to do with every test: all without rigs."""
    own = _named(test)
    for path in PLUGINS.glob("*.py"):
        packages = {name.partition(".")[0] for name in _imported(path.read_text("utf-8"))}
        if not packages & PACKAGES.keys():
            own.add(path)
    return own


def modules(test: Path) -> frozenset[str]:
    """Modules of the project that a test file reaches."""
    graph = import_graph()
    named = set().union(*(_imported(path.read_text("utf-8")) for path in _tests(test)))
    own = _imported(test.read_text("utf-8"))
    found: set[str] = set()
    left = set(graph.modules) if own & PROGRAMS else named & graph.modules
    while left:
        module = left.pop()
        found.add(module)
        reached = graph.find_modules_directly_imported_by(module)
        parent = module.rpartition(".")[0]
        if parent:
            reached.add(parent)
        path = _file(module)
        if _imports_by_name(path.read_text("utf-8")):
            reached |= graph.find_descendants(module if path.name == "__init__.py" else parent)
        left |= reached - found
    return frozenset(found)


def _data(test: Path, reached: frozenset[str]) -> Iterator[Path]:
    """Files other than programs: of the packages reached, of models, and those that are named.

    A test and the plugins it imports may name what lies in the project's folder or beside the test;
    not all tests together, among which is what is written when they have passed.
    """
    folders = {_file(module).parent for module in reached}
    for package in PACKAGES.values():
        for path in package.rglob("*"):
            if path.is_file() and path.suffix not in {".py", ".pyc"}:
                near = next(above for above in path.parents if (above / "__init__.py").is_file())
                if near in folders:
                    yield path
    sources = (path for path in _named(test) if path.name != "conftest.py")
    words = set().union(*(_texts(path.read_text("utf-8")) for path in sources))
    beside = {path for folder in {ROOT, test.parent} - {TESTS} for path in folder.iterdir()}
    named = {path for path in beside - {TESTS} if path.name in words}
    for place in (*map(ROOT.joinpath, DATA), *named):
        yield from (
            path
            for path in (place.rglob("*") if place.is_dir() else [place])
            if path.is_file() and "__pycache__" not in path.parts
        )


def files(test: Path) -> list[Path]:
    """Every file of the project that a test's result may depend on."""
    test = test.resolve()
    reached = modules(test)
    sources = (_file(module) for module in reached)
    return sorted({*_tests(test), *sources, *_data(test, reached)})


def environment() -> list[str]:
    """Interpreter, machine and the version of every pinned library."""
    pinned = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    names = [line.split("==")[0] for line in pinned["tool"]["uv"]["constraint-dependencies"]]
    lines = [platform.python_implementation(), platform.python_version().rpartition(".")[0]]
    lines += [sys.platform, platform.machine()]
    for name in names:
        try:
            lines.append(f"{name}=={version(name)}")
        except PackageNotFoundError:
            lines.append(f"{name} absent")
    return lines


def fingerprint(test: Path, read: Callable[[Path], bytes] = Path.read_bytes) -> str:
    """Hash of all that a test file's results depend on.

    Args:
        test: The file.
        read: How a file of the project is read.
    """
    total = hashlib.sha256("\n".join(environment()).encode())
    for path in files(test):
        content = read(path)
        total.update(f"\n{path.relative_to(ROOT).as_posix()} {len(content)}\n".encode())
        total.update(content)
    return total.hexdigest()[:32]
