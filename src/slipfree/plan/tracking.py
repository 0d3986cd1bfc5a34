"""Follow a plan in closed loop: four controllers, and the simulation of a vehicle under them.

A controller decides at every period, from the measured states, about the inputs of the period that
follows: `Controller.step` in the loop of a robot, `track_plan` in simulation. It knows the ground
and the vehicle of the plan; the vehicle moves in another world, where inputs may arrive late.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slipfree.batch.evaluator import evaluator_of
from slipfree.batch.many import stand, stand_checked, start_states
from slipfree.batch.motion import COMPLETE
from slipfree.core.dae import Dae, InputValue, PiecewiseLinear
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import SolverError, Trajectory, joined
from slipfree.plan.mpc import Cycle, Horizon, check_duration, cycle_inputs, first_cycle, replan
from slipfree.plan.polynomial_motion import PolynomialMotion
from slipfree.plan.sampling import SampledPlan, SamplingTask, sample_plan
from slipfree.solve.simulate import interrupted_at, simulate_to_failure
from slipfree.solve.system import SolverOptions
from slipfree.system.forks import computing
from slipfree.system.interrupt import interrupt_requested

TIME_TOLERANCE = 1e-6  # relative difference of times that count as equal


class Decision(NamedTuple):
    """Inputs that a controller chooses for a period."""

    # inputs by name: those of the plan, or the commands ``forward`` and ``yaw_rate``
    inputs: Mapping[str, InputValue]
    # times of the samples for `slipfree.simulate`, in the time of the inputs, shape (n,) [s]
    times: Array
    # whether no new inputs were found, and those of an earlier period are continued
    failed: bool = False


class Controller(ABC):
    """A way to follow a plan, with a memory: use each for one motion.

    All functions are built by the constructor and by `prepare`; `step` only evaluates them.

    Parameters
    ----------
    model : Dae
        Model of the plan, whose states are measured.
    period : float
        Time between two steps. [s]
    compiled : bool
        Whether rest poses of pressed wheels are computed by compiled code.

    Attributes
    ----------
    seconds : list of float
        CPU time of each step. [s]
    """

    name: str

    def __init__(self, model: Dae, period: float, *, compiled: bool) -> None:
        self.model, self.period, self.seconds = model, period, list[float]()
        self._compiled = compiled

    def step(self, state: Array, time: float) -> dict[str, float]:
        """Return the inputs to apply from now on, until the next step a period later.

        Parameters
        ----------
        state : ndarray, shape (n_x,)
            Measured states of ``model``, in map coordinates and the order of
            ``model.state_names``. Height, roll and pitch of a vehicle with pressed wheels are
            replaced by those of rest on the ground of the plan, since measured ones that
            contradict it make predictions diverge.
        time : float
            Time since the beginning of the plan. [s]

        Returns
        -------
        dict of str to float
            Means over the period of the inputs of the plan's model, or of the commands ``forward``
            [m/s] and ``yaw_rate`` [rad/s], by name. If no new inputs are found, those of an earlier
            step are continued.

        Raises
        ------
        ModelError
            If ``state`` is not finite or has another shape, or the times do not increase.

        Examples
        --------
        >>> import numpy as np
        >>> from slipfree import Analytic, Mesh, catalog, direct_kinematics, plan, settle
        >>> from slipfree.plan.tracking import Following
        >>> vehicle = catalog.three_wheeler(axle="fixed")
        >>> model = direct_kinematics(vehicle, Analytic(lambda x, y: 0.1 * x * y))
        >>> wish = {"goal": {"y": 1.0}, "costs": {"effort": 1.0}, "duration": 4.0, "mesh": Mesh(4)}
        >>> found = plan(model, settle(model), **wish)
        >>> controller = Following(model, found.motion, 0.25, period=0.1)
        >>> commands = controller.step(np.zeros(4), 0.0)
        >>> sorted(commands)
        ['forward', 'yaw_rate']
        """
        decision = self.decide(time, time + self.period, state)
        weights = np.diff(decision.times) / np.ptp(decision.times)
        middles = (decision.times[1:] + decision.times[:-1]) / 2

        def mean(value: InputValue) -> float:
            if isinstance(value, PiecewiseLinear):
                value = value.base + value.slope * middles
            return float(np.sum(weights * np.asarray(value)))

        return {name: mean(value) for name, value in decision.inputs.items()}

    def decide(self, t: float, end: float, x: Array) -> Decision:
        """Return the course of the inputs from a time to the end of its period.

        ``x`` are states as in `step`; times count since the beginning of the plan. [s]
        """
        clock = time.process_time()
        decision = self._decide(t, end, self._at_rest(x))
        self.seconds.append(time.process_time() - clock)
        return decision

    def prepare(self, x: Array) -> None:
        """Build or compile all functions that steps need, from states as in `step`."""
        self._at_rest(x)

    @abstractmethod
    def _decide(self, t: float, end: float, x: Array) -> Decision:
        """Return the inputs for states at rest on the ground of the plan."""

    def _at_rest(self, x: Array) -> Array:
        """Return states with those that relax at rest; unchanged if no rest is found."""
        if not self.model.rest.numel():
            return x
        evaluate = evaluator_of(self.model, compiled=self._compiled)
        free = zip(self.model.state_names[: -self.model.rest.numel()], x[:, None], strict=False)
        states = start_states(evaluate.graphs, dict(free))
        stands = stand_checked(evaluate, states, stand(evaluate, states)) == COMPLETE
        return states[evaluate.graphs.rows.x, 0] + self.model.shift[0] if stands[0] else x


class Replanning(Controller):
    """The inputs of the plan, updated by `slipfree.replan` over a moving window; or unchanged."""

    def __init__(self, window: Horizon, *, period: float, updated: bool = True) -> None:
        program = window.program
        super().__init__(program.task.dae, period, compiled=program.options.compiled)
        self.name = "replan" if updated else "inputs"
        self._window = window
        self._whole = Cycle(0.0, window.plan, np.zeros(0), 0.0)
        self._cycle = first_cycle(window) if updated else self._whole
        self._updated = updated

    def _decide(self, t: float, end: float, x: Array) -> Decision:
        """Return the inputs of a plan for the rest of the motion, or of the former cycle."""
        failed = False
        try:
            if self._updated:
                self._cycle = replan(self._window, self._cycle, t, x)
        except SolverError:
            failed = True
        begun = t < self._cycle.t + self._cycle.motion.duration - TIME_TOLERANCE
        inputs, times = cycle_inputs(self._window, self._cycle if begun else self._whole, t, end)
        named = dict(zip(self.model.input_names, leaves(inputs), strict=True))
        return Decision(named, times, failed)


class Following(Controller):
    """The velocities of the plan, corrected for the errors of place and heading.

    The law is that of Kanayama et al. (1990), A stable tracking control method for an autonomous
    mobile robot, IEEE Int. Conf. Robotics and Automation, eq. 8, with gains by which errors are
    critically damped over the size of the vehicle. Since it tracks the plan in time, the vehicle
    reverses where the plan does.
    """

    name = "follow"

    def __init__(self, model: Dae, plan: PolynomialMotion, speed: float, *, period: float) -> None:
        super().__init__(model, period, compiled=False)
        self._plan, self._speed = plan, speed

    def _decide(self, t: float, end: float, x: Array) -> Decision:
        """Return velocities that follow the plan: feed-forward and feedback of errors."""
        planned = _places(self.model, self._plan, np.array([t, end]))
        (r_x, v_x), (r_y, v_y), (heading, yaw_rate) = (
            (float(value[0]), float(np.diff(value)[0]) / (end - t)) for value in planned.values()
        )
        at = dict(zip(self.model.state_names, x, strict=True))
        middle, size = heading + yaw_rate * (end - t) / 2, self.model.size
        v = v_y * np.cos(middle) - v_x * np.sin(middle)
        cos, sin = np.cos(at["heading"]), np.sin(at["heading"])
        ahead = (r_y - at["y"]) * cos - (r_x - at["x"]) * sin
        left = -(r_y - at["y"]) * sin - (r_x - at["x"]) * cos
        turned = np.sin(heading - at["heading"])  # smooth where the angle wraps around
        forward = v * np.cos(heading - at["heading"]) + self._speed / size * ahead
        # with left' = v sin(turned), errors are critically damped forwards and backwards
        yaw_rate += (2 * abs(v) * turned + v * left / size) / size
        return Decision({"forward": forward, "yaw_rate": yaw_rate}, np.array([t, end]))


class Sampling(Controller):
    """Commands by `slipfree.sample_plan`, which track the places and headings of the plan.

    Beyond its end, the plan is continued at its last velocity. The task's model is that of the plan
    with commands as inputs (`slipfree.commanded`).
    """

    name = "sampling"

    def __init__(
        self, model: Dae, task: SamplingTask, plan: PolynomialMotion, *, period: float
    ) -> None:
        super().__init__(model, period, compiled=task.compiled)
        self._task, self._plan = task, plan
        self._cycle: SampledPlan | None = None
        self._last = 0.0

    def prepare(self, x: Array) -> None:
        """Compile the candidates' equations."""
        super().prepare(x)
        with suppress(SolverError):  # a vehicle that cannot start; the first step reports it
            sample_plan(self._task, self._at_rest(x))

    def _decide(self, t: float, end: float, x: Array) -> Decision:
        """Return the inputs of the best sampled motion, or of the former cycle."""
        failed = False
        try:
            elapsed, goal = t - self._last, _places(self._task.model, self._plan, t + self._task.t)
            self._cycle = sample_plan(self._task, x, self._cycle, elapsed=elapsed, goal=goal)
            self._last = t
        except SolverError:
            failed = True
        begin, last, ends = t - self._last, end - self._last, self._task.t[1:-1]
        near = TIME_TOLERANCE * self._task.span
        times = np.array([begin, *ends[(ends > begin + near) & (ends < last - near)], last])
        index = np.searchsorted(ends, (times[1:] + times[:-1]) / 2)
        names = self._task.model.input_names
        none = np.zeros((len(names), index.size))
        values = none if self._cycle is None else self._cycle.inputs[:, index]
        return Decision(dict(zip(names, values, strict=True)), times, failed)


