"""Force balance of a vehicle in the plane of the ground, for many motions at once.

Unknowns at each instant are the velocity of the centre of mass in the vehicle's axes, ahead and to
the left, and the turning rate. Per unit of mass::

    dv/dt + omega x v = sum F_i + g_t,    k^2 domega/dt = sum r_i x F_i,
    F_i = -mu N_i s_i / sqrt(|s_i|^2 + (mu / K)^2),    s_i = v + omega x r_i - u_i d_i,

with the slip ``s_i``, load ``N_i`` and rim speed ``u_i`` of wheel i, the friction ``mu``, the slip
stiffness ``K`` and the radius of gyration ``k``. Small slip needs the force ``K N s``; large slip
has the friction ``mu N``. Without ``dv/dt`` the model is quasi-static, and then, at a small ``mu /
K``, one of Coulomb friction; on level ground at a large ``mu / K``, the slip is least. Loads are
those of a plane, by least squares if there are more than three wheels.

Each step is one of the backward differentiation formula of second order, with the secant of the
friction law at the extrapolated velocity; the first steps, and those without acceleration, are of
the implicit Euler method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import ceil
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, ComplexArray, Indices
from slipfree.geometry.frame import Vector, elements, unit_vector
from slipfree.vehicle.sections import Disc, Omni, Section, Sphere, Torus
from slipfree.vehicle.tree import EARTH_GRAVITY, Vehicle, Wheel, body_inertia, wheel_inertia

MAX_STEP = 0.02  # longest step of the integration [s]
RELAXATION, RELAXING_STEPS = 0.5, 20  # steps to the steady motion at the first rates: duration [s]
ITERATIONS = 6  # of the secant in a step without inertia
LEAST_SHARE = 0.02  # smallest load of a wheel, over the weight of the vehicle [1]
MIN_COSINE = 0.55  # of slopes


class Chassis(NamedTuple):
    """Wheels of a vehicle at r rows of logs; one row if no joint moves.

    Complex numbers are ahead + i left, relative to the platform.
    """

    place: ComplexArray  # shape (w, r): wheel centres [m]
    direction: ComplexArray  # shape (w, r): of rolling
    free: ComplexArray  # shape (w, r): direction without friction, of rollers; 0 for none
    signal: Indices  # shape (w,): index of the input that drives each wheel
    grip: Array  # shape (w,): factor of the friction, zero for wheels that swivel [1]
    lift: Array  # shape (w, s): derivatives of wheel heights by s joints of the suspension

    def at(self, rows: Indices) -> Chassis:
        """Return the wheels at some rows."""
        if self.place.shape[1] == 1:
            return self
        place, direction, free = (each[:, rows] for each in self[:3])
        return Chassis(place, direction, free, self.signal, self.grip, self.lift)


class Constants(NamedTuple):
    """Constants of m sets and n motions; arrays of shape (m, n), or with ones in their place."""

    radius: Array  # shape (w, m, 1): rolling radius, or factor of the speed of a side [m or 1]
    track: Array  # factor of all lateral distances [1]
    center: ComplexArray  # centre of mass [m]
    stiffness: Array  # slip stiffness K [s/m]
    gyration: Array  # square of the radius of gyration k^2, moment of inertia over mass [m^2]
    friction: Array  # [1]
    rolling: Array  # factor of all radii on a surface [1]
    anisotropy: Array  # friction across over that along the wheels [1]
    turn_slope: Array  # exponent of the influence of the slope on differences of rim speeds [1]
    length: Array | float = 1.0  # factor of all longitudinal distances [1]
    inertia: float = 1.0  # factor of all accelerations: 0 for quasi-statics [1]
    gravity: float = EARTH_GRAVITY  # [m/s^2]

    def take(self, count: int) -> Constants:
        """Return the constants of the first motions."""

        def part(each: Any) -> Any:
            return each if np.ndim(each) < 2 or each.shape[-1] == 1 else each[..., :count]

        return Constants(*map(part, self))


# (number of the sample, velocity and turning rate) -> sines of the nose-up and left-up angles
Tilt = Callable[[int, ComplexArray, Array], tuple[Array, Array]]


def simulate(
    chassis: Chassis,
    constants: Constants,
    signals: Array,
    rows: Indices,
    dt: float,
    tilt: Tilt | None = None,
    lengths: Indices | None = None,
    coarse: int = 0,
) -> tuple[ComplexArray, Array]:
    """Return velocities of the platform's centre on the map, and turning rates, at samples.

    Parameters
    ----------
    chassis : Chassis
        Wheels.
    constants : Constants
        Constants of m sets.
    signals : array, shape (q, m or 1, r)
        Inputs at the rows of logs: rates of wheels or speeds of sides, linear between rows.
    rows : array of int, shape (k, n)
        Row of each sample of n motions. A motion begins in steady motion at the first row.
    dt : float
        Time between samples. [s]
    tilt : callable, optional
        Slopes under the vehicles, which is called once for each sample in order; by default the
        ground is level.
    lengths : array of int, shape (n,), optional
        Numbers of samples of the motions, in descending order; by default k.
    coarse : int
        Number of first samples between which there is a single step.

    Returns
    -------
    velocity : array of complex, shape (k, m, n)
        Ahead and to the left; zero after the end of a motion. [m/s]
    turning : array, shape (k, m, n)
        Turning rate. [rad/s]
    """
    count, n = rows.shape
    shape = constants.radius.shape[1], n
    velocity, turning = np.zeros((count, *shape), complex), np.zeros((count, *shape))
    state = np.zeros((3, *shape))
    before_state, last = None, 0.0  # state before the last step, and its length
    level = np.zeros((1, 1))
    here = _WheelForces(chassis.at(rows[0]), constants)
    rims = signals[:, :, rows[0]]
    slope = level, level
    for k in range(count):
        if k and lengths is not None and n != (n := int(np.searchsorted(-lengths, -k))):
            state = state[..., :n]
            before_state = None if before_state is None else before_state[..., :n]
            constants, rims = constants.take(n), rims[..., :n]
            slope = slope[0][..., :n], slope[1][..., :n]
            here = _WheelForces(chassis.at(rows[k, :n]), constants)
        before, rims = rims, signals[:, :, rows[k, :n]]
        if chassis.place.shape[1] > 1:
            here = _WheelForces(chassis.at(rows[k, :n]), constants)
        if k == 0:
            if tilt is not None:
                slope = tilt(0, velocity[0], turning[0])
            driven = here.speeds(rims, slope[0])
            state[0] += driven.mean(axis=0)
            for _ in range(RELAXING_STEPS):
                state = here.step(state, state, driven, slope, RELAXATION)
        else:
            substeps = 1 if k < coarse else ceil(dt / MAX_STEP)
            h = dt / substeps
            for j in range(1, substeps + 1):
                share = j / substeps
                driven = here.speeds(before + share * (rims - before), slope[0])
                if not constants.inertia:
                    for _ in range(ITERATIONS):
                        state = here.step(state, state, driven, slope, h)
                    continue
                base, guess, length = state, state, h
                if before_state is not None and last == h:
                    base, guess = (4 * state - before_state) / 3, 2 * state - before_state
                    length = 2 / 3 * h
                before_state, last = state, h
                state = here.step(base, guess, driven, slope, length)
        v = state[0] + 1j * state[1] - 1j * state[2] * constants.center
        velocity[k, :, :n], turning[k, :, :n] = v, state[2]
        if tilt is not None:
            slope = tilt(k, v, state[2])
            # speeds are along the slope, places on the map
            along, across = (np.sqrt(1 - sine**2) for sine in slope)
            velocity[k, :, :n] = v.real * along + 1j * v.imag * across
    return velocity, turning


class _WheelForces:
    """Wheels relative to the centre of mass, with their shares of the load."""

    def __init__(self, chassis: Chassis, constants: Constants) -> None:
        c = constants
        place, direction, free = (each[:, None] for each in chassis[:3])
        x, y = c.length * place.real - c.center.real, c.track * place.imag - c.center.imag
        self.x, self.y, self.constants, self.signal = x, y, c, chassis.signal
        # least squares: shares with the sum one and no moments, and no work of the suspension
        sums = np.broadcast_arrays(np.ones_like(x), x, y, *chassis.lift.T[..., None, None])
        rows = np.stack(sums, axis=-1)
        normal = np.einsum("wmni,wmnj->mnij", rows, rows)
        normal += 1e-9 * np.eye(len(sums))  # wheels in one line
        right = np.zeros((*normal.shape[:-1], 1))
        right[..., 0, 0] = 1
        share = np.einsum("wmni,mni->wmn", rows, np.linalg.solve(normal, right)[..., 0])
        self.load = chassis.grip[:, None, None] * c.gravity * np.maximum(share, LEAST_SHARE)
        self.dx, self.dy = direction.real, direction.imag
        rolls = free != 0
        self.is_plain = not rolls.any() and bool((c.anisotropy == 1).all())
        self.is_aligned = bool((direction == 1).all()) and not rolls.any()
        if not self.is_plain:
            # products of the axes in which friction acts
            nx, ny = np.where(rolls, -free.imag, -self.dy), np.where(rolls, free.real, self.dx)
            axis = np.where(rolls, 0.0, 1.0), np.where(rolls, 1.0, c.anisotropy)
            self.xx = axis[0] * self.dx**2 + axis[1] * nx**2
            self.xy = axis[0] * self.dx * self.dy + axis[1] * nx * ny
            self.yy = axis[0] * self.dy**2 + axis[1] * ny**2
            self.rolls, self.nx, self.ny = rolls, nx, ny

    def speeds(self, signals: Array, up: Array) -> Array:
        """Return the rim speeds of the wheels, shape (w, m, n) [m/s]."""
        c = self.constants
        speeds = c.radius * c.rolling * signals[self.signal]
        if not c.turn_slope.any():
            return np.asarray(speeds)
        mean = speeds.mean(axis=0)
        return np.asarray(mean + (speeds - mean) * np.exp(-c.turn_slope * up))

    def step(
        self, base: Array, guess: Array, u: Array, slope: tuple[Array, Array], h: float
    ) -> Array:
        """Return velocities ahead and to the left and the turning rate, shape (3, m, n).

        Accelerations are differences from a ``base`` over ``h`` [s]; friction has its secant, and
        inertia its turning rate, at a ``guess``.
        """
        vx, vy, w = guess
        up, left = slope
        c, x, y = self.constants, self.x, self.y
        ux, uy = u * self.dx, u * self.dy
        sx, sy = vx - w * y - ux, vy + w * x - uy
        if self.is_plain:
            size = sx**2 + sy**2
        else:
            size = np.where(self.rolls, (self.nx * sx + self.ny * sy) ** 2, sx**2 + sy**2)
        cosine = np.sqrt(np.maximum(1 - up**2 - left**2, MIN_COSINE**2))
        grip = c.friction * cosine * self.load / np.sqrt(size + (c.friction / c.stiffness) ** 2)
        if self.is_plain:
            a11 = a22 = grip.sum(axis=0)
            h1, h2 = -y * grip, x * grip
            a12, f1, h3 = 0.0, (grip * ux).sum(axis=0), x * h2 - y * h1
            f2 = 0.0 if self.is_aligned else (grip * uy).sum(axis=0)
        else:
            xx, xy, yy = grip * self.xx, grip * self.xy, grip * self.yy
            a11, a12, a22 = xx.sum(axis=0), xy.sum(axis=0), yy.sum(axis=0)
            h1, h2 = x * xy - y * xx, x * yy - y * xy
            h3 = x * h2 - y * h1
            f1, f2 = (xx * ux + xy * uy).sum(axis=0), (xy * ux + yy * uy).sum(axis=0)
        a13, a23, a33 = h1.sum(axis=0), h2.sum(axis=0), h3.sum(axis=0)
        f3 = (h1 * ux).sum(axis=0) if self.is_aligned else (h1 * ux + h2 * uy).sum(axis=0)
        mass, spin = c.inertia / h, c.inertia * c.gyration / h
        f1 = f1 + mass * base[0] - c.gravity * up
        f2 = f2 + mass * base[1] - c.gravity * left
        f3 = f3 + spin * base[2]
        a11, a22, a33 = a11 + mass, a22 + mass, a33 + spin
        above, below = a12 - c.inertia * w, a12 + c.inertia * w
        # elimination of the turning rate, then of the velocity to the left
        r1, r2 = a13 / a33, a23 / a33
        b11, b12, g1 = a11 - r1 * a13, above - r1 * a23, f1 - r1 * f3
        b21, b22, g2 = below - r2 * a13, a22 - r2 * a23, f2 - r2 * f3
        det = b11 * b22 - b12 * b21
        vx, vy = (g1 * b22 - g2 * b12) / det, (g2 * b11 - g1 * b21) / det
        return np.stack(np.broadcast_arrays(vx, vy, (f3 - a13 * vx - a23 * vy) / a33))


def integrate(velocity: ComplexArray, turning: Array, dt: float) -> tuple[ComplexArray, Array]:
    """Return places and headings, from zero, of velocities and turning rates at samples.

    Paths between samples are arcs.
    """
    turn = (turning[1:] + turning[:-1]) * (dt / 2)
    heading, place = np.zeros_like(turning), np.zeros_like(velocity)
    np.cumsum(turn, axis=0, out=heading[1:])
    chord = (velocity[1:] + velocity[:-1]) * (dt / 2) * np.sinc(turn / 2 / np.pi)
    np.cumsum(chord * np.exp(1j * (heading[1:] - turn / 2)), axis=0, out=place[1:])
    return place, heading


def chassis_of(vehicle: Vehicle, signals: Sequence[int], joints: Mapping[str, Array]) -> Chassis:
    """Return positions and rolling directions of the wheels of a vehicle on level ground.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle. Wheels on passive joints swivel without friction; other joints are at zero.
    signals : sequence of int
        Index of the input that drives each wheel; -1 for wheels that roll freely.
    joints : mapping of arrays, shape (r,)
        Values of commanded joints, by name. [rad or m]
    """
    names = [each.name for each in vehicle.coordinates]
    values = ca.SX.sym("values", len(names))
    poses = vehicle.carriers(values={name: values[k] for k, name in enumerate(names)})
    axles = [unit_vector(wheel.axle) for wheel in vehicle.wheels]
    rows = [
        ca.vertcat(pose.origin[:2], (pose.rotation @ ca.DM(list(axle)))[:2])
        for pose, axle in zip(poses, axles, strict=True)
    ]
    suspension = [k for k, each in enumerate(vehicle.coordinates) if each.kind == "suspension"]
    heights = ca.vertcat(*(pose.origin[2] for pose in poses))
    lift = ca.densify(ca.jacobian(heights, values)[:, suspension])
    function = ca.Function("wheels", [values], [ca.horzcat(*rows)])
    passive = [k for k, each in enumerate(vehicle.coordinates) if each.kind == "passive"]
    count = max((each.size for each in joints.values()), default=1)
    table = np.zeros((len(names), count))
    for name, own in joints.items():
        table[names.index(name)] = own
    x, y, ax, ay = np.array([function(column).full() for column in table.T]).transpose(1, 2, 0)
    moving = ca.which_depends(ca.vertcat(*rows), values[passive], 1, True) if passive else ()
    swivels = np.reshape(moving, (-1, 4)).any(axis=1) if passive else np.zeros(len(rows), bool)
    # The axle points to the right: the rolling direction is the axle turned by 90 degrees.
    direction = (ax + 1j * ay) / np.hypot(ax, ay)
    place = y - 1j * x
    is_driven = np.array(signals) >= 0
    rollers = np.array([wheel.section.rollers or 0.0 for wheel in vehicle.wheels])
    turned = direction * np.exp(1j * rollers)[:, None]
    is_free = (rollers != 0) | ~is_driven
    return Chassis(
        place,
        direction,
        np.where(is_free[:, None], turned, 0),
        np.maximum(signals, 0),
        np.where(swivels, 0.0, [float(wheel.grip) for wheel in vehicle.wheels]),
        ca.DM(ca.Function("lift", [values], [lift])(table[:, 0])).full(),
    )


def track(vehicle: Vehicle) -> float:
    """Return the lateral distance between the outermost wheels' centres, joints at zero [m]."""
    return float(np.ptp(vehicle.centers[:, 0]))


