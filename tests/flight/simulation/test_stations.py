"""Thrust for every share of it from any static curve, and different engines at different stations."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_tools import Hexjet
from flights import Rows

import cosim.simulation.engines
from cosim import fly
from cosim.api.call.choices import engine_choices, load_scenario
from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.control.allocation.thrust_map import StaticCurve, ThrustMap, invert
from cosim.engine import EngineBank, EngineSource, load_engine
from cosim.results.log.digest import log_digest
from cosim.results.report.flight_figures import run_figures
from cosim.results.report.panels import thrust_curves
from cosim.results.resolved_scenario import resolve
from cosim.results.run import open_run
from cosim.simulation.build import build
from cosim.simulation.delay_ledger import sum_samples
from cosim.spec.scenario import Scenario

STEP = 0.004
POINTS = tuple(k / 20 for k in range(21))
LINE = StaticCurve("line", POINTS, tuple(20.0 * u for u in POINTS))
STEEPER = StaticCurve("steeper", POINTS, tuple(1.0 + 30.0 * u for u in POINTS))
SQUARE = StaticCurve("square", POINTS, tuple(0.5 + 20.0 * u * u for u in POINTS))


def scenario(**changes: Any) -> Scenario:
    base: dict[str, Any] = {"name": "test", "duration_s": 2.0, "sensor_noise": False, "controller": "baseline"}
    return Scenario.from_table(base | changes, Scenario.load("hover").folder, "test")


def test_one_straight_curve_is_left_alone() -> None:
    """The share is the throttle to the last bit: the very same tuple; with idle thrust too."""
    thrust_map, steeper = ThrustMap(LINE, [LINE] * 6), ThrustMap(STEEPER, [STEEPER] * 4)
    shares = (0.1, 0.2, 1 / 3, 0.4, 0.5, 1.0)
    assert thrust_map.identity
    assert thrust_map.throttle(shares) is shares
    assert (thrust_map.idle, thrust_map.fraction(7.3)) == (0.0, invert(LINE).at(7.3))
    assert steeper.identity
    assert (steeper.idle, steeper.fraction(16.0)) == pytest.approx((1.0 / 30.0, 0.5), rel=1e-15)


@pytest.mark.parametrize("name", ["edf", "edf-as-flown", "turbojet", "motor"])
def test_the_papers_engines_are_straight(name: str) -> None:
    curve = StaticCurve(name, *load_engine(name, {}, 0.0025 if name == "motor" else STEP).curve)
    assert curve.is_straight
    assert ThrustMap(curve, [curve]).idle == 0.0


def test_what_a_curve_answers_does_not_depend_on_what_it_was_asked_before() -> None:
    """It keeps the line that answered last: at every point, beside it and beyond the ends, in any order."""
    curve = StaticCurve("bent", (0.0, 0.2, 0.5, 0.6, 1.0), (1.0, 2.0, 7.0, 7.5, 12.0))
    asked = [f + d for f in curve.thrust for d in (-0.3, 0.0, 0.3)] + [-5.0, 20.0]
    kept = invert(curve)
    for one in asked:
        for other in asked:
            kept.at(one)
            assert kept.at(other) == invert(curve).at(other)
    for thrust, throttle in zip(curve.thrust, curve.throttle, strict=True):
        assert kept.at(thrust) == pytest.approx(throttle, abs=1e-15)


@pytest.mark.parametrize("bend", [1e-8, -1e-8])
def test_a_curve_that_bends_by_more_than_a_billionth_is_not_straight(bend: float) -> None:
    bent = StaticCurve("bent", POINTS, tuple(20.0 * (u + 4.0 * bend * u * (1.0 - u)) for u in POINTS))
    assert not bent.is_straight
    assert not ThrustMap(bent, [bent]).identity


def test_equal_shares_are_equal_thrusts_on_a_curve() -> None:
    """Exactly at the measured points; between them to the sag of the chord, T'' h^2 / 8 = 0.0125 N here."""
    thrust_map = ThrustMap(SQUARE, [SQUARE] * 6)
    assert not thrust_map.identity
    for u, force in zip(SQUARE.throttle, SQUARE.thrust, strict=True):
        assert thrust_map.throttle((thrust_map.fraction(force),) * 6) == pytest.approx((u,) * 6, abs=1e-15)
    shares = np.linspace(0.0, 1.0, 301)
    thrusts = np.array([0.5 + 20.0 * thrust_map.throttle((c,) * 6)[0] ** 2 for c in shares.tolist()])
    np.testing.assert_allclose(thrusts, 0.5 + 20.0 * shares, atol=40.0 * 0.05**2 / 8 * 1.001)


def test_stations_get_the_throttle_that_gives_the_references_thrust() -> None:
    thrust_map = ThrustMap(LINE, [LINE, STEEPER, SQUARE, LINE])
    assert thrust_map.throttle((0.5, 0.5, 0.5, 0.25)) == pytest.approx((0.5, 0.3, (9.5 / 20) ** 0.5, 0.25), abs=1e-3)
    # what an engine cannot give it does not: below its idle thrust, above its full thrust
    assert thrust_map.throttle((0.0, 0.0, 0.0, 1.0)) == (0.0, 0.0, 0.0, 1.0)
    weak = StaticCurve("weak", POINTS, tuple(10.0 * u for u in POINTS))
    assert ThrustMap(LINE, [weak]).throttle((0.8,)) == (1.0,)


@pytest.mark.parametrize(
    ("thrusts", "said"),
    [
        ((0.0, 5.0, 4.0, 8.0, 9.0), r"from throttle 0\.25 to 0\.5 it falls from 5 to 4 N"),
        ((2.0, 2.0, 4.0, 8.0, 9.0), r"from throttle 0 to 0\.25 it is the same, 2 N"),
    ],
)
def test_a_curve_that_cannot_be_inverted_is_refused(thrusts: tuple[float, ...], said: str) -> None:
    with pytest.raises(InputError, match=rf"^engine odd: its thrust at rest must grow with the throttle, but {said}$"):
        ThrustMap(LINE, [LINE, StaticCurve("odd", (0.0, 0.25, 0.5, 0.75, 1.0), thrusts)])


def test_a_real_turbine_gives_the_thrust_of_its_share() -> None:
    """Settled in the FMU itself.

    The sag between its points is below a thousandth of full thrust, and a little more where its idle governor lets go.
    """
    engine = load_engine("turbine-20", {}, STEP)
    curve = StaticCurve(engine.name, *engine.curve)
    thrust_map = ThrustMap(curve, [curve] * 6)
    assert not thrust_map.identity
    shares = np.array([0.1, 0.2, 0.4, 0.55, 0.77, 1.0])
    with EngineBank(engine, 6, STEP) as bank:
        settled = bank.reset(thrust_map.throttle(tuple(shares.tolist()))).thrust
    low, high = curve.thrust[0], curve.thrust[-1]
    np.testing.assert_allclose(settled, low + shares * (high - low), rtol=0.0, atol=1e-3 * high)
    slopes = np.diff(curve.thrust) / np.diff(curve.throttle)
    assert slopes.max() > 1.2 * slopes.min()  # it is far from straight


@pytest.mark.parametrize("ground", [0.0, 2000.0])
def test_a_turbine_hovers_where_its_thrust_carries_the_vehicle(ground: float) -> None:
    """Also where the air is thin: at sea level its throttle would give a seventh more."""
    with build(scenario(engine="turbine-20", duration_s=0.4, environment={"ground_m": ground})) as simulation:
        carried = sum(simulation.step().thrust)
        weight = simulation.vehicle.mass_kg * 9.80665
        idle, hover = simulation.cascade.thrust_map.idle, simulation.cascade.allocator.hover
        low, high = simulation.engine.curve.thrust[0], simulation.engine.curve.thrust[-1]
    # the chord's sag
    assert carried == pytest.approx(weight, rel=3e-3)
    assert (idle + hover) * (high - low) * 6 == pytest.approx(weight, rel=1e-12)


def test_a_bent_curve_keeps_the_gain_of_the_tilts() -> None:
    """Tilts are enlarged by thrust over hover thrust, with what the engines give without throttle in both."""
    with build(scenario(engine="turbine-20", duration_s=0.4)) as simulation:
        allocator, idle = simulation.cascade.allocator, simulation.cascade.thrust_map.idle
        share = 1.7 * (allocator.hover + idle) - idle
        at_hover = allocator.allocate(allocator.hover, (0.0, 0.05, 0.02)).tilt
        above = allocator.allocate(share, (0.0, 0.05, 0.02)).tilt
    assert idle > 0.0
    assert above == pytest.approx([tilt / 1.7 for tilt in at_hover], rel=1e-12)


def test_a_station_has_its_own_engine_and_the_same_thrust() -> None:
    """One turbojet of less thrust and one EDF with a larger delay among EDFs as flown."""
    stations = {"3": {"engine": "turbojet"}, "5": {"parameters": {"delay_samples": 40.0}}}
    with build(scenario(duration_s=0.4, stations=stations)) as simulation:
        first = simulation.step()
        stands = [(station.name, station.delay_samples) for station in simulation.stations]
    assert stands == [*[("edf-as-flown", 25)] * 2, ("turbojet", 25), *[("edf-as-flown", n) for n in (25, 40, 25)]]
    # the same thrust from the start, at a throttle of its own: 20.0 N and 15.1 N at full throttle
    assert first.thrust == pytest.approx((first.thrust[0],) * 6, rel=1e-9)
    gains = (0.2554 / (1 - 0.8748)) / (0.01866 / (1 - 0.9879))
    assert first.actuation.throttle[2] / first.actuation.throttle[0] == pytest.approx(gains, rel=1e-9)


def test_a_scenarios_parameters_reach_a_station_of_the_same_engine() -> None:
    mixed = scenario(engine_parameters={"delay_samples": 30.0}, stations={"2": {"parameters": {"gain": 0.2}}})
    with build(mixed) as simulation:
        second = simulation.stations[1]
    assert (second.parameters["delay_samples"], second.parameters["gain"]) == (30.0, 0.2)


def test_the_ledger_of_mixed_engines_is_what_can_be_measured() -> None:
    """A step of roll command from hover, as in the test of one engine: the mean over the stations."""
    mixed = {"1": {"parameters": {"delay_samples": 61.0}}, "2": {"engine": "edf"}, "6": {"engine": "turbojet"}}
    amplitude, start = 1e-5, 50
    push = {
        "kind": "torque_command",
        "axis": "roll",
        "start_s": start * STEP,
        "duration_s": 8.0,
        "amplitude": amplitude,
    }
    loose = {"control": {"rate": {"roll": {"p": 0.0, "i": 0.0, "d": 0.0}}}}
    flown = scenario(
        duration_s=(start + 700) * STEP,
        disturbance=[push],
        # held: engines of different delays would make roll of what the altitude hold asks for
        command=[{"kind": "step", "signal": "collective", "start_s": 0.0, "amplitude": 0.45}],
        stations=mixed,
        vehicle=loose | {"aero": {"damping_n_m_s": [0.0, 0.0, 0.0]}},
    )
    rates = []
    for each in (flown, flown.replace(disturbance=[])):
        rows = Rows()
        with build(each) as simulation:
            simulation.run([rows])
            ledger, vehicle, curve = simulation.ledger, simulation.vehicle, simulation.engine.curve
        rates.append(rows.samples[-1].measured.rate[0])
    lever = sum(abs(jet.position_m[1]) for jet in vehicle.jets)
    gain = lever * (curve.thrust[-1] - curve.thrust[0]) * amplitude / vehicle.inertia_kg_m2[0]
    grown = (rates[0] - rates[1]) / (gain * STEP)
    stated = sum_samples(ledger)
    assert stated is not None
    assert rows.samples[-1].k - start + 0.5 - grown == pytest.approx(stated, abs=0.05)
    row = next(row for row in ledger if row.element == "transport delay")
    assert row.samples == pytest.approx((61 + 0 + 25 * 4) / 6)
    assert row.owner == "engines edf-as-flown, edf, turbojet: mean by their shares of the moment"


def test_each_engine_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = []

    def count(source: EngineSource, *given: Any, **options: Any) -> Any:
        loaded.append(source.name)
        return load_engine(source, *given, **options)

    monkeypatch.setattr(cosim.simulation.engines, "load_engine", count)
    stations = {"3": {"engine": "turbojet"}, "4": {"engine": "turbojet"}, "5": {"engine": "edf-as-flown"}}
    with build(scenario(stations=stations)) as simulation:
        assert len({id(station) for station in simulation.stations}) == 2
    assert loaded == ["edf-as-flown", "turbojet"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stations": {"7": {"engine": "edf"}}}, r"stations\.7: hexjet has stations 1 to 6"),
        ({"stations": {"3": {}}}, r"stations\.3: give engine, parameters or both"),
        (
            {"stations": {"3": {"parameters": {"thrust": 1.0}}}},
            r"thrust is of causality output, and no parameter; allowed: .*gain",
        ),
        (
            {"stations": {str(jet): {"parameters": {"gain": 0.07}} for jet in range(1, 7)}},
            r"stations: the engines give at most 32\.9 N together; hexjet \(5\.525 kg\) weighs 54\.2 N",
        ),
    ],
)
def test_what_cannot_stand_there_is_refused_in_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught, build(scenario(**changes)):
        pass
    assert "\n" not in str(caught.value)


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A mapping file and the archive it names, in another folder, and a second archive of the same name elsewhere."""
    for place, name in (("fans", "edf-as-flown"), ("jets", "turbojet")):
        (tmp_path / "theirs" / place).mkdir(parents=True)
        shutil.copy(data_folder("fmus") / f"{name}.fmu", tmp_path / "theirs" / place / "engine.fmu")
    (tmp_path / "theirs" / "fan.toml").write_text(
        'fmu = "fans/engine.fmu" # theirs\n[parameters]\ndelay_samples = 20\n[ledger]\ndelay_s = 0.08\n'
    )
    return tmp_path / "theirs"


