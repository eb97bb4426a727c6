"""A flight that was recorded flown again: the vehicle that flew explains it, and what is wrong with another is named (docs/replay.md)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stated_figures import stated

from cosim import Scenario, fly
from cosim.identify.logs import read_flight_log
from cosim.identify.replay import Choices, RecordedFlight, Replay, ThrottleChannels, record_flight
from cosim.identify.replay import replay as fly_again
from cosim.identify.replay.recorded import SLOWEST_COMMAND_S
from cosim.identify.replay.replay import EXPLAINED, NEEDED, NOT_EXPLAINED, NOT_TOLD
from cosim.results.export.csv_file import export_csv
from cosim.results.export.parquet import export_parquet
from cosim.results.export.ulog import export_ulog

FEW = Choices(draws=4)
DOUBLET = Scenario.load("roll-doublet").replace(duration_s=7.0, expect=[])
HEAVY = {"vehicle": {"inertia_kg_m2": [0.054042, 0.0676, 0.091]}}  # 1.3 times as stated, about every axis
LATE = {"engine_parameters": {"delay_samples": 30}}  # 5 control steps of 4 ms more


@pytest.fixture(scope="module")
def doublet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a roll doublet."""
    folder = tmp_path_factory.mktemp("runs") / "doublet"
    fly(DOUBLET, folder)
    return folder


def recorded(path: Path, scenario: Scenario = DOUBLET) -> RecordedFlight:
    vehicle, _ = scenario.resolved_vehicle()
    return record_flight(read_flight_log(path), vehicle, scenario.step_s, ThrottleChannels(), (None, None))


def replayed(flight: RecordedFlight, scenario: Scenario = DOUBLET) -> Replay:
    return fly_again("flight", scenario, flight, FEW)


@pytest.mark.parametrize("form", ["run", "csv", "parquet", "ulog"])
def test_the_vehicle_that_flew_explains_its_log_in_every_format(doublet: Path, tmp_path: Path, form: str) -> None:
    path = doublet
    if form != "run":
        path = tmp_path / f"flight.{form}"
        {"csv": export_csv, "parquet": export_parquet, "ulog": export_ulog}[form](doublet, path)
    result = replayed(recorded(path))
    assert result.verdict == EXPLAINED
    assert not result.fault
    roll = next(channel for channel in result.channels if channel.name == "rate_p")
    assert roll.excited
    assert roll.theil.u < 0.02
    assert roll.rms < 1.2 * roll.noise
    assert roll.bands[0].coherence > 0.99
    assert abs(roll.bands[0].gain_db or 9.0) < 0.1


@pytest.mark.parametrize(
    ("flown", "name", "value", "near"),
    [
        (HEAVY, "moment of inertia about x", 1.3, 0.03),
        (LATE, "all engines and servos later by", 0.02, 0.001),
    ],
)
def test_a_number_that_is_wrong_is_named_with_its_value(
    tmp_path: Path, flown: dict[str, object], name: str, value: float, near: float
) -> None:
    """What flew is another vehicle than the one that flies again."""
    fly(DOUBLET.replace(**flown), tmp_path / "run")
    result = replayed(recorded(tmp_path / "run"))
    assert result.verdict == NOT_EXPLAINED
    (named,) = result.causes.named
    assert named.name == name
    assert named.value == pytest.approx(value, abs=near)
    assert named.bound is not None
    assert named.bound < near


def test_swapped_engines_are_named(doublet: Path) -> None:
    flight = recorded(doublet)
    result = replayed(replace(flight, throttle=flight.throttle[:, [1, 0, 2, 3, 4, 5]]))
    assert result.verdict == NOT_EXPLAINED
    assert [one.name for one in result.causes.named] == ["engines 1 and 2 swapped"]


def test_a_reversed_axis_is_named(doublet: Path) -> None:
    flight = recorded(doublet)
    turned = np.array([-1.0, 1.0, 1.0])
    result = replayed(replace(flight, rate=flight.rate * turned, angles=flight.angles * turned))
    assert [one.name for one in result.causes.named] == ["roll rate reversed"]


def test_the_page_has_the_numbers_of_the_code() -> None:
    page, usual = "docs/replay.md", Choices()
    stated(page, "the command of every engine, every {} ms or faster", 1e3 * SLOWEST_COMMAND_S)
    stated(
        page, "moments of inertia ({} %, standard deviation), mass ({} %)", 100.0 * usual.inertia, 100.0 * usual.mass
    )
    stated(page, "or else their thrust ({} %).", 100.0 * usual.thrust)
    stated(page, "A channel that is within it for {} % of the time is explained", 100.0 * NEEDED)
    stated(page, "the number stands with its {} % bounds", 95.0)


def test_a_hover_tells_nothing_and_nothing_is_named(tmp_path: Path) -> None:
    hover = Scenario.load("hover").replace(duration_s=5.0, expect=[])
    fly(hover.replace(**HEAVY), tmp_path / "run")
    result = replayed(recorded(tmp_path / "run", hover), hover)
    assert result.verdict == NOT_TOLD
    assert not result.causes.named
    assert not result.fault
    assert any(line.startswith("not told") for line in result.evidence)
