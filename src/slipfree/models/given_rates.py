"""Given rates of the platform in inverse models, and the equations that impose them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.rearrange import ModelVariable, new_variable, variables
from slipfree.core.records import Label, leaves, pack
from slipfree.laws.least_slip import slip_unit
from slipfree.vehicle.tree import Vehicle

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
EULER = ("heading_rate", "roll_rate", "pitch_rate")
OMEGA = ("omega_x", "omega_y", "omega_z")
PLANAR = ("velocity_x", "velocity_y", "heading_rate")
COMMANDS = {
    "forward": Label("forward", "m s-1", "velocity of the platform's centre along its heading"),
    "right": Label("right", "m s-1", "velocity of the platform's centre across its heading"),
    "yaw_rate": Label("yaw_rate", "rad s-1", "rate of the heading, counter-clockwise"),
}


class Derived(NamedTuple):
    """Platform rate that is an expression of the direct model's states and unknowns."""

    label: Label
    expression: ca.SX


class Imposed(NamedTuple):
    """Equations of a direct model in which given rates of the platform are inputs.

    Attributes
    ----------
    inputs : tuple of ModelVariable
        The given rates.
    rates : tuple of ModelVariable
        Unknown rates of the direct model that are not given.
    rows : SX, shape (n, 1)
        Equations of the direct model, and one for each given rate that is not among its unknowns.
    labels : tuple of Label
        Labels of the equations.
    """

    inputs: tuple[ModelVariable, ...]
    rates: tuple[ModelVariable, ...]
    rows: ca.SX
    labels: tuple[Label, ...]


def impose(direct: Dae, given: Sequence[str]) -> Imposed:
    """Return the equations of a direct model in which given rates of its platform are inputs."""
    rates = {each.label.full: each for each in leaves(variables(direct)[1].rates)}
    derived = derived_rates(direct)
    inputs, rows, labels = [], [direct.alg[1]], [*direct.labels.alg[1]]
    for name in given:
        if name in rates:
            inputs.append(rates.pop(name))
            continue
        label, expression = derived[name]
        inputs.append(new_variable(direct, label))
        rows.append(expression - inputs[-1].symbol)
        labels.append(replace(label, name=f"{name}_law"))
    return Imposed(tuple(inputs), tuple(rates.values()), ca.vertcat(*rows), tuple(labels))


def derived_rates(direct: Dae) -> dict[str, Derived]:
    """Return platform rates as expressions of a direct model's states and unknowns, by name.

    These are the components of the angular velocity in map axes, the velocity along and across the
    heading, and the yaw rate.
    """
    rates, c, s = direct.z.rates, ca.cos(direct.x.heading), ca.sin(direct.x.heading)
    euler = ca.vertcat(rates.heading, rates.roll, rates.pitch)
    turning = omega(direct.x.heading, direct.named("roll")[0]) @ euler
    words = "angular velocity of the platform about"
    labels = {name: Label(name, "rad s-1", f"{words} {name[-1]}") for name in OMEGA}
    planar = [c * rates.y - s * rates.x, c * rates.x + s * rates.y, rates.heading]
    both = zip((labels | COMMANDS).items(), (*ca.vertsplit(turning), *planar), strict=True)
    return {name: Derived(label, expression) for (name, label), expression in both}


def omega(heading: ca.SX, roll: ca.SX) -> ca.SX:
    """Return the matrix that maps Euler rates to the angular velocity in map axes, shape (3, 3).

    The Euler rates are ``heading', roll', pitch'``; see Chakraborty and Ghosal, eq. 4.
    """
    return ca.vertcat(
        ca.horzcat(0, -ca.sin(heading), ca.cos(roll) * ca.cos(heading)),
        ca.horzcat(0, ca.cos(heading), ca.cos(roll) * ca.sin(heading)),
        ca.horzcat(1, 0, -ca.sin(roll)),
    )


class Minimum(NamedTuple):
    """Conditions for a minimum under constraints.

    Attributes
    ----------
    unknowns : tuple of ModelVariable
        Optimisation variables and multipliers of the constraints.
    rows : SX, shape (n, 1)
        The conditions, one for each unknown.
    labels : tuple of Label
        Labels of the conditions.
    """

    unknowns: tuple[ModelVariable, ...]
    rows: ca.SX
    labels: tuple[Label, ...]


