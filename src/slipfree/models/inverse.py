"""Inverse kinematics: which wheel and steering rates give three rates of the platform.

Of a vehicle that rolls without slip and has three inputs, any three of the platform's rates may be
given [1]_. As there, the rate of the steering is unknown, and that is delicate: it acts on the
ground only through the lever of the contact about the steering axis. Where the contact lies on the
axis, as on flat ground, nothing determines it; where the contact trails, the steering follows the
platform; where it leads, the steering runs away from it. The steering angle, in contrast, is well
determined as long as the vehicle moves.

References
----------
.. [1] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
       section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae, Labels, Limit, SampledCheck
from slipfree.errors import ModelError
from slipfree.lookups import needed_lookups, substitute_lookups
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.margin import EULER, OMEGA, VELOCITY, inverse_margin, omega, rolling
from slipfree.models.records import Configuration, Dependent, Forces, Outputs
from slipfree.records import Array, Label, leaves, pack, unpack
from slipfree.terrain.base import Terrain
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

Steering = Literal["rate", "angle"]
PLANAR = ("velocity_x", "velocity_y", "heading_rate")
LEAST_MARGIN = 1e-3  # smallest singular value at which the given rates still count as determining
ELSEWHERE = 1e-6  # distance of path and start that counts [size, rad]
STANDING = 1e-6  # speed below which a steering angle has no effect [size/s]


class Given(NamedTuple):
    """Inputs: the three given rates of the platform, in the order given. [m/s, rad/s]."""

    platform: tuple[Any, ...]


class InverseRates(NamedTuple):
    """The rates that follow from those given. [m/s, rad/s].

    ``platform`` are those of velocities and Euler angles that are not given; ``wheels`` those of
    the driven wheels; ``joints`` those of the commanded coordinates, unless their angles are
    unknown.
    """

    platform: tuple[Any, ...]
    suspension: tuple[Any, ...]
    passive: tuple[Any, ...]
    free: tuple[Any, ...]
    wheels: tuple[Any, ...]
    joints: tuple[Any, ...]


class ByRate(NamedTuple):
    """Algebraic unknowns in two blocks, with the rate of the steering among them."""

    position: Dependent
    rates: InverseRates
    forces: Forces


class Steered(NamedTuple):
    """Pose, commanded coordinates and rates, which are determined together."""

    position: Dependent
    joints: tuple[Any, ...]
    rates: InverseRates


class ByAngle(NamedTuple):
    """Algebraic unknowns, with the steering angle among those of the motion."""

    motion: Steered
    forces: Forces


class InverseOutputs(NamedTuple):
    """What else is sampled along an inverse motion.

    ``omega`` are the components of the platform's angular velocity that are not given. ``growth``
    is the rate at which the steering runs away, if its rate is unknown; ``lever`` the slip that
    its rate would cost, if its angle is. [rad/s, 1/s, m]
    """

    rolling: Outputs
    omega: tuple[Any, ...]
    growth: tuple[Any, ...]
    lever: tuple[Any, ...]


def inverse_kinematics(
    vehicle: Vehicle,
    terrain: Terrain,
    *,
    given: Sequence[str] = PLANAR,
    steering: Steering = "rate",
    least_margin: float = LEAST_MARGIN,
) -> Dae:
    """Return the motion of a vehicle that rolls without slip under given rates of its platform.

    Parameters
    ----------
    vehicle : Vehicle
        Rolls without slip, and has three inputs: driven wheels and commanded coordinates.
    terrain : Terrain
        The ground; contacts keep to its domain.
    given : sequence of three str
        Of ``velocity_x``, ``velocity_y``, ``velocity_z`` and of either ``omega_x``, ``omega_y``,
        ``omega_z`` or ``heading_rate``, ``roll_rate``, ``pitch_rate``.
    steering : {"rate", "angle"}
        What is unknown. With the rate, the vehicle rolls exactly, but the model is singular on
        flat ground and the steering may run away: see ``steering_growth`` and `steering_note`.
        With the angle, the contact of a steered wheel slips by its lever times the rate of the
        steering: see `steering_slip`. A start then comes from the direct model, since a vehicle
        at rest may be steered anyhow.
    least_margin : float
        Smallest singular value down to which the rates count as determined; zero to go through
        crossings, as collocation can.

    Returns
    -------
    Dae
        Inputs are the three given rates. It starts from any sample of the direct model.

    Raises
    ------
    ModelError
        If the three are not three different known rates, or the vehicle does not suit.
    """
    _check_given(given)
    _check_vehicle(vehicle, steering)
    if not least_margin >= 0:
        raise ModelError(f"least_margin: expected zero or more, found {least_margin}")
    direct = direct_kinematics(vehicle, terrain, slip="rolling")
    parts = _parts(direct, tuple(given), steering)
    dae = _by_rate(direct, parts) if steering == "rate" else _by_angle(vehicle, direct, parts)
    effect = rolling(vehicle, direct)
    model = (dae.x, dae.z, dae.u)
    margin = inverse_margin(vehicle, direct, effect, model, given, steering, least_margin)
    checks = [moved(check, direct, dae) for check in direct.checks]
    growth = (effect.growth(given),) if steering == "rate" and vehicle.of("commanded") else ()
    return replace(dae, checks=(*checks, margin), y=dae.y._replace(growth=growth))


def _check_given(given: Sequence[str]) -> None:
    known = (*VELOCITY, *OMEGA, *EULER)
    if isinstance(given, str) or len(given) != 3 or len(set(given)) != 3:
        raise ModelError(f"given: expected three different rates, found {given!r}")
    for name in given:
        if name not in known:
            raise ModelError(f"given: {name!r} is not known; known: {', '.join(known)}")
    if set(given) & set(OMEGA) and set(given) & set(EULER):
        raise ModelError(
            f"given: expected components of the angular velocity ({', '.join(OMEGA)}) or Euler "
            f"rates ({', '.join(EULER)}), not both, found {', '.join(given)}"
        )


def _check_vehicle(vehicle: Vehicle, steering: str) -> None:
    if steering not in ("rate", "angle"):
        raise ModelError(f"steering: expected 'rate' or 'angle', found {steering!r}")
    free = [wheel.name for wheel in vehicle.wheels if not wheel.driven]
    have, need = len(vehicle.of("passive")) + len(free), 2 * len(vehicle.wheels) - 3
    if have != need:
        raise ModelError(
            f"{vehicle.name} cannot roll without slip, as inverse kinematics needs: {need} "
            f"conditions ask for as many passive joints and free wheels, found {have}"
        )
    commanded = [c.name for c in vehicle.of("commanded")]
    inputs = [wheel.name for wheel in vehicle.wheels if wheel.driven] + commanded
    if len(inputs) != 3:
        raise ModelError(
            f"{vehicle.name}: three rates of the platform determine three inputs, found "
            f"{len(inputs)} ({', '.join(inputs)})"
        )
    if steering == "angle" and not commanded:
        raise ModelError(f"{vehicle.name} has no commanded coordinate whose angle could be unknown")


class _Parts(NamedTuple):
    """Inputs, unknown rates and equations of an inverse model, with their labels."""

    u: Given
    u_labels: Given
    rates: InverseRates
    rate_labels: InverseRates
    equations: ca.SX
    equation_labels: tuple[Label, ...]
    omega: tuple[ca.SX, ...]
    omega_labels: tuple[Label, ...]


def _parts(direct: Dae, given: tuple[str, ...], steering: str) -> _Parts:
    """Return the rates of the direct model sorted into given and unknown, and the equations.

    The symbols stay those of the direct model. A given component of the angular velocity is a
    new one, with one more equation for the Euler rates.
    """
    labels = [
        Label(name, "rad s-1", f"angular velocity of the platform about {name[-1]}")
        for name in OMEGA
    ]
    symbols = [ca.SX.sym(name) for name in OMEGA]
    u, rates = _sorted(direct.z.rates, direct.u, symbols, given, steering)
    u_labels, rate_labels = _sorted(direct.labels.z.rates, direct.labels.u, labels, given, steering)
    euler = ca.vertcat(*direct.z.rates[3:6])
    turning = ca.vertsplit(omega(direct.x.heading, direct.z.position.roll) @ euler)
    asked = [k for k, name in enumerate(OMEGA) if name in given]
    rest = [k for k in range(3) if k not in asked]
    return _Parts(
        u,
        u_labels,
        rates,
        rate_labels,
        ca.vertcat(direct.alg[1], *(turning[k] - symbols[k] for k in asked)),
        (*direct.labels.alg[1], *(replace(labels[k], name=f"{OMEGA[k]}_law") for k in asked)),
        tuple(turning[k] for k in rest),
        tuple(labels[k] for k in rest),
    )


def _sorted(
    rates: Any, inputs: Any, omegas: Sequence[Any], given: tuple[str, ...], steering: str
) -> tuple[Given, InverseRates]:
    """Return given and unknown rates out of the direct model's, as symbols or as labels."""
    known = dict(zip((*VELOCITY, *EULER, *OMEGA), (*rates[:6], *omegas), strict=True))
    platform = tuple(known[name] for name in (*VELOCITY, *EULER) if name not in given)
    joints = inputs.joints if steering == "rate" else ()
    unknown = InverseRates(
        platform, rates.suspension, rates.passive, rates.free, inputs.wheels, joints
    )
    return Given(tuple(known[name] for name in given)), unknown


