"""Keys of the problems with ``verb = "inverse"``, and commands in them and in files."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np
from pydantic import Field

from slipfree.core.errors import DataError, ModelError
from slipfree.core.facts import printed_unit
from slipfree.files.logs import read_log
from slipfree.files.tables import read_names
from slipfree.files.toml.source import Fault, format_value, problem_error
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import Angles, Column, Piecewise, Record, TimeFunction, bare_words
from slipfree.models.given_rates import COMMANDS, ROBOT, UNITS
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, S
from slipfree.problem.schema import FILE, VERB, MotionKeys, TerrainKeys, Time
from slipfree.problem.units import check_time_unit
from slipfree.solve.sampling import input_samples
from slipfree.vehicle.formula import evaluate

TIMEOUT = "timeout"  # key of [given] beside 'file'


class PathTable(Record):
    """Timed path: positions and headings of the platform's centre, as arrays or from a file."""

    t: Column | None = Field(default=None, description="times, increasing from 0 [s]")
    x: Column | None = Field(default=None, description="x at these times [m]")
    y: Column | None = Field(default=None, description="y at these times [m]")
    heading: Angles | None = Field(default=None, description="headings at these times [rad]")
    file: str | None = Field(default=None, description="CSV file with the columns t, x, y, heading")


class Inverse(MotionKeys):
    """Inverse problem: wheel and steering rates for given platform rates or a platform path."""

    verb: Literal["inverse"] = Field(description=VERB)
    given: dict[str, TimeFunction] | None = Field(
        default=None,
        description="rates of the platform by name, or 'file', a CSV file of rates over time, with "
        "'timeout', the time after which a rate that is not given again is zero; by default it is "
        "held [m/s, rad/s, s]",
    )
    exact: bool | None = Field(
        default=None,
        description="whether rates in the heading frame are met exactly; otherwise their errors "
        "are minimised; true by default unless all three are given",
    )
    path: PathTable | None = Field(default=None, description="a timed path, instead of given rates")
    steering: Literal["rate", "angle"] = Field(
        default="angle", description="unknown of the steering: its rate or its angle"
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        **TerrainKeys.alternatives,
        (): ("given", "path"),
        ("path",): ("t", "file"),
    }

    @property
    def named_files(self) -> tuple[str, ...]:
        """Name of the CSV file of commands; empty without such a file."""
        file = (self.given or {}).get(FILE)
        return (file,) if isinstance(file, str) else ()

    def faults(self) -> Iterator[Fault]:
        """Yield the errors of values that contradict each other, such as arrays of a path."""
        yield from super().faults()
        path = self.path
        if path is None:
            return
        times = path.t or ()
        if path.heading and (words := bare_words(path.heading[0])):
            yield Fault(("path", "heading"), words, format_value(path.heading[0]))
        for name in ("x", "y", "heading"):
            place, column = ("path", name), getattr(path, name)
            if path.file is not None and column is not None:
                yield Fault(
                    place, "no array beside 'file'", f"{format_value(list(column))}; remove one"
                )
            elif path.file is None and len(column or ()) != len(times):
                expected = f"an array of {len(times)} numbers, one for each time in 't'"
                found = "none" if column is None else f"an array of {len(column)}"
                yield Fault(place, expected, found)


def are_commands(given: Collection[str]) -> bool:
    """Return whether given rates are commands in the heading frame, or a file of them."""
    names = set(given)
    return FILE in names or (bool(names) and (names <= set(COMMANDS) or names <= set(ROBOT)))


def read_commands(problem: Problem[S], spec: Inverse) -> tuple[dict[str, Any], str]:
    """Return the commands of a problem by the names of `COMMANDS`, and their description."""
    given, columns, descriptions = dict(spec.given or {}), dict[str, Any](), []
    timeout = given.pop(TIMEOUT, None)
    if timeout is not None and not (FILE in given and isinstance(timeout, float) and timeout > 0):
        fault = Fault(
            ("given", TIMEOUT), "a positive time in s, beside 'file'", format_value(timeout)
        )
        raise problem_error(problem.source, [fault])
    if (file := given.pop(FILE, None)) is not None:
        with at(problem, ("given", FILE)):
            if not isinstance(file, str):
                raise DataError(
                    "expected the name of a CSV file in quotes, found "
                    f"{format_value(file)}; put the name in quotes"
                )
            columns, notes = _read_file(problem.folder / file, spec.time.duration, timeout)
        descriptions = ["; ".join([f"{', '.join(columns)} of {file}", *notes])]
    if faults := [*_faults(spec, given, columns)]:
        raise problem_error(problem.source, faults)
    for name, value in given.items():
        if isinstance(value, str):
            with at(problem, ("given", name)):
                _check_formula(value, spec.time)
    for name, value in given.items():
        descriptions.append(f"{name} {_rate_words(value)} {printed_unit(UNITS[name])}")
    return {
        ROBOT.get(name, name): _negative(value) if name == "v_y" else value
        for name, value in (columns | given).items()
    }, ", ".join(descriptions)


