"""Motions of vehicles of any size: all lengths of a problem are multiplied by a scale."""

from collections.abc import Callable
from dataclasses import fields, replace
from functools import lru_cache

import casadi as ca
import numpy as np

import slipfree as sf
from helpers.cases import PAPER_RATES, hills
from slipfree.catalog import open_source_rover, three_wheeler
from slipfree.core.dae import power_of_length
from slipfree.laws.protocols import SlipLaw
from slipfree.models.given_rates import PLANAR
from slipfree.solve.collocation import drive
from slipfree.solve.settle import settle_contact
from slipfree.vehicle.sections import Section

TOLERANCE = 1e-8
OPTIONS = sf.SolverOptions(tolerance=TOLERANCE)
KINEMATIC = {"m", "m2", "m-1", "rad", "s-1", "1"}  # units without force
SIDE = np.linspace(-5.0, 5.0, 41)  # nodes of the map at scale 1 [m]


def scaled(vehicle: sf.Vehicle, scale: float) -> sf.Vehicle:
    """Return a vehicle with all its lengths times a scale; its masses stay."""

    def times(place: tuple[float, float, float]) -> tuple[float, float, float]:
        return place[0] * scale, place[1] * scale, place[2] * scale

    return replace(
        vehicle,
        joints=tuple(
            replace(j, at=times(j.at), body=replace(j.body, at=times(j.body.at)))
            for j in vehicle.joints
        ),
        wheels=tuple(
            replace(w, at=times(w.at), section=_scaled_section(w.section, scale))
            for w in vehicle.wheels
        ),
        body=replace(vehicle.body, at=times(vehicle.body.at)),
    )


def _scaled_section(section: Section, scale: float) -> Section:
    sizes = {each.name: getattr(section, each.name) * scale for each in fields(section)}
    return replace(section, **sizes)


def formula(scale: float) -> sf.Analytic:
    return sf.Analytic(lambda x, y: scale * hills(x / scale, y / scale))


@lru_cache
def grid() -> sf.Grid:
    x, y = np.meshgrid(SIDE, SIDE, indexing="ij")
    return sf.Grid(SIDE, SIDE, sf.Analytic(hills).elevation(x, y))


def bicubic(scale: float) -> sf.Bicubic:
    nodes = grid()
    return sf.Bicubic(sf.Grid(nodes.x * scale, nodes.y * scale, nodes.z * scale))


Ground = Callable[[float], sf.Analytic | sf.Bicubic]


def direct(
    scale: float,
    ground: Ground,
    slip: SlipLaw = sf.LeastSlip(),  # noqa: B008
    end: float = 6.0,
) -> sf.Trajectory:
    dae = sf.direct_kinematics(scaled(three_wheeler(), scale), ground(scale), slip=slip)
    start = sf.settle(dae, x=0.3 * scale, heading=0.2)
    t = np.linspace(0, end, 121)
    return sf.simulate(dae, start, dae.inputs(**PAPER_RATES), t, options=OPTIONS)


def to_the_edge(scale: float) -> sf.Trajectory:
    """Drive off the map, which ends the motion."""
    dae = sf.direct_kinematics(scaled(three_wheeler(), scale), bicubic(scale))
    start = sf.settle(dae, x=0.3 * scale, y=3.5 * scale)
    inputs = dae.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    return sf.simulate(dae, start, inputs, np.linspace(0, 6, 121), options=OPTIONS)


def montana(scale: float) -> sf.Trajectory:
    vehicle, ground = scaled(three_wheeler(), scale), bicubic(scale)
    start = sf.settle(sf.direct_kinematics(vehicle, ground), x=0.3 * scale, heading=0.2)
    dae = sf.montana_kinematics(vehicle, ground)
    inputs = dae.inputs(**PAPER_RATES)
    return sf.simulate(dae, start, inputs, np.linspace(0, 6, 121), options=OPTIONS)


