"""Vehicles with shapes on rough ground, and the clearance of their bodies by brute force."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from helpers.vehicles import part_frames
from slipfree import Bicubic, Grid, ModelError, direct_kinematics, settle
from slipfree.catalog import rocky7, skid_steer, three_wheeler
from slipfree.vehicle.shapes import Ball, Box, Hull

AXIS = np.linspace(-4, 4, 81)


def with_shapes(vehicle, *shapes, **joints):
    """Return a vehicle with shapes on its platform, and on joints by name."""
    moved = (
        replace(j, body=replace(j.body, shapes=joints.get(j.name, ()))) for j in vehicle.joints
    )
    return replace(
        vehicle, body=replace(vehicle.body, shapes=shapes), joints=tuple(moved), name="shaped"
    )


LATTICE = tuple((0.3 * i, 0.4 + 0.3 * j, 0.0) for i in (-1, 0, 1) for j in (-1, 0, 1))
SHAPED = {
    "box": with_shapes(skid_steer(), Box((0.3, 0.7, 0.2), (0.02, 0.05, 0.13), (0.05, -0.1, 0.3))),
    "rocker": with_shapes(
        rocky7(),
        Box((0.26, 0.4, 0.16), (0.0, 0.1, 0.2)),
        rocker_right=(Ball(0.05, (0.0, -0.05, -0.05)),),
        bogie_left=(Ball(0.02, (0.0, 0.0, 0.03)),),
    ),
    "hull": with_shapes(three_wheeler(axle="fixed"), Hull(LATTICE), Ball(0.1, (0.2, 0.5, 0.2))),
}


def rough(seed=3, relief=0.03):
    """Random ground with waves of half a metre, and its heights by scipy alone."""
    z = gaussian_filter(np.random.default_rng(seed).normal(size=(81, 81)), 3, mode="wrap")
    z *= relief / z.std()
    return Bicubic(Grid(AXIS, AXIS, z), mu=0.8), RectBivariateSpline(AXIS, AXIS, z, s=0).ev


def shape_distance(shape, points):
    """Distances of points, in the shape's part, from a shape; negative in a box."""
    if isinstance(shape, Ball):
        return np.linalg.norm(points - shape.at, axis=-1) - shape.radius
    if isinstance(shape, Hull):
        corners = np.array(shape.points)
        return np.linalg.norm(points[..., None, :] - corners, axis=-1).min(axis=-1)
    axes = Rotation.from_euler("xyz", shape.turned).as_matrix()
    beyond = np.abs((points - shape.at) @ axes) - np.array(shape.size) / 2
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    return outside + np.minimum(beyond.max(axis=-1), 0)


def brute_clearance(vehicle, run, heights):
    """Least distance of dense samples of the ground from the shapes, improved by Nelder and Mead.

    Sampling alone, 2 cm apart, is at most 0.3 mm above the minimum.
    """
    frames, least = part_frames(vehicle, run), np.inf
    for name, shape in vehicle.shapes:
        origin, axes = frames[name][0][0], frames[name][1][0].as_matrix()
        middle = origin + axes @ np.mean(
            getattr(shape, "points", [getattr(shape, "at", 0)]), axis=0
        )

        def distance(x, y, shape=shape, origin=origin, axes=axes):
            points = np.stack([x, y, heights(x, y)], axis=-1)
            return shape_distance(shape, (points - origin) @ axes)

        sides = [np.arange(center - 0.9, center + 0.9, 0.02) for center in middle[:2]]
        x, y = np.meshgrid(*sides, indexing="ij")
        values = distance(x, y)
        inner = values[1:-1, 1:-1]
        around = [
            values[1 + i : values.shape[0] - 1 + i, 1 + j : values.shape[1] - 1 + j]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        low = np.argwhere(inner <= np.min(around, axis=0)) + 1
        low = low[np.argsort(values[tuple(low.T)])]
        for i, j in low[:4]:
            if values[i, j] > min(least, values.min()) + 1e-3:
                break
            at = minimize(
                lambda p: float(distance(p[0], p[1])),
                [x[i, j], y[i, j]],
                method="Nelder-Mead",
                options={"xatol": 1e-7, "fatol": 1e-10},
            )
            least = min(least, at.fun)
    return least


def settled_poses(vehicle, count, relief=0.03):
    """Yield starts at random places of rough ground, and their clearances by brute force."""
    ground, heights = rough(relief=relief)
    model, rng = direct_kinematics(vehicle, ground), np.random.default_rng(count)
    while count:
        x, y, heading = rng.uniform((-2, -2, -3), (2, 2, 3))
        try:
            run = settle(model, x=x, y=y, heading=heading)
        except ModelError:  # a wheel touches a second time
            continue
        yield run, brute_clearance(vehicle, run, heights)
        count -= 1
