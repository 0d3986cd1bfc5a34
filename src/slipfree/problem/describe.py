"""What a vehicle is made of, what decides its motion, and how well."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from slipfree.dae import Dae
from slipfree.named import leaves
from slipfree.problem.summary import Facts
from slipfree.trajectory import Trajectory
from slipfree.vehicle.chain import Vehicle


def tree(vehicle: Vehicle) -> list[str]:
    """Return the parts of a vehicle, indented below those that carry them."""
    kinds = {c.name: c for c in vehicle.coordinates}

    def below(part: str, indent: str) -> Iterator[str]:
        for joint in vehicle.joints:
            if joint.parent == part:
                c, does = kinds[joint.coordinate], "turns about" if joint.motion == "turn" else (
                    "slides along"
                )  # fmt: skip
                yield f"{indent}{joint.name}: {does} {joint.axis} by {c.name} ({c.kind})"
                yield from below(joint.name, indent + "  ")
        for wheel in vehicle.wheels:
            if wheel.parent == part:
                drive = "driven" if wheel.driven else "free"
                size = f"r1 {wheel.r1:g}, r2 {wheel.r2:g} m"
                yield f"{indent}wheel {wheel.name}: {drive}, {size}"

    return ["platform", *below("platform", "  ")]


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
        ("rates", listed(rates)),
        ("  equations", f"{len(dae.labels.alg[1])}: {dae.labels.alg[1][0].name.replace('_', ' ')}"),
        ("passive joints", f"{len(passive)}: {', '.join(passive) or 'none'}"),
        ("free wheels", f"{len(free)}: {', '.join(free) or 'none'}"),
        ("no-slip conditions", f"{needed} more than the wheels' touching; freedoms {rolls}"),
    ]


def conditioning(start: Trajectory) -> Facts:
    """Return how far a start is from a singular configuration."""
    return [("singular value", f"{start['singular_value'][-1]:.4g} of the Jacobian, at the start")]
