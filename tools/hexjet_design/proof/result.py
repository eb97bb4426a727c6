"""What the proof of a design came to: see :mod:`hexjet_design.proof.run`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite

from hexjet_design.proof.comparison import FlownMeasures, FlownPair


@dataclass(frozen=True)
class ProofFlight:
    """One flight of a proof.

    ``flown``: what was measured of it; None where nothing was.
    """

    scenario: str
    gain: float  # factor on gains of roll, pitch and yaw
    later: int  # added delay in control steps
    fault: str  # deviation from the promise; or empty
    engine: str = ""  # engine that was off; empty: all alike
    flown: FlownMeasures | None = None

    @property
    def words(self) -> str:
        """Description of the flight in words."""
        corner = f"gain {self.gain:.2f}, {self.later} steps later"
        where = "as designed" if self.is_as_designed else corner
        return f"{self.scenario}, {self.engine or where}"

    @property
    def is_as_designed(self) -> bool:
        """Whether vehicle and engines were those of the design."""
        return (self.gain, self.later) == (1.0, 0) and not self.engine


@dataclass(frozen=True)
class Proof:
    """Checks of a design with the real engine and in flight; ``reason`` of failure, or empty."""

    reason: str
    measured_hz: float  # highest frequency measured
    stability_fraction: float  # max |T (r - 1)|; below 1 is stable
    sensitivity: float  # largest of the measured loops
    above: float  # largest loop gain above measured_hz
    flights: Sequence[ProofFlight]
    unsure: tuple[tuple[float, float], ...] = ()  # (Hz, misfit) where it fails
    compared: Sequence[FlownPair] = ()  # with shipped gains, if flown
    lean_deg: float = 0.0  # of the doublets; 0: none flown
    allowing: Mapping[str, float] = field(default_factory=dict)  # requirements that would have been met

    def lines(self) -> list[str]:
        """Describe the proof by flights and that by measured response, one sentence each."""
        lines = []
        if self.flights:
            passed = sum(not flight.fault for flight in self.flights)
            lines.append(
                f"flown in six degrees of freedom with noise and the engine itself: {passed} of {len(self.flights)} "
                f"flights kept what was promised ({self._describe_flights()})"
            )
        if isfinite(self.measured_hz):
            lines.append(
                f"model error, measured with the engine, uses {100.0 * self.stability_fraction:.0f} % of the stability "
                f"margin up to {self.measured_hz:.3g} Hz (peak |S| {self.sensitivity:.2f}); "
                f"above, |L| < {self.above:.2g}"
            )
        return lines

    def _describe_flights(self) -> str:
        names = ", ".join(dict.fromkeys(flight.scenario for flight in self.flights if not flight.engine))
        odd = "; one engine off" if any(flight.engine for flight in self.flights) else ""
        return f"{names}: as designed and at the tolerances' corners{odd}"
