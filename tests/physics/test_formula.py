"""Tests of joint formulas: allowed contents, and the errors of refused formulas."""

import math

import casadi as ca
import pytest

from slipfree import ModelError
from slipfree.vehicle.formula import evaluate, names_in

A, B = 0.3, -1.2
MEANT = {
    "-a": -A,
    "2*a + b/4 - 1e-1": 2 * A + B / 4 - 0.1,
    "atan2(0.7*tan(a), 0.7 + 0.3*tan(a))": math.atan2(0.7 * math.tan(A), 0.7 + 0.3 * math.tan(A)),
    "sqrt(a**2 + b**2) * cos(pi)": -math.hypot(A, B),
    "asin(a) + acos(a) + atan(b)": math.pi / 2 + math.atan(B),
    "abs(b) + exp(a) + log(a) - sin(b)": abs(B) + math.exp(A) + math.log(A) - math.sin(B),
    "2**3**2 + +a": 512 + A,
    "  (a)\n": A,
    "0": 0.0,
}


def test_a_formula_means_what_it_says():
    for text, expected in MEANT.items():
        found = evaluate(text, {"a": ca.SX(A), "b": ca.SX(B)})
        assert float(ca.evalf(found)) == pytest.approx(expected, rel=1e-15), text


def test_a_formula_tells_what_it_depends_on():
    assert names_in("atan2(tan(a), pi) - 2*steer_b") == {"a", "steer_b"}
    assert names_in("0") == set()


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "found ''"),
        ("a.real", "found 'a.real'"),
        ("__import__('os')", "found \"__import__('os')\""),
        ("sin(a, b)", "found 'sin(a, b)'"),
        ("a if b else 0", "found 'a if b else 0'"),
        ("'a'", "found \"'a'\""),
        ("1j*a", "found '1j'"),
        ("(" * 300 + "a" + ")" * 300, "found '(((("),
        ("a\0", "found 'a"),
        ("9" * 400, "found '9999"),
    ],
)
def test_anything_else_is_refused(text, found):
    with pytest.raises(ModelError) as caught:
        names_in(text)
    assert "expected numbers up to 1e+300, coordinates, + - * / **, pi and sin" in str(caught.value)
    assert found in str(caught.value)


def test_long_and_deep_formulas_are_refused():
    with pytest.raises(ModelError, match="expected at most 1000 characters, found 5001"):
        names_in("-" * 5000 + "a")
    with pytest.raises(ModelError, match="expected at most 50 nested levels, found more"):
        names_in("-" * 900 + "a")


def test_unknown_names_are_listed_with_those_that_are_known():
    with pytest.raises(
        ModelError, match=r"formula '2\*stear': expected one of the names steer, found 'stear'"
    ):
        evaluate("2*stear", {"steer": ca.SX(0)})
