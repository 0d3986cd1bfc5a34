"""Unknowns of a calibration: numbers of a vehicle, of a law, and of the sensor that measures poses.

An unknown is a number of the model, by the name of its quantity: a rolling radius, the track, the
centre of mass, a grip, a constant of the law such as ``creep``, or an offset of the sensor. The
same functions set numbers and expressions in parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, get_type_hints

import casadi as ca
from annotated_types import DocInfo, Unit

from slipfree.core.dae import Dae, Parameter
from slipfree.core.errors import ModelError
from slipfree.core.records import Label
from slipfree.geometry.frame import Vector
from slipfree.vehicle.sections import Disc, Omni, Section, Sphere, Torus
from slipfree.vehicle.tree import Vehicle
from slipfree.vehicle.wheel import Wheel

CREEP = "creep"  # constant of laws that is their continuation parameter


@dataclass(frozen=True)
class Unknown:
    """A number to be fitted.

    Attributes
    ----------
    name : str
        Name in results.
    quantity : str
        One of `QUANTITIES`, one of `SENSOR`, or a constant of the law.
    wheels : tuple of str
        Names of the wheels that share the number, for a quantity of wheels; empty for all wheels.
    lower, upper : float
        Bounds, in the unit of the quantity; infinite for none.
    prior : tuple of 2 floats or None
        Mean and standard deviation of a normal prior, in the unit of the quantity.

    Raises
    ------
    ModelError
        If the bounds are not in ascending order, or the deviation of the prior is not positive.
    """

    name: str
    quantity: str
    wheels: tuple[str, ...] = ()
    lower: float = -math.inf
    upper: float = math.inf
    prior: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ModelError(
                f"unknown {self.name!r}: expected a lower bound below the upper one, found "
                f"{self.lower:g} and {self.upper:g}"
            )
        if self.prior is not None and not 0 < self.prior[1] < math.inf:
            raise ModelError(
                f"unknown {self.name!r}: expected a finite positive standard deviation of the "
                f"prior, found {self.prior[1]:g}"
            )


class Quantity(NamedTuple):
    """A number of a vehicle."""

    unit: str  # unit and description
    words: str
    read: Callable[[Vehicle, Sequence[str]], float]  # ``read(vehicle, wheels)``
    set: Callable[[Vehicle, Sequence[str], Any], Vehicle]  # ``set(vehicle, wheels, value)``


def _on_wheels(
    read: Callable[[Wheel], float], change: Callable[[Wheel, Any], Wheel]
) -> tuple[Callable[..., float], Callable[..., Vehicle]]:
    """Return the functions of a quantity that several wheels share."""

    def read_all(vehicle: Vehicle, wheels: Sequence[str]) -> float:
        values = [read(wheel) for wheel in vehicle.wheels if wheel.name in wheels]
        return sum(values) / len(values)

    def set_all(vehicle: Vehicle, wheels: Sequence[str], value: Any) -> Vehicle:
        changed = (change(w, value) if w.name in wheels else w for w in vehicle.wheels)
        return replace(vehicle, wheels=tuple(changed))

    return read_all, set_all


def _resized(wheel: Wheel, radius: Any) -> Wheel:
    """Return a wheel with another rolling radius and the same tube."""
    return replace(wheel, section=_section(wheel.section, radius, wheel.name))


def _section(section: Section, radius: Any, name: str) -> Section:
    if isinstance(section, Omni):
        return replace(section, rim=_section(section.rim, radius, name))
    if section.torus_radii is None:
        raise ModelError(
            f"wheel {name!r}: expected a torus, disc or sphere, whose radius can be fitted, found "
            f"{section}"
        )
    tube, circle = section.torus_radii
    if tube and circle:
        return Torus(tube, radius - tube)
    return Disc(radius) if circle else Sphere(radius)


def lateral_places(vehicle: Vehicle) -> list[tuple[Wheel, float]]:
    """Return the wheels and the lateral places of their centres, joints at zero [m]."""
    return [*zip(vehicle.wheels, vehicle.centers[:, 0].tolist(), strict=True)]


def track(vehicle: Vehicle) -> float:
    """Return the lateral distance between the outermost wheels' centres, joints at zero [m]."""
    places = [place for _, place in lateral_places(vehicle)]
    return max(places) - min(places)


