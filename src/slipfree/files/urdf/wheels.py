"""Wheels and casters of a URDF: recognition and guesses; position, size, mass and drive."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.urdf.evidence import (
    CASTER,
    FOOTPRINT,
    MECANUM,
    OMNI,
    STEERING,
    TRAILER,
    UNITS,
    USUAL,
    WHEEL,
    Evidence,
    evidence,
    weigh,
    wheel_evidence,
)
from slipfree.files.urdf.links import wheel_name
from slipfree.files.urdf.meshes import MeshFiles, angles_to, mesh_shape, unit_factor, unit_words
from slipfree.files.urdf.tree import (
    MAX_ECCENTRICITY,
    STEEP,
    Findings,
    Link,
    MeshFile,
    Shape,
    Tree,
    UrdfJoint,
    UrdfTable,
    WheelRole,
    eccentricity,
    is_about,
    lowest,
)
from slipfree.files.vehicle_toml import (
    Value,
    angle_text,
    placed,
    rotation_of,
    toml_line,
    toml_value,
    vector_of,
)
from slipfree.geometry.frame import ORIGIN, Vector, tensor, unit_vector
from slipfree.vehicle.sections import section_of_radii
from slipfree.vehicle.tree import Wheel

MIN_AXLE_LEFT = 1e-6  # a wheel with a smaller leftward component of its axle rolls sideways
MASS_OFFSET = 1e-3  # larger distances of a wheel's centre of mass from its centre are reported [m]
RIGHT = (0.0, -1.0, 0.0)
ALIKE = 0.2  # largest relative difference of the radii of opposite wheels
NEARLY = 0.02  # largest such difference that is not reported
TRAIL, MAX_TRAIL = 0.2, 2.0  # trail of wheels that swivel freely [radii]; longer ones articulate
SMALL_CASTER = 0.8  # largest radius of casters without a name or a swivel [radius of others]
PARALLEL = 0.9  # least cosine of the angle between parallel axles
BALL_TOUCH = 0.1  # a ball touches the ground of the wheels within this part of its radius
FULL_TURN = 6.2  # least range of joints whose limits are those of a careless export [rad]
MIN_ROLLERS = 4  # least number of a wheel with rollers
MIN_ROLLER_ANGLE = 10.0  # least angle of rollers [degrees]
SAME_ANGLE = 0.95  # least length of the mean of unit vectors at twice the angles of rollers
SMALL = 1e-3  # smaller vectors between places have no direction [m]
LARGEST = 2.5  # radius above that of all tyres [m]
SIDES = "left", "right"
CONTRADICTION = 0.05  # least relative difference of sizes that contradict each other


class Wheels:
    """Recognition and conversion of the wheels of a URDF that faces forward along x.

    Attributes are the URDF with the round shapes of meshes (``tree``), the joints that carry wheels
    (``joints``), the names of those that slide freely in all directions (``balls``), and by joint
    of a round shape that carries no wheel (``gears``) the table and values of the other choice with
    the reason.
    """

    def __init__(self, tree: Tree, roles: UrdfTable, findings: Findings) -> None:
        self._roles, self._findings = roles, findings
        tree, rollers = with_fixed_rollers(tree)
        self._unread: dict[str, str] = {}
        self.tree = self._with_mesh_shapes(_with_fixed_shapes(tree))
        self._given: dict[str, WheelRole] = {**roles.wheels}
        shaped = [j for j in self.tree.joints.values() if self._has_wheel_shape(j)]
        guesses = dict(wheel_guesses(self.tree, shaped, self._unread, roles)) | rollers
        joints = [
            joint
            for joint in self.tree.joints.values()
            if joint in shaped or joint.name in {*guesses, *roles.wheels}
        ]
        undeclared = [joint for joint in joints if joint.name not in roles.wheels]
        paired = self._compare_counterparts(joints)
        gears: dict[str, tuple[str, dict[str, Value], str]] = {}
        for name, reason in self._high(undeclared, paired):
            gears[name] = "wheels", {"driven": True}, f"no wheel but fixed: {reason}"
        for joint in self.tree.turning:
            if self.tree.is_last(joint) and any(w in self.tree.below(joint.child) for w in joints):
                reason = "fixed: wheels are fixed to it"
                gears[joint.name] = "joints", {"kind": "commanded"}, reason
        self.gears = {name: gear for name, gear in gears.items() if name not in roles.joints}
        self.joints = [joint for joint in joints if joint.name not in self.gears]
        for joint in self.joints:
            if joint.name in guesses:
                self._add_guess(joint, guesses[joint.name])
        # wheels measured in a mesh are guesses, unreadable meshes of moving joints are errors
        for joint in self.joints:
            shape = self._shape(joint)
            if shape is not None and shape.kind == "mesh" and joint.name not in self._given:
                values = {"radius": shape.radius, "tube": shape.tube or self._roles.tube}
                other = toml_line("joints", joint.name, kind="fixed")
                self._findings.guess("wheels", joint.name, values, "a wheel: a round mesh", other)
        alike = defaultdict[str, list[UrdfJoint]](list)
        for name, message in self._unread.items():
            joint = self.tree.joints[name]
            if joint not in self.joints and joint.moves:
                alike[re.sub("'.*?'", "", message)].append(joint)  # with the names of the meshes
        for joints in alike.values():
            radius, first = usual_radius(self.tree, joints), self._unread[joints[0].name]
            line = self._radius_line(joints, radius)
            self._findings.ask(joints, f"{first}; or measure the radius:", line)
            # the description of the vehicle has these wheels, too
            self.joints += joints
            self._given |= {joint.name: WheelRole(radius=radius) for joint in joints}
        for name, guess in sliding_wheels(self.tree, self.joints):
            self._add_guess(self.tree.joints[name], guess)
        bare = [joint for joint in self.joints if self._role(joint).rollers is None]
        for name, guess in mecanum_wheels(self.tree, bare):
            self._add_guess(self.tree.joints[name], guess)
        self.balls = {
            name for name, role in self._given.items() if role.rollers and role.driven is False
        }
        self._casters = caster_wheels(
            self.tree, [wheel for wheel in self.joints if wheel.name not in self.balls]
        )
        self._check_radii()
        for joint in bare:
            if OMNI.search(joint.names) and self._role(joint).rollers is None:
                self._add_guess(joint, wheel_evidence(WheelRole(rollers=False), "bare"))

    def _role(self, joint: UrdfJoint) -> WheelRole:
        return self._given.get(joint.name, WheelRole())

    def wheel(self, joint: UrdfJoint, part_of: Mapping[str, str]) -> Wheel | None:
        """Return the wheel of a joint, in axes x forward, y left; None with an error if invalid."""
        if joint.parent not in part_of:
            self._findings.wrong(
                joint,
                "expected the parent of a wheel to be the platform or a joint, found another "
                "wheel; remove one of the wheels",
            )
            return None
        role, shape, radius = self._role(joint), self._shape(joint), self._rolling_radius(joint)
        if radius is None:
            wanted = "expected a cylinder, a sphere or a mesh as its wheel, found none"
            message = self._unread.get(joint.name, wanted)
            line = self._radius_line([joint], usual_radius(self.tree, [joint]))
            self._findings.ask([joint], f"{message};", line)
            return None
        tube = self._roles.tube
        if shape is not None:
            tube = radius if shape.kind == "sphere" else shape.tube or tube
        tube = tube if role.tube is None else role.tube
        if tube > radius:
            message = f"expected a tube of at most the radius, {radius:g} m, found {tube:g}"
            self._findings.wrong(joint, f"{message}; reduce it")
            return None
        turning = shape if joint.moves and self.tree.is_level(joint) else None
        if turning and eccentricity(turning, unit_vector(joint.axis)) > MAX_ECCENTRICITY:
            at = ", ".join(f"{x:g}" for x in turning.at)
            self._findings.wrong(
                joint,
                f"expected a wheel shape centred on its axis, found a {turning.kind} at ({at}) m; "
                "move the shape or the axis",
            )
            return None
        below = [repr(part.name) for part in self.tree.below(joint.child) if part.moves]
        if below:
            self._findings.wrong(
                joint,
                f"expected a wheel without moving joints below it, found {', '.join(below)}; make "
                f"{'them' if len(below) > 1 else 'it'} fixed, or declare the joint of the wheel so",
            )
            return None
        name = wheel_name(joint.name)
        if name != joint.name:
            self._findings.notes.append(f"joint {joint.name} carries the wheel {name}")
        mass, inertia = self._mass(joint)
        return Wheel(
            name,
            part_of[joint.parent],
            vector_of(joint.at + rotation_of(joint.turned) @ (shape.at if shape else ORIGIN)),
            section_of_radii(tube, radius - tube, rollers=role.rollers or None),
            self._is_driven(joint) if role.driven is None else role.driven,
            role.grip,
            mass if role.mass is None else role.mass,
            self._axle(joint),
            role.static_depth,
            role.inertia or inertia,
            role.drive,
        )

    def add_notes(self) -> None:
        """Add notes on the shapes and centres of mass of the wheels."""
        alike: dict[str, list[tuple[str, float]]] = {}
        for joint in self.joints:
            shapes, chosen = self.tree.links[joint.child].shapes, self._shape(joint)
            is_given = self._role(joint).radius is not None
            if chosen is None or is_given or all(shape == chosen for shape in shapes):
                continue
            counts = Counter((shape.kind, shape.radius) for shape in shapes)
            listed = ", ".join(
                f"{n} {kind}{'s' * (n > 1)} of {radius:g} m" for (kind, radius), n in counts.items()
            )
            message = (
                f"radius {chosen.radius:g} m of several shapes ({listed}): that of the one about "
                "the axle that touches level ground first"
            )
            radius = max((s.radius for s in shapes if s.radius != chosen.radius), default=0.0)
            alike.setdefault(message, []).append((joint.name, radius))
        for message, wheels in alike.items():
            _, radius = wheels[0]
            other = partial(toml_line, "wheels", radius=radius) if radius else None
            self._findings.note(message, dict(wheels), other)
        radii = [radius for radius in map(self._rolling_radius, self.joints) if radius]
        off, thin = list[str](), list[str]()
        for joint in self.joints:
            shape, role = self._shape(joint), self._role(joint)
            link, at = self.tree.links[joint.child], shape.at if shape else ORIGIN
            is_flat = shape is not None and shape.kind != "sphere" and not shape.tube
            off += [joint.name] * bool(link.mass and math.dist(link.center, at) > MASS_OFFSET)
            thin += [joint.name] * (is_flat and role.tube is None and not self._roles.tube)
        note, known = self._findings.note, {*self._roles.joints, *self.gears}
        on_wheels = {
            below.name for wheel in self.joints for below in [wheel, *self.tree.below(wheel.child)]
        }
        unused = [
            joint.name
            for joint in self.tree.joints.values()
            if WHEEL.search(joint.names)
            and joint.name not in known | on_wheels
            and self.tree.is_last(joint)
            and on_wheels.isdisjoint(below.name for below in self.tree.below(joint.child))
        ]
        for rate in sorted({joint.max_rate for joint in self.joints} - {math.inf}):
            limited = [joint.name for joint in self.joints if joint.max_rate == rate]
            note(f"may exceed <limit velocity>, {rate:g} rad/s, unless [bounds] limit it", limited)
        wide = {
            joint.name: {"radius": shape.length}
            for joint in (*self.joints, *(self.tree.joints[name] for name in self.gears))
            if (shape := self._shape(joint)) and shape.kind == "cylinder"
            if shape.length > 2 * shape.radius and self._role(joint).radius is None
        }
        note(
            "cylinders longer than their diameters: are radius and length exchanged?",
            wide,
            lambda _: f"wheels = {toml_value(wide)}",
        )
        places = {
            j.name: np.array([self._center(j)[1], self._rolling_radius(j) or 0.0])
            for j in self.joints
        }
        self._findings.notes += plugin_contradictions(self.tree, places)
        note("centre of mass moved from the inertial's origin to the wheel's centre", off)
        note(
            "no wheels in spite of their names",
            unused,
            partial(toml_line, "wheels", radius=max(radii, default=0.1)),
        )
        note(
            "treated as thin discs, since their treads are flat",
            thin,
            lambda _: f"tube = {min(radii, default=0.1) / 5:.2g}",
        )

    def _with_mesh_shapes(self, tree: Tree) -> Tree:
        """Return the tree with round shapes of meshes for possible wheels without a shape."""
        links = dict(tree.links)
        joints = list[UrdfJoint]()
        for joint in tree.joints.values():
            if links[joint.child].shapes or not links[joint.child].meshes:
                continue
            is_fixed = not joint.moves and joint.name not in tree.fixed_to_wheels
            is_wheel = is_fixed and bool(WHEEL.search(joint.names))
            if joint.type == "continuous":
                is_wheel = tree.is_level(joint)
            is_wheel &= joint.name not in self._roles.joints and tree.is_last(joint)
            joints += [joint] * (is_wheel or joint.name in self._roles.wheels)
        meshes = (mesh for joint in joints for mesh in links[joint.child].meshes)
        files = MeshFiles(meshes, Path(tree.file).parent)
        for joint in joints:
            link = links[joint.child]
            axis = unit_vector(joint.axis) if joint.moves else tree.frames[link.name][0].T @ RIGHT
            try:
                shape = mesh_shape(link.meshes, np.asarray(axis), files)
            except DataError as error:
                self._unread[joint.name] = str(error)
                continue
            if shape is not None:
                links[joint.child] = link._replace(shapes=(shape,))
            elif WHEEL.search(joint.names):
                self._unread[joint.name] = (
                    "expected a mesh that is round about the axis of its joint, found "
                    f"{link.meshes[0].name!r}, which is not"
                )
        return replace(tree, links=links)

    def _add_guess(self, joint: UrdfJoint, guess: Evidence) -> None:
        """Complete the given properties of a wheel by guessed ones, and record these."""
        name, shape, role, stated = joint.name, self._shape(joint), guess.fact, self._role(joint)
        if stated.radius and role.tube is not None and role.tube == role.radius:
            role = replace(role, tube=stated.radius)
        every = "radius", "tube", "driven", "rollers"
        keys = [key for key in every if getattr(stated, key) is None]
        values = {key: getattr(role, key) for key in keys if getattr(role, key) is not None}
        self._given[name] = replace(stated, **values)
        if shape is not None and "radius" in keys:
            values = {"radius": shape.radius, **values}
        if shape is not None and shape.tube and "tube" in keys:
            values = {"tube": shape.tube, **values}
        other = toml_line("joints", name, kind="fixed") if len(self.joints) > 3 else ""
        if role.rollers is not None:
            slant = angle_text(roller_angles(self.tree, self.joints).get(name, np.pi / 2))
            other = toml_line("wheels", name, rollers=False if role.rollers else slant)
        if values.get("rollers"):
            values["rollers"] = angle_text(values["rollers"])
        if values:
            self._findings.guess("wheels", name, values, f"a wheel: {guess.words}", other)

    def _center(self, joint: UrdfJoint) -> Array:
        """Return the centre of a wheel in the root's frame [m]."""
        (rotation, origin), shape = self.tree.frames[joint.child], self._shape(joint)
        return np.asarray(origin + rotation @ (shape.at if shape else ORIGIN))

    def _check_radii(self) -> None:
        """Add an error for radii that do not suit the distances of the wheels.

        Radii that are no guesses are errors if they do in another unit.
        """
        radii = np.array([self._rolling_radius(joint) or 0.0 for joint in self.joints])
        centers = np.array([self._center(joint) for joint in self.joints])
        alike: dict[tuple[str, str, float], list[UrdfJoint]] = {}
        huge, odd = list[UrdfJoint](), dict[str, Any]()
        for k, joint in enumerate(self.joints):
            shape, role = self._shape(joint), self._roles.wheels.get(joint.name, WheelRole())
            is_mesh = shape is not None and shape.kind == "mesh"
            is_guess = is_mesh or joint.name in {*self._given} - {*self._roles.wheels}
            if role.radius or self._roles.radius or not radii[k]:
                continue
            turns = joint.moves and self.tree.is_level(joint)
            axle = self.tree.axis(joint) if turns else self._lateral(joint)
            factor = unit_factor(radii, centers, axle, k)
            if factor == 1 and not is_guess:
                odd[joint.name] = {"radius": float(radii[k]) / 2}
            is_huge = bool(radii[k] > LARGEST) and factor in (None, 1)
            huge += [joint] * is_huge
            if is_huge or factor is None or (factor == 1 and not is_guess):
                continue
            mesh = self.tree.links[joint.child].meshes[0] if is_mesh else None
            unit = f" {UNITS[factor]} correct it, or" if factor in UNITS else ""
            unit = f" mesh {mesh.name!r}: {unit_words(mesh, factor)}, or" if mesh else unit
            radius = float(factor * radii[k]) if factor != 1 else usual_radius(self.tree, [joint])
            alike.setdefault((f"{radii[k]:.3g} m", unit, radius), []).append(joint)
        for (found, unit, radius), joints in alike.items():
            self._findings.ask(
                joints,
                "expected a wheel that suits the distances between the wheels, found a radius of "
                f"{found} in link {joints[0].child!r};{unit}",
                self._radius_line(joints, radius),
            )

        self._findings.note(
            "radii that do not suit the distances of the wheels: are they diameters?",
            odd,
            lambda _: f"wheels = {toml_value(odd)}",
        )
        if huge:
            radius = self._rolling_radius(huge[0]) or 0.0
            self._findings.ask(
                huge,
                f"expected radii of at most {LARGEST:g} m, found {radius:.3g} m; are all lengths "
                "in millimetres, centimetres or inches? write them in metres; or, if not,",
                self._radius_line(huge, radius),
            )

    def _radius_line(self, joints: Sequence[UrdfJoint], radius: float) -> str:
        """Return the line of the vehicle file that gives the radius of wheels, to 3 digits."""
        shapes, radius = map(self._shape, joints), float(f"{radius:.3g}")
        if all(shape is None or shape.kind == "mesh" for shape in shapes) and all(
            self.tree.links[joint.child].meshes and joint.type == "continuous" for joint in joints
        ):
            return f"radius = {radius!r}, the radius of all wheels that are meshes"
        wheels = {joint.name: {"radius": radius} for joint in joints}
        return f"wheels = {toml_value(wheels)}, the radius in metres"

    def _rolling_radius(self, joint: UrdfJoint) -> float | None:
        shape, radius = self._shape(joint), self._role(joint).radius
        if radius or shape is None:
            return radius
        return (shape.kind == "mesh" and self._roles.radius) or shape.radius

    def _has_wheel_shape(self, joint: UrdfJoint) -> bool:
        """Return whether a joint carries a wheel by its type and its shape."""
        if joint.type != "continuous" or joint.name in self._roles.joints:
            return False
        shape = self._shape(joint)
        if shape is not None and shape.kind == "sphere":  # of a caster, or with two axes
            above = [j for j in self.tree.joints.values() if j.child == joint.parent and j.moves]
            if CASTER.search(joint.names) or (above and not any(joint.at)):
                return False
        return (
            self.tree.is_last(joint)
            and self.tree.is_level(joint)
            and shape is not None
            and is_about(shape, unit_vector(joint.axis))
        )

    @property
    def ground(self) -> float:
        """Height of level ground below the wheels, in the frame of the root [m]."""
        bottoms = [
            float(self.tree.frames[joint.child][1][2]) - (self._rolling_radius(joint) or 0.0)
            for joint in self.joints
        ]
        return min(bottoms, default=-np.inf)

    def _compare_counterparts(self, joints: Sequence[UrdfJoint]) -> set[str]:
        """Guess radii of opposite wheels with different shapes, and return the names of these."""
        shapes = {joint.name: shape for joint in joints if (shape := self._shape(joint))}
        sized = [joint for joint in joints if joint.name in shapes]
        unlike: list[tuple[UrdfJoint, UrdfJoint]] = []
        for joint in sized:
            other = self.tree.mirror_image(joint, sized)
            if other is None or joint.name in self._roles.wheels:
                continue
            large, small = shapes[joint.name].radius, shapes[other.name].radius
            if (small < (1 - ALIKE) * large) and other.name not in self._roles.wheels:
                unlike.append((joint, other))
            elif small < (1 - NEARLY) * large:
                self._findings.notes.append(
                    f"opposite wheels with different radii: {joint.name}, {large:g} m, and "
                    f"{other.name}, {small:g} m; otherwise write "
                    f"{toml_line('wheels', other.name, radius=large)}"
                )
        names = {joint.name for pair in unlike for joint in pair}
        bottoms = (
            self.tree.bottom(j.child, [shapes[j.name]]) for j in sized if j.name not in names
        )
        ground = min(bottoms, default=None)
        for pair in unlike:
            every = [joint.name for joint in pair]
            radii = [shapes[name].radius for name in every]
            large, small = radii
            drives = [self.tree.drives.get(name) for name in every]
            plugins = [drive and drive.radius for drive in drives]
            height = None
            if ground is not None:
                height = float(self.tree.frames[self.tree.joints[every[0]].child][1][2]) - ground
            sizes = {
                "height": height,
                "plugin of large": plugins[0],
                "plugin of small": plugins[1],
                "large": large,
                "small" if 2 * small > large else "tiny": small,
            }
            known: list[float] = []  # equal choices have one text
            facts: dict[str, Any] = {"names": every}
            for fact, size in sizes.items():
                if size and size > 0:
                    same = (one for one in known if math.isclose(one, size, rel_tol=ALIKE))
                    known.append(next(same, round(size, 6)))
                    facts[fact] = f"{known[-1]:g} m"
            choice = weigh(evidence("radius", facts))
            best, other_size = (float(each.split()[0]) for each in (choice.choice, choice.rival))
            wheels = [{name: {"radius": size} for name in every} for size in (best, other_size)]
            if choice.is_open:
                self._findings.ask(
                    [self.tree.joints[every[1]]],
                    f"expected the radius of its counterpart {every[0]}, {large:g} m, found "
                    f"{small:g} m (radius {choice.choice}: {choice.reason});",
                    *(f"wheels = {toml_value(each)}" for each in wheels),
                )
            for name, radius in zip(every, radii, strict=True):
                given = self._given.get(name, WheelRole())
                if not math.isclose(radius, best, rel_tol=ALIKE) and not choice.is_open:
                    reason = f"of radius {choice.choice}: {choice.reason}"
                    line = toml_line("joints", name, kind="fixed")
                    if 2 * radius > best:
                        line = toml_line("wheels", name, radius=radius)
                    self._findings.guess("wheels", name, {"radius": best}, reason, line)
                self._given[name] = replace(given, radius=given.radius or best)
        return names

    def _high(
        self, joints: Sequence[UrdfJoint], paired: Collection[str]
    ) -> Iterator[tuple[str, str]]:
        """Yield the names of joints whose round shapes end too high for wheels, and the reasons.

        These ends are more than half of the largest radius above the lowest one. Where the evidence
        is open or favours a wheel, the user is asked as well.
        """
        shapes = {j: shape for j in joints if j.name not in paired and (shape := self._shape(j))}
        ends = {joint: self.tree.bottom(joint.child, [shape]) for joint, shape in shapes.items()}
        radius = max((shape.radius for shape in shapes.values()), default=0.0)
        most = min(ends.values(), default=0.0) + radius / 2
        near_ground = [shapes[joint].radius for joint in shapes if ends[joint] <= most]
        for joint in (joint for joint in shapes if ends[joint] > most):
            alike = any(math.isclose(shapes[joint].radius, r, rel_tol=ALIKE) for r in near_ground)
            facts = {"high": True, "alike": alike, "names": WHEEL.search(joint.names)}
            choice = weigh(evidence("ground", facts))
            if choice.is_open or choice.choice == "wheel":
                self._findings.ask(
                    [joint],
                    f"expected a wheel near the ground of the others, found {choice.reason};",
                    toml_line("wheels", joint.name),
                    toml_line("joints", joint.name, kind="fixed"),
                )
            yield joint.name, choice.reason

    def _shape(self, joint: UrdfJoint) -> Shape | None:
        """Return the lowest round shape of a wheel's link, if possible about a moving joint."""
        shapes, (rotation, _) = self.tree.links[joint.child].shapes, self.tree.frames[joint.child]
        if joint.moves:
            axis = unit_vector(joint.axis)
            shapes = tuple(shape for shape in shapes if is_about(shape, axis)) or shapes
        chosen = min(shapes, key=lambda shape: lowest(shape, rotation), default=None)
        if chosen is None or not joint.moves or not is_about(chosen, axis):
            return chosen
        twins = [shape.at for shape in shapes if shape.radius == chosen.radius]
        return chosen._replace(at=vector_of(np.mean(twins, axis=0)))  # the middle of twin tyres

    def _mass(self, joint: UrdfJoint) -> tuple[float, tuple[float, float] | None]:
        """Return mass and moments about and across the axle of a wheel with the links fixed to it.

        The moments are sums of those about the links' centres of mass, since these centres are
        moved to the centre of the wheel. They are None if no link has a mass, or a mass has no
        moments.
        """
        frames = self.tree.frames
        rotation, _ = frames[joint.child]
        links = [joint.child, *(below.child for below in self.tree.below(joint.child))]
        heavy = [self.tree.links[link] for link in links if self.tree.links[link].mass]
        mass, total = sum(link.mass or 0.0 for link in heavy), np.zeros((3, 3))
        for link in heavy:
            if link.inertia is None:
                return mass, None
            turn = rotation.T @ frames[link.name][0]
            total += turn @ tensor(link.inertia) @ turn.T
        axis = np.asarray(unit_vector(joint.axis)) if joint.moves else rotation.T @ RIGHT
        axial = float(axis @ total @ axis)
        return mass, (axial, float(np.trace(total) - axial) / 2) if heavy else None

    def _is_driven(self, joint: UrdfJoint) -> bool:
        """Return whether a wheel is driven, and record a guess if the evidence is incomplete."""
        has_actuator = self._has_actuator(joint)
        facts = {
            "actuator": has_actuator,
            "actuator of others": not has_actuator and any(map(self._has_actuator, self.joints)),
            "names": joint.names,
            "caster": joint.name in self._casters,
        }
        choice = weigh([*evidence("driven", facts)] or evidence("driven", {"nothing": True}))
        is_driven = choice.choice == "driven"
        if choice.rival or not has_actuator:
            rolling = {wheel.name for wheel in self.joints} - self.balls - self._casters
            other = toml_line("wheels", joint.name, driven=not is_driven)
            if is_driven and (len(rolling) < 3 or self._role(joint).rollers):  # none can be free
                other = ""
            reason = f"{choice.choice}: {choice.reason}"
            self._findings.guess("wheels", joint.name, {"driven": is_driven}, reason, other)
        return is_driven

    def _has_actuator(self, joint: UrdfJoint) -> bool:
        """Return whether a wheel, or the gear beside which it is fixed, has an actuator."""
        gears = (self.tree.joints[name] for name in self.gears)
        turning = {gear.name for gear in gears if joint in self.tree.below(gear.child)}
        return not self.tree.actuated.isdisjoint(turning | {joint.name})

    def _axle(self, joint: UrdfJoint) -> Vector:
        """Return the axle of a wheel in its parent's frame, to the right; note unusual signs."""
        parent, _ = self.tree.frames[joint.parent]
        if not joint.moves or not self.tree.is_level(joint):
            return vector_of(parent.T @ self._lateral(joint))
        axis = rotation_of(joint.turned) @ unit_vector(joint.axis)
        left = float((parent @ axis)[1])
        if left < -MIN_AXLE_LEFT:
            self._findings.notes.append(
                f"wheel {joint.name}: its rate is positive forward, opposite to the sign of "
                "its joint in the URDF"
            )
            return vector_of(axis)
        if left < MIN_AXLE_LEFT and not self._role(joint).rollers:
            self._findings.notes.append(
                f"wheel {joint.name} rolls sideways; its rate has the sign of its joint; if the "
                'robot drives this way, write forward = "y"'
            )
        return vector_of(-axis)

    def _lateral(self, joint: UrdfJoint) -> Array:
        """Return the axle of a wheel that no joint turns: that of its shape, or to the right."""
        shape, (rotation, _) = self._shape(joint), self.tree.frames[joint.child]
        if shape is None or shape.kind == "sphere":
            return np.asarray(RIGHT)
        axis = (rotation @ rotation_of(shape.turned))[:, 2]
        if abs(axis[2]) > STEEP or abs(axis[1]) < MIN_AXLE_LEFT:
            return np.asarray(RIGHT)
        return np.asarray(-np.sign(axis[1]) * axis)


