"""A JSBSim file of the user's is data: nothing in it writes, sends, listens or ends the process."""

from __future__ import annotations

import os
import shutil
import socket
import warnings
import xml.etree.ElementTree as ET
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import psutil
import pytest

from cosim.base.errors import FlightError, InputError, Notice
from cosim.base.signals import ZERO3, Disturbance
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.executive import Executive
from cosim.vehicle.model_file import read_model

STEPS = 50
READS = '<system name="s"><channel name="c"><pure_gain name="g"><input>{}</input><gain>1</gain></pure_gain></channel></system>'
WRITES = '<system name="s"><channel name="c"><fcs_function name="{}"><function><value>1</value></function></fcs_function></channel></system>'


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """What a process of its own would have been started for, without starting it: that takes most of a second."""
    models: list[bytes] = []
    monkeypatch.setattr("cosim.vehicle.model_trial._find_failure", lambda xml: models.append(xml) or "")
    return models


pytestmark = pytest.mark.usefixtures("tried")


def brought(folder: Path, parts: str, **files: str) -> Path:
    """A folder with a model of these parts, and files beside it by their names without ``.xml``."""
    for name, text in files.items():
        (folder / f"{name}.xml").write_text(text)
    model = folder / "own.xml"
    model.write_text(f"<fdm_config>\n{parts}\n</fdm_config>")
    return model


def fly(model: Path) -> None:
    """Fly the Hex-Jet with this model for some steps, and look in every one of them at what listens."""
    vehicle, _ = load_vehicle("hexjet")
    own = vehicle.model_copy(update={"model": model.name})
    with closing(Airframe(own, model.parent, Environment(), 0.004, 4, 1)) as frame:
        frame.reset(Initial(altitude_m=10.0), [ZERO3] * 6, ZERO3)
        for _ in range(STEPS):
            frame.step([(0.0, 0.0, -9.0)] * 6, Disturbance())
            assert frame._fdm.get_property_value("simulation/terminate") == 0.0
        connections = psutil.Process().net_connections(kind="inet")
        assert not [one for one in connections if one.status == psutil.CONN_LISTEN]


@pytest.mark.parametrize("place", ["in the model", "a file that it names", "in a part's file"])
def test_what_writes_sends_or_listens_is_left_out_with_a_line(place: str, tmp_path: Path) -> None:
    written = tmp_path / "written.csv"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        there.settimeout(0.2)
        port = there.getsockname()[1]
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            command_port = free.getsockname()[1]
        acting = [
            f'<output name="{written}" type="CSV" rate="50"><rates>ON</rates></output>',
            f'<output name="127.0.0.1" type="SOCKET" protocol="UDP" port="{port}" rate="50"><rates>ON</rates></output>',
            f'<input port="{command_port}" type="SOCKET"/>',
        ]
        if place == "in the model":
            model = brought(tmp_path, "\n".join(acting))
        elif place == "a file that it names":
            names = [text.split()[0].strip("<") for text in acting]
            files = {f"part{number}": text for number, text in enumerate(acting)}
            model = brought(
                tmp_path, "\n".join(f'<{name} file="part{number}"/>' for number, name in enumerate(names)), **files
            )
        else:  # where JSBSim looks for none: nothing is to be said either
            part = f'<system name="s"><property value="2">my/gain</property>{"".join(acting)}</system>'
            model = brought(tmp_path, '<system file="part"/>', part=part)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            fly(model)
        with pytest.raises(TimeoutError):
            there.recv(1000)
    assert not written.exists()
    lines = {str(warning.message) for warning in said}
    expected = {f"{model}: left out, as no part of what flies: <output> (line 2, 3); <input> (line 4)"}
    assert lines == (set() if place == "in a part's file" else expected)
    assert all(warning.category is Notice and warning.filename == __file__ for warning in said)


ACTS = {
    "simulation/write-state-file": "write-state-file",
    "simulation/integrator/../write-state-file[0]": "write-state-file",
    "/fdm/jsbsim/simulation/do_linearization": "do_linearization",
    "simulation/terminate": "terminate",
    "simulation/./reset": "reset",
    "simulation/pause": "pause",
}


