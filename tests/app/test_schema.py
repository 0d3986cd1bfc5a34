"""Tests of the descriptions of keys in the schemas of problem files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, get_args, get_origin

import pytest

from slipfree.problem import schema
from slipfree.problem.load import VERBS
from slipfree.problem.schema import law_tables

SCHEMAS = [verb.schema for verb in VERBS]
UNIT = re.compile(r" \[(?:1|(?:[mNs]|Pa|kg|rad|deg|Hz)[\w/ ^()+]*|1/s)(?:, (?:1|[\w/ ]+))*\]$")


def records(found: Any, seen: set[type[schema.Record]]) -> Iterator[type[schema.Record]]:
    """Yield the tables in an annotation, and those in them."""
    if isinstance(found, type) and issubclass(found, schema.Record):
        if found in seen:
            return
        seen.add(found)
        yield found
        for field in found.model_fields.values():
            yield from records(field.annotation, seen)
    for each in get_args(found):
        yield from records(each, seen)


def is_numeric(annotation: Any) -> bool:
    """Return whether real numbers may stand for a key, in arrays or by name as well."""
    if annotation in (float, Any) or get_origin(annotation) is dict:
        return True
    return any(map(is_numeric, get_args(annotation)))


TABLES = list(records(tuple[*SCHEMAS, law_tables()], set()))  # type: ignore[misc]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_every_key_says_what_it_means_and_in_which_unit(table: type[schema.Record]) -> None:
    for key, field in table.model_fields.items():
        assert field.description, key
        has_unit = UNIT.search(field.description) is not None
        assert has_unit == is_numeric(field.annotation), (key, field.description)


def test_all_tables_are_looked_at() -> None:
    names = {table.__name__ for table in TABLES}
    assert names >= {
        "TerrainTable",
        "PowerLaw",
        "DriverTable",
        "GuideTable",
        "KeepOut",
        "StepClimbing",
    }
    assert len(names) > 35
