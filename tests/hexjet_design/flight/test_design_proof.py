"""What a linear model of an engine does not see, and how the end of a design finds it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from foreign_engines import foreign, mapped

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.engine import load_engine
from cosim.identify.sweep.response import FrequencyResponse
from cosim.simulation.controllers.controller_file import ControllerFile, Requirements, read_controller
from cosim.spec.new_aircraft import new_aircraft
from cosim.spec.scenario import Scenario, find_scenario
from hexjet_design import design as making
from hexjet_design import tune as search
from hexjet_design.api import DesignResult
from hexjet_design.controller_table import make_controller_table
from hexjet_design.design import Design, design
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import channels
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.criteria import CORNER_FACTOR
from hexjet_design.loop.dynamics import bounds, fit_dynamics, with_misfit
from hexjet_design.proof import flights as flying
from hexjet_design.proof import run as proving
from hexjet_design.proof.comparison import FlownMeasures, FlownPair, comparison_lines, comparison_rows, worse_lines
from hexjet_design.proof.flights import describe_fault
from hexjet_design.proof.result import Proof, ProofFlight
from hexjet_design.proof.run import add_proof, prove
from hexjet_design.result import summary_lines, to_dict

STEP = 0.004
GENERATIONS, ROUNDS = search.MAX_GENERATIONS, search.MAX_EVALUATIONS  # of the whole search
ISOLATED = flying._make_scenario


@pytest.fixture(scope="module", autouse=True)
def _quick() -> Iterator[None]:
    """A short search without its last digits: its result is worse, and must keep the requirements all the same.

    The engines, made here, fly in this process, to the same bits (test_engine_isolated.py) in a quarter of the time.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flying, "_make_scenario", lambda *given: ISOLATED(*given).replace(engine_isolated=False))
        patch.setattr(search, "MAX_GENERATIONS", 4)
        patch.setattr(search, "MAX_EVALUATIONS", 40)
        patch.setattr(making, "tune_digits", lambda *a, **k: None)
        patch.setattr(making, "bandwidths_without_limits", lambda *a, **k: {})
        yield


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("proof")


def quick(path: Path, lead: bool = False, **need: float) -> Design:
    settings = ["engine_unchecked=true"]
    return design(str(path), controller="baseline", lead=lead, need=Requirements(**need), settings=settings)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def sound(place: Path) -> Design:
    return quick(foreign(place, "sound", "lag=0.15,delay=0.04"))


@pytest.fixture(scope="module")
def lively(sound: Design) -> Design:
    """The same, which trims an uneven engine before it leans far."""
    return in_full(sound)


def in_full(made: Design) -> Design:
    """The same with roll searched for in full, and a lead."""
    roll = made.axes["roll"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "MAX_GENERATIONS", GENERATIONS)
        patch.setattr(search, "MAX_EVALUATIONS", ROUNDS)
        model, lead = making.predictor_model(roll.channel, "test"), making.engine_lead(roll.channel)
        found = search.tune(roll.channel, "baseline", model, roll.before.tuning, made.need, lead=lead)
    after = making.assess(roll.channel, found.tuning, made.need)
    return replace(made, axes={**made.axes, "roll": replace(roll, after=after)})


def response(zero: float) -> FrequencyResponse:
    """(1 + zero s) / ((1 + 0.3 s) (1 + 0.03 s)) behind a hold, 18 N, 5 samples late: exact."""
    hertz = np.geomspace(0.05, 5.0, 60)
    s = 2j * np.pi * hertz
    value = 18.0 * (1.0 + zero * s) / ((1.0 + 0.3 * s) * (1.0 + 0.03 * s)) * np.exp(-5 * STEP * s)
    value = value * (1.0 - np.exp(-s * STEP)) / (s * STEP)
    return FrequencyResponse(hertz, value, np.ones(60), np.zeros(60), STEP)


