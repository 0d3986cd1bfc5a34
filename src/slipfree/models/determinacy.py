"""Determinacy of inverse kinematics: singular values of its linear equations.

Slip is linear in all rates. A vehicle that rolls without slip obeys ``A r = 0``, with three rows
per wheel. With some of the platform's rates given, the columns of the other rates form a square
matrix. Its smallest singular value measures how well the given rates determine the others; the
singular vectors show which ones they do not determine. Where steering angles are unknown, the
derivative of the slip with respect to an angle replaces the column of its rate.

All columns are scaled to slip velocities: angular rates of the platform by its extent, rates of
wheels and joints by the rolling radius, and a steering angle by the speed of the platform per
0.3 rad.

Under commands, vehicles slip, and the rates of the driven wheels act through the direct model of
least slip. The matrix is then the effect of the wheel rates on the given rates, scaled to
velocities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, Label, leaves, pack
from slipfree.core.trajectory import Trajectory
from slipfree.laws.rolling import Rolling
from slipfree.models.base import extent
from slipfree.models.given_rates import EULER, OMEGA, VELOCITY, derived_rates, omega
from slipfree.models.kinematics import direct_kinematics
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

TYPICAL_ANGLE = 0.3  # steering angle that scales its column [rad]
MIN_NAMED_SHARE = 0.1  # smallest entry of a singular vector in messages [largest entry]
MIN_LEVER = 0.02  # a contact with a smaller lever lies on the steering axis [rolling radii]
LEAST_AUTHORITY = 5e-3  # smallest singular value at which wheels can impose given commands
MOVES = {
    "forward": "move the platform forward",
    "right": "move the platform sideways",
    "yaw_rate": "turn the platform",
}
MIN_RELATIVE_AUTHORITY = 1e-9  # smaller values: the wheels do not affect the given rate


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
    direct: Dae,
    model: Dae,
    given: Sequence[str],
    solve_for: str,
    least: float,
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
    vehicle: Vehicle, terrain: Terrain, run: Trajectory, *, solve_for: str = "rates"
) -> dict[tuple[str, ...], Array]:
    """Return condition numbers of the inverse problem for each choice of three platform rates.

    ``run`` is a motion of a vehicle that rolls without slip; with ``solve_for="angles"`` its speed
    must not be zero. The condition numbers at its samples (n,), infinite where the choice is
    singular, have the names of the three given rates as key (``velocity_x`` to ``omega_z``).
    """
    direct = direct_kinematics(vehicle, terrain, slip=Rolling())
    slip, count = slip_columns(direct), run.t.size
    choices = list(combinations((*VELOCITY, *OMEGA), 3))
    matrices = [slip.matrix(given, solve_for)[0] for given in choices]
    function = direct.function("matrices", list(direct.columns()), matrices)
    rows = [
        np.column_stack([direct.rows(record, run, k) for k in range(count)]) for record in "xzu"
    ]
    floor, found = np.finfo(float).tiny, dict[tuple[str, ...], Array]()
    for given, part in zip(choices, function.map(count)(*rows), strict=True):
        values = np.linalg.svd(samples_first(part, count), compute_uv=False)
        largest, smallest = values[:, 0], values[:, -1]
        regular = smallest > MIN_RELATIVE_AUTHORITY * largest
        found[given] = np.where(regular, largest / np.fmax(smallest, floor), np.inf)
    return found


def check_authority(direct: Dae, stand: Trajectory, given: Sequence[str]) -> None:
    """Raise ModelError if the wheels cannot impose rates at the last sample of a motion."""
    check = command_determinacy(direct, direct, given)
    x, z = direct.rows("x", stand, -1), direct.rows("z", stand, -1)
    if check.margin(x[:, None], z[:, None])[0] < 0:
        raise ModelError(f"{direct.vehicle.name!r}: {check.describe(x, z)}")
