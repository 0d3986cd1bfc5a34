"""Scenes of motions over terrain: ground, vehicles and arrows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from slipfree.core.errors import ModelError
from slipfree.core.facts import SCALES
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory, stop_words
from slipfree.files.urdf.links import Robot, poses_on_map, wheel_name
from slipfree.geometry.mesh import TriangleMesh
from slipfree.geometry.regions import Region
from slipfree.models.samples import CLOSEST, FramePoses, has_friction, part_poses, wheel_poses
from slipfree.routing.traversability import extents, nodes_at, traversability
from slipfree.show import ground_drawing, style
from slipfree.show.ground_drawing import Place, Window
from slipfree.show.meshes import (
    Surface,
    extruded,
    joined,
    plate,
    rod,
    roller_axles,
    shape_mesh,
    spokes,
    surface,
)
from slipfree.show.scene import (
    BLOCKED,
    LIFT,
    PLAN_LINES,
    PLOTTED,
    RED,
    Actor,
    Arrows,
    Backdrop,
    Color,
    Layer,
    Lines,
    Scene,
    SceneBody,
    SceneGround,
    arrow_scales,
    layer,
    map_lines,
    rgb,
)
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import cut
from slipfree.terrain.solids import Prism
from slipfree.vehicle.tree import Joint, Vehicle
from slipfree.vehicle.wheel import Wheel

SIDE = 161  # maximum number of nodes of the drawn ground along an axis: 51 200 faces
MARGIN = 0.35  # margin of the drawn ground around the paths [extent of the paths]
NEXT = 3.0  # smallest margin [reach of the vehicle]
FINE = 0.125  # distance of nodes near the paths [reach of the vehicle]
SEEN = 0.1  # larger distances of wheels from the drawn ground cause a warning [wheel radius]
AROUND = 1.6  # half the width of the ground around the vehicle in a film [reach of the vehicle]
PLACE_COLOR = (0, 0, 0)  # of start, way-points and goal of a plan
CLOSEST_COLOR = (120, 0, 160)  # of the place where a body came closest to the ground
ROD, PLATE = 0.07, 0.12  # radius of rods, thickness of the platform [wheel radius]
NARROW = 0.55  # width of the platform [width of the vehicle]
TYRE = (90, 90, 90)
LARGEST = 1e9  # value in plots over time
SAME = 1e-9  # smaller differences of grounds are rounding [m]


class Driven(NamedTuple):
    """A motion over terrain with its ground and vehicle."""

    name: str
    run: Trajectory
    terrain: Bicubic
    vehicle: Vehicle
    keep_out: tuple[Region, ...] = ()  # of a plan
    places: tuple[Place, ...] = ()  # start, way-points and goal of a plan
    areas: Mapping[str, Window] = {}  # of places that are no points, by name
    plan: Trajectory | None = None  # the plan that the motion simulates, with contact points
    prisms: tuple[Prism, ...] = ()  # solids on the ground
    robot: Robot | None = None  # URDF of the vehicle; None without one
    visuals: Mapping[str, TriangleMesh] = {}  # of links of the URDF, in their frames, by name


def drive_scene(drives: Sequence[Driven], *, with_poses: bool = False) -> Scene:
    """Return the scene of motions over the ground of the first; other grounds are a ModelError.

    The ground can also have colours of the poses of the first vehicle, which take a while.
    """
    first, grid = drives[0], drives[0].terrain.grid
    reach = max(extents(drive.vehicle)[2] for drive in drives)
    window = _window(drives, grid, reach)
    x, y, z = ground_drawing.patch(grid, window, SIDE)
    if (holes := np.isnan(z)).any():
        drawn = Grid(x, y, first.terrain.elevation(x[:, None], y), holes=holes)
    else:
        drawn = Grid(x, y, z)
    ways = [np.stack([run["x"], run["y"]], axis=1) for run in _runs(drives)]
    fine = surface(drawn, first.terrain, ways, NEXT * reach, FINE * reach)
    origin = np.round([x.mean(), y.mean(), drawn.values.mean()])
    poses = [_pose_layer(drawn, first, window)] if with_poses else []
    layers = [
        each._replace(colors=np.rint(fine.interpolated(each.colors.astype(float))).astype(np.uint8))
        for each in (*_layers(drawn), *poses)
    ]
    warnings = [*_off(drives, fine, SEEN), *_others(drives)]
    notes = [_cropped(grid, fine), *_off(drives, fine, 0.0)]
    solids = [*_solid_meshes(first.prisms, window, drawn.values.min(), origin)]
    shade = fine.interpolated(ground_drawing.brightness(x, y, drawn.z).reshape(-1, 1)).ravel()
    lines = (
        *map_lines(drawn, first.terrain, window, origin, reach),
        *_closest(drives, origin, reach),
        *_plan_lines(first, window, origin, reach),
    )
    gray = np.tile(np.array(BLOCKED, np.uint8), (sum(len(each.vertices) for each in solids), 1))
    ground = SceneGround(
        joined(fine.mesh(origin), *solids),
        tuple(each._replace(colors=np.concatenate([each.colors, gray])) for each in layers),
        np.append(shade, np.ones(len(gray))),
        lines,
    )
    backdrop = _backdrop(first, window, origin, reach, solids)
    actors = []
    for k, drive in enumerate(drives):
        actors.append(_actor(drive, drive.run, drive.name, k, origin))
        if drive.plan is not None:
            name = f"{drive.name}: plan"
            actors.append(_actor(drive, drive.plan, name, k + len(drives), origin, ghost=True))
    scales, missing = arrow_scales(actors, reach)
    place = ", ".join(f"{value + 0.0:.10g}" for value in origin)  # no minus zero
    notes += [f"The origin of the scene is ({place}) m in map coordinates.", *missing]
    return Scene(
        ground, tuple(actors), origin, reach, backdrop, scales, tuple(notes), tuple(warnings)
    )


def _closest(drives: Sequence[Driven], origin: Array, reach: float) -> Iterable[Lines]:
    """Yield vertical lines where bodies came closest to the ground, if facts contain the places."""
    places = [each.run.facts[CLOSEST] for each in drives if CLOSEST in each.run.facts]
    if places:
        feet = np.array([[each.value[axis] for axis in "xyz"] for each in places]) - origin
        tops = feet + np.array([0.0, 0.0, reach])
        labels = tuple((each.words, top) for each, top in zip(places, tops, strict=True))
        legend = "bodies above the ground"
        yield Lines("closest", legend, CLOSEST_COLOR, np.stack([feet, tops], axis=1), labels)


def _plan_lines(first: Driven, window: Window, origin: Array, reach: float) -> Iterator[Lines]:
    """Yield borders of keep-out regions, and posts at start, way-points and goal, of a plan."""

    def draped(points: Array) -> Array:  # within the drawn ground
        x, y = np.clip(points.T, *np.reshape(window, (2, 2)).T[..., None])
        z = first.terrain.elevation(x, y) + LIFT * reach
        return np.asarray(np.stack([x, y, z], axis=-1) - origin)

    borders = list[Array]()
    for region in first.keep_out:
        closed = np.concatenate([region.outline, region.outline[:1]])
        corners = np.arange(len(closed))
        at = np.linspace(0, corners[-1], 20 * len(closed))
        line = draped(np.stack([np.interp(at, corners, closed[:, k]) for k in (0, 1)], axis=1))
        borders.append(np.stack([line[:-1], line[1:]], axis=1))
    if borders:
        yield Lines(PLAN_LINES[0], "regions of the plan", RED, np.concatenate(borders))
    if first.places:
        feet = draped(np.array([place[1:] for place in first.places]))
        tops = feet + np.array([0.0, 0.0, reach])
        names = (place[0] for place in first.places)
        labels = tuple(zip(names, tops, strict=True))
        yield Lines(
            PLAN_LINES[1], "of the plan", PLACE_COLOR, np.stack([feet, tops], axis=1), labels
        )


def _solid_meshes(
    prisms: Iterable[Prism], window: Window, bottom: float, origin: Array
) -> Iterator[TriangleMesh]:
    """Yield the meshes of prisms above ``bottom`` in the drawn part, relative to an origin [m]."""
    for prism in prisms:
        if found := ground_drawing.in_window(prism, window, bottom):
            corners, (right, left) = found
            place = np.array([prism.x, prism.y, prism.z]) - origin
            outline = np.insert(corners, 1, right, axis=1) @ prism.axes.T + place
            yield extruded(outline, (left - right) * prism.axes[:, 1])


def _backdrop(
    first: Driven, window: Window, origin: Array, reach: float, solids: Sequence[TriangleMesh]
) -> Backdrop:
    """Return the drawing of the ground on a map and its faces around a point."""
    terrain = first.terrain
    blocks = [mesh.vertices[face] for mesh in solids for face in mesh.faces]

    def near(middle: Array, half: float, count: int) -> Sequence[Array]:
        west, east, south, north = terrain.domain
        x, y = (
            np.clip(np.linspace(at - half, at + half, count) + start, low, high)
            for at, start, low, high in zip(
                middle, origin, (west, south), (east, north), strict=False
            )
        )
        x, y = np.meshgrid(x, y, indexing="ij")
        points = np.stack([x, y, terrain.elevation(x, y)], axis=-1) - origin
        corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
        faces = np.stack(corners, axis=2).reshape(-1, 4, 3)
        middle_x, middle_y, _ = np.moveaxis(faces.mean(axis=1) + origin, -1, 0)
        whole = ~terrain.grid.touches(terrain.grid.holes, middle_x, middle_y)
        return [*faces[whole], *blocks]

    def draw(ax: Axes) -> Axes:
        ground_drawing.solids(first.prisms, ground_drawing.muted(terrain.grid, ax, window))
        return ground_drawing.plan_marks(ax, first.keep_out, first.places, first.areas)

    return Backdrop(draw, near, AROUND * reach)


def _runs(drives: Sequence[Driven]) -> list[Trajectory]:
    return [run for drive in drives for run in (drive.run, drive.plan) if run is not None]


def _window(drives: Sequence[Driven], grid: Grid, reach: float) -> Window:
    """Return the part of the ground to draw: the surroundings of all paths, within the map."""
    x, y = (
        np.concatenate([np.append(run[name], run[f"contact_{name}"]) for run in _runs(drives)])
        for name in "xy"
    )
    around = ground_drawing.about(x, y, grid, MARGIN)
    path = float(x.min()), float(x.max()), float(y.min()), float(y.max())
    near = ground_drawing.padded(path, (NEXT * reach, NEXT * reach), grid)
    (west, south), (east, north) = np.minimum(around, near)[::2], np.maximum(around, near)[1::2]
    return float(west), float(east), float(south), float(north)


def _layers(drawn: Grid) -> Iterator[Layer]:
    """Yield the colourings of the ground by its heights."""
    low, high = float(drawn.values.min()), float(drawn.values.max())
    yield layer("height", drawn.z.ravel(), f"{low:.4g} to {high:.4g} m", low, high)
    slope = np.degrees(np.arctan(np.hypot(*np.gradient(drawn.z, *drawn.spacing)))).ravel()
    yield layer("slope", slope, f"0 to {slope.max():.3g} degrees", 0.0, float(slope.max()))


def _pose_layer(drawn: Grid, drive: Driven, window: Window) -> Layer:
    """Return the colouring by the poses of a vehicle, grey where no heading is possible."""
    terrain, reach = drive.terrain, extents(drive.vehicle)[2]
    wide_x, wide_y = (2 * reach + 3 * cell for cell in terrain.grid.spacing)
    near = ground_drawing.padded(window, (wide_x, wide_y), terrain.grid)
    part = Bicubic(cut(terrain.grid, near), terrain.center, terrain.mu)
    layers = traversability(part, drive.vehicle, keep_out=drive.keep_out)
    places = np.stack(np.meshgrid(drawn.x, drawn.y, indexing="ij"), axis=-1).reshape(-1, 2)
    costs = layers.cost[:, *nodes_at(layers, places)]
    least = costs.min(axis=0)
    free = np.isfinite(least)
    top = float(np.percentile(least[free], 99)) if free.any() else 1.0
    words = f"cost per metre of path in the best direction, 1 to {top:.3g}; grey: blocked"
    colored = layer("traversability", np.where(free, least, 1.0), words, 1.0, top)
    colored.colors[~free] = BLOCKED
    return colored


def _actor(
    drive: Driven, run: Trajectory, name: str, k: int, origin: Array, ghost: bool = False
) -> Actor:
    vehicle, color = drive.vehicle, rgb(style.PALETTE[k % len(style.PALETTE)])
    contacts = np.stack([run[f"contact_{axis}"] for axis in "xyz"], axis=-1)
    parts, wheels = part_poses(vehicle, run), wheel_poses(vehicle, run)
    bodies = [*_part_bodies(vehicle, parts, wheels, color), *_wheels(vehicle, wheels, color)]
    if drive.robot is not None and drive.visuals and not ghost:
        bodies = [*_with_visuals(bodies, drive, drive.robot, color)]
    arrows = [] if ghost else _arrows(run, drive, contacts, wheels.rotations[..., 0])
    values = {} if ghost else _plotted(run)
    return Actor(
        name,
        color,
        run.t,
        tuple(b._replace(origins=b.origins - origin) for b in bodies),
        contacts - origin,
        tuple(a._replace(starts=a.starts - origin) for a in arrows),
        ghost,
        stop_words(run),
        run.wheels,
        values,
    )


def _plotted(run: Trajectory) -> dict[str, Array]:
    """Return the quantities of a motion for the plots of a page, in the units of the plots."""
    values = {name: run[name] for name in run}
    if "slip_along" in run:
        values["slip"] = np.hypot(run["slip_along"], run["slip_across"])
    if "utilisation" in run:
        del values["friction_needed" if has_friction(run) else "utilisation"]
    known = (each for each in PLOTTED if each.name in values)
    # infinite values cannot be interpolated
    return {
        each.name: np.minimum(SCALES.get(each.unit, 1.0) * values[each.name], LARGEST)
        for each in known
    }


def _part_bodies(
    vehicle: Vehicle, parts: FramePoses, wheels: FramePoses, color: Color
) -> Iterable[SceneBody]:
    """Yield the bodies of platform and joints: plates, and rods to their joints and wheels."""
    radius = max(wheel.radius for wheel in vehicle.wheels)
    names = ["platform", *(joint.name for joint in vehicle.joints)]
    spans = _plate_spans(vehicle, parts, wheels)
    for number, name in enumerate(names):
        origins, rotations = parts.origins[:, number], parts.rotations[:, number]
        carried: list[Joint | Wheel] = [*vehicle.joints, *vehicle.wheels]
        ends = [np.array(each.at) for each in carried if each.parent == name]
        for joint in vehicle.joints:
            if joint.parent == name and joint.motion == "slide":
                away = parts.origins[:, names.index(joint.name)] - origins
                places = np.einsum("nji,nj->ni", rotations, away)
                ends += [places.min(axis=0), places.max(axis=0)]
        meshes = [
            rod((0.0, 0.0, 0.0), end, ROD * radius)
            for end in ends
            if np.linalg.norm(end) > ROD * radius
        ]
        shapes = [shape for part, shape in vehicle.shapes if part == name]
        meshes += map(shape_mesh, shapes)
        if name in spans and not shapes:
            away = wheels.origins[0] - origins[0]
            half = NARROW * float(np.abs((away @ rotations[0])[:, 0]).max())
            meshes.append(plate(half, *spans[name], PLATE * radius))
        if meshes:
            yield SceneBody(name, ((joined(*meshes), color),), origins, rotations)


def _plate_spans(
    vehicle: Vehicle, parts: FramePoses, wheels: FramePoses
) -> dict[str, tuple[float, float]]:
    """Return the rear and the front end of the plates of an articulated vehicle, by part [m].

    The platform has a plate, and each joint that carries wheels on both sides, all ahead of it or
    all behind it: one half of a frame steered in the middle.
    """
    base = parts.rotations[0, 0]
    places, joints = ((each.origins[0] - parts.origins[0, 0]) @ base for each in (wheels, parts))
    radius = max(wheel.radius for wheel in vehicle.wheels)
    parents = {joint.name: joint.parent for joint in vehicle.joints}
    halves = dict[tuple[bool, ...], int]()
    for number, joint in enumerate(vehicle.joints, 1):
        carried = tuple(_is_carried(joint.name, each.parent, parents) for each in vehicle.wheels)
        x, y, _ = places[list(carried)].T
        away = y - joints[number, 1]
        if x.size and x.min() < 0 < x.max() and max(away.min(), -away.max()) > radius:
            halves[carried] = number  # of several joints in a row, the last one
    own = ~np.any([*halves, (False,) * len(places)], axis=0)
    ends = np.append(places[own, 1], joints[list(halves.values()), 1])
    spans = {"platform": (float(ends.min()), float(ends.max()))}
    for carried, number in halves.items():
        away = places[list(carried), 1] - joints[number, 1]
        span = float(away.min(initial=0)), float(away.max(initial=0))
        spans[vehicle.joints[number - 1].name] = span
    return spans


def _is_carried(part: str, by: str, parents: Mapping[str, str]) -> bool:
    """Return whether the part ``by`` is ``part``, or moves with it."""
    while by != part and by in parents:
        by = parents[by]
    return by == part


def _wheels(vehicle: Vehicle, wheels: FramePoses, color: Color) -> Iterable[SceneBody]:
    for k, wheel in enumerate(vehicle.wheels):
        looks = [(wheel.section.mesh(), TYRE), (spokes(wheel.radius * 0.97), color)]
        if wheel.rollers:
            looks.append((roller_axles(wheel.radius, wheel.rollers), color))
        yield SceneBody(wheel.name, tuple(looks), wheels.origins[:, k], wheels.rotations[:, k])


def _with_visuals(
    bodies: Iterable[SceneBody], drive: Driven, robot: Robot, color: Color
) -> Iterable[SceneBody]:
    """Yield bodies that no mesh of the URDF replaces, without that of the platform, and links."""
    replaced = {
        wheel_name(joint.name)
        for joint in robot.tree.joints.values()
        if joint.child in drive.visuals
    }
    names = {wheel.name for wheel in drive.vehicle.wheels} - replaced
    for body in bodies:
        if body.name == "platform" or body.name in names:
            yield body._replace(meshes=body.meshes if body.name in names else ())
    for link in poses_on_map(drive.run, drive.vehicle, robot):
        if mesh := drive.visuals.get(link.child):
            yield SceneBody(link.child, ((mesh, color),), link.origins, link.rotation.as_matrix())


def _arrows(run: Trajectory, drive: Driven, contacts: Array, axles: Array) -> list[Arrows]:
    """Return arrows of slip and force in axes of the contact: along, across, normal."""
    normals = ground_normals(drive.terrain, contacts)
    height = drive.terrain.elevation(contacts[..., 0], contacts[..., 1])
    nearest = np.abs(contacts[..., 2] - height)
    for prism in drive.prisms:
        away, outward = prism.distance(contacts)
        normals = np.where((np.abs(away) < nearest)[..., None], outward, normals)
        nearest = np.minimum(nearest, np.abs(away))
    along = np.cross(normals, axles)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    frame = {"along": along, "across": np.cross(along, normals), "normal": normals}
    arrows = []
    for name, directions in (("slip", ("along", "across")), ("force", tuple(frame))):
        if {f"{name}_{each}" for each in directions} <= run.columns.keys():
            vectors = sum(run[f"{name}_{each}"][..., None] * frame[each] for each in directions)
            arrows.append(Arrows(name, contacts, np.asarray(vectors)))
    return arrows


def ground_normals(terrain: Bicubic, points: Array) -> Array:
    """Return the upward unit normals of a ground at map points; both have the shape (..., 3)."""
    dz_dx, dz_dy = ground_drawing.gradient(terrain, points[..., 0], points[..., 1])
    normals = np.stack([-dz_dx, -dz_dy, np.ones_like(dz_dx)], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _cropped(grid: Grid, fine: Surface) -> str:
    (h_x, h_y), (d_x, d_y) = grid.spacing, fine.grid.spacing
    sizes = [f"{np.ptp(each.x):.4g} x {np.ptp(each.y):.4g} m" for each in (fine.grid, grid)]
    near = f" ({fine.spacing:.3g} m near the paths)" if fine.spacing < max(d_x, d_y) else ""
    return (
        f"Drawn ground: {sizes[0]} of {sizes[1]}, node spacing {d_x:.3g} x {d_y:.3g} m{near}; "
        f"node spacing of the map {h_x:.3g} x {h_y:.3g} m."
    )


def _off(drives: Sequence[Driven], fine: Surface, least: float) -> Iterable[str]:
    """Yield a note on the vertical distance of the drawn ground from the contact points."""
    off = max(
        float(np.abs(fine.height(x, y) - drive.terrain.elevation(x, y)).max())
        for drive in drives
        for x, y in [(drive.run["contact_x"], drive.run["contact_y"])]
    )
    radius = min(wheel.radius for drive in drives for wheel in drive.vehicle.wheels)
    if off >= least * radius:
        sunk = ": wheels may appear below or above the ground" if off >= SEEN * radius else ""
        yield f"Drawn ground and contact points are at most {off:.2g} m apart{sunk}."


def _others(drives: Sequence[Driven]) -> Iterable[str]:
    first = drives[0]
    west, east, south, north = first.terrain.domain
    for drive in drives[1:]:
        x, y = drive.run["contact_x"], drive.run["contact_y"]
        if x.min() < west or x.max() > east or y.min() < south or y.max() > north:
            raise ModelError(
                f"{drive.name}: expected a motion on the ground of {first.name}, found one that "
                "leaves it; show the results separately, or the result on the larger ground first"
            )
        apart = np.abs(first.terrain.elevation(x, y) - drive.terrain.elevation(x, y)).max()
        if apart > min(wheel.radius for wheel in drive.vehicle.wheels):
            raise ModelError(
                f"{drive.name}: expected a ground that differs from that of {first.name} by at "
                f"most the radius of a wheel, found {apart:.3g} m along the motion; show the "
                "results separately"
            )
        if apart > SAME:
            yield (
                f"The drawn ground is that of {first.name}; the ground of "
                f"{drive.name} differs from it by up to {apart:.3g} m along that motion."
            )