def _places(dae: Dae, plan: PolynomialMotion, t: Array) -> dict[str, Array]:
    """Return places and headings of a plan at times, in map coordinates."""
    step = 0.01 * plan.duration
    before, last = plan.states(np.array([1 - step / plan.duration, 1.0])).T
    beyond = np.maximum(t - plan.duration, 0.0) / step
    x = plan.states(np.minimum(t / plan.duration, 1.0)) + np.outer(last - before, beyond)
    x += dae.shift[0][:, None]
    names = ("x", "y", "heading")
    return dict(zip(names, x[dae.state_rows(*names)], strict=True))


class TrackingWorld(NamedTuple):
    """The world in which a vehicle follows a plan.

    Attributes
    ----------
    dae : Dae
        Model with the inputs of the plan; its states may be others.
    commanded : Dae or None
        The same with the inputs ``forward`` and ``yaw_rate`` (`slipfree.commanded`), for
        controllers that command velocities.
    start : Trajectory
        The vehicle at rest at its start; the last sample counts.
    latency : float
        Time after which inputs take effect; rounded to periods. Until then the inputs are zero. [s]
    """

    dae: Dae
    commanded: Dae | None
    start: Trajectory
    latency: float = 0.0


class TrackedMotion(NamedTuple):
    """Motion of a vehicle that follows a plan in closed loop."""

    run: Trajectory  # the simulated motion, with times since the beginning of the plan
    cycles: int  # number of simulated cycles
    failures: int  # decisions without solution, which used the inputs of the last solved one
    missed: int  # cycles in which the controller was still busy with an earlier decision
    seconds: Array  # CPU time of each decision [s]


