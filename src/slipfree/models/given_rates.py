"""Given rates of the platform in inverse models: equations, steering, and determinacy.

The guiding motion is the motion of the platform with the given rates, among those that the ground
permits, in which the wheels that are not steered slip least sideways. Each steered wheel is
turned until its contact point has no velocity across the wheel; on level ground this is the rule of
the instantaneous centre of rotation. Steering rates follow the target angles with a lag
(`GAIN`, `MAX_STEERING_RATE`): the exact rates of the targets would need third derivatives of the
ground. Targets and rates respect the joints' stops and `max_rate`. Where all three rates are given
and some wheels are not steered, other angles may have less slip.

Determinacy is measured by singular values of the linear equations. Slip is linear in all rates. A
vehicle that rolls without slip obeys ``A r = 0``, with three rows per wheel. With some of the
platform's rates given, the columns of the other rates form a square matrix. Its smallest singular
value measures how well the given rates determine the others; the singular vectors show which ones
they do not determine. Where steering angles are unknown, the derivative of the slip with respect to
an angle replaces the column of its rate.

All columns are scaled to slip velocities: angular rates of the platform by its extent, rates of
wheels and joints by the rolling radius, and a steering angle by the speed of the platform per
0.3 rad.

Under commands, vehicles slip, and the rates of the driven wheels act through the direct model of
least slip. The matrix is then the effect of the wheel rates on the given rates, scaled to
velocities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError, check_known
from slipfree.core.quantities import quantity_label
from slipfree.core.rearrange import ModelVariable, new_variable, variables
from slipfree.core.records import Array, Label, leaves, pack
from slipfree.core.trajectory import Trajectory
from slipfree.laws.least_slip import LeastSlip, slip_unit
from slipfree.laws.rolling import Rolling, check_rolling_counts, rolling_counts
from slipfree.models.base import extent
from slipfree.vehicle.tree import Coordinate, Kind, Vehicle

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
EULER = ("heading_rate", "roll_rate", "pitch_rate")
OMEGA = ("omega_x", "omega_y", "omega_z")
RATES = (*VELOCITY, *OMEGA, *EULER)  # of the platform in map axes
PLANAR = ("velocity_x", "velocity_y", "heading_rate")
COMMANDS = {name: quantity_label(name) for name in ("forward", "right", "yaw_rate")}
ROBOT = {"v_x": "forward", "v_y": "right", "omega_z": "yaw_rate"}  # REP 103: v_y to the left
UNITS = {name: "m s-1" if name in VELOCITY else "rad s-1" for name in RATES}
UNITS |= {name: label.unit for name, label in COMMANDS.items()}
UNITS |= {name: UNITS[ours] for name, ours in ROBOT.items()}  # of all rates that may be given
SolveFor = Literal["rates", "angles"]
MAX_CONDITION = 1e9  # condition numbers above this one are those of singular matrices
LEAST_MARGIN = 1e-3  # smallest singular value at which the given rates determine the unknowns
GAIN = 5.0  # decay rate of the error of a steering angle [1/s]
MAX_STEERING_RATE = 1.0  # largest rate of a steered joint without max_rate [rad/s, m/s]
STOP_CLEARANCE = 1e-4  # distance between a stop and the target of a steered coordinate [rad, m]
MIN_WHEEL_SPEED = 1e-4  # speed of a wheel below which it is not steered [size/s]
FREE_RATE_WEIGHTS = {"forward": 1e-8, "right": 1e-8, "yaw_rate": 1e-3}  # of rates not given [1]
BRANCH_SHIFT = 0.2  # steering errors lie between -pi/2 - shift and pi/2 - shift [rad]
MIN_EFFECT = 1e-9  # a joint with a smaller effect on a wheel's direction does not steer [1, 1/m]


class Derived(NamedTuple):
    """Platform rate that is an expression of the direct model's states and unknowns."""

    label: Label
    expression: ca.SX


class Imposed(NamedTuple):
    """Equations of a direct model in which given rates of the platform are inputs.

    ``rates`` are the unknown rates that are not given; ``rows`` the equations of the direct model,
    and one for each given rate that is not among its unknowns.
    """

    inputs: tuple[ModelVariable, ...]
    rates: tuple[ModelVariable, ...]
    rows: ca.SX
    labels: tuple[Label, ...]


