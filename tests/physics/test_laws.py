"""Tests of slip laws and wheel-ground laws: their protocols and registry."""

from __future__ import annotations

import casadi as ca
import pytest

from slipfree import Analytic, direct_kinematics, quasi_statics
from slipfree.catalog import three_wheeler
from slipfree.core.records import leaves
from slipfree.laws.registry import GROUND_LAWS, SLIP_LAWS
from slipfree.models.kinematics import contact_labels
from slipfree.models.montana import montana_kinematics

VEHICLE = three_wheeler()
GROUND = Analytic(lambda x, y: 0.1 * ca.sin(x + y), mu=0.6)
LAWS = {**SLIP_LAWS, **GROUND_LAWS}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_has_a_label_for_every_equation_and_unknown(name):
    law = LAWS[name]()
    if name in GROUND_LAWS:
        models = [quasi_statics(VEHICLE, GROUND, law=law)]
    else:
        models = [of(VEHICLE, GROUND, slip=law) for of in (direct_kinematics, montana_kinematics)]
    for dae in models:
        rates, labels = dae.labels.z.rates, dae.labels.alg[-2]
        given = (VEHICLE,) if name in GROUND_LAWS else (VEHICLE, contact_labels(VEHICLE))
        assert list(leaves(rates.law)) == list(leaves(law.unknowns(*given)))
        assert len(labels) == len(list(leaves(rates))) == dae.alg[-2].numel()
        assert all(label.words and label.name for label in labels)
