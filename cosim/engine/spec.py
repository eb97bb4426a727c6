"""Specification of an engine: its parameters, static curve and delay, ready for a bank."""

from __future__ import annotations

import hashlib
import math
import os
from bisect import bisect_right
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.archive import Archive
from cosim.engine.fmu.starting import Setting
from cosim.engine.fmu.variables import Port, Variable
from cosim.engine.library import FMI2_SUFFIX
from cosim.engine.response import REST_TOLERANCE, Curve, SmallStep, trim_flat_ends
from cosim.engine.rundown import FlameOutLaw

if TYPE_CHECKING:
    from cosim.engine.fmu.uncertainty import ParameterRange, Uncertainty
    from cosim.spec.vehicle import RateModel

Axis = TypeVar("Axis")


@dataclass(frozen=True)
class EngineSpec:
    """Specification of an engine that was measured and is ready for a bank.

    ``pole`` and ``delay_samples`` belong to ``G(z) = gain / (z - pole) z^-delay_samples`` at ``internal_step``, where
    the engine's ``engine.toml`` names the parameters; they are None for any other FMU.
    """

    name: str
    title: str
    library: bool  # one of the shipped engines
    path: Path
    fmi: str  # FMI version
    sha256: str  # hash of the archive
    parameters: Mapping[str, float]  # value of each parameter
    curve: Curve  # steady thrust [N] over throttle
    internal_step: float | None  # s, of the solver; None: unknown
    pole: float | None
    delay_samples: int | None
    start: str | None  # parameter that starts it at rest
    rotor_inertia: float  # inertia about the jet, kg m^2; 0: none
    flame_out: FlameOutLaw | None  # None: unknown
    specified_delay: float | None  # s, as its mapping file states
    mapping: Path | None  # mapping file that it was loaded by
    archive: Archive = field(repr=False)
    settings: tuple[Setting, ...] = field(repr=False)
    settling_window: int = field(repr=False)  # communication steps after the delay
    ripple: float = field(default=REST_TOLERANCE, repr=False)  # relative ripple of steady thrust
    air: Air = STANDARD_AIR  # air in which the curve was measured
    isolated: bool = False  # True: runs in a process of its own
    small_step: SmallStep | None = None  # response to a small step
    logged_outputs: tuple[tuple[str, Variable], ...] = ()  # additional columns and their variables
    uncertainty: Uncertainty | None = field(default=None, repr=False)  # uncertainty in its mapping file
    uncertain_ranges: tuple[ParameterRange, ...] = field(default=(), repr=False)  # ranges around the stated values

    @property
    def identity(self) -> str:
        """Identity of the engine in a design: the hash of its equations, else of its archive."""
        return self.archive.equations_sha256 or self.sha256

    @property
    def fingerprint(self) -> str:
        """Identity of a file's engine in an identified model: a hash of archive and mapping file; empty: library.

        The name alone does not distinguish one ``kestrel.toml`` from another.  How well its parameters are known is no
        part of it, and neither is how the file is written.
        """
        from cosim.engine.fmu.uncertainty import without_uncertainty  # imports numpy

        if self.library:
            return ""
        stated = without_uncertainty(self.mapping) if self.mapping else b""
        return hashlib.sha256(self.identity.encode() + stated).hexdigest()

    def matches_model(self, model_sha256: str) -> bool:
        """Return whether a model with this engine hash, or an empty one, may be of this engine."""
        return self.library or model_sha256 in ("", self.fingerprint)

    @property
    def source_key(self) -> tuple[Hashable, ...]:
        """Key of the engine's origin, equal for all engines of one FMU."""
        return self.path, self.mapping, self.settings

    @property
    def behaviour_key(self) -> tuple[Hashable, ...]:
        """Key of everything but inputs that the engine's behaviour depends on."""
        return *make_behaviour_key(self.archive, self.settings, self.air), self.start, self.settling_window, self.ripple

    @property
    def family(self) -> str:
        """Key of its identified models: the library's name without FMI version, else the name with the file's suffix.

        The file is the mapping file where there is one.  With its suffix, so that somebody's ``edf.fmu`` is not taken
        for the library's ``edf``.
        """
        file = self.mapping or self.path
        return self.name.removesuffix(FMI2_SUFFIX) if self.library else file_label(file) + file.suffix

    @property
    def families(self) -> tuple[str, ...]:
        """Keys of its identified models, including the file name that version 0.2.0 used."""
        return (self.family,) if self.library else (self.family, (self.mapping or self.path).name)

    def models_in(self, identified: Mapping[str, Mapping[Axis, RateModel]]) -> Mapping[Axis, RateModel]:
        """Return this engine's models by axis, if any; those of a file that was copied or renamed by its hash."""
        for family in self.families:
            if family in identified:
                return identified[family]
        own = self.fingerprint
        copied = (each for each in identified.values() if own and any(m.engine_sha256 == own for m in each.values()))
        return next(copied, {})

    @property
    def ports(self) -> Mapping[str, Port]:
        """The engine's variables with their conversions, by port name."""
        return self.archive.ports

    def has_port(self, port: str) -> bool:
        """Return whether the engine has a port, such as ``ambient_pressure``, ``run`` or ``fuel_flow``."""
        return port in self.ports

    @property
    def transport_delay(self) -> float | None:
        """Delay from throttle to thrust [s]; None where the engine states none."""
        if self.specified_delay is not None:
            return self.specified_delay
        if self.delay_samples is None or self.internal_step is None:
            return None
        return self.delay_samples * self.internal_step

    @property
    def rising_curve(self) -> Curve:
        """Part of the static curve on which thrust rises with throttle."""
        return trim_flat_ends(self.curve, self.ripple, self.archive.starting.rest_n)

    @property
    def lag(self) -> float | None:
        """Time constant [s] of the stated pole: -internal_step / ln(pole)."""
        if self.pole is None or self.internal_step is None:
            return None
        return -self.internal_step / math.log(self.pole) if self.pole > 0.0 else 0.0

    def thrust_at(self, throttle: float) -> float:
        """Return the steady thrust [N] at a throttle, interpolated linearly between the measured points."""
        throttles, thrusts = self.curve
        k = min(max(bisect_right(throttles, throttle), 1), len(throttles) - 1)
        fraction = (throttle - throttles[k - 1]) / (throttles[k] - throttles[k - 1])
        return thrusts[k - 1] + (thrusts[k] - thrusts[k - 1]) * min(max(fraction, 0.0), 1.0)


def file_label(path: Path) -> str:
    """Return a name for an engine file: the file's, or its folder's if the file is called ``engine``."""
    return Path(os.path.abspath(path)).parent.name or path.stem if path.stem == "engine" else path.stem


def make_behaviour_key(archive: Archive, settings: tuple[Setting, ...], air: Air) -> tuple[Hashable, ...]:
    """Return a key of everything that the response of an FMU with these settings in this air depends on."""
    values = tuple((variable.name, value.hex()) for variable, value in settings)
    return archive.sha256, tuple(sorted(archive.ports.items())), archive.starting, values, air
