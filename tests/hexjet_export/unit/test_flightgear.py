"""FlightGear's packets (docs/runs.md): their layout by its header, what stands in them, and a flight that sends them."""

from __future__ import annotations

import socket
import struct
from math import degrees, pi

import pytest
from command_tools import Hexjet
from patience import PATIENCE

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.base.signals import Sample
from hexjet_export.logs import flightgear
from hexjet_export.logs.flightgear import FORMAT, PACKETS_PER_S, FlightGear, pack_state, parse_address

# Where fields begin, counted by hand from FGNetFDM in net_fdm.hxx: types and array lengths as they stand there.
PLACES = {
    "version": (0, "I"), "longitude": (8, "d"), "latitude": (16, "d"), "altitude": (24, "d"), "agl": (32, "f"),
    "phi": (36, "f"), "theta": (40, "f"), "psi": (44, "f"), "beta": (52, "f"), "phidot": (56, "f"), "psidot": (64, "f"),
    "vcas": (68, "f"), "climb_rate": (72, "f"), "v_north": (76, "f"), "v_down": (84, "f"), "v_body_v": (92, "f"),
    "A_Z_pilot": (108, "f"), "num_engines": (120, "I"), "eng_state": (124, "I"), "rpm": (140, "f"), "egt": (188, "f"),
    "num_tanks": (284, "I"), "num_wheels": (304, "I"), "wow": (308, "I"), "visibility": (364, "f"), "spoilers": (404, "f"),
}  # fmt: skip


def decoded(data: bytes) -> dict[str, float]:
    return {name: struct.unpack_from(f">{kind}", data, place)[0] for name, (place, kind) in PLACES.items()}


def test_the_size_is_flightgears() -> None:
    assert struct.calcsize(FORMAT) == 408


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """A short flight in a side wind, rolling."""
    seen: list[Sample] = []

    class Keep:
        def observe(self, sample: Sample) -> None:
            seen.append(sample)

    scenario = Scenario.load("roll-doublet").replace(
        duration_s=0.4, expect=[], environment={"wind_ned_m_s": [0.0, 3.0, 0.0], "ground_m": 100.0},
        initial={"rate_deg_s": [20.0, 0.0, 0.0], "attitude_deg": [0.0, 0.0, 90.0]},
    )  # fmt: skip
    fly(scenario, observers=[Keep()])
    return seen


def test_what_stands_in_a_packet(samples: list[Sample]) -> None:
    sample = samples[50]
    state, where = sample.state, Geodesy(22.35, 113.59, 100.0)
    found = decoded(pack_state(sample, where))
    assert found["version"] == 24
    latitude, longitude, height = where.to_geodetic(state.position[0], state.position[1], state.altitude)
    assert (degrees(found["latitude"]), degrees(found["longitude"])) == pytest.approx((latitude, longitude), abs=1e-12)
    assert found["altitude"] == height == pytest.approx(100.0 + state.altitude)
    assert [found[name] for name in ("phi", "theta", "psi")] == pytest.approx(state.euler, abs=1e-6)
    assert found["v_north"] == pytest.approx(state.velocity[0] / 0.3048, abs=1e-6)
    assert found["climb_rate"] == pytest.approx(-found["v_down"], abs=1e-6)
    assert found["A_Z_pilot"] == pytest.approx(state.specific_force[2] / 0.3048, rel=1e-6)
    assert found["num_engines"] == 4
    assert found["eng_state"] == 2
    assert (found["num_wheels"], found["wow"]) == (3, 0)
    assert found["visibility"] == flightgear.VISIBILITY_M


def test_the_rates_are_those_of_the_angles(samples: list[Sample]) -> None:
    """Against the differences of the angles themselves."""
    where = Geodesy(22.35, 113.59)
    before, at, after = samples[49], samples[50], samples[51]
    step = after.time - before.time
    found = decoded(pack_state(at, where))
    for name, axis in (("phidot", 0), ("psidot", 2)):
        slope = (after.state.euler[axis] - before.state.euler[axis]) / step
        assert found[name] == pytest.approx(slope, abs=2e-3)


def test_the_air_comes_from_where_the_wind_does(samples: list[Sample]) -> None:
    """At rest with the nose to the east in air that moves east: from behind, 3 m/s, without a slip."""
    sample = samples[5]
    assert sample.state.wind == pytest.approx((0.0, 3.0, 0.0), abs=1e-6)
    found = decoded(pack_state(sample, Geodesy(22.35, 113.59)))
    assert found["vcas"] == pytest.approx(3.0 * 3600.0 / 1852.0, rel=0.01)
    assert abs(found["beta"]) < 0.02
    assert abs(found["psi"] - pi / 2.0) < 0.02
    # another reader of the same packets
    other = pytest.importorskip("pymavlink.fgFDM").fgFDM()
    other.parse(pack_state(sample, Geodesy(22.35, 113.59)))
    for name in PLACES:
        if name not in ("eng_state", "rpm", "egt", "wow", "v_body_v"):  # arrays, and one that is called otherwise there
            assert other.get(name) == pytest.approx(found[name], rel=1e-9), name
    assert other.get("v_north", units="mps") == pytest.approx(sample.state.velocity[0], abs=1e-6)


def test_a_flight_sends_sixty_packets_a_second(samples: list[Sample]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(PATIENCE)
        viewer = FlightGear(str(listening.getsockname()[1]), Scenario.load("hover").environment)
        for sample in samples:
            viewer.observe(sample)
        viewer.close()
        got = [listening.recv(2048) for _ in range(round(0.4 * PACKETS_PER_S))]
    assert {len(each) for each in got} == {408}
    times = [decoded(each)["phi"] for each in got]
    assert times[0] == pytest.approx(samples[0].state.euler[0], abs=1e-6)
    assert len(set(times)) > len(times) // 2


@pytest.mark.parametrize("address", ["", "x", "0", "70000", "host:", "5550:udp"])
def test_an_address_that_is_none(address: str) -> None:
    with pytest.raises(InputError, match="must be PORT or HOST:PORT"):
        parse_address(address)


def test_the_command_flies_with_nobody_there(hexjet: Hexjet) -> None:
    done = hexjet(
        "fly", "hover", "--set", "duration_s=0.1", "--flightgear", "45550", "--rtf", "0", "--out", "flown", "--json"
    )
    assert done.status == 0, done.err
    assert hexjet("fly", "hover", "--flightgear", "nowhere", "--out", "other").status == 2
