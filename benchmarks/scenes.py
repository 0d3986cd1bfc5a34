"""Scenes of the comparison of engines: vehicles on balls as URDF, grounds as nodes, wheel rates.

Wheels are balls, which every engine represents exactly. All engines get the same text, the same
nodes and the same rates; x points ahead. A new engine needs a `Scene`, and returns a `Motion`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

RADIUS, HALF_TRACK, HALF_BASE = 0.15, 0.3, 0.35  # of the balls and between them [m]
MASS, WHEEL_MASS, LINK_MASS = 20.0, 1.0, 1.0  # [kg]
AXLE = 0.2  # side of the cube with the inertia of an axle [m]
RISE = 0.5  # time in which wheels reach their rate [s]
CELL = 0.05  # of the map [m]
SETTLING = 0.5  # time for which engines hold the wheels before the motion [s]
# of servos [N m s/rad]; inertia of their rotors, with a lag of 1 ms [kg m^2]
GAIN, ROTOR = 1000.0, 1.0


class Scene(NamedTuple):
    """A vehicle on a ground, driven by given rates of its wheels."""

    urdf: str  # vehicle; the joints of its wheels are called wheel_..., passive ones otherwise
    couplings: Mapping[str, str]  # joints that turn by the same angle against each other
    height: Callable[[Any, Any, Any], Any]  # true ground [m] at x, y [m], by numpy or CasADi
    x: np.ndarray  # nodes of the map, from low to high [m]
    y: np.ndarray
    friction: float
    start: tuple[float, float, float]  # x, y [m] and heading from the x axis [rad]
    raised: float  # above its pose at rest, from which it falls [m]
    # of the driven wheels [rad/s]: even ones, which `share` precedes, or those at the samples
    rates: Mapping[str, float | np.ndarray]
    t: np.ndarray  # times of the samples [s]
    # beginnings along x and heights of slabs, which are the ground in place of the map [m]
    slabs: tuple[tuple[float, float], ...] = ()
    slip_stiffness: float = np.inf  # of the wheels, force over load and slip velocity [s/m]

    @property
    def nodes(self) -> np.ndarray:
        """Heights of the nodes, shape (x, y) [m]."""
        return self.height(*np.meshgrid(self.x, self.y, indexing="ij"), np) + np.zeros(
            (self.x.size, self.y.size)
        )

    @property
    def boxes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Centres and half sizes of the slabs [m]; the first one is the floor."""
        low, high, side, floor = self.x[0], self.x[-1], self.y[-1], -1.0
        return [
            (
                np.array([max(x, low) + high, 0.0, floor + z]) / 2,
                np.array([high - max(x, low), 2 * side, z - floor]) / 2,
            )
            for x, z in self.slabs
        ]

    def rates_at(self, t: np.ndarray) -> np.ndarray:
        """Return the rates of the driven wheels at times, shape (n, wheels) [rad/s]."""
        sampled = np.ndim(next(iter(self.rates.values()))) > 0
        columns = (
            np.interp(t, self.t, rate) if sampled else rate * share(np.maximum(t, 0))
            for rate in self.rates.values()
        )
        return np.column_stack(list(columns))

    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """Return vertices [m] and faces of the map as a mesh, counterclockwise from above."""
        x, y = np.meshgrid(self.x, self.y, indexing="ij")
        number = np.arange(x.size).reshape(x.shape)
        a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
        faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
        return np.column_stack([x.ravel(), y.ravel(), self.nodes.ravel()]), faces

    def write_mesh(self, file: Path) -> None:
        """Write the map as a mesh (.obj)."""
        vertices, faces = self.triangles()
        lines = ["v {} {} {}".format(*vertex) for vertex in vertices]
        lines += ["f {} {} {}".format(*(face + 1)) for face in faces]
        file.write_text("\n".join(lines))


class Pose(NamedTuple):
    """Pose from which an engine begins."""

    position: np.ndarray  # of the root link [m]
    rotation: np.ndarray  # of the root link, shape (3, 3)
    joints: Mapping[str, float]  # angles of the passive joints [rad]


class Motion(NamedTuple):
    """What an engine returns."""

    seconds: float  # CPU time of the motion, without preparation and settling [s]
    position: np.ndarray  # of the root link at the samples, shape (n, 3) [m]
    rotation: np.ndarray  # of the root link at the samples, shape (n, 3, 3)


def share(t: Any, of: Any = np) -> Any:
    """Return the share of the even rate that wheels have at a time, by numpy or CasADi."""
    return of.tanh((t / RISE) ** 2)