@computing
def track_plan(
    controller: Controller,
    world: TrackingWorld,
    *,
    duration: float,
    options: SolverOptions = SolverOptions(),
    progress: Callable[[float], None] | None = None,
) -> TrackedMotion:
    """Simulate a vehicle that follows a plan under a controller.

    The controller measures all states without error or delay. Its CPU time is charged to the loop:
    a decision that takes longer than n periods takes effect n periods later, and until then the
    controller makes no other one. Meanwhile, the last values of the inputs are held.

    Parameters
    ----------
    controller : Controller
        For example `slipfree.plan.tracking.Replanning`. Its period is at most the duration, of
        which it becomes the nearest whole part; so inputs that are late last as long as those that
        they replace.
    world : TrackingWorld
        World in which the vehicle moves.
    duration : float
        Duration of the motion. [s]
    options : SolverOptions
        Options of the simulation.
    progress : callable, optional
        Function called in each cycle with the time at which it begins. [s]

    Returns
    -------
    TrackedMotion
        The motion ends early if a limit of the world is violated, the simulation fails, or a
        Ctrl-C is held back by `held_interrupt`.

    Raises
    ------
    ModelError
        If the period is not positive or exceeds the duration, or if the world lacks states or
        inputs of the plan's model.
    SolverError
        If a simulation cannot be started.
    """
    planned, period = controller.model, controller.period
    check_duration("period: expected a period", period, duration)
    _check_world(planned, world)
    times = np.linspace(0.0, duration, round(duration / period) + 1)
    latency, length = round(world.latency / times[1]), times[1]
    decisions, runs = list[Decision](), list[Trajectory]()
    waiting, free, here = deque[tuple[int, Decision]](), 0, world.start
    controller.prepare(_measured(planned, here))
    for k, (t, end) in enumerate(pairwise(times)):
        if progress is not None:
            progress(t)
        if k >= free:
            decisions.append(controller.decide(t, end, _measured(planned, here)))
            busy = int(controller.seconds[-1] / length)
            waiting.append((k + busy + latency, decisions[-1]))
            free = k + busy + 1
        if waiting and waiting[0][0] <= k:
            applied = waiting.popleft()[1]
        elif k == 0:
            applied = Decision(dict.fromkeys(decisions[0].inputs, 0.0), np.array([0.0, length]))
        else:
            applied = _held(applied, length)
        try:
            here = _drive(world, here, applied, t, options)
        except KeyboardInterrupt:
            if not (runs and interrupt_requested()):
                raise
            runs[-1] = replace(here, stop=interrupted_at(t))
            break
        runs.append(here)
        if here.stop is not None or here.t[-1] < end - TIME_TOLERANCE * duration:
            break
    run = joined(*(each.part(slice(-1)) for each in runs[:-1]), runs[-1])
    failures = sum(each.failed for each in decisions)
    seconds = np.array(controller.seconds[-len(decisions) :])
    return TrackedMotion(run, len(runs), failures, k + 1 - len(decisions), seconds)