def _with_fixed_shapes(tree: Tree) -> Tree:
    """Return a URDF in which hubs without a shape or mesh have those of the links fixed to them."""
    links, turning = dict(tree.links), tree.fixed_to_wheels
    for joint in tree.joints.values():
        hub = links[joint.child]
        if hub.shapes or hub.meshes or joint.type != "continuous" or not tree.is_last(joint):
            continue
        rotation, origin = tree.frames[joint.child]
        shapes: list[Shape] = []
        meshes: list[MeshFile] = []
        for below in (part for part in tree.below(joint.child) if part.name in turning):
            turn, at = tree.frames[below.child]
            pose = rotation.T @ turn, rotation.T @ (at - origin)
            shapes += [placed(shape, *pose) for shape in links[below.child].shapes]
            meshes += [placed(mesh, *pose) for mesh in links[below.child].meshes]
        links[joint.child] = hub._replace(shapes=tuple(shapes), meshes=tuple(meshes))
    return replace(tree, links=links)


def casters(
    tree: Tree, wheels: Sequence[UrdfJoint], excluded: Collection[str]
) -> Iterator[tuple[str, frozenset[str], Evidence]]:
    """Yield the casters whose wheels do not turn about a level axis of a joint.

    A caster is a joint with "caster" in a name, with the links below it, the lowest of which
    touches the ground, or a sphere that touches the ground. Its joint there, the joints of all its
    links and the evidence are yielded. It slides freely as a ball unless its wheel trails a swivel.
    """
    bottoms = [tree.bottom(wheel.child, tree.links[wheel.child].shapes) for wheel in wheels]
    ground = min(bottoms, default=np.inf)
    known = tree.fixed_to_wheels | {wheel.name for wheel in wheels}
    for joint in tree.joints.values():
        if joint.name in known or joint.name in excluded:
            continue
        parts = [joint, *tree.below(joint.child)]
        names = frozenset(part.name for part in parts)
        shapes = tree.links[joint.child].shapes
        if CASTER.search(joint.names):
            parts = [part for part in parts if part.name not in excluded]
            if known.isdisjoint(names) and (contact := _lowest_part(tree, parts, ground)):
                part, radius, reason = contact
                discs = [s for s in tree.links[part.child].shapes[:1] if s.kind != "sphere"]
                offset = (tree.frames[part.child][1] - tree.frames[joint.child][1])[:2]
                swivels_below = joint.moves and not tree.is_level(joint)
                if swivels_below and discs and np.hypot(*offset) > TRAIL * discs[0].radius:
                    yield part.name, names, wheel_evidence(WheelRole(radius=radius), "trail")
                else:
                    yield part.name, names, _ball(radius, reason)
            known |= names
        elif tree.is_last(joint) and [shape.kind for shape in shapes] == ["sphere"]:
            radius = shapes[0].radius
            if abs(tree.bottom(joint.child, shapes) - ground) <= BALL_TOUCH * radius:
                reason = "it is a sphere that touches the ground of the wheels"
                yield joint.name, names, _ball(radius, reason)


