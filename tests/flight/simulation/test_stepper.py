"""A flight that a program steps is the flight that fly flies, and goes back to where it was, to the last bit."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import of_page

from cosim import Command, FlightError, InputError, Scenario, Snapshot, Stepper, fly
from cosim.base.signals import Sample
from cosim.results.log.digest import log_digest

ROUGH = {
    "environment": {"wind_ned_m_s": [2.0, -1.0, 0.0], "turbulence_severity": 4, "turbulence_wind_m_s": 6.0},
    "disturbance": [
        {"kind": "gust", "start_s": 0.4, "velocity_ned_m_s": [0.0, 3.0, 1.0], "rise_s": 0.5, "hold_s": 1.0, "fall_s": 0.5},
        {"kind": "payload", "start_s": 0.2, "mass_kg": 0.2, "offset_m": [0.02, 0.0, 0.1]},
    ],
    "fault": [
        {"kind": "slow_spool", "jet": 3, "lag_s": 0.05, "start_s": 0.5},
        {"kind": "sensor_bias", "sensor": "gyro", "bias": [0.01, 0.0, 0.0], "start_s": 2.2},
    ],
}  # fmt: skip
DOUBLET = Scenario.load("roll-doublet").replace(duration_s=4.0, expect=[])
TURBINE = Scenario.load("hover").replace(
    aircraft="hexjet-p220", engine="p220", controller="baseline", duration_s=4.0, expect=[]
)


class Integral:
    """A rate loop that remembers, in numpy and in a list."""

    level = "rate"
    columns = (("sum_roll", "rad", "body", "integral of the roll error"),)

    def reset(self) -> None:
        self.sums = np.zeros(3)
        self.seen: list[float] = []
        self.shown = (0.0,)

    def update(self, setpoint: Any, measured: Any, applied: Any) -> Any:
        self.sums += 0.004 * (np.array(setpoint) - measured)
        self.seen = [*self.seen[-5:], measured[0]]
        self.shown = (self.sums[0],)
        return 0.01 * (np.array(setpoint) - self.seen[0]) + 0.01 * self.sums


def nothing(flight: Stepper) -> Sample:
    return flight.step()


def leaning(flight: Stepper) -> Sample:
    return flight.step(Command((0.02 * np.sin(0.05 * flight.k), 0.01, 0.0), 10.0))


def by_hand(flight: Stepper) -> Sample:
    held = 0.45 + 0.01 * np.cos(0.1 * flight.k)
    return flight.step(throttle=[held] * 6, tilt=None if flight.k % 7 else (0.001, -0.001))


def flown(flight: Stepper, how: Callable[[Stepper], Sample], seconds: float) -> str:
    return repr([how(flight) for _ in range(round(seconds / flight.scenario.step_s))])


@pytest.mark.parametrize(
    ("scenario", "more", "how"),
    [
        (DOUBLET.replace(**ROUGH), {}, nothing),
        (DOUBLET, {}, leaning),
        (DOUBLET, {"controller": Integral()}, leaning),
        (DOUBLET, {"actuators": True}, by_hand),
        (TURBINE, {}, nothing),
        (Scenario.load("hover").replace(duration_s=4.0, initial={"on_ground": True}, expect=[]), {}, nothing),
    ],
    ids=["rough", "commands", "own controller", "actuators", "turbines with tank and spools", "on its legs"],
)
def test_two_seconds_one_and_that_one_again(scenario: Scenario, more: dict[str, Any], how: Any) -> None:
    share = 1.0 if scenario.fault else 0.2  # of the time: the rough flight has something to happen in all of it
    with Stepper(scenario, **more) as flight:
        flown(flight, how, 2.0 * share)
        here, log = flight.snapshot(), flight.run().log
        first = flown(flight, how, share)
        whole = flight.run().log
        measured = flight.restore(pickle.loads(pickle.dumps(here)))
        assert (flight.k, measured) == (here.k, flight.measured)
        assert flight.snapshot() == here
        assert flown(flight, how, share) == first
        again = flight.run().log
    # what came later is not in the first
    assert (here.k, len(log), len(whole)) == tuple(round(n * share / scenario.step_s) for n in (2.0, 2.0, 3.0))
    assert log_digest(whole) == log_digest(again)


def test_blocks_of_the_users_go_back_too_and_observers_see_each_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A wind over place, sensors with random numbers, a metric; an observer is of one flight, and closed after it."""
    file = of_page("blocks", tmp_path / "mine.py")
    lists = {"metrics": [f"{file}:Swing"], "observers": [f"{file}:Highest"]}
    scenario = DOUBLET.replace(wind=f"{file}:Shear", sensors=f"{file}:Drifting", **lists, duration_s=0.4)
    with Stepper(scenario) as flight:
        flown(flight, nothing, 0.1)
        here = flight.snapshot()
        first = flown(flight, leaning, 0.1)
        flight.restore(here)
        assert flown(flight, leaning, 0.1) == first
        assert flight.run().summary.own_metrics["own.swing_at_s"] is not None
        assert capsys.readouterr().out.count("highest at") == 1  # of the flight that was left
    assert capsys.readouterr().out.count("highest at") == 1
    reference = fly(scenario)
    with Stepper(scenario) as flight:
        while flight.ending is None:
            flight.step()
        run = flight.run()
    assert log_digest(run.log) == log_digest(reference.log)
    assert run.summary.own_metrics == reference.summary.own_metrics


