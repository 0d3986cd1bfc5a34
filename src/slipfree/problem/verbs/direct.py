"""Direct problems: motion for given inputs of wheels and joints, or for a driving law."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.errors import DataError, ModelError
from slipfree.core.facts import Fact, rows
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.mcap import is_mcap, read_joint_commands
from slipfree.files.netcdf import NOTHING
from slipfree.files.tables import read_columns, read_names
from slipfree.files.toml import Fault, Piecewise, PiecewiseConstantOrFile, Positive, format_value
from slipfree.files.urdf.links import Robot, joint_values
from slipfree.geometry import path
from slipfree.models.montana import Difference, cross_check, montana_kinematics
from slipfree.problem.build import (
    Setup,
    build_climbing,
    build_law,
    build_shared_model,
    build_start,
    build_world,
    check_names,
    model_law,
    path_points,
    sampled_times,
    solver_options,
)
from slipfree.problem.build_ground import at
from slipfree.problem.build_vehicle import vehicle_file
from slipfree.problem.problem import Problem
from slipfree.problem.schema import FILE, STEP_CLIMBING, ClimbingDriver, Modelled, MotionKeys
from slipfree.problem.verbs import base
from slipfree.solve.sampling import input_samples
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.plan.polynomial_motion import SavedPlan


ROUNDING = 1e-9  # relative length by which the end of a path is not yet passed
START_TOLERANCE = 1e-6  # of the first commanded position [rad, m]


class _Actuator(NamedTuple):
    """Input that moves a joint: ``joint = offset + slope * q``, with rate ``q'`` of the input."""

    name: str  # of the input
    slope: float
    offset: float
    is_wheel: bool  # whether q is the angle of a wheel, not a coordinate


def read_joint_inputs(problem: Problem[Any], file: str, vehicle: Vehicle) -> dict[str, Piecewise]:
    """Return the inputs that a file commands, by name; joints without input are ignored.

    The rates of an MCAP file are the commanded velocities. If some messages have no velocity, the
    rates between two messages are constant, and each position is reached at the time of its
    message. Those of a CSV file, as `slipfree.files.netcdf.export_rates` writes it, are the means
    of consecutive rows. ProblemError is raised if the file cannot be used, or its first positions
    are not those of the start.
    """
    spec: MotionKeys = problem.spec
    robot = vehicle_file(spec.vehicle, problem).robot
    actuators, inputs = _actuators(vehicle, robot), dict[str, Piecewise]()
    with at(problem, ("inputs", FILE)):
        if not is_mcap(Path(file)):
            names = [each.name for each in actuators.values()]
            return _read_rates(problem.folder / file, names, spec.time.duration)
        commands = read_joint_commands(problem.folder / file)
        for joint, actuator in actuators.items():
            if joint not in commands or actuator.name in inputs:
                continue
            t, positions, velocities = commands[joint]
            if np.isfinite(velocities).all():
                rates = velocities / actuator.slope
            elif np.isfinite(positions).all():
                wanted = (positions - actuator.offset) / actuator.slope
                name, first = actuator.name.removesuffix("_rate"), float(wanted[0])
                start = spec.start.get(name, 0.0)
                if not actuator.is_wheel and abs(start - first) > START_TOLERANCE:
                    raise DataError(
                        f"expected a start at the first position of joint {joint} in the file, "
                        f"{name} = {first:.9g}, found {name} = {start:.9g}; set {name} = "
                        f"{first:.9g} in [start]"
                    )
                rates = np.append(np.diff(wanted) / np.diff(t), 0.0)
            else:
                raise DataError(
                    f"expected a velocity, or a position, of joint {joint} in every message that "
                    "names it, found messages without velocity and messages without position; "
                    "record either in every message"
                )
            later: Array = t if t[0] == 0 else np.append(0.0, t)
            padded = np.append(np.zeros(later.size - rates.size), rates)
            inputs[actuator.name] = tuple(zip(later.tolist(), padded.tolist(), strict=True))
        if not inputs:
            raise DataError(
                f"{file}: expected commands of one or more of the joints {', '.join(actuators)}, "
                + (
                    f"found those of {', '.join(commands)}; rename the joints in the file"
                    if commands
                    else "found no joint names; record the commands with names"
                )
            )
    return inputs


