"""Programs of a fresh environment, with packages at their pins."""

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = SETTINGS["project"]
UV = os.environ.get("UV") or shutil.which("uv")


def call(*command, **options):
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def pins_in(place):
    pins = place / "pins.txt"
    pins.write_text("\n".join(SETTINGS["tool"]["uv"]["constraint-dependencies"]), encoding="utf-8")
    return pins


def installed(place, interpreter, *packages):
    """Programs of a fresh environment with some packages at their pins, and variables for them.

    Settings of OpenBLAS stay: another kernel gives other last bits.
    """
    environment = place / "environment"
    call(UV, "venv", "--python", interpreter, environment)
    programs = environment / "bin"
    pins = pins_in(place)
    call(UV, "pip", "install", "--python", programs / "python", "--constraint", pins, *packages)
    blas = {name: text for name, text in os.environ.items() if name.startswith("OPENBLAS_")}
    return programs, {"PATH": os.environ["PATH"], "HOME": str(place), **blas}


def here(version):
    """An interpreter of a version on this machine, None if there is none."""
    places = [shutil.which(f"python{version}")]
    places += sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for place in filter(None, places):  # a shim may stand for nothing
        done = subprocess.run([place, "--version"], capture_output=True, text=True, check=False)
        if done.stdout.startswith(f"Python {version}."):
            return place
    return None
