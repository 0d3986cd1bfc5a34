"""Inverse kinematics: rates of wheels and steering for a given motion of the platform."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slipfree.control.path_following import check_way_points, path_inputs, track_path
from slipfree.core.errors import DataError, ModelError, SlipfreeError
from slipfree.core.facts import Fact, printed_unit, rows
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.files.logs import check_motion, read_log
from slipfree.files.mcap import is_mcap
from slipfree.files.netcdf import NOTHING
from slipfree.files.toml.source import Fault, name_errors, problem_error
from slipfree.files.toml.types import unit_faults
from slipfree.models.determinacy import check_authority
from slipfree.models.given_rates import (
    COMMANDS,
    LEAST_MARGIN,
    PLANAR,
    RATES,
    ROBOT,
    STOP_CLEARANCE,
    UNITS,
    GivenRates,
    is_determined,
    steering_effects,
)
from slipfree.models.inverse import invert, steering_note, steering_slip
from slipfree.models.kinematics import direct_kinematics
from slipfree.problem.build import (
    Setup,
    build_start,
    build_world,
    check_names,
    heading_offset,
)
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.units import check_time_unit, moves_sideways
from slipfree.problem.verbs.base import (
    Result,
    Watch,
    integrate,
    with_diagnostics,
)
from slipfree.problem.verbs.driving import DriveVerb
from slipfree.problem.verbs.inverse_schema import Inverse, are_commands, read_commands
from slipfree.solve.collocation import drive
from slipfree.solve.options import SolverOptions
from slipfree.solve.replay import apply_inputs, replay, round_trip, spline_inputs, trim_states
from slipfree.solve.sampling import input_samples
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.plan.polynomial_motion import SavedPlan
    from slipfree.show.plots import Plot


ROUND_TRIP, REPLAY = "round_trip_", "replay_"  # beginnings of the names of differences
METHOD, COLLOCATION = "solved_by", "collocation"  # attribute of a result, and one of its values
STEERED = 0.02  # largest error of a steering coordinate at its target [rad, m]
ROWS = rows(
    """\
rate of wheel {wheel}: <wheel_rates> {first:.6g} at the start, {last:.6g} rad/s at the end
steering {name}: <steering> {least:.6g} to {greatest:.6g} {unit}{words}
!margin: {inverse_margin_least:.4g} at least ({inverse_margin_least.words}): {margin_meaning}
*error of {name}: <command_errors> {largest:.1e} {unit} at most (t = {t:.4g} s), {words}
steering slip: {steering_slip_largest:.2e} at most (steering lever times steering rate)
*warning: {steering_warning}"""
)
CHECK_ROWS = rows(
    """\
