"""PyBullet: sequential impulses with fixed steps, motors on wheels, height field or mesh."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient
from scenes import SETTLING, Motion, Pose, Scene
from scipy.spatial.transform import Rotation

STEPS = (1 / 120, 1 / 240, 1 / 480, 1 / 1000, 1 / 2000)  # [s]
SERIES: dict[str, list[dict[str, Any]]] = {
    "PyBullet": [{"step": step} for step in STEPS],
    "PyBullet, mesh": [{"step": step, "mesh": True} for step in STEPS],
}
ITERATIONS, TORQUE = 200, 1e3  # of the solver; of motors, more than needed [N m]


def ground_of(engine: Any, scene: Scene, mesh: bool) -> None:
    """Add the slabs, or the map as a height field or as a mesh."""
    for middle, half in scene.boxes:
        shape = engine.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
        body = engine.createMultiBody(0, shape, basePosition=middle)
        engine.changeDynamics(body, -1, lateralFriction=1.0)
    if scene.slabs and mesh:
        raise ValueError("slabs need no mesh")
    if scene.slabs:
        return
    z = scene.nodes
    if mesh:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "ground.obj")
            scene.write_mesh(file)
            shape = engine.createCollisionShape(
                pybullet.GEOM_MESH, fileName=str(file), flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH
            )
        place = [0.0, 0.0, 0.0]
    else:
        shape = engine.createCollisionShape(
            pybullet.GEOM_HEIGHTFIELD,
            meshScale=[np.diff(scene.x)[0], np.diff(scene.y)[0], 1.0],
            heightfieldData=z.T.ravel().tolist(),
            numHeightfieldRows=scene.x.size,
            numHeightfieldColumns=scene.y.size,
        )
        place = [scene.x.mean(), scene.y.mean(), (z.min() + z.max()) / 2]
    body = engine.createMultiBody(0, shape, basePosition=place)
    engine.changeDynamics(body, -1, lateralFriction=1.0)


def motion(scene: Scene, pose: Pose, step: float, mesh: bool = False) -> Motion:
    """Return the motion of a scene from a pose."""
    engine = BulletClient(pybullet.DIRECT)
    engine.setGravity(0, 0, -9.81)
    engine.setPhysicsEngineParameter(fixedTimeStep=step, numSolverIterations=ITERATIONS)
    ground_of(engine, scene, mesh)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "vehicle.urdf")
        file.write_text(scene.urdf)
        turned = Rotation.from_matrix(pose.rotation).as_quat()
        body = engine.loadURDF(
            str(file), pose.position, turned, flags=pybullet.URDF_USE_INERTIA_FROM_FILE
        )
    numbers = {
        engine.getJointInfo(body, k)[1].decode(): k for k in range(engine.getNumJoints(body))
    }
    for number in (-1, *numbers.values()):
        engine.changeDynamics(body, number, linearDamping=0, angularDamping=0)
    for name, number in numbers.items():
        if name.startswith("wheel_"):
            engine.changeDynamics(
                body, number, lateralFriction=scene.friction, rollingFriction=0, spinningFriction=0
            )
        else:
            engine.resetJointState(body, number, pose.joints[name])
        if name not in scene.rates:  # joints have motors by default
            engine.setJointMotorControl2(body, number, pybullet.VELOCITY_CONTROL, force=0)
    for one, other in scene.couplings.items():
        link = engine.createConstraint(
            body,
            numbers[one],
            body,
            numbers[other],
            pybullet.JOINT_GEAR,
            [0, 1, 0],
            [0] * 3,
            [0] * 3,
        )
        engine.changeConstraint(link, gearRatio=1, maxForce=1e5, erp=0.8)
    mass_center = engine.getDynamicsInfo(body, -1)[3]
    wheels = [numbers[name] for name in scene.rates]
    forces = [TORQUE] * len(wheels)

    def drive(rates: np.ndarray) -> None:
        engine.setJointMotorControlArray(
            body, wheels, pybullet.VELOCITY_CONTROL, targetVelocities=rates, forces=forces
        )
        engine.stepSimulation()

    count = round(scene.t[-1] / step)
    rates = scene.rates_at(step * np.arange(count))
    if not scene.raised:
        for _ in range(round(SETTLING / step)):
            drive(rates[0])
    wanted, poses = set(np.round(scene.t / step).astype(int)), []
    seconds = 0.0
    for k in range(count + 1):
        if k in wanted:
            at, turned = engine.getBasePositionAndOrientation(body)  # of the centre of mass
            rotation = np.reshape(engine.getMatrixFromQuaternion(turned), (3, 3))
            poses.append((at - rotation @ mass_center, rotation))
        if k < count:
            begin = time.process_time()
            drive(rates[k])
            seconds += time.process_time() - begin
    engine.disconnect()
    return Motion(seconds, np.array([p for p, _ in poses]), np.array([r for _, r in poses]))
