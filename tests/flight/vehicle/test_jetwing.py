"""aircraft/jetwing: its file of aerodynamics, trim against JSBSim's own, and flights on its wing."""

from __future__ import annotations

import importlib.util
import xml.etree.ElementTree as ET
from math import cos, degrees, radians, sin
from pathlib import Path
from typing import Any

import jsbsim
import numpy as np
import pytest
from scipy.optimize import fsolve

from cosim import fly
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import ZERO3, Command, Measured
from cosim.control.phases.wing import MAX_LEAD_FRACTION, WingFlight, WingTable
from cosim.simulation.build import build
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Environment, Initial, Scenario
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.jsbsim_model import render, to_structural

VEHICLE, FOLDER = load_vehicle("jetwing")
POUND_FORCE, FOOT = 4.4482216152605, 0.3048
FULL = 96.0  # N of all four
ARM = sum(hinge.position_m[2] for hinge in VEHICLE.hinges[:4]) / 4.0  # m, how far below they push once turned ahead


def generator() -> Any:
    spec = importlib.util.spec_from_file_location("aerodynamics", FOLDER / "aerodynamics.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_model_is_what_its_program_writes() -> None:
    made = generator()
    assert (FOLDER / "jetwing.xml").read_text(encoding="utf-8") == made.document()
    # Helmbold's slope lies between that of a slender wing and that of a section, and stall ends the straight line
    assert np.pi * made.ASPECT / 2.0 > made.WING > 0.5 * 2.0 * np.pi
    lifts = [made.coefficients(radians(a))[0] for a in range(-90, 91)]
    assert 1.0 < max(lifts) < 1.4
    assert made.coefficients(radians(90.0))[0] == pytest.approx(0.0, abs=1e-6)


def test_what_is_drawn_of_it_is_the_geometry_of_its_program() -> None:
    made, panels = generator(), VEHICLE.panels
    size = {"wing": 0.0, "tail": 0.0, "fin": 0.0, "aileron": 0.0, "elevator": 0.0, "rudder": 0.0}
    for panel in panels:
        a, b, c, d = (np.array(corner) for corner in panel.corners_m)
        along, across = np.cross(c - a, d - b)[[2, 1]] / 2.0  # areas as seen from above, and from the side
        kind = "fin" if not any(corner[1] for corner in panel.corners_m) else "tail" if a[0] < -0.3 else "wing"
        size[kind] += abs(across if kind == "fin" else along)
        if panel.surface is not None:
            size[panel.surface] += abs(across if kind == "fin" else along)
    assert size["wing"] == pytest.approx(made.AREA, rel=1e-3)
    assert (size["tail"], size["fin"]) == pytest.approx((made.TAIL_AREA, made.FIN_AREA), rel=2e-3)
    outboard = made.AILERON_TO - made.AILERON_FROM
    assert size["aileron"] == pytest.approx(made.AREA * made.AILERON * outboard, rel=3e-3)
    assert size["elevator"] == pytest.approx(made.TAIL_AREA * made.ELEVATOR, rel=3e-3)
    assert size["rudder"] == pytest.approx(made.FIN_AREA * made.RUDDER, rel=3e-3)


def test_its_surfaces_are_drawn_to_the_side_that_they_push_from() -> None:
    """Deflected to 1 a trailing edge goes down where that lifts: elevator, left aileron; the rudder's to the left."""
    down = {}
    for panel in VEHICLE.panels:
        if panel.surface is None:
            continue
        first, second, third, _ = (np.array(corner) for corner in panel.corners_m)
        edge = (second - first) / np.linalg.norm(second - first)
        moved = panel.turn_rad * np.cross(edge, third - second)  # of a small turn
        down[panel.surface, bool(first[1] > 0.0)] = (np.sign(round(moved[1], 4)), np.sign(round(moved[2], 4)))
    assert down["elevator", False][1] == 1.0
    assert down["aileron", True][1] == -1.0  # it rolls to the right
    assert down["aileron", False][1] == 1.0
    assert down["rudder", False][0] == -1.0
    derivatives = generator().DERIVATIVES
    assert derivatives["elevator, moment"] < 0.0 < derivatives["elevator, lift"]
    assert derivatives["aileron, roll"] > 0.0
    assert derivatives["rudder, yaw"] < 0.0 < derivatives["rudder, side"]


def balance(speed: float) -> tuple[float, float, float]:
    """Angle of attack [rad], thrust along x at the front and rear hinges' mean [N] and elevator of level flight, where
    JSBSim's forces, written and read as a flight does, leave no acceleration ahead, down and in pitch."""
    frame = Airframe(VEHICLE, FOLDER, Environment(), 0.004, 1, 0)
    try:
        frame.reset(Initial(altitude_m=60.0), [ZERO3] * 4, ZERO3)
        gravity = frame._fdm["accelerations/wdot-ft_sec2"] * FOOT  # at this place of a round Earth that turns
        frame.reset(Initial(altitude_m=60.0, velocity_ned_m_s=(speed, 0.0, 0.0)), [ZERO3] * 4, ZERO3)
        force, aero = frame._fdm.set_property_value, frame.aerodynamic_wrench

        def off(guess: np.ndarray) -> list[float]:
            alpha, thrust, elevator = guess
            force("fcs/elevator-cmd-norm", elevator)
            force("ic/theta-rad", alpha)
            force("ic/vn-fps", speed / FOOT)
            force("ic/vd-fps", 0.0)
            frame._fdm.run_ic()
            (x, _, z), (_, m, _) = aero()
            # a carried engine pushes along a line through its hinge, 90 mm above its station at rest
            weight = VEHICLE.mass_kg * gravity
            return [x + thrust - weight * sin(alpha), z + weight * cos(alpha), m + thrust * ARM]

        alpha, thrust, elevator = fsolve(off, [0.05, 8.0, 0.0], xtol=1e-12)
        assert off(np.array([alpha, thrust, elevator])) == pytest.approx([0.0, 0.0, 0.0], abs=1e-8)
        return float(alpha), float(thrust), float(elevator)
    finally:
        frame.close()


def own_trim(speed: float, folder: Path) -> tuple[float, float, float]:
    """The same by JSBSim's own trim (``FGTrim``, longitudinal), as :func:`balance`.

    Its throttle moves engines of JSBSim's propulsion and nothing else, so no external force is one: the jets are here
    one electric engine on a direct thruster, whose thrust is its power [ft lbf/s] times the throttle, in lbf.  And it
    pitches with the elevator's trim, so that takes the elevator's place.
    """
    model = render(VEHICLE, FOLDER / str(VEHICLE.model)).replace(b"fcs/elevator-cmd-norm", b"fcs/pitch-trim-cmd-norm")
    root = ET.fromstring(model)
    place = "".join(f"<{a}>{v!r}</{a}>" for a, v in zip("xyz", to_structural((0.0, 0.0, ARM)), strict=True))
    ahead = "<orient unit='DEG'><roll>0</roll><pitch>0</pitch><yaw>0</yaw></orient>"
    propulsion, aerodynamics = root.find("propulsion"), root.find("aerodynamics")
    assert propulsion is not None
    assert aerodynamics is not None
    below_stall = "<alphalimits unit='DEG'><min>-5</min><max>11</max></alphalimits>"  # a lift that rises all the way
    aerodynamics.insert(0, ET.fromstring(below_stall))
    propulsion.append(
        ET.fromstring(
            f"<engine file='jets'><thruster file='direct'><location unit='IN'>{place}</location>{ahead}</thruster></engine>"
        )
    )
    power = FULL * FOOT  # W in so many ft lbf/s
    (folder / "jets.xml").write_text(
        f"<electric_engine name='jets'><power unit='WATTS'>{power!r}</power></electric_engine>"
    )
    (folder / "direct.xml").write_text("<direct name='direct'/>")
    (folder / "jetwing.xml").write_bytes(ET.tostring(root))
    fdm = jsbsim.FGFDMExec(str(folder), None)
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(".")
    fdm.set_engine_path(".")
    assert fdm.load_model("jetwing", add_model_to_path=False)
    fdm["ic/lat-geod-deg"], fdm["ic/h-agl-ft"], fdm["ic/vt-fps"] = Environment().latitude_deg, 60.0 / FOOT, speed / FOOT
    for jet in range(1, 5):
        fdm[f"external_reactions/jet{jet}/magnitude"] = 0.0
    fdm.run_ic()
    fdm.do_trim(0)  # longitudinal: raises where it finds none
    assert fdm["velocities/vt-fps"] * FOOT == pytest.approx(speed, abs=1e-9)
    thrust = fdm["propulsion/engine/thrust-lbs"] * POUND_FORCE
    assert thrust == pytest.approx(fdm["fcs/throttle-cmd-norm"] * FULL, rel=1e-5)  # its horsepower has six digits
    return fdm["aero/alpha-rad"], thrust, fdm["fcs/pitch-trim-cmd-norm"]


@pytest.mark.parametrize("speed", [18.0, 25.0])
def test_jsbsim_trims_itself_where_its_forces_balance(speed: float, tmp_path: Path) -> None:
    alpha, thrust, elevator = own_trim(speed, tmp_path)
    expected = balance(speed)
    # JSBSim's trim stops at 1e-3 ft/s^2, 3e-5 of gravity, and 1e-4 rad/s^2, 3e-6 of the elevator's 30 rad/s^2 and more
    assert alpha == pytest.approx(expected[0], abs=3e-5 * (expected[0] + radians(2.0)))  # no lift at -2 degrees
    assert thrust == pytest.approx(expected[1], rel=1e-4)
    assert elevator == pytest.approx(expected[2], abs=1e-5)


@pytest.mark.long
def test_it_settles_where_jsbsim_trims_it(tmp_path: Path) -> None:
    """Long.  On the wing: with its jets ahead, rear and front alike."""
    scenario = Scenario.load("jetwing-cruise").replace(
        environment=STILL, duration_s=40.0, sensor_noise=False, expect=[]
    )
    log = fly(scenario).log
    last = log["time_s"] > 38.0
    speed = float(np.mean(log["velocity_north_m_s"][last]))
    flown = float(np.mean(log["pitch_rad"][last] - np.arctan2(-log["velocity_down_m_s"][last], speed)))
    thrust = sum(
        float(np.mean(log[f"thrust_{jet}_N"][last] * np.sin(log[f"tilt_{hinge.name}_rad"][last])))
        for jet, hinge in enumerate(VEHICLE.hinges[:4], 1)
    )
    alpha, ahead, elevator = own_trim(speed, tmp_path)
    flown_elevator = float(np.mean(log["deflection_elevator"][last]))
    assert np.ptp(log["altitude_m"][last]) < 0.05  # it has settled
    assert degrees(flown) == pytest.approx(degrees(alpha), abs=0.15)  # the jets carry a little, their air pushes
    assert thrust == pytest.approx(ahead, rel=0.01)
    assert flown_elevator == pytest.approx(elevator, abs=0.03)
    assert np.abs(log["altitude_m"][log["time_s"] > 15.0] - 60.0).max() < 0.5


def wing_of(simulation: Simulation) -> WingFlight:
    (wing,) = [law for law in simulation.cascade.selector.laws if isinstance(law, WingFlight)]
    return wing


def test_the_law_counts_on_what_the_model_says() -> None:
    simulation = build(Scenario.load("jetwing-transition"))
    wing = wing_of(simulation)
    made = generator()
    for alpha in (-0.05, 0.0, 0.05, 0.14):
        lift, drag, moment = (value / made.AREA for value in wing._table.at(alpha))
        assert (lift, drag, moment / made.CHORD) == pytest.approx(made.coefficients(alpha), abs=2e-3)
    simulation.close()


def test_the_angle_that_carries() -> None:
    table = WingTable((-0.1, 0.0, 0.2), (-0.1, 0.2, 1.2), (0.0,) * 3, (0.0,) * 3)
    assert table.angle_for(0.7) == pytest.approx(0.1)
    assert table.angle_for(-5.0) == -0.1
    assert table.angle_for(5.0) == 0.2
    assert table.at(table.angle_for(0.33))[0] == pytest.approx(0.33)


def test_it_gains_speed_on_its_jets_at_one_height() -> None:
    log = fly(Scenario.load("jetwing-transition").replace(
        initial={"altitude_m": 30.0, "on_ground": False}, duration_s=3.0, expect=[],
        command=[{"kind": "step", "signal": "ahead_m_s", "start_s": 0.0, "amplitude": 25.0}],
    )).log  # fmt: skip
    assert log["velocity_north_m_s"][-1] == pytest.approx(1.5 * 3.0, abs=0.6)
    assert np.abs(log["altitude_m"] - 30.0).max() < 0.3
    assert np.abs(log["roll_rad"]).max() < 0.02


def test_without_an_engine_its_hinges_catch_it() -> None:
    """It turned through 90 deg of heading within 3 s and fell; caught with its lift turned away it fell 4.7 m."""
    lost, turned = [], []
    for jet in (1, 3):
        fault = [{"kind": "flame_out", "start_s": 0.5, "jet": jet}]
        hover = Scenario.load("jetwing-hover").replace(fault=fault, expect=[], duration_s=5.0)
        run = fly(hover.replace(initial={"altitude_m": 30.0}))
        assert run.outcome == "completed"
        lost.append(30.0 - float(run.log["altitude_m"].min()))
        turned.append(degrees(np.abs(np.unwrap(run.log["yaw_rad"])).max()))
    assert lost == pytest.approx([2.3, 1.9], abs=0.1)
    assert turned == pytest.approx([6.0, 150.0], abs=1.0)


STILL = {"turbulence_wind_m_s": 0.0, "turbulence_severity": 0}


@pytest.mark.long
def test_the_figures_without_an_engine_on_its_wing() -> None:
    """Long.  It stays there on the other three and its rudder, and comes back to its jets."""
    cruise = Scenario.load("jetwing-cruise").replace(environment=STILL, expect=[], duration_s=30.0)
    off, turns, slowest = 0.0, 0.0, 25.0
    for jet in (1, 3):
        log = fly(cruise.replace(fault=[{"kind": "flame_out", "start_s": 15.0, "jet": jet}])).log
        since = log["time_s"] > 15.0
        off = max(off, float(np.abs(log["altitude_m"][since] - 60.0).max()))
        turns = max(turns, degrees(np.abs(log["yaw_rad"][since]).max()))
        slowest = min(slowest, float(log["velocity_north_m_s"][since].min()))
    assert (off, turns, 25.0 - slowest) == pytest.approx((2.6, 3.0, 1.1), abs=0.5)
    brake = [
        {"kind": "step", "signal": "ahead_m_s", "start_s": at, "amplitude": by} for at, by in ((0, 0.0), (10, -25.0))
    ]
    fallen, fastest = 0.0, 0.0
    for jet in (1, 2, 3, 4):
        lost = [{"kind": "flame_out", "start_s": 5.0, "jet": jet}]
        back = fly(cruise.replace(fault=lost, command=brake, duration_s=45.0))
        assert back.outcome == "completed"
        fallen = max(fallen, 60.0 - float(back.log["altitude_m"].min()))
        fastest = max(fastest, float(back.log["velocity_north_m_s"][-1]))
    assert (fallen, fastest) == pytest.approx((4.0, 6.0), abs=0.5)


def test_without_an_engine_its_wing_hands_over_to_its_hinges() -> None:
    """Throttles that turned it would be too late below the speed from which on the wing carries."""
    cruise = Scenario.load("jetwing-cruise").replace(environment=STILL, expect=[], duration_s=9.0)
    slower = [{"kind": "step", "signal": "ahead_m_s", "start_s": 0.0, "amplitude": -25.0}]
    lost = [{"kind": "flame_out", "start_s": 0.5, "jet": 3}]
    slow = {**cruise.model_dump()["initial"], "velocity_ned_m_s": [12.0, 0.0, 0.0]}
    log = fly(cruise.replace(initial=slow, fault=lost, command=slower)).log
    on_wing, ahead = log["wing_lift_N"] > 0.0, log["ahead_m_s"]
    since = int(np.flatnonzero(~on_wing & (log["time_s"] > 1.0))[0])
    assert ahead[since - 1] == pytest.approx(10.0, abs=0.1)
    assert not on_wing[since:].any()
    assert np.abs(log["roll_rad"][since:]).max() < 0.3


def test_the_nose_leads_no_further_than_stated_where_lift_is_missing() -> None:
    simulation = build(Scenario.load("jetwing-transition"))
    wing = wing_of(simulation)
    weight = VEHICLE.mass_kg * GRAVITY
    level = Measured(ZERO3, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -60.0), (15.0, 0.0, 0.0), 60.0)
    for vertical, leads in ((1.0, 0.0), (1.02, 0.02), (2.0, None)):
        wing.reset()
        for _ in range(1000):
            asked = wing.attitude(Command(ZERO3, 60.0, ahead=15.0), 15.0, level)
            wing.actuator_demand(vertical * weight, level, 0.0)
        lead = asked.attitude[1] - wing.shown[2]
        late = 1.0 / VEHICLE.control.attitude.gain_1_s[1] + 1.0 / VEHICLE.control.rate.pitch.p
        expected = MAX_LEAD_FRACTION * 0.14 if leads is None else late * leads * GRAVITY / 15.0
        assert lead == pytest.approx(expected, abs=1e-9)
    simulation.close()


