"""The validated model of a ``vehicle.toml``, with the rules between its parts.

Body frame: forward-right-down (FRD), origin at the centre of gravity of the vehicle as built.
"""

from collections.abc import Sequence
from operator import not_
from re import fullmatch
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from cosim.base.constants import SERVOS
from cosim.base.layout import UP, Layout
from cosim.base.signals import MAX_JETS
from cosim.base.storage.toml import Model, Positive, Vector
from cosim.spec.vehicle.body import Aero, Contact, Fuel, GroundEffect, Panel
from cosim.spec.vehicle.gains import Control
from cosim.spec.vehicle.rate_model import RateModel
from cosim.spec.vehicle.sensors import Sensors
from cosim.spec.vehicle.stations import Airflow, Hinge, Jet, Servo, Surface, layout_of

# Default control step: the paper's 250 Hz.
STEP_S = 0.004
Step = Annotated[float, Field(gt=0.0, le=0.1)]  # s, control step


class Limits(Model):
    """Limits that end a flight."""

    tilt_deg: Annotated[float, Field(gt=0.0, le=180.0)]  # from upright, in the air: diverged
    rate_deg_s: Positive  # about any axis: diverged
    touchdown_m_s: Positive  # a leg touches faster: crashed


def _check_name(name: str) -> str:
    if not fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise ValueError("letters, digits, - and _ are allowed, a letter or digit first")
    return name


