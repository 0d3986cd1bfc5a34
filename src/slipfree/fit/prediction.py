"""Predictions of windows of logs by the force balance, as a function of its unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts are imported when they are used, since this takes 0.3 s

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, ComplexArray, Indices, Names
from slipfree.fit.drives import SLOW, DriveLog, Slopes, Windows, chord, chord_line, courses
from slipfree.fit.estimate import BALANCE, Unknown
from slipfree.fit.force_balance import Chassis, Constants, integrate, simulate

HISTORY = 10.0  # time of simulation before the start of a window, for friction as of ice [s]
RECENT = 1.0  # time of it with short steps [s]
LEAST_LAG = 1e-3  # shorter lags count as none [s]
NOMINAL = {name: each.start for name, each in BALANCE.items()}


class Model(NamedTuple):
    """A vehicle as a force balance with p unknowns; the values of others are `fixed`."""

    unknowns: tuple[Unknown, ...]
    fixed: Mapping[str, float]  # by quantity; otherwise those of `BALANCE`
    radii: Array  # shape (w,): nominal radius of each wheel [m], or 1 for speeds of sides
    wheels: tuple[str, ...]  # names
    half_track: float  # nominal [m]

    @property
    def start(self) -> Array:
        """Values of the unknowns before a fit, shape (p,)."""
        return np.array([self.nominal(each) for each in self.unknowns])

    def nominal(self, unknown: Unknown) -> float:
        """Return the value of an unknown before a fit."""
        if unknown.quantity in self.fixed:
            return self.fixed[unknown.quantity]
        if unknown.quantity == "radius":
            own = [name in unknown.wheels or not unknown.wheels for name in self.wheels]
            return float(self.radii[own].mean())
        return 2 * self.half_track if unknown.quantity == "track" else NOMINAL[unknown.quantity]


class Lanes(NamedTuple):
    """Values of quantities for m sets and n windows: shape (m, 1), or (m, n) if they differ."""

    values: Mapping[str, Array]
    radius: Array  # shape (w, m, 1)


def lanes_of(model: Model, values: Array, of_window: Mapping[str, Names]) -> Lanes:
    """Return the values of all quantities for sets of unknowns, shape (m, p).

    ``of_window`` are the names of surface and campaign of each window.
    """
    m = len(values)
    given = {**NOMINAL, "track": 2 * model.half_track, **model.fixed}
    found = {name: np.full((m, 1), given[name]) for name in NOMINAL}
    radius = np.repeat(model.radii[:, None, None], m, axis=1)
    for unknown, column in zip(model.unknowns, values.T, strict=True):
        name, own = unknown.quantity, column[:, None]
        if name == "radius":
            rows = [each in unknown.wheels or not unknown.wheels for each in model.wheels]
            radius[rows] = own
        elif unknown.of:
            names = of_window[BALANCE[name].of]
            found[name] = np.where(names == unknown.of, own, found[name])
        else:
            found[name] = own
    return Lanes(found, radius)


class WindowErrors(NamedTuple):
    """Predicted minus measured motions of windows."""

    along: Array  # along and to the left of the measured displacement [m]
    across: Array
    # integral of a measured turning rate; otherwise change of a measured heading, or course [rad]
    turn: Array

    @property
    def position(self) -> Array:
        """Distances of predicted from measured ends [m]."""
        return np.hypot(self.along, self.across)


class Predictor:
    """Predictions of windows from the pose at their start and the inputs.

    The motion before the start follows from the inputs of the 10 s before, on slopes at measured
    positions. From the start on, slopes are those at the predicted positions. Without headings, the
    course at the start is that of the measured positions and velocities.
    """

    def __init__(
        self, model: Model, logs: Sequence[DriveLog], windows: Windows, slopes: Slopes | None = None
    ) -> None:
        if not windows.log.size:
            raise ModelError(
                "windows: expected at least one in the fitted logs, found none; use longer logs or "
                "shorter windows"
            )
        self.model, self.windows, self._slopes = model, windows, slopes
        self._dt = dt = logs[0].dt
        self._half = half = chord(dt)
        self._has_headings = all(log.heading is not None for log in logs)
        count = np.array([log.place.size for log in logs])
        offset = np.append(0, np.cumsum(count))
        run = np.concatenate([log.run + k * 1_000_000 for k, log in enumerate(logs)])
        starts = np.flatnonzero(np.append(True, np.diff(run) != 0))
        sizes = np.diff(np.append(starts, run.size))
        self._run = np.repeat(starts, sizes), np.repeat(starts + sizes - 1, sizes)
        self._starts = starts
        self._inputs = np.concatenate([log.inputs for log in logs]).T
        self._chassis = _joined([log.chassis for log in logs], count)
        self._order = np.argsort(windows.first - windows.last, kind="stable")
        first, last, begin, end = (
            (each + offset[windows.log])[self._order] for each in windows[1:5]
        )
        self._lead = half + ceil(HISTORY / dt)  # samples before the start
        after = 0 if self._has_headings else half
        self._lengths = last - first + self._lead + 1 + after
        k = np.arange(int(self._lengths.max()))[:, None]
        low, high = self._run[0][first], self._run[1][first]
        self._rows = np.clip(first - self._lead + k, low, np.maximum(high, last))
        self._at = [np.asarray(each - first + half) for each in (first, last, begin, end)]
        self._place = np.concatenate([log.place for log in logs])
        self.names = {key: windows.names(logs, key) for key in ("surface", "campaign")}
        if self._has_headings:
            self._course = np.exp(1j * np.concatenate([log.heading for log in logs]))
        else:
            self._course = np.concatenate([courses(log) for log in logs])
        self._moved = self._place[end] - self._place[begin]
        self._ends = begin, end
        turned = np.concatenate([log.turned for log in logs])
        self._turn = turned[last] - turned[first]

    def errors(self, values: Array) -> Array:
        """Return the errors of n windows for values, shape (m, p), as an array (n, m, 3)."""
        names = {key: each[self._order] for key, each in self.names.items()}
        lanes = lanes_of(self.model, values, names)
        q = lanes.values
        receiver = q["sensor_ahead"] - 1j * q["sensor_right"]
        velocity, turning = self.motion(lanes)
        half = self._half
        part = slice(self._lead - half, None)
        path, heading = integrate(velocity[part], turning[part], self._dt)
        path = path + receiver * np.exp(1j * heading)
        first, last, begin, end = self._at
        n = np.arange(first.size)
        turned = heading[last, :, n] - heading[first, :, n]
        age = q["age"] / self._dt
        old_path, old_heading = path, heading
        if age.any():
            k = np.arange(len(path))[:, None, None] - np.broadcast_to(age, path.shape[1:])
            k = np.clip(k, 0, len(path) - 1)
            low = np.minimum(k.astype(int), len(path) - 2)
            share = k - low

            def delayed(each: Array) -> Array:
                one, other = (np.take_along_axis(each, low + d, axis=0) for d in (0, 1))
                return np.asarray(one + share * (other - one))

            old_path, old_heading = delayed(path), delayed(heading)
        started, ended = self._ends
        if self._has_headings:
            own, final = (
                np.exp(1j * (old_heading[k, :, n] + q["sensor_heading"].T)) for k in (begin, end)
            )
        else:
            k, line = chord_line(self._dt)
            own, final = (
                np.einsum("k,nkm->nm", line, old_path[at[:, None] + k, :, n[:, None]])
                for at in (begin, end)
            )
        spin = self._course[started][:, None] / own
        spin = spin / np.abs(spin)
        shift = spin * (old_path[end, :, n] - old_path[begin, :, n])
        moved = self._moved[:, None]
        along = np.where(np.abs(moved) > 0, moved, 1.0)
        missed = (shift - moved) * np.abs(along) / along
        bent = np.angle(final * spin / self._course[ended][:, None])
        is_measured = np.isfinite(self._turn)[:, None]
        bent = np.where(is_measured, turned - self._turn[:, None], bent)
        return np.stack([missed.real, missed.imag, bent], axis=-1)[np.argsort(self._order)]

    def motion(self, lanes: Lanes) -> tuple[ComplexArray, Array]:
        """Return velocities of the platform's centre and turning rates, shape (k, m, n) each."""
        q = lanes.values
        receiver, tilt = q["sensor_ahead"] - 1j * q["sensor_right"], None
        if self._slopes:
            tilt = _PathSlopes(self, self._slopes, receiver, q["sensor_heading"])
        constants = Constants(
            lanes.radius,
            q["track"] / (2 * self.model.half_track),
            q["center_of_mass_ahead"] - 1j * q["center_of_mass_right"],
            q["stiffness"],
            q["gyration"],
            q["friction"],
            q["rolling"],
            q["anisotropy"],
            q["turn_slope"],
            inertia=float(self.model.fixed.get("inertia", 1.0)),
        )
        return simulate(
            self._chassis,
            constants,
            self._signals(q),
            self._rows,
            self._dt,
            tilt,
            self._lengths,
            self._lead - round(RECENT / self._dt),
        )

    def _signals(self, q: Mapping[str, Array]) -> Array:
        """Return the inputs after delay and lag, shape (q, m or 1, rows)."""
        pairs = np.column_stack([q["delay"][:, 0], q["lag"][:, 0], q["turn"][:, 0]])
        kinds, index = np.unique(pairs, axis=0, return_inverse=True)
        if len(kinds) == 1:
            index = np.zeros(1, int)
        signals = np.empty((len(self._inputs), len(kinds), self._place.size))
        rows, (low, high) = np.arange(self._place.size), self._run
        for k, (delay, lag, turn) in enumerate(kinds.tolist()):
            at = np.clip(rows - delay / self._dt, low, high)
            before = np.minimum(at.astype(int), np.maximum(high - 1, low))
            share = at - before
            after = np.minimum(before + 1, high)
            for j, own in enumerate(self._inputs):
                signals[j, k] = own[before] + share * (own[after] - own[before])
                keep = float(np.exp(-self._dt / lag)) if lag >= LEAST_LAG else 0.0
                for part in np.split(signals[j, k], self._starts[1:]) if keep else ():
                    start = [keep * part[0]]
                    part[:] = scipy.signal.lfilter([1 - keep], [1, -keep], part, zi=start)[0]
            if turn != 1:
                mean = signals[:, k].mean(axis=0)
                signals[:, k] = mean + turn * (signals[:, k] - mean)
        return signals[:, index.ravel()]


