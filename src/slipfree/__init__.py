"""Simulation and planning of the motion of wheeled vehicles over uneven ground.

Build a ground and a vehicle, then a model of both and an initial state; then simulate or plan the
motion:

Ground
    `Analytic`, a formula. `Bicubic`, the surface of a `Grid` of heights. `read_map`, heights from a
    file. `Solids`, steps, stairs and boxes on a ground.
Vehicle
    `catalog`, vehicles ready for use. `read_vehicle`, a vehicle from a TOML or URDF file.
    `Vehicle`, a tree of `Coordinate`, `Joint`, `Body` and `Wheel` with the drives `Rate`, `Torque`
    or `Motor`. `planar`, a vehicle that moves only in a vertical plane; `in_gravity`, one on the
    moon or elsewhere.
Model, a `Dae`
    `direct_kinematics`, the motion at given wheel rates, with a slip law: `LeastSlip`, `Rolling`.
    `inverse_kinematics`, the wheel rates of a given motion. `quasi_statics`, the slow motion under
    gravity and friction, with a wheel-ground law: `Coulomb`, `Soil`. `dynamics`, the motion with
    inertia on `Compliant` contacts or `Soil`. `rigid_dynamics`, the motion with inertia on rigid
    contacts, for plans, with `LinearCreep` or `Coulomb`.
    `montana_kinematics`, a second formulation of the direct kinematics.
Start
    `settle`, the vehicle at rest on the ground. `settle_many`, at many positions at once.
    `guarantee`, bounds of poses for every ground within an error of the map.
Inputs
    ``model.inputs(...)``, values or expressions. `follow` a `Path`, or drive `straight`. A model
    that is `commanded` has forward velocity and yaw rate as inputs.
Motion, a `Trajectory`
    `simulate`, with `SolverOptions`; the `Outcome` says whether the motion is complete. `rollouts`,
    many motions of one model, in processes or side by side.
    `cross_check`, the difference between two formulations.
Mobility map, an ``Atlas``
    `atlas`, where and how a vehicle can stand on a map. `plot` draws it, a motion or a plan.
Plan
    `plan`, the inputs that reach a goal with the least `Cost`; its options `Mesh` and `Search`.
    `replan`, a plan from the current state while driving; `sample_plan`, by sampling
    (`SamplingTask`). `Region`, a keep-out region. `Route`, a path over a map.
Problem file
    `load_problem` and `run_problem`, as in ``slipfree run``. `open_result`, the result in a file.
Errors
    `ModelError`, `DataError`, `SolverError`; all are `SlipfreeError`.

All quantities are in SI units, angles in radians. Map coordinates have z up; ``heading`` is
measured counter-clockwise from the y axis. Expressions of a model are in local coordinates: see
`Dae`.

Examples
--------
>>> import numpy as np
>>> from slipfree import Analytic, catalog, direct_kinematics, settle, simulate
>>> model = direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y))
>>> inputs = model.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
>>> run = simulate(model, settle(model), inputs, np.linspace(0, 2, 5))
>>> print(f"{run['y'][-1]:.3f} m forward")
0.300 m forward
"""

import lazy_loader

# Names are imported at their first use, so that the command line starts without delay.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
