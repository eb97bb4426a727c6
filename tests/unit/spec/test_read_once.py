"""What a file states is checked when it is read, and once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from cosim import fly
from cosim.base.errors import InputError
from cosim.base.storage import toml
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.flight_row import fly_one
from cosim.results.run import open_run
from cosim.spec.scenario import Scenario
from cosim.spec.scenario import scenario as scenario_file
from cosim.spec.vehicle import files as vehicle_files


def test_a_wrong_vehicle_key_is_found_when_the_scenario_is_read(tmp_path: Path) -> None:
    stated = 'name = "x"\nduration_s = 1.0\n[vehicle]\n{}\n'
    path = tmp_path / "x.toml"
    for line, words in (("mas_kg = 5.0", "mas_kg"), ("mass_kg = -1.0", "mass_kg"), ('mass_kg = "5"', "mass_kg")):
        path.write_text(stated.format(line))
        with pytest.raises(InputError, match=f"scenario x: vehicle.*{words}"):
            Scenario.load(path)
    path.write_text('name = "x"\nduration_s = 1.0\naircraft = "nobody"\n')
    with pytest.raises(InputError, match="unknown aircraft 'nobody'"):
        Scenario.load(path)
    path.write_text(stated.format("mass_kg = 5.0"))
    assert Scenario.load(path).resolved_vehicle()[0].mass_kg == 5.0


def test_a_copy_has_the_vehicle_that_it_states() -> None:
    hover = Scenario.load("hover")
    assert hover.resolved_vehicle()[0].name == "hexjet"
    assert hover.model_copy(update={"aircraft": "quadrotor"}).resolved_vehicle()[0].name == "quadrotor"
    assert hover.model_copy(update={"vehicle": {"mass_kg": 5.0}}).resolved_vehicle()[0].mass_kg == 5.0
    assert hover.model_copy(update={"seed": 2}).resolved_vehicle() is hover.resolved_vehicle()


def test_a_run_of_an_older_vehicle_can_be_read(tmp_path: Path) -> None:
    """What a vehicle no longer has is no reason not to open the run; it cannot be flown again and says why."""
    fly(Scenario.load("hover").replace(duration_s=0.02, expect=[]), tmp_path / "run", report=False)
    file = tmp_path / "run" / "scenario.toml"
    file.write_text(file.read_text().replace("[vehicle]\n", "[vehicle]\nlong_gone = 1.0\n"))
    assert open_run(tmp_path / "run").scenario.vehicle["long_gone"] == 1.0
    with pytest.raises(InputError, match="long_gone"):
        Scenario.load(file)


def test_a_studys_key_is_checked_once_a_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    study = open_study("hover", vary=["vehicle.mass_kg=5:5.5", "environment.wind_ned_m_s.0=0:1"], runs=2,
                       settings=["duration_s=0.02"])  # fmt: skip
    checked: Counter[str] = Counter()

    def counting(model: type[BaseModel], data: Any, where: str) -> Any:
        checked[model.__name__] += 1
        return toml.validate(model, data, where)

    for module in (scenario_file, vehicle_files):
        monkeypatch.setattr(module, "validate", counting)
    row = fly_one(study, flights(study)[0])
    assert row["outcome"] == "completed", row["reason"]
    assert checked == {"Scenario": 1, "Vehicle": 1}
