"""Figures on the pages that no command writes between marks: read from their sentences and found out again.

A sentence is given with ``{}`` for each figure.  It must be on the page once, so that a page which is rewritten tells,
and each figure must be what is found here, to its last printed digit.  What a README states of a vehicle or an engine
must be what its file says.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from engine_tools import NEWTON_PER_KGF, PAPER, STEP, Array, Driven, archive, driven
from places import DESIGNS, ROOT
from scipy.optimize import brentq
from stated_figures import NUMBER, defined, figures, last_digit, numbers, row_states, rows, stated, text, value

from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import read_toml
from cosim.campaign.analysis.statistics import wilson
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights
from cosim.campaign.study.study import Study
from cosim.campaign.surveys import faults as survival
from cosim.campaign.surveys import survey
from cosim.campaign.workers.flight_row import fly_one
from cosim.control.allocation import reallocation as replan
from cosim.engine import build_engines, library, load_engine, response
from cosim.engine.fmu import container
from cosim.engine.fmu.uncertainty import CUT
from cosim.engine.qualify import check, trial
from cosim.identify.sweep import Identification, identify_axis
from cosim.identify.sweep.fit import fit
from cosim.identify.sweep.result import low_frequency_delay, rate_response
from cosim.results.report.marks import page_parts, parts_of
from cosim.simulation.build import build as build_flight
from cosim.simulation.controllers.controller_file import Requirements
from cosim.simulation.delay_ledger import select_axis, sum_samples
from cosim.spec.scenario import DoubletCommand, Scenario
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.atmosphere import standard_air

G = 9.80665


# --- docs/paper.md, docs/design.md -------------------------------------------------------------------------------


def test_the_papers_doublet_as_it_is_flown() -> None:
    page = "docs/paper.md"
    doublet = Scenario.load("roll-doublet")
    (command,) = doublet.command
    sentence = (
        "by `make demo`: {} deg of roll one way and the other, here with EDF engines and {} samples of added delay"
    )
    stated(page, sentence, getattr(command, "amplitude", math.nan), delay("edf-as-flown") - delay("edf"))
    # the largest gain that settles is among the numbers that `hexjet paper` fits
    fitted = tomllib.loads((ROOT / "tools" / "hexjet_paper" / "calibration.toml").read_text(encoding="utf-8"))[
        "parameters"
    ]
    ours = load_vehicle("hexjet")[0].control.rate.roll.p
    (percent,) = figures(page, "some {} % above the largest with which the vehicle settles")
    assert 100.0 * (ours / fitted["hexjet_p"] - 1.0) == pytest.approx(value(percent), abs=2.0)


def test_pages_without_a_result() -> None:
    """They state versions and times of a command; a figure of a flight would need a test."""
    for page in ("fmus/README.md", "benchmarks/README.md"):
        assert not re.search(r"\d\.\d+ (?:ms|us|m|deg|rad|%)", text(page)), page


# --- docs/identification.md ------------------------------------------------------------------------------------------

IDENTIFICATION = "docs/identification.md"


def delay(name: str) -> int:
    """Samples of transport delay that an engine of the library states."""
    variables = library.read_engine(data_folder("engines") / name).variables
    return int(next(v.start for v in variables if v.name == "delay_samples") or 0)


def printed(command: str) -> list[list[str]]:
    """What the page shows of a command: its lines as words."""
    page = (ROOT / IDENTIFICATION).read_text(encoding="utf-8")
    (block,) = re.findall(rf"^```\n\$ {re.escape(command)}\n(.*?)^(?:```|\$)", page, re.MULTILINE | re.DOTALL)
    return words(block)


def words(block: str) -> list[list[str]]:
    lines = [re.sub(r"[()=^,:±]", " ", line).split() for line in block.splitlines()]
    return [line for line in lines if line and "─" not in line[0] and line[0] not in ("report", "model")]


@pytest.mark.parametrize("command", ["hexjet identify engine turbojet", "hexjet identify roll --out roll-model"])
def test_identification_prints_what_the_page_shows(
    command: str, hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Words alike, and figures to a unit of the last digit; of those that are rounding errors that they are."""
    monkeypatch.setenv("COLUMNS", "120")
    done = hexjet(*command.split()[1:])
    assert done.status == 0
    now, then = words(done.out), printed(command)
    assert [len(line) for line in now] == [len(line) for line in then]
    for found, said in zip(chain(*now), chain(*then), strict=True):
        if re.fullmatch(NUMBER, said) and re.fullmatch(NUMBER, found):
            rounding = 1e-9 if abs(float(said)) < 1e-9 else 0.0
            assert float(found) == pytest.approx(float(said), abs=1.0001 * last_digit(said) + rounding), said
        else:
            assert found == said


@pytest.fixture(scope="module")
def roll() -> tuple[Identification, Identification]:
    """With noise and without."""
    return identify_axis("roll"), identify_axis("roll", settings=("sensor_noise=false",))


