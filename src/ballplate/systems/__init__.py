"""The rig and its controllers as systems of python-control, for all that it can do with systems.

    import ballplate as bp
    import control

    plant = bp.systems.linear()                       # x' = A x + B u about the level plate
    law = bp.systems.law("circle", controller="lqr")  # u of the state and of the desired position
    desired = ["reference_x", "reference_y"]
    loop = control.interconnect([plant, law], inputs=desired, outputs=["x", "y"])
    loop.poles(), control.step_info(loop["x", "reference_x"])

Plants: ``linear``, ``sampled`` and ``mechanism`` are linear, ``equations`` and ``exact`` are not.
Controllers: ``law`` with the state, ``controller`` with the measurement. All are made of a scenario
and what is changed of it, as runs are, by the same code that runs use.

Signals have the names of a record's columns, so that ``control.interconnect`` joins them; ``UNITS``
says in what. A controller feeds back with its own sign: the loop gain that margins are asked of is
``-law * plant``. The ``dt`` of a sampled system is the control period in s.
"""

from ballplate.systems.controllers import controller, law
from ballplate.systems.plants import equations, exact, linear, mechanism, sampled
from ballplate.systems.signals import UNITS

__all__ = ["UNITS", "controller", "equations", "exact", "law", "linear", "mechanism", "sampled"]