def _ball(radius: float, reason: str) -> Evidence:
    role = WheelRole(False, radius, radius, rollers=np.pi / 2)
    return wheel_evidence(role, "ball", reason=reason)


def _lowest_part(
    tree: Tree, parts: Sequence[UrdfJoint], ground: float
) -> tuple[UrdfJoint, float, str] | None:
    """Return the part of a caster that touches the ground, its radius [m], and its reason."""
    bottoms: list[tuple[float, int, float, str]] = []  # height, index, radius, reason
    for index, joint in enumerate(parts):
        link, (rotation, origin) = tree.links[joint.child], tree.frames[joint.child]
        for shape in link.shapes:
            bottom = tree.bottom(link.name, [shape])
            bottoms.append((bottom, index, shape.radius, "radius of its shape"))
        depth = 0.0  # of the lowest point below the origin
        for box in link.boxes:
            half = np.abs((rotation @ rotation_of(box.turned))[2]) @ np.asarray(box.size) / 2
            depth = max(depth, float(half - rotation[2] @ np.asarray(box.at)))
        if not link.shapes and not link.boxes:
            files = MeshFiles(link.meshes, Path(tree.file).parent)
            try:
                meshes = [files.triangles(mesh).vertices for mesh in link.meshes]
            except DataError:  # the ground of the wheels gives the radius
                meshes = []
            depth = max((float(-(rotation @ each.T)[2].min()) for each in meshes), default=0.0)
        if depth > 0:
            bottoms.append((float(origin[2]) - depth, index, depth, "radius to its lowest point"))
    if bottoms:
        _, index, radius, reason = min(bottoms)
        return parts[index], radius, reason
    height = float(tree.frames[parts[-1].child][1][2]) - ground
    return (parts[-1], height, "radius to the ground of the wheels") if height > 0 else None


