"""Path tracking: platform rates along a timed path, with or without feedback."""

from __future__ import annotations

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.rearrange import with_outputs
from slipfree.core.records import Array, Label, Record, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.models.given_rates import PLANAR

GAIN = 1.0  # decay rate of the errors of position and heading [1/s]
DEGREE = 5  # degree of the splines through the way-points
MAX_START_DISTANCE = 1e-6  # largest distance of the path from the start [vehicle sizes, rad]


def path_inputs(
    dae: Dae,
    start: Trajectory,
    x: ca.SX | Array,
    y: ca.SX | Array,
    heading: ca.SX | Array,
    *,
    t: Array | None = None,
) -> Record:
    """Return the inputs of an inverse model along a timed path.

    Parameters
    ----------
    dae : Dae
        The inverse model, with the given rates velocity_x, velocity_y and heading_rate.
    start : Trajectory
        Motion of the model; the path must begin at its last sample.
    x, y, heading : SX, or ndarray of shape (n,)
        Position and heading of the platform's centre as expressions of ``dae.t``, or their values
        at the times ``t``, which a spline of degree five interpolates. [m, rad]
    t : ndarray, shape (n,), optional
        Times of the values, at least six, increasing; beyond them the rates stay constant. [s]

    Returns
    -------
    record
        Inputs of the model, functions of time.

    Raises
    ------
    ModelError
        If the model has other inputs; if the path depends on symbols other than ``dae.t``; if there
        are fewer than six times, if their number is not that of the values, if a value is not
        finite, or if the times do not increase; or if the path does not begin at the start.
    """
    names = tuple(label.full for label in leaves(dae.labels.u))
    if set(names) != set(PLANAR):
        raise ModelError(
            f"path: expected an inverse model with the inputs {', '.join(PLANAR)}, found "
            f"{', '.join(names)}; build it with inverse_kinematics(..., given={PLANAR})"
        )
    if t is None:
        path = ca.vertcat(x, y, heading)
        foreign = [symbol for symbol in ca.symvar(path) if not ca.is_equal(symbol, dae.t)]
        if foreign:
            raise ModelError(
                f"path: expected expressions of dae.t only, found the symbols {foreign}; replace "
                "them by numbers or functions of dae.t"
            )
        first = np.array(ca.Function("first", [dae.t], [path])(0.0)).ravel()
        velocity = ca.jacobian(path, dae.t)
    else:
        t, points = _checked_points(t, x, y, heading)
        first, velocity = points[:, 0], _splines(t, points.T, dae.t)[1]
    there = np.array([start.in_frame("paper")[name][-1] for name in ("x", "y", "heading")])
    gaps = (first - there) / [dae.size, dae.size, 1.0]
    gaps[2] = (gaps[2] + np.pi) % (2 * np.pi) - np.pi
    wrong = [
        f"{name} = {value:.6g} instead of {at:.6g}"
        for name, value, at, gap in zip(("x", "y", "heading"), first, there, gaps, strict=True)
        if not abs(gap) < MAX_START_DISTANCE
    ]
    if wrong:
        raise ModelError(
            "path: expected a path that begins at the position and heading of the start, found "
            f"{', '.join(wrong)}; move the path or the start"
        )
    return dae.inputs(**dict(zip(PLANAR, ca.vertsplit(velocity), strict=True)))


def track_path(dae: Dae, t: Array, x: Array, y: Array, heading: Array) -> tuple[Dae, Record]:
    """Return a model with tracking errors as outputs, and the commands that track a path.

    Commands are the velocity of the path in the platform's heading frame plus `GAIN` times the
    errors of position and heading, so that transients of the steering do not accumulate.

    Parameters
    ----------
    dae : Dae
        Inverse model with the given rates ``forward``, ``right`` and ``yaw_rate``.
    t : ndarray, shape (n,)
        Times of the way-points, at least six, increasing. [s]
    x, y, heading : ndarray, shape (n,)
        Position and heading of the platform's centre in map coordinates, heading from the y axis.
        A spline of degree five interpolates them. [m, rad]

    Returns
    -------
    Dae
        The model with the outputs ``path_error``, the distance from the current point of the path
        [m], and ``heading_error`` [rad].
    record
        Inputs of the model.

    Raises
    ------
    ModelError
        If there are fewer than six way-points, if the numbers of times and values differ, if a
        value is not finite, or if the times do not increase.
    """
    t, points = _checked_points(t, x, y, heading)
    place, velocity = _splines(t, points.T, dae.t)
    east, north = (place[k] - dae.shift[0][k] - each for k, each in enumerate((dae.x.x, dae.x.y)))
    turn = place[2] - dae.x.heading
    turn = ca.atan2(ca.sin(turn), ca.cos(turn))
    v_x, v_y = velocity[0] + GAIN * east, velocity[1] + GAIN * north
    c, s = ca.cos(dae.x.heading), ca.sin(dae.x.heading)
    inputs = dae.inputs(
        forward=c * v_y - s * v_x, right=c * v_x + s * v_y, yaw_rate=velocity[2] + GAIN * turn
    )
    apart = Label("path_error", "m", "distance of the platform's centre from its path")
    turned = Label("heading_error", "rad", "heading of the path minus that of the platform")
    return with_outputs(dae, [(apart, ca.hypot(east, north)), (turned, turn)]), inputs


def _checked_points(
    t: Array, x: ca.SX | Array, y: ca.SX | Array, heading: ca.SX | Array
) -> tuple[Array, Array]:
    """Return times and values of way-points, shapes (n,) and (3, n).

    Raises ModelError if `path_inputs` cannot interpolate them.
    """
    t = np.asarray(t, dtype=float)
    values = [np.asarray(each, dtype=float) for each in (x, y, heading)]
    if t.size <= DEGREE:
        raise ModelError(
            f"path: expected at least {DEGREE + 1} way-points, found {t.size}; add way-points"
        )
    if any(each.shape != (t.size,) for each in values):
        raise ModelError(
            f"path: expected {t.size} values each of x, y and heading, one per time, found the "
            f"shapes {', '.join(str(v.shape) for v in values)}; give one value of each for every "
            "time"
        )
    if not (np.isfinite(values).all() and np.isfinite(t).all()):
        raise ModelError(
            "path: expected finite times and values, found NaN or infinity; remove such way-points"
        )
    if not (np.diff(t) > 0).all():
        k = int((np.diff(t) <= 0).argmax())
        raise ModelError(
            f"path: expected increasing times, found {t[k]:.6g} s followed by {t[k + 1]:.6g} s; "
            "sort the way-points by time, and remove repeated times"
        )
    return t, np.array(values)


def _splines(t: Array, values: Array, time: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return interpolating splines of columns of values, and their time derivatives."""
    from scipy.interpolate import make_interp_spline  # imported here: the import takes 0.2 s

    spline, inside = make_interp_spline(t, values, k=DEGREE), ca.fmin(ca.fmax(time, t[0]), t[-1])
    found = []
    for name, each in (("path", spline), ("path_velocity", spline.derivative())):
        at, count = ca.MX.sym("t"), each.t.size - each.k - 1  # further coefficients are padding
        weights = each.c[:count].ravel().tolist()
        value = ca.Function.bspline(name, [each.t.tolist()], weights, [each.k], values.shape[1])
        found.append(ca.Function(f"{name}_at", [at], [value(at)], {"never_inline": True})(inside))
    return found[0], found[1]
