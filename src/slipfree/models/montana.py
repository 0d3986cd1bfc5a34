"""Montana's contact equations [1]_, and direct kinematics by them, compared with the closure model.

Five contact coordinates determine the pose of a wheel that touches the ground: the contact point on
the ground ``u_g, v_g``, the contact point on the wheel ``u_w, v_w``, and the angle ``psi`` between
the two Gauss frames. The equations give their rates from the twist of the wheel [2]_. They need the
curvature of the tread, hence a wheel section without edges.

The forms of a parametrised surface ``c(u, v)`` are those of [1]_, section 2, for a Gauss frame from
Gram-Schmidt orthogonalisation; they also hold where ``c_u`` and ``c_v`` are not orthogonal, as on a
height map.

In the model of direct kinematics, the wheels' contact coordinates are states. Each wheel touches
the ground and moves over it by Montana's equations; its pose follows from its contact coordinates.
The same pose follows from the chain of joints that carries the wheel. Both poses agree at the
start, and their rates are equal. Integration errors cause a drift between them; terms proportional
to the drift reduce it (Baumgarte stabilisation), and the drift is an output. Three distances
between wheel centres, as in [2]_, are not sufficient constraints: the orientations of the axles are
needed too.

References
----------
.. [1] D. J. Montana, "The kinematics of contact and grasp", Int. J. Robotics Research 7(3), 1988,
       pp. 17-32.
.. [2] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
       sections 2 and 3.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame, check_exact_closure, contact_frame
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Labels
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.records import Array, Label, leaves, pack, symbols
from slipfree.core.schema import NonNegative
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.frame import Pose
from slipfree.laws.least_slip import LeastSlip
from slipfree.laws.protocols import Equations, SlipLaw, quantity_labels, wheel_limits
from slipfree.models import base
from slipfree.models.friction_feasibility import (
    contact_force_residuals,
    force_outputs,
    mechanics,
    with_tangential,
)
from slipfree.models.kinematics import contact_labels, slip_equations
from slipfree.models.limits import limits_of, tip_over_margin
from slipfree.models.samples import slip_velocities
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle, Wheel


class Forms(NamedTuple):
    """Metric, curvature and torsion forms of a surface at a point.

    Upper triangular ``M`` in ``[c_u c_v] = [x y] M`` [m per unit of u, v], ``K = [x y]' [n_u n_v]
    M^-1``, positive where the surface bends away from ``n`` [1/m], and ``T = y' [x_u x_v] M^-1``
    [1/m].
    """

    metric: ca.SX
    curvature: ca.SX
    torsion: ca.SX


class Patch(NamedTuple):
    """Point of a surface, its Gauss frame ``[x y n]`` and its forms in that frame.

    ``x`` is along ``c_u``, ``n`` along ``c_u x c_v``.
    """

    point: ca.SX
    frame: ca.SX
    forms: Forms


def patch(c: ca.SX, uv: ca.SX) -> Patch:
    """Return the Gauss frame and the forms of a regular surface at its point ``c(uv)``."""
    c_u, c_v = ca.horzsplit(ca.densify(ca.jacobian(c, uv)))
    c_uu, c_uv = ca.horzsplit(ca.densify(ca.jacobian(c_u, uv)))
    c_vv = ca.densify(ca.jacobian(c_v, uv[1]))
    return patch_of(c, (c_u, c_v), (c_uu, c_uv, c_vv))


def patch_of(c: ca.SX, tangents: tuple[ca.SX, ca.SX], seconds: tuple[ca.SX, ca.SX, ca.SX]) -> Patch:
    """Return the Gauss frame and the forms of a surface from its derivatives at a point.

    ``tangents`` are ``c_u, c_v``, ``seconds`` are ``c_uu, c_uv, c_vv``. The frame is not
    differentiated, since ``n`` is normal to ``c_u`` and ``c_v``, and ``y`` to ``c_u``: ``K = -M^-T
    II M^-1`` with the second fundamental form ``II = n . [c_uu c_uv; c_uv c_vv]``, and ``y . x_u =
    y . c_uu / |c_u|``.
    """
    (c_u, c_v), (c_uu, c_uv, c_vv) = tangents, seconds
    area = ca.cross(c_u, c_v)
    x, n = c_u / ca.norm_2(c_u), area / ca.norm_2(area)
    y = ca.cross(n, x)
    metric = ca.blockcat([[ca.norm_2(c_u), ca.dot(x, c_v)], [0, ca.dot(y, c_v)]])
    to_arc = inverse(metric)
    across = ca.dot(n, c_uv)
    second = ca.blockcat([[ca.dot(n, c_uu), across], [across, ca.dot(n, c_vv)]])
    turning = ca.horzcat(ca.dot(y, c_uu), ca.dot(y, c_uv)) / metric[0, 0]
    forms = Forms(metric, -to_arc.T @ second @ to_arc, turning @ to_arc)
    return Patch(c, ca.horzcat(x, y, n), forms)


def inverse(matrix: ca.SX) -> ca.SX:
    """Return the inverse of a matrix of shape (2, 2)."""
    (a, b), (c, d) = (ca.horzsplit(row) for row in ca.vertsplit(matrix))
    return ca.blockcat([[d, -b], [-c, a]]) / (a * d - b * c)


class ContactCoordinates(NamedTuple):
    """Coordinates of a contact on both surfaces, and the angle between their Gauss frames.

    ``x, y`` are ``u_g, v_g`` on the ground [m], ``u, v`` are ``u_w, v_w`` on the wheel, see
    ``Section.point`` [rad], ``psi`` is the angle from the wheel's Gauss x axis to the ground's,
    about the ground's normal [rad].
    """

    x: Any
    y: Any
    u: Any
    v: Any
    psi: Any


class Pair(NamedTuple):
    """Surfaces of a wheel, in its axes, and of the ground at their contact, and the angle psi."""

    wheel: Patch
    ground: Patch
    psi: ca.SX

    @property
    def frame(self) -> ca.SX:
        """The wheel's Gauss frame in fixed axes, shape (3, 3)."""
        return self.ground.frame @ alignment(self.psi)

    @property
    def pose(self) -> Pose:
        """Pose of the wheel, with coincident contact points and opposite normals."""
        rotation = self.frame @ self.wheel.frame.T
        return Pose(rotation, self.ground.point - rotation @ self.wheel.point)