@pytest.mark.parametrize("name", ACTS)
def test_a_property_that_acts_is_refused_with_its_line(name: str, tmp_path: Path) -> None:
    model = brought(tmp_path, f'<system name="t"/>\n{WRITES.format(name)}')
    with pytest.raises(InputError, match=rf"own\.xml, line 3: simulation/{ACTS[name]}: JSBSim does something"):
        fly(model)


def test_jsbsim_itself_lets_no_model_write_what_acts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Were a name found that the check does not know, JSBSim would not take the value."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cosim.vehicle.model_file.find_acting_property", lambda text: "")
    before = set(tmp_path.rglob("*"))
    for number, name in enumerate(ACTS):
        folder = tmp_path / str(number)
        folder.mkdir()
        fly(brought(folder, WRITES.format(name)))
    left = {path.name for path in set(tmp_path.rglob("*")) - before if path.is_file()}
    assert left == {"own.xml"}


def test_a_surface_writes_nothing_that_acts(tmp_path: Path) -> None:
    model = brought(tmp_path, _least())
    model.write_text(model.read_text().replace("<fdm_config", '<fdm_config version="2.0"'))
    frame = Executive(model, None, "own", 0.004)
    assert frame.node("simulation/dt").get_double_value() == 0.004
    with pytest.raises(InputError, match=r"own: simulation/terminate: JSBSim does something"):
        frame.node("simulation/terminate")
    for name in ("a b", "1st", "a[", "-x", "", "#"):  # to look for one of these ends the process
        with pytest.raises(InputError, match="this JSBSim model has no property"):
            frame.node(name)


def _least() -> str:
    return "<metrics/><mass_balance><ixx>1</ixx><iyy>1</iyy><izz>1</izz><emptywt>1</emptywt></mass_balance><ground_reactions/><aerodynamics/>"


MISSING = {
    "a function": '<aerodynamics><axis name="LIFT"><function name="aero/lift"><product>\n'
    "<property>no/such</property><value>1</value></product></function></axis></aerodynamics>",
    "what a function says in short": '<aerodynamics><axis name="LIFT"><function name="aero/lift"><product>\n'
    "<p>no/such</p><v>1</v></product></function></axis></aerodynamics>",
    "the branch that is not taken": '<aerodynamics><axis name="LIFT"><function name="aero/lift"><ifthen><v>1</v><v>0</v>\n'
    "<p>no/such</p></ifthen></function></axis></aerodynamics>",
    "a table": '<aerodynamics><axis name="LIFT"><function name="aero/lift"><table><independentVar lookup="row">\n'
    "no/such</independentVar><tableData>0 1\n1 2</tableData></table></function></axis></aerodynamics>",
    "what comes in": READS.format("\nno/such"),
    "what comes in, turned round": READS.format("\n-no/such"),
    "a gain": READS.format("velocities/p-rad_sec").replace("<gain>1", "<gain>\nno/such"),
    "a condition": '<system name="s"><channel name="c"><switch name="g"><default value="0"/>\n'
    '<test value="1">no/such gt 2</test></switch></channel></system>',
    "what turns a channel on": READS.format("velocities/p-rad_sec").replace('name="c"', '\nname="c" execute="no/such"'),
}


@pytest.mark.parametrize("where", MISSING)
def test_a_property_that_is_not_there_is_named_with_its_line(where: str, tmp_path: Path) -> None:
    line = r"own\.xml, line [23]: the model has no property no/such: take out what reads it, or give it a value, with "
    with pytest.raises(InputError, match=line + r'<property value="0">no/such</property>'):
        fly(brought(tmp_path, MISSING[where]))
    stated = '<flight_control name="f"><property value="0">no/such</property></flight_control>'
    earlier = '<system name="own"><property value="0">no/such</property></system>'
    fly(brought(tmp_path, (earlier if "<system" in MISSING[where] else stated) + MISSING[where]))


def test_a_missing_property_is_found_in_the_file_that_reads_it(tmp_path: Path) -> None:
    part = READS.format("propulsion/engine/thrust-lbs") + "\n"
    with pytest.raises(InputError, match=r"part\.xml, line 1: the model has no property propulsion/engine/thrust-lbs:"):
        fly(brought(tmp_path, '<system file="part"/>', part=part))


