"""Signals that a block shows of its own become columns: of the log, of CSV and ULog, and on the page, with their meaning."""

from __future__ import annotations

from math import isnan, sin
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from pyulog import ULog

from cosim.base.errors import InputError
from cosim.base.protocols import Column, EngineState
from cosim.base.signals import Actuation, Command, Disturbance, Measured
from cosim.flight import record
from cosim.results import metrics
from cosim.results.export import export_log
from cosim.results.log.columns import NAMES, log_columns
from cosim.results.log.digest import DigestSink, log_digest
from cosim.results.report.flight import write_report
from cosim.results.run import LOG, Run, open_run
from cosim.simulation.build import build
from cosim.simulation.controllers import built_in as wiring
from cosim.simulation.ending import Ending
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Scenario

HOVER = Scenario.load("roll-doublet").replace(duration_s=0.6, expect=[])
SURFACE = Column("sliding_surface_rad_s", "rad/s", "body", "rate of roll, and three times its angle")
GAIN = Column("switching_gain", "1", "", "how hard it switches")


class Delegate:
    """Hands everything on to another block."""

    def __init__(self, block: Any) -> None:
        self._block = block

    def __getattr__(self, name: str) -> Any:
        return getattr(self._block, name)


class Sliding(Delegate):
    """A controller that flies as the one inside, and shows two signals of its own."""

    columns = (SURFACE, GAIN)
    shown: tuple[float, ...] = (0.0, 0.0)

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        self.shown = (measured.rate[0] + 3.0 * 2.0 * measured.attitude[1], sin(measured.altitude))
        answer: Actuation = self._block.update(command, measured, injected, engines)
        return answer


class Estimating(Delegate):
    """A predictor that shows its innovation."""

    columns = (Column("innovation_rad_s", "rad/s", "body", "measured rate less the predicted one"),)
    shown: tuple[float, ...] = (0.0,)

    def update(self, measured: float, applied: float) -> float:
        answer: float = self._block.update(measured, applied)
        self.shown = (measured - answer,)
        return answer


def flown(simulation: Simulation, folder: Path | None = None, sink: DigestSink | None = None) -> Run:
    simulation.reset()
    recording = record(simulation, folder, sink=sink)
    ending: Ending = simulation.run([recording])
    return recording.finish(ending.outcome, ending.reason)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "sliding"
    with build(HOVER) as simulation:
        simulation.controller = Sliding(simulation.controller)
        run = flown(simulation, folder)
        assert run.outcome == "completed", run.reason
    return folder


def test_the_log_has_them_last_with_what_they_mean(folder: Path) -> None:
    run = open_run(folder)
    assert run.log.columns == (*NAMES, SURFACE.name, GAIN.name)
    found = {field.name: field.metadata for field in pq.read_schema(folder / LOG)}
    for column in (SURFACE, GAIN):
        said = {"unit": column.unit, "frame": column.frame, "meaning": column.meaning}
        assert found[column.name] == {key.encode(): value.encode() for key, value in said.items()}
    # the values are those of the same step as the rest of the row
    roll = 2.0 * np.sin(0.5 * run.log["roll_measured_rad"])
    expected = run.log["rate_p_measured_rad_s"] + 3.0 * roll
    np.testing.assert_allclose(run.log[SURFACE.name], expected, atol=1e-3)  # pitch and yaw are small
    np.testing.assert_array_equal(run.log[GAIN.name], [sin(h) for h in run.log["altitude_measured_m"].tolist()])


def test_so_have_csv_ulog_and_page(folder: Path, tmp_path: Path) -> None:
    log = open_run(folder).log
    export_log("csv", folder, tmp_path / "flight.csv")
    assert (tmp_path / "flight.csv").read_text().splitlines()[0].endswith(f",{SURFACE.name},{GAIN.name}")
    export_log("ulog", folder, tmp_path / "flight.ulg")
    ulog = ULog(str(tmp_path / "flight.ulg"))
    data = ulog.get_dataset("hexjet_own").data
    for column in (SURFACE, GAIN):
        np.testing.assert_array_equal(data[column.name], log[column.name].astype(np.float32))
    assert ulog.msg_info_dict[f"hexjet_own_{SURFACE.name}"] == f"[rad/s] body: {SURFACE.meaning}"
    assert ulog.msg_info_dict[f"hexjet_own_{GAIN.name}"] == f"[1] {GAIN.meaning}"
    write_report(open_run(folder), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for column in (SURFACE, GAIN):
        assert f"<code>{column.name}</code>" in page
        assert column.meaning in page


def test_showing_changes_nothing_else_and_a_flight_that_shows_nothing_has_no_more_columns(folder: Path) -> None:
    with build(HOVER) as simulation:
        plain = flown(simulation).log
    assert plain.columns == NAMES
    log = open_run(folder).log
    assert all(plain[name].tobytes() == log[name].tobytes() for name in NAMES)


def test_the_digest_of_a_flight_covers_them(folder: Path) -> None:
    sink = DigestSink(metrics.columns())
    with build(HOVER) as simulation:
        simulation.controller = Sliding(simulation.controller)
        flown(simulation, sink=sink)
    assert sink.hexdigest() == log_digest(open_run(folder).log)


def test_predictors_show_through_the_cascade_under_their_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    built_in = wiring.make_predictors
    monkeypatch.setattr(wiring, "make_predictors", lambda *told: [Estimating(p) for p in built_in(*told)])
    with build(HOVER) as simulation:
        log = flown(simulation).log
        columns = [f"{axis}_innovation_rad_s" for axis in ("roll", "pitch", "yaw")]
        assert log.columns[len(NAMES) :] == tuple(columns)
        for column, rate in zip(columns, "pqr", strict=True):
            expected = log[f"rate_{rate}_measured_rad_s"] - log[f"rate_{rate}_predicted_rad_s"]
            np.testing.assert_array_equal(log[column], expected)
        # of a predictor whose place another takes in flight nothing is known from there on
        simulation.reset()
        gains = simulation.vehicle.control.rate
        rates = (gains.roll, gains.pitch, gains.yaw)
        simulation.cascade.rate.retune(rates, built_in(HOVER, simulation.vehicle, simulation.engine))
        assert all(isnan(value) for value in simulation.step().own)


@pytest.mark.parametrize(
    ("column", "complaint"),
    [
        (SURFACE._replace(name="roll_rad"), "column 'roll_rad': the log has one of that name already"),
        (SURFACE._replace(name="a b"), "column 'a b': a column's name is of letters, digits and _"),
        (SURFACE._replace(name="1st"), "no digit first"),
        (SURFACE._replace(name="größe"), "letters, digits and _"),
        (SURFACE._replace(meaning=""), "column 'sliding_surface_rad_s': what does it mean"),
    ],
)
def test_a_column_that_cannot_be_one_is_refused(column: Column, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        log_columns(custom=[column])
    with pytest.raises(InputError, match="the log has one of that name already"):
        log_columns(custom=[GAIN, GAIN])


def test_a_block_that_shows_less_than_it_said_ends_the_flight() -> None:
    class Short(Sliding):
        def update(self, *told: Any) -> Actuation:
            answer: Actuation = self._block.update(*told)
            self.shown = (0.0,)
            return answer

    with build(HOVER) as simulation:
        simulation.controller = Short(simulation.controller)
        run = flown(simulation)
    assert run.outcome == "failed"
    assert "Short shows 1 numbers for 2 columns" in run.reason
