"""Rigid time stepping of the seven-wheeler on a ramp or step, as an independent solution.

Impulses of rigid contacts with Coulomb friction, found by projected Gauss-Seidel sweeps in every
step of fixed length; contacts have no stiffness or damping. It shares no equation with the package:
inertia and lever arms are derived by hand.
"""

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

R, LINK, AHEAD, GRAVITY, SPEED = 0.066, 0.215, 0.255, 9.81, 0.25
MASS, WHEELS, SPIN = (13.8, 7.8), (2, 1, 2), (0.010, 0.005, 0.010)
CENTERS = ((-(LINK + R - 0.2), 0.05), (AHEAD + R - 0.0975, 0.05))
INERTIA = tuple(
    m * (length**2 + 0.25**2) / 12 for m, length in zip(MASS, (0.4, 0.195), strict=True)
)
HEIGHT, STRIBECK, KP, KI, SWEEPS = 0.09, 0.01, 4.0, 40.0, 60
GRAZING = 2e-4  # gap up to which a contact is touched [m]


class Case(NamedTuple):
    """What to climb and how."""

    angle: float
    static: float
    dynamic: float
    exact: bool
    share: float = 0.9
    cap: float = 2.0


def turn(angle):
    return ca.vertcat(ca.cos(angle), ca.sin(angle)), ca.vertcat(-ca.sin(angle), ca.cos(angle))


def gaps(case, center):
    """Gap and normal to the floor and to the wedge: face, corner or plateau."""
    edge = HEIGHT / np.tan(case.angle) if case.angle < 1.57 else 0.0
    away = center - ca.DM([edge, HEIGHT])
    face = ca.DM([-np.sin(case.angle), np.cos(case.angle)])
    on_face = ca.dot(away, ca.DM([-np.cos(case.angle), -np.sin(case.angle)])) > 0
    length = ca.sqrt(ca.sumsqr(away) + 1e-16)
    on_top = away[0] > 0
    distance = ca.if_else(on_face, ca.dot(away, face), ca.if_else(on_top, away[1], length))
    normal = ca.if_else(on_face, face, ca.if_else(on_top, ca.DM([0, 1]), away / length))
    return ((center[1] - R, ca.DM([0, 1])), (distance - R, normal))


def references(case, tilts, directions):
    if not case.exact:
        return ca.DM([1, 1, 1])
    cosines = [
        ca.cos(direction - tilt)
        for direction, tilt in zip(directions, (tilts[0], *tilts), strict=True)
    ]
    ahead = cosines[0] * ca.cos(directions[1] - tilts[1])
    speeds = ca.vertcat(cosines[1] * cosines[2], cosines[0] * cosines[2], ahead)
    size = ca.fmax(ca.fabs(speeds[1]), ca.mmax(ca.fabs(speeds)) / case.cap)
    return speeds / ca.fmax(size, 1e-3)


def mechanics(q, v):
    """Mass matrix, and forces of gravity and of turning, by hand."""
    mass, force = ca.SX.zeros(4, 4), ca.SX.zeros(4)
    mass[0, 0] = mass[1, 1] = sum(MASS)
    force[1] = -sum(MASS) * GRAVITY
    for k, (m, (a, h)) in enumerate(zip(MASS, CENTERS, strict=True)):
        e, n = turn(q[2 + k])
        arm = a * n - h * e
        mass[:2, 2 + k] = m * arm
        mass[2 + k, :2] = m * arm.T
        mass[2 + k, 2 + k] = m * (a**2 + h**2) + INERTIA[k]
        force[:2] += m * v[2 + k] ** 2 * (a * e + h * n)
        force[2 + k] -= m * GRAVITY * arm[1]
    return mass, force


