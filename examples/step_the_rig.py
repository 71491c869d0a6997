# %% [markdown]
# # Step a rig with any program
# `ballplate.rig` gives what a real rig would: a measurement once a control period, for plate rates
# that it applies as far as its limits allow. One rig or many; the last axis is the vector.

# %%
import numpy as np

import ballplate as bp

with bp.rig("hold", plant={"start": {"x": 0.05}}, duration=5, count=4) as rig:
    before = rig.measurement.y[:, 0::2]
    speed = np.zeros((4, 2))
    while not rig.done:
        ball, angle = rig.measurement.y[:, 0::2], rig.measurement.y[:, 1::2]
        speed += 0.05 * ((ball - before) / rig.period - speed)  # a low-pass filter
        goal = np.array([-1.0, 1.0]) * (0.4 * ball + 0.4 * speed)
        before = ball
        rig.step(np.clip(8 * (goal - angle), -0.5, 0.5))

# %% Each rig has its own noise and is a run like any other
for number in range(4):
    result = rig.result(number)
    print(result.outcome, f"{1000 * np.hypot(*result.ball[-1]):.1f} mm from the centre")
rig.result(0)
