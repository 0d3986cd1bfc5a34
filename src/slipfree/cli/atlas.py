"""``slipfree atlas``: mobility map of a vehicle, from a map and a vehicle, or from a problem."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slipfree.cli import console, outputs
from slipfree.cli.console import Draw, Processes, Scheduler, Settings, Trust, output_option
from slipfree.core.errors import DataError

if TYPE_CHECKING:
    from slipfree.core.facts import Lines
    from slipfree.problem.build_ground import GroundMap
    from slipfree.problem.problem import Problem
    from slipfree.terrain.base import Grid

UNBOUNDED = "1e99"  # bound that no quantity reaches
ANY_VEHICLE = "three_wheeler"  # of a problem of which only the map is read
ENDINGS = (".tif", ".tiff", ".nc")
ARGUMENTS = {  # of the command, by the settings that they stand for
    "--set terrain.file": "MAP",
    "--set vehicle.file": "VEHICLE",
    "--set vehicle.catalog": "VEHICLE",
    "--set terrain.friction": "--friction",
    "--set atlas.within.": "--within ",
    **{f"--set atlas.{name}": f"--{name}" for name in ("headings", "every", "error", "guarantee")},
}


def atlas(
    file: Annotated[Path, typer.Argument(metavar="MAP|FILE")],
    vehicle: Annotated[str | None, typer.Argument(metavar="VEHICLE")] = None,
    headings: Annotated[int | None, typer.Option(metavar="N")] = None,
    every: Annotated[int | None, typer.Option(metavar="N")] = None,
    friction: Annotated[str | None, typer.Option(metavar="MU")] = None,
    error: Annotated[float | None, typer.Option(metavar="METRES")] = None,
    guarantee: Annotated[float | None, typer.Option(metavar="METRES")] = None,
    within: Annotated[list[str] | None, typer.Option(metavar="NAME=LOW..HIGH")] = None,
    out: Annotated[list[Path] | None, output_option("OUT.tif|OUT.nc")] = None,
    processes: Processes = None,
    scheduler: Scheduler = None,
    settings: Settings = None,
    draw: Draw = True,
    trust: Trust = None,
) -> None:
    """Map where and at which headings a vehicle can stand.

    Print a summary, write maps of pose, tip-over margin and least friction, and draw figures. Tiles
    that are finished are kept in a folder beside the output until all files are written: repeat the
    command to continue.

    Parameters
    ----------
    file : path
        Map of the heights, or problem file with verb = 'atlas'.
    vehicle : str, optional
        With a map: vehicle file (TOML, URDF or xacro), or name of the catalogue.
    headings : int, optional
        Number of equally spaced headings; default: 16.
    every : int, optional
        Use every N-th node of the map along both axes.
    friction : str, optional
        Coefficient of friction of the ground, or a map file of it.
    error : float, optional
        Compute the extremes of pose, margin, clearance and friction on grounds that differ from
        the map by at most this.
    guarantee : float, optional
        Prove bounds of the poses on all grounds that differ from the map by at most this.
    within : list of str, optional
        Bounds of a quantity, as in roll=-0.2..0.2: other headings are not allowed; repeatable.
    out : list of path, optional
        GeoTIFF of the maps over the headings, or netCDF file of all poses; repeatable. Default:
        PROBLEM.tif, or MAP_VEHICLE_atlas.tif, in the current folder.
    """
    from slipfree.problem.inputs import files_read
    from slipfree.problem.verbs import atlas as verb

    workers = console.workers_of(processes, scheduler)
    values = {
        "atlas.headings": headings,
        "atlas.every": every,
        "atlas.error": error,
        "atlas.guarantee": guarantee,
        "terrain.friction": None if friction is None else _toml(friction),
    }
    own = [f"{key}={value}" for key, value in values.items() if value is not None]
    for words in within or []:
        name, equals, bounds = words.partition("=")
        low, dots, high = bounds.partition("..")
        if not (name and equals and dots):
            raise DataError(
                f"--within: expected NAME=LOW..HIGH, as in roll=-0.2..0.2, found {words!r}; "
                "correct it"
            )
        ends = _toml(low, f"-{UNBOUNDED}"), _toml(high, UNBOUNDED)
        own.append(f"atlas.within.{name}=[{', '.join(ends)}]")
    own += settings or []
    with as_arguments():
        if vehicle is not None:
            problem = problem_of_map(file, vehicle, own, trust)
        elif file.suffix.lower() == ".toml":
            problem = console.read_problem(file, own, trust, "atlas")
        else:
            console.refuse_result(file)
            raise DataError(
                f"{file}: expected a problem file (.toml), or a map and a vehicle, found no "
                f"vehicle; name one: slipfree atlas {shlex.quote(str(file))} VEHICLE"
            )
    named = file.stem if vehicle is None else f"{file.stem}_{Path(vehicle).stem}_atlas"
    outs = out or [Path(f"{named}.tif")]
    states = verb.input_states(problem)
    figures = outs[0].parent / f"{outs[0].stem}_figures"
    inputs = files_read(problem)
    outputs.check_outputs(outs, inputs, endings=ENDINGS, folder=figures if draw else None)
    with as_arguments():
        setup = verb.build_atlas(problem)
    console.print_facts(setup.facts, main=[setup.facts[0], setup.facts[-1]])
    for words in setup.warnings:
        console.warn(words)
    with verb.TileFolder(outs[0], setup, states) as tiles:
        with console.studying("tiles", tiles) as watch:
            verb.run_tiles(setup, tiles, workers, watch)
            files = [
                outputs.save(each, lambda path: verb.write_file(path, setup, tiles))
                for each in outs
            ]
            view, facts = verb.overview(setup.x, setup.y, setup.site, tiles.tiles())
        tiles.remove()
    console.print_facts(verb.summary_lines(facts))
    console.add_json("atlas", lambda: {name: fact._asdict() for name, fact in facts.items()})
    if not facts["allowed_share"].value:
        console.warn("no pose is allowed; the summary lists the reasons")
    console.print_line(f"wrote {', '.join(map(str, files))}")
    if draw:
        from slipfree.show.atlas_figures import atlas_plots

        outputs.draw_figures(atlas_plots(view), figures)


def _toml(text: str, default: str = "") -> str:
    try:
        return repr(float(text))
    except ValueError:
        return json.dumps(text) if text.strip() else default


def problem_of_map(
    file: Path, vehicle: str, settings: Sequence[str], trust: list[Path] | None
) -> Problem[Any]:
    """Return the problem of the mobility map of a vehicle, a file or name of the catalogue."""
    from slipfree.files.urdf.xacro import trusted_paths
    from slipfree.problem.load import load_again
    from slipfree.problem.schema import CATALOG

    if file.suffix.lower() == ".toml":
        raise DataError(
            f"{file}: expected a map before the vehicle {vehicle!r}, found a TOML file; omit "
            "VEHICLE for a problem file"
        )
    is_known = vehicle in CATALOG and not Path(vehicle).exists()
    if not is_known and not Path(vehicle).suffix:
        raise DataError(
            f"VEHICLE: expected a vehicle file, or one of {', '.join(CATALOG)}, found {vehicle!r}; "
            "correct the name"
        )
    key = "catalog" if is_known else "file"
    own = ["verb=atlas", f"terrain.file={json.dumps(str(file))}"]
    own.append(f"vehicle.{key}={json.dumps(vehicle)}")
    # names of files are relative to the current folder
    head = Path("atlas"), "", [*own, *settings], trusted_paths(trust or [])
    return load_again(*head, command="atlas")


def ground_of(
    file: Path, vehicle: str | None, settings: Sequence[str], trust: list[Path] | None
) -> tuple[Problem[Any], GroundMap]:
    """Return a problem with the map, and its ground; maps in degrees are converted."""
    from slipfree.files.maps.elevation import DegreesError
    from slipfree.files.toml import ProblemError
    from slipfree.problem.build_ground import build_ground

    if file.suffix.lower() == ".toml" and vehicle is None:
        problem = console.read_problem(file, [*settings], trust, "vehicle")
        return problem, build_ground(problem)
    settings = ["frame=rep103", *settings]
    problem = problem_of_map(file, vehicle or ANY_VEHICLE, settings, trust)
    try:
        return problem, build_ground(problem)
    except ProblemError as error:
        if not isinstance(error.__cause__, DegreesError):
            raise
    key = "terrain.geographic=local"
    console.print_line(f"the map is in degrees; it is converted to metres by --set {key}")
    problem = problem_of_map(file, vehicle or ANY_VEHICLE, [key, *settings], trust)
    return problem, build_ground(problem)


def start_on(problem: Problem[Any], grid: Grid) -> tuple[Mapping[str, float], Lines]:
    """Return a start at which a vehicle stands, see `stand`, and show the progress."""
    from slipfree.problem.ground_survey import stand

    with as_arguments(), console.counted("poses tried for a start") as progress:
        return stand(problem, grid, progress)


@contextmanager
def as_arguments() -> Iterator[None]:
    """Name the options and arguments of this command in messages, not their settings."""
    from slipfree.files.toml import ProblemError

    try:
        yield
    except ProblemError as error:
        faults = []
        for fault in error.faults:
            for setting, option in ARGUMENTS.items():
                if fault.startswith(setting):
                    fault = option + fault.removeprefix(setting)
            faults.append(fault)
        raise ProblemError(*faults) from error
