"""A jump of mass, centre of gravity and inertia while JSBSim flies.

JSBSim's state is that of the centre of gravity, and it moves the state first and evaluates forces and masses after.
A point mass that is written between two runs therefore acts late, and where it moves the centre of gravity, JSBSim
keeps the place and velocity of the centre where the body should keep those of its structure.  Nothing pushes a rigid
body when a part of it lets go or, at the same velocity, takes hold: it keeps attitude and rate, and its new centre of
gravity, by ``s`` from the old one, has

    r_new = r_old + s,    v_new = v_old + omega x s.

So before the step the place is moved, JSBSim evaluates accelerations anew with its integration suspended, and the first
run takes them alone, by the rectangular rule.
"""

from __future__ import annotations

from collections.abc import Callable
from math import asin, atan2, cos, hypot, sin

from cosim.base.signals import Vector3
from cosim.vehicle.executive import Executive
from cosim.vehicle.jsbsim_units import FOOT

PointMass = tuple[float, Vector3]  # kg, m from the nominal centre, body


def find_centre(mass: float, others: list[PointMass]) -> Vector3:
    """Return the centre of gravity [m, body, from that as built] of a mass [kg] as built plus point masses."""
    total = mass + sum([m for m, _ in others])
    x, y, z = (sum([m * place[axis] for m, place in others]) / total for axis in range(3))
    return (x, y, z)


class MassChange:
    """Corrects JSBSim's state after its masses were changed, before the next run."""

    def __init__(self, jsbsim: Executive) -> None:
        node = jsbsim.node
        self._fdm = jsbsim.fdm
        self._get = jsbsim.fdm.get_property_value
        self._turbulence = [node(f"atmosphere/turb-{axis}-fps") for axis in ("north", "east", "down")]
        self._gust = [node(f"atmosphere/gust-{axis}-fps") for axis in ("north", "east", "down")]
        self._kind = node("atmosphere/turb-type")
        self._latitude, self._longitude = node("position/lat-gc-rad"), node("position/long-gc-rad")
        self._height = node("position/h-sl-ft")

    def shift_centre(self, ned: Vector3) -> None:
        """Move the centre of gravity by ``ned`` [m]; velocity, attitude and rate stay."""
        north, east, down = (metres / FOOT for metres in ned)
        get = self._get
        latitude, longitude = get("position/lat-geod-rad"), get("position/long-gc-rad")
        outward = -north * sin(latitude) - down * cos(latitude)  # away from Earth's axis, in the meridian
        x = get("position/ecef-x-ft") + outward * cos(longitude) - east * sin(longitude)
        y = get("position/ecef-y-ft") + outward * sin(longitude) + east * cos(longitude)
        z = get("position/ecef-z-ft") + north * cos(latitude) - down * sin(latitude)
        radius = hypot(x, y, z)
        self._latitude.set_double_value(asin(z / radius))
        self._longitude.set_double_value(atan2(y, x))
        # The height is the radius minus the sea-level radius at this latitude.
        self._height.set_double_value(self._height.get_double_value() + radius - get("position/radius-to-vehicle-ft"))

    def evaluate(self, run: Callable[[], bool]) -> bool:
        """Evaluate forces and accelerations at the same time; return whether JSBSim continues.

        Its turbulence would divide by the time that passes, so it stands still meanwhile, as a gust.
        """
        kind = self._kind.get_double_value()
        if kind:
            for gust, turbulence in zip(self._gust, self._turbulence, strict=True):
                gust.set_double_value(turbulence.get_double_value())
            self._kind.set_double_value(0.0)
        self._fdm.suspend_integration()
        try:
            return run()
        finally:
            self._fdm.resume_integration()
            if kind:
                self._kind.set_double_value(kind)
                for gust in self._gust:
                    gust.set_double_value(0.0)
