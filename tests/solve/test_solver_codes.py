"""Tests that solver codes are printed with their meaning."""

import casadi as ca
import pytest

from slipfree.core.outcome import IPOPT_STATUSES, SUNDIALS_FLAGS, ipopt_words, sundials_words

CASADI = "casadi/interfaces/sundials/idas_interface.cpp:620: IDASolve returned "


def test_codes_are_printed_with_their_meaning() -> None:
    assert all((IPOPT_STATUSES | SUNDIALS_FLAGS).values())
    for flag, meaning in (
        ("IDA_ILL_INPUT", "an input of the integrator, such as an initial value, is invalid"),
        ("CV_CONV_FAILURE", "the equations of a step could not be solved"),
        ("IDA_UNHEARD_OF", "the integrator failed"),
    ):
        message = f'Error in Function::call\n{CASADI}"{flag}". Consult IDAS documentation.'
        assert sundials_words(message) == f"{meaning} ({flag})"
    assert sundials_words("a\ncasadi/core/function.cpp:12: it is wrong\n") == "it is wrong"
    assert ipopt_words("Restoration_Failed") == (
        "the search could not return to motions that meet the constraints "
        "(IPOPT: Restoration_Failed)"
    )
    assert ipopt_words("Unheard_Of") == "the search failed (IPOPT: Unheard_Of)"


def test_flags_that_casadi_raises_have_a_meaning() -> None:
    x = ca.SX.sym("x")
    for method in ("idas", "cvodes"):
        options = {"max_num_steps": 2, "disable_internal_warnings": True}
        f = ca.integrator("f", method, {"x": x, "ode": -x}, 0.0, [9.0], options)
        with pytest.raises(RuntimeError) as error:
            f(x0=1.0)
        words = sundials_words(str(error.value))
        assert words.startswith("too many steps between two samples ("), words
        assert words.endswith("_TOO_MUCH_WORK)")
