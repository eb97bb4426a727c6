"""The time before a flight with an autopilot: its sensors are those of the flight, and none says the same twice."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import conjugate, from_euler, multiply, rotate, to_euler
from cosim.base.geodesy import gravity
from cosim.base.signals import Measured, State
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Sensors
from hexjet_sitl.block import StationarySensors

PULL = 9.79
SENSORS = Scenario.load("hover").resolved_vehicle()[0].sensors
BIASED = Sensors.model_validate(
    SENSORS.model_dump()
    | {"gyro": SENSORS.gyro.model_dump() | {"bias_rad_s": (0.01, -0.02, 0.03)}}
    | {"accelerometer": SENSORS.accelerometer.model_dump() | {"bias_m_s2": (0.1, -0.2, 0.3)}}
    | {"barometer": SENSORS.barometer.model_dump() | {"bias_m": 0.5}}
)
LEANING = from_euler(0.1, -0.2, 0.3)
STATE = State(
    (1.0, 2.0, -30.0), (3.0, 0.0, 0.0), LEANING, (0.1, -0.2, 0.3), (0.5, 0.0, 0.0), (0.0, 0.0, -12.0), 30.0,
    (0.0, 0.0, 0.0), 4.0, False, False,
)  # fmt: skip


def sampled(count: int, noisy: bool = True, seed: int = 1) -> list[Measured]:
    stand = StationarySensors(BIASED, 0.004, seed, noisy, STATE, PULL)
    return [stand.sample() for _ in range(count)]


def test_bias_gravity_and_noise_are_those_of_the_flight() -> None:
    said = sampled(20_000)
    force = np.array([one.specific_force for one in said])
    level = np.array(rotate(conjugate(LEANING), (0.0, 0.0, -PULL)))
    assert force.mean(axis=0) == pytest.approx(level + np.array([0.1, -0.2, 0.3]), abs=2e-3)
    assert force.std(axis=0) == pytest.approx([BIASED.accelerometer.noise_m_s2] * 3, rel=0.03)
    assert np.mean([one.rate for one in said], axis=0) == pytest.approx((0.01, -0.02, 0.03), abs=1e-3)
    height = np.array([one.altitude for one in said])
    assert height.mean() == pytest.approx(30.5, abs=0.01)
    assert height.std() == pytest.approx(BIASED.barometer.noise_m, rel=0.03)
    off = [to_euler(multiply(conjugate(LEANING), one.attitude)) for one in said]
    assert np.std(off, axis=0) == pytest.approx([BIASED.attitude.noise_rad] * 3, rel=0.03)
    assert np.mean([one.velocity for one in said], axis=0) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)


def test_nothing_repeats_and_seeds_differ() -> None:
    said = sampled(500)
    for name in ("rate", "specific_force", "attitude", "altitude"):
        assert len({getattr(one, name) for one in said}) == 500, name
    assert len({one.position for one in said}) == 500 // BIASED.gnss.period_samples  # one a fix, the first of them late
    assert sampled(3) == sampled(3)
    assert sampled(3) != sampled(3, seed=2)


def test_without_noise_it_stands_exactly() -> None:
    (said,) = sampled(1, noisy=False)
    assert said.rate == (0.0, 0.0, 0.0)
    assert said.specific_force == pytest.approx(rotate(conjugate(LEANING), (0.0, 0.0, -PULL)))


@pytest.mark.parametrize(("latitude", "ground"), [(0.0, 0.0), (22.35, 0.0), (60.0, 0.0), (-45.0, 3000.0)])
def test_gravity_is_what_the_flight_feels(latitude: float, ground: float) -> None:
    """Specific force less the change of velocity over two seconds of JSBSim's motion, through its middle."""
    place = {"latitude_deg": latitude, "ground_m": ground}
    still = Scenario.load("hover").replace(controller="baseline", sensor_noise=False, environment=place)
    with build(still) as simulation:
        states = [simulation.state]
        for _ in range(500):
            simulation.step()
            states.append(simulation.state)
    down = np.array([rotate(one.attitude, one.specific_force)[2] for one in states])
    fallen = states[-1].velocity[2] - states[0].velocity[2]
    felt = fallen / (500 * simulation.dt) - (0.5 * (down[0] + down[-1]) + down[1:-1].sum()) / 500
    assert gravity(latitude, ground + 10.0) == pytest.approx(felt, abs=3e-4)
