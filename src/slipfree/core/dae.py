"""Symbolic model as a DAE: the result of every model function and the input of every solver."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, runtime_checkable

import casadi as ca
import numpy as np
from typing_extensions import TypeVar  # with a default

from slipfree.core import records
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError, similar
from slipfree.core.lookups import CellBounds, Lookup, lookup_function
from slipfree.core.records import Array, HtmlRepr, Indices, Label, Mask, Record, leaves
from slipfree.core.schema import Finite
from slipfree.core.trajectory import Outcome, Trajectory
from slipfree.system.forks import cached_property

if TYPE_CHECKING:
    from slipfree.terrain.base import Terrain
    from slipfree.vehicle.tree import Vehicle

LIMIT_ROUNDING = (
    1e-9  # violation of a limit that counts as rounding [unit or scale of the quantity]
)


@records.with_overview
class Limit(NamedTuple):
    """Limit of a motion: the motion ends where ``lower <= expression <= upper`` is violated.

    A violation by rounding, at most `LIMIT_ROUNDING`, counts as none: a joint may rest at its stop.

    Attributes
    ----------
    label : Label
        Name, unit and message; the message completes the sentence "at t = 3 s ...".
    expression : SX, shape (1, 1)
        Limited quantity in the symbols of the model, with local positions
        (:ref:`local-and-map-coordinates`).
    lower, upper : float
        Bounds, in the label's unit.
    describe : callable or None
        ``describe(x, z)`` returns a more specific message for a local state of shapes (n_x,) and
        (n_z,), or an empty string if this limit is not the reason of the stop.
    outcome : Outcome
        Outcome of a motion that ends at this limit.
    """

    label: Label
    expression: ca.SX
    lower: float
    upper: float
    describe: Callable[[Array, Array], str] | None = None
    outcome: Outcome = Outcome.LIMIT

    def message(self, value: float, x: Array, z: Array) -> str:
        """Return the message of a violation.

        Parameters
        ----------
        value : float
            Value of the quantity, in the unit of its label.
        x, z : ndarray, shapes (n_x,) and (n_z,)
            States and unknowns, in local coordinates, at which it is violated.

        Returns
        -------
        str
            The text of ``describe``, or the value and the allowed range.
        """
        if self.describe is not None and (words := self.describe(x, z)):
            return words
        lower, upper, unit = self.lower, self.upper, self.label.unit
        if unit == "rad":
            (value, lower, upper), unit = np.degrees((value, lower, upper)).tolist(), "deg"
        allowed = f"at least {lower:g}" if np.isfinite(lower) else f"at most {upper:g}"
        if np.isfinite(lower) and np.isfinite(upper):
            allowed = f"{lower:g} to {upper:g}"
        unit = "" if unit == "1" else f" {unit.replace('m-1', '1/m')}"
        return f"{self.label.words}: {round(value, 6) + 0.0:.4g}, allowed {allowed}{unit}"

    def violated_by(self, values: Array | float, size: float) -> Mask:
        """Return which values are beyond the limit, by more than rounding.

        Parameters
        ----------
        values : ndarray, any shape, or float
            Values of the quantity, in the unit of its label.
        size : float
            Scale of the quantity (`Dae.size_of`), to which rounding is relative.

        Returns
        -------
        ndarray of bool, of the same shape
            True beyond the limit, and for NaN.
        """
        slack = LIMIT_ROUNDING * size
        values = np.asarray(values)
        return ~((values >= self.lower - slack) & (values <= self.upper + slack))  # also nan


def invalid_start(words: str) -> ModelError:
    """Return the error of a start that violates a limit, check or equation, from its message."""
    return ModelError(
        f"start: expected a sample within the limits of the model, found a violation: {words}; "
        "choose another start or other inputs"
    )


@dataclass(frozen=True, eq=False)
class PiecewiseLinear:
    """An input that is linear in time on every interval between samples."""

    # value of each linear function ``base + slope t`` at t = 0, for the n - 1 intervals between n
    # samples, in the unit of the input, shape (n - 1,)
    base: Array
    # rate of each linear function, in the unit of the input per second, shape (n - 1,)
    slope: Array

    @classmethod
    def through(cls, t: Array, values: Array) -> PiecewiseLinear:
        """Return the input that has values at times, shape (n,) each."""
        slope = np.diff(values) / np.diff(t)
        return cls(values[:-1] - slope * t[:-1], slope)


InputValue = float | Array | PiecewiseLinear | ca.SX
X = TypeVar("X", default=Any)  # types of the records of a model: states, unknowns, inputs, outputs
Z = TypeVar("Z", default=Any)
U = TypeVar("U", default=Any)
Y = TypeVar("Y", default=Any)


class Continuation(NamedTuple):
    """Continuation (homotopy) parameter for the solution of the equations at the initial state."""

    symbol: ca.SX  # symbol of the parameter in the residuals, shape (1, 1)
    # values for which the equations are solved one after the other, from simpler equations to those
    # of the model
    values: tuple[float, ...]


class SampledCheck(Protocol):
    """A condition on the samples of a motion that is computed numerically, not symbolically."""

    @property
    def label(self) -> Label:
        """Name, unit and description of the margin."""

    def margin(self, x: Array, z: Array) -> Array:
        """Return the margins, shape (n,), of n states in the columns of ``x`` and ``z``.

        A negative margin is a violation; its unit is that of the label.
        """

    def describe(self, x: Array, z: Array) -> str:
        """Return a message about the violation in a state of shapes (n_x,) and (n_z,)."""


@runtime_checkable
class PlacedCheck(SampledCheck, Protocol):
    """A check whose margin is a function of some expressions of the model.

    An attribute ``limit`` of type `Limit` gives the same condition as an expression, which planners
    use: a user may name it in limits and costs.
    """

    @property
    def placing(self) -> ca.SX:
        """Column of expressions of the model on which the margin depends."""

    def margin_at(self, placed: Array) -> Array:
        """Return the margins, shape (n,), at n columns of values of ``placing``."""


@runtime_checkable
class WheelCheck(PlacedCheck, Protocol):
    """A check of the contact of the wheel of its label, by which a vehicle is lowered to rest."""

    @property
    def pose(self) -> ca.Function:
        """``placing`` as a function of states and unknowns."""

    def deepest(self, placed: Array) -> tuple[Array, Array]:
        """Return the smallest gaps to the ground, (n,), and their local x and y, (2, n) [m]."""

    def known_bounds(self) -> CellBounds:
        """Return known bounds of the ground by which compiled code finds single contacts.

        The wheel has a single contact if its radius, the first of the bounds' numbers, times the
        curvature is less than ``hypot(a_x, a_y) - slope |a_z|``, where ``a`` is its axle. The rows
        of ``placing`` begin with its centre and ``a``.
        """


class Standing(NamedTuple):
    """Model of the vehicle at rest, from which the start of a dynamic model is computed."""

    model: Dae  # model whose equilibrium is the start
    # model with exact contact, whose pose is the initial guess of the equilibrium; None if the
    # wheels cannot all touch a rigid ground
    guess: Dae | None
    speed: ca.SX  # symbol of the speed of the platform along its forward axis, shape (1, 1) [m/s]
    # states of the dynamic model in the symbols of ``model`` and the speed, local coordinates
    x: ca.SX


class Replay(NamedTuple):
    """Model whose simulation verifies plans on another model.

    Attributes
    ----------
    model : Dae
        Model with the states and inputs of the planned model.
    limits : tuple of Limit
        Limits of the planned model within which it agrees with ``model``. Plans contain them from
        the beginning.
    """

    model: Dae
    limits: tuple[Limit, ...]


class HeldTerms(NamedTuple):
    """Terms of the rates whose derivatives the Jacobian of a simulation neglects.

    The Jacobian only serves Newton's method in the integrator, which converges as fast without
    derivatives of terms that change slowly.
    """

    ode: ca.SX  # rates of the states, with symbols in the place of the terms, shape (n_x, 1)
    # the symbols (k, 1), and the terms in the symbols of the model
    symbols: ca.SX
    values: ca.SX


class Labels(NamedTuple):
    """Labels of the variables and equations of a `Dae`."""

    # x, z, q, u, y: labels of the variables, in records with the structure of those in
    # the model
    x: Any
    z: Any
    q: Any
    u: Any
    y: Any
    alg: tuple[tuple[Label, ...], ...]  # labels of the algebraic equations, one tuple per block


class Sizes(NamedTuple):
    """Scales of variables and residuals, with the size of the vehicle as unit of length."""

    # scales of the states, the unknowns and the residuals, each in the unit of its quantity
    x: Array
    z: Array
    alg: Array


class Parameter(NamedTuple):
    """A number of a model that can change without building the model again."""

    label: Label  # name, unit and description
    symbol: ca.SX  # symbol in the expressions of the model, shape (1, 1)
    value: float  # nominal value, in the label's unit


class Holding(NamedTuple):
    """Equilibrium of contact forces at rest: ``matrix.T @ forces + load = 0``."""

    # derivatives of the slips along and across every wheel, and normal to it if the normal forces
    # are not given, by the free rates, shape (3 n_wheels, n_rates) or (2 n_wheels, n_rates) [1, m]
    matrix: ca.SX
    # generalised forces of gravity, springs, dampers and given normal forces over the weight [1, m]
    load: ca.SX
    friction: ca.SX  # coefficients of friction under the wheels, shape (n_wheels, 1) [1]
    # given normal forces over the weight, (n_wheels, 1); None if equilibrium determines them [1]
    normal: ca.SX | None = None


@dataclass(frozen=True, eq=False)
class Dae(HtmlRepr, Generic[X, Z, U, Y]):
    """Semi-explicit DAE of index 1: ``x' = ode(t, x, z, u)``, ``0 = alg(t, x, z, u)``.

    Without ``z`` and ``alg`` the model is an ordinary differential equation. The algebraic
    equations are ordered in blocks, one for each field of ``z``; a block determines its field for
    given values of the fields before it. The last blocks are solved only at the samples if neither
    the rates of the states nor other blocks depend on them; an example is the block of the forces
    that a given motion needs. Quadratures may depend on such blocks. States and unknowns are in
    local coordinates. Initial states, outputs and trajectories are in map coordinates: local values
    plus ``shift``.

    Attributes
    ----------
    t : SX, shape (1, 1)
        Time. [s]
    x, z, q, u : record of SX
        Symbols of differential states, algebraic unknowns, quadratures and inputs.
    ode, quad : SX, shape (n_x, 1) and (n_q, 1)
        Rates of the states and of the quadratures.
    alg : tuple of SX
        Residuals, one column for each field of ``z``.
    y : record of SX
        Outputs; positions are in map coordinates.
    labels : Labels
        Names, units and descriptions of variables and equations.
    limits : tuple of Limit
        Limits of a valid motion.
    checks : tuple of SampledCheck
        Numeric limits, evaluated at the samples.
    guess : SX, shape (n_z, 1)
        Initial guess of ``z``, a function of ``x``.
    scale : ndarray, shape (n_z,)
        Typical sizes of ``z``, each in the unit of its unknown.
    shift : tuple of two ndarrays, shapes (n_x,) and (n_z,)
        Map values minus local values of ``x`` and of ``z``.
    reported : mapping of str to float
        Values in conditions and costs given by name, and in messages, minus map values, by name of
        the quantity; zero for other quantities. An example is the heading of a problem that counts
        headings from the x axis.
    size : float
        Unit of length of the solvers, usually the extent of the vehicle. Tolerances, residuals and
        rank decisions do not change if all lengths of a problem are scaled with it. [m]
    pace : SX, shape (1, 1)
        Speed over the ground, divided by the distance that a step of the integrator may cover; zero
        for no bound. The error test of an integrator does not see a bump or a contact that begins
        and ends within one step. [1/s]
    suppress_algebraic : bool
        Whether the integrator's error test ignores ``z``, as for models whose ``z`` contains
        stabilisation terms.
    continuation : Continuation or None
        Continuation for initial states at which Newton's method alone does not converge.
    rest : SX, shape (k, 1)
        Initial guess of the equilibrium values of the last ``k`` states, a function of the other
        states. `slipfree.settle` computes these values for given values of the other states. Empty
        if no states are determined by equilibrium.
    standing : Standing or None
        Model whose equilibrium `slipfree.settle` computes for a start, if it is not this model.
    lookups : tuple of Lookup
        Coefficients of the ground that the expressions contain as symbols; `function` evaluates
        them.
    replay : Replay or None
        Model whose simulation verifies plans on this model, if it is not this model.
    held : HeldTerms or None
        Terms of ``ode`` whose derivatives the Jacobian of a simulation neglects, if any.
    linear : tuple of two SX, shapes (n, n) and (n, 1), or None
        Matrix and right side of linear equations with the solution of the second block of
        ``alg``, if there is a form that takes fewer operations than the Jacobian of the block.
    lag : SX or None, shape (1, 1)
        Symbol in ``linear`` of models whose last states relax: the time by which the stiffness of
        the contacts is advanced, zero in the other equations. It makes a step linearly implicit.
        [s]
    relaxation_time : float
        Time constant of the relaxation of a loaded contact, for models with a ``lag``. [s]
    discs : tuple of pairs of SX
        Pairs of unknowns that lie in the unit disc at a solution, such as the used fractions of
        friction along and across a wheel. Newton's method without continuation needs them.
    leading_rates : SX, shape (k, 1)
        Rates of the first k unknowns of ``z``, if other unknowns determine them; empty otherwise.
    holding : Holding or None
        Equilibrium of the contact forces at rest; None for vehicles without mass.
    vehicle, ground : object
        Vehicle and ground from which the model was made; None for other equations. Driving laws,
        figures, mobility maps and initial guesses of plans take them from here; solvers ignore
        them.
    p : tuple of Parameter
        Numbers that are symbols of the model. Solvers take models without parameters; mobility
        maps vary them.

    Raises
    ------
    ModelError
        If the numbers of equations and variables differ, ``size`` is not positive and finite, or
        several variables have the same name.

    Notes
    -----
    ``model.x.x``, ``model.x.y`` and ``model.z.position.z`` are local: they are relative to the
    ground's origin, ``ground.origin`` in map coordinates. In costs, limits, events and feedback
    laws, add ``model.shift``: the map's x is ``model.x.x + model.shift[0][0]``.

    Examples
    --------
    Distance of the platform from a map position, for a cost or an event:

    >>> import casadi as ca
    >>> import numpy as np
    >>> from slipfree import Bicubic, Grid, catalog, direct_kinematics
    >>> axis = np.linspace(100.0, 120.0, 41)
    >>> ground = Bicubic(Grid(axis, axis, np.zeros((41, 41))))
    >>> model = direct_kinematics(catalog.three_wheeler(), ground)
    >>> model.shift[0][:2].tolist()
    [110.0, 110.0]
    >>> x, y = model.x.x + model.shift[0][0], model.x.y + model.shift[0][1]
    >>> distance = ca.hypot(x - 112.0, y - 105.0)
    """

    t: ca.SX
    x: X
    z: Z
    q: Record
    u: U
    ode: ca.SX
    alg: tuple[ca.SX, ...]
    quad: ca.SX
    y: Y
    labels: Labels
    limits: tuple[Limit, ...]
    checks: tuple[SampledCheck, ...]
    guess: ca.SX
    scale: Array
    shift: tuple[Array, Array]
    size: float = 1.0
    pace: ca.SX = ca.SX(0)  # noqa: RUF009 - never changed
    suppress_algebraic: bool = False
    continuation: Continuation | None = None
    rest: ca.SX = ca.SX(0, 1)  # noqa: RUF009 - never changed
    standing: Standing | None = None
    lookups: tuple[Lookup, ...] = ()
    replay: Replay | None = None
    held: HeldTerms | None = None
    linear: tuple[ca.SX, ca.SX] | None = None
    lag: ca.SX | None = None
    relaxation_time: float = 0.0
    discs: tuple[tuple[ca.SX, ca.SX], ...] = ()
    leading_rates: ca.SX = ca.SX(0, 1)  # noqa: RUF009 - never changed
    holding: Holding | None = None
    # for equations without a vehicle None, which the packages above this one never use
    vehicle: Vehicle = None  # type: ignore[assignment]
    ground: Terrain = None  # type: ignore[assignment]
    p: tuple[Parameter, ...] = ()
    reported: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        blocks: Any = self.z
        if len(self.alg) != len(blocks):
            raise ModelError(
                f"alg: expected one block of equations for each of the {len(blocks)} fields of z, "
                f"found {len(self.alg)}; give one block for each field"
            )
        sizes = [("ode", self.ode, self.x), ("quad", self.quad, self.q)]
        sizes += [(f"alg[{i}]", b, blocks[i]) for i, b in enumerate(self.alg)]
        for name, rows, record in sizes:
            count = len(list(leaves(record)))
            if rows.shape != (count, 1):
                raise ModelError(
                    f"{name}: expected a column of {count} expressions, one for each variable, "
                    f"found shape {rows.shape}; correct the expressions or the variables"
                )
        if not 0 < self.size < float("inf"):
            raise ModelError(
                f"size: expected a positive, finite length in metres, found {self.size}; give, for "
                "example, the extent of the vehicle"
            )
        names = [label.full for label in leaves(tuple(self.labels[:5]))]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise ModelError(
                f"labels: expected a different name for each variable, found {min(twice)!r} more "
                "than once; rename a coordinate of the vehicle or an output"
            )

    def __repr__(self) -> str:
        counts = [
            f"{len(list(leaves(getattr(self.labels, record))))} {words}"
            for record, words in (("x", "states"), ("z", "unknowns"), ("u", "inputs"))
        ]
        return records.overview(
            f"Dae: {', '.join(counts)}, {len(self.limits)} limits, size {self.size:.3g} m",
            states=records.quantity_names(self.labels.x),
            unknowns=records.quantity_names(self.labels.z),
            inputs=self.input_names,
            outputs=records.quantity_names((self.labels.q, self.labels.y)),
        )

    @property
    def input_names(self) -> list[str]:
        """Names of the inputs, in their order."""
        return [label.full for label in leaves(self.labels.u)]

    @property
    def state_names(self) -> list[str]:
        """Names of the states, in their order."""
        return [label.full for label in leaves(self.labels.x)]

    def state_rows(self, *names: str) -> list[int]:
        """Return the rows of states in the column of all states.

        Parameters
        ----------
        *names : str
            Names of states, such as ``"heading"``, those of ``state_names``.

        Returns
        -------
        list of int
            Indices in the order of the names.

        Raises
        ------
        ValueError
            If the model has no state of a name.
        """
        return [self.state_names.index(name) for name in names]

    @property
    def zero_inputs(self) -> Record:
        """Inputs that are all zero."""
        return self.inputs(**dict.fromkeys(self.input_names, 0.0))

    @property
    def quantities(self) -> Iterator[tuple[Label, ca.SX]]:
        """Labels and expressions of states, unknowns, inputs and outputs, one after the other."""
        x, z, _, u, y, _ = self.labels
        return zip(leaves((x, z, u, y)), leaves((self.x, self.z, self.u, self.y)), strict=True)

    @cached_property
    def all_limits(self) -> tuple[Limit, ...]:
        """Limits of the model, and those of checks that are also expressions, for planners."""
        of_checks = (getattr(check, "limit", None) for check in self.checks)
        return *self.limits, *(limit for limit in of_checks if limit is not None)

    @cached_property
    def sizes(self) -> Sizes:
        """Scales of the states, the unknowns and the residuals."""
        labels = self.labels
        return Sizes(
            *(
                np.array([self.size_of(label) for label in leaves(record)])
                for record in (labels.x, labels.z, labels.alg)
            )
        )

    def size_of(self, label: Label) -> float:
        """Return the scale of a quantity, relative to which its rounding counts.

        Parameters
        ----------
        label : Label
            Label of a quantity, with a unit such as ``"m s-1"``.

        Returns
        -------
        float
            ``size`` raised to the exponent of metres in the unit.
        """
        return float(self.size ** power_of_length(label.unit))

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the variables, limits and states of a start by name, also with the wheel."""
        labels = [*leaves(tuple(self.labels[:5])), *(limit.label for limit in self.all_limits)]
        labels += leaves(self.standing.model.labels.x) if self.standing else ()
        return {name: label.unit for label in labels for name in (label.name, label.full)}

    @property
    def residuals(self) -> tuple[ca.SX, ...]:
        """Blocks of ``alg`` divided by their scales, dimensionless."""
        pairs = zip(self.alg, self.block_rows, strict=True)
        return tuple(block / ca.DM(self.sizes.alg[rows]) for block, rows in pairs)

    @property
    def block_rows(self) -> list[slice]:
        """Rows of each block in the columns of equations and of unknowns."""
        return records.consecutive(*(block.numel() for block in self.alg))

    def inputs(self, **values: InputValue) -> Record:
        """Return the record of inputs from values by name.

        Parameters
        ----------
        **values : float, ndarray of shape (n - 1,), PiecewiseLinear or SX
            Value of each input. A float is constant. An array has one value, and a PiecewiseLinear
            one linear function of time, for each interval between samples. An expression in the
            model's symbols is a function of ``t`` or a feedback law, with positions in local
            coordinates (:ref:`local-and-map-coordinates`).

        Returns
        -------
        record
            Values with the structure of ``u``.

        Raises
        ------
        ModelError
            If a name is missing or unknown.
        """
        names = self.input_names
        _same_names("inputs", names, values)
        record: Any = self.u
        found: Record = records.unpack(record, [values[name] for name in names])
        return found

    def rows(
        self, record: str, run: Trajectory, index: int | slice | Indices = slice(None)
    ) -> Array:
        """Return samples of a trajectory as vectors in local coordinates.

        Parameters
        ----------
        record : {"x", "z", "u", "q"}
            Variables to return.
        run : Trajectory
            Motion of this model, in map coordinates.
        index : int, slice or ndarray of int
            Index of the sample, or indices of several; by default all.

        Returns
        -------
        ndarray, shape (n,) or (n, n_samples)
            Values in the order of the record, each in the unit of its label.
        """
        labels = leaves(getattr(self.labels, record))
        values = np.array([run.of(label)[index] for label in labels])
        shift = {"x": self.shift[0], "z": self.shift[1]}.get(record, np.zeros(len(values)))
        return (values.T - shift).T

    @checked
    def start(self, **values: Finite) -> Array:
        """Return a state vector in local coordinates, shape (n_x,), from map values by name.

        States that are not named have the map value zero.

        Raises
        ------
        ModelError
            If a name is unknown or a value is not finite.
        """
        names = self.state_names
        _same_names("start", names, values, all_needed=False)
        return np.array([values.get(name, 0.0) for name in names]) - self.shift[0]

    def local_state(self, x: Array) -> Array:
        """Return states in local coordinates, shape (n_x,), from map coordinates in their order.

        Raises
        ------
        ModelError
            If a state is missing or not finite.
        """
        names = self.state_names
        if np.shape(x) != (len(names),) or not np.isfinite(x).all():
            raise ModelError(
                f"expected finite values of the states {', '.join(names)}, in map coordinates, "
                f"found {x}; give all of them in this order"
            )
        return x - self.shift[0]

    def named(self, name: str) -> list[ca.SX]:
        """Return the expressions of a quantity: one, or one per wheel.

        Quantities are states, unknowns, inputs, outputs, and checks with a limit.

        Positions are local, except those among the outputs.

        Raises
        ------
        ModelError
            If no state, unknown, input or output has that name.
        """
        found, known = [], set()
        for label, expression in self.quantities:
            known.add(label.name)
            if name in (label.name, label.full):
                found.append(expression)
        for limit in self.all_limits[len(self.limits) :]:  # of checks
            known.add(limit.label.name)
            if name == limit.label.name:
                found.append(limit.expression)
        if not found:
            hint = similar(name, known)
            raise ModelError(
                f"expected a quantity of the model, found {name!r}; {hint}use one of "
                f"{', '.join(sorted(known))}"
            )
        return found

    def function(
        self,
        name: str,
        symbols: Sequence[ca.SX],
        expressions: Sequence[ca.SX],
        options: dict[str, object] | None = None,
    ) -> ca.Function:
        """Return expressions of the model as a function of some of its symbols.

        Parameters
        ----------
        name : str
            Name of the function.
        symbols, expressions : sequence of SX
            Arguments and results of the function. The continuation parameter has its last value
            if it is not an argument.
        options : dict, optional
            Options of the casadi Function.
        """
        continuation = self.continuation
        if continuation and not ca.depends_on(ca.vertcat(*symbols), continuation.symbol):
            expressions = self.without_continuation(expressions)
        return lookup_function(self.lookups, name, symbols, expressions, options)

    def without_continuation(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Return expressions with the last value of the continuation parameter.

        Parameters
        ----------
        expressions : sequence of SX
            Expressions in the symbols of the model.

        Returns
        -------
        list of SX
            Expressions of the model itself; the same ones for a model without continuation.
        """
        if self.continuation is None:
            return list(expressions)
        last = ca.SX(self.continuation.values[-1])
        return list(ca.substitute(list(expressions), [self.continuation.symbol], [last]))

    def columns(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the symbols of the model as columns.

        Returns
        -------
        tuple of 3 SX, shapes (n_x, 1), (n_z, 1) and (n_u, 1)
            States, algebraic unknowns and inputs, in the order of the leaves of their records.
        """
        return self._columns

    @cached_property
    def _columns(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        return records.pack(self.x), records.pack(self.z), records.pack(self.u)


@dataclass(frozen=True, eq=False)
class Nlp:
    """Nonlinear program: minimise ``f`` within bounds of the unknowns and of ``g``."""

    x: ca.MX  # unknowns divided by their scales, shape (n_x, 1)
    # f and g: objective and constraints as functions of ``x``, shapes (1, 1) and (n_g, 1)
    f: ca.MX
    g: ca.MX
    # guess, scale, lower, upper: initial guess, scales and bounds of the unknowns, each in
    # the unit of its quantity, shape (n_x,)
    guess: Array
    scale: Array
    lower: Array
    upper: Array
    # g_lower and g_upper: bounds of the constraints, in the units of ``g``, shape (n_g,)
    g_lower: Array
    g_upper: Array
    # indices into ``x`` by name of the quantity; each array has the shape of its quantity
    where: Mapping[str, Indices]


def power_of_length(unit: str) -> int:
    """Return the exponent of metres in a unit such as ``"rad s-1"`` or ``"m2 s-1"``."""
    factors = (re.fullmatch(r"m(-?\d+)?", factor) for factor in unit.split())
    return sum(int(factor[1] or 1) for factor in factors if factor)


def _same_names(
    what: str, names: list[str], given: Iterable[str], *, all_needed: bool = True
) -> None:
    """Raise ModelError for unknown names and, with ``all_needed``, for missing ones."""
    unknown = sorted(set(given) - set(names))
    missing = [name for name in names if name not in set(given)] if all_needed else []
    if unknown or missing:
        expected = f"values {'for' if all_needed else 'only for'} {_quoted(names)}"
        found = [f"the unknown {_quoted(unknown)}"] if unknown else []
        found += [f"no value for {_quoted(missing)}"] if missing else []
        remedy = "correct or remove unknown names" if unknown else "give a value for each name"
        raise ModelError(
            f"{what}: expected {expected if names else 'no values'}, found {' and '.join(found)}; "
            f"{remedy}"
        )


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names))
