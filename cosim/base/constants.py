"""Constants of nature and of law, once."""

from __future__ import annotations

from typing import Final

GRAVITY: Final = 9.80665  # m/s^2, the standard acceleration of free fall: exact by definition (CGPM 1901)
