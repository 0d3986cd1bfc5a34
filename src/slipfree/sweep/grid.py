"""Grid of a sweep: values of keys, seeds, and the settings of every run."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.errors import DataError, shortened
from slipfree.core.version import __version__
from slipfree.files.toml.source import key_path, load_toml
from slipfree.files.urdf.xacro import trusted_paths
from slipfree.problem.inputs import FileStates, file_states, input_files, input_names
from slipfree.problem.load import load_variants
from slipfree.problem.problem import Problem
from slipfree.show.swept import Varied

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
RANGE = re.compile(rf"\s*({NUMBER})\s*:\s*({NUMBER})\s*:\s*(\d+)\s*")
WHOLE = re.compile(r"\s*[+-]?\d+\s*")
DIGITS = 12  # significant digits of the values of a range: 0.3, not 0.30000000000000004
MAX_RUNS = 100_000
SEED = "seed"  # last part of the keys that repetitions change


class Run(NamedTuple):
    """One run of a sweep."""

    number: int  # number of the run; the first is 1
    values: tuple[str, ...]  # one value per varied key
    seeds: tuple[int, ...]  # one seed for each key in `Sweep.seeds`
    # all settings that replace values of the problem file, as ``key=value``
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Sweep:
    """A problem and its varied keys."""

    problem: Problem[Any]  # of the first run
    settings: tuple[str, ...]  # settings of all runs
    axes: tuple[Varied, ...]
    # keys of the seeds that every repetition changes; empty without repetitions
    seeds: tuple[str, ...]
    repeat: int  # number of repetitions of every point of the grid
    seed: int
    files: FileStates  # all input files

    @property
    def keys(self) -> tuple[str, ...]:
        """The varied keys, then the keys of the seeds."""
        return (*(axis.name for axis in self.axes), *self.seeds)

    @property
    def count(self) -> int:
        """Number of runs."""
        return int(np.prod([len(axis.values) for axis in self.axes], dtype=int)) * self.repeat

    def run(self, number: int) -> Run:
        """Return a run; the seeds vary fastest, then the last key."""
        *at, k = np.unravel_index(
            number - 1, (*(len(each.values) for each in self.axes), self.repeat)
        )
        values = tuple(axis.values[i] for axis, i in zip(self.axes, at, strict=True))
        # each key has seeds of its own: equal seeds would correlate, for example, the random ground
        # and its elevation error
        seeds = tuple(self.seed + int(k) + self.repeat * i for i in range(len(self.seeds)))
        pairs = zip(self.keys, (*values, *map(str, seeds)), strict=True)
        own = (f"{key}={value}" for key, value in pairs)
        return Run(number, values, seeds, (*self.settings, *own))

    @property
    def head(self) -> dict[str, Any]:
        """Identity of the sweep for the first line of the log; equal for comparable results."""
        text = "\n".join(self.problem.source.text.splitlines())
        return {
            "slipfree": __version__,
            "problem": {"": hashlib.sha256(text.encode()).hexdigest()},
            "files": self.files.digests,
            "settings": list(self.settings),
            "vary": {axis.name: list(axis.values) for axis in self.axes},
            "repeat": self.repeat,
            "seeds": dict.fromkeys(self.seeds, self.seed),
        }


def sweep_of(
    file: Path,
    vary: Sequence[str],
    settings: Sequence[str] = (),
    repeat: int | None = None,
    seed: int = 1,
    progress: Callable[[int, int], None] = lambda _, __: None,
    trust: Sequence[Path] = (),
) -> Sweep:
    """Return the sweep of a problem file, after a check of every value.

    The keys ``vary`` are given as ``key=a:b:n`` for n equally spaced numbers from a to b, or as
    ``key=v1,v2,...`` for values in TOML or words without quotes; all combinations are run. Each
    value is checked separately, with the first values of the other keys; a run with an invalid
    combination fails. ``repeat`` is the number of runs of each combination, with seeds from
    ``seed`` on; by default one run has the seed of the file. ``progress`` is called with the
    numbers of checked and of all values.

    DataError is raised if ``vary`` is invalid, contains a key twice or contains a key of
    ``settings``, if there are more than 100 000 runs, or if the problem has no seed for
    repetitions; a `ProblemError` if a value is invalid.
    """
    axes = tuple(axis_of(each) for each in vary)
    _check_keys(axes, settings)
    sizes = int(np.prod([len(axis.values) for axis in axes], dtype=object)) * (repeat or 1)
    if sizes > MAX_RUNS:
        raise DataError(
            f"sweep: expected at most {MAX_RUNS} runs, found {sizes}; vary fewer values, or "
            "reduce --repeat"
        )
    problems = load_variants(file, settings, _checked_points(axes))
    first = replace(next(problems), trusted=trusted_paths(trust))
    files, count = input_files(first), sum(len(axis.values) for axis in axes)
    for done, problem in enumerate(problems, 1 + len(axes)):
        if not {*input_names(problem.spec)} <= files.keys():
            files |= input_files(problem)
        progress(done, count)
    bare = Sweep(first, tuple(settings), axes, (), 1, seed, file_states(files))
    if repeat is None:
        return bare
    known = seed_keys(bare.problem.spec.model_dump())
    seeds = tuple(key for key in known if key not in bare.keys)
    if not seeds:
        where = bare.problem.source.path
        raise DataError(
            f"{where}: expected a key that ends in .{SEED} for --repeat, found "
            + (f"only {', '.join(known)}, which --vary changes" if known else "none")
            + "; add a table with a seed, such as [terrain.synthetic.power_law] or "
            "[terrain.error], or omit --repeat"
        )
    return replace(bare, seeds=seeds, repeat=repeat)


def _checked_points(axes: Sequence[Varied]) -> Iterator[list[str]]:
    """Yield the first point of a grid, then those that differ from it in one value."""
    first = [f"{axis.name}={axis.values[0]}" for axis in axes]
    yield first
    for k, axis in enumerate(axes):
        for value in axis.values[1:]:
            yield [*first[:k], f"{axis.name}={value}", *first[k + 1 :]]


def axis_of(text: str) -> Varied:
    """Return the key and the values of ``key=a:b:n`` or ``key=v1,v2,...``.

    Raises DataError if the text has neither form, a value is empty or given twice, or a range is
    not valid.
    """
    key, equals, rest = text.partition("=")
    text = shortened(text)
    try:
        spelled = ".".join(key_path(key))
    except ValueError:
        spelled = ""
    if not (spelled and equals and rest.strip()):
        raise DataError(
            f"--vary {text}: expected key=a:b:n for n numbers from a to b, or key=v1,v2,..., "
            f"found {text!r}; write it in one of these forms"
        )
    match = RANGE.fullmatch(rest)
    values = _range(text, *match.groups()) if match else _values(rest)
    if "" in values:
        raise DataError(
            f"--vary {text}: expected values between commas, found an empty value; remove a comma"
        )
    meant: dict[object, str] = {}
    for value in values:
        if (same := meant.setdefault(_comparison_key(value), value)) is not value:
            also = "twice" if same == value else f"and {value}, which are equal"
            raise DataError(
                f"--vary {text}: expected values that differ, found {same} {also}; remove one"
            )
    return Varied(spelled, values)


def seed_keys(spec: Mapping[str, Any], above: str = "") -> tuple[str, ...]:
    """Return the dotted keys of all seeds of a problem, including those not in the file."""
    keys: list[str] = []
    for name, value in spec.items():
        if isinstance(value, Mapping):
            keys += seed_keys(value, f"{above}{name}.")
        elif name == SEED and above:
            keys.append(f"{above}{name}")
    return tuple(keys)


def _comparison_key(value: str) -> object:
    """Return an object that is equal for values with the same meaning in TOML.

    Such values are ``1`` and ``1.0``, or a word with and without quotes.
    """
    try:
        number = load_toml(f"value = {value}")["value"]
    except ValueError:
        return value.strip()
    if isinstance(number, int | float) and not isinstance(number, bool):
        return float(number)
    return number if isinstance(number, str) else repr(number)


def _check_keys(axes: Sequence[Varied], settings: Sequence[str]) -> None:
    """Raise DataError for varied keys that are repeated, set, or part of another varied key.

    A table may be set and one of its keys varied; the varied values then replace the key's value.
    """
    paths = [key_path(axis.name) for axis in axes]
    for long, short in permutations(paths, 2):
        if long[: len(short)] == short:
            raise DataError(
                f"--vary {'.'.join(long)}: expected keys that do not contain one another, "
                f"found --vary {'.'.join(short)} as well; remove one of the two"
            )
    for setting in settings:
        try:
            set_path = key_path(setting.partition("=")[0])
        except ValueError:
            continue  # reading the problem reports the error
        for path in paths:
            if set_path[: len(path)] == path:
                raise DataError(
                    f"--vary {'.'.join(path)}: expected a key that is not set, found "
                    f"--set {setting}; remove one of the two"
                )


def _range(text: str, first: str, last: str, count: str) -> tuple[str, ...]:
    """Return equally spaced numbers as text; integers if the ends and the step are integers."""
    low, high, n = float(first), float(last), int(count)
    if not 2 <= n <= MAX_RUNS:
        raise DataError(
            f"--vary {text}: expected 2 to {MAX_RUNS} values, found {count}; correct the last "
            "number"
        )
    if not (low != high and isfinite(low) and isfinite(high)):
        raise DataError(
            f"--vary {text}: expected two different finite ends, found {first} and {last}; correct "
            "the first two numbers"
        )
    numbers = [float(f"{value:.{DIGITS}g}") for value in np.linspace(low, high, n)]
    whole = WHOLE.fullmatch(first) and WHOLE.fullmatch(last) and (high - low) % (n - 1) == 0
    return tuple(str(round(value)) if whole else str(value) for value in numbers)


def _values(text: str) -> tuple[str, ...]:
    """Return comma-separated values as TOML text, or as words if they are not valid TOML."""
    try:
        values = load_toml(f"values = [{text}]")["values"]
        return tuple(map(_spelled, values))
    except (ValueError, TypeError):
        return tuple(part.strip() for part in text.split(","))


def _spelled(value: Any) -> str:
    """Return a value as TOML text, which equals JSON for strings, numbers, booleans and arrays."""
    if isinstance(value, dict):
        raise TypeError(value)
    return json.dumps(value, ensure_ascii=False)
