"""What a user waits for before anything happens: imports and help, in fresh processes.

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
HEAVY = ("pandas", "pydantic", "matplotlib", "typer", "rich", "xarray")


def call(arguments: list[str]) -> None:
    """Run Python once, quietly."""
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)


if __name__ == "__main__":
    heading()
    for name, arguments in COMMANDS.items():
        print(f"{name:28} {least(lambda a=arguments: call(a), 5):.2f} s")
    code = f"import slipfree, sys; print(*(m for m in {HEAVY} if m in sys.modules))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    print(f"'import slipfree' loads of {', '.join(HEAVY)}: {found.stdout.strip() or 'none'}")