def _with_track(vehicle: Vehicle, _: Sequence[str], value: Any) -> Vehicle:
    """Return a vehicle whose lateral distances between joints and wheels grow with the track."""
    factor = value / track(vehicle.numeric)

    def wider(at: Vector) -> Any:
        return at[0] * factor, at[1], at[2]

    return replace(
        vehicle,
        joints=tuple(replace(joint, at=wider(joint.at)) for joint in vehicle.joints),
        wheels=tuple(replace(wheel, at=wider(wheel.at)) for wheel in vehicle.wheels),
    )


def _center(axis: int) -> tuple[Callable[..., float], Callable[..., Vehicle]]:
    """Return the functions of one coordinate of the platform's centre of mass."""

    def read(vehicle: Vehicle, _: Sequence[str]) -> float:
        return vehicle.body.at[axis]

    def change(vehicle: Vehicle, _: Sequence[str], value: Any) -> Vehicle:
        at = (*vehicle.body.at[:axis], value, *vehicle.body.at[axis + 1 :])
        return replace(vehicle, body=replace(vehicle.body, at=at))

    return read, change


QUANTITIES: dict[str, Quantity] = {
    "radius": Quantity("m", "rolling radius of wheels", *_on_wheels(lambda w: w.radius, _resized)),
    "track": Quantity(
        "m",
        "lateral distance between the outermost wheels",
        lambda vehicle, _: track(vehicle),
        _with_track,
    ),
    "grip": Quantity(
        "1",
        "factor that multiplies the ground's coefficient of friction",
        *_on_wheels(lambda w: w.grip, lambda w, value: replace(w, grip=value)),
    ),
    "center_of_mass_right": Quantity(
        "m", "centre of mass of the platform, to the right", *_center(0)
    ),
    "center_of_mass_ahead": Quantity("m", "centre of mass of the platform, ahead", *_center(1)),
    "center_of_mass_up": Quantity("m", "centre of mass of the platform, upwards", *_center(2)),
}
SENSOR: dict[str, Label] = {
    "sensor_right": Label("sensor_right", "m", "position of the sensor, to the right"),
    "sensor_ahead": Label("sensor_ahead", "m", "position of the sensor, ahead"),
    "sensor_heading": Label("sensor_heading", "rad", "orientation of the sensor, left positive"),
}


def label_of(unknown: Unknown, law: Any) -> Label:
    """Return name, unit and description of an unknown."""
    if unknown.quantity in QUANTITIES:
        quantity = QUANTITIES[unknown.quantity]
        return Label(unknown.name, quantity.unit, quantity.words)
    if unknown.quantity in SENSOR:
        return replace(SENSOR[unknown.quantity], name=unknown.name)
    constants = law_constants(law)
    if unknown.quantity not in constants:
        known = ", ".join((*QUANTITIES, *SENSOR, *constants))
        raise ModelError(
            f"unknown {unknown.name!r}: expected one of the quantities {known}, found "
            f"{unknown.quantity!r}; correct it"
        )
    return replace(constants[unknown.quantity], name=unknown.name)


def limits_of(unknown: Unknown, vehicle: Vehicle, law: Any) -> tuple[float, float]:
    """Return the bounds of an unknown within which the vehicle and the law are valid."""
    least, most = unknown.lower, unknown.upper
    if unknown.quantity == "radius":
        names = _wheels(unknown, vehicle)
        tubes = [(w.section.torus_radii or (0.0,))[0] for w in vehicle.wheels if w.name in names]
        least = max(least, *tubes)
    elif unknown.quantity in ("track", "grip"):
        least = max(least, 0.0)
    elif unknown.quantity in law_constants(law):
        least, most = law_limits(unknown, law)
    return least, most


