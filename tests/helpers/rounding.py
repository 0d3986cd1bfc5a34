"""Roots that tests compute on their own, and the tests that need results to rounding."""

from pathlib import Path
from types import CodeType, FunctionType

import numpy as np
from scipy.optimize import fsolve

SCIPY = {"brentq", "fsolve", "linprog", "minimize", "null_space", "quad", "solve_ivp"}
NUMPY = {"eigvalsh", "inv", "lstsq", "pinv", "solve", "svd"}  # of `np.linalg`
TESTS = str(Path(__file__).parents[1])
EPS = np.finfo(float).eps


def root(residual, start):
    """Return the root of n equations near a start and bounds of its rounding errors, shape (n,).

    Only some processors reach a relative tolerance that is below the rounding errors. So Newton's
    method ends where its corrections no longer become smaller. The bounds are the unit roundoff
    times ``|J^-1| |J| |x|`` (Higham, Accuracy and Stability of Numerical Algorithms, 7.2).
    """
    at, size = fsolve(residual, start), np.inf
    steps = np.sqrt(EPS) * np.diag(1 + np.abs(at))
    rows = [
        np.subtract(residual(at + step), residual(at - step)) / (2 * step.max()) for step in steps
    ]
    inverse = np.linalg.inv(np.transpose(rows))
    while (correction := np.abs(step := inverse @ residual(at)).max()) < size / 2:
        at, size = at - step, correction
    return at, EPS * np.abs(inverse) @ np.abs(np.transpose(rows)) @ np.abs(at)


def depends_on_rounding(test):
    """Return whether a test, or a function of the tests that it calls, solves or asks for 1e-11."""
    functions = [test]
    for function in functions:
        codes = [function.__code__]
        for code in codes:  # with the functions inside
            codes += [value for value in code.co_consts if isinstance(value, CodeType)]
        names = {name for code in codes for name in code.co_names}
        values = [value for code in codes for value in code.co_consts]
        values += [inner for value in values if isinstance(value, tuple) for inner in value]
        if names & SCIPY or ("linalg" in names and names & NUMPY):
            return True
        if any(isinstance(value, float) and 0 < value <= 1e-11 for value in values):
            return True
        called = [function.__globals__.get(name) for name in names]
        kinds = [value for value in called if isinstance(value, type)]
        called += [each for kind in kinds for each in vars(kind).values()]
        called = [getattr(value, "__wrapped__", value) for value in called]
        called = [value for value in called if isinstance(value, FunctionType)]
        own = [each for each in called if each.__code__.co_filename.startswith(TESTS)]
        functions += [each for each in own if each not in functions]
    return False
