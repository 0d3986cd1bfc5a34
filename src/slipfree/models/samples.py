"""Quantities at the samples of a motion: poses, slip, rocking, and the ending over obstacles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np
import scipy  # scipy.spatial is imported when it is used

from slipfree.contact.closure import ContactFrame, without_rolling
from slipfree.contact.nearest_points import Nearest, NearestPoints, frame_of
from slipfree.core.errors import ModelError
from slipfree.core.facts import Fact
from slipfree.core.records import Array, Mask, pack
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.frame import Pose, platform
from slipfree.models.base import State, carriers, joint_rates, spins
from slipfree.models.limits import UPRIGHT
from slipfree.terrain.base import Terrain
from slipfree.terrain.solids import HEIGHT_TOLERANCE, Prism
from slipfree.vehicle.tree import Vehicle, Wheel

CLOSEST = "clearance_body_place"  # fact: the body that comes closest to the ground, and the place
POSITION = ("x", "y", "z", "heading", "roll", "pitch")
Ending = Literal["climbs", "passes", "moves along", "stalls", "tips over", "unfinished"]
TOP_SHARE = 0.8  # height of a wheel's centre above the top of a solid that it has climbed [radii]
STALL_TIME = 1.0  # final interval in which a stalled vehicle does not advance [s]
STALL_DISTANCE = 5e-3  # largest displacement of a stalled vehicle in this interval [m]
STALL_SHARE = 0.05  # or, if larger, this share of the distance that the rims travel [1]


class FramePoses(NamedTuple):
    """Poses of k frames at n samples, in map coordinates.

    Origins (n, k, 3) [m], and rotations (n, k, 3, 3) whose columns are the frames' axes.
    """

    origins: Array
    rotations: Array


def part_poses(vehicle: Vehicle, run: Trajectory) -> FramePoses:
    """Return the poses of the platform and of the parts of all joints, in this order.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    run : Trajectory
        Its motion, with the pose of the platform and the value of every coordinate.

    Raises
    ------
    ModelError
        If the motion lacks the platform's pose or a coordinate.
    """
    return _frame_poses(vehicle, run, lambda *at: [*vehicle.parts(*at).values()])


def nearest_points(vehicle: Vehicle, terrain: Terrain, run: Trajectory) -> Nearest | None:
    """Return the nearest points of bodies and ground at the samples; None without shapes.

    Parameters and errors are those of `part_poses`, and the ground.
    """
    if not vehicle.shapes:
        return None

    def frames(place: Pose, values: Mapping[str, ca.SX]) -> Sequence[Pose]:
        parts = vehicle.parts(place, values)
        return tuple(frame_of(shape, parts[name]) for name, shape in vehicle.shapes)

    origins, rotations = _frame_poses(vehicle, run, frames)
    columns = rotations.transpose(0, 1, 3, 2).reshape(*origins.shape[:2], 9)
    placed = np.concatenate([origins - np.array(terrain.origin), columns], axis=-1)
    return NearestPoints(terrain, vehicle.shapes)(placed.reshape(run.t.size, -1).T)


def closest_fact(vehicle: Vehicle, terrain: Terrain, run: Trajectory) -> dict[str, Fact]:
    """Return the body that comes closest to the ground in a motion, the place and the time."""
    near = nearest_points(vehicle, terrain, run)
    if near is None:
        return {}
    k = int(near.gap.argmin())
    body = NearestPoints(terrain, vehicle.shapes).body_of(int(near.shape[k]))
    x, y, z = near.foot[k].tolist()
    when = f", t = {run.t[k]:.4g} s" if run.t.size > 1 else ""
    words = f"{body} above ({x:.3f}, {y:.3f}) m{when}"
    part = vehicle.shapes[int(near.shape[k])][0]
    value = {"body": part, "x": x, "y": y, "z": z, "t": float(run.t[k])}
    return {
        "clearance_body_least": Fact(float(near.gap[k]), "m"),
        CLOSEST: Fact(value, words=words),
    }


def wheel_poses(vehicle: Vehicle, run: Trajectory) -> FramePoses:
    """Return the poses of the wheels, rotated about their axles (x axes).

    Parameters and errors are those of `part_poses`; the motion must also have the wheel angles.
    """
    poses = _frame_poses(vehicle, run, vehicle.carriers)
    # forward about the axle, which points right, by minus the angle
    angles = -run["wheel_angle"].reshape(-1, 1)
    turned = scipy.spatial.transform.Rotation.from_euler("x", angles).as_matrix()
    return poses._replace(rotations=poses.rotations @ turned.reshape(poses.rotations.shape))


def _frame_poses(
    vehicle: Vehicle, run: Trajectory, frames: Callable[[Pose, Mapping[str, ca.SX]], Sequence[Pose]]
) -> FramePoses:
    """Return the poses of frames over a motion."""
    names = (*POSITION, *(c.name for c in vehicle.coordinates))
    q = ca.SX.sym("q", len(names))
    place, values = ca.vertsplit(q)[:6], dict(zip(names[6:], ca.vertsplit(q)[6:], strict=True))
    poses = frames(platform(*place), values)
    run = run.in_frame("paper")
    columns = np.column_stack([run[name] for name in names]).T
    out = [
        ca.horzcat(*(pose.origin for pose in poses)),
        ca.horzcat(*(ca.vec(pose.rotation) for pose in poses)),
    ]
    function = ca.Function("poses", [q], [ca.vec(each) for each in out])
    origins, rotations = (np.array(each).T for each in function.map(run.t.size)(columns))
    shape = run.t.size, len(poses)
    by_column = rotations.reshape(*shape, 3, 3)
    return FramePoses(origins.reshape(*shape, 3), by_column.transpose(0, 1, 3, 2))


def slip_velocity(
    wheel: Wheel, carrier: Pose, contact: ContactFrame, q: ca.SX, q_dot: ca.SX, wheel_rate: ca.SX
) -> ca.SX:
    """Return the velocity (3, 1) over the ground of a wheel's material point at its contact [m/s].

    ``carrier`` is the pose of the part that carries the wheel, at the wheel's centre, as a function
    of the vehicle's coordinates ``q`` with the rates ``q_dot``; ``wheel_rate`` is positive for
    forward motion. The normal component vanishes if the wheel keeps contact; a wheel with rollers
    has no velocity across their axles.
    """
    twist = carrier.twist(q, q_dot)
    # a positive rate drives forward, hence the minus: the axle points to the right
    omega = twist.omega - wheel_rate * carrier.rotation[:, 0]  # wheel frame R Rx(-theta)
    slip = twist.v + ca.cross(omega, contact.point - carrier.origin)
    return without_rolling(wheel, contact, slip)


def slip_velocities(state: State, contacts: Sequence[ContactFrame]) -> tuple[ca.SX, ...]:
    """Return the slip velocities (3, 1) of all wheels of a vehicle, in fixed axes [m/s]."""
    moving = coordinates(state)
    columns = state.vehicle.wheels, carriers(state), contacts, spins(state)
    return tuple(
        slip_velocity(wheel, pose, contact, *moving, spin)
        for wheel, pose, contact, spin in zip(*columns, strict=True)
    )


def absolute_spins(state: State) -> tuple[ca.SX, ...]:
    """Return the angular velocities of the wheels about their axles, relative to fixed axes.

    They are positive for forward motion. [rad/s]
    """
    moving = coordinates(state)
    return tuple(
        rate - ca.dot(pose.rotation[:, 0], pose.twist(*moving).omega)
        for pose, rate in zip(carriers(state), spins(state), strict=True)
    )


def coordinates(state: State) -> tuple[ca.SX, ca.SX]:
    """Return the coordinates of a vehicle and their rates, as columns of equal order."""
    rates, joints = state.rates, joint_rates(state)
    inclination = rates.z, rates.roll, rates.pitch
    q_dot = pack((rates.x, rates.y, rates.heading, joints, *inclination, rates.suspension))
    return pack((*state.x, *state.position[:4])), q_dot


def measured_slip(vehicle: Vehicle, run: Trajectory) -> Array:
    """Return the slip velocities of a motion, from finite differences of its poses.

    The material point that touches the ground at a sample moves with the wheel through the
    neighbouring samples; its velocity is a difference quotient over five samples. The result is
    independent of the model's rates. It includes the motion that rollers permit.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    run : Trajectory
        Motion of the vehicle with at least five equally spaced samples.

    Returns
    -------
    ndarray, shape (n - 4, n_wheels, 3)
        Slip velocities in fixed axes, without the first two and the last two samples. [m/s]

    Raises
    ------
    ModelError
        If there are fewer than five samples, if they are not equally spaced, or if the motion lacks
        the poses or contact points of the wheels.
    """
    steps = np.diff(run.t)
    if steps.size < 4:
        raise ModelError(
            f"measured_slip: expected at least five samples, found {run.t.size}; sample the motion "
            "at more times"
        )
    if not np.allclose(steps, steps[0], rtol=1e-6, atol=0):
        raise ModelError(
            f"measured_slip: expected equally spaced samples, found steps of {steps.min():.4g} to "
            f"{steps.max():.4g} s; sample the motion at constant steps"
        )
    centers, rotations = wheel_poses(vehicle, run)
    contacts = np.stack([run[f"contact_{axis}"] for axis in "xyz"], -1)
    places = np.einsum("nwji,nwj->nwi", rotations, contacts - centers)[2:-2]
    n = run.t.size

    def carried(k: int) -> Array:
        """Return the points of the wheels that touch at each sample, k samples later."""
        span = slice(2 + k, n - 2 + k)
        return np.asarray(centers[span] + np.einsum("nwij,nwj->nwi", rotations[span], places))

    # central difference of fourth order: its error is far below the slip of a rolling wheel
    differences = carried(-2) - 8 * carried(-1) + 8 * carried(1) - carried(2)
    return np.asarray(differences / (12 * steps[0]))


class LoadChange(NamedTuple):
    """Change of the wheel that carries the least load, at a time between two samples [s]."""

    t: float
    before: str
    after: str


def has_friction(run: Trajectory) -> bool:
    """Return whether the ground has friction; else ``utilisation`` is the coefficient needed."""
    return "ground_friction" in run.attributes or not np.array_equal(
        run["utilisation"], run["friction_needed"]
    )


def has_pressed_wheels(run: Trajectory) -> bool:
    """Return whether a motion was computed with pressed wheels."""
    return "depth" in run.columns


def rocks(run: Trajectory) -> list[LoadChange]:
    """Return the changes of the wheel with the least load in a motion with pressed wheels.

    At each change the vehicle rocks from one set of supporting wheels to another, which may take
    only a few hundredths of a second.
    """
    loads, changes = run["load_share"], list[LoadChange]()
    lightest = loads.argmin(axis=1)
    for k in np.flatnonzero(np.diff(lightest)).tolist():
        before, after = lightest[k : k + 2]
        more, less = loads[k : k + 2, before] - loads[k : k + 2, after]
        share = more / (more - less) if more != less else 0.0
        t = run.t[k] + share * (run.t[k + 1] - run.t[k])
        changes.append(LoadChange(float(t), run.wheels[before], run.wheels[after]))
    return changes


def lightest_wheel(run: Trajectory, sample: int) -> tuple[str, float, float]:
    """Return the name, load share and depth of the wheel with the least load at a sample.

    The load share is the load times the number of wheels, divided by the weight [1]. The depth is
    negative in the air [m].
    """
    loads = run["load_share"][sample]
    k = int(loads.argmin())
    return run.wheels[k], float(loads[k]), float(run["depth"][sample, k])


class ObstacleEnding(NamedTuple):
    """Ending of a motion over solids, and its explanation.

    It is ``"unfinished"`` if the vehicle is before the obstacles or on them, and still advances;
    ``t`` is the time at which the last wheel reaches the top or passes its front, or the motion
    ends [s].
    """

    name: Ending
    t: float
    words: str

    def __str__(self) -> str:
        """Return the name and the reason."""
        return f"{self.name}: {self.words}"


def obstacle_ending(
    run: Trajectory, vehicle: Vehicle, prisms: Sequence[Prism]
) -> ObstacleEnding | None:
    """Return the ending of a motion over solids; None without solids.

    Obstacles are the solids on which the vehicle does not stand at the start. The vehicle

    - *tips over* if the motion ends at the limit of a body's inclination,
    - *climbs* if, after the first contact with an obstacle, each wheel reaches the highest top of
      the obstacles that a wheel touches; later it may leave it,
    - *passes* if each wheel crosses the vertical plane of this top's front edge, some beside the
      obstacle, or of the highest obstacle's if none is touched,
    - *stalls* if the platform is displaced by less than 5 mm in the last second, or by less than
      5 % of the distance that the rims travel,
    - *moves along* an obstacle that it touches in the last second if only the displacement parallel
      to the obstacle's front is not as small.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.dynamics` on `slipfree.Solids`.
    vehicle : Vehicle
        Vehicle of the motion.
    prisms : sequence of Prism
        Solids of the ground.

    Examples
    --------
    A four-wheeler drives over a block of 40 mm.

    >>> import numpy as np
    >>> from slipfree import Analytic, Solids, catalog, dynamics, settle, simulate
    >>> from slipfree.terrain.solids import kerb, placed
    >>> vehicle, prisms = catalog.rigid_skid_steer(), placed(kerb(0.04, 0.3), y=0.5)
    >>> model = dynamics(vehicle, Solids(Analytic(lambda x, y: 0 * x, mu=0.8), prisms))
    >>> inputs = {label.full: 3.0 for label in model.labels.u.wheels}
    >>> run = simulate(model, settle(model), model.inputs(**inputs), np.linspace(0, 3, 61))
    >>> print(obstacle_ending(run, vehicle, prisms).name)
    climbs
    """
    if not prisms:
        return None
    end = float(run.t[-1])
    if run.stop is not None and run.stop.name.endswith(UPRIGHT):
        return ObstacleEnding("tips over", end, f"at t = {end:.3g} s {run.stop.words}")
    loads = (run[f"solid_load_{k}"] > 0 for k in range(1, len(prisms) + 1))
    obstacles = [  # all wheels stand on a floor at the start
        (prism, np.asarray(load.any(axis=1)))
        for prism, load in zip(prisms, loads, strict=True)
        if not load[0].all()
    ]
    touched = [(prism, met) for prism, met in obstacles if met.any()]
    highest = max((prism for prism, _ in touched or obstacles), key=_top, default=None)
    if highest is None:
        return ObstacleEnding("unfinished", end, f"there is no obstacle{_stop_words(run)}")
    met = np.cumsum(np.any([met for _, met in obstacles], axis=0)) > 0
    up = is_on_top(run, vehicle, _top(highest)) & met[:, None]
    if up.any(axis=0).all():
        t = _last_time(run, up)
        words = f"by t = {t:.3g} s every wheel had reached the top, z = {_top(highest):.3g} m"
        return ObstacleEnding("climbs", t, words)
    count = f"{up.any(axis=0).sum()} of {len(vehicle.wheels)} wheels had reached the top"
    count = f"{count}, z = {_top(highest):.3g} m" if touched else "no wheel touched an obstacle"
    # whether each wheel's centre is past the front edge of the top, shape (n, n_wheels)
    level = _top(highest) - highest.z - HEIGHT_TOLERANCE
    front = min(x for x, z in highest.section.points if z > level)
    forward, _, _ = highest.axes.T
    x, y = run["center_x"] - highest.x, run["center_y"] - highest.y
    past = np.asarray(forward[0] * x + forward[1] * y > front)
    if past.any(axis=0).all() and not past[0].all():
        t = _last_time(run, past)
        words = f"by t = {t:.3g} s every wheel had crossed the line of the front edge; {count}"
        return ObstacleEnding("passes", t, words)
    if not touched:
        return ObstacleEnding("unfinished", end, f"{count}{_stop_words(run)}")
    is_final = run.t > end - STALL_TIME
    name = _final_motion(run, vehicle, [each for each, met in touched if met[is_final].any()])
    return ObstacleEnding(name, end, f"by t = {end:.3g} s {count}{_stop_words(run)}")


def _top(prism: Prism) -> float:
    """Return the height of the top of a prism [m]."""
    return prism.z + max(z for _, z in prism.section.points)


def is_on_top(run: Trajectory, vehicle: Vehicle, top: float) -> Mask:
    """Return whether each wheel is as high as on a level top [m], at each sample, (n, n_wheels).

    Its centre may be 0.2 radii lower, but not lower than half-way from its height at the start.
    """
    radii = np.array([wheel.radius for wheel in vehicle.wheels])
    rise = top + radii - run["center_z"][0]
    below = np.minimum((1 - TOP_SHARE) * radii, np.where(rise > 0, rise / 2, np.inf))
    return np.asarray(run["center_z"] > top + radii - below)


def _last_time(run: Trajectory, reached: Mask) -> float:
    """Return the time at which the last wheel first reaches something, from (n, n_wheels) [s]."""
    return float(run.t[reached.argmax(axis=0).max()])


def _final_motion(run: Trajectory, vehicle: Vehicle, touched: Sequence[Prism]) -> Ending:
    """Return the ending by the motion in the last second, in which obstacles are touched."""
    since = run.t[-1] - STALL_TIME
    if since < run.t[0]:
        return "unfinished"
    away = np.array([run[axis][-1] - np.interp(since, run.t, run[axis]) for axis in "xyz"])
    rims = np.abs(run["wheel_rate"]) @ [w.radius for w in vehicle.wheels] / len(vehicle.wheels)
    times = np.append(since, run.t[run.t > since])
    travel = np.trapezoid(np.interp(times, run.t, rims), times)
    small = max(STALL_DISTANCE, STALL_SHARE * travel)
    if np.linalg.norm(away) < small:
        return "stalls"
    advances = [np.linalg.norm((away @ prism.axes)[[0, 2]]) for prism in touched]
    return "moves along" if min(advances, default=np.inf) < small else "unfinished"


def _stop_words(run: Trajectory) -> str:
    return f"; {run.stop.words}" if run.stop is not None else ""
