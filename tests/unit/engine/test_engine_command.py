"""What an ECU does to the throttle: each limit against the bare engine fed with the throttle that the limit leaves, bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from engine_tools import STEP, Array, Driven, archive, driven

from cosim import fly
from cosim.base.errors import InputError
from cosim.engine import load_engine
from cosim.spec.scenario import Scenario

pytestmark = pytest.mark.usefixtures("built_engines")

LIMITED = ["p220", "p220-2025", "turbine-20", "turbine-100", "turbine-220"]
TURBINES = LIMITED[2:]


def answer(name: str, folder: Path, throttle: Array, start: float, **limits: float) -> Array:
    with driven(archive(name, 3), folder) as engine:
        engine.start(throttle_start=start, **limits)
        return np.array([engine.get("thrust"), *engine.run(throttle)])


def wild() -> Array:
    """Slow and fast, small and large."""
    random = np.random.default_rng(8)
    walk = 0.5 + np.cumsum(random.normal(0.0, 0.004, 1200))
    return np.clip(np.concatenate([walk, np.repeat(random.uniform(0.0, 1.0, 10), 40)]), 0.0, 1.0)


def every(throttle: Array, samples: int) -> Array:
    return np.repeat(throttle[::samples], samples)[: len(throttle)]


def resolved(throttle: Array, step: float) -> Array:
    return np.clip(step * np.floor(throttle / step + 0.5), 0.0, 1.0)


def kept(throttle: Array, band: float, start: float) -> Array:
    rows = []
    for u in throttle:
        start = u if abs(u - start) > band else start
        rows.append(start)
    return np.array(rows)


def led(throttle: Array, rate: float, start: float) -> Array:
    rows = []
    for u in throttle:
        most = STEP * rate
        start = u if abs(u - start) <= most else start + np.copysign(most, u - start)
        rows.append(start)
    return np.array(rows)


@pytest.mark.parametrize("name", LIMITED)
def test_each_limit_is_the_bare_engine_with_the_throttle_that_it_leaves(name: str, tmp_path: Path) -> None:
    u, start = wild(), 0.5
    cases: list[tuple[dict[str, float], Array]] = [
        ({"command_interval": 25}, every(u, 25)),
        ({"command_resolution": 0.01}, resolved(u, 0.01)),
        ({"command_dead_band": 0.008}, kept(u, 0.008, start)),
        ({"command_rate": 0.8}, led(u, 0.8, start)),
    ]
    for k, (limit, left) in enumerate(cases):
        found = answer(name, tmp_path / f"a{k}", u, start, **limit)
        bare = answer(name, tmp_path / f"b{k}", left, start)
        assert found.tobytes() == bare.tobytes(), limit
        assert np.abs(left - u).max() > 0.004
        assert np.ptp(found) > 0.1 * found.max()


def test_all_of_them_come_in_their_order(tmp_path: Path) -> None:
    """Delay, reading, resolution, dead band, rate."""
    u, start = wild(), 0.5
    limits = {
        "delay_samples": 7, "command_interval": 5, "command_resolution": 0.004,
        "command_dead_band": 0.006, "command_rate": 1.2,
    }  # fmt: skip
    late = np.concatenate([np.full(7, start), u[:-7]])
    left = led(kept(resolved(every(late, 5), 0.004), 0.006, start), 1.2, start)
    found = answer("p220-2025", tmp_path / "a", u, start, **limits)
    assert found.tobytes() == answer("p220-2025", tmp_path / "b", left, start).tobytes()


@pytest.mark.parametrize("name", LIMITED)
def test_it_starts_in_equilibrium_at_what_it_resolves(name: str, tmp_path: Path) -> None:
    found = answer(name, tmp_path / "a", np.full(500, 0.417), 0.417, command_resolution=0.05, command_dead_band=0.03)
    np.testing.assert_allclose(found, found[0], rtol=1e-9)
    assert found[0] == answer(name, tmp_path / "b", np.full(1, 0.4), 0.4)[0]


@pytest.mark.parametrize("name", TURBINES)
def test_the_speed_stays_within_the_loops_dead_band(name: str, tmp_path: Path) -> None:
    """A demand inside the band moves nothing; after one outside, the speed stands off by the band."""
    band = 0.01
    with driven(archive(name, 3), tmp_path) as engine:
        full, b = engine_parameters(name)["full_speed"], engine_parameters(name)["thrust_exponent"]
        idle = (engine_parameters(name)["idle_speed"] / full) ** b
        engine.start(throttle_start=0.5, speed_dead_band=band, delay_samples=0)
        start, speed = engine.get("thrust"), engine.get("spool_speed")
        inside = ((speed / full + 0.9 * band) ** b - idle) / (1.0 - idle)
        np.testing.assert_allclose(engine.run(np.full(500, inside)), start, rtol=1e-9)
        outside = ((speed / full + 5.0 * band) ** b - idle) / (1.0 - idle)
        engine.run(np.full(6000, outside), first=500)
        assert engine.get("spool_speed") / full == pytest.approx(speed / full + 4.0 * band, rel=1e-5)


def engine_parameters(name: str) -> dict[str, float]:
    return dict(load_engine(name, {}, STEP).parameters)


def hot(engine: Driven, throttle: Array, first: int = 0) -> Array:
    rows = []
    for k, u in enumerate(throttle, start=first):
        engine.set("throttle", float(u))
        engine.fmu.doStep(k * STEP, STEP)
        rows.append([engine.get(port) for port in ("thrust", "exhaust_temperature")])
    return np.array(rows)


@pytest.mark.parametrize("name", TURBINES)
def test_no_acceleration_is_hotter_than_the_limit(name: str, tmp_path: Path) -> None:
    peaks = {}
    for limit in (0.0, 1023.15):
        with driven(archive(name, 3), tmp_path / str(limit)) as engine:
            engine.start(throttle_start=0.0, exhaust_limit=limit)
            found = hot(engine, np.ones(3000))
        peaks[limit] = found[:, 1].max()
        # it arrives all the same: 720 degC at full throttle
        assert found[-1] == pytest.approx(
            [{"20": 24.0, "100": 100.0, "220": 220.0}[name.rpartition("-")[2]], 993.15], rel=2e-3
        )
    assert 1000.0 < peaks[1023.15] <= 1023.15 < peaks[0.0]


def test_where_it_is_too_hot_for_the_throttle_the_limit_is_where_it_rests(tmp_path: Path) -> None:
    """The hottest it may be is below full thrust's 720 degC: it starts, and stays, at that temperature."""
    with driven(archive("turbine-220", 3), tmp_path) as engine:
        engine.start(throttle_start=1.0, exhaust_limit=950.0)
        found = hot(engine, np.ones(500))
    assert found[:, 1] == pytest.approx(950.0, abs=1e-3)
    assert found[0, 0] < 215.0
    np.testing.assert_allclose(found[:, 0], found[0, 0], rtol=1e-6)