!round trip: differences of the platform rates from those of the direct model at the same wheel \
and joint rates: <round_trip_*> {name} {fact:.1e}
!collocation: {elements:.0f} elements of degree {degree:.0f}, {cpu_seconds:.3g} s CPU, steering \
error {sought_error:.1e} rad
*!replay by the direct model: differs by at most <replay_*> {name} {fact:.1e}
*!replay stopped early: {stopped_replay}"""
)
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


def _inverse_facts(run: Trajectory) -> dict[str, Fact]:
    """Return the facts about rates of wheels and steering, and errors of commands or of a path."""
    facts = dict[str, Fact]()
    if "inverse_margin" in run:
        facts["margin_meaning"] = Fact(run.columns["inverse_margin"].label.words)
    if warning := steering_warning(run):
        facts["steering_warning"] = Fact(warning)
    rates = [
        {"wheel": wheel, "first": float(run[name][0]), "last": float(run[name][-1])}
        for wheel in run.wheels
        if (name := f"{wheel}_rate") in run
    ]
    known = {*COMMANDS, "path", "heading"}
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
        ranges.append({"name": shown, "least": low, "greatest": high, "unit": unit, "words": words})
    off = [np.abs(run[f"{name}_error"]) for name in steered]
    is_turning = np.max([np.zeros(run.t.size), *off], axis=0) > STEERED
    errors = list[dict[str, Any]]()
    for name in (each for each in (*COMMANDS, "path", "heading") if f"{each}_error" in run):
        error, unit = np.abs(run[f"{name}_error"]), run.columns[f"{name}_error"].label.unit
        unit, worst = printed_unit(unit), int(error.argmax())
        if name not in COMMANDS:  # errors of a path accumulate
            words = f"{error[-1]:.1e} {unit} at the end"
        elif is_turning.all():
            words = f"the steering is never within {STEERED:g} rad of its target"
        else:
            words = f"{error[~is_turning].max():.1e} {unit} while the steering is at its target"
        row = {"largest": float(error[worst]), "t": float(run.t[worst])}
        errors.append({"name": name, **row, "unit": unit, "words": words})
    tables = {"wheel_rates": rates, "steering": ranges, "command_errors": errors}
    return facts | {name: Fact(rows) for name, rows in tables.items()}


class InverseVerb(DriveVerb):
    """Inverse kinematics: wheel and steering rates for a given motion of the platform."""

    schema = Inverse
    own_rows, last_rows = ROWS, CHECK_ROWS
    metrics_shown = ("inverse_margin_least", "slip_rms", "utilisation_largest")
    verified = (ROUND_TRIP, REPLAY)

    def figures(self, result: Result) -> tuple[Plot, ...]:
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
        rates = GivenRates(
            tuple(given),
            "rates" if is_rolling_path or spec.steering == "rate" else "angles",
            len(given) < len(COMMANDS) if spec.exact is None else spec.exact,
            0.0 if is_rolling_path and spec.steering == "angle" else LEAST_MARGIN,
        )
        with at(problem, place):
            rates.check(vehicle)
        with at(problem, ("vehicle",)):
            direct = direct_kinematics(vehicle, world.terrain, slip=rates.slip)
        dae = invert(direct, rates)
        check_names(problem, direct, None)
        if faults := [*unit_faults(("given",), spec.given or {}, UNITS)]:
            raise problem_error(problem.source, faults)
        stand = build_start(problem, direct)
        texts = {name: value for name, value in given.items() if isinstance(value, str)}
        formulas = {name: evaluate(text, {"t": dae.t}) for name, text in texts.items()}
        numbers = {name: value for name, value in given.items() if name not in formulas}
        t, over_time = input_samples(spec.time.duration, spec.time.step, numbers)
        initial = {n: v[0] if isinstance(v, np.ndarray) else v for n, v in over_time.items()}
        inputs, first = (dae.inputs(**each, **formulas) for each in (over_time, initial))
        with at(problem, place):
            if is_rolling_path and points is not None:
                inputs = first = path_inputs(dae, stand, *points[1:], t=points[0])
            elif points is not None:
                dae, inputs = track_path(dae, *points)
                first = inputs
            drive: dict[str, Any] = {"inputs": inputs, "t": t, "driven": description}
            setup = Setup(**vars(world), model=direct, dae=dae, start=stand, **drive)
            return replace(setup, start=_start(spec, setup, first, exact=rates.exact))

    def drive(
        self, problem: Problem[Inverse], setup: Setup, watch: Watch, resume: SavedPlan | None
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
            run = integrate(setup, options, watch)
        replayed = partial(_with_replay, setup, inputs, options)
        if "steering_lever" in run.columns:
            run = steering_slip(setup.vehicle, run)
        elif run.stop and run.stop.name == "solver" and "steering_growth" in run.columns:
            words = "; ".join(filter(None, [run.stop.words, steering_note(run)]))
            run = replace(run, stop=run.stop._replace(words=words))  # with the cause
        return with_diagnostics(run, {"replay": replayed}, watch), NOTHING

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return the attributes of the result, including its solution method."""
        is_collocated = _is_collocated(problem.spec, setup)
        method = COLLOCATION if is_collocated else "integration"
        inputs = " ".join(setup.model.input_names)
        return super().attributes(problem, setup) | {METHOD: method, "inputs": inputs}

    def facts(self, run: Trajectory) -> dict[str, Fact]:
        """Return the facts of a motion, including rates, least margin and errors."""
        return super().facts(run) | _inverse_facts(run)

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
    given = dict(spec.given) if spec.given is not None else dict.fromkeys(PLANAR, 0.0)
    faults = [*_rate_faults(given)]
    is_solved_for = points is not None and spec.steering == "angle"
    if spec.exact is not None and not is_solved_for:
        expected = (
            f"the key 'exact' only with given rates {', '.join(COMMANDS)}, or with a path and "
            "steering = 'angle'"
        )
        faults.append(Fault(("exact",), expected, f"{str(spec.exact).lower()}; remove the key"))
    if faults:
        raise problem_error(problem.source, faults)
    words = ", ".join(
        f"{name} {value:g} {printed_unit(UNITS[name])}" for name, value in given.items()
    )
    if points is not None:
        words = f"path of {points.shape[1]} way-points in {points[0, -1]:g} s"
    if is_solved_for and not is_determined(vehicle):
        return dict.fromkeys(COMMANDS, 0.0), words
    return given, f"{words}; the steering {spec.steering} is unknown"