def plugin_contradictions(tree: Tree, wheels: Mapping[str, Array]) -> Iterator[str]:
    """Yield notes on drives of simulators that contradict the links.

    ``wheels`` are the distance to the left and the radius of each wheel, by joint [m].
    """
    for plugin in (plugin for plugin in tree.plugins if plugin.drives):
        own = {name: wheels[name] for name in plugin.words if name in wheels}
        sides = ([y for name, (y, _) in own.items() if s in plugin.words[name]] for s in SIDES)
        left, right = (sum(side) / len(side) if side else math.nan for side in sides)
        radii = {radius for _, radius in own.values()}
        sizes = {
            "a radius": (plugin.radius, radii.pop() if len(radii) == 1 else math.nan),
            "a track": (plugin.track, abs(left - right)),
        }
        wrong = [
            f"{name} of {stated:g} m instead of {size:g} m"
            for name, (stated, size) in sizes.items()
            if stated and abs(size - stated) > CONTRADICTION * stated
        ]
        wrong += ["the wheels on the left as right ones"] * bool(left < right)
        names = {name for name, tag in plugin.words.items() if name and tag.endswith("joint")}
        if unknown := sorted(names - {*tree.joints}):
            wrong.append(f"joints that are not in the file, {', '.join(unknown)}")
        if wrong:
            yield f"drive {plugin.name!r} of a simulator, not used: {', '.join(wrong)}"


