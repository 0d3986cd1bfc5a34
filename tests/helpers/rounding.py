"""Roots that tests compute on their own, and the tests that need results to rounding."""

import inspect
import re
from functools import cache
from types import FunctionType

import numpy as np
from scipy.optimize import fsolve

SENSITIVE = re.compile(
    r"\de-1[1-9]\b|\b(brentq|fsolve|linprog|minimize|null_space|quad|solve_ivp)\("
    r"|linalg\.(eigvalsh|inv|lstsq|pinv|solve|svd)\("
)
SOURCE = cache(inspect.getsource)
EPS = np.finfo(float).eps


def root(residual, start):
    """Return the root of n equations near a start and bounds of its rounding errors, shape (n,).

    Only some processors reach a relative tolerance that is below the rounding errors. So Newton's
    method ends where its corrections no longer become smaller. The bounds are the unit roundoff
    times ``|J^-1| |J| |x|`` (Higham, Accuracy and Stability of Numerical Algorithms, 7.2).
    """
    at, size = fsolve(residual, start), np.inf
    steps = np.sqrt(EPS) * np.diag(1 + np.abs(at))
    changes = [np.subtract(residual(at + step), residual(at - step)) for step in steps]
    jacobian = np.transpose(changes) / (2 * np.diag(steps))
    inverse = np.linalg.inv(jacobian)
    while (correction := np.abs(step := inverse @ residual(at)).max()) < size / 2:
        at, size = at - step, correction
    return at, EPS * np.abs(inverse) @ np.abs(jacobian) @ np.abs(at)


def depends_on_rounding(test):
    """Return whether a test, or what it calls of the tests, solves by itself or names 1e-11."""
    found = [test]
    for each in found:
        text, names = SOURCE(each), vars(inspect.getmodule(each))
        if SENSITIVE.search(text):
            return True
        called = [inspect.unwrap(names[n]) for n in names.keys() & set(re.findall(r"\w+", text))]
        called = [value for value in called if isinstance(value, FunctionType | type)]
        own = [value for value in called if value.__module__.startswith(("helpers.", "test_"))]
        found += [value for value in own if value not in found]
    return False
