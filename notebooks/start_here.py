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
# # Start here
#
# A ground, a vehicle, the rates of its wheels: where does it go, how do its wheels lean, and what holds
# it there? Five steps, each a few lines. Lengths are in metres, angles in radians, time in seconds.

# %%
# %matplotlib inline
import numpy as np

from slipfree import (
    Bicubic,
    ModelError,
    Path,
    catalog,
    direct_kinematics,
    follow,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.plan.plan import plan
from slipfree.show import motion_figures, style
from slipfree.terrain.synthetic import blank, power_law

# %% [markdown]
# ## A ground
#
# Heights on a uniform grid, here made by rule: a level one with waves of 2 to 8 m added, the same for the
# same seed. A bicubic spline goes through them. (`slipfree.read_map` reads your own.)

# %%
grid = blank((-5.0, 5.0), (-3.0, 7.0), 0.25)
grid = power_law(grid, rms=0.1, hurst=0.9, longest=8.0, shortest=2.0, seed=3)
ground = Bicubic(grid, mu=0.6)  # mu: coefficient of friction
print(f"{grid.x.size} x {grid.y.size} nodes, heights {grid.z.min():.2f} to {grid.z.max():.2f} m")

# %% [markdown]
# ## A vehicle that stands on it
#
# Three wheels: two driven ones behind, which may tilt sideways freely, and a free one ahead that is
# steered. `direct_kinematics` makes the model, `settle` finds how it stands at a place: its place and
# heading are ours to choose, its height, pitch and roll are the ground's.

# %%
vehicle = catalog.three_wheeler()
model = direct_kinematics(vehicle, ground)
start = settle(model, x=0.0, y=0.0, heading=0.0)
for name in ("z", "pitch", "roll"):
    print(f"{name:6} {start[name][0]:+.4f} {start.columns[name].label.unit}")

# %% [markdown]
# ## A motion
#
# Rates in, motion out. Inputs go by name; a message says which there are if one is missing.

# %%
rates = model.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0)
run = simulate(model, start, rates, np.linspace(0, 8, 161))
print(run.stop.words if run.stop else f"ran to {run.t[-1]:g} s")
print(f"largest slip {np.abs(run['slip_across']).max():.0e} m/s, ", end="")
print(f"largest tilt {np.abs(run['tilt_right']).max():.2f} rad, ", end="")
print(f"friction needed {run['friction_needed'].max():.2f}")

# %%
figure = style.figure(5.4, 4.4)
ax = motion_figures.ground(grid, figure.subplots())
motion_figures.path(run, ax)
ax.plot(run["contact_x"], run["contact_y"], lw=1, label=run.wheels)
figure.legend(loc="outside lower center", ncols=3)
figure

# %% [markdown]
# It rolls without slip. But the two rates do not fit the straight front wheel, and the tilts take up the
# difference: the wheels lean over more and more, and need ever more friction.
#
# ## Feedback
#
# Inputs may be expressions of the model's own symbols. `follow` returns such a law: it keeps the vehicle
# on a path and lets its tilts decay.

# %%
path = Path(np.array([(0.0, 0.0), (0.3, 1.5), (-0.6, 3.0), (-0.6, 4.5)]))
law = follow(model, path, speed=0.3)
along = simulate(model, settle(model, heading=-0.2), law, np.linspace(0, 15, 301))
print(f"largest tilt {np.abs(along['tilt_right']).max():.3f} rad, ", end="")
print(f"friction needed {along['friction_needed'].max():.2f}")

# %%
figure = style.figure(6.4, 2.6)
left, right = figure.subplots(1, 2, sharey=True)
for ax, motion, words in ((left, run, "constant rates"), (right, along, "driving law")):
    style.history(motion, "friction_needed", ax).set_title(words)
left.legend(frameon=False)
right.set_ylabel("")
figure

# %% [markdown]
# ## Does friction hold it?
#
# So far the motion was given by kinematics, and friction was what it *needs*. In `quasi_statics`
# friction decides: every wheel that pushes creeps a little. On ice there is no equilibrium, and the
# message says what it would take.

# %%
by_friction = quasi_statics(vehicle, ground)
law = follow(by_friction, path, speed=0.3)
crept = simulate(by_friction, settle(by_friction, heading=-0.2), law, np.linspace(0, 15, 301))
slips = np.hypot(crept["slip_along"], crept["slip_across"])
print(f"on mu = 0.6: largest creep {1000 * slips.max():.2f} mm/s, ", end="")
print(
    f"ends {np.hypot(crept['x'][-1] - along['x'][-1], crept['y'][-1] - along['y'][-1]):.4f} m away"
)
ice = quasi_statics(vehicle, Bicubic(grid, mu=0.05))
try:
    settle(ice, heading=-0.2)
except ModelError as error:
    print(f"on mu = 0.05: {error}")

# %% [markdown]
# ## A plan
#
# A vehicle with a rigid axle has to slip on uneven ground. How little? `plan` seeks the rates that reach a
# goal at the least cost, and simulates them again.

# %%
rigid = catalog.three_wheeler(axle="fixed")
model = direct_kinematics(rigid, ground)
start = settle(model)
straight_on = simulate(
    model,
    start,
    model.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0),
    np.linspace(0, 20, 41),
)
best = plan(
    model, start, goal={"x": 0.4, "y": 2.6}, costs={"slip": 7e4, "effort": 0.01}, duration=20.0
)


def rms(motion):
    """Return the root mean square slip of a wheel. [m/s]."""
    return np.sqrt((motion["slip_along"] ** 2 + motion["slip_across"] ** 2).mean())


print(f"solved: {best.success}; simulated end ", end="")
print(f"({best.replay['x'][-1]:.4f}, {best.replay['y'][-1]:.4f}) m")
print(
    f"rms slip {rms(straight_on):.1e} m/s straight on at constant rates, {rms(best.replay):.1e} planned"
)

# %% [markdown]
# ## Further
#
# The same from the shell: `slipfree new direct first`, `slipfree run first.toml`, `slipfree show first.nc`.
# Next: a traverse of real ground, your own vehicle, the paper's vehicle retold, and whether it stands.