def pair(wheel: Wheel, terrain: Terrain, at: ContactCoordinates, lookups: LookupTable) -> Pair:
    """Return the surfaces of wheel and ground at a contact, in local coordinates."""
    tread = patch(wheel.section.point(at.u, at.v), ca.vertcat(at.u, at.v))
    height, gradient, hessian = terrain.jet(at.x, at.y, lookups)
    tangents = ca.vertcat(1, 0, gradient[0]), ca.vertcat(0, 1, gradient[1])
    h_xx, h_xy, h_yy = (ca.vertcat(0, 0, hessian[k]) for k in (0, 1, 3))
    ground = patch_of(ca.vertcat(at.x, at.y, height), tangents, (h_xx, h_xy, h_yy))
    return Pair(tread, ground, at.psi)


def alignment(psi: ca.SX) -> ca.SX:
    """Return the wheel's Gauss frame in the axes of the ground's Gauss frame, shape (3, 3).

    The matrix is symmetric.
    """
    c, s = ca.cos(psi), ca.sin(psi)
    return ca.blockcat([[c, -s, 0], [-s, -c, 0], [0, 0, -1]])


class ContactRates(NamedTuple):
    """Time derivatives of the parameters of the two surfaces (2, 1), and of psi [rad/s]."""

    wheel: ca.SX
    ground: ca.SX
    psi: ca.SX