def test_a_run_with_foreign_engines_flies_again_from_its_folder(foreign: Path, tmp_path: Path) -> None:
    """Bit for bit, with nothing left of the place it came from."""
    fan, jet = str(foreign / "fan.toml"), str(foreign / "jets" / "engine.fmu")
    stations = {"2": {"engine": jet}, "4": {"engine": "edf"}}
    stations["5"] = {"engine": fan, "parameters": {"delay_samples": 22.0}}
    noisy = {"sensor_noise": True, "engine_unchecked": True}
    flown = scenario(duration_s=1.0, engine=fan, stations=stations, **noisy)
    first = fly(flown, tmp_path / "first", report=False)
    assert first.folder is not None
    assert {path.name for path in first.folder.glob("*.fmu")} == {"engine.fmu", "jets.fmu"}  # called as the engines
    assert first.summary.engine == "fan"
    found = first.summary.stations
    assert [station.engine for station in found] == ["fan", "jets", "fan", "edf", "fan", "fan"]
    assert len({station.sha256 for station in found}) == 3
    assert set(first.summary.sha256) >= {"fan.toml", "engine.fmu", "edf.fmu"}
    assert sum(name.endswith("engine.fmu") for name in first.summary.sha256) == 2
    shutil.rmtree(foreign)
    moved = first.folder.rename(tmp_path / "moved")
    again = fly(Scenario.load(moved / "scenario.toml"), tmp_path / "second", report=False)
    assert log_digest(open_run(moved).log) == log_digest(again.log)
    assert again.summary.sha256["engine.fmu"] == first.summary.sha256["engine.fmu"]


