"""MuJoCo: soft contacts, implicit integration, elliptic cones, servos with heavy rotors."""

from __future__ import annotations

import time
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from scenes import GAIN, ROTOR, SETTLING, Motion, Pose, Scene

STEPS = (0.004, 0.002, 0.001, 0.0005, 0.00025)  # [s]
SERIES: dict[str, list[dict[str, Any]]] = {
    "MuJoCo": [{"step": step} for step in STEPS],
    "MuJoCo, no-slip": [{"step": step, "noslip": 10} for step in STEPS],
}


def model_of(scene: Scene, step: float, noslip: int) -> Any:
    """Return the model of a scene."""
    spec = mujoco.MjSpec.from_string(scene.urdf)
    spec.body("base").add_freejoint()
    for geom in spec.geoms:
        geom.friction, geom.priority, geom.condim = [scene.friction, 0, 0], 1, 3
        geom.solref = [max(2 * step, 0.002), 1]
        geom.contype, geom.conaffinity = 1, 2
    ground = {"contype": 2, "conaffinity": 1}
    if scene.slabs:
        for middle, half in scene.boxes:
            box = mujoco.mjtGeom.mjGEOM_BOX
            spec.worldbody.add_geom(type=box, pos=middle, size=half, **ground)
    else:
        z = scene.nodes
        low, relief = float(z.min()), max(float(np.ptp(z)), 1e-3)
        half = [float(np.ptp(scene.x)) / 2, float(np.ptp(scene.y)) / 2]
        spec.add_hfield(
            name="ground",
            nrow=scene.y.size,
            ncol=scene.x.size,
            size=[*half, relief, 1.0],
            userdata=((z.T - low) / relief).ravel(),
        )
        middle = [float(scene.x.mean()), float(scene.y.mean()), low]
        field = mujoco.mjtGeom.mjGEOM_HFIELD
        spec.worldbody.add_geom(type=field, hfieldname="ground", pos=middle, **ground)
    for wheel in scene.rates:
        spec.joint(wheel).armature = ROTOR
        servo = spec.add_actuator(name=wheel, target=wheel, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_velocity(kv=GAIN)
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.option.noslip_iterations = noslip
    return spec.compile()


def motion(scene: Scene, pose: Pose, step: float, noslip: int = 0) -> Motion:
    """Return the motion of a scene from a pose."""
    model = model_of(scene, step, noslip)
    data = mujoco.MjData(model)
    data.qpos[:3] = pose.position
    mujoco.mju_mat2Quat(data.qpos[3:7], pose.rotation.ravel())
    for joint, angle in pose.joints.items():
        data.joint(joint).qpos = angle
    if not scene.raised:
        mujoco.mj_step(model, data, round(SETTLING / step))
    data.time = 0.0
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    rates = scene.rates_at(step * np.arange(round(scene.t[-1] / step)))
    begin = time.process_time()
    states, _ = rollout.rollout(model, data, state, rates)
    seconds = time.process_time() - begin
    states = np.vstack([state, states[0]])[np.round(scene.t / step).astype(int)]
    turned = np.empty((scene.t.size, 9))
    for matrix, row in zip(turned, states, strict=True):
        mujoco.mju_quat2Mat(matrix, row[4:8])
    return Motion(seconds, states[:, 1:4], turned.reshape(-1, 3, 3))
