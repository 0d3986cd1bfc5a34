"""Commands that inspect problems, vehicles and results."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import (
    BAD_INPUT,
    File,
    InputFolder,
    Settings,
    Trust,
    about,
    print_facts,
    read_problem,
    reported,
    show,
)
from slipfree.cli.messages import (
    INTERRUPTED,
    add_json,
    add_json_file,
    detail,
    has_bar,
    print_error,
    print_line,
    visible,
)
from slipfree.cli.new import write_new_file
from slipfree.cli.outputs import check_outputs, motion_json, quantities, resume_command, row_json
from slipfree.core.errors import DataError
from slipfree.system.interrupt import held_interrupt, interrupt_requested

if TYPE_CHECKING:
    from slipfree.problem.verbs.compare import ComparedMotion


def check(file: File, settings: Settings = None, trust: Trust = None) -> None:
    """Check a problem, and settle the vehicle on the ground at the start of the motion.

    Print facts about ground, vehicle and start; the motion is not computed.
    """
    with reported():
        from slipfree.problem.load import verb_of
        from slipfree.problem.result import build

        problem = read_problem(file, settings, trust)
        setup = build(problem)
        detail("settled the vehicle at the start")
        start, facts = verb_of(problem).describe_start(problem, setup)
        add_json("start", lambda: quantities(start))
        print_facts([*setup.facts, *facts])
        print_line("ok")


def vehicle(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Problem file, or vehicle file (TOML, URDF or xacro)."),
    ],
    settings: Settings = None,
    write: Annotated[
        Path | None,
        typer.Option(
            "--write", metavar="FILE", help="Write a vehicle file with the guesses made for a URDF."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    trust: Trust = None,
) -> None:
    """Describe the vehicle of a problem or of a vehicle file.

    Print parts, unknowns, equations, rolling conditions and condition numbers of the vehicle, and
    the errors of an invalid one.
    """
    with reported():
        from slipfree.problem.build_vehicle import guessed_completion
        from slipfree.problem.inputs import files_named_in
        from slipfree.problem.report import describe

        if write is not None:
            check_outputs([write], [file, *files_named_in(file)])
            write_new_file(guessed_completion(file, write.parent, trust or []), write, force)
            print_line(f"wrote {write}\n")
        found = describe(file, settings or [], trust or [])
        print_line("\n".join([*found.tree, ""]))
        add_json("tree", lambda: found.tree)
        print_facts(found.facts)
        if found.faults:
            print_error("\n".join(found.faults))
            raise typer.Exit(BAD_INPUT)


def compare(file: File, settings: Settings = None, trust: Trust = None) -> None:
    """Compare the slip of several vehicles on one ground.

    Print whether each vehicle can roll without slip, and the slip that remains otherwise.
    """
    with reported():
        from slipfree.problem.build_ground import ground_facts
        from slipfree.problem.verbs.compare import compare as solve

        def print_progress(name: str) -> None:
            if sys.stderr.isatty() and has_bar():
                print_line(f"  {name}", err=True)
            detail(f"vehicle {name}")

        problem = read_problem(file, settings, trust, "compare")
        with held_interrupt():
            ground, rows = solve(problem, print_progress)
            is_interrupted = interrupt_requested()
        print_facts(ground_facts(ground))
        add_json("vehicles", lambda: [row_json(row) for row in rows])
        width = max(len(row.name) for row in rows)
        for words, drives in (
            ("at the same rates", [row.same for row in rows]),
            ("at the rates of the driving law", [row.fitting for row in rows]),
        ):
            print_line(f"\n{words}: largest slip of the wheels {', '.join(rows[0].wheels)} [mm/s]")
            head = f"{'rank':6}{'along':18}{'across':18}{'from the poses':27}"
            print_line(f"{'':{width}}  {head}{'friction*':10}{'tilt [rad]':12}axle [m]")
            for row, drive in zip(rows, drives, strict=True):
                rank = f"{row.rank}/{row.conditions}"
                print_line(f"{row.name:{width}}  {rank:6}{_drive(drive)}")
        print_line("\n* largest friction coefficient that a wheel requires; forces load-weighted")
        if is_interrupted:
            count = f"{len(rows)} of {len(problem.spec.vehicles)}"
            print_error(f"interrupted; the table contains {count} vehicles")
            raise typer.Exit(INTERRUPTED)


def _drive(drive: ComparedMotion) -> str:
    slips = "".join(
        f"{' '.join(f'{1e3 * value:.2f}' for value in values):18}"
        for values in (drive.along, drive.across)
    )
    measured = " ".join(f"{1e3 * value:.1e}" for value in drive.measured)
    axle = " to ".join(f"{value:.3f}" for value in drive.width)
    stop = f", stopped at {drive.stop.t:.3g} s by {drive.stop.name}" if drive.stop else ""
    return f"{slips}{measured:27}{drive.friction:<10.3f}{drive.tilt:<12.3f}{axle}{stop}"


def info(
    file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")],
    problem: Annotated[
        bool, typer.Option("--problem", help="Print the stored problem file instead.")
    ] = False,
) -> None:
    """Print outcome, attributes and ranges of the quantities of a result file."""
    with reported(), about(file):
        from slipfree.files.netcdf import read
        from slipfree.problem.inputs import STORED
        from slipfree.problem.result import facts_of, motion_facts
        from slipfree.problem.verbs.base import outcome_fact, ranges

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
            add_json("problem", lambda: text)
            typer.echo(visible(text) if sys.stdout.isatty() else text, nl=False)
            return
        facts = motion_facts(motion)
        words = [(name.replace("_", " "), value) for name, value in attributes.items()]
        print_facts([outcome_fact(motion), *(each for each in words if each not in facts), *facts])
        if go_on := resume_command(motion, file):
            print_line(f"to resume: {go_on}")
        print_line()
        add_json("outcome", motion.outcome.name.lower)
        add_json("attributes", lambda: attributes)
        add_json("result", lambda: motion_json(motion, facts_of(motion)))
        show(ranges(motion))


def export(
    file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")],
    path: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv|.geojson", help="Write the platform's path in map coordinates."
        ),
    ] = None,
    rates: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Write the rates of driven wheels and joints."),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.mcap", help="Write path, joints, transforms and slip for ROS 2."
        ),
    ] = None,
    folder: InputFolder = None,
) -> None:
    """Export the path, the rates or the whole motion of a result.

    The path is for geographic information systems, the rates are for robots, the motion is for
    Foxglove and RViz.
    """
    with reported(), about(file):
        from slipfree.files.export import export_path, export_rates
        from slipfree.problem.result import export_mcap, result_files

        if path is None and rates is None and mcap is None:
            raise DataError(
                "export: expected --path, --rates or --mcap, found none; add one of them"
            )
        write_motion = partial(export_mcap, folder=folder)
        check_outputs([path, rates, mcap], result_files(file, folder))
        for out, write in ((path, export_path), (rates, export_rates), (mcap, write_motion)):
            if out is not None:
                write(file, out)
                add_json_file(out)
                print_line(f"wrote {out}")