def test_a_zero_in_the_right_half_plane_is_found_as_one() -> None:
    """Thrust that first goes the wrong way; without such a zero the best model was 70 % off."""
    found = fit_dynamics(response(-0.35), 5.0, 0.3)
    assert found.misfit < 1e-3
    assert [z.real for z in found.zeros] == pytest.approx([1.0 / 0.35], rel=1e-3)
    assert sorted(-1.0 / p.real for p in found.poles) == pytest.approx([0.03, 0.3], rel=1e-3)
    assert found.delay_samples == 5.0
    assert "right half plane at 2.857 rad/s" in found.describe()
    assert found.lag_s == pytest.approx(0.3 + 0.03 + 0.35, rel=1e-3)  # the zero is late at low frequency
    other = fit_dynamics(response(0.1), 5.0, 0.3)
    assert all(z.real < 0.0 for z in other.zeros)


@pytest.mark.long
def test_an_engine_that_trembles_is_swept_by_more_than_it_moves_itself(place: Path) -> None:
    """Noise of 0.25 % of full thrust, 0.1 s of lag: half a per cent of throttle would drown in it."""
    path = mapped(foreign(place, "noisy", "lag=0.1,delay=0.04,noise=0.0025"), "[rest]", "thrust = 0.5")
    scenario, vehicle = making._scenario(str(path), "hexjet", ["engine_unchecked=true"])
    spec = load_engine(str(path), {}, STEP, unchecked=True)
    found = making.identify_hover(scenario, vehicle, spec, None)
    assert found.sweep.amplitude == pytest.approx(2.0 * 0.5 / 20.0, rel=0.01)
    dynamics = making.make_dynamics(found)
    assert dynamics.lag_s + dynamics.delay_samples * STEP == pytest.approx(0.14, rel=0.05)


def test_a_misfit_is_no_design(monkeypatch: pytest.MonkeyPatch, sound: Design) -> None:
    made = sound
    assert made.ok
    height = made.axes["altitude"]  # which engines alone answer, on every vehicle
    actuator = height.channel.actuator
    wrong = replace(actuator, dynamics=replace(actuator.dynamics, misfit=0.62))
    axes = {**made.axes, "altitude": replace(height, channel=replace(height.channel, actuator=wrong))}
    monkeypatch.setattr(proving, "fly_all", lambda *a: pytest.fail("flown all the same"))
    found = add_proof(replace(made, axes=axes))
    assert not found.ok
    assert "the best one is 62 % off its response" in found.reason


def test_a_misfit_is_the_worst_engine_that_it_allows(sound: Design) -> None:
    """The largest sensitivity among many engines ``1 + x``, and the least of the tolerances, against the formula."""
    roll = sound.axes["roll"]
    assert roll.after is not None
    unsure = ((0.05, 0.02), (1.0, 0.1), (8.0, 0.6))
    actuator = roll.channel.actuator
    changed = replace(actuator, dynamics=replace(actuator.dynamics, unsure=unsure))
    channel = replace(roll.channel, actuator=changed)
    plain, wide = (ClosedLoop(FrequencyGrid(each, close=2000), roll.after.tuning) for each in (roll.channel, channel))
    share = np.interp(np.log(plain.points.theta / (2.0 * np.pi * STEP)), np.log([0.05, 1.0, 8.0]), [0.02, 0.1, 0.6])
    turns = np.exp(2j * np.pi * np.arange(360) / 360)
    worst = max(float(np.max(np.abs(1.0 / (1.0 + (1.0 + share * x) * plain.open_loop)))) for x in turns)
    assert wide.peak_sensitivity == pytest.approx(worst, rel=1e-3)
    assert wide.peak_sensitivity > 1.05 * plain.peak_sensitivity
    assert wide.distance == pytest.approx(1.0 / wide.peak_sensitivity)
    assert plain.distance == pytest.approx(1.0 / plain.peak_sensitivity)
    assert wide.compute_tolerance(3.0, 0.3) < plain.compute_tolerance(3.0, 0.3)
    assert not search.is_acceptable(wide, sound.need)  # what the search keeps to
    lost = replace(changed, dynamics=replace(actuator.dynamics, unsure=((1.0, 5.0),)))
    beyond = ClosedLoop(FrequencyGrid(replace(channel, actuator=lost)), roll.after.tuning)
    assert beyond.distance < 0.0
    assert np.isinf(beyond.peak_sensitivity)
    assert 0.0 < search.excess(beyond, sound.need) < 10.0  # a slope, for a search that comes from there