def with_separate_balls(tree: Tree) -> Tree:
    """Return a URDF in which balls of casters that are part of the chassis have their own links.

    Simulators model a caster as a frictionless sphere of the chassis, without a joint; as a link of
    its own it is a wheel for the rest of the reader. A sphere is such a ball if it touches the
    ground below the other links.
    """
    links, joints = dict(tree.links), dict(tree.joints)
    bottoms = {name: tree.bottom(name, link.shapes) for name, link in links.items()}
    moving = [joint for joint in tree.joints.values() if joint.moves]
    for name in sorted({joint.parent for joint in moving} - {joint.child for joint in moving}):
        ground = min((z for other, z in bottoms.items() if other != name), default=np.inf)
        for k, ball in enumerate(tree.links[name].shapes):
            height = abs(tree.bottom(name, [ball]) - ground)
            new, above = f"{name}_ball_{k + 1}", BALL_TOUCH * ball.radius < height < np.inf
            if ball.kind != "sphere" or above or new in joints or new in links:
                continue
            rest = tuple(shape for shape in links[name].shapes if shape != ball)
            links[name] = links[name]._replace(shapes=rest)
            links[new] = Link(new, shapes=(ball._replace(at=ORIGIN, turned=ORIGIN),))
            joints[new] = UrdfJoint(new, "fixed", name, new, ball.at)
    return replace(tree, links=links, joints=joints)


