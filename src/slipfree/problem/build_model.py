"""Model and law of a problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any, Protocol, TypeVar

from slipfree.core.dae import Dae
from slipfree.files.toml.source import Fault, problem_error
from slipfree.laws.registry import CONTACT_LAWS, GROUND_LAWS, SLIP_LAWS
from slipfree.models.dynamics import dynamics
from slipfree.models.kinematics import check_driven, direct_kinematics
from slipfree.models.quasi_statics import quasi_statics
from slipfree.problem import schema
from slipfree.problem.build_common import in_frame
from slipfree.problem.build_ground import at
from slipfree.problem.problem import A, Problem, S
from slipfree.problem.soil_table import soil_of
from slipfree.terrain.base import Terrain
from slipfree.terrain.solids import Prism, Solids
from slipfree.vehicle.tree import Vehicle

L = TypeVar("L")
LAWS: dict[str, Mapping[str, Callable[..., Any]]] = {
    "kinematics": SLIP_LAWS,
    "quasi-static": GROUND_LAWS,
    "dynamics": CONTACT_LAWS,
}  # laws of each model; the first is the default
MAKERS = {"soil": soil_of}  # functions that make a law from a table with further keys


class Lawful(Protocol):
    """Problem with a choice of model and law."""

    @property
    def model(self) -> str:
        """Name of the model."""

    @property
    def slip(self) -> str:
        """Name of the slip law."""

    @property
    def law(self) -> schema.Law:
        """Parameters of laws."""

    @property
    def model_fields_set(self) -> set[str]:
        """Names of the keys that the problem gives."""


def build_model(
    problem: Problem[S],
    spec: schema.Modelled,
    vehicle: Vehicle,
    terrain: Terrain,
    prisms: tuple[Prism, ...] = (),
) -> Dae:
    """Return the model of a problem for a vehicle on a ground; ``prisms`` are for dynamics.

    Raises
    ------
    ProblemError
        If the law does not belong to the model, a parameter is missing, or the model does not
        support the vehicle or the ground.
    """
    law = model_law(problem, spec)
    if spec.model == "kinematics":
        with at(problem, ("vehicle",)):
            check_driven(vehicle)
    with at(problem, ("slip",) if spec.model == "kinematics" else ("model",)):
        if spec.model == "kinematics":
            return in_frame(problem, direct_kinematics(vehicle, terrain, slip=law))
        if spec.model == "quasi-static":
            return in_frame(problem, quasi_statics(vehicle, terrain, law=law))
        ground = Solids(terrain, prisms) if prisms else terrain
        return in_frame(problem, dynamics(vehicle, ground, law=law))


def law_name(spec: Lawful) -> str:
    """Return the name of the law of a problem's model: the given one, or the default."""
    if spec.model == "kinematics":
        return spec.slip
    return next(iter(sorted(spec.law.model_fields_set)), next(iter(LAWS[spec.model])))


def model_law(problem: Problem[A], spec: Lawful) -> Any:
    """Return the law of a problem's model: a slip law, a wheel-ground law or a contact law.

    Raises
    ------
    ProblemError
        If a given law or the key ``slip`` does not belong to the model, several laws are given, or
        a parameter is missing or invalid.
    """
    name, known = law_name(spec), LAWS[spec.model]
    if spec.model != "kinematics" and "slip" in spec.model_fields_set:
        expected = f"no slip law with model = {spec.model!r}, where forces determine the slip"
        raise problem_error(
            problem.source, [Fault(("slip",), expected, f"{spec.slip!r}; remove the key")]
        )
    for other in spec.law.model_fields_set - ({name} & set(known)):
        raise problem_error(problem.source, [_wrong_law(spec, other)])
    return _with_parameters(problem, spec, MAKERS.get(name, known[name]))


def _wrong_law(spec: Lawful, name: str) -> Fault:
    """Return the error for the table of a law that does not apply."""
    if name in LAWS[spec.model]:
        tables = ", ".join(sorted(spec.law.model_fields_set))
        if spec.model == "kinematics":
            found = f"slip = {spec.slip!r}; set slip = {name!r}, or remove the table"
            return Fault(("law", name), f"slip = {name!r}, where this law applies", found)
        words = f"one law with model = {spec.model!r}, of {', '.join(LAWS[spec.model])}"
        return Fault(("law", name), words, f"{tables}; keep one of these tables")
    model = next(each for each, laws in LAWS.items() if name in laws)
    expected = f"model = {model!r}, where this law applies"
    return Fault(
        ("law", name), expected, f"model = {spec.model!r}; set it to {model!r}, or remove the table"
    )


def _with_parameters(problem: Problem[A], spec: Lawful, law: Callable[..., L]) -> L:
    """Return a law with the parameters that a problem gives, and defaults of all others.

    Raises
    ------
    ProblemError
        If a parameter without default is missing, or a value is invalid.
    """
    name = law_name(spec)
    given = spec.law.parameters(name)
    for key, parameter in signature(law).parameters.items():
        needed = (
            parameter.kind is not parameter.VAR_KEYWORD and parameter.default is parameter.empty
        )
        if needed and key not in given:
            raise problem_error(problem.source, [Fault(("law", name, key), "a value", "none")])
    with at(problem, ("law", name)):
        return law(**given)
