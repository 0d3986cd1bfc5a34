"""Inverse kinematics of any vehicle: the rates of wheels and joints for some rates of its platform.

Vehicles that cannot roll without slip, or have more inputs than the platform has freedoms, are
given a subset of the platform's rates in its heading frame: by default forward speed and yaw rate.
They are met exactly, or with the least error where
the steering angles do not allow them. Two things follow.

Steering, at the level of positions: of all motions of the platform that have the given rates and
that the ground admits, the one at which wheels that are not steered slip least across themselves
guides the steered ones. Each is turned until the point of its carrier at the contact moves along
it, which on level ground is the rule of the instantaneous centre. As rates of the steering are
inputs, they follow these angles with a lag (`GAIN`, `FASTEST`): the rates of the angles themselves
would need third derivatives of the ground. Targets and rates keep to the joints' stops and
`max_rate`. Where all three rates are given, and not all wheels steered, other angles may slip less.

Rates of the driven wheels, exact: those of least slip among all that make the direct model move as
is given. The direct model's own equations, least slip under its inputs, are constraints. So the
answer round-trips, exactly and whatever the steering does: its lag costs slip, not accuracy.
Without these constraints it would not: the least slip of a given motion is in general not the
motion of least slip under given inputs.

Rates of the driven wheels, nearest: the least of squared slip along them in the guiding motion and
of `ERROR_WEIGHT` times the squared errors of the given rates, subject to the same equations. On
ground where the wheels can roll along the guiding motion both vanish. Else the weight is a
compromise: the Open Source Rover, whose middle wheels do not steer, misses 0.3 m/s forward and 0.1
m/s to the right by 0.031, 0.023 and 0.007 m/s if it is 10, 100 and 1000, and its wheels slip by
0.05, 0.08 and 0.18 m/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae, Labels
from slipfree.geometry.frame import Pose
from slipfree.laws.least_slip import slip_unit
from slipfree.models.base import extent, values_of
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.reach import (
    DEFAULT,
    SUBSET,
    ReachMargin,
    check_given,
    planar_rates,
    response_matrices,
    response_of,
)
from slipfree.models.records import (
    Algebraic,
    Dependent,
    Forces,
    Outputs,
    Rates,
)
from slipfree.rearrange import rearranged_checks
from slipfree.records import Label, leaves, pack, symbols, unpack
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Coordinate, Kind, Vehicle

GAIN = 5.0  # at which the error of a steering angle decays [1/s]
FASTEST = 1.0  # rate of a steered joint without max_rate that the law asks for at most [rad/s, m/s]
STOP_CLEARANCE = 1e-4  # between a stop and the target of a steered coordinate [rad, m]
STILL = 1e-4  # speed of a wheel below which it is not steered [size/s]
LOOSE = {"forward": 1e-8, "right": 1e-8, "yaw_rate": 1e-3}  # weights of rates not given [1]
ERROR_WEIGHT = 10.0  # of errors of the given rates beside slip along the wheels [1]
BRANCH = 0.2  # beyond a right angle, of the largest steering error to the right [rad]
NEAR = 1e-9  # effect of a joint on a wheel's direction that is none [1, 1/m]


class Wanted(NamedTuple):
    """Inputs: the given rates of the platform. [m/s, rad/s]."""

    platform: tuple[Any, ...]


class Guide(NamedTuple):
    """The motion that guides the steering, and multipliers. [m/s, rad/s].

    ``motion`` are rates of the pose and of the suspension; ``contacts`` and ``given`` multipliers
    that keep wheels on the ground and the given rates. Passive joints are held, and wheels that
    they swivel do not count.
    """

    motion: tuple[Any, ...]
    contacts: tuple[Any, ...]
    given: tuple[Any, ...]


class SubsetRates(NamedTuple):
    """Rates that follow from the given ones. [m/s, rad/s].

    ``motion`` are those of the direct model, ``wheels`` its inputs at the driven wheels. With
    them come multipliers of the direct model's equations and of the given rates.
    """

    motion: Rates
    wheels: tuple[Any, ...]
    direct: tuple[Any, ...]
    given: tuple[Any, ...]


class Found(NamedTuple):
    """Algebraic unknowns in the blocks that determine them, of a vehicle with steered wheels."""

    position: Dependent
    guide: Guide
    rates: SubsetRates
    forces: Forces


class SubsetOutputs(NamedTuple):
    """What else is sampled.

    ``platform`` are the platform's rates that are not given, ``joints`` the rates of commanded
    coordinates, ``errors`` the angles by which steered ones are off. ``missed`` are the errors of
    the given rates, given minus actual, unless they are met exactly. [m/s, rad/s, rad]
    """

    direct: Outputs
    platform: tuple[Any, ...]
    joints: tuple[Any, ...]
    errors: tuple[Any, ...]
    missed: tuple[Any, ...]


def subset_kinematics(
    vehicle: Vehicle,
    terrain: Terrain,
    *,
    given: Sequence[str] = DEFAULT,
    exact: bool = True,
) -> Dae:
    """Return the motion of any vehicle under given rates of its platform.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle. Commanded coordinates that turn wheels about the platform's up axis are
        steered; others are held.
    terrain : Terrain
        The ground; contacts keep to its domain.
    given : sequence of str
        Of ``forward``, ``right`` and ``yaw_rate``: velocity of the platform's centre over the map
        along its heading and across it, rate of the heading. All three are seldom free of slip
        where wheels are not steered.
    exact : bool
        Whether the rates are met exactly; otherwise their errors ``forward_error`` and so on,
        given minus actual, are outputs, and as small as wheel rates close to those of rolling
        make them.

    Returns
    -------
    Dae
        Inputs are the given rates: constants, one value an interval or expressions of time. If
        exact, it ends where the wheels hardly bring them about: see
        `slipfree.models.reach.ReachMargin`.

    Raises
    ------
    ModelError
        If a rate is not known or given twice, or, if exact, they are more than the driven wheels.
    """
    given = tuple(given)
    check_given(vehicle, given, exact=exact)
    direct: Dae = direct_kinematics(vehicle, terrain)
    u = Wanted(tuple(ca.SX.sym(name) for name in given))
    plane = planar_rates(direct)
    guide, guide_labels, guiding = _guide(vehicle, direct, given, u, always=not exact)
    errors = _steering_errors(vehicle, direct, guide)
    joints = _laws(vehicle, errors)
    off = [value - plane[name] for name, value in zip(given, u.platform, strict=True)]
    sizes = [extent(vehicle) if name == "yaw_rate" else 1.0 for name in given]
    if exact:
        goal, conditions = _slip(direct), [-each for each in off]
    else:
        goal, conditions = _departure(direct, guide, off, sizes), []
    rates, rate_labels, balance = _rates(direct, given, goal, conditions)
    dae = replace(
        direct,
        z=_blocks(direct.z, guide, rates),
        u=u,
        alg=(direct.alg[0], *guiding, balance, direct.alg[2]),
        y=SubsetOutputs(
            direct.y,
            tuple(plane[name] for name in SUBSET if name not in given),
            direct.u.joints,
            tuple(errors.values()),
            () if exact else tuple(off),
        ),
        labels=_labels(direct.labels, given, guide_labels, rate_labels, tuple(errors), exact),
        **_starting(direct, guide_labels, rate_labels),
    )
    dae = _driven(dae, direct.u.joints, tuple(joints))
    checks = rearranged_checks(direct, dae)
    if not exact:  # rates jump where a wheel turns back, which no error test would pass
        return replace(dae, checks=checks, suppress_algebraic=True)
    response = response_of(vehicle, direct, given)
    matrices = response_matrices(direct, given)
    states = direct.function("matrices", [pack(dae.x), pack(dae.z)], matrices)
    margin = ReachMargin(response, states)
    return replace(dae, checks=(*checks, margin))


def _blocks(z: Any, guide: Guide | tuple[()], rates: Any) -> Any:
    """Return the unknowns of the direct model with other rates, or their labels."""
    if not guide:
        return Algebraic(z.position, rates, z.forces)
    return Found(z.position, guide, rates, z.forces)


def steered(vehicle: Vehicle, direct: Dae, kind: Kind = "commanded") -> dict[str, dict[int, ca.SX]]:
    """Return how much coordinates of a kind turn wheels, by the wheels' numbers.

    About the platform's up axis, left positive; only coordinates that turn some. [rad/rad, rad/m]
    """
    values = values_of(vehicle, direct.x, direct.z.position)
    poses = vehicle.carriers(Pose(ca.SX.eye(3), ca.SX.zeros(3)), values)
    angles = ca.vertcat(*(ca.atan2(pose.rotation[1, 0], pose.rotation[0, 0]) for pose in poses))
    column, found = ca.vertcat(*values.values()), dict[str, dict[int, ca.SX]]()
    for c in vehicle.of(kind):
        effect = ca.jacobian(angles, values[c.name])
        level = ca.evalf(ca.substitute(effect, column, ca.SX.zeros(column.shape)))
        turned = np.flatnonzero(np.abs(np.array(level)) > NEAR)
        if turned.size:
            found[c.name] = {k: effect[k] for k in map(int, turned)}
    return found


def _guide(
    vehicle: Vehicle, direct: Dae, given: tuple[str, ...], u: Wanted, *, always: bool
) -> tuple[Any, Any, list[ca.SX]]:
    """Return unknowns, labels and equations of the guiding motion; none if nothing is steered."""
    by_drives = steered(vehicle, direct)
    if not by_drives and not always:
        return (), (), []
    castors = steered(vehicle, direct, "passive")
    turned = {k for effects in (*by_drives.values(), *castors.values()) for k in effects}
    rates, names = direct.z.rates, direct.labels.z.rates
    labels = Guide(
        tuple(replace(label, name=f"guide_{label.name}") for label in _motion(names)),
        tuple(replace(label, name="guide_multiplier") for label in names.law.multipliers),
        tuple(
            Label(f"guide_multiplier_{name}", slip_unit(SUBSET[name].unit), SUBSET[name].words)
            for name in given
        ),
    )
    guide = symbols(labels)
    across = [slip for k, slip in enumerate(direct.y.slip_across) if k not in turned]
    plane = planar_rates(direct)
    sizes = {"yaw_rate": direct.size}
    loose = [LOOSE[name] * (sizes.get(name, 1.0) * rate) ** 2 for name, rate in plane.items()]
    count = len(rates.law.multipliers)
    lagrangian = 0.5 * sum((*loose, *(slip**2 for slip in across)))
    lagrangian += ca.dot(pack(guide.contacts), direct.alg[1][-count:])
    for multiplier, name, value in zip(guide.given, given, u.platform, strict=True):
        lagrangian += multiplier * (plane[name] - value)
    (lagrangian,) = _guided(direct, guide, [lagrangian])
    return guide, labels, [ca.gradient(lagrangian, pack(guide))]


def _motion(rates: Any) -> tuple[Any, ...]:
    """Return rates of pose and suspension, or their labels."""
    return (*rates[:6], *rates.suspension)


def _guided(direct: Dae, guide: Guide, expressions: list[ca.SX]) -> list[ca.SX]:
    """Return expressions of the guiding motion, with wheels and joints at rest."""
    rates = direct.z.rates
    still = pack((direct.u, rates.free, rates.passive))
    found = ca.substitute(expressions, [still], [ca.SX.zeros(still.shape)])
    slots = ca.vertcat(*_motion(rates))
    return list(ca.substitute(found, [slots], [pack(guide.motion)]))


def _steering_errors(vehicle: Vehicle, direct: Dae, guide: Any) -> dict[str, ca.SX]:
    """Return by how much steered coordinates are short of the guiding motion. [rad, m].

    Carriers move with ``along`` and ``across`` at the contacts of the wheels that a coordinate
    turns; near the end this is the step that makes ``across`` least. Angles are doubled, since
    forward or backward is the same, so that wheels that disagree by more than a right angle do not
    cancel. Errors lie within a right angle either way, shifted by `BRANCH`, so that all wheels turn
    the same way for a motion straight across them.
    """
    errors = {}
    values = values_of(vehicle, direct.x, direct.z.position)
    coordinates = {c.name: c for c in vehicle.coordinates}
    for name, effects in steered(vehicle, direct).items():
        wheels = [(direct.y.slip_along[k], direct.y.slip_across[k]) for k in effects]
        moving = iter(_guided(direct, guide, [part for wheel in wheels for part in wheel]))
        sine, cosine = ca.SX(0), ca.SX((STILL * direct.size) ** 2)
        for effect, along, across in zip(effects.values(), moving, moving, strict=True):
            sine -= 2 * effect * along * across
            cosine += effect**2 * (along**2 - across**2)
        c, s = np.cos(2 * BRANCH), np.sin(2 * BRANCH)
        error = ca.atan2(c * sine + s * cosine, c * cosine - s * sine) / 2 - BRANCH
        errors[name] = _within_stops(coordinates[name], values[name], error)
    return errors


def _within_stops(c: Coordinate, value: ca.SX, error: ca.SX) -> ca.SX:
    """Return the error of a steered coordinate whose target is moved to within its stops.

    A wheel may as well point backward, half a turn away; if that is beyond the stops too, the
    target is the nearer stop.
    """
    if not (np.isfinite(c.lower) or np.isfinite(c.upper)):
        return error
    clearance = min(STOP_CLEARANCE, (c.upper - c.lower) / 4)
    low, high = c.lower + clearance - value, c.upper - clearance - value
    reverse = error - ca.pi * ca.sign(error)
    is_reversed = ca.logic_and(
        _outside(error, low, high), ca.logic_not(_outside(reverse, low, high))
    )
    return ca.fmin(ca.fmax(ca.if_else(is_reversed, reverse, error), low), high)


def _outside(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    return ca.logic_or(value < low, value > high)


def _laws(vehicle: Vehicle, errors: Mapping[str, ca.SX]) -> tuple[ca.SX, ...]:
    """Return the rates of all commanded coordinates. [rad/s, m/s]."""
    fastest = {
        c.name: c.max_rate if np.isfinite(c.max_rate) else FASTEST for c in vehicle.of("commanded")
    }
    return tuple(
        rate * ca.tanh(GAIN / rate * errors.get(name, ca.SX(0))) for name, rate in fastest.items()
    )


def _slip(direct: Dae) -> Any:
    """Return half the squared slip of all wheels. [m2/s2]."""
    return 0.5 * sum(slip**2 for slip in (*direct.y.slip_along, *direct.y.slip_across))


def _departure(direct: Dae, guide: Guide, off: Sequence[ca.SX], sizes: Sequence[float]) -> Any:
    """Return half the squared slip along driven wheels in the guiding motion, and of its errors.

    Of both, the latter are weighed. Where wheels cannot point along the guiding motion, this
    bounds how far they spin beyond the rates without slip along: by half the root of the weight
    times the error. [m2/s2]
    """
    along, wheels = ca.vertcat(*direct.y.slip_along), ca.vertcat(*direct.u.wheels)
    turning = ca.jacobian(along, wheels)
    driven = [k for k in range(along.numel()) if turning[k, :].nnz()]
    moving = ca.vertcat(*_guided(direct, guide, ca.vertsplit(along)))
    slip = (moving + turning @ wheels)[driven]
    errors = ca.vertcat(*(size * error for size, error in zip(sizes, off, strict=True)))
    return 0.5 * (ca.sumsqr(slip) + ERROR_WEIGHT * ca.sumsqr(errors))


def _rates(
    direct: Dae, given: tuple[str, ...], goal: ca.SX, conditions: Sequence[ca.SX]
) -> tuple[SubsetRates, SubsetRates, ca.SX]:
    """Return unknown rates, their labels, and the conditions for the least value of a goal."""
    names, equations = direct.labels.z.rates, direct.alg[1]
    labels = SubsetRates(
        names,
        direct.labels.u.wheels,
        tuple(replace(label, name=f"response_{label.name}") for label in leaves(names)),
        tuple(
            Label(
                f"multiplier_{name}",
                slip_unit(SUBSET[name].unit),
                f"multiplier of the given rate {name}: no rates of the driven wheels bring it "
                "about here beside the others; leave it out",
            )
            for name in (given if conditions else ())
        ),
    )
    other = symbols(labels)
    rates = other._replace(motion=direct.z.rates, wheels=direct.u.wheels)
    lagrangian = goal + ca.dot(pack(rates.direct), equations)
    lagrangian += sum((m * c for m, c in zip(rates.given, conditions, strict=True)), ca.SX(0))
    return rates, labels, ca.gradient(lagrangian, pack(rates))


def _labels(
    labels: Labels,
    given: tuple[str, ...],
    guide: Guide | tuple[()],
    rates: SubsetRates,
    errors: tuple[str, ...],
    exact: bool,
) -> Labels:
    """Return the labels of the model."""
    units = {label.name: label.unit for label in labels.x.joints}
    words = {label.name: label.words for label in labels.x.joints}
    outputs = SubsetOutputs(
        labels.y,
        tuple(label for name, label in SUBSET.items() if name not in given),
        labels.u.joints,
        tuple(
            Label(f"{name}_error", units[name], f"what is missing of the {words[name]}")
            for name in errors
        ),
        ()
        if exact
        else tuple(
            replace(SUBSET[name], name=f"{name}_error", words=f"error of the given {name}")
            for name in given
        ),
    )
    guiding, balance = (
        tuple(
            Label(name, slip_unit(label.unit), f"{what} with respect to {label.full}")
            for label in leaves(record)
        )
        for name, what, record in (
            ("guide", "least slip across wheels that are not steered", guide),
            ("inverse", "least slip at the given rates", rates),
        )
    )
    return labels._replace(
        z=_blocks(labels.z, guide, rates),
        u=Wanted(tuple(SUBSET[name] for name in given)),
        y=outputs,
        alg=(labels.alg[0], *([guiding] if guiding else []), balance, labels.alg[2]),
    )


def _starting(direct: Dae, guide: Any, rates: Any) -> dict[str, Any]:
    """Return guess, sizes and shift: what is new begins at zero."""
    position, motion = (len(list(leaves(part))) for part in direct.z[:2])
    before, end = len(list(leaves(guide))), position + motion
    after = len(list(leaves(rates))) - motion
    where = [position] * before + [end] * after
    return {
        "guess": ca.densify(
            ca.vertcat(
                direct.guess[:position],
                ca.SX.zeros(before),
                direct.guess[position:end],
                ca.SX.zeros(after),
                direct.guess[end:],
            )
        ),
        "scale": np.insert(direct.scale, where, 1.0),
        "shift": (direct.shift[0], np.insert(direct.shift[1], where, 0.0)),
    }


def _driven(dae: Dae, joints: tuple[ca.SX, ...], laws: tuple[ca.SX, ...]) -> Dae:
    """Return the model with laws in place of the rates of the commanded joints."""
    symbols_, law = pack(joints), ca.vertcat(ca.SX(0, 1), *laws)

    def put(expression: ca.SX) -> ca.SX:
        return ca.substitute(expression, symbols_, law)

    return replace(
        dae,
        ode=put(dae.ode),
        alg=tuple(put(rows) for rows in dae.alg),
        quad=put(dae.quad),
        y=unpack(dae.y, [put(each) for each in leaves(dae.y)]),
        limits=tuple(limit._replace(expression=put(limit.expression)) for limit in dae.limits),
    )
