"""Has the vehicle touched the ground, and has it come to stand there?"""

from __future__ import annotations

from cosim.pilot.modes import Report

# Chosen by us; times are long against the bounce of a leg (damping ratio 0.6 at 7 Hz: gone in 0.1 s).
_TOUCH_S = 0.2  # contact for so long counts
_BOUNCE_S = 0.1  # no contact for so long ends it
_STAND_S = 0.5  # with the thrust gone
_FELT_S = 1.0  # for the touch that is felt without a switch
_FALLING = 1.0  # m/s: faster than any landing, so a switch that reports contact here is broken
_STILL = 0.1  # m/s
_LIGHT = 0.6  # of hover collective: less than the vehicle could descend with for long


class Touchdown:
    """Contact from the leg switch, from height rate and collective where the switch is silent or has proved wrong."""

    def __init__(self, hover: float, step: float) -> None:
        self._hover = hover
        self._step = step
        self.reset()

    def reset(self) -> None:
        """A new flight: the switch is believed."""
        self._contact = self._apart = self._felt = self._light = 0.0
        self.switch_failed = False

    def update(self, sink: float, report: Report, descending: bool) -> None:
        """One step; ``sink`` the measured rate downwards, ``descending``: a descent is asked for."""
        dt = self._step
        light = report.collective < _LIGHT * self._hover
        quiet = descending and light and -_STILL < sink < _STILL
        self._felt = self._felt + dt if quiet else 0.0
        legs = report.legs and not self.switch_failed
        if legs and sink > _FALLING and self._contact > _TOUCH_S:
            self.switch_failed = True
            legs = False
        if legs or self._felt > _FELT_S:
            self._contact += dt
            self._apart = 0.0
        else:
            self._apart += dt
            if self._apart > _BOUNCE_S:
                self._contact = 0.0
        self._light = self._light + dt if light and self._contact > 0.0 else 0.0

    @property
    def touching(self) -> bool:
        """On the ground with some weight, for a moment at least."""
        return self._contact > _TOUCH_S

    @property
    def off(self) -> bool:
        """No contact, for a moment at least."""
        return self._contact == 0.0 and self._apart > _BOUNCE_S

    @property
    def standing(self) -> bool:
        """On the ground with the thrust gone."""
        return self._contact > _STAND_S and self._light > _STAND_S
