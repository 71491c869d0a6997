# %% [markdown]
# # The rig in python-control
# `ballplate.systems` gives plants and controllers as systems of python-control: poles, margins,
# root locus and step responses of any law, on the model it was designed on and on the mechanism.

# %%
import control
import numpy as np

import ballplate as bp

plant = bp.systems.linear()  # x' = A x + B u about the level plate, signals by name
law = bp.systems.law("circle", controller="pole_placement")
desired = ["reference_x", "reference_y"]
loop = control.interconnect([plant, law], inputs=desired, outputs=["x", "y"])
print("poles", loop.poles().real.round(3))
print(control.step_info(loop["x", "reference_x"]))

# %% Margins and root locus of axis x: the loop gain cut at the plate acceleration
axis = ["x", "x_rate", "phi", "phi_rate"]
# Of a sampled system model_reduction loses the sampling time: see findings/.
along = control.model_reduction(
    plant, keep_states=axis, keep_inputs=["phi_acc"], keep_outputs=axis, method="truncate",
    warn_unstable=False,
)  # fmt: skip
gain = -law["phi_acc", axis] * along
least, phase, *_ = control.stability_margins(gain)
print(f"stable down to {least:.2f} times the gain, with {phase:.0f} deg to lose")
print(control.root_locus_map(gain, gains=[least, 1.0, 2.0]).loci.round(2))

# %% As it runs: sampled, with an observer, the ball seen 42 ms late, on the mechanism that vibrates
feedback = bp.systems.controller("circle", controller="pole_placement")
for late in (bp.systems.sampled("circle"), bp.systems.mechanism("circle")):
    poles = control.feedback(late, feedback, sign=1).poles()
    slowest = np.log(np.abs(poles).max()) / late.dt
    print(f"{late.name}: slowest pole {slowest:.2f} 1/s")

# %% The same commands on the exact plant, friction and all, simulated by python-control
run = bp.run("circle", plant={"kind": "lagrange"}, duration=8)
exact = bp.systems.exact("circle")
commands = np.stack([run["applied_phi_acc"], run["applied_theta_acc"]])
path = control.input_output_response(exact, run.time, commands).outputs[[0, 4]].T
print(f"farthest apart: {1e6 * np.abs(path - run.ball).max():.6f} um")
