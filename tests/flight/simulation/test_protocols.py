"""What is written against a protocol flies: a controller, a predictor, an allocator, sensors, engines and wind of one's own.

That the built-in blocks fit theirs is proved by mypy, which reads ``conformance.py``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from math import isnan, nan
from typing import Any

import pytest
from places import ROOT

import cosim.engine.isolated
import cosim.simulation.build
from cosim.base.errors import InputError
from cosim.base.protocols import Diagnostics, EngineState
from cosim.base.signals import (
    ALL_HEALTHY,
    UNKNOWN3,
    Actuation,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    PerJet,
    Sample,
    State,
    Unallocated,
)
from cosim.engine import EngineBank
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Scenario
from cosim.vehicle.sensors import FaultySensors

DOUBLET = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.04, "amplitude": 8.0, "width_s": 0.1}
ROLL = Scenario.load("roll-doublet").replace(duration_s=0.4, command=[DOUBLET], expect=[])


def flown(change: Callable[[Simulation], None] | None = None, scenario: Scenario = ROLL) -> list[Sample]:
    with build(scenario) as simulation:
        if change:
            change(simulation)
            simulation.reset()
        return [simulation.step() for _ in range(scenario.steps)]


class Constant:
    """A controller of one's own: hover thrust, whatever is asked for."""

    lost: tuple[int, ...] = ()
    diagnostics: tuple[Diagnostics, Diagnostics, Diagnostics] = (UNKNOWN3, UNKNOWN3, UNKNOWN3)
    signals = ControlSignals(UNKNOWN3, UNKNOWN3, UNKNOWN3, nan, nan)

    def __init__(self, throttle: PerJet) -> None:
        self._throttle = throttle

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        return self._throttle

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        off = frozenset({1, 4}) if command.attitude[0] else frozenset[int]()
        return Actuation(self._throttle, (0.0, 0.0), Unallocated(), off)

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        return ALL_HEALTHY

    def forgive(self) -> None: ...


class Delegate:
    """Hands everything on to another block, as no compiled class does."""

    def __init__(self, block: Any) -> None:
        self._block = block

    def __getattr__(self, name: str) -> Any:
        return getattr(self._block, name)


def test_mypy_proves_that_the_built_in_blocks_fit() -> None:
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "tests/tools/conformance.py" in stated["tool"]["mypy"]["files"]


def test_a_controller_of_ones_own_flies_and_shuts_engines_off() -> None:
    def change(simulation: Simulation) -> None:
        hover = simulation.cascade.allocator.hover
        simulation.controller = Constant(simulation.cascade.thrust_map.throttle((hover,) * 6))
        with pytest.raises(InputError, match="Constant flies, and has not the parts of the built-in cascade"):
            attach_autopilot(simulation)

    samples = flown(change)
    begin = next(sample.k for sample in samples if sample.command.attitude[0])
    assert isnan(samples[0].control.collective)
    assert samples[begin - 1].state.altitude == pytest.approx(samples[0].state.altitude, abs=1e-3)
    for sample in samples:
        lit = [newton > 0.0 for newton in sample.thrust]
        # on again with the command gone
        assert lit == [True, not sample.command.attitude[0]] + [True] * 2 + [not sample.command.attitude[0], True]


@pytest.mark.parametrize("part", ["controller", "allocator"])
def test_a_block_from_outside_is_the_built_in_one_to_the_last_bit(part: str) -> None:
    def change(simulation: Simulation) -> None:
        holder = simulation if part == "controller" else simulation.cascade.loops
        setattr(holder, part, Delegate(getattr(holder, part)))

    assert repr(flown(change)) == repr(flown())


def test_sensors_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    class Perfect:
        def reset(self, state: State) -> Measured:
            return self.sample(state)

        def sample(self, state: State) -> Measured:
            return Measured(state.rate, state.attitude, state.position, state.velocity, state.altitude)

    samples = flown(lambda simulation: setattr(simulation, "sensors", FaultySensors(Perfect())))
    assert all(sample.measured.rate == sample.state.rate for sample in samples)
    bias = {"kind": "sensor_bias", "sensor": "barometer", "bias": [0.5], "start_s": 0.2}
    monkeypatch.setattr(cosim.simulation.build, "SensorSuite", lambda *_: Perfect())
    ill = flown(None, ROLL.replace(fault=[bias], monitor=False))
    # what is sampled at the end of the step in which the fault begins is biased
    assert [sample.measured.altitude - sample.state.altitude for sample in ill[50:52]] == [0.0, pytest.approx(0.5)]


def test_engines_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    class Late(EngineBank):
        def step(self, k: int, throttle: PerJet, ambient: Any = None) -> EngineOutput:
            return super().step(k, throttle, ambient)._replace(exhaust_temperature=(float(k),) * 6)

    monkeypatch.setattr(cosim.engine.isolated, "EngineBank", Late)
    assert [sample.engines.exhaust_temperature[0] for sample in flown()[:3]] == [0.0, 1.0, 2.0]
