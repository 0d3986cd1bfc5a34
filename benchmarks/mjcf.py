"""Convert a vehicle on a map to a MuJoCo model, and simulate it."""

from __future__ import annotations

import time
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from slipfree import Grid
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.frame import Pose, unit_vector
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Joint, Vehicle, body_inertia, body_of
from slipfree.vehicle.wheel import Wheel, wheel_inertia

OPTION = {
    "integrator": "implicitfast",
    "cone": "elliptic",
    "impratio": "10",
    "gravity": "0 0 -9.81",
}
SOFTNESS = 0.004  # time constant of contacts, at least twice the largest step [s]
GAIN, ROTOR = "1000", "1"  # of servos [N m s/rad]; inertia of their rotors [kg m^2]: a lag of 1 ms
SPECK = 1e-9  # mass and moments of inertia of parts without mass, which MuJoCo refuses [kg, kg m^2]


def mujoco_model(vehicle: Vehicle, grid: Grid, mu: float, softness: float = SOFTNESS) -> Any:
    """Return the model of a vehicle on a height field with the nodes of a square map.

    Wheels are ellipsoids with the two radii of curvature of the torus at its tread. They have
    velocity servos with heavy rotors, which do not act on the carriers: without them the contact
    solver, which ignores the gain, treats wheels as easy to turn, and they slip by a few per cent.
    Joints on the same coordinate are coupled by equations. Commanded coordinates stay zero: their
    joints are rigid. Springs, dampers and stops are not written.
    """
    import mujoco

    low, relief, half = float(grid.z.min()), float(np.ptp(grid.z)), float(np.ptp(grid.x)) / 2
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "option", OPTION)
    asset, world, equality, actuator = (
        ElementTree.SubElement(root, name)
        for name in ("asset", "worldbody", "equality", "actuator")
    )
    rows, columns = map(str, grid.z.T.shape)
    field = {
        "name": "ground",
        "nrow": rows,
        "ncol": columns,
        "size": numbers(half, half, relief, 1),
    }
    ElementTree.SubElement(asset, "hfield", field)
    middle = numbers(grid.x.mean(), grid.y.mean(), low)
    _ground(world, mu, type="hfield", hfield="ground", pos=middle)
    parts = {"platform": ElementTree.SubElement(world, "body", name="platform")}
    ElementTree.SubElement(parts["platform"], "freejoint")
    leaders = dict[str, tuple[str, float]]()
    for joint in vehicle.joints:
        place = placed(joint.pose(dict.fromkeys(joint.coordinates, ca.SX(0))))
        part = ElementTree.SubElement(parts[joint.parent], "body", name=joint.name, **place)
        parts[joint.name] = part
        moved = moved_by(vehicle, joint)
        if moved is None:
            continue
        kind = "hinge" if joint.motion == "turn" else "slide"
        along = numbers(*unit_vector(joint.axis))
        ElementTree.SubElement(part, "joint", name=joint.name, type=kind, axis=along)
        leader, factor = leaders.setdefault(moved[0], (joint.name, moved[1]))
        if leader != joint.name:
            pair = {"joint1": joint.name, "joint2": leader, "solref": numbers(SOFTNESS, 1)}
            ratio = numbers(0, moved[1] / factor, 0, 0, 0)
            ElementTree.SubElement(equality, "joint", pair, polycoef=ratio)
    for name, part in parts.items():
        body, inertia = body_of(vehicle, name), body_inertia(vehicle, name)
        _inertial(part, body.mass, body.at, inertia)
    for wheel in vehicle.wheels:
        _wheel(parts[wheel.parent], wheel, mu)
        if wheel.driven:
            ElementTree.SubElement(actuator, "velocity", joint=f"wheel_{wheel.name}", kv=GAIN)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    model.geom_solref[:] = softness, 1.0
    model.hfield_data[:] = ((grid.z.T - low) / relief).ravel()
    return model


