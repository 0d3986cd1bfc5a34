"""Starts with a given contact point of one wheel."""

from __future__ import annotations

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import leaves
from slipfree.core.trajectory import Trajectory
from slipfree.solve.options import SolverOptions
from slipfree.solve.settle import settle_exchanged


def settle_contact(
    dae: Dae,
    wheel: str,
    *,
    contact_x: float,
    contact_y: float,
    options: SolverOptions = SolverOptions(),
    **start: float,
) -> Trajectory:
    """Return the vehicle at rest with a given contact point of one wheel.

    The contact point of one wheel, the heading and the joints are given. The nine closure equations
    of a three-wheeler then determine position, height, roll and pitch of its platform and the other
    two contact points.

    Parameters
    ----------
    dae : Dae
        A closure model: its states include ``x`` and ``y``, its first unknowns are the contacts.
    wheel : str
        Name of the wheel.
    contact_x, contact_y : float
        Contact point of the wheel, in map coordinates. [m]
    options : SolverOptions
        Options of the solvers.
    **start : float
        Heading and joints by name; others are zero. [rad, m]

    Raises
    ------
    ModelError
        If ``dae`` is not a closure model, the wheel or a name is unknown, ``x`` or ``y`` is given,
        or the vehicle cannot stand with this contact point.
    """
    known = {label.wheel for label in leaves(dae.labels.z[0]) if label.name == "contact_x"}
    if not known:
        raise ModelError(
            "settle_contact: expected a model whose first unknowns are contact points, found no "
            "unknown 'contact_x'; use a closure model"
        )
    if wheel not in known:
        names = ", ".join(sorted(filter(None, known)))
        raise ModelError(
            f"settle_contact: expected one of the wheels {names}, found {wheel!r}; correct the name"
        )
    fixed = {name: start.pop(name) for name in ("x", "y") if name in start}
    if fixed:
        raise ModelError(
            "settle_contact: expected no x and y, which follow from the contact point, found "
            f"{' and '.join(fixed)}; remove {'it' if len(fixed) == 1 else 'them'}"
        )
    place = {f"contact_x[{wheel}]": contact_x, f"contact_y[{wheel}]": contact_y}
    exchange = dict(zip(("x", "y"), place, strict=True))
    return settle_exchanged(dae, exchange, options=options, **place, **start)