def swivels(tree: Tree, wheels: Sequence[UrdfJoint]) -> frozenset[str]:
    """Return the names of the joints about steep axes that swivel freely, as those of casters."""
    swivelling: dict[str, set[str]] = {}
    for joint in tree.joints.values():
        below = {part.name for part in tree.below(joint.child)}
        carried = [wheel for wheel in wheels if wheel.name in below]
        if not carried or not joint.moves or joint.type == "prismatic" or tree.is_level(joint):
            continue
        trails = list[float]()  # distances from the axis, across the axles [radii]
        for wheel in carried:
            axle = axle_of(tree, wheel)
            offset = tree.frames[wheel.child][1] - tree.frames[joint.child][1]
            across = abs(float(offset[0] * axle[1] - offset[1] * axle[0]))
            trails.append(across / (tree.radius_of(wheel) or np.inf))
        is_behind = not STEERING.search(joint.names) and TRAIL < min(trails) < MAX_TRAIL
        commands = [e for e in tree.evidence.get(joint.name, ()) if e.choice == "commanded"]
        is_free = joint.mimic is None and not any(each.weight > USUAL for each in commands)
        is_named = TRAILER.search(joint.names) and not STEERING.search(joint.name)
        if is_free and (is_named or is_behind):
            swivelling[joint.name] = {wheel.name for wheel in carried}
    names = {wheel.name for wheel in wheels}  # if each wheel swivels, none does so freely
    return frozenset() if names == set().union(*swivelling.values()) else frozenset(swivelling)


