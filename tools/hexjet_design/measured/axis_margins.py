"""The margins of one axis: measured, computed, and over an engine's uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

from hexjet_design.loop.engine_uncertainty import LoopUncertainty, delay_deviations, gain_deviations
from hexjet_design.loop.limit import AxisLimit
from hexjet_design.measured.computed import Computed
from hexjet_design.measured.engine_range import EngineRange
from hexjet_design.measured.estimate import Response, relative_difference
from hexjet_design.measured.excitation import Multisine

NYQUIST_CYCLES = 0.5  # per control step


@dataclass(frozen=True)
class AxisMargins:
    """One axis: measured, computed if possible, and measured at half the amplitude."""

    axis: str
    unit: str
    sine: Multisine
    amplitude: float
    periods: int
    response: Response
    half: Response
    computed: Computed | None
    notes: tuple[str, ...]
    uncertainty: LoopUncertainty | None = None  # of the engine at the crossover, or None
    over_engine: EngineRange | None = None  # margins over that uncertainty, or None
    transport_s: float | None = None  # s, command to rate; None: unknown

    @property
    def is_complete(self) -> bool:
        """Whether the loop was measured up to half the control rate, where a sampled loop ends."""
        return self.band_hz[1] * self.sine.step >= NYQUIST_CYCLES * (1.0 - 1e-9)

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest measured frequency above the noise."""
        heard = self.response.hertz[self.response.used]
        return float(heard[0]), float(heard[-1])

    def in_deviations(self) -> tuple[float | None, float | None]:
        """Return the nearer gain margin and the delay margin in standard deviations of the engine's gain and delay."""
        if self.uncertainty is None:
            return None, None
        gains = [self._margin_value(name) for name in ("gain_db", "gain_down_db")]
        gain_db = min([abs(value) for value in gains if value is not None], default=None)
        delay_s = self._margin_value("delay_s")
        return gain_deviations(self.uncertainty, gain_db), delay_deviations(self.uncertainty, delay_s)

    def _margin_value(self, name: str) -> float | None:
        return self.response.margins[name].value if name in self.response.margins else None

    @property
    def limit(self) -> AxisLimit | str | None:
        """Computed loop compared with the limit of performance, why there is none, or None if not requested."""
        return None if self.computed is None else self.computed.limit

    def off(self, name: str) -> float | None:
        """Return the relative deviation of the measured from the computed margin (gains as factors), or None."""
        if self.computed is None or name not in self.response.margins:
            return None
        value, reference = self.response.margins[name].value, getattr(self.computed.margins, name)
        return relative_difference(name, value, reference) if reference else None
