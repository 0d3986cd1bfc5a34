"""Compare the numbers of the documentation with what commands printed.

Numbers of tables and numbers with a unit are looked up, to their last digit, in the outputs in
``RESULTS.md`` of the commands that the row, the paragraph, the section or else the page names, and
in executed notebooks; then in the scripts, tests and problems, as inputs. Descriptions of cases
(first column of a table), published values and data, and formulas of errata are only counted.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache

from common import HERE, TESTS

ROOT = HERE.parent
PAGES = ("README", "docs/accuracy", "docs/performance", "docs/papers", "docs/measured")
RESULTS = re.split(r"^## ", (HERE / "RESULTS.md").read_text("utf-8"), flags=re.M)[1:]
PLAIN = re.compile(r"(?<![\w.^])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w|\.\d)")
NUMBER = re.compile(r"(?<![\w.^])\d{1,3}(?: \d{3})+(?![\d.])|" + PLAIN.pattern)
UNIT = (
    r"(?<!\w)(mm|cm|km|m|ms|us|s|rad|mrad|degrees|deg|N|J|Hz|kg|kPa|%|times|MB|GB|MiB|kB|minutes"
    r"|steps|iterations|runs|poses|points|logs|windows)(?!\w)"
)
LISTED = re.compile(r"(?:(?:,|/| to| and|, and| or|;)* [-+]?\d[\d.e-]*)* ?" + UNIT)
CODE = re.compile(r"`[^`]*`|\$[^$]*\$|\]\([^)]*\)|\([\d., ]*\d\)(?=[ ,;|])")  # equation numbers
DATA = re.compile(r" of -?[\d.]+ to -?[\d.]+ ")  # range of measured data
PER = {"mm": 1e3, "cm": 1e2, "ms": 1e3, "us": 1e6, "%": 1e2, "minutes": 1 / 60, "kB": 1e-3}
PER |= {"degrees": 57.29578, "deg": 57.29578, "km": 1e-3, "mrad": 1e3, "GB": 1e-3, "kPa": 1e-3}
PER |= {"s": 1e-3, "m": 1e-3}  # of outputs in ms or mm


def main() -> str | None:
    """Print the numbers that no source contains, by page and line, and counts of the others."""
    missing = 0
    for page in (*PAGES, "docs/measured_wheels"):
        counts: Counter[str] = Counter()
        for line, text, kind in numbers((ROOT / f"{page}.md").read_text("utf-8")):
            counts[kind] += 1
            if kind == "not found":
                print(f"{page}.md:{line}: {text}")
        missing += counts["not found"]
        print(f"{page}.md: {', '.join(f'{count} {kind}' for kind, count in counts.most_common())}")
    return f"{missing} numbers have no source" if missing else None


def numbers(page: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, text and kind of source of each number of a page."""
    page = re.sub(
        r"^```\w.*?^```$", lambda code: "\n" * code[0].count("\n"), page, flags=re.M | re.S
    )
    start = 1
    for section in re.split(r"^(?=#)", page, flags=re.M):
        for block in re.split(r"(?<=\n\n)", section):
            header, named = [""], block
            for number, line in enumerate(block.splitlines(), start):
                row = line.startswith("|")
                cells = re.split(r"(?<!\\)\|", line)[1:-1] if row else [line]
                if row and header == [""]:
                    header = cells
                elif row and "`" in line:
                    named = line
                near = named if "`" in line or "the same |" in line or not row else block
                found = sources(near) or sources(section) or sources(page) or ([], [])
                for column, cell in enumerate(cells if header is not cells else ()):
                    published = "paper" in (header + [""] * column)[column] or "FOLDER" in header[0]
                    for text, units, data in of_cell(cell, " ".join(header) if row else None):
                        if "Errata" in section.partition("\n\n")[0] or published or data:
                            kind = "published"
                        elif row and column == 0 and len(cells) > 1:
                            kind = "cases"
                        elif "(output not kept)" in line:
                            kind = "outputs not kept"
                        else:
                            over = row and ("times" in units or " over " in cells[0])
                            kind = looked_up(text, units, found, over)
                        yield number, f"{text} {' '.join(units)} | {cell.strip()[:90]}", kind
            start += block.count("\n")


def of_cell(cell: str, header: str | None) -> Iterator[tuple[str, list[str], bool]]:
    """Yield numbers of a cell or a line with their units, and whether they are ranges of data."""
    plain = CODE.sub(lambda code: "`" * len(code[0]), cell)
    ranges = [match.span() for match in DATA.finditer(plain)]
    for match in NUMBER.finditer(plain):
        unit = LISTED.match(plain, match.end())
        if unit or header is not None:
            units = [unit[1]] if unit else re.findall(UNIT, header or "")
            yield match[0].replace(" ", ""), units, any(a < match.start() < b for a, b in ranges)


def looked_up(
    text: str, units: list[str], found: tuple[list[float], list[float]], over: bool
) -> str:
    """Return which source has a number that rounds to a text; ``over``: also a ratio of two."""
    mantissa, _, exponent = text.partition("e")
    digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    if text.isdigit() and int(text) >= 1000:
        digit = 10.0 ** (len(text) - len(text.rstrip("0")))
    scales = {1.0} | {PER[unit] for unit in units if unit in PER}

    def among(values: Iterable[float]) -> bool:
        return any(abs(float(text) - s * v) <= 0.501 * digit for v in values for s in scales)

    printed, inputs = found
    if among(printed):
        return "printed"
    if over and among(a / b for a in printed for b in printed if b):
        return "ratios of printed numbers"
    return "inputs" if among(inputs) else "not found"


@cache
def sources(text: str) -> tuple[list[float], list[float]] | None:
    """Return the numbers of the outputs and of the inputs that a text names."""
    outputs = inputs = ""
    for command in re.findall(r"`([^`]+)`", text):
        words = ["", *command.split()]
        words = ["python", "benchmarks", *words[1:]] if words[1:2] == ["batch"] else words[1:]
        if words[:2] == ["python", "benchmarks"] and words[2:]:
            parts = {word for word in words[3:] if word.isalpha()}
            heads = [part for part in RESULTS if part.startswith(f"`python benchmarks {words[2]}")]
            outputs += "".join(p for p in heads if parts <= {*p.partition("`\n")[0].split()})
            inputs += (HERE / f"{words[2]}.py").read_text("utf-8")
        elif words[:1] == ["slipfree"] and words[2:]:
            outputs += "".join(part for part in RESULTS if part.startswith(f"`{' '.join(words)}`"))
        for name in re.findall(r"(test_\w+|notebooks/\w+|problems/\w+)(?:\.py|\.toml)", command):
            files = [*TESTS.rglob(f"{name}.py"), *ROOT.glob(f"{name}.*")]
            if not files:
                print(f"no file: {command}")
            for file in files:
                if file.suffix == ".ipynb":
                    outputs += printed_by(file.read_text("utf-8"))
                else:
                    inputs += file.read_text("utf-8")
    both = [[float(n) for n in PLAIN.findall(t)] for t in (outputs, inputs)]
    return (both[0], both[1]) if outputs or inputs else None


def printed_by(notebook: str) -> str:
    """Return the text outputs of the cells of a notebook."""
    outputs = (out for cell in json.loads(notebook)["cells"] for out in cell.get("outputs", ()))
    return "".join(
        "".join(out.get("text", out.get("data", {}).get("text/plain", ()))) for out in outputs
    )
