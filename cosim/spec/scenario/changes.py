"""What :meth:`Scenario.replace` takes, for type checkers: every key of a scenario with its type."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

Section = Mapping[str, Any]  # merged, or a record that replaces it
Entries = Sequence[Any]  # tables, or records of a scenario


class Changes(TypedDict, total=False):
    """Changes of a scenario: new values by key, units in the keys' names."""

    name: str
    title: str
    description: str
    aircraft: str
    engine: str
    controller: str
    controller_parameters: Mapping[str, float]
    controller_sha256: str | None
    controller_limit_s: float
    duration_s: float
    step_s: float
    substeps: int | str
    seed: int
    sensor_noise: bool
    added_delay_samples: int
    initial: Section | Any
    environment: Section | Any
    mismatch: Section | Any
    command: Entries
    disturbance: Entries
    fault: Entries
    monitor: bool | None
    engine_parameters: Mapping[str, float]
    engine_unchecked: bool
    engine_isolated: bool | None
    stations: Mapping[str, Any]
    requests: str | None
    metrics: Sequence[str]
    observers: Sequence[str]
    sensors: str | None
    wind: str | None
    own_sha256: Mapping[str, str]
    parameter_files: Entries
    changed: Sequence[str]
    vehicle: Mapping[str, Any]
    limits: Section | Any
    expect: Entries
    require: Entries
