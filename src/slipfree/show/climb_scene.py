"""Scenes of climbs: the profile and the vehicle, with an assumed width.

A climb is computed in a plane. For the scene the profile is extruded across the plane, and the
wheels of an axle stand side by side; the width has no effect on the computation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from slipfree.climb.metrics import MIN_LOAD
from slipfree.errors import ModelError
from slipfree.geometry.mesh import Mesh
from slipfree.models.poses import spun
from slipfree.records import Array
from slipfree.show import climb_figures, scene
from slipfree.show.meshes import clipped, extruded, joined, plate, rod, spokes
from slipfree.show.scene import PLATE, ROD, TYRE, Actor, Arrows, Color, Ground, Scene
from slipfree.terrain.solids import Profile
from slipfree.trajectory import Trajectory
from slipfree.vehicle.climber import AXLES, Body, Climber
from slipfree.vehicle.sections.torus import Torus

TRACK = 3.5  # half of the track width [wheel radius]
WIDTH = 2.0  # half of the width of the ground [half track]
TUBE = 0.35  # radius of the wheels' tube [wheel radius]
ROOM = 4.0  # margin of the ground around a climb [wheel radius]
LEVELS = 25  # subdivisions of the ground in height, for its colour
NARROW = 0.6  # width of the bodies [width of the vehicle]
TILTS = {"rear": "tilt_rear", "middle": "tilt_rear", "front": "tilt_front"}  # by axle


class Climbed(NamedTuple):
    """A climb with its vehicle and ground.

    Attributes
    ----------
    name : str
        Displayed name.
    run : Trajectory
        The motion.
    climber, profile : Climber, Profile
        The vehicle and the ground.
    plan : Trajectory or None
        The plan that the climb tracks.
    """

    name: str
    run: Trajectory
    climber: Climber
    profile: Profile
    plan: Trajectory | None = None


def climb_scene(climbs: Sequence[Climbed]) -> Scene:
    """Return the scene of climbs over one profile.

    Parameters
    ----------
    climbs : sequence of Climbed
        Climbs to draw, at least one.

    Raises
    ------
    ModelError
        If their profiles differ.
    """
    first = climbs[0]
    for each in climbs[1:]:
        if each.profile != first.profile:
            raise ModelError(
                f"{each.name}: expected a climb over the profile of {first.name}, found another "
                "profile; show the results separately"
            )
    reach = max(_reach(each.climber) for each in climbs)
    runs = [run for each in climbs for run in (each.run, each.plan) if run is not None]
    origin = np.round([np.mean([_span(runs, "center_y")]), 0.0, 0.0])
    ground = _ground(first, runs, origin)
    actors = []
    for k, each in enumerate(climbs):
        actors.append(_actor(each, each.run, each.name, k, origin))
        if each.plan is not None:
            actors.append(
                _actor(each, each.plan, f"{each.name}: plan", k + len(climbs), origin, ghost=True)
            )
    notes = [
        "A climb is computed in a plane: the widths of ground and vehicle are only for display."
    ]
    return scene.framed(ground, actors, origin, reach, _backdrop(climbs, origin, reach), notes)


def _backdrop(climbs: Sequence[Climbed], origin: Array, reach: float) -> scene.Backdrop:
    """Return the ground of a film: its section, and the solids around the vehicle."""
    first = climbs[0]
    width = WIDTH * TRACK * first.climber.radius

    def draw(ax: Axes) -> Axes:
        climb_figures.ground(first.profile, ax)
        return climb_figures.frame_motions([each.run for each in climbs], first.climber, ax)

    def near(middle: Array, half: float) -> Sequence[Array]:
        x = middle[0] + origin[0]
        faces = []
        for solid in first.profile.solids:
            corners = clipped(
                solid.points, (x - half, -ROOM * first.climber.radius), (x + half, np.inf)
            )
            if len(corners) >= 3:
                right, left = (np.insert(corners, 1, y, axis=1) for y in (-width, width))
                edges = left, np.roll(left, -1, axis=0), np.roll(right, -1, axis=0), right
                faces += [*np.stack(edges, axis=1), right]
        return [face - origin for face in faces]

    return scene.Backdrop(draw, scene.SECTION, near, reach, (14.0, -115.0))


def _span(runs: Sequence[Trajectory], name: str) -> tuple[float, float]:
    return min(float(run[name].min()) for run in runs), max(float(run[name].max()) for run in runs)


def _reach(climber: Climber) -> float:
    return climber.front.ahead - climber.rear.ahead + climber.radius


def _ground(each: Climbed, runs: Sequence[Trajectory], origin: Array) -> Ground:
    """Return the extruded profile around the climbs."""
    radius = each.climber.radius
    half = WIDTH * TRACK * radius
    left, right = _span(runs, "center_y")
    bottom, top = (
        -ROOM * radius,
        max(max(z for _, z in solid.points) for solid in each.profile.solids),
    )
    levels = [bottom, *np.linspace(0, top, LEVELS if top > 0 else 1)]
    meshes = []
    for solid in each.profile.solids:
        for low, high in pairwise(levels):
            box = (left - ROOM * radius, low), (right + ROOM * radius, high)
            corners = clipped(solid.points, *box) - origin[[0, 2]]
            if len(corners) >= 3:
                outline = np.insert(corners, 1, half, axis=1)
                meshes.append(extruded(outline, (0.0, -2 * half, 0.0)))
    mesh = joined(*meshes)
    legend, z = f"0 to {top:.4g} m", mesh.vertices[:, 2] + origin[2]
    return Ground(mesh, (scene.layer("height", z, legend, 0.0, top),))


def _actor(
    each: Climbed, run: Trajectory, name: str, k: int, origin: Array, ghost: bool = False
) -> Actor:
    climber, color = each.climber, scene.color_of(k)
    bodies = [*_bodies(climber, run, origin, color), *_wheels(climber, run, origin, color)]
    contacts = np.full((run.t.size, 1, 3), np.nan)
    arrows: tuple[Arrows, ...] = ()
    if not ghost:  # plans have no loads
        contacts, arrows = _contacts(each, run, origin)
    return Actor(name, color, run.t, tuple(bodies), contacts, arrows, ghost, scene.stopped(run))


def _bodies(climber: Climber, run: Trajectory, origin: Array, color: Color) -> Iterable[scene.Body]:
    """Yield the rear and the front body; the origin of both is the joint between them."""
    joint = np.stack([run["y"], np.zeros(run.t.size), run["z"]], axis=1) - origin
    rear = (climber.rear.ahead, max(climber.middle.ahead, climber.rear.ahead / 2))
    front = (0.0, climber.front.ahead)
    axles = {"rear": [climber.rear.ahead, climber.middle.ahead], "front": [climber.front.ahead]}
    for name, body, ends in (
        ("rear", climber.rear_body, rear),
        ("front", climber.front_body, front),
    ):
        mesh = _body(climber.radius, ends, axles[name], body)
        yield scene.Body(
            f"{name} body", ((mesh, color),), joint, _tilt_rotations(run[f"tilt_{name}"])
        )


def _body(radius: float, ends: tuple[float, float], axles: Sequence[float], body: Body) -> Mesh:
    """Return the mesh of a body in its frame, x right, y forward: plate, axles, centre of mass."""
    half, thick = TRACK * radius, ROD * radius
    meshes = [plate(NARROW * half, *ends, PLATE * radius), rod((0, 0, 0), (0, axles[0], 0), thick)]
    meshes += [rod((-half, ahead, 0), (half, ahead, 0), thick) for ahead in axles]
    meshes.append(rod((0, body.ahead, 0), (0, body.ahead, body.above), 2 * thick))
    return joined(*meshes)


def _tilt_rotations(tilt: Array) -> Array:
    """Return rotation matrices, shape (n, 3, 3), of frames x right, y forward, tilted nose up."""
    cosine, sine, zero = np.cos(tilt), np.sin(tilt), np.zeros(tilt.size)
    right = np.stack([zero, zero - 1, zero], axis=1)
    forward, up = np.stack([cosine, zero, sine], axis=1), np.stack([-sine, zero, cosine], axis=1)
    return np.stack([right, forward, up], axis=2)


def _abreast(climber: Climber, k: int) -> Array:
    """Return the lateral positions of the wheels of an axle, positive to the left [m]."""
    half, count = TRACK * climber.radius, climber.axles[k].wheels
    return np.linspace(-half, half, count) if count > 1 else np.zeros(1)


def _wheels(climber: Climber, run: Trajectory, origin: Array, color: Color) -> Iterable[scene.Body]:
    tread = Torus(TUBE * climber.radius, (1 - TUBE) * climber.radius).mesh()
    looks = ((tread, TYRE), (spokes(0.97 * climber.radius), color))
    for k, axle in enumerate(AXLES):
        turned = spun(_tilt_rotations(run[TILTS[axle]]), run["wheel_angle", axle])
        for number, across in enumerate(_abreast(climber, k)):
            at = np.stack(
                [run["center_y", axle], np.full(run.t.size, across), run["center_z", axle]]
            )
            yield scene.Body(f"{axle} {number + 1}", looks, at.T - origin, turned)


def _contacts(each: Climbed, run: Trajectory, origin: Array) -> tuple[Array, tuple[Arrows, ...]]:
    """Return the contact points of all wheels, and the arrows of slip and forces there."""
    points, slips, forces = [], [], []
    for number, solid in enumerate(each.profile.solids, 1):
        normals = solid.distance(run["center_y"], run["center_z"])[1]
        tangents = np.stack([normals[..., 1], -normals[..., 0]], axis=-1)
        for k, axle in enumerate(AXLES):
            normal, tangent = _to_space(normals[:, k]), _to_space(tangents[:, k])
            load, rubbing, slip = (
                run[f"solid_{name}_{number}", axle][:, None]
                for name in ("load", "friction", "slip")
            )
            center = np.stack(
                [run["center_y", axle], np.zeros(run.t.size), run["center_z", axle]], 1
            )
            touch = (
                np.where(load > MIN_LOAD, center - each.climber.radius * normal, np.nan) - origin
            )
            for across in _abreast(each.climber, k):
                points.append(touch + np.array([0.0, across, 0.0]))
                slips.append(slip * tangent)
                forces.append((load * normal + rubbing * tangent) / each.climber.axles[k].wheels)
    at = np.stack(points, axis=1)
    bears = np.isfinite(at)
    vectors = (np.where(bears, np.stack(each, axis=1), np.nan) for each in (slips, forces))
    arrows = tuple(Arrows(*pair) for pair in zip(("slip", "force"), (at, at), vectors, strict=True))
    return at, arrows


def _to_space(vectors: Array) -> Array:
    """Return plane vectors (x, z), shape (n, 2), as vectors (x, 0, z), shape (n, 3)."""
    return np.stack([vectors[:, 0], np.zeros(len(vectors)), vectors[:, 1]], axis=1)
