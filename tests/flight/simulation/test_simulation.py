"""The whole co-simulation: the ledger of delays, the paper's roll response, the Smith identities, determinism."""

from __future__ import annotations

import gc
import sys
from dataclasses import replace

import numpy as np
import pytest
from flights import Rows

from cosim import fly
from cosim.base.errors import EngineError, InputError
from cosim.base.signals import Ambient, EngineOutput, PerJet, Unallocated
from cosim.engine import EngineBank
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.simulation.controllers.models import make_predictors
from cosim.simulation.delay_ledger import sum_samples
from cosim.spec.scenario import Scenario

STEP = 0.004
GYRO_LATENCY = {"sensors": {"gyro": {"latency_samples": 3}}}


def scenario(**changes: object) -> Scenario:
    base: dict[str, object] = {"name": "test", "duration_s": 4.0, "sensor_noise": False}
    return Scenario.from_table(base | changes, Scenario.load("hover").folder, "test")


def measured_delay(flown: Scenario) -> tuple[float, float]:
    """Delay from roll command to measured roll rate in control steps, as measured and as the ledger states it.

    A small step of roll command from hover, the rate loop's gain at zero: once the lags have died out, the rate of an
    integrator grows along K T (k + 1/2 - D), k counted from the step.  The half is the ideal integrator's own: the one
    with a phase of -90 deg at every frequency, the trapezoidal rule, has gone half a step at the step itself.  K is
    known from the engine's thrust, the lever and the inertia.
    """
    amplitude, start, step = 1e-4, 50, flown.step_s
    push = {"kind": "torque_command", "axis": "roll", "start_s": start * step, "duration_s": 1000 * step}
    loose = {"control": {"rate": {"roll": {"p": 0.0, "i": 0.0, "d": 0.0}}}}
    flown = flown.replace(
        controller="baseline",
        duration_s=(start + 600) * step,
        disturbance=[push | {"amplitude": amplitude}],
        vehicle=loose | {"aero": {"damping_n_m_s": [0.0, 0.0, 0.0]}},
    )
    rows = Rows()
    with build(flown) as simulation:
        simulation.run([rows])
        vehicle, engine = simulation.vehicle, simulation.engine
        stated = sum_samples(simulation.ledger)
        hover = simulation.cascade.allocator.hover
    lever = sum(abs(jet.position_m[1]) for jet in vehicle.jets)
    slope = engine.thrust_at(hover + amplitude) - engine.thrust_at(hover)
    gain = lever * slope / vehicle.inertia_kg_m2[0]
    last = rows.samples[-1]
    grown = (last.measured.rate[0] - rows.samples[start].measured.rate[0]) / (gain * step)
    assert stated is not None
    return last.k - start + 0.5 - grown, stated


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"substeps": 1},
        {"substeps": 2},
        {"substeps": 3},
        {"engine": "edf"},
        {"engine": "edf-as-flown-fmi2"},
        {"vehicle": GYRO_LATENCY},
        {"vehicle": {"sensors": {"gyro": {"filter_s": 0.0}}}},
        {"engine_parameters": {"delay_samples": 60.0}},
        # two and three internal steps of the engine in a control step
        {"step_s": 0.008, "controller": "baseline"},
        {"step_s": 0.012, "controller": "baseline"},
        {"step_s": 0.012, "controller": "baseline", "engine_parameters": {"delay_samples": 7.0}},
    ],
    ids=str,
)
def test_measured_delay_is_the_ledgers_sum(changes: dict[str, object]) -> None:
    """To a twentieth of a sample, as promised; the rest is the engine's lag not having died out to the last bit."""
    measured, stated = measured_delay(scenario(**changes))
    assert measured == pytest.approx(stated, abs=0.05)


@pytest.mark.parametrize("added", [1, 10, 35])
def test_delay_grows_by_what_is_added(added: int) -> None:
    base, _ = measured_delay(scenario())
    more, _ = measured_delay(scenario(engine_parameters={"delay_samples": 25.0 + added}))
    assert more - base == pytest.approx(added, abs=1e-3)


