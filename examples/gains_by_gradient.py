"""Two gains tuned by their gradient: flights that JAX differentiates (``pip install jax``), beside those of a design.

The cost is smooth: the mean square of the roll error, and of what the engines are asked for from step to step.  The
design knows no flight: it shapes the linear loop, for a delay and a gain that may be off by 30 %.
"""

# %% A flight as a function of the attitude gain and the rate gain of roll, as factors on the vehicle's own
import numpy as np

from cosim import Scenario, design
from hexjet_batch.stages.rotations import to_euler
from hexjet_batch.with_jax import jax, make_flight

scenario = Scenario.load("roll-doublet").replace(duration_s=4.0, sensor_noise=False, expect=[])
numbers, fly_numbers = make_flight([scenario])
xp = numbers.xp
k = xp.arange(scenario.steps) * scenario.step_s
asked = xp.radians(10.0) * xp.where(k < 1.0, 0.0, xp.where(k < 2.0, 1.0, xp.where(k < 3.0, -1.0, 0.0)))


def with_gains(logs):
    """Return the numbers with both gains times the exponentials of two numbers."""
    angle, rate = xp.exp(logs)
    gain = numbers.attitude.gain_1_s
    roll = numbers.rate[0].replace(p=rate * numbers.rate[0].p)
    return numbers.replace(
        attitude=numbers.attitude.replace(gain_1_s=(angle * gain[0], *gain[1:])), rate=(roll, *numbers.rate[1:])
    )


def cost(logs, effort=300.0):
    """Return the cost of a flight; ``effort``: what a turn of the torque costs beside an error."""
    flown = fly_numbers(with_gains(logs))
    error = to_euler(flown.motion.attitude, xp)[0][:, 0] - asked
    return xp.mean(error**2) + effort * xp.mean(xp.diff(flown.torque[0][:, 0]) ** 2)


# %% Downhill: a step along the gradient, halved where it goes too far
slope = jax.jit(jax.value_and_grad(cost))
logs = np.zeros(2)
value, gradient = slope(logs)
size = 0.3
for _ in range(20):
    ahead = logs - size * np.asarray(gradient) / np.linalg.norm(gradient)
    new, turned = slope(ahead)
    if new < value:
        logs, value, gradient = ahead, new, turned
    else:
        size /= 2.0

# %% Beside the vehicle's own gains and those of a design, which takes a minute
own = np.array([numbers.attitude.gain_1_s[0], numbers.rate[0].p])
made = design(controller="smith", lead=False, scheduled=False, proof=False).to_dict()["axes"]["roll"]["after"]["tuning"]
found = {
    "the vehicle's own": own,
    "by gradient": own * np.exp(logs),
    "by design": np.array([made["attitude_gain_1_s"], made["rate"]["p"]]),
}
for name, gains in found.items():
    value, _ = slope(np.log(gains / own))
    print(f"{name}: attitude {gains[0]:.3f} 1/s, rate {gains[1]:.4f}, cost {float(value):.5f}")