def test_what_identification_says_about_the_hexjet(roll: tuple[Identification, Identification]) -> None:
    noisy, clean = roll
    page = IDENTIFICATION
    one, held, two = noisy.fits
    long, short = (sorted((1e3 * lag for lag in each.fits[2].model.lags), reverse=True) for each in roll)
    stated(page, "fit the response to {} %, noise included. They come out as {} and {} ms ({} and {} ms without sensor "
           "noise), {} ms ({} ms) together, and delay, lags and half a hold add up to what the [delay ledger]"
           "(design.md#time) states, {} samples", 100.0 * two.misfit, *long, *short, sum(long), sum(short),
           low_frequency_delay(two))  # fmt: skip
    assert noisy.ledger_samples == pytest.approx(low_frequency_delay(two), abs=0.05)
    paper = 433.1
    stated(page, "It gives {} ms, and a gain of {} rad/s², {} % high", 1e3 * held.model.lags[0], held.model.gain,
           100.0 * (held.model.gain / paper - 1.0))  # fmt: skip
    lag = fit(noisy.response, 1, "held", {"lag_s": 0.03895})
    stated(page, "(`--hold lag_s=0.03895`) gives a delay of {} samples", lag.model.delay_samples)
    stated(page, "between lag and delay: {} ms and {} samples", 1e3 * one.model.lags[0], one.model.delay_samples)
    vehicle, _ = load_vehicle("hexjet")
    stated(page, "two lags, {} ms in the engine and {} ms in the gyro's filter", -4.0 / math.log(PAPER["edf"][1]),
           1e3 * vehicle.sensors.gyro.filter_s)  # fmt: skip
    late = low_frequency_delay(clean.fits[2])
    stated(page, "vehicle's delay is {} samples ({} ms) less than that of the paper's G(z), {} against {};",
           papers_delay() - late, 4.0 * (papers_delay() - late), late, papers_delay())  # fmt: skip
    hertz, _, degrees = deviation(clean)
    (agree,) = figures(page, "around {} Hz the two agree")
    assert np.interp(0.0, -degrees[hertz > 3.0], hertz[hertz > 3.0]) == pytest.approx(value(agree), abs=0.15)


def papers_delay() -> float:
    """Low-frequency delay of the paper's G(z), samples: of its zero, its lag, z^-25 and the held integral."""
    return 25.0 - 1.0 / (1.0 + 1.4538) + 1.0 / (1.0 - 0.9024) + 0.5


def deviation(found: Identification) -> tuple[Array, Array, Array]:
    """Frequency [Hz], magnitude [dB] and phase [deg] of the response over the paper's G(z)."""
    assert found.reference is not None
    ratio = found.response.value / rate_response(found.reference, found.response.hertz)
    return found.response.hertz, 20.0 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))


# --- docs/control-design.md ------------------------------------------------------------------------------------------


def test_what_a_design_is_asked_for() -> None:
    """The table of requirements has the defaults."""
    page, asked = "docs/control-design.md", Requirements()
    for name, number in {
        "peak sensitivity at the plant's input, attitude and rate loop closed": asked.max_sensitivity,
        "stable for delay and gain off together, either way": 100.0 * asked.delay_tolerance,
        "overshoot of a step": asked.max_overshoot * (100.0 if asked.max_overshoot < 1.0 else 1.0),
        "bandwidth of roll and pitch": asked.min_bandwidth_hz,
    }.items():
        row_states(page, name, number)
    assert asked.gain_tolerance == asked.delay_tolerance
    assert rows(page)["three standard deviations of noise in the command"][0].startswith("a quarter of")
    assert 3.0 * asked.noise_share == pytest.approx(0.25, abs=2e-4)
    lead = read_toml(DESIGNS / "p220.toml")["vehicle"]["control"]["lead"]["roll"]
    poles = "a pair of poles at {} rad/s with damping {}"
    stated(page, poles, lead["natural_rad_s"], lead["damping"])
    designs = {row[0]: row[1:] for row in (line.strip("| ").split(" | ") for line in page_parts(ROOT / page)["designs"].splitlines()[2:])}  # fmt: skip
    delay, bandwidth = 5, 6  # its columns
    stated(page, "With it there are {} Hz", value(numbers(designs["p220, hexjet-p220"][bandwidth])[0]))
    stated(page, "Why the turbojet's delay margin is {} ms", value(numbers(designs["turbojet, hexjet"][delay])[0]))


# --- the aircraft's READMEs ------------------------------------------------------------------------------------------

HEXJET = "aircraft/hexjet/README.md"


def test_every_function_on_the_way_exists() -> None:
    named = re.findall(r"\d+\. `([\w/]+\.(?:py|c)):([\w.]+)`", text("docs/tables/design.md"))
    assert len(named) > 50
    assert [f"{file}:{name}" for file, name in named if name not in defined(ROOT / file)] == []


def test_who_owns_the_delay() -> None:
    """The table is the ledger's of a flight as shipped."""
    with build_flight(Scenario.load("hover")) as simulation:
        rows = select_axis(simulation.ledger, "roll")
        ledger = [row for row in rows if row.element != "delay added to the roll output"]
    said = [cells for name, *cells in owners() if name != "sum"]
    assert [[f"{row.samples:.2f}", f"{4.0 * (row.samples or 0.0):.2f}"] for row in ledger] == [row[1:] for row in said]
    (total,) = [cells for name, *cells in owners() if name == "sum"]
    samples = sum_samples(ledger)
    assert samples is not None
    assert total[1:] == [f"{samples:.2f}", f"{4.0 * samples:.2f}"]
    stated(HEXJET, "The same count for the paper's G(z) gives {} samples", papers_delay())


def owners() -> Iterator[list[str]]:
    for line in (ROOT / HEXJET).read_text(encoding="utf-8").replace("**", "").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 4 and re.fullmatch(r"-?\d+\.\d\d", cells[2]):
            yield cells


