"""Commands that inspect problems, vehicles and results."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import (
    BAD_INPUT,
    File,
    Settings,
    about,
    check_place,
    read_problem,
    refuse_result,
    reported,
    show,
    tell,
)
from slipfree.cli.json_output import motion_answer, quantities, row_answer
from slipfree.cli.messages import complain, detail, has_bar, put, put_file, say, visible
from slipfree.cli.outcomes import resume_command
from slipfree.errors import DataError

if TYPE_CHECKING:
    from slipfree.problem.verbs.compare import Drive


def check(file: File, settings: Settings = None) -> None:
    """Check a problem and settle the vehicle at its start.

    The motion is not computed.
    """
    with reported():
        from slipfree.problem.solve import build
        from slipfree.problem.verbs.registry import verb_of

        problem = read_problem(file, settings)
        setup = build(problem)
        detail("settled the vehicle at its start")
        start, facts = verb_of(problem).describe_start(problem, setup)
        put("start", lambda: quantities(start))
        tell([*setup.facts, *facts])
        say("ok")


def vehicle(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Problem file, or vehicle file (TOML or URDF).")
    ],
    settings: Settings = None,
) -> None:
    """Describe the vehicle of a problem or of a vehicle file.

    Print its parts, unknowns, equations, rolling conditions and condition numbers.
    """
    with reported():
        from slipfree.problem.vehicle_report import describe

        found = describe(file, settings or [])
        say("\n".join([*found.tree, ""]))
        put("tree", lambda: found.tree)
        tell(found.facts)
        if found.faults:
            complain("\n".join(found.faults))
            raise typer.Exit(BAD_INPUT)


def compare(file: File, settings: Settings = None) -> None:
    """Compare the slip of several vehicles on one ground.

    Print whether each vehicle can roll without slip, and the slip that remains otherwise.
    """
    with reported():
        from slipfree.problem.build_ground import ground_facts
        from slipfree.problem.load import load_problem
        from slipfree.problem.verbs.compare import compare as solve

        def told(name: str) -> None:
            if sys.stderr.isatty() and has_bar():
                say(f"  {name}", err=True)
            detail(f"vehicle {name}")

        refuse_result(file)
        ground, rows = solve(load_problem(file, settings or [], command="compare"), told)
        tell(ground_facts(ground))
        put("vehicles", lambda: [row_answer(row) for row in rows])
        width = max(len(row.name) for row in rows)
        for words, drives in (
            ("at the same rates", [row.same for row in rows]),
            ("at the rates of the driving law", [row.fitting for row in rows]),
        ):
            say(f"\n{words}: largest slip of the wheels {', '.join(rows[0].wheels)} [mm/s]")
            head = f"{'rank':6}{'along':18}{'across':18}{'measured on the poses':27}"
            say(f"{'':{width}}  {head}{'friction*':10}{'tilt [rad]':12}axle [m]")
            for row, drive in zip(rows, drives, strict=True):
                rank = f"{row.rank}/{row.conditions}"
                say(f"{row.name:{width}}  {rank:6}{_drive(drive)}")
        say("\n* largest coefficient of friction that a wheel needs, load-weighted")


def _drive(drive: Drive) -> str:
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
    """Print the contents of a result file."""
    with reported(), about(file):
        from slipfree.files.netcdf import read
        from slipfree.problem.result import motion_facts
        from slipfree.problem.summary import outcome_fact, ranges

        motion = read(file, lazy=True)
        attributes = dict(motion.attributes)
        text = attributes.pop("problem", None)
        if problem:
            if text is None:
                raise DataError(
                    f"{file}: expected a result with its problem file, found none; use a file of "
                    "slipfree run"
                )
            put("problem", lambda: text)
            typer.echo(visible(text) if sys.stdout.isatty() else text, nl=False)
            return
        facts = motion_facts(motion)
        words = [(name.replace("_", " "), value) for name, value in attributes.items()]
        tell([outcome_fact(motion), *(each for each in words if each not in facts), *facts])
        if go_on := resume_command(motion, file):
            say(f"to resume: {go_on}")
        say()
        put("outcome", motion.outcome.name.lower)
        put("attributes", lambda: attributes)
        put("result", lambda: motion_answer(motion))
        show(ranges(motion))


def export(
    file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")],
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv|.geojson", help="Path of the platform in map coordinates."),
    ] = None,
    rates: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Rates of driven wheels and joints.")
    ] = None,
) -> None:
    """Export the path or the rates of a result.

    The path is for geographic information systems, the rates are for robots.
    """
    with reported(), about(file):
        from slipfree.files.export import export_path, export_rates

        if path is None and rates is None:
            raise DataError("export: expected --path, --rates or both, found neither")
        for out, write in ((path, export_path), (rates, export_rates)):
            if out is not None:
                check_place(out)
                write(file, out)
                put_file(out)
                say(f"wrote {out}")
