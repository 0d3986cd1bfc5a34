"""Direct kinematics by Montana's contact equations, compared with the closed-chain model.

The wheels' contact coordinates are states. Each wheel touches the ground and moves over it by
Montana's equations; its pose follows from its contact coordinates. The same pose follows from the
chain of joints that carries the wheel. Both poses agree at the start, and their rates are equal.
Integration errors cause a drift between them; terms proportional to the drift reduce it (Baumgarte
stabilisation), and the drift is an output. Three distances between wheel centres, as in
[1]_, are not sufficient constraints: the orientations of the axles are needed too.

References
----------
.. [1] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
       section 3.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame, check_exact_closure, contact_frame
from slipfree.contact.montana import ContactCoordinates, contact_rates, pair
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
from slipfree.models.base import (
    Quantities,
    VehicleState,
    at_rest,
    carriers,
    contact_checks,
    joint_rates,
    outputs,
    spins,
    vehicle_dae,
)
from slipfree.models.friction_feasibility import (
    contact_force_residuals,
    force_outputs,
    mechanics,
    with_tangential,
)
from slipfree.models.kinematics import contact_labels, slip_equations
from slipfree.models.limits import limits_of, tip_over_margin
from slipfree.models.records import (
    Configuration,
    Dependent,
    Forces,
    Rates,
    labels_of,
)
from slipfree.models.samples import slip_velocities
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

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

    rates: Rates
    forces: Forces


class RollingWheel(NamedTuple):
    """Contact, pose, rates and drift of a rolling wheel.

    ``pose`` is that of the wheel's hub from the contact coordinates, ``slip`` the velocity of the
    wheel's material contact point [m/s]. The drift is the wheel's centre from the contact
    coordinates minus its centre from the chain of joints [m], and the rotation vector from the
    first orientation to the second, to first order [rad].
    """

    contact: ContactFrame
    pose: Pose
    slip: ca.SX
    rates: ContactCoordinates
    displacement: ca.SX
    rotation: ca.SX


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
    _check(vehicle)
    labels = _assembly_labels(
        labels_of(vehicle, slip.unknowns(vehicle, contact_labels(vehicle))), vehicle
    )
    x, z, u = symbols(labels.x), symbols(labels.z), symbols(labels.u)
    position = Dependent(x.z, x.roll, x.pitch, x.suspension, ())
    place, lookups = Configuration(x.x, x.y, x.heading, x.joints), LookupTable()
    state = VehicleState(vehicle, ground, lookups, place, position, z.rates, u)
    turning, coordinates, chain = spins(state), pack(x[:-1]), carriers(state)
    q_dot = ca.vertcat(*z.rates[:6], *joint_rates(state), *z.rates.suspension)
    rolls = list[RollingWheel]()
    for wheel, at, carrier, spin in zip(vehicle.wheels, x.contacts, chain, turning, strict=True):
        both, twist = pair(wheel, ground, at, lookups), carrier.twist(coordinates, q_dot)
        pose, frame = both.pose, both.frame
        contact = contact_frame(ground, at.x, at.y, pose.rotation[:, 0], lookups)
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
        rates = ContactCoordinates(*u_v, psi)
        rolls.append(RollingWheel(contact, pose, velocity, rates, displacement, rotation))
    contacts = tuple(roll.contact for roll in rolls)
    parts = mechanics(state, contacts, slip_velocities(state, contacts))
    q = Quantities(
        *state,
        with_tangential(z.forces, parts),
        tuple(roll.pose for roll in rolls),
        contacts,
        tuple(roll.slip for roll in rolls),
        turning,
        parts,
        tip_over_margin(state, contacts),
    )
    drifts = (
        ca.fmax(ca.norm_2(roll.displacement) / wheel.radius, ca.norm_2(roll.rotation))
        for wheel, roll in zip(vehicle.wheels, rolls, strict=True)
    )
    law = slip_equations(slip, labels, q)
    sampled = force_outputs(q, labels.y.forces)
    return vehicle_dae(
        q,
        labels,
        x,
        z,
        (law, Equations(labels.alg[1], contact_force_residuals(q))),
        sampled,
        ode=ca.vertcat(q_dot, *leaves(tuple(roll.rates for roll in rolls))),
        y=outputs(q, sampled)._replace(
            **AMONG_STATES,
            drift_position=tuple(ca.norm_2(roll.displacement) for roll in rolls),
            drift_rotation=tuple(ca.norm_2(roll.rotation) for roll in rolls),
        ),
        limits=(
            # first, since other limits assume wheels without drift
            *wheel_limits(vehicle, "assembly", drifts, -np.inf, MAX_DRIFT),
            *limits_of(q),
        ),
        checks=contact_checks(q, x, z, q.poses),
        guess=at_rest(vehicle, labels.z),
        suppress_algebraic=True,
    )


def _check(vehicle: Vehicle) -> None:
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
    shared = [name for name in first if name in second.columns and _describes_motion(name)]
    return tuple(_difference(first, second, name, n) for name in shared)


def _describes_motion(name: str) -> bool:
    return not name.endswith("_residual") and name not in {
        "newton_step",
        "singular_value",
        "clearance",
        *(f"quaternion_{axis}" for axis in "xyzw"),
    }


def _difference(first: Trajectory, second: Trajectory, name: str, n: int) -> Difference:
    label = first.columns[name].label
    gap: Array = np.abs(first[name][:n] - second[name][:n]).reshape(n, -1)
    if label.unit == "rad":
        gap = np.abs((gap + np.pi) % (2 * np.pi) - np.pi)
    k, i = np.unravel_index(np.argmax(gap), gap.shape)
    wheel = first.wheels[i] if first[name].ndim == 2 else None
    place = Label(label.name, label.unit, label.words, wheel)
    return Difference(place, float(gap[k, i]), float(first.t[k]))