def _read_file(
    file: Path, duration: float, timeout: float | None
) -> tuple[dict[str, Piecewise], list[str]]:
    """Return the commands of a table by name, constant until the next row, and notes on them.

    A command that is not followed by another one within ``timeout`` is zero after it [s].
    """
    names = read_names(file, "commands")
    rates = [name for name in names if name != "t"]
    if len(set(names)) < len(names) or "t" not in names or not are_commands(rates) or FILE in rates:
        raise DataError(
            f"{file}: expected a first line with the names of columns, each once: t, and one or "
            f"more of {', '.join(COMMANDS)} or one or more of {', '.join(ROBOT)}, found "
            f"{','.join(names)!r}; correct the first line"
        )
    units = {name: printed_unit(UNITS[name]) for name in rates}
    log = read_log(file, ["t", *rates], rates, kind="commands", units=units)
    t = log.t
    if not t.size:
        raise DataError(f"{file}: expected one or more rows of numbers, found only names; add rows")
    if t[0] != 0:
        raise DataError(f"{file}: expected 0 as the first time, found {t[0]:g} s; shift the times")
    kept = np.append(np.diff(t) > 0, True)
    values = np.column_stack([log.values[name] for name in rates])
    if (values[:-1][~kept[:-1]] != values[1:][~kept[:-1]]).any():
        k = int(kept.argmin())
        raise DataError(
            f"{file}: expected increasing times, found {t[k]:g} s after {t[k]:g} s with other "
            "values; keep one row for each time"
        )
    t, values = t[kept], values[kept]
    check_time_unit(t, duration)
    waits = np.diff(t, append=max(duration, t[-1]))
    k = int(waits.argmax())
    words = f"held for at most {waits[k]:.3g} s, from {t[k]:g} s"
    if timeout is not None and waits[k] > timeout:
        late = waits > timeout
        words = (
            f"zero {timeout:g} s after the last command, for at most {waits[k] - timeout:.3g} s, "
            f"from {t[k] + timeout:g} s"
        )
        order = np.argsort(np.append(t, t[late] + timeout), kind="stable")
        t = np.append(t, t[late] + timeout)[order]
        values = np.vstack([values, 0 * values[late]])[order]
    notes = [*log.notes, *log.rows_left_out, words]
    columns = zip(rates, values.T.tolist(), strict=True)
    return {name: tuple(zip(t.tolist(), rate, strict=True)) for name, rate in columns}, notes


def _faults(spec: Inverse, given: Mapping[str, Any], columns: Collection[str]) -> Iterator[Fault]:
    """Yield errors in commands: names of other kinds, repeated names, wrong frame or steering."""
    if spec.steering != "angle":
        expected = f"'angle' with given rates {', '.join(COMMANDS)}"
        yield Fault(("steering",), expected, f"{spec.steering!r}; remove the key")
    for name in given:
        if not are_commands({name, *columns}):
            yield Fault(
                ("given", name),
                f"rates of the same kind as {', '.join(columns)} in the CSV file",
                f"{name!r}; remove it, or give all rates in one frame",
            )
        elif name in columns:
            expected, found = "only rates that are not in the CSV file", f"{name!r}; remove it"
            yield Fault(("given", name), expected, found)
    if spec.frame != "rep103" and (robot := [n for n in (*columns, *given) if n in ROBOT]):
        place = ("given", robot[0] if robot[0] in given else FILE)
        expected = f"{', '.join(COMMANDS)}, or frame = 'rep103' with {', '.join(ROBOT)} (v_y left)"
        found = f"{robot[0]} in the frame {spec.frame!r}; set frame = 'rep103', or give the former"
        yield Fault(place, expected, found)


def _check_formula(text: str, time: Time) -> None:
    t, symbol = input_samples(time.duration, time.step, {})[0], ca.SX.sym("t")
    try:
        value = evaluate(text, {"t": symbol})
    except ModelError as error:
        raise ModelError(f"{error}; a rate may be a formula of t, in seconds") from error
    rates = np.array(ca.Function("rate", [symbol], [value])(t[None])).ravel()
    if not np.isfinite(rates).all():
        k = int(np.flatnonzero(~np.isfinite(rates))[0])
        raise ModelError(
            f"expected finite values of {text!r}, found {rates[k]:g} at t = {t[k]:g} s; change the "
            "formula"
        )


def _negative(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple((t, -rate) for t, rate in value)
    return f"-({value})" if isinstance(value, str) else -value


def _rate_words(value: float | Piecewise | str) -> str:
    if isinstance(value, tuple):
        return " then ".join(f"{rate:g}" for _, rate in value)
    return value if isinstance(value, str) else f"{value:g}"