def _check_world(planned: Dae, world: TrackingWorld) -> None:
    """Raise ModelError unless the world has the states and inputs of the planned model."""
    own, expected = world.dae.input_names, planned.input_names
    states = [label for label in leaves(planned.labels.x) if label.name not in world.start.columns]
    if own != expected or states:
        lacks = f"; without {', '.join(each.full for each in states)}" if states else ""
        raise ModelError(
            "world: expected the states and inputs of the plan's model, "
            f"{', '.join(expected)}, found {', '.join(own)}{lacks}; use a vehicle with the same "
            "joints and wheels (its parameters may differ)"
        )


def _held(decision: Decision, length: float) -> Decision:
    """Return the last values of the inputs of a decision, for a period that follows."""
    values = {
        name: value.base[-1:] + value.slope[-1:] * decision.times[-1]
        if isinstance(value, PiecewiseLinear)
        else np.ravel(value)[-1:]
        for name, value in decision.inputs.items()
    }
    return Decision(values, np.array([0.0, length]))


def _measured(planned: Dae, here: Trajectory) -> Array:
    """Return the states of a plan's model at the last sample of a motion, in map coordinates."""
    return planned.rows("x", here, -1) + planned.shift[0]


def _drive(
    world: TrackingWorld, here: Trajectory, decision: Decision, t: float, options: SolverOptions
) -> Trajectory:
    """Return the motion under a decision from a time on, with times since the plan's beginning."""
    dae = world.dae if {*world.dae.input_names} == {*decision.inputs} else world.commanded
    if dae is None:
        raise ModelError(
            f"world: expected a model with the inputs {', '.join(decision.inputs)}, found none; "
            "give the field 'commanded' of TrackingWorld, by slipfree.commanded"
        )
    times = decision.times
    run = simulate_to_failure(dae, here, dae.inputs(**decision.inputs), times, options)
    shift = t - times[0]
    stop = run.stop and run.stop._replace(t=run.stop.t + shift)
    return replace(run, t=run.t + shift, stop=stop)