def _require_distinct(where: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{where}: two are called {name!r}; names must differ")


class Vehicle(Model):
    """The contents of ``aircraft/<name>/vehicle.toml``."""

    listed_by: ClassVar[str] = "hexjet sweep --keys vehicle"
    name: Annotated[str, AfterValidator(_check_name)]
    title: str
    model: str | None = None  # JSBSim model; None: built from this file
    engine: str | None = None  # default engine
    step_s: Step | None = None  # control step if a scenario states none
    mass_kg: Positive
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    # Products of inertia: integrals of x y, x z and y z over the mass, body.
    products_kg_m2: Annotated[Vector, Field(exclude_if=lambda products: not any(products))] = (0.0, 0.0, 0.0)
    jets: Annotated[list[Jet], Field(min_length=1, max_length=MAX_JETS)]
    hinges: list[Hinge] = Field(max_length=MAX_JETS, default_factory=list, exclude_if=not_)  # innermost first
    surfaces: list[Surface] = Field(max_length=MAX_JETS, default_factory=list, exclude_if=not_)
    panels: list[Panel] = Field(max_length=100, default_factory=list, exclude_if=not_)  # drawn only, without forces
    contacts: Annotated[list[Contact], Field(min_length=1)]
    servo: Servo | None = None
    fuel: Fuel | None = None
    # Of each jet without its own; None: no intake drag.
    airflow: Airflow | None = None
    ground_effect: GroundEffect | None = None  # None: no ground effect
    aero: Aero
    sensors: Sensors
    control: Control
    identified: dict[str, dict[Literal["roll", "pitch", "yaw"], RateModel]]
    limits: Limits

    @model_validator(mode="after")
    def _check_servos(self) -> Self:
        tilting = [jet.servo is not None for jet in self.jets]
        if any(tilting) != all(tilting) or any(tilting) != (self.servo is not None):
            raise ValueError("jets: either all jets have a servo and there is a table [servo], or none and no table")
        return self

    @model_validator(mode="after")
    def _check_hinges(self) -> Self:
        _require_distinct(
            "hinges, surfaces", [*(hinge.name for hinge in self.hinges), *(surface.name for surface in self.surfaces)]
        )
        for number, hinge in enumerate(self.hinges):
            for jet in (*hinge.carries, *hinge.deflects):
                if jet > len(self.jets):
                    raise ValueError(f"hinges.{number}: jet {jet}: there are jets 1 to {len(self.jets)}")
        return self

    @model_validator(mode="after")
    def _check_surfaces(self) -> Self:
        names = [surface.name for surface in self.surfaces]
        for number, panel in enumerate(self.panels):
            if panel.surface is not None and panel.surface not in names:
                there = f"there are: {', '.join(names)}" if names else "there are none"
                raise ValueError(f"panels.{number}.surface: no surface is called {panel.surface!r}; {there}")
            if panel.turn_rad and panel.surface is None:
                raise ValueError(f"panels.{number}.turn_rad {panel.turn_rad:g}: no surface is named that turns it")
        if self.surfaces and self.model is None:
            raise ValueError("surfaces: are moved in the vehicle's own JSBSim model, and model names none")
        return self

    @model_validator(mode="after")
    def _check_banks(self) -> Self:
        if self.servo is None:
            return self
        if self.hinges:
            raise ValueError("hinges: a vehicle with a table [servo] has its two banks; state them as hinges instead")
        if self.surfaces:
            raise ValueError("surfaces: the allocation of the two banks of [servo] moves none; state them as hinges")
        for number, station in enumerate(self.jets):
            if station.axis not in (None, UP):
                raise ValueError(
                    f"jets.{number}.axis {list(station.axis or UP)}: jets on the banks of [servo] point up"
                )
        return self

    @model_validator(mode="after")
    def _check_allocation(self) -> Self:
        method, where = self.control.allocation.method, "control.allocation.method"
        if method == "banks" and self.servo is None:
            raise ValueError(f"{where} 'banks': is for two banks with a table [servo]; take 'effectiveness'")
        if method == "rotors" and (self.servo is not None or not self._is_upright):
            raise ValueError(f"{where} 'rotors': is for jets that all point straight up; take 'effectiveness'")
        if method == "effectiveness" and self.servo is not None:
            raise ValueError(f"{where} 'effectiveness': state the two banks of [servo] as [[hinges]]")
        if self.allocation != "effectiveness" and len(self.jets) < 4:
            raise ValueError(
                f"jets: {len(self.jets)} that point straight up do not hold a vehicle level; four do, or hinges"
            )
        return self

    @model_validator(mode="after")
    def _check_wing(self) -> Self:
        wing, where = self.control.wing, "control.wing"
        if wing is None:
            return self
        if self.model is None or self.allocation != "effectiveness":
            raise ValueError(f"{where}: needs a model with a wing, and control.allocation.method 'effectiveness'")
        names = [hinge.name for hinge in self.hinges]
        for name in wing.tilts:
            if name not in names:
                raise ValueError(f"{where}.tilts: no hinge is called {name!r}; there are: {', '.join(names)}")
        return self

    @property
    def allocation(self) -> Literal["banks", "rotors", "effectiveness"]:
        """Allocation method of commands to throttles and angles: as configured, else chosen by the layout."""
        if self.control.allocation.method is not None:
            return self.control.allocation.method
        if self.servo is not None:
            return "banks"
        return "rotors" if self._is_upright else "effectiveness"

    @property
    def _is_upright(self) -> bool:
        """Whether all jets point straight up, without hinges or surfaces."""
        return not self.hinges and not self.surfaces and all(jet.axis in (None, UP) for jet in self.jets)

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of servo-driven actuators: hinges, then surfaces; the two banks if there are neither."""
        return (*(hinge.name for hinge in self.hinges), *(surface.name for surface in self.surfaces)) or SERVOS

    @property
    def turns(self) -> tuple[tuple[float, float], ...]:
        """Range [rad] of each angle of :meth:`layout`; empty if no thrust direction changes."""
        if self.servo is not None:
            return ((-self.servo.range_rad, self.servo.range_rad),) * len(SERVOS)
        return tuple(hinge.angle_limits for hinge in self.hinges)

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """Range of each of :attr:`actuators`; empty if nothing moves."""
        return (*self.turns, *(surface.range for surface in self.surfaces))

    @property
    def rest(self) -> tuple[float, ...]:
        """Rest position of each of :attr:`actuators`."""
        if not self.hinges and not self.surfaces:
            return (0.0, 0.0)
        return (*(hinge.rest_rad for hinge in self.hinges), *(0.0 for _ in self.surfaces))

    @property
    def tensor(self) -> tuple[Vector, Vector, Vector]:
        """Inertia tensor [kg m^2, body frame] by rows, the products of inertia with negative sign."""
        (a, b, c), (xy, xz, yz) = self.inertia_kg_m2, self.products_kg_m2
        return ((a, -xy, -xz), (-xy, b, -yz), (-xz, -yz, c))

    def with_point_mass(self, mass_kg: float, position_m: Vector) -> Self:
        """Return the vehicle with a point mass [kg] added, or removed if negative, at a place [m, body].

        Inertia is about its own centre of gravity then; places stay stated from the old one, as those of a small part.
        """
        shift = mass_kg * self.mass_kg / (self.mass_kg + mass_kg)  # parallel axis theorem
        squares = [x * x for x in position_m]
        inertia = [j + shift * (sum(squares) - own) for j, own in zip(self.inertia_kg_m2, squares, strict=True)]
        return self.model_copy(update={"mass_kg": self.mass_kg + mass_kg, "inertia_kg_m2": tuple(inertia)})

    def with_fuel(self, fraction: float) -> Self:
        """Return the vehicle with that fraction (0 to 1) of its full fuel; the same vehicle if it has no tank."""
        if self.fuel is None:
            return self
        return self.with_point_mass(-(1.0 - fraction) * self.fuel.mass_kg, self.fuel.position_m)

    def layout(self) -> Layout:
        """Return the layout of jets and hinges; its angles are those of the hinges, or of the two banks."""
        return layout_of(self.jets, self.hinges)

    @model_validator(mode="after")
    def _check_contacts(self) -> Self:
        _require_distinct("contacts", [contact.name for contact in self.contacts])
        return self

    @model_validator(mode="after")
    def _check_inertia(self) -> Self:
        a, b, c = sorted(self.inertia_kg_m2)
        if a + b < c:
            raise ValueError(
                f"inertia_kg_m2 {list(self.inertia_kg_m2)}: no body has one moment above the sum of the others"
            )
        if any(self.products_kg_m2):
            # The second moments of the mass, the integral of x x^T, must be a positive definite matrix.
            (a, b, c), (xy, xz, yz) = self.inertia_kg_m2, self.products_kg_m2
            xx, yy, zz = (b + c - a) / 2.0, (a + c - b) / 2.0, (a + b - c) / 2.0
            minor = xx * yy - xy * xy
            whole = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
            if minor < 0.0 or xx * zz < xz * xz or yy * zz < yz * yz or whole < 0.0:
                raise ValueError(
                    f"products_kg_m2 {list(self.products_kg_m2)}: no body with inertia_kg_m2 "
                    f"{list(self.inertia_kg_m2)} has them: too large, or in another unit"
                )
        return self

    @model_validator(mode="after")
    def _check_bank_inertia(self) -> Self:
        if self.servo and 2.0 * self.servo.bank_inertia_kg_m2 >= self.inertia_kg_m2[1]:
            raise ValueError(
                f"servo.bank_inertia_kg_m2 {self.servo.bank_inertia_kg_m2:g}: two banks are a part of the vehicle and "
                f"must have less than its moment of inertia about y, {self.inertia_kg_m2[1]:g} kg m^2"
            )
        return self

    @model_validator(mode="after")
    def _check_empty_vehicle(self) -> Self:
        if self.fuel is None:
            return self
        whole, fuel = self.mass_kg, self.fuel.mass_kg
        if fuel >= whole:
            raise ValueError(f"fuel.mass_kg {fuel:g} is a part of mass_kg {whole:g} and must be below it")
        empty = self.with_fuel(0.0).inertia_kg_m2
        a, b, c = sorted(empty)
        if a <= 0.0 or a + b < c:
            raise ValueError(
                f"fuel: {fuel:g} kg at {list(self.fuel.position_m)} leave an empty vehicle with the moments of inertia "
                f"{[round(moment, 6) for moment in empty]} kg m^2, which no body has"
            )
        return self

    @property
    def control_step(self) -> float:
        """Default control step [s]: ``step_s``, else the common sample time of all identified models, else STEP_S."""
        if self.step_s is not None:
            return self.step_s
        steps = {model.sample_time_s for models in self.identified.values() for model in models.values()}
        return steps.pop() if len(steps) == 1 else STEP_S
