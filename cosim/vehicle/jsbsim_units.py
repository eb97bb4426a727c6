"""Units of JSBSim in SI units."""

from __future__ import annotations

from typing import Final

FOOT: Final = 0.3048  # m in a foot, exact
INCH: Final = 0.0254  # m in an inch, exact
POUND_FORCE: Final = 4.4482216152605  # N in a pound, exact
SLUG: Final = POUND_FORCE / FOOT  # kg in a slug
SLUG_FT2: Final = SLUG * FOOT**2  # kg m^2 in a slug ft^2
POUND_FOOT: Final = POUND_FORCE * FOOT  # N m in a pound foot
# Constant with which JSBSim converts weights to masses.
JSBSIM_POUNDS_PER_SLUG: Final = 32.174049