def _by_rate(direct: Dae, parts: _Parts) -> Dae:
    """Return the model whose unknowns are rates: the direct model with other inputs."""
    z_labels = ByRate(direct.labels.z.position, parts.rate_labels, direct.labels.z.forces)
    outputs, output_labels = _outputs(direct, parts, growth=True)
    labels = direct.labels._replace(
        z=z_labels,
        u=parts.u_labels,
        y=output_labels,
        alg=(direct.labels.alg[0], parts.equation_labels, direct.labels.alg[2]),
    )
    return replace(
        direct,
        z=ByRate(direct.z.position, parts.rates, direct.z.forces),
        u=parts.u,
        alg=(direct.alg[0], parts.equations, direct.alg[2]),
        y=outputs,
        labels=labels,
        **_starting(direct, z_labels, direct.shift[0]),
    )


def _by_angle(vehicle: Vehicle, direct: Dae, parts: _Parts) -> Dae:
    """Return the model whose unknowns are steering angles, as if they were at rest."""
    kinds = [c.kind for c in vehicle.coordinates if c.kind != "suspension"]
    still = [k for k, kind in enumerate(kinds) if kind == "passive"]
    turned = [k for k, kind in enumerate(kinds) if kind == "commanded"]

    def states(record: Any) -> tuple[Configuration, tuple[Any, ...]]:
        joints = record.joints
        kept = Configuration(record.x, record.y, record.heading, tuple(joints[k] for k in still))
        return kept, tuple(joints[k] for k in turned)

    (x, angles), (x_labels, angle_labels) = states(direct.x), states(direct.labels.x)
    sought = Steered(direct.labels.z.position, angle_labels, parts.rate_labels)
    z_labels = ByAngle(sought, direct.labels.z.forces)
    y, y_labels = _outputs(direct, parts, growth=False)
    rows = [0, 1, 2, *(3 + k for k in still)]
    joints = pack(direct.u.joints)

    def held(expression: ca.SX) -> ca.SX:
        return ca.substitute(expression, joints, ca.SX.zeros(joints.shape))

    labels = Labels(
        x_labels,
        z_labels,
        direct.labels.q,
        parts.u_labels,
        y_labels,
        ((*direct.labels.alg[0], *parts.equation_labels), direct.labels.alg[2]),
    )
    slow = Label("steering_speed", "m s-1", "the vehicle stands, so that it may be steered anyhow")
    speed = ca.sqrt(direct.z.rates.x**2 + direct.z.rates.y**2)
    return replace(
        direct,
        x=x,
        z=ByAngle(Steered(direct.z.position, angles, parts.rates), direct.z.forces),
        u=parts.u,
        ode=direct.ode[rows],
        alg=(held(ca.vertcat(direct.alg[0], parts.equations)), held(direct.alg[2])),
        quad=held(direct.quad),
        y=unpack(y, [held(each) for each in leaves(y)]),
        labels=labels,
        limits=(
            *(limit._replace(expression=held(limit.expression)) for limit in direct.limits),
            Limit(slow, speed, STANDING * direct.size, np.inf),
        ),
        **_starting(direct, z_labels, direct.shift[0][rows], angles),
    )


