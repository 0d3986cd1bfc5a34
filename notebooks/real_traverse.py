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
# # A traverse of real ground
#
# The Jacksboro fault in Tennessee: an elevation model of 403 by 344 nodes, 74 by 93 m apart, that matplotlib
# ships. We take it at a tenth of its size, slopes unchanged, so that a cell is some five vehicles long, and
# send a three-wheeler through a gap of the ridge: a route, a drive along it, its forces, and what to do
# where the map is finer than the wheels. With your own map, `read_map` stands in place of `jacksboro`.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path as File

import numpy as np

from slipfree import (
    Bicubic,
    Path,
    SolverOptions,
    catalog,
    direct_kinematics,
    follow,
    settle,
    simulate,
    straight,
)
from slipfree.core.errors import ModelError
from slipfree.core.trajectory import path_length
from slipfree.files.maps.elevation import jacksboro
from slipfree.files.netcdf import export_path, write
from slipfree.routing.search import routes
from slipfree.routing.traversability import blocking_reasons, traversability
from slipfree.show import motion_figures, style
from slipfree.show.plan_figures import cost_map, initial_routes
from slipfree.show.plots import draw
from slipfree.terrain.base import Grid
from slipfree.terrain.rolled import rolled

whole = jacksboro(scale=0.1)
inside_x = (whole.x >= 2300) & (whole.x <= 2730)
inside_y = (whole.y >= 2300) & (whole.y <= 2750)
grid = Grid(
    whole.x[inside_x], whole.y[inside_y], np.ascontiguousarray(whole.z[np.ix_(inside_x, inside_y)])
)
ground = Bicubic(grid, mu=0.8)
print(f"cells of {grid.spacing[0]:.1f} x {grid.spacing[1]:.1f} m, relief {np.ptp(grid.z):.0f} m")

# %% [markdown]
# ## Where can it go?
#
# For every place and eight directions: the pose of the vehicle, and the friction that it takes. What cannot be
# crossed is blocked, and a message gives the reason.

# %%
vehicle = catalog.three_wheeler()
start, goal = (2650.0, 2430.0), (2530.0, 2650.0)
layers = traversability(ground, vehicle)
found = routes(layers, start, goal, 2, turning_radius=3.0)
for route in found:
    print(
        f"a way of {route.length:.0f} m, which costs as much as {route.cost:.0f} m of level ground"
    )
poses = layers.poses
used = np.fmin.reduce(poses["utilisation"])
i, j = np.unravel_index(np.nanargmax(used), used.shape)
x, y = poses.x[i], poses.y[j]
print(f"at ({x:.0f}, {y:.0f}) m: {blocking_reasons(layers, x, y)}")

# %%
figure = style.figure(6.0, 5.4)
ax = figure.add_subplot(aspect="equal", xlabel="east x [m]", ylabel="north y [m]")
cost_map(layers, grid, ax, grid.domain)
initial_routes([route.points for route in found], ax)
figure.legend(loc="outside lower center", ncols=3)
figure

# %% [markdown]
# ## The drive
#
# A law follows the cheapest way at 1 m/s. It knows the plane only; the model knows the ground.

# %%
path = Path(found[0].points)
model = direct_kinematics(vehicle, ground)
ahead = path.points[1] - path.points[0]
stand = settle(model, x=start[0], y=start[1], heading=np.arctan2(-ahead[0], ahead[1]))
law = follow(model, path, speed=1.0)
run = simulate(
    model, stand, law, np.arange(0, found[0].length, 0.5), options=SolverOptions(tolerance=1e-7)
)
print(run.stop.words if run.stop else f"{path_length(run):.0f} m in {run.t[-1]:.0f} s")
off = np.hypot(*(run[axis][-1] - at for axis, at in zip("xy", path.points[-1], strict=True)))
print(f"climbed {np.ptp(run['z']):.1f} m, ends {off:.2f} m from the goal")
print(
    f"largest tilt {np.abs(run['tilt_right']).max():.4f} rad, slip {np.abs(run['slip_across']).max():.0e} m/s"
)
print(f"closure residual {run['closure_residual'].max():.0e} m, ", end="")
print(f"clearance beside the contacts {run['clearance'].min():.2f} m at least")

# %%
figures = draw(motion_figures.motion_plots(run, grid))
figures["map"]

# %% [markdown]
# ## What does it take to be there?
#
# The vehicle's weight, quasi-statically: contact forces, the friction that each wheel needs, drive torque
# and how far it is from tipping over.

# %%
needed = run["friction_needed"]
k, worst = np.unravel_index(np.argmax(needed), needed.shape)
print(f"friction needed {needed.max():.2f}: wheel {run.wheels[worst]}, t = {run.t[k]:.0f} s")
print(f"drive torque {np.abs(run['drive_torque']).max():.0f} N m, ", end="")
print(f"tip-over margin {run['tip_over_margin'].min():.2f} rad")
figure = style.figure(6.4, 2.8)
ax = style.history(run, "friction_needed", figure.subplots())
ax.axhline(ground.mu, color="black", ls=":", label="what the ground offers")
figure.legend(loc="outside lower center", ncols=4)
figure

# %% [markdown]
# Above the line friction cannot hold this motion: across a slope the tilting vehicle needs three times the
# slope's tangent. That is what a plan with a limit on `utilisation` is for
# (`slipfree run problems/plan_real_dem.toml`, the same gap), or a vehicle with a rigid axle.
#
# ## Where the map is finer than the wheels
#
# At 1/200 cells are 0.4 m wide, and the tightest hollows have a radius of 0.35 m. Wheels of 0.6 m would touch
# twice there, and the motion ends by name. `rolled` gives the ground as the wheel feels it, and says how much
# it changed.

# %%
small = jacksboro(scale=1 / 200)
east, north = (small.x > 126) & (small.x < 146), (small.y > 70) & (small.y < 95)
rough = Grid(small.x[east], small.y[north], np.ascontiguousarray(small.z[np.ix_(east, north)]))
felt = rolled(rough, 0.6)
print(f"rolled: height changed by {felt.largest:.3f} m at most, {1000 * felt.rms:.1f} mm rms")
large = catalog.three_wheeler(r1=0.1, r2=0.5)
for words, height in (("as measured", rough), ("as the wheel feels it", felt.grid)):
    model = direct_kinematics(large, Bicubic(height))
    try:
        stand = settle(model, x=136.15, y=78.93)
        drive = straight(model, stand, speed=0.5)
        crossed = simulate(model, stand, drive, np.linspace(0, 20, 401))
    except ModelError as error:
        print(f"{words}: {error}")
        continue
    end = crossed.stop.words if crossed.stop else "all of the way"
    print(f"{words}: {path_length(crossed):.1f} m; {end}")

# %% [markdown]
# ## Take it elsewhere
#
# Results are netCDF that xarray, MATLAB and others open; `export_path` (at the shell `slipfree export`)
# writes the way in the coordinates of the map.

# %%
with tempfile.TemporaryDirectory() as folder:
    write(File(folder) / "traverse.nc", run)
    export_path(File(folder) / "traverse.nc", File(folder) / "way.csv")
    print(*(File(folder) / "way.csv").read_text().splitlines()[:3], sep="\n")
