"""The most likely failure by gradients (``pip install jax``), beside the search that has none.

Two numbers of the vehicle are not known: its moments of inertia to 10 %, its thrust to 5 %.  A flight fails where roll
goes beyond a limit.  The nearest failure to the middle, in standard deviations, is where the margin is 0 and its
gradient points back: each step solves the margin's linear model (Hasofer and Lind, Rackwitz and Fiessler).
"""

# %% The margin of a flight as a function of both, in standard deviations
from cosim import Scenario, search  # isort: skip
import numpy as np

from hexjet_batch.stages.rotations import to_euler
from hexjet_batch.with_jax import jax, make_flight

LIMIT = np.radians(13.0)
settings = {"duration_s": 4.0, "sensor_noise": False}
numbers, fly_numbers = make_flight([Scenario.load("roll-doublet").replace(**settings)])
xp = numbers.xp


def margin(z, sharp=30000.0):
    """Return how far roll stays within its limit [rad]; ``sharp``: of the smooth maximum over the steps."""
    inertia, thrust = 1.0 + 0.1 * z[0], 1.0 + 0.05 * z[1]
    flown = numbers.flown
    body = flown.replace(inertia_kg_m2=tuple(inertia * value for value in flown.inertia_kg_m2))
    factors = tuple(thrust * factor for factor in numbers.factors)
    roll = to_euler(fly_numbers(numbers.replace(flown=body, factors=factors)).motion.attitude, xp)[0][:, 0]
    both = xp.concat([roll, -roll])
    return LIMIT - jax.scipy.special.logsumexp(sharp * both) / sharp


# %% Down the gradient to the nearest point without margin
slope = jax.jit(jax.value_and_grad(margin))
z = np.zeros(2)
flights = 0
value, gradient = slope(z)
while abs(value) > 1e-5 and flights < 12:
    gradient = np.asarray(gradient)
    z = (gradient @ z - float(value)) * gradient / (gradient @ gradient)
    value, gradient = slope(z)
    flights += 1
print(f"by gradient: {np.linalg.norm(z):.2f} standard deviations, {flights} flights, at {np.round(z, 2)}")

# %% The same by a search that flies and compares
found = search(
    "roll-doublet",
    likely=True,
    controllers=["smith"],
    vary={"mismatch.inertia_factor": "normal(1,0.1,0.5,1.5)", "mismatch.thrust_factor": "normal(1,0.05,0.5,1.5)"},
    success=["always(abs(roll_deg) < 13)"],
    settings=settings,
    budget=80,
    workers=1,
    out="runs/failure-by-gradient",
)
case = found.to_dict()["found"][0]
place = [round(each["place"], 2) for each in case["effects"]]
print(f"by search: {case['distance']:.2f} standard deviations, {case['flights']} flights, at {place}")