def test_the_hexjets_numbers_are_its_files() -> None:
    vehicle, _ = load_vehicle("hexjet")
    control, pilot, sensors = vehicle.control, vehicle.control.pilot, vehicle.sensors
    servo, position, contact = vehicle.servo, vehicle.control.position, vehicle.contacts[0]
    assert servo is not None
    assert position is not None
    assert pilot is not None
    lx, ly, lz = vehicle.jets[0].position_m
    jxx, jyy, jzz = vehicle.inertia_kg_m2
    corners = np.abs([each.position_m for each in vehicle.contacts]).max(axis=0)
    for name, values in {
        "mass": [vehicle.mass_kg],
        "size": [2e3 * corners[0], 2e3 * corners[1], 2e3 * corners[2]],
        "L_y": [ly],
        "L_x": [lx],
        "L_z": [lz],
        "J_xx": [jxx],
        "J_yy, J_zz": [jyy, jzz],
        "servo lag, rate, range": [1e3 * servo.lag_s, servo.rate_limit_rad_s, math.degrees(servo.range_rad)],
        "span": [vehicle.aero.span_m],
        "drag areas": list(vehicle.aero.drag_area_m2),
        "rate damping": list(vehicle.aero.damping_n_m_s),
        "legs, hull points": [contact.spring_n_m, contact.damping_n_s_m],
        "gyro filter": [1e3 * sensors.gyro.filter_s],
        "gyro noise": [sensors.gyro.noise_rad_s],
        "attitude noise": [sensors.attitude.noise_rad],
        "GNSS": [
            sensors.gnss.position_noise_m, sensors.gnss.velocity_noise_m_s, 1.0 / (STEP * sensors.gnss.period_samples),
            STEP * sensors.gnss.latency_samples,
        ],
        "barometer": [sensors.barometer.noise_m],
        "rate gain, roll": [control.rate.roll.p, control.rate.roll.i, control.rate.roll.integral_limit],
        "attitude gain, roll": [control.attitude.gain_1_s[0]],
        "attitude rate limits": list(control.attitude.rate_limit_rad_s),
        "derivative filter": [1e3 * control.rate.roll.d_filter_s],
        "predictor tuning": [
            control.predictor.filter_s, control.predictor.observer_rad_s, control.predictor.model_observer_rad_s,
            control.predictor.disturbance_observer_rad_s,
        ],
        "position and velocity gains": [position.position_1_s, position.velocity_1_s],
        "catch-up speed, lean limit": [position.catch_up_m_s, math.degrees(position.lean_rad)],
        "position filter": [position.acceleration_noise_m_s15],
        "autopilot: speed, acceleration, jerk": [pilot.speed_m_s, pilot.acceleration_m_s2],
        "autopilot: climb, descent, landing": [pilot.climb_m_s, pilot.descent_m_s, pilot.land_m_s],
        "autopilot: turn rate, stick, heights, spool-up": [
            math.degrees(pilot.yaw_rate_rad_s), math.degrees(pilot.stick_lean_rad), pilot.takeoff_height_m,
            pilot.return_height_m, pilot.spool_s,
        ],
        "friction": [contact.friction_static, contact.friction_dynamic],
        "end of flight": [vehicle.limits.tilt_deg, vehicle.limits.rate_deg_s, vehicle.limits.touchdown_m_s],
        "throttle limits": [control.allocation.throttle_min, control.allocation.throttle_max],
    }.items():  # fmt: skip
        row_states(HEXJET, name, *values)


def test_where_the_hexjets_numbers_come_from() -> None:
    vehicle, _ = load_vehicle("hexjet")
    control, position, pilot = vehicle.control, vehicle.control.position, vehicle.control.pilot
    assert position is not None
    assert pilot is not None
    full = G * 0.2554 / (1.0 - 0.8748)
    mass, (jxx, jyy, jzz) = vehicle.mass_kg, vehicle.inertia_kg_m2
    gain = 6.0 * vehicle.jets[0].position_m[1] * full / jxx
    stated(HEXJET, "6 L_y T / J_xx = {} rad/s² per unit of throttle, the gain of the paper's G(z), with T = {} · {} / "
           "(1 - {}) = {} N", gain, G, 0.2554, 0.8748, full)  # fmt: skip
    stated(HEXJET, "radii of gyration of {} and {} mm beside {} mm about x",
           *(1e3 * math.sqrt(each / mass) for each in (jyy, jzz, jxx)))  # fmt: skip
    stated(HEXJET, "six times {} is the table's {} kg", full / G, 12.0)
    legs = [each for each in vehicle.contacts if each.kind == "leg"]
    stiffness, damping = sum(leg.spring_n_m for leg in legs), sum(leg.damping_n_s_m for leg in legs)
    stated(HEXJET, "{} mm of sink at rest, damping ratio about {} |", 1e3 * mass * G / stiffness,
           damping / 2.0 / math.sqrt(stiffness * mass))  # fmt: skip
    stated(HEXJET, "the roll lag of G(z) is {} ms, the EDF's {} ms", -4.0 / math.log(0.9024), -4.0 / math.log(0.8748))
    stated(HEXJET, "a climb loop of {} rad/s, a third of what {} s of delay would allow, height slower by {} |",
           control.altitude.velocity_1_s, delay("edf-as-flown") * STEP,
           control.altitude.velocity_1_s / control.altitude.position_1_s)  # fmt: skip
    stated(HEXJET, "chosen: {} Hz; the derivative gains are {}", 0.5 / math.pi / control.rate.roll.d_filter_s,
           control.rate.roll.d)  # fmt: skip
    lean = G * math.tan(position.lean_rad)
    stated(HEXJET, "{} deg give {} m/s², twice the pull of {} m/s of wind and {} m/s² together",
           math.degrees(position.lean_rad), lean, 8.0, pilot.acceleration_m_s2)  # fmt: skip
    pull = 0.5 * 1.225 * 8.0**2 * vehicle.aero.drag_area_m2[1] / mass
    assert lean / (pull + pilot.acceleration_m_s2) == pytest.approx(2.0, abs=0.2)
    stated(HEXJET, "lean of {} deg, and changes of lean that take a second",
           math.degrees(math.atan(pilot.acceleration_m_s2 / G)))  # fmt: skip
    assert pilot.acceleration_m_s2 / pilot.jerk_m_s3 == pytest.approx(1.0)
    stated(HEXJET, "recovers; a drop of {} m", vehicle.limits.touchdown_m_s**2 / 2.0 / G)
    # what a Smith predictor leaves
    attitude = control.attitude.gain_1_s[0]
    stated(HEXJET, "(K = {} rad/s², h T = {} s,", gain, delay("edf-as-flown") * STEP)
    stated(HEXJET, "{} % of throttle costs {} degrees", 1.0,
           math.degrees(gain * delay("edf-as-flown") * STEP * 0.01 / attitude))  # fmt: skip
    stated(HEXJET, "the model's pole is {} and not 1, the offset fades with a time constant of {} s", 0.9999,
           STEP / (1.0 - 0.9999))  # fmt: skip


