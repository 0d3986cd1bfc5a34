"""Remove a region, save, plan and save in the page of ``slipfree edit``; check the file each time.

``python benchmarks/edit_page.py [--count 50] [--seed 0]`` drives a headless Chromium, with random
regions and random pauses between the clicks. It prints the number of repetitions after which the
file had other contents than the page showed, or had lost anything else; the exit code is 1 if there
were any. Chromium, its driver and selenium are required.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers.chromium import headless_chromium
from helpers.edit_page import PATIENCE, PROBLEM, EditPage, remove_save_plan_save


def main() -> int:
    """Repeat the workflow and print the failures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random, failures = Random(options.seed), 0
    with (
        tempfile.TemporaryDirectory() as folder,
        headless_chromium((1100, 700), PATIENCE) as driver,
    ):
        file = Path(folder) / "short.toml"
        file.write_text(PROBLEM, encoding="utf-8")
        page = EditPage(driver, file)
        try:
            page.open()
            for number in range(options.count):
                page.write(f"{PROBLEM}# {number}\n")
                region, pause = random.randrange(3), random.choice((0.0, 0.03, 0.1, 0.2, 0.3))
                try:
                    remove_save_plan_save(page, region, pause)
                except AssertionError as error:
                    failures += 1
                    print(f"{number}: region {region}, pause {pause} s: {error}")
            print(page.end(), end="")
        finally:
            page.process.kill()
    print(f"{options.count} repetitions, {failures} with a wrong file")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