def _rate_faults(given: dict[str, float]) -> Iterator[Fault]:
    """Yield an error for each unknown name, and for a wrong kind of the given rates."""
    yield from name_errors(("given",), given, list(dict.fromkeys((*RATES, *COMMANDS, *ROBOT))))
    if ours := [name for name in given if name in {*COMMANDS, *ROBOT} - {*RATES}]:
        expected = (
            f"either rates in the platform's heading frame ({', '.join(COMMANDS)}; with frame = "
            f"'rep103' also {', '.join(ROBOT)}) or other rates, not both"
        )
        yield Fault(("given", ours[0]), expected, f"{', '.join(given)}; remove one kind")
    for name, value in given.items():
        if not isinstance(value, float):
            yield Fault(
                ("given", name),
                "a number",
                f"a function of time; give a number (only {', '.join(COMMANDS)} may vary in time)",
            )


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
    if faults := [*_path_faults(points, place, problem.spec)]:
        raise problem_error(problem.source, faults)
    points[3] += heading_offset(problem)
    return points, notes


def _path_faults(points: Array, place: tuple[str, ...], spec: Inverse) -> Iterator[Fault]:
    """Yield an error for a path that begins late or ends early, and for a leap of the heading."""
    t, heading = points[[0, 3]]
    if t[0] != 0:
        yield Fault(place, "0 as the first time", f"{t[0]:g} s; shift the times")
    elif t[-1] < spec.time.duration:
        expected = f"at most the time of the last way-point, {t[-1]:g} s"
        found = f"{spec.time.duration:g} s; reduce the duration, or add way-points"
        yield Fault(("time", "duration"), expected, found)
    leaps = np.flatnonzero(np.abs(np.diff(heading)) > np.pi)
    if leaps.size:
        k = int(leaps[0])
        before, after = heading[k : k + 2]
        change = "subtract 2 pi from" if after > before else "add 2 pi to"
        remedy = f"{change} the headings from there on if they wrap, or add way-points"
        expected = "consecutive headings that differ by at most pi"
        found = f"{after:g} rad at way-point {k + 2} after {before:g} rad; {remedy}"
        yield Fault(("path", "heading") if place[-1] == "t" else place, expected, found)


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
    unknown = [name for name in steering_effects(direct) if name not in spec.start]
    try:
        errors = [f"{name}_error" for name in unknown]
        return trim_states(dae, stand, first, states=unknown, least=errors, options=options)
    except ModelError:
        if exact:
            check_authority(direct, stand, dae.input_names)
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
        trip = round_trip(direct, run, PLANAR, options=options)
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
    at_stop = [c.name for c, distance in pairs if distance < 2 * STOP_CLEARANCE]
    return run.with_facts({**facts, "held_at_stop": Fact(at_stop)})