def law_limits(unknown: Unknown, law: Any) -> tuple[float, float]:
    """Return the bounds of a constant of a law: its own, and those of its annotation."""
    least, most = unknown.lower, unknown.upper
    hint = get_type_hints(type(law), include_extras=True)[unknown.quantity]
    for bound in getattr(hint, "__metadata__", ()):
        least = max(least, getattr(bound, "gt", least), getattr(bound, "ge", least))
        most = min(most, getattr(bound, "lt", most), getattr(bound, "le", most))
    return least, most


def law_constants(law: Any) -> dict[str, Label]:
    """Return the constants of a law, by name, from the annotations of its dataclass."""
    hints, constants = get_type_hints(type(law), include_extras=True), {}
    for each in fields(law):
        metadata = getattr(hints[each.name], "__metadata__", ())
        unit = next((m.unit for m in metadata if isinstance(m, Unit)), "1")
        words = next((m.documentation for m in metadata if isinstance(m, DocInfo)), "")
        constants[each.name] = Label(each.name, unit, words)
    return constants


def value_of(unknown: Unknown, vehicle: Vehicle, law: Any) -> float:
    """Return the value of an unknown in a vehicle and a law; zero for those of the sensor."""
    if unknown.quantity in QUANTITIES:
        return QUANTITIES[unknown.quantity].read(vehicle, _wheels(unknown, vehicle))
    return 0.0 if unknown.quantity in SENSOR else float(getattr(law, unknown.quantity))


def with_unknowns(vehicle: Vehicle, unknowns: Sequence[Unknown], values: Sequence[Any]) -> Vehicle:
    """Return a vehicle with other values of its unknowns, numbers or expressions."""
    changed = vehicle
    for unknown, value in zip(unknowns, values, strict=True):
        if unknown.quantity in QUANTITIES:
            quantity = QUANTITIES[unknown.quantity]
            changed = quantity.set(changed, _wheels(unknown, vehicle), value)
            if isinstance(value, ca.SX):
                changed = replace(changed, nominal=vehicle)
    return changed


def law_with_unknowns(law: Any, unknowns: Sequence[Unknown], values: Sequence[Any]) -> Any:
    """Return a law with other values of its unknowns, numbers or expressions."""
    pairs = zip(unknowns, values, strict=True)
    own = {each.quantity: value for each, value in pairs if each.quantity in law_constants(law)}
    return replace(law, **own)


def parametric_model(
    build: Callable[[Vehicle, Any], Dae], vehicle: Vehicle, law: Any, unknowns: Sequence[Unknown]
) -> Dae:
    """Return a model in which the fitted quantities are parameters."""
    labels = [label_of(each, law) for each in unknowns]
    symbols = [ca.SX.sym(label.name) for label in labels]
    values = [value_of(each, vehicle, law) for each in unknowns]
    others = [
        (each, symbol)
        for each, symbol in zip(unknowns, symbols, strict=True)
        if each.quantity != CREEP
    ]
    symbolic = with_unknowns(vehicle, *zip(*others, strict=True)) if others else vehicle
    new_law = law_with_unknowns(law, *zip(*others, strict=True)) if others else law
    model = build(symbolic, new_law)
    parameters = list[Parameter]()
    for unknown, label, symbol, value in zip(unknowns, labels, symbols, values, strict=True):
        if unknown.quantity in SENSOR:
            continue
        if unknown.quantity == CREEP:
            if model.continuation is None:
                raise ModelError(f"unknown {unknown.name!r}: the law has no creep speed to fit")
            symbol = model.continuation.symbol
        parameters.append(Parameter(label, symbol, value))
    return replace(model, p=tuple(parameters))


def _wheels(unknown: Unknown, vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of the wheels of an unknown; raise ModelError for unknown names."""
    names = tuple(wheel.name for wheel in vehicle.wheels)
    for name in unknown.wheels:
        if name not in names:
            raise ModelError(
                f"unknown {unknown.name!r}: expected wheels of the vehicle, {', '.join(names)}, "
                f"found {name!r}; correct it"
            )
    return unknown.wheels or names