@pytest.mark.parametrize(("changes", "late"), [({}, set()), ({"substeps": 1}, {("JSBSim", 0.5)})])
def test_ledger_owns_the_transport_delay_once(changes: dict[str, object], late: set[tuple[str, float]]) -> None:
    """25 samples, in the engine and nowhere else; a single run of JSBSim a step is half a step late."""
    with build(scenario(**changes)) as simulation:
        found = {(row.owner, row.samples) for row in simulation.ledger if row.kind == "transport" and row.samples}
    assert found == {("engine edf-as-flown", 25.0)} | late


def paper_response(hertz: np.ndarray) -> np.ndarray:
    z = np.exp(2j * np.pi * hertz * STEP)
    return np.asarray(0.0689 * (z + 1.4538) / ((z - 0.9999) * (z - 0.9024)) * z**-25)


@pytest.mark.parametrize("substeps", [1, 4])
def test_swept_roll_response_is_the_papers(substeps: int) -> None:
    """Within 1 dB and 6 deg of G(z) from 0.3 to 4 Hz, roll command to measured rate, closed loop, as flown."""
    sweep = {"kind": "torque_command", "axis": "roll", "shape": "sweep", "start_s": 2.0, "duration_s": 92.0}
    sweep |= {"amplitude": 0.02, "from_hz": 0.15, "to_hz": 6.0}
    run = fly(scenario(duration_s=100.0, substeps=substeps, disturbance=[sweep]))
    assert run.outcome == "completed", run.reason
    log = run.log
    command = log["torque_roll"] + log["disturbance_torque_roll"] - log["refused_roll"]
    rate = log["rate_p_measured_rad_s"]
    hertz = np.array([0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0])
    # the record begins and ends at rest, so its Fourier transforms divide without a window
    kernel = np.exp(-2j * np.pi * hertz[:, None] * log["time_s"])
    ratio = (kernel @ rate) / (kernel @ command) / paper_response(hertz)
    assert np.abs(20 * np.log10(np.abs(ratio))).max() < 1.0
    assert np.abs(np.degrees(np.angle(ratio))).max() < 6.0


def same(one: Run, other: Run) -> bool:
    """To the last bit."""
    return all(one.log[name].tobytes() == other.log[name].tobytes() for name in one.log.columns)


def test_smith_with_a_model_without_delay_is_the_baseline_bit_for_bit() -> None:
    """In the whole co-simulation, with noise: the engine without delay, its model without delay."""
    flown = Scenario.load("roll-doublet").replace(engine="edf", duration_s=5.0)
    assert same(*(fly(flown.replace(controller=controller)) for controller in ("baseline", "smith")))


def test_roll_doublet_as_the_paper_reports_it() -> None:
    """Same gains: with Smith both ways settle and it ends level; without, the vehicle is lost or swings on."""
    smith = fly(Scenario.load("roll-doublet"))
    roll = smith.metrics["roll"]
    assert smith.outcome == "completed"
    assert roll.settling_time_s is not None
    assert roll.settling_time_s < 2.0
    assert roll.final_error_rad is not None
    assert roll.final_error_rad < 0.005
    baseline = fly(Scenario.load("roll-doublet").replace(controller="baseline"))
    assert baseline.outcome in ("diverged", "crashed")
    # the same command, and the same motion until the predictor first has something to say
    both = len(baseline.log)
    np.testing.assert_array_equal(smith.log["roll_setpoint_rad"][:both], baseline.log["roll_setpoint_rad"])
    np.testing.assert_array_equal(smith.log["roll_rad"][:26], baseline.log["roll_rad"][:26])


