"""Comparison of several vehicles on one ground: rolling without slip, or remaining slip."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from slipfree.core.records import leaves
from slipfree.core.trajectory import Frame, Trajectory
from slipfree.files.toml import Quantity
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.samples import measured_slip
from slipfree.problem import build
from slipfree.problem.build_ground import GroundMap, build_ground
from slipfree.problem.problem import Problem
from slipfree.problem.schema import DriverTable, TerrainKeys, VehicleSource
from slipfree.solve.sampling import input_samples
from slipfree.solve.simulate import simulate_to_failure
from slipfree.solve.system import with_inputs
from slipfree.system.parts import PartsWatch, study, until_interrupt
from slipfree.vehicle.tree import Vehicle

RANK = 1e-9  # smaller singular values, relative to the largest, count as zero


class NamedVehicle(VehicleSource):
    """A named vehicle of a comparison.

    Attributes
    ----------
    name : str
        Name of the vehicle.
    """

    name: Annotated[str, Field(min_length=1)]


class Compare(TerrainKeys):
    """Several vehicles on one ground: at common rates, and at the rates of a driving law.

    Attributes
    ----------
    frame : Frame
        Axis from which the heading of the start is measured: y, or x (REP 103).
    vehicles : tuple of NamedVehicle
        The vehicles to compare.
    inputs : mapping of str to float
        Common rates of driven wheels and commanded joints, by name; without them, vehicles are
        compared at the rates of the driving law only. [rad/s, m/s]
    driver : DriverTable
        The driving law.
    """

    verb: Literal["compare"]
    frame: Frame = "paper"
    vehicles: Annotated[tuple[NamedVehicle, ...], Field(strict=False, min_length=1)]
    inputs: dict[str, Quantity] = Field(default={})
    driver: DriverTable


def compare(
    problem: Problem[Compare], watch: PartsWatch = PartsWatch()
) -> tuple[GroundMap, list[dict[str, Any]]]:
    """Compare vehicles on one ground; return the ground and the results of each vehicle.

    Results are name, wheels, ``rank`` of the Jacobian of the slip in the unknown rates, number of
    slip ``conditions`` (a vehicle can roll without slip if both are equal), and the motions
    ``same_rates`` (with ``inputs``) and ``driving_law``: their stop, and extremes over time with
    units. Slip has a value for each wheel; ``slip_measured`` is computed from their poses alone.

    After a Ctrl-C held back by `held_interrupt`, the results are those of the finished vehicles.
    ProblemError is raised if the problem cannot be built; SolverError if a motion fails before its
    first sample.
    """
    ground = build_ground(problem)
    terrain, vehicles = build.build_terrain(problem, ground), problem.spec.vehicles

    def compared(index: int) -> dict[str, Any]:
        """Return the row of a vehicle: whether it can roll, and its motions at both rates."""
        vehicle = build.build_vehicle(problem, vehicles[index], ("vehicles", index))
        dae = build.in_frame(problem, direct_kinematics(vehicle, terrain))
        spec, start = problem.spec, build.build_start(problem, dae)
        options = spec.solver.options
        known = [label.full for label in leaves(dae.labels.u)]
        free = {f"{wheel.name}_rate" for wheel in vehicle.wheels if not wheel.driven}
        rates = {key: rate for key, rate in spec.inputs.items() if key not in free}
        build.check_names(problem, dae, {**dict.fromkeys(known, 0.0), **rates})
        t, _ = input_samples(spec.time.duration, spec.time.step, {})
        drives = {"driving_law": build.build_law(problem, spec.driver, dae, start)}
        if rates:
            drives["same_rates"] = dae.inputs(**{key: rates.get(key, 0.0) for key in known})
        motions = {
            name: _extremes(vehicle, simulate_to_failure(dae, start, each, t, options))
            for name, each in drives.items()
        }
        # the Jacobian of the rates contains A'A, which has the rank of A, the Jacobian of the slip
        system = with_inputs(dae, dae.zero_inputs, 0, options)
        point = 0.0, dae.rows("x", start, -1), dae.rows("z", start, -1), system.u[:, 0], 0.0
        block = np.array(system.blocks[1].newton(*point)[1]) * dae.sizes.z[system.blocks[1].span]
        count = len(block) - len(start.wheels)
        values = np.linalg.svd(block[:count, :count], compute_uv=False)
        return {
            "name": vehicles[index].name,
            "wheels": start.wheels,
            "rank": int((values > RANK * values[0]).sum()),
            "conditions": 3 * len(vehicle.wheels),
            **motions,
        }

    with study(compared, watch=watch) as run:
        rows = until_interrupt(run(range(len(vehicles)), lambda index: index))
    return ground, [row for _, row in rows]


def _extremes(vehicle: Vehicle, run: Trajectory) -> dict[str, Any]:
    """Return extremes of slip, friction and tilt, and the stop of a motion, for its table.

    ``friction_needed`` is that of load-weighted forces, NaN for a vehicle without mass. ``axle`` is
    the distance between the centres of the first two wheels: it varies on a split axle.
    """
    even = run if run.stop is None else run.part(slice(-1))  # a stop lies between the samples
    slip = np.linalg.norm(measured_slip(vehicle, even), axis=2)
    tilts = [run[c.name] for c in vehicle.of("passive") if vehicle.unit(c.name) == "rad"]
    gaps = [run[f"center_{axis}"][:, 0] - run[f"center_{axis}"][:, 1] for axis in "xyz"]
    width = np.sqrt(sum(gap**2 for gap in gaps))
    tilt = max((float(np.abs(tilt).max()) for tilt in tilts), default=0.0)
    # load-weighted; without mass not a number
    friction = float(run["friction_needed"].max()) if vehicle.mass else float("nan")
    stop = run.stop and {"name": run.stop.name, "time": run.stop.t, "words": run.stop.words}
    return {
        "slip_along": {"unit": "m s-1", "max": np.abs(run["slip_along"]).max(axis=0)},
        "slip_across": {"unit": "m s-1", "max": np.abs(run["slip_across"]).max(axis=0)},
        "slip_measured": {"unit": "m s-1", "max": slip.max(axis=0)},
        "friction_needed": {"unit": "1", "max": friction},
        "tilt": {"unit": "rad", "max": tilt},
        # distance of the first two wheels
        "axle": {"unit": "m", "min": float(width.min()), "max": float(width.max())},
        "stop": stop,
    }