def impose(direct: Dae, given: Sequence[str]) -> Imposed:
    """Return the equations of a direct model in which given rates of its platform are inputs."""
    rates = {each.label.full: each for each in leaves(variables(direct)[1].rates)}
    derived = derived_rates(direct)
    inputs, rows, labels = [], [direct.alg[1]], [*direct.labels.alg[1]]
    for name in given:
        if name in rates:
            inputs.append(rates.pop(name))
            continue
        label, expression = derived[name]
        inputs.append(new_variable(direct, label))
        rows.append(expression - inputs[-1].symbol)
        labels.append(replace(label, name=f"{name}_law"))
    return Imposed(tuple(inputs), tuple(rates.values()), ca.vertcat(*rows), tuple(labels))


def derived_rates(direct: Dae) -> dict[str, Derived]:
    """Return platform rates as expressions of a direct model's states and unknowns, by name.

    These are the components of the angular velocity in map axes, the velocity along and across the
    heading, and the yaw rate.
    """
    rates, c, s = direct.z.rates, ca.cos(direct.x.heading), ca.sin(direct.x.heading)
    euler = ca.vertcat(rates.heading, rates.roll, rates.pitch)
    turning = omega(direct.x.heading, direct.named("roll")[0]) @ euler
    words = "angular velocity of the platform about"
    labels = {name: Label(name, "rad s-1", f"{words} {name[-1]}") for name in OMEGA}
    planar = [c * rates.y - s * rates.x, c * rates.x + s * rates.y, rates.heading]
    both = zip((labels | COMMANDS).items(), (*ca.vertsplit(turning), *planar), strict=True)
    return {name: Derived(label, expression) for (name, label), expression in both}


def omega(heading: ca.SX, roll: ca.SX) -> ca.SX:
    """Return the matrix that maps Euler rates to the angular velocity in map axes, shape (3, 3).

    The Euler rates are ``heading', roll', pitch'``; see Chakraborty and Ghosal, eq. 4.
    """
    return ca.vertcat(
        ca.horzcat(0, -ca.sin(heading), ca.cos(roll) * ca.cos(heading)),
        ca.horzcat(0, ca.cos(heading), ca.cos(roll) * ca.sin(heading)),
        ca.horzcat(1, 0, -ca.sin(roll)),
    )


class Minimum(NamedTuple):
    """Conditions for a minimum under constraints, one for each variable and each multiplier."""

    unknowns: tuple[ModelVariable, ...]
    rows: ca.SX
    labels: tuple[Label, ...]


def minimum(
    direct: Dae,
    goal: ca.SX,
    constraints: ca.SX,
    unknowns: Sequence[ModelVariable],
    multipliers: Sequence[Label],
    label: Label,
) -> Minimum:
    """Return the conditions for the minimum of an objective under equality constraints.

    ``constraints`` are expressions that vanish at the minimum, ``multipliers`` the labels of their
    multipliers; ``label`` is the name of the conditions, and the beginning of their descriptions.
    """
    new = tuple(new_variable(direct, each) for each in multipliers)
    variables = (*unknowns, *new)
    prices, column = (pack(tuple(each.symbol for each in part)) for part in (new, variables))
    labels = tuple(
        replace(
            label,
            unit=slip_unit(each.label.unit),
            words=f"{label.words} with respect to {each.label.full}",
        )
        for each in variables
    )
    return Minimum(variables, ca.gradient(goal + ca.dot(prices, constraints), column), labels)


class GivenRates(NamedTuple):
    """Given rates of the platform, and the unknowns of the inverse model.

    ``names`` are either commands, some of `COMMANDS`, or three of `RATES`; the other fields are
    arguments of `slipfree.inverse_kinematics`.
    """

    names: Sequence[str]
    solve_for: SolveFor = "angles"
    exact: bool = True
    least_margin: float = LEAST_MARGIN

    @property
    def are_commands(self) -> bool:
        """Whether the rates are commands of the platform."""
        return not self.names or bool(set(self.names) & set(COMMANDS))

    @property
    def slip(self) -> LeastSlip | Rolling:
        """Slip law of the direct model: least slip for commands, rolling for three rates."""
        return LeastSlip() if self.are_commands else Rolling()

    def check(self, vehicle: Vehicle) -> None:
        """Raise ModelError if a vehicle has no inverse model for the rates."""
        if self.are_commands:
            _check_commands(self, vehicle)
        else:
            _check_rates(self, vehicle)


