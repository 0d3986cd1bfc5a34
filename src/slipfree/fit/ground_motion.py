"""Motion of a skid-steered vehicle over a map, from the commanded speeds of its sides.

The models need no dimensions of the vehicle: their constants are fitted to logs of positions. The
slope under the vehicle is that of the map at the predicted position and heading, never that of the
measured path, so that a prediction uses nothing but the map, the start and the commands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy  # its parts are imported when they are used, since this takes 0.3 s

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Mask
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import averaged

CHORD = 1.0  # half the time over which a line through positions gives a course [s]
LEAST_LAG = 1e-3  # shorter lags count as none [s]
STEEPEST = 0.55  # largest sine of a slope: steeper cells of a map are walls, trees or errors
HALF_BASE, HALF_TRACK = 0.4, 0.4  # of the four wheels [m]
FRICTION = 0.6  # only ratios to it count: creep, resistance
LEAST_SHARE = 0.03  # of the weight on an axle or a side
RESISTED = 0.05  # speed from which the rolling resistance is complete [m/s]
# of the balance, which converges quadratically; tolerance of a step in m/s and rad/s
NEWTON_STEPS, NEWTON_TOLERANCE = 30, 3e-5
Rates = tuple[Array, Array, Array]  # forward and leftward speed [m/s], and turning rate [rad/s]
Values = Mapping[str, float]
# (values, speeds of the left and right side, sines of the nose-up and left-up angles, rates a
# moment before) -> rates
Step = Callable[[Values, Array, Array, Array, Array, Rates | None], Rates]


class Slopes:
    """Slope of a height map, averaged over the size of a vehicle; bilinear between the nodes.

    ``smoothing`` is the standard deviation of a Gaussian [m], and ``shift`` the place of the map
    that belongs to the origin of the logs, relative to that of the map [m].
    """

    def __init__(
        self, grid: Grid, smoothing: float, shift: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        steps = float(grid.x[1] - grid.x[0]), float(grid.y[1] - grid.y[0])
        heights = averaged(grid.z, steps, smoothing) if smoothing else grid.z
        gradient = np.gradient(heights, *steps)
        self._table = np.stack([*gradient], axis=-1).reshape(-1, 2)
        self._shape = grid.z.shape
        self._first = np.array([grid.x[0] - shift[0], grid.y[0] - shift[1]])
        self._steps = np.array(steps)

    def __call__(self, place: Array) -> Array:
        """Return the gradient at places, shape (n, 2); beyond the map that of its border."""
        last = np.array(self._shape) - 1
        cell = np.clip((place - self._first) / self._steps, 0, last - 1e-9)
        whole = cell.astype(int)
        f, g = cell[:, :1] - whole[:, :1], cell[:, 1:] - whole[:, 1:]
        k = whole[:, 0] * self._shape[1] + whole[:, 1]
        table, row = self._table, self._shape[1]
        near = (1 - g) * table[k] + g * table[k + 1]
        return np.asarray((1 - f) * near + f * ((1 - g) * table[k + row] + g * table[k + row + 1]))

    def tilt(self, place: Array, heading: Array) -> tuple[Array, Array]:
        """Return the sines of the nose-up and left-up angles of vehicles; heading from x [rad]."""
        (x, y), c, s = self(place).T, np.cos(heading), np.sin(heading)
        ahead = x * c + y * s
        along = np.sqrt(1 + ahead**2)
        left = (y * c - x * s) / (along * np.sqrt(1 + x**2 + y**2))
        return np.clip(ahead / along, -STEEPEST, STEEPEST), np.clip(left, -STEEPEST, STEEPEST)


class DriveLog(NamedTuple):
    """A log of commands and positions, with samples at equal intervals.

    Positions are those of the receiver. Headings are measured from their first axis.
    """

    name: str
    group: str  # of logs that are left out together, such as a campaign
    dt: float  # time between samples [s]
    place: Array  # shape (n, 2): position of the receiver [m]
    velocity: Array  # shape (n, 2): measured, or the derivative of the positions [m/s]
    speed: Array  # shape (n,): of the receiver [m/s]
    good: Mask  # shape (n,): samples with reliable positions
    direction: Array  # shape (n,): 1 where the command is ahead, -1 back, 0 neither
    sides: Array  # shape (n, 2): commanded speeds of the left and the right side [m/s]


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
        wide = half + 2  # of commands, which precede the motion
        calm = _throughout(log.speed > 0.25, half) & _throughout(log.good, half)
        steady = _throughout(log.direction > 0, wide) | _throughout(log.direction < 0, wide)
        ends = calm & steady
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


def _throughout(mask: Mask, half: int) -> Mask:
    """Return where a mask holds for ``half`` samples before and after."""
    width = 2 * half + 1
    return np.convolve(mask, np.ones(width), "same") > width - 0.5


class MotionModel(NamedTuple):
    """A model of the motion: constants with start values and bounds, and its rates."""

    words: str
    start: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    units: dict[str, str]
    step: Step


def _differential(p: Values, left: Array, right: Array, *_: object) -> Rates:
    return p["scale"] * (left + right) / 2, 0 * left, p["scale"] * (right - left) / p["track"]


def _icr(p: Values, left: Array, right: Array, *_: object) -> Rates:
    """Centres of rotation of the sides at fixed places (Mandow et al., IROS 2007)."""
    left, right = p["scale_left"] * left, p["scale_right"] * right
    width = p["left"] - p["right"]
    turn = (right - left) / width
    return (right * p["left"] - left * p["right"]) / width, -p["ahead"] * turn, turn


def _straight(p: Values, left: Array, right: Array, *_: object) -> Rates:
    return p["scale"] * (left + right) / 2, 0 * left, 0 * left


def _slope(p: Values, left: Array, right: Array, up: Array, *_: object) -> Rates:
    """Slip along a slope, and turns that are tighter downhill than uphill."""
    mean = (left + right) / 2
    turn = (right - left + 2 * p["drift"] * mean) / p["track"] * np.exp(-p["turn_slope"] * up)
    return p["scale"] * mean - p["slip_slope"] * np.abs(mean) * up, 0 * left, turn


def _friction(
    p: Values, left: Array, right: Array, up: Array, tilt: Array, near: Rates | None
) -> Rates:
    """Equilibrium of four wheels with friction, creep and rolling resistance on a slope.

    With given loads, the equilibrium minimises a convex function of the body's velocity, the sum of
    friction times regularised sliding speed and of the work against gravity and resistance. A
    Newton step that does not reduce it is replaced by one with secant stiffness, which always does.
    Loads follow from the moments of gravity and of the wheels' forces about the contacts, as shares
    of the front and of the left side.
    """
    mean, half = (left + right) / 2, p["turn"] * (right - left) / 2
    mean, half = p["scale"] * mean, half + p["drift"] * mean
    drive = np.stack([mean - half, mean + half, mean - half, mean + half], axis=1)
    x, y = HALF_BASE * np.array([1, 1, -1, -1]) - p["ahead"], HALF_TRACK * np.array([1, -1, 1, -1])
    normal = np.sqrt(1 - up**2 - tilt**2)
    front = 0.5 + (p["ahead"] - p["height"] * up / normal) / (2 * HALF_BASE)
    on_left = 0.5 - p["height"] * tilt / normal / (2 * HALF_TRACK)
    front, on_left = (np.clip(share, LEAST_SHARE, 1 - LEAST_SHARE) for share in (front, on_left))
    shares = [front * on_left, front * (1 - on_left)]
    shares += [(1 - front) * on_left, (1 - front) * (1 - on_left)]
    load = normal[:, None] * np.stack(shares, axis=1)  # over the weight
    resistance = p["resistance"] * load * np.tanh(drive / RESISTED)
    grip, pulls = FRICTION * load, np.stack([up, tilt, 0 * up], axis=1)
    arms = np.stack([np.stack([1 + 0 * y, 0 * y, -y]), np.stack([0 * x, 1 + 0 * x, x])])
    constant = np.einsum("nw,cw->nc", resistance, arms[0]) + pulls

    def sliding(at: Array) -> tuple[Array, Array, Array, Array]:
        along, across = at @ arms[0] - drive, at @ arms[1]
        size = np.sqrt(along**2 + across**2 + p["creep"] ** 2)
        return along, across, size, (grip * size).sum(axis=1) + (constant * at).sum(axis=1)

    def step(k_xx: Array, k_xy: Array, k_yy: Array, force: Array) -> Array:
        pairs = ((k_xx, 0, 0), (k_xy, 0, 1), (k_xy, 1, 0), (k_yy, 1, 1))
        matrix = sum(np.einsum("nw,aw,bw->nab", k, arms[i], arms[j]) for k, i, j in pairs)
        return np.asarray(np.linalg.solve(matrix, force[..., None])[..., 0])

    at = np.stack([mean, 0 * mean, half / HALF_TRACK / 2] if near is None else near, axis=1)
    along, across, size, value = sliding(at)
    for _ in range(NEWTON_STEPS):
        k = grip / size
        force = (k * along) @ arms[0].T + (k * across) @ arms[1].T + constant
        k_xy = -k * along * across / size**2
        tangent = step(k * (1 - (along / size) ** 2), k_xy, k * (1 - (across / size) ** 2), force)
        new = at - tangent
        there = sliding(new)
        worse = ~(there[3] <= value + 1e-12)
        if worse.any():
            new[worse] = (at - step(k, 0 * k, k, force))[worse]
            there = sliding(new)
        moved, at = np.abs(new - at).max(), new
        along, across, size, value = there
        if moved < NEWTON_TOLERANCE:
            break
    return at[:, 0], at[:, 1], at[:, 2]


_SCALE, _TRACK, _LAGS = (0.5, 1.5), (0.02, 20.0), {"speed_lag": (0.0, 3.0), "turn_lag": (0.0, 3.0)}
_LAG_STARTS = {"speed_lag": 0.05, "turn_lag": 0.1}
_DIFFERENTIAL = {"scale": 1.0, "track": 0.7}
_ICR = {"scale_left": 1.0, "scale_right": 1.0, "left": 0.35, "right": -0.35, "ahead": 0.0}
_BOUNDS = {
    "scale": _SCALE,
    "scale_left": _SCALE,
    "scale_right": _SCALE,
    "track": _TRACK,
    "left": (0.01, 10.0),
    "right": (-10.0, -0.01),
    "ahead": (-2.0, 2.0),  # within the wheelbase for the centre of mass
    "drift": (-0.5, 0.5),
    "turn": (0.05, 20.0),
    "creep": (1e-3, 1.0),
    "height": (0.0, 1.5),
    "resistance": (0.0, 0.9 * FRICTION),
    "slip_slope": (-3.0, 3.0),
    "turn_slope": (-8.0, 8.0),
    **_LAGS,
}
_UNITS = {"track": "m", "left": "m", "right": "m", "ahead": "m", "speed_lag": "s", "turn_lag": "s"}


def _model(words: str, start: dict[str, float], step: Step) -> MotionModel:
    return MotionModel(
        words,
        start,
        {name: _BOUNDS[name] for name in start},
        {name: _UNITS.get(name, "1") for name in start},
        step,
    )


MODELS = {
    "straight": _model("straight on at the commanded speed", {"scale": 1.0}, _straight),
    "differential": _model("differential drive", _DIFFERENTIAL, _differential),
    "differential_lags": _model(
        "differential drive, lags", {**_DIFFERENTIAL, **_LAG_STARTS}, _differential
    ),
    "icr": _model("five-parameter ICR", _ICR, _icr),
    "icr_lags": _model("five-parameter ICR, lags", {**_ICR, **_LAG_STARTS}, _icr),
    "slope": _model(
        "slip and turning by the slope",
        {"scale": 1.0, "track": 0.7, "drift": 0.01, "slip_slope": 0.1, "turn_slope": 1.0},
        _slope,
    ),
    "friction": _model(
        "balance of friction on the slope",
        {
            "scale": 1.05,
            "turn": 2.4,
            "drift": 0.01,
            "creep": 0.05,
            "ahead": 0.1,
            "height": 0.5,
            "resistance": 0.1,
        },
        _friction,
    ),
}


class PathErrors(NamedTuple):
    """Predicted minus measured ends of windows."""

    along: Array  # along and to the left of the measured displacement [m]
    across: Array
    course: Array  # [rad]
    displacement: Array  # measured [m]

    @property
    def position(self) -> Array:
        """Distances of predicted from measured ends [m]."""
        return np.hypot(self.along, self.across)


class GroundPredictor:
    """Predictions of windows: the same course at the start as measured, then commands only.

    The measured course is the mean of those of a line through the positions of a chord, and of the
    receiver's velocities with the equivalent weights; with ``from_positions``, the former only, for
    logs whose velocities are derivatives of the positions. ModelError is raised without windows.
    """

    def __init__(
        self,
        logs: Sequence[DriveLog],
        windows: PathWindows,
        slopes: Slopes,
        from_positions: bool = False,
    ) -> None:
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
        at = first[:, None] + np.arange(int(self._steps.max()) + 1)
        offset = np.append(0, np.cumsum(count))[own]
        self._rows = offset[:, None] + np.minimum(at, count[own, None] - 1)
        z = np.concatenate([log.place for log in logs]) @ [1, 1j]
        seen = z[self._rows]
        rows = np.arange(len(first))
        self._ends = rows[:, None], (self._steps - half)[:, None] + k
        self._start, self._course = seen[:, 0], seen[:, : 2 * half + 1] @ self._line
        self._final = seen[self._ends] @ self._line
        if not from_positions:
            speeds = (np.concatenate([log.velocity for log in logs]) @ [1, 1j])[self._rows]
            # a line through positions weighs the velocities between them like this
            weights = half * (half + 1) - k**2
            self._course = _mean_course(self._course, speeds[:, : 2 * half + 1] @ weights)
            self._final = _mean_course(self._final, speeds[self._ends] @ weights)
        self._moved = seen[rows, self._steps - half] - seen[:, half]

    def __call__(self, model: MotionModel, values: Values) -> PathErrors:
        """Return the errors of a model with values of its constants."""
        path = self._paths(model, values)
        half, rows = self._half, np.arange(len(path))
        own, final = path[:, : 2 * half + 1] @ self._line, path[self._ends] @ self._line
        spin = self._course / np.abs(self._course) * np.abs(own) / np.where(own == 0, 1, own)
        missed = spin * (path[rows, self._steps - half] - path[:, half]) - self._moved
        missed = missed * np.abs(self._moved) / self._moved
        course = np.angle(final * spin / self._final)
        back = np.argsort(self._order)
        return PathErrors(
            missed.real[back], missed.imag[back], course[back], np.abs(self._moved)[back]
        )

    def _paths(self, model: MotionModel, values: Values) -> Array:
        """Return predicted positions, shape (n, n_steps), from a chord before each window."""
        mean, half_difference = self._commands(values)
        left, right = (mean - half_difference)[self._rows], (mean + half_difference)[self._rows]
        level = np.zeros(len(left))
        # the heading one chord before the start, from the measured course at the start
        turned = sum(
            model.step(values, left[:, k], right[:, k], level, level, None)[2]
            for k in range(self._half)
        )
        heading = np.angle(self._course) - np.asarray(turned) * self._dt
        place, path = self._start.copy(), np.empty(left.shape, dtype=complex)
        path[:] = place[:, None]
        rates: Rates | None = None
        for k in range(left.shape[1] - 1):
            n = int(np.searchsorted(-self._steps, -k, side="right"))  # windows that go on
            here = np.column_stack([place[:n].real, place[:n].imag])
            up, tilt = self._slopes.tilt(here, heading[:n])
            if rates is not None:
                rates = rates[0][:n], rates[1][:n], rates[2][:n]
            rates = model.step(values, left[:n, k], right[:n, k], up, tilt, rates)
            v, side, turn = rates
            # speeds are along the slope, places on the map
            moved = v * np.sqrt(1 - up**2) + 1j * side * np.sqrt(1 - tilt**2)
            place[:n] += self._dt * moved * np.exp(1j * (heading[:n] + self._dt * turn / 2))
            heading[:n] += self._dt * turn
            path[:n, k + 1] = place[:n]
        return path

    def _commands(self, values: Values) -> tuple[Array, Array]:
        """Return mean and half difference of the sides' speeds after first-order lags."""
        means, differences = list[Array](), list[Array]()
        for left, right in (sides.T for sides in self._logs):
            means.append(_lagged((left + right) / 2, values.get("speed_lag", 0.0), self._dt))
            differences.append(_lagged((right - left) / 2, values.get("turn_lag", 0.0), self._dt))
        return np.concatenate(means), np.concatenate(differences)


def _mean_course(one: Array, other: Array) -> Array:
    """Return the mean direction of velocities, as complex numbers of size one."""
    mean = one / np.abs(one) + other / np.abs(other)
    return np.asarray(mean / np.abs(mean))


def _lagged(signal: Array, lag: float, dt: float) -> Array:
    """Return a signal after a first-order lag [s]."""
    if lag < LEAST_LAG:
        return signal
    keep = float(np.exp(-dt / lag))
    return np.asarray(
        scipy.signal.lfilter([1 - keep], [1, -keep], signal, zi=[keep * signal[0]])[0]
    )
