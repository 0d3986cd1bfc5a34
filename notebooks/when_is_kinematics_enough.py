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
# # When is kinematics enough?
#
# Kinematics and quasi-statics leave inertia out. This page measures the error of that: two vehicles
# drive over the same hills at speeds from 0.1 to 0.8 m/s, once with `quasi_statics` and once with
# `dynamics`. Both models have the same masses, the same friction and the same wheel rates. Lengths
# are in metres.

# %%
# %matplotlib inline
import casadi as ca
import numpy as np

from slipfree import Analytic, catalog, dynamics, quasi_statics, settle, simulate
from slipfree.laws.compliant import Compliant
from slipfree.laws.coulomb import Coulomb
from slipfree.show import style

GRAVITY, CREEP, PATH = 9.81, 1e-3, 1.0  # m/s^2, m/s, m
ground = Analytic(
    lambda x, y: 0.08 * (ca.sin(1.7 * x + 0.9 * y) + ca.sin(0.8 * x - 1.5 * y + 1.0)), mu=0.7
)
vehicles = {"skid steer": catalog.skid_steer(), "rocking axle": catalog.ackermann()}
wheelbases = {"skid steer": 0.5, "rocking axle": 0.7}
speeds = np.array([0.1, 0.2, 0.4, 0.8])


def drive(model, vehicle, rate, **start):
    """Return the motion along the path; rims move at a speed of ``rate``, 15 % more or less."""
    rates = {
        f"{wheel.name}_rate": rate / wheel.radius * (1.15 if "right" in wheel.name else 0.85)
        for wheel in vehicle.wheels
        if wheel.driven
    }
    rates |= {label.full: 0.0 for label in model.labels.u.joints}
    begin = settle(model, x=0.3, y=0.2, heading=0.3, **start)
    return simulate(model, begin, model.inputs(**rates), np.linspace(0, PATH / rate, 41))


# %% [markdown]
# ## The difference grows with the square of the speed
#
# The right wheels are faster than the left ones, so that wheels slip all the time. The distance
# between the ends of both motions is drawn over the speed. A line shows the slope of a square.

# %%
figure = style.figure(8, 4)
axes = figure.subplots()
differences = {}
for name, vehicle in vehicles.items():
    still = quasi_statics(vehicle, ground, law=Coulomb(creep=CREEP))
    moving = dynamics(vehicle, ground, law=Compliant(creep=CREEP))
    ends = []
    for speed in speeds:
        slow = drive(still, vehicle, speed)
        fast = drive(moving, vehicle, speed, speed=speed)
        ends.append(np.hypot(*(fast[axis][-1] - slow[axis][-1] for axis in "xy")))
    differences[name] = np.array(ends)
    axes.loglog(speeds, 1e3 * differences[name], "o-", label=name)
    print(f"{name:12}:", ", ".join(f"{1e3 * end:.2f} mm" for end in ends))
axes.loglog(speeds, 10 * (speeds / 0.8) ** 2, color="0.6", label="square of the speed")
axes.set(xlabel="speed (m/s)", ylabel="distance of the ends (mm)")
axes.set_xticks(speeds, [f"{speed:g}" for speed in speeds])
axes.minorticks_off()
axes.legend()
figure

# %% [markdown]
# At the lowest speeds a part remains that does not depend on the speed: in dynamics the wheels are
# pressed into the ground by a small depth, in quasi-statics they are not.
#
# ## A rule of thumb
#
# The Froude number $v^2 / (g L)$, with the wheelbase $L$, compares inertia with weight. The difference
# per metre, divided by the Froude number, is about the same at the two highest speeds.

# %%
for name, ends in differences.items():
    froude = speeds**2 / (GRAVITY * wheelbases[name])
    for speed, number, end in zip(speeds[2:], froude[2:], ends[2:], strict=True):
        print(
            f"{name:12}: {speed} m/s, Froude number {number:.3f}, difference {end / PATH:.2%} of "
            f"the path, {end / PATH / number:.2f} times the Froude number"
        )

# %% [markdown]
# So for this ground and these vehicles: **inertia changes the end of a path by about a tenth of the
# Froude number, as a share of the length.** A vehicle with a wheelbase of half a metre may leave
# inertia out up to 0.7 m/s, if 1 % of the path is accurate enough. Other grounds have other factors:
# measure yours by two runs, with `model = "quasi-static"` and `model = "dynamics"`.
#
# ## Where the rule ends
#
# The rule assumes that wheels stay on the ground. On a crest of curvature $\kappa$ a vehicle lifts
# off if $v^2 \kappa > g$; a single wheel of light load does so earlier. Here the first wheel loses
# its load at a Froude number near 1. From then on only dynamics describes the motion.

# %%
vehicle = vehicles["skid steer"]
moving = dynamics(vehicle, ground, law=Compliant(creep=CREEP))
for speed in (0.8, 1.6, 2.4, 3.2):
    run = drive(moving, vehicle, speed, speed=speed)
    lifted = (run["depth"] < 0).any(axis=1).mean()
    least = run["force_normal"].min() / (vehicle.weight / len(vehicle.wheels))
    print(
        f"{speed} m/s, Froude number {speed**2 / (GRAVITY * 0.5):.2f}: a wheel in the air during "
        f"{lifted:.0%} of the time, least load {least:.2f} of an equal share"
    )