@pytest.mark.parametrize(
    ("parts", "line"),
    {
        "a name that cannot be": (READS.format("a b c"), r"line 2: JSBSim could not load the model: name may contain"),
        "a table without rows": (
            '<aerodynamics><axis name="LIFT"><function name="f"><table><independentVar lookup="row">aero/alpha-rad'
            "</independentVar><tableData></tableData></table></function></axis></aerodynamics>",
            r"JSBSim could not load the model: .*tableData",
        ),
        "no number": (
            '<mass_balance><location name="CG" unit="M"><x>1</x><y>y</y><z>0</z></location></mass_balance>',
            r"line 2: y: 'y' is no number",
        ),
        "no unit": (
            '<mass_balance><location name="CG" unit="KM"><x>1</x><y>0</y><z>0</z></location></mass_balance>',
            r"location CG: unit 'KM': must be one of IN, FT, M",
        ),
        "a vehicle of its own": ('<child name="../other"/>', r"line 2: child: one vehicle flies here"),
    }.values(),
)
def test_what_jsbsim_refuses_is_one_line(parts: str, line: str, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    with pytest.raises(InputError, match=line) as caught:
        fly(brought(tmp_path, parts))
    assert "hexjet-scratch" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_what_jsbsim_says_of_a_model_that_flies_is_a_note(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = brought(tmp_path, READS.format("velocities/p-rad_sec").replace("pure_gain", "wizard"))
    with pytest.warns(Notice, match=r"own\.xml: JSBSim: Unknown FCS component: wizard"):
        fly(model)
    assert capfd.readouterr() == ("", "")


def test_a_part_keeps_what_it_states_beside_its_file(tmp_path: Path) -> None:
    """As in JSBSim: a property's value is the model's own, and what else either has is there."""
    own = '<property value="1">my/gain</property><property value="3">my/other</property>'
    part = f'<system name="theirs">{own}</system>'
    own = '<system name="mine" file="part"><property value="2">my/gain</property></system>'
    root = ET.fromstring(read_model(brought(tmp_path, own, part=part)))
    values = {element.text: element.get("value") for element in root.findall("system/property")}
    assert values == {"my/gain": "2", "my/other": "3"}
    system = root.find("system")
    assert system.attrib == {"name": "mine"}


def test_only_files_are_read(tmp_path: Path) -> None:
    """A device or a pipe would be read for ever; a path may lead out of the folder: it is read, and no more."""
    os.mkfifo(tmp_path / "pipe.xml")
    for name in ("/dev/zero", "pipe"):
        with pytest.raises(InputError, match="is a device or a pipe"):
            read_model(brought(tmp_path, f'<system file="{name}"/>'))
    for place in (Path("/dev/zero"), tmp_path / "pipe.xml"):
        with pytest.raises(InputError, match="is a device or a pipe"):
            read_model(place)
    with pytest.raises(InputError, match="a part's file names no other"):
        read_model(brought(tmp_path, '<system file="part"/>', part='<system file="part"/>'))
    (tmp_path / "inner").mkdir()
    inner = brought(tmp_path / "inner", '<system file="../part"/>')
    (tmp_path / "part.xml").write_text('<system name="s"><property value="1">my/gain</property></system>')
    assert b"my/gain" in read_model(inner)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("c172p", "has no property propulsion/engine/prop-induced-velocity_fps"),
        ("T38", "has no property fcs/throttle-cmd-norm"),
        ("F450", "no such file"),
        ("ball", ""),
        ("minisgs", ""),
        ("Shuttle", "the airframe's state is not finite"),  # its wing on 5.5 kg
    ],
)
def test_jsbsims_own_aircraft_fly_or_are_refused_in_a_line(name: str, expected: str, tmp_path: Path) -> None:
    """Without engines, contacts, point masses and autopilot, as the page asks for."""
    package = find_spec("jsbsim")
    source = Path(package.origin).parent / "aircraft" / name / f"{name}.xml"
    if not source.is_file():
        pytest.skip(f"this jsbsim brings no {name}")
    root = ET.parse(source).getroot()
    for part in list(root):
        if part.tag in ("propulsion", "autopilot"):
            root.remove(part)
        elif part.tag == "ground_reactions":
            part.clear()
        elif part.tag == "mass_balance":
            for mass in part.findall("pointmass"):
                part.remove(mass)
    shutil.copytree(source.parent, tmp_path / name)
    model = tmp_path / name / "own.xml"
    ET.ElementTree(root).write(model)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Notice)
        if not expected:
            fly(model)
            return
        with pytest.raises((InputError, FlightError), match=expected) as caught:
            fly(model)
    assert str(caught.value).startswith(str(model.parent)) or caught.type is FlightError


