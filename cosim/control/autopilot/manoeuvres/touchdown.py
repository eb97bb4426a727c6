"""Detection of ground contact, and of a vehicle that has come to stand there.

Two sources: the switch at the legs, and the accelerometer compared with the commanded thrust.  In the air at rest these
balance; where the legs carry weight the sensed force exceeds the thrust.  An accelerometer that repeats itself is not
used.  A switch that sticks reports contact anywhere: whether there can be ground is decided by :class:`Landing`.
"""

from __future__ import annotations

from cosim.base.protocols import Report


class Touchdown:
    """Detects ground contact by the leg switch, or by lift and thrust if the switch is silent or proved wrong.

    ``hover``: the collective at which it hovers with full tanks; ``idle``: what the engines give at none, on the same
    scale.  What the collective of level flight really is (fuel burns, engines are lost) is learnt in the air.
    ``spool``: s in which the engines follow a command, for certain.

    Times are long against the bounce of a leg (damping ratio 0.6 at 7 Hz: gone in 0.1 s); all are chosen by us.
    """

    # Times [s]: of contact until a touchdown, without contact until its end, and of a contact sensed without switch.
    touch_s, bounce_s, felt_s = 0.2, 0.1, 1.0
    # Time [s] since the last contact that still counts as contact: with thrust near its weight a vehicle hops so long.
    bouncing_s = 1.0
    # Times [s] until it stands: without thrust; without motion or commands, when 0.9 of its weight would sink 2 m/s.
    stand_s, rest_s = 0.5, 2.0
    # Sink rates [m/s]: faster than any landing, so that a contact is false, and slow enough to count as standing.
    falling, still = 1.0, 0.2
    # Fraction of hover thrust below which a descent cannot last.
    light = 0.6
    # Fraction of the weight on the legs, and for how long [s]: three times the error of lift and thrust in a descent.
    load, load_s = 0.15, 0.2
    # Measured lift over weight below which a report of leg contact is wrong.
    free_fall = 0.7
    # Averaging time [s] of the hover thrust.
    hover_s = 5.0

    def __init__(self, hover: float, step: float, idle: float = 0.0, spool: float = 0.0) -> None:
        self._full = hover + idle
        self._idle = idle
        self._step = step
        self._spool = max(spool, step)
        self.reset()

    def reset(self) -> None:
        """Start a flight, with the leg switch trusted again."""
        self._contact_s = self._no_contact_s = self._felt_s = self._light_s = 0.0
        self._load_s = self._hanging_s = self._resting_s = 0.0
        self._since_contact = self.bouncing_s  # s since the legs last reported contact
        self._thrust = 1.0  # upper bound of thrust over weight
        self._hover = 1.0  # estimated over nominal hover thrust
        self.switch_failed = False

    def update(self, sink: float, lift: float | None, report: Report, descending: bool, flying: bool = False) -> None:
        """Update contact by one step; ``sink``: sink rate [m/s]; ``descending``: a descent is commanded.

        ``lift``: specific force upwards over gravity, None where it is not known.  ``flying``: off the ground for
        certain, and not about to touch it.
        """
        dt = self._step
        thrust_fraction = (report.collective + self._idle) / self._full
        self._thrust = (
            thrust_fraction
            if thrust_fraction > self._thrust
            else self._thrust + 2.0 * dt / self._spool * (thrust_fraction - self._thrust)
        )
        if flying and lift is not None and 0.5 < lift < 1.5 and not report.legs:
            self._hover += dt / self.hover_s * (thrust_fraction / lift - self._hover)
        light = report.collective < self.light * (self._hover * self._full - self._idle)
        bearing = lift is not None and lift - self._thrust / self._hover > self.load
        self._load_s = self._load_s + dt if bearing else 0.0
        quiet = descending and light and self.carries_weight and abs(sink) < self.still
        self._felt_s = self._felt_s + dt if quiet else 0.0
        legs = report.legs and not self.switch_failed
        self._hanging_s = self._hanging_s + dt if legs and light and lift is not None and lift < self.free_fall else 0.0
        if legs and ((sink > self.falling and self.is_touching) or self._hanging_s > self.load_s):
            self.switch_failed = True
            legs = False
        self._since_contact = 0.0 if legs else self._since_contact + dt
        if legs or self._felt_s > self.felt_s:
            self._contact_s += dt
            self._no_contact_s = 0.0
        else:
            self._no_contact_s += dt
            if self._no_contact_s > self.bounce_s:
                self._contact_s = 0.0
        self._light_s = self._light_s + dt if light and self._contact_s > 0.0 else 0.0
        resting = descending and self.has_contact and abs(sink) < self.still
        self._resting_s = self._resting_s + dt if resting else 0.0

    @property
    def carries_weight(self) -> bool:
        """Whether the legs carry weight: for a moment at least, the sensed force exceeds the thrust."""
        return self._load_s > self.load_s

    @property
    def has_contact(self) -> bool:
        """Whether the legs touch the ground, or have until a moment ago."""
        return self._contact_s > 0.0

    @property
    def is_touching(self) -> bool:
        """Whether the vehicle has been in contact for a moment at least."""
        return self._contact_s > self.touch_s

    @property
    def is_bouncing(self) -> bool:
        """Whether the legs have touched the ground a moment ago."""
        return self._since_contact < self.bouncing_s

    @property
    def is_off_ground(self) -> bool:
        """Whether there has been no contact, for a moment at least."""
        return self._contact_s == 0.0 and self._no_contact_s > self.bounce_s

    @property
    def is_standing(self) -> bool:
        """Whether the vehicle is on the ground with the thrust gone."""
        return self._contact_s > self.stand_s and self._light_s > self.stand_s

    @property
    def legs_bear_weight(self) -> bool:
        """Whether the legs carry the weight that the engines, at their least thrust, do not.

        Engines around a lost one may give most of the weight for their balance.  If they give nearly all of it no load
        is to be felt; a vehicle that neither falls nor climbs away then stands.
        """
        return self._contact_s > self.stand_s and (self._load_s > self.stand_s or self._resting_s > self.rest_s)