QUADROTOR = "aircraft/quadrotor/README.md"


def test_the_quadrotors_numbers_are_its_files() -> None:
    vehicle, _ = load_vehicle("quadrotor")
    motor = {v.name: v.start or 0.0 for v in library.read_engine(data_folder("engines") / "motor").variables}
    thrust = motor["newton_per_unit"] * motor["gain"] / (1.0 - motor["pole"])
    position = vehicle.control.position
    assert position is not None
    x, _, z = vehicle.jets[0].position_m
    jxx = vehicle.inertia_kg_m2[0]
    gain, damping = 4.0 * x * thrust / jxx, vehicle.aero.damping_n_m_s[0]
    row_states(QUADROTOR, "mass, payload", 1e3 * vehicle.mass_kg)
    row_states(QUADROTOR, "full thrust", thrust)
    row_states(QUADROTOR, "rotor places", 1e3 * x, 1e3 * z)
    row_states(QUADROTOR, "J_xx = J_yy", jxx)
    row_states(QUADROTOR, "roll and pitch damping", damping)
    row_states(QUADROTOR, "motor lag, delay", -2.5 / math.log(motor["pole"]), motor["delay_samples"])
    row_states(QUADROTOR, "position and velocity gains", position.position_1_s, position.velocity_1_s)
    stated(QUADROTOR, "chosen: thrust to weight {} |", 4.0 * thrust / vehicle.mass_kg / G)
    stated(QUADROTOR, "{} · {} m · {} N / J_xx = {} rad/s² per unit command", 4.0, x, thrust, gain)
    stated(QUADROTOR, "derived: {} 1/s times J_xx", damping / jxx)
    stated(QUADROTOR, "derived: with {} and {} above", gain, damping / jxx)
    stated(QUADROTOR, "P near {} gives", vehicle.control.rate.roll.p)
    stated(QUADROTOR, "of the roll loop's {} 1/s", vehicle.control.attitude.gain_1_s[0])
    stated(QUADROTOR, "on a quadrotor of {} g before it flies", 1e3 * vehicle.mass_kg)
    poles = np.log(np.roots([1.0, -1.8770, 0.8786])) / 0.0025
    stated(QUADROTOR, "poles at {} and {} rad/s, gain at rest {}, and a zero", *sorted(poles, reverse=True),
           (-0.7549 + 0.9393) / (1.0 - 1.8770 + 0.8786))  # fmt: skip


# --- docs/engine-check.md, docs/own-engine.md ------------------------------------------------------------------------

CHECK = "docs/engine-check.md"


def test_what_a_check_of_an_engine_does_and_allows() -> None:
    stated(
        CHECK,
        "{} s under a throttle that jumps between {} values",
        trial.RUN_S,
        len({trial.zigzag_throttle(k) for k in range(100)}),
    )
    stated(CHECK, "static thrust at {} throttles", response.CURVE_POINTS)
    stated(
        CHECK,
        "{} and {} steps | {} bytes of memory a step",
        trial.TIMED_STEPS,
        trial.TIMED_STEPS + trial.GROWTH_STEPS,
        trial.LEAST_LEAK,
    )
    stated(CHECK, "more than {} MB printed in the trial", check.MOST_PRINTED / 2**20)
    stated(CHECK, "| archive | {} MB; {} files; {} GB unpacked, and not more than {} times the archive once that is {} MB |",
           container.MOST_PACKED / 2**20, container.MOST_FILES, container.MOST_UNPACKED / 2**30, container.MOST_INFLATION,
           container.INFLATION_FROM / 2**20)  # fmt: skip
    stated(CHECK, "| XML | {} MB, {} elements deep", container.MOST_XML / 2**20, container.DEEPEST_XML)
    stated(CHECK, "| time | {} s in all (`--time-limit`), {} s without", check.LIMITS.seconds, check.LIMITS.silence)
    stated(CHECK, "| memory | {} GB resident", check.LIMITS.megabytes / 1024.0)
    assert response.LITTLE_CHANGE == 1e-6
    assert "by less than a millionth" in text(CHECK)


def test_how_a_turbine_creeps_before_it_accelerates() -> None:
    build_engines(["turbine-20"])
    found = check.check_fmu("turbine-20")
    assert found.ok
    assert None not in (found.tenth_up, found.rise_time_up, found.tenth_down, found.rise_time_down)
    stated(CHECK, "`turbine-20` takes {} samples, {} s and {} s upward, {} samples, {} s and {} s downward",
           *(each or 0.0 for each in (found.delay_samples_up, found.tenth_up, found.rise_time_up,
                                      found.delay_samples_down, found.tenth_down, found.rise_time_down)))  # fmt: skip


def test_an_engine_of_your_own_in_thin_air(tmp_path: Path) -> None:
    page = "docs/own-engine.md"
    with engine("turbine-220", tmp_path) as jet:
        for port, at in zip(("ambient_pressure", "ambient_temperature"), standard_air(2000.0), strict=True):
            jet.set(port, at)
        jet.start(throttle_start=1.0)
        thrust = jet.get("thrust")
    stated(page, "{} km up `turbine-220` gives {} N of its {} N", 2.0, thrust, 220.0)
    stated(page, "the loops have {} of the gain", thrust / 220.0)
    source = (ROOT / "cosim" / "engine" / "_bank.c").read_text(encoding="utf-8")
    stated(page, "makes more than {} parts of a step", float(re.findall(r"MOST_PARTS = (\d+)", source)[0]))


