# %% [markdown]
# # First steps
# Run a scenario, look at it, change it, compare. Open this file as a notebook (Jupyter with
# jupytext, VS Code, Spyder, PyCharm) or run it with Python. SI units throughout.

# %%
import ballplate as bp

print(bp.scenarios()["circle"])
result = bp.run("circle", duration=12)
result  # a notebook shows its indicators and its picture, beside the clean model

# %% What it is made of
error = result.metrics["tracking_error_percent"]
clean = result.baseline.metrics["tracking_error_percent"]
print(f"tracking error {error:.1f} %, on the clean model {clean:.1f} %")
print(result["true_x"].max(), result.units["true_x"])  # a column of the record, shape (K,)

# %% Is it the friction? What may be set, and the same run without
print(bp.describe("plant.friction"))
smooth = bp.run("circle", duration=12, plant={"friction": {"rolling_mm": 0}})
print(f"without friction {smooth.metrics['tracking_error_percent']:.1f} %")

# %% Two laws, one with a weight of its own, in one table and one picture
laws = ["backstepping", {"kind": "lqr", "rho": 100.0}]
both = bp.compare("circle", vary={"controller": laws}, duration=12)
both

# %% Kept for later: a folder per run with record, numbers and picture
again = bp.load(both.save("runs/two-laws"))
print(list(again))
