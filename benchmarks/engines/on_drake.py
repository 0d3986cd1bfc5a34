"""Drake: discrete contact solver SAP, compliant balls on a rigid mesh (hydroelastic contact).

Balls on boxes touch at points.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    Mesh,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
)
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scenes import GAIN, ROTOR, SETTLING, Motion, Pose, Scene

STEPS = (0.01, 0.005, 0.002, 0.001, 0.0005)  # [s]
SERIES: dict[str, list[dict[str, Any]]] = {
    "Drake": [{"step": step} for step in STEPS],
    "Drake, fine": [{"step": step, "size": 0.01} for step in STEPS[:2]],
}
MODULUS = 1e8  # of the balls [Pa]
RESOLUTION = 1e-3  # of the rates, linear in between [s]


def motion(scene: Scene, pose: Pose, step: float, size: float | None = None) -> Motion:
    """Return the motion of a scene from a pose, with cells of the balls of a size [m]."""
    if scene.slabs and size:
        raise ValueError("balls touch boxes at points")
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, step)
    if scene.slabs:
        plant.set_contact_model(ContactModel.kPoint)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    properties = (
        "<drake:proximity_properties><drake:compliant_hydroelastic/>"
        f'<drake:hydroelastic_modulus value="{MODULUS}"/>'
        f'<drake:mesh_resolution_hint value="{size or 0.03}"/>'
        '<drake:hunt_crossley_dissipation value="10"/>'
        f'<drake:mu_dynamic value="{scene.friction}"/><drake:mu_static value="{scene.friction}"/>'
        "</drake:proximity_properties>"
    )
    urdf = scene.urdf.replace("</geometry></collision>", f"</geometry>{properties}</collision>")
    urdf = urdf.replace("<robot ", '<robot xmlns:drake="http://drake.mit.edu" ')
    Parser(plant).AddModelsFromString(urdf, "urdf")
    ground = ProximityProperties()
    AddRigidHydroelasticProperties(ground)
    AddContactMaterial(friction=CoulombFriction(scene.friction, scene.friction), properties=ground)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "ground.obj")
        shapes = [(RigidTransform(middle), Box(*(2 * half))) for middle, half in scene.boxes]
        if not shapes:
            scene.write_mesh(file)
            shapes = [(RigidTransform(), Mesh(str(file)))]
        for k, (place, shape) in enumerate(shapes):
            plant.RegisterCollisionGeometry(plant.world_body(), place, shape, f"ground_{k}", ground)
        wanted = []
        for index in plant.GetJointActuatorIndices():  # from the transmissions of the URDF
            servo = plant.get_joint_actuator(index)
            servo.set_default_rotor_inertia(ROTOR)
            servo.set_default_gear_ratio(1.0)
            servo.set_controller_gains(PdControllerGains(p=0.0, d=GAIN))
            wanted.append(list(scene.rates).index(servo.joint().name()))
        plant.Finalize()
        vehicle = plant.GetBodyByName("base").model_instance()
        fine = np.linspace(0, scene.t[-1], 1 + round(scene.t[-1] / RESOLUTION))
        rates = scene.rates_at(fine)[:, wanted]
        targets = PiecewisePolynomial.FirstOrderHold(fine, np.hstack([0 * rates, rates]).T)
        source = builder.AddSystem(TrajectorySource(targets))  # it holds the first rates before 0
        builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(vehicle))
        simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    inside = plant.GetMyMutableContextFromRoot(context)
    base = plant.GetBodyByName("base")
    place = RigidTransform(RotationMatrix(pose.rotation), pose.position)
    plant.SetFreeBodyPose(inside, base, place)
    for name, angle in pose.joints.items():
        plant.GetJointByName(name).set_angle(inside, angle)
    context.SetTime(0.0 if scene.raised else -round(SETTLING / step) * step)
    simulator.Initialize()
    simulator.AdvanceTo(0.0)
    poses, seconds = [], 0.0
    for t in scene.t:
        begin = time.process_time()
        simulator.AdvanceTo(t)
        seconds += time.process_time() - begin
        poses.append(plant.EvalBodyPoseInWorld(inside, base))
    return Motion(
        seconds,
        np.array([p.translation() for p in poses]),
        np.array([p.rotation().matrix() for p in poses]),
    )
