"""Problem files shared by several tests."""

from pathlib import Path

from helpers.cases import DATA
from slipfree.problem.load import load_problem

VALID = (DATA / "direct_flat.toml").read_text()


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
FIT = """
verb = "fit"
vehicle = { catalog = "rigid_skid_steer" }
data = { file = "x.csv", window = 1.0 }
unknowns.track = {}
"""
PROBLEM = (DATA / "straight_flat.toml").read_text(encoding="utf-8")
