"""Tests of slip laws and wheel-ground laws: their protocols and registry."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, is_dataclass
from inspect import getmodule

import casadi as ca
import pytest

from slipfree import Analytic, direct_kinematics, quasi_statics
from slipfree.catalog import three_wheeler
from slipfree.laws.protocols import GroundLaw, SlipLaw
from slipfree.laws.registry import GROUND_LAWS, SLIP_LAWS
from slipfree.models.kinematics import contact_labels
from slipfree.models.montana import montana_kinematics
from slipfree.records import leaves

VEHICLE = three_wheeler()
GROUND = Analytic(lambda x, y: 0.1 * ca.sin(x + y), mu=0.6)
LAWS = {**SLIP_LAWS, **GROUND_LAWS}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_a_frozen_record_in_a_file_of_its_own(name):
    law = LAWS[name]()
    assert is_dataclass(law)
    assert isinstance(law, SlipLaw) == (name in SLIP_LAWS)
    assert isinstance(law, GroundLaw) == (name in GROUND_LAWS)
    for field in fields(law):
        with pytest.raises(FrozenInstanceError):
            setattr(law, field.name, 1.0)
    assert law == LAWS[name]()
    module = getmodule(law)
    assert module.__name__.startswith("slipfree.laws.")
    assert sum(getmodule(other) is module for other in LAWS.values()) == 1


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
