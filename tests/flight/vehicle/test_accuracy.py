"""How exact the airframe is: NASA's check cases, and an independent integration of our own flights."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from places import ROOT

from benchmarks.accuracy.check_cases import CASES, QUANTITIES, Array, compare, fly_case, read_simulators
from benchmarks.accuracy.exact import density, geodetic, gravitation, local, start
from benchmarks.accuracy.flights import OFF_CENTRE, SCHEMES, Course, course, error, exact, fly_again, from_the_log
from cosim import Scenario, fly

# Least and greatest of NASA's simulators after 30 s, from the same files, for where these are not at hand
AFTER_30_S: dict[str, dict[str, tuple[float, float]]] = {
    "02": {
        "feVelocity_ft_s_Y": (2.100310896, 2.101011086627401),
        "feVelocity_ft_s_Z": (960.292948985, 960.2930953),
        "altitudeMsl_ft": (15598.90389, 15598.9059736),
        "longitude_deg": (5.74e-05, 5.74552213287e-05),
        "eulerAngle_deg_Yaw": (-4.28935504226, -4.146742),
        "eulerAngle_deg_Pitch": (-3.821955266387911, -3.505810107),
        "eulerAngle_deg_Roll": (-59.85663392, -56.150304320773394),
        "bodyAngularRateWrtEi_deg_s_Roll": (12.61839077566776, 12.620844062702608),
        "bodyAngularRateWrtEi_deg_s_Pitch": (-17.3974747619, -17.394550197091117),
        "bodyAngularRateWrtEi_deg_s_Yaw": (31.1195888868, 31.12073831148526),
    },
    "03": {
        "feVelocity_ft_s_Y": (2.100310896, 2.1010110866266887),
        "feVelocity_ft_s_Z": (960.293064507, 960.2930953),
        "altitudeMsl_ft": (15598.90389, 15598.9046837),
        "longitude_deg": (5.74e-05, 5.74552233006e-05),
        "eulerAngle_deg_Yaw": (-111.66967658395333, -111.35836388895274),
        "eulerAngle_deg_Pitch": (-39.35000687, -38.69970978266794),
        "eulerAngle_deg_Roll": (-5.148413928481029, -5.083261585),
        "bodyAngularRateWrtEi_deg_s_Roll": (-0.001187561045469286, -2.778098017255249e-23),
        "bodyAngularRateWrtEi_deg_s_Pitch": (-1.5985522484127e-06, 0.003790049812324711),
        "bodyAngularRateWrtEi_deg_s_Yaw": (1.7355824190446156e-05, 0.0013143371217074406),
    },
    "06": {
        "feVelocity_ft_s_Y": (1.842320739, 1.84318916077271),
        "feVelocity_ft_s_Z": (863.969620489, 864.1107492138067),
        "altitudeMsl_ft": (16283.8269023858, 16284.7227329),
        "longitude_deg": (5.33700208807e-05, 5.34e-05),
    },
    "07": {
        "feVelocity_ft_s_Y": (4.70595712808921, 4.70984159128),
        "feVelocity_ft_s_Z": (863.925662411, 864.0668375323617),
        "altitudeMsl_ft": (16284.5440914928, 16285.440553),
        "longitude_deg": (0.0001284744802148, 0.000128580722916),
    },
    "09": {
        "feVelocity_ft_s_Y": (610.549656587, 610.746581927),
        "feVelocity_ft_s_Z": (181.748229037, 181.903793657),
        "altitudeMsl_ft": (10156.7197821401, 10160.9897645),
        "longitude_deg": (0.0616343433543985, 0.0616478507138),
    },
}

DATA = ROOT.parent / "shared" / "data" / "nesc"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="NASA's trajectories are not beside this clone")


@pytest.fixture(scope="module")
def flown() -> dict[str, dict[str, Array]]:
    return {number: fly_case(case) for number, case in CASES.items()}


@needs_data
@pytest.mark.parametrize("number", CASES)
def test_every_quantity_is_inside_the_spread(number: str, flown: dict[str, dict[str, Array]]) -> None:
    rows = compare(number, flown[number], read_simulators(DATA, number))
    assert len(rows) == len(QUANTITIES)
    for row in rows:
        assert row.inside, row


@pytest.mark.parametrize("number", CASES)
def test_after_half_a_minute_as_nasas_simulators(number: str, flown: dict[str, dict[str, Array]]) -> None:
    """Without the files: nearer to the nearest of them than they are to each other."""
    for quantity, (low, high) in AFTER_30_S[number].items():
        assert low - (high - low) <= flown[number][quantity][-1] <= high + (high - low), quantity


@needs_data
@pytest.mark.parametrize("number", CASES)
def test_the_typed_values_are_those_of_the_files(number: str) -> None:
    theirs = read_simulators(DATA, number)
    for quantity, (low, high) in AFTER_30_S[number].items():
        last = [columns[quantity][0][-1] for columns in theirs.values() if quantity in columns]
        assert (low, high) == (min(last), max(last))


@needs_data
def test_a_wrong_body_is_found_outside() -> None:
    """A thousandth of one moment of inertia, a hundredth of the drag: the comparison sees both."""
    x, y, z = CASES["02"].inertia_slug_ft2
    wrong = replace(CASES["02"], inertia_slug_ft2=(x, 1.001 * y, z))
    rows = {row.quantity: row.inside for row in compare("02", fly_case(wrong), read_simulators(DATA, "02"))}
    assert not rows["bodyAngularRateWrtEi_deg_s_Pitch"]
    wrong = replace(CASES["06"], drag_area_ft2=1.01 * CASES["06"].drag_area_ft2)
    rows = {row.quantity: row.inside for row in compare("06", fly_case(wrong), read_simulators(DATA, "06"))}
    assert not rows["altitudeMsl_ft"]


def test_the_other_integration_knows_the_earth() -> None:
    """Normal gravity of WGS 84 at equator and pole, sea-level density, and geodetic places there and back."""
    for latitude, gravity, radius in ((0.0, 9.7803253, 6378137.0), (np.pi / 2, 9.8321849, 6356752.314)):
        r = radius * np.array([np.cos(latitude), 0.0, np.sin(latitude)])
        outward = 7.292115e-5**2 * radius if latitude == 0.0 else 0.0
        # J2 alone: the next term, J4, is 1.2e-4 m/s^2 at the pole
        assert np.linalg.norm(gravitation(r)) - outward == pytest.approx(gravity, abs=1.5e-4)
    assert density(0.0) == pytest.approx(1.225, rel=1e-5)
    assert density(5000.0) == pytest.approx(0.7364, rel=1e-4)
    motion, _ = fly_again(replace(FALL, inputs=FALL.inputs[:1]), SCHEMES["flown"], 4)
    latitude, longitude, height = geodetic(start(22.35, 113.59, 31.5, motion)[:3])
    assert np.degrees([latitude, longitude]) == pytest.approx([22.35, 113.59], abs=1e-12)
    assert height == pytest.approx(31.5, abs=1e-8)
    axes = local(latitude, longitude)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-15)


@pytest.fixture(scope="module")
def doublet() -> tuple[Course, list]:  # type: ignore[type-arg]
    flown = course("roll doublet", "roll-doublet", {"duration_s": 2.0})
    return flown, exact(flown, 1)


FALL = course("hover", "hover", {"duration_s": 0.2})


def test_the_other_integration_is_exact(doublet: tuple[Course, list]) -> None:  # type: ignore[type-arg]
    flown, truth = doublet
    finer = error(exact(flown, 4), truth)
    assert finer.attitude_deg < 1e-9
    assert finer.place_mm < 1e-3  # of an inertial place of 6e9 mm that moves at 4e5 mm/s


def test_the_airframe_converges_to_it_with_the_square_of_the_run(doublet: tuple[Course, list]) -> None:  # type: ignore[type-arg]
    flown, truth = doublet
    errors = {runs: error(fly_again(flown, SCHEMES["flown"], runs)[1], truth) for runs in (4, 8, 16)}
    assert errors[4].attitude_deg < 1e-3
    assert errors[4].rate_deg_s < 1e-4
    assert errors[4].velocity_mm_s < 0.1
    for coarse, fine in ((4, 8), (8, 16)):
        assert errors[coarse].attitude_deg / errors[fine].attitude_deg == pytest.approx(4.0, rel=0.1)


def test_without_the_make_up_a_force_is_half_a_run_late(doublet: tuple[Course, list]) -> None:  # type: ignore[type-arg]
    """All other errors are small beside half a run times the roll rate, and that is of first order."""
    flown, truth = doublet
    late = [error(fly_again(flown, SCHEMES["late"], runs)[1], truth).attitude_deg for runs in (4, 8)]
    fastest = max(np.abs(motion.rate[0]) for motion in truth)
    assert late[0] == pytest.approx(np.degrees(fastest) * 0.0005, rel=0.1)
    assert late[0] / late[1] == pytest.approx(2.0, rel=0.05)


def test_a_payload_off_to_the_side_is_carried_alike() -> None:
    """Mass, centre and products of inertia from the step on in which it comes; half a run late was 1e-3 of the rate."""
    flown = replace(FALL, inputs=[replace(FALL.inputs[0], disturbance=PAYLOAD)] * 100)
    truth = exact(flown)
    spin = np.linalg.norm(truth[-1].rate)
    assert spin > 1.0
    found = fly_again(flown, SCHEMES["flown"], 4)[1]
    assert np.linalg.norm(found[-1].rate - truth[-1].rate) < 2e-5 * spin
    assert error(found, truth).place_mm < 0.1
    late = fly_again(flown, SCHEMES["masses"], 4)[1]
    assert np.linalg.norm(late[-1].rate - truth[-1].rate) > 1e-3 * spin


PAYLOAD = FALL.inputs[0].disturbance._replace(payload=(0.5, 0.1, -0.05, 0.04))


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("payload-drop", {"duration_s": 3.0}),
        ("full-scale-roll-doublet", {"vehicle": OFF_CENTRE, "duration_s": 5.0}),
        ("full-scale-yaw-doublet", {"engine": "turbine-220"}),
        ("trijet-yaw-doublet", {"duration_s": 4.0}),
    ],
    ids=["payload", "fuel", "rotors", "hinges"],
)
def test_masses_and_rotors_act_with_the_forces(name: str, changes: dict[str, Any]) -> None:
    """Second order like all else: a quarter of the error with twice the runs, where half a run late leaves a half."""
    flown = course(name, name, changes)
    truth = exact(flown, 1)
    coarse, fine = (error(fly_again(flown, SCHEMES["flown"], runs)[1], truth) for runs in (4, 8))
    late = error(fly_again(flown, SCHEMES["masses"], 4)[1], truth)
    assert coarse.attitude_deg < 1e-3
    assert coarse.velocity_mm_s < 0.1
    assert coarse.attitude_deg / fine.attitude_deg == pytest.approx(4.0, rel=0.25)
    assert late.attitude_deg > 5.0 * coarse.attitude_deg


def test_a_gust_in_turbulence_is_integrated_from_its_log() -> None:
    """The whole of ``gust``, damping, gust and drag off the centre included.

    Linear between rows is not what the turbulence, which changes at every run, did there; the rest is the airframe's own
    error.  Without the rate of the air the equations miss what the damping makes of it.
    """
    scenario = Scenario.load("gust").replace(expect=[])
    log = fly(scenario).log
    assert log["air_rate_p_rad_s"].std() > 0.2  # a vehicle as small as this is turned, not only pushed
    rate, velocity = from_the_log(log, scenario)
    without, _ = from_the_log(log, scenario, air_turns=False)
    assert rate < 2e-4
    assert velocity < 2e-4
    assert without > 30.0 * rate


def test_without_turbulence_the_air_does_not_turn() -> None:
    log = fly(Scenario.load("gust").replace(duration_s=0.4, environment={"turbulence_severity": 0}, expect=[])).log
    assert log["wind_north_m_s"][1:] == pytest.approx(3.0)
    for axis in "pqr":
        assert not log[f"air_rate_{axis}_rad_s"].any()