@lru_cache
def stepper(case, h):
    """The step from ``(q, v, spins, integrals)`` and impulses to the next, and outputs."""
    y, impulses = ca.SX.sym("y", 14), ca.SX.sym("impulses", 12)
    q, v, spins, sums = ca.vertsplit(y, [0, 4, 8, 11, 14])
    mass, force = mechanics(q, v)
    arms = ((-LINK, 0), (0, 0), (AHEAD, 1))
    rows_n, rows_t, found, directions, axles = [], [], [], [], []
    for i, (a, body) in enumerate(arms):
        e, n = turn(q[2 + body])
        center = q[:2] + a * e
        axles.append(center)
        jacobian = ca.SX.zeros(2, 7)
        jacobian[:, :2], jacobian[:, 2 + body] = ca.SX.eye(2), a * n
        for gap, normal in gaps(case, center):
            tangent = ca.vertcat(normal[1], -normal[0])
            row = tangent.T @ jacobian
            row[4 + i] = -R
            rows_n.append(normal.T @ jacobian)
            rows_t.append(row)
            found.append(gap)
        near = (1 - ca.tanh((gap - 1.5e-3) / 6e-4)) / 2
        directions.append(case.share * near * ca.atan2(-normal[0], normal[1]))
    wanted = SPEED / R * references(case, (q[2], q[3]), directions)
    wheels, u = ca.DM(WHEELS), ca.vertcat(v, spins)
    torque = wheels * (KP * (wanted - spins) + KI * sums)
    inertia = ca.diagcat(mass, *(j + h * n * KP for j, n in zip(SPIN, WHEELS, strict=True)))
    force = force + ca.vertcat(0, 0, torque[0] + torque[1], torque[2])
    ahead = ca.vertcat(h * force, h * wheels * (KP * wanted + KI * sums))
    inverse = ca.diagcat(ca.inv(mass), *(1 / inertia[k, k] for k in (4, 5, 6)))
    free = inverse @ (ca.vertcat(mass @ v, ca.DM(SPIN) * spins) + ahead)
    rows, gap = ca.vertcat(*rows_n, *rows_t), ca.vertcat(*found)
    slip = ca.vertcat(*rows_t) @ u
    grip = case.dynamic + (case.static - case.dynamic) * ca.exp(-((slip / STRIBECK) ** 2))
    closing = ca.if_else(gap > 0, gap / h, 0.2 * gap / h)
    before = ca.Function("before", [y], [rows @ inverse @ rows.T, rows @ free, closing, grip])
    new = free + inverse @ rows.T @ impulses
    after = ca.vertcat(q + h * new[:4], new, sums + h * (wanted - new[4:]))
    extra = ca.vertcat(gap, slip, wanted, *axles, *(rows_t[2] @ u, u[0], u[1]))
    finish = ca.Function("finish", [y, impulses], [after])
    outputs = ca.Function("outputs", [y], [extra])
    z = ca.MX.sym("z", 26)
    matrix, right, closing_m, grip_m = before(z[:14])
    last = z[14:]
    for _ in range(SWEEPS):
        last = sweep()(last, matrix, right, closing_m, grip_m)
    return ca.Function("step", [z], [ca.vertcat(finish(z[:14], last), last)]), outputs


@lru_cache
def sweep():
    """One projected Gauss-Seidel sweep over six contacts, normal before tangent."""
    matrix, right = ca.SX.sym("W", 12, 12), ca.SX.sym("b", 12)
    closing, grip = ca.SX.sym("g", 6), ca.SX.sym("mu", 6)
    start = ca.SX.sym("impulses", 12)
    now = list(ca.vertsplit(start))
    for k in range(6):
        rate = matrix[k, :] @ ca.vertcat(*now) + right[k] + closing[k]
        now[k] = ca.fmax(0, now[k] - rate / matrix[k, k])
        rate = matrix[6 + k, :] @ ca.vertcat(*now) + right[6 + k]
        most = grip[k] * now[k]
        now[6 + k] = ca.fmin(most, ca.fmax(-most, now[6 + k] - rate / matrix[6 + k, 6 + k]))
    return ca.Function("sweep", [start, matrix, right, closing, grip], [ca.vertcat(*now)])


def climb(case, h, until=4.0):
    """Return the means of the sizes of (20), shape (3,), and whether the rear axle came up."""
    step, outputs = stepper(case, h)
    block = round(0.1 / h)
    march = step.mapaccum(block)
    foot = R * np.tan(case.angle / 2) if case.angle < 1.57 else R
    y = np.zeros(26)
    y[:2], y[4], y[8:11] = (-0.05 - foot - AHEAD, R), SPEED, SPEED / R
    parts = [y[:, None]]
    edge = HEIGHT / np.tan(case.angle) if case.angle < 1.57 else 0.0
    for _ in range(round(until / 0.1)):
        parts.append(np.array(march(parts[-1][:, -1])))
        if parts[-1][0, -1] - LINK * np.cos(parts[-1][2, -1]) > edge + 0.1:
            break
    y = np.hstack(parts)[:, :: max(1, round(2e-3 / h))]
    out = np.array(outputs.map(y.shape[1])(y[:14]))
    gap, axles = out[:6], out[15:21].reshape(3, 2, -1)
    up = (axles[0, 0] > edge + 0.02) & (axles[0, 1] > HEIGHT + R - 0.003)
    span = slice((gap[5] < GRAZING).argmax() - 25, up.argmax() + 50)
    rates, speed = y[8:11, span], np.hypot(y[4], y[5])[span]  # the middle axle is at the joint
    rates = np.where(np.abs(rates) < 0.4, np.nan, rates)
    return np.nanmean(np.minimum(np.abs(1 - speed / (R * rates)), 1), axis=1), bool(up.any())
