"""What rates of driven wheels do to the platform, and those that move it as is given.

The direct model is linear in its inputs, so that at one configuration the rates of least slip among
those that bring about some given rates of the platform follow from linear algebra.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.models.base import extent
from slipfree.records import Array, Label, leaves, pack
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

SUBSET = {
    "forward": Label("forward", "m s-1", "velocity of the platform's centre along its heading"),
    "right": Label("right", "m s-1", "velocity of the platform's centre across its heading"),
    "yaw_rate": Label("yaw_rate", "rad s-1", "rate of the heading, counter-clockwise"),
}
DEFAULT = ("forward", "yaw_rate")
MOVES = {
    "forward": "move the platform forward",
    "right": "move the platform sideways",
    "yaw_rate": "turn the platform",
}
RANK = 1e-9  # relative singular value below which wheels have no effect on a given rate
MISSED = 1e-9  # part of the given rates that may be missed
LEAST_MARGIN = 5e-3  # smallest singular value at which given rates still count as reached


def planar_rates(direct: Dae) -> dict[str, ca.SX]:
    """Return the platform's rates in its heading frame, in the direct model's symbols."""
    rates, c, s = direct.z.rates, ca.cos(direct.x.heading), ca.sin(direct.x.heading)
    return {
        "forward": c * rates.y - s * rates.x,
        "right": c * rates.x + s * rates.y,
        "yaw_rate": rates.heading,
    }


def check_given(vehicle: Vehicle, given: tuple[str, ...], *, exact: bool = True) -> None:
    """Raise ModelError for given rates that are not known, or more than driven wheels."""
    for name in given:
        if name not in SUBSET:
            raise ModelError(f"given: {name!r} is not known; known: {', '.join(SUBSET)}")
    if not given or len(set(given)) != len(given):
        raise ModelError(f"given: expected different rates, found {', '.join(given) or 'none'}")
    if "right" not in given and all(wheel.rollers for wheel in vehicle.wheels if wheel.driven):
        raise ModelError(
            f"{vehicle.name} also moves across its heading, since all its driven wheels have "
            "rollers: give right as well, right = 0 to go straight"
        )
    driven = [wheel.name for wheel in vehicle.wheels if wheel.driven]
    if exact and len(given) > len(driven):
        raise ModelError(
            f"{vehicle.name} has {len(driven)} driven wheels, which determine as many rates of the "
            f"platform at most, found {', '.join(given)}; leave out "
            f"{'right' if 'right' in given else given[-1]}, or set exact = false for the nearest "
            "motion"
        )


@dataclass(frozen=True, eq=False)
class Response:
    """How the direct model answers its inputs, to first order; it is linear in them.

    Attributes
    ----------
    given, wheels, joints : tuple of str
        Names of the given rates, and of the inputs.
    sizes : tuple of float
        What turns given rates into velocities. [1 or m]
    radii : tuple of float
        Radii of the driven wheels. [m]
    matrices : casadi Function
        ``(x, position) -> (K, B, T, U, S)`` of ``K y + B u = 0``, slip ``T y + U u`` and given
        rates ``S y``, with ``y`` the rates of the direct model.
    """

    given: tuple[str, ...]
    wheels: tuple[str, ...]
    joints: tuple[str, ...]
    sizes: tuple[float, ...]
    radii: tuple[float, ...]
    matrices: ca.Function

    def effects(self, parts: Sequence[Array]) -> tuple[Array, Array]:
        """Return given rates and slip for each input: stacks of matrices, last axes. [m, 1]."""
        k, b, t, u, s = parts
        answer = -np.linalg.solve(k, b)
        return s @ answer, t @ answer + u

    def reach(self, parts: Sequence[Array]) -> Array:
        """Return the effect of wheels on given rates, as velocities: without unit."""
        effect = self.effects(parts)[0][..., : len(self.wheels)]
        return np.asarray(np.array(self.sizes)[:, None] * effect / np.array(self.radii))

    def lacking(self, parts: Sequence[Array]) -> tuple[float, str]:
        """Return the smallest singular value of the reach, and what it means in words."""
        left, values, _ = np.linalg.svd(self.reach(parts))
        name = self.given[int(np.abs(left[:, -1]).argmax())]
        at, remedy = "", "Remove"
        if self.joints:
            at, remedy = "with the current steering angles ", "Steer the wheels first, remove"
        return float(values[-1]), (
            f"platform rate '{name}' cannot be imposed: {at}the wheels cannot {MOVES[name]} "
            f"(smallest singular value {values[-1]:.1e}, largest {values[0]:.1e}). {remedy} "
            f"'{name}' from the given rates, or set exact = false for the nearest motion"
        )


def response_of(vehicle: Vehicle, direct: Dae, given: tuple[str, ...]) -> Response:
    """Return the response of a direct model of least slip, for some given rates."""
    function = direct.function(
        "response", [pack(direct.x), pack(direct.z.position)], response_matrices(direct, given)
    )
    return Response(
        given,
        tuple(label.full for label in direct.labels.u.wheels),
        tuple(label.full for label in direct.labels.u.joints),
        tuple(extent(vehicle) if name == "yaw_rate" else 1.0 for name in given),
        tuple(wheel.radius for wheel in vehicle.wheels if wheel.driven),
        function,
    )


def response_matrices(direct: Dae, given: tuple[str, ...]) -> list[ca.SX]:
    """Return the matrices of a response, see `Response`, in the symbols of the direct model."""
    rates, u = pack(direct.z.rates), pack(direct.u)
    slip = ca.vertcat(*direct.y.slip_along, *direct.y.slip_across)
    plane, law = planar_rates(direct), direct.alg[1]
    asked = ca.vertcat(*(plane[name] for name in given))
    pairs = [(law, rates), (law, u), (slip, rates), (slip, u), (asked, rates)]
    return [ca.densify(ca.jacobian(rows, by)) for rows, by in pairs]


def check_reach(
    vehicle: Vehicle, direct: Dae, stand: Trajectory, given: Sequence[str] = DEFAULT
) -> None:
    """Raise ModelError, with its name, for a given rate that wheels do not bring about.

    Parameters
    ----------
    vehicle, direct, stand
        As in `wheel_rates`.
    given : sequence of str
        Names of the given rates.
    """
    response = response_of(vehicle, direct, tuple(given))
    value, words = response.lacking(_parts(response, direct, stand))
    if value < LEAST_MARGIN:
        raise ModelError(f"{vehicle.name}: {words}")


def _parts(response: Response, direct: Dae, stand: Trajectory) -> list[Array]:
    """Return the matrices of the response at the last sample of a trajectory."""
    x, z = direct.rows("x", stand, -1), direct.rows("z", stand, -1)
    position = z[: len(list(leaves(direct.z.position)))]
    return [np.array(part) for part in response.matrices(x, position)]


def wheel_rates(
    vehicle: Vehicle,
    direct: Dae,
    stand: Trajectory,
    *,
    joints: Mapping[str, float] | None = None,
    **given: float,
) -> dict[str, float]:
    """Return the inputs of least slip that move a vehicle as is given, at one configuration.

    What the given rates leave open is solved for in the least-squares sense: rates that neither
    they nor the slip depend on are the least ones. Singular values below `RANK` of the largest
    count as none.

    Parameters
    ----------
    vehicle, direct : Vehicle, Dae
        The vehicle, and its direct model of least slip.
    stand : Trajectory
        Its last sample is the configuration.
    joints : mapping of str to float, optional
        Rates of commanded coordinates, by the names of the inputs; others are zero. [rad/s]
    **given : float
        Some of ``forward``, ``right`` and ``yaw_rate``. [m/s, rad/s]

    Returns
    -------
    dict of str to float
        For ``direct.inputs(**...)``. [rad/s, m/s]

    Raises
    ------
    ModelError
        If a rate cannot be reached; it is named.
    """
    check_given(vehicle, tuple(given))
    response = response_of(vehicle, direct, tuple(given))
    effect, slip = response.effects(_parts(response, direct, stand))
    count, moving = len(response.wheels), joints or {}
    turning = np.array([moving.get(name, 0.0) for name in response.joints])
    asked = np.array(list(given.values())) - effect[:, count:] @ turning
    wheels = _least(effect[:, :count], slip[:, :count], asked, slip[:, count:] @ turning)
    miss = np.array(response.sizes) * (asked - effect[:, :count] @ wheels)
    worst = int(np.abs(miss).argmax())
    if not abs(miss[worst]) <= MISSED * float(np.abs(np.array(response.sizes) * asked).max()):
        raise ModelError(
            f"{vehicle.name} cannot reach {response.given[worst]} here: the nearest its wheels "
            f"bring about, beside the other given rates, misses it by {abs(miss[worst]):.2g} m/s; "
            f"leave {response.given[worst]} out of the given rates"
        )
    names = (*response.wheels, *response.joints)
    return dict(zip(names, (float(each) for each in (*wheels, *turning)), strict=True))


def _least(effect: Array, slip: Array, asked: Array, rest: Array) -> Array:
    """Return what brings ``effect`` to ``asked`` with the least ``slip`` beside ``rest``."""
    left, values, right = np.linalg.svd(effect)
    rank = int((values > RANK * max(values[0], np.finfo(float).tiny)).sum())
    inverse = right[:rank].T @ np.diag(1 / values[:rank]) @ left[:, :rank].T
    free = right[rank:].T
    base = inverse @ asked
    rates = base + free @ np.linalg.lstsq(slip @ free, -(rest + slip @ base), rcond=RANK)[0]
    return np.asarray(rates + inverse @ (asked - effect @ rates))


@dataclass(frozen=True, eq=False)
class ReachMargin:
    """A check that driven wheels reach the given rates: the smallest singular value of the effect.

    Attributes
    ----------
    response : Response
        How the direct model answers.
    states : casadi Function
        ``(x, z) ->`` the matrices of the response.
    """

    response: Response
    states: ca.Function

    @property
    def label(self) -> Label:
        """Name, unit and words of the margin."""
        words = (
            "smallest singular value of the wheels' effect on the given rates, above the least, "
            f"{LEAST_MARGIN:g}"
        )
        return Label("inverse_margin", "1", words)

    def margin(self, x: Array, z: Array) -> Array:
        """Return the margins of states in columns, shape (n,)."""
        count = x.shape[1]
        parts = [np.array(part) for part in self.states.map(count)(x, z)]
        stacks = [p.reshape(p.shape[0], count, -1).transpose(1, 0, 2) for p in parts]
        values = np.linalg.svd(self.response.reach(stacks), compute_uv=False)
        return np.asarray(values[:, -1] - LEAST_MARGIN)

    def describe(self, x: Array, z: Array) -> str:
        """Return which given rate the wheels do not reach, at one state."""
        return self.response.lacking([np.array(part) for part in self.states(x, z)])[1]
