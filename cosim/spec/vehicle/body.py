"""Models of a vehicle's tank, drag, contact points, ground effect and drawn panels."""

from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from cosim.base.storage.toml import Axis3, Model, NotNegative, Positive, Vector


class Panel(Model):
    """Flat panel of a wing, tail or surface, for drawing only.

    A panel with a ``surface`` turns with it, right-handed about the edge from the first corner to the second.
    """

    corners_m: Annotated[list[Vector], Field(min_length=3, max_length=12)]  # body, in order around the panel
    surface: str | None = None  # control surface that turns it
    turn_rad: Annotated[float, Field(ge=-3.2, le=3.2)] = 0.0  # angle at the surface's property 1

    @model_serializer(mode="wrap")
    def _leave_out_surface(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        table: dict[str, Any] = handler(self)
        return {key: value for key, value in table.items() if key == "corners_m" or self.surface is not None}


class Fuel(Model):
    """Fuel in the full tank: part of ``Vehicle.mass_kg``, at one point."""

    mass_kg: Positive
    position_m: Vector  # body


class GroundEffect(Model):
    """Effects of the jets near the ground, each with a switch; see :mod:`cosim.vehicle.effects.ground_effect`."""

    suckdown: bool = False  # lift loss by Wyatt's correlation
    # Angular mean diameter of the shape above the jets: (1 / pi) times the integral of its radius.
    planform_m: Positive
    jet_m: Positive  # of one round jet with the total area
    planform_z_m: float = 0.0  # below the centre of gravity
    hot_gas: bool = False  # True: intakes get warmer near the ground
    hot_gas_height_m: list[NotNegative] = Field(default_factory=list)  # height of the centre of gravity, rising
    hot_gas_rise_k: list[NotNegative] = Field(default_factory=list)  # rise at each height; the last is 0

    @model_validator(mode="after")
    def _check_hot_gas(self) -> Self:
        if self.jet_m >= self.planform_m:
            raise ValueError(f"jet_m {self.jet_m:g} must be below planform_m {self.planform_m:g}")
        heights, rises = self.hot_gas_height_m, self.hot_gas_rise_k
        if len(heights) != len(rises):
            raise ValueError(f"hot_gas_rise_k: needs one value for each of the {len(heights)} of hot_gas_height_m")
        if self.hot_gas and len(heights) < 2:
            raise ValueError("hot_gas: needs two or more heights in hot_gas_height_m, and their hot_gas_rise_k")
        if any(b <= a for a, b in pairwise(heights)):
            raise ValueError(f"hot_gas_height_m: every height must be above the one before it, not {heights}")
        if rises and rises[-1] != 0.0:
            raise ValueError(f"hot_gas_rise_k: the last must be 0, not {rises[-1]:g}: above it nothing is swallowed")
        return self


class Aero(Model):
    """Body drag, one area per axis, and linear damping of rates."""

    # Wing span for JSBSim's turbulence model: gusts of this size turn the vehicle.
    span_m: Positive
    drag_area_m2: Axis3  # Cd times reference area along x, y, z
    centre_m: Vector  # centre of drag, body
    damping_n_m_s: Axis3  # moment per rate about x, y, z


class Contact(Model):
    """A point that can touch the ground."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_. -]*$")]
    kind: Literal["leg", "hull"]
    position_m: Vector
    spring_n_m: Positive
    damping_n_s_m: NotNegative
    friction_static: NotNegative
    friction_dynamic: NotNegative