def _starting(
    direct: Dae, z_labels: Any, x_shift: Array, angles: tuple[ca.SX, ...] = ()
) -> dict[str, Any]:
    """Return guess, sizes and shift of a model that adds angles and rates to the pose."""
    position, forces = (len(list(leaves(part))) for part in (direct.z.position, direct.z.forces))
    rest = len(list(leaves(z_labels))) - position - forces
    column = ca.vertcat(ca.SX(0, 1), *angles)
    poses = [direct.guess[:position]]
    lookups, before, after = substitute_lookups(
        needed_lookups(direct.lookups, poses), [column], [ca.SX.zeros(column.shape)]
    )
    (guess,) = ca.substitute(poses, before, after)
    radius, end = direct.scale[position - 1], direct.scale.size - forces  # of a contact point
    sizes = [radius if label.unit in ("m", "m s-1") else 1.0 for label in leaves(z_labels)]
    sizes[position + rest :] = direct.scale[end:]
    still = np.zeros(rest + forces)
    return {
        "guess": ca.densify(ca.vertcat(guess, ca.SX.zeros(rest), direct.guess[end:])),
        "lookups": (*direct.lookups, *lookups),
        "scale": np.array(sizes),
        "shift": (x_shift, np.concatenate([direct.shift[1][:position], still])),
    }