def test_a_search_sees_a_narrow_misfit_as_the_check_behind_it_does(sound: Design) -> None:
    """However few its points are: else it stops inside what it takes for the requirements, and the check finds it out."""
    roll = sound.axes["roll"]
    assert roll.after is not None
    narrow = ((0.05, 0.002), (8.88, 0.1), (8.893, 9.0), (8.9, 0.1), (12.0, 0.05))
    actuator = roll.channel.actuator
    channel = replace(roll.channel, actuator=replace(actuator, dynamics=replace(actuator.dynamics, unsure=narrow)))
    few, many = (ClosedLoop(FrequencyGrid(channel, close=close), roll.after.tuning) for close in (600, 20_000))
    assert few.beyond_stability == pytest.approx(many.beyond_stability, rel=1e-9)
    assert few.distance == pytest.approx(many.distance, rel=1e-4)


def test_what_a_model_leaves_of_the_response_is_carried_into_the_controller_file(sound: Design) -> None:
    """30 % too strong at the upper end; a model that follows carries nothing, and its file says nothing."""
    exact = response(0.1)
    model = fit_dynamics(exact, 5.0, 0.3)
    assert with_misfit(model, exact).unsure == ()
    bent = replace(exact, value=exact.value * np.geomspace(1.0, 1.3, 60))
    carried = with_misfit(replace(model, misfit=0.1), bent)
    middle = np.exp(np.mean(np.log(np.geomspace(1.0, 1.3, 60))))
    assert carried.uncertainty(np.array([50.0]))[0] == pytest.approx(1.3 / middle - 1.0, rel=0.01)  # type: ignore[index]
    assert "up to 14 %" in carried.unsure_words()
    assert make_controller_table(sound)["design"].get("unsure") is None
    axes = {
        axis: replace(each, channel=replace(each.channel, actuator=replace(each.channel.actuator, dynamics=carried)))
        for axis, each in sound.axes.items()
    }
    made = replace(sound, axes=axes)
    assert len(make_controller_table(made)["design"]["unsure"]) == 60
    assert any("designed for every engine that differs" in line for line in summary_lines(made))
    assert len(to_dict(made)["axes"]["roll"]["actuator_unsure"]) == 60


def test_no_narrow_mode_is_lost_between_the_points_of_a_bound() -> None:
    hertz = np.linspace(0.1, 20.0, 4000)
    off = 0.01 + 3.0 * (np.abs(hertz - 9.0) < 0.004)
    points = np.array(bounds(hertz, off)).T
    assert np.all(np.interp(np.log(hertz), np.log(points[0]), points[1]) >= off)
    assert points[1].min() == pytest.approx(0.01)


def test_a_response_too_far_from_its_model_is_searched_for_again(
    monkeypatch: pytest.MonkeyPatch, sound: Design
) -> None:
    """Once, with what was measured; where nothing stands it, both reasons are told."""
    far = Proof("the loop may be unstable", 9.0, 4.0, 3.0, 0.1, (), ((1.0, 0.5),))
    fine = Proof("", 9.0, 0.1, 1.7, 0.1, ())
    proofs = iter([far, fine, far])
    monkeypatch.setattr(proving, "prove", lambda *a: next(proofs))
    asked = []

    def again(unsure: Any) -> Design:
        asked.append(unsure)
        return sound if len(asked) == 1 else replace(sound, reason="roll: no gains")

    assert add_proof(sound, again=again).ok
    assert asked == [((1.0, 0.5),)]
    assert add_proof(sound, again=again).reason == "the loop may be unstable; with that in the search, roll: no gains"


