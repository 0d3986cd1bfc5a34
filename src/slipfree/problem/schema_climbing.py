"""Table ``[driver]`` of step climbers, in direct problems and plans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from pydantic import Field

from slipfree.control import reference_speeds, step_climbing
from slipfree.files.toml.source import Fault
from slipfree.files.toml.types import Record
from slipfree.problem.law_record import law_record
from slipfree.problem.schema import Driver

STEP_CLIMBING = "step-climbing"

if TYPE_CHECKING:
    Noise = Record
else:
    Noise = law_record(reference_speeds.Noise)


class NoisyControl(Record):
    """Key of the control of a step climber that is not a parameter of the controller."""

    noise: Noise | None = Field(
        default=None, description="noise of the sensors; without this table, exact measurements"
    )


if TYPE_CHECKING:
    Control = Any
else:
    Control = law_record(step_climbing.StepClimbing, NoisyControl)


class ClimbingDriver(Driver):
    """A driving law, with the control of the wheels of a step climber."""

    control: Control = Field(
        default=Control(), description=f"control of the wheels, with name = {STEP_CLIMBING!r}"
    )

    def climbing_faults(self, model: str) -> Iterator[Fault]:
        """Yield errors of the driver of a step climber, and of its keys with another driver."""
        if self.name != STEP_CLIMBING:
            if "control" in self.model_fields_set:
                found = f"{self.name!r}; change it, or remove [driver.control]"
                yield Fault(("driver", "name"), f"{STEP_CLIMBING!r} with [driver.control]", found)
            return
        if model != "dynamics":
            expected = f"'dynamics' with driver.name = {STEP_CLIMBING!r}"
            yield Fault(("model",), expected, f"{model!r}; change it")
        if self.speed < 0:
            expected = f"a positive speed with name = {STEP_CLIMBING!r}"
            yield Fault(("driver", "speed"), expected, f"{self.speed:g}; change it")
        for key in ("path", "file"):
            if getattr(self, key) is not None:
                expected = f"no path with name = {STEP_CLIMBING!r}"
                yield Fault(("driver", key), expected, f"{key!r}; remove it")
