"""Cross-sections of wheels: convex curves that generate surfaces of revolution about the axle.

The outward unit normal of a wheel has an axial and a radial component. The section maps them to the
point of the wheel with that normal. Contact, Montana's equations, the certificate of a single
contact and drawings all follow from this map.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import lru_cache
from math import degrees, pi
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.schema import Length, Radius

Faces = npt.NDArray[np.uint32]


class TriangleMesh(NamedTuple):
    """A triangle mesh: vertices (n, 3) [m], and faces (m, 3).

    Faces are the indices of three vertices, counter-clockwise seen from outside.
    """

    vertices: Array
    faces: Faces


def sheet(points: Array, closed: tuple[bool, bool] = (False, False)) -> TriangleMesh:
    """Return the mesh through a grid of points (n, m, 3) [m].

    ``closed`` is whether the last line of points connects to the first, for each direction.
    """
    n, m, _ = points.shape
    i, j = (
        np.arange(size if each else size - 1) for size, each in zip((n, m), closed, strict=True)
    )
    first, right = i[:, None] * m, ((i + 1) % n)[:, None] * m
    here, up = j[None, :], ((j + 1) % m)[None, :]
    a, b, c, d = first + here, right + here, right + up, first + up
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2)
    return TriangleMesh(points.reshape(-1, 3), faces.reshape(-1, 3).astype(np.uint32))


AXLE = ca.SX(ca.DM([1, 0, 0]))  # direction of the axle in the wheel's axes
FACES_AROUND, FACES_ACROSS = 36, 6  # faces of a mesh around the wheel, and across its tread
MIN_DRAWN_HALF_WIDTH = 0.04  # smallest half-width of a mesh, in rolling radii
CLOSED_EDGE_RADIUS = 1e-9  # smaller edges of a tread lie on the axle, in rolling radii
ARC_LENGTH_POINTS = 721  # points of a table of arc lengths


@dataclass(frozen=True)
class Section(ABC):
    """Cross-section of a wheel, a body of revolution about its axle.

    A subclass is a frozen dataclass that defines `profile`; its fields are of the type
    `slipfree.core.schema.Length`. The other methods follow from it; a subclass overrides one where
    a closed form has fewer operations.

    Raises
    ------
    ModelError
        If a dimension is not positive and finite.
    """

    @property
    def rollers(self) -> float | None:
        """Angle from the wheel's axle to the axles of free rollers; None without rollers [rad]."""
        return None

    @property
    def torus_radii(self) -> tuple[float, float] | None:
        """Radii of the tube and of the circle of tube centres; None if this is not a torus [m].

        A torus with ``r1 = 0`` is a disc, one with ``r2 = 0`` a sphere.
        """
        return None

    def __str__(self) -> str:
        """Return the kind of section and its dimensions [m], as in ``torus r1 0.05, r2 0.25 m``."""
        sizes = ", ".join(f"{each.name} {getattr(self, each.name):g}" for each in fields(self))
        return f"{type(self).__name__.lower()} {sizes} m"

    @abstractmethod
    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the point of the section with a given outward normal.

        Parameters
        ----------
        axial, radial : SX, shape (1, 1)
            Components of the unit normal along the axle and perpendicular to it,
            ``radial >= 0``. [1]

        Returns
        -------
        tuple of 2 SX, shape (1, 1)
            Axial and radial coordinates of the point, from the wheel's centre. [m]
        """

    def support(self, normal: ca.SX, axle: ca.SX = AXLE) -> ca.SX:
        """Return the point of the surface with a given outward normal, from the wheel's centre.

        Parameters
        ----------
        normal : SX, shape (3, 1)
            Outward unit normal, not parallel to the axle. [1]
        axle : SX, shape (3, 1)
            Unit vector of the axle in the frame of the normal, by default the x axis. [1]

        Returns
        -------
        SX, shape (3, 1)
            Position of the point relative to the wheel's centre, in the frame of the normal. [m]
        """
        axial, radial, away = components(normal, axle)
        x, rho = self.profile(axial, radial)
        return x * axle + rho * away

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        """Return the point of the surface for angles of the outward normal, shape (3, 1) [m].

        Parameters
        ----------
        u : SX, shape (1, 1)
            Angle from the axle to the normal; pi/2 is the middle of the tread. [rad]
        v : SX, shape (1, 1)
            Angle about the axle, 3 pi/2 at the lowest point of an upright wheel. [rad]

        Notes
        -----
        The point is in the wheel's axes. The cross product of its derivatives with respect to ``u``
        and ``v`` points outward.
        """
        x, rho = self.profile(ca.cos(u), ca.sin(u))
        return ca.vertcat(x, ca.cos(v) * rho, ca.sin(v) * rho)

    def tread_radius(self, axial: ca.SX, radial: ca.SX) -> ca.SX:
        """Return the radius of curvature of the section for a normal; zero at an edge [m].

        Parameters are those of `profile`.
        """
        normal = ca.SX.sym("normal", 2)
        turn = ca.vertcat(-normal[1], normal[0])
        point = ca.vertcat(*self.profile(normal[0], normal[1]))
        bend = ca.dot(turn, ca.jtimes(point, normal, turn))
        return ca.substitute(bend, normal, ca.vertcat(axial, radial))

    def outline(self, u: Array) -> tuple[Array, Array]:
        """Return points of the section at given angles of the normal.

        Parameters
        ----------
        u : ndarray, any shape
            Angles from the axle to the normal, 0 to pi. [rad]

        Returns
        -------
        x, rho : ndarray, shape of ``u``
            Axial and radial coordinates. [m]
        """
        flat = np.ravel(u)[None]
        x, rho = _curve(self, flat.size)(flat)
        return x.full().reshape(np.shape(u)), rho.full().reshape(np.shape(u))

    def mesh(self) -> TriangleMesh:
        """Return a mesh of the wheel's surface about the x axis, for drawings.

        If the edges of the tread do not reach the axle, the mesh is a ring; its inner side mirrors
        the tread at the edge, as in a tube. A section narrower than 0.04 rolling radii is drawn
        with that width; the rolling radius does not change.
        """
        x, rho = self.outline(np.array([0, np.pi / 2, np.pi]))
        added = max(0.0, MIN_DRAWN_HALF_WIDTH * rho[1] - np.abs(x).max())

        def drawn(u: Array) -> tuple[Array, Array]:
            x, rho = self.outline(u)
            return x + added * np.cos(u), rho + added * (np.sin(u) - 1)

        fine = np.linspace(0, np.pi, ARC_LENGTH_POINTS)
        arc = _lengths(*drawn(fine))
        x, rho = drawn(np.interp(np.linspace(arc[-1], 0, FACES_ACROSS + 1), arc, fine))
        edge = min(rho[0], rho[-1])
        is_ring = edge > CLOSED_EDGE_RADIUS * rho.max()
        if is_ring:
            x = np.append(x, x[-2:0:-1])
            rho = np.append(rho, np.maximum(2 * edge - rho[-2:0:-1], 0))
        v = 2 * np.pi * np.arange(FACES_AROUND)[:, None] / FACES_AROUND
        ring = np.broadcast_arrays(x, np.cos(v) * rho, np.sin(v) * rho)
        return sheet(np.stack(ring, axis=-1), closed=(True, is_ring))


def components(normal: ca.SX, axle: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the axial and radial components of a unit normal, and the radial unit vector.

    Parameters are those of `Section.support`.
    """
    axial, radial = ca.dot(normal, axle), ca.norm_2(ca.cross(-normal, axle))
    return axial, radial, (normal - axial * axle) / radial


