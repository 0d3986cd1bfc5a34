"""Rates of the platform that an inverse model may be given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca

from slipfree.dae import Dae
from slipfree.rearrange import Variable, new_variable, variables
from slipfree.records import Label, leaves

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
EULER = ("heading_rate", "roll_rate", "pitch_rate")
OMEGA = ("omega_x", "omega_y", "omega_z")


class Derived(NamedTuple):
    """A rate of the platform that is no unknown of the direct model, in its symbols."""

    label: Label
    expression: ca.SX


class Imposed(NamedTuple):
    """The direct model's equations of motion under given rates of the platform.

    Attributes
    ----------
    inputs : tuple of Variable
        The given rates.
    rates : tuple of Variable
        Unknown rates of the direct model that are not given.
    rows : SX, shape (n, 1)
        The direct model's equations, and one for each given rate that is no unknown of it.
    labels : tuple of Label
        Their labels.
    """

    inputs: tuple[Variable, ...]
    rates: tuple[Variable, ...]
    rows: ca.SX
    labels: tuple[Label, ...]


def impose(direct: Dae, given: Sequence[str]) -> Imposed:
    """Return the equations of motion of a direct model under given rates of its platform."""
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
    """Return the rates of the platform that are no unknowns of a direct model, by name."""
    rates = direct.z.rates
    euler = ca.vertcat(rates.heading, rates.roll, rates.pitch)
    turning = omega(direct.x.heading, direct.z.position.roll) @ euler
    return {
        name: Derived(
            Label(name, "rad s-1", f"angular velocity of the platform about {name[-1]}"), turning[k]
        )
        for k, name in enumerate(OMEGA)
    }


def omega(heading: ca.SX, roll: ca.SX) -> ca.SX:
    """Return the matrix from ``heading', roll', pitch'`` to the angular velocity in fixed axes.

    Chakraborty and Ghosal, eq. 4; shape (3, 3).
    """
    return ca.vertcat(
        ca.horzcat(0, -ca.sin(heading), ca.cos(roll) * ca.cos(heading)),
        ca.horzcat(0, ca.cos(heading), ca.cos(roll) * ca.sin(heading)),
        ca.horzcat(1, 0, -ca.sin(roll)),
    )
