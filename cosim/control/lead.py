"""Lead: a slow engine answered for, by asking at first for more than is wanted in the end.

The lags of the engine are divided out and shorter ones put in their place, with gain 1 at rest:

    C(s) = (a / w)^2 (s^2 + 2 zeta w s + w^2) / (s + a)^2,  of a single lag  (a / w) (s + w) / (s + a)
    C(z) = C_0 prod(z - z_i) / (z - e^(-a T))^n,  z_i = e^(s_i T) at the roots s_i of what is divided out

Poles and zeros are matched, ``z = e^(s T)``: the sampled engine has its poles at the same ``z_i``, so behind a hold
they cancel exactly, and ``C(z) G(z)`` keeps nothing of them.  A predictor stands before the lead and reads what comes
behind it.
"""

from __future__ import annotations

from cmath import exp, sqrt

from cosim.spec.vehicle import EngineLead


def lead_polynomials(lead: EngineLead, step: float) -> tuple[list[float], list[float]]:
    """Numerator and denominator of ``C(z)``, highest power first, the denominator's first coefficient 1."""
    w, zeta = lead.natural_rad_s, lead.damping
    if zeta is None:
        roots = [complex(-w)]
    else:
        turn = w * sqrt(complex(zeta * zeta - 1.0))
        roots = [-zeta * w + turn, -zeta * w - turn]
    over, under = [complex(1.0)], [complex(1.0)]
    for root in roots:
        over = _times(over, exp(root * step))
        under = _times(under, exp(complex(-lead.pole_rad_s * step)))
    gain = _at_one(under) / _at_one(over)
    return [gain * x.real for x in over], [x.real for x in under]


def _at_one(polynomial: list[complex]) -> float:
    """Return the real part at ``z = 1``, added up in order: ``sum`` adds in another way from Python to Python."""
    total = complex(0.0)
    for x in polynomial:
        total += x
    return total.real


def _times(polynomial: list[complex], root: complex) -> list[complex]:
    """``polynomial * (z - root)``."""
    return [x - root * y for x, y in zip([*polynomial, 0.0], [0.0, *polynomial], strict=True)]


class Lead:
    """The lead on one command.

    What allocation could not give is taken back from its past, and with it what was wanted (``unallocated / C(inf)``):
    its state is then that of an engine that got what was applied: it neither winds up nor asks for what is there.
    """

    def __init__(self, lead: EngineLead, step: float) -> None:
        self._step = step
        self.follow(lead)
        self.settle(0.0)

    def follow(self, lead: EngineLead) -> None:
        """Another lead of the same form from the next update on: what is wanted for long is still given as it is."""
        over, under = lead_polynomials(lead, self._step)
        # C = c_0 + c_1 L + c_2 L^2 with the low-pass L = (1 - p) / (z - p): states that are as large as what is wanted,
        # whatever the lead becomes.  Past answers for states would be, with a change, a push that two lags add up.
        p = exp(complex(-lead.pole_rad_s * self._step)).real
        b0, b1, b2 = (*over, 0.0)[:3]
        self._most, self._p, self._q = b0, p, 1.0 - p
        if len(under) == 2:
            self._c1, self._c2 = (b1 + p * b0) / self._q, 0.0
        else:
            self._c1 = (b1 + 2.0 * p * b0) / self._q
            self._c2 = (b0 * p * p + b1 * p + b2) / (self._q * self._q)

    @property
    def constants(self) -> tuple[float, float, float, float, float]:
        """``C(inf)``, the low-pass's ``p`` and ``1 - p``, and the weights of the two low-passed."""
        return (self._most, self._p, self._q, self._c1, self._c2)

    def settle(self, value: float) -> None:
        """As if ``value`` had always been wanted."""
        self._once = self._twice = value  # what was wanted, through one low-pass and through two

    def update(self, wanted: float, unallocated: float) -> float:
        """Return the led command; ``unallocated`` is what allocation could not give of the answer before."""
        p, q, once = self._p, self._q, self._once
        if unallocated:
            once -= q * unallocated / self._most
        twice = self._twice
        self._twice = p * twice + q * once
        self._once = p * once + q * wanted
        return self._most * wanted + self._c1 * once + self._c2 * twice