class _PathSlopes:
    """Slopes at measured positions before the start of windows, then at predicted ones."""

    def __init__(
        self, predictor: Predictor, slopes: Slopes, receiver: Array, mounted: Array
    ) -> None:
        self._predictor, self._slopes, course = predictor, slopes, predictor._course
        self._course = np.where(np.isfinite(course) & (course != 0), course, 1.0)
        self._receiver, self._mounted = receiver, mounted
        self._pose: tuple[Any, ...] | None = None

    def __call__(self, k: int, velocity: ComplexArray, turning: Array) -> tuple[Array, Array]:
        n, own = velocity.shape[1], self._predictor
        if k <= own._lead:
            rows = own._rows[k, :n]
            heading = np.angle(self._course[rows]) - self._mounted[..., :n]
            if not own._has_headings:  # the vehicle slides sideways from its heading to its course
                moved = velocity + 1j * turning * self._receiver
                heading = heading - np.where(np.abs(moved) > SLOW, np.angle(moved), 0.0)
            heading = np.broadcast_to(heading, velocity.shape)
            place = own._place[rows] - self._receiver * np.exp(1j * heading)
        else:
            assert self._pose is not None  # noqa: S101
            place, heading, v, w = (each[:, :n] for each in self._pose)
            heading, before = heading + own._dt / 2 * (w + turning), heading
            turns = np.exp(1j * (before + heading) / 2)
            place = place + own._dt / 2 * (v + velocity) * turns
        up, left = self._slopes.tilt(place, heading)
        moved = velocity.real * np.sqrt(1 - up**2) + 1j * velocity.imag * np.sqrt(1 - left**2)
        self._pose = place, heading, moved, turning
        return up, left


def _joined(chassis: Sequence[Chassis], counts: Indices) -> Chassis:
    """Return the wheels at the rows of all logs."""
    if all(each.place.shape[1] == 1 for each in chassis):
        return chassis[0]
    parts = [
        [np.broadcast_to(part, (len(part), count)) for part in each[:3]]
        for each, count in zip(chassis, counts.tolist(), strict=True)
    ]
    place, direction, free = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
    return chassis[0]._replace(place=place, direction=direction, free=free)
