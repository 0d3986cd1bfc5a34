"""Commands that inspect problems, vehicles and results."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli import console, outputs
from slipfree.cli.console import BAD_INPUT, Draw, File, Force, ResultFile, Settings, Trust
from slipfree.core.errors import DataError
from slipfree.core.facts import TableColumn, of_attributes

OK = "ok", "no errors found"


def check(file: File, settings: Settings = None, trust: Trust = None) -> None:
    """Check a problem, and place the vehicle at its start.

    Print facts about ground, vehicle and start; the motion, or the mobility map, is not computed.
    """
    from slipfree.problem.load import verb_of
    from slipfree.problem.result import build
    from slipfree.problem.verbs.atlas import AtlasKeys, build_atlas

    problem = console.read_problem(file, settings, trust, "check")
    if isinstance(problem.spec, AtlasKeys):
        console.print_facts([OK, *build_atlas(problem).facts])
        return
    setup = build(problem)
    console.detail("settled the vehicle at the start")
    start, facts = verb_of(problem).describe_start(problem, setup)
    console.add_json("start", lambda: outputs.quantities(start))
    console.print_facts([OK, *setup.facts, *facts])


def ground(
    file: Annotated[Path, typer.Argument(metavar="MAP|FILE")],
    vehicle: Annotated[str | None, typer.Argument(metavar="VEHICLE")] = None,
    settings: Settings = None,
    draw: Draw = True,
    trust: Trust = None,
) -> None:
    """Describe a map, and find a start at which a vehicle stands.

    Print size, reference system, slopes, holes and doubtful heights. Maps in degrees are converted
    as by --set terrain.geographic=local. The figure shows heights, slopes and the start.

    Parameters
    ----------
    file : path
        Map of the heights, or problem file (TOML).
    vehicle : str, optional
        With a map: vehicle file (TOML, URDF or xacro), or name of the catalogue, to find a
        start at which it stands.
    """
    from slipfree.problem.build_ground import ground_facts
    from slipfree.problem.ground_survey import survey, survey_lines
    from slipfree.problem.inputs import files_read

    with console.as_arguments():
        problem, ground = console.ground_of(file, vehicle, settings or [], trust)
    with console.about(file):
        facts = survey(ground)
    console.add_json("ground", lambda: {name: fact._asdict() for name, fact in facts.items()})
    lines = [*ground_facts(ground), *survey_lines(facts, problem.spec.terrain.rolled)]
    pose: Mapping[str, float] = {}
    try:
        if vehicle is not None or file.suffix.lower() == ".toml":
            pose, standing = console.start_on(problem, ground.grid)
            lines += standing
            console.add_json("start", lambda: pose)
    finally:  # also if the vehicle has errors
        console.print_facts(lines)
    if draw:
        from slipfree.show.motion_figures import ground_plot

        folder = Path(f"{file.stem}_figures")
        outputs.check_outputs([], files_read(problem), folder=folder, names=("ground.png",))
        place = (pose["x"], pose["y"]) if pose else None
        (path,) = outputs.draw([ground_plot(ground.grid, place)], folder)
        console.print_line(f"drew {path}")


def vehicle(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    settings: Settings = None,
    write: Annotated[Path | None, typer.Option("--write", metavar="FILE")] = None,
    force: Force = False,
    picture: outputs.Picture = None,
    trust: Trust = None,
) -> None:
    """Describe the vehicle of a problem or of a vehicle file.

    Print whether the vehicle can roll without slip, inputs, dimensions, mass, wheels and guesses,
    or the errors of an invalid vehicle. With --verbose, also print the tree of parts, all notes,
    numbers of unknowns and equations, and condition numbers.

    Parameters
    ----------
    file : path
        Problem file, or vehicle file (TOML, URDF or xacro).
    write : path, optional
        Write a vehicle file with the guesses made for a URDF.
    """
    from slipfree.problem.build_vehicle import guessed_completion
    from slipfree.problem.inputs import files_named_in
    from slipfree.problem.report import describe, vehicle_plot

    outputs.check_outputs([picture], [file, *files_named_in(file)], endings=outputs.PICTURES)
    if write is not None:
        outputs.check_outputs([write], [file, *files_named_in(file)])
        outputs.write_new_file(guessed_completion(file, write.parent, trust or []), write, force)
        console.print_line(f"wrote {write}\n")
    description = describe(file, settings or [], trust or [])
    console.print_line("\n".join([*description.tree[: None if description.faults else 1], ""]))
    console.add_json("tree", lambda: description.tree)
    console.add_json("wheels", lambda: description.wheels)
    console.print_facts(description.facts, description.details)
    if description.wheels:
        columns = [TableColumn(name, name) for name in description.wheels[0]]
        console.print_line()
        console.print_table(columns, description.wheels)
    if description.faults:
        console.print_error("\n".join(description.faults))
        raise typer.Exit(BAD_INPUT)
    if picture is not None:
        outputs.save_picture(vehicle_plot(file, settings or [], trust or []), picture)


def info(file: ResultFile, problem: Annotated[bool, typer.Option("--problem")] = False) -> None:
    """Print the outcome and all facts of a result.

    With --verbose, print also the range of every quantity.

    Parameters
    ----------
    problem : bool
        Print the stored problem file instead.
    """
    with console.about(file):
        from slipfree.files.atlas_files import is_atlas
        from slipfree.files.netcdf import FIT, attributes_of, read
        from slipfree.problem.result import STORED, facts_of
        from slipfree.problem.verbs.base import outcome_fact, ranges

        if is_atlas(file):
            from slipfree.problem.report import atlas_lines

            summary, set_up, _ = atlas_lines(file)
            console.print_facts([*summary, *set_up])
            return
        if FIT in attributes_of(file):
            from slipfree.problem.verbs.fit import read_fit

            console.print_facts(read_fit(file)["facts"])
            return
        motion = read(file, lazy=True)
        attributes = dict(motion.attributes)
        text = attributes.pop("problem", None)
        attributes.pop(STORED, None)
        if problem:
            if text is None:
                raise DataError(
                    f"{file}: expected a result with its problem file, found none; use a file of "
                    "slipfree run"
                )
            console.add_json("problem", lambda: text)
            typer.echo(console.visible(text) if sys.stdout.isatty() else text, nl=False)
            return
        facts, summary = facts_of(motion)
        lines = (each for each in of_attributes(attributes) if each not in summary)
        console.print_facts([outcome_fact(motion), *summary, *lines])
        if go_on := outputs.resume_command(motion, file):
            console.print_line(f"to resume: {go_on}")
        console.add_json("outcome", motion.outcome.name.lower)
        console.add_json("attributes", lambda: attributes)
        console.add_json("result", lambda: outputs.motion_json(motion, facts))
        if console.output_options().verbose:
            console.print_line()
            console.show(ranges(motion))
        else:
            command = shlex.join(["slipfree", "info", "-v", str(file)])
            console.print_line(f"ranges of all quantities: {command}")


def export(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    path: Annotated[Path | None, typer.Option(metavar="FILE.csv|.geojson")] = None,
    rates: Annotated[Path | None, typer.Option(metavar="FILE.csv")] = None,
    mcap: Annotated[Path | None, typer.Option(metavar="FILE.mcap")] = None,
    code: Annotated[Path | None, typer.Option("--c", metavar="DIR")] = None,
    trust: Trust = None,
) -> None:
    """Export a motion for ROS or GIS, or a vehicle as C code.

    The path is for geographic information systems, the rates are for robots, the motion is for
    Foxglove and RViz. The C code is for the controller of a robot: it returns the rates of wheels
    and joints for velocities of the platform, and the pose on the ground.

    Parameters
    ----------
    file : path
        Result file; with --c, a problem or vehicle file.
    path : path, optional
        Write the platform's path in map coordinates.
    rates : path, optional
        Write the rates of driven wheels and joints.
    mcap : path, optional
        Write path, joints, transforms and slip for ROS 2.
    code : path, optional
        Write inverse kinematics and contact of the vehicle as C code with a test.
    """
    with console.about(file):
        from slipfree.files.mcap import ros_package
        from slipfree.files.netcdf import export_path, export_rates
        from slipfree.problem.result import export_code, export_mcap, result_files

        if mcap is not None:
            ros_package()
        exports = path, rates, mcap
        if (code is None) == (exports == (None, None, None)):
            raise DataError(
                "export: expected --path, --rates or --mcap with a result, or --c with a problem "
                f"or vehicle file, found {'none' if code is None else 'both'}; "
                f"{'add one of them' if code is None else 'omit --c'}"
            )
        if code is not None:
            console.refuse_result(file)
            files, command = export_code(file, code, trust or ())
            for each in files:
                console.print_written(each)
            console.add_json("test", lambda: command)
            console.print_line(f"to test: {command}")
            return
        outputs.check_outputs(exports, result_files(file))
        for out, write in ((path, export_path), (rates, export_rates), (mcap, export_mcap)):
            if out is not None:
                write(file, out)
                console.print_written(out)
