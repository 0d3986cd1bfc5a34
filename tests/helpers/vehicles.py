"""Vehicles that several tests drive."""

from slipfree.vehicle.tree import Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import Wheel


def skid_steered():
    """Return a vehicle with two driven wheels and a ball."""
    return Vehicle(
        "skid_steered",
        (),
        (),
        (
            Wheel("right", "platform", (0.5, 0.0, 0.0), 0.05, 0.15, driven=True),
            Wheel("left", "platform", (-0.5, 0.0, 0.0), 0.05, 0.15, driven=True),
            Wheel("front", "platform", (0.0, 0.6, 0.0), 0.2, 0.0, driven=False),
        ),
    )


def four_wheels(*, rock):
    """A four-wheeler whose front axle rocks about its forward axis, or not."""
    kind = "suspension" if rock else "passive"
    origin, size = (0.0, 0.0, 0.0), (0.03, 0.12)
    return Vehicle(
        "four_wheeler",
        (Coordinate("rock", kind, "front axle"), Coordinate("steer", "commanded", "steering")),
        (
            Joint("axle", "platform", "y", (0.0, 0.7, 0.0), "rock"),
            Joint("right_knuckle", "axle", "z", (0.3, 0.0, 0.0), "steer"),
            Joint("left_knuckle", "axle", "z", (-0.3, 0.0, 0.0), "steer"),
        ),
        (
            Wheel("rear_right", "platform", (0.3, 0.0, 0.0), *size, driven=True),
            Wheel("rear_left", "platform", (-0.3, 0.0, 0.0), *size, driven=True),
            Wheel("front_right", "right_knuckle", origin, *size, driven=False),
            Wheel("front_left", "left_knuckle", origin, *size, driven=False),
        ),
    )