def inverse(scale: float, solve_for: str) -> sf.Trajectory:
    """Follow the paper's platform rates, from a start that moves."""
    vehicle, ground = scaled(three_wheeler(), scale), bicubic(scale)
    dae = sf.direct_kinematics(vehicle, ground, slip=sf.Rolling())
    inputs = dae.inputs(right_rate=0.45, left_rate=0.42, steer_rate=0.0)
    start = sf.simulate(dae, sf.settle(dae, heading=0.1), inputs, np.linspace(0, 0.1, 3))
    back = sf.inverse_kinematics(vehicle, ground, given=PLANAR, solve_for=solve_for)
    given = back.inputs(velocity_x=0.01255 * scale, velocity_y=0.12865 * scale, heading_rate=0.0159)
    return sf.simulate(back, start, given, np.linspace(0, 4, 41), options=OPTIONS)


def path(scale: float, ground: Ground) -> sf.Trajectory:
    """Follow a circle by collocation."""
    vehicle, place = scaled(three_wheeler(), scale), ground(scale)
    dae = sf.direct_kinematics(vehicle, place)
    back = sf.inverse_kinematics(vehicle, place, given=PLANAR, solve_for="rates", least_margin=0.0)
    start = sf.settle(dae, x=-scale, heading=1.0)
    heading, radius = 1.0 + 0.02 * back.t, 6.75 * scale
    x = -scale + radius * (ca.cos(heading) - np.cos(1.0))
    y = radius * (ca.sin(heading) - np.sin(1.0))
    t = np.linspace(0, 6, 61)
    rates = zip(PLANAR, (x, y, heading), strict=True)
    inputs = back.inputs(**{name: ca.jacobian(each, back.t) for name, each in rates})
    return drive(back, start, inputs, t, free_states=["steer"], options=OPTIONS).run


def rover(scale: float) -> sf.Trajectory:
    """Drive a rover with six wheels, four steered, at given forward speed and yaw rate."""
    dae = sf.inverse_kinematics(
        scaled(open_source_rover(), scale), bicubic(scale), given=("forward", "yaw_rate")
    )
    start = sf.settle(dae, heading=0.1)
    inputs = dae.inputs(forward=0.1 * scale, yaw_rate=0.05)
    return sf.simulate(dae, start, inputs, np.linspace(0, 3, 31), options=OPTIONS)


def from_a_contact(scale: float) -> sf.Trajectory:
    dae = sf.direct_kinematics(scaled(three_wheeler(), scale), bicubic(scale))
    place = {"contact_x": 0.2 * scale, "contact_y": 0.8 * scale}
    return settle_contact(dae, "front", heading=0.1, **place)


CASES: dict[str, Callable[[float], sf.Trajectory]] = {
    "direct, formula": lambda scale: direct(scale, formula),
    "direct, map": lambda scale: direct(scale, bicubic),
    "direct, no slip": lambda scale: direct(scale, bicubic, sf.Rolling()),
    "direct, to the edge": to_the_edge,
    "Montana": montana,
    "inverse, steering rate": lambda scale: inverse(scale, "rates"),
    "inverse, steering angle": lambda scale: inverse(scale, "angles"),
    "path, formula": lambda scale: path(scale, formula),
    "path, map": lambda scale: path(scale, bicubic),
    "rover, speed and yaw": rover,
    "start from a contact": from_a_contact,
}


def difference(first: sf.Trajectory, run: sf.Trajectory, scale: float) -> tuple[str, float]:
    """Return the quantity that differs most from the motion at scale 1, scaled, and by how much.

    In units of the tolerance; a stop, whose time is located to a microsecond, is left out.
    """
    count = min(first.t.size, run.t.size) - (first.stop is not None)
    worst = "", 0.0
    for name in first:
        unit = first.columns[name].label.unit
        exact = name.endswith("_residual") or name in ("newton_step", "clearance")
        if exact or not set(unit.split()) <= KINEMATIC:
            continue
        values = run[name][:count] / scale ** power_of_length(unit)
        gap = float(np.abs(values - first[name][:count]).max()) / TOLERANCE
        if not gap <= worst[1]:
            worst = name, gap
    return worst
