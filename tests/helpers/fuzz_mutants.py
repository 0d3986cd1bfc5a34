"""Robots and rasters with a few mutations, and a process that reads them.

``python -m helpers.fuzz_mutants KIND BEGIN END`` prints each seed before its file is read, and then
the outcome, as lines of JSON.
"""

import faulthandler
import json
import os
import re
import sys
import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree

import numpy as np
import rasterio.shutil

from helpers.cases import DATA
from helpers.fuzz_checks import Verdict, judged
from helpers.fuzz_damage import NUMBERS, WORDS, Case, damaged
from helpers.fuzz_maps import archive
from helpers.rasters import from_origin, geotiff

LIMIT = 60  # for the four readings of one file; most take milliseconds [s]
PRINTABLE = re.compile(r"[^\x00-\x08\x0b\x0c\x0e-\x1f\x80-\uffff]*")
SKID_STEER = """\
<robot name="skid"><material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
<link name="base_footprint"/><link name="base_link"><inertial><mass value="20"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="package://skid/base.stl" scale="1 1 1"/></geometry></visual>
<collision><geometry><box size="0.6 0.4 0.2"/></geometry></collision></link>
<joint name="base_joint" type="fixed"><parent link="base_footprint"/><child link="base_link"/>
<origin xyz="0 0 0.2"/></joint>
"""
CORNERS = {"front_left": "0.2 0.25 0", "front_right": "0.2, -0.25, 0"}
CORNERS |= {"rear_left": "-0.2 0.25 0", "rear_right": "-0.2 -0.25 0"}


def _skid_steer() -> str:
    """Return a robot with wheels of boxes, cylinders and meshes, as drawing programs write it."""
    shape = '<cylinder radius="0.1" length="0.05"/>'
    shapes = [shape, shape, '<sphere radius="0.1"/>', '<box size="0.2 0.2 0.05"/>']
    parts = [
        f'<link name="{name}_wheel"><inertial><mass value="1.5"/></inertial><collision>'
        f'<origin rpy="1.5707963267948966 0 0"/><geometry>{shape}</geometry></collision></link>'
        f'<joint name="{name}_joint" type="continuous"><parent link="base_link"/>'
        f'<child link="{name}_wheel"/><origin xyz="{place}"/><axis xyz="0 1 0"/>'
        '<limit effort="10" velocity="20" lower="0" upper="0"/></joint>'
        for (name, place), shape in zip(CORNERS.items(), shapes, strict=True)
    ]
    return f"{SKID_STEER}{''.join(parts)}</robot>"


@cache
def _robots() -> tuple[tuple[str, str], ...]:
    """Return robots with the texts of vehicle files that complete them."""
    known = [((DATA / f"{n}.urdf").read_text(), (DATA / f"{n}.toml").read_text()) for n in NAMES]
    return *known, (_skid_steer(), 'urdf = "skid.urdf"\n')


NAMES = ("cart", "bogie")


def _tags(robot: ElementTree.Element, rng: Random) -> None:
    """Remove, repeat, rename or move an element."""
    parent = rng.choice([each for each in robot.iter() if len(each)])
    element = rng.choice(list(parent))
    how = rng.randrange(4)
    if how == 0:
        parent.remove(element)
    elif how == 1:
        parent.insert(rng.randint(0, len(parent)), element)
    elif how == 2:
        element.tag = rng.choice([each.tag for each in robot.iter()])
    elif all(each is not rng.choice(list(robot)) for each in element.iter()):
        parent.remove(element)
        robot.append(element)


def _attributes(robot: ElementTree.Element, rng: Random) -> None:
    """Remove, rename or exchange an attribute, or give it another value."""
    elements = [each for each in robot.iter() if each.attrib]
    element, other = rng.choice(elements), rng.choice(elements)
    key, second = rng.choice([*element.attrib]), rng.choice([*other.attrib])
    how = rng.randrange(4)
    if how == 0:
        del element.attrib[key]
    elif how == 1:
        element.attrib[second] = element.attrib.pop(key)
    elif how == 2:
        element.attrib[key], other.attrib[second] = other.attrib[second], element.attrib[key]
    else:
        words = [word for word in WORDS if PRINTABLE.fullmatch(word)]
        element.attrib[key] = rng.choice(words)


def _numbers(robot: ElementTree.Element, rng: Random) -> None:
    """Change a number, or the number of numbers."""
    elements = [
        (each, key)
        for each in robot.iter()
        for key in each.attrib
        if re.search(r"\d", each.attrib[key])
    ]
    element, key = rng.choice(elements)
    words = re.split(r"([ ,]+)", element.attrib[key])
    k = rng.randrange(len(words))
    number = rng.choice(NUMBERS)
    if isinstance(number, int) and abs(number) > 10**40:
        number = "9" * 5000
    words[k] = rng.choice([str(number), f"{rng.lognormvariate(0, 2):.3g}", f"-{words[k]}", ""])
    element.attrib[key] = "".join(words)


