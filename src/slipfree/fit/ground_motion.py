"""Motion of a skid-steered vehicle over a map, from the commanded speeds of its sides.

The models need no dimensions of the vehicle: their constants are fitted to logs of positions. The
slope under the vehicle is that of the map at the predicted position and heading, never that of the
measured path, so that a prediction uses nothing but the map, the start and the commands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # its parts are imported when they are used, since this takes 0.3 s

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Mask
from slipfree.fit.unknowns import Unknown
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import averaged

CHORD = 1.0  # half the time over which a line through positions gives a course [s]
LEAST_LAG = 1e-3  # shorter lags count as none [s]
STEEPEST = 0.55  # largest sine of a slope: steeper cells of a map are walls, trees or errors
ComplexArray = npt.NDArray[np.complex128]
Rates = tuple[Array, Array, Array]  # forward and leftward speed [m/s], and turning rate [rad/s]
Values = Mapping[str, Array]  # constants of n motions, each of shape (n,)
# (values, speeds of the left and right side, sine of the nose-up angle) -> rates
Step = Callable[[Values, Array, Array, Array], Rates]


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
        gradient = cell[:, 0] + f * cell[:, 1] + g * (cell[:, 2] + f * cell[:, 3])
        turned = gradient * _direction(-heading)
        ahead, left = turned.real, turned.imag
        square = ahead**2
        along = np.sqrt(1 + square)
        left = left / (along * np.sqrt(1 + square + left**2))
        return _bounded(ahead / along), _bounded(left)


def _bounded(sine: Array) -> Array:
    return np.minimum(np.maximum(sine, -STEEPEST), STEEPEST)


def _direction(angle: Array) -> ComplexArray:
    """Return complex numbers of size one; faster than the complex exponential."""
    direction = np.empty(angle.shape, dtype=complex)
    direction.real, direction.imag = np.cos(angle), np.sin(angle)
    return direction


class DriveLog(NamedTuple):
    """A log of commands and positions, with samples at equal intervals.

    Positions are those of the receiver. Headings are measured from their first axis.
    """

    name: str
    group: str  # of logs that are left out together, such as a campaign
    dt: float  # time between samples [s]
    place: Array  # shape (n, 2): position of the receiver on the map [m]
    velocity: Array  # shape (n, 2): of the receiver [m/s]
    speed: Array  # shape (n,): of the receiver [m/s]
    good: Mask  # shape (n,): samples with reliable positions
    direction: Array  # shape (n,): 1 where the command is ahead, -1 back, 0 neither
    sides: Array  # shape (n, 2): commanded speeds of the left and the right side [m/s]
    is_velocity_measured: bool = True  # by the receiver; otherwise the derivative of the positions
    heading: Array | None = None  # shape (n,): of a sensor, continuous over turns [rad]


class PathWindows(NamedTuple):
    """Parts of logs: index of the log, first and last sample, and length of the path [m]."""

    log: Array
    first: Array
    last: Array
    length: Array

    def take(self, rows: Mask) -> PathWindows:
        """Return some of the windows."""
        return PathWindows(*(part[rows] for part in self))


def windows_of(logs: Sequence[DriveLog], length: float = 0.0, duration: float = 0.0) -> PathWindows:
    """Return the windows of a length of path [m] or a duration [s]; they do not overlap.

    A window begins and ends where the vehicle drives in one direction with good positions for a
    second before and after. 85 % of its samples are good, and its positions agree with the
    velocities to 0.1 m + 5 % of the path.
    """
    rows = list[tuple[int, int, int, float]]()
    for k, log in enumerate(logs):
        half, count = round(CHORD / log.dt), len(log.speed)
        if count < 2 * half + 10:  # no sample has a chord before and after, with a margin
            continue
        s = np.append(0.0, np.cumsum(log.speed[1:] * (log.speed[1:] > 0.1)) * log.dt)
        ends = np.logical_and.reduce([*conditions(log).values()])
        ends[: half + 5] = ends[count - half - 5 :] = False
        i = 0
        while i < count - 1:
            j = int(np.searchsorted(s, s[i] + length)) if length else i + round(duration / log.dt)
            if not ends[i]:
                i += 1
                continue
            step = max(half // 2, 1)
            if j < count and ends[j]:
                path, moved = s[j] - s[i], log.place[j] - log.place[i]
                drift = log.velocity[i:j].sum(axis=0) * log.dt - moved
                if np.hypot(*drift) <= 0.1 + 0.05 * path and log.good[i:j].mean() >= 0.85:
                    rows.append((k, i, j, float(path)))
                    step = j - i
            i += step
    if not rows:
        raise ModelError(
            "windows: expected at least one part of a log in which the vehicle drives with good "
            "positions, found none; use longer logs or shorter windows"
        )
    table = np.array(rows)
    log, first, last = table[:, :3].T.astype(int)
    return PathWindows(log, first, last, table[:, 3])


def conditions(log: DriveLog) -> dict[str, Mask]:
    """Return where a window may begin or end, by the reason for which it may not elsewhere."""
    half = round(CHORD / log.dt)
    wide = half + 2  # of commands, which precede the motion
    one_way = _throughout(log.direction > 0, wide) | _throughout(log.direction < 0, wide)
    return {
        "near positions that are not good": _throughout(log.good, half),
        "slower than 0.25 m/s": _throughout(log.speed > 0.25, half),
        "commands to stand or to turn back": one_way,
    }


def _throughout(mask: Mask, half: int) -> Mask:
    """Return where a mask holds for ``half`` samples before and after."""
    width = 2 * half + 1
    return np.convolve(mask, np.ones(width), "same") > width - 0.5


class Tour(NamedTuple):
    """Starts and commands of n motions over a map, the longest motion first."""

    place: ComplexArray  # shape (n,): start [m]
    heading: Array  # shape (n,): at the start [rad]
    left: Array  # shape (m, n): commanded speeds of the sides [m/s]
    right: Array
    steps: Array  # shape (n,): numbers of steps, at most m
    dt: float  # [s]
    slopes: Slopes


class MotionModel(NamedTuple):
    """A model of the motion: constants with start values and bounds, and the paths it predicts."""

    words: str
    start: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    units: dict[str, str]
    # places and headings at the samples, shape (m + 1, n), undefined after the end of a motion
    paths: Callable[[Values, Tour], tuple[ComplexArray, Array]]


def integrate_rates(step: Step, values: Values, tour: Tour) -> tuple[ComplexArray, Array]:
    """Return the paths of a model whose rates depend on the slope at the vehicle."""
    place, heading, n = tour.place, tour.heading, len(tour.place)
    shape = len(tour.left) + 1, n
    places, headings = np.zeros(shape, dtype=complex), np.zeros(shape)
    places[0], headings[0] = place, heading
    for k in range(len(tour.left)):
        if n != (n := int(np.searchsorted(-tour.steps, -k))):  # motions that go on
            values = {name: each[:n] for name, each in values.items()}
            place, heading = place[:n], heading[:n]
        up, tilt = tour.slopes.tilt(place, heading)
        v, side, turn = step(values, tour.left[k, :n], tour.right[k, :n], up)
        # speeds are along the slope, places on the map
        moved = v * np.sqrt(1 - up**2) + 1j * (side * np.sqrt(1 - tilt**2))
        place = place + tour.dt * moved * _direction(heading + tour.dt / 2 * turn)
        heading = heading + tour.dt * turn
        places[k + 1, :n], headings[k + 1, :n] = place, heading
    return places, headings


def _differential(p: Values, left: Array, right: Array, _: Array) -> Rates:
    return p["scale"] * (left + right) / 2, 0 * left, p["scale"] * (right - left) / p["track"]


def _icr(p: Values, left: Array, right: Array, _: Array) -> Rates:
    """Centres of rotation of the sides at fixed places (Mandow et al., IROS 2007)."""
    left, right = p["scale_left"] * left, p["scale_right"] * right
    width = p["left"] - p["right"]
    turn = (right - left) / width
    return (right * p["left"] - left * p["right"]) / width, -p["ahead"] * turn, turn


def _straight(p: Values, left: Array, right: Array, _: Array) -> Rates:
    return p["scale"] * (left + right) / 2, 0 * left, 0 * left


def slope_rates(p: Values, left: Array, right: Array, up: Array) -> Rates:
    """Slip along a slope, and turns that are tighter downhill than uphill."""
    mean = (left + right) / 2
    turn = (right - left + 2 * p["drift"] * mean) / p["track"] * np.exp(-p["turn_slope"] * up)
    return p["scale"] * mean - p["slip_slope"] * np.abs(mean) * up, 0 * left, turn


# constants of drives and sensors, which any model may have besides its own: start values
DRIVES_AND_SENSORS = {
    "turn": 1.0,
    "speed_lag": 0.05,
    "turn_lag": 0.1,
    "sensor_right": 0.0,
    "sensor_ahead": 0.0,
    "sensor_heading": 0.0,
}
_SCALE = (0.5, 1.5)
_BOUNDS = {
    "scale": _SCALE,
    "scale_left": _SCALE,
    "scale_right": _SCALE,
    "track": (0.02, 20.0),
    "left": (0.01, 10.0),
    "right": (-10.0, -0.01),
    "ahead": (-2.0, 2.0),
    "drift": (-0.5, 0.5),
    "turn": (0.05, 20.0),
    "slip_slope": (-3.0, 3.0),
    "turn_slope": (-8.0, 8.0),
    "speed_lag": (0.0, 3.0),
    "turn_lag": (0.0, 3.0),
    "sensor_right": (-5.0, 5.0),
    "sensor_ahead": (-5.0, 5.0),
    "sensor_heading": (-7.0, 7.0),  # a turn to either side, without an edge near half a turn
}
_UNITS = dict.fromkeys(
    ("track", "left", "right", "ahead", "sensor_right", "sensor_ahead", "sensor_heading"), "m"
) | {"speed_lag": "s", "turn_lag": "s", "sensor_heading": "rad"}


def _model(words: str, start: dict[str, float], step: Step) -> MotionModel:
    return MotionModel(
        words,
        start,
        {name: _BOUNDS[name] for name in start},
        {name: _UNITS.get(name, "1") for name in start},
        partial(integrate_rates, step),
    )


MODELS = {
    "straight": _model("straight on at the commanded speed", {"scale": 1.0}, _straight),
    "differential": _model("differential drive", {"scale": 1.0, "track": 0.7}, _differential),
    "icr": _model(
        "five-parameter ICR",
        {"scale_left": 1.0, "scale_right": 1.0, "left": 0.35, "right": -0.35, "ahead": 0.0},
        _icr,
    ),
    "slope": _model(
        "slip and turning by the slope",
        {"scale": 1.0, "track": 0.7, "drift": 0.01, "slip_slope": 0.1, "turn_slope": 1.0},
        slope_rates,
    ),
}


def with_drives_and_sensors(model: MotionModel, unknowns: Sequence[Unknown]) -> MotionModel:
    """Return a model with those unknowns that are constants of drives and sensors."""
    added = [
        each
        for each in unknowns
        if each.quantity in DRIVES_AND_SENSORS and each.quantity not in model.start
    ]
    bounds = {}
    for each in added:
        low, high = _BOUNDS[each.quantity]
        bounds[each.quantity] = max(low, each.lower), min(high, each.upper)
    start = {each.quantity: DRIVES_AND_SENSORS[each.quantity] for each in added}
    return model._replace(
        start=model.start | {name: float(np.clip(at, *bounds[name])) for name, at in start.items()},
        bounds=model.bounds | bounds,
        units=model.units | {name: _UNITS.get(name, "1") for name in start},
    )


class PathErrors(NamedTuple):
    """Predicted minus measured ends of windows."""

    along: Array  # along and to the left of the measured displacement [m]
    across: Array
    course: Array  # or heading, of logs with a sensor of it [rad]
    displacement: Array  # measured [m]

    @property
    def position(self) -> Array:
        """Distances of predicted from measured ends [m]."""
        return np.hypot(self.along, self.across)


class GroundPredictor:
    """Predictions of windows: the same course at the start as measured, then commands only.

    The measured course is the mean of those of a line through the positions of a chord, and of the
    receiver's velocities with the equivalent weights. Without measured velocities it is the former;
    with a sensor of the heading in all logs, the heading takes its place. ModelError is raised
    without windows.
    """

    def __init__(self, logs: Sequence[DriveLog], windows: PathWindows, slopes: Slopes) -> None:
        if not windows.log.size:
            raise ModelError(
                "windows: expected at least one in the fitted logs, found none; use longer logs or "
                "shorter windows"
            )
        self.windows, self._slopes = windows, slopes
        self._dt = dt = logs[0].dt
        self._half = half = round(CHORD / dt)
        steps = windows.last - windows.first + 2 * half  # with a chord before and after
        self._order = np.argsort(-steps, kind="stable")
        self._steps = steps[self._order]
        k = np.arange(-half, half + 1)
        self._line = k / (dt * (k**2).sum())  # slope of a line through the positions of a chord
        first = (windows.first - half)[self._order]
        self._logs = [log.sides for log in logs]
        own, count = windows.log[self._order], np.array([len(log.sides) for log in logs])
        at = first + np.arange(int(self._steps.max()) + 1)[:, None]
        self._rows = np.append(0, np.cumsum(count))[own] + np.minimum(at, count[own] - 1)
        z = np.concatenate([log.place for log in logs]) @ [1, 1j]
        seen = z[self._rows]
        rows = np.arange(len(first))
        self._last = self._steps - half, rows
        self._ends = self._last[0] + k[:, None], rows
        self._start, self._moved = seen[0], seen[self._last] - seen[half]
        angles = [log.heading for log in logs if log.heading is not None]
        self._has_headings = len(angles) == len(logs)
        if self._has_headings:
            heading = np.exp(1j * np.concatenate(angles))[self._rows]
            self._course, self._final = heading[half], heading[self._last]
            return
        self._course = self._line @ seen[: 2 * half + 1]
        self._final = self._line @ seen[self._ends]
        if all(log.is_velocity_measured for log in logs):
            speeds = (np.concatenate([log.velocity for log in logs]) @ [1, 1j])[self._rows]
            # a line through positions weighs the velocities between them like this
            weights = half * (half + 1) - k**2
            self._course = _mean_course(self._course, weights @ speeds[: 2 * half + 1])
            self._final = _mean_course(self._final, weights @ speeds[self._ends])

    def __call__(self, model: MotionModel, values: Mapping[str, float | Array]) -> PathErrors:
        """Return the errors of a model of n windows, shape (n,).

        If values of constants are arrays of shape (m,), each with a value for a prediction, errors
        have the shape (n, m).
        """
        count = max(np.size(each) for each in values.values())
        path, heading = self._paths(model, values, count)
        half = self._half
        if self._has_headings:
            direction = np.exp(1j * (heading + values.get("sensor_heading", 0.0)))
            own, final = direction[half], direction[self._last]
        else:
            own, final = (
                np.tensordot(self._line, each, 1)
                for each in (path[: 2 * half + 1], path[self._ends])
            )
        course, displacement = self._course[:, None], self._moved[:, None]
        spin = course / np.abs(course) * np.abs(own) / np.where(own == 0, 1, own)
        missed = spin * (path[self._last] - path[half]) - displacement
        missed = missed * np.abs(displacement) / displacement
        turned = np.angle(final * spin / self._final[:, None])
        back = np.argsort(self._order)
        if all(np.ndim(each) == 0 for each in values.values()):
            missed, turned = missed[:, 0], turned[:, 0]
        size = np.abs(self._moved)
        return PathErrors(missed.real[back], missed.imag[back], turned[back], size[back])

    def _paths(
        self, model: MotionModel, values: Mapping[str, float | Array], count: int
    ) -> tuple[ComplexArray, Array]:
        """Return predicted positions and headings, (n_samples, n, count), from a chord before."""
        n, half = len(self._start), self._half
        mean, difference = self._commands(values, count)
        lanes = {name: np.tile(np.broadcast_to(each, count), n) for name, each in values.items()}
        none = np.zeros(n * count)
        receiver = lanes.get("sensor_ahead", none) - 1j * lanes.get("sensor_right", none)
        course = np.repeat(np.angle(self._course), count)
        if self._has_headings:
            course = course - lanes.get("sensor_heading", none)
        tour = Tour(
            np.repeat(self._start, count) - receiver * np.exp(1j * course),
            course,
            mean - difference,
            mean + difference,
            np.repeat(self._steps, count),
            self._dt,
            self._slopes,
        )
        # the heading one chord before the start, from the measured course at the start
        chord = tour._replace(left=tour.left[:half], right=tour.right[:half])
        turned = model.paths(lanes, chord)[1][-1] - course
        place, heading = model.paths(lanes, tour._replace(heading=course - turned))
        if receiver.any():
            place = place + receiver * _direction(heading)
        return place.reshape(-1, n, count), heading.reshape(-1, n, count)

    def _commands(self, values: Mapping[str, float | Array], count: int) -> list[Array]:
        """Return mean and half difference of the sides' speeds after lags, (n_steps, n count)."""
        signals = list[Array]()
        for name, sign in (("speed_lag", 1), ("turn_lag", -1)):
            parts = (
                _lagged((right + sign * left) / 2, values.get(name, 0.0), self._dt)
                for left, right in (sides.T for sides in self._logs)
            )
            signals.append(np.concatenate([*parts], axis=0))
        signals[1] = signals[1] * values.get("turn", 1.0)
        return [
            np.repeat(each, count // each.shape[1], axis=1)[self._rows[:-1]].reshape(
                len(self._rows) - 1, -1
            )
            for each in signals
        ]


def _mean_course(one: ComplexArray, other: ComplexArray) -> ComplexArray:
    """Return the mean direction of velocities, as complex numbers of size one."""
    mean = one / np.abs(one) + other / np.abs(other)
    return np.asarray(mean / np.abs(mean))


def _lagged(signal: Array, lags: float | Array, dt: float) -> Array:
    """Return the means over the steps of a held signal after first-order lags [s], by columns."""
    columns = list[Array]()
    for lag in np.ravel(lags).tolist():
        keep = float(np.exp(-dt / lag)) if lag > LEAST_LAG else 0.0
        before = scipy.signal.lfilter([0, 1 - keep], [1, -keep], signal, zi=[signal[0]])[0]
        columns.append(signal + lag / dt * (1 - keep) * (before - signal))
    return np.column_stack(columns)
