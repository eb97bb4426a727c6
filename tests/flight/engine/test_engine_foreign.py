"""Engines of other people's tools: blemished, source only, started, noisy, of integers, with constants."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet
from engine_tools import STEP
from foreign_engines import (
    FULL,
    IGNITION,
    KINDS,
    MODE,
    MODES,
    POWER,
    PULSE,
    PULSE3,
    VALVE,
    force,
    foreign,
    lever,
    mapped,
)
from places import ROOT

from cosim import Scenario, check_engine, fly
from cosim.base.errors import InputError
from cosim.base.signals import Ambient
from cosim.base.storage.toml import parse_setting
from cosim.engine import EngineBank, EngineSpec, check_fmu, load_engine
from cosim.engine.fmu.air import Air
from cosim.engine.fmu.archive import read_archive, validate
from cosim.engine.fmu.description import is_harmless_violation
from cosim.engine.response import note_flat_ends
from cosim.results.log.digest import log_digest
from cosim.simulation.build import build
from cosim.simulation.delay_ledger import LedgerRow, make_delay_ledger, select_axis
from cosim.spec.vehicle import load_vehicle


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("foreign")


def of_kind(name: str, folder: Path) -> Path:
    """An engine of a kind; the path by which it is named: the mapping file where there is one."""
    of, rows, fmi, lines, change = KINDS[name]
    path = foreign(folder, name, of, rows, fmi, change, MODES[fmi] if "modes" in of else "")
    return mapped(path, *lines) if lines else path


SWITCH = ("valve", "valve", "input", 'Boolean: start="false"')
BLEMISHED = {
    "unit": (('unit="N"', 'unit="kgf"'), 'The unit "kgf" of variable "thrust"'),
    "display unit of no unit": (('unit="N"', 'unit="kgf" displayUnit="lbf"'), 'The unit "kgf" of variable "thrust"'),
    "variability": ((' variability="discrete"', ""), 'The variable "valve" \\(line '),
    "no start": (('max="1" start="0"', 'max="1"'), r'Variable "throttle" .* has no start value'),
    "date": (('modelName="foreign"', 'modelName="foreign" generationDateAndTime="today"'), "'today' is not a valid"),
    "own attribute": (('<CoSimulation ', '<CoSimulation hasWings="true" '), "'hasWings' is not allowed"),
}  # fmt: skip


@pytest.mark.parametrize("what", BLEMISHED)
def test_a_blemish_that_no_step_depends_on_is_listed_and_read_over(what: str, place: Path) -> None:
    change, said = BLEMISHED[what]
    archive = read_archive(foreign(place, "blemished", "lag=0.2", [lever(), force(), SWITCH], change=change))
    assert any(re.search(said, text) for text in archive.harmless_violations)
    assert all(is_harmless_violation(text) for text in archive.harmless_violations)
    assert archive.thrust.name == "thrust"
    assert archive.ports["thrust"].scale == (9.80665 if "kgf" in change[1] else 1.0)


def test_dependencies_are_nobodys_business_here(place: Path) -> None:
    """Checked by the trial, beyond what reading checks; no step looks at them."""
    right = '<Outputs><Unknown index="2"/>'
    wrong = right.replace('"/>', '" dependencies="1" dependenciesKind="fixed fixed"/>')
    complaints = validate(foreign(place, "dependencies", "lag=0.2", change=(right, wrong)).read_bytes())
    assert complaints
    assert all(is_harmless_violation(text) for text in complaints)


DANGEROUS = {
    "a name for two": (('name="valve"', 'name="throttle"'), 'The variable name "throttle" .*is not unique'),
    "no reference": (('name="valve" valueReference="7"', 'name="valve"'), "'valueReference' is required but missing"),
    "a reference that is none": (('valueReference="7"', 'valueReference="many"'), "'many' is not a valid value"),
    "no type": (('<Boolean start="false"/>', ""), "Missing child element"),
    "unknown force": (('unit="N"', 'unit="furlong"'), "its thrust is in furlong, which the FMU does not define"),
    "a step that is no number": (('<CoSimulation ', '<CoSimulation maxOutputDerivativeOrder="x" '), "'x' is not a valid"),
}  # fmt: skip


def refusal(call: Callable[..., object], *given: Any) -> str:
    """The one line of what is refused."""
    with pytest.raises(InputError) as caught:
        call(*given)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("what", DANGEROUS)
def test_what_decides_which_number_is_read_is_refused(what: str, place: Path) -> None:
    change, said = DANGEROUS[what]
    path = foreign(place, "dangerous", "lag=0.2", [lever(), force(), SWITCH], change=change)
    assert re.search(said, refusal(read_archive, path))


def test_a_blemished_engine_is_fit_and_flies_with_a_warning(place: Path, hexjet: Hexjet) -> None:
    """In the trial of every foreign engine too, which the flight makes."""
    path = foreign(place, "blemished-flight", "lag=0.1,delay=0.02", change=('unit="N"', 'unit="newton"'))
    asked = "--controller baseline --set duration_s=1.0 --out run --json"
    done = hexjet("fly", "hover", "--engine", str(path), *asked.split())
    assert json.loads(done.out)["outcome"] == "completed", done.err
    blemish = 'blemish in its description, of no effect on stepping: The unit "newton" of variable "thrust"'
    assert f"{path}: {blemish}" in done.err


def load(path: Path, *lines: str) -> EngineSpec:
    return load_engine(str(mapped(path, *lines) if lines else path), {}, STEP, unchecked=True)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_throttle_in_whole_numbers_moves_in_their_steps(fmi: int, place: Path) -> None:
    """1000 to 2000 microseconds: thrust at rest is that of the nearest whole one."""
    spec = load(foreign(place, f"pulses{fmi}", "lag=0.02,pulse=1", [PULSE if fmi == 2 else PULSE3, force()], fmi))
    assert spec.archive.throttle.name == "esc_us"
    assert any("1000 steps" in note for note in spec.archive.port_notes)
    with EngineBank(spec, 1, STEP) as bank:
        for share in (0.0, 0.5, 0.50049, 0.50051, 1.0):
            assert bank.reset(share).thrust[0] == pytest.approx(FULL * round(1000.0 * share) / 1000.0, abs=1e-7)


def test_a_switch_is_no_throttle(place: Path) -> None:
    row = ("throttle", "throttle", "input", 'Integer: min="0" max="1" start="0"')
    with pytest.raises(InputError, match="a throttle needs 20 steps at least"):
        load(foreign(place, "switch", "lag=0.02", [row, force()]))


@pytest.mark.parametrize(
    ("row", "held"), [(VALVE, "'fuel.valve' = 1.0"), (VALVE, "fuel.valve = 1"), (POWER, "power_available = true")]
)
def test_an_input_is_held_at_what_the_mapping_file_says(row: tuple[str, ...], held: str, place: Path) -> None:
    path = foreign(place, "valve", "lag=0.05,valve=1", [lever(), force(), row])  # type: ignore[list-item]
    with pytest.raises(InputError, match=r"does not answer the throttle .* \[inputs\]"):
        load(path)
    assert load(path, "[inputs]", held).curve.thrust[-1] == pytest.approx(FULL)


WRONG_INPUTS = {
    "no = 1.0": r"no input is called no \(there are: throttle, fuel.valve, mode\)",
    "throttle = 1.0": "throttle is its port throttle",
    "'fuel.valve' = 2.0": "must be a number from 0 to 1",
    "'fuel.valve' = true": "it is of type Real; a number goes here",
    "mode = 'running'": "allowed: off, crank, run",
    "mode = 7": r"allowed: off \(0\), crank \(1\), run \(2\)",
}


@pytest.mark.parametrize("held", WRONG_INPUTS)
def test_an_input_that_cannot_be_held_is_refused(held: str, place: Path) -> None:
    path = foreign(place, "wrong-inputs", "lag=0.05", [lever(), force(), VALVE, MODE], types=MODES[2])
    assert re.search(WRONG_INPUTS[held], refusal(load, path, "[inputs]", held))
    with pytest.raises(InputError, match=r"fuel.valve is an input, which a mapping file holds under \[inputs\]"):
        load_engine(str(path), {"fuel.valve": 1.0}, STEP, unchecked=True)


CHOICE = ("choice", "valve", "parameter", 'Enumeration: declaredType="Mode" start="0"')


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_parameter_of_an_enumeration_is_set_by_the_name_of_its_item(fmi: int, place: Path) -> None:
    """Or by its number; what a check measured with is in its report."""
    path = foreign(place, f"choice{fmi}", "lag=0.05,valve=1", [lever(), force(), CHOICE], fmi, types=MODES[fmi])
    for line in ("choice = 'crank'", "choice = 1"):
        assert load(path, "[parameters]", line).curve.thrust[-1] == pytest.approx(FULL)
    report = check_engine(path, settings=["choice=crank"]).check
    assert report.problems == []
    assert [(each["start"], each["value"]) for each in report.parameters] == [(0.0, "crank")]
    assert dict(report.lines())["parameter"] == "choice = crank"


SCALE = ("scale", "gain", "parameter", 'start="1" max="3"')
DECK = ("deck", "runs", "parameter", 'String: start="deck.csv"')
WRONG_PARAMETERS = {
    "choice = 'hot'": r"x.fmu: choice = 'hot': allowed: off, crank, run$",
    "choice = 7": r"x.fmu: choice = 7: allowed: off \(0\), crank \(1\), run \(2\)$",
    "choice = 0.5": r"x.fmu: choice = 0.5: allowed: off \(0\), crank \(1\), run \(2\)$",
    "scale = 'much'": r"x.fmu: scale = 'much': allowed: a number, because it is no enumeration$",
    "scale = true": r"x.fmu: scale = True: it is of type Real; a number goes here$",
    "scale = [1.0]": "x.toml: parameters.scale: must be a finite number, true, false or a text$",
    "scale = nan": "x.toml: parameters.scale = nan: must be a finite number, true, false or a text$",
    "scale = 4": r"x.fmu: scale = 4: must be a number from -inf to 3$",
    "deck = 'other.csv'": r"x.fmu: deck is a parameter of type String, which cannot be set; allowed: choice, scale$",
    "thrust = 1.0": r"x.fmu: thrust is of causality output, and no parameter; allowed: choice, scale$",
}


@pytest.mark.parametrize("line", WRONG_PARAMETERS)
def test_a_parameter_that_cannot_be_set_is_refused_with_what_can(line: str, place: Path) -> None:
    path = foreign(place, "x", "lag=0.05,valve=1", [lever(), force(), CHOICE, SCALE, DECK], types=MODES[2])
    assert re.search(WRONG_PARAMETERS[line], refusal(load, path, "[parameters]", line))


def test_states_that_cannot_be_saved_prevent_no_flight(place: Path) -> None:
    """No flight saves one: an engine that says that it can, and returns an error, is fit."""
    claims = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true" canHandleVariable'
    path = foreign(place, "states", "lag=0.05", change=("canHandleVariable", claims))
    assert check_fmu(str(path)).problems == []


def test_an_engine_is_warmed_up_before_anything_is_asked_of_it(place: Path) -> None:
    """Ignition held from the beginning lights it within 12 s: every instance, and the flight begins behind that."""
    path = foreign(place, "lit", "lag=0.1,start=12", [lever(), force(), IGNITION])
    with pytest.raises(InputError, match="does not answer the throttle within 10 s; an engine that has to be started"):
        load(path)
    spec = load(path, "[inputs]", "ignition = true", "[start]", "warm_up_s = 13.0")
    assert spec.curve.thrust[-1] == pytest.approx(FULL)
    assert spec.settling_window < 100  # the start is no dead time
    with EngineBank(spec, 2, STEP) as bank:
        assert bank.reset(0.4).thrust == pytest.approx((8.0, 8.0))
        up = [bank.step(k, (1.0, 0.4)).thrust for k in range(25)]
    assert up[-1] == pytest.approx((FULL - 12.0 * math.exp(-1.0), 8.0), rel=1e-6)  # 0.1 s after the flight's first step


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            "[start]\nsequence = []",
            "start.sequence: the start of an engine in stages left in version 0.3.0; use [inputs]",
        ),
        ("[ports]\nthrust = 'F*'", "several engines in one FMU left in version 0.3.0; use one FMU for each"),
        ("[ports]\nthrust = ['F1', 'F2']", "several engines in one FMU left in version 0.3.0"),
    ],
)
def test_a_mapping_that_names_what_left_is_answered_in_one_line(lines: str, said: str, place: Path) -> None:
    told = refusal(load, foreign(place, "left", "lag=0.1"), *lines.split("\n"))
    assert said in told
    assert lines[1:].startswith("start") or "ports.thrust" in told


def test_a_scenario_of_version_0_2_flies_if_its_engines_start_before_the_flight() -> None:
    table = {"name": "old", "duration_s": 1.0, "engine_start": "before flight"}
    assert Scenario.from_table(table, ROOT, "test").duration_s == 1.0
    with pytest.raises(InputError, match=r"engine_start: the start of engines in flight left in version 0\.3\.0"):
        Scenario.from_table(table | {"engine_start": "in flight"}, ROOT, "test")


def test_a_thrust_that_never_stands_still_flies_with_a_stated_rest(place: Path) -> None:
    """Noise of 0.25 % of full thrust: refused with the number to write, then measured by its mean."""
    path = foreign(place, "noisy", "lag=0.1,delay=0.04,noise=0.0025", [lever(), force()])
    told = refusal(load, path)
    written = re.search(r"still moves by 0\.\d+ N; .* counts as still: \[rest\] (thrust = 0\.\d+)", told)
    assert written is not None, told
    spec = load(path, "[rest]", written[1])
    for throttle, thrust in zip(*spec.curve, strict=True):
        assert thrust == pytest.approx(FULL * throttle, abs=0.004 * FULL)  # of the mean: a tenth of rest, and noise
    with EngineBank(spec, 1, STEP) as bank:
        bank.reset(0.5)


def test_sign_and_gross_thrust(place: Path) -> None:
    """Thrust that is negative backwards, and one with ram drag beside it; never guessed."""
    backwards = foreign(place, "backwards", "lag=0.05,sign=-1")
    assert load(backwards, "[scale]", "thrust = -1.0").curve.thrust[-1] == pytest.approx(FULL)
    rows = [lever(), force("Fg", "gross"), force("Fram", "drag")]
    gross = foreign(place, "gross", "lag=0.05,drag=2.5", rows)
    assert load(gross, "[ports]", "thrust = 'Fg'").curve.thrust[-1] == pytest.approx(FULL + 2.5)
    net = load(gross, "[ports]", "thrust = 'Fg'", "ram_drag = 'Fram'")
    assert net.curve.thrust[-1] == pytest.approx(FULL)
    with EngineBank(net, 1, STEP) as bank:
        assert bank.reset(0.25).thrust[0] == pytest.approx(0.25 * FULL)


def test_the_air_in_other_words(place: Path) -> None:
    """Against the tables of ISO 2533, and in the loop against Python: an engine that lives of density and Mach number."""
    for height, pressure, temperature, density in (  # geopotential; ISO 2533:1975, table 1
        (0.0, 101325.0, 288.15, 1.225), (2000.0, 79501.4, 275.15, 1.00655), (11000.0, 22632.0, 216.65, 0.363918),
        (15000.0, 12044.6, 216.65, 0.193674),
    ):  # fmt: skip
        derived = Air(pressure, temperature, 0.0).derive()
        assert derived["altitude"] == pytest.approx(height, abs=1.0)
        assert derived["density"] == pytest.approx(density, rel=2e-5)
    fast = Air(101325.0, 288.15, 340.294).derive()  # the speed of sound there
    assert fast["mach"] == pytest.approx(1.0, rel=1e-5)
    assert fast["total_pressure"] == pytest.approx(101325.0 * 1.2**3.5)  # 1.892929 at Mach 1
    assert fast["total_temperature"] == pytest.approx(1.2 * 288.15)
    rows = [lever(), force(), ("Mn", "mach", "input", 'start="0"'), ("rho", "density", "input", 'unit="kg/m3" start="1"'),
            ("alt", "altitude", "input", 'unit="m" start="0"'), ("h", "altitude", "output", 'unit="m"')]  # fmt: skip
    spec = load(
        foreign(place, "deck", "lag=0.02,air=1", rows), "[ports]", "mach = 'Mn'", "density = 'rho'", "altitude = 'alt'"
    )
    assert {"mach", "density", "altitude"} <= set(spec.ports)
    air = Air(79501.4, 275.15, 100.0)
    derived = air.derive()
    with EngineBank(spec, 1, STEP) as bank:
        bank.reset(1.0)
        for k in range(200):
            thrust = bank.step(k, (1.0,), Ambient(air.pressure, air.temperature, (air.speed,))).thrust[0]
        height = bank._instances[0].read(next(v for v in spec.archive.outputs if v.name == "h"))
    assert thrust == pytest.approx(FULL * derived["density"] / 1.225 * (1.0 - 0.3 * derived["mach"]), rel=1e-9)
    assert height == pytest.approx(2000.0, abs=1.0)


@pytest.mark.parametrize(("made_of", "ends"), [("flat=0.9", (0.0, 0.9)), ("lag=0.1", (0.0, 1.0))])
def test_a_throttle_that_does_nothing_at_its_end_is_not_used_there(
    made_of: str, ends: tuple[float, float], place: Path
) -> None:
    spec = load(foreign(place, "flat", made_of))
    assert (spec.rising_curve.throttle[0], spec.rising_curve.throttle[-1]) == ends
    assert bool(note_flat_ends(spec.curve)) == (ends != (0.0, 1.0))


@pytest.mark.parametrize("key", ["engine_parameters.emf.k", "stations.3.parameters.emf.k", "engine_parameters.'emf.k'"])
def test_a_dotted_name_goes_behind_set(key: str) -> None:
    path, value = parse_setting(f"{key}=1.1")
    assert (path[-1], value) == ("emf.k", 1.1)
    assert path[:-1] == key.split(".")[: 1 if key.startswith("engine") else 3]


def test_a_flight_without_a_model_names_the_one_command(place: Path) -> None:
    path = foreign(place, "nobody-knows", "lag=0.1,delay=0.04")
    with pytest.raises(InputError, match=r"hexjet design --engine .*nobody-knows\.fmu --out hexjet-nobody-knows\.toml"):
        fly(Scenario.load("roll-doublet").replace(engine=str(path), engine_unchecked=True))


def test_every_kind_is_read_and_measured_or_refused_in_one_line(tmp_path: Path) -> None:
    """Those that cannot be flown as they are say what is missing."""
    said = {}
    for kind in KINDS:
        path = of_kind(kind, tmp_path)
        try:
            said[path.stem] = load_engine(str(path), {}, STEP, unchecked=True).name
        except InputError as error:
            said[path.stem] = str(error)
    assert len(said) >= 40
    assert not any("\n" in text for text in said.values())
    refused = {name: text for name, text in said.items() if text != name}
    assert set(refused) == {"furlong", "hunts", "noisy-unsaid", "never-lit"}
    assert "[start], [inputs]" in refused["never-lit"]
    assert all("[rest] thrust" in refused[name] for name in ("hunts", "noisy-unsaid"))
    assert max(len(each[3]) for each in KINDS.values()) <= 5  # and the one that names the FMU


HOVER = Scenario.load("hover").replace(controller="baseline", engine_unchecked=True, duration_s=0.1, expect=[])


@pytest.mark.parametrize("kind", ["undeclared-unit", "power", "pulses", "ignition", "noisy"])
def test_six_lines_of_mapping_make_it_fly(kind: str, tmp_path: Path) -> None:
    """Blemished, with a constant input, a throttle in whole numbers, a warm-up, noise: as each is, and hovers."""
    path = of_kind(kind, tmp_path)
    assert path.suffix == ".fmu" or len(path.read_text().splitlines()) <= 6
    run = fly(HOVER.replace(engine=str(path), duration_s=0.4, sensor_noise=False))
    assert run.outcome == "completed", run.reason
    total = sum(run.log[f"thrust_{jet}_N"].mean() for jet in range(1, 7))
    assert total == pytest.approx(9.81 * run.log["mass_kg"][0], rel=0.02)


def test_the_delay_ledger_has_what_was_measured(place: Path, tmp_path: Path) -> None:
    """A library engine under a file's name, of which nothing is stated: the same rows; else what its parts add up to."""
    vehicle = load_vehicle("hexjet")[0]
    scenario = Scenario.load("hover")
    with build(scenario) as simulation:
        allocator = simulation.cascade.allocator

    def rows(engine: str) -> list[LedgerRow]:
        spec = load_engine(engine, {}, 0.004, unchecked=True)
        ledger = select_axis(make_delay_ledger(scenario, vehicle, [spec] * 6, allocator), "roll")
        return [row for row in ledger if row.owner.startswith("engine ")]

    copied = shutil.copy(load_engine("edf-as-flown", {}, 0.004).path, tmp_path / "mine.fmu")
    stated, measured = rows("edf-as-flown"), rows(str(copied))
    assert [row.samples for row in measured] == pytest.approx([row.samples for row in stated], rel=1e-6)
    assert all("measured with a small step" in row.element for row in measured)
    delay, lag = rows(str(foreign(place, "two-lags", "lag=0.2,lag2=0.08,delay=0.04")))
    assert delay.samples == 10.0
    # behind a hold of a step, thrust at its end: half a step less than the continuous lags, and the ledger's one more
    assert lag.samples == pytest.approx((0.2 + 0.08) / 0.004 + 0.5, abs=0.3)
    path = mapped(foreign(place, "stated", "lag=0.2,delay=0.04"), "[ledger]", "delay_s = 0.02")
    assert [row.samples for row in rows(str(path))] == pytest.approx([5.0, 5.0 + 0.2 / 0.004 + 0.5], abs=0.3)
    noisy = mapped(foreign(place, "restless", "lag=0.1,noise=0.0025"), "[rest]", "thrust = 0.5")
    assert [row.samples for row in rows(str(noisy))] == [None, None]  # 1 N of change, and half of it by itself