def _check_rates(given: GivenRates, vehicle: Vehicle) -> None:
    """Raise ModelError unless three different rates are given to a vehicle that rolls."""
    names, commands = given.names, ", ".join(COMMANDS)
    if len(names) != 3 or len(set(names)) != 3:
        is_repeated = len(set(names)) != len(names)
        remedy = "give each name once" if is_repeated else "give three rates"
        raise ModelError(
            f"given: expected a list of three different names from {', '.join(RATES)}, or of one "
            f"or more names from {commands}, found {names!r}; {remedy}"
        )
    check_known("given", names, RATES, "three of")
    if set(names) & set(OMEGA) and set(names) & set(EULER):
        raise ModelError(
            f"given: expected components of the angular velocity ({', '.join(OMEGA)}) or Euler "
            f"rates ({', '.join(EULER)}), not both, found {', '.join(names)}; replace those of one "
            "kind by the other kind"
        )
    instead = f"give one or more of {commands} instead"
    purpose = f", as inverse kinematics with the rates {', '.join(names)} requires"
    check_rolling_counts(vehicle, purpose, instead)
    if len(inputs := _inputs(vehicle)) != 3:
        raise ModelError(
            f"{vehicle.name!r}: expected three inputs (driven wheels and commanded coordinates) "
            f"for three given rates of the platform, found {len(inputs)}: {', '.join(inputs)}; "
            f"{instead}"
        )
    if given.solve_for == "angles" and not vehicle.of("commanded"):
        raise ModelError(
            "solve_for: expected a vehicle with a commanded coordinate for 'angles', found none "
            f"in {vehicle.name!r}; use 'rates'"
        )


def _check_commands(given: GivenRates, vehicle: Vehicle) -> None:
    """Raise ModelError if a vehicle cannot follow the given commands.

    Commands must be known, different and, if exact, no more than the driven wheels. ``right`` must
    be among them if all driven wheels have rollers. Commands determine steering angles, so that
    ``solve_for`` must be ``"angles"``; ``"rates"`` is for three given rates.
    """
    names, exact, found = given.names, given.exact, ", ".join(given.names)
    check_known("given", names, COMMANDS, "only names from")
    if not names or len(set(names)) != len(names):
        raise ModelError(
            f"given: expected one or more different rates, found {found or 'none'}; "
            f"give one or more of {', '.join(COMMANDS)}, each once"
        )
    driven = [wheel for wheel in vehicle.wheels if wheel.driven]
    if not driven and (exact or "right" not in names):
        raise ModelError(
            f"{vehicle.name!r}: expected at least one driven wheel to impose the given rates, "
            "found none; set 'driven' of its wheels"
        )
    if "right" not in names and all(wheel.rollers for wheel in driven):
        raise ModelError(
            f"{vehicle.name!r}: expected the given rate 'right', the speed to the right, since "
            "all driven wheels have rollers and the vehicle can move sideways, found only "
            f"{found}; add 'right' with the value 0 to drive straight"
        )
    if exact and len(names) > len(driven):
        raise ModelError(
            f"{vehicle.name!r}: expected no more given rates than driven wheels ({len(driven)}), "
            f"found {len(names)}: {found}; remove "
            f"'{'right' if 'right' in names else names[-1]}', or set exact = false for the nearest "
            "motion"
        )
    if given.solve_for != "angles":
        raise ModelError(
            f"solve_for: expected 'angles' with the commands {found}, found 'rates'; use 'angles'"
        )


def is_determined(vehicle: Vehicle) -> bool:
    """Return whether a vehicle can roll without slip and has three inputs."""
    count, need = rolling_counts(vehicle)
    return count == need and len(_inputs(vehicle)) == 3


def _inputs(vehicle: Vehicle) -> list[str]:
    driven = [wheel.name for wheel in vehicle.wheels if wheel.driven]
    return driven + [c.name for c in vehicle.of("commanded")]


