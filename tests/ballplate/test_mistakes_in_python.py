"""`ballplate.gym`.

A mistake in Python is the line of the command as an exception, before anything runs."""

from pathlib import Path

import gymnasium
import pytest

import ballplate as bp
import ballplate.gym

ROOT = Path(__file__).parents[2]
CHANGES = [{"at": 1.0, "set": {"plant.level_deg": [1.0, 0.0]}}]
IDEAL = {"observer": "ideal", "predictor": None, "sensors": {"ideal": True}}


def vary(**how):
    """Two ways to vary the circle."""
    for call in (bp.compare, bp.sweep):
        yield lambda call=call: call("circle", vary=how.get("all", how), duration=0.01)


def env(**how):
    return lambda: gymnasium.make_vec("ballplate.gym:ballplate/Step-v0", 2, **how)


def on_processes(count):
    """What takes a number of processes."""
    yield lambda: bp.compare("hold", processes=count)
    yield lambda: bp.sweep("hold", {"seed": [1, 2]}, processes=count)
    yield lambda: bp.study("friction", processes=count)


def heavy():
    return bp.model("circle", plant={"ball": {"mass": 0.1}})


def no_array(t, x, reference):
    return 0


CALLS = {
    "did you mean 'circle'": [lambda: bp.run("cirle"), lambda: bp.systems.sampled("cirle")],
    "a real rig; 'hobby' is a simulated one.*parameters='hobby'": [
        lambda: bp.run("hold", on="hobby")
    ],
    "columns: give a text": [lambda: bp.identify("a.csv", columns={"time": "t"})],
    "test_mistakes_in_python.py, line .*control must give plate accelerations": [
        lambda: bp.run("hold", duration=0.1, controller=bp.law(no_array)())
    ],
    "did you mean 'rho'": [lambda: bp.run("hold", controller={"kind": "lqr", "rh": 1})],
    "did you mean 'period'": [lambda: bp.systems.exact("circle", rig={"perod": 1})],
    "did you mean 'uncertain'": [env(family="uncertan")],
    "did you mean 'kind'": [env(settings=["plant.kin=lagrange"])],
    "nothing called 'roling_mm'; did you mean": [lambda: bp.describe("roling_mm")],
    "nothing called 'friktion'; did you mean 'friction'": [lambda: bp.describe("friktion")],
    "describe: give a key": [lambda: bp.describe(None)],
    "must be a table, the name of a kind": [lambda: bp.run("hold", controller=3)],
    "taken by LQR": [
        lambda: bp.run("hold", controller=type("LQR", (bp.laws.AFL,), {"name": "lqr"}))
    ],
    r"controller\.model": [lambda: bp.run("circle", controller=bp.laws.LQR(model=heavy()))],
    "must take": [
        lambda: bp.law(lambda t, x: x),
        lambda: bp.law(lambda t, x, r, *, kp: x),  # no default
    ],
    "settings: must be a table or a list of texts": [
        lambda: bp.run("hold", "duration=1"),
        lambda: bp.run("circle", 5),
    ],
    "variants: must be a table of names, or texts NAME=": [
        lambda given=given: bp.compare("circle", variants=given)
        for given in (3, {1: {"seed": 1}}, [1, 2], {"a"}, b"a=b=1")
    ],
    "variants 'ab': write NAME=": [lambda: bp.compare("circle", variants="ab")],
    "5": [lambda: bp.run("circle", [5])],
    "must be a number": [lambda: bp.run("hold", {"duration": object()})],
    "out /proc/nowhere: cannot be": [lambda: bp.run("hold", out="/proc/nowhere")],
    "reset: a simulated rig .* add on": [lambda: bp.run("hold", reset=True)],
    r"on (emulated|.*rig\.toml): \[\[change\]\] works on a simulated rig only": [
        lambda on=on: bp.run("circle", {"change": CHANGES}, on=on)
        for on in ("emulated", str(ROOT / "examples" / "own_rig" / "rig.toml"))
    ],
    "change: an FMU does not change by itself": [
        lambda: bp.fmu("circle", "rig.fmu", {"change": CHANGES})
    ],
    "a simulated rig has no bus": [lambda: bp.run("circle", trace="a.log")],
    r"one of \.asc, \.blf, \.csv, \.log, \.trc": [
        lambda: bp.run("circle", on="emulated", trace="a.pcap")
    ],
    "mujoco": [lambda: bp.run("hold", {"plant.kind": "x"}, on="r.toml")],
    "no such run folder": [lambda: bp.load("nowhere")],
    "log nowhere: not found": [lambda: bp.identify("nowhere")],
    "study 'nowhere': not found": [lambda: bp.study("nowhere")],
    "at least one key": [lambda: bp.sweep("hold", {})],
    "vary: give a table": [lambda: bp.sweep("circle", None)],
    "vary seed: give at least one value": [*vary(seed=[])],
    "seed: 1 is given twice": [*vary(seed=[1, 2, 1])],
    r"vary controller\.kind: give a list of values": [
        call
        for values in ("afl", {"kind": "afl"}, 5)
        for call in vary(all={"controller.kind": values})
    ],
    "hold: given 2 times": [lambda: bp.compare("hold", "circle", "hold")],
    "names, files and results, got <": [lambda: bp.compare(object())],
    "count: must be at least 1": [
        lambda: bp.rig("hold", count=0),
        lambda: bp.rig("hold", count="3"),
        lambda: bp.rig("hold", count=2.5),
    ],
    "processes: must be a whole number of at least 1, got": [
        call for count in ("x", 0, -1, 2.5, [1]) for call in on_processes(count)
    ],
    "out: must be a path, got 3": [
        lambda: bp.run("hold", out=3),
        lambda: bp.compare("hold", out=3),
        lambda: bp.study("friction", out=3),
    ],
    "name at least one": [lambda: bp.rig([])],
    "has no linearisation": [lambda: bp.systems.law("circle", controller="sliding_mode")],
    "systems.law is the law with": [lambda: bp.systems.controller("circle", **IDEAL)],
    "depends on its orientation": [
        lambda: bp.systems.mechanism("circle", plant={"ball": {"oval_mm": 0.1}})
    ],
    "hold: must divide the 5000 control periods": [env(hold=7), env(hold=2.5)],
    "rate: must be more than 0": [env(rate=0.0), env(rate="x")],
    "preview: must be times": [env(preview=(-1.0,))],
    "autoreset_mode: must be NextStep or Disabled": [env(autoreset_mode="SameStep")],
}
"""Words of what is told to calls that are told it."""


@pytest.mark.parametrize("words", CALLS)
def test_a_mistake_is_one_line_and_writes_nothing(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for call in CALLS[words]:
        with pytest.raises(bp.TwinError, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)
    assert not list(Path().iterdir())