def test_without_commands_it_is_the_flight_that_fly_flies() -> None:
    scenario = DOUBLET.replace(**ROUGH, duration_s=0.6)
    reference = fly(scenario)
    with Stepper(scenario) as flight:
        while flight.ending is None:
            asked, sample = flight.command, flight.step()
            assert asked == sample.command
        run = flight.run()
        with pytest.raises(FlightError, match=r"the flight is over \(completed: flew 150 steps\); reset or restore it"):
            flight.step()
        with pytest.raises(FlightError, match="is over"):
            flight.snapshot()
        assert flight.reset(seed=5) == flight.measured
        assert (flight.k, flight.scenario.seed, flight.ending) == (0, 5, None)
        other = flown(flight, nothing, 0.2)
        flight.reset(seed=0)
        assert flown(flight, nothing, 0.2) != other
    assert (run.outcome, run.reason, run.summary.by_hand) == ("completed", reference.reason, 0)
    assert log_digest(run.log) == log_digest(reference.log)


def test_a_flight_that_is_lost_ends_with_the_state_that_ended_it() -> None:
    lost = DOUBLET.replace(initial={"altitude_m": 10.0, "rate_deg_s": [900.0, 0.0, 0.0]})
    with Stepper(lost) as flight:
        while flight.ending is None:
            flight.step()
        run, reference = flight.run(), fly(lost)
    assert (run.outcome, run.reason) == ("diverged", reference.reason)
    assert reference.outcome == "diverged"
    assert run.log["roll_rad"].tobytes() == reference.log["roll_rad"].tobytes()


def test_a_run_says_what_was_given_by_hand() -> None:
    with Stepper("hover") as flight:
        flight.step()
        flight.step(Command((0.0, 0.0, 0.0), 11.0))
        run = flight.run()
    assert (run.summary.by_hand, len(run.log), run.summary.planned_s) == (1, 2, 0.008)
    assert run.summary.expectation is None
    assert "1 steps by hand" in run._repr_html_()
    with Stepper("hover", actuators=True, log=False) as flight:
        standing = flight.step().actuation.throttle  # those at which the engines stood
        assert flight.step(tilt=(0.01, 0.02)).actuation[:2] == (standing, (0.01, 0.02))
        assert flight.step(throttle=(0.5,) * 6).actuation[:2] == ((0.5,) * 6, (0.01, 0.02))
        with pytest.raises(InputError, match="nothing was recorded"):
            flight.run()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"command": (0.0, 0.0, 0.0)}, "command: tuple: must be a cosim.Command"),
        ({"command": Command((0.0, float("nan"), 0.0), 10.0)}, "command.attitude = .*must be 3 finite numbers"),
        ({"command": Command((0.0, 0.0, 0.0), 10.0, (0.0, 0.0), 0.5)}, "command.rate = .*must be 3"),  # type: ignore
        ({"throttle": [0.5] * 5}, "throttle = .*must be 6 finite numbers"),
        ({"tilt": (0.0, float("inf"))}, "tilt = .*must be 2 finite numbers"),
    ],
)
def test_what_cannot_be_given_is_one_line_and_ends_nothing(given: dict[str, Any], message: str) -> None:
    with Stepper("hover", actuators=True, log=False) as flight:
        with pytest.raises(InputError, match=message) as caught:
            flight.step(**given)
        assert "\n" not in str(caught.value)
        assert flight.step().k == 0


def test_what_is_no_place_of_this_flight_is_refused() -> None:
    with Stepper("hover", log=False) as flight:
        flight.step()
        here = flight.snapshot()
        with pytest.raises(InputError, match="a controller flies; Stepper"):
            flight.step(throttle=[0.5] * 6)
        said = "this flight does not repeat: at step 1 it is at another place than it was"
        with pytest.raises(FlightError, match=said):
            flight.restore(Snapshot(here.flight, here.seed, here.k, here.given, "0" * 64))
        flight.restore(here)  # a flight that failed can be restored
        assert flight.k == 1
    other = Stepper("hover", controller="baseline", log=False)
    with other, pytest.raises(InputError, match="is of another flight"):
        other.restore(here)
    with pytest.raises(InputError, match="so there is no controller to name"):
        Stepper("hover", controller="baseline", actuators=True)


def test_a_controller_that_does_not_forget_is_found_out_and_one_that_fails_ends_the_flight() -> None:
    class Forgetful(Integral):
        flights = 0

        def reset(self) -> None:
            super().reset()
            Forgetful.flights += 1
            self.sums = np.full(3, float(self.flights))

    class Failing(Integral):
        def update(self, setpoint: Any, measured: Any, applied: Any) -> Any:
            super().update(setpoint, measured, applied)
            return [float("nan")] * 3 if len(self.seen) > 4 else [0.0] * 3

    with Stepper("hover", controller=Forgetful, log=False) as flight:
        flown(flight, nothing, 0.1)
        here = flight.snapshot()
        with pytest.raises(FlightError, match="does not repeat"):
            flight.restore(here)
    with Stepper("hover", controller=Failing) as flight:
        said = r"Failing: the answer for roll = nan: must be finite at step 4 \(0.016 s\)"
        with pytest.raises(FlightError, match=said):
            flown(flight, nothing, 0.1)
        assert flight.ending is not None
        run = flight.run()
        assert (run.outcome, len(run.log)) == ("failed", 4)
        flight.reset()
        assert flight.step().k == 0


def test_an_autopilots_flight_is_not_stepped() -> None:
    with pytest.raises(InputError, match="requests: an autopilot flies it"):
        Stepper(Scenario.load("hover").replace(requests="requests.jsonl"))
    with Stepper("hover", log=False) as flight:
        flight.step()
        with pytest.raises(InputError, match="requests: an autopilot flies it"):
            flight.reset(scenario=Scenario.load("hover").replace(requests="requests.jsonl"))
        assert flight.step().k == 1