def _outputs(direct: Dae, parts: _Parts, *, growth: bool) -> tuple[InverseOutputs, InverseOutputs]:
    """Return the outputs and their labels; the growth is filled in later."""
    joints = pack(direct.u.joints)
    words = "rate at which the steering runs away from the given motion, if positive"
    grows, levers, lever_labels = [], [], []
    if growth and joints.numel():
        grows = [Label("steering_growth", "s-1", words)]
    elif joints.numel():
        lever = ca.sqrt(ca.sumsqr(ca.jacobian(direct.alg[1], joints)))
        text = "slip of steered contacts for each unit of the steering rate"
        levers, lever_labels = [lever], [Label("steering_lever", "m", text)]
    return (
        InverseOutputs(direct.y, parts.omega, tuple(ca.SX(0) for _ in grows), tuple(levers)),
        InverseOutputs(direct.labels.y, parts.omega_labels, tuple(grows), tuple(lever_labels)),
    )


@dataclass(frozen=True, eq=False)
class _Moved:
    """A check of the direct model on the states of an inverse one."""

    check: SampledCheck
    states: ca.Function

    @property
    def label(self) -> Label:
        """Name, unit and words of the margin."""
        return self.check.label

    def margin(self, x: Array, z: Array) -> Array:
        """Return the margins, shape (n,), of states in columns."""
        return self.check.margin(*self._direct(x, z))

    def describe(self, x: Array, z: Array) -> str:
        """Return what is wrong, and where, with one state."""
        found = self._direct(x[:, None], z[:, None])
        return self.check.describe(found[0][:, 0], found[1][:, 0])

    def _direct(self, x: Array, z: Array) -> tuple[Array, Array]:
        found = self.states.map(x.shape[1])(x, z)
        return np.array(found[0]), np.array(found[1])


