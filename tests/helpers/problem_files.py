"""Problem files shared by several tests."""

from pathlib import Path

from slipfree.problem.load import load_problem

VALID = """\
verb = "direct"

[terrain.synthetic]
x = [-3, 3]
y = [-3.0, 4.0]
spacing = 0.5
base = 2.0

[vehicle]
catalog = "three_wheeler"
r1 = 0.05

[start]
x = 0.1
heading = 0.2

[inputs]
right_rate = 0.5
left_rate = 0.5
steer_rate = 0

[time]
duration = 1
step = 0.25
"""


def rough_ground(x: str, y: str, spacing: float, spectrum: str, seed: int) -> str:
    """Return the table of a random ground with a range of wavelengths, as TOML."""
    head = f"\n[terrain.synthetic]\nx = {x}\ny = {y}\nspacing = {spacing}\n"
    return head + f"power_law = {{ {spectrum}, hurst = 0.9, seed = {seed} }}\n"


def _read(folder: Path, text: str, *settings: str) -> object:
    path = folder / "p.toml"
    path.write_text(text, encoding="utf-8")
    return load_problem(path, settings)


FILE = (
    VALID[: VALID.index("[terrain")]
    + '[terrain]\nfile = "g.npz"\n\n'
    + VALID[VALID.index("[vehicle]") :]
)
PROBLEM = """\
verb = "direct"
title = "Überfahrt"

[terrain.synthetic]
x = [-3, 3]
y = [-3, 2.25]
spacing = 0.25

[vehicle]
catalog = "three_wheeler"

[start]
heading = 0

[driver]
name = "straight"
speed = 1.0

[time]
duration = 0.5
step = 0.1
"""