def steering_effects(direct: Dae, kind: Kind = "commanded") -> dict[str, dict[int, ca.SX]]:
    """Return the effects of coordinates of a model; see `turning_effects`."""
    values = {c.name: direct.named(c.name)[0] for c in direct.vehicle.coordinates}
    return turning_effects(direct.vehicle, values, kind)


def turning_effects(
    vehicle: Vehicle, values: Mapping[str, ca.SX], kind: Kind
) -> dict[str, dict[int, ca.SX]]:
    """Return the effects of coordinates of a kind on the directions of wheels.

    The result maps names of coordinates to effects by wheel number, the derivatives of the wheel's
    direction: its angle about the platform's up axis, positive to the left. Coordinates without
    effect are omitted. ``values`` are symbols of coordinates by name, zero if omitted.
    [rad/rad, rad/m]
    """
    poses = vehicle.carriers(values=values)
    angles = ca.vertcat(*(ca.atan2(pose.rotation[1, 0], pose.rotation[0, 0]) for pose in poses))
    column, effects = ca.vertcat(ca.SX(0, 1), *values.values()), dict[str, dict[int, ca.SX]]()
    for c in vehicle.of(kind):
        effect = ca.jacobian(angles, values[c.name])
        level = ca.evalf(ca.substitute(effect, column, ca.SX.zeros(column.shape)))
        turned = np.flatnonzero(np.abs(np.array(level)) > MIN_EFFECT)
        if turned.size:
            effects[c.name] = {k: effect[k] for k in map(int, turned)}
    return effects


def guiding_motion(
    direct: Dae, inputs: Sequence[ModelVariable]
) -> tuple[Minimum, tuple[ModelVariable, ...]]:
    """Return the conditions of the guiding motion, and its unknown rates of pose and suspension.

    It has the least sideways slip of unsteered wheels under given rates. Passive joints are fixed;
    wheels that swivel on passive joints are ignored. Wheels on rollers do not count. ``inputs`` are
    the given rates.
    """
    kinds: tuple[Kind, ...] = ("commanded", "passive")
    turning = (steering_effects(direct, kind).values() for kind in kinds)
    ignored = {k for effects in turning for each in effects for k in each}
    names, plane = direct.labels.z.rates, derived_rates(direct)
    given = [each.label.name for each in inputs]
    motion = tuple(
        new_variable(direct, replace(label, name=f"guide_{label.name}"))
        for label in (*names[:6], *names.suspension)  # of the pose first
    )
    multipliers = [replace(label, name=f"guide_{label.name}") for label in names.law.multipliers]
    multipliers += [
        Label(f"guide_multiplier_{name}", slip_unit(COMMANDS[name].unit), COMMANDS[name].words)
        for name in given
    ]
    # at its proper rate, a wheel on rollers meets every motion: its slip at rest does not count
    ignored |= {k for k, wheel in enumerate(direct.vehicle.wheels) if wheel.rollers}
    across = [slip for k, slip in enumerate(direct.y.slip_across) if k not in ignored]
    # small weights determine the rates that are not given
    sizes = zip(COMMANDS, command_sizes(direct.vehicle, [*COMMANDS]), strict=True)
    loose = [FREE_RATE_WEIGHTS[name] * (size * plane[name].expression) ** 2 for name, size in sizes]
    goal = 0.5 * ca.sum1(ca.vertcat(*loose, *(slip**2 for slip in across)))
    touching = direct.alg[1][-len(names.law.multipliers) :]  # the wheels keep their contacts
    missed = [
        plane[name].expression - each.symbol for name, each in zip(given, inputs, strict=True)
    ]
    goal, *rows = guided(direct, motion, [goal, touching, *missed])
    label = Label("guide", "", "least sideways slip of wheels that are not steered")
    return minimum(direct, goal, ca.vertcat(*rows), motion, multipliers, label), motion


def guided(
    direct: Dae, motion: Sequence[ModelVariable], expressions: Sequence[ca.SX]
) -> list[ca.SX]:
    """Return expressions with the rates of the guiding motion; wheels and joints are at rest."""
    rates = direct.z.rates
    still = pack((direct.u, rates.free, rates.passive))
    moving = ca.substitute([*expressions], [still], [ca.SX.zeros(still.shape)])
    symbols = ca.vertcat(*(each.symbol for each in motion))
    return list(ca.substitute(moving, [ca.vertcat(*rates[:6], *rates.suspension)], [symbols]))


