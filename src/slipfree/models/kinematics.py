"""Direct kinematics: motion of a vehicle over the ground for given wheel and joint rates."""

from __future__ import annotations

import casadi as ca

from slipfree.contact.closure import has_exact_closure
from slipfree.core.dae import Labels
from slipfree.core.errors import ModelError
from slipfree.core.records import Label, leaves, pack
from slipfree.laws.least_slip import LeastSlip
from slipfree.laws.protocols import Equations, Motion, SlipLaw, check_law, wheel_labels
from slipfree.models.closure_model import closure_dae, closure_quantities
from slipfree.models.labels import labels_of
from slipfree.models.pressed_model import SMOOTHING, pressed_dae
from slipfree.models.quantities import Quantities
from slipfree.models.records import KinematicDae
from slipfree.models.statics import following_forces
from slipfree.system.forks import computing
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle


@computing
def direct_kinematics(
    vehicle: Vehicle,
    terrain: Terrain,
    *,
    slip: SlipLaw = LeastSlip(),  # noqa: B008 - a frozen record
    smoothing: float = SMOOTHING,
) -> KinematicDae:
    """Return the kinematic model of a vehicle on a ground for given rates.

    Positions follow from closure: every wheel touches the ground, which gives three equations in
    its two contact coordinates and the pose. If not all wheels can touch a rigid ground, they are
    pressed into it (`slipfree.models.pressed_model`). Rates follow from the slip law.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    terrain : Terrain
        The ground. A motion ends where a contact leaves its domain.
    slip : SlipLaw
        `LeastSlip`, for every vehicle; or `Rolling`, for vehicles that can roll without slip.
    smoothing : float
        Width of the transition in which the load of a pressed wheel vanishes as it leaves the
        ground; only for vehicles whose wheels cannot all touch a rigid ground. [static depths]

    Returns
    -------
    Dae
        Inputs are the rates of the driven wheels and of the commanded coordinates.

    Raises
    ------
    ModelError
        If ``slip`` is not a slip law or cannot be used with the vehicle, if ``smoothing`` is not
        positive, if the vehicle has fewer than three wheels, or if contacts and springs do not
        determine its pose.

    See Also
    --------
    slipfree.models.quasi_statics.quasi_statics : Motion determined by gravity and friction.

    Notes
    -----
    For a vehicle with mass, the forces that the motion needs are outputs. Where equilibrium does
    not determine them, they are the load-weighted forces of
    `slipfree.models.statics.following_forces`.

    Examples
    --------
    >>> from slipfree import Analytic, catalog, direct_kinematics
    >>> direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y))
    Dae: 6 states, 30 unknowns, 3 inputs, 13 limits, size 1 m
      states: x, y, heading, tilt_right, tilt_left, steer
      unknowns: z, roll, pitch, contact_x, contact_y, velocity_x, velocity_y, velocity_z, ...
      inputs: right_rate, left_rate, steer_rate
      outputs: wheel_angle, work, contact_z, center_x, center_y, center_z, slip_along, ...
    """
    check_slip_law(vehicle, slip)
    if not smoothing > 0:
        raise ModelError(
            f"direct_kinematics: smoothing: expected a positive number, found {smoothing}; "
            "increase it"
        )
    if not has_exact_closure(vehicle):
        return pressed_dae(vehicle, terrain, slip, smoothing)
    labels = labels_of(vehicle, slip.unknowns(vehicle, contact_labels(vehicle)))
    z, q = closure_quantities(vehicle, terrain, labels)
    return closure_dae(labels, z, q, slip_equations(slip, labels, q), following_forces(q))


def check_driven(vehicle: Vehicle) -> None:
    """Raise ModelError if a vehicle has no input, so that in kinematics nothing moves it."""
    if vehicle.of("commanded") or any(wheel.driven for wheel in vehicle.wheels):
        return
    raise ModelError(
        f"{vehicle.name!r}: expected a driven wheel or a commanded coordinate, without which "
        "kinematics determines no motion, found none; set driven = true for some of the wheels "
        f"{', '.join(wheel.name for wheel in vehicle.wheels)}, or use model = 'dynamics', in which "
        "gravity moves the vehicle"
    )


def check_slip_law(vehicle: Vehicle, slip: SlipLaw) -> None:
    """Raise ModelError if ``slip`` is not a slip law, or cannot be used with the vehicle."""
    check_law(slip, SlipLaw, "slip: expected a slip law such as LeastSlip() or Rolling()")
    slip.check(vehicle)


def slip_equations(slip: SlipLaw, labels: Labels, q: Quantities) -> Equations:
    """Return the equations that a slip law gives for the rates, for wheels in exact contact."""
    normal = [
        ca.dot(contact.normal, velocity)
        for contact, velocity in zip(q.contacts, q.slips, strict=True)
    ]
    motion = Motion(
        q.vehicle,
        q.contacts,
        q.slips,
        pack(q.rates.motion),
        tuple(leaves(labels.z.rates.motion)),
        Equations(contact_labels(q.vehicle), ca.vertcat(*normal)),
        (1.0,) * len(q.slips),
    )
    return slip.equations(motion, q.rates.law)


def contact_labels(vehicle: Vehicle) -> tuple[Label, ...]:
    """Return the labels of the normal velocities of the wheels, which vanish in exact contact."""
    return wheel_labels(vehicle, "contact", "m s-1", "contact in the least-slip condition")
