"""What a user gets wrong in a vehicle: each mistake is one line that names key, value and what is allowed."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from places import ROOT

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.engine.source import find_source
from cosim.spec.vehicle import aircraft_names, engine_of, load_vehicle
from cosim.vehicle.jsbsim_model import render

Table = dict[str, Any]
Change = Callable[[Table], object]


def put(*path: str | int, to: object) -> Change:
    """Write a value at a place of the table."""

    def change(table: Table) -> None:
        here: Any = table
        for part in path[:-1]:
            here = here[part]
        here[path[-1]] = to

    return change


def each(lists: str, key: str, of: Callable[[Any], Any]) -> Change:
    """Change one key of every entry of a list."""

    def change(table: Table) -> None:
        for entry in table[lists]:
            entry[key] = of(entry[key])

    return change


def whole(table: Table) -> None:
    """Every place in mm."""
    for lists in ("jets", "contacts"):
        each(lists, "position_m", lambda place: [1000.0 * x for x in place])(table)


def legs(table: Table, *places: list[float]) -> None:
    kept = [contact for contact in table["contacts"] if contact["kind"] == "leg"]
    others = [contact for contact in table["contacts"] if contact["kind"] != "leg"]
    table["contacts"] = others + [leg | {"position_m": place} for leg, place in zip(kept, places, strict=False)]


HINGE = {"name": "nose", "position_m": [0.1, 0.0, 0.0], "axis": [0.0, 1.0, 0.0], "carries": [1], "lag_s": 0.02,
         "rate_limit_rad_s": 5.0, "range_rad": 0.3}  # fmt: skip

SURFACE = {"name": "elevator", "property": "fcs/elevator-cmd-norm", "lag_s": 0.02, "rate_limit_1_s": 10.0}


def hinged(**changes: object) -> Change:
    """Jets on a hinge in place of the banks."""

    def change(table: Table) -> None:
        del table["servo"]
        for jet in table["jets"]:
            del jet["servo"]
        table["control"]["allocation"].pop("method", None)
        table["hinges"] = [HINGE | changes]

    return change


def twice(table: Table) -> None:
    hinged()(table)
    table["hinges"] = [HINGE, HINGE]


MISTAKES: dict[str, tuple[Change, str]] = {
    "no mass": (lambda t: t.pop("mass_kg"), r"mass_kg is missing$"),
    "mass of nothing": (put("mass_kg", to=0.0), r"mass_kg = 0\.0: .*greater than 0"),
    "mass in g": (put("mass_kg", to=5525.0), r"inertia_kg_m2\.0 = \S+ with mass_kg = 5525: .* is allowed: are they in kg"),
    "a mass with its unit": (put("mass_kg", to="5.5 kg"), r"mass_kg = '5\.5 kg': must be a number"),
    "inertia of no body": (put("inertia_kg_m2", to=[0.04, 0.05, 0.2]), r"inertia_kg_m2 \[0\.04, 0\.05, 0\.2\]: no body"),
    "inertia in g m^2": (
        put("inertia_kg_m2", to=[41.0, 51.0, 69.0]),
        r"inertia_kg_m2\.0 = 41 with .* to \S+ kg m\^2 is allowed",
    ),
    "products of no body": (put("products_kg_m2", to=[0.0, 3.0, 0.0]), r"products_kg_m2 \[0\.0, 3\.0, 0\.0\]: no body"),
    "places in mm": (whole, r"jets\.0\.position_m \[130\.0, 150\.0, \S+\]: \S+ m .* at most 100 m is allowed"),
    "a place that is none": (put("jets", 2, "position_m", 0, to=float("nan")), r"jets\.2\.position_m\.0 = nan: .*finite"),
    "a key with a letter less": (put("mas_kg", to=5.0), r"unknown key 'mas_kg'; did you mean 'mass_kg'"),
    "30 rad of tilt": (put("servo", "range_rad", to=30.0), r"servo\.range_rad = 30\.0: .*less than or equal to 3\.2"),
    "a spin of two": (put("jets", 0, "spin", to=2), r"jets\.0\.spin = 2: .*-1, 0 or 1"),
    "banks without a servo": (lambda t: t.pop("servo"), r"jets: either all jets have a servo and there is a table \[servo\]"),
    "no jets": (put("jets", to=[]), r"jets: needs at least 1"),
    "too many jets": (lambda t: put("jets", to=t["jets"] * 6)(t), r"jets: may have at most 16, not 36"),
    "two contacts of one name": (
        put("contacts", 1, "name", to="leg_front_right"),
        r"contacts: two are called 'leg_front_right'; names must differ",
    ),
    "a contact with a quote in its name": (
        put("contacts", 1, "name", to="a'b"),
        r"""contacts\.1\.name = "a'b": .*pattern""",
    ),
    "a leg upwards": (put("contacts", 0, "position_m", 2, to=-0.2), r"contacts\.0\.position_m \[.*-0\.2\]: .* must be above 0"),
    "no legs": (legs, r"contacts: 0 of kind 'leg'; .* three at least"),
    "all legs in front": (
        lambda t: legs(t, [0.2, 0.2, 0.2], [0.2, -0.2, 0.2], [0.1, 0.0, 0.2]),
        r"contacts: the centre of gravity, \[0, 0\], is not between the legs at \[0\.2, 0\.2\], .* must stand around it",
    ),
    "more fuel than vehicle": (
        put("fuel", to={"mass_kg": 9.0, "position_m": [0.0, 0.0, 0.0]}),
        r"fuel\.mass_kg 9 is a part of mass_kg 5\.525 and must be below it",
    ),
    "a tank too far out": (
        put("fuel", to={"mass_kg": 3.0, "position_m": [0.3, 0.0, 0.0]}),
        r"fuel: 3 kg at \[0\.3, 0\.0, 0\.0\] leave .* which no body has",
    ),
    "hinge upside down": (hinged(range_rad=[0.3, -0.3]), r"hinges\.0.*: range_rad \[0\.3, -0\.3\]: the first must be below"),
    "hinge in degrees": (hinged(range_rad=30.0), r"hinges\.0.*: range_rad \[-30, 30\]: .* which unit\?"),
    "hinge of a jet that there is not": (hinged(carries=[7]), r"hinges\.0: jet 7: there are jets 1 to 6"),
    "hinge without a direction": (hinged(axis=[0.0, 0.0, 0.0]), r"hinges\.0\.axis: must have a direction, not \[0, 0, 0\]"),
    "two hinges of one name": (twice, r"hinges, surfaces: two are called 'nose'; names must differ"),
    "surfaces beside banks": (put("surfaces", to=[SURFACE]), r"surfaces: the allocation of the two banks of \[servo\] moves none"),
    "a name with a space": (put("name", to="my own"), r"name = 'my own': letters, digits, - and _ are allowed"),
    "a shipped one's name": (put("name", to="hexjet"), r"name = 'hexjet': is the name of an aircraft that is shipped"),
    "scaled from nothing": (
        put("scaled", to={"base": "hexjett", "mass_kg": 5.0}),
        r"scaled\.base: unknown aircraft 'hexjett'; did you mean 'hexjet'",
    ),
    "hinges scaled": (
        put("scaled", to={"base": "quadjet", "mass_kg": 5.0}),
        r"scaled\.base: quadjet is not of banks or rotors .* --from quadjet copies it as it is",
    ),
    "a panel of a surface that there is not": (
        put("panels", to=[{"corners_m": [[0.0, 0.0, 0.0]] * 3, "surface": "flap"}]),
        r"panels\.0\.surface: no surface is called 'flap'; there are none",
    ),
    "a panel that nothing turns": (
        put("panels", to=[{"corners_m": [[0.0, 0.0, 0.0]] * 3, "turn_rad": 0.3}]),
        r"panels\.0\.turn_rad 0\.3: no surface is named that turns it",
    ),
    "an engine's file that there is not": (put("engine", to="their.fmu"), r"engine = 'their\.fmu': no such file, as seen from"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / "aircraft" / "hexjet", tmp_path / "mine")
    return tmp_path / "mine"


def taken(folder: Path) -> None:
    """The vehicle, its engine and its model, as who flies it takes them."""
    vehicle, place = load_vehicle(str(folder))
    find_source(str(engine_of(str(folder))))
    render(vehicle, place / str(vehicle.model))


def line_of(folder: Path) -> str:
    """What whoever flies it is told first."""
    with pytest.raises(InputError) as told:
        taken(folder)
    text = str(told.value)
    assert "\n" not in text
    assert text.startswith(str(folder)) or "engine" in text
    return text


def test_the_vehicle_that_the_mistakes_are_made_in_is_right(folder: Path) -> None:
    put("name", to="mine")(table := read_toml(folder / "vehicle.toml"))
    (folder / "vehicle.toml").write_text(tomli_w.dumps(table))
    vehicle, place = load_vehicle(str(folder))
    assert render(vehicle, place / str(vehicle.model))
    for name in aircraft_names():
        load_vehicle(name)


@pytest.mark.parametrize("name", [5, [], None, Path("hexjet")])
def test_what_is_no_name_of_an_aircraft_is_one_line(name: object) -> None:
    with pytest.raises(InputError, match=r"^aircraft .*: must be a name or a path, as a text$"):
        load_vehicle(name)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(folder: Path, mistake: str) -> None:
    change, said = MISTAKES[mistake]
    table = read_toml(folder / "vehicle.toml") | {"name": "mine"}
    change(table)
    (folder / "vehicle.toml").write_text(tomli_w.dumps(table))
    line = line_of(folder)
    assert re.search(said, line), line


TEXTS = {
    "vehicle.toml": [
        (lambda text: text.replace("mass_kg =", "mass_kg"), r"vehicle\.toml: not valid TOML: .*line \d+"),
        (lambda text: text + "\n[aero]\nspan_m = 1.0\n", r"vehicle\.toml: not valid TOML: .*\[?aero"),
        (
            lambda text: text.replace("# ", "# \udcff", 1),
            r"vehicle\.toml: not UTF-8 text \(byte \d+\); a TOML file is needed",
        ),
    ],
    "hexjet.xml": [
        (lambda text: text.replace("</fdm_config>", ""), r"hexjet\.xml: not valid XML: .*line \d+"),
        (lambda text: text.replace("fdm_config", "aircraft"), r"hexjet\.xml: is no JSBSim model: its root is aircraft"),
        (
            lambda text: text.replace("</fdm_config>", "<propulsion><engine file='x'/></propulsion></fdm_config>"),
            r"hexjet\.xml: propulsion/engine: engines are FMUs here",
        ),
        (
            lambda text: text.replace('name="leg_front_left"', 'name="leg_up_front"'),
            r"hexjet\.xml: contact leg_up_front: vehicle\.toml states none of this name; there are: ",
        ),
    ],
}


@pytest.mark.parametrize(("file", "number"), [(file, n) for file, cases in TEXTS.items() for n in range(len(cases))])
def test_a_file_that_cannot_be_read_is_one_line(folder: Path, file: str, number: int) -> None:
    vehicle = folder / "vehicle.toml"
    vehicle.write_text(vehicle.read_text().replace('name = "hexjet"', 'name = "mine"', 1))
    change, said = TEXTS[file][number]
    text = (folder / file).read_text()
    changed = change(text)
    assert changed != text
    (folder / file).write_bytes(changed.encode(errors="surrogateescape"))
    line = line_of(folder)
    assert re.search(said, line), line
