# %% [markdown]
# # A nonlinear predictive controller with acados
# acados (<https://docs.acados.org>) compiles the equations from `bp.symbolic` as C code.

# %%
import casadi as ca
import numpy as np
from acados_template import AcadosOcp, AcadosOcpSolver

import ballplate as bp

END, N, STEP, TOOK = 8.0, 20, 0.03, []  # s, steps ahead of, s, s of each command
SEEN = [0, 4, 1, 5]  # positions and speeds


# %%
class Acados(bp.laws.Law):
    """Leaves friction to the observer."""

    name, friction = "acados", {"plant.friction.rolling_mm": 0}

    def start(self, x, reference, period):
        """One step of sequential quadratic programming a command, from the end of the last one."""
        m, ocp = bp.symbolic("circle", self.friction, period=STEP), AcadosOcp()
        ocp.model, ocp.parameter_values = m.acados("nmpc"), m.nominal
        ocp.model.cost_y_expr, ocp.model.cost_y_expr_e = ca.vertcat(m.x[SEEN], m.u), m.x[SEEN]
        ocp.cost.cost_type = ocp.cost.cost_type_e = "NONLINEAR_LS"
        ocp.cost.W = np.diag([1e4, 1e4, 300, 300, 1e-3, 1e-3])
        ocp.cost.W_e, ocp.cost.yref, ocp.cost.yref_e = ocp.cost.W[:4, :4], np.zeros(6), np.zeros(4)
        for kind in "xu":
            bounded = [i for i, name in enumerate(m.names[kind]) if name in m.bounds]
            setattr(ocp.constraints, f"idxb{kind}", np.array(bounded))
            for end, sign in (("l", -1), ("u", 1)):
                most = [sign * m.bounds[m.names[kind][i]][1] for i in bounded]
                setattr(ocp.constraints, f"{end}b{kind}", np.array(most))
        ocp.constraints.x0 = x[0]
        ocp.dims.N, ocp.solver_options.N_horizon, ocp.solver_options.tf = N, N, N * STEP
        ocp.solver_options.integrator_type, ocp.solver_options.nlp_solver_type = "ERK", "SQP_RTI"
        return AcadosOcpSolver(ocp, json_file="nmpc.json")

    def command(self, now):
        """The first input of the best that is ahead, shape (1, 2)."""
        x, solver = (now.equivalent if self.friction else now.x)[0], now.plan
        r = now.reference(now.time + STEP * np.arange(N + 1)).reshape(5, N + 1, 2)
        for k, desired in enumerate(np.hstack([r[0], r[1]])):
            solver.set(k, "yref", np.append(desired, [0, 0])[: 6 if k < N else 4])
        u = solver.solve_for_x0(x).reshape(1, 2)
        TOOK.append(float(np.atleast_1d(solver.get_stats("time_tot"))[0]))
        return u


# %% In no time, with a time as a number, and with the time it takes here
own = {"controller": Acados, "controller.period": 0.02, "duration": END, "metrics.start": END / 2}
for time in (0, 0.04, "measured"):
    run = bp.run("cure", own | {"controller.computing_time": time}, baseline=False)
    print(time, run.outcome, run.metrics["tracking_error_percent"], "%", np.median(TOOK), "s")