def test_the_resolved_scenario_states_what_stands_where() -> None:
    mixed = scenario(stations={"3": {"engine": "turbojet"}, "6": {"engine": "edf-as-flown"}})
    with build(mixed) as simulation:
        resolved, files = resolve(simulation)
        expected = {"engine": "turbojet", "parameters": dict(simulation.stations[2].parameters)}
    assert files == {}
    assert {number: station.model_dump() for number, station in resolved.stations.items()} == {"3": expected}
    with build(resolved) as again:
        assert [station.name for station in again.stations] == [station.name for station in simulation.stations]


def test_the_page_names_the_odd_engine_and_draws_its_own_curve(tmp_path: Path) -> None:
    run = fly(scenario(duration_s=0.4, engine="turbine-20", stations={"3": {"engine": "edf"}}), tmp_path / "run")
    page = (tmp_path / "run" / "report.html").read_text()
    assert "<dt>engine of jet 3</dt><dd>edf</dd>" in page
    assert "engine of jet 4" not in page
    curves = thrust_curves(run.summary)
    assert curves[2][-1] == (1.0, pytest.approx(20.005, abs=0.01))
    assert curves[3][-1][1] == pytest.approx(24.0, abs=0.1)
    panels = run_figures(run.log, run.summary)["engines"]["panels"]
    names = {signal["label"] for panel in panels for signal in panel["signals"]}
    assert "jet 1" in names
    assert "jet 3" not in names  # it says nothing but its thrust


