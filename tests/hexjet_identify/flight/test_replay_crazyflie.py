"""Two flights of a real vehicle flown again by a model from published numbers (aircraft/crazyflie/README.md)."""

from pathlib import Path

import numpy as np
import pytest

from cosim import Scenario
from cosim.base.errors import InputError
from cosim.engine import load_engine
from cosim.spec.vehicle import engine_of, load_vehicle
from hexjet_identify.logs import read_flight_log
from hexjet_identify.replay import Choices, Replay, ThrottleChannels, record_flight, replay
from hexjet_identify.replay.flown import Model
from hexjet_identify.replay.replay import NOT_EXPLAINED, draw_vehicles

DATA = Path(__file__).parents[4] / "shared" / "data" / "flight-logs"
ENGINE = engine_of("crazyflie")
HOVER = Scenario.load("hover").replace(aircraft="crazyflie", engine=ENGINE, controller="baseline", expect=[])
VEHICLE, _ = load_vehicle("crazyflie")


def flown_again(number: int, begin: float, end: float) -> Replay:
    path = DATA / f"crazyflie-log{number}.cfusdlog"
    if not path.is_file():
        pytest.skip("the shared flight logs are not here")
    flight = record_flight(read_flight_log(path), VEHICLE, HOVER.step_s, ThrottleChannels(), (begin, end))
    return replay(path.name, HOVER, flight, Choices(draws=3))


def test_the_real_flights_are_not_explained_and_no_fault_is_made_up() -> None:
    """What the model has is told: the quick part of the rates is coherent, and the vertical force follows the commands."""
    result = flown_again(10, 44.0, 56.0)
    assert result.verdict == NOT_EXPLAINED
    assert not result.causes.named
    assert result.causes.reason
    bands = {channel.name: channel.bands for channel in result.channels}
    # From 6 to 16 Hz it turns more than the model, as the article's inertia and levers say.
    for rate in ("rate_p", "rate_q"):
        quick = bands[rate][1]
        assert quick.coherence > 0.8
        assert quick.gain_db is not None
        assert 1.0 < quick.gain_db < 6.0
    assert bands["specific_force_z"][0].coherence > 0.9
    assert set(bands) == {*(f"rate_{rate}" for rate in "pqr"), *(f"specific_force_{axis}" for axis in "xyz")}
    assert any("windows start level" in note for note in result.notes)
    assert any("0 is taken for throttle 0 and 65535 for 1" in note for note in result.notes)


def test_axes_and_motors_are_the_right_way_round() -> None:
    """With any axis reversed or any two motors swapped the model is further from the flight."""
    result = flown_again(16, 33.0, 38.5)
    exchanges = [one for one in result.causes.tried if not one.parts]
    assert all(one.removed <= 0.0 for one in exchanges)


def test_at_rest_there_is_nothing_to_fly() -> None:
    with pytest.raises(InputError, match="in which the engines carry the vehicle"):
        flown_again(10, 70.0, 75.0)


def test_draws_follow_the_uncertainty_of_the_engine() -> None:
    model = Model(HOVER)
    model.engine = load_engine(str(ENGINE), {}, HOVER.step_s)
    changes = list(draw_vehicles(model, Choices(draws=400)))
    gains, lags = (np.array([change.parameters[name] for change in changes]) for name in ("gain", "lag"))
    assert np.std(gains) == pytest.approx(0.0126, rel=0.15)
    assert np.std(lags) == pytest.approx(0.03, rel=0.15)
    assert {change.thrust for change in changes} == {1.0}
    assert np.std([change.inertia[0] for change in changes]) == pytest.approx(0.05, rel=0.15)
