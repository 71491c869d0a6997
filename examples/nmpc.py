# %% [markdown]
# # A nonlinear predictive controller with IPOPT
# `bp.symbolic` gives the equations as CasADi symbols (`pip install 'ballplate[casadi]'`); the twin
# shows how good the law is, and how much the solver's time costs.

# %%
import casadi as ca
import numpy as np

import ballplate as bp

DURATION, N, STEP = 8.0, 20, 0.03  # s, steps ahead of, s


# %% [markdown]
# Multiple shooting over states x and inputs u, from the `first` state along positions and speeds r.
# %%
def solver(m):
    """IPOPT for a model, and the bounds of what it chooses."""
    x, u, first, r = (ca.MX.sym("", *s) for s in ((8, N + 1), (2, N), (8, 1), (4, N)))
    p, error = np.tile(m.nominal[:, None], N), r - x[[0, 4, 1, 5], 1:]
    gaps = ca.veccat(x[:, 0] - first, m.F.map(N)(x[:, :-1], u, p) - x[:, 1:])
    cost = 1e4 * ca.sumsqr(error[:2, :]) + 300 * ca.sumsqr(error[2:, :]) + 1e-3 * ca.sumsqr(u)
    nlp = {"x": ca.veccat(x, u), "p": ca.veccat(first, r), "f": cost, "g": gaps}
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 30}
    most = [m.bounds.get(name, (0, np.inf))[1] for name in m.names["x"] + m.names["u"]]
    most = np.concatenate([np.full(8, np.inf), np.tile(most[:8], N), np.tile(most[8:], N)])
    return ca.nlpsol("nmpc", "ipopt", nlp, quiet), most


class NMPC(bp.laws.Law):
    """Leaves friction to the observer."""

    name, friction = "nmpc", {"plant.friction.rolling_mm": 0}

    def start(self, x, reference, period):
        """Solver, bounds, and where it begins."""
        return [*solver(bp.symbolic("circle", self.friction, period=STEP)), 0]

    def command(self, now):
        """The first input of the best that is ahead, shape (1, 2)."""
        solve, most, _ = plan = now.plan
        x = (now.equivalent if self.friction else now.x)[0]
        r = now.reference(now.time + STEP * np.arange(1, N + 1)).reshape(5, N, 2)
        wanted = np.concatenate([x, np.hstack([r[0], r[1]]).ravel()])
        plan[2] = solve(x0=plan[2], p=wanted, lbx=-most, ubx=most, lbg=0, ubg=0)["x"]
        return plan[2].full()[None, 8 * N + 8 : 8 * N + 10, 0]


class Informed(NMPC):
    """Has the friction of the scenario in its model."""

    name, friction = "informed_nmpc", {}


# %% Beside LQR and the cure: in no time, with times as numbers, and with the time they take here
laws = {"cure": {}} | {each.name: {"controller": each} for each in (bp.laws.LQR, NMPC, Informed)}
slow = {"controller.period": 0.02, "duration": DURATION, "metrics.start": DURATION / 2}
for name, law in laws.items():
    for time in (0, 0.04, "measured"):
        run = bp.run("cure", law | slow | {"controller.computing_time": time}, baseline=False)
        took = 1e3 * np.nanmedian(run["computing_time"]) if time else 0
        error = run.metrics["tracking_error_percent"]
        print(f"{name:13} {time!s:8} took {took:6.2f} ms: {run.outcome}, e_tt {error} %")
