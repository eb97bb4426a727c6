"""Flights in which a failsafe acts, to the ground; and the same flights again, bit for bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pilot_flights import Asked

from cosim import fly
from cosim.base.storage.toml import toml_text
from cosim.control.autopilot import requests as rq
from cosim.results.autopilot.request_log import Entry
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.log.digest import DigestSink, log_digest
from cosim.results.log.recorder import Recorder
from cosim.results.run import Run
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from hexjet_prove.surveys import failsafes as table
from hexjet_prove.surveys.survey import load_subject


def again(scenario: Path, digest: str) -> Run:
    """Fly what a file states, and hold every number of every sample against the flight of before."""
    run = fly(Scenario.load(str(scenario)))
    assert "otherwise" not in run.reason
    assert log_digest(run.log) == digest
    return run


class Flight(Asked):
    """A hover in still air over the ground, with an autopilot that is asked things.

    ``recorded``: it can be flown :meth:`again`, where nothing but :meth:`fly` steps it.
    """

    def __init__(
        self, aircraft: str = "hexjet", height: float = 3.0, *, recorded: bool = False, **changes: Any
    ) -> None:
        subject = load_subject(aircraft)
        scenario = table.scenario_of(subject, table.default_controller(subject), height, 0.0).replace(**changes)
        self.simulation = build(scenario)
        self.pilot = attach_autopilot(self.simulation, airborne=not scenario.initial.on_ground)
        self._entries: list[Entry] = []
        self._digest: DigestSink | None = None
        if recorded:
            self._digest = DigestSink(())
            columns = log_columns(logged_vehicle(self.simulation.vehicle), self.simulation.columns)
            self._digest.begin(columns)
            self._recorder = Recorder(self.simulation.dt, self._digest, columns)
        self.ok(rq.SetParameter("SYS_FAILURE_EN", 1.0))

    def ask(self, request: Any) -> rq.Answer:
        self._entries.append(Entry(self.simulation.k, "test", request, ""))
        return super().ask(request)

    def fly(self, seconds: float, until: Any = None) -> float:
        """Step on; the thrust of the last step, N."""
        thrust = 0.0
        for _ in range(round(seconds / self.simulation.dt)):
            self.sample = self.simulation.step()
            if self._digest is not None:
                self._recorder.observe(self.sample)
            thrust = sum(self.sample.engines.thrust)
            assert self.simulation.termination.check(self.simulation.state, 0.0) is None
            if until is not None and until():
                return thrust
        assert until is None, f"not within {seconds} s: {self.pilot.status}"
        return thrust

    def again(self, folder: Path) -> Run:
        """The flight so far as a scenario with its requests, flown again bit for bit."""
        assert self._digest is not None
        self._recorder.flush()
        simulation = self.simulation
        scenario = simulation.scenario.replace(fault=[], duration_s=round(simulation.k * simulation.dt, 9))
        lines = [{"step": entry.step, "sender": entry.sender} | rq.to_dict(entry.request) for entry in self._entries]
        (folder / "again.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
        stated = scenario.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        (folder / "again.toml").write_text(toml_text(stated | {"requests": "again.jsonl"}), encoding="utf-8")
        return again(folder / "again.toml", self._digest.hexdigest())
