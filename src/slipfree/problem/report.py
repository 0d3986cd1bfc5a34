"""Reports: of result files in HTML, and of vehicles for ``slipfree describe``."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.core.dae import Dae
from slipfree.core.errors import DataError, ModelError
from slipfree.core.facts import NOTE, Lines, lines, of_attributes, printed_unit
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import FIGURE_SAMPLES, Trajectory, outcome_words
from slipfree.core.version import __version__
from slipfree.files.atlas_files import is_atlas, open_atlas, tiles_in
from slipfree.files.netcdf import MAP_TRANSFORM, ORIGIN, read
from slipfree.files.urdf.xacro import trusted_paths
from slipfree.files.vehicle_toml import Draft, VehicleError
from slipfree.geometry.frame import AXES, unit_vector
from slipfree.models.base import is_determinate
from slipfree.models.dynamics import dynamics
from slipfree.models.kinematics import check_driven, direct_kinematics
from slipfree.models.samples import closest_fact
from slipfree.problem import build_vehicle
from slipfree.problem.load import find_motion_verb, load_problem, verb_of
from slipfree.problem.problem import Problem
from slipfree.problem.result import STORED, build, motion_facts, open_result
from slipfree.problem.verbs.atlas import overview, summary_lines
from slipfree.problem.verbs.base import PLAIN_ROWS, START_ROWS, outcome_fact, ranges
from slipfree.routing.traversability import extents
from slipfree.show.atlas_figures import AtlasView, atlas_plots
from slipfree.show.film import picture
from slipfree.show.html_page import Report
from slipfree.show.plots import Plot
from slipfree.show.scene import Driven, drive_scene
from slipfree.solve.settle import settle
from slipfree.solve.system import with_inputs
from slipfree.system.regular_files import digest
from slipfree.terrain.analytic import Analytic
from slipfree.terrain.base import Grid, Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Coordinate, Joint, Vehicle

VERSION = "_version"
ELSEWHERE = (  # attributes reported in other sections
    *("problem", "settings", "history", "title", "date_created", "problem_folder"),
    *(STORED, MAP_TRANSFORM),
)
MAPS = "map", "side"  # first figures of reports
LEVEL = 6.0  # half the width of the level ground in a picture [reach of the vehicle]
MIN_SHARE = 0.3  # smallest named entry of a singular vector, relative to the largest
SAME_PLACE = 0.05  # largest distance from a mirror image [distance from the platform's origin]
STEEP = 0.5  # least vertical component of a steering axis
MAX_TREE_DEPTH = 40  # largest printed depth of the tree of parts


def report(file: Path) -> Report:
    """Return the report of a result file; raise DataError if it cannot be read."""
    tables: dict[str, Sequence[tuple[str, ...]]]
    if is_atlas(file):
        summary, set_up, view = atlas_lines(file)
        attributes = view.site.attributes
        maps = ((name, label) for name, (label, _) in view.maps.items())
        tables = {
            "Set-up": set_up,
            "Maps": [(name, printed_unit(label.unit), label.words) for name, label in maps],
            "Versions": _versions(file, attributes),
        }
        texts = {"Problem": attributes["problem"]} if "problem" in attributes else {}
        title = attributes.get("title", file.stem)
        lead = "Where and how the vehicle can stand."
        return Report(title, lead, True, summary, tables, atlas_plots(view), "", texts)
    result = open_result(file, samples=FIGURE_SAMPLES)
    run, verb = read(file, lazy=True), find_motion_verb(result.kind)
    facts = [outcome_fact(run), *motion_facts(run)]
    main = [outcome_fact(run), *(verb.summary(run, main=True) if verb else [])]
    names = {row.name for row in (verb.rows if verb else PLAIN_ROWS) if row.is_check}
    attributes = run.attributes
    tables = {
        "Result": [fact for fact in facts if fact[0] not in names],
        "Checks": [fact for fact in facts if fact[0] in names],
        "Set-up": _set_up(attributes),
        "Quantities": [(name, span, run.columns[name].label.words) for name, span in ranges(run)],
        "Versions": _versions(file, attributes),
    }
    lead = outcome_words(run)
    if run.stop is None and verb is not None:
        lead = verb.describe_end(run) or lead
    head = attributes["title"], f"{lead[0].upper()}{lead[1:]}.", run.stop is None
    shown, figures = result.trajectory.t.size, list[Plot]()
    note = f"The figures show {shown} of {run.t.size} samples, including the extremes of all "
    note = f"{note}quantities; the tables use all samples." if shown < run.t.size else ""
    try:
        figures += (verb or verb_of(result.problem)).figures(result)
    except DataError as error:
        note = f"No figures: {error}"
    figures.sort(key=lambda plot: plot.name not in MAPS)
    texts = {}
    if "problem" in attributes:
        name = f"{Path(attributes.get('problem_file', 'problem.toml')).stem}_again.toml"
        settings = attributes.get("settings", "").splitlines()
        words = ["slipfree", "run", name, *(part for each in settings for part in ("--set", each))]
        again = f"slipfree info {shlex.quote(file.name)} --problem > {shlex.quote(name)}\n"
        again += f"{shlex.join(words)}   # with slipfree {attributes[ORIGIN]}\n"
        texts = {"Problem": attributes["problem"], "To repeat the run": again}
    return Report(*head, main, tables, figures, note, texts)


def atlas_lines(file: Path) -> tuple[Lines, Lines, AtlasView]:
    """Return summary, set-up, and the contents of the figures of a mobility map."""
    poses, site = open_atlas(file)
    view, facts = overview(poses.x, poses.y, site, tiles_in(poses))
    return summary_lines(facts), _set_up(site.attributes), view


def _set_up(attributes: Mapping[str, str]) -> Lines:
    """Return the attributes of a result that other sections do not report."""
    own = {n: text for n, text in attributes.items() if n not in ELSEWHERE and VERSION not in n}
    return of_attributes(own)


def _versions(file: Path, attributes: Mapping[str, str]) -> Lines:
    """Return versions, date and digest of a result, for its report."""
    versions = ((n.removesuffix(VERSION), v) for n, v in attributes.items() if n.endswith(VERSION))
    return [
        ("computed", attributes.get("date_created", "date unknown")),
        *versions,
        ("result file", file.name),
        ("SHA-256 of the file", digest(file)),
        ("this page", f"written by slipfree {__version__}"),
    ]


class Description(NamedTuple):
    """Description of a vehicle: tree of its parts, wheels, facts, and errors if it has any.

    ``details`` are the parts, and facts about the numbers of unknowns and equations.
    """

    tree: list[str]
    wheels: list[Mapping[str, str]]
    facts: Lines
    faults: tuple[str, ...]
    details: Sequence[tuple[str, str]] = ()


def describe(path: Path, settings: Sequence[str] = (), trust: Sequence[Path] = ()) -> Description:
    """Return the description of the vehicle in a problem or in a vehicle file.

    The vehicle of a vehicle file stands on level ground. For an invalid vehicle the description has
    the errors and the facts about its known parts. DataError is raised if the problem is invalid,
    no part of the vehicle can be read, or settings are given for a vehicle file.
    """
    try:
        if not build_vehicle.is_vehicle_file(path):
            setup = build(load_problem(path, settings, command="vehicle", trust=trust))
            return _description(setup.vehicle, setup.model, setup.terrain, setup.start)
        if settings:
            raise DataError(
                f"--set: expected a problem file, found the vehicle file {path}; omit --set"
            )
        vehicle = build_vehicle.read_vehicle(path, trust=trust)
    except VehicleError as error:
        if error.draft is None:
            raise
        return Description(_drawn_tree(error.draft), [], _shares(error.draft), error.faults)
    level, facts, details = Analytic(lambda x, _: 0 * x, mu=1.0), _shares(vehicle), Lines()
    try:
        dae: Dae = dynamics(vehicle, level) if vehicle.planar else direct_kinematics(vehicle, level)
        main, details = counts(vehicle, dae)
        facts = [*main, *dimensions(vehicle), *_notes(vehicle)]
        check_driven(vehicle)
        return _description(vehicle, dae, level, settle(dae))
    except ModelError as error:
        words = str(error).replace("choose another start or other inputs", "correct the vehicle")
        faults = (f"{path}: on level ground: {words}",)
        return Description(_drawn_tree(vehicle), wheel_rows(vehicle), facts, faults, details)


def vehicle_plot(path: Path, settings: Sequence[str] = (), trust: Sequence[Path] = ()) -> Plot:
    """Return the picture of a vehicle, on level ground or on the ground of its problem."""
    if build_vehicle.is_vehicle_file(path):
        contents = build_vehicle.read_vehicle_file(path, trusted_paths(trust))
        vehicle = contents.vehicle
        axis = np.linspace(-LEVEL, LEVEL, 9) * extents(vehicle)[2]
        terrain = Bicubic(Grid(axis, axis, np.zeros((axis.size, axis.size))))
        start = settle(direct_kinematics(vehicle, terrain))
    else:
        problem: Problem[Any] = load_problem(path, settings, command="vehicle", trust=trust)
        setup, contents = build(problem), build_vehicle.vehicle_file(problem.spec.vehicle, problem)
        vehicle, terrain, start = setup.vehicle, setup.terrain, setup.start
    robot, visuals = contents.robot, build_vehicle.visual_meshes(contents)
    drive = Driven(vehicle.name, start, terrain, vehicle, robot=robot, visuals=visuals)
    return picture(drive_scene([drive]), vehicle.name)


def _description(vehicle: Vehicle, dae: Dae, terrain: Terrain, start: Trajectory) -> Description:
    """Return the description of a vehicle at its start."""
    solved = conditioning(dae, start) if dae.labels.z else []
    clear = lines(START_ROWS, closest_fact(vehicle, terrain, start))
    main, details = counts(vehicle, dae)
    facts = [*main, *dimensions(vehicle), *clear, *_notes(vehicle)]
    drawn = _drawn_tree(vehicle)
    details = [*(("parts", line) for line in drawn), *details, *solved]
    return Description(drawn, wheel_rows(vehicle), facts, (), details)


def wheel_rows(vehicle: Vehicle) -> list[Mapping[str, str]]:
    """Return the rows of the table of a vehicle's wheels: values by the heading of the column.

    Places are those with all coordinates at zero. The partner is the wheel at the mirror image.
    """
    places, wheels = vehicle.centers, vehicle.wheels
    joints = {joint.name: joint for joint in vehicle.joints}
    kinds = {c.name: c.kind for c in vehicle.coordinates}
    rows = list[Mapping[str, str]]()
    for wheel, place in zip(wheels, places, strict=True):
        part, turned = joints.get(wheel.parent), set[str]()
        while part is not None:
            if part.motion == "turn" and abs(unit_vector(part.axis)[2]) > STEEP:
                turned |= {kinds[name] for name in part.coordinates}
            part = joints.get(part.parent)
        away = np.linalg.norm(places - place * (-1, 1, 1), axis=1)
        near = int(away.argmin())
        is_pair = away[near] < SAME_PLACE * np.linalg.norm(place) and wheels[near] is not wheel
        tube, _ = wheel.section.torus_radii or (0.0, 0.0)
        rows.append(
            {
                "wheel": wheel.name,
                "place (m)": ", ".join(f"{0.0 + round(each, 4):g}" for each in place),
                "radius (m)": f"{wheel.radius:.4g}",
                "width (m)": f"{2 * tube:.4g}" if tube else "thin",
                "driven": "yes" if wheel.driven else "no",
                "steered": "yes" if "commanded" in turned else "free" if turned else "no",
                "mass (kg)": f"{wheel.mass:.4g}",
                "partner": wheels[near].name if is_pair else "none",
            }
        )
    return rows


def dimensions(vehicle: Vehicle) -> Lines:
    """Return track, wheelbase, and total mass with its centre, with all coordinates at zero.

    The centre of mass is in the frame of the platform.
    """
    across, along, _ = np.ptp(vehicle.centers, axis=0)
    masses = [*vehicle.masses()]
    total = sum(mass for _, mass, _ in masses)
    center = "no mass"
    if total:
        sums = sum((mass * np.array(ca.evalf(at)).ravel() for _, mass, at in masses), np.zeros(3))
        at = ", ".join(f"{0.0 + round(each, 4):g}" for each in sums / total)
        center = f"{total:.4g} kg, centre of mass at ({at}) m"
    return [("track", f"{across:.4g} m"), ("wheelbase", f"{along:.4g} m"), ("total mass", center)]


def _drawn_tree(vehicle: Vehicle | Draft) -> list[str]:
    return [f"{vehicle.name}, in axes x right, y forward, z up", *tree(vehicle)]


def _notes(vehicle: Vehicle | Draft) -> Lines:
    return [(NOTE, note) for note in vehicle.notes]


def tree(vehicle: Vehicle | Draft) -> list[str]:
    """Return the lines of the tree of a vehicle's parts, indented below their parents.

    Axes are those with all coordinates at zero, in the vehicle's frame.
    """
    kinds = {c.name: c for c in vehicle.coordinates}
    connected: list[Joint] = []

    def below(part: str, indent: str, rotation: Array) -> Iterator[str]:
        """Yield lines of the joints and wheels that a part carries, indented by their depth."""
        if len(indent) > 2 * MAX_TREE_DEPTH:
            yield f"{indent}..."
            return
        for joint in vehicle.joints:
            if joint.parent == part:
                connected.append(joint)
                pose = joint.pose(dict.fromkeys(joint.coordinates, ca.SX(0)))
                turned = rotation @ np.array(ca.evalf(pose.rotation))
                axis = turned @ unit_vector(joint.axis)
                yield f"{indent}{joint.name}: {_joint(joint, axis, kinds)}"
                yield from (f"{indent}  {shape}" for shape in joint.body.shapes)
                yield from below(joint.name, indent + "  ", turned)
        for wheel in vehicle.wheels:
            if wheel.parent == part:
                drive = "driven" if wheel.driven else "free"
                more = f", {wheel.mass:g} kg" if wheel.mass else ""
                more += f", grip {wheel.grip:g}" if wheel.grip != 1 else ""
                yield f"{indent}wheel {wheel.name}: {drive}, {wheel.section}{more}"

    body = vehicle.body
    at = ", ".join(f"{each:g}" for each in body.at)
    mass = f": {body.mass:g} kg, centre of mass at ({at}) m" if body.mass else ""
    shapes = (f"  {shape}" for shape in body.shapes)
    lines = [f"platform{mass}", *shapes, *below("platform", "  ", np.eye(3))]
    parts = {"platform", *(joint.name for joint in connected)}
    loose = [(j.name, j.parent) for j in vehicle.joints if j not in connected]
    loose += [(f"wheel {w.name}", w.parent) for w in vehicle.wheels if w.parent not in parts]
    return lines + [f"not connected to the platform: {name}, on {parent}" for name, parent in loose]


def _joint(joint: Joint, vector: Array, kinds: dict[str, Coordinate]) -> str:
    """Return motion, axis and coordinates of a joint in words.

    ``vector`` is its axis in the frame of the platform, with all coordinates at zero.
    """
    moved = dict.fromkeys(sorted(joint.coordinates), "kind not given")
    for name, c in ((name, kinds[name]) for name in moved if name in kinds):
        acts = [(c.stiffness, "spring"), (c.damping, "damper"), (c.bump, "elastic stops")]
        moved[name] = ", ".join([c.kind, *(f"{words} {value:g}" for value, words in acts if value)])
    if not moved:
        return "rigid" if joint.value in ("0", "0.0") else f"fixed at {joint.value}"
    along = f"({', '.join(f'{each:.3g}' for each in vector)})"
    names = AXES | {f"-{n}": (-x, -y, -z) for n, (x, y, z) in AXES.items()}
    same = [name for name, each in names.items() if np.allclose(each, vector, atol=1e-6)]
    along = (*same, along)[0]
    does = "turns about" if joint.motion == "turn" else "slides along"
    if joint.value in moved:
        return f"{does} {along} by {joint.value} ({moved[joint.value]})"
    kinds_of = "; ".join(f"{name}: {kind}" for name, kind in moved.items())
    return f"{does} {along} by {joint.value} ({kinds_of})"


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    return f"{len(names)}: {', '.join(names) or 'none'}"


def counts(vehicle: Vehicle, dae: Dae) -> tuple[Lines, Lines]:
    """Return main facts and details of the unknowns and equations of a vehicle's motion."""

    def listed(record: Any) -> str:
        return _listed(label.full for label in leaves(record))

    inputs, states = ("inputs", listed(dae.labels.u)), ("states", listed(dae.labels.x))
    if not dae.labels.z:  # dynamics has no algebraic unknowns
        return [inputs], [states]
    position, rates, forces = dae.labels.z
    # a wheel-ground law gives the forces, which do not follow from the motion
    has_law = bool(dae.labels.y.forces) and not any(leaves(forces)) and not dae.rest.numel()
    is_exact = has_exact_closure(vehicle)
    free = [wheel.name for wheel in vehicle.wheels if not wheel.driven]
    passive = [c.name for c in vehicle.of("passive")]
    unknown = 3 + len(passive) + len(free)
    no_slip = sum(1 if wheel.rollers else 2 for wheel in vehicle.wheels)
    if has_law:
        rolls = "the wheels slip as the wheel-ground law determines"
    elif unknown == no_slip:
        law = "least" if any(wheel.rollers for wheel in vehicle.wheels) else "rolling"
        rolls = f"yes (slip = '{law}')"
    else:
        rolls = (
            f"not in general: {no_slip} no-slip conditions, {unknown} unknown rates (platform, "
            "free wheels, passive joints); the slip is minimal, zero if inputs and ground permit"
        )
    ground = ["height", "pitch", "roll", *(c.name for c in vehicle.of("suspension"))]
    listed_ground = ", ".join(ground if is_exact else [*ground, "depths of the wheels in it"])
    equations = "equilibrium and the wheel-ground law; they also determine the normal forces"
    if not has_law:
        equations = dae.labels.alg[1][0].name.replace("_", " ")
    main = [inputs, ("can roll without slip", rolls), ("the ground determines", listed_ground)]
    wheels = len(vehicle.wheels)
    suspension = f"{len(vehicle.of('suspension'))} of {wheels - 3} for exact contact of all wheels"
    contact = "determined by the ground"
    conditions = f"{3 * wheels}: three for each wheel that touches the ground"
    if not is_exact:
        contact = "contact unknowns"
        conditions = f"{len(dae.labels.alg[0])}: two for each contact point"
        suspension += ": the wheels are pressed into the ground, and may lift off it"
    details = [
        states,
        (contact, listed(position)),
        ("  equations", conditions),
        ("suspension", suspension),
        ("rates", listed((rates.motion, rates.law))),
        ("  equations", f"{len(dae.labels.alg[1])}: {equations}"),
        ("passive joints", _listed(passive)),
        ("free wheels", _listed(free)),
        ("no-slip conditions", f"{no_slip}, for {unknown} unknown rates"),
    ]
    if not vehicle.mass:
        return main, details
    count = wheels + no_slip  # a friction force for each condition
    loose = count - len(list(leaves(rates.motion)))
    if not is_exact:
        how = "the depths of the wheels determine the loads, on which friction depends"
    elif has_law:
        how = "the wheel-ground law determines them, together with the rates"
    elif is_determinate(vehicle) or not loose:
        how = "equilibrium determines them"
    else:
        how = f"{loose} of them are not determined by equilibrium: they are load-weighted"
    return main, [*details, ("contact forces", f"{count}: {how}")]