@lru_cache(maxsize=64)
def arc_lengths(section: Section) -> tuple[Array, Array]:
    """Return n angles of the normal from 0 to pi [rad], and arc lengths of the section there [m].

    Both have shape (n,). The arc length is zero at angle zero.
    """
    u = np.linspace(0, np.pi, ARC_LENGTH_POINTS)
    return u, _lengths(*section.outline(u))


def _lengths(x: Array, rho: Array) -> Array:
    return np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(rho))))


@lru_cache(maxsize=64)
def _curve(section: Section, count: int) -> ca.Function:
    """Return a CasADi function from ``count`` angles of the normal to points of a section."""
    u = ca.SX.sym("u")
    point = (ca.densify(ca.SX(each)) for each in section.profile(ca.cos(u), ca.sin(u)))
    return ca.Function("profile", [u], [*point]).map(count)


@dataclass(frozen=True)
class RoundSection(Section):
    """Circular section: a tube around the wheel, also of radius zero, or about the centre."""

    @property
    @abstractmethod
    def torus_radii(self) -> tuple[float, float]:
        """Radii of the tube and of the circle of tube centres [m]."""

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return axial and radial coordinates of the point with a given outward normal [m]."""
        r1, r2 = self.torus_radii
        return r1 * axial, r2 + r1 * radial

    def outline(self, u: Array) -> tuple[Array, Array]:
        """Return axial and radial coordinates [m] of points at given angles of the normal."""
        r1, r2 = self.torus_radii
        return r1 * np.cos(u), r2 + r1 * np.sin(u)

    def support(self, normal: ca.SX, axle: ca.SX = AXLE) -> ca.SX:
        """Return the point of the surface with a given outward normal, shape (3, 1) [m].

        It is ``r1 n + r2 e`` with the normal ``n`` and the unit vector ``e`` along the component of
        ``n`` perpendicular to the axle.
        """
        r1, r2 = self.torus_radii
        return r1 * normal + r2 * components(normal, axle)[2]

    def tread_radius(self, axial: ca.SX, radial: ca.SX) -> ca.SX:  # noqa: ARG002 - constant
        """Return the radius of the tube, the same for every normal [m]."""
        return self.torus_radii[0] + 0 * axial  # SX or MX, as the normal


@checked
@dataclass(frozen=True)
class Disc(RoundSection):
    """A thin disc.

    Attributes
    ----------
    radius : float
        Radius of the edge. [m]
    """

    radius: Length

    @property
    def torus_radii(self) -> tuple[float, float]:
        """Radii of the disc as a torus [m]."""
        return 0.0, self.radius


@checked
@dataclass(frozen=True)
class Sphere(RoundSection):
    """Spherical wheel that rotates about an axle through its centre.

    Attributes
    ----------
    radius : float
        Radius of the ball. [m]
    """

    radius: Length

    @property
    def torus_radii(self) -> tuple[float, float]:
        """Radii of the sphere as a torus [m]."""
        return self.radius, 0.0


@checked
@dataclass(frozen=True)
class Torus(RoundSection):
    """Torus: a wheel with a circular tread section.

    Attributes
    ----------
    r1 : float
        Radius of the tube. [m]
    r2 : float
        Radius of the circle of tube centres; the rolling radius is ``r1 + r2``. [m]
    """

    r1: Length
    r2: Length

    @property
    def torus_radii(self) -> tuple[float, float]:
        """Radii of the tube and of the circle of tube centres [m]."""
        return self.r1, self.r2


@checked
@dataclass(frozen=True)
class Omni(Section):
    """Omni or mecanum wheel: free rollers whose common envelope has the shape of a wheel.

    The rollers turn freely about their axles. The contact point therefore moves freely across the
    axle of the roller that touches the ground; slip has a cost, and friction acts, only along this
    axle. The wheel is one body of revolution: the change from roller to roller is neglected.

    Attributes
    ----------
    rim : Section
        Cross-section of the envelope of all rollers.
    angle : float
        Angle from the wheel's axle to the axle of the roller at the contact, seen from above, on a
        wheel upright on level ground: counter-clockwise positive, other than zero, between -pi/2
        and pi/2. The wheel's axle points to the right of its forward direction. An omni wheel has
        the angle pi/2: its rollers' axles are along its forward direction. A mecanum wheel has
        pi/4 if the axle of the roller on the ground points forward on its right side, and -pi/4 if
        it points forward on its left side; on top of the wheel, the axles are mirror images. [rad]

    Raises
    ------
    ModelError
        If the angle is zero, since no drive could act on the ground, or not between -pi/2 and pi/2.

    Notes
    -----
    On the ground, seen from above, for the angle pi/4::

                   forward
                      |     / axle of the roller
                      |   /
                      | /
           left ------o------> axle of the wheel

    In the usual arrangement of four mecanum wheels, the rollers on top form an X, seen from above,
    and those on the ground an O: the angle is positive in front on the left and in the rear on the
    right, negative at the other two wheels. If the signs are reversed, all four rollers' axles on
    the ground point approximately to the middle of the vehicle, about which the wheels can then
    hardly turn it.
    """

    rim: Section
    angle: float = pi / 2

    def __post_init__(self) -> None:
        if not 0 < abs(self.angle) <= pi / 2:
            raise ModelError(
                "rollers: expected an angle between -90 and 90 degrees from the wheel's axle to "
                "the axles of the rollers, other than zero, at which no drive could act on the "
                f"ground, found {degrees(self.angle) + 0.0:.6g} degrees; give 90 degrees for an "
                "omni wheel, or 45 or -45 degrees for a mecanum wheel"
            )

    def __str__(self) -> str:
        """Return the kind and dimensions of the rim, followed by the angle of the rollers."""
        return f"{self.rim} on rollers at {degrees(self.angle):.6g} degrees"

    @property
    def rollers(self) -> float:
        """Angle from the wheel's axle to the rollers' axles [rad]."""
        return self.angle

    @property
    def torus_radii(self) -> tuple[float, float] | None:
        """Radii of the rim as a torus; None if it is not one [m]."""
        return self.rim.torus_radii

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the point of the rim's section with a given outward normal.

        Parameters
        ----------
        axial, radial : SX, shape (1, 1)
            Components of the unit normal, as in `Section.profile`. [1]

        Returns
        -------
        tuple of 2 SX, shape (1, 1)
            Axial and radial coordinates of the point, from the wheel's centre. [m]
        """
        return self.rim.profile(axial, radial)

    def support(self, normal: ca.SX, axle: ca.SX = AXLE) -> ca.SX:
        """Return the point of the rim's surface with a given outward normal.

        Parameters
        ----------
        normal, axle : SX, shape (3, 1)
            Unit vectors in one frame, as in `Section.support`. [1]

        Returns
        -------
        SX, shape (3, 1)
            Position relative to the wheel's centre, in the frame of the normal. [m]
        """
        return self.rim.support(normal, axle)

    def tread_radius(self, axial: ca.SX, radial: ca.SX) -> ca.SX:
        """Return the radius of curvature of the rim's section for an outward normal.

        Parameters
        ----------
        axial, radial : SX, shape (1, 1)
            Components of the unit normal, as in `Section.profile`. [1]

        Returns
        -------
        SX, shape (1, 1)
            Radius, zero at an edge. [m]
        """
        return self.rim.tread_radius(axial, radial)


SECTIONS: dict[str, type[Section]] = {"torus": Torus, "disc": Disc, "sphere": Sphere}


@checked
def section_of_radii(r1: Radius, r2: Radius, *, rollers: float | None = None) -> Section:
    """Return the torus of two radii; a disc for ``r1 = 0``, a sphere for ``r2 = 0``.

    ``r1`` is the radius of the tube, ``r2`` that of the circle of tube centres [m]; ``rollers`` the
    angle of free rollers, as in `Omni`, None without rollers. ModelError is raised for negative or
    infinite radii, if both are zero, and for invalid angles.
    """
    if r1 + r2 <= 0:
        raise ModelError("r1, r2: expected a positive radius, found two zeros; increase r1 or r2")
    section = Disc(r2) if r1 == 0 else Sphere(r1) if r2 == 0 else Torus(r1, r2)
    return section if rollers is None else Omni(section, rollers)
