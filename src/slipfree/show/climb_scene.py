"""Scenes of climbs: the profile and the vehicle, with an assumed width.

A climb is computed in a plane. For the scene the profile is extruded across the plane, and the
wheels of an axle stand side by side; the width has no effect on the computation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from slipfree.climb.metrics import MIN_LOAD
from slipfree.errors import ModelError
from slipfree.geometry.mesh import Mesh
from slipfree.records import Array, Label
from slipfree.show import climb_figures, scene
from slipfree.show.drive_scene import solid_mesh, vehicle_bodies
from slipfree.show.meshes import joined
from slipfree.show.scene import Actor, Arrows, Ground, Scene
from slipfree.terrain.solids import Prism, Profile
from slipfree.trajectory import Column, Trajectory
from slipfree.vehicle.climber import FOLD, Climber, side_view
from slipfree.vehicle.sections.torus import Torus
from slipfree.vehicle.tree import Vehicle

TRACK = 3.5  # half of the track width [wheel radius]
WIDTH = 2.0  # half of the width of the ground [half track]
TUBE = 0.35  # radius of the wheels' tube [wheel radius]
ROOM = 4.0  # margin of the ground around a climb [wheel radius]


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
    places = np.concatenate([run["center_y"].ravel() for run in runs])
    room = ROOM * first.climber.radius
    left, right = float(places.min()) - room, float(places.max()) + room
    origin = np.round([0.0, (left + right) / 2, 0.0])
    top = max(max(z for _, z in solid.points) for solid in first.profile.solids)
    mesh = _solids(first, left, right, origin)
    z = mesh.vertices[:, 2] + origin[2]
    ground = Ground(mesh, (scene.layer("height", z, f"0 to {top:.4g} m", 0.0, top),))
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

    def draw(ax: Axes) -> Axes:
        climb_figures.ground(first.profile, ax)
        return climb_figures.frame_motions([each.run for each in climbs], first.climber, ax)

    def near(middle: Array, half: float) -> Sequence[Array]:
        y = float(middle[1] + origin[1])
        mesh = _solids(first, y - half, y + half, origin)
        return [mesh.vertices[face] for face in mesh.faces]

    return scene.Backdrop(draw, scene.SECTION, near, reach, (14.0, -25.0))


def _reach(climber: Climber) -> float:
    return climber.front.ahead - climber.rear.ahead + climber.radius


def _solids(each: Climbed, left: float, right: float, origin: Array) -> Mesh:
    """Return the mesh of the extruded profile between two positions along it [m]."""
    half = WIDTH * TRACK * each.climber.radius
    window, bottom = (-half, half, left, right), -ROOM * each.climber.radius
    solids = (Prism(solid, half_width=half) for solid in each.profile.solids)
    return joined(*(solid_mesh(solid, window, bottom, origin) for solid in solids))


def _actor(
    each: Climbed, run: Trajectory, name: str, k: int, origin: Array, ghost: bool = False
) -> Actor:
    color, vehicle = scene.color_of(k), _with_width(each.climber)
    bodies = vehicle_bodies(vehicle, _in_space(each.climber, run), color)
    contacts = np.full((run.t.size, 1, 3), np.nan)
    arrows: tuple[Arrows, ...] = ()
    if not ghost:  # plans have no loads
        contacts, arrows = _contacts(each, run, origin)
    moved = tuple(body._replace(origins=body.origins - origin) for body in bodies)
    return Actor(name, color, run.t, moved, contacts, arrows, ghost, scene.stopped(run))


def _abreast(climber: Climber, k: int) -> Array:
    """Return the lateral positions of the wheels of an axle, positive to the right [m]."""
    half, count = TRACK * climber.radius, climber.axles[k].wheels
    return np.linspace(-half, half, count) if count > 1 else np.zeros(1)


def _with_width(climber: Climber) -> Vehicle:
    """Return the vehicle with all wheels of each axle side by side."""
    section = Torus(TUBE * climber.radius, (1 - TUBE) * climber.radius)
    flat = side_view(climber)
    wheels = (
        replace(wheel, name=f"{wheel.name}_{number}", at=(float(x), *wheel.at[1:]), section=section)
        for k, wheel in enumerate(flat.wheels)
        for number, x in enumerate(_abreast(climber, k), 1)
    )
    return replace(flat, wheels=tuple(wheels), planar=False)


def _in_space(climber: Climber, run: Trajectory) -> Trajectory:
    """Return the poses of a motion in space, with the angles of all wheels of each axle."""
    zero, (rear, front) = np.zeros(run.t.size), (run["tilt_rear"], run["tilt_front"])
    values = dict.fromkeys(("x", "heading", "roll"), zero)
    values |= {"y": run["y"], "z": run["z"], "pitch": rear, FOLD: front - rear}
    counts = [axle.wheels for axle in climber.axles]
    values["wheel_angle"] = np.repeat(run["wheel_angle"], counts, axis=1)
    columns = {name: Column(Label(name, "", name), each) for name, each in values.items()}
    return Trajectory(run.t, columns)


def _contacts(each: Climbed, run: Trajectory, origin: Array) -> tuple[Array, tuple[Arrows, ...]]:
    """Return the contact points of all wheels, and the arrows of slip and forces there."""
    points, slips, forces = [], [], []
    for number, solid in enumerate(each.profile.solids, 1):
        normals = solid.distance(run["center_y"], run["center_z"])[1]
        tangents = np.stack([normals[..., 1], -normals[..., 0]], axis=-1)
        for k, axle in enumerate(each.climber.axles):
            normal, tangent = _to_space(normals[:, k]), _to_space(tangents[:, k])
            load, rubbing, slip = (
                run[f"solid_{name}_{number}"][:, k, None] for name in ("load", "friction", "slip")
            )
            center = _to_space(np.stack([run["center_y"], run["center_z"]], axis=2)[:, k])
            touch = (
                np.where(load > MIN_LOAD, center - each.climber.radius * normal, np.nan) - origin
            )
            for across in _abreast(each.climber, k):
                points.append(touch + np.array([across, 0.0, 0.0]))
                slips.append(slip * tangent)
                forces.append((load * normal + rubbing * tangent) / axle.wheels)
    at = np.stack(points, axis=1)
    bears = np.isfinite(at)
    vectors = (np.where(bears, np.stack(each, axis=1), np.nan) for each in (slips, forces))
    arrows = tuple(Arrows(*pair) for pair in zip(("slip", "force"), (at, at), vectors, strict=True))
    return at, arrows


def _to_space(vectors: Array) -> Array:
    """Return plane vectors (y, z), shape (n, 2), as vectors (0, y, z), shape (n, 3)."""
    return np.insert(vectors, 0, 0.0, axis=1)
