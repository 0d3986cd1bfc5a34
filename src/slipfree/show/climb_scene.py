"""Scenes of climbs: the profile and the vehicle, with an assumed width.

A climb is computed in a plane. For the scene the profile is extruded across the plane, and the
wheels of an axle stand side by side; the width has no effect on the computation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from slipfree.errors import ModelError
from slipfree.geometry.mesh import Mesh
from slipfree.records import Array
from slipfree.routing.traversability import extents
from slipfree.show import climb_figures, scene
from slipfree.show.drive_scene import Driven, actors_of, solid_mesh
from slipfree.show.meshes import joined
from slipfree.show.scene import Ground, Scene
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Prism, Profile, Solid
from slipfree.trajectory import Trajectory
from slipfree.vehicle.climber import Climber, side_view
from slipfree.vehicle.sections.torus import Torus
from slipfree.vehicle.tree import Vehicle

TRACK = 3.5  # half of the track width [wheel radius]
WIDTH = 2.0  # half of the width of the ground [half track]
TUBE = 0.35  # radius of the wheels' tube [wheel radius]
ROOM = 4.0  # margin of the ground around a climb, and its depth [wheel radius]
FORCES = ("force_along", "force_across", "force_normal")


def in_space(
    name: str, run: Trajectory, climber: Climber, profile: Profile, plan: Trajectory | None = None
) -> Driven:
    """Return a climb as a motion in space, with an assumed width of vehicle and ground.

    Parameters
    ----------
    name : str
        Displayed name.
    run : Trajectory
        The motion.
    climber, profile : Climber, Profile
        The vehicle and the ground.
    plan : Trajectory, optional
        Poses of the plan that the climb tracks.
    """
    half = TRACK * climber.radius
    counts = [axle.wheels for axle in climber.axles]
    across = [np.linspace(-half, half, count) if count > 1 else np.zeros(1) for count in counts]
    vehicle = _with_width(climber, across)
    prisms = tuple(Prism(solid, half_width=WIDTH * half) for solid in profile.solids)
    nodes = np.linspace(-half, half, 4)  # the ground below all solids, which nothing touches
    bottom = min(z for solid in profile.solids for _, z in solid.points)
    terrain = Bicubic(Grid(nodes, nodes, np.full((4, 4), bottom)))
    moved, *planned = (
        _side_by_side(each, vehicle, counts, across) for each in (run, plan) if each is not None
    )
    return Driven(name, moved, terrain, vehicle, plan=next(iter(planned), None), prisms=prisms)


def _with_width(climber: Climber, across: Sequence[Array]) -> Vehicle:
    """Return the vehicle with all wheels of each axle side by side."""
    section = Torus(TUBE * climber.radius, (1 - TUBE) * climber.radius)
    flat = side_view(climber)
    wheels = (
        replace(wheel, name=f"{wheel.name}_{number}", at=(float(x), *wheel.at[1:]), section=section)
        for wheel, places in zip(flat.wheels, across, strict=True)
        for number, x in enumerate(places, 1)
    )
    return replace(flat, wheels=tuple(wheels), planar=False)


def _side_by_side(
    run: Trajectory, vehicle: Vehicle, counts: Sequence[int], across: Sequence[Array]
) -> Trajectory:
    """Return a motion with the quantities of all wheels of each axle, which share its forces."""
    columns = {}
    for name, column in run.columns.items():
        values = column.values
        if values.ndim == 2:
            values = values / counts if name in FORCES else values
            values = np.repeat(values, counts, axis=1)
        if name == "contact_x":
            values = values + np.concatenate(across)
        columns[name] = column._replace(values=values)
    return replace(run, columns=columns, wheels=tuple(wheel.name for wheel in vehicle.wheels))


def climb_scene(climbs: Sequence[Driven]) -> Scene:
    """Return the scene of climbs over one profile.

    Parameters
    ----------
    climbs : sequence of Driven
        Results of `in_space`, at least one.

    Raises
    ------
    ModelError
        If their profiles differ.
    """
    first = climbs[0]
    for each in climbs[1:]:
        if _sections(each) != _sections(first):
            raise ModelError(
                f"{each.name}: expected a climb over the profile of {first.name}, found another "
                "profile; show the results separately"
            )
    reach = max(extents(each.vehicle)[2] for each in climbs)
    runs = [run for each in climbs for run in (each.run, each.plan) if run is not None]
    places = np.concatenate([run["center_y"].ravel() for run in runs])
    room = ROOM * first.vehicle.wheels[0].radius
    left, right = float(places.min()) - room, float(places.max()) + room
    origin = np.round([0.0, (left + right) / 2, 0.0])
    top = max(z for solid in _sections(first) for _, z in solid.points)
    mesh = _solids(first, left, right, origin)
    z = mesh.vertices[:, 2] + origin[2]
    ground = Ground(mesh, (scene.layer("height", z, f"0 to {top:.4g} m", 0.0, top),))
    backdrop = _backdrop(climbs, origin, reach)
    notes = [
        "A climb is computed in a plane: the widths of ground and vehicle are only for display."
    ]
    return scene.framed(ground, actors_of(climbs, origin), origin, reach, backdrop, notes)


def _backdrop(climbs: Sequence[Driven], origin: Array, reach: float) -> scene.Backdrop:
    """Return the ground of a film: its section, and the solids around the vehicle."""
    first = climbs[0]

    def draw(ax: Axes) -> Axes:
        climb_figures.ground(_sections(first), ax)
        radius = first.vehicle.wheels[0].radius
        return climb_figures.frame_motions([each.run for each in climbs], radius, ax)

    def near(middle: Array, half: float) -> Sequence[Array]:
        y = float(middle[1] + origin[1])
        mesh = _solids(first, y - half, y + half, origin)
        return [mesh.vertices[face] for face in mesh.faces]

    return scene.Backdrop(draw, scene.SECTION, near, reach, (14.0, -25.0))


def _sections(each: Driven) -> list[Solid]:
    return [prism.section for prism in each.prisms]


def _solids(each: Driven, left: float, right: float, origin: Array) -> Mesh:
    """Return the mesh of the extruded profile between two positions along it [m]."""
    half, bottom = each.prisms[0].half_width, -ROOM * each.vehicle.wheels[0].radius
    window = (-half, half, left, right)
    return joined(*(solid_mesh(prism, window, bottom, origin) for prism in each.prisms))