# --- the engines' READMEs --------------------------------------------------------------------------------------------

LINEAR = ("turbojet", "edf", "edf-as-flown", "motor")
TURBINES = {"turbine-220": "220 N", "turbine-100": "100 N", "turbine-20": "20 N"}
ENGINES = "engines/README.md"


@contextmanager
def engine(name: str, folder: Path) -> Iterator[Driven]:
    build_engines([name])
    with driven(archive(name, 3), folder / name) as it:
        yield it


def parameters(name: str) -> dict[str, float]:
    variables = library.read_engine(data_folder("engines") / name).variables
    return {v.name: v.start for v in variables if v.causality == "parameter" and v.start is not None}


def step_of(name: str) -> float:
    return float(library.read_engine(data_folder("engines") / name).internal_step)


def rise(thrust: Array) -> float:
    """From 10 to 90 % of the way from the first to the last [s]."""
    share = (thrust - thrust[0]) / (thrust[-1] - thrust[0])
    return float(np.argmax(share >= 0.9) - np.argmax(share >= 0.1)) * STEP


def lag_at_half(name: str, folder: Path) -> float:
    """Area between a small step of the throttle and its answer, without the delay [s]."""
    with engine(name, folder) as jet:
        jet.start(throttle_start=0.5, delay_samples=0.0)
        before = jet.get("thrust")
        thrust = jet.run(np.full(5000, 0.501))
    left = 1.0 - (thrust - before) / (thrust[-1] - before)
    return STEP * (0.5 + float(left.sum()))


def ends(name: str, folder: Path) -> list[float]:
    with engine(name, folder) as jet:
        found = []
        for throttle in (0.0, 1.0):
            jet.fmu.reset()
            jet.start(throttle_start=throttle)
            found.append(jet.get("thrust"))
    return found


@pytest.mark.parametrize("name", [*LINEAR, "p220", "p220-2025", *TURBINES, "jetcat-p300", "fitted"])
def test_the_table_of_engines(name: str, tmp_path: Path) -> None:
    """Delay, lag at half throttle, thrust from idle to full."""
    _, late, lag, thrust = rows(ENGINES, 5)[f"[`{name}`]({name}/README.md)"]
    samples, step = delay(name), step_of(name)
    if samples:
        said, seconds = numbers(late)
        assert int(said) == samples
        assert float(seconds) * (1e-3 if late.endswith("ms") else 1.0) == pytest.approx(samples * step)
    else:
        assert late == "none"
    here = -step / math.log(parameters(name)["pole"]) if name in LINEAR else lag_at_half(name, tmp_path)
    figure = numbers(lag)[0]
    assert abs(float(figure) - here * (1e3 if lag.endswith("ms") else 1.0)) <= 0.5001 * last_digit(figure), here
    for figure, found in zip(numbers(thrust), ends(name, tmp_path), strict=True):
        assert abs(float(figure) - found) <= 0.5001 * last_digit(figure), found


@pytest.mark.parametrize("name", ["turbojet", "edf", "edf-as-flown"])
def test_an_engine_of_the_paper_in_numbers(name: str) -> None:
    page, (gain, pole, samples) = f"engines/{name}/README.md", PAPER[name]
    stated(page, "G(z) = {} / (z - {})", gain, pole)
    stated(page, "y[k+1] = {} y[k] + {} u[k", pole, gain)
    stated(page, "K = {} / (1 - {}) = {}", gain, pole, gain / (1.0 - pole))
    cells = {name: row[0] for name, row in rows(page, 2).items()}
    full = NEWTON_PER_KGF * gain / (1.0 - pole)
    for figure, found in (
        (numbers(cells["thrust at rest"])[0], full),
        (
            numbers(cells["time constant"].partition("=")[2])[0],
            -STEP / math.log(pole) * (1.0 if name == "turbojet" else 1e3),
        ),
        (
            numbers(cells["10 to 90 %"])[0],
            -STEP * math.log(9.0) / math.log(pole) * (1.0 if name == "turbojet" else 1e3),
        ),
    ):
        assert abs(float(figure) - found) <= 0.5001 * last_digit(figure), (figure, found)
    if samples:
        row_states_two(cells["delay"], samples, samples * STEP)
    else:
        assert cells["delay"].startswith("none")
    if name != "edf-as-flown":
        (six,) = figures(page, "come to {} kgf")
        assert float(six) == pytest.approx(6.0 * 0.2554 / (1.0 - 0.8748), abs=0.005)


def row_states_two(cell: str, first: float, second: float) -> None:
    assert [float(figure) for figure in numbers(cell)] == pytest.approx([first, second])


def test_the_motor_in_numbers() -> None:
    page, p = "engines/motor/README.md", parameters("motor")
    stated(page, "y[k+1] = {} y[k] + {} u[k-5] thrust = {} N · y, internal step {} ms", p["pole"], p["gain"],
           p["newton_per_unit"], 1e3 * step_of("motor"))  # fmt: skip
    full = p["newton_per_unit"] * p["gain"] / (1.0 - p["pole"])
    stated(page, "A lag of {} ms behind {} samples ({} ms) of delay", -2.5 / math.log(p["pole"]), p["delay_samples"],
           2.5 * p["delay_samples"])  # fmt: skip
    stated(page, "nothing for {} steps, then {} N · u · (1 - {}^n)", p["delay_samples"], full, p["pole"])
    stated(page, "the gain is {} N per unit", full)