def steering_errors(direct: Dae, motion: Sequence[ModelVariable]) -> dict[str, ca.SX]:
    """Return the errors of steered coordinates, target minus actual value, by name [rad, m].

    Small errors are Gauss-Newton steps that minimise the velocity ``across`` the wheels. The
    formula uses doubled angles, since a wheel may roll forward or backward. Errors lie in an
    interval of half a turn, shifted by `BRANCH_SHIFT` from zero: all wheels then turn in the same
    direction if the required motion is perpendicular to them.
    """
    errors, vehicle = {}, direct.vehicle
    values = {c.name: direct.named(c.name)[0] for c in vehicle.coordinates}
    coordinates = {c.name: c for c in vehicle.coordinates}
    for name, effects in steering_effects(direct).items():
        effects = {k: e for k, e in effects.items() if not vehicle.wheels[k].rollers}
        if not effects:
            continue
        wheels = [(direct.y.slip_along[k], direct.y.slip_across[k]) for k in effects]
        moving = iter(guided(direct, motion, [part for wheel in wheels for part in wheel]))
        sine, cosine = ca.SX(0), ca.SX((MIN_WHEEL_SPEED * direct.size) ** 2)
        for effect, along, across in zip(effects.values(), moving, moving, strict=True):
            sine -= 2 * effect * along * across
            cosine += effect**2 * (along**2 - across**2)
        c, s = np.cos(2 * BRANCH_SHIFT), np.sin(2 * BRANCH_SHIFT)
        error = ca.atan2(c * sine + s * cosine, c * cosine - s * sine) / 2 - BRANCH_SHIFT
        errors[name] = _within_stops(coordinates[name], values[name], error)
    return errors


def _within_stops(c: Coordinate, value: ca.SX, error: ca.SX) -> ca.SX:
    """Return the error of a steered coordinate, with its target moved between the stops.

    If the target is beyond a stop, the wheel turns to the opposite direction, half a turn away. If
    that is beyond a stop too, the target is the nearer stop.
    """
    if not (np.isfinite(c.lower) or np.isfinite(c.upper)):
        return error
    clearance = min(STOP_CLEARANCE, (c.upper - c.lower) / 4)
    low, high = c.lower + clearance - value, c.upper - clearance - value
    reverse = error - ca.pi * ca.sign(error)
    is_out, stays_out = (ca.logic_or(each < low, each > high) for each in (error, reverse))
    is_reversed = ca.logic_and(is_out, ca.logic_not(stays_out))
    return ca.fmin(ca.fmax(ca.if_else(is_reversed, reverse, error), low), high)


def steering_laws(vehicle: Vehicle, errors: Mapping[str, ca.SX]) -> tuple[ca.SX, ...]:
    """Return the rates of all commanded coordinates [rad/s, m/s].

    Coordinates with an error in ``errors`` are steered towards their targets; the rates of the
    others are zero.
    """
    fastest = {
        c.name: c.max_rate if np.isfinite(c.max_rate) else MAX_STEERING_RATE
        for c in vehicle.of("commanded")
    }
    return tuple(
        rate * ca.tanh(GAIN / rate * errors.get(name, ca.SX(0))) for name, rate in fastest.items()
    )


TYPICAL_ANGLE = 0.3  # steering angle that scales its column [rad]
MIN_NAMED_SHARE = 0.1  # smallest entry of a singular vector in messages [largest entry]
MIN_LEVER = 0.02  # a contact with a smaller lever lies on the steering axis [rolling radii]
LEAST_AUTHORITY = 5e-3  # smallest singular value at which wheels can impose given commands
MOVES = {
    "forward": "move the platform forward",
    "right": "move the platform sideways",
    "yaw_rate": "turn the platform",
}


