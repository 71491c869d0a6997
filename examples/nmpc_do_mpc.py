# %% [markdown]
# # A nonlinear predictive controller with do-mpc
# do-mpc (`pip install do-mpc`) has the equations from `bp.symbolic`; in place of an observer of its
# own it uses the twin's, which knows friction and dead time.

# %%
import numpy as np
from do_mpc.controller import MPC

import ballplate as bp

DURATION, N, STEP = 8.0, 20, 0.03  # s, steps ahead of, s
DESIRED = ("desired_x", "desired_y", "desired_x_rate", "desired_y_rate")  # set in every step


# %%
class DoMPC(bp.laws.Law):
    """Leaves friction to the observer."""

    name, friction = "do_mpc", {"plant.friction.rolling_mm": 0}

    def start(self, x, reference, period):
        """The controller, and the template of its path."""
        m = bp.symbolic("circle", self.friction, period=STEP)
        mpc = MPC(model := m.do_mpc(DESIRED))
        mpc.set_param(n_horizon=N, t_step=STEP, store_full_solution=False)
        mpc.settings.supress_ipopt_output()
        far = [(model.x[name.removeprefix("desired_")] - model.tvp[name]) ** 2 for name in DESIRED]
        cost = 1e4 * sum(far[:2]) + 300 * sum(far[2:])
        mpc.set_objective(mterm=cost, lterm=cost + 1e-3 * (model.u.cat.T @ model.u.cat))
        mpc.set_rterm(phi_acc=0.0, theta_acc=0.0)
        for name, ends in m.bounds.items():
            where = "_u" if name in m.names["u"] else "_x", name
            mpc.bounds["lower", *where], mpc.bounds["upper", *where] = ends
        known, path = mpc.get_p_template(1), mpc.get_tvp_template()
        known["_p", 0] = m.nominal
        mpc.set_p_fun(lambda _: known)
        mpc.set_tvp_fun(lambda _: path)
        mpc.setup()
        mpc.set_initial_guess()
        return mpc, path

    def command(self, now):
        """The first input of the best that is ahead, shape (1, 2)."""
        mpc, path = now.plan
        r = now.reference(now.time + STEP * np.arange(N + 1)).reshape(5, N + 1, 2)
        for k, desired in enumerate(np.hstack([r[0], r[1]])):
            path["_tvp", k] = desired
        return mpc.make_step((now.equivalent if self.friction else now.x).T).T


# %% In no time, with a time as a number, and with the time it takes here
slow = {"controller.period": 0.02, "duration": DURATION, "metrics.start": DURATION / 2}
own = {"controller": DoMPC} | slow
for time in (0, 0.04, "measured"):
    run = bp.run("cure", own | {"controller.computing_time": time}, baseline=False)
    print(time, run.outcome, run.metrics["tracking_error_percent"], "%")
