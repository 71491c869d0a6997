# %% [markdown]
# # From a log to the parameters of a rig
# Here the twin itself plays the rig, with a friction that is then to be found; a log of a real rig
# is a CSV file with named columns, units in the header (`measured_x [mm]`).

# %%
import ballplate as bp

secret = {"plant.friction.rolling_mm": 0.25}
recorded = bp.run("excite", secret, baseline=False)
log = bp.load(recorded.export("log.csv"))
log

# %% Fit friction, dead time, drives and level; a third of the log is held out
found = bp.identify("log.csv")
print(*found.sentences, sep="\n")
found

# %% What was identified is what a run takes
print(found.settings)
arm = found.settings["plant"]["friction"]["rolling_mm"]
print(f"rolling friction {arm:.3f} mm, put in: {secret['plant.friction.rolling_mm']} mm")
predicted = bp.run("circle", found.settings, duration=12)
predicted