def contact_rates(wheel: Forms, ground: Forms, psi: ca.SX, v: ca.SX, omega: ca.SX) -> ContactRates:
    """Return the rates of the contact coordinates by eq. 2 of Chakraborty and Ghosal.

    The forms differ from those in the paper: its ``K`` and ``T`` lack the factors ``1/|c_u|`` and
    ``1/|c_v|``, and its diagonal ``M`` is wrong on a height map (``test_surface.py``:
    ``test_printed_forms_fail``). ``v`` and ``omega`` are the velocity of the wheel's material point
    at the contact and the angular velocity of the wheel, relative to the ground and in the wheel's
    Gauss frame; ``v[2]`` is zero [m/s, rad/s].
    """
    turn = alignment(psi)[:2, :2]
    from_ground = turn @ ground.curvature @ turn
    relative = inverse(wheel.curvature + from_ground)
    rolling = ca.vertcat(-omega[1], omega[0])
    arc_w = relative @ (rolling - from_ground @ v[:2])
    arc_g = turn @ relative @ (rolling + wheel.curvature @ v[:2])
    return ContactRates(
        inverse(wheel.metric) @ arc_w,
        inverse(ground.metric) @ arc_g,
        omega[2] + wheel.torsion @ arc_w + ground.torsion @ arc_g,
    )


# quantities that describe the solution, or that may jump
OF_SOLUTION = {"newton_step", "singular_value", "clearance", *(f"quaternion_{k}" for k in "xyzw")}
MAX_DRIFT = 1e-3  # largest drift of an assembled vehicle [wheel radii, rad]
# contact coordinates that are outputs of the closure model and states of Montana's
AMONG_STATES: dict[str, Any] = {"wheel_u": (), "wheel_v": (), "psi": ()}


class Assembly(NamedTuple):
    """Differential states: platform, joints, and contact coordinates of every wheel.

    ``joints`` are the commanded and passive coordinates, ``suspension`` the others, in the
    vehicle's order [rad or m].
    """

    x: Any
    y: Any
    z: Any
    heading: Any
    roll: Any
    pitch: Any
    joints: tuple[Any, ...]
    suspension: tuple[Any, ...]
    contacts: tuple[ContactCoordinates, ...]


class Unknowns(NamedTuple):
    """Algebraic unknowns, grouped by the equations that determine them."""

    rates: base.Rates
    forces: base.Forces


