"""Vehicles shared by several tests."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from slipfree.vehicle.sections import Sphere, Torus
from slipfree.vehicle.tree import Coordinate, Joint, Vehicle, Wheel


def part_frames(vehicle, run, origin=(0.0, 0.0, 0.0)):
    """Return origins (n, 3) and rotations of all parts by name, by elementary geometry.

    ``run`` has the samples of the pose and of all coordinates; origins count from ``origin``.
    """
    angles = np.stack([run[name] for name in ("heading", "roll", "pitch")], -1)
    place = np.stack([run[name] for name in "xyz"], -1) - origin
    parts = {"platform": (place, Rotation.from_euler("ZYX", angles))}
    for joint in vehicle.joints:
        place, turn = parts[joint.parent]
        sign = -1 if joint.value.startswith("-") else 1
        value = sign * run[joint.value.lstrip("-")][:, None] * np.eye(3)["xyz".index(joint.axis)]
        slides = joint.motion == "slide"
        place = place + turn.apply(joint.at + value * slides)
        parts[joint.name] = place, turn * Rotation.from_rotvec(value * (not slides))
    return parts


def skid_steered():
    """Return a vehicle with two driven wheels and a ball."""
    return Vehicle(
        "skid_steered",
        (),
        (),
        (
            Wheel("right", "platform", (0.5, 0.0, 0.0), Torus(0.05, 0.15), driven=True),
            Wheel("left", "platform", (-0.5, 0.0, 0.0), Torus(0.05, 0.15), driven=True),
            Wheel("front", "platform", (0.0, 0.6, 0.0), Sphere(0.2), driven=False),
        ),
    )


def all_steered():
    """Return a vehicle with three driven wheels, each steered on its own."""
    places = {"fr": (0.4, 0.5), "fl": (-0.4, 0.5), "b": (0.0, -0.5)}
    return Vehicle(
        "all_steered",
        tuple(Coordinate(f"steer_{k}", "commanded", "steering") for k in places),
        tuple(Joint(k, "platform", "z", (*at, 0.0), f"steer_{k}") for k, at in places.items()),
        tuple(Wheel(k, k, (0.0, 0.0, 0.0), Torus(0.03, 0.12), driven=True) for k in places),
    )


def four_wheels(*, rock):
    """A four-wheeler whose front axle rocks about its forward axis, or not."""
    kind = "suspension" if rock else "passive"
    origin, section = (0.0, 0.0, 0.0), Torus(0.03, 0.12)
    return Vehicle(
        "four_wheeler",
        (Coordinate("rock", kind, "front axle"), Coordinate("steer", "commanded", "steering")),
        (
            Joint("axle", "platform", "y", (0.0, 0.7, 0.0), "rock"),
            Joint("right_knuckle", "axle", "z", (0.3, 0.0, 0.0), "steer"),
            Joint("left_knuckle", "axle", "z", (-0.3, 0.0, 0.0), "steer"),
        ),
        (
            Wheel("rear_right", "platform", (0.3, 0.0, 0.0), section, driven=True),
            Wheel("rear_left", "platform", (-0.3, 0.0, 0.0), section, driven=True),
            Wheel("front_right", "right_knuckle", origin, section, driven=False),
            Wheel("front_left", "left_knuckle", origin, section, driven=False),
        ),
    )


def four_wheel_steered(**steering):
    """Return a four-wheeler with a rocking front axle; all wheels are driven and steered.

    Keywords are those of the steered coordinates, such as stops.
    """
    vehicle = Vehicle(
        "four_wheel_steered",
        (Coordinate("rock", "suspension", "front axle"),),
        (Joint("axle", "platform", "y", (0.0, 0.4, 0.0), "rock"),),
        tuple(
            Wheel(f"{end}_{side}", parent, (x, y, 0.0), Torus(0.03, 0.12), driven=True)
            for end, parent, y in (("front", "axle", 0.0), ("rear", "platform", -0.4))
            for side, x in (("right", 0.3), ("left", -0.3))
        ),
    )
    for wheel in vehicle.wheels:
        name = f"steer_{wheel.name}"
        words = f"steering angle of wheel {wheel.name}, left positive"
        vehicle = replace(
            vehicle,
            coordinates=(*vehicle.coordinates, Coordinate(name, "commanded", words, **steering)),
            joints=(*vehicle.joints, Joint(name, wheel.parent, "z", wheel.at, name)),
            wheels=tuple(
                replace(w, parent=name, at=(0.0, 0.0, 0.0)) if w is wheel else w
                for w in vehicle.wheels
            ),
        )
    return vehicle
