"""Differential geometry of a parametrised surface ``c(u, v)``.

The forms are those of Montana [1]_ for a Gauss frame from Gram-Schmidt orthogonalisation; they also
hold where ``c_u`` and ``c_v`` are not orthogonal, as on a height map.

References
----------
.. [1] D. J. Montana, "The kinematics of contact and grasp", Int. J. Robotics Research 7(3), 1988,
       pp. 17-32, section 2.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca


class Forms(NamedTuple):
    """Metric, curvature and torsion forms of a surface at a point.

    Attributes
    ----------
    metric : SX, shape (2, 2)
        Upper triangular ``M`` in ``[c_u c_v] = [x y] M``. [m per unit of u, v]
    curvature : SX, shape (2, 2)
        ``K = [x y]' [n_u n_v] M^-1``, positive where the surface bends away from ``n``. [1/m]
    torsion : SX, shape (1, 2)
        ``T = y' [x_u x_v] M^-1``. [1/m]
    """

    metric: ca.SX
    curvature: ca.SX
    torsion: ca.SX


class Patch(NamedTuple):
    """Point, Gauss frame and forms of a surface.

    Attributes
    ----------
    point : SX, shape (3, 1)
        The point ``c``. [m]
    frame : SX, shape (3, 3)
        Gauss frame ``[x y n]``: ``x`` along ``c_u``, ``n`` along ``c_u x c_v``. [1]
    forms : Forms
        The three forms in that frame.
    """

    point: ca.SX
    frame: ca.SX
    forms: Forms


def patch(c: ca.SX, uv: ca.SX) -> Patch:
    """Return the Gauss frame and the forms of a surface at its point ``c(uv)``.

    Parameters
    ----------
    c : SX, shape (3, 1)
        The surface, twice continuously differentiable and regular. [m]
    uv : SX, shape (2, 1)
        Symbols of its parameters.
    """
    c_u, c_v = ca.horzsplit(ca.densify(ca.jacobian(c, uv)))
    c_uu, c_uv = ca.horzsplit(ca.densify(ca.jacobian(c_u, uv)))
    c_vv = ca.densify(ca.jacobian(c_v, uv[1]))
    return patch_of(c, (c_u, c_v), (c_uu, c_uv, c_vv))


def patch_of(c: ca.SX, tangents: tuple[ca.SX, ca.SX], seconds: tuple[ca.SX, ca.SX, ca.SX]) -> Patch:
    """Return the Gauss frame and the forms of a surface from its derivatives at a point.

    Parameters
    ----------
    c : SX, shape (3, 1)
        The point. [m]
    tangents : tuple of 2 SX, shape (3, 1)
        ``c_u, c_v``.
    seconds : tuple of 3 SX, shape (3, 1)
        ``c_uu, c_uv, c_vv``.

    Notes
    -----
    The frame is not differentiated, since ``n`` is normal to ``c_u`` and ``c_v``, and ``y`` to
    ``c_u``: ``K = -M^-T II M^-1`` with the second fundamental form
    ``II = n . [c_uu c_uv; c_uv c_vv]``, and ``y . x_u = y . c_uu / |c_u|``.
    """
    (c_u, c_v), (c_uu, c_uv, c_vv) = tangents, seconds
    area = ca.cross(c_u, c_v)
    x, n = c_u / ca.norm_2(c_u), area / ca.norm_2(area)
    y = ca.cross(n, x)
    metric = ca.blockcat([[ca.norm_2(c_u), ca.dot(x, c_v)], [0, ca.dot(y, c_v)]])
    to_arc = inverse(metric)
    across = ca.dot(n, c_uv)
    second = ca.blockcat([[ca.dot(n, c_uu), across], [across, ca.dot(n, c_vv)]])
    turning = ca.horzcat(ca.dot(y, c_uu), ca.dot(y, c_uv)) / metric[0, 0]
    forms = Forms(metric, -to_arc.T @ second @ to_arc, turning @ to_arc)
    return Patch(c, ca.horzcat(x, y, n), forms)


def inverse(matrix: ca.SX) -> ca.SX:
    """Return the inverse of a matrix of shape (2, 2)."""
    (a, b), (c, d) = (ca.horzsplit(row) for row in ca.vertsplit(matrix))
    return ca.blockcat([[d, -b], [-c, a]]) / (a * d - b * c)