def test_a_sound_engine_is_proved_and_the_proof_is_told(lively: Design) -> None:
    found = add_proof(lively)
    assert found.ok, found.reason
    assert found.proof is not None
    assert len(found.proof.flights) == 22
    assert found.proof.lean_deg == pytest.approx(20.0)
    assert sum("with 0.70 of its thrust and 1.30 times its lag" in each.words for each in found.proof.flights) == 1
    assert {(each.gain, each.later) for each in found.proof.flights} >= {(0.7, 3), (1.3, 3), (1.0, 0)}
    assert found.proof.sensitivity <= 1.7 * 1.02  # the measured loop's, an engine whose model is exact
    assert found.proof.stability_fraction < 0.05
    assert any("22 of 22 flights" in line for line in summary_lines(found))
    assert to_dict(found)["proof"]["flights"][0]["fault"] == ""
    # the same flights with the gains that ship, in the file too, which still is one
    assert [each.flight for each in found.proof.compared] == ["hover", "doublet", "doublet to 20 deg"]
    written = ControllerFile.model_validate(make_controller_table(found)).design.proof
    assert written is not None
    assert (written.flights, written.lean_deg) == (22, 20.0)
    flown = found.proof.flights[1].flown
    assert flown is not None
    assert written.flown[1].designed["throttle_activity_1_s"] == pytest.approx(
        flown.values["throttle_activity_1_s"], rel=1e-5
    )


