"""Lead: compensation of a slow engine by an overshoot of its command.

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
    """Return numerator and denominator of ``C(z)``, highest power first, the denominator's first coefficient 1."""
    w, zeta = lead.natural_rad_s, lead.damping
    if zeta is None:
        roots = [complex(-w)]
    else:
        spread = w * sqrt(complex(zeta * zeta - 1.0))
        roots = [-zeta * w + spread, -zeta * w - spread]
    numerator, denominator = [complex(1.0)], [complex(1.0)]
    for root in roots:
        numerator = _multiply_by_root(numerator, exp(root * step))
        denominator = _multiply_by_root(denominator, exp(complex(-lead.pole_rad_s * step)))
    gain = _evaluate_at_one(denominator) / _evaluate_at_one(numerator)
    return [gain * x.real for x in numerator], [x.real for x in denominator]


def _evaluate_at_one(polynomial: list[complex]) -> float:
    """Return the real part at ``z = 1``, added up in order: ``sum`` adds in another way from Python to Python."""
    total = complex(0.0)
    for x in polynomial:
        total += x
    return total.real


def _multiply_by_root(polynomial: list[complex], root: complex) -> list[complex]:
    """Return ``polynomial * (z - root)``."""
    return [x - root * y for x, y in zip([*polynomial, 0.0], [0.0, *polynomial], strict=True)]


class Lead:
    """Lead compensator on one command.

    The allocation residual is subtracted from its state (``unallocated / C(inf)``), which is then that of an engine
    that got what was applied, so that the lead does not wind up.
    """

    def __init__(self, lead: EngineLead, step: float) -> None:
        self._step = step
        self.set_poles(lead)
        self.settle(0.0)

    def set_poles(self, lead: EngineLead) -> None:
        """Change the poles at the next update to those of a lead of the same form; the static gain stays 1."""
        numerator, denominator = lead_polynomials(lead, self._step)
        # C = c_0 + c_1 L + c_2 L^2 with the low-pass L = (1 - p) / (z - p): the states are as large as the input for
        # any lead. With past outputs as states, a change of the lead would be a step in the sum of two lags.
        p = exp(complex(-lead.pole_rad_s * self._step)).real
        b0, b1, b2 = (*numerator, 0.0)[:3]
        self._instant_gain, self._p, self._q = b0, p, 1.0 - p
        if len(denominator) == 2:
            self._c1, self._c2 = (b1 + p * b0) / self._q, 0.0
        else:
            self._c1 = (b1 + 2.0 * p * b0) / self._q
            self._c2 = (b0 * p * p + b1 * p + b2) / (self._q * self._q)

    @property
    def constants(self) -> tuple[float, float, float, float, float]:
        """The constants ``C(inf)``, ``p`` and ``1 - p`` of the low-pass, and the weights of its two outputs."""
        return (self._instant_gain, self._p, self._q, self._c1, self._c2)

    def settle(self, value: float) -> None:
        """Start as if ``value`` had always been the input."""
        self._once = self._twice = value  # input after one and after two low-passes

    def update(self, value: float, unallocated: float) -> float:
        """Return the compensated command; ``unallocated``: the allocation residual of the previous command."""
        p, q, once = self._p, self._q, self._once
        if unallocated:
            once -= q * unallocated / self._instant_gain
        twice = self._twice
        self._twice = p * twice + q * once
        self._once = p * once + q * value
        return self._instant_gain * value + self._c1 * once + self._c2 * twice