@checked
def montana_kinematics(
    vehicle: Vehicle,
    ground: Terrain,
    *,
    slip: SlipLaw = LeastSlip(),  # noqa: B008 - a frozen record
    kappa: NonNegative = 10.0,
) -> Dae:
    """Return the kinematic model of a vehicle by Montana's contact equations.

    Its motion is that of ``direct_kinematics``. Start it from the settled closure model or from a
    later sample of a motion of that model: ``simulate`` finds all states there by name. ``settle``
    has nothing to solve here, since the contacts are states. A motion ends if a wheel drifts more
    than a thousandth of its radius, or 1 mrad, from its position on the vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, without wheels that have an edge (``Disc``) or rollers.
    ground : Terrain
        The ground. A motion ends where a contact leaves its domain. Third derivatives of the
        height enter IDAS's Jacobian.
    slip : SlipLaw
        As in the closure model.
    kappa : float
        Rate at which drift decays. [1/s]

    Returns
    -------
    Dae
        Inputs are the rates of the driven wheels and of the commanded coordinates.

    Raises
    ------
    ModelError
        If a wheel is a disc or has rollers, if not all wheels can touch a rigid ground, if
        ``kappa`` is negative or not finite, or if ``slip`` is not a slip law or cannot be used with
        the vehicle.

    Examples
    --------
    >>> from slipfree import Analytic, catalog, montana_kinematics
    >>> montana_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y))
    Dae: 24 states, 21 unknowns, 3 inputs, 16 limits, size 1 m
      states: x, y, z, heading, roll, pitch, tilt_right, tilt_left, steer, contact_x, ...
      unknowns: velocity_x, velocity_y, velocity_z, heading_rate, roll_rate, pitch_rate, ...
      inputs: right_rate, left_rate, steer_rate
      outputs: wheel_angle, work, contact_z, center_x, center_y, center_z, slip_along, ...
    """
    slip.check(vehicle)
    remedy = "use formulation = 'closure' with least slip, which presses the wheels into the ground"
    check_exact_closure(vehicle, "Montana's form", remedy)
    rollers = [wheel.name for wheel in vehicle.wheels if wheel.rollers]
    if rollers:
        raise ModelError(
            "Montana's form: expected wheels without rollers, found rollers on "
            f"{', '.join(map(repr, rollers))}; use formulation = 'closure', the default"
        )
    for wheel in vehicle.wheels:
        if float(wheel.section.tread_radius(ca.SX(0), ca.SX(1))) == 0:
            raise ModelError(
                f"Montana's form: wheel {wheel.name!r}: expected a tread with a positive "
                "radius of curvature, such as a torus with r1 > 0, found the edge of "
                f"{wheel.section}; use formulation = 'closure', which allows edges"
            )
    labels = _assembly_labels(
        base.labels_of(vehicle, slip.unknowns(vehicle, contact_labels(vehicle))), vehicle
    )
    x, z, u = symbols(labels.x), symbols(labels.z), symbols(labels.u)
    position = base.Dependent(x.z, x.roll, x.pitch, x.suspension, ())
    place, lookups = base.Configuration(x.x, x.y, x.heading, x.joints), LookupTable()
    state = base.VehicleState(vehicle, ground, lookups, place, position, z.rates, u)
    turning, coordinates, chain = base.spins(state), pack(x[:-1]), base.carriers(state)
    q_dot = ca.vertcat(*z.rates[:6], *base.joint_rates(state), *z.rates.suspension)
    contacts, poses, slips = list[ContactFrame](), list[Pose](), list[ca.SX]()
    rolling, drifts = list[ContactCoordinates](), list[tuple[ca.SX, ca.SX]]()
    for wheel, at, carrier, spin in zip(vehicle.wheels, x.contacts, chain, turning, strict=True):
        both, twist = pair(wheel, ground, at, lookups), carrier.twist(coordinates, q_dot)
        pose, frame = both.pose, both.frame
        contact = contact_frame(ground, at.x, at.y, pose.rotation[:, 0], lookups)
        # drift: from the chain of joints to the contact coordinates, to first order
        displacement = pose.origin - carrier.origin
        turn = carrier.rotation @ pose.rotation.T
        rotation = ca.inv_skew((turn - turn.T) / 2)  # sine of the angle times the axis
        omega = twist.omega + kappa * rotation - spin * pose.rotation[:, 0]
        velocity = twist.v - kappa * displacement + ca.cross(omega, contact.point - pose.origin)
        wheel_uv, ground_uv, psi = contact_rates(
            both.wheel.forms, both.ground.forms, at.psi, frame.T @ velocity, frame.T @ omega
        )
        # u and v are those of the hub, which does not spin with the wheel: v stays near 3 pi/2
        u_v = ground_uv[0], ground_uv[1], wheel_uv[0], wheel_uv[1] - spin
        rolling.append(ContactCoordinates(*u_v, psi))
        drifts.append((ca.norm_2(displacement), ca.norm_2(rotation)))
        contacts.append(contact)
        poses.append(pose)
        slips.append(velocity)
    parts = mechanics(state, contacts, slip_velocities(state, contacts))
    q = base.Quantities(
        *state,
        with_tangential(z.forces, parts),
        tuple(poses),
        tuple(contacts),
        tuple(slips),
        turning,
        parts,
        tip_over_margin(state, contacts),
    )
    distances, angles = zip(*drifts, strict=True)
    relative = (
        ca.fmax(distance / wheel.radius, angle)
        for wheel, (distance, angle) in zip(vehicle.wheels, drifts, strict=True)
    )
    law = slip_equations(slip, labels, q)
    sampled = force_outputs(q, labels.y.forces)
    return base.vehicle_dae(
        q,
        labels,
        x,
        z,
        (law, Equations(labels.alg[1], contact_force_residuals(q))),
        sampled,
        ode=ca.vertcat(q_dot, *leaves(tuple(rolling))),
        y=base.outputs(q, sampled)._replace(
            **AMONG_STATES, drift_position=distances, drift_rotation=angles
        ),
        limits=(
            # first, since other limits assume wheels without drift
            *wheel_limits(vehicle, "assembly", relative, -np.inf, MAX_DRIFT),
            *limits_of(q),
        ),
        checks=base.contact_checks(q, x, z, q.poses),
        guess=base.at_rest(vehicle, labels.z),
        suppress_algebraic=True,
    )


