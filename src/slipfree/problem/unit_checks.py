"""Check of the units of named values in a problem against those of the model."""

from __future__ import annotations

from collections.abc import Iterator

from slipfree.dae import Dae
from slipfree.files.toml.angles import unit_faults
from slipfree.files.toml.errors import Fault
from slipfree.problem import schema
from slipfree.records import leaves

BARE = ("start", "goal", "limits")  # tables with angles
TABLES = (*BARE, "inputs", "bounds")


def check_units(spec: schema.Task, dae: Dae) -> Iterator[Fault]:
    """Yield an error for each value whose unit differs from that of the model's quantity."""
    units = _units(dae)
    for name in TABLES:
        yield from unit_faults((name,), getattr(spec, name, None) or {}, units, bare=name in BARE)
    for index, wanted in enumerate(getattr(spec, "way_points", ())):
        yield from unit_faults(("way_points", index), wanted, units, bare=True)
    rates = {name: _rate(unit) for name, unit in units.items()}
    yield from unit_faults(("accelerations",), getattr(spec, "accelerations", {}), rates)


def _units(dae: Dae) -> dict[str, str]:
    """Return the units of all quantities of a model, by name and by name with wheel."""
    labels = [label for record in dae.labels[:5] for label in leaves(record)]
    labels += [limit.label for limit in dae.limits]
    labels += leaves(dae.standing.model.labels.x) if dae.standing else ()
    return {name: label.unit for label in labels for name in (label.name, label.full)}


def _rate(unit: str) -> str:
    return unit.replace(" s-1", " s-2") if " s-1" in unit else f"{unit} s-1"