def caster_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> frozenset[str]:
    """Return the names of the joints of wheels that belong to casters or trailers.

    They are below joints that swivel freely, or have "caster" in a name, or are in the middle of a
    vehicle that turns only if they slide. If all wheels do, none belongs to a caster.
    """
    heads = [tree.joints[name].child for name in swivels(tree, wheels)]
    swivelling = {below.name for head in heads for below in tree.below(head)}
    above = {joint.child for joint in tree.joints.values() if CASTER.search(joint.name)}
    names = {
        wheel.name
        for wheel in wheels
        if wheel.name in swivelling or wheel.parent in above or CASTER.search(wheel.names)
    }
    names |= _middle_wheels(tree, [wheel for wheel in wheels if wheel.name not in names])
    return frozenset() if len(names) == len(wheels) else frozenset(names)


def _middle_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> set[str]:
    """Return the names of small wheels in the middle, with one pair of wheels and no steering."""
    places = np.array([tree.frames[wheel.child][1] for wheel in wheels]).reshape(-1, 3)
    axles = [axle_of(tree, wheel) for wheel in wheels]
    if len(wheels) < 3 or any(abs(axle @ axles[0]) < PARALLEL for axle in axles):
        return set()
    along, left = places @ np.cross(axles[0], (0, 0, 1)), places @ axles[0]
    near = TRAIL * max(float(np.ptp(left)), float(np.ptp(along)))
    pairs = [
        sorted((float(left[i]), float(left[j])))
        for i, j in combinations(range(len(wheels)), 2)
        if abs(along[i] - along[j]) < near < abs(left[i] - left[j])
    ]
    if len(pairs) != 1 or tree.steered & {wheel.name for wheel in wheels}:
        return set()
    ends = pairs[0][0] + near, pairs[0][1] - near
    radii = np.array([tree.radius_of(wheel) for wheel in wheels])
    inside = (ends[0] < left) & (left < ends[1]) & (radii > 0) & (radii < SMALL_CASTER * max(radii))
    middle = {wheel.name for wheel, is_small in zip(wheels, inside, strict=True) if is_small}
    return middle if len(middle) == len(wheels) - 2 and not middle & tree.actuated else set()


def axle_of(tree: Tree, wheel: UrdfJoint) -> Array:
    """Return the axle of a wheel in the root's frame; to the left for one that no joint turns."""
    if wheel.type not in ("continuous", "revolute") or not tree.is_level(wheel):
        return np.array([0.0, 1.0, 0.0])
    return tree.axis(wheel)


def with_fixed_rollers(tree: Tree) -> tuple[Tree, dict[str, Evidence]]:
    """Return a URDF in which joints below wheels with rollers are fixed.

    Return also the evidence of these wheels, by joint. Rollers are continuous joints of the wheel's
    link, equally far from its axis.
    """
    joints, links, found = dict(tree.joints), dict(tree.links), {}
    for joint in tree.joints.values():
        below = tree.below(joint.child)
        rollers = [roller for roller in below if roller.type == "continuous"]
        if joint.type != "continuous" or len(rollers) < MIN_ROLLERS or not tree.is_level(joint):
            continue
        axis = np.asarray(unit_vector(joint.axis))
        far = [np.linalg.norm(np.cross(roller.at, axis)) for roller in rollers]
        if not all(r.parent == joint.child for r in rollers) or np.ptp(far) > far[0] / 10:
            continue
        joints |= {each.name: each._replace(type="fixed") for each in below}
        if not links[joint.child].shapes:
            radius = float(far[0]) + replace(tree, links=links).radius_of(rollers[0])
            shape = Shape("cylinder", radius, ORIGIN, angles_to(axis))
            links[joint.child] = links[joint.child]._replace(shapes=(shape,))
        angle = _roller_angle(rollers, axis)
        fact = "rollers" if angle else "odd"
        found[joint.name] = wheel_evidence(WheelRole(rollers=angle), fact)
    return replace(tree, joints=joints, links=links), found


def _roller_angle(rollers: Sequence[UrdfJoint], axis: Array) -> float | bool:
    """Return the angle of rollers, as in `Omni`; False if it is nearly zero or not the same [rad].

    It does not depend on the sign of any axis. Angles are rounded to hundredths of a degree.
    """
    doubled = np.zeros(2)  # of doubled angles, since axes have no direction
    for roller in rollers:
        at = np.asarray(roller.at)
        outward = at - (at @ axis) * axis
        # forward at the ground, where the wheel's axis points to the right, and outward is down
        forward = np.cross(axis, outward) / np.linalg.norm(outward)
        along = rotation_of(roller.turned) @ unit_vector(roller.axis)
        angle = 2 * np.arctan2(along @ forward, along @ axis)
        doubled += np.array([np.cos(angle), np.sin(angle)]) / len(rollers)
    cosine, sine = map(float, doubled)
    mean = float(np.round(math.degrees(math.atan2(sine, cosine)) / 2, 2))
    if np.linalg.norm(doubled) < SAME_ANGLE or abs(mean) < MIN_ROLLER_ANGLE:
        return False
    return math.radians(90.0 if mean == -90.0 else mean)


