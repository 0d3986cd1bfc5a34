"""Measure the start-up time of imports and help, in fresh processes.

``python benchmarks/start_up.py``
"""

from __future__ import annotations

import subprocess
import sys

from reference import heading, least

COMMANDS = {
    "python -c 'import casadi'": ["-c", "import casadi"],
    "python -c 'import slipfree'": ["-c", "import slipfree"],
    "slipfree --help": ["-m", "slipfree", "--help"],
}
HEAVY = ("pandas", "pydantic", "matplotlib", "typer", "rich", "xarray", "rasterio")


def call(arguments: list[str]) -> None:
    """Run Python once, quietly."""
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)


if __name__ == "__main__":
    heading()
    for name, arguments in COMMANDS.items():
        print(f"{name:28} {least(lambda a=arguments: call(a), 5):.2f} s")
    for words in ("import slipfree", "slipfree --help"):
        told = "" if words == "import slipfree" else "; from slipfree.cli import app; "
        told += "" if not told else "app(['--help'], standalone_mode=False)"
        code = (
            f"import slipfree, sys{told}; print('\\n', *(m for m in {HEAVY} if m in sys.modules))"
        )
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        loaded = found.stdout.strip().splitlines()[-1].strip() if found.stdout.strip() else ""
        print(f"{words!r} loads of {', '.join(HEAVY)}: {loaded or 'none'}")