def test_further_outputs_are_in_the_log_by_name_and_unit(place: Path) -> None:
    """A gross thrust and its drag beside the net thrust: the same in a process of its own, bit for bit."""
    rows = [lever(), force("Fn"), force("Fg", "gross"), force("Fram", "drag")]
    lines = ("[ports]", "thrust = 'Fn'", "[log]", "gross_N = 'Fg'", "drag_N = 'Fram'")
    scenario = HOVER.replace(engine=str(mapped(foreign(place, "more", "lag=0.1,drag=0.5", rows), *lines)))
    run, apart = fly(scenario), fly(scenario.replace(engine_isolated=True))
    column = next(each for each in run.log.described if each.name == "gross_N_3")
    assert (column.unit, column.meaning) == ("N", "engine 3: Fg")
    assert run.log["gross_N_3"] == pytest.approx(run.log["thrust_3_N"] + run.log["drag_N_3"], abs=1e-12)
    assert run.log["drag_N_6"].min() > 0.0
    assert log_digest(run.log) == log_digest(apart.log)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("gross_N = 'thrus'", r"log.gross_N = 'thrus': no such output; .*thrust"),
        ("'1st' = 'thrust'", "a column's name is of letters"),
    ],
)
def test_an_output_that_cannot_be_logged_is_refused(line: str, said: str, place: Path) -> None:
    assert re.search(said, refusal(load, foreign(place, "logged", "lag=0.1"), "[log]", line))
