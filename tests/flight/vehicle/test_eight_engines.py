"""More engines than six: faults, log, metrics, figures, export and the ground station's words follow the vehicle."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from cosim import fly
from cosim.base.errors import InputError
from cosim.base.signals import MAX_JETS
from cosim.base.storage.paths import data_folder
from cosim.campaign.study.keys import find_key
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.flight_row import fly_one
from cosim.results.events import list_events
from cosim.results.export import export_log
from cosim.results.metrics import activity, fuel_burnt
from cosim.results.report.flight_figures import run_figures
from cosim.results.report.panels import jet_rows
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import files as vehicle_files
from hexjet_prove.surveys.survey import measure_flight

JETS = [  # on a circle, every other one turning the other way
    {"position_m": [0.11 * cos(at), 0.11 * sin(at), -0.02], "reaction_m": 0.012 * way, "spin": way}
    for at, way in (((2 * n + 1) * pi / 8, 1 if n % 2 else -1) for n in range(8))
]


@pytest.fixture(scope="module", autouse=True)
def hangar(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The quadrotor's folder as that of a vehicle whose JSBSim model has eight engines."""
    home = tmp_path_factory.mktemp("home")
    folder = home / "aircraft" / "octorotor"
    folder.mkdir(parents=True)
    own = data_folder("aircraft") / "quadrotor"
    fourth = re.search(r' *<force name="jet4".*?</force>\n', (own / "quadrotor.xml").read_text(), re.DOTALL)
    assert fourth is not None
    more = "".join(fourth[0].replace("jet4", f"jet{n}") for n in range(4, 9))
    (folder / "octorotor.xml").write_text((own / "quadrotor.xml").read_text().replace(fourth[0], more))
    text = (own / "vehicle.toml").read_text()
    (folder / "vehicle.toml").write_text(
        text.replace('"quadrotor"', '"octorotor"').replace("quadrotor.xml", "octorotor.xml")
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vehicle_files, "data_folder", lambda name: home / name)
        patch.setattr(vehicle_files, "aircraft_names", lambda: ["octorotor"])
        yield


def octorotor(**changes: object) -> Scenario:
    base = Scenario.read("hover")
    return base.replace(
        **{"aircraft": "octorotor", "engine": "motor", "controller": "baseline", "step_s": 0.0025, "duration_s": 0.5,
           "expect": [], "vehicle": {"jets": JETS, "mass_kg": 1.1, "control": {"monitor": {"catch": False}}}, **changes}
    )  # fmt: skip


FAULTS = [{"kind": "thrust_loss", "jet": 8, "share": 0.3, "start_s": 0.2, "duration_s": 0.1},
          {"kind": "sensor_bias", "sensor": "barometer", "bias": [0.2], "start_s": 0.3}]  # fmt: skip


class Columns(dict[str, np.ndarray]):
    """A log in memory."""

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(self)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return fly(octorotor(fault=FAULTS), tmp_path_factory.mktemp("runs") / "eight")


def test_it_flies_and_logs_all_of_them(run: Run) -> None:
    assert run.outcome == "completed", run.reason
    thrust = sum(run.log[f"thrust_{jet}_N"] for jet in range(1, 9))
    assert thrust[:40] == pytest.approx(1.1 * 9.80665, rel=0.02)
    assert np.all(np.isfinite(run.log["health_8"]))


def test_a_fault_is_flagged_where_it_acts(run: Run) -> None:
    time = run.log["time_s"]
    late = (time > 0.2 - 1e-6) & (time < 0.3 - 1e-6)
    assert np.array_equal(run.log["fault_jet_8"], late.astype(float))
    assert np.array_equal(run.log["fault_barometer"], (time > 0.3 - 1e-6).astype(float))
    for other in (*(f"fault_jet_{jet}" for jet in range(1, 8)), "fault_servo_left", "fault_gyro", "fault_gnss"):
        assert not np.any(run.log[other]), other
    assert any(event.text == "jet 8: 30 % of the thrust lost" for event in list_events(run))