def with_dimensions(
    vehicle: Vehicle,
    radii: Mapping[str, float],
    width: float | None = None,
    center: Mapping[int, float] = MappingProxyType({}),
    gyration: float | None = None,
) -> Vehicle:
    """Return a vehicle with other dimensions.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle.
    radii : mapping of float
        Rolling radii, by wheel. [m]
    width : float, optional
        Track; all lateral distances between joints and wheels grow with it. [m]
    center : mapping of float
        Coordinates 0 and 1 of the centre of all masses, to which the platform's is moved. [m]
    gyration : float, optional
        Moment of inertia about the vertical over mass, of which the platform has what other parts
        leave; its other moments are scaled alike. [m^2]

    Raises
    ------
    ModelError
        If a wheel has no radius that can be changed, or other parts exceed the moment of inertia.
    """
    factor = 1.0 if width is None else width / track(vehicle)

    def wider(at: Vector) -> Vector:
        return at[0] * factor, at[1], at[2]

    def changed(wheel: Wheel) -> Wheel:
        own = replace(wheel, at=wider(wheel.at))
        if wheel.name not in radii:
            return own
        return replace(own, section=_section(wheel.section, radii[wheel.name], wheel.name))

    found = replace(
        vehicle,
        joints=tuple(replace(joint, at=wider(joint.at)) for joint in vehicle.joints),
        wheels=tuple(map(changed, vehicle.wheels)),
    )
    body, own = found.body, found.body.mass
    if not own or not (center or gyration):
        return found
    others = [*replace(found, body=replace(body, mass=0.0)).masses()]
    masses = np.array([own, *(mass for _, mass, _ in others)])
    places = np.array([body.at, *(ca.evalf(place).full().ravel() for *_, place in others)])
    wanted = masses @ places / masses.sum()
    for k, value in center.items():
        places[0, k] += (value - wanted[k]) * masses.sum() / own
        wanted[k] = value
    found = replace(found, body=replace(body, at=tuple(places[0].tolist())))
    if gyration is None:
        return found
    squares = ((places - wanted)[:, :2] ** 2).sum(axis=1)
    spins = [body_inertia(found, joint.name)[2, 2] for joint in found.joints if joint.body.mass]
    spins += [wheel_inertia(wheel)[1] for wheel in found.wheels]
    spin = gyration * masses.sum() - masses @ squares - sum(spins)
    if spin <= 0:
        raise ModelError(
            f"vehicle: expected a moment of inertia over mass above "
            f"{gyration - spin / masses.sum():.3g} "
            f"m^2, that of the other parts, found {gyration:.3g} m^2; reduce their masses, or set "
            "'constants.gyration'"
        )
    old = body_inertia(found, "platform")  # a body can have moments of the same shape
    return replace(found, body=replace(found.body, inertia=elements(old * (spin / old[2, 2]))))


def _section(section: Section, radius: float, name: str) -> Section:
    """Return a section with another rolling radius and the same tube."""
    if isinstance(section, Omni):
        return replace(section, rim=_section(section.rim, radius, name))
    if section.torus_radii is None:
        raise ModelError(
            f"wheel {name!r}: expected a torus, disc or sphere, whose radius can be fitted, found "
            f"{section}; remove the radius from the unknowns"
        )
    tube, circle = section.torus_radii
    if tube and circle:
        return Torus(tube, radius - tube)
    return Disc(radius) if circle else Sphere(radius)