def moved(check: SampledCheck, direct: Dae, dae: Any) -> SampledCheck:
    """Return a check of the direct model's pose for an inverse model."""
    others = len(list(leaves(direct.z[1:])))
    z = ca.vertcat(pack(direct.z.position), ca.SX.zeros(others))
    symbols = [pack(dae.x), pack(dae.z)]
    return _Moved(check, ca.Function("states", symbols, [pack(direct.x), z]))


def along(
    dae: Dae,
    start: Trajectory,
    x: Any,
    y: Any,
    heading: Any,
    *,
    t: Array | None = None,
    begin: float = 0.0,
) -> Given:
    """Return the inputs of an inverse model that lead along a path in time.

    Parameters
    ----------
    dae : Dae
        The inverse model, with the given rates velocity_x, velocity_y and heading_rate.
    start : Trajectory
        Its last sample is where the path must start.
    x, y, heading : SX, or ndarray of shape (n,)
        Place and heading of the platform's centre as expressions of ``dae.t``, or their values at
        the times ``t``, through which a spline of degree five is laid. [m, rad]
    t : ndarray, shape (n,), optional
        Six or more ascending times of the values; beyond them the rates keep their last values. [s]
    begin : float
        Time at which the path starts, if it is not given by values. [s]

    Raises
    ------
    ModelError
        If the model has other inputs, the path depends on more than time or has too few or
        unsuitable values, or it starts elsewhere than the start.
    """
    names = tuple(label.full for label in leaves(dae.labels.u))
    if set(names) != set(PLANAR):
        raise ModelError(
            f"path: the model must be given {', '.join(PLANAR)}, found {', '.join(names)}"
        )
    if t is not None:
        begin = float(np.ravel(t)[0])
    rates, wrong = {}, []
    for name, rate, value in zip(("x", "y", "heading"), PLANAR, (x, y, heading), strict=True):
        first, rates[rate] = _path_rate(name, value, dae.t, t, begin)
        there = float(start[name][-1])
        gap = (first - there) / dae.size
        if name == "heading":
            gap = (first - there + np.pi) % (2 * np.pi) - np.pi
        if not abs(gap) < ELSEWHERE:
            wrong.append(f"{name} = {first:.6g}, the vehicle stands at {there:.6g}")
    if wrong:
        raise ModelError(f"path: it starts elsewhere than the start: {'; '.join(wrong)}")
    inputs: Given = dae.inputs(**rates)
    return inputs


def _path_rate(
    name: str, value: Any, time: ca.SX, t: Array | None, begin: float
) -> tuple[float, ca.SX]:
    """Return one coordinate of a path at its beginning, and its rate."""
    if isinstance(value, ca.SX):
        if not all(ca.is_equal(symbol, time) for symbol in ca.symvar(value)):
            raise ModelError(f"path: {name} may depend on the model's time alone, found {value}")
        return float(ca.Function("first", [time], [value])(begin)), ca.jacobian(value, time)
    from scipy.interpolate import make_interp_spline  # imported where it is used: it takes 0.2 s

    t = np.asarray([] if t is None else t, dtype=float)
    value = np.asarray(value, dtype=float)
    if t.ndim != 1 or t.size < 6 or value.shape != t.shape:
        raise ModelError(
            f"path: {name} needs six or more values, one for each of the times t, found shape "
            f"{value.shape} for {t.size} times"
        )
    if not (np.isfinite(value).all() and np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise ModelError(f"path: values of {name} must be finite and their times ascend")
    spline = make_interp_spline(t, value, k=5).derivative()
    at = ca.MX.sym("t")
    weights = spline.c[: spline.t.size - spline.k - 1].tolist()  # the rest is padding
    rate = ca.Function.bspline(name, [spline.t.tolist()], weights, [spline.k], 1)
    law = ca.Function(f"{name}_rate", [at], [rate(at)], {"never_inline": True})
    return float(value[0]), law(ca.fmin(ca.fmax(time, t[0]), t[-1]))
