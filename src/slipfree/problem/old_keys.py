"""Keys of problem files of version 0.1, and the keys that replace them."""

from __future__ import annotations

from typing import Any

from slipfree.files.toml.errors import Fault

VERBS = ("direct", "plan")  # whose keys changed


def upgrade_keys(data: dict[str, Any]) -> tuple[dict[str, Any], list[Fault]]:
    """Return the tables of a problem with today's keys, and an error for each old key.

    Parameters
    ----------
    data : dict
        The tables as the file has them.
    """
    found, faults = dict(data), list[Fault]()
    if found.get("verb") not in VERBS:
        return found, faults
    if found.get("slip") == "traction":
        del found["slip"]
        found.setdefault("model", "quasi-static")
        expected = "model = 'quasi-static', which replaces slip = 'traction'"
        faults.append(Fault(("slip",), expected, "'traction'"))
    if "traction" in found:
        law = found.pop("traction")
        found.setdefault("law", {"coulomb": law})
        expected = "[law.coulomb], which replaces [traction], with model = 'quasi-static'"
        faults.append(Fault(("traction",), expected, "the old key 'traction'"))
    return found, faults