def _assembly_labels(labels: Labels, vehicle: Vehicle) -> Labels:
    """Return the labels of Montana's model, from the labels of the closure model."""
    x, z, q, u, y, (_, *equations) = labels
    place = z.position
    contacts = zip(*zip(*place.contacts, strict=True), y.wheel_u, y.wheel_v, y.psi, strict=True)
    sampled = y._replace(
        **AMONG_STATES,
        drift_position=quantity_labels(vehicle, "drift_position"),
        drift_rotation=quantity_labels(vehicle, "drift_rotation"),
    )
    states = Assembly(
        x.x,
        x.y,
        place.z,
        x.heading,
        place.roll,
        place.pitch,
        x.joints,
        place.suspension,
        tuple(ContactCoordinates(*row) for row in contacts),
    )
    return Labels(states, Unknowns(z.rates, z.forces), q, u, sampled, tuple(equations))


class Difference(NamedTuple):
    """Largest difference between two motions in one quantity, and its time [s].

    The label contains the wheel of the largest difference if there is a value per wheel; angles
    differ modulo 2 pi.
    """

    label: Label
    size: float
    t: float

    def __repr__(self) -> str:
        unit = self.label.unit
        return f"Difference: {self.label.full} {self.size:.2e} {unit} at t = {self.t:.6g} s"


@checked
def cross_check(first: Trajectory, second: Trajectory) -> tuple[Difference, ...]:
    """Return the largest difference of every quantity that two motions share.

    Quantities that describe the solution rather than the motion (residuals, the Newton step,
    singular values) are omitted, and so are quantities that may jump: the clearance of a second
    contact and the quaternion.

    Parameters
    ----------
    first, second : Trajectory
        Motions with the same sample times; if one ends earlier, later samples of the other are
        ignored.

    Returns
    -------
    tuple of Difference
        The largest differences, one for each quantity, in the order of ``first``.

    Raises
    ------
    ModelError
        If the sample times differ.

    Examples
    --------
    The closure model and Montana's equations give the same motion of the three-wheeler:

    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, cross_check, settle, simulate
    >>> from slipfree import direct_kinematics, montana_kinematics
    >>> vehicle, ground = catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y)
    >>> model, other = direct_kinematics(vehicle, ground), montana_kinematics(vehicle, ground)
    >>> start, t = settle(model), np.linspace(0, 1, 3)
    >>> rates = {"right_rate": 0.5, "left_rate": 0.5, "steer_rate": 0.0}
    >>> runs = [simulate(each, start, each.inputs(**rates), t) for each in (model, other)]
    >>> max(each.size for each in cross_check(*runs) if each.label.unit == "m") < 1e-5
    True
    """
    n = min(first.t.size, second.t.size)
    if not np.array_equal(first.t[:n], second.t[:n]):
        raise ModelError(
            "cross_check: expected two motions with the same sample times, found different times; "
            "simulate both with the same times"
        )
    differences = list[Difference]()
    for name, (label, values) in first.columns.items():
        if name not in second.columns or name in OF_SOLUTION or name.endswith("_residual"):
            continue
        gap: Array = np.abs(values[:n] - second[name][:n]).reshape(n, -1)
        if label.unit == "rad":
            gap = np.abs((gap + np.pi) % (2 * np.pi) - np.pi)
        k, i = np.unravel_index(np.argmax(gap), gap.shape)
        place = replace(label, wheel=first.wheels[i] if values.ndim == 2 else None)
        differences.append(Difference(place, float(gap[k, i]), float(first.t[k])))
    return tuple(differences)