def moved_by(vehicle: Vehicle, joint: Joint) -> tuple[str, float] | None:
    """Return the coordinate to which a joint's value is proportional, and the factor.

    A rigid joint and one with a commanded coordinate have none.
    """
    names = joint.coordinates - {c.name for c in vehicle.of("commanded")}
    if not names:
        return None
    name, *others = names
    zero, one, two = (float(evaluate(joint.value, {name: ca.SX(k)})) for k in (0, 1, 2))
    if others or zero or two != 2 * one:
        raise ValueError(f"joint {joint.name!r}: expected a multiple of a coordinate")
    return name, one


def _wheel(part: ElementTree.Element, wheel: Wheel, mu: float) -> None:
    """Add a wheel to its part."""
    name, (tube, _) = f"wheel_{wheel.name}", wheel.section.torus_radii
    body = ElementTree.SubElement(part, "body", name=name, **placed(wheel.mount))
    rotor = {"armature": ROTOR} if wheel.driven else {}
    ElementTree.SubElement(body, "joint", rotor, name=name, type="hinge", axis="-1 0 0")
    axial, across = wheel_inertia(wheel)
    _inertial(body, wheel.mass, (0.0, 0.0, 0.0), np.diag([axial, across, across]))
    size = numbers(np.sqrt(tube * wheel.radius), wheel.radius, wheel.radius)
    _ground(body, mu * wheel.grip, type="ellipsoid", size=size, priority="1")


def _ground(body: ElementTree.Element, mu: float, **shape: str) -> None:
    """Add a shape in contact, without friction against spinning and rolling."""
    contact = {"friction": numbers(mu, 0, 0), "condim": "3"}
    ElementTree.SubElement(body, "geom", contact, **shape)


def _inertial(body: ElementTree.Element, mass: float, at: Any, inertia: Any) -> None:
    """Add mass, centre of mass and inertia tensor."""
    tensor = inertia if mass else SPECK * np.eye(3)
    order = [tensor[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    given = {"pos": numbers(*at), "fullinertia": numbers(*order), "mass": numbers(mass or SPECK)}
    ElementTree.SubElement(body, "inertial", given)


def placed(pose: Pose) -> dict[str, str]:
    """Return the attributes of a pose that is constant."""
    x, y, z, w = Rotation.from_matrix(np.array(ca.evalf(pose.rotation))).as_quat()
    return {"pos": numbers(*np.array(ca.evalf(pose.origin)).ravel()), "quat": numbers(w, x, y, z)}


def numbers(*values: float) -> str:
    """Return numbers as text for MuJoCo."""
    return " ".join(f"{float(value):.17g}" for value in values)


def settled(model: Any, vehicle: Vehicle, start: Trajectory, step: float) -> Any:
    """Return the state after a second at rest, with a step size, from a pose of ours."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:7] = [start[k][0] for k in ("x", "y", "z", *(f"attitude_{k}" for k in "wxyz"))]
    for joint in vehicle.joints:
        moved = moved_by(vehicle, joint)
        if moved is not None:
            data.joint(joint.name).qpos = moved[1] * start[moved[0]][0]
    model.opt.timestep = step
    mujoco.mj_step(model, data, round(1 / step))
    data.time = 0.0
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    return state


def driven(model: Any, state: Any, rates: Any, step: float) -> tuple[float, Any]:
    """Return the CPU time [s] of a motion and its states, one after each step and the first.

    ``rates`` are those of the driven wheels, a row for each step.
    """
    import mujoco
    from mujoco import rollout

    model.opt.timestep = step
    data = mujoco.MjData(model)
    begin = time.process_time()
    states, _ = rollout.rollout(model, data, state, rates)
    return time.process_time() - begin, np.vstack([state, states[0]])


class Motion:
    """Positions, headings and pitches of the platform: from states of MuJoCo, or of ours."""

    def __init__(self, states: Any) -> None:
        turned = Rotation.from_quat(states[:, [5, 6, 7, 4]]).as_matrix()
        self.position = states[:, 1:4]
        self.heading = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
        self.pitch = np.arctan2(turned[:, 2, 1], turned[:, 2, 2])
