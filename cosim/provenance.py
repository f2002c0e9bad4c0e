"""What a result says of itself, read from its metadata through a typed model; the file may come from anywhere."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, StrictInt, StrictStr

from .names import PlainName
from .pendulum_files import PENDULUM_FMUS
from .recording import Recording
from .typed import Positive, checked


class _Part(BaseModel):
    """Of the metadata only what is used is looked at; the rest is kept as it is."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class FmuUsed(_Part):
    """An FMU of the run: its file's name, and the identity of its contents."""

    file: PlainName
    guid: StrictStr


class PlantUsed(_Part):
    """The plant in the scenario of the run."""

    fmu: PlainName = PENDULUM_FMUS[0]
    parameters: StrictStr | None = None


class SignalUsed(_Part):
    """A signal of the scenario: the input that it acted on."""

    input: StrictStr


class ScenarioUsed(_Part):
    """The scenario of the run."""

    name: StrictStr = "a run"
    plant: PlantUsed = PlantUsed()
    signals: list[SignalUsed] = []


class Provenance(_Part):
    """How a result came about: step [s], order, every, FMUs, start values and messages by instance, wires, scenario."""

    step: Positive | None = None
    order: StrictStr | None = None
    every: StrictInt | None = None
    fmus: dict[str, FmuUsed] = {}
    start_values: dict[str, dict[str, bool | int | float | str]] = {}
    wires: list[tuple[StrictStr, StrictStr]] | None = None
    messages: dict[str, list[StrictStr]] = {}
    scenario: ScenarioUsed = ScenarioUsed()


def provenance(result: Recording, source: object = "the result's metadata") -> Provenance:
    """Return how `result` came about; raise UserError, which begins with `source`, for metadata of another shape."""
    return checked(Provenance, result.metadata, str(source))
