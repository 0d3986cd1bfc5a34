"""Formulas: text expressions for the values of joints in terms of coordinates."""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import casadi as ca

from slipfree.core.errors import ModelError, shortened

FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(ca, name.replace("abs", "fabs"))
    for name in ["sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt", "exp", "log", "abs"]
}
CONSTANTS = {"pi": math.pi}
MAX_SHOWN = 60  # characters of a formula in a message
TRIED = 0.0, 0.1, -0.1  # values of the coordinates, at one of which a formula is finite
MAX_NUMBER = 1e300  # largest number in a formula
OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
    ast.UAdd: lambda a: a,
    ast.USub: lambda a: -a,
}
MAX_LENGTH = 1000  # largest number of characters of a formula
MAX_DEPTH = 50  # deepest nesting of a formula


def evaluate(text: str, values: Mapping[str, ca.SX]) -> ca.SX:
    """Return the value of a formula.

    It consists of numbers, names, ``+ - * / **``, parentheses, ``pi`` and the functions ``sin cos
    tan asin acos atan atan2 sqrt exp log abs``, with angles in radians. ModelError is raised if the
    text is not such a formula, if a name has no value, or if the text has more than 1000 characters
    or 50 nested levels.
    """
    return ca.SX(_evaluate_node(_parse(text), text, values, MAX_DEPTH))


@cache
def names_in(text: str) -> frozenset[str]:
    """Return the names of the coordinates in a formula; raise ModelError for invalid text."""
    tree = _parse(text)
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    names = frozenset(used - set(CONSTANTS) - set(FUNCTIONS))
    at = (_evaluate_node(tree, text, dict.fromkeys(names, ca.SX(x)), MAX_DEPTH) for x in TRIED)
    if not any(math.isfinite(float(ca.evalf(ca.SX(value)))) for value in at):
        message = f"formula {shortened(text, MAX_SHOWN)!r}: expected a finite value, found none"
        raise ModelError(f"{message}; correct divisions by zero and the domains of functions")
    return names


def _parse(text: str) -> ast.expr:
    """Return the syntax tree of a formula; nothing is evaluated."""
    if len(text) > MAX_LENGTH:
        raise ModelError(
            f"formula {text[:60] + '...'!r}: expected at most {MAX_LENGTH} characters, found "
            f"{len(text)}; shorten it"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # text such as '\\d' or 1if is refused below
            return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        pass
    raise _formula_error(text, text[:60])


def _evaluate_node(node: ast.expr, text: str, values: Mapping[str, ca.SX], depth: int) -> Any:
    """Return the value of a node of a formula; ModelError if formulas do not support it.

    ``text`` is the whole formula, for messages; ``values`` are those of its names; ``depth`` is the
    number of levels that are still allowed.
    """
    if depth == 0:
        raise ModelError(
            f"formula {text!r}: expected at most {MAX_DEPTH} nested levels, found more; simplify it"
        )
    match node:
        case ast.Constant(value=int() | float() as number) if (
            not isinstance(number, bool) and abs(number) <= MAX_NUMBER
        ):
            return float(number)
        case ast.Name(id=name) if name in values:
            return values[name]
        case ast.Name(id=name) if name in CONSTANTS:
            return CONSTANTS[name]
        case ast.Name(id=name) if name not in FUNCTIONS:
            raise ModelError(
                f"formula {text!r}: expected "
                + (f"one of the names {', '.join(sorted(values))}" if values else "no names")
                + f", found {name!r}; correct the formula"
            )
        case ast.UnaryOp(op=op, operand=only) if type(op) in OPERATORS:
            return OPERATORS[type(op)](_evaluate_node(only, text, values, depth - 1))
        case ast.BinOp(op=op, left=left, right=right) if type(op) in OPERATORS:
            pair = (_evaluate_node(each, text, values, depth - 1) for each in (left, right))
            return OPERATORS[type(op)](*map(ca.SX, pair))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
            if len(args) == 1 + (name == "atan2"):
                return FUNCTIONS[name](
                    *(_evaluate_node(each, text, values, depth - 1) for each in args)
                )
    segment = ast.get_source_segment(text.strip(), node) or text
    raise _formula_error(text, segment[:MAX_SHOWN])


def _formula_error(text: str, part: str) -> ModelError:
    return ModelError(
        f"formula {shortened(text, MAX_SHOWN)!r}: expected numbers up to {MAX_NUMBER:g}, "
        f"coordinates, + - * / **, pi and {', '.join(FUNCTIONS)}, found {part!r}; correct the "
        "formula"
    )