@pytest.mark.parametrize(("p", "settles"), [(0.015, True), (0.0175, False), (0.02, False)])
def test_without_a_predictor_the_oscillation_dies_out_only_at_a_lower_gain(p: float, settles: bool) -> None:
    """What aircraft/hexjet/README.md says of the chosen gain, over a minute and without noise."""
    changes = {"duration_s": 60.0, "sensor_noise": False, "expect": []}
    gain = {"control": {"rate": {"roll": {"p": p}}}}
    run = fly(Scenario.load("roll-doublet").replace(controller="baseline", vehicle=gain, **changes))
    swing = run.metrics["roll"].oscillation_rad
    assert swing is not None
    assert swing < 0.002 if settles else swing > 0.1


def test_the_controllers_see_the_sensors_and_the_refusals() -> None:
    """The measurement of the step, and what allocation refused in the one before: given these, the loops answer alike."""
    climb = {"kind": "step", "signal": "altitude_m", "start_s": 1.0, "amplitude": 40.0}
    roll = {"kind": "doublet", "signal": "roll_deg", "start_s": 2.0, "amplitude": 60.0, "width_s": 0.6}
    gains = {"altitude": {"climb_limit_m_s": 30.0}, "allocation": {"throttle_max": 0.55}, "rate": {"roll": {"p": 0.2}}}
    vehicle = {"control": gains, "limits": {"tilt_deg": 180.0, "rate_deg_s": 1e5}}
    rows = Rows()
    before = Unallocated()
    refused_roll = refused_collective = 0
    with build(scenario(duration_s=6.0, sensor_noise=True, command=[climb, roll], vehicle=vehicle)) as simulation:
        simulation.run([rows])
        flown = rows.samples[: simulation.k]
        simulation.reset()
        loops = simulation.cascade
        for sample in flown:
            told, given = sample.control, sample.measured
            assert loops.attitude.update(sample.command, given) == told.rate_setpoint
            assert loops.rate.update(told.rate_setpoint, given.rate, before) == told.torque
            assert loops.altitude.update(sample.command, given, before) == told.collective
            before = sample.actuation.unallocated
            refused_roll += before.roll != 0.0
            refused_collective += before.collective != 0.0
    assert refused_roll > 10
    assert refused_collective > 10


def test_a_biased_attitude_sensor_tilts_the_vehicle() -> None:
    """It stands at minus the bias: what it flies by is what it measures."""
    bias = {"sensors": {"attitude": {"bias_rad": [0.05, 0.0, 0.0], "noise_rad": 0.0}}}
    run = fly(scenario(duration_s=12.0, sensor_noise=True, vehicle=bias))
    assert run.log["roll_rad"][-250:].mean() == pytest.approx(-0.05, abs=0.005)


def test_one_seed_one_log_bit_for_bit() -> None:
    """With turbulence, noise and a payload; another seed gives another log."""
    flown = Scenario.load("gust").replace(duration_s=5.0)
    first, second, third = fly(flown), fly(flown), fly(flown.replace(seed=2))
    assert same(first, second)
    for name in ("rate_p_measured_rad_s", "wind_north_m_s"):
        assert (first.log[name] != third.log[name]).any()


def test_a_simulation_can_be_flown_again() -> None:
    rows = Rows(), Rows()
    with build(Scenario.load("payload-drop").replace(duration_s=4.0)) as simulation:
        for kept in rows:
            simulation.reset()
            simulation.run([kept])
    # as text, which has every digit, because what an engine does not say is NaN and equals nothing
    assert [repr(sample) for sample in rows[0].samples] == [repr(sample) for sample in rows[1].samples]


def test_a_closed_flight_is_freed_at_once() -> None:
    """Nothing in it refers to it in a circle, which would keep JSBSim's megabyte until a collector comes by."""
    simulation = build(scenario(duration_s=0.1))
    simulation.run()
    simulation.close()
    model = simulation.airframe._fdm
    gc.disable()
    try:
        del simulation
        assert sys.getrefcount(model) == 2  # this name, and the argument
    finally:
        gc.enable()


