"""Motions with friction and their limits, shared by tests and benchmarks."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import casadi as ca
import numpy as np

import slipfree as sf
from helpers.cases import hills
from helpers.dynamics import slope
from slipfree.catalog import three_wheeler
from slipfree.core.records import leaves
from slipfree.solve.system import solve_initial_conditions, with_inputs

RATES = {"right_rate": 0.45, "left_rate": 0.44, "steer_rate": 0.0}
UNEQUAL = {"right_rate": 0.5, "left_rate": 0.4, "steer_rate": 0.1}
TURNED = {"heading": 0.3, "steer": 0.2}
PLACE = {"x": 0.013, "y": 0.017}
FIXED = three_wheeler(axle="fixed")
MU = 0.6
T = np.linspace(0, 10, 101)


def flat(x, _):
    """Level ground."""
    return 0 * x


def moved(vehicle, ground, law, t, rates=None, tolerance=1e-8, **start):
    """Drive a vehicle with friction at constant rates."""
    dae = sf.quasi_statics(vehicle, ground, law=law)
    begin = sf.settle(dae, **start)
    return sf.simulate(
        dae, begin, dae.inputs(**(rates or RATES)), t, options=sf.SolverOptions(tolerance=tolerance)
    )


def order(sizes, errors):
    """Return the slope of the errors in a log-log plot."""
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def from_rolling(axle, creep) -> Iterator[tuple[float, int]]:
    """Yield how far the motion over hills is from rolling, and its steps at tolerance 1e-8."""
    vehicle, ground = three_wheeler(axle=axle), sf.Analytic(hills, mu=MU)
    rolling = sf.direct_kinematics(vehicle, ground, slip=sf.Rolling())
    run = sf.simulate(
        rolling,
        sf.settle(rolling, **PLACE),
        rolling.inputs(**RATES),
        T,
        options=sf.SolverOptions(tolerance=1e-12),
    )
    for eps in creep:
        same = moved(vehicle, ground, sf.Coulomb(eps), T, tolerance=1e-11, **PLACE)
        usual = moved(vehicle, ground, sf.Coulomb(eps), T, **PLACE)
        if same.stop or usual.stop:
            raise AssertionError(same.stop or usual.stop)
        apart = max(np.abs(same[name] - run[name]).max() for name in ("x", "y", "heading"))
        yield apart, int(usual.statistics["steps"])


class Parts(NamedTuple):
    """Numbers of one instant: slip ``jac w + rest``, contact ``touch w + still = 0``."""

    rates: np.ndarray
    jac: np.ndarray
    rest: np.ndarray
    touch: np.ndarray
    still: np.ndarray
    bears: np.ndarray
    load: np.ndarray


def parts(ground, law) -> Parts:
    """Return the instant at which a rigid axle starts to move at rates that do not fit it."""
    dae = sf.quasi_statics(FIXED, ground, law=law)
    begin = sf.settle(dae, **TURNED)
    system = with_inputs(dae, dae.inputs(**UNEQUAL), 0)
    x = dae.rows("x", begin, 0)
    z = solve_initial_conditions(system, 0.0, x, dae.rows("z", begin, 0), system.u[:, 0])
    w = ca.vertcat(*leaves(dae.z.rates.motion))
    slip = ca.vertcat(
        *(v for pair in zip(dae.y.slip_along, dae.y.slip_across, strict=True) for v in pair)
    )
    pose = (dae.x.x, dae.x.y, dae.z[0].z, dae.x.heading, dae.z[0].roll, dae.z[0].pitch)
    power = -ca.jtimes(dae.y.forces.potential_energy, ca.vertcat(*pose), w[:6])
    normal = dae.alg[1][w.numel() : w.numel() + 3]
    f = ca.Function(
        "f",
        list(dae.columns()),
        [w, ca.jacobian(slip, w), slip, ca.jacobian(normal, w), normal, ca.gradient(power, w)],
    )
    rates, jac, now, touch, moving, load = (np.array(each) for each in f(x, z, system.u[:, 0]))
    names = [label.name for label in leaves(dae.labels.z)]
    bears = z[[k for k, name in enumerate(names) if name == "force_normal"]]
    rest, still = (now - jac @ rates).ravel(), (moving - touch @ rates).ravel()
    return Parts(rates.ravel(), jac, rest, touch, still, bears, load.ravel())


def from_linear(ground, mu, ratio=2e-3) -> float:
    """Return how far the rates are from the linear law ``f = -(mu/eps) N s``. [m/s, rad/s]."""
    now = parts(sf.Analytic(ground, mu=float(mu)), sf.Coulomb(creep=ratio * mu))
    weight = np.repeat(now.bears, 2) / ratio
    n, m = len(now.rates), len(now.bears)
    matrix = np.zeros((n + m, n + m))
    matrix[:n, :n] = now.jac.T @ (weight[:, None] * now.jac)
    matrix[:n, n:], matrix[n:, :n] = now.touch.T, now.touch
    # On level ground gravity only bears on the normals, so that this is least slip by load.
    gravity = np.zeros(n) if ground is flat else now.load
    right = np.concatenate([gravity - now.jac.T @ (weight * now.rest), -now.still])
    return float(np.abs(np.linalg.solve(matrix, right)[:n] - now.rates).max())


class Dissipation(NamedTuple):
    """Rates, the cost that should be least, how far above it may be, rates that keep contact."""

    rates: np.ndarray
    cost: Callable
    gap: float
    keeping: np.ndarray


def dissipation(eps) -> Dissipation:
    """Return what is least for small creep; by duality the friction used bounds the gap. [W]."""
    now = parts(sf.Analytic(hills, mu=MU), sf.Coulomb(eps))

    def slips(rates):
        return np.hypot(*(now.jac @ rates + now.rest).reshape(3, 2).T)

    def cost(rates):
        return MU * now.bears @ slips(rates) - now.load @ rates

    slip = slips(now.rates)
    gap = MU * now.bears @ (slip - slip**2 / np.hypot(slip, eps))
    return Dissipation(now.rates, cost, float(gap), np.linalg.svd(now.touch)[2][3:])


def least_slip_rates():
    """Return the rates of least slip at the same instant."""
    least = sf.direct_kinematics(FIXED, sf.Analytic(hills))
    run = sf.simulate(
        least, sf.settle(least, **TURNED), least.inputs(**UNEQUAL), np.array([0, 1e-6])
    )
    return np.array([run.of(label)[0] for label in leaves(least.labels.z.rates.motion)])


def random_starts(axle, mu, eps, count, rng) -> tuple[int, float]:
    """Return how many of Newton's runs converge, and how far apart their solutions lie at most."""
    ground = slope(8, mu)
    vehicle = three_wheeler(axle=axle)
    dae = sf.quasi_statics(vehicle, ground, law=sf.Coulomb(eps))
    tilts = {"tilt_right": 0.05, "tilt_left": -0.03} if axle == "tilting" else {}
    begin = sf.settle(dae, heading=0.7, steer=0.2, **tilts)
    system = with_inputs(dae, dae.inputs(right_rate=0.5, left_rate=0.35, steer_rate=0.1), 0)
    x = dae.rows("x", begin, 0)
    z = solve_initial_conditions(system, 0.0, x, dae.rows("z", begin, 0), system.u[:, 0])
    block = system.blocks[1]
    meant = system._replace(blocks=(system.blocks[0], block._replace(stages=block.stages[-1:])))
    converged, apart = 0, 0.0
    for _ in range(count):
        first = z.copy()
        first[block.span] += rng.normal(size=len(block.labels)) * 0.3 * dae.scale[block.span]
        try:
            again = solve_initial_conditions(meant, 0.0, x, first, system.u[:, 0])
        except sf.ModelError:
            continue
        converged += 1
        apart = max(apart, float(np.abs((again - z) / dae.scale).max()))
    return converged, apart