def _link(name: str, mass: float, size: float, ball: float = 0.0) -> str:
    """Return a link as a ball, or without shape and with the inertia of a cube of a size [m]."""
    inertia = 0.4 * mass * ball**2 if ball else mass * size**2 / 6
    shape = f'<collision><geometry><sphere radius="{ball}"/></geometry></collision>'
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="{inertia}" '
        f'iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"{shape if ball else ''}</link>"
    )


def _joint(
    name: str, parent: str, at: tuple[float, float, float], axis: str, more: str = ""
) -> str:
    """Return a joint to the link of the same name without the first word."""
    kind = "continuous" if name.startswith("wheel_") else "revolute"
    limit = "" if kind == "continuous" else '<limit lower="-1" upper="1" effort="0" velocity="99"/>'
    child = name.partition("_")[2]
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at[0]} {at[1]} {at[2]}"/><axis xyz="{axis}"/>{limit}{more}</joint>'
    )


class Size(NamedTuple):
    """Size of a cart."""

    radius: float = RADIUS  # of the balls [m]
    half_track: float = HALF_TRACK  # [m]
    half_base: float = HALF_BASE  # [m]
    ahead: float = 0.0  # place of the centre of mass [m]
    gyration: float = 0.053  # square of the radius of gyration about the vertical [m^2]


def _urdf(name: str, platform: tuple[float, float], parts: list[str], driven: str) -> str:
    """Return a vehicle; the platform is a cube of a size [m], with its centre ahead [m]."""
    ahead, size = platform
    base = _link("base", MASS, size).replace("<mass", f'<origin xyz="{ahead} 0 0"/><mass')
    drives = "".join(
        f'<transmission name="drive_{wheel}"><type>SimpleTransmission</type><joint name="{wheel}"/>'
        f'<actuator name="motor_{wheel}"/></transmission>'
        for wheel in re.findall(f'joint name="(wheel_{driven}[^"]*)"', "".join(parts))
    )
    return f'<robot name="{name}">{base}{"".join(parts)}{drives}</robot>'


def cart(driven: str = "", size: Size = Size()) -> str:  # noqa: B008 - immutable
    """Return a cart on four balls, whose front axle rocks; by default all carry the same load.

    ``driven`` is the beginning of the names of the driven wheels; others turn freely.
    """
    base, at_axles = size.half_base, size.half_base**2 + size.half_track**2
    total = MASS + LINK_MASS + 4 * WHEEL_MASS
    ahead = (size.ahead * total - LINK_MASS * base) / MASS
    others = LINK_MASS * (AXLE**2 / 6 + base**2)
    others += 4 * WHEEL_MASS * (0.4 * size.radius**2 + at_axles)
    about_middle = (size.gyration + size.ahead**2) * total
    spread = float(np.sqrt(6 * ((about_middle - others) / MASS - ahead**2)))
    parts = [_joint("rock_axle", "base", (base, 0, 0), "1 0 0"), _link("axle", LINK_MASS, AXLE)]
    for end, parent, x in (("front", "axle", 0.0), ("rear", "base", -base)):
        for side, y in (("left", size.half_track), ("right", -size.half_track)):
            name = f"{end}_{side}"
            parts += [
                _joint(f"wheel_{name}", parent, (x, y, 0), "0 1 0"),
                _link(name, WHEEL_MASS, 0, size.radius),
            ]
    return _urdf("cart", (ahead, spread), parts, driven)


def rocker_bogie() -> str:
    """Return a rover with six driven balls, rockers joined by a differential, and bogies."""
    parts = []
    for side, y in (("left", HALF_TRACK), ("right", -HALF_TRACK)):
        same = '<mimic joint="rock_left_rocker" multiplier="-1"/>' if side == "right" else ""
        parts += [
            _joint(f"rock_{side}_rocker", "base", (0, y, 0), "0 1 0", same),
            _link(f"{side}_rocker", LINK_MASS, 0.2),
            _joint(f"rock_{side}_bogie", f"{side}_rocker", (-0.25, 0, 0), "0 1 0"),
            _link(f"{side}_bogie", LINK_MASS, 0.2),
        ]
        for end, parent, x in (
            ("front", "rocker", 0.45),
            ("middle", "bogie", 0.2),
            ("rear", "bogie", -0.2),
        ):
            name = f"{end}_{side}"
            parts += [
                _joint(f"wheel_{name}", f"{side}_{parent}", (x, 0, -0.1), "0 1 0"),
                _link(name, WHEEL_MASS, 0, RADIUS),
            ]
    return _urdf("rover", (0.0, 0.3), parts, "")
