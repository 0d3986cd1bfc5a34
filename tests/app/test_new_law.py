"""Add a slip law, a wheel-ground law: one file and one line of registration each.

The class `WeightedSlip` below is the file ``laws/weighted.py`` (14 lines without docstrings and
imports), and ``"weighted": WeightedSlip`` the line of ``SLIP_LAWS`` in ``problem/schema.py``;
`Viscous` with its record is ``laws/viscous.py`` (19 lines), and ``"viscous": Viscous`` the line of
``GROUND_LAWS``. Nothing else of the package knows them: problem files, commands, results and both
formulations of the contact take them as they are.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from annotated_types import Gt, Unit
from numpy.testing import assert_allclose

from helpers.commands import printed, sets
from slipfree.core.records import Label
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import read
from slipfree.laws import protocols
from slipfree.laws.least_slip import LeastSlip, Multipliers, stationarity
from slipfree.problem.schema import GROUND_LAWS, SLIP_LAWS
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle


@dataclass(frozen=True)
class WeightedSlip:
    """Least slip with a weight for the slip across the wheels.

    Attributes
    ----------
    across : float
        Weight of squared slip across the wheels. [1]
    """

    across: Annotated[float, Gt(0), Unit("1")]

    def check(self, vehicle: Vehicle) -> None:
        """Accept every vehicle."""

    def unknowns(self, vehicle: Vehicle, constraints: tuple[Label, ...]) -> Multipliers:
        """Return the labels of the multipliers."""
        return LeastSlip().unknowns(vehicle, constraints)

    def equations(self, motion: protocols.Motion, unknowns: Multipliers) -> protocols.Equations:
        """Return the stationarity conditions."""
        cost = ca.SX(0)
        for contact, slip in zip(motion.contacts, motion.slips, strict=True):
            cost += ca.dot(contact.along, slip) ** 2 / 2
            cost += self.across * ca.dot(contact.across, slip) ** 2 / 2
        return stationarity(cost, motion, unknowns)


class Loads(NamedTuple):
    """Normal forces. [N]."""

    normal: tuple[Any, ...]


@dataclass(frozen=True)
class Viscous:
    """Force against the slip, in proportion to slip and load.

    Attributes
    ----------
    drag : float
        Force for each newton of load and m/s. [s/m]
    """

    drag: Annotated[float, Gt(0), Unit("s/m")] = 100.0

    def check(self, vehicle: Vehicle, terrain: Terrain) -> None:
        """Accept every vehicle and ground."""

    def unknowns(self, vehicle: Vehicle) -> Loads:
        """Return the labels of the normal forces."""
        return Loads(protocols.quantity_labels(vehicle, "force_normal"))

    def reaction(self, contacts: protocols.SlidingContacts, unknowns: Loads) -> protocols.Reaction:
        """Return the forces, and the conditions that wheels stay on the ground."""
        along, across = (
            tuple(-self.drag * n * s for n, s in zip(unknowns.normal, slips, strict=True))
            for slips in (contacts.along, contacts.across)
        )
        words = "normal velocity of the contact point"
        labels = protocols.wheel_labels(contacts.vehicle, "touching", "m s-1", words)
        equations = protocols.Equations(labels, ca.vertcat(*contacts.normal))
        return protocols.Reaction(along, across, unknowns.normal, equations)


PROBLEM = """\
verb = "direct"
terrain.file = "plane.npz"
vehicle = {{ catalog = "three_wheeler", axle = "fixed" }}
start.x = 0.0
inputs = {{ right_rate = {right}, left_rate = {left}, steer_rate = 0.0 }}
time = {{ duration = 1.0, step = 0.25 }}
{model}
"""
SLOPE = 0.2  # of the ground, to the right [1]


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(SLIP_LAWS, "weighted", WeightedSlip)
    monkeypatch.setitem(GROUND_LAWS, "viscous", Viscous)


def driven(slope: float, model: str, right: float, left: float, *settings: str) -> Trajectory:
    """Return the motion on a plane that rises to the right, solved by ``slipfree run``."""
    nodes = np.linspace(-4, 4, 17)
    rise = np.repeat(slope * nodes[:, None], nodes.size, axis=1)
    np.savez("plane.npz", x=nodes, y=nodes, z=rise)
    Path("p.toml").write_text(PROBLEM.format(model=model, right=right, left=left))
    printed("run", "p.toml", "--no-draw", *sets(*settings))
    return read(Path("p.nc"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weight", "formulation"), [(0.01, "montana"), (1.0, "closure"), (25.0, "closure")]
)
def test_a_slip_law_decides_how_a_rigid_axle_turns(weight: float, formulation: str) -> None:
    """Turning slips across all wheels, going straight along the driven ones.

    With half the track ``d``, the wheelbase ``l`` and half the rims' difference in speed ``v``,
    ``2 (d w - v)^2 + 2/3 weight l^2 w^2`` is least at the yaw rate ``w``.
    """
    model = f'slip = "weighted"\nformulation = "{formulation}"\nlaw.weighted.across = {weight}'
    run = driven(0.0, model, 0.55, 0.45)
    (x_r, x_l, _), (y_r, _, y_f) = run["center_x"][0], run["center_y"][0]
    track, base = (x_r - x_l) / 2, y_f - y_r
    rim = (run["center_z"] - run["contact_z"])[0, 0] * (0.55 - 0.45) / 2
    yaw = rim * track / (track**2 + weight * base**2 / 3)
    drift = 10 * 1e-8 if formulation == "montana" else 0  # kappa times the tolerance
    assert_allclose(run["heading_rate"], yaw, rtol=1e-9, atol=drift)
    assert run["multiplier"].shape == (5, 3)
    assert run.attributes["law"] == "weighted"
    if weight == 1.0:
        least = driven(0.0, f'slip = "least"\nformulation = "{formulation}"', 0.55, 0.45)
        assert_allclose(run["heading"], least["heading"], atol=1e-12)
        assert run.columns["multiplier"].label == least.columns["multiplier"].label


def test_a_wheel_ground_law_decides_how_fast_a_vehicle_slides() -> None:
    """Across a slope all wheels slide sideways alike: ``drag N s`` bears the weight's part."""
    run = driven(SLOPE, 'model = "quasi-static"\n[law.viscous]\ndrag = 5.0', 0.0, 0.0)
    assert run.stop is None
    assert_allclose(run["slip_across"], -SLOPE / 5, rtol=1e-9)
    assert_allclose(run["slip_along"], 0, atol=1e-9)
    cosine = np.cos(np.arctan(SLOPE))
    assert_allclose(run["x"][-1], -SLOPE / 5 * cosine, rtol=1e-6)
    assert_allclose(run["force_across"], SLOPE * run["force_normal"], rtol=1e-9)
    assert run["force_normal"].sum(axis=1) == pytest.approx(36 * 9.81 * cosine)
    assert run.attributes["law"] == "viscous"
    assert "a quasi-static prediction by the wheel-ground law 'viscous'" in printed("info", "p.nc")
    facts = printed("vehicle", "p.toml", "--verbose")
    assert "force_normal[right]" in facts
    assert "9: the wheel-ground law determines them" in facts
