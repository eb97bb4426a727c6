"""A second way to the loop that ``hexjet design`` closes: one step of it, written out, with every delay as states.

Nothing here knows :mod:`hexjet_design`: the plant is stepped as the simulation steps it, JSBSim run by JSBSim run, and
the predictors are textbook realisations in companion form.  The step is linear, so unit vectors give its matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import exp
from typing import Any

import control
import numpy as np
from scipy.linalg import fractional_matrix_power
from scipy.signal import tf2ss

from cosim.base.arrays import Array


@dataclass(frozen=True)
class Engine:
    """``thrust' = A thrust + B command``, ``out = C thrust'`` over a step, gain 1 at rest, behind ``delay`` steps."""

    A: Array
    B: Array
    C: Array
    delay: int


def first_order(pole: float, delay: int) -> Engine:
    return Engine(np.array([[pole]]), np.array([1.0 - pole]), np.array([1.0]), delay)


def realised(answer: Array, delay: int, order: int) -> Engine:
    """An engine from its answer to a step of the command, sampled at the end of each step: Ho and Kalman's realisation.

    Pulses that are long beside a sample are what Hankel's matrix tells apart, so it is made of every tenth sample; the
    root of the realisation is taken to come back to one.
    """
    every, rows = 10, 60
    rest = answer[delay:] / answer[-1]
    pulse = np.diff(rest[every - 1 :: every], prepend=0.0)
    hankel = np.array([pulse[i : i + rows] for i in range(rows + 1)])
    U, size, V = np.linalg.svd(hankel[:-1])
    root = np.sqrt(size[:order])
    slow = (U[:, :order] / root).T @ hankel[1:] @ (V[:order].T / root)
    A = np.real(fractional_matrix_power(slow, 1.0 / every))
    C = U[0, :order] * root
    held = sum(np.linalg.matrix_power(A, k) for k in range(every))
    B = np.linalg.solve(held, root * V[:order, 0])
    return Engine(A, B / (C @ np.linalg.solve(np.eye(order) - A, B)), C, delay)


def matched(lead: Mapping[str, float], step: float) -> tuple[Array, Array, Array, float]:
    """The lead in state space: z = e^(sT) for both roots above and below, 1 at rest."""
    w, a = lead["natural_rad_s"], lead["pole_rad_s"]
    above = np.roots([1.0, 2.0 * lead["damping"] * w, w * w]) if "damping" in lead else np.array([-w])
    over = np.real(np.poly(np.exp(above * step)))
    under = np.poly([exp(-a * step)] * len(above))
    A, B, C, D = tf2ss(over * under.sum() / over.sum(), under)
    return A, B[:, 0], C[0], float(D[0, 0])


def partial_fractions(gain: float, zeros: Sequence[complex], poles: Sequence[complex]) -> tuple[Array, Array, Array]:
    """``gain prod (z - zero) / prod (z - pole)`` as a real state for each pole, a pair as real and imaginary part.

    In companion form poles that are all but 1 would lose their digits.
    """
    n = len(poles)
    A, B, C = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    k = 0
    for i, pole in enumerate(poles):
        others = [each for j, each in enumerate(poles) if j != i]
        share = gain * np.prod([pole - zero for zero in zeros]) / np.prod([pole - other for other in others])
        size = np.sqrt(abs(share))
        p = complex(pole)
        if p.imag > 0.0:  # r / (z - p) and its conjugate
            A[k : k + 2, k : k + 2] = [[p.real, -p.imag], [p.imag, p.real]]
            B[k], C[k : k + 2] = size, np.array([2.0 * share.real, -2.0 * share.imag]) / size
            k += 2
        elif not p.imag:
            A[k, k], B[k], C[k] = p.real, size, np.real(share) / size
            k += 1
    return A, B, C


def observer_gain(F: Array, C: Array, pole: float) -> Array:
    """The gain that puts all poles of ``(I - gain C) F`` at one place: Ackermann's formula, in exact fractions.

    As many equal poles among those that are all but 1 are not found in floating point.
    """
    n = len(F)
    exact = [[Fraction(float(each)) for each in row] for row in F]
    place = Fraction(float(pole))

    def times(row: list[Fraction], matrix: list[list[Fraction]]) -> list[Fraction]:
        return [sum((row[i] * matrix[i][j] for i in range(n)), Fraction()) for j in range(n)]

    rows = [times([Fraction(float(each)) for each in C], exact)]
    for _ in range(n - 1):
        rows.append(times(rows[-1], exact))
    wanted = [Fraction(int(i == n - 1)) for i in range(n)]
    for i in range(n):  # Gauss's elimination
        pivot = next(k for k in range(i, n) if rows[k][i])
        rows[i], rows[pivot], wanted[i], wanted[pivot] = rows[pivot], rows[i], wanted[pivot], wanted[i]
        for k in range(n):
            if k != i and rows[k][i]:
                share = rows[k][i] / rows[i][i]
                rows[k] = [a - share * b for a, b in zip(rows[k], rows[i], strict=True)]
                wanted[k] -= share * wanted[i]
    x = [wanted[i] / rows[i][i] for i in range(n)]
    for _ in range(n):
        x = [sum((exact[i][j] * x[j] for j in range(n)), Fraction()) - place * x[i] for i in range(n)]
    return np.array([float(each) for each in x])


@dataclass(frozen=True)
class Body:
    """The airframe about one axis, with the gyro behind it."""

    gain: float  # rad/s^2 per unit of command
    damping: float  # 1/s
    step: float
    substeps: int
    gyro_s: float
    latency: int = 0  # steps until the rate is measured
    hold: int = 1  # steps for which a measurement is kept; what that does on the mean
    angle_latency: int = 0
    banks: float = 0.0  # rad/s^2 of the body per rad/s^2 of the tilt: the reaction of what is tilted


class Loop:
    """One channel under a controller file's numbers."""

    def __init__(
        self,
        engine: Engine,
        body: Body,
        controller: str,
        model: Mapping[str, Any] | None,
        rate: Mapping[str, float],
        attitude: float,
        tuning: Mapping[str, float],
        lead: Mapping[str, float] | None = None,
    ) -> None:
        self.engine, self.body, self.rate, self.attitude = engine, body, rate, attitude
        self.lead = matched(lead, body.step) if lead else None
        self.size = 0
        self.past = 1 + (int(model["delay_samples"]) if model else 0)
        self.slots: dict[str, slice] = {}
        for name, n in (
            ("thrust", len(engine.A)),
            ("force", 1),
            ("tilt", 2),  # of the last two steps
            ("w", 1),
            ("w_dot", 1),
            ("gyro", body.latency + body.hold),
            ("angle", 1 + body.angle_latency),
            ("sum", 1),
        ):
            self._slot(name, n)
        for name, n in (("slope", 1), ("before", 1), ("u", self.past), ("sent", engine.delay)):
            self._slot(name, n)
        if self.lead is not None:
            self._slot("lead", len(self.lead[0]))
        self.predict = self._predictor(controller, model, tuning)
        identity = np.eye(self.size + 2)
        columns = [self.advance(column[:-2], column[-2], column[-1]) for column in identity]
        self.A = np.array([after for after, _ in columns[:-2]]).T
        self.C = np.array([total for _, total in columns[:-2]])
        self.B, self.D = columns[-2]
        self.of_set_point = columns[-1][0]

    def closed(self, step: float) -> Any:
        """Set-point to angle, as python-control has it."""
        angle = np.zeros((1, self.size))
        angle[0, self.slots["angle"].start] = 1.0
        return control.ss(self.A, self.of_set_point[:, None], angle, 0.0, step)

    def _slot(self, name: str, n: int) -> None:
        self.slots[name] = slice(self.size, self.size + n)
        self.size += n

    def advance(self, x: Array, w: float, r: float) -> tuple[Array, float]:
        """State after a step with ``w`` added to the command and a set-point ``r``, and what reached the plant."""
        body, slots, T = self.body, self.slots, self.body.step
        value = {name: x[where] for name, where in slots.items()}
        after = np.zeros_like(x)
        line, angles = value["gyro"], value["angle"]
        value["gyro"] = np.array([line[body.latency :].mean()])  # as it is measured
        predicted = self.predict(value, after)
        error = self.attitude * (r - angles[-1]) - predicted
        total = value["sum"][0] + self.rate["i"] * T * error
        share = T / (self.rate["d_filter_s"] + T)
        slope = value["slope"][0] + share * ((predicted - value["before"][0]) / T - value["slope"][0])
        u = self.rate["p"] * error + total - self.rate["d"] * slope
        if self.lead is not None:
            A, B, C, D = self.lead
            after[slots["lead"]] = A @ value["lead"] + B * u
            u = C @ value["lead"] + D * u
        sent = np.concatenate([[u + w], value["sent"]])
        thrust = self.engine.A @ value["thrust"] + self.engine.B * sent[self.engine.delay]
        tilt, (last, earlier) = self.engine.C @ thrust, value["tilt"]
        # over a step the body gets the momentum that the banks lose: the change of their mean speed
        force = body.gain * tilt + body.banks * ((tilt - last) - (last - earlier)) / T**2
        old, rate, small = value["force"][0], value["w"][0], T / body.substeps
        now, before = old - body.damping * rate, value["w_dot"][0]
        for run in range(body.substeps):
            rate = rate + small * (1.5 * now - 0.5 * before)
            # the first of several runs ends with half the change of the force on top
            acting = force + 0.5 * (force - old) if run == 0 and body.substeps > 1 else force
            now, before = acting - body.damping * rate, now
        pole = exp(-T / body.gyro_s) if body.gyro_s else 0.0
        told = np.concatenate([[u], value["u"]])  # to the predictor, which does not know of w
        new = {
            "thrust": thrust,
            "force": force,
            "tilt": [tilt, last],
            "w": rate,
            "w_dot": before,
            "gyro": [pole * line[0] + (1.0 - pole) * rate, *line[:-1]],
            "angle": [angles[0] + 0.5 * T * (value["w"][0] + rate), *angles[:-1]],
            "sum": total,
            "slope": slope,
            "before": predicted,
        }
        for name, number in new.items():
            after[slots[name]] = number
        after[slots["u"]] = told[: self.past]
        after[slots["sent"]] = sent[: self.engine.delay]
        return after, u + w

    def _predictor(
        self, controller: str, model: Mapping[str, Any] | None, tuning: Mapping[str, float]
    ) -> Callable[[Mapping[str, Array], Array], float]:
        if controller == "baseline":
            return lambda value, after: float(value["gyro"][0])
        assert model is not None
        zeros, poles = (
            [
                *model[f"{what}s"],
                *(complex(re, sign * im) for re, im in model.get(f"{what}_pairs", ()) for sign in (1, -1)),
            ]
            for what in ("zero", "pole")
        )
        A, B, C = partial_fractions(model["gain"], zeros, poles)
        d, T = int(model["delay_samples"]), model["sample_time_s"]
        n = len(A)
        if controller in ("smith", "filtered-smith"):
            self._slot("now", n)
            self._slot("then", n)
            self._slot("filter", 4)  # what went in and came out, one and two steps ago
            a = exp(-T / tuning["filter_s"])
            p = max(model["poles"])
            # F = (b0 z^2 + b1 z) / (z - a)^2 with F(1) = 1 and F(p) = p^d
            rows = np.array([[1.0, 1.0], [p * p, p]])
            b0, b1 = np.linalg.solve(rows, [(1.0 - a) ** 2, p**d * (p - a) ** 2])

            def smith(value: Mapping[str, Array], after: Array) -> float:
                now = A @ value["now"] + B * value["u"][0]
                then = A @ value["then"] + B * value["u"][d]
                after[self.slots["now"]], after[self.slots["then"]] = now, then
                off = float(value["gyro"][0] - C @ then)
                if controller == "smith":
                    return float(C @ now) + off
                in1, _, out1, out2 = value["filter"]
                out = b0 * off + b1 * in1 + 2.0 * a * out1 - a * a * out2
                after[self.slots["filter"]] = [off, in1, out, out1]
                return float(C @ now) + out

            return smith
        disturbed = controller == "state-disturbance"
        size = n + 1 if disturbed else n
        F = np.eye(size)
        F[:n, :n] = A
        if disturbed:
            F[:n, n] = B
        C_all = np.concatenate([C, [0.0]])[:size]
        bandwidth = tuning["disturbance_observer_rad_s" if disturbed else "model_observer_rad_s"]
        gain = observer_gain(F, C_all, exp(-bandwidth * T))
        self._slot("x", size)
        weights = [np.linalg.matrix_power(A, j) @ B for j in range(d)]
        far = C @ np.linalg.matrix_power(A, d)
        steady = float(sum(C @ weight for weight in weights))

        def observed(value: Mapping[str, Array], after: Array) -> float:
            x = F @ value["x"]
            x[:n] += B * value["u"][d]
            x = x + gain * (value["gyro"][0] - C_all @ x)
            after[self.slots["x"]] = x
            on_its_way = sum(float(C @ weights[j]) * value["u"][j] for j in range(d))
            return float(far @ x[:n]) + on_its_way + (steady * float(x[n]) if disturbed else 0.0)

        return observed

    @property
    def stable(self) -> bool:
        """All eigenvalues inside the unit circle."""
        return bool(np.abs(np.linalg.eigvals(self.A)).max() < 1.0)

    def sensitivity(self, points: int = 700) -> Array:
        """``|S|`` from 0.001 rad a sample to the Nyquist frequency."""
        z = np.exp(1j * np.geomspace(1e-3, np.pi, points))
        # one solution a frequency: the eigenvectors of a delay chain are all but parallel
        states = np.linalg.solve(z[:, None, None] * np.eye(self.size) - self.A, self.B[:, None])
        return np.abs(self.D + states[:, :, 0] @ self.C)

    def stable_with(self, factor: complex) -> bool:
        """Whether the loop is stable with ``factor`` times what goes into the plant: a gain, or a turn of the phase."""
        return bool(np.abs(np.linalg.eigvals(self.A + (factor - 1.0) * np.outer(self.B, self.C))).max() < 1.0)

    def open_loop(self, theta: Array) -> Any:
        """``L`` at ``theta`` rad a sample, broken at the plant's input."""
        alone = self.A - np.outer(self.B, self.C)
        z = np.exp(1j * theta)
        states = np.linalg.solve(z[:, None, None] * np.eye(self.size) - alone, self.B[:, None])
        return -states[:, :, 0] @ self.C

    def delay_margin(self) -> float:
        """Samples: the least angle from -1 at a crossing of ``|L| = 1``, over the frequency there."""
        theta = np.geomspace(1e-4, 3.1, 3000)
        size = np.log(np.abs(self.open_loop(theta)))
        found = []
        for k in np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:])):
            low, high = theta[k], theta[k + 1]
            for _ in range(30):
                middle = 0.5 * (low + high)
                inside = np.sign(np.log(abs(self.open_loop(np.array([middle]))[0]))) == np.sign(size[k])
                low, high = (middle, high) if inside else (low, middle)
            found.append((np.angle(self.open_loop(np.array([low]))[0]) + np.pi) % (2.0 * np.pi) / low)
        return float(min(found))
