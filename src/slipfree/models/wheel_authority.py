"""Wheel rates for given rates of the platform, at one configuration.

The direct model is linear in its inputs. The wheel rates of least slip among those with the given
rates of the platform therefore follow from linear algebra.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.models.determinacy import (
    command_determinacy,
    command_sizes,
    input_effects,
)
from slipfree.models.given_rates import check_commands
from slipfree.vehicle.tree import Vehicle

MIN_RELATIVE_SINGULAR_VALUE = 1e-9  # smaller values: the wheels do not affect the given rate
MAX_MISSED_SHARE = 1e-9  # tolerance of the given rates [largest given rate]


def check_authority(vehicle: Vehicle, direct: Dae, stand: Trajectory, given: Sequence[str]) -> None:
    """Raise ModelError if the wheels cannot impose the given rates at the last sample of a motion.

    Parameters
    ----------
    vehicle, direct, stand
        As in `wheel_rates`.
    given : sequence of str
        Names of the given rates.
    """
    check = command_determinacy(vehicle, direct, direct, given)
    x, z = direct.rows("x", stand, -1), direct.rows("z", stand, -1)
    if check.margin(x[:, None], z[:, None])[0] < 0:
        raise ModelError(f"{vehicle.name!r}: {check.describe(x, z)}")


def wheel_rates(
    vehicle: Vehicle,
    direct: Dae,
    stand: Trajectory,
    *,
    joints: Mapping[str, float] | None = None,
    **given: float,
) -> dict[str, float]:
    """Return the inputs of least slip with which the platform has given rates.

    The configuration is the last sample of ``stand``. If several inputs have the same slip, the
    result has the least norm.

    Parameters
    ----------
    vehicle, direct : Vehicle, Dae
        The vehicle, and its direct model of least slip.
    stand : Trajectory
        Motion whose last sample is the configuration.
    joints : mapping of str to float, optional
        Rates of commanded coordinates, by the names of the inputs, such as ``steer_rate``; others
        are zero. [rad/s, m/s]
    **given : float
        Given rates: some of ``forward``, ``right`` and ``yaw_rate``. [m/s, rad/s]

    Returns
    -------
    dict of str to float
        Inputs by name, as arguments of ``direct.inputs``. [rad/s, m/s]

    Raises
    ------
    ModelError
        If no rate is given, if a rate or a joint is unknown, if a rate cannot be imposed, if there
        are more rates than driven wheels, or if ``right`` is missing though all driven wheels have
        rollers.
    """
    check_commands(vehicle, tuple(given))
    at = direct.rows("x", stand, -1), direct.rows("z", stand, -1)
    effect, slip = (np.array(part) for part in input_effects(direct, direct, tuple(given))(*at))
    names = [label.full for label in leaves(direct.labels.u)]
    count, moving = len(direct.u.wheels), joints or {}
    if unknown := set(moving) - set(names[count:]):
        raise ModelError(
            f"joints: expected names of {', '.join(names[count:]) or 'no inputs'}, found "
            f"{', '.join(map(repr, sorted(unknown)))}; correct the names"
        )
    turning = np.array([moving.get(name, 0.0) for name in names[count:]])
    requested = np.array(list(given.values())) - effect[:, count:] @ turning
    wheels = _least_slip_inputs(
        effect[:, :count], slip[:, :count], requested, slip[:, count:] @ turning
    )
    sizes = np.array(command_sizes(vehicle, tuple(given)))
    miss = sizes * (requested - effect[:, :count] @ wheels)
    worst = int(np.abs(miss).argmax())
    if not abs(miss[worst]) <= MAX_MISSED_SHARE * float(np.abs(sizes * requested).max()):
        name = [*given][worst]
        raise ModelError(
            f"{vehicle.name!r}: expected given rates that the wheels can impose together in this "
            f"configuration, found {name!r}, which the nearest motion misses by "
            f"{abs(miss[worst]):.2g} m/s; remove {name!r} from the given rates"
        )
    return dict(zip(names, (float(each) for each in (*wheels, *turning)), strict=True))


def _least_slip_inputs(effect: Array, slip: Array, requested: Array, rest: Array) -> Array:
    """Return the inputs with ``effect @ inputs = requested`` and least slip.

    The slip is ``rest + slip @ inputs``.
    """
    left, values, right = np.linalg.svd(effect)
    rank = int((values > MIN_RELATIVE_SINGULAR_VALUE * max(values[0], np.finfo(float).tiny)).sum())
    inverse = right[:rank].T @ np.diag(1 / values[:rank]) @ left[:, :rank].T
    free = right[rank:].T
    base = inverse @ requested
    rates = (
        base
        + free
        @ np.linalg.lstsq(slip @ free, -(rest + slip @ base), rcond=MIN_RELATIVE_SINGULAR_VALUE)[0]
    )
    return np.asarray(rates + inverse @ (requested - effect @ rates))