def test_a_survey_of_faults_hears_of_the_last_of_them(run: Run) -> None:
    log = {name: run.log[name] for name in run.log.columns}
    assert np.min(log["health_8"]) < 1.0  # the monitor sees that 30 % are missing
    log["health_8"] = np.ones_like(log["health_8"])
    assert measure_flight(Columns(log), 80)[2] is None
    log["health_8"] = np.where(run.log["time_s"] > 0.25, 0.0, 1.0)
    assert measure_flight(Columns(log), 80)[2] == np.flatnonzero(run.log["time_s"] > 0.25)[0]


def test_metrics_are_of_all_of_them(run: Run) -> None:
    log, step = run.log, run.summary.step_s
    flat = run.summary.flat_metrics
    every = activity([log[f"throttle_{jet}"] for jet in range(1, 9)], step)
    assert flat["effort.throttle_1_s"] == every != activity([log[f"throttle_{jet}"] for jet in range(1, 7)], step)
    assert flat["fuel_burnt_kg"] == fuel_burnt(
        log["fuel_kg"], [log[f"fuel_flow_{jet}_kg_s"] for jet in range(1, 9)], step
    )


def test_a_studys_row_is_the_same_flight(run: Run) -> None:
    """The columns that a row's metrics are made from are those of this vehicle."""
    folder = run.folder
    assert folder is not None
    study = open_study(folder / "scenario.toml", vary=["sensor_noise=true,false"])
    row = fly_one(study, next(flight for flight in flights(study) if flight.values["sensor_noise"]))
    assert row["outcome"] == "completed", row["reason"]
    assert isinstance(row["effort.throttle_1_s"], float)
    again = fly(Scenario.load(folder / "scenario.toml").replace(seed=row["seed"]), report=False)
    assert row["effort.throttle_1_s"] == again.summary.flat_metrics["effort.throttle_1_s"]


def test_files_and_figures_have_all_of_them(run: Run, tmp_path: Path) -> None:
    folder = run.folder
    assert folder is not None
    export_log("csv", folder, tmp_path / "log.csv")
    with (tmp_path / "log.csv").open() as file:
        assert {"throttle_8", "fault_jet_8", "thrust_8_N"} <= set(next(csv.reader(file)))
    export_log("ulog", folder, tmp_path / "log.ulg")
    topics = {topic.name: topic.data for topic in ULog(str(tmp_path / "log.ulg")).data_list}
    assert "hexjet_own" not in topics
    for n in range(8):
        thrust = run.log[f"thrust_{n + 1}_N"].astype(np.float32)
        assert np.array_equal(topics["hexjet_thrust"][f"newton[{n}]"], thrust)
        throttle = run.log[f"throttle_{n + 1}"].astype(np.float32)
        assert np.array_equal(topics["actuator_motors"][f"control[{n}]"], throttle)
        assert np.array_equal(topics["hexjet_fault"][f"jet[{n}]"], run.log[f"fault_jet_{n + 1}"])
    assert np.all(np.isnan(topics["actuator_motors"]["control[8]"]))
    figures = run_figures(run.log, run.summary)
    assert "own" not in figures
    assert {panel["title"] for panel in figures["thrust"]["panels"]} == {f"Jet {n}" for n in range(1, 9)}


def test_an_odd_number_is_drawn_in_pairs() -> None:
    assert jet_rows([(0.0, 1.0, 0.0)] * 7) == ((1, 2), (3, 4), (5, 6), (7,))


def test_what_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match=r"jet = 9.*jets 1 to 8"):
        build(octorotor(fault=[{"kind": "flame_out", "jet": 9, "start_s": 0.1}]))
    with pytest.raises(InputError, match=r"stations.9: octorotor has stations 1 to 8"):
        build(octorotor(stations={"9": {"engine": "motor"}}))
    with pytest.raises(InputError, match="station is the number of a jet"):
        octorotor(stations={str(MAX_JETS + 1): {"engine": "motor"}})
    with pytest.raises(InputError, match="jets"):
        octorotor(vehicle={"jets": [JETS[0]] * (MAX_JETS + 1)}).resolved_vehicle()
    assert find_key(octorotor(fault=FAULTS), "fault.0.jet.0").high == 8.0