def test_the_shipped_limit_is_met_by_the_smallest_turbine_alone(tmp_path: Path) -> None:
    """950 degC, at which such engines are shut off; the others never come near it, and are the same bits without."""
    for name, peak in (("turbine-20", 1183.0), ("turbine-100", 1089.2), ("turbine-220", 1152.0)):
        assert engine_parameters(name)["exhaust_limit"] == 1223.15
        runs = []
        for k, limit in enumerate(({}, {"exhaust_limit": 0.0})):
            with driven(archive(name, 3), tmp_path / f"{name}{k}") as engine:
                engine.start(throttle_start=0.0, **limit)
                runs.append(hot(engine, np.repeat([1.0, 0.0, 0.6], [2000, 1000, 500])))
        assert runs[0][:, 1].max() == pytest.approx(peak, abs=0.1)
        assert (runs[0].tobytes() == runs[1].tobytes()) == (name != "turbine-20")
        if name == "turbine-20":
            assert runs[1][:, 1].max() == pytest.approx(1249.1, abs=0.1)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("p220", {"command_rate": -1.0}), ("p220-2025", {"command_interval": 0.0}), ("p220", {"command_interval": 2.5})],
)
def test_a_wrong_limit_is_refused_in_one_line(name: str, wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=rf"{next(iter(wrong))} = .*: must be a (whole )?number from"):
        load_engine(name, wrong, STEP)


@pytest.mark.parametrize("name", ["p220", "p220-2025"])
def test_a_slower_engine_does_the_same_later(name: str, tmp_path: Path) -> None:
    """Twice as slow, with every throttle held twice as long: the same thrusts, but for the integration's error."""
    u = wild()
    plain = answer(name, tmp_path / "a", u, 0.5)[1:]
    slow = answer(name, tmp_path / "b", np.repeat(u, 2), 0.5, time_factor=2.0)[2::2]
    np.testing.assert_allclose(slow, plain, rtol=1e-8)


def test_one_station_may_be_slower_than_the_others() -> None:
    """Six engines of one scenario, the third 40 % slower: equal at rest, behind after a step."""
    slower = {"3": {"parameters": {"time_factor": 1.4}}}
    flight = Scenario.load("full-scale-roll-doublet").replace(
        stations=slower, duration_s=3.0, sensor_noise=False, expect=[]
    )
    log = fly(flight).log
    assert log["thrust_3_N"][0] == pytest.approx(log["thrust_2_N"][0], rel=1e-9)
    np.testing.assert_allclose(log["throttle_3"], log["throttle_2"], atol=1e-6)
    assert np.abs(log["thrust_3_N"] - log["thrust_2_N"]).max() > 0.3
