"""Commands that lead a platform along a path in time, with feedback on its place and heading."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.rearrange import with_outputs
from slipfree.records import Array, Label

GAIN = 1.0  # at which errors of place and heading decay [1/s]
DEGREE = 5  # of the splines through the way-points


def track_path(dae: Dae, t: Array, x: Array, y: Array, heading: Array) -> tuple[Dae, Any]:
    """Return a model with its errors along a path, and the commands that lead along it.

    Commands are the velocity of the path in the platform's heading frame plus `GAIN` times the
    errors of place and heading, so that transients of the steering do not accumulate.

    Parameters
    ----------
    dae : Dae
        From `slipfree.models.platform_rates.subset_kinematics`, given ``forward``, ``right`` and
        ``yaw_rate``.
    t : ndarray, shape (n,)
        Six or more ascending times of the way-points. [s]
    x, y, heading : ndarray, shape (n,)
        Place and heading of the platform's centre in map coordinates, heading from the y axis. A
        spline of degree five goes through them. [m, rad]

    Returns
    -------
    Dae
        With the outputs ``path_error``, distance to the place on the path, and ``heading_error``.
    record
        Its inputs.

    Raises
    ------
    ModelError
        If there are fewer than six way-points, a value is not finite or times do not ascend.
    """
    t, points = np.asarray(t, dtype=float), np.array([x, y, heading], dtype=float)
    if t.size <= DEGREE or points.shape != (3, t.size):
        raise ModelError(
            f"path: expected {DEGREE + 1} or more times and as many values of x, y and heading, "
            f"found {t.size} times and values of shape {points.shape}"
        )
    if not (np.isfinite(points).all() and np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise ModelError("path: expected finite values at times that ascend")
    place, velocity = _splines(t, points.T, dae.t)
    east, north = (place[k] - dae.shift[0][k] - each for k, each in enumerate((dae.x.x, dae.x.y)))
    turn = place[2] - dae.x.heading
    turn = ca.atan2(ca.sin(turn), ca.cos(turn))
    v_x, v_y = velocity[0] + GAIN * east, velocity[1] + GAIN * north
    c, s = ca.cos(dae.x.heading), ca.sin(dae.x.heading)
    inputs = dae.inputs(
        forward=c * v_y - s * v_x, right=c * v_x + s * v_y, yaw_rate=velocity[2] + GAIN * turn
    )
    apart = Label("path_error", "m", "distance of the platform's centre to its place on the path")
    turned = Label("heading_error", "rad", "heading of the path minus that of the platform")
    return with_outputs(dae, [(apart, ca.hypot(east, north)), (turned, turn)]), inputs


def _splines(t: Array, values: Array, time: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return splines through columns of values, and their rates, as expressions of time."""
    from scipy.interpolate import make_interp_spline  # imported where it is used: it takes 0.2 s

    spline, inside = make_interp_spline(t, values, k=DEGREE), ca.fmin(ca.fmax(time, t[0]), t[-1])
    found = []
    for name, each in (("path", spline), ("path_velocity", spline.derivative())):
        at, count = ca.MX.sym("t"), each.t.size - each.k - 1  # further coefficients are padding
        weights = each.c[:count].ravel().tolist()
        value = ca.Function.bspline(name, [each.t.tolist()], weights, [each.k], values.shape[1])
        found.append(ca.Function(f"{name}_at", [at], [value(at)], {"never_inline": True})(inside))
    return found[0], found[1]
