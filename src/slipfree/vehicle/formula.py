"""Formulas: the value of a joint as an expression of coordinates, written as text."""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import casadi as ca

from slipfree.errors import ModelError

FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "sin": (1, ca.sin),
    "cos": (1, ca.cos),
    "tan": (1, ca.tan),
    "asin": (1, ca.asin),
    "acos": (1, ca.acos),
    "atan": (1, ca.atan),
    "atan2": (2, ca.atan2),
    "sqrt": (1, ca.sqrt),
    "exp": (1, ca.exp),
    "log": (1, ca.log),
    "abs": (1, ca.fabs),
}
CONSTANTS = {"pi": math.pi}
LARGEST = 1e300  # number that a formula may hold
OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
    ast.UAdd: lambda a: a,
    ast.USub: lambda a: -a,
}
LONGEST = 1000  # characters of a formula
DEEPEST = 50  # nesting of a formula


def evaluate(text: str, values: Mapping[str, ca.SX]) -> ca.SX:
    """Return the value of a formula.

    Parameters
    ----------
    text : str
        Numbers, names, ``+ - * / **``, parentheses, ``pi`` and the functions ``sin cos tan asin
        acos atan atan2 sqrt exp log abs``. Angles in radians.
    values : mapping of str to SX
        What the names stand for. [rad or m]

    Raises
    ------
    ModelError
        If the text is no such formula, or a name is unknown.
    """
    return ca.SX(_value(_parsed(text), text, values, DEEPEST))


@cache
def names_in(text: str) -> frozenset[str]:
    """Return the names that a formula depends on; ModelError if it is none."""
    tree = _parsed(text)
    found = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    names = frozenset(found - set(CONSTANTS) - set(FUNCTIONS))
    _value(tree, text, {name: ca.SX.sym(name) for name in names}, DEEPEST)
    return names


def _parsed(text: str) -> ast.expr:
    try:
        if len(text) <= LONGEST:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of what is refused anyway, such as '\\d' or 1if
                return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        pass
    raise _refused(text, text[:60])


def _value(node: ast.expr, text: str, values: Mapping[str, ca.SX], depth: int) -> Any:
    """Return the value of a node of a formula, nested no deeper than given."""
    if depth == 0:
        raise _refused(text, f"parts nested {DEEPEST} deep")
    match node:
        case ast.Constant(value=int() | float() as number) if _is_number(number):
            return float(number)
        case ast.Name(id=name) if name in values:
            return values[name]
        case ast.Name(id=name) if name in CONSTANTS:
            return CONSTANTS[name]
        case ast.Name(id=name) if name not in FUNCTIONS:
            raise ModelError(
                f"formula {text!r}: {name!r} is not known; known: {', '.join(sorted(values))}"
            )
        case ast.UnaryOp(op=op, operand=only) if type(op) in OPERATORS:
            return OPERATORS[type(op)](_value(only, text, values, depth - 1))
        case ast.BinOp(op=op, left=left, right=right) if type(op) in OPERATORS:
            pair = (_value(each, text, values, depth - 1) for each in (left, right))
            return OPERATORS[type(op)](*map(ca.SX, pair))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
            count, function = FUNCTIONS[name]
            if len(args) == count:
                return function(*(_value(each, text, values, depth - 1) for each in args))
    found = ast.get_source_segment(text.strip(), node) or text  # as it stands there, however deep
    raise _refused(text, found[:60])


def _is_number(value: float) -> bool:
    """Return whether a constant is a finite number; integers may exceed all floats."""
    return not isinstance(value, bool) and abs(value) < math.inf and abs(value) <= LARGEST


def _refused(text: str, part: str) -> ModelError:
    return ModelError(
        f"formula {text!r}: expected numbers, coordinates, + - * / **, pi and "
        f"{', '.join(FUNCTIONS)}, found {part!r}"
    )
