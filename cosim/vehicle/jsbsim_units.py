"""Units of JSBSim in SI units."""

from __future__ import annotations

from typing import Final

FOOT: Final = 0.3048  # m, exact
INCH: Final = 0.0254  # m, exact
POUND_FORCE: Final = 4.4482216152605  # N, exact
SLUG: Final = POUND_FORCE / FOOT  # kg
SLUG_FT2: Final = SLUG * FOOT**2  # kg m^2
POUND_FOOT: Final = POUND_FORCE * FOOT  # N m
# Constant with which JSBSim converts weights to masses.
JSBSIM_POUNDS_PER_SLUG: Final = 32.174049