def angle_slopes(direct: Dae, rows: ca.SX) -> dict[str, ca.SX]:
    """Return the total derivatives of ``rows`` with respect to commanded coordinates, by name.

    The derivatives include the change of the pose with the coordinates. Each has the shape of
    ``rows``.
    """
    names = [c.name for c in direct.vehicle.of("commanded")]
    angles = ca.vertcat(ca.SX(0, 1), *(direct.named(name)[0] for name in names))
    closure, position = direct.alg[0], pack(direct.z.position)
    follows = -ca.solve(ca.jacobian(closure, position), ca.jacobian(closure, angles))
    slopes = ca.jacobian(rows, angles) + ca.jacobian(rows, position) @ follows
    return {name: slopes[:, k] for k, name in enumerate(names)}


@dataclass(frozen=True, eq=False)
class SlipColumns:
    """Scaled derivatives of the slip of a rolling vehicle, columns (3 n_wheels, 1) by name.

    ``rates`` are the derivatives with respect to velocities, ``omega_x`` to ``omega_z``, Euler
    rates and all other rates, ``angles`` those with respect to the commanded coordinates.
    """

    rates: dict[str, ca.SX]
    angles: dict[str, ca.SX]

    def matrix(self, given: Sequence[str], solve_for: str) -> tuple[ca.SX, tuple[str, ...]]:
        """Return the square matrix of the unknowns' columns, and the names of the unknowns.

        Parameters are those of `inverse_kinematics`.
        """
        known = (*given, *(EULER if set(given) & set(OMEGA) else OMEGA))
        columns = {name: column for name, column in self.rates.items() if name not in known}
        if solve_for == "angles":
            columns = {
                n: c for n, c in columns.items() if n.removesuffix("_rate") not in self.angles
            }
            columns |= self.angles
        return ca.horzcat(*columns.values()), tuple(columns)


def slip_columns(direct: Dae) -> SlipColumns:
    """Return the scaled derivatives of the slip with respect to rates and steering angles.

    ``direct`` is the direct model of rolling without slip.
    """
    vehicle = direct.vehicle
    rates, labels, law = direct.z.rates, direct.labels.z.rates, direct.alg[1]
    size, radius = extent(vehicle), min(wheel.radius for wheel in vehicle.wheels)
    platform = tuple(rates[:6])
    others = [*leaves((rates[6:], direct.u))]
    names = [label.full for label in leaves((labels[6:], direct.labels.u))]
    slides = {f"{c.name}_rate" for c in vehicle.coordinates if vehicle.unit(c.name) == "m"}
    a = ca.jacobian(law, ca.vertcat(*platform, *others))
    turning = ca.inv(omega(direct.x.heading, direct.named("roll")[0]))
    sizes = [1.0] * 3 + [size] * 6 + [1.0 if name in slides else radius for name in names]
    columns = ca.horzcat(a[:, :3], a[:, 3:6] @ turning, a[:, 3:]) @ ca.diag(1 / ca.DM(sizes))
    speed = ca.sqrt(rates.x**2 + rates.y**2)
    return SlipColumns(
        dict(zip((*VELOCITY, *OMEGA, *EULER, *names), ca.horzsplit(columns), strict=True)),
        {name: slope * TYPICAL_ANGLE / speed for name, slope in angle_slopes(direct, law).items()},
    )


@dataclass(frozen=True, eq=False)
class Determinacy:
    """Check that given rates of the platform determine the unknowns of an inverse model.

    The equations are ``matrix @ unknowns + columns @ given = 0``, scaled to velocities;
    ``matrices`` returns both from states and unknowns ``(x, z)``. The margin is the excess of the
    smallest singular value of the matrix over ``least``. ``reasons`` say why a given rate cannot be
    imposed, or an unknown is not determined, by name; ``{}`` in ``remedy`` stands for the given
    rate.
    """

    least: float
    given: tuple[str, ...]
    unknown: tuple[str, ...]
    reasons: Mapping[str, str]
    remedy: str
    matrices: ca.Function

    @property
    def label(self) -> Label:
        """Name, unit and description of the margin."""
        return quantity_label("inverse_margin", least=self.least)

    def margin(self, x: Array, z: Array) -> Array:
        """Return the margins of n states, the columns of ``x`` and ``z``, shape (n,)."""
        matrices = samples_first(self.matrices.map(x.shape[1])(x, z)[0], x.shape[1])
        return np.asarray(np.linalg.svd(matrices, compute_uv=False)[:, -1] - self.least)

    def describe(self, x: Array, z: Array) -> str:
        """Return a message that names the rates that cannot be imposed, the reason and a remedy."""
        matrix, columns = (np.array(part) for part in self.matrices(x, z))
        left, values, right = np.linalg.svd(matrix)
        bound = _dominant_names(left[:, -1] @ columns, self.given)
        words = f"platform rate {_quoted_list(bound)} cannot be imposed"
        if len(bound) > 1:
            words = f"platform rates {_quoted_list(bound)} cannot be imposed independently"
        reason = self.reasons.get(bound[0], "")
        if not reason:
            lost = _dominant_names(right[-1], self.unknown)
            alone = np.linalg.norm(matrix[:, self.unknown.index(lost[0])]) < MIN_LEVER
            why = self.reasons.get(lost[0], "") if alone else ""
            reason = f"{_quoted_list(lost)} {'is' if len(lost) == 1 else 'are'} not determined{why}"
        return (
            f"{words}: {reason} (smallest singular value {values[-1]:.1e}, largest "
            f"{values[0]:.1e}). {self.remedy.format(bound[0])}"
        )


