"""What a vehicle is made of, what decides its motion, and how well."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from slipfree.dae import Dae
from slipfree.geometry.frame import AXES, unit_vector
from slipfree.kinematics.records import is_determinate
from slipfree.named import leaves
from slipfree.problem.summary import Facts
from slipfree.trajectory import Trajectory
from slipfree.vehicle.chain import Coordinate, Joint, Vehicle


def tree(vehicle: Vehicle) -> list[str]:
    """Return the parts of a vehicle, indented below those that carry them."""
    kinds = {c.name: c for c in vehicle.coordinates}

    def below(part: str, indent: str) -> Iterator[str]:
        for joint in vehicle.joints:
            if joint.parent == part:
                yield f"{indent}{joint.name}: {_joint(joint, kinds)}"
                yield from below(joint.name, indent + "  ")
        for wheel in vehicle.wheels:
            if wheel.parent == part:
                drive = "driven" if wheel.driven else "free"
                size = f"r1 {wheel.r1:g}, r2 {wheel.r2:g} m"
                more = f", {wheel.mass:g} kg" if wheel.mass else ""
                more += f", grip {wheel.grip:g}" if wheel.grip != 1 else ""
                more += ", rollers" if wheel.rollers else ""
                yield f"{indent}wheel {wheel.name}: {drive}, {size}{more}"

    body = vehicle.body
    at = ", ".join(f"{each:g}" for each in body.at)
    mass = f": {body.mass:g} kg, centre of mass at ({at}) m" if body.mass else ""
    return [f"platform{mass}", *below("platform", "  ")]


def _joint(joint: Joint, kinds: dict[str, Coordinate]) -> str:
    """Return how a joint moves and what moves it."""
    moved = [f"{name}: {_kind(kinds[name])}" for name in sorted(joint.coordinates)]
    if not moved:
        return "rigid"
    axis = next((n for n, vector in AXES.items() if vector == joint.axis), None)
    along = axis or f"({', '.join(f'{each:.3g}' for each in unit_vector(joint.axis))})"
    does = "turns about" if joint.motion == "turn" else "slides along"
    if joint.value in joint.coordinates:
        return f"{does} {along} by {joint.value} ({_kind(kinds[joint.value])})"
    return f"{does} {along} by {joint.value} ({'; '.join(moved)})"


def _kind(c: Coordinate) -> str:
    """Return what decides a coordinate, and what acts on it."""
    acts = [(c.stiffness, "spring"), (c.damping, "damper"), (c.bump, "elastic stops")]
    return ", ".join([c.kind, *(f"{words} {value:g}" for value, words in acts if value)])


def _forces(vehicle: Vehicle, dae: Dae[Any, Any, Any, Any, Any]) -> Iterator[tuple[str, str]]:
    """Yield what decides the forces of a vehicle with mass."""
    if not vehicle.mass:
        return
    count = 3 * len(vehicle.wheels)
    if dae.labels.z.rates.normal:
        how = "the law of friction decides them, together with the rates"
    elif is_determinate(vehicle):
        how = "equilibrium determines them"
    else:
        how = f"{count - len(list(leaves(dae.labels.z.rates.motion)))} of them are left open by " \
              "equilibrium: the load-weighted ones are taken"  # fmt: skip
    yield "contact forces", f"{count}: {how}"


def counts(vehicle: Vehicle, dae: Dae[Any, Any, Any, Any, Any]) -> Facts:
    """Return what decides the motion: unknowns and equations, named and counted."""
    wheels = len(vehicle.wheels)
    position, rates, _ = dae.labels.z
    free = [wheel.name for wheel in vehicle.wheels if not wheel.driven]
    passive = [c.name for c in vehicle.of("passive")]
    given, needed = len(passive) + len(free), 2 * wheels - 3
    if given == needed:
        rolls = "as many as needed: it can roll without slip (slip = 'rolling')"
    else:
        more = "too few by" if given < needed else "too many by"
        rolls = f"{more} {abs(needed - given)}: it slips the least it can (slip = 'least')"

    def listed(record: Any) -> str:
        names = [label.full for label in leaves(record)]
        return f"{len(names)}: {', '.join(names) or 'none'}"

    return [
        ("inputs", listed(dae.labels.u)),
        ("states", listed(dae.labels.x)),
        ("decided by the ground", listed(position)),
        ("  equations", f"{3 * wheels}: three for each wheel that touches the ground"),
        ("suspension", f"{len(vehicle.of('suspension'))} of {wheels - 3} needed"),
        ("rates", listed((rates.motion, rates.multipliers))),
        ("  equations", f"{len(dae.labels.alg[1])}: {_equations(dae)}"),
        ("passive joints", f"{len(passive)}: {', '.join(passive) or 'none'}"),
        ("free wheels", f"{len(free)}: {', '.join(free) or 'none'}"),
        ("no-slip conditions", f"{needed} more than the wheels' touching; freedoms {rolls}"),
        *_forces(vehicle, dae),
    ]


def _equations(dae: Dae[Any, Any, Any, Any, Any]) -> str:
    """Return what the equations of the rates state."""
    if dae.labels.z.rates.normal:
        return "equilibrium, touching and friction; they decide the normal forces too"
    return dae.labels.alg[1][0].name.replace("_", " ")


def conditioning(start: Trajectory) -> Facts:
    """Return how far a start is from a singular configuration."""
    return [("singular value", f"{start['singular_value'][-1]:.4g} of the Jacobian, at the start")]
