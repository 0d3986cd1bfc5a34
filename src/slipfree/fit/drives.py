"""Logs of drives, their windows, and predictions of these as functions of unknowns.

Logs have inputs and poses at equal intervals. The force balance predicts the motion in a window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts are imported when they are used, since this takes 0.3 s

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, ComplexArray, Indices, Mask, Names
from slipfree.fit.estimate import BALANCE, Unknown
from slipfree.fit.force_balance import Chassis, Constants, integrate, simulate
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import averaged

CHORD = 1.0  # half the time over which a line through positions gives a course [s]
SETTLED = 1.0  # time from the start of a run, whose motion is unknown, to the first window [s]
SLOW = 0.25  # speed below which a course is not known [m/s]
GOOD_SHARE = 0.85  # least share of good samples of a window
DRIFT = 0.1, 0.05  # largest difference of positions and velocities [m], [path]
HELD = 2.0  # median number of samples between new values from which values are held
OLD = 0.5  # time from the start of a window to the first pose, where poses are held [s]
MAX_AGE = 1.0  # of poses [s]
LEAST_TURN = 0.5  # turn from which the age of headings is known [rad]
ROUNDING = 1e-9  # of times [s]
MIN_SPAN = 0.35  # least time between first and last pose [window]


class DriveLog(NamedTuple):
    """A log with n samples at equal intervals.

    Positions are those of the receiver, x + i y on the map or in a plane; headings count from x.
    """

    name: str
    campaign: str  # logs that are left out together
    surface: str
    dt: float  # time between samples [s]
    chassis: Chassis  # with 1 or n rows
    inputs: Array  # shape (n, q): rates of wheels [rad/s], or speeds of sides [m/s]
    run: Indices  # shape (n,): number of the run: inputs continue within a run
    piece: Indices  # shape (n,): number of the piece: positions continue within a piece
    manoeuvre: Indices  # shape (n,): number of the manoeuvre
    place: ComplexArray  # shape (n,) [m]
    good: Mask  # shape (n,): samples with reliable positions
    fresh: Mask  # shape (n,): samples with a new pose
    heading: Array | None = None  # shape (n,): continuous over turns [rad]
    yaw_rate: Array | None = None  # shape (n,): measured turning rate [rad/s]
    velocity: ComplexArray | None = None  # shape (n,): measured by the receiver [m/s]
    direction: Array | None = None  # shape (n,): 1 where inputs drive ahead, -1 back, 0 neither

    @property
    def moved(self) -> ComplexArray:
        """Velocity of the receiver, measured or from the positions, shape (n,) [m/s]."""
        return np.gradient(self.place, self.dt) if self.velocity is None else self.velocity

    @property
    def turned(self) -> Array:
        """Integral of the measured turning rate, shape (n,); NaN without one [rad]."""
        if self.yaw_rate is None:
            return np.full(self.place.size, np.nan)
        turned = scipy.integrate.cumulative_trapezoid(self.yaw_rate, dx=self.dt, initial=0.0)
        return np.asarray(turned)


class Windows(NamedTuple):
    """Parts of logs."""

    log: Indices  # index of the log
    first: Indices  # first and last sample
    last: Indices
    begin: Indices  # first and last sample with a new pose
    end: Indices
    length: Array  # of the path [m]

    def take(self, rows: Mask | Indices) -> Windows:
        """Return some of the windows."""
        log, first, last, begin, end = (part[rows] for part in self[:5])
        return Windows(log, first, last, begin, end, self.length[rows])

    def names(self, logs: Sequence[DriveLog], kind: str) -> Names:
        """Return the surface or campaign of each window."""
        return np.array([getattr(log, kind) for log in logs])[self.log]


def age_of_poses(log: DriveLog) -> float | None:
    """Return the age at which turns of headings and of the measured rate agree best [s].

    None is returned without a heading, a turning rate, or turns.
    """
    if log.heading is None or log.yaw_rate is None:
        return None
    sums, rows = log.turned, np.flatnonzero(log.fresh)
    rows = rows[rows >= round(MAX_AGE / log.dt)]
    pairs = np.column_stack([rows[:-4], rows[4:]])
    pairs = pairs[(np.diff(log.piece[pairs], axis=1) == 0)[:, 0]]
    if not pairs.size or np.ptp(sums) < LEAST_TURN:
        return None
    ages, turned = np.arange(0.0, MAX_AGE, 0.025), np.diff(log.heading[pairs], axis=1)[:, 0]
    samples = np.arange(sums.size)
    missed = [
        np.abs(np.diff(np.interp(pairs - age / log.dt, samples, sums), axis=1)[:, 0] - turned)
        for age in ages
    ]
    return float(ages[int(np.mean(missed, axis=1).argmin())])


def size_of(logs: Sequence[DriveLog]) -> tuple[float, float]:
    """Return travel over the integral of the inputs, and the effective track of a vehicle [m].

    Both are rough: the upper quartile of travel, which slip reduces, and a regression of turns,
    over a second each.
    """
    parts = list[Array]()
    for log in logs:
        step = chord(log.dt)
        rows = np.flatnonzero((log.piece[step:] == log.piece[:-step]) & log.good[step:])
        course = courses(log) if log.heading is None else unit_vectors(log.heading)
        turn = np.angle(course[rows + step] * course[rows].conj())
        sums = np.cumsum(log.inputs @ [[0.5, -1], [0.5, 1]], axis=0) * log.dt
        travel, driven = (each[rows + step] - each[rows] for each in (log.place, sums))
        parts.append(np.column_stack([np.abs(travel), turn, driven]))
    every = np.concatenate(parts)
    travel, turn, driven, difference = every[np.isfinite(every).all(axis=1)].T
    is_fast = np.abs(driven) >= max(float(np.median(np.abs(driven))), 1e-9)
    ratio = float(np.quantile(travel[is_fast] / np.abs(driven[is_fast]), 0.75))
    track = ratio * (difference @ difference) / max(float(difference @ turn), 1e-9)
    return ratio, float(np.clip(track, 0.05, 20.0))


def held_for(changes: Mask) -> int:
    """Return the usual number of samples between new values; 1 if each sample is new."""
    rows = np.flatnonzero(changes)
    period = float(np.median(np.diff(rows))) if rows.size > 2 else 1.0
    return round(period) if period >= HELD else 1


def without_holds(values: Array, run: Indices, longest: float = np.inf) -> tuple[Array, int]:
    """Return readings that are linear between new ones, and the usual number of samples.

    A reading that does not change for longer is new after the usual number of samples. Readings
    that are new more rarely than every `longest` samples change in steps.
    """
    is_new = np.append(False, (np.diff(values) != 0) & (np.diff(run) == 0))
    period = held_for(is_new)
    if period == 1 or period > longest:
        return values, 1
    rows = np.flatnonzero(is_new | np.append(True, np.diff(run) != 0))
    waits = np.diff(np.append(rows, values.size))
    again = rows[waits > 1.5 * period] + waits[waits > 1.5 * period] - period
    rows = np.union1d(rows, again)
    return by_runs(np.arange(values.size), run, rows, run[rows], values[rows]), period


def by_runs(
    at: Any,
    run_at: Indices,
    t: Any,
    run: Indices,
    values: Array,
    width: float = 0.0,
    hold: float | None = None,
) -> Array:
    """Return values at other times or samples, linear between those of the same run.

    With a ``width``, they are means over it. Values with a ``hold`` remain for this time, until the
    next one, and are zero after it. Runs without values are NaN.
    """
    found = np.full(at.size, np.nan)
    for number in np.unique(run_at):
        here, own = run_at == number, run == number
        if own.any():
            found[here] = _sampled(at[here], t[own], values[own], width, hold)
    return found


def _sampled(at: Array, t: Array, values: Array, width: float, hold: float | None) -> Array:
    if hold is not None:
        late = np.flatnonzero(np.diff(t) > hold)
        t, values = np.insert(t, late + 1, t[late] + hold), np.insert(values, late + 1, 0.0)

    def value(times: Array) -> Array:
        rows = np.searchsorted(t, times + ROUNDING, side="right") - 1
        return np.interp(times, t, values) if hold is None else values[rows]

    if t[-1] - t[0] <= width or not width:
        return value(at)
    ends = np.clip(np.add.outer([-width / 2, width / 2], at), t[0], t[-1])
    knots = np.union1d(t, ends)
    means = value((knots[1:] + knots[:-1]) / 2)  # between knots, values are linear or constant
    low, high = np.interp(ends, knots, np.append(0.0, np.cumsum(means * np.diff(knots))))
    mean = np.asarray((high - low) / (ends[1] - ends[0]))
    mean[[0, -1]] = value(at[[0, -1]])
    mean[1:-1] -= np.diff(mean, 2) / 8  # the trapezoidal rule then gives the integral
    return mean


def courses(log: DriveLog) -> ComplexArray:
    """Return velocities along a line through the positions of a chord, shape (n,).

    With measured velocities, the result is the mean direction of both, since a line through
    positions weighs the velocities between them by a parabola.
    """
    k, line = chord_line(log.dt)
    course = scipy.ndimage.correlate1d(log.place, line, mode="nearest")
    if log.velocity is None:
        return np.asarray(course)
    weights = k[-1] * (k[-1] + 1) - k**2
    speeds = scipy.ndimage.correlate1d(log.velocity, weights / weights.sum(), mode="nearest")
    with np.errstate(invalid="ignore"):
        mean = course / np.abs(course) + speeds / np.abs(speeds)
        return np.asarray(mean / np.abs(mean))


def chord_line(dt: float) -> tuple[Indices, Array]:
    """Return the samples of a chord about its middle, and their weights in the slope of a line."""
    k = np.arange(-chord(dt), chord(dt) + 1)
    return k, k / (dt * (k**2).sum())


def chord(dt: float) -> int:
    """Return the number of samples of half a chord."""
    return round(CHORD / dt)


def windows_of(logs: Sequence[DriveLog], length: float = 0.0, duration: float = 0.0) -> Windows:
    """Return the windows of a length of path [m] or a duration [s]; they do not overlap.

    Without both, the windows are the pieces of the logs. A window lies in one piece and one run,
    85 % of its samples are good, and its positions agree with measured velocities to 0.1 m + 5 % of
    the path. It begins a second after the start of a run or later, since the motion before a run is
    unknown. Without headings, it begins and ends where the vehicle drives in one direction with
    good positions for a second before and after.
    """
    rows = list[tuple[int, int, int, int, int, float]]()
    for k, log in enumerate(logs):
        ends = np.logical_and.reduce([*conditions(log).values()])
        first_of_run = np.searchsorted(log.run, log.run)
        begins = ends & (np.arange(ends.size) - first_of_run >= round(SETTLED / log.dt))
        speed = np.abs(log.moved)
        path = np.append(0.0, np.cumsum(speed[1:] * (speed[1:] > SLOW / 2)) * log.dt)
        old = round(OLD / log.dt) if held_for(log.fresh) > 1 else 0
        fresh = np.flatnonzero(log.fresh & log.good)
        whole = np.flatnonzero(np.append(True, np.diff(log.piece) != 0))
        pieces = np.column_stack([whole, np.append(whole[1:], log.piece.size) - 1])
        i, count = 0, log.place.size
        step = max(chord(log.dt) // 2, 1)
        spans = list[tuple[int, int]]()
        if not length and not duration:
            spans = [(int(a), int(b)) for a, b in pieces if b > a]
        while (length or duration) and i < count - 1:
            far = length and int(np.searchsorted(path, path[i] + length))
            j = far or i + round(duration / log.dt)
            is_inside = begins[i] and j < count and log.piece[i] == log.piece[j]
            if is_inside and log.run[i] == log.run[j] and ends[j]:
                spans.append((i, j))
            i += 1 if not begins[i] else (j - i if spans and spans[-1] == (i, j) else step)
        for i, j in spans:
            own = fresh[np.searchsorted(fresh, i + old) : np.searchsorted(fresh, j, side="right")]
            if own.size < 2 or own[-1] - own[0] < MIN_SPAN * (j - i):
                continue
            if log.velocity is not None:
                drift = log.velocity[i:j].sum() * log.dt - log.place[j] + log.place[i]
                if np.abs(drift) > DRIFT[0] + DRIFT[1] * (path[j] - path[i]):
                    continue
            if log.good[i:j].mean() >= GOOD_SHARE:
                rows.append((k, i, j, int(own[0]), int(own[-1]), float(path[j] - path[i])))
    if not rows:
        raise ModelError(
            "windows: expected at least one part of a log in which the vehicle drives with good "
            "positions, found none; use longer logs or shorter windows"
        )
    return Windows(*map(np.array, zip(*rows, strict=True)))


def conditions(log: DriveLog) -> dict[str, Mask]:
    """Return where a window may begin or end, by the reason for which it may not elsewhere."""
    if log.heading is not None:
        return {"at positions that are not good": log.good}
    half = chord(log.dt)
    # with a margin of half a second
    inside = _throughout(np.ones(log.place.size, bool), half + 5)
    found = {
        "near the ends of the log": inside,
        "near positions that are not good": _throughout(log.good, half),
        f"slower than {SLOW:g} m/s": _throughout(np.abs(log.moved) > SLOW, half),
    }
    if log.direction is not None:
        wide = half + 2  # of commands, which precede the motion
        ways = [_throughout(sign * log.direction > 0, wide) for sign in (1, -1)]
        found["commands to stand or to turn back"] = ways[0] | ways[1]
    return found


def _throughout(mask: Mask, half: int) -> Mask:
    """Return where a mask holds for ``half`` samples before and after."""
    return np.asarray(scipy.ndimage.binary_erosion(mask, np.ones(2 * half + 1)), bool)


STEEPEST = 0.55  # largest sine of a slope: steeper cells of a map are walls, trees or errors


class Slopes:
    """Slope of a height map, averaged over the size of a vehicle; bilinear between the nodes.

    ``smoothing`` is the standard deviation of a Gaussian [m]; ``grid`` has the averaged heights.
    """

    def __init__(self, grid: Grid, smoothing: float) -> None:
        steps = float(grid.x[1] - grid.x[0]), float(grid.y[1] - grid.y[0])
        heights = averaged(grid.z, steps, smoothing) if smoothing else grid.z
        self.grid = Grid(grid.x, grid.y, heights)
        x, y = (np.gradient(heights, step, axis=k) for k, step in enumerate(steps))
        node = np.asarray(x + 1j * y)
        first, right, ahead = node[:-1, :-1], node[1:, :-1], node[:-1, 1:]
        bend = node[1:, 1:] - right - ahead + first
        # of each cell: bilinear in the shares of its sides
        self._cells = np.stack([first, right - first, ahead - first, bend], -1).reshape(-1, 4)
        self._last = np.array(grid.z.shape) - 1
        self._first = np.array([grid.x[0], grid.y[0]])
        self._steps = np.array(steps)

    def tilt(self, place: ComplexArray, heading: Array) -> tuple[Array, Array]:
        """Return the sines of the nose-up and left-up angles of vehicles.

        Places are complex numbers [m], headings count from x [rad]; beyond the map the slope is
        that of its border.
        """
        (x, y), (dx, dy), (nx, ny) = self._first, self._steps, self._last
        f = np.minimum(np.maximum((place.real - x) / dx, 0), nx - 1e-9)
        g = np.minimum(np.maximum((place.imag - y) / dy, 0), ny - 1e-9)
        i, j = f.astype(int), g.astype(int)
        f, g = f - i, g - j
        cell = self._cells[i * int(ny) + j]
        gradient = cell[..., 0] + f * cell[..., 1] + g * (cell[..., 2] + f * cell[..., 3])
        turned = gradient * unit_vectors(-heading)
        ahead, left = turned.real, turned.imag
        square = ahead**2
        along = np.sqrt(1 + square)
        left = left / (along * np.sqrt(1 + square + left**2))
        return _bounded(ahead / along), _bounded(left)


def _bounded(sine: Array) -> Array:
    return np.minimum(np.maximum(sine, -STEEPEST), STEEPEST)


def unit_vectors(angle: Array) -> ComplexArray:
    """Return complex numbers of size one; faster than the complex exponential."""
    direction = np.empty(angle.shape, dtype=complex)
    direction.real, direction.imag = np.cos(angle), np.sin(angle)
    return direction


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
    effective_track: float = 1.0  # nominal, of vehicles whose dimensions are not known [m]

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
            found[name] = np.where(of_window[BALANCE[name].of] == unknown.of, own, found[name])
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
        chassis = [log.chassis for log in logs]
        self._chassis = chassis[0]
        if any(each.place.shape[1] > 1 for each in chassis):  # at the rows of all logs
            parts = [
                [np.broadcast_to(part, (len(part), n)) for part in each[:3]]
                for each, n in zip(chassis, count.tolist(), strict=True)
            ]
            place, direction, free = (np.hstack(each) for each in zip(*parts, strict=True))
            self._chassis = chassis[0]._replace(place=place, direction=direction, free=free)
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
        size = q["effective_track"] / self.model.effective_track
        constants = Constants(
            lanes.radius,
            size * q["track"] / (2 * self.model.half_track),
            q["center_of_mass_ahead"] - 1j * q["center_of_mass_right"],
            q["stiffness"],
            q["gyration"],
            q["friction"],
            q["rolling"],
            q["anisotropy"],
            q["turn_slope"],
            length=size,
            inertia=float(self.model.fixed.get("inertia", 1.0)),
        )
        # inputs after delay and lag, shape (q, m or 1, rows)
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
        return simulate(
            self._chassis,
            constants,
            signals[:, index.ravel()],
            self._rows,
            self._dt,
            tilt,
            self._lengths,
            self._lead - round(RECENT / self._dt),
        )


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
        """Return the sines of the nose-up and left-up angles at step ``k``.

        Until the start of a window, positions are measured and headings follow from the course;
        then both are predicted by the trapezoidal rule. ``velocity`` is forward + i left [m/s],
        ``turning`` the yaw rate [rad/s].
        """
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
