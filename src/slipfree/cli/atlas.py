"""``slipfree atlas``: mobility map of a vehicle, from a map and a vehicle, or from a problem."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli import console, outputs
from slipfree.cli.console import Draw, Processes, Scheduler, Settings, Trust, output_option
from slipfree.core.errors import DataError
from slipfree.core.facts import as_attributes, guesses

UNBOUNDED = "1e99"  # bound that no quantity reaches
ENDINGS = (".tif", ".tiff", ".nc")


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
    with console.as_arguments():
        if vehicle is not None:
            problem, _ = console.ground_of(file, vehicle, own, trust, "paper")
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
    earlier = ", which replaces the earlier file" * outs[0].exists()
    with console.as_arguments():
        setup = verb.build_atlas(problem)
    main = [setup.facts[0], setup.facts[-1], *guesses(as_attributes(setup.facts))]
    console.print_facts(setup.facts, main=main)
    for words in setup.warnings:
        console.warn(words)
    with verb.TileFolder(outs[0], setup, states) as tiles:
        if tiles.missing and problem.spec.atlas.compiled and console.has_bar():
            words = "compiling the equations, for up to a minute unless they are known"
            console.print_line(words, err=True)
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
    console.print_line(f"wrote {', '.join(map(str, files))}{earlier}")
    if draw:
        from slipfree.show.atlas_figures import atlas_plots

        outputs.draw_figures(atlas_plots(view), figures)


def _toml(text: str, default: str = "") -> str:
    try:
        return repr(float(text))
    except ValueError:
        return json.dumps(text) if text.strip() else default
