"""JSON output of motions and comparisons, with units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slipfree.core.facts import Facts
    from slipfree.core.trajectory import Stop, Trajectory
    from slipfree.problem.verbs.compare import ComparedMotion, ComparedVehicle


def motion_json(run: Trajectory, facts: Facts) -> dict[str, Any]:
    """Return the JSON object of a motion: times, stop, wheels, ranges of quantities, facts."""
    return {
        "samples": run.t.size,
        "time": {"unit": "s", "first": run.t[0], "last": run.t[-1]},
        "stop": stop_json(run.stop),
        "wheels": run.wheels,
        "quantities": quantities(run),
        "facts": {name: fact._asdict() for name, fact in facts.items()},
        "statistics": run.statistics,
    }


def stop_json(stop: Stop | None) -> dict[str, Any] | None:
    """Return name, time [s] and description of a stop; None without a stop."""
    return None if stop is None else {"name": stop.name, "time": stop.t, "words": stop.words}


def quantities(run: Trajectory) -> dict[str, Any]:
    """Return description, unit, first, last, smallest and largest value of each quantity by name.

    For quantities of wheels, first and last values are arrays of shape (n_wheels,), and smallest
    and largest values are taken over all wheels. Headings refer to the frame of the problem file.
    """
    return {
        name: {
            "words": label.words,
            "unit": label.unit,
            "first": values[0],
            "last": values[-1],
            "min": values.min(),
            "max": values.max(),
        }
        for name, (label, values) in run.columns.items()
    }


def row_json(row: ComparedVehicle) -> dict[str, Any]:
    """Return the JSON object of one vehicle of ``slipfree compare``."""
    return {
        "name": row.name,
        "wheels": row.wheels,
        "rank": row.rank,
        "conditions": row.conditions,
        "same_rates": _drive(row.same),
        "driving_law": _drive(row.fitting),
    }


def _drive(drive: ComparedMotion) -> dict[str, Any]:
    """Return the JSON object of one motion of a vehicle: extremes over time, and its stop.

    Values of slip are arrays with one entry per wheel.
    """
    return {
        "slip_along": {"unit": "m s-1", "max": drive.along},
        "slip_across": {"unit": "m s-1", "max": drive.across},
        "slip_measured": {"unit": "m s-1", "max": drive.measured},
        "friction_needed": {"unit": "1", "max": drive.friction},
        "tilt": {"unit": "rad", "max": drive.tilt},
        "axle": {"unit": "m", "min": drive.width[0], "max": drive.width[1]},
        "stop": stop_json(drive.stop),
    }