def _read_rates(file: Path, inputs: Sequence[str], end: float) -> dict[str, Piecewise]:
    """Return the rates in a CSV file by input; rates between two rows are their mean.

    Of two rows with the same time, the second one counts from there on.
    """
    expected = f"times t and rates of some of the inputs {', '.join(inputs)}"
    names = [name for name in inputs if name in read_names(file, expected)]
    if not names:
        raise DataError(f"{file}: expected {expected}, found none of them; name the columns so")
    t, *rates = read_columns(file, ["t", *names], expected).values.values()
    steps = np.diff(t, prepend=0.0)
    if steps.min() < 0 or t[-1] < end * (1 - ROUNDING):
        raise DataError(
            f"{file}: expected times that increase from 0 to time.duration, {end:g} s, or further, "
            f"found {t[0]:g} to {t[-1]:g} s; sort the rows, or change the duration"
        )
    since, later = np.append(0.0, t)[:-1], steps > 0
    means = [(np.append(each[0], each)[:-1] + each) / 2 for each in rates]
    table = zip(names, means, rates, strict=True)
    return {
        name: (*zip(since[later].tolist(), mean[later].tolist(), strict=True), (t[-1], last[-1]))
        for name, mean, last in table
    }


def _actuators(vehicle: Vehicle, robot: Robot | None) -> dict[str, _Actuator]:
    """Return the inputs by the names of coordinates and of joints that they move linearly."""
    wheels, (q, joints) = [w.name for w in vehicle.wheels], joint_values(vehicle, robot)
    names = [*(c.name for c in vehicle.coordinates), *wheels]
    commanded = [c.name for c in vehicle.of("commanded")]
    driven = {*commanded, *(w.name for w in vehicle.wheels if w.driven)}
    actuators = {n: _Actuator(f"{n}_rate", 1.0, 0.0, is_wheel=False) for n in commanded}
    for joint, value in joints.items():
        slopes = ca.jacobian(value, q)
        if slopes.nnz() != 1 or ca.symvar(slopes):
            continue
        name = names[slopes.sparsity().get_triplet()[1][0]]
        if name in driven:
            slope, offset = ca.sum2(ca.DM(slopes)), ca.Function("value", [q], [value])(0)
            own = f"{name}_rate", float(slope), float(offset), name in wheels
            actuators[joint] = _Actuator(*own)
    return actuators


class SampledDriver(ClimbingDriver):
    """A driving law: straight ahead, along a path, or of a step climber; continuous or sampled.

    Attributes
    ----------
    name : {"straight", "follow", "step-climbing"}
        Name of the law.
    period : float or None
        With model = 'dynamics': time between evaluations of the law, a divisor of time.step; the
        inputs are constant in between. By default the law is continuous, which is 3 to 40 times as
        fast. [s]
    """

    name: Literal["straight", "follow", "step-climbing"]  # type: ignore[assignment]
    period: Positive | None = None


class Direct(Modelled):
    """Direct problem: the motion at given rates, or under a driving law.

    Attributes
    ----------
    inputs : mapping of str to float, tuple or str or None
        Rates of driven wheels and commanded joints, by name, or 'file', a CSV or MCAP file of them
        of joints. [rad/s, m/s]
    driver : SampledDriver or None
        a driving law.
    formulation : {"closure", "montana"}
        Formulation of contact: closure of positions, or Montana's equations of rates.
    """

    verb: Literal["direct"]
    inputs: dict[str, PiecewiseConstantOrFile] | None = None
    driver: SampledDriver | None = None
    formulation: Literal["closure", "montana"] = "closure"

    alternatives = "inputs", "driver"

    def faults(self) -> Iterator[Fault]:
        """Yield errors of common keys, inputs of the wrong type, and a period without dynamics."""
        yield from super().faults()
        if self.driver and self.driver.period and self.model != "dynamics":
            expected = "a period only with model = 'dynamics'"
            found = f"model = {self.model!r}; change the model, or remove the period"
            yield Fault(("driver", "period"), expected, found)
        for name, value in (self.inputs or {}).items():
            if isinstance(value, str) != (name == FILE):
                words = "a number, or an array of [time, value] pairs"
                expected = "the name of a CSV or MCAP file in quotes" if name == FILE else words
                yield Fault(("inputs", name), expected, format_value(value))


