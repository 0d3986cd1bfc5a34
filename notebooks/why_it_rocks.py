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
# # Why does a rigid robot rock?
#
# Three points determine a plane. A robot with four wheels and no suspension, the commonest outdoor
# robot, stands on three of them on uneven ground; the fourth is in the air. As it drives, another
# wheel takes over, and the robot rocks. This page shows where that happens, and how the model of
# wheels that are pressed into the ground describes it. Lengths are in metres, angles in degrees
# where they are drawn.

# %%
# %matplotlib inline
from dataclasses import replace

import casadi as ca
import numpy as np

from slipfree import Analytic, catalog, direct_kinematics, settle, simulate
from slipfree.models.samples import lightest_wheel, rocks
from slipfree.show import style
from slipfree.solve.settle import stable_poses

robot = catalog.rigid_skid_steer()
ground = Analytic(lambda x, y: 0.05 * (ca.sin(2.1 * x + 1.3 * y) + ca.sin(1.1 * x - 2.4 * y + 1.0)))
model = direct_kinematics(robot, ground)

# %% [markdown]
# ## One position, two poses
#
# A wheel presses on the ground with a load that grows with its depth below the surface, a fiftieth of
# the rolling radius at an equal share of the weight. From a first pose, height, roll and pitch relax
# to the equilibrium of these loads. At some positions the robot can stand on either of two sets of
# wheels: which one depends on where it came from.

# %%
rng = np.random.default_rng(0)
for x, y in rng.uniform(-3, 3, (40, 2)):
    poses = stable_poses(model, x=x, y=y)
    if len(poses) > 1:
        break
for pose in poses:
    name, share, depth = lightest_wheel(pose, 0)
    print(
        f"x {x:.2f}, y {y:.2f} m: roll {np.degrees(pose['roll'][0]):6.2f}, "
        f"pitch {np.degrees(pose['pitch'][0]):6.2f} degrees, {name} is {-1e3 * depth:.0f} mm high"
    )

# %% [markdown]
# ## A drive
#
# At equal rates of all wheels, the load moves from wheel to wheel. Where the lightest wheel changes,
# roll and pitch change by degrees within centimetres of path.

# %%
inputs = model.inputs(**{f"{wheel.name}_rate": 3.0 for wheel in robot.wheels})
run = simulate(model, settle(model), inputs, np.linspace(0, 8, 401))
figure = style.figure(8, 5)
load, angle = figure.subplots(2, sharex=True)
for wheel in run.wheels:
    load.plot(run.t, run["load_share", wheel], label=wheel.replace("_", " "))
load.set_ylabel("load over an equal share (1)")
load.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.25))
for name in ("roll", "pitch"):
    angle.plot(run.t, np.degrees(run[name]), label=name)
for rock in rocks(run):
    angle.axvline(rock.t, color="0.8", zorder=0)
angle.set(xlabel="time (s)", ylabel="angle (degrees)")
angle.legend()
print(f"{len(rocks(run))} changes of the lightest wheel in {run['y'][-1]:.1f} m")
figure

# %% [markdown]
# The grey lines are the changes of the lightest wheel.
#
# ## What a suspension changes
#
# With the right wheels on a rocker, all four touch everywhere, and exact contact determines the pose.
# The same path takes no change of support.

# %%
rocker = catalog.skid_steer(half_track=0.285, wheelbase=0.51, r1=0.05, r2=0.115)
exact = direct_kinematics(rocker, ground)
inputs = exact.inputs(**{f"{wheel.name}_rate": 3.0 for wheel in rocker.wheels})
soft = simulate(exact, settle(exact), inputs, run.t)
for name, motion in (("rigid", run), ("rocker", soft)):
    rate = np.abs(np.degrees(motion["roll_rate"])).max()
    least = motion["force_normal"].min() / motion["force_normal"].mean()
    print(f"{name:6}: fastest roll {rate:5.1f} degrees/s, least load {least:.2f} of the mean")

# %% [markdown]
# ## What the model does not know
#
# Inertia: a real robot needs time to tip, and may bounce. Times of rocks are estimates, and a motion
# over such ground depends on its past. The stiffness of tyres and soil: the depth is a parameter,
# `static_depth` of the wheels, and smaller depths mean more wheels in the air.

# %%
for share in (20, 50, 250):
    wheels = tuple(replace(wheel, static_depth=wheel.radius / share) for wheel in robot.wheels)
    stiff = direct_kinematics(replace(robot, wheels=wheels), ground)
    rates = stiff.inputs(**{f"{wheel.name}_rate": 3.0 for wheel in wheels})
    again = simulate(stiff, settle(stiff), rates, run.t)
    lifted = (again["depth"] < 0).mean()
    away = np.hypot(again["x"][-1] - run["x"][-1], again["y"][-1] - run["y"][-1])
    print(
        f"depth R/{share}: wheels in the air {lifted:.0%} of the time, {len(rocks(again))} changes, "
        f"end {1e3 * away:.0f} mm from that of R/50"
    )
