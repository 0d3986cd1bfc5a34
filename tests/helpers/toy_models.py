"""Models of a few states, and planning problems for them."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Labels, Limit
from slipfree.core.records import Label, symbols
from slipfree.plan.transcription import PlanTask


def model(rate, limits=()):
    """One state under one input, with the integral of the state."""
    names = [("sum", "m s", "integral of x"), ("push", "m s-1", "push"), ("twice", "m", "twice x")]
    labels = Labels((Label("x", "m", "place"),), (), *((Label(*each),) for each in names), ())
    x, q, u, t = symbols(labels.x), symbols(labels.q), symbols(labels.u), ca.SX.sym("t")
    bounds = tuple(Limit(Label("bound", "m", "x is out of bounds"), x[0], *each) for each in limits)
    rest, shift, y = (ca.SX(0, 1), np.zeros(0)), (np.zeros(1), np.zeros(0)), (2 * x[0],)
    ode = rate(t, x[0], u[0])
    return Dae(t, x, (), q, u, ode, (), ca.SX(x[0]), y, labels, bounds, (), *rest, shift)


class Values(NamedTuple):
    values: tuple[Any, ...]


class Nothing(NamedTuple):
    pass


def toy(count, ode):
    """A model of states ``x``, an unknown ``z = x0^2`` and one input."""
    x_labels = Values(tuple(Label(f"x{k}", "m", f"state {k}") for k in range(count)))
    z_labels, u_labels = (Values((Label(name, "m", name),)) for name in ("square", "drive"))
    labels = Labels(
        x_labels, z_labels, Nothing(), u_labels, Nothing(), ((Label("law", "m", "law"),),)
    )
    x, z, u, t = symbols(x_labels), symbols(z_labels), symbols(u_labels), ca.SX.sym("t")
    rates = ca.vertcat(*ode(t, x.values, z.values[0], u.values[0]))
    law, none, quad = (z.values[0] - x.values[0] ** 2,), Nothing(), ca.SX(0, 1)
    numbers = ca.SX(0), np.ones(1), (np.zeros(count), np.zeros(1))  # guess, scale, shift
    return Dae(t, x, z, none, u, rates, law, quad, none, labels, (), (), *numbers)


FREE = (-np.inf, np.inf)


def task(dae, start, *, duration=1.0, inputs=FREE, rates=FREE, places=(), **given):
    """Planning problem of a toy; further keywords are fields of `PlanTask`."""
    span = (duration, duration) if isinstance(duration, float) else duration
    ranges = {"inputs": np.array([inputs]), "accelerations": np.array([rates])}
    lists = {name: tuple(given.pop(name, ())) for name in ("costs", "limits")}
    given = {"smooth": 0.0, "conditions": tuple(places)} | ranges | lists | given
    return PlanTask(dae, np.array(start), span, **given)
