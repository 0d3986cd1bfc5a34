"""Options of the solvers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Le, Unit, doc

from slipfree.core.arguments import checked

MIN_TOLERANCE = 1e-14  # rounding dominates below it
MAX_TOLERANCE = 1e-2  # errors do not grow with the tolerance beyond it: steps are uncontrolled
Method = Literal["idas", "cvodes", "explicit"]


@checked
@dataclass(frozen=True)
class SolverOptions:
    """Options of starts, simulations and plans.

    Every function that solves a model accepts all options and uses those that apply; a start uses
    only `compiled`.

    Attributes
    ----------
    tolerance : float
        Relative and absolute tolerance of the integrator; that of a length is multiplied by the
        size of the vehicle, ``dae.size``. [size, rad]
    method : {"idas", "cvodes", "explicit"} or None
        Name of the integrator. By default CVODES for motions without algebraic unknowns, and IDAS
        for motions with them, which CVODES cannot solve. The error test of CVODES includes the
        quadratures. ``"explicit"`` are the fixed steps of the batch (`slipfree.rollouts`), refined
        until the estimated error of ``x`` and ``y`` at the end is below the tolerance; for
        kinematics and quasi-statics with inputs that are numbers. It is fast if compiled, for
        tolerances from about 1e-6.
    compiled : bool
        Whether to compile the equations with the system's C compiler; the libraries are cached.
        Without a compiler the equations are interpreted, and a warning gives the reason.

    Raises
    ------
    ModelError
        If the tolerance is not between 1e-14 and 0.01, or the method is unknown.
    """

    tolerance: Annotated[float, Ge(MIN_TOLERANCE), Le(MAX_TOLERANCE), Unit("1")] = 1e-8
    method: Method | None = None
    compiled: Annotated[
        bool,
        doc(
            "whether to compile the equations; a first compilation takes seconds, its result is "
            "cached"
        ),
    ] = False