def test_fmi_2_and_fmi_3_engines_fly_alike() -> None:
    flown = Scenario.load("roll-doublet").replace(duration_s=3.0)
    assert same(fly(flown), fly(flown.replace(engine="edf-as-flown-fmi2")))


def test_the_step_is_sequential() -> None:
    """Thrust of step k acts in step k, the disturbance too, and the sample shows the state before it."""
    rows = Rows()
    with build(scenario(duration_s=0.2)) as simulation:
        simulation.run([rows])
        assert simulation.k == 50
    assert [(sample.k, sample.time) for sample in rows.samples] == [(k, k * STEP) for k in range(50)]
    assert rows.samples[0].state.altitude == pytest.approx(30.0, abs=1e-6)


def test_an_engine_that_fails_ends_the_run_and_keeps_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    honest, said = EngineBank.step, "engine 3 (edf.fmu): thrust is not finite at step 300 (1.2 s)"

    def fail(self: EngineBank, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        if k == 300:
            raise EngineError(said)
        return honest(self, k, throttle, ambient)

    monkeypatch.setattr(EngineBank, "step", fail)
    run = fly(Scenario.load("hover").replace(duration_s=2.0))
    assert (run.outcome, run.reason, len(run.log)) == ("failed", said, 300)


def test_a_crash_is_the_last_row_of_its_log() -> None:
    cut = {"kind": "step", "signal": "collective", "start_s": 0.4, "amplitude": 0.06}
    run = fly(scenario(initial={"altitude_m": 2.0}, command=[cut]))
    assert run.outcome == "crashed"
    assert "hit the ground at" in run.reason
    assert run.log["on_ground"].tolist() == [0.0] * (len(run.log) - 1) + [1.0]
    assert run.summary.touchdown_m_s == pytest.approx(float(run.reason.split(" m/s")[0].split()[-1]), abs=0.06)
    # the height was held until the collective was commanded
    assert run.log["altitude_m"][:100].min() > 1.95


def test_a_vehicle_that_tumbles_diverges() -> None:
    moment = {"kind": "moment", "start_s": 0.4, "duration_s": 2.0, "moment_n_m": [3.0, 0.0, 0.0]}
    run = fly(scenario(disturbance=[moment]))
    assert run.outcome == "diverged"
    assert "leaned past 80 deg" in run.reason
    assert len(run.log) < 1000


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"controller": "smyth"}, r"unknown controller 'smyth'; did you mean 'smith'\? allowed: .*baseline"),
        ({"engine": "edfs"}, r"unknown engine 'edfs'; did you mean 'edf'\? allowed: .*turbojet"),
        ({"duration_s": 1.0005}, r"duration_s = 1.0005 s is not a whole number of 0.004 s steps"),
        ({"engine_parameters": {"delay": 3.0}}, r"delay: no such parameter; allowed: delay_samples, gain"),
        ({"vehicle": {"mass_kg": float("nan")}}, r"mass_kg = nan: .*finite"),
        ({"vehicle": {"mass_kg": 14.0}}, r"would hover at throttle 1\.\d+, outside 0.05 to 1"),
        (
            {"step_s": 0.005, "duration_s": 1.0},
            r"step 0.005 s is not a whole multiple of the engine's internal step 0.004 s",
        ),
        ({"step_s": 0.008, "duration_s": 1.6}, r"model's sample time 0.004 s is not the scenario's step 0.008 s"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        build(scenario(**changes))
    assert "\n" not in str(caught.value)


def test_a_controller_without_a_model_of_the_engine_says_which_there_are() -> None:
    flown = scenario()
    with build(flown) as simulation:
        vehicle, engine = simulation.vehicle, replace(simulation.engine, library=False)
    said = r"needs an identified model of hexjet with engine 'edf-as-flown\.fmu'; there are models for: edf"
    with pytest.raises(InputError, match=said):
        make_predictors(flown, vehicle, engine)
    assert len(make_predictors(flown.replace(controller="baseline"), vehicle, engine)) == 3
