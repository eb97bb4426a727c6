"""A place of a list may be written alone, whether the list is stated or has its default."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim.base.errors import InputError
from cosim.spec.scenario import Scenario

HERE = Path()


def scenario(**changes: Any) -> Scenario:
    return Scenario.from_table({"name": "places", "duration_s": 1.0, **changes}, HERE, "places")


def test_a_place_is_written_over_the_default() -> None:
    assert scenario(environment={"wind_ned_m_s": {"1": 3.0}}).environment.wind_ned_m_s == (0.0, 3.0, 0.0)
    vehicle, _ = scenario(vehicle={"products_kg_m2": {"1": 0.001}}).resolved_vehicle()
    assert vehicle.products_kg_m2 == (0.0, 0.001, 0.0)


def test_a_place_is_written_over_what_is_stated() -> None:
    stated, _ = scenario().resolved_vehicle()
    vehicle, _ = scenario(vehicle={"inertia_kg_m2": {"2": 0.06}}).resolved_vehicle()
    assert vehicle.inertia_kg_m2 == (*stated.inertia_kg_m2[:2], 0.06)


@pytest.mark.parametrize("table", [{"3": 1.0}, {"x": 1.0}, {"0": 1.0, "north": 2.0}])
def test_a_place_that_there_is_not_is_refused(table: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"^places: environment\.wind_ned_m_s"):
        scenario(environment={"wind_ned_m_s": table})


def test_a_place_is_a_number() -> None:
    with pytest.raises(InputError, match=r"wind_ned_m_s = True: must be a number"):
        scenario(environment={"wind_ned_m_s": {"1": True}})