class DirectVerb(base.DriveVerb):
    """Motion of a vehicle at given rates, or under a driving law."""

    schema = Direct
    options = (base.CROSS_CHECK,)
    own_rows = rows("*distance from the path: {path_distance_largest:.3g} at most; {path_end}")

    def build(self, problem: Problem[Direct]) -> Setup:
        """Return the model, the settled start and the inputs of a problem."""
        spec = problem.spec
        world = build_world(problem)
        dae = model = build_shared_model(problem, world)
        constants, source = spec.inputs, ""
        if constants is not None and FILE in constants:
            constants = dict(constants)
            file = str(constants.pop(FILE))
            constants = read_joint_inputs(problem, file, world.vehicle) | constants
            source = f" of {file}"
        check_names(problem, dae, constants)
        is_climbing = spec.driver is not None and spec.driver.name == STEP_CLIMBING
        if is_climbing:
            dae, climbing_inputs = build_climbing(problem, world, model)
        start = build_start(problem, dae)
        (t, rates), every = input_samples(spec.time.duration, spec.time.step, constants or {}), 0
        if spec.formulation == "montana":
            with at(problem, ("formulation",)):
                if spec.model != "kinematics":
                    raise ModelError(
                        "expected model = 'kinematics' with formulation = 'montana', found model = "
                        f"{spec.model!r}; set model = 'kinematics', or remove 'formulation'"
                    )
                dae = montana_kinematics(world.vehicle, world.terrain, slip=model_law(problem))
        if spec.driver is None:
            driven = f"inputs {', '.join(rates)}{source}"
            with at(problem, ("inputs",)):
                inputs = dae.inputs(**rates)
        else:
            driven = f"driver {spec.driver.name}"
            inputs = climbing_inputs if is_climbing else build_law(problem, spec.driver, dae, start)
            if spec.driver.period is not None:
                driven += f", every {spec.driver.period:g} s"
                t, every = sampled_times(problem, ("driver", "period"), spec.driver.period)
        drive: dict[str, Any] = {"start": start, "inputs": inputs, "t": t, "driven": driven}
        return Setup(**vars(world), model=model, dae=dae, every=every, **drive)

    def drive(
        self, problem: Problem[Direct], setup: Setup, watch: base.Watch, resume: SavedPlan | None
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the motion, complete or up to its stop, and an empty mapping of arrays."""
        run = base.integrate(setup, solver_options(problem), watch)
        if setup.every:
            last = run.t.size - 1  # with the end at a stop
            kept = [*range(0, last, setup.every), last]
            run = run.part(np.array(kept), run.stop)
        driver = problem.spec.driver
        if driver is None or (followed := _followed(problem, driver)) is None:
            return run, NOTHING
        speed, length = abs(driver.speed), followed.length
        on, beyond = speed * run.t <= length, speed * run.t[-1] - length  # of the reference point
        distance = float(followed.distance(run["x"][on], run["y"][on]).max())
        whole = f"{length / speed:.4g} s"
        words = f"{length + min(beyond, 0.0):.4g} of {length:.4g} m followed (the whole in {whole})"
        if beyond > ROUNDING * length:
            words = f"end of the path at t = {whole}, passed by {beyond:.4g} m, straight on"
        facts = {"path_distance_largest": Fact(distance, "m"), "path_end": Fact(words)}
        return run.with_facts(facts), NOTHING

    def marks(self, problem: Problem[Any], domain: Any) -> dict[str, Any]:
        """Return the path that the driver follows; empty without one."""
        driver = problem.spec.driver
        followed = _followed(problem, driver) if driver is not None else None
        return {} if followed is None else {"wanted": followed.line}

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return the attributes of the result, including model, law and formulation."""
        spec = problem.spec
        attributes = super().attributes(problem, setup) | base.model_attributes(spec)
        return attributes | {base.FORMULATION: spec.formulation}

    def cross_check(self, result: base.Result) -> tuple[str, tuple[Difference, ...]]:
        """Return the other formulation of contact, and differences from the motion in it."""
        problem = result.problem
        other = "montana" if problem.spec.formulation == "closure" else "closure"
        again = replace(problem, spec=problem.spec.model_copy(update={"formulation": other}))
        setup = self.build(again)
        with at(problem, ("start",)):
            motion = self.solve(again, setup, base.Watch(), None)[0]
        return other, cross_check(result.trajectory, motion)


def _followed(problem: Problem[Direct], driver: SampledDriver) -> path.Path | None:
    """Return the path that a driver follows; None without one."""
    return path.Path(path_points(problem, driver)) if driver.name == "follow" else None
