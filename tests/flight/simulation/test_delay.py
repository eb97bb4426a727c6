"""A delay holds every command that it is stated for, by as many steps as stated, and the command alone.

Three faults of delayed actuators that other simulators had: a buffer that holds one of several commands, one that is
pushed twice a step, and a delay of the force in the place of the command.
"""

from __future__ import annotations

from math import pi

import pytest

from cosim import Scenario, Stepper

HOVER = Scenario.load("hover").replace(sensor_noise=False, duration_s=1.0, expect=[])
JETS = 6
STATED = 7  # samples


def thrust_after_a_step(added: int, jet: int) -> list[float]:
    """The thrust of a jet, step by step from the one in which its throttle alone rises."""
    with Stepper(HOVER.replace(mismatch={"delay_samples": added}), actuators=True, log=False) as flight:
        standing = flight.step().actuation.throttle
        raised = tuple(each + 0.05 * (n == jet) for n, each in enumerate(standing))
        rows = [flight.step(throttle=raised).thrust for _ in range(60)]
    assert all(row[other] == rows[0][other] for row in rows for other in range(JETS) if other != jet)
    return [row[jet] for row in rows]


@pytest.mark.parametrize("jet", range(JETS))
def test_every_engine_is_later_by_the_samples_that_are_stated(jet: int) -> None:
    """Neither by half of them nor by none, and otherwise the same to the last bit."""
    prompt, late = thrust_after_a_step(0, jet), thrust_after_a_step(STATED, jet)
    assert prompt[-1] > prompt[0]
    assert late[:STATED] == prompt[:1] * STATED
    assert late[STATED:] == prompt[:-STATED]


def motion_after_a_tilt(added: int) -> list[tuple[float, float, float]]:
    """The rates while the banks tilt and throttles stand."""
    with Stepper(HOVER.replace(mismatch={"delay_samples": added}), actuators=True, log=False) as flight:
        flight.step()
        return [flight.step(tilt=(pi / 60, -pi / 90)).state.rate for _ in range(40)]


def test_the_delay_is_of_the_command_and_not_of_the_force() -> None:
    """A thrust that stands turns with its jet at once, however late the engine answers its throttle."""
    moved = motion_after_a_tilt(25)
    assert moved == motion_after_a_tilt(0)
    assert abs(moved[-1][2]) > 0.01


@pytest.mark.parametrize("signal", ["roll_deg", "pitch_deg", "yaw_deg"])
def test_the_added_delay_is_of_the_roll_command_alone(signal: str) -> None:
    """By as many steps as stated; pitch and yaw, which tilts answer, are as before."""
    begins = []
    for added in (0, STATED):
        step = {"kind": "step", "signal": signal, "start_s": 0.1, "amplitude": 2.0}
        scenario = HOVER.replace(command=[step], added_delay_samples=added, controller="baseline")
        with Stepper(scenario, log=False) as flight:
            given = [flight.step().actuation for _ in range(80)]
        moved = [
            max(each.throttle) - min(each.throttle) if signal == "roll_deg" else abs(each.tilt[0]) for each in given
        ]
        begins.append(next(k for k, size in enumerate(moved) if size > moved[0] + 1e-3))
    assert begins[1] - begins[0] == (STATED if signal == "roll_deg" else 0)
