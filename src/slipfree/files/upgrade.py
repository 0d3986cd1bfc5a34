"""Conversion of the attributes and quantities in result files of version 0.1."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np

from slipfree.files.toml.source import load_toml, replace_values
from slipfree.outcome import Outcome
from slipfree.records import Array, Label
from slipfree.trajectory import OUTCOME, STATISTICS, STOP, Column

CLIMBS = {  # current names of quantities of climbs
    "x": "y",
    "velocity_x": "velocity_y",
    "tilt_rear_rate": "omega_x",
    "axle_x": "center_y",
    "axle_z": "center_z",
    "wheel_rate": "spin",
    "torque": "motor_torque",
    "rear_overturned": "rear_upright",
    "front_overturned": "front_upright",
}
CLIMB_SUMS = {
    "lost_energy": {"rubbed": 1.0, "damped": 1.0},
    "fold_rate": {"tilt_front_rate": 1.0, "tilt_rear_rate": -1.0},
}
TILTS_OF_BODIES = ("tilt_rear", "tilt_rear", "tilt_front")  # of rear, middle and front axle
ON_SOLIDS = ("gap", "load", "friction", "slip")  # quantities of climbs with the number of a solid
NO_CLEARANCE = 1.0  # version 0.1 stored this for a wheel without a second near point [m]
ROUNDING = 1e-6  # smaller violations of a limit count as rounding, in the unit of the limit

OUTCOMES = {  # outcome by name of the stop; limits and checks have other names
    "solver": Outcome.SOLVER_FAILURE,
    "interrupted": Outcome.INTERRUPTED,
    "no_equilibrium": Outcome.NO_EQUILIBRIUM,
    "fold": Outcome.NO_EQUILIBRIUM,
    "plan": Outcome.SOLVER_FAILURE,
    "plan_accuracy": Outcome.INACCURATE,
}
OUTCOMES_OF_PLANS = {  # outcome by status of IPOPT in the message of the stop
    "Infeasible_Problem_Detected": Outcome.INFEASIBLE,
    "User_Requested_Stop": Outcome.INTERRUPTED,
    "interrupted; go on": Outcome.INTERRUPTED,
}


def upgrade_0_1(attributes: Mapping[str, str | float]) -> dict[str, str | float]:
    """Return the attributes of a result of version 0.1 in the current format.

    The outcome follows from the name and the message of the stop. The description of a climb moves
    from ``outcome`` to ``climb``. The attributes ``verb``, ``model``, ``law``, ``formulation`` and
    ``solved_by`` follow from the problem file, ``plan_violations`` from the statistics.
    """
    found = dict(attributes)
    if OUTCOME in found:
        found["climb"] = found[OUTCOME]
    found[OUTCOME] = _outcome(found).name.lower()
    if violated := _violations(found):
        found["plan_violations"] = violated
    return {**_problem_attributes(found), **found}


def sums_0_1(labels: Mapping[str, Label]) -> dict[str, dict[str, float]]:
    """Return the stored quantities of a result of version 0.1 that make up the current ones.

    A current quantity is a sum of stored quantities with factors. Quantities of
    climbs have new names, since climbs are now computed by the dynamic model.
    """
    if not _is_climb(labels):
        return {name: {name: 1.0} for name in labels}
    found = dict[str, dict[str, float]]()
    for name in labels:
        kind, _, number = name.rpartition("_")
        if kind in ON_SOLIDS and number.isdigit():
            found[f"solid_{kind}_{int(number) + 1}"] = {name: 1.0}
        else:
            found[CLIMBS.get(name, name)] = {name: 1.0}
    return found | CLIMB_SUMS


def upgrade_column_0_1(
    column: Column, names: Collection[str], stored: Callable[[str], Array]
) -> Column:
    """Return a quantity of a result of version 0.1 with its current values.

    Clearances of 1 m or more become infinite: in version 0.1 they meant that no second point of the
    ground is near. Wheel angles of climbs become relative to the bodies that carry the axles, which
    turn nose up while wheels turn forward.

    Parameters
    ----------
    column : Column
        The quantity, with its current name.
    names : collection of str
        Names of all stored quantities.
    stored : callable
        Function that returns the values of a stored quantity.
    """
    label, values = column
    if label.name == "clearance":
        return Column(label, np.where(values >= NO_CLEARANCE, np.inf, values))
    if label.name == "wheel_angle" and _is_climb(names):
        tilts = np.stack([stored(name) for name in TILTS_OF_BODIES], axis=-1)
        return Column(label, values + tilts - tilts[0])
    return column


def _is_climb(names: Collection[str]) -> bool:
    """Return whether the quantities of a result of version 0.1 are those of a climb."""
    return "axle_x" in names


def _problem_attributes(attributes: Mapping[str, str | float]) -> dict[str, str]:
    """Return verb, model, law, formulation and method of a motion from its problem file.

    The result is empty if the attributes contain no readable problem file.
    """
    try:
        data = load_toml(str(attributes["problem"]))
        replace_values(data, str(attributes.get("settings", "")).splitlines())
    except (KeyError, ValueError):  # no problem, or a damaged one
        return {}
    verb, slip = str(data.get("verb")), str(data.get("slip", "least"))
    found = {"verb": verb}
    if verb in ("direct", "plan"):
        is_traction = slip == "traction"
        found["model"] = "quasi-static" if is_traction else "kinematics"
        found["law"] = "coulomb" if is_traction else slip
    if verb == "direct":
        found["formulation"] = str(data.get("formulation", "closure"))
    if verb == "inverse":
        is_collocated = "path" in data and data.get("steering", "angle") == "angle"
        found["solved_by"] = "collocation" if is_collocated else "integration"
    return found


def _outcome(attributes: Mapping[str, str | float]) -> Outcome:
    """Return the outcome of a motion from the name and the message of its stop."""
    name, _, words = (str(attributes.get(key, "")) for key in STOP)
    if not name:
        return Outcome.COMPLETE
    if name in ("plan", "plan_accuracy"):
        for status, outcome in OUTCOMES_OF_PLANS.items():
            if status in words:
                return outcome
    if name.endswith("_residual"):
        return Outcome.SOLVER_FAILURE
    return OUTCOMES.get(name, Outcome.LIMIT)


def _violations(attributes: Mapping[str, str | float]) -> str:
    """Return the violations of a plan's limits in words; version 0.1 stored them without units."""
    prefix = f"{STATISTICS}plan_violation_"
    return ", ".join(
        f"{name.removeprefix(prefix)} by {size:.1e}"
        for name, size in attributes.items()
        if name.startswith(prefix) and not isinstance(size, str) and size > ROUNDING
    )