@pytest.mark.parametrize(
    ("axis", "value"),
    [
        ("X", "<quotient><p>aero/qbar-psf</p><p>velocities/vt-fps</p></quotient>"),
        ("ROLL", "<pow><v>-1</v><v>0.5</v></pow>"),
    ],
)
def test_what_is_not_finite_at_rest_is_named_with_its_line(axis: str, value: str, tmp_path: Path) -> None:
    """Not the functions behind it, which are not finite for its sake."""
    part = f'<function name="aero/own">{value}</function>\n<function name="aero/more"><p>aero/own</p></function>'
    model = brought(tmp_path, f'<aerodynamics>\n<axis name="{axis}">\n{part}\n</axis>\n</aerodynamics>')
    with pytest.raises(InputError) as caught:
        fly(model)
    said = str(caught.value)
    assert said.startswith(f"{model}, line 4: aero/own is ")
    assert said.endswith(" at the start; it has to be finite, at rest too")


NUMBERS = (
    '<system name="s"><property value="0">my/zero</property><channel name="c"><sensor name="my/noise"><input>my/zero</input>'
    '<noise variation="ABSOLUTE" distribution="GAUSSIAN">1</noise></sensor><fcs_function name="my/random"><function><random/>'
    "</function></fcs_function></channel></system>"
)
TURBULENCE = "atmosphere/p-turb-rad_sec"


def drawn(model: Path, seed: int, *properties: str) -> np.ndarray:
    """Fly 4 s in turbulence, and return these properties of JSBSim, a column of steps each."""
    vehicle, _ = load_vehicle("hexjet")
    own = vehicle.model_copy(update={"model": model.name})
    with closing(
        Airframe(own, model.parent, Environment(turbulence_severity=3, turbulence_wind_m_s=6.0), 0.004, 1, seed)
    ) as frame:
        rows = []
        frame.reset(Initial(altitude_m=50.0), [ZERO3] * 6, ZERO3)
        for _ in range(1000):
            frame.step([(0.0, 0.0, -9.0)] * 6, Disturbance())
            rows.append([frame._fdm.get_property_value(name) for name in properties])
    return np.array(rows).T


def test_the_seed_reaches_the_random_numbers_of_a_file(tmp_path: Path) -> None:
    """JSBSim draws them apart from its turbulence, which is the same with them and without, at the same seed."""
    model = brought(tmp_path, NUMBERS)
    # 1000 independent numbers correlate by 0.03, one deviation; equal ones by 1
    flown = [drawn(model, seed, TURBULENCE, "my/noise", "my/random") for seed in (0, 1, 2, 2 + 2**40)]
    numbers = np.concatenate([columns[1:] for columns in flown])
    correlation = np.corrcoef(numbers)
    assert np.abs(correlation[~np.eye(len(numbers), dtype=bool)]).max() < 0.15
    assert (drawn(model, 2, TURBULENCE, "my/noise", "my/random") == flown[2]).all()
    (tmp_path / "plain").mkdir()
    plain = brought(tmp_path / "plain", '<system name="s"/>')
    assert (drawn(plain, 2, TURBULENCE) == flown[2][0]).all()


def test_a_file_is_tried_once_for_what_it_says(tried: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By another process again only where it, or a file that it names, says something else; what is shipped never."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    model = brought(tmp_path, '<system file="part"/>', part='<system name="s"/>')
    for _ in range(2):
        fly(model)
    assert len(tried) == 1
    (tmp_path / "part.xml").write_text('<system name="t"/>')
    fly(model)
    assert len(tried) == 2
    vehicle, folder = load_vehicle("jetwing")
    Airframe(vehicle, folder, Environment(), 0.004, 4, 1).close()
    vehicle, folder = load_vehicle("hexjet-p220")
    Airframe(vehicle, folder, Environment(), 0.004, 4, 1).close()
    assert len(tried) == 2
