"""Simulate a model many times, with arrays of starts, inputs and parameters."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import ceil
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import evaluator_of
from slipfree.batch.graph import graphs_of
from slipfree.batch.many import LaneResults, lanes_at_once, run_lanes, start_states, states_of
from slipfree.core.arguments import BY_NAME, check_angles, check_finite, checked
from slipfree.core.dae import Dae, InputValue, PiecewiseLinear
from slipfree.core.errors import ModelError, SlipfreeError, require
from slipfree.core.records import Array, leaves
from slipfree.core.schema import Count, Positive
from slipfree.core.trajectory import TIME, WHEELS, Column, SolverError, Trajectory
from slipfree.solve.settle import settle
from slipfree.solve.simulate import check_times, simulate
from slipfree.solve.system import SolverOptions
from slipfree.system.processes import local_tasks

if TYPE_CHECKING:
    import xarray

FAILED = "failed"  # outcome of a run without samples
MAX_LANES = 8192  # runs of a task of the batch
MAX_TASK = 32  # runs that a process executes before it returns results
TASKS_PER_PROCESS = 4  # so that all processes end at about the same time

Model = Dae | Callable[..., Dae]


@checked
def rollouts(
    model: Model,
    starts: Trajectory | Sequence[Trajectory] | Annotated[Mapping[str, float | Array], BY_NAME],
    inputs: Mapping[str, InputValue],
    t: Array,
    *,
    p: Mapping[str, Sequence[object] | Array] | None = None,
    quantities: Sequence[str] | None = None,
    options: SolverOptions = SolverOptions(),
    processes: Count = 1,
    method: Literal["simulate", "batch"] = "simulate",
    step: Positive | None = None,
) -> xarray.Dataset:
    """Simulate a model for many starts, inputs and parameters.

    Runs share the model, its maps and compiled functions. Starts, inputs and parameters that are
    given once apply to all runs.

    With the method ``"simulate"``, each run equals one call of `simulate`. With ``"batch"``, runs
    are computed side by side in fixed steps, some hundred times as fast, with an estimate of the
    error of each; see :doc:`/theory`. It is worth its compilation, up to half a minute once
    for each structure of a vehicle, from about a thousand runs.

    Parameters
    ----------
    model : Dae or callable
        The model, or a function that returns it. Several processes, and parameters, require a
        function; that of several processes must be defined at the level of a module.
    starts : Trajectory, sequence of Trajectory, or mapping of str to float or ndarray
        Trajectories whose last samples are the starts; or values for `settle` by name, each a
        number or an array of shape (n_runs,).
    inputs : mapping of str to float, ndarray, PiecewiseLinear or SX
        Value of each input. An array has the shape (n_intervals,), (n_runs, 1) or
        (n_runs, n_intervals). Linear functions of time and expressions apply to all runs; other
        processes do not accept expressions.
    t : ndarray, shape (n_times,)
        Ascending times of the samples of all runs. [s]
    p : mapping of str to array, optional
        Arguments of the function ``model``, each with one value for each run. The function is
        called once for each run whose arguments differ from those of the run before; runs with
        equal arguments are executed together.
    quantities : sequence of str, optional
        Names of the quantities to keep; by default all.
    options : SolverOptions
        Options of starts and simulations.
    processes : int
        Number of processes, at most the number of available cores. Other processes import the main
        module: protect a script by ``if __name__ == "__main__":``.
    method : {"simulate", "batch"}
        Method of the simulations. The batch requires a model of kinematics or quasi-statics, and
        inputs that are numbers. It computes work and the rows of the solver's report for no run.
    step : float, optional
        Largest length of a step of the batch along the path; by default half the size of the
        vehicle or, if it is shorter, half the trail of a caster. [m]

    Returns
    -------
    xarray.Dataset
        Quantities with the dimensions ``run``, ``time`` and ``wheel``, NaN after the end of a run.
        ``outcome``, ``reason`` and ``end`` have one value for each run: the name of its `Outcome`
        in lower case or ``"failed"`` if it has no start, the message of its stop or error, and the
        time that it reached, which may lie between two samples. [s] ``error``, of the batch only,
        estimates the error of ``x`` and ``y`` at the last sample of a run [m], and ``error_STATE``
        that of each state, such as ``error_heading``. The former is between 0.3 and 3 times the
        error for 95 % of the runs, the latter, where errors may vanish, for 86 to 99 %, with
        pressed wheels or creep for 78 to 92 %. Runs in which Newton's method does not follow
        the contacts are simulated, and have no estimate.

    Raises
    ------
    ModelError
        If shapes, times or names of inputs are invalid, or a model cannot be sent to processes.
        Errors of single runs are reported in the result instead.
    SlipfreeError
        If xarray is not installed, or a process dies.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, direct_kinematics, rollouts
    >>> model = direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y))
    >>> rates = np.array([[0.4], [0.5], [0.6]])
    >>> inputs = {"right_rate": rates, "left_rate": rates, "steer_rate": 0.0}
    >>> found = rollouts(model, {"heading": 0.3}, inputs, np.linspace(0, 2, 5))
    >>> found["y"].sel(time=2.0).values.round(3)
    array([0.23 , 0.287, 0.344])
    >>> found["outcome"].values.tolist()
    ['complete', 'complete', 'complete']
    """
    require("xarray")
    t = check_times(t)
    if processes > 1 and isinstance(model, Dae):
        raise ModelError(
            f"model: expected a function for {processes} processes, found a model, which cannot be "
            "sent to other processes; give a function at the level of a module that returns it"
        )
    values = {
        name: each if isinstance(each, ca.SX | PiecewiseLinear) else np.asarray(each, dtype=float)
        for name, each in inputs.items()
    }
    states: list[Trajectory] | dict[str, Array]
    if isinstance(starts, Mapping):
        states = {name: np.asarray(each, dtype=float) for name, each in starts.items()}
    elif not (states := [*starts] if isinstance(starts, Sequence) else [starts]):
        raise ModelError(
            "starts: expected a trajectory for each run, found none; give at least one"
        )
    parameters = {name: np.asarray(each) for name, each in (p or {}).items()}
    count = _count_runs(parameters, states, values, t.size - 1)
    if isinstance(model, Dae) and parameters:
        raise ModelError(
            "model: expected a function of the parameters in p that returns a model, found a "
            "model; give such a function, or omit p"
        )
    kept = None if quantities is None else tuple(quantities)
    common = _Common(model, t, kept, options, states, values, parameters, step)
    if isinstance(starts, Mapping) and not isinstance(model, Dae):
        check_angles("starts", starts, common.model_of(0).units)
    table = _Table(count, t)
    # models with equal parameters are built once
    order = (
        sorted(range(count), key=lambda k: repr(common.parameters_of(k)))
        if parameters
        else range(count)
    )
    execute, largest = (
        (_simulate_runs, MAX_TASK) if method == "simulate" else (_run_batch, MAX_LANES)
    )
    numbers = np.array(order)
    # the first run is executed in this process: errors of the arguments end the call here
    first = 1 if method == "simulate" or processes > 1 else largest
    table.add(execute(common, numbers[:first]))
    rest = numbers[first:]
    size = min(largest, max(1, ceil(rest.size / (TASKS_PER_PROCESS * processes))))
    tasks = [rest[k : k + size] for k in range(0, rest.size, size)]
    if processes == 1:
        for task in tasks:
            table.add(execute(common, task))
    elif tasks:
        try:
            function = pickle.dumps(model)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ModelError(
                "model: expected a function at the level of a module, or functools.partial of one, "
                f"that can be sent to other processes; found {model!r}: {error}"
            ) from error
        parts = ((function, common.part(task), execute, task) for task in tasks)
        with local_tasks(_execute_part, processes) as finish:
            for done in finish(parts, lambda: None):
                table.add(done)
    return table.dataset({"tolerance": options.tolerance} if method == "simulate" else {})


_Results = list[tuple[Array, LaneResults]]  # numbers of runs, and their results


class _Common(NamedTuple):
    """Arguments of runs; arrays have a value for each run or one for all."""

    model: Any  # a `Model`; None in arguments of a part, to which it is added
    t: Array
    quantities: tuple[str, ...] | None
    options: SolverOptions
    starts: list[Trajectory] | dict[str, Array]
    inputs: dict[str, Any]
    parameters: dict[str, Array]
    step: float | None

    def part(self, numbers: Array) -> _Common:
        """Return the arguments of some runs, without the model."""

        def own(values: Any, dimensions: int = 1) -> Any:
            each = isinstance(values, np.ndarray) and values.ndim >= dimensions and len(values) > 1
            return values[numbers] if each else values

        starts = self.starts
        if isinstance(starts, dict):
            starts = {name: own(each) for name, each in starts.items()}
        elif len(starts) > 1:
            starts = [starts[k] for k in numbers]
        return self._replace(
            model=None,
            starts=starts,
            inputs={name: own(each, dimensions=2) for name, each in self.inputs.items()},
            parameters={name: own(each) for name, each in self.parameters.items()},
        )

    def parameters_of(self, k: int) -> tuple[tuple[str, Any], ...]:
        return tuple((name, _of_run(values, k)) for name, values in self.parameters.items())

    def model_of(self, k: int) -> Dae:
        model = self.model
        return model if isinstance(model, Dae) else _built(model, self.parameters_of(k))

    def start_of(self, k: int) -> Trajectory | dict[str, Any]:
        if isinstance(self.starts, list):
            return self.starts[k if len(self.starts) > 1 else 0]
        return {name: float(_of_run(values, k)) for name, values in self.starts.items()}


def _count_runs(
    parameters: Mapping[str, Array],
    states: list[Trajectory] | dict[str, Array],
    values: Mapping[str, Any],
    intervals: int,
) -> int:
    """Return the number of runs; raise ModelError for shapes that do not fit each other.

    ``parameters`` and ``states`` are numbers or arrays (n_runs,) by name, or starts as a list;
    ``values`` are inputs by name, for a number of ``intervals`` between samples.
    """
    counts = dict[str, int]()
    arrays = {f"p[{name!r}]": array for name, array in parameters.items()}
    if isinstance(states, list):
        counts["starts"] = len(states)
    else:
        arrays |= {f"starts[{name!r}]": array for name, array in states.items()}
    for argument, array in arrays.items():
        if array.ndim > 1:
            raise ModelError(
                f"{argument}: expected a number or an array of shape (n_runs,), found shape "
                f"{array.shape}; correct the shape"
            )
        counts[argument] = array.size
    for name, value in values.items():
        if not isinstance(value, np.ndarray):
            continue
        if value.ndim > 2 or (value.ndim and value.shape[-1] not in (1, intervals)):
            raise ModelError(
                f"inputs[{name!r}]: expected a number or an array of shape ({intervals},), "
                f"(n_runs, 1) or (n_runs, {intervals}), for {intervals} intervals between samples, "
                f"found shape {value.shape}; correct the shape"
            )
        counts[f"inputs[{name!r}]"] = len(value) if value.ndim == 2 else 1
    longest = max(counts, key=lambda key: counts[key], default="starts")
    count = counts.get(longest, 1)
    for argument, size in counts.items():
        if size not in (1, count):
            raise ModelError(
                f"{argument}: expected values for 1 run or for {count} runs, as in {longest}, "
                f"found {size}; correct the shape"
            )
    return count


def _of_run(values: Array, k: int) -> Any:
    return values.reshape(-1)[k if values.size > 1 else 0].item()


def _simulate_runs(common: _Common, numbers: Array) -> _Results:
    return [(numbers[[i]], _simulated(common, int(k))) for i, k in enumerate(numbers)]


def _run_batch(common: _Common, numbers: Array) -> _Results:
    """Return the results of runs by the batch; runs that it cannot decide are simulated."""
    results: _Results = []
    groups: dict[Any, list[int]] = {}
    for k in numbers if common.parameters else ():
        groups.setdefault(common.parameters_of(int(k)), []).append(int(k))
    for chosen in map(np.array, groups.values()) if groups else [numbers]:
        dae = common.model_of(int(chosen[0]))
        placed = isinstance(common.starts, list)
        graphs = graphs_of(dae)
        if isinstance(common.starts, dict):
            start = {n: v if v.size == 1 else v[chosen] for n, v in common.starts.items()}
            states = start_states(graphs, start)
        else:
            runs = common.starts if len(common.starts) == 1 else [common.starts[k] for k in chosen]
            states = np.stack([states_of(graphs, run) for run in runs], axis=1)
        dae.inputs(**common.inputs)  # raises ModelError for missing and unknown names
        inputs = np.empty((len(common.inputs), common.t.size - 1, chosen.size))
        for row, label in zip(inputs, leaves(dae.labels.u), strict=True):
            values = common.inputs[label.full]
            if not isinstance(values, np.ndarray):
                raise ModelError(
                    f"inputs[{label.full!r}]: expected numbers for the method 'batch', found "
                    f"{type(values).__name__}; give arrays, or use method='simulate'"
                )
            check_finite(f"inputs[{label.full!r}]", values)
            if values.ndim == 2:
                values = (values if len(values) == 1 else values[chosen]).T
            row[:] = values.reshape(-1, 1) if values.ndim < 2 else values
        states = np.broadcast_to(states, (len(states), chosen.size))
        size = lanes_at_once(graphs, common.t)
        for part in (slice(k, k + size) for k in range(0, chosen.size, size)):
            lanes = run_lanes(
                evaluator_of(dae),
                states[:, part],
                inputs[..., part],
                common.t,
                step=common.step,
                quantities=common.quantities,
                placed=placed,
            )
            results.append((chosen[part], lanes))
            results += _simulate_runs(common, chosen[part][lanes.disputed])
    return results


@lru_cache(maxsize=1)
def _built(model: Callable[..., Dae], parameters: tuple[tuple[str, Any], ...]) -> Dae:
    """Return the model for parameters; raise ModelError if the function returns none."""
    built = model(**dict(parameters))
    if not isinstance(built, Dae):
        raise ModelError(
            f"model: expected a function that returns a model, found {type(built).__name__} from "
            f"{model!r}; return the result of direct_kinematics, for example"
        )
    return built


def _simulated(common: _Common, k: int) -> LaneResults:
    """Return the simulated run k, or the outcome and the message of its failure."""
    dae, decided = common.model_of(k), (None, np.zeros(1, dtype=bool))
    values = dict[str, Any](common.inputs)
    for name, each in values.items():
        if isinstance(each, np.ndarray) and each.ndim:
            row = each if each.ndim == 1 else each[k if len(each) > 1 else 0]
            values[name] = float(row[0]) if row.size == 1 else row
    inputs = dae.inputs(**values)

    def failed(error: Exception) -> LaneResults:
        return LaneResults({}, (), [FAILED], [str(error)], np.full(1, np.nan), *decided)

    try:
        start = common.start_of(k)
        if not isinstance(start, Trajectory):
            start = settle(dae, options=common.options, **start)
        motion = simulate(dae, start, inputs, common.t, options=common.options)
    except SolverError as error:
        if error.trajectory is None:
            return failed(error)
        motion, words, outcome = error.trajectory, str(error), "solver_failure"
    except SlipfreeError as error:
        return failed(error)
    else:
        words, outcome = motion.stop.words if motion.stop else "", motion.outcome.name.lower()
    rows = np.isin(motion.t, common.t)
    columns = {}
    for name in motion if common.quantities is None else common.quantities:
        motion[name]  # raises ModelError for an unknown name
        label, samples = motion.columns[name]
        column = np.full((1, common.t.size, *samples.shape[1:]), np.nan)
        column[0, : rows.sum()] = samples[rows]
        columns[name] = Column(label, column)
    end = np.array([motion.t[-1]])
    return LaneResults(columns, motion.wheels, [outcome], [words], end, *decided)


class _Table:
    """Results of runs, in arrays of shape (run, time) or (run, time, wheel)."""

    def __init__(self, count: int, t: Array) -> None:
        self.t, self.wheels = t, tuple[str, ...]()
        self.columns: dict[str, Column] = {}
        self.outcomes, self.reasons = np.full((2, count), "", dtype=object)
        self.ends, self.errors = np.full((2, count), np.nan)
        self.estimated = False

    def add(self, results: _Results) -> None:
        """Add the results of some runs."""
        for k, part in results:
            self.outcomes[k], self.reasons[k], self.ends[k] = part.outcomes, part.reasons, part.end
            self.errors[k] = np.nan if part.error is None else part.error
            self.estimated |= part.error is not None
            self.wheels = part.wheels or self.wheels
            for name, (label, samples) in part.columns.items():
                if self.estimated and part.error is None and name not in self.columns:
                    continue  # the batch has no such quantity
                if name not in self.columns:
                    shape = self.ends.size, *samples.shape[1:]
                    self.columns[name] = Column(label, np.full(shape, np.nan))
                self.columns[name].values[k] = samples

    def dataset(self, attributes: dict[str, float]) -> xarray.Dataset:
        """Return the results as an xarray dataset."""
        coordinates: dict[str, Any] = {"time": ("time", self.t, TIME)}
        if self.wheels:
            coordinates["wheel"] = ("wheel", np.array(self.wheels), WHEELS)
        variables: dict[str, Any] = {
            name: (("run", *column.dimensions)[: column.values.ndim], *column[1:], column.metadata)
            for name, column in self.columns.items()
        }
        variables["outcome"] = "run", self.outcomes.astype(str), {"long_name": "outcome of the run"}
        words = {"long_name": "reason of an early end"}
        variables["reason"] = "run", self.reasons.astype(str), words
        end = {"units": "s", "long_name": "time that the run reached"}
        variables["end"] = "run", self.ends, end
        if self.estimated:
            words = {"units": "m", "long_name": "estimated error of x and y at the last sample"}
            variables["error"] = "run", self.errors, words
        dataset: xarray.Dataset = require("xarray").Dataset(variables, coordinates, attributes)
        return dataset


@lru_cache(maxsize=1)
def _loaded(function: bytes) -> Model:
    """Return a pickled function, the same object for all tasks of a process: see `_built`."""
    model: Model = pickle.loads(function)
    return model


def _execute_part(task: tuple[bytes, _Common, Callable[..., _Results], Array]) -> _Results:
    function, common, execute, numbers = task
    found = execute(common._replace(model=_loaded(function)), np.arange(numbers.size))
    return [(numbers[k], each) for k, each in found]
