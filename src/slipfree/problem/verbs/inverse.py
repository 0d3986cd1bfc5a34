"""Inverse kinematics: rates of wheels and steering for a given motion of the platform."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import casadi as ca
import numpy as np

from slipfree.control.path_following import check_way_points, path_inputs, track_path
from slipfree.core.errors import DataError, ModelError, SlipfreeError
from slipfree.core.facts import Fact, named_rows, printed_unit
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.files import toml
from slipfree.files.logs import check_motion, read_log
from slipfree.files.mcap import is_mcap
from slipfree.files.netcdf import NOTHING
from slipfree.files.tables import read_names
from slipfree.models import given_rates
from slipfree.models.given_rates import COMMANDS, ROBOT, UNITS
from slipfree.models.inverse import invert, steering_note, steering_slip
from slipfree.models.kinematics import direct_kinematics
from slipfree.problem.build import (
    Setup,
    build_start,
    build_world,
    check_names,
    check_time_unit,
    heading_offset,
    moves_sideways,
)
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, S
from slipfree.problem.schema import FILE, MotionKeys
from slipfree.problem.verbs import base
from slipfree.solve.collocation import drive
from slipfree.solve.replay import apply_inputs, replay, round_trip, spline_inputs, trim_states
from slipfree.solve.sampling import input_samples
from slipfree.solve.system import SolverOptions
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.plan.polynomial_motion import SavedPlan
    from slipfree.show.plots import Plot


TIMEOUT = "timeout"  # key of [given] beside 'file'


class PathTable(toml.Record):
    """Timed path: positions and headings of the platform's centre, as arrays or from a file.

    Attributes
    ----------
    t : tuple of float or None
        Times, increasing from 0. [s]
    x : tuple of float or None
        x at these times. [m]
    y : tuple of float or None
        y at these times. [m]
    heading : tuple of float or None
        Headings at these times. [rad]
    file : str or None
        CSV file with the columns t, x, y, heading.
    """

    t: toml.Column | None = None
    x: toml.Column | None = None
    y: toml.Column | None = None
    heading: toml.Angles | None = None
    file: str | None = None
    alternatives = "t", "file"


class Inverse(MotionKeys):
    """Inverse problem: wheel and steering rates for given platform rates or a platform path.

    Attributes
    ----------
    given : mapping of str to float, tuple or str or None
        Rates of the platform by name, or 'file', a CSV file of rates over time, with 'timeout', the
        time after which a rate that is not given again is zero; by default it is held. [m/s, rad/s,
        s]
    exact : bool or None
        Whether rates in the heading frame are met exactly; otherwise their errors are minimised;
        true by default unless all three are given.
    path : PathTable or None
        a timed path, instead of given rates.
    steering : {"rate", "angle"}
        Unknown of the steering: its rate or its angle.
    """

    verb: Literal["inverse"]
    given: dict[str, toml.TimeFunction] | None = None
    exact: bool | None = None
    path: PathTable | None = None
    steering: Literal["rate", "angle"] = "angle"

    alternatives = "given", "path"

    def faults(self) -> Iterator[toml.Fault]:
        """Yield the errors of values that contradict each other, such as arrays of a path."""
        yield from super().faults()
        path = self.path
        if path is None:
            return
        times = path.t or ()
        if path.heading and (words := toml.bare_words(path.heading[0])):
            yield toml.Fault(("path", "heading"), words, toml.format_value(path.heading[0]))
        for name in ("x", "y", "heading"):
            place, column = ("path", name), getattr(path, name)
            if path.file is not None and column is not None:
                yield toml.Fault(
                    place,
                    "no array beside 'file'",
                    f"{toml.format_value(list(column))}; remove one",
                )
            elif path.file is None and len(column or ()) != len(times):
                expected = f"an array of {len(times)} numbers, one for each time in 't'"
                found = "none" if column is None else f"an array of {len(column)}"
                yield toml.Fault(place, expected, found)


def are_commands(given: Collection[str]) -> bool:
    """Return whether given rates are commands in the heading frame, or a file of them."""
    names = set(given)
    return FILE in names or (bool(names) and (names <= set(COMMANDS) or names <= set(ROBOT)))


def read_commands(problem: Problem[S], spec: Inverse) -> tuple[dict[str, Any], str]:
    """Return the commands of a problem by the names of `COMMANDS`, and their description."""
    given, columns, descriptions = dict(spec.given or {}), dict[str, Any](), []
    timeout = given.pop(TIMEOUT, None)
    if timeout is not None and not (FILE in given and isinstance(timeout, float) and timeout > 0):
        expected = "a positive time in s, beside 'file'"
        problem.refuse(toml.Fault(("given", TIMEOUT), expected, toml.format_value(timeout)))
    if (file := given.pop(FILE, None)) is not None:
        with at(problem, ("given", FILE)):
            if not isinstance(file, str):
                raise DataError(
                    "expected the name of a CSV file in quotes, found "
                    f"{toml.format_value(file)}; put the name in quotes"
                )
            columns, notes = _read_file(problem.folder / file, spec.time.duration, timeout)
        descriptions = ["; ".join([f"{', '.join(columns)} of {file}", *notes])]
    problem.refuse(*_faults(spec, given, columns))
    for name, value in given.items():
        words = value
        if isinstance(value, str):
            t, symbol = input_samples(spec.time.duration, spec.time.step, {})[0], ca.SX.sym("t")
            with at(problem, ("given", name)):
                try:
                    formula = evaluate(value, {"t": symbol})
                except ModelError as error:
                    remedy = "a rate may be a formula of t, in seconds"
                    raise ModelError(f"{error}; {remedy}") from error
                rates = np.array(ca.Function("rate", [symbol], [formula])(t[None])).ravel()
                for k in np.flatnonzero(~np.isfinite(rates))[:1].tolist():
                    raise ModelError(
                        f"expected finite values of {value!r}, found {rates[k]:g} at t = "
                        f"{t[k]:g} s; change the formula"
                    )
        elif isinstance(value, tuple):
            words = " then ".join(f"{rate:g}" for _, rate in value)
        else:
            words = f"{value:g}"
        descriptions.append(f"{name} {words} {printed_unit(UNITS[name])}")
    commands = {ROBOT.get(name, name): value for name, value in (columns | given).items()}
    if "v_y" in {*columns, *given}:  # to the left
        left = commands["right"]
        if isinstance(left, tuple):
            commands["right"] = tuple((t, -rate) for t, rate in left)
        else:
            commands["right"] = f"-({left})" if isinstance(left, str) else -left
    return commands, ", ".join(descriptions)


def _read_file(
    file: Path, duration: float, timeout: float | None
) -> tuple[dict[str, toml.Piecewise], list[str]]:
    """Return the commands of a table by name, constant until the next row, and notes on them.

    A command that is not followed by another one within ``timeout`` is zero after it [s].
    """
    names = read_names(file, "commands")
    rates = [name for name in names if name != "t"]
    if len(set(names)) < len(names) or "t" not in names or not are_commands(rates) or FILE in rates:
        raise DataError(
            f"{file}: expected a first line with the names of columns, each once: t, and one or "
            f"more of {', '.join(COMMANDS)} or one or more of {', '.join(ROBOT)}, found "
            f"{','.join(names)!r}; correct the first line"
        )
    units = {name: printed_unit(UNITS[name]) for name in rates}
    log = read_log(file, ["t", *rates], rates, kind="commands", units=units)
    t = log.t
    if not t.size:
        raise DataError(f"{file}: expected one or more rows of numbers, found only names; add rows")
    if t[0] != 0:
        raise DataError(f"{file}: expected 0 as the first time, found {t[0]:g} s; shift the times")
    kept = np.append(np.diff(t) > 0, True)
    values = np.column_stack([log.values[name] for name in rates])
    if (values[:-1][~kept[:-1]] != values[1:][~kept[:-1]]).any():
        k = int(kept.argmin())
        raise DataError(
            f"{file}: expected increasing times, found {t[k]:g} s after {t[k]:g} s with other "
            "values; keep one row for each time"
        )
    t, values = t[kept], values[kept]
    check_time_unit(t, duration)
    waits = np.diff(t, append=max(duration, t[-1]))
    k = int(waits.argmax())
    words = f"held for at most {waits[k]:.3g} s, from {t[k]:g} s"
    if timeout is not None and waits[k] > timeout:
        late = waits > timeout
        words = (
            f"zero {timeout:g} s after the last command, for at most {waits[k] - timeout:.3g} s, "
            f"from {t[k] + timeout:g} s"
        )
        order = np.argsort(np.append(t, t[late] + timeout), kind="stable")
        t = np.append(t, t[late] + timeout)[order]
        values = np.vstack([values, 0 * values[late]])[order]
    notes = [*log.notes, *log.rows_left_out, words]
    columns = zip(rates, values.T.tolist(), strict=True)
    return {name: tuple(zip(t.tolist(), rate, strict=True)) for name, rate in columns}, notes


def _faults(
    spec: Inverse, given: Mapping[str, Any], columns: Collection[str]
) -> Iterator[toml.Fault]:
    """Yield errors in commands: names of other kinds, repeated names, wrong frame or steering."""
    if spec.steering != "angle":
        expected = f"'angle' with given rates {', '.join(COMMANDS)}"
        yield toml.Fault(("steering",), expected, f"{spec.steering!r}; remove the key")
    for name in given:
        if not are_commands({name, *columns}):
            yield toml.Fault(
                ("given", name),
                f"rates of the same kind as {', '.join(columns)} in the CSV file",
                f"{name!r}; remove it, or give all rates in one frame",
            )
        elif name in columns:
            expected, found = "only rates that are not in the CSV file", f"{name!r}; remove it"
            yield toml.Fault(("given", name), expected, found)
    if spec.frame != "rep103" and (robot := [n for n in (*columns, *given) if n in ROBOT]):
        place = ("given", robot[0] if robot[0] in given else FILE)
        expected = f"{', '.join(COMMANDS)}, or frame = 'rep103' with {', '.join(ROBOT)} (v_y left)"
        found = f"{robot[0]} in the frame {spec.frame!r}; set frame = 'rep103', or give the former"
        yield toml.Fault(place, expected, found)


ROUND_TRIP, REPLAY = "round_trip_", "replay_"  # beginnings of the names of differences
METHOD, COLLOCATION = "solved_by", "collocation"  # attribute of a result, and one of its values
STEERED = 0.02  # largest error of a steering coordinate at its target [rad, m]
ROWS = named_rows("inverse")
CHECK_ROWS = named_rows("inverse_checks")
COLUMNS = ("t", "x", "y", "heading")
MIN_SAMPLES = 4  # smallest number of samples between jumps of the given rates, for a replay
GUESS_SPEED = 0.1  # speed of the initial guess if the velocity is not given [m/s]


def is_collocated(run: Trajectory) -> bool:
    """Return whether the steering of a motion was computed by collocation."""
    return run.attributes.get(METHOD) == COLLOCATION


def steering_warning(run: Trajectory) -> str:
    """Return the warning about an unstable integrated steering; empty if it is stable."""
    if "steering_growth" not in run.columns or is_collocated(run):
        return ""
    return steering_note(run)


class InverseVerb(base.DriveVerb):
    """Inverse kinematics: wheel and steering rates for a given motion of the platform."""

    schema = Inverse
    own_rows, last_rows = ROWS, CHECK_ROWS
    metrics_shown = ("inverse_margin_least", "slip_rms", "utilisation_largest")
    verified = (ROUND_TRIP, REPLAY)

    def figures(self, result: base.Result) -> tuple[Plot, ...]:
        """Return the figures of a motion; map and rates of wheels and joints come first."""
        plots = super().figures(result)
        return tuple(sorted(plots, key=lambda plot: plot.name not in ("map", "rates")))

    def build(self, problem: Problem[Inverse]) -> Setup:
        """Return the models, the start and the inputs of a problem."""
        spec = problem.spec
        world = build_world(problem)
        vehicle = world.vehicle
        points, notes = _points(problem, vehicle)
        given, description = _given_rates(problem, vehicle, points)
        description = "; ".join([description, *notes])
        place = ("given",) if points is None else ("path",)
        is_rolling_path = points is not None and not are_commands(given)
        rates = given_rates.GivenRates(
            tuple(given),
            "rates" if is_rolling_path or spec.steering == "rate" else "angles",
            len(given) < len(COMMANDS) if spec.exact is None else spec.exact,
            0.0 if is_rolling_path and spec.steering == "angle" else given_rates.LEAST_MARGIN,
        )
        with at(problem, place):
            rates.check(vehicle)
        with at(problem, ("vehicle",)):
            direct = direct_kinematics(vehicle, world.terrain, slip=rates.slip)
        dae = invert(direct, rates)
        check_names(problem, direct, None)
        problem.refuse(*toml.unit_faults(("given",), spec.given or {}, UNITS))
        stand = build_start(problem, direct)
        texts = {name: value for name, value in given.items() if isinstance(value, str)}
        formulas = {name: evaluate(text, {"t": dae.t}) for name, text in texts.items()}
        numbers = {name: value for name, value in given.items() if name not in formulas}
        t, over_time = input_samples(spec.time.duration, spec.time.step, numbers)
        initial = {n: v[0] if isinstance(v, np.ndarray) else v for n, v in over_time.items()}
        inputs, first = (dae.inputs(**each, **formulas) for each in (over_time, initial))
        with at(problem, place):
            if is_rolling_path and points is not None:
                inputs = first = path_inputs(dae, stand, *points)
            elif points is not None:
                dae, inputs = track_path(dae, *points)
                first = inputs
            drive: dict[str, Any] = {"inputs": inputs, "t": t, "driven": description}
            setup = Setup(**vars(world), model=direct, dae=dae, start=stand, **drive)
            return replace(setup, start=_start(spec, setup, first, exact=rates.exact))

    def drive(
        self, problem: Problem[Inverse], setup: Setup, watch: base.Watch, resume: SavedPlan | None
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the motion with its differences from the direct model."""
        spec, options, inputs = problem.spec, problem.spec.solver.options, None
        if _is_collocated(spec, setup):
            steering = [c.name for c in setup.vehicle.of("commanded")]
            way = setup.dae, setup.start, setup.inputs, setup.t
            solution = drive(*way, free_states=steering, options=options)
            statistics = {**solution.run.statistics, "tolerance": options.tolerance}
            inputs = spline_inputs(setup.model, solution.t, solution.unknowns)
            run = replace(solution.run, statistics=statistics)
        else:
            run = base.integrate(setup, options, watch)
        replayed = partial(_with_replay, setup, inputs, options)
        if "steering_lever" in run.columns:
            run = steering_slip(setup.vehicle, run)
        elif run.stop and run.stop.name == "solver" and "steering_growth" in run.columns:
            words = "; ".join(filter(None, [run.stop.words, steering_note(run)]))
            run = replace(run, stop=run.stop._replace(words=words))  # with the cause
        return base.with_diagnostics(run, {"replay": replayed}, watch), NOTHING

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return the attributes of the result, including its solution method."""
        method = COLLOCATION if _is_collocated(problem.spec, setup) else "integration"
        inputs = " ".join(setup.model.input_names)
        return super().attributes(problem, setup) | {METHOD: method, "inputs": inputs}

    def facts(self, run: Trajectory) -> dict[str, Fact]:
        """Return the facts of a motion, including rates, least margin and errors."""
        facts = super().facts(run)
        if "inverse_margin" in run:
            facts["margin_meaning"] = Fact(run.columns["inverse_margin"].label.words)
        if warning := steering_warning(run):
            facts["steering_warning"] = Fact(warning)
        rates = [
            {"wheel": wheel, "first": float(run[name][0]), "last": float(run[name][-1])}
            for wheel in run.wheels
            if (name := f"{wheel}_rate") in run
        ]
        known = *COMMANDS, "path", "heading"
        steered = [name for name in run if f"{name}_error" in run and name not in known]
        at_stops = run.facts["held_at_stop"].value if "held_at_stop" in run.facts else ()
        ranges = list[dict[str, Any]]()
        for name in [each for each in ("steer", "steer_rate") if each in run] + steered:
            unit, words = printed_unit(run.columns[name].label.unit), ""
            if name in steered:
                words = f", off by {np.abs(run[f'{name}_error']).max():.1e} {unit} at most"
                words += "; reaches its stop" if name in at_stops else ""
            low, high = float(run[name].min()), float(run[name].max())
            shown = {"steer": "angle", "steer_rate": "rate"}.get(name, name)
            ranges.append(
                {"name": shown, "least": low, "greatest": high, "unit": unit, "words": words}
            )
        off = [np.abs(run[f"{name}_error"]) for name in steered]
        is_turning = np.max([np.zeros(run.t.size), *off], axis=0) > STEERED
        errors = list[dict[str, Any]]()
        for name in (each for each in known if f"{each}_error" in run):
            error, unit = np.abs(run[f"{name}_error"]), run.columns[f"{name}_error"].label.unit
            unit, worst = printed_unit(unit), int(error.argmax())
            if name not in COMMANDS or not off:  # errors of a path accumulate
                words = f"{error[-1]:.1e} {unit} at the end"
            elif is_turning.all():
                words = f"the steering is never within {STEERED:g} rad of its target"
            else:
                words = f"{error[~is_turning].max():.1e} {unit} while the steering is at its target"
            row = {"largest": float(error[worst]), "t": float(run.t[worst])}
            errors.append({"name": name, **row, "unit": unit, "words": words})
        tables = {"wheel_rates": rates, "steering": ranges, "command_errors": errors}
        return facts | {name: Fact(rows) for name, rows in tables.items()}

    def warnings(self, run: Trajectory) -> Sequence[str]:
        """Return a warning if the steering is unstable, unless the message of the stop has it."""
        warning = steering_warning(run)
        return [warning] if warning and not (run.stop and warning in run.stop.words) else []


def _given_rates(
    problem: Problem[Inverse], vehicle: Vehicle, points: Array | None
) -> tuple[dict[str, Any], str]:
    """Return the given rates by name, zeros for a path, and their description.

    For a path their names are those of commands if the steering angle is unknown and the vehicle
    cannot roll without slip, else those of the rates to impose.
    """
    spec = problem.spec
    if points is None and are_commands(spec.given or ()):
        return read_commands(problem, spec)
    given = dict(spec.given) if spec.given is not None else dict.fromkeys(given_rates.PLANAR, 0.0)
    known = dict.fromkeys((*given_rates.RATES, *COMMANDS, *ROBOT))
    faults = [*toml.name_errors(("given",), given, [*known])]
    if ours := [name for name in given if name in {*COMMANDS, *ROBOT} - {*given_rates.RATES}]:
        expected = (
            f"either rates in the platform's heading frame ({', '.join(COMMANDS)}; with frame = "
            f"'rep103' also {', '.join(ROBOT)}) or {', '.join(given_rates.RATES)}, not both"
        )
        found = f"{', '.join(given)}; remove one kind"
        faults.append(toml.Fault(("given", ours[0]), expected, found))
    found = f"a function of time; give a number (only {', '.join(COMMANDS)} may vary in time)"
    functions = [name for name, value in given.items() if not isinstance(value, float)]
    faults += [toml.Fault(("given", name), "a number", found) for name in functions]
    is_solved_for = points is not None and spec.steering == "angle"
    if spec.exact is not None and not is_solved_for:
        expected = (
            f"the key 'exact' only with given rates {', '.join(COMMANDS)}, or with a path and "
            "steering = 'angle'"
        )
        faults.append(
            toml.Fault(("exact",), expected, f"{str(spec.exact).lower()}; remove the key")
        )
    problem.refuse(*faults)
    words = ", ".join(
        f"{name} {value:g} {printed_unit(UNITS[name])}" for name, value in given.items()
    )
    if points is not None:
        words = f"path of {points.shape[1]} way-points in {points[0, -1]:g} s"
    if is_solved_for and not given_rates.is_determined(vehicle):
        return dict.fromkeys(COMMANDS, 0.0), words
    return given, f"{words}; the steering {spec.steering} is unknown"


def _points(problem: Problem[Inverse], vehicle: Vehicle) -> tuple[Array | None, tuple[str, ...]]:
    """Return the way-points, None without path, and notes on the units of their file.

    Way-points are t, x, y, heading [s, m, m, rad], shape (4, n), with headings from the y axis.
    """
    spec, path = problem.spec, problem.spec.path
    if path is None:
        return None, ()
    notes: tuple[str, ...] = ()
    place = ("path", "t" if path.file is None else "file")
    if path.file is None:
        points = np.array([path.t, path.x, path.y, path.heading], dtype=float)
    else:
        with at(problem, place):
            if is_mcap(Path(path.file)) and spec.frame != "rep103":
                raise DataError(
                    "expected frame = 'rep103' for a path in MCAP, with headings from the x axis, "
                    f"found frame = {spec.frame!r}; set frame = 'rep103'"
                )
            log = read_log(problem.folder / path.file, COLUMNS, kind="way-points")
            notes = (*log.notes, *log.rows_left_out)
            points = np.array([log.t, *(log.values[name] for name in COLUMNS[1:])])
            points[3] = np.unwrap(points[3], discont=1.5 * np.pi)
            check_time_unit(points[0], spec.time.duration)
            zero = heading_offset(problem) + np.pi / 2
            check_motion(log, zero=zero, is_aligned=not moves_sideways(vehicle))
    with at(problem, place):
        check_way_points(*points)
    (t, *_, heading), faults = points, list[toml.Fault]()
    if t[0] != 0:
        faults.append(toml.Fault(place, "0 as the first time", f"{t[0]:g} s; shift the times"))
    elif t[-1] < spec.time.duration:
        expected = f"at most the time of the last way-point, {t[-1]:g} s"
        found = f"{spec.time.duration:g} s; reduce the duration, or add way-points"
        faults.append(toml.Fault(("time", "duration"), expected, found))
    for k in np.flatnonzero(np.abs(np.diff(heading)) > np.pi)[:1].tolist():
        before, after = heading[k : k + 2]
        change = "subtract 2 pi from" if after > before else "add 2 pi to"
        remedy = f"{change} the headings from there on if they wrap, or add way-points"
        found = f"{after:g} rad at way-point {k + 2} after {before:g} rad; {remedy}"
        where = ("path", "heading") if path.file is None else place
        expected = "consecutive headings that differ by at most pi"
        faults.append(toml.Fault(where, expected, found))
    problem.refuse(*faults)
    points[3] += heading_offset(problem)
    return points, notes


def _start(spec: Inverse, setup: Setup, first: Any, *, exact: bool) -> Trajectory:
    """Return the vehicle at its start, with the first given rates.

    Under commands, steering angles that are absent from ``[start]`` are those that the first
    commands require. If collocation determines the steering, the vehicle is at rest.
    """
    vehicle, direct, dae, stand = setup.vehicle, setup.model, setup.dae, setup.start
    options = spec.solver.options
    if _is_collocated(spec, setup):
        return stand
    if not are_commands(dae.input_names):
        if spec.given is not None:
            # inputs that drive straight ahead at about the given speed
            heading, given, speed = float(stand["heading"][-1]), dict(spec.given), GUESS_SPEED
            if "velocity_x" in given and "velocity_y" in given:
                v_x, v_y = float(given["velocity_x"]), float(given["velocity_y"])
                speed = v_y * np.cos(heading) - v_x * np.sin(heading)
            rates = {f"{w.name}_rate": speed / w.radius for w in vehicle.wheels if w.driven}
            rates |= {f"{c.name}_rate": 0.0 for c in vehicle.of("commanded")}
            stand = apply_inputs(direct, stand, direct.inputs(**rates), options=options)
        return apply_inputs(dae, stand, first, options=options)
    unknown = [name for name in given_rates.steering_effects(direct) if name not in spec.start]
    try:
        errors = [f"{name}_error" for name in unknown]
        return trim_states(dae, stand, first, states=unknown, least=errors, options=options)
    except ModelError:
        if exact:
            given_rates.check_authority(direct, stand, dae.input_names)
        raise


def _is_collocated(spec: Inverse, setup: Setup) -> bool:
    """Return whether collocation determines the steering along the whole path."""
    is_commanded = are_commands(setup.dae.input_names)
    return spec.path is not None and spec.steering == "angle" and not is_commanded


def _with_replay(setup: Setup, inputs: Any, options: SolverOptions, run: Trajectory) -> Trajectory:
    """Return a motion with facts about its differences from the direct model.

    The direct model is integrated with ``inputs``, functions of time; if None, with splines through
    the samples of the motion.
    """
    direct, facts = setup.model, dict[str, Fact]()

    def unit_of(name: str) -> str:
        column = run.columns.get(name)
        return column.label.unit if column else ""

    try:
        trip = round_trip(direct, run, given_rates.PLANAR, options=options)
        facts |= {f"{ROUND_TRIP}{name}": Fact(gap, unit_of(name)) for name, gap in trip.items()}
        if run.t.size > 1:
            values: list[Any] = [v for v in leaves(setup.inputs) if isinstance(v, np.ndarray)]
            where = {k + 1 for each in values for k in np.flatnonzero(np.diff(each))}
            jumps = [float(setup.t[k]) for k in sorted(where) if setup.t[k] < run.t[-1]]
            apart = np.diff(np.searchsorted(run.t, [run.t[0], *jumps])).min(initial=MIN_SAMPLES)
            if apart < MIN_SAMPLES:  # too few for splines through the inputs
                raise ModelError(
                    f"expected at least {MIN_SAMPLES} samples between changes of the commands for "
                    f"a replay, found {apart}; reduce 'step' in [time]"
                )
            motion, gaps = replay(direct, run, inputs, jumps=jumps, options=options)
            facts |= {f"{REPLAY}{name}": Fact(gap, unit_of(name)) for name, gap in gaps.items()}
            if (stop := motion.stop) is not None and run.stop is None:
                facts["stopped_replay"] = Fact(f"at {stop.t:.6g} s: {stop.words}")
    except (SlipfreeError, np.linalg.LinAlgError) as error:
        facts["stopped_replay"] = Fact(str(error))
    followed = [c for c in setup.vehicle.of("commanded") if f"{c.name}_error" in run.columns]
    to_stop = [np.fmin(c.upper - run[c.name], run[c.name] - c.lower).min() for c in followed]
    pairs = zip(followed, to_stop, strict=True)
    at_stop = [c.name for c, distance in pairs if distance < 2 * given_rates.STOP_CLEARANCE]
    return run.with_facts({**facts, "held_at_stop": Fact(at_stop)})