def test_turbulence_may_meet_a_flight_that_is_under_way() -> None:
    log = fly(Scenario.load("jetwing-cruise").replace(expect=[], duration_s=0.1)).log
    assert np.isfinite(log["altitude_m"]).all()
    assert np.abs(log["wind_down_m_s"]).max() > 0.0


def test_a_vehicle_without_a_wing_says_so(tmp_path: Path) -> None:
    (tmp_path / "ahead.csv").write_text("time_s,ahead_m_s\n0.0,0.0\n1.0,5.0\n")
    stated = {"kind": "step", "signal": "ahead_m_s", "start_s": 0.0, "amplitude": 5.0}
    for command in (stated, {"kind": "table", "file": str(tmp_path / "ahead.csv"), "start_s": 0.0}):
        with pytest.raises(InputError, match=r"'ahead_m_s': trijet has no \[control.wing\] to fly ahead with"):
            build(Scenario.load("trijet-hover").replace(command=[command]))


def test_its_model_is_asked_of_wing_and_surfaces_once(monkeypatch: pytest.MonkeyPatch) -> None:
    first = build(Scenario.load("jetwing-hover"))
    first.close()
    for name in ("wing_effects", "surface_effects"):
        monkeypatch.setattr(Airframe, name, lambda *_: pytest.fail("asked again"))
    again = build(Scenario.load("jetwing-cruise"))
    assert wing_of(again)._table == wing_of(first)._table
    again.close()
    lighter = Scenario.load("jetwing-hover").replace(vehicle={"mass_kg": 4.4})
    with pytest.raises(pytest.fail.Exception, match="asked again"):
        build(lighter)
