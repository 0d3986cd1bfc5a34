"""Tables ``[law.NAME]`` of problem files, from the dataclasses of the registered laws."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, cast

from pydantic import (
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from slipfree.files.toml.source import record_at
from slipfree.files.toml.types import Record
from slipfree.laws.registry import CONTACT_LAWS, GROUND_LAWS, SLIP_LAWS
from slipfree.laws.soil import Soil
from slipfree.problem.catalog_table import reworded
from slipfree.problem.law_record import given_values, law_record
from slipfree.problem.soil_table import soil_table


def known_slip(name: str) -> str:
    """Return the name of a slip law unchanged; raise PydanticCustomError if it is unknown."""
    if name not in SLIP_LAWS:
        raise PydanticCustomError("expected", "one of {names}", {"names": ", ".join(SLIP_LAWS)})
    return name


def registered_laws() -> dict[str, Any]:
    """Return the laws that have parameters, by name."""
    laws: dict[str, Any] = {**SLIP_LAWS, **GROUND_LAWS, **CONTACT_LAWS}
    return {name: law for name, law in laws.items() if fields(law)}


def table_of(law: type) -> type[Record]:
    """Return the record of the table of a law; that of soil also has names and regions."""
    return soil_table() if law is Soil else law_record(law)


class Law(Record):
    """Parameters of a law, in a table of its name."""

    @model_validator(mode="wrap")
    @classmethod
    def _by_name(cls, data: Any, handler: ModelWrapValidatorHandler[Law]) -> Law:
        """Validate each table by the schema of its law; raise ValidationError with all errors."""
        if cls is not Law or not isinstance(data, dict):
            return handler(data)
        try:
            return law_tables().model_validate(data)
        except ValidationError as error:
            errors = [dict(each) for each in error.errors(include_url=False)]
            raise ValidationError.from_exception_data(
                cls.__name__, [reworded(each, _known_keys(each)) for each in errors]
            ) from error

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the parameters that a problem gives for a law, by name."""
        table = getattr(self, name, None)
        return {} if table is None else given_values(table)


def _known_keys(error: dict[str, Any]) -> list[str]:
    """Return the keys of the table in which an error of pydantic found an unknown key."""
    if error["type"] != "extra_forbidden":
        return []
    return list(record_at(law_tables(), error["loc"][:-1]).model_fields)


def law_tables() -> type[Law]:
    """Return the record of the tables of all registered laws."""
    keys: dict[str, Any] = {
        name: (
            table_of(law) | None,
            Field(default=None, description=f"parameters of {name}"),
        )
        for name, law in registered_laws().items()
    }
    return cast("type[Law]", create_model("Laws", __base__=Law, __doc__=Law.__doc__, **keys))