@pytest.mark.long
def test_a_light_mode_past_the_band_is_found_by_measuring_there(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """1 % of the thrust in a mode at 9 Hz: a model within a quarter of a percent, and a loop that swings up.

    By the whole search of roll: a short one ends with crossovers from 2 to 4 Hz, by the last bits of a processor's
    arithmetic, and three times that is only sometimes past the mode.
    """
    monkeypatch.setattr(proving, "fly_all", lambda *a: pytest.fail("flown all the same"))
    made = in_full(quick(foreign(place, "mode", "lag=0.4,mode=0.01,mode_hz=9,damping=0.01")))
    assert made.ok
    found = prove(made)
    assert "around 9" in found.reason
    assert found.measured_hz > 9.0


def test_what_only_a_flight_shows_is_no_design(place: Path, sound: Design, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same engine to a slow sweep, but for a controller of its own that reads the throttle four times a second."""
    other = foreign(place, "samples", "lag=0.15,delay=0.04,sampled=0.25")
    found = add_proof(replace(sound, scenario=sound.scenario.replace(engine=str(other))))
    # in hover or in the doublet, by how much gain the search found
    begins = r"flown with the engine itself it does not keep what it promises: (hover|doublet), as designed: "
    assert re.match(begins, found.reason)
    assert to_dict(found)["file"] is None
    assert any(line.startswith("no acceptable design: flown") for line in summary_lines(found))
    assert found.proof is not None
    assert len(found.proof.flights) == 4  # a corner that fails is enough


def test_a_hover_that_swings_asks_for_less_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing but noise moves it; of a doublet, or at a corner, that is not said."""
    design: Any = SimpleNamespace(identification=None, need=Requirements(noise_share=0.08), vehicle=None)
    monkeypatch.setattr(proving, "compare_with_shipped", lambda *a: [])
    monkeypatch.setattr(proving, "lean_of", lambda vehicle: 20.0)
    monkeypatch.setattr(proving, "find_allowing", lambda *a: {})
    swings = ProofFlight("hover", 1.0, 0, "roll swings by 3.7 deg, 1 at most")
    for flight, asked in (
        (swings, True),
        (replace(swings, gain=0.7), False),
        (replace(swings, scenario="gust"), False),
    ):
        monkeypatch.setattr(proving, "fly_all", lambda *a, flight=flight: [flight])
        assert prove(design).reason.endswith("less of it may do: noise_share 0.01") is asked


def test_an_engine_that_surges_on_a_fast_throttle_is_no_design(place: Path, lively: Design) -> None:
    """It keeps what was promised at 10 deg, with every corner; the pilot may ask for 20.

    As designed all four flights are the proof's own: the first that it names is the first that fails.
    """
    surges = foreign(place, "surges", f"lag=0.15,delay=0.04,surge={SURGE}")
    made = replace(lively, scenario=lively.scenario.replace(engine=str(surges)))
    tables = flying.flight_tables(made)
    low, high = [name for name in tables if name.startswith("doublet")]
    assert (low, high) == ("doublet", "doublet to 20 deg")
    for gain, later in [(0.7, 0), (1.3, 0), (0.7, 3), (1.3, 3)]:
        assert flying.fly_corner(made, low, tables[low], gain, later).fault == ""
    found = add_proof(made)
    assert not found.ok
    assert found.proof is not None
    assert len(found.proof.flights) == 4
    assert "does not keep what it promises: doublet to 20 deg, as designed: " in found.reason


@pytest.mark.parametrize(
    ("off", "holds", "allowed"),
    [
        ({"engine": "engine 1 with 0.70 of its thrust"}, 0.17, {"engine_spread": 0.15}),
        ({"engine": "engine 1 with 0.70 of its thrust"}, 0.01, {"engine_spread": 0.0}),
        ({"gain": 1.3}, 0.26, {"gain_tolerance": 0.25}),
        ({"gain": 0.7, "later": 3}, 0.3, {"delay_tolerance": 0.25}),
        ({}, 0.0, None),
    ],
)
def test_a_design_whose_proof_fails_beside_it_is_written_as_not_proved(
    off: dict[str, Any],
    holds: float,
    allowed: dict[str, float] | None,
    sound: Design,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What would allow it is found with flights that keep it up to ``holds``; of one as designed nothing is written."""
    transport = sound.axes["roll"].channel.transport_samples

    def corner(_: Design, name: str, table: object, gain: float, later: int) -> ProofFlight:
        size = later / transport if off.get("later") else abs(gain - 1.0)
        return ProofFlight(name, gain, later, "lost" if size > holds else "")

    def odd(_: Design, tables: object, factor: float) -> ProofFlight:
        return ProofFlight("doublet", 1.0, 0, "lost" if abs(factor - 1.0) > holds else "", "engine 1")

    flights = [ProofFlight("hover", 1.0, 0, ""), replace(ProofFlight("doublet", 1.0, 0, "overshoot of 39 %"), **off)]
    monkeypatch.setattr(flying, "fly_corner", corner)
    monkeypatch.setattr(flying, "fly_with_odd_engine", odd)
    monkeypatch.setattr(proving, "fly_all", lambda *a: flights)
    monkeypatch.setattr(proving, "compare_with_shipped", lambda *a: [])
    found = add_proof(sound)
    assert (found.ok, found.is_written) == (False, allowed is not None)
    result = DesignResult(found).write(tmp_path / "mine.toml")
    told, page = result.to_dict(), " ".join((tmp_path / "mine.html").read_text().split())
    assert (told["ok"], told["proved"], told["allowing"]) == (False, False, allowed or {})
    if allowed is None:
        assert (result.controller, told["file"]) == (None, None)
        assert "no acceptable design" in page
        return
    ((key, value),) = allowed.items()
    first, second = result.lines()[1:3]
    assert first.startswith(f"NOT PROVED: {found.reason}")
    assert second.startswith(f"{key} {value:g} would allow it")
    assert ", not proved</span>" in page
    assert "NOT PROVED" in page
    assert (tmp_path / "mine.toml").read_text().startswith("# NOT PROVED: flown with the engine itself")
    made = read_controller(tmp_path / "mine.toml").design
    assert made.proof is not None
    assert made.proof.failed == found.reason
    assert told["file"]["design"]["proof"]["failed"] == found.reason


def test_an_engine_that_is_off_is_flown_as_such(sound: Design, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thrust comes to 0.7 and 1.3 times in steps, the lag is longer by 0.3 of the engine's, and nothing has failed."""
    flown: list[Scenario] = []
    monkeypatch.setattr(flying, "fly", lambda scenario, **_: flown.append(scenario))
    monkeypatch.setattr(flying, "describe_fault", lambda *_: "")
    monkeypatch.setattr(flying, "measure_flight", lambda *_: None)
    tables = flying.flight_tables(sound)
    for factor in (0.7, 1.3):
        flight = flying.fly_with_odd_engine(sound, tables, factor)
        assert not flight.is_as_designed
    weak, strong = flown
    for scenario, last in ((weak, 0.7), (strong, 1.3)):
        slow = scenario.fault[-1]
        assert thrust_at(0.0, scenario) == pytest.approx(1.0, rel=0.06)
        assert thrust_at(scenario.command[0].start_s, scenario) == pytest.approx(last)
        assert slow.kind == "slow_spool"
        assert slow.lag_s == pytest.approx(0.3 * 0.15, rel=0.02)
        assert not scenario.monitored
        assert scenario.command[0].amplitude == pytest.approx(20.0)


def thrust_at(time: float, scenario: Scenario) -> float:
    """The thrust of the first engine over that of the others."""
    losses = [each for each in scenario.fault if each.kind == "thrust_loss"]
    acting = [each for each in losses if each.start_s <= time < each.start_s + (each.duration_s or np.inf)]
    return float(np.prod([1.0 - each.share for each in acting], initial=scenario.mismatch.thrust_factor_1))


def flight_of(**values: float | None) -> FlownMeasures:
    return FlownMeasures("", True, {"roll_rmse_deg": 3.39, "settling_s": 1.84, "throttle_activity_1_s": 0.075} | values)


def test_what_is_worse_as_flown_is_the_first_thing_said(sound: Design) -> None:
    """Of a design that tracks worse, with 18 times the work of the throttles."""
    before, after = flight_of(), flight_of(roll_rmse_deg=3.76, settling_s=1.65, throttle_activity_1_s=1.331)
    pair = FlownPair("doublet", before, after)
    assert pair.worse() == {"roll_rmse_deg": pytest.approx(1.109, rel=1e-3), "throttle_activity_1_s": pytest.approx(17.75, rel=1e-3)}  # fmt: skip
    lines = worse_lines([FlownPair("hover", before, before), pair])
    assert lines[1] == "WORSE as flown than what ships: throttle activity 0.075 -> 1.331 1/s (17.7 times) in doublet"
    proof = Proof("", 9.0, 0.1, 1.7, 0.1, (), (), [pair], 20.0)
    made = replace(sound, proof=proof)
    assert summary_lines(made)[1] == proof.lines()[0]  # the verdict first
    assert summary_lines(made)[2:4] == lines
    assert to_dict(made)["worse"] == lines
    record = to_dict(made)["proof"]  # by the keys that older readers know
    assert record["share"] == proof.stability_fraction
    assert "stability_fraction" not in record
    assert [record["compared"][0][which]["lost"] for which in ("shipped", "designed")] == ["", ""]
    assert "failure" not in record["compared"][0]["shipped"]
    assert make_controller_table(made)["design"]["proof"]["worse"] == lines
    never = FlownPair("doublet", before, flight_of(settling_s=None))
    assert "settling, to 5 % 1.84 -> never s" in worse_lines([never])[0]
    assert worse_lines([FlownPair("doublet", before, before)]) == []


def test_what_ships_may_not_fly_the_engine(sound: Design) -> None:
    gone = FlownPair("doublet", FlownMeasures("lost at 4.2 s", True, {}), flight_of())
    assert comparison_lines([gone]) == ["the gains that ship do not fly this engine: doublet lost at 4.2 s"]
    assert comparison_rows([gone])[0] == ["roll error, RMSE, deg", "lost at 4.2 s", "3.39"]
    assert worse_lines([gone]) == []


def test_a_flight_that_is_lost_as_designed_alone_is_worse() -> None:
    lost = FlownPair("doublet", flight_of(), FlownMeasures("lost at 4.2 s", True, {}))
    said, advice = comparison_lines([lost])
    assert said == "WORSE as flown than what ships: doublet lost at 4.2 s, which the gains that ship fly"
    assert advice.startswith("next: a lower noise_share")


def test_an_aircraft_of_a_folder_is_proved_as_what_it_is(
    tmp_path: Path, sound: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its folder: its name alone is known to nobody."""
    aircraft = new_aircraft("mine", "hexjet", tmp_path / "mine").parent
    given = sound.scenario.replace(aircraft=str(aircraft))
    design = replace(sound, scenario=given, vehicle=given.resolved_vehicle()[0])
    flown: list[Scenario] = []
    monkeypatch.setattr(flying, "fly", lambda scenario, **_: flown.append(scenario))
    monkeypatch.setattr(flying, "describe_fault", lambda *_: "")
    monkeypatch.setattr(flying, "measure_flight", lambda *_: None)
    assert flying.fly_corner(design, "hover", read_toml(find_scenario("hover")), 1.0, 0).fault == ""
    assert flown[0].resolved_vehicle()[0].name == "mine"


SURGE = 0.45


def flown(**changes: Any) -> Any:
    time = np.arange(0.0, 10.0, 0.01)
    zero = np.zeros_like(time)
    log = {"time_s": time, "altitude_m": zero, "altitude_setpoint_m": zero}
    log |= {f"{axis}{kind}_rad": zero for axis in ("roll", "pitch") for kind in ("", "_setpoint")}
    roll = SimpleNamespace(overshoot_percent=changes.pop("overshoot", 0.0), oscillation_rad=changes.pop("swing", 0.0))
    run = SimpleNamespace(outcome="completed", reason="", log=log | changes.pop("log", {}), metrics={"roll": roll})
    for key, value in changes.items():
        setattr(run, key, value)
    return run


@pytest.mark.parametrize(
    ("name", "changes", "said"),
    [
        ("hover", {}, ""),
        ("hover", {"outcome": "diverged", "reason": "at 3 s"}, "diverged, at 3 s"),
        ("hover", {"log": {"roll_rad": np.radians(np.linspace(0.0, 3.0, 1000))}}, "roll swings by 3.0 deg, 1 at most"),
        ("doublet", {"overshoot": 17.0}, ""),
        ("doublet", {"overshoot": 49.0}, "overshoot of 49 %, 8 % promised"),
        ("doublet", {"swing": 0.05}, "roll still swings by 2.9 deg"),
        ("gust", {"log": {"pitch_rad": np.full(1000, 0.5)}}, "pitch goes 29 deg off, 25 at most"),
        ("gust", {"log": {"altitude_m": np.full(1000, 3.0)}}, "3.0 m off its height, 2 at most"),
    ],
)
def test_what_a_flight_does_that_was_not_promised(name: str, changes: dict[str, Any], said: str) -> None:
    assert describe_fault(name, flown(**dict(changes)), 0.08, 1.0).startswith(said)
    assert bool(describe_fault(name, flown(**dict(changes)), 0.08, 1.0)) == bool(said)
    if "log" in changes and name == "gust":
        assert describe_fault(name, flown(**dict(changes)), 0.08, CORNER_FACTOR) == ""


OVERSHOOT_AND_BACK = "lag=0.15,delay=0.048,over=0.1,over_s=4"


@pytest.mark.parametrize(
    ("name", "made_of"),
    [
        ("overshoots", OVERSHOOT_AND_BACK),
        pytest.param("creeps", "lag=0.15,delay=0.048,over=-0.5,over_s=8", marks=pytest.mark.long),
        pytest.param("overshoots-by-half", "lag=0.15,delay=0.048,over=0.5,over_s=4", marks=pytest.mark.long),
        pytest.param("leads", "lag=0.12,lag2=0.05,zero=0.35", marks=pytest.mark.long),
    ],
)
def test_an_engine_with_a_zero_beside_a_slow_pole_is_designed_for(name: str, made_of: str, place: Path) -> None:
    """Its delay at low frequency is below 0, or tells nothing of a loop: no measure of what a loop can be."""
    made = quick(foreign(place, name, made_of), lead=True)
    assert made.ok, made.reason
    roll = made.axes["roll"]
    assert roll.after is not None
    # the fast part of each alone: its lags that no zero takes away, its dead time, the gyro and a hold
    assert 0.02 < roll.channel.time_scale_s < 0.25
    assert (roll.channel.slowness_s > 2.0) if name == "creeps" else (roll.channel.slowness_s < 0.0)
    assert proving._check_loops_with_engine(made, made.engine_dynamics).reason == ""
    for flight, table in flying.flight_tables(made).items():
        assert flying.fly_corner(made, flight, table, 1.0, 0).fault == "", flight
    words = [line for line in summary_lines(made) if "where a loop is closed" in line]
    assert len(words) == 1


def test_an_engine_that_warms_up_is_designed_for_or_refused_in_a_line(place: Path) -> None:
    """Its lag is three times as long from 45 s on, in the middle of the sweep: no linear model has both."""
    made = quick(foreign(place, "warms", "lag=0.15,delay=0.048,warm=0.45,warm_s=45"))
    assert made.ok or made.reason
    assert made.engine_dynamics.misfit > 0.01
    assert "for every engine that differs from the model" in " ".join(summary_lines(made))


@pytest.mark.parametrize(
    "made_of", ["lag=0.00001", "lag=0.00001,delay=0.1", "lag=0.12,lag2=0.12,delay=0.02", "lag=0.05,more=5,more_s=0.05"]
)
def test_what_is_no_lag_is_a_model_all_the_same(made_of: str, place: Path) -> None:
    """A gain, a delay, two equal lags and six of them: sampled, closed and followed in time."""
    scenario, vehicle = making._scenario(str(foreign(place, "odd", made_of)), "hexjet", ["engine_unchecked=true"])
    spec = load_engine(scenario.engine, {}, STEP, unchecked=True)
    dynamics = making.make_dynamics(making.identify_hover(scenario, vehicle, spec, None))
    roll = channels(scenario, vehicle, spec, Actuator.of("odd", dynamics))["roll"]
    for channel in (roll, roll.with_delay(roll.actuator_delay + 0.4), roll.with_lags(0.7), roll.with_lags(0.0)):
        closed = ClosedLoop(FrequencyGrid(channel), making.shipped_tuning(channel, vehicle, spec))
        assert np.isfinite(closed.steps.angle).all()
        assert closed.unstable_poles >= 0


def test_an_engine_that_is_told_of_changes_alone_is_swept_by_more_where_asked(place: Path) -> None:
    """A throttle that is passed on in steps of 1.5 %: half a per cent moves nothing, and the way out is named."""
    path = str(foreign(place, "told", "lag=0.15,delay=0.048,delta=0.015"))
    scenario, vehicle = making._scenario(path, "hexjet", ["engine_unchecked=true"])
    spec = load_engine(path, {}, STEP, unchecked=True)
    with pytest.raises(
        InputError, match=r"does not answer the throttle around 0\.45\d*; raise amplitude \(now 0\.005\)"
    ):
        making.identify_hover(scenario, vehicle, spec, None)
    found = making.identify_hover(scenario, vehicle, spec, 0.15)
    assert found.chosen.model.delay_samples == pytest.approx(12.0, abs=6.0)


def test_what_is_the_same_of_several_axes_is_said_once(sound: Design) -> None:
    """Also what limits roll: one line, with the bandwidth and what each limit's absence gives."""
    limited = replace(sound.axes["roll"], limits={"delay": 0.5, "noise": 100.0})
    lines = summary_lines(replace(sound, axes={**sound.axes, "roll": limited}))
    said = [line.partition(": ")[2] for line in lines if " for gain " in line or " for lags " in line]
    assert said
    assert len(said) == len(set(said))
    checks = {(axis, what) for axis, each in sound.axes.items() for what in each.checks}
    told = {(axis, said) for line in lines if ": stable for " in line
            for names, _, said in [line.partition(": stable for ")] for axis in names.split(", ")}  # fmt: skip
    assert told == checks
    (bandwidth,) = [line for line in lines if line.startswith("roll: bandwidth ")]
    assert "limited most by noise: without delay the same, without noise 100.00 Hz (+" in bandwidth
