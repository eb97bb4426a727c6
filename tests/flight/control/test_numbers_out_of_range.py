"""A vehicle, a gain or a speed beyond what a number holds is one line, and a failed flight: no traceback."""

from __future__ import annotations

import pytest
from packed_columns import unpack

from cosim import fly
from cosim.base.errors import FlightError, InputError
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.results.report.signals_data import pack
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

ALTITUDE = {"control": {"altitude": {"velocity_1_s": 1e308, "position_1_s": 1e200}}}
ROLL = {"control": {"rate": {"roll": {"p": 1e300}}}}


@pytest.mark.parametrize("name", ["trijet-roll-doublet", "quadjet-roll-doublet", "jetwing-roll-doublet"])
@pytest.mark.parametrize(
    ("vehicle", "initial"), [(ALTITUDE, {}), (ROLL, {"rate_deg_s": (1e20, 0.0, 0.0)})], ids=["lift", "moment"]
)
def test_a_flight_whose_allocation_is_not_finite_fails_in_one_line(
    name: str, vehicle: dict[str, object], initial: dict[str, object]
) -> None:
    flown = Scenario.load(name).replace(vehicle=vehicle, initial=initial, duration_s=1.0, expect=[], command=[])
    run = fly(flown)
    assert run.summary.outcome == "failed"
    assert "the allocation cannot be solved: wanted: " in run.summary.reason
    assert "\n" not in run.summary.reason


def test_the_recovery_after_an_engine_loss_says_it_too() -> None:
    flown = Scenario.load("trijet-roll-doublet").replace(expect=[], monitor=True)
    with build(flown) as simulation:
        allocator = simulation.controller.allocator  # type: ignore[attr-defined]
        assert isinstance(allocator, EffectivenessAllocator)
        with pytest.raises(FlightError, match="the allocation cannot be solved: wanted: nan is not a finite number"):
            allocator.allocate(0.5, (float("nan"), 0.0, 0.0))


def test_a_range_of_throttle_with_nothing_in_it_is_one_line() -> None:
    limits = {"throttle_min": 0.5, "throttle_max": 0.5000000000000001}
    empty = Scenario.load("trijet-roll-doublet").replace(vehicle={"control": {"allocation": limits}})
    with (
        pytest.raises(InputError, match=r"^trijet: .*control\.allocation: scales: must be greater than 0$"),
        build(empty),
    ):
        pass


def test_a_page_shows_a_column_whose_range_no_number_holds() -> None:
    import numpy as np

    values = np.array([-1.7e308, 0.0, 1.7e308, 5.0e307])
    packed = pack(values)
    assert packed is not None
    assert unpack(packed, 4) == pytest.approx(values, rel=1e-6, abs=1e301)


def test_a_speed_that_overflows_ends_the_flight() -> None:
    wind = {"kind": "wind", "start_s": 0.1, "velocity_ned_m_s": (1e155, 0.0, 0.0)}
    flown = Scenario.load("jetwing-hover").replace(duration_s=0.3, expect=[], command=[], disturbance=[wind])
    run = fly(flown)
    assert run.summary.outcome in ("failed", "diverged", "crashed")