@pytest.mark.parametrize("name", TURBINES)
def test_the_hottest_exhaust_without_a_limit(name: str, tmp_path: Path) -> None:
    """Idle to full; and of the largest how long it takes, with a limit and without."""
    hot = dict(zip(("turbine-220", "turbine-100", "turbine-20"), figures(
        ENGINES, "than the 720 °C at which it rests: {} °C (220 N), {} °C (100 N), {} °C (20 N)"
    ), strict=True))  # fmt: skip
    with engine(name, tmp_path) as jet:
        jet.start(throttle_start=0.0, exhaust_limit=0.0)
        jet.set("throttle", 1.0)
        thrust, found = [jet.get("thrust")], 0.0
        for k in range(3000):
            jet.fmu.doStep(k * STEP, STEP)
            thrust.append(jet.get("thrust"))
            found = max(found, jet.get("exhaust_temperature") - 273.15)
        closed = jet.run(np.zeros(3000), first=3000)
    assert abs(float(hot[name]) - found) < 0.501
    assert parameters(name)["exhaust_limit"] == pytest.approx(950.0 + 273.15)
    if name == "turbine-220":
        with engine(name, tmp_path) as jet:
            jet.start(throttle_start=0.0, exhaust_limit=750.0 + 273.15)
            kept = jet.run(np.ones(4000))
        stated(
            ENGINES,
            "at {} °C `turbine-220` takes {} s from 10 to 90 %, without {} s",
            750.0,
            rise(kept),
            rise(np.array(thrust)),
        )
        page = "engines/turbine-220/README.md"
        stated(
            page,
            "Idle to full takes {} s from 10 to 90 % and full to idle {} s; the P220",
            rise(np.array(thrust)),
            rise(closed),
        )


def test_what_was_found_for_the_turbines(tmp_path: Path) -> None:
    """The numbers that no sheet states, the law of speed, and what wind costs."""
    page = "engines/turbine-220/README.md"
    table = rows(page, 4) | rows(page, 5)
    for n, name in enumerate(TURBINES):
        p = parameters(name)
        head = p["pressure_ratio"] ** (2.0 / 7.0) - 1.0
        power = p["air_flow"] * 1004.5 * 288.15 * head / p["compressor_efficiency"]
        for row, values in {
            "turbine efficiency η_t": [p["turbine_efficiency"]],
            "combustion efficiency η_b at full speed, idle": [
                p["combustion_efficiency"],
                p["idle_combustion_efficiency"],
            ],
            "nozzle area A [cm²]": [1e4 * p["nozzle_area"]],
            "flow droop d": [p["flow_droop"]],
            "air flow [kg/s]": [p["air_flow"]],
            "pressure ratio": [p["pressure_ratio"]],
            "η_c": [p["compressor_efficiency"]],
            "λ, r": [p["pressure_loss"], p["ram_recovery"]],
        }.items():
            for figure, found in zip(numbers(table[row][n]), values, strict=True):
                assert abs(float(figure) - found) <= 0.5001 * last_digit(figure), (name, row)
        watts, percent = numbers(table["windage at full speed [W], share of the compressor's power"][n])
        assert float(watts) == pytest.approx(p["windage_power"], rel=5e-3)  # three digits
        assert abs(float(percent) - 100.0 * p["windage_power"] / power) <= 0.5001
    lost = []
    for name in TURBINES:
        still, moving = (at_speed(name, tmp_path, speed) for speed in (0.0, 70.0))
        lost.append(100.0 * (1.0 - moving / still))
    stated(page, "({} % at {} m/s, {} % with the 100 N, {} % with the 20 N)", lost[0], 70.0, *lost[1:])
    off = []
    with engine("turbine-220", tmp_path) as jet:
        for throttle in np.linspace(0.0, 1.0, 41):
            jet.fmu.reset()
            jet.start(throttle_start=float(throttle))
            speed = jet.get("spool_speed")
            law = 9.0 + 211.0 * (speed**3.205 - 35e3**3.205) / (117e3**3.205 - 35e3**3.205)
            off.append(abs(jet.get("thrust") - law) / 2.2)
    stated(page, "the thrust over speed keeps within {} % of full thrust", max(off))


def at_speed(name: str, folder: Path, speed: float) -> float:
    with engine(name, folder) as jet:
        jet.set("air_speed", speed)
        jet.start(throttle_start=1.0)
        return jet.get("thrust")


def test_the_p220_up_and_down(tmp_path: Path) -> None:
    page = "engines/p220/README.md"
    with engine("p220", tmp_path) as jet:
        jet.start(throttle_start=1.0)
        chopped = jet.run(np.zeros(10_000))
        jet.fmu.reset()
        jet.start(throttle_start=0.0)
        opened = jet.run(np.ones(4000))
        rest = jet.run(np.zeros(15_000), first=4000)
    stated(page, "From idle to full it takes {} s from 10 to 90 %, from full to idle {} s", rise(opened), rise(rest))
    stated(page, "At u = {} the equation rests at {} N", 100.0, opened[-1])
    lowest = int(chopped.argmin())
    least, within = figures(page, "thrust runs down to {} N within {} s")
    assert abs(float(least) - chopped[lowest]) <= 0.005
    assert float(within) - 1.0 < lowest * STEP <= float(within)
    # creeps for half a minute
    assert (
        chopped[lowest + round(10.0 / STEP)] < 0.75 * rest[-1] < 0.98 * rest[-1] < chopped[lowest + round(30.0 / STEP)]
    )
    stated(page, "only then rises to the {} N at which it rests", rest[-1])


# --- aircraft/hexjet-100/README.md, docs/campaigns.md ----------------------------------------------------------------