MUTATIONS: tuple[Callable[[ElementTree.Element, Random], None], ...] = (
    _tags,
    _attributes,
    _numbers,
    _numbers,
)


def mutated_urdf(rng: Random) -> Case:
    """Return a robot with mutated bytes, or one to four mutated tags, attributes or numbers."""
    text, completion = rng.choice(_robots())
    name = re.search(r'urdf = "(\w+)', completion)
    assert name is not None
    if rng.random() < 0.3:
        raw = damaged(text.encode(), rng)
    else:
        robot = ElementTree.fromstring(text)
        for _ in range(rng.choice([1, 1, 2, 4])):
            rng.choice(MUTATIONS)(robot, rng)
        raw = ElementTree.tostring(robot)
    files = {f"{name[1]}.urdf": raw, "vehicle.toml": completion.encode()}
    return Case("urdf", files, rng.choice([*files]))


RASTERS: dict[str, tuple[str, str, list[dict[str, Any]]]] = {  # driver, type of heights, options
    ".tif": (
        "GTiff",
        "float32",
        [{}, {"compress": "deflate", "predictor": 3}, {"compress": "lzw", "tiled": True}],
    ),
    ".asc": ("AAIGrid", "float32", [{}]),
    ".png": ("PNG", "uint16", [{}]),
    ".img": ("HFA", "float32", [{}]),
    ".nc": ("netCDF", "float32", [{}]),
    ".gpkg": ("GPKG", "float32", [{}]),
    ".grd": ("GSBG", "float32", [{}]),
    ".bt": ("BT", "float32", [{}]),
}


@cache
def _rasters() -> tuple[tuple[str, bytes], ...]:
    """Return small sound rasters with their endings, in metres and in degrees."""
    heights, found = np.random.default_rng(3).uniform(1, 4, (12, 10)), []
    places = {"EPSG:32633": from_origin(5e5, 5e6, 2), "EPSG:4326": from_origin(15, 45, 1e-4)}
    for ending, (driver, dtype, options) in RASTERS.items():
        for option, (crs, place) in product(options, places.items()):
            with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
                whole, copy = Path(folder, "whole.tif"), Path(folder, f"copy{ending}")
                geotiff(whole, heights, place, crs=crs, dtype=dtype, nodata=0)
                rasterio.shutil.copy(whole, copy, driver=driver, **option)
                found.append((ending, copy.read_bytes()))
    return tuple(found)


def mutated_raster(rng: Random) -> Case:
    """Return a raster, or an archive of arrays, with mutated bytes."""
    if rng.random() < 0.15:
        case = archive("npz", rng)
        return case._replace(files={name: damaged(raw, rng) for name, raw in case.files.items()})
    ending, raw = rng.choice(_rasters())
    if rng.random() < 0.5:
        raw = damaged(raw, rng)
    else:  # most of the file stays sound
        found = bytearray(raw)
        for _ in range(rng.choice([1, 2, 4])):
            found[rng.randrange(len(found))] = rng.randrange(256)
        raw = bytes(found)
    return Case("raster", {f"ground{ending}": raw}, f"ground{ending}")


MUTANTS = {"mutated_urdf": mutated_urdf, "mutated_raster": mutated_raster}


def judged_silently(case: Case, folder: Path, told: Path) -> Verdict:
    """Return what becomes of a case; what is printed on standard error is an error."""
    with told.open("w+") as stream:
        kept = os.dup(2)
        os.dup2(stream.fileno(), 2)
        try:
            found = judged(case, folder)
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
    words = told.read_text(errors="replace")
    return Verdict("print", words[:2000]) if words else found


def main(kind: str, begin: str, end: str) -> None:
    """Judge the mutants of a range of seeds; end the process at one that takes too long."""
    alarm = os.fdopen(os.dup(2), "w")  # standard error is redirected while a file is read
    for seed in range(int(begin), int(end)):
        print(json.dumps({"seed": seed}), flush=True)  # noqa: T201
        with tempfile.TemporaryDirectory() as scratch:
            case = MUTANTS[kind](Random(seed))
            folder = Path(scratch) / "files"
            folder.mkdir()
            faulthandler.dump_traceback_later(LIMIT, exit=True, file=alarm)
            found = judged_silently(case, folder, Path(scratch) / "stderr")
            faulthandler.cancel_dump_traceback_later()
        print(json.dumps({"seed": seed, **found._asdict()}), flush=True)  # noqa: T201


if __name__ == "__main__":
    main(*sys.argv[1:])