def samples_first(part: ca.DM, count: int) -> Array:
    """Return the output of a mapped function as an array of shape (count, rows, columns)."""
    array = np.array(part)
    return array.reshape(array.shape[0], count, -1).transpose(1, 0, 2)


def _dominant_names(vector: Array, names: Sequence[str]) -> list[str]:
    """Return the names of the dominant entries of a vector, in descending order."""
    size = np.abs(vector)
    return [names[k] for k in np.argsort(-size) if size[k] >= MIN_NAMED_SHARE * size.max()]


def _quoted_list(names: Sequence[str]) -> str:
    quoted = [f"'{name}'" for name in names]
    return " and ".join(filter(None, [", ".join(quoted[:-1]), quoted[-1]]))


def rolling_determinacy(
    direct: Dae, model: Dae, given: Sequence[str], solve_for: str, least: float
) -> Determinacy:
    """Return the determinacy check of an inverse model of rolling without slip.

    ``direct`` is the direct model of rolling without slip, ``model`` the inverse one in its
    symbols; ``given``, ``solve_for`` and ``least`` are those of `inverse_kinematics`.
    """
    slip = slip_columns(direct)
    matrix, unknown = slip.matrix(given, solve_for)
    columns = ca.horzcat(*(slip.rates[name] for name in given))
    x, z, _ = model.columns()
    expressions = [matrix, columns]
    if solve_for == "angles":  # the column of an angle contains the given rates
        joints = pack(direct.u.joints)
        law, *expressions = ca.substitute(
            [direct.alg[1], *expressions], [joints], [ca.SX.zeros(joints.shape)]
        )
        u = ca.vertcat(*(each for each in leaves(model.u) if ca.depends_on(law, each)))
        effect, rest = ca.jacobian(law, u), ca.substitute(law, u, ca.SX.zeros(u.shape))
        rates = -ca.solve(effect.T @ effect, effect.T @ rest)  # exact, since the vehicle rolls
        expressions = ca.substitute(expressions, [u], [rates])
    function = direct.function("matrices", [x, z], expressions)
    remedy = "Give other rates"
    if solve_for == "rates":
        remedy = "Solve for the steering angles, or give a path or other rates"
    reasons = {}
    for c in direct.vehicle.of("commanded"):
        moved: set[str] = set()
        for joint in direct.vehicle.joints:
            if c.name in joint.coordinates or joint.parent in moved:
                moved.add(joint.name)
        wheels = [wheel.name for wheel in direct.vehicle.wheels if wheel.parent in moved]
        lie = (
            "the contact of wheel {} lies" if len(wheels) == 1 else "the contacts of wheels {} lie"
        )
        reasons[f"{c.name}_rate"] = (
            f", since {lie.format(_quoted_list(wheels))} on the axis of '{c.name}'"
        )
    return Determinacy(least, tuple(given), unknown, reasons, remedy, function)