def test_how_long_the_middle_size_hovers(tmp_path: Path) -> None:
    """Fuel by the straight line over the falling mass, and what the turbine burns at first."""
    page = "aircraft/hexjet-100/README.md"
    vehicle, _ = load_vehicle("hexjet-100")
    slope = (0.312 - 0.064) / 98.0  # kg/min per N
    rest = 6.0 * (0.064 - 2.0 * slope)
    rate = slope * G  # kg/min per kg of vehicle
    burnt = (vehicle.mass_kg + rest / rate) * (1.0 - math.exp(-10.0 * rate))
    stated(
        page,
        "between {} kg/min at 2 N and {} kg/min at 100 N comes to {} kg in 10 minutes of hover",
        0.064,
        0.312,
        burnt,
    )
    with engine("turbine-100", tmp_path) as jet:

        def thrust(throttle: float) -> float:
            jet.fmu.reset()
            jet.start(throttle_start=throttle)
            return jet.get("thrust") - vehicle.mass_kg * G / 6.0

        brentq(thrust, 0.0, 1.0, xtol=1e-9)
        grams = 6e3 * jet.get("fuel_flow")
    stated(page, "turbine-100 burns {} g/s at first", grams)
    assert vehicle.servo is not None
    stated(page, "have {} kg m² about the tilt axis, and {} rad/s² take 5 N m", 0.03,
           round(vehicle.servo.rate_limit_rad_s / vehicle.servo.lag_s, -1))  # fmt: skip


FAULTS, FAULT_DATA, FULL = "docs/faults.md", "docs/tables/faults.md", "docs/full-scale.md"


def test_what_faults_are_flown_with() -> None:
    """docs/faults.md: heights, times and thresholds are those of the code, of vehicle.toml and of the flight's judge."""
    vehicle, _ = load_vehicle("hexjet")
    monitor, lost = vehicle.control.monitor, vehicle.limits.tilt_deg
    assert monitor is not None
    assert (monitor.threshold, monitor.lag_factor) == (0.2, 3.0)  # "a fifth", "a factor of three"
    stated(FAULTS, "a lag within a factor of three, a delay within {} ms. An engine outside by more than a fifth of its "
           "hover thrust for {} ms is judged", 1e3 * monitor.delay_spread_s, 1e3 * monitor.confirm_s)  # fmt: skip
    found = 1e3 * -STEP / math.log(PAPER["edf"][1]) * math.log(1.0 / 0.8)
    stated(FAULTS, "A flame-out of an EDF in hover is found after {} ms: {} ms until a fifth of the thrust is gone, and five "
           "steps", 24.0, found)  # fmt: skip
    (row,) = [line for line in page_parts(ROOT / FAULTS)["faults"].splitlines()
              if line.startswith("| flame-out | hover |")]  # fmt: skip
    assert row.endswith("| 24 ms |")
    stated(FAULTS, "which leaves the most roll either way around hover with {} % of hover thrust kept for height",
           100.0 * replan._KEPT)  # fmt: skip
    stated(FAULTS, "*Held* is within {} deg of level over the last second, *lost* past {} deg", survey.LEVEL_DEG, lost)
    stated(FAULTS, "Where it is past {} deg, no allocation", lost)
    stated(FAULT_DATA, "one seed, {} m, {} s from the fault on; *roll* is a commanded lean of {} deg", survival.HEIGHT_M,
           survival.AFTER_S, survival.ROLL_DEG)  # fmt: skip
    stated(FAULT_DATA, "the vehicle is *held*, within {} deg of what is asked on every axis", survey.LEVEL_DEG)
    stated(FAULTS, "With engines that answer {} s late the baseline loses the vehicle in a roll of {} deg",
           delay("edf-as-flown") * STEP, survival.ROLL_DEG)  # fmt: skip
    stated(FAULTS, "it leans on by more than {} deg", survey.LEVEL_DEG)
    jammed = {case.fault["angle_deg"] for case in survival.cases(vehicle) if case.fault and "angle_deg" in case.fault}
    stated(FAULTS, "A servo that jams {} deg off loses", *jammed)


def test_what_full_scale_flies_with() -> None:
    """docs/full-scale.md: inputs of its tables."""
    (command,) = Scenario.load("full-scale-roll-doublet").command
    assert isinstance(command, DoubletCommand)
    stated("docs/tables/full-scale.md", "in the roll doublet of {}° (overshoot, time to settle) and in {} s of hover", command.amplitude,
           Scenario.load("full-scale-hover").duration_s)  # fmt: skip
    late = load_engine("turbine-220", {}, STEP).transport_delay or 0.0
    stated(FULL, "with an ECU that answers {} s late and limits the acceleration", late)
    stated(FULL, "is too late for that too: {} s in its ECU and the slowest spool", late)
    stated(FULL, "linearised at hover thrust ({} N), gives", load_vehicle("hexjet-p220")[0].mass_kg * G / 6.0)
    vehicle, _ = load_vehicle("hexjet-p220")
    assert vehicle.fuel is not None
    # the data sheet's straight line from 9 N, 0.104 kg/min to 220 N, 0.58 kg/min, over the falling mass
    slope = (0.58 - 0.104) / 211.0
    rest, rate = 6.0 * (0.104 - 9.0 * slope), slope * G
    burnt = (vehicle.mass_kg + rest / rate) * (1.0 - math.exp(-10.0 * rate))
    stated(FULL, "A hover of ten minutes burns {} of {} kg of fuel", burnt, vehicle.fuel.mass_kg)


CAMPAIGNS, STUDIES = "docs/campaigns.md", "docs/tables/campaigns.md"


