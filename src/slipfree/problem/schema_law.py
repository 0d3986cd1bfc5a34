"""Tables ``[law.NAME]`` of problem files, from the dataclasses of the registered laws."""

from __future__ import annotations

from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, cast, get_type_hints

from annotated_types import DocInfo, Unit
from pydantic import (
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from slipfree.files.toml.angles import IN_RADIANS
from slipfree.files.toml.types import Record
from slipfree.laws.registry import CONTACT_LAWS, GROUND_LAWS, SLIP_LAWS
from slipfree.problem.catalog_table import reworded


def known_slip(name: str) -> str:
    """Return the name of a slip law unchanged; raise PydanticCustomError if it is unknown."""
    if name not in SLIP_LAWS:
        raise PydanticCustomError("expected", "one of {names}", {"names": ", ".join(SLIP_LAWS)})
    return name


def registered_laws() -> dict[str, Any]:
    """Return the laws that have parameters, by name."""
    laws: dict[str, Any] = {**SLIP_LAWS, **GROUND_LAWS, **CONTACT_LAWS}
    return {name: law for name, law in laws.items() if fields(law)}


@cache
def law_record(law: type) -> type[Record]:
    """Return the record of a law's parameters, from the annotations of its dataclass."""
    hints = get_type_hints(law, include_extras=True)
    keys: dict[str, Any] = {
        each.name: (
            _with_unit(hints[each.name]),
            Field(
                default=... if each.default is MISSING else each.default,
                description=_description(hints[each.name]),
            ),
        )
        for each in fields(law)
    }
    words = (law.__doc__ or "").partition("\n")[0]
    return create_model(law.__name__, __base__=Record, __doc__=words, **keys)


def _with_unit(hint: Any) -> Any:
    """Return the annotation of a parameter; angles also accept text such as "30 deg"."""
    units = [each.unit for each in getattr(hint, "__metadata__", ()) if isinstance(each, Unit)]
    return Annotated[hint, IN_RADIANS] if units == ["rad"] else hint


def _description(hint: Any) -> str:
    """Return the description and unit in the annotation of a parameter."""
    metadata = getattr(hint, "__metadata__", ())
    words = [each.documentation for each in metadata if isinstance(each, DocInfo)]
    return " ".join([*words, *(f"[{each.unit}]" for each in metadata if isinstance(each, Unit))])


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
            laws = registered_laws()
            known: dict[Any, list[str]] = {(): list(laws)} | {
                (name,): [each.name for each in fields(law)] for name, law in laws.items()
            }
            raise ValidationError.from_exception_data(
                cls.__name__,
                [
                    reworded(dict(each), known.get(each["loc"][:-1], []))
                    for each in error.errors(include_url=False)
                ],
            ) from error

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the parameters that a problem gives for a law, by name."""
        table = getattr(self, name, None)
        return {} if table is None else dict(table)


def law_tables() -> type[Law]:
    """Return the record of the tables of all registered laws."""
    keys: dict[str, Any] = {
        name: (
            law_record(law) | None,
            Field(default=None, description=f"parameters of {name}"),
        )
        for name, law in registered_laws().items()
    }
    return cast("type[Law]", create_model("Laws", __base__=Law, __doc__=Law.__doc__, **keys))
