"""Faults injected into commands that write files: old and new files afterwards.

``python benchmarks faults [--tries N] [--seed N] [--only NAME]`` prints a line for every fault
and command: the numbers of tries, of lost files (neither the old file nor a complete new one), of
tracebacks on stderr, of complete new files, of leftover unfinished files, of later successes of the
same command without the fault, and the exit codes. ``--only interrupted`` sends SIGINT and SIGTERM
to each verb at random times and prints what it leaves on disk: nothing before its first step or
iterate, samples or iterates, solved plans, whole results; ``lost`` counts commands that leave
nothing afterwards.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from random import Random

from common import PROBLEMS
from PIL import Image

from helpers.fuzz_files import bases, document
from slipfree.core.errors import SlipfreeError
from slipfree.files import netcdf
from slipfree.system.codegen_cache import FOLDER

LONGEST = 120.0  # that a command may take [s]
BEGIN = "from slipfree.__main__ import main; print('begun', flush=True); main()"
COMMANDS = {
    "run": ["run", "p.toml", "-o", "out.nc", "--csv", "out.csv"],
    "plan": ["run", "plan.toml", "-o", "plan.nc", "--no-draw"],
    "sweep": ["sweep", "p.toml", "--repeat", "4", "--processes", "2", "-o", "sw", "--keep"],
    "show": ["show", "old.nc", "--html", "page.html"],
    "film": ["show", "old.nc", "--animation", "film.gif"],
    "report": ["report", "old.nc", "-o", "report.html"],
    "climb": ["run", "climb.toml", "-o", "climb.nc"],
}
OFTEN = ("killed", "Ctrl-C", "compiling", "file limit")  # tried more than once
Start = Callable[[list[str], Path], tuple[int, str]]


def prepared(folder: Path) -> None:
    """Write problems and an old result."""
    for kind, name, k in (("direct", "p", 0), ("plan", "plan", 0), ("direct", "climb", -1)):
        data = dict(bases(kind)[k])
        data["solver"] = {**data.get("solver", {}), "compiled": name != "climb"}
        (folder / f"{name}.toml").write_text(document(data))
    plain(["run", "p.toml", "-o", "old.nc", "--no-draw"], folder)


def begun(words: list[str], folder: Path, **more: object) -> subprocess.Popen[str]:
    """Start a command and return its process."""
    return subprocess.Popen(
        [sys.executable, "-c", BEGIN, *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **more,
    )  # type: ignore[call-overload,no-any-return]


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Return the exit code and stderr of a command."""
    try:
        _, told = process.communicate(timeout=LONGEST)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        return -99, process.communicate()[1]
    return process.returncode, told


def plain(words: list[str], folder: Path) -> tuple[int, str]:
    """Run a command without a fault."""
    return ended(begun(words, folder))


def signalled(number: int, after: float, **variables: str) -> Start:
    """Return a function that runs a command and sends it a signal after a delay."""

    def start(words: list[str], folder: Path) -> tuple[int, str]:
        process = begun(words, folder, env={**os.environ, **variables})
        if process.stdout is not None:
            process.stdout.readline()  # Python itself has started
        try:
            process.wait(after)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, number)  # as a terminal does
        return ended(process)

    return start