def test_what_campaigns_say_of_studies_and_statistics() -> None:
    robust, envelope, full = (Study.load(name) for name in ("predictor-robustness", "payload-and-gust", "full-scale"))
    stated(
        CAMPAIGNS, "--out runs/robustness # {} flights, all processors", (robust.runs or 0) * len(robust.controllers)
    )
    stated(CAMPAIGNS, "the roll doublet with {} vehicles that are not the model", robust.runs or 0)
    levels = math.prod(len(vary.values) if vary.values else vary.levels or 1 for vary in envelope.vary)
    stated(STUDIES, "(../../studies/payload-and-gust.toml) flies {} combinations", levels)
    flown = parts_of((ROOT / STUDIES).read_text(encoding="utf-8"), STUDIES)["full-scale"]
    runs, share, *_, lost, soon, _, _ = (int(each) for each in re.findall(r"\d+", flown.splitlines()[-1]))
    assert runs == full.runs
    stated(FULL, "is lost in {} of {} flights in gusts and succeeds in {} %", lost, runs, share)
    ((_, edge),) = re.findall(r"(up to) (\d+) ms late", flown)
    stated(STUDIES, "With an ECU that answers within {} ms six in seven succeed", int(edge))
    assert soon == pytest.approx(100.0 * 6.0 / 7.0, abs=0.5)
    # exact: none of a hundred, 0.975 of the probability
    stated(
        CAMPAIGNS, "a hundred flights without a failure leave room for {} % of failures", 100.0 * (1.0 - 0.025**0.01)
    )
    low, high = wilson(np.array([200]), np.array([400]))
    assert 50.0 * float(high[0] - low[0]) == pytest.approx(5.0, abs=0.5)
    assert "After 400 flights they reach five points either way" in text(CAMPAIGNS)


def ranged(study: Study, key: str) -> tuple[float, float]:
    """From where to where a study varies a key."""
    (vary,) = [each for each in study.vary if each.key == key]
    assert vary.range is not None
    return vary.range[0], vary.range[1]


def test_what_campaigns_say_is_varied() -> None:
    """docs/tables/campaigns.md: the ranges are those of the studies' files."""
    robust, envelope, full = (Study.load(name) for name in ("predictor-robustness", "payload-and-gust", "full-scale"))
    assert ranged(robust, "engine_parameters.delay_samples") == (0.5, 1.5)
    inertia, thrust = ranged(robust, "vehicle.inertia_kg_m2.0"), ranged(robust, "mismatch.thrust_factor")
    lag = 1e3 * -STEP / math.log(PAPER["edf"][1])
    load, off = ranged(robust, "disturbance.0.mass_kg"), ranged(robust, "disturbance.0.offset_m.1")
    stated(
        STUDIES,
        "Half the delay either way, {} % of gain, {} to {} % of thrust, lags from {} to {} ms, noise, and up to {} kg as "
        "much as {} cm off to one side",
        round(100.0 * (inertia[1] - 1.0)), *(100.0 * each for each in thrust),
        *(lag + 1e3 * each for each in ranged(robust, "vehicle.sensors.gyro.filter_s")), load[1], 100.0 * off[1],
    )  # fmt: skip
    (levers,) = [each.values for each in envelope.vary if each.key == "disturbance.0.offset_m.1"]
    lean, end = (envelope.success[f"roll.{name}_rad"].max for name in ("max_abs_error", "final_error"))
    stated(
        STUDIES,
        "a load taken up ({} to {} kg, {} to {} cm to windward) and a side gust ({} to {} m/s). A flight fails beyond {}° of "
        "lean at the worst, or {}° at the end",
        *ranged(envelope, "disturbance.0.mass_kg"), *(-100.0 * float(each) for each in (levers[0], levers[-1])),
        *ranged(envelope, "disturbance.1.velocity_ned_m_s.1"), math.degrees(lean or 0.0), math.degrees(end or 0.0),
    )  # fmt: skip
    gust = ranged(full, "disturbance.0.velocity_ned_m_s.1")
    (late,) = [vary.normal for vary in full.vary if vary.key == "engine_parameters.delay_samples"]
    assert late is not None
    ecu = read_toml(data_folder("engines") / "jetcat-p300" / "engine.toml")
    place = ecu["uncertainty"]["parameters"].index("delay_samples")
    fitted = (ecu["variables"]["delay_samples"]["start"], ecu["uncertainty"]["deviation"][place])
    assert (late.mean, late.sd, late.max) == (*fitted, fitted[0] + CUT * fitted[1])
    stated(STUDIES, "{} kg on six P220, as shipped, with engines as late as the one ECU that was measured, {} ms with a "
           "deviation of {} ms, and up to a tenth slower than published, in gusts of {} to {} m/s",
           load_vehicle("hexjet-p220")[0].mass_kg, *(1e3 * STEP * each for each in fitted), *gust)  # fmt: skip
    assert ranged(full, "fault.0.lag_s")[1] == pytest.approx(0.1 / 1.295, abs=5e-4)


UNLIMITED = ["limits.settling_s=false", "limits.oscillation_rad=false"]


@pytest.mark.parametrize(
    ("sentence", "settings", "success"),
    [
        ("the first command finds {} more samples for Smith's predictor", [], []),
        ("one that oscillates without end does not break, and it finds {};", UNLIMITED, []),
        (
            "as in the search of [the shipped studies](tables/campaigns.md#predictor-robustness), find {}.",
            [*UNLIMITED, "duration_s=40"],
            ["roll.oscillation_rad<=0.0175"],
        ),
    ],
    ids=["unsettled", "lost", "swings"],
)
def test_how_much_delay_a_search_finds(sentence: str, settings: list[str], success: list[str]) -> None:
    """So many samples more than the model has break Smith's predictor, and one less does not."""
    more = int(figures(CAMPAIGNS, sentence)[0])
    vary = [f"mismatch.delay_samples={more - 1},{more}"]
    study = open_study("roll-doublet", vary=vary, controllers=["smith"], settings=settings, success=success)
    assert [fly_one(study, flight)["success"] for flight in flights(study)] == [True, False]
