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
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose
from slipfree.named import Array, Label, leaves, pack
from slipfree.trajectory import Trajectory
from slipfree.vehicle.chain import Vehicle

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
EULER = ("heading_rate", "roll_rate", "pitch_rate")
OMEGA = ("omega_x", "omega_y", "omega_z")
TYPICAL_ANGLE = 0.3  # of steering, which weighs its column [rad]
SHARE = 0.3  # of the largest entry of a singular vector, from which on an entry is named
Direct = Dae[Any, Any, Any, Any, Any]


@dataclass(frozen=True, eq=False)
class Rolling:
    """The slip of a rolling vehicle by columns, as expressions of the direct model's symbols.

    Attributes
    ----------
    names : tuple of str
        Names of all rates: velocities, ``omega_x`` to ``omega_z``, Euler rates, then suspension,
        passive joints, free wheels, driven wheels and commanded coordinates.
    columns : SX, shape (3 n_wheels, n_names)
        Derivatives of the slip with respect to them, scaled.
    angles : SX, shape (3 n_wheels, n_commanded)
        Derivatives with respect to the commanded coordinates, the pose following them. [m/s/rad]
    angle_names : tuple of str
        Names of the commanded coordinates.
    """

    names: tuple[str, ...]
    columns: ca.SX
    angles: ca.SX
    angle_names: tuple[str, ...]

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


def rolling(vehicle: Vehicle, direct: Direct) -> Rolling:
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
    slip, closure = direct.alg[1], direct.alg[0]
    a = ca.jacobian(slip, ca.vertcat(*platform, *others))
    extent, radius = _extent(vehicle), min(wheel.radius for wheel in vehicle.wheels)
    to_omega = ca.inv(omega(direct.x.heading, z.position.roll))
    a_omega = a[:, 3:6] @ to_omega / extent
    lengths = [1.0 if _slides(vehicle, name) else radius for name in names]
    a_others = a[:, 6:] @ ca.diag(ca.DM([1 / length for length in lengths]))
    commanded = [c.name for c in vehicle.of("commanded")]
    kept = [c.name for c in vehicle.coordinates if c.kind != "suspension"]
    angles = ca.vertcat(ca.SX(0, 1), *(direct.x.joints[kept.index(name)] for name in commanded))
    position = pack(z.position)
    follows = -ca.solve(ca.jacobian(closure, position), ca.jacobian(closure, angles))
    b = ca.jacobian(slip, angles) + ca.jacobian(slip, position) @ follows
    return Rolling(
        (*VELOCITY, *OMEGA, *EULER, *names),
        ca.horzcat(a[:, :3], a_omega, a[:, 3:6] / extent, a_others),
        b,
        tuple(commanded),
    )


def _slides(vehicle: Vehicle, rate: str) -> bool:
    names = {j.coordinate for j in vehicle.joints if j.motion == "slide"}
    return rate.removesuffix("_rate") in names


def _extent(vehicle: Vehicle) -> float:
    """Return how far wheels are from the platform's centre, right or ahead. [m]."""
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    poses = vehicle.carriers(rest, {c.name: ca.SX(0) for c in vehicle.coordinates})
    return max(float(np.abs(np.array(ca.evalf(pose.origin))).max()) for pose in poses)


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
        ``(x, z, u) -> (matrix of the unknowns, columns of the given rates, slip)``.
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
        return np.linalg.svd(self._matrices(x, z)[0], compute_uv=False)[:, -1] - self.least

    def describe(self, x: Array, z: Array) -> str:
        """Return what is not determined by what, at one state."""
        matrix, columns = (part[0] for part in self._matrices(x[:, None], z[:, None]))
        left, values, right = np.linalg.svd(matrix)
        lost = _large(right[-1], self.unknown)
        why = f": {self.reasons[lost[0]]}" if len(lost) == 1 and lost[0] in self.reasons else ""
        bound = _large(left[:, -1] @ columns, self.given)
        words = f"{_listed(self.given)} leave {_listed(lost)} undetermined{why}"
        depends = f"{_listed(bound)} cannot be chosen freely"
        return f"{words}; {depends} (smallest singular value {values[-1]:.1e} of {values[0]:.1e})"

    def _matrices(self, x: Array, z: Array) -> tuple[Array, Array]:
        """Return the matrices of the unknowns and of the given rates, sample first.

        With the angle unknown its column depends on the given rates; they follow from the rest,
        since the vehicle rolls.
        """
        count, n_u = x.shape[1], len(self.given)
        function = self.matrix.map(count)
        _, columns, slip = _stacked(function(x, z, np.zeros((n_u, count))), count)
        u = -np.linalg.pinv(columns) @ slip
        matrix, columns, _ = _stacked(function(x, z, u[..., 0].T), count)
        return matrix, columns


def _stacked(parts: Sequence[ca.DM], count: int) -> list[Array]:
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
    vehicle: Vehicle, direct: Direct, model: tuple[Any, Any, Any], given: Sequence[str],
    steering: str, least: float,
) -> InverseMargin:  # fmt: skip
    """Return the check for an inverse model.

    Parameters
    ----------
    vehicle, direct : Vehicle, Dae
        The vehicle, and its direct model with ``slip="rolling"``.
    model : tuple of records of SX
        ``x``, ``z`` and ``u`` of the inverse model, in symbols of the direct model.
    given, steering, least
        As in `inverse_kinematics`.
    """
    parts, rates = rolling(vehicle, direct), direct.z.rates
    speed = ca.sqrt(rates.x**2 + rates.y**2)
    matrix, unknown = parts.matrix(given, steering, speed)
    symbols = [pack(record) for record in model]
    columns = parts.columns[:, [parts.names.index(name) for name in given]]
    slip = ca.jtimes(direct.alg[1], symbols[2], symbols[2])
    function = ca.Function("matrix", symbols, [matrix, columns, slip])
    return InverseMargin(least, tuple(given), tuple(unknown), _reasons(vehicle, steering), function)