def limited(size: int) -> Start:
    """Return a function that runs a command with a limited file size."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    env = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}  # no halves of compiled modules
    return lambda words, folder: ended(begun(words, folder, preexec_fn=limit, env=env))


def surrounded(**variables: str | None) -> Start:
    """Return a function that runs a command with other environment variables; None removes one."""
    there = {k: v for k, v in {**os.environ, **variables}.items() if v is not None}
    return lambda words, folder: ended(begun(words, folder, env=there))


@contextmanager
def mounted(options: str, folder: Path) -> Iterator[None]:
    """Mount a file system in memory over a folder, with the contents of the folder."""
    copy = Path(tempfile.mkdtemp())
    shutil.copytree(folder, copy, dirs_exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", folder], check=True)
    try:
        shutil.copytree(copy, folder, dirs_exist_ok=True)
        if "full" in options:
            _filled(folder / "filler", int(options.removeprefix("full")))
        else:
            subprocess.run(["mount", "-o", f"remount,{options}", folder], check=True)
        yield
    finally:
        if "full" not in options:
            subprocess.run(["mount", "-o", "remount,rw", folder], check=True)
        (folder / "filler").unlink(missing_ok=True)
        shutil.rmtree(copy)
        shutil.copytree(folder, copy)
        subprocess.run(["umount", folder], check=True)
        shutil.rmtree(folder)
        shutil.move(copy, folder)


def _filled(file: Path, room: int) -> None:
    """Fill a file system except for some bytes."""
    with suppress(OSError), file.open("wb", buffering=0) as stream:
        while stream.write(bytes(4096)):
            pass
    os.truncate(file, max(file.stat().st_size - room, 0))


def complete(file: Path, rows: int) -> bool:
    """Return whether a file is complete."""
    try:
        match file.suffix:
            case ".nc":
                return netcdf.read(file).t.size > 0
            case ".html":
                return file.read_text(encoding="utf-8").rstrip().endswith("</html>")
            case ".png" | ".gif":
                with Image.open(file) as image:
                    for frame in range(getattr(image, "n_frames", 1)):
                        image.seek(frame)
                        image.load()
                return True
            case ".pdf":
                return file.read_bytes().rstrip().endswith(b"%%EOF")
            case ".csv":
                with file.open(newline="") as stream:
                    lines = list(csv.reader(stream))
                return len({*map(len, lines)}) == 1 and (not rows or len(lines) == rows)
    except (SlipfreeError, OSError, SyntaxError, ValueError):
        return False
    return file.suffix in (".toml", ".jsonl") or file.name == "filler"


def tried(name: str, fault: Start, folder: Path, counts: Counter[str], rows: int) -> None:
    """Run a command with a fault, check all files, and run it again without the fault."""
    if name == "sweep":
        shutil.rmtree(folder / "sw")  # which would go on with what it has
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    code, told = fault(COMMANDS[name], folder)
    counts["tries"] += 1
    counts["tracebacks"] += "Traceback" in told or "Exception ignored" in told
    if "Traceback" in told or "Exception ignored" in told:
        print(told[-1500:], file=sys.stderr)
    counts[f"exit {code}"] += 1
    for file in sorted(folder.rglob("*")):
        if file.is_file() and ".part" in file.suffixes:
            counts["parts left"] += 1
        elif file.is_file() and before.get(file) != file.read_bytes():
            good = complete(file, rows if file.name == "out.csv" else 0)
            counts["new complete" if good else "lost"] += 1
            if not good:
                print(f"lost: {file}", file=sys.stderr)
    counts["lost"] += sum(not file.exists() for file in before)
    code, told = plain(COMMANDS[name], folder)
    counts["works again"] += code == 0
    if code:
        print(told[-600:], file=sys.stderr)


WINDOWS = (
    "--set inputs= --set driver={name='follow',speed=0.25,path=[[0.0,0.0],[0.2,1.5],[0.6,2.6]]} "
    "--set plan.window=1.2 --set plan.overlap=0.4 --set plan.intervals=8"
)
VERBS = {  # command, its file, and what its details say when there is something to keep
    "direct": ("run p.toml -o o.nc", "o.nc", "integrated to"),
    "sampled": ("run sampled.toml -o o.nc", "o.nc", "integrated to"),
    "inverse": ("run inverse.toml -o o.nc --set time.duration=4", "o.nc", "integrated to"),
    "climb": ("run climb.toml -o o.nc", "o.nc", "integrated to"),
    "plan": ("run plan.toml -o o.nc", "o.nc", "iteration 1,"),
    "robust": ("run robust.toml -o o.nc", "o.nc", "iteration 1,"),
    "windows": (f"run plan.toml -o o.nc {WINDOWS}", "o.nc", "iteration 1,"),
    "compare": ("compare compare.toml", "", ""),
    "fit": ("fit fit.toml -o o.csv", "o.csv", ""),
    "track": ("track plan.nc --by replan -o o.nc", "o.nc", "replan, seed 1: 0.04"),
    "pareto": ("pareto plan.toml --points 3 -o front", "front/point_01.nc", "point 2 of 3"),
    "report": ("report old.nc -o o.html", "o.html", ""),
}


def interruptions(tries: int, seed: int) -> int:
    """Interrupt each verb at random times and print a table; return 1 if anything was lost."""
    rng, bad = Random(seed), 0
    names = ("nothing yet", "samples", "iterate", "solved plan", "whole", "lost", "traceback")
    print(f"{'verb':10}{'took':>7}" + "".join(f"{name:>13}" for name in names) + "  exit codes")
    with tempfile.TemporaryDirectory() as above:
        folder = Path(above)
        os.environ[FOLDER] = str(folder / "cache")
        prepare_verbs(folder)
        for verb, (command, name, sign) in VERBS.items():
            words, counts, codes = [*command.split(), "--verbose"], Counter[str](), Counter[int]()
            words += ["--no-draw"] if words[0] in ("run", "fit", "pareto") else []
            begin = time.perf_counter()
            code, told = plain(words, folder)
            took = time.perf_counter() - begin
            if code:
                raise RuntimeError(f"{verb}: {told}")
            for k in range(tries):
                remove(folder, name)
                start = signalled((signal.SIGINT, signal.SIGTERM)[k % 2], rng.uniform(0.3, took))
                code, told = start(words, folder)
                codes[code] += 1
                counts["traceback"] += "Traceback" in told
                counts[left(folder / name if name else None, told, sign, code)] += 1
            bad += counts["lost"] + counts["traceback"]
            row = "".join(f"{counts[each]:>13}" for each in names)
            listed = ", ".join(f"{code}: {n}" for code, n in sorted(codes.items()))
            print(f"{verb:10}{took:>6.1f}s{row}  {listed}", flush=True)
    return int(bad > 0)


def remove(folder: Path, name: str) -> None:
    """Remove the output of a command."""
    if "/" in name:
        shutil.rmtree(folder / Path(name).parent, ignore_errors=True)
    elif name:
        (folder / name).unlink(missing_ok=True)


def left(file: Path | None, told: str, sign: str, code: int) -> str:
    """Return the column of the table that counts the output of an interrupted command."""
    if file is None:
        return (
            "whole" if code == 0 else "samples" if "the table contains" in told else "nothing yet"
        )
    if not file.is_file():
        return "lost" if sign and sign in told else "nothing yet"
    if not complete(file, 0):
        return "lost"
    if file.suffix != ".nc" or code == 0:
        return "whole" if code == 0 or file.suffix == ".html" else "samples"
    stop = netcdf.read(file).stop
    kinds = {"plan": "iterate", "plan_unverified": "solved plan", "plan_share": "solved plan"}
    return "whole" if stop is None else kinds.get(stop.name, "samples")


def prepare_verbs(folder: Path) -> None:
    """Write a short problem of each verb, and the results that commands read."""
    prepared(folder)
    data = dict(bases("direct")[0])
    long = {**data, "time": {"duration": 7.0, "step": 0.02}}
    (folder / "p.toml").write_text(document(long))
    sampled = tomllib.loads((folder / "climb.toml").read_text())
    (folder / "climb.toml").write_text(
        document({**sampled, "time": {"duration": 3.0, "step": 0.01}})
    )
    sampled["driver"] = {**sampled["driver"], "period": 0.002}
    (folder / "sampled.toml").write_text(document(sampled))
    (folder / "inverse.toml").write_text((PROBLEMS / "paper_inverse.toml").read_text())
    plan = (PROBLEMS / "plan_rigid_hills.toml").read_text()
    plan = re.sub(r"intervals = \d+", "intervals = 12", plan)
    (folder / "plan.toml").write_text(plan)
    robust = "\n[plan.robust]\ninputs = 0.01\ndraws = 20\nfinal_draws = 40\n"
    (folder / "robust.toml").write_text(plan + robust)
    (folder / "compare.toml").write_text((PROBLEMS / "compare_axles.toml").read_text())
    (folder / "fit.toml").write_text((PROBLEMS / "fit_skid_steer.toml").read_text())
    shutil.copy(PROBLEMS / "skid_steer_log.csv", folder)
    for words in (["plan.toml", "-o", "plan.nc"], ["p.toml", "-o", "old.nc"]):
        code, told = plain(["run", *words, "--no-draw"], folder)
        if code:
            raise RuntimeError(f"{words[0]}: {told}")


def faults(rng: Random, took: float) -> dict[str, Callable[[], Start]]:
    """Return the faults by name."""
    return {
        "killed": lambda: signalled(signal.SIGKILL, rng.uniform(0.1, took)),
        "Ctrl-C": lambda: signalled(signal.SIGINT, rng.uniform(0.1, took)),
        "compiling": lambda: signalled(
            rng.choice([signal.SIGKILL, signal.SIGINT]),
            rng.uniform(0.5, 4),
            SLIPFREE_CACHE=tempfile.mkdtemp(prefix="caches-"),
        ),
        "file limit": lambda: limited(rng.choice([0, 100, 4096, 10_000, 50_000, 200_000])),
        "no display": lambda: surrounded(DISPLAY=None, WAYLAND_DISPLAY=None, MPLBACKEND=None),
        "bad caches": _bad_caches,
        "no compiler": lambda: surrounded(CC="/bin/false", PATH="/nowhere", SLIPFREE_CACHE=""),
    }


def _bad_caches() -> Start:
    """Return functions that run a command with damaged caches of fonts or compiled functions."""
    folder = Path(tempfile.mkdtemp(prefix="caches-"))
    for kept in Path(os.environ[FOLDER]).glob("*.so"):
        (folder / kept.name).write_bytes(kept.read_bytes()[:1000] + b"junk")
    import matplotlib.font_manager as fonts

    version = fonts.FontManager.__version__
    (folder / f"fontlist-v{version}.json").write_text('{"_version": ')
    return surrounded(MPLCONFIGDIR=str(folder), SLIPFREE_CACHE=str(folder))


def mounts(rng: Random) -> dict[str, Callable[[], str]]:
    """Return file systems on which commands must fail."""
    return {
        "disk full": lambda: f"full{rng.choice([0, 4096, 20_000, 60_000, 200_000])}",
        "read-only": lambda: "ro",
    }


def table(tries: int, seed: int, only: str | None) -> int:
    """Print a line for every fault and command; return 1 if anything was lost."""
    rng, total = Random(seed), Counter[str]()
    print(
        f"{'fault':12}{'command':9}{'tries':>6}{'lost':>6}{'tracebacks':>12}{'new complete':>14}"
        f"{'parts left':>12}{'works again':>13}  exit codes"
    )
    with tempfile.TemporaryDirectory() as above:
        folder = Path(above) / "work"
        folder.mkdir()
        os.environ[FOLDER] = str(Path(above) / "cache")
        prepared(folder)
        for name in COMMANDS:
            plain(COMMANDS[name], folder)  # compiles
            begin = time.perf_counter()
            code, told = plain(COMMANDS[name], folder)
            took = time.perf_counter() - begin
            if code:
                raise RuntimeError(f"{name}: {told}")
            rows = len((folder / "out.csv").read_text().splitlines())
            for fault, make in faults(rng, took).items():
                if only in (None, fault, name):
                    counts = Counter[str]()
                    for _ in range(tries if fault in OFTEN else 1):
                        tried(name, make(), folder, counts, rows)
                    total += _told(fault, name, counts)
            for fault, options in mounts(rng).items() if os.geteuid() == 0 else ():
                if only in (None, fault, name):
                    counts = Counter[str]()
                    for _ in range(2):
                        tried(name, _on(options()), folder, counts, rows)
                    total += _told(fault, name, counts)
    _told("all", "", total)
    bad = total["lost"] + total["tracebacks"] + total["tries"] - total["works again"]
    return 1 if bad else 0


def _on(options: str) -> Start:
    def start(words: list[str], folder: Path) -> tuple[int, str]:
        with mounted(options, folder):
            return plain(words, folder)

    return start


def _told(fault: str, name: str, counts: Counter[str]) -> Counter[str]:
    codes = ", ".join(
        f"{key.removeprefix('exit ')}: {n}"
        for key, n in sorted(counts.items())
        if key.startswith("exit")
    )
    print(
        f"{fault:12}{name:9}{counts['tries']:>6}{counts['lost']:>6}{counts['tracebacks']:>12}"
        f"{counts['new complete']:>14}{counts['parts left']:>12}{counts['works again']:>13}  "
        f"{codes}",
        flush=True,
    )
    return counts


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Inject faults.")
    parser.add_argument("--tries", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="a fault or a command, or interrupted")
    asked = parser.parse_args()
    if asked.only == "interrupted":
        return interruptions(asked.tries, asked.seed)
    return table(asked.tries, asked.seed, asked.only)
