"""Tests that random problems end regularly; ``benchmarks random_runs problems`` runs 500.

``python benchmarks random_runs problems --seed N`` prints a case in full and allows changes to it.
"""

import pytest

from helpers.random_cases import FAULTS, SOUND, draw, outcome

pytestmark = pytest.mark.slow

SEEDS = {
    "complete": (124, 158, 160, 168, 182, 187, 202, 229, 230, 249, 305, 308),
    "stopped": (36, 83, 131, 200, 257, 260, 281),
    "refused": (7, 30, 32, 52, 136, 147, 167, 208),
}
PLANTED = {name: 1000 + index for index, name in enumerate(FAULTS)}


@pytest.mark.parametrize(
    ("kind", "seed"), [(kind, seed) for kind, seeds in SEEDS.items() for seed in seeds]
)
def test_a_random_problem_ends_as_it_should(kind, seed, capfd):
    found = outcome(draw(seed))
    assert found.faults == []
    assert found.kind == kind, found.words
    assert "".join(capfd.readouterr()) == ""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_refused_in_words(fault):
    found = outcome(draw(PLANTED[fault], fault=fault, **SOUND))
    assert found.kind == "refused"
    assert found.faults == []


def test_a_case_is_that_of_its_seed():
    assert draw(7) == draw(7) != draw(8)