HERE = str(Path("some/engine.fmu").absolute())


@pytest.mark.parametrize(
    ("given", "choices"),
    [
        ((), {}),
        (("edf",), {"engine": "edf"}),
        (("3=edf", "4 = turbojet"), {"stations": {"3": {"engine": "edf"}, "4": {"engine": "turbojet"}}}),
        (("turbojet", "1=some/engine.fmu"), {"engine": "turbojet", "stations": {"1": {"engine": HERE}}}),
        (("a=b.toml",), {"engine": str(Path("a=b.toml").absolute())}),
        (("3=edf", "3=turbojet"), "engine 3=turbojet: there is already another for station 3"),
        (("edf", "turbojet"), "engine turbojet: there is already another for all"),
    ],
    ids=str,
)
def test_engines_on_the_command_line(given: tuple[str, ...], choices: dict[str, Any] | str) -> None:
    if isinstance(choices, str):
        with pytest.raises(InputError, match=choices):
            engine_choices(given)
    else:
        assert engine_choices(given) == choices


def test_one_engine_for_all_replaces_the_stations(tmp_path: Path) -> None:
    path = tmp_path / "mixed.toml"
    path.write_text(
        "name = 'mixed'\nduration_s = 1.0\n[stations.3]\nengine = 'turbojet'\n"
        "[[expect]]\ncontroller = 'smith'\nengine = 'edf-as-flown'\n"
    )
    one, all_, none = (
        load_scenario(str(path), None, given, None, ()) for given in (["5=edf"], ["edf", "5=turbojet"], [])
    )
    assert {number: station.engine for number, station in one.stations.items()} == {"3": "turbojet", "5": "edf"}
    assert (all_.engine, set(all_.stations)) == ("edf", {"5"})
    assert [len(each.expect) for each in (one, all_, none)] == [0, 0, 1]


def test_a_station_that_does_not_exist_ends_with_one_line(hexjet: Hexjet) -> None:
    assert "stations.7" in hexjet("fly", "hover", "--engine", "7=edf").refusal


def test_a_list_is_changed_at_a_place() -> None:
    """``vehicle.jets.2.spin`` and its like; all the places of a list, counted from 0."""
    changed = Scenario.load("hover", ["vehicle.jets.2.spin=0"])
    with build(changed.replace(expect=[])) as simulation:
        assert [jet.spin for jet in simulation.vehicle.jets] == [1, -1, 0, 1, -1, 1]
        assert simulation.vehicle.jets[2].servo == "left"
        assert simulation.vehicle.jets[2].position_m == (0.13, -0.15, -0.08)
    with pytest.raises(InputError, match="jets"):
        build(Scenario.load("hover", ["vehicle.jets.6.spin=-1"]))
