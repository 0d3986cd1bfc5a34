"""Logs of motions: one reader for fits, commands and paths, and checks of the columns.

Times must increase, positions must be metres of one drive, headings must follow the course, and
the travel of wheels must be near that of the positions. What is left out is counted by its reason.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.arguments import FULL_TURN
from slipfree.core.errors import DataError, read_table
from slipfree.core.records import Array, ComplexArray, Indices, Mask
from slipfree.files.maps.reference_systems import metric_system
from slipfree.files.mcap import is_mcap, read_motion_log
from slipfree.files.netcdf import read as read_result
from slipfree.files.tables import (
    ALIASES,
    DAY,
    UNITS,
    Columns,
    line_of,
    read_columns,
    read_names,
    split_unit,
)

TEXTS: dict[str, str] = read_table(__file__, "logs.toml")  # of errors, and remedies
POSE = ("x", "y", "heading", "vx", "vy", "window")  # columns that rows of a log must have
GAP = 1.5  # longest time between rows whose positions count as continuous [s], or 1.5 medians
MAX_INTERVAL, JUMP = 10.0, 3600.0  # largest median time, and largest time, between rows [s]
SHUFFLED = 0.1  # share of decreasing times in rows without order, not of clocks that start again
REPEATED = 1e-3  # of poses at one time: larger differences are those of two poses [m, rad]
FAR = 0.3  # least distance of a row that is away from both of its neighbours [m]
RETURN, MIXED = 0.1, 0.03  # distance of these over it, and share of such rows in mixed drives [1]
CHORD, CHORDS = 1.0, 50  # time of chords that have a course [s], and least number of them in a log
LEAST_CHORDS = 5
MAX_RATIO = 8.0  # of the motion to the travel of the wheels, or of this to that [1]
ALIKE, NEAR = 0.9, 0.25  # least cosine of similar speeds, and tolerance of the ratio of units [1]
CLEAR, CLEARER = 0.8, 0.3  # least concentration of courses about headings, and least difference
OPPOSITE, COUNTS = 0.5, 0.95  # least correlations of turns, and of counts with the path [1]
OFFSET = 25.0  # least constant difference of course and heading that is refused [deg]
FULL_CIRCLE = 360.0  # largest longitude [deg]
TURNING, SMALL_SHARE = 0.1, 0.1  # turn of chords of a drive with turns [rad], and misfit [1]
CLOSE = 0.03  # largest relative error of a ratio of units of the sides
SHIFTS, MAX_DELAY = np.arange(-80, 81) / 4, 1.0  # of clocks, and largest one that is a delay [s]
DEGREE = 1e-4  # motion over travel of wheels below which positions are degrees [1]


def _of_units(words: str, names: str, power: int = 1) -> dict[str, float]:
    """Return the motion over the travel of the wheels for columns in other units, by words [1]."""
    return {words.format(name): UNITS[name][1] ** power for name in names.split()}


OF_RATES = _of_units("rates in {0}, as in 'left [{0}]'", "rpm deg/s rev/s")
OF_SPEEDS = _of_units("speeds in {0}, as in 'left [{0}]'", "km/h cm/s")
OF_SPEEDS["rates of wheels in rad/s, which must be multiplied by the radius"] = 0.15
OF_POSES = _of_units("times in {0}, as in 't [{0}]'", "ms minutes")
OF_POSES["times in days, which must be multiplied by 86400"] = DAY
OF_POSES |= _of_units("positions in {0}, as in 'x [{0}]'", "km feet cm mm", -1)


class MotionLog(NamedTuple):
    """A log: times, columns by name, notes, and rows that were left out or held."""

    path: Path
    t: Array  # shape (n,): times from the first row or date, of rows with poses [s]
    values: dict[str, Array]  # shape (n,) each, without gaps
    notes: tuple[str, ...]  # on units
    left_out: Counter[str]  # numbers of rows by reason
    held: tuple[float, float]  # longest time for which an input was held, and its start [s]
    rows: Indices  # shape (n,): numbers of the rows among all of the file, from 0
    every: dict[str, Array]  # shape (m,) each: t and columns of all rows; only inputs have no gaps
    has_input: Mask  # shape (m,): rows that give an input, or in which it is held over a gap

    @property
    def rows_left_out(self) -> list[str]:
        """Numbers of rows that were left out, with the reasons."""
        return [f"{count} rows left out: {reason}" for reason, count in self.left_out.items()]

    @property
    def hold(self) -> str:
        """Longest time for which an input was held."""
        longest, start = self.held
        return f"inputs not given for at most {longest:.3g} s, from t = {start:.6g} s"


def read_log(
    path: Path,
    columns: Sequence[str] | Mapping[str, str],
    inputs: Collection[str] = (),
    *,
    where: str = "the first line",
    kind: str = "a log",
    units: Mapping[str, str] | None = None,
    is_linear: bool = False,
    timeout: float | None = None,
    max_error: float = np.inf,
) -> MotionLog:
    """Return a log as text, as MCAP or as a result of slipfree.

    ``columns``, ``units`` and ``where`` are as in `read_columns`, with the time ``t``; ``inputs``
    are the names of columns that are inputs, ``kind`` is that of the file in messages. Rows without
    a pose, or with a stated ``error`` of the position above ``max_error`` [m], are left out. Inputs
    are held until they are given again, for at most ``timeout`` [s], and zero after it; with
    ``is_linear``, they are linear between rows that are not farther apart than a gap. They are
    known in rows without a pose, too. DataError is raised for times that decrease, jump or belong
    to two poses, and for positions that alternate between two drives.
    """
    names = dict(columns) if isinstance(columns, Mapping) else {name: name for name in columns}
    if path.suffix == ".nc":
        table = _read_result(path, {name: names[name] for name in inputs})
    elif is_mcap(path) and "x" in names and inputs:
        table = _read_joints(path, {name: names[name] for name in inputs})
    else:
        known = {name: "m" for name in ("error",) if name in names} | dict(units or {})
        free = {*names} - {"t"}
        header = {name.lower(): name for name in read_names(path, kind)}
        degrees = [next((header[n] for n in group if n in header), "") for group in ALIASES[-2:]]
        if names.get("x") == "x" and all(degrees) and not ALIASES[1] & {*header}:
            columns = names = {**names, "x": degrees[0], "y": degrees[1]}
        table = read_columns(path, columns, kind, where=where, units=known, optional=free)
    for name in ("x", "y"):
        if any(split_unit(names.get(name, ""))[0].lower() in group for group in ALIASES[-2:]):
            raise _degrees(path, table.values, [names["x"], names["y"]])
    values = dict(table.values)
    t = values.pop("t")
    has_input = np.zeros(t.size, bool)
    is_apart = np.diff(values.get("window", 0 * t)) != 0
    is_fit = bool(inputs) and "x" in names
    _check_times(path, table, is_apart, is_fit=is_fit)
    longest, start, given = 0.0, 0.0, np.ones(t.size, bool)
    for name in inputs:
        rows = np.flatnonzero(np.isfinite(values[name]))
        if not t.size:
            break
        if not rows.size:
            raise _error("no_numbers", path, column=names[name], where=where)
        # the last row that gives this input; an input is zero after the timeout, as in robots
        last = rows[np.maximum(np.searchsorted(rows, np.arange(t.size), side="right") - 1, 0)]
        age = t - t[last]
        given &= age >= 0
        is_late = age > (np.inf if timeout is None else timeout)
        held = values[name][last]
        if is_linear:
            following = np.minimum(np.searchsorted(rows, np.arange(t.size)), rows.size - 1)
            is_near = (t[rows[following]] - t[last] <= longest_gap(t[rows])) & (age > 0)
            held = np.where(is_near, np.interp(t, t[rows], values[name][rows]), held)
            has_input |= ~is_near | is_late
        has_input[rows] = True
        values[name] = np.where(is_late, 0.0, held)
        # the first row of a window does not wait for the window before it
        waits = np.where(is_apart[rows[1:] - 1], 0.0, np.diff(t[rows]))
        if waits.max(initial=0.0) > longest:
            longest, start = float(waits.max()), float(t[rows[waits.argmax()]])
    reasons = dict[str, Mask]()
    if "x" in values:
        poses = [np.isfinite(values[name]) for name in POSE if name in values]
        pose = "no position or heading" + " (inputs are used)" * bool(inputs)
        reasons[pose] = ~np.logical_and.reduce(poses)
        reasons[f"stated error above {max_error:g} m"] = values.get("error", 0 * t) > max_error
    reasons["before the first command or rate"] = ~given
    good, left_out = np.ones(t.size, bool), Counter[str]()
    for reason, bad in reasons.items():
        left_out[reason] = int((good & bad).sum())
        good &= ~bad
    if "x" in values:
        _check_repeated(path, t, values, good)
        is_away = _excursions(path, table, good)
        left_out["position that jumps away and back"] = int(is_away.sum())
        good &= ~is_away
    if not good.any() and t.size:
        found = ", ".join(f"{count} with {reason}" for reason, count in (+left_out).items())
        raise _error("no_rows", path, found=found)
    return MotionLog(
        path,
        t[good],
        {name: column[good] for name, column in values.items()},
        table.notes,
        +left_out,
        (longest, start),
        np.flatnonzero(good),
        {"t": t, **values},
        has_input,
    )


def rate_ratios(radii: Sequence[float]) -> dict[str, float]:
    """Return the ratios of `check_motion` for rates of wheels with radii [m]."""
    of_speeds = "speeds of the wheels in m/s, which must be divided by the radius"
    return OF_RATES | OF_POSES | {of_speeds: len(radii) / sum(radii)}


def longest_gap(t: Array) -> float:
    """Return the longest time between rows whose positions count as continuous [s]."""
    return max(GAP, GAP * float(np.median(np.diff(t)))) if t.size > 1 else GAP


def _check_times(path: Path, table: Columns, is_apart: Mask, *, is_fit: bool) -> None:
    """Raise DataError for times that decrease, jump or are not in seconds."""
    t = table.values["t"]
    steps = np.where(is_apart, 0.0, np.diff(t))
    interval = float(np.median(np.diff(t)[~is_apart])) if not is_apart.all() else 0.0
    if is_fit and interval > MAX_INTERVAL:
        raise _error("rare", path, most=MAX_INTERVAL, interval=interval)
    is_jump = (steps < 0) | (steps > max(JUMP, 100 * interval))
    if is_jump.any():
        k = int(is_jump.argmax())
        found = f"the clock {'starts again' if steps[k] < 0 else 'jumps'}; divide the log before "
        found += "this line into two files"
        if np.mean(steps < 0) > SHUFFLED:
            found = "so do many others; sort the rows by time"
        elif steps[k] < 0 and (t[k + 2 : k + 3] > t[k]).any():
            found = "one row is late; sort the rows by time"
        times = {"time": _time(table, k + 1), "before": _time(table, k)}
        raise _error("times", path, **times, line=line_of(path, k + 1), found=found)


def _time(table: Columns, row: int) -> str:
    return f"{table.start + table.values['t'][row]:.12g} s"


def _check_repeated(path: Path, t: Array, values: Mapping[str, Array], good: Mask) -> None:
    """Raise DataError if rows of a window have the same time and different poses."""
    rows = np.flatnonzero(good)
    same = np.diff(t[rows]) == 0
    if "window" in values:
        same &= np.diff(values["window"][rows]) == 0
    poses = [values[name][rows] for name in POSE[:3] if name in values]
    change = np.abs(np.diff(poses)).max(axis=0)
    if (same & (change > REPEATED)).any():
        k = int((same & (change > REPEATED)).argmax())
        places = (
            f"x = {values['x'][row]:.6g}, y = {values['y'][row]:.6g} m in line {line_of(path, row)}"
            for row in rows[k : k + 2].tolist()
        )
        raise _error("repeated", path, places=" and ".join(places), t=t[rows[k]])


def _excursions(path: Path, table: Columns, good: Mask) -> Mask:
    """Return whether a good row is far from both neighbours; DataError for many such rows."""
    rows = np.flatnonzero(good)
    place = (table.values["x"] + 1j * table.values["y"])[rows]
    window = table.values.get("window", np.zeros(good.size))[rows]
    steps, over = np.abs(np.diff(place)), np.abs(place[2:] - place[:-2])
    least = np.minimum(steps[1:], steps[:-1])
    is_away = (least > FAR) & (over < RETURN * least) & (window[2:] == window[:-2])
    if is_away.sum() > MIXED * is_away.size:
        k = rows[int(is_away.argmax())]
        first = {"time": _time(table, k + 1), "line": line_of(path, int(k) + 1)}
        raise _error("mixed", path, count=is_away.sum(), least=least[is_away][0], **first)
    return np.isin(np.arange(good.size), rows[1:-1][is_away])


def is_continuous(t: Array, place: Array, window: Array) -> Mask:
    """Return whether a position follows from the one before, without a gap or leap, shape (n - 1,).

    A leap is farther than three times the distance at the speed that 95 % of the rows do not
    exceed, and farther than 0.3 m. Positions may be repeated until a new one is measured.
    """
    moved = np.abs(np.diff(place))
    inside = (np.diff(window) == 0) & (np.diff(t) <= longest_gap(t))
    is_new = (moved > 0) & inside
    since = np.maximum.accumulate(np.where(np.append(True, is_new | ~inside), np.arange(t.size), 0))
    waits = t[1:] - t[since[:-1]]
    speeds = moved[is_new] / np.maximum(waits[is_new], 1e-9)
    fast = float(np.quantile(speeds, 0.95)) if speeds.size else 0.0
    return np.asarray(inside & (moved <= 3 * fast * waits + FAR))


def check_motion(
    log: MotionLog,
    *,
    zero: float = 0.0,
    speed: Array | None = None,
    sides: Array | None = None,
    ratios: Mapping[str, float] | None = None,
    is_aligned: bool = True,
    may_turn: bool = False,
) -> None:
    """Raise DataError if the columns of a log contradict each other.

    Parameters
    ----------
    log : MotionLog
        Log with x and y, and possibly the heading.
    zero : float
        Angle from the x axis from which headings count. [rad]
    speed : array, shape (m,), optional
        Mean speed of the driven wheels' treads in all rows. [m/s]
    sides : array, shape (2, m), optional
        Mean speeds of those on the left and on the right. [m/s]
    ratios : mapping, optional
        Motion over the travel of the wheels if columns have other units, by a description; None if
        units are named.
    is_aligned : bool
        Whether the vehicle moves along its heading.
    may_turn : bool
        Whether headings may have a constant difference from the course, as of a sensor.
    """
    t, place = log.t, log.values["x"] + 1j * log.values["y"]
    if t.size > LEAST_CHORDS and (place == place[0]).all():
        raise _error("still", log.path, place=place[0])
    part = np.append(0, np.cumsum(~is_continuous(t, place, log.values.get("window", 0 * t))))
    fresh = np.append(True, np.diff(place) != 0)  # poses may be held until the next one is measured
    log = log._replace(values={name: column[fresh] for name, column in log.values.items()})
    values, place, part = log.values, place[fresh], part[fresh]
    step = max(1, min(round(CHORD * place.size / max(np.ptp(t), CHORD)), place.size // CHORDS))
    rows = np.flatnonzero((part[step:] == part[:-step]) & (place[step:] != place[:-step]))
    if rows.size < LEAST_CHORDS:
        return
    chords = place[rows + step] - place[rows]
    size, turns, sign = np.abs(chords), None, 2  # courses are known up to the direction of travel

    def change(total: Array, late: float = 0.0) -> Array:
        ends = [np.interp(t[fresh][rows + k] - late, log.every["t"], total) for k in (0, step)]
        return np.asarray(np.diff(ends, axis=0)[0])

    def path(rate: Array) -> Array:
        return np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(log.every["t"])))

    if speed is not None:
        travel, parts = change(path(speed)), [speed] if sides is None else sides
        # angles or counts of an encoder may start again
        counts = [np.unwrap(each, period=float(np.ptp(each)) or 1.0) for each in parts]
        likeness = _correlation(size, abs(change(np.sum(counts, axis=0))))
        if likeness > max(COUNTS, _correlation(size, abs(travel))):
            raise _error("counts", log.path)
    if sides is not None:
        paths = [*map(path, sides)]
        turns = change(paths[1] - paths[0])
        if is_aligned:
            relative = chords * np.exp(-1j * zero)
            _check_sides(log, rows, step, relative, lambda late: [change(p, late) for p in paths])
    if speed is not None:
        sign = 1
        _check_travel(log, size, abs(travel), ratios or {})
        chords = chords * np.where(travel < 0, -1, 1)
    later = np.isin(rows + step, rows)
    at = np.searchsorted(rows, rows[later] + step)
    curved = np.angle((chords[at] / chords[later]) ** sign) / sign  # turns of the course
    if "heading" not in values:
        if turns is not None and _correlation(curved, turns[later]) < -OPPOSITE:
            raise _error("opposite_turns", log.path)
        return
    near = (0, step // 2, (step + 1) // 2, step)  # two rows in the middle if the step is odd
    first, *middle, last = (values["heading"][rows + k] for k in near)
    bent = np.angle(np.exp(1j * (last - first)))
    by_wheels = 0.0 if turns is None else _correlation(bent, turns)  # of the turns of headings
    course, heading = np.angle(chords) - zero, np.array(middle)
    weight = size / size.sum()
    alike = {  # mean direction of courses from headings that are read in this way
        factor: complex(np.exp(1j * sign * (course - factor * heading)).mean(axis=0) @ weight)
        for factor in np.outer((1, -1), (1.0, np.pi / 180, np.pi / 18000)).ravel().tolist()
    }
    best = max(alike, key=lambda factor: abs(alike[factor]))
    is_other = abs(alike[best]) > max(CLEAR, abs(alike[1.0]) + CLEARER)
    if best == -1.0 and abs(alike[best]) > CLEAR:  # also in drives that hardly turn
        is_other |= _correlation(curved, bent[later]) < -OPPOSITE
    offset, mirrored = (np.rad2deg(np.angle(alike[factor]) / sign) for factor in (1.0, -1.0))
    largest = float(np.abs(values["heading"]).max())
    if is_other and abs(best) < 1 and (is_aligned or largest > FULL_TURN):
        unit = "cdeg" if abs(best) < UNITS["mrad"][1] else "deg"
        expected = "in rad"
        found = f"values up to {largest:g} that agree with the direction of motion in {unit}"
        remedy = f"name their unit with the column, as in 'heading [{unit}]'"
    elif not is_aligned:
        return
    elif is_other and by_wheels > OPPOSITE:
        expected, found = "that turn with the course", "that it turns against headings and wheels"
        remedy = "exchange the columns of x, to the east, and y, to the north"
        if abs(abs(mirrored) - 90) > 45:
            remedy = f"change the sign of {'y' if abs(mirrored) < 45 else 'x'}"
    elif is_other:
        expected, found = "that turn with the course", "the opposite: clockwise from north?"
        remedy = f"write {round(mirrored) % (360 // sign)} deg minus the heading"
        if not by_wheels < -OPPOSITE:
            remedy += ", or exchange the columns of x and y if they are north and east"
    elif by_wheels < -OPPOSITE:
        expected, found = "that turn to the left where right wheels are faster", "the opposite"
        remedy = TEXTS["opposite_wheels"]
    elif not may_turn and abs(alike[1.0]) > ALIKE and abs(offset) > OFFSET:
        expected, found = "along the course", f"a constant difference of {offset:.0f} deg"
        remedy = TEXTS["offset"].format(offset=offset)
    else:
        return
    k = int((size * np.abs(np.exp(1j * sign * (course - heading[0])) - 1)).argmax())
    words = {"expected": expected, "found": found, "remedy": remedy}
    raise _error("headings", log.path, **words, heading=heading[0, k], course=course[k])


def _correlation(one: Array, other: Array) -> float:
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) / max(size, 1e-300)


def _check_sides(
    log: MotionLog,
    rows: Indices,
    step: int,
    chords: ComplexArray,
    changes: Callable[[float], list[Array]],
) -> None:
    """Raise DataError if the motion follows another reading of the sides, but not their columns.

    ``chords`` begin at the samples ``rows`` and are relative to the axis of headings [m].
    ``changes`` returns the paths of the left and of the right side over chords that are earlier by
    a time [s], shape (n,) each [m]. A distance is compared with the mean of both paths, a turn with
    their difference. One side may have the opposite sign; inputs or headings may be late.
    """
    if "heading" in log.values:
        heading, at, middle = log.values["heading"], rows >= 0, 0.0
        bent = np.angle(np.exp(1j * (heading[rows + step] - heading[rows])))
        ahead = (chords * np.exp(-1j * heading[rows + step // 2])).real
    else:  # courses are known up to the direction of travel, in the middle of chords
        at = np.isin(rows + step, rows)
        bent = np.angle((chords[np.searchsorted(rows, rows[at] + step)] / chords[at]) ** 2) / 2
        ahead, middle = np.zeros(bent.size), CHORD / 2
    size = np.abs(chords[at])
    energy = np.array([size @ size, bent @ bent])  # turns by 1 rad weigh as much as 1 m

    def misfit(left: Array, right: Array) -> Array:  # share of distances, and of turns
        pairs = (size, abs(left + right)), (bent, right - left)
        return np.array([1 - _correlation(*pair) ** 2 for pair in pairs])

    left, right = (each[at] for each in changes(-middle))
    plain = misfit(left, right)
    if (plain - misfit(left, -right)) @ energy > CLEARER * energy.sum():
        pairs = (ahead, left - right), (bent, -left - right)
        likeness = max((_correlation(*pair) for pair in pairs), key=abs)
        side = "one" if abs(likeness) < CLEARER else "right" if likeness > 0 else "left"
        raise _error("sign", log.path, side=side)
    is_one = not left.any() or not right.any() or np.array_equal(left, right)
    if is_one and plain[1] > CLEARER and energy[1] > TURNING**2 * bent.size:
        raise _error("one_side", log.path)
    factors = np.linalg.lstsq(np.transpose([left, right]), ahead)[0]
    scaled = misfit(factors[0] * left, factors[1] * right)
    if plain.max() > CLEARER > SMALL_SHARE > scaled.max() and factors.min() > 0:
        side, other = np.array(["left", "right"])[np.argsort(factors)]
        ratio = float(factors.max() / factors.min())
        units = [w for w, each in (OF_RATES | OF_SPEEDS).items() if abs(each * ratio - 1) < CLOSE]
        unit = ", or ".join(units) or "in another unit"
        raise _error("units_of_sides", log.path, side=side, other=other, ratio=ratio, unit=unit)
    shares = {  # distances may have the clock of the inputs, turns that of the headings
        late: np.minimum(plain, misfit(*(each[at] for each in changes(late - middle))))
        for late in SHIFTS[abs(SHIFTS) <= np.ptp(log.t) / 5 * (plain.sum() > CLEARER)].tolist()
    }
    late, best = min(shares.items(), key=lambda each: float(each[1].sum()))
    if abs(late) > MAX_DELAY and plain.sum() - best.sum() > CLEARER > best.max():
        when = f"{abs(late):.3g} s {'after' if late > 0 else 'before'} those of the inputs"
        raise _error("clocks", log.path, when=when, share=1 - best[1], plain=1 - plain[1])


def _check_travel(log: MotionLog, moved: Array, travel: Array, ratios: Mapping[str, float]) -> None:
    """Raise DataError if the motion is as far from that of the wheels as other units are from SI.

    ``moved`` are lengths of chords, ``travel`` the paths of the wheels [m].
    """
    likeness, ratio = _correlation(moved, travel), float(moved.sum() / max(travel.sum(), 1e-300))
    units = ", or ".join(w for w, each in ratios.items() if abs(ratio / each - 1) < NEAR)
    if likeness > ALIKE and ratio < DEGREE:
        raise _degrees(log.path, log.values, ["x", "y"])
    units = units or "another unit" * (len(ratios) > 0 and not 1 / MAX_RATIO < ratio < MAX_RATIO)
    if likeness > ALIKE and units:
        raise _error("units", log.path, ratio=ratio, units=units)


def _degrees(path: Path, values: Mapping[str, Array], names: Sequence[str]) -> DataError:
    """Return the error of positions in degrees, with a line that projects them."""
    place = [float(np.nanmedian(values[name])) for name in ("x", "y")]
    x, y = (split_unit(name)[0] for name in names)
    if max(map(abs, place)) > FULL_CIRCLE:
        return _error("no_degrees", path, place=place, x=x, y=y)
    is_swapped = x.lower() in ALIASES[-1]
    system = metric_system(*place[:: -1 if is_swapped else 1])
    longitude, latitude = (y, x) if is_swapped else (x, y)
    given = {"file": path, "longitude": longitude, "latitude": latitude}
    return _error("degrees", path, **given, system=system)


def _read_result(path: Path, columns: Mapping[str, str]) -> Columns:
    """Return pose, rates and values of a result of slipfree, with headings from the y axis."""
    run = read_result(path).in_frame("paper")
    table = {"t": run.t, **{key: run[key] for key in POSE[:3]}}
    for name, column in columns.items():
        wheel = column.removesuffix("_rate")
        if wheel in run.wheels:
            table[name] = run["wheel_rate", wheel]
        elif wheel in run.columns and column.endswith("_rate"):
            table[name] = np.gradient(run[wheel], run.t)
        elif column in run.columns:
            table[name] = run[column]
        else:
            raise _error("no_rate", path, name=column, known=", ".join(run.columns))
    return Columns(table)


def _read_joints(path: Path, columns: Mapping[str, str]) -> Columns:
    """Return poses, and rates and values of joints in rows of their own, of an MCAP file.

    A column is the name of a joint, with ``_rate`` for its velocity.
    """
    pose, joints = read_motion_log(path)
    if missing := [n for n in columns.values() if n.removesuffix("_rate") not in joints]:
        name, known = missing[0].removesuffix("_rate"), ", ".join(joints)
        raise _error("no_rate", path, name=name, known=known)
    states = {name: joints[column.removesuffix("_rate")] for name, column in columns.items()}
    every = np.unique(np.concatenate([each.t for each in states.values()]))
    t = np.append(every, pose["t"])
    table = {"t": t} | {key: np.append(np.full(every.size, np.nan), pose[key]) for key in POSE[:3]}
    for name, own in states.items():
        values = own.velocities if name.endswith("_rate") else own.positions
        if not np.isfinite(values).all():
            raise _error("no_values", path, joint=columns[name].removesuffix("_rate"))
        table[name] = np.full(t.size, np.nan)
        table[name][np.searchsorted(every, own.t)] = values
    order = np.argsort(t, kind="stable")
    return Columns({name: column[order] for name, column in table.items()})


def _error(name: str, path: Path, /, **values: Any) -> DataError:
    """Return an error of `TEXTS` about a file."""
    return DataError(f"{path}: {TEXTS[name].format(**values)}")