def _shares(draft: Vehicle | Draft) -> Lines:
    """Return the names of parts by their use, and the notes on a vehicle."""
    suspension = _listed(c.name for c in draft.of("suspension"))
    return [
        ("wheels", _listed(wheel.name for wheel in draft.wheels)),
        ("driven wheels", _listed(wheel.name for wheel in draft.wheels if wheel.driven)),
        ("commanded", _listed(c.name for c in draft.of("commanded"))),
        ("passive joints", _listed(c.name for c in draft.of("passive"))),
        ("suspension", f"{suspension}; at most {max(len(draft.wheels) - 3, 0)}"),
        *_notes(draft),
    ]


def conditioning(dae: Dae, start: Trajectory) -> Lines:
    """Return the condition numbers of the equations at a start, with the least determined unknowns.

    The Jacobians are in metres and radians, separately for the equations of position and of the
    rates. The least determined unknowns have large entries in the right singular vector of the
    smallest singular value.
    """
    system = with_inputs(dae, dae.zero_inputs, 0)
    x, z = (dae.rows(record, start, 0) for record in "xz")
    labels, facts = list(leaves(dae.labels.z)), []
    moving = {*leaves(dae.labels.z.position), *leaves(dae.labels.z.rates.motion)}
    for name, block in zip(("position", "rates"), system.blocks, strict=False):
        point = 0.0, x, z, system.u[:, 0], block.stages[-1]
        jacobian = np.array(block.newton(*point)[1]) * dae.sizes.alg[block.span, None]
        _, values, right = np.linalg.svd(jacobian)
        own = labels[block.span]
        size = np.abs(right[-1]) * [label in moving for label in own]
        weak = [own[k].full for k in np.argsort(size)[::-1] if size[k] > MIN_SHARE * size.max()]
        words = f"{values[0] / values[-1]:.3g} at the start, least determined: {', '.join(weak)}"
        facts.append((f"condition of {name}", words))
    return facts
