"""Forces on a slow vehicle: equilibrium, work of its drives, and feasibility of its friction.

The equations follow from the principle of virtual power. The slip velocities ``s_i`` of the contact
points are linear in the rates of all coordinates and wheels; the contact forces ``lambda_i`` act on
a coordinate with the coefficient of its rate in ``sum lambda_i . s_i``. For a free rate, this force
balances gravity, springs and dampers; for a commanded rate, the drive bears the difference. Inertia
is neglected: all results are quasi-static.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame
from slipfree.core.dae import Labels
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, leaves, pack, symbols
from slipfree.core.trajectory import Column, Trajectory
from slipfree.models import base
from slipfree.models.force_distribution import least_utilisation
from slipfree.models.limits import tip_over_margin
from slipfree.models.samples import coordinates, slip_velocities
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

MAX_LEVEL_SLOPE = 0.005  # smaller slopes count as level ground [rad]
MAX_HELD_UTILISATION = 0.99  # below it, friction is not the reason for a failure
MAX_EXHAUSTED_UTILISATION = 1.001  # below it, friction is just exhausted
MAX_UPRIGHT_LEAN = 0.02  # a wheel with a smaller lean counts as upright [rad]
BEST = quantity_label("utilisation_best")


def mechanics(
    state: base.State, contacts: Sequence[ContactFrame], slips: Sequence[ca.SX]
) -> base.Mechanics:
    """Return the terms of the equilibrium of a vehicle; ``slips`` are those of its wheels."""
    vehicle, rates, u = state.vehicle, state.rates, state.u
    components = [
        ca.horzcat(touch.along, touch.across, touch.normal).T @ velocity
        for touch, velocity in zip(contacts, slips, strict=True)
    ]
    unknown, given = pack(rates.motion), pack(u)
    values = base.values_of(state)
    height = sum(mass * center[2] for _, mass, center in base.masses_of(state))
    springs = sum(c.potential(values[c.name]) for c in vehicle.coordinates if c.is_loaded)
    potential = ca.SX(vehicle.gravity * height + springs)
    pairs = [
        *zip(vehicle.of("passive"), rates.passive, strict=True),
        *zip(vehicle.of("suspension"), rates.suspension, strict=True),
        *zip(vehicle.of("commanded"), u.joints, strict=True),
    ]
    damped = ca.SX(sum(c.damping * rate**2 for c, rate in pairs))
    power = ca.jtimes(potential, *coordinates(state))
    # the damper force is the gradient of the dissipation function, which is half the power
    lost = power + damped / 2
    slip = ca.vertcat(*components)
    return base.Mechanics(
        ca.jacobian(slip, unknown),
        ca.jacobian(slip, given),
        -ca.gradient(lost, unknown),
        -ca.gradient(lost, given),
        tuple(
            wheel.grip * state.terrain.friction(touch.point[0], touch.point[1], state.lookups)
            for wheel, touch in zip(vehicle.wheels, contacts, strict=True)
        ),
        vehicle.weight,
        potential,
        damped,
    )


def equilibrium(parts: base.Mechanics, forces: ca.SX) -> ca.SX:
    """Return the equilibrium residual divided by the weight, shape (n_rates, 1) [1, m]."""
    return (parts.free.T @ forces + parts.load) / parts.weight


def contact_force_residuals(q: base.Quantities) -> ca.SX:
    """Return the residuals that determine the contact forces of a motion; empty without mass.

    Where equilibrium does not determine the forces, the tangential forces ``f_t`` minimise ``sum
    |f_t|^2 / (mu N)``, with the friction limits ``mu N`` of the wheels as fixed weights. The
    conditions are ``f_t = -mu N s_t`` (`with_tangential`) and ``s_n = 0``, where ``s_t`` and
    ``s_n`` are the tangential and normal velocities of a contact for the virtual rates. This is the
    limit of regularised Coulomb friction for small slip. Forces of least norm would not be
    plausible, since a wheel with a small load cannot bear a large force.
    """
    if not q.vehicle.mass:
        return ca.SX(0, 1)
    balanced = equilibrium(q.mechanics, q.forces.column)
    if base.is_determinate(q.vehicle):
        return balanced
    slip = q.mechanics.free @ pack(q.forces.virtual)
    return ca.vertcat(balanced, slip[2::3])


def with_tangential(forces: base.Forces, parts: base.Mechanics) -> base.Forces:
    """Return forces with the tangential ones that follow from virtual rates: ``-mu N s_t``."""
    if not forces.virtual:
        return forces
    slip = parts.free @ pack(forces.virtual)
    along, across = (
        tuple(
            -mu * normal * s
            for mu, normal, s in zip(
                parts.friction, forces.normal, ca.vertsplit(slip[k::3]), strict=True
            )
        )
        for k in range(2)
    )
    return forces._replace(along=along, across=across)


def closure_quantities(
    vehicle: Vehicle, terrain: Terrain, labels: Labels
) -> tuple[base.Algebraic, base.Quantities]:
    """Return the algebraic unknowns of a closure model and the expressions that contain them."""
    x, z, u = symbols(labels.x), symbols(labels.z), symbols(labels.u)
    state = base.VehicleState(vehicle, terrain, LookupTable(), x, z.position, z.rates, u)
    poses = base.carriers(state)
    contacts = base.contact_frames(state, poses, z.position.contacts)
    slips = slip_velocities(state, contacts)
    parts = mechanics(state, contacts, slips)
    of_wheels = with_tangential(z.forces, parts), poses, contacts, slips, base.spins(state)
    return z, base.Quantities(*state, *of_wheels, parts, tip_over_margin(state, contacts))


def force_outputs(
    q: base.Quantities, labels: base.ForceOutputs | tuple[()]
) -> base.ForceOutputs | tuple[()]:
    """Return the output forces, efforts and energies; empty if the vehicle has no mass.

    The ``labels`` of the outputs include tangential forces that are not unknowns.
    """
    if not labels:
        return ()
    along, across, normal, _ = q.forces
    parts = q.mechanics
    wheels = list(zip(along, across, normal, parts.friction, strict=True))
    efforts = -(parts.driven.T @ q.forces.column + parts.held)
    torques = iter(ca.vertsplit(efforts) if efforts.numel() else [])
    drives = [next(torques) if wheel.driven else ca.SX(0) for wheel in q.vehicle.wheels]
    rubbed = [
        a * ca.dot(touch.along, s) + c * ca.dot(touch.across, s)
        for a, c, touch, s in zip(along, across, q.contacts, q.slips, strict=True)
    ]
    return base.ForceOutputs(
        along if labels.along else (),
        across if labels.across else (),
        tuple(_used(a, c, n) for a, c, n, _ in wheels),
        tuple(_used(a, c, mu * n) for a, c, n, mu in wheels),
        tuple(drives),
        tuple(torques),
        ca.dot(efforts, pack(q.u)),
        parts.damped - sum(rubbed),
        parts.potential,
        q.tip_over_margin,
    )


def _used(along: ca.SX, across: ca.SX, offered: ca.SX) -> ca.SX:
    """Return the ratio of tangential force to available friction; infinite without load [1].

    The square root is the last operation: limits use the square, since the root has no derivative
    at zero force.
    """
    return ca.sqrt(ca.if_else(offered > 0, (along**2 + across**2) / offered**2, ca.SX.inf()))


def best_utilisation(vehicle: Vehicle, terrain: Terrain, run: Trajectory) -> Trajectory:
    """Return a motion with the additional column ``utilisation_best``.

    If equilibrium does not determine the contact forces, ``utilisation`` is computed for one
    distribution, the load-weighted one. ``utilisation_best`` is the largest utilisation among the
    wheels, minimised over all distributions; above one, friction cannot hold the vehicle. It is
    infinite where no contact forces balance the vehicle, because the vehicle tips over or a wheel
    or joint is free to move. It is NaN where the optimisation does not converge, or where the
    friction is not positive or a value is not finite. The loads of
    pressed wheels follow from their depths, which are assumed: they are distributed as well, among
    all wheels.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with mass.
    terrain : Terrain
        The ground; without a friction coefficient, the utilisation is that for the coefficient 1.
    run : Trajectory
        A motion of any model of the vehicle on this ground.

    Raises
    ------
    ModelError
        If the vehicle has no mass, or if the motion lacks a coordinate or a rate.
    """
    base.check_mass(vehicle, "best friction utilisation")
    labels = base.labels_of(vehicle)
    required = labels.x, labels.z.position, labels.z.rates.motion, labels.u
    _, q = closure_quantities(vehicle, terrain, labels)
    given = [pack((q.x, q.position, q.rates.motion, q.u))]
    f = lookup_function(q.lookups.lookups, "hold", given, _equilibrium_terms(q.mechanics))
    rows = np.array([run.of(label) for label in leaves(required)])
    rows -= base.map_offsets(terrain, required)[:, None]
    columns, loads, friction = (np.array(out) for out in f.map(run.t.size)(rows))
    matrix = columns.reshape(len(columns), run.t.size, -1).transpose(1, 0, 2)
    known = np.isfinite(matrix).all(axis=(1, 2)) & (friction > 0).all(axis=0)
    best = np.full(run.t.size, np.nan)
    least = least_utilisation(matrix[known], loads.T[known], friction.T[known])
    best[known] = least.utilisation
    return replace(run, columns={**run.columns, BEST.name: Column(BEST, best)})


def _equilibrium_terms(parts: base.Mechanics) -> list[ca.SX]:
    """Return the equilibrium's matrix, its load divided by the weight, and the wheels' friction."""
    return [parts.free.T, parts.load / parts.weight, ca.vertcat(*parts.friction)]


def diagnosis(z: base.Algebraic, q: base.Quantities) -> Callable[[Array, Array], str]:
    """Return a function ``describe(x, z)`` that reports why there is no equilibrium at a state.

    The text names the friction needed, and the largest lean of a wheel if it exceeds 0.02 rad. It
    is empty if friction holds the vehicle or the friction needed cannot be computed.
    """
    x, contacts = q.x, q.contacts
    normal = sum((each.normal for each in contacts), ca.SX.zeros(3))
    uphill, slope = -normal[:2], ca.acos(normal[2] / ca.norm_2(normal))
    forward = base.platform_pose(q).rotation[:2, 1]
    aside = ca.fabs(uphill[0] * forward[1] - uphill[1] * forward[0])
    angles = [slope, ca.atan2(aside, ca.dot(uphill, forward))]
    lean = ca.acos(ca.fmin(ca.mmin(ca.vertcat(*(each.uprightness for each in contacts))), 1))
    results = [*_equilibrium_terms(q.mechanics), *angles, q.tip_over_margin, lean]
    f = lookup_function(q.lookups.lookups, "hold", [pack(x), pack(z)], results)

    def describe(x: Array, z: Array) -> str:
        """Return slope and reason of a missing equilibrium, for the stop of a motion."""
        matrix, load, friction, *rest = (np.array(each) for each in f(x, z))
        slope, aside, margin, lean = (float(each.item()) for each in rest)
        if not all(np.isfinite(each).all() for each in (matrix, load, friction)):
            return ""
        factor = float(least_utilisation(matrix[None], load.T, friction.T).utilisation[0])
        place = "on level ground"
        if slope > MAX_LEVEL_SLOPE:
            place = (
                f"headed {np.degrees(aside):.0f} degrees from uphill on a slope of "
                f"{np.degrees(slope):.1f} degrees,"
            )
        words = _friction_words(factor, friction, tips=margin < 0)
        leans = f"; a wheel leans by {lean:.3g} rad" if lean > MAX_UPRIGHT_LEAN else ""
        return f"{place} {words}{leans}" if words else ""

    return describe


def _friction_words(factor: float, friction: Array, *, tips: bool) -> str:
    """Return the reason why there is no quasi-static equilibrium; empty if friction suffices.

    ``factor`` is the least utilisation, ``friction`` the wheels' coefficients of friction. The text
    is empty also if ``factor`` is NaN.
    """
    if tips:
        return "the vehicle tips over"
    if np.isinf(factor):
        return (
            "no contact forces balance the vehicle: a wheel without drive or a passive joint is "
            "free to move"
        )
    low, high = friction.min(), friction.max()
    even = high - low < 1e-9 * high
    offered = f"{low:.4g}" if even else f"{low:.4g} to {high:.4g}"
    if not factor >= MAX_HELD_UTILISATION:  # also for NaN
        return ""
    if factor < MAX_EXHAUSTED_UTILISATION:
        return f"the vehicle needs all the friction that the ground offers, {offered}"
    needed = (
        f"a coefficient of friction of at least {factor * low:.4g}"
        if even
        else f"{factor:.4g} times the friction of the ground"
    )
    return f"the vehicle needs {needed}, the ground offers {offered}"
