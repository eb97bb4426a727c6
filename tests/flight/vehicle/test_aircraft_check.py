"""hexjet aircraft: a start that flies, and what is found to be wrong with what was made of it."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet

from cosim import InputError, Scenario, fly
from cosim.aircraft_check.check import AircraftCheck, check_aircraft
from cosim.control.allocation.authority import Reach
from cosim.results.log.digest import log_digest
from cosim.spec.vehicle import aircraft_names, load_vehicle


def test_authority_of_a_quadrotor_is_what_it_is_by_hand() -> None:
    """Two rotors of a side up and two down by d: 4 d y about x, 4 d x about y; by their reactions 4 d c about z."""
    vehicle, _ = load_vehicle("quadrotor")
    least, most, weight = np.full(4, 0.5), np.full(4, 4.0), 6.0
    x, y, _ = np.abs(vehicle.jets[0].position_m)
    c = abs(vehicle.jets[0].reaction_m)
    d = min(4.0 - 1.5, 1.5 - 0.5)
    reach = Reach(vehicle.layout(), least.tolist(), most.tolist(), [], [], weight)
    whole = reach.authority()
    assert whole.moment == pytest.approx((4 * d * y, 4 * d * x, 4 * d * c), rel=1e-9)
    assert whole.lift == pytest.approx(16.0 / 6.0, rel=1e-9)
    lost = reach.authority([2])
    assert lost.moment is None


def test_tilted_jets_push_forward_and_turn_about_their_lever() -> None:
    vehicle, _ = load_vehicle("hexjet")
    reach = Reach(vehicle.layout(), [0.0] * 6, [1.0] * 6, [(-0.5, 0.5)] * 2, [0.0, 0.0], 1.0)
    wrench, _ = reach._linearise_wrench(np.zeros(6), (0.2, -0.1))
    left, right = vehicle.jets[1], vehicle.jets[0]
    assert wrench[:3, 1] == pytest.approx([np.sin(0.2), 0.0, -np.cos(0.2)])
    for column, jet, tilt in ((1, left, 0.2), (0, right, -0.1)):
        force = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
        assert wrench[3:, column] == pytest.approx(np.cross(jet.position_m, force))


def test_a_new_one_flies_as_what_it_began_as_and_is_fit(hexjet: Hexjet) -> None:
    made = hexjet("aircraft", "new", "mine", "--from", "quadrotor")
    assert made.status == 0
    assert made.out.splitlines()[1:] == ["hexjet aircraft check ./mine", "hexjet fly hover --aircraft ./mine"]
    done = hexjet("aircraft", "check", "./mine", "--json", "--out", "check")
    assert done.status == 0, done.err
    report = json.loads(done.out)
    assert report["fit"]
    assert [line["fault"] for line in report["checks"]] == [""] * len(report["checks"])
    drawing = ET.parse("check/aircraft.svg").getroot()
    texts = [element.text for element in drawing.iter("{http://www.w3.org/2000/svg}text")]
    assert {"1", "2", "3", "4", "from above", "from the right", "from the front"} <= set(texts)
    changes = {"duration_s": 0.3, "expect": [], "engine": "motor", "controller": "baseline", "step_s": 0.0025}
    mine, theirs = (
        fly(Scenario.load("hover").replace(aircraft=name, **changes))
        for name in (str(Path("mine").absolute()), "quadrotor")
    )
    assert log_digest(mine.log) == log_digest(theirs.log)


@pytest.mark.parametrize("base", aircraft_names())
def test_every_base_can_be_begun_from(hexjet: Hexjet, base: str) -> None:
    assert hexjet("aircraft", "new", "mine", "--from", base).status == 0
    theirs, mine = load_vehicle(base)[0], load_vehicle("./mine")[0]
    differing = {key for key in type(mine).model_fields if getattr(mine, key) != getattr(theirs, key)}
    assert differing - ({"engine"} if base == "crazyflie" else set()) <= {"name", "title", "model"}
    text = Path("mine/vehicle.toml").read_text()
    assert "[scaled]" not in text
    assert [line for line in text.splitlines() if re.search(r"#.*(README|design\.toml|docs/|tests/)", line)] == []


def faults(report: AircraftCheck) -> dict[str, str]:
    return {line.name: line.fault for line in report.lines if line.fault}


def altered(*changes: tuple[str, str]) -> dict[str, str]:
    path = Path("mine/vehicle.toml")
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return faults(check_aircraft("./mine"))


def test_what_is_wrong_is_found(hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.aircraft_check.check.FLIGHT_S", 0.5)
    hexjet("aircraft", "new", "mine", "--from", "quadrotor")
    original = Path("mine/vehicle.toml").read_text()
    mass = next(line for line in original.splitlines() if line.startswith("mass_kg"))
    inertia = next(line for line in original.splitlines() if line.startswith("inertia_kg_m2"))
    with pytest.raises(InputError, match=r"inertia_kg_m2\.0 = 1\.92 with mass_kg = .*: a radius of gyration of 1\.8 m"):
        altered((inertia, "inertia_kg_m2 = [1.92, 1.92, 3.40]"))  # g m^2
    Path("mine/vehicle.toml").write_text(original)
    assert altered((mass, "mass_kg = 1.7")) == {"hover": "less than 1.15: height and attitude fight for it"}
    Path("mine/vehicle.toml").write_text(original)
    with pytest.raises(InputError, match=r"mine \(59 kg\) would hover at throttle"):
        altered((mass, "mass_kg = 59.0"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("new", "my plane"),
            "'my plane' is no name for an aircraft: letters, digits, - and _, a letter or digit first",
        ),
        (("new", "hexjet"), "hexjet: is the name of an aircraft that is shipped; choose another"),
        (("new", "mine", "--from", "hexjett"), "base: 'hexjett': must be one that is shipped; did you mean 'hexjet'?"),
        (("new", "held"), "held/vehicle.toml: is there already"),
        (("check", "./none"), "none: no such file"),
    ],
)
def test_a_wrong_call_is_one_line(hexjet: Hexjet, arguments: tuple[str, ...], said: str) -> None:
    Path("held").mkdir()
    Path("held/vehicle.toml").write_text("name = 'held'\n")
    done = hexjet("aircraft", *arguments)
    assert done.status == 2
    assert said in done.err
    assert done.err.count("\n") == 1
