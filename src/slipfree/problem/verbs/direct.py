"""Direct problems: the motion at given rates, or under a driving law."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import NOTHING
from slipfree.files.toml.source import Fault, format_value
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import PiecewiseConstantOrFile, Positive
from slipfree.models.montana import cross_check, montana_kinematics
from slipfree.problem.build_common import (
    Setup,
    build_start,
    check_names,
    sampled_times,
    samples,
    solver_options,
)
from slipfree.problem.build_driver import build_climbing, build_law
from slipfree.problem.build_ground import at
from slipfree.problem.build_model import model_law
from slipfree.problem.build_world import build_world
from slipfree.problem.joint_inputs import read_joint_inputs
from slipfree.problem.problem import Problem
from slipfree.problem.schema import FILE, VERB, Modelled, TerrainKeys
from slipfree.problem.schema_climbing import STEP_CLIMBING, ClimbingDriver
from slipfree.problem.verbs.base import CROSS_CHECK, CrossCheck, Result, Watch, integrate
from slipfree.problem.verbs.drive_facts import FORMULATION
from slipfree.problem.verbs.driving import DriveVerb, model_attributes
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.plan.warm_start import SavedPlan


class SampledDriver(ClimbingDriver):
    """A driving law: straight ahead, along a path, or of a step climber; continuous or sampled."""

    name: Literal["straight", "follow", "step-climbing"] = Field(  # type: ignore[assignment]
        description="name of the law"
    )
    period: Positive | None = Field(
        default=None,
        description="with model = 'dynamics': time between evaluations of the law, a divisor of "
        "time.step; the inputs are constant in between. By default the law is continuous, which is "
        "3 to 40 times as fast [s]",
    )


class Direct(Modelled):
    """Direct problem: the motion at given rates, or under a driving law."""

    verb: Literal["direct"] = Field(description=VERB)
    inputs: dict[str, PiecewiseConstantOrFile] | None = Field(
        default=None,
        description="rates of driven wheels and commanded joints, by name, or 'file', an MCAP file "
        "with commands of joints [rad/s, m/s]",
    )
    driver: SampledDriver | None = Field(default=None, description="a driving law")
    formulation: Literal["closure", "montana"] = Field(
        default="closure",
        description="formulation of contact: closure of positions, or Montana's equations of rates",
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        **TerrainKeys.alternatives,
        (): ("inputs", "driver"),
    }

    @property
    def named_files(self) -> tuple[str, ...]:
        """Name of the MCAP file of commands; empty without such a file."""
        file = (self.inputs or {}).get(FILE)
        return (file,) if isinstance(file, str) else ()

    def faults(self) -> Iterator[Fault]:
        """Yield errors of common keys, inputs of the wrong type, and a period without dynamics."""
        yield from super().faults()
        if self.driver and self.driver.period and self.model != "dynamics":
            expected = "a period only with model = 'dynamics'"
            found = f"model = {self.model!r}; change the model, or remove the period"
            yield Fault(("driver", "period"), expected, found)
        if self.driver is not None:
            yield from self.driver.climbing_faults(self.model)
        for name, value in (self.inputs or {}).items():
            if isinstance(value, str) != (name == FILE):
                words = "a number, or an array of [time, value] pairs"
                expected = "the name of an MCAP file in quotes" if name == FILE else words
                yield Fault(("inputs", name), expected, format_value(value))


class DirectVerb(DriveVerb):
    """Motion of a vehicle at given rates, or under a driving law."""

    schema = Direct
    options = (CROSS_CHECK,)

    def build(self, problem: Problem[Direct]) -> Setup:
        """Return the model, the settled start and the inputs of a problem.

        Raises
        ------
        ProblemError
            If ground, vehicle, law, start or inputs are not valid, or the model does not support
            the formulation of contact.
        """
        spec = problem.spec
        world = build_world(problem)
        ground, terrain, vehicle, prisms, model = world
        dae: Dae = model
        given, source = _given(problem, vehicle)
        check_names(problem, dae, given)
        is_climbing = spec.driver is not None and spec.driver.name == STEP_CLIMBING
        if is_climbing:
            dae, climbing_inputs = build_climbing(problem, world)
        start = build_start(problem, dae)
        (t, rates), every = samples(spec.time, given or {}), 0
        if spec.formulation == "montana":
            with at(problem, ("formulation",)):
                if spec.model != "kinematics":
                    raise ModelError(
                        "expected model = 'kinematics' with formulation = 'montana', found model = "
                        f"{spec.model!r}; set model = 'kinematics', or remove 'formulation'"
                    )
                dae = montana_kinematics(vehicle, terrain, slip=model_law(problem, spec))
        if spec.driver is None:
            driven = f"inputs {', '.join(rates)}{source}"
            with at(problem, ("inputs",)):
                inputs = dae.inputs(**rates)
        else:
            driven = f"driver {spec.driver.name}"
            inputs = (
                climbing_inputs
                if is_climbing
                else build_law(problem, spec.driver, dae, vehicle, start)
            )
            if spec.driver.period is not None:
                driven += f", every {spec.driver.period:g} s"
                t, every = sampled_times(problem, ("driver", "period"), spec.driver.period)
        parts = ground, terrain, vehicle, model, dae, start, inputs, t, driven
        return Setup(*parts, prisms=prisms, every=every)

    def drive(
        self, problem: Problem[Direct], setup: Setup, watch: Watch, resume: SavedPlan | None
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the motion, complete or up to its stop, and an empty mapping of arrays."""
        run = integrate(setup, solver_options(problem), watch)
        return run.part(slice(0, None, setup.every or 1), run.stop), NOTHING

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return the attributes of the result, including model, law and formulation."""
        spec = problem.spec
        found = super().attributes(problem, setup) | model_attributes(spec)
        return found | {FORMULATION: spec.formulation}

    def cross_check(self, result: Result) -> CrossCheck:
        """Return the differences from the motion in the other formulation of contact."""
        problem = result.problem
        other = "montana" if problem.spec.formulation == "closure" else "closure"
        again = replace(problem, spec=problem.spec.model_copy(update={"formulation": other}))
        setup = self.build(again)
        with at(problem, ("start",)):
            motion = self.solve(again, setup, Watch(), None).trajectory
        return CrossCheck(other, cross_check(result.trajectory, motion))


def _given(problem: Problem[Direct], vehicle: Vehicle) -> tuple[dict[str, Any] | None, str]:
    """Return the inputs of a problem, including those of its MCAP file, and a note on the file.

    Rates in the problem replace those in the file. The inputs are None under a driving law.
    """
    given = problem.spec.inputs
    if given is None or FILE not in given:
        return given, ""
    file = given[FILE]
    rates = {name: value for name, value in given.items() if name != FILE}
    return read_joint_inputs(problem, file, vehicle) | rates, f" of {file}"
