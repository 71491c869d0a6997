"""FMUs by the names of their variables, and a rig and its controller coupled by FMPy."""

import fmpy
import numpy as np

MEASURED = ("measured_x", "measured_phi", "measured_y", "measured_theta", "age")
RATES = ("rate_phi", "rate_theta")
STATE = tuple(f"true_{each}{rate}" for each in ("x", "phi", "y", "theta") for rate in ("", "_rate"))


class Unit:
    """An instance of an FMU of either version, ready to be stepped."""

    def __init__(self, file, start=0.0, **values):
        about = fmpy.read_model_description(str(file))
        self.known = {each.name: each for each in about.modelVariables}
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(str(file)), about, "CoSimulation")
        self._modern = about.fmiVersion.startswith("3")
        for name, value in values.items():
            self.put({name.replace("__", "."): value})
        if not self._modern:
            self.fmu.setupExperiment(startTime=start)
        self.fmu.enterInitializationMode(**({"startTime": start} if self._modern else {}))
        self.fmu.exitInitializationMode()

    def _call(self, verb, name, *given):
        variable = self.known[name]
        return getattr(self.fmu, f"{verb}{variable.type}")([variable.valueReference], *given)

    def put(self, values):
        """Set variables by their names."""
        for name, value in values.items():
            self._call("set", name, [value])

    def get(self, *names):
        """Values of variables, as an array."""
        return np.array([self._call("get", name)[0] for name in names])


def coupled(rig, controller, periods, period=0.002):
    """The true states of a rig at the begin of each period under a controller, (periods, 8).

    Args:
        rig: Its ``Unit``.
        controller: The ``Unit`` of its controller, which makes each step first.
        periods: Their number.
        period: Control period in s.
    """
    states = []
    for k in range(periods):
        states.append(rig.get(*STATE))
        controller.put(dict(zip(MEASURED, rig.get(*MEASURED).tolist(), strict=True)))
        controller.put({"touched": bool(rig.get("touched")[0])})
        controller.fmu.doStep(k * period, period)
        rig.put(dict(zip(RATES, controller.get(*RATES).tolist(), strict=True)))
        rig.fmu.doStep(k * period, period)
    return np.array(states)
