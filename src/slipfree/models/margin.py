"""How well three rates of the platform determine the motion of a vehicle that can roll.

Rolling is linear in all rates: ``A r = 0``, three rows a wheel. With three platform rates given,
the columns of the others make a square matrix; its singular values say how well they follow, and
its singular vectors what depends on what. With the steering angle instead of its rate unknown,
the column of the rate is replaced by the derivative of the slip in the angle.

So that singular values compare, columns are slip velocities: angular rates of the platform count
by its extent, rates of wheels and joints by the rolling radius, and a steering angle by the speed
of the platform for every 0.3 rad.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.models.base import extent
from slipfree.models.kinematics import direct_kinematics
from slipfree.records import Array, Label, leaves, pack
from slipfree.terrain.base import Terrain
from slipfree.trajectory import Column, Trajectory
from slipfree.vehicle.tree import Vehicle

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
EULER = ("heading_rate", "roll_rate", "pitch_rate")
OMEGA = ("omega_x", "omega_y", "omega_z")
TYPICAL_ANGLE = 0.3  # of steering, which weighs its column [rad]
SHARE = 0.1  # of the largest entry of a singular vector, from which on an entry is named
NEAR = 0.02  # lever of a contact on the axis, relative to the rolling radius
ROUNDING = 1e-14  # relative singular value that counts as zero


@dataclass(frozen=True, eq=False)
class Rolling:
    """The slip of a rolling vehicle by columns, as expressions of the direct model's symbols.

    Attributes
    ----------
    names : tuple of str
        Names of all rates: velocities, ``omega_x`` to ``omega_z``, Euler rates, then suspension,
        passive joints, free wheels, driven wheels and commanded coordinates.
    sizes : tuple of float
        What turns them into velocities. [m, or 1]
    columns : SX, shape (3 n_wheels, n_names)
        Derivatives of the slip with respect to the velocities that result.
    angles : SX, shape (3 n_wheels, n_commanded)
        Derivatives with respect to the commanded coordinates, the pose following them. [m/s/rad]
    angle_names : tuple of str
        Names of the commanded coordinates.
    """

    names: tuple[str, ...]
    sizes: tuple[float, ...]
    columns: ca.SX
    angles: ca.SX
    angle_names: tuple[str, ...]

    def growth(self, given: Sequence[str]) -> ca.SX:
        """Return at which rate a deviation of the steering grows while the given rates are kept.

        The derivative of every commanded coordinate's rate in the coordinate itself; the largest
        counts. It is the forward speed over the lever of the contact about the steering axis,
        negative where the contact trails. [1/s]
        """
        matrix, unknown = self.matrix(given, "rate", ca.SX(1))
        change = -ca.solve(matrix, self.angles)
        largest = ca.SX(-np.inf)
        for k, name in enumerate(self.angle_names):
            size = self.sizes[self.names.index(f"{name}_rate")]
            largest = ca.fmax(largest, change[unknown.index(f"{name}_rate"), k] / size)
        return largest

    def matrix(self, given: Sequence[str], steering: str, speed: ca.SX) -> tuple[ca.SX, list[str]]:
        """Return the scaled matrix of the unknowns and their names."""
        angular = OMEGA if set(given) & set(OMEGA) else EULER
        others = self.names[len(VELOCITY) + len(OMEGA) + len(EULER) :]
        unknown = [n for n in (*VELOCITY, *angular, *others) if n not in given]
        parts, names = [], []
        for name in unknown:
            angle = name.removesuffix("_rate")
            if steering == "angle" and angle in self.angle_names:
                column = self.angles[:, self.angle_names.index(angle)]
                parts.append(column * TYPICAL_ANGLE / speed)
                names.append(angle)
            else:
                parts.append(self.columns[:, self.names.index(name)])
                names.append(name)
        return ca.horzcat(*parts), names


def omega(heading: ca.SX, roll: ca.SX) -> ca.SX:
    """Return what leads from ``heading', roll', pitch'`` to the angular velocity in fixed axes.

    Chakraborty and Ghosal, eq. 4; shape (3, 3).
    """
    return ca.vertcat(
        ca.horzcat(0, -ca.sin(heading), ca.cos(roll) * ca.cos(heading)),
        ca.horzcat(0, ca.cos(heading), ca.cos(roll) * ca.sin(heading)),
        ca.horzcat(1, 0, -ca.sin(roll)),
    )


def rolling(vehicle: Vehicle, direct: Dae) -> Rolling:
    """Return the slip by columns, from the direct model with ``slip="rolling"``."""
    z, u = direct.z, direct.u
    rates = z.rates
    platform = [rates.x, rates.y, rates.z, rates.heading, rates.roll, rates.pitch]
    others = [*leaves((rates.suspension, rates.passive, rates.free)), *leaves(u)]
    label_of = direct.labels.z.rates
    names = [
        label.full
        for label in leaves((label_of.suspension, label_of.passive, label_of.free, direct.labels.u))
    ]
    a = ca.jacobian(direct.alg[1], ca.vertcat(*platform, *others))
    size, radius = extent(vehicle), min(wheel.radius for wheel in vehicle.wheels)
    to_omega = ca.inv(omega(direct.x.heading, z.position.roll))
    sizes = [1.0] * 3 + [size] * 6 + [1.0 if _slides(vehicle, n) else radius for n in names]
    columns = ca.horzcat(a[:, :3], a[:, 3:6] @ to_omega, a[:, 3:])
    return Rolling(
        (*VELOCITY, *OMEGA, *EULER, *names),
        tuple(sizes),
        columns @ ca.diag(ca.DM([1 / size for size in sizes])),
        *_angles(vehicle, direct),
    )


def _angles(vehicle: Vehicle, direct: Dae) -> tuple[ca.SX, tuple[str, ...]]:
    """Return derivatives of the slip in the commanded coordinates, the pose following them."""
    names = tuple(c.name for c in vehicle.of("commanded"))
    kept = [c.name for c in vehicle.coordinates if c.kind != "suspension"]
    angles = ca.vertcat(ca.SX(0, 1), *(direct.x.joints[kept.index(name)] for name in names))
    (closure, slip), position = direct.alg[:2], pack(direct.z.position)
    follows = -ca.solve(ca.jacobian(closure, position), ca.jacobian(closure, angles))
    return ca.jacobian(slip, angles) + ca.jacobian(slip, position) @ follows, names


def _slides(vehicle: Vehicle, rate: str) -> bool:
    name = rate.removesuffix("_rate")
    return any(name in j.coordinates and j.motion == "slide" for j in vehicle.joints)


@dataclass(frozen=True, eq=False)
class InverseMargin:
    """A check that the given rates determine all others: the smallest singular value.

    Attributes
    ----------
    least : float
        Smallest singular value allowed; the margin is what is above it.
    given, unknown : tuple of str
        Names of the given rates and of the columns of the matrix.
    reasons : mapping of str to str
        What it means that an unknown alone is not determined.
    matrix : casadi Function
        ``(x, z, u) -> (matrix of the unknowns, columns of the given rates, derivative of the slip
        in u, slip at u = 0)``.
    """

    least: float
    given: tuple[str, ...]
    unknown: tuple[str, ...]
    reasons: Mapping[str, str]
    matrix: ca.Function

    @property
    def label(self) -> Label:
        """Name, unit and words of the margin."""
        words = f"smallest singular value of the inverse problem, above the least, {self.least:g}"
        return Label("inverse_margin", "1", words)

    def margin(self, x: Array, z: Array) -> Array:
        """Return the margins of states in columns, shape (n,)."""
        values = np.linalg.svd(self._matrices(x, z)[0], compute_uv=False)
        return np.asarray(values[:, -1] - self.least)

    def describe(self, x: Array, z: Array) -> str:
        """Return what is not determined by what, at one state."""
        matrix, columns = (part[0] for part in self._matrices(x[:, None], z[:, None]))
        left, values, right = np.linalg.svd(matrix)
        lost = _large(right[-1], self.unknown)
        alone = np.linalg.norm(matrix[:, self.unknown.index(lost[0])]) < NEAR
        why = f": {self.reasons[lost[0]]}" if alone and lost[0] in self.reasons else ""
        bound = _large(left[:, -1] @ columns, self.given)
        words = f"{_listed(self.given)} leave {_listed(lost)} undetermined{why}"
        depends = f"{_listed(bound)} cannot be chosen freely"
        return f"{words}; {depends} (smallest singular value {values[-1]:.1e} of {values[0]:.1e})"

    def _matrices(self, x: Array, z: Array) -> tuple[Array, Array]:
        """Return the matrices of the unknowns and of the given rates, sample first.

        With the angle unknown its column depends on the given rates; they follow from the rest,
        since the vehicle rolls.
        """
        count = x.shape[1]
        function, rest = self.matrix.map(count), np.zeros((len(self.given), count))
        *_, effect, slip = _stacked(function(x, z, rest), count)
        u = -np.linalg.pinv(effect) @ slip
        matrix, columns, *_ = _stacked(function(x, z, u[..., 0].T), count)
        return matrix, columns


def _stacked(parts: Any, count: int) -> list[Array]:
    """Return horizontally mapped outputs with the sample as first index."""
    arrays = [np.array(part) for part in parts]
    return [a.reshape(a.shape[0], count, -1).transpose(1, 0, 2) for a in arrays]


def _large(vector: Array, names: Sequence[str]) -> list[str]:
    """Return the names of the large entries, the largest first."""
    size = np.abs(vector)
    return [names[k] for k in np.argsort(-size) if size[k] >= SHARE * size.max()]


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def inverse_margin(
    vehicle: Vehicle,
    direct: Dae,
    parts: Rolling,
    model: tuple[Any, Any, Any],
    given: Sequence[str],
    steering: str,
    least: float,
) -> InverseMargin:
    """Return the check for an inverse model.

    Parameters
    ----------
    vehicle, direct : Vehicle, Dae
        The vehicle, and its direct model with ``slip="rolling"``.
    parts : Rolling
        From `rolling`.
    model : tuple of records of SX
        ``x``, ``z`` and ``u`` of the inverse model, in symbols of the direct model.
    given, steering, least
        As in `inverse_kinematics`.
    """
    rates = direct.z.rates
    speed = ca.sqrt(rates.x**2 + rates.y**2)
    matrix, unknown = parts.matrix(given, steering, speed)
    symbols = [pack(record) for record in model]
    columns = parts.columns[:, [parts.names.index(name) for name in given]]
    effect = ca.jacobian(direct.alg[1], symbols[2])
    expressions = [matrix, columns, effect, direct.alg[1] - effect @ symbols[2]]
    if steering == "angle":
        joints = pack(direct.u.joints)
        expressions = ca.substitute(expressions, [joints], [ca.SX.zeros(joints.shape)])
    function = direct.function("matrix", symbols, expressions)
    return InverseMargin(least, tuple(given), tuple(unknown), _reasons(vehicle), function)


def _reasons(vehicle: Vehicle) -> dict[str, str]:
    """Return what it means that the rate of a commanded coordinate is not determined."""
    reasons = {}
    for c in vehicle.of("commanded"):
        moved: set[str] = set()
        for joint in vehicle.joints:
            if c.name in joint.coordinates or joint.parent in moved:
                moved.add(joint.name)
        wheels = [wheel.name for wheel in vehicle.wheels if wheel.parent in moved]
        who = (
            f"the contact of wheel {wheels[0]} lies"
            if len(wheels) == 1
            else (f"the contacts of wheels {_listed(wheels)} lie")
        )
        reasons[f"{c.name}_rate"] = f"{who} on the axis of {c.name}"
    return reasons


def conditions(
    vehicle: Vehicle, terrain: Terrain, run: Trajectory, *, steering: str = "rate"
) -> dict[tuple[str, ...], Array]:
    """Return how well each of the 20 choices of three platform velocities determines the rest.

    Parameters
    ----------
    vehicle, terrain : Vehicle, Terrain
        What moves on what.
    run : Trajectory
        A motion of the vehicle there, direct or inverse; it must move if ``steering="angle"``.
    steering : {"rate", "angle"}
        What of the steering is unknown.

    Returns
    -------
    dict
        Condition numbers, shape (n,), one for each sample, by the names of the three; infinite
        where the choice is singular.
    """
    direct = direct_kinematics(vehicle, terrain, slip="rolling")
    parts, rates = rolling(vehicle, direct), direct.z.rates
    speed = ca.sqrt(rates.x**2 + rates.y**2)
    choices = list(combinations((*VELOCITY, *OMEGA), 3))
    matrices = [parts.matrix(given, steering, speed)[0] for given in choices]
    function = direct.function("matrices", list(direct.columns()), matrices)
    count = run.t.size
    rows = [
        np.column_stack([direct.rows(record, run, k) for k in range(count)]) for record in "xzu"
    ]
    stacks = _stacked(function.map(count)(*rows), count)
    values = [np.linalg.svd(stack, compute_uv=False) for stack in stacks]
    floor = np.finfo(float).tiny
    return {
        given: np.where(v[:, -1] > ROUNDING * v[:, 0], v[:, 0] / np.fmax(v[:, -1], floor), np.inf)
        for given, v in zip(choices, values, strict=True)
    }


def steering_note(run: Trajectory) -> str:
    """Return the warning that the steering of an inverse motion is unstable; empty if it is not.

    Parameters
    ----------
    run : Trajectory
        From the inverse model with ``steering="rate"``, whole or what was reached.
    """
    growth = run["steering_growth"]
    bad = growth > 0
    if not bad.any():
        return ""
    first, worst = float(run.t[int(bad.argmax())]), int(np.nanargmax(growth))
    return (
        f"steering mode unstable from t = {first:.4g} s: errors of the steering grow at up to "
        f"{growth[worst]:.3g} 1/s (t = {run.t[worst]:.4g} s), since the steered contact leads the "
        "steering axis; take steering = 'angle', or a path"
    )


def steering_slip(run: Trajectory) -> Trajectory:
    """Return an inverse motion with the rate of its steering angle and the slip that costs.

    Parameters
    ----------
    run : Trajectory
        From the inverse model with ``steering="angle"``; the rate is the derivative of the cubic
        spline through the samples.

    Returns
    -------
    Trajectory
        With ``steer_rate`` and ``steering_slip``, lever times rate, in addition.
    """
    from scipy.interpolate import CubicSpline  # imported where it is used: it takes 0.2 s

    lever = run["steering_lever"]
    rate = np.zeros_like(lever)
    if run.t.size > 1:
        rate = CubicSpline(run.t, run["steer"])(run.t, 1)
    found = (
        (Label("steer_rate", "rad s-1", "rate of the steering angle"), rate),
        (Label("steering_slip", "m s-1", "slip of the steered contact"), lever * np.abs(rate)),
    )
    return replace(
        run, columns={**run.columns, **{label.name: Column(label, v) for label, v in found}}
    )