def mecanum_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, Evidence]]:
    """Yield the wheels called mecanum wheels, also by meshes, with the usual angles of rollers."""
    named: list[UrdfJoint] = []
    for joint in wheels:
        link, drive = tree.links[joint.child], tree.drives.get(joint.name)
        meshes = (each for each in (*link.meshes, *link.visuals) if isinstance(each, MeshFile))
        words = [joint.names, *(mesh.name for mesh in meshes)]
        named += [joint] * bool(MECANUM.search(" ".join([*words, drive.name if drive else ""])))
    for name, angle in roller_angles(tree, named).items():
        yield name, wheel_evidence(WheelRole(rollers=angle), "mecanum")


def roller_angles(tree: Tree, wheels: Sequence[UrdfJoint]) -> dict[str, float]:
    """Return the usual angles of rollers of mecanum wheels by joint, those at corners [rad].

    The URDF faces forward along x. The rollers on top of the wheels form an X.
    """
    places = np.array([tree.frames[joint.child][1][:2] for joint in wheels])
    offsets = places - places.mean(axis=0) if wheels else places
    return {
        joint.name: float(np.copysign(np.pi / 4, ahead * left))
        for joint, (ahead, left) in zip(wheels, offsets, strict=True)
        if min(abs(ahead), abs(left)) > SMALL
    }


def wheel_guesses(
    tree: Tree, wheels: Sequence[UrdfJoint], unread: Collection[str], roles: UrdfTable
) -> Iterator[tuple[str, Evidence]]:
    """Yield the wheels that joints probably carry, with the name of the joint."""
    guesses = dict[str, Evidence]()  # by names, such as "wheel", or a given radius of meshes
    frames, on_wheels = tree.frames, tree.fixed_to_wheels
    grounds = [frames[link][1][2] for link in tree.links if FOOTPRINT.search(link)]
    heights: dict[str, float] = {}
    for joint in tree.joints.values():
        link, is_named = tree.links[joint.child], WHEEL.search(joint.names)
        is_known = joint in wheels or joint.name in {*roles.joints, *on_wheels}
        if is_known or joint.type == "prismatic" or not tree.is_last(joint):
            continue
        is_ball = {shape.kind for shape in link.shapes} == {"sphere"}
        if (joint.moves and not tree.is_level(joint)) or (is_ball and CASTER.search(joint.names)):
            continue
        turned = joint.upper - joint.lower  # equal limits are those of a careless export, too
        turns = joint.type == "revolute" and (turned >= FULL_TURN or turned == 0)
        is_round = turns and any(is_about(s, unit_vector(joint.axis)) for s in link.shapes)
        height = float(frames[joint.child][1][2] - grounds[0]) if grounds else 0.0
        drive, named = tree.drives.get(joint.name), WheelRole() if is_named else None
        is_mesh = joint.type == "continuous" and link.meshes and not link.shapes
        facts = {
            "given radius": is_mesh and roles.radius and WheelRole(radius=roles.radius),
            "plugin": drive
            and drive.radius
            and joint.moves
            and not link.shapes
            and WheelRole(radius=drive.radius),
            "full turn": is_round and WheelRole(),
            "shape and limits": link.shapes and joint.type == "revolute" and named,
            "shape": link.shapes and named,
            "name": joint.moves and not link.meshes and named,
        }
        if found := next(evidence("wheel", facts), None):
            guesses[joint.name] = found
        elif is_named and link.meshes and height > 0:
            heights[joint.name] = height
    for name in heights:  # the radius of all is that of the lowest one
        guesses[name] = wheel_evidence(WheelRole(radius=min(heights.values())), "footprint")
    rolling = [*wheels, *(tree.joints[name] for name in guesses if tree.joints[name].moves)]
    for caster, parts, guess in casters(tree, rolling, roles.joints):
        guesses = {name: each for name, each in guesses.items() if name not in parts}
        guesses[caster] = guess
    yield from guesses.items()
    sized = [
        tree.joints[name]
        for name, guess in guesses.items()
        if guess.fact.radius or tree.links[tree.joints[name].child].shapes
    ]
    everything = [*wheels, *sized]
    known = {*unread, *roles.joints, *tree.fixed_to_wheels, *(wheel.name for wheel in everything)}
    ends = [j for j in tree.joints.values() if tree.is_last(j) and j.name not in known]
    for wheel in everything:
        other = tree.mirror_image(wheel, ends)
        if other is not None and tree.mirror_image(wheel, everything) is None:
            # a counterpart gives the radius of a wheel without a shape
            role = WheelRole(radius=tree.radius_of(wheel) or None)
            if role.radius is None and wheel in sized:
                role = guesses[wheel.name].fact
            yield other.name, wheel_evidence(role, "mirrored", other=wheel.name)


def sliding_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, Evidence]]:
    """Yield the unsteered wheels that slide: axles not parallel, or casters without a swivel."""
    casters_, turned = caster_wheels(tree, wheels), tree.steered
    rolling = [
        wheel
        for wheel in wheels
        if wheel.name not in turned
        and wheel.type in ("continuous", "revolute", "fixed")
        and (not wheel.moves or tree.is_level(wheel))
    ]
    rest = [wheel for wheel in rolling if wheel.name not in casters_]
    for wheel in rolling:
        if wheel.name in casters_:
            yield wheel.name, wheel_evidence(WheelRole(False, rollers=np.pi / 2), "no swivel")
    axles = [axle_of(tree, wheel) for wheel in rest]
    if any(abs(axle @ axles[0]) < PARALLEL for axle in axles):
        for wheel in rest:
            yield wheel.name, wheel_evidence(WheelRole(rollers=np.pi / 2), "oblique")


def usual_radius(tree: Tree, joints: Sequence[UrdfJoint]) -> float:
    """Return an example of a radius: of wheels with a shape, or a quarter of the least distance."""
    radii = [tree.radius_of(j) for j in tree.joints.values() if j.type == "continuous"]
    known = [radius for radius in radii if 0 < radius < 1]
    places = [tree.frames[joint.child][1] for joint in joints]
    apart = min((float(np.linalg.norm(a - b)) for a, b in combinations(places, 2)), default=0.0)
    return float(f"{max(known, default=apart / 4 or 0.1):.2g}")
