"""Input clocks of FMI 3.0: ticked in event mode where a fixed step meets them, named where it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from engine_tools import STEP
from foreign_engines import ARRAYS, Row, force, foreign, lever, mapped

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.engine import EngineBank, EngineSpec, load_engine

EVENTS = ("<CoSimulation ", '<CoSimulation hasEventMode="true" ')
CLOCKED = 'min="0" max="1" start="0" variability="discrete" clocks="44"'


def clock(stated: str, kind: str = "constant") -> Row:
    return "ecu.tick", "clock", "input", f'Clock: intervalVariability="{kind}" {stated}'


def throttle() -> Row:
    return "throttle", "throttle", "input", CLOCKED


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("clocks")


def load(path: Path, step: float = STEP) -> EngineSpec:
    return load_engine(str(path), {}, step, unchecked=True)


def thrusts(spec: EngineSpec, steps: int = 200, count: int = 1) -> list[tuple[float, ...]]:
    throttles = np.random.default_rng(3).uniform(size=(steps, count))
    with EngineBank(spec, count, STEP) as bank:
        bank.reset(0.0)
        return [bank.step(k, tuple(each)).thrust for k, each in enumerate(throttles)]


@pytest.mark.parametrize(
    ("stated", "period", "strict"),
    [
        ('intervalDecimal="0.02"', 0.02, 0),
        ('intervalDecimal="0.02"', 0.02, 1),
        ('resolution="1000" intervalCounter="20"', 0.02, 1),
        ('intervalDecimal="0.001"', 0.001, 1),
    ],
)
def test_a_clocked_throttle_is_taken_at_the_ticks(stated: str, period: float, strict: int, place: Path) -> None:
    """As the engine that samples its throttle itself then, to the last bit; faster than the step, as one that does not.

    The strict one returns an error for a throttle that is set outside a tick, and for a tick at another time.
    """
    made_of = "lag=0.1,delay=0.02"
    lever_of = throttle() if strict else lever()
    path = foreign(place, f"clocked-{strict}-{len(stated)}-{period}", f"{made_of},clocked={period},strict={strict}",
                   [lever_of, force(), clock(stated)], 3, EVENTS)  # fmt: skip
    spec = load(path)
    assert spec.archive.event_mode
    assert f"its clock ecu.tick ticks every {period:g} s" in spec.archive.port_notes
    assert spec.archive.substeps(STEP) == max(1, round(STEP / period))
    own = load(foreign(place, f"own-{period}", made_of + (f",sampled={period}" if period > STEP else ""), None, 3))
    # a run-up begins a flight where it ends, at a multiple of neither
    for each in (spec, own):
        assert each.settling_window % 5 == own.settling_window % 5
    assert thrusts(spec) == thrusts(own)


def test_several_engines_take_their_throttles_at_one_tick(place: Path) -> None:
    stated = 'size="6" start="0 0 0 0 0 0" min="0" max="1" variability="discrete" clocks="44"'
    rows: list[Row] = [("u", "throttles", "input", stated), ARRAYS[1], clock('intervalDecimal="0.02"')]
    path = foreign(place, "six", "lag=0.1,clocked=0.02,strict=1,engines=6", rows, 3, EVENTS)
    spec = load(mapped(path, "[ports]", "throttle = 'u[*]'", "thrust = 'F[*]'"))
    assert [round(other.curve.thrust[-1], 6) for other in spec.siblings] == [20.0] * 5
    assert len(set(thrusts(spec, 20, 6)[-1])) == 6


def test_it_flies(place: Path) -> None:
    path = foreign(place, "flies", "lag=0.1,clocked=0.02,strict=1", [throttle(), force(), clock('intervalDecimal="0.02"')],
                   3, EVENTS)  # fmt: skip
    run = fly(Scenario.load("hover").replace(
        engine=str(path), engine_unchecked=True, controller="baseline", duration_s=0.2, expect=[]
    ))  # fmt: skip
    assert run.outcome == "completed"


def test_a_step_that_does_not_meet_the_ticks_is_refused(place: Path) -> None:
    path = foreign(place, "odd", "lag=0.1,clocked=0.01", [lever(), force(), clock('intervalDecimal="0.01"')], 3, EVENTS)
    with pytest.raises(
        InputError, match=r"clock ecu.tick ticks every 0.01 s, and a step of 0.004 s is no whole part or mul"
    ):
        load(path)
    assert load(path, 0.005).archive.clocks


@pytest.mark.parametrize(
    ("row", "change", "said"),
    [
        (clock("", "countdown"), EVENTS, "its clock ecu.tick never ticks: it is countdown, and only one that states"),
        (clock('intervalDecimal="0.02"'), ("", ""), "its clock ecu.tick never ticks: the FMU has no event mode"),
    ],
)
def test_a_clock_that_is_not_ticked_is_named(row: Row, change: tuple[str, str], said: str, place: Path) -> None:
    spec = load(foreign(place, f"never-{len(said)}", "lag=0.1", [lever(), force(), row], 3, change))
    assert any(note.startswith(said) for note in spec.archive.port_notes), spec.archive.port_notes
    assert spec.archive.clocks == ()
