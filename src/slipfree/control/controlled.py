"""Models with a controller: laws replace inputs, and its states become states of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Labels, Limit
from slipfree.core.errors import ModelError
from slipfree.core.records import leaves, pack, unpack


@dataclass(frozen=True, eq=False)
class Controller:
    """Controller of a model, as expressions of symbols of the model and of the controller.

    States, inputs, outputs and their labels are records; ``rates`` are those of the states,
    ``laws`` the values of the model's inputs in their order.
    """

    x: Any
    u: Any
    rates: tuple[ca.SX, ...]
    laws: tuple[ca.SX, ...]
    y: Any
    labels_x: Any
    labels_u: Any
    labels_y: Any


class WithController(NamedTuple):
    """Variables of a model, and those of its controller."""

    model: Any
    controller: Any


def controlled(model: Dae, controller: Controller, *, sampled: bool = False) -> Dae:
    """Return a model with a controller: states, inputs and outputs of the model, then its own.

    With ``sampled`` the inputs of the model remain inputs, which
    `slipfree.solve.zero_order_hold.simulate_sampled` sets to the values of the laws. ModelError is
    raised if the number of laws is not the number of inputs, or the model has numeric checks.
    """
    inputs = pack(model.u)
    if len(controller.laws) != inputs.numel():
        raise ModelError(
            f"controlled: expected {inputs.numel()} laws, one per input of the model, found "
            f"{len(controller.laws)}; give one for each input"
        )
    if model.checks:
        raise ModelError(
            "controlled: expected a model without numeric checks at the samples, found "
            f"{len(model.checks)}; use a plane ground"
        )

    def driven(expressions: Sequence[ca.SX]) -> list[ca.SX]:
        if sampled:
            return list(expressions)
        laws = ca.vertcat(ca.SX(0, 1), *controller.laws)
        return list(ca.substitute([ca.SX(each) for each in expressions], [inputs], [laws]))

    y = unpack(model.y, driven([*leaves(model.y)]))
    pairs = zip(model.limits, driven([each.expression for each in model.limits]), strict=True)
    limits: tuple[Limit, ...] = tuple(limit._replace(expression=each) for limit, each in pairs)
    rates = ca.vertcat(ca.SX(0, 1), *controller.rates)
    labels, own, standing = model.labels, np.zeros(rates.numel()), model.standing
    if standing is not None:  # the controller starts with states of zero
        standing = standing._replace(x=ca.vertcat(standing.x, ca.SX.zeros(rates.shape)))
    held = model.held
    if held is not None:
        held = held._replace(ode=ca.vertcat(*driven([held.ode]), rates))
    return replace(
        model,
        x=WithController(model.x, controller.x),
        u=WithController(model.u if sampled else (), controller.u),
        ode=ca.vertcat(*driven([model.ode]), rates),
        alg=tuple(driven(model.alg)),
        quad=driven([model.quad])[0],
        y=WithController(y, controller.y),
        labels=Labels(
            WithController(labels.x, controller.labels_x),
            labels.z,
            labels.q,
            WithController(labels.u if sampled else (), controller.labels_u),
            WithController(labels.y, controller.labels_y),
            labels.alg,
        ),
        limits=limits,
        pace=driven([model.pace])[0],
        shift=(np.concatenate([model.shift[0], own]), model.shift[1]),
        standing=standing,
        held=held,
    )
