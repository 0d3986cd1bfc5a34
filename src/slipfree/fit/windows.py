"""Windows of a log: rates at the samples, and measured motion from the first to the last one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Indices, Mask
from slipfree.fit.body_motion import evaluate

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(8)  # quadrature over the time between samples
TIME_SLACK = 1e-6  # of window ends [window]
MAX_SAMPLES = 1_000_000  # windows times samples of the longest one; an estimate takes 2 kB for each


class Windows(NamedTuple):
    """Windows of a log, with at most k + 1 samples each."""

    number: Array  # shape (n,): number of each window in the log, and time of its first sample [s]
    start: Array
    dt: Array  # shape (n, k): times between samples; zero after the end of a shorter window [s]
    given: Array  # shape (n, k + 1, n_given): inputs and joints at the samples [rad/s, m/s, rad, m]
    # shape (n, 3): measured pose of the sensor at the last sample, relative to the first one: to
    # the right and forward [m], and change of heading, continuous over turns [rad]
    end: Array

    def take(self, rows: npt.NDArray[np.int64] | Mask) -> Windows:
        """Return some of the windows, given by indices or a mask."""
        return Windows(*(part[rows] for part in self))


class Log(NamedTuple):
    """A log of rates and poses."""

    t: Array  # shape (n,): times, not decreasing within a window [s]
    given: Array  # shape (n, n_given): inputs and joints [rad/s, m/s, rad, m]
    # shape (n, 3): position in axes of which the second points along heading zero [m], and heading,
    # which changes by less than half a turn between samples [rad]
    pose: Array
    window: Array | npt.NDArray[np.int64]  # shape (n,): number of each sample's window


def divide(t: Array, duration: float) -> tuple[Indices, Array]:
    """Return rows and numbers of windows of a duration [s] from the first time; they share ends."""
    since, slack = t - t[0], TIME_SLACK * duration
    numbers = np.unique(np.floor((since + slack) / duration))
    numbers = numbers[duration * (numbers + 1) <= since[-1] + slack]
    if not numbers.size:
        raise ModelError(
            f"expected a log of at least one window, {duration:g} s, found {since[-1]:g} s; reduce "
            "data.window"
        )
    first = np.searchsorted(since, duration * numbers - slack)
    last = np.searchsorted(since, duration * (numbers + 1) + slack)
    rows = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True)])
    return rows, np.repeat(numbers, last - first)


def joined(logs: Sequence[Log]) -> Log:
    """Return several logs as one, whose windows are numbered on from log to log."""
    numbered, first = list[Log](), 0.0
    for log in logs:
        numbered.append(log._replace(window=log.window - log.window.min(initial=0.0) + first))
        first = float(numbered[-1].window.max(initial=first - 1)) + 1
    return Log(*map(np.concatenate, zip(*numbered, strict=True)))


def cut(log: Log) -> Windows:
    """Return the windows of a log; those with fewer than two samples are left out."""
    starts = np.flatnonzero(np.append(True, np.diff(log.window) != 0))
    spans = [
        slice(a, b) for a, b in zip(starts, [*starts[1:], len(log.t)], strict=True) if b - a > 1
    ]
    if not spans:
        raise ModelError(
            "windows: expected at least one window with two samples, found none: samples are "
            f"{np.median(np.diff(log.t)) if len(log.t) > 1 else 0:.3g} s apart (median); correct "
            "the unit of the times if they are not in seconds, or use longer windows"
        )
    longest = max(part.stop - part.start for part in spans)
    if longest * len(spans) > MAX_SAMPLES:
        raise ModelError(
            f"windows: expected at most {MAX_SAMPLES} samples (windows times samples of the "
            f"longest one), found {len(spans)} windows of up to {longest} samples; use a part of "
            "the log, windows of similar length, or fewer samples per second"
        )
    dt, given = (
        np.zeros((len(spans), longest - 1)),
        np.zeros((len(spans), longest, log.given.shape[1])),
    )
    end = np.zeros((len(spans), 3))
    for k, part in enumerate(spans):
        steps, count = np.diff(log.t[part]), part.stop - part.start
        if steps.min() < 0:
            raise ModelError(
                "windows: expected times that do not decrease, found a decrease after "
                f"{log.t[part][steps.argmin()]:g} s; divide the log there"
            )
        dt[k, : count - 1] = steps
        given[k, :count], given[k, count:] = log.given[part], log.given[part.stop - 1]
        x, y, heading = log.pose[part].T
        end[k] = _relative(np.column_stack([x, y, np.unwrap(heading)]))
    first = [part.start for part in spans]
    return Windows(log.window[first].astype(float), log.t[first], dt, given, end)


def _relative(poses: Array) -> Array:
    """Return the last pose relative to the first one."""
    dx, dy, turned = poses[-1] - poses[0]
    c, s = np.cos(poses[0, 2]), np.sin(poses[0, 2])
    return np.array([c * dx + s * dy, -s * dx + c * dy, turned])


def end_poses(windows: Windows, velocity: Array, sensor: Array) -> tuple[Array, Array, Array]:
    """Return the predicted end poses of windows, and their derivatives by velocities and sensor.

    Between two samples, the velocity (right, forward, yaw rate) is linear in time. The heading is
    then quadratic in time, and the position is integrated by Gauss quadrature. Shapes (n, 3), (n,
    3, k + 1, 3) and (n, 3, 3).
    """
    count, samples, _ = velocity.shape
    pairs = np.concatenate([velocity[:, :-1], velocity[:, 1:]], axis=2).reshape(-1, 6)
    steps, by_pairs = evaluate(_interval_function(), windows.dt.reshape(-1, 1), pairs)
    moved, by_steps = _compose_steps(steps.reshape(count, samples - 1, 3))
    here = np.broadcast_to(sensor, (count, 3))
    end, by_moved, by_sensor = evaluate(_sensor_function(), moved, here)
    slopes = by_steps @ by_pairs.reshape(count, samples - 1, 3, 6)
    slopes = by_moved[:, None] @ slopes
    by_velocity = np.zeros((count, samples, 3, 3))
    by_velocity[:, :-1] += slopes[..., :3]
    by_velocity[:, 1:] += slopes[..., 3:]
    return end[..., 0], by_velocity.transpose(0, 2, 1, 3), by_sensor


def _compose_steps(steps: Array) -> tuple[Array, Array]:
    """Return pose changes over several intervals, and their derivatives with respect to each."""
    ahead = np.cumsum(steps[..., 2], axis=1)
    before = ahead - steps[..., 2]
    c, s = np.cos(before), np.sin(before)
    moved = np.stack([c * steps[..., 0] - s * steps[..., 1], s * steps[..., 0] + c * steps[..., 1]])
    place = moved.sum(axis=2)
    later = place[..., None] - np.cumsum(moved, axis=2)  # a turn rotates what follows
    slopes = np.zeros((*steps.shape, 3))
    slopes[..., 0, :] = np.stack([c, -s, -later[1]], axis=-1)
    slopes[..., 1, :] = np.stack([s, c, later[0]], axis=-1)
    slopes[..., 2, 2] = 1
    return np.column_stack([*place, ahead[:, -1]]), slopes


@cache
def _interval_function() -> ca.Function:
    """Return the function of time and velocities at both ends to the pose change, and its slope."""
    dt, pair = ca.SX.sym("dt"), ca.SX.sym("pair", 6)
    first, last = pair[:3], pair[3:]
    place = ca.SX.zeros(2)
    for point, weight in zip((1 + POINTS) / 2, WEIGHTS / 2, strict=True):
        turn = dt * point * (first[2] + point * (last[2] - first[2]) / 2)
        place += dt * weight * _rotation(turn) @ (first + point * (last - first))[:2]
    step = ca.vertcat(place, dt * (first[2] + last[2]) / 2)
    return ca.Function("step", [dt, pair], [step, ca.densify(ca.jacobian(step, pair))])


@cache
def _sensor_function() -> ca.Function:
    """Return the function of pose change and sensor to the sensor's, and its slopes by both."""
    moved, sensor = ca.SX.sym("moved", 3), ca.SX.sym("sensor", 3)
    at = sensor[:2]
    seen = _rotation(sensor[2]).T @ (moved[:2] + _rotation(moved[2]) @ at - at)
    end = ca.vertcat(seen, moved[2])
    slopes = [ca.densify(ca.jacobian(end, by)) for by in (moved, sensor)]
    return ca.Function("sensor", [moved, sensor], [end, *slopes])


def _rotation(angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))
