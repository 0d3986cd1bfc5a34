"""Planned climbs driven: torques of the plan ahead, rates of the plan back.

Where a climb is, is told by how far the vehicle has come, not by time: a vehicle that lags behind
gets the torques of the place where it is. The measure of it is

    p = mean over the axles of x + z,

which grows along every way that does not lead steeply down, at least as fast as the axles go.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from slipfree.climb.path import spin_inertia
from slipfree.climb.reference import PerAxle
from slipfree.climb.way import axle_arms
from slipfree.named import Array

SLOWEST = 0.01  # speed of the reference where the plan rests, so that it gets away [m/s]
CLOSEST = 1e-7  # of places between which the plan is interpolated [m]


@dataclass(frozen=True, eq=False)
class Course:
    p: Array
    square: Array
    slope: Array
    speeds: Array
    torques: Array
    along: Array


def course(climber, plans) -> Course:
    parts = [_places(climber, plan, unknowns) for plan, unknowns in plans]
    p, square, slope, speeds, torques, along = (np.concatenate(each) for each in zip(*parts, strict=True))
    # two legs meet in one place, with two torques there
    for k in range(1, p.size):
        p[k] = max(p[k], p[k - 1] + CLOSEST)
    return Course(p, square, slope, speeds, torques, along)


def _progress(climber, q):
    arms = axle_arms(climber, q)
    return q[:, :2].sum(axis=1) + arms.sum(axis=2).mean(axis=1)


def _places(climber, plan, unknowns):
    where = plan.nlp.where
    b = np.maximum(unknowns[where["b"]], 0)
    nodes, middles = plan.nodes, plan.middles
    steps = np.diff(nodes.s)
    a, mean = np.diff(b) / (2 * steps), (b[:-1] + b[1:]) / 2
    spinning = middles.speeds * a[:, None] + middles.slopes * mean[:, None]
    wheels = np.array([axle.wheels for axle in climber.axles])
    torque = (climber.radius * unknowns[where["tangential"]] + spin_inertia(climber) * spinning) / wheels
    s = np.sort(np.concatenate([nodes.s, middles.s]))
    def all_(x, y):
        return np.stack([np.interp(s, x, c) for c in np.atleast_2d(y.T)], axis=-1)
    q = np.empty((s.size, 4)); q[0::2], q[1::2] = nodes.q, middles.q
    v = np.empty((s.size, 3)); v[0::2], v[1::2] = nodes.speeds, middles.speeds
    n = np.empty((s.size, 3, 2)); n[0::2], n[1::2] = nodes.normals, middles.normals
    p = _progress(climber, q)
    return p, np.interp(s, nodes.s, b), np.gradient(p, s), v, all_(middles.s, torque), np.arctan2(-n[..., 0], n[..., 1])


@dataclass(frozen=True, eq=False)
class Tracking:
    course: Course
    proportional: float = 4.0
    lead: float = 1e-3
    slowest: float = SLOWEST
    braking: float = 0.3
    spare: float = 1e3
    sensed: bool = False
    scale: float = 1.0
    senses = False
    derivative = 0.0
    integral = 0.0
    lag = 1.0

    def asked(self, climber, x, axles, velocities, speed):
        c = self.course
        rows = np.column_stack([c.square, c.speeds, self.scale * c.torques, c.slope, c.along])
        f = ca.interpolant("plan", "linear", [c.p.tolist()], rows.ravel().tolist())
        at = ca.MX.sym("p")
        table = ca.Function("plan", [at], [f(at)], {"never_inline": True})
        p = sum(place[0] + place[1] for place in axles) / 3
        rise = sum(place[0] + place[1] for place in velocities) / 3
        p = p + self.lead
        inside = ca.fmin(ca.fmax(p, c.p[0]), c.p[-1])
        row = table(inside)
        before = p < c.p[0]
        after = p > c.p[-1]
        outside = ca.logic_or(before, after)
        ratios = [ca.if_else(outside, 1, row[1 + k]) for k in range(3)]
        if self.sensed:
            going = ca.mmin(ca.vertcat(*(climber.radius * x.spins[k] / ratios[k] for k in range(3))))
        else:
            going = rise / ca.if_else(outside, 1, row[7])
        rest = ca.sqrt(ca.fmax(row[0], 0) + self.slowest**2)
        arriving = ca.fmin(speed, ca.sqrt(2 * self.braking * ca.fmax(c.p[0] - p, 0) + self.slowest**2))
        leaving = ca.fmin(speed, ca.sqrt(c.square[-1] + 2 * self.braking * ca.fmax(p - c.p[-1], 0) + self.slowest**2))
        pace = ca.if_else(before, arriving, ca.if_else(after, leaving, rest))
        pace = ca.fmin(pace, ca.fmax(going, 0) + self.spare) if self.sensed else pace
        refs, out = [], []
        for k in range(3):
            direction = ca.if_else(outside, 0, row[8 + k])
            along = velocities[k][0] * ca.cos(direction) + velocities[k][1] * ca.sin(direction)
            wish = pace * ratios[k]
            if not self.sensed:
                wish = ca.fmin(wish, along + self.spare)
            refs.append(wish / climber.radius)
            ahead = ca.if_else(outside, 0, row[4 + k])
            out.append(ahead + self.proportional * (refs[-1] - x.spins[k]))
        wanted = PerAxle(*out)
        if math.isinf(climber.torque):
            return PerAxle(*refs), wanted, wanted, ca.SX(1)
        scale = climber.torque / ca.fmax(climber.torque, ca.mmax(ca.fabs(ca.vertcat(*out))))
        return PerAxle(*refs), wanted, PerAxle(*(scale * t for t in out)), scale
