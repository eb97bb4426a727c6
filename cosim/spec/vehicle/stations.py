"""Models of a vehicle's engine stations, tilt servos, hinges and surfaces, and their layout."""

from collections.abc import Sequence
from math import hypot
from operator import not_
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from cosim.base.constants import SERVOS, Side
from cosim.base.layout import UP, HingeAxis, Layout, Station
from cosim.base.storage.toml import Model, NotNegative, Positive, Vector


def _normalise(axis: Vector) -> Vector:
    """Return a vector scaled to length 1; one that has it already is returned unchanged, to the last bit."""
    length = hypot(*axis)
    if not length:
        raise ValueError("must have a direction, not [0, 0, 0]")
    if abs(length - 1.0) <= 1e-15:
        return axis
    return (axis[0] / length, axis[1] / length, axis[2] / length)


Direction = Annotated[Vector, AfterValidator(_normalise)]


class Airflow(Model):
    """Air mass flow of one engine: ``kg_s (thrust / at_thrust_n)^exponent``, with intake and exhaust."""

    kg_s: Positive
    at_thrust_n: Positive
    exponent: NotNegative
    intake_m: float  # from the station along the thrust
    exhaust_m: float  # exhaust, from the station along thrust


class Jet(Model):
    """One engine station: fixed to the body, on a tilting bank, or on hinges."""

    position_m: Vector  # body, from the centre of gravity
    # Direction of thrust on the vehicle, body, hinges at zero; None: straight up, [0, 0, -1].
    axis: Annotated[Direction | None, Field(exclude_if=not_)] = None
    servo: Side | None = None
    # Moment on the frame per thrust, about minus the thrust direction: with thrust straight up positive turns the nose
    # right.
    reaction_m: float = 0.0
    spin: Literal[-1, 0, 1] = 0  # sense about the thrust; 0: not modelled
    engine: Annotated[str | None, Field(exclude_if=not_)] = None  # default: that of the scenario
    # Airflow of this jet's own engine; None: that of the vehicle.
    airflow: Annotated[Airflow | None, Field(exclude_if=not_)] = None
    # Cost of using its range, relative to the others, in allocation by effectiveness.
    effort: Annotated[Positive, Field(exclude_if=lambda effort: effort == 1.0)] = 1.0


class Servo(Model):
    """A tilt servo: first-order lag, then rate and range limits."""

    lag_s: NotNegative
    rate_limit_rad_s: Positive
    range_rad: Annotated[float, Field(gt=0.0, le=3.2)]  # either way from straight up
    bank_inertia_kg_m2: NotNegative = 0.0  # of one bank about its axis; 0: neglected
    # Mass of one bank times the distance of its centre of mass from that axis, along the thrust.
    bank_imbalance_kg_m: float = 0.0


class Hinge(Model):
    """Bank, gimbal or vane with its own servo, which moves jets or deflects their thrust.

    The servo is a first-order lag with rate and range limits.  The turning part has ``mass_kg`` with its centre at
    ``centre_m`` (hinge at zero) and ``inertia_kg_m2`` about the hinge's axis, all of it a part of the vehicle's.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=24)]  # name in logs and faults
    position_m: Vector  # body: a point on its axis
    axis: Direction  # body; positive angles are right-handed
    carries: list[Annotated[int, Field(ge=1)]] = Field(default_factory=list)  # jets mounted on it, from 1
    deflects: list[Annotated[int, Field(ge=1)]] = Field(default_factory=list)  # jets whose thrust it deflects
    effect: float = 1.0  # turn of the thrust per turn of the hinge
    lag_s: NotNegative
    rate_limit_rad_s: Positive
    range_rad: Positive | tuple[float, float]  # either way from zero, or both limits
    rest_rad: float = 0.0  # angle at the start and without demand
    mass_kg: NotNegative = 0.0
    centre_m: Vector | None = None  # centre of mass, body; None: on the axis
    inertia_kg_m2: NotNegative = 0.0  # 0: its motion does not react on the body
    effort: Positive = 1.0

    @property
    def angle_limits(self) -> tuple[float, float]:
        """Least and greatest angle [rad]."""
        return self.range_rad if isinstance(self.range_rad, tuple) else (-self.range_rad, self.range_rad)

    @model_validator(mode="after")
    def _check_hinge(self) -> Self:
        least, most = self.angle_limits
        if least >= most:
            raise ValueError(f"range_rad [{least:g}, {most:g}]: the first must be below the second")
        if not least <= self.rest_rad <= most:
            raise ValueError(f"rest_rad {self.rest_rad:g}: must be within range_rad, {least:g} to {most:g}")
        if max(abs(least), abs(most)) > 3.2:
            raise ValueError(f"range_rad [{least:g}, {most:g}]: is more than half a turn either way: which unit?")
        if not self.carries and not self.deflects:
            raise ValueError("carries, deflects: name the jets that it moves, numbered from 1")
        if set(self.carries) & set(self.deflects):
            raise ValueError(
                f"deflects {self.deflects}: what a hinge carries turns with it as a whole; name a jet once"
            )
        if self.centre_m is not None:
            x, y, z = (c - p for c, p in zip(self.centre_m, self.position_m, strict=True))
            a, b, c = self.axis
            off = x * x + y * y + z * z - (a * x + b * y + c * z) ** 2
            if self.mass_kg * off > self.inertia_kg_m2 * (1.0 + 1e-9):
                raise ValueError(
                    f"inertia_kg_m2 {self.inertia_kg_m2:g}: {self.mass_kg:g} kg with the centre that far from the axis "
                    f"have at least {self.mass_kg * off:.3g} about it"
                )
        return self


class Surface(Model):
    """Commanded surface of the JSBSim model: a property of it, driven by its own servo."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=24)]
    # Property of the JSBSim model, for example fcs/elevator-cmd-norm.
    property: Annotated[str, Field(pattern=r"^[A-Za-z0-9_./\[\]-]+$")]
    lag_s: NotNegative
    rate_limit_1_s: Positive  # in the unit of the property
    range: tuple[float, float] = (-1.0, 1.0)
    # Airspeed along x at which allocation measures its effect in the model; default for small jets in transition.
    at_m_s: Positive = 20.0
    effort: Positive = 1.0

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        if not self.range[0] <= 0.0 <= self.range[1] or self.range[0] == self.range[1]:
            raise ValueError(f"range {list(self.range)}: least and most, and 0 within them")
        return self


def layout_of(jets: Sequence[Jet], hinges: Sequence[Hinge] = ()) -> Layout:
    """Return the layout of jets and hinges; jets with a ``servo`` turn about their own stations."""
    stations = [Station(jet.position_m, jet.axis or UP, -jet.reaction_m) for jet in jets]
    if any(jet.servo for jet in jets):
        banks = [tuple(n for n, jet in enumerate(jets) if jet.servo == side) for side in SERVOS]
        # The axis is -y, so that positive angles tilt the thrust forward.
        turns = [HingeAxis((0.0, 0.0, 0.0), (0.0, -1.0, 0.0), (), bank) for bank in banks]
    else:
        turns = [
            HingeAxis(
                hinge.position_m,
                hinge.axis,
                tuple(jet - 1 for jet in hinge.carries),
                tuple(jet - 1 for jet in hinge.deflects),
                hinge.effect,
            )
            for hinge in hinges
        ]
    return Layout(stations, turns)