def input_effects(direct: Dae, model: Dae, given: Sequence[str]) -> ca.Function:
    """Return the effects of a direct model's inputs on given rates and on slip.

    The function maps ``x`` and ``z`` of a model in the symbols of the direct one to the derivatives
    of the given rates and of the slip of all wheels with respect to the inputs, in which the direct
    model is linear.
    """
    law, rates, u = direct.alg[1], pack(direct.z.rates), pack(direct.u)
    slip, derived = ca.vertcat(*direct.y.slip_along, *direct.y.slip_across), derived_rates(direct)
    requested = ca.vertcat(*(derived[name].expression for name in given))
    pairs = [(law, rates), (law, u), (requested, rates), (slip, rates), (slip, u)]
    parts = [ca.densify(ca.jacobian(rows, by)) for rows, by in pairs]
    function = direct.function("parts", list(model.columns()[:2]), parts)
    at = [ca.MX.sym(name, function.size1_in(k)) for k, name in enumerate("xz")]
    of_law, by_inputs, of_given, of_slip, slipping = function(*at)
    answer = -ca.solve(of_law, by_inputs)
    return ca.Function("effects", at, [of_given @ answer, of_slip @ answer + slipping])


def command_sizes(vehicle: Vehicle, given: Sequence[str]) -> list[float]:
    """Return a factor for each given rate that converts it to a velocity [1 or m]."""
    return [extent(vehicle) if name == "yaw_rate" else 1.0 for name in given]


def command_determinacy(direct: Dae, model: Dae, given: Sequence[str]) -> Determinacy:
    """Return the check that the driven wheels can impose given commands.

    The matrix of the check is the derivative of the given rates with respect to the rates of the
    driven wheels in the direct model of least slip, both scaled to velocities; ``model``, in the
    symbols of that model, is the one to check.
    """
    vehicle = direct.vehicle
    effects, wheels = input_effects(direct, model, given), direct.labels.u.wheels
    radii = [wheel.radius for wheel in vehicle.wheels if wheel.driven]
    at = [ca.MX.sym(name, effects.size1_in(k)) for k, name in enumerate("xz")]
    matrix = ca.diag(ca.DM(command_sizes(vehicle, given))) @ effects(*at)[0][:, : len(wheels)]
    function = ca.Function(
        "matrices", at, [matrix @ ca.diag(1 / ca.DM(radii)), -ca.MX.eye(len(given))]
    )
    steered = bool(direct.u.joints)
    where = "with the current steering angles " if steered else ""
    reasons = {name: f"{where}the wheels cannot {MOVES[name]}" for name in given}
    remedy = "Steer the wheels first, remove" if steered else "Remove"
    remedy += " '{}' from the given rates, or set exact = false for the nearest motion"
    names = tuple(label.full for label in wheels)
    return Determinacy(LEAST_AUTHORITY, tuple(given), names, reasons, remedy, function)


def conditions(
    direct: Dae, run: Trajectory, solve_for: SolveFor = "rates"
) -> dict[tuple[str, ...], Array]:
    """Return condition numbers of the inverse problem for each choice of three platform rates.

    ``run`` is a motion of the model ``direct`` of a vehicle that rolls without slip; with
    ``solve_for="angles"`` its speed must not be zero. The condition numbers at its samples (n,),
    infinite where the choice is singular, have the names of the three given rates as key
    (``velocity_x`` to ``omega_z``).
    """
    slip, count = slip_columns(direct), run.t.size
    choices = [*combinations((*VELOCITY, *OMEGA), 3)]
    matrices = [slip.matrix(given, solve_for)[0] for given in choices]
    function = direct.function("matrices", list(direct.columns()), matrices)
    found = function.map(count)(*(direct.rows(record, run) for record in "xzu"))
    sizes = np.linalg.cond([samples_first(each, count) for each in found])
    return dict(zip(choices, np.where(sizes < MAX_CONDITION, sizes, np.inf), strict=True))


def check_authority(direct: Dae, stand: Trajectory, given: Sequence[str]) -> None:
    """Raise ModelError if the wheels cannot impose rates at the last sample of a motion."""
    check = command_determinacy(direct, direct, given)
    x, z = direct.rows("x", stand, -1), direct.rows("z", stand, -1)
    if check.margin(x[:, None], z[:, None])[0] < 0:
        raise ModelError(f"{direct.vehicle.name!r}: {check.describe(x, z)}")
