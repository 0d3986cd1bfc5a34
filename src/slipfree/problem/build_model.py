"""Model and law of a problem."""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from typing import TypeVar

from slipfree.dae import Dae
from slipfree.files.toml.errors import Fault, problem_error
from slipfree.laws.protocols import GroundLaw, SlipLaw
from slipfree.laws.registry import GROUND_LAWS, SLIP_LAWS
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.quasi_statics import quasi_statics
from slipfree.problem import schema
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, S
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

DEFAULT_LAW = "coulomb"
L = TypeVar("L")


def build_model(
    problem: Problem[S], spec: schema.Modelled, vehicle: Vehicle, terrain: Terrain
) -> Dae:
    """Return the model of a problem for a vehicle on a ground, with its law."""
    if spec.model == "kinematics":
        slip = slip_law(problem, spec)
        with at(problem, ("slip",)):
            return direct_kinematics(vehicle, terrain, slip=slip)
    law = ground_law(problem, spec)
    with at(problem, ("model",)):
        return quasi_statics(vehicle, terrain, law=law)


def slip_law(problem: Problem[S], spec: schema.Modelled) -> SlipLaw:
    """Return the slip law, with its parameters, of a problem with the kinematic model."""
    for name in spec.law.model_fields_set - {spec.slip}:
        expected = (
            "model = 'quasi-static', where this law applies"
            if name in GROUND_LAWS
            else f"slip = {name!r}, where this law applies"
        )
        found = f"model = 'kinematics', slip = {spec.slip!r}; change them, or remove the table"
        raise problem_error(problem.source, [Fault(("law", name), expected, found)])
    return _with_parameters(problem, spec, SLIP_LAWS[spec.slip])


def law_name(spec: schema.Modelled) -> str:
    """Return the name of the slip law or wheel-ground law of a problem."""
    if spec.model == "kinematics":
        return spec.slip
    return next(iter(sorted(spec.law.model_fields_set)), DEFAULT_LAW)


def ground_law(problem: Problem[S], spec: schema.Modelled) -> GroundLaw:
    """Return the wheel-ground law of a quasi-static problem; Coulomb's by default."""
    name = law_name(spec)
    if "slip" in spec.model_fields_set:
        expected = "no slip law with model = 'quasi-static', where forces determine the slip"
        found = f"{spec.slip!r}; remove the key"
        raise problem_error(problem.source, [Fault(("slip",), expected, found)])
    for other in spec.law.model_fields_set - ({name} & set(GROUND_LAWS)):
        expected = f"one wheel-ground law with model = 'quasi-static', of {', '.join(GROUND_LAWS)}"
        found = f"{', '.join(sorted(spec.law.model_fields_set))}; remove the other tables"
        raise problem_error(problem.source, [Fault(("law", other), expected, found)])
    return _with_parameters(problem, spec, GROUND_LAWS[name])


def _with_parameters(problem: Problem[S], spec: schema.Modelled, law: Callable[..., L]) -> L:
    """Return a law with the parameters that a problem gives; other parameters have defaults."""
    name = law_name(spec)
    given = spec.law.parameters(name)
    for key, parameter in signature(law).parameters.items():
        if parameter.default is parameter.empty and key not in given:
            raise problem_error(problem.source, [Fault(("law", name, key), "a value", "none")])
    with at(problem, ("law", name)):
        return law(**given)
