"""Differences between the simulated vehicle and the one the controller is designed for."""

from operator import not_
from typing import Annotated

from pydantic import Field

from cosim.base.signals import JETS
from cosim.base.storage.toml import Model, Samples, Vector
from cosim.spec.scenario.faults import StationNumber

Factor = Annotated[float, Field(gt=0.0, le=10.0)]
_Part = Annotated[float, Field(ge=-2.0, le=2.0)]
Deformation = tuple[_Part, _Part, _Part]


class Mismatch(Model):
    """Differences of the simulated vehicle from its nominal data, unknown to the controller.

    Keys of the aircraft and of the engine change both sides where the controller is made from them too: the hover
    throttle follows the mass, the allocation the places of the jets, height control and tilts the engine's curve.
    """

    mass_factor: Factor = 1.0  # of the mass; inertia is unchanged
    # Factor of all moments and products of inertia.
    inertia_factor: Annotated[Factor, Field(exclude_if=lambda factor: factor == 1.0)] = 1.0
    # Stretch of the mass distribution along x, y, z, body, as the logarithm of a length's factor; any is a body's.
    stretch: Annotated[Deformation, Field(exclude_if=lambda logs: not any(logs))] = (0.0, 0.0, 0.0)
    # Shear of it in x by y, x by z, y by z, body: log-Cholesky (Rucker, Wensing, 2022), with mass, centre and stretch.
    shear: Annotated[Deformation, Field(exclude_if=lambda shears: not any(shears))] = (0.0, 0.0, 0.0)
    centre_m: Vector = (0.0, 0.0, 0.0)  # body, offset from the nominal centre
    thrust_factor: Factor = 1.0  # of all engines, at equal spool speed
    thrust_factor_1: Factor = 1.0  # in addition, of jet 1
    thrust_factor_2: Factor = 1.0
    thrust_factor_3: Factor = 1.0
    thrust_factor_4: Factor = 1.0
    thrust_factor_5: Factor = 1.0
    thrust_factor_6: Factor = 1.0
    delay_samples: Samples = 0  # of every engine; no controller knows it
    # Parameters of every engine that is the scenario's, by the FMU's names.
    engine_parameters: Annotated[dict[str, float], Field(exclude_if=not_)] = {}
    # Parameters of one station's engine, which override those of all.
    stations: Annotated[dict[StationNumber, dict[str, float]], Field(exclude_if=not_)] = {}

    @property
    def single_factors(self) -> tuple[float, ...]:
        return tuple(getattr(self, f"thrust_factor_{jet}") for jet in range(1, JETS + 1))
