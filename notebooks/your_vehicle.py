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
# # Your own vehicle
#
# A vehicle is a platform, joints that hang on it or on each other, and wheels. A file of ten lines
# describes one; here a car whose front axle rocks, so that all four wheels touch. We read it, see what
# decides its motion, drive it, give it weight, and build one in Python.

# %%
# %matplotlib inline
import os
import tempfile
from dataclasses import replace
from pathlib import Path as File

import numpy as np

from slipfree import Bicubic, ModelError, Path, Vehicle, direct_kinematics, follow, settle, simulate
from slipfree.problem.build_vehicle import read_vehicle
from slipfree.problem.report import describe
from slipfree.show import motion_figures, style
from slipfree.terrain.synthetic import blank, power_law
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import Body, Coordinate, Joint, Wheel

CAR = """
name = "car"
frame = "rep103"           # x forward, y left, z up
coordinates = [
    { name = "rock", kind = "suspension" },                          # the ground decides its value
    { name = "steer", kind = "commanded", lower = -0.6, upper = 0.6 }]   # its rate is an input
joints = [
    { name = "axle", parent = "platform", axis = "x", at = [0.7, 0, 0], value = "rock" },
    { name = "left_fork", parent = "axle", axis = "z", at = [0, 0.3, 0], value = "steer" },
    { name = "right_fork", parent = "axle", axis = "z", at = [0, -0.3, 0], value = "steer" }]
wheels = [
    { name = "rear_left", parent = "platform", at = [0, 0.3, 0], radius = 0.15, driven = true },
    { name = "rear_right", parent = "platform", at = [0, -0.3, 0], radius = 0.15, driven = true },
    { name = "front_left", parent = "left_fork", radius = 0.15 },
    { name = "front_right", parent = "right_fork", radius = 0.15 }]
"""
os.chdir(tempfile.mkdtemp())
File("car.toml").write_text(CAR)
about = describe(File("car.toml"))
print(*about.tree, "", sep="\n")
for name, value in about.facts:
    print(f"{name:24} {value}")

# %% [markdown]
# This is what `slipfree vehicle car.toml` prints. A file that is not a vehicle yet is told apart the same
# way, fault by fault: without the rocking axle a wheel would hang in the air.

# %%
File("stiff.toml").write_text(CAR.replace('kind = "suspension"', 'kind = "passive"'))
print(*describe(File("stiff.toml")).faults, sep="\n")

# %% [markdown]
# ## Over hills
#
# A car with both forks at one angle cannot roll without slip in a turn, nor a rigid axle on uneven ground.
# How much slip is least? And how much of it do the proper angles save, inner and outer wheel steered
# differently (Ackermann)? A joint's value may be any formula of coordinates.

# %%
grid = power_law(
    blank((-4, 6), (-2, 8), 0.25), rms=0.08, hurst=0.9, longest=6.0, shortest=1.5, seed=5
)
ground = Bicubic(grid, mu=0.7)
path = Path(np.array([(0.0, 0.0), (0.0, 2.0), (1.0, 3.5), (2.5, 4.0)]))
ackermann = CAR.replace(
    'at = [0, 0.3, 0], value = "steer"',
    'at = [0, 0.3, 0], value = "atan2(0.7*tan(steer), 0.7 - 0.3*tan(steer))"',
).replace(
    'at = [0, -0.3, 0], value = "steer"',
    'at = [0, -0.3, 0], value = "atan2(0.7*tan(steer), 0.7 + 0.3*tan(steer))"',
)
File("ackermann.toml").write_text(ackermann)
runs = {}
for name in ("car", "ackermann"):
    vehicle = read_vehicle(File(f"{name}.toml"))
    model = direct_kinematics(vehicle, ground)
    law = follow(model, path, speed=0.4)
    runs[name] = simulate(model, settle(model), law, np.linspace(0, 12, 241))
    slip = np.sqrt((runs[name]["slip_along"] ** 2 + runs[name]["slip_across"] ** 2).mean())
    print(f"{name:10} rms slip of a wheel {1000 * slip:.2f} mm/s at 400 mm/s")

# %%
figure = style.figure(6.6, 3.2)
left, right = figure.subplots(1, 2)
motion_figures.ground(grid, left)
left.plot(runs["ackermann"]["contact_x"], runs["ackermann"]["contact_y"], lw=1)
for k, (name, motion) in enumerate(runs.items()):
    size = np.hypot(motion["slip_along"], motion["slip_across"]).max(axis=1)
    right.plot(motion.t, 1000 * size, label=name, **style.look(k))
right.set(xlabel="time [s]", ylabel="slip of the worst wheel [mm/s]")
right.legend(frameon=False)
figure

# %% [markdown]
# ## With weight
#
# Masses sit on the parts: then forces are computed, and a motion ends where a wheel would lift off. In a
# file they are `mass` of the platform, of joints and of wheels; here they are put into what was read.

# %%
car = read_vehicle(File("ackermann.toml"))
heavy = replace(
    car, body=Body(80.0, (0.0, 0.35, 0.1)), wheels=tuple(replace(w, mass=4.0) for w in car.wheels)
)
model = direct_kinematics(heavy, ground)
law = follow(model, path, speed=0.4)
run = simulate(model, settle(model), law, np.linspace(0, 12, 241))
print(f"{heavy.mass:.0f} kg; utilisation of friction {run['utilisation'].max():.2f}, ", end="")
print(
    f"torque {np.abs(run['drive_torque']).max():.1f} N m, tip-over margin {run['tip_over_margin'].min():.2f} rad"
)

# %% [markdown]
# ## In Python
#
# The same records that files are read into, in axes x right, y forward, z up. A cart with a caster, whose
# swivel is passive and trails by 6 cm:

# %%
cart = Vehicle(
    "cart",
    coordinates=(Coordinate("swivel", "passive", "swivel of the caster"),),
    joints=(Joint("caster", "platform", "z", (0.0, 0.5, 0.0), "swivel"),),
    wheels=(
        Wheel("right", "platform", (0.25, 0.0, 0.0), Torus(0.02, 0.1), driven=True),
        Wheel("left", "platform", (-0.25, 0.0, 0.0), Torus(0.02, 0.1), driven=True),
        Wheel("front", "caster", (0.0, -0.06, 0.0), Torus(0.02, 0.1), driven=False),
    ),
)
model = direct_kinematics(cart, ground)
rates = model.inputs(right_rate=3.0, left_rate=2.5)
run = simulate(model, settle(model, swivel=2.5), rates, np.linspace(0, 8, 161))
print(f"the caster swings from {run['swivel'][0]:.2f} to {run['swivel'][-1]:.2f} rad")

# %% [markdown]
# What no contact feels is refused by name, such as a caster without trail on level ground:

# %%
wheels = (*cart.wheels[:2], replace(cart.wheels[2], at=(0.0, 0.0, 0.0)))
try:
    settle(direct_kinematics(replace(cart, wheels=wheels), Bicubic(blank((-2, 2), (-2, 2), 0.25))))
except ModelError as error:
    print(error)

# %% [markdown]
# URDF files are read too, and the catalogue has rovers: see the page on vehicles.
