"""Identified rate responses of a vehicle, in its own file or in a model file."""

from operator import not_
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cosim.base.storage.toml import Model, Positive, read_toml, validate
from cosim.spec.file_kind import MODELS, check_kind


def _append_conjugates(real: list[float], pairs: list[tuple[float, float]]) -> list[float] | list[complex]:
    if not pairs:
        return real
    return [*map(complex, real), *(complex(re, sign * im) for re, im in pairs for sign in (1.0, -1.0))]


class RateModel(Model):
    """An identified rate response: gain * prod(z - zeros) / prod(z - poles) * z^-delay, command to rad/s.

    Poles and zeros that are not real come in pairs, of which the one with the positive imaginary part is stated.
    """

    gain: float
    zeros: list[float]
    poles: list[Annotated[float, Field(gt=-1.0, le=1.0)]]
    # Real and imaginary part of each pair.
    zero_pairs: list[tuple[float, Positive]] = Field(default_factory=list, exclude_if=not_)
    pole_pairs: list[tuple[float, Positive]] = Field(default_factory=list, exclude_if=not_)
    delay_samples: Annotated[float, Field(ge=0.0, le=1000.0)]  # predictors believe it; may be fractional
    sample_time_s: Annotated[float, Field(ge=1e-6, le=1000.0)]  # bounds keep poles in 1/s finite
    source: str
    # EngineSpec.fingerprint of an engine file; "" in older models.
    engine_sha256: Annotated[str, Field(exclude_if=not_)] = ""

    @model_validator(mode="after")
    def _check_strictly_proper(self) -> Self:
        if len(self.all_zeros) >= len(self.all_poles):
            raise ValueError("a predictor needs a strictly proper model: fewer zeros than poles")
        if any(re * re + im * im > 1.0 for re, im in self.pole_pairs):
            raise ValueError("pole_pairs: must lie within the unit circle")
        return self

    @property
    def all_poles(self) -> list[float] | list[complex]:
        """All poles: real ones, then conjugate pairs."""
        return _append_conjugates(self.poles, self.pole_pairs)

    @property
    def all_zeros(self) -> list[float] | list[complex]:
        """All zeros: real ones, then conjugate pairs."""
        return _append_conjugates(self.zeros, self.zero_pairs)


Models = dict[str, dict[Literal["roll", "pitch", "yaw"], RateModel]]  # by engine and axis


class ModelFile(Model):
    """Identified models in a separate file, to be merged into a vehicle."""

    identified: Annotated[Models, Field(min_length=1)]


def read_models(path: Path) -> Models:
    """Return the models of a file by engine and axis; raise InputError if it cannot be read or is none."""
    table = read_toml(path)
    check_kind(table, path, MODELS)
    return validate(ModelFile, table, str(path)).identified
