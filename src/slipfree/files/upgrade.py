"""Upgrade the attributes and quantities of result files of version 0.1."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping

import numpy as np

from slipfree.files.toml.errors import ProblemError
from slipfree.files.toml.settings import replace_values
from slipfree.outcome import Outcome
from slipfree.trajectory import OUTCOME, STATISTICS, STOP, Column

NO_PLACE = 1.0  # least clearance that meant that the ground comes near at no second place [m]
ROUNDING = 1e-6  # of a limit that a plan meets, in its unit

OUTCOMES = {  # of the names of stops; limits and checks have their own
    "solver": Outcome.SOLVER_FAILURE,
    "interrupted": Outcome.INTERRUPTED,
    "no_equilibrium": Outcome.NO_EQUILIBRIUM,
    "fold": Outcome.NO_EQUILIBRIUM,
    "plan": Outcome.SOLVER_FAILURE,
    "plan_accuracy": Outcome.INACCURATE,
}
OUTCOMES_OF_PLANS = {  # of IPOPT's statuses in the words of the stop
    "Infeasible_Problem_Detected": Outcome.INFEASIBLE,
    "User_Requested_Stop": Outcome.INTERRUPTED,
    "interrupted; go on": Outcome.INTERRUPTED,
}


def upgrade_0_1(attributes: Mapping[str, str | float]) -> dict[str, str | float]:
    """Return the attributes of a result of version 0.1 under the keys of today.

    The outcome follows from the name of the stop; the ending of a climb, which was stored as
    ``outcome``, becomes ``climb``; verb, model, law and method follow from the problem file.
    """
    found = dict(attributes)
    if OUTCOME in found:
        found["climb"] = found[OUTCOME]
    found[OUTCOME] = _outcome(found).name.lower()
    if violated := _violations(found):
        found["plan_violations"] = violated
    return {**_question(found), **found}


def upgrade_column_0_1(column: Column) -> Column:
    """Return a quantity of a result of version 0.1, which stored 1 m for no second place."""
    label, values = column
    if label.name != "clearance":
        return column
    return Column(label, np.where(values >= NO_PLACE, np.inf, values))


def _question(attributes: Mapping[str, str | float]) -> dict[str, str]:
    """Return verb, model, law and method of a motion from its problem file, if it holds one."""
    try:
        data = tomllib.loads(str(attributes["problem"]))
        replace_values(data, str(attributes.get("settings", "")).splitlines())
    except (KeyError, tomllib.TOMLDecodeError, ProblemError):  # of a library, or a damaged file
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
    """Return the outcome of a motion from the name and the words of its stop."""
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
    """Return the violations of a plan, which version 0.1 stored without units."""
    prefix = f"{STATISTICS}plan_violation_"
    return ", ".join(
        f"{name.removeprefix(prefix)} by {size:.1e}"
        for name, size in attributes.items()
        if name.startswith(prefix) and not isinstance(size, str) and size > ROUNDING
    )
