"""The equations of a motion, as integrators and Newton's method call them, with their Jacobian.

What follows from the model alone is made once, whatever its inputs, and compiled if the model asks
for it; the grounds that it calls and the laws of its inputs come in by the chain rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca

from slipfree.calls import Lifted, Taylor, built, column, jacobian, lifted
from slipfree.dae import Dae
from slipfree.named import Array


class Equations(NamedTuple):
    """Equations of a motion under inputs; ``m`` are its unknowns, ``alg`` is without unit.

    Attributes
    ----------
    core : casadi Function
        ``(t, x, m, u) -> (ode, alg)``; differentiable by ``x`` and ``m``.
    newton : casadi Function
        ``(t, x, m, u) -> (alg, its Jacobian in m)``.
    """

    core: ca.Function
    newton: ca.Function


class _Stage(NamedTuple):
    """Calls that can be made together.

    ``arguments`` takes symbols and the results of earlier stages; ``calls`` hold what is called
    and its Jacobian.
    """

    arguments: ca.Function
    calls: tuple[tuple[ca.Function, ...], ...]


class _Model(NamedTuple):
    """A model's equations without their calls; ``inputs`` tells which inputs they depend on.

    ``values`` is ``(t, x, m, v, c) -> (ode, alg)``, with results of calls ``c``, and ``slopes``
    ``(t, x, m, v, c, c1) ->`` its Jacobian in ``x, m, v``, with their derivatives ``c1``.
    """

    inputs: tuple[bool, ...]
    stages: tuple[_Stage, ...]
    values: ca.Function
    slopes: ca.Function


def equations(
    dae: Dae[Any, Any, Any, Any, Any], count: int, law: Sequence[ca.SX], u: ca.SX
) -> Equations:
    """Return the equations of a motion.

    Parameters
    ----------
    dae : Dae
        The model.
    count : int
        Number of its first unknowns that belong to the motion.
    law : sequence of SX
        What its inputs are, in its symbols and ``u``.
    u : SX
        Symbols of numbers that the law contains.
    """
    x, z, _ = dae.columns()
    model, m = _model(dae, count), z[:count]
    # Laws of other inputs may contain unknowns that are none of the motion's.
    used = (each if own else ca.SX(0) for each, own in zip(law, model.inputs, strict=True))
    driven = ca.vertcat(ca.SX(0, 1), *used)
    symbols = [dae.t, x, m, u]
    inputs = ca.Function("law", symbols, [driven], {"cse": True})
    turns = ca.Function("law_slopes", symbols, [jacobian(driven, ca.vertcat(x, m))], {"cse": True})
    given = [ca.MX.sym(name, each.numel()) for name, each in zip("txmu", symbols, strict=True)]
    point = [*given[:3], inputs(*given)]
    ode, alg = model.values(*point, *_results(model, point, 0))
    slopes = model.slopes(*point, *_results(model, point, 1))
    ends = [0, x.numel(), x.numel() + count]
    by_state, by_input = ca.horzsplit(slopes, [0, ends[-1], slopes.shape[1]])
    total = by_state + by_input @ turns(*given)
    (ode_x, ode_m), (alg_x, alg_m) = ca.blocksplit(total, ends, ends)
    options: dict[str, Any] = {
        "jac_penalty": 0,
        "custom_jacobian": _jacobian(given, [ode, alg], [[ode_x, ode_m], [alg_x, alg_m]]),
        "is_diff_in": [False, True, True, False],
        "never_inline": True,
    }
    return Equations(
        ca.Function("core", given, [ode, alg], options),
        ca.Function("newton", given, [alg, ca.densify(alg_m)]),
    )


def jacobian_option(core: ca.Function, x_size: Array, m_size: Array) -> dict[str, Any]:
    """Return the option that gives IDAS the Jacobian as it is.

    CasADi would derive it from the system, and assemble it anew around the one that ``core`` has.

    Parameters
    ----------
    core : casadi Function
        The equations, from `equations`.
    x_size, m_size : ndarray, shape (n_x,) and (n_m,)
        Units in which IDAS has the states and the unknowns.
    """
    t, x, m, u = core.mx_in()
    by_x, by_m = ca.DM(x_size), ca.DM(m_size)
    unused = [ca.MX(core.sparsity_out(k)) for k in range(core.n_out())]
    found = core.jacobian().call([t, x * by_x, m * by_m, u, *unused])
    _, ode_x, ode_m, _, _, alg_x, alg_m, _ = found
    ode_x, alg_x = (part @ ca.diag(by_x) for part in (ca.diag(1 / by_x) @ ode_x, alg_x))
    ode_m, alg_m = (part @ ca.diag(by_m) for part in (ca.diag(1 / by_x) @ ode_m, alg_m))
    given, blocks = [t, x, m, ca.MX.sym("p", 0), u], [ode_x, alg_x, ode_m, alg_m]
    names = [
        "jac_ode_x",
        "jac_alg_x",
        "jac_ode_z",
        "jac_alg_z",
    ]  # CasADi's, as that of the function
    return {"cache": {"jacF": ca.Function("jacF", given, blocks, [*"txzpu"], names)}}


def _jacobian(
    given: Sequence[ca.MX], parts: Sequence[ca.MX], slopes: Sequence[Sequence[ca.MX]]
) -> ca.Function:
    """Return the Jacobian of ``core`` by ``x`` and ``m``, with nothing for ``t`` and ``u``."""
    t, *_, u = given
    blocks = [[ca.MX(part.numel(), t.numel()), *row, ca.MX(part.numel(), u.numel())]
              for part, row in zip(parts, slopes, strict=True)]  # fmt: skip
    results = [ca.MX.sym("result", part.numel()) for part in parts]
    return ca.Function("jac_core", [*given, *results], [each for row in blocks for each in row])


@lru_cache(maxsize=8)
def _model(dae: Dae[Any, Any, Any, Any, Any], count: int) -> _Model:
    """Return the equations of a model, whatever its inputs."""
    x, z, v = dae.columns()
    alg = ca.vertcat(ca.SX(0, 1), *dae.residuals)[:count]
    rows = [dae.ode, alg]
    if dae.easing:
        rows = ca.substitute(rows, [dae.easing.symbol], [ca.SX(dae.easing.values[-1])])
    whole = lifted([dae.t, x, z[:count], v], [ca.densify(each) for each in rows])
    smooth = [True] * len(whole.calls)

    def make() -> list[ca.Function]:
        return _functions(whole, smooth)

    functions = built(whole, smooth, ("values", "slopes"), make, compiled=dae.compiled)
    inputs = ca.vertsplit(v) if v.numel() else []
    return _Model(tuple(ca.depends_on(ca.vertcat(*rows), each) for each in inputs), _stages(whole),
                  *functions)  # fmt: skip


def _functions(whole: Lifted, smooth: Sequence[bool]) -> list[ca.Function]:
    taylor, given, shared = Taylor(whole, smooth), [*whole.symbols, whole.results], {"cse": True}
    rows = taylor.linear(ca.vertcat(*whole.expressions))
    slopes = taylor.here(ca.jacobian(rows, ca.vertcat(*whole.symbols[1:])))
    return [ca.Function("values", given, [*whole.expressions], shared),
            ca.Function("slopes", [*given, taylor.first], [slopes])]  # fmt: skip


def _stages(whole: Lifted) -> tuple[_Stage, ...]:
    """Gather calls one after the other, as long as none takes the results of another."""
    groups = list[list[int]]()
    for k, call in enumerate(whole.calls):
        own = column(whole.calls[j].results for j in groups[-1]) if groups else None
        if own is None or ca.depends_on(call.arguments, own):
            groups.append([])
        groups[-1].append(k)
    stages = list[_Stage]()
    for group in groups:
        before = column(call.results for call in whole.calls[: group[0]])
        calls = [whole.calls[k] for k in group]
        arguments = [call.arguments for call in calls]
        stages.append(_Stage(
            ca.Function("arguments", [*whole.symbols, before], arguments),
            tuple(tuple(call.orders(1)) for call in calls),
        ))  # fmt: skip
    return tuple(stages)


def _results(model: _Model, point: Sequence[ca.MX], order: int) -> list[ca.MX]:
    """Return the results of the calls at a point, and their derivatives up to an order."""
    found: list[list[ca.MX]] = [[ca.MX(0, 1)] for _ in range(order + 1)]
    for stage in model.stages:
        arguments = stage.arguments.call([*point, ca.vertcat(*found[0])])
        for own, functions in zip(arguments, stage.calls, strict=True):
            given = [own]
            for known, function in zip(found, functions, strict=False):
                given.append(function.call(given)[0])
                known.append(ca.vec(ca.densify(given[-1])))
    return [ca.vertcat(*each) for each in found]
