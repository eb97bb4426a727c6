"""From data to a model: readers of flight logs, identification by a sweep, identification from a log.

from cosim.identify import identify_axis

roll = identify_axis("roll")
roll.model.delay_samples, roll.response.magnitude_db
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.identify.sweep import FrequencyResponse, fit, identify_axis, identify_engine

__all__ = ["FrequencyResponse", "fit", "identify_axis", "identify_engine"]


def __getattr__(name: str) -> Any:
    """Load what is asked for: whoever reads a log needs no sweep."""
    if name in __all__:
        from cosim.identify import sweep

        return getattr(sweep, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
