# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Planning a climb
#
# A three-wheeler with a rigid rear axle, driven at the rear, is to get up a ramp of 20 degrees. The
# coefficient of friction is 0.5, more than the tangent of the slope, 0.364; yet it cannot drive
# straight up: the front wheel carries weight and does not push. Obliquely the rear wheels bear less
# of the slope's pull along them, and the vehicle gets up, if the plan knows about forces.
#
# We plan wheel rates twice, without and with a limit on the friction that any wheel uses, and then
# drive both plans where friction decides: the same inputs, in a model with Coulomb friction.
# All motions are quasi-static, inertia is left out.

# %%
# %matplotlib inline
from pathlib import Path

import numpy as np

import slipfree
from slipfree import SolverOptions, quasi_statics, settle
from slipfree.core.trajectory import path_length
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.plan.verification import simulate_plan
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, run_problem
from slipfree.show import ground_drawing, style
from slipfree.show.plan_figures import cost_map, initial_routes, plan_plots
from slipfree.show.plots import draw

above = [Path.cwd(), *Path.cwd().parents, *Path(slipfree.__file__).parents]
problems = next(path / "problems" for path in above if (path / "problems").is_dir())
ramp = problems / "plan_climb_ramp.toml"

# %% [markdown]
# ## The shortest way, and the shortest that friction allows
#
# The cost is effort, the squared rates over a fixed time: the shorter the way, the less. A little of
# it is slip. The search for the first plan starts from the straight motion; that for the second one
# starts from three motions, straight on and in a bow to either side; the cheapest of the plans they
# lead to counts.

# %%
straight = "driver.paths=[[[0.0, -1.5], [0.0, 10.5]]]"
outcomes = {
    "without a limit": run_problem(load_problem(ramp, ["limits.utilisation=", straight])),
    "friction used up to 95 %": run_problem(load_problem(ramp)),
}
for words, outcome in outcomes.items():
    found = outcome.trajectory
    print(
        f"{words}: {path_length(found):.2f} m, needs up to {found['utilisation'].max():.2f} times "
        f"the friction there is; {found.facts['plan_iterations'].value:.0f} iterations"
    )

# %% [markdown]
# More than once the friction there is means that the motion cannot be held. What does happen then? The
# planned rates drive the same vehicle in a model in which wheels slip as friction lets them.


# %%
def by_friction(outcome):
    """Return the motion under the planned rates where friction decides."""
    setup, plan = outcome.setup, from_arrays(outcome.arrays, "the plan")
    model = quasi_statics(setup.vehicle, setup.terrain)
    start = settle(model, **{name: setup.start[name][0] for name in ("x", "y", "heading")})
    return simulate_plan(model, start, plan.motion, step=0.1, options=SolverOptions(tolerance=1e-6))


driven = {words: by_friction(outcome) for words, outcome in outcomes.items()}
for words, motion in driven.items():
    planned = outcomes[words].trajectory
    apart = np.hypot(motion["x"][-1] - planned["x"][-1], motion["y"][-1] - planned["y"][-1])
    print(f"{words}: ends {apart:.2f} m from where it was planned to")

# %%
ground = outcomes["without a limit"].setup.ground.grid
looks = {"color": "black", "lw": 2.5}, {"color": style.PALETTE[1], "lw": 1.5, "ls": "--"}
figure = style.figure(7.2, 4.4)
for k, (words, outcome) in enumerate(outcomes.items()):
    ax = figure.add_subplot(1, 2, k + 1, title=words, aspect="equal")
    ground_drawing.relief(*ground_drawing.patch(ground, ground.domain, ground_drawing.HEATMAP), ax)
    for motion, look in ((outcome.trajectory, looks[0]), (driven[words], looks[1])):
        ax.plot(motion["x"], motion["y"], **look)
    ax.set_xlabel("east x [m]")
    ax.set_ylabel("north y [m]")
handles = [ax.plot([], [], **look)[0] for look in looks]
figure.legend(handles, ["planned", "driven by friction"], loc="outside lower center", ncols=2)
figure

# %% [markdown]
# ## What the plan does
#
# The inputs with their bounds, the limits, and slip. The rear wheels use all that they may on the
# slope, and only there.

# %%
climb = outcomes["friction used up to 95 %"]
figures = draw(
    plan_plots(
        climb.trajectory,
        ground,
        climb.setup.layers,
        places=climb.setup.places,
        bounds=climb.setup.spec.bounds,
        limits=climb.setup.spec.limits,
    )
)
figures["plan"]

# %% [markdown]
# ## When there is no plan
#
# With walls to either side the vehicle has to go straight. The search fails, and says what stands
# against what: which wheel, when, and by how much it would have to use more friction.

# %%
walls = ["limits.x=[-0.2, 0.2]", "plan.intervals=12", straight]
refused = run_problem(load_problem(ramp, walls)).trajectory
print(refused.stop.words)

# %% [markdown]
# Less friction than the tangent of the slope is refused before anything is solved: no heading helps.

# %%
try:
    run_problem(load_problem(ramp, ["terrain.friction=0.3"]))
except slipfree.SlipfreeError as error:
    print(str(error).partition("goal: ")[2])

# %% [markdown]
# ## Where the ground is large
#
# A search over the map comes first: inclined poses, and those near tipping or sliding, cost more, and ground that the
# vehicle cannot cross is excluded. A driving law follows each route that is found, and its motion is the
# initial guess of a plan: `slipfree run problems/plan_crater_field.toml`. Here are routes over that field
# of different homotopy classes, which pass the obstacles on different sides.

# %%
field = build(load_problem(problems / "plan_crater_field.toml", ["plan.starts=3"]))
grid = field.ground.grid
figure = style.figure(5.6, 5.6)
ax = figure.add_subplot(aspect="equal", xlabel="east x [m]", ylabel="north y [m]")
cost_map(field.layers, grid, ax, grid.domain)
initial_routes(field.guide.paths, ax)
figure.legend(loc="outside upper center", ncols=3)
figure