def minimum(
    direct: Dae,
    goal: ca.SX,
    constraints: ca.SX,
    unknowns: Sequence[ModelVariable],
    multipliers: Sequence[Label],
    label: Label,
) -> Minimum:
    """Return the conditions for the minimum of an objective under equality constraints.

    Parameters
    ----------
    direct : Dae
        Model that contains the symbols.
    goal : SX, shape (1, 1)
        The objective, such as the squared slip. [m2/s2]
    constraints : SX, shape (n, 1)
        Expressions that vanish at the minimum.
    unknowns : sequence of ModelVariable
        Optimisation variables.
    multipliers : sequence of n Label
        Labels of the multipliers of the constraints.
    label : Label
        Name of the conditions, and the beginning of their descriptions.
    """
    new = tuple(new_variable(direct, each) for each in multipliers)
    found = (*unknowns, *new)
    prices, column = (pack(tuple(each.symbol for each in part)) for part in (new, found))
    labels = tuple(
        replace(
            label,
            unit=slip_unit(each.label.unit),
            words=f"{label.words} with respect to {each.label.full}",
        )
        for each in found
    )
    return Minimum(found, ca.gradient(goal + ca.dot(prices, constraints), column), labels)


def check_rates(given: Sequence[str]) -> None:
    """Raise ModelError unless the given rates are three different known rates of the platform.

    Components of the angular velocity and Euler rates must not be mixed.
    """
    known = (*VELOCITY, *OMEGA, *EULER)
    if isinstance(given, str) or len(given) != 3 or len(set(given)) != 3:
        remedy = "give three rates"
        if isinstance(given, str):
            remedy = "give a list of names"
        elif len(set(given)) != len(given):
            remedy = "give each name once"
        raise ModelError(
            f"given: expected a list of three different names from {', '.join(known)}, or of one "
            f"or more names from {', '.join(COMMANDS)}, found {given!r}; {remedy}"
        )
    for name in given:
        if name not in known:
            raise ModelError(
                f"given: expected three of {', '.join(known)}, found {name!r}; correct the name"
            )
    if set(given) & set(OMEGA) and set(given) & set(EULER):
        raise ModelError(
            f"given: expected components of the angular velocity ({', '.join(OMEGA)}) or Euler "
            f"rates ({', '.join(EULER)}), not both, found {', '.join(given)}; replace those of one "
            "kind by the other kind"
        )


def check_commands(vehicle: Vehicle, given: tuple[str, ...], *, exact: bool = True) -> None:
    """Raise ModelError if a vehicle cannot follow the given commands.

    Commands must be known, different and, if ``exact``, no more than the driven wheels. ``right``
    must be among them if all driven wheels have rollers.
    """
    for name in given:
        if name not in COMMANDS:
            raise ModelError(
                f"given: expected only names from {', '.join(COMMANDS)}, found {name!r}; correct "
                "or remove the name"
            )
    if not given or len(set(given)) != len(given):
        raise ModelError(
            f"given: expected one or more different rates, found {', '.join(given) or 'none'}; "
            f"give one or more of {', '.join(COMMANDS)}, each once"
        )
    driven = [wheel for wheel in vehicle.wheels if wheel.driven]
    if not driven and (exact or "right" not in given):
        raise ModelError(
            f"{vehicle.name!r}: expected at least one driven wheel to impose the given rates, "
            "found none; set 'driven' of its wheels"
        )
    if "right" not in given and all(wheel.rollers for wheel in driven):
        raise ModelError(
            f"{vehicle.name!r}: expected the given rate 'right', since all driven wheels have "
            f"rollers and the vehicle can move sideways, found only {', '.join(given)}; add "
            "'right' with the value 0 to drive straight"
        )
    if exact and len(given) > len(driven):
        raise ModelError(
            f"{vehicle.name!r}: expected no more given rates than driven wheels ({len(driven)}), "
            f"found {len(given)}: {', '.join(given)}; remove "
            f"'{'right' if 'right' in given else given[-1]}', or set exact = false for the nearest "
            "motion"
        )
