"""Studies: ``compare`` vehicles, ``pareto``, ``track`` a plan."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slipfree.cli.common import (
    INTERRUPTED,
    MAX_PROCESSES,
    Draw,
    File,
    Settings,
    Trust,
    about,
    add_json,
    detail,
    output_option,
    print_error,
    print_facts,
    print_line,
    read_problem,
    reporting,
    studying,
    written,
)
from slipfree.cli.outputs import check_outputs, save
from slipfree.cli.outputs import draw as draw_plots
from slipfree.core.errors import ModelError
from slipfree.core.facts import TableColumn, table
from slipfree.system.interrupt import interrupt_requested
from slipfree.system.regular_files import regular_file

if TYPE_CHECKING:
    from slipfree.plan.pareto import FrontPoint

TABLE, FIGURE = "pareto.csv", "pareto.png"  # of a Pareto front
GO_ON = "repeat the command to continue"


def compare(file: File, settings: Settings = None, trust: Trust = None) -> None:
    """Compare the slip of several vehicles on one ground.

    Print whether each vehicle can roll without slip, and the slip that remains otherwise.
    """
    from slipfree.problem.build_ground import ground_facts
    from slipfree.problem.verbs.compare import compare as solve

    problem = read_problem(file, settings, trust, "compare")
    with studying("vehicles") as watch:
        ground, rows = solve(problem, watch)
        is_interrupted = interrupt_requested()
    print_facts(ground_facts(ground))
    add_json("vehicles", lambda: rows)
    for words, drive in (
        ("at the same rates", "same_rates"),
        ("at the rates of the driving law", "driving_law"),
    ):
        wheels = ", ".join(rows[0]["wheels"])
        print_line(f"\n{words}: largest slip of the wheels {wheels} [mm/s]")
        shown = list[dict[str, Any]]()
        for row in rows:
            motion = row[drive]
            values = {name: each["max"] for name, each in motion.items() if name != "stop"}
            axle, stop = "{min:.3f} to {max:.3f}".format_map(motion["axle"]), motion["stop"]
            stopped = "stopped at {time:.3g} s by {name}".format_map(stop) if stop else ""
            rank = f"{row['rank']}/{row['conditions']}"
            own = {"name": row["name"], "rank": rank, "axle": axle, "stop": stopped}
            shown.append(values | own)
        print_line("\n".join(table(COMPARED, shown)))
    print_line("\n* largest friction coefficient that a wheel requires; forces load-weighted")
    kept = f"the table contains {len(rows)} of {len(problem.spec.vehicles)} vehicles"
    _exit(kept, is_interrupted=is_interrupted)


COMPARED = (
    TableColumn("", "name"),
    TableColumn("rank", "rank"),
    TableColumn("along", "slip_along", ".2f", "mm/s"),
    TableColumn("across", "slip_across", ".2f", "mm/s"),
    TableColumn("from the poses", "slip_measured", ".1e", "mm/s"),
    TableColumn("friction*", "friction_needed", ".3f"),
    TableColumn("tilt [rad]", "tilt", ".3f"),
    TableColumn("axle [m]", "axle"),
    TableColumn("", "stop"),
)


def _exit(*kept: str, is_interrupted: bool, code: int = 0) -> None:
    """Exit with a code if a study is interrupted or incomplete; say what is kept."""
    if is_interrupted:
        print_error("; ".join(["interrupted", *kept]))
        raise typer.Exit(INTERRUPTED)
    if code:
        raise typer.Exit(code)


def pareto(
    file: File,
    against: Annotated[str, typer.Option(metavar="NAME")] = "duration",
    points: Annotated[int, typer.Option(min=2, max=1000, metavar="N")] = 7,
    settings: Settings = None,
    out: Annotated[Path | None, output_option("DIR")] = None,
    processes: Annotated[
        int, typer.Option("-j", "--processes", min=1, max=MAX_PROCESSES, metavar="P")
    ] = 1,
    draw: Draw = True,
    trust: Trust = None,
) -> None:
    """Plan motions of least slip against duration, effort or energy.

    Print the Pareto front, and write its table, its figure and the plan of every point.

    Parameters
    ----------
    against : str
        Second objective: duration, effort, energy, or the square of any quantity.
    points : int
        Number of points of the front.
    out : path, optional
        Folder of table, plans and figure; default: the problem's name with _pareto.
    processes : int
        Number of processes.
    """
    from slipfree.files.netcdf import write
    from slipfree.files.tables import write_rows
    from slipfree.problem.inputs import files_read
    from slipfree.problem.pareto import (
        GIVEN,
        FrontFolder,
        front_facts,
        front_plot,
        front_rows,
        plan_front,
        table_lines,
    )

    problem = read_problem(file, settings, trust)
    folder = out or Path(f"{problem.source.path.stem}_pareto")
    files = {k: f"point_{k + 1:02}.nc" for k in range(points)} | {GIVEN: "plan.nc"}
    outputs = [TABLE, FIGURE, *files.values()]
    check_outputs([], files_read(problem), folder=folder, names=outputs)

    def keep(number: int, point: FrontPoint) -> None:
        result, path = point.solution.result, folder / files[number]
        folder.mkdir(parents=True, exist_ok=True)
        save(path, lambda path: write(path, result.trajectory, result.arrays))
        detail(f"wrote {path}")

    with FrontFolder(folder, problem, against, points) as parts, reporting(None) as reports:
        solve = partial(plan_front, processes=processes, report=reports.search, keep=keep)
        front = solve(problem, against, points, parts=parts)
        rows = front_rows(front)
        lines = [[*row.values()] for row in rows]
        save(folder / TABLE, lambda path: write_rows(path, [*rows[0]], lines))
        code = front.outcome.exit_code
        is_interrupted = interrupt_requested() or code == INTERRUPTED
        if not is_interrupted:
            parts.remove()
    print_facts(front_facts(front))
    print_line("\n".join(["", *table_lines(front)]))
    add_json("points", lambda: rows)
    draw = draw and not is_interrupted
    if draw:
        draw_plots([front_plot(front)], folder)
    print_line(f"wrote table, plans{' and figure' if draw else ''} in {folder}")
    if code:
        unsolved = sum(not each.is_solved for each in front.points)
        verb, what = ("is", "the reason is") if unsolved == 1 else ("are", "the reasons are")
        print_error(
            f"{unsolved} of {len(front.points)} points {verb} not solved; {what} in the last "
            f"column of {folder / TABLE}"
        )
    _exit(GO_ON, is_interrupted=is_interrupted, code=code)


def track(
    file: Annotated[Path, typer.Argument(metavar="PLAN.nc")],
    settings: Settings = None,
    by: Annotated[list[str] | None, typer.Option(metavar="WAY")] = None,
    disturb: Annotated[list[str] | None, typer.Option(metavar="NAME=SIZE")] = None,
    seeds: Annotated[int, typer.Option(metavar="COUNT", min=1)] = 1,
    period: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    window: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    out: Annotated[Path | None, output_option("OUT.nc")] = None,
    draw: Draw = True,
) -> None:
    """Follow a plan in a changed world, in several ways.

    Print the distance of the end from that of the plan, the slip, and the CPU time of a cycle: with
    the inputs of the plan, the driving law along its path, replanning, and sampling. The
    controllers know the ground and the vehicle of the plan. Changes of the world are given by
    --set, as in model=quasi-static, and drawn at random by --disturb; every way meets the same
    worlds.

    Parameters
    ----------
    file : path
        Result file of a plan.
    by : list of str, optional
        Way to follow the plan: inputs, follow, replan or sampling; may be repeated. Default:
        all.
    disturb : list of str, optional
        Random disturbance of the world: heights (rms) [m]; friction, radii, inputs, relative;
        latency [s]. May be repeated.
    seeds : int
        Number of worlds, seeds 1, 2, ...
    period : float, optional
        Time between decisions, rounded to a part of the plan's duration; default: a twentieth
        of the window.
    window : float, optional
        Horizon of replan and sampling; default: a fifth of the plan's duration.
    out : path, optional
        File for the last motion, by the last way with the last seed; the figure has the same
        name with .png. Default: neither.
    """
    with about(file):
        from slipfree.files.netcdf import write
        from slipfree.problem.result import result_files
        from slipfree.problem.verbs.plan_tracking import (
            WAYS,
            follow_plan,
            tracking_lines,
            tracking_rows,
        )

        with regular_file(file, "a result file of slipfree"):
            picture = out.with_suffix(".png") if out is not None and draw else None
            check_outputs([out, picture], result_files(file))
        with studying("motions") as watch:
            test = follow_plan(
                file,
                settings or [],
                by=tuple(dict.fromkeys(by or WAYS)),
                disturb=_disturbances(disturb or []),
                seeds=seeds,
                period=period,
                window=window,
                time=lambda name, seed, t: detail(f"{name}, seed {seed}: {t:.4g} s"),
                beside=out or Path(file.name),
                watch=watch,
            )
            results = test.results
            if out is not None and results:
                last = results[-1][1]
                out = save(out, lambda path: write(path, last.trajectory, last.arrays))
            is_interrupted = interrupt_requested()
            if test.parts is not None and not is_interrupted:
                test.parts.remove()
        rows = tracking_rows(test)
        print_line("\n".join(tracking_lines(rows)))
        add_json("motions", lambda: rows)
        if out is not None and results:
            print_line(f"wrote {out}")
        if picture is not None and results and not is_interrupted:
            from slipfree.problem.verbs.plan import PlanVerb
            from slipfree.show.plan_figures import tracking_plot

            named = [(name, result.trajectory) for name, result in results]
            problem, setup = results[-1][1].problem, results[-1][1].setup
            marks = PlanVerb().marks(problem, setup.terrain.domain)
            plot = tracking_plot(picture.stem, test.plan, named, setup.ground.grid, marks)
            draw_plots([plot], picture.parent)
            print_line(f"wrote {picture}")
        code = max((result.outcome.exit_code for _, result in results), default=0)
        _exit(*written(), GO_ON, is_interrupted=is_interrupted, code=code)


def _disturbances(words: Sequence[str]) -> dict[str, float]:
    sizes = dict[str, float]()
    for each in words:
        name, _, size = each.partition("=")
        try:
            sizes[name] = float(size)
        except ValueError:
            sizes[name] = float("nan")
        if not 0 <= sizes[name] < float("inf"):
            raise ModelError(
                f"--disturb: expected NAME=SIZE with a size of at least 0, as in heights=0.02, "
                f"found {each!r}; correct it"
            )
    return sizes
