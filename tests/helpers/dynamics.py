"""Grounds, a car and motions for tests of dynamics."""

from dataclasses import replace
from functools import cache

import numpy as np

from slipfree import Analytic, SolverOptions, settle, simulate
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import EARTH_GRAVITY, Body, Coordinate, Joint, Vehicle, Wheel

FLAT = Analytic(lambda x, y: 0 * (x + y), mu=0.8)


@cache  # the same ground each time, so that its models are found again
def slope(degrees, mu=None, across=False):
    """Return a plane that rises along y, or along x."""
    rise = np.tan(np.radians(degrees))
    return Analytic(lambda x, y: rise * (x if across else y) + 0 * (x + y), mu=mu)


def states(model, **values):
    """Return a start of a model at given states; others are zero."""
    return settle(replace(model, standing=None), **({"attitude_w": 1.0} | values))


def moved(model, start, t, tolerance=1e-9, **inputs):
    """Return the motion from a start, with zero for inputs that are not given."""
    given = {label.full: 0.0 for part in model.labels.u for label in part} | inputs
    run = simulate(model, start, model.inputs(**given), t, options=SolverOptions(tolerance))
    assert run.stop is None
    return run


def energy_error(run):
    """Return what the energy gains beyond the work that is not lost [J]."""
    energy = run["kinetic_energy"] + run["potential_energy"] + run["contact_energy"]
    return energy - energy[0] - run["work"] + run["lost_energy"]


def four_wheels(*, spring=0.0, driven=True, mass=40.0, height=0.25, turn=None, **wheel):
    """Return a car; with a spring constant, its wheels are on vertical struts.

    With the radius ``turn`` of the path of the rear axle's middle, around a centre to the left, the
    front wheels are fixed at the angles of this turn.
    """
    length, half_track, radius = 0.7, 0.3, 0.15
    coordinates, joints, wheels = [], [], []
    corners = [(end, side) for end in (length, 0.0) for side in (half_track, -half_track)]
    for k, (y, x) in enumerate(corners):
        name, parent, at = f"w{k}", "platform", (x, y, 0.0)
        if spring:
            rest = -mass / 4 * EARTH_GRAVITY / spring
            words = f"stroke {k}"
            coordinates.append(
                Coordinate(f"s{k}", "suspension", words, stiffness=spring, rest=rest, damping=150.0)
            )
            joints.append(Joint(f"strut{k}", "platform", "z", at, f"s{k}", "slide"))
            parent, at = f"strut{k}", (0.0, 0.0, 0.0)
        if turn and y:
            angle = np.arctan2(length, turn + x)
            knuckle = Joint(f"knuckle{k}", parent, "z", at, "0", turned=(0.0, 0.0, angle))
            joints.append(knuckle)
            parent, at = f"knuckle{k}", (0.0, 0.0, 0.0)
        wheels.append(Wheel(name, parent, at, Torus(0.03, 0.12), driven=driven, mass=2.0, **wheel))
    body = Body(mass, (0.0, length / 2, height - radius), (1.5, 1.2, 2.0, 0, 0, 0))
    return Vehicle("car", tuple(coordinates), tuple(joints), tuple(wheels), body)


def center_height(vehicle, body_height):
    """Return the height of the centre of mass of `four_wheels` over the ground [m]."""
    return (40 * body_height + 8 * 0.15) / vehicle.mass
