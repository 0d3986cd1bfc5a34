"""Run a benchmark: ``python benchmarks NAME [options]``; without a name, list all."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

HELPERS = {"__main__", "common", "scenes"}
SCRIPTS = {
    file.stem: file
    for file in sorted(Path(__file__).parent.glob("*.py"))
    if file.stem not in HELPERS
}


def main() -> object:
    """Run the script that the command line names, below versions and machine."""
    name, *options = sys.argv[1:] or [""]
    if name not in SCRIPTS:
        for script, file in SCRIPTS.items():
            text = ast.get_docstring(ast.parse(file.read_text("utf-8"))) or ""
            print(f"{script:12} {text.partition(chr(10))[0]}")
        return f"expected one of these names, found {name!r}" if name else None
    sys.argv = [f"benchmarks {name}", *options]
    module = importlib.import_module(name)
    if not {"-h", "--help"} & set(options):
        importlib.import_module("common").heading()
    return module.main()


if __name__ == "__main__":
    sys.exit(main())
