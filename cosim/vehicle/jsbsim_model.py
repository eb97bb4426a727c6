"""The JSBSim model of a vehicle: the user's file, completed for a flight, with the vehicle's numbers in it.

A file may have as little as ``<fdm_config/>``, or have an aerodynamics of its own, systems, tables and files that it
takes them from.  What a flight needs beside that is added: mass and inertia, contacts, one external force per jet, a
force and a moment for what disturbs it, a point mass for a payload, and drag and damping as ``vehicle.toml`` states
them where the file has no aerodynamics.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Hashable
from pathlib import Path
from typing import NamedTuple

from cosim.base.errors import InputError
from cosim.base.signals import AXES, Vector3
from cosim.base.storage.cache import RecentCache
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.jsbsim_units import FOOT, INCH, JSBSIM_POUNDS_PER_SLUG, POUND_FOOT, SLUG, SLUG_FT2
from cosim.vehicle.model_file import find_line, parse, read_model

MOMENTUM_PROPERTY = "rotors/momentum-{}-slug_ft2_s"  # our own property in the model, body


class _Template(NamedTuple):
    """JSBSim model without numbers, for vehicles that differ only in those.

    Every second of ``pieces`` is the place of a number in :func:`_list_numbers`; the others stand as they are.
    """

    pieces: list[bytes]
    has_aerodynamics: bool  # aerodynamics of its own


_templates: RecentCache[_Template] = RecentCache(64)
# Marks in place of units: of a constant of the model, and of a coordinate of a position.
_CONSTANT, _POSITION = "constant", "position"
PAYLOAD_NAME = "payload"  # name of the payload's point mass
PRODUCTS_OF_INERTIA = ("ixy", "ixz", "iyz")  # products of inertia in JSBSim
# Sign of JSBSim's products relative to the integrals of x y, x z and y z in body axes: JSBSim reads minus the integrals
# in its structural axes, x aft and z up (negated_crossproduct_inertia="true", the default).
PRODUCT_SIGN = {"ixy": 1.0, "ixz": -1.0, "iyz": 1.0}
_INCHES_BY_UNIT = {"IN": 1.0, "FT": 12.0, "M": 1.0 / INCH}  # inches per unit of positions
# Parts of a JSBSim model in the order of its schema.
_SCHEMA_ORDER = (
    "metrics", "mass_balance", "ground_reactions", "external_reactions", "propulsion", "flight_control", "aerodynamics",
)  # fmt: skip


def to_structural(body: Vector3) -> tuple[float, float, float]:
    """Return a body-frame position (m, FRD) in JSBSim's structural frame: inches, x aft, y right, z up."""
    x, y, z = body
    return (-x / INCH, y / INCH, -z / INCH)


def render(vehicle: Vehicle, model: Path | None, rotors: bool = False) -> bytes:
    """Return the JSBSim model with the vehicle's numbers written over the file's, in JSBSim's own units.

    A vehicle with a tank gets a point mass for the fuel that is burnt, and with ``rotors`` a gyroscopic moment.

    Raises InputError if the file cannot be read or has what a vehicle here cannot have.
    """
    text = read_model(model)
    template = _templates.get(
        (model, text, _template_key(vehicle), rotors),
        lambda: _make_template(vehicle, model or Path(vehicle.name), text, rotors),
    )
    numbers = [number.encode() for _, _, number in _list_numbers(vehicle, template.has_aerodynamics)]
    pieces = list(template.pieces)
    pieces[1::2] = [numbers[int(at)] for at in pieces[1::2]]
    return b"".join(pieces)


def _template_key(vehicle: Vehicle) -> tuple[Hashable, ...]:
    """Return the data of a vehicle, other than numbers, that its model depends on."""
    names = tuple(contact.name for contact in vehicle.contacts)
    return vehicle.name, names, len(vehicle.jets), any(vehicle.products_kg_m2), vehicle.fuel is not None


def _make_template(vehicle: Vehicle, model: Path, text: bytes, rotors: bool) -> _Template:
    root = parse(model, text)
    if root.tag != "fdm_config":
        raise InputError(f"{model}: is no JSBSim model: its root is {root.tag}, not fdm_config")
    has_aerodynamics = add_missing_parts(root, vehicle, model)
    _add_optional_masses(_child(root, "mass_balance"), vehicle)
    constants = {element.text: element for element in root.findall("flight_control/property")}
    for at, (path, unit, _) in enumerate(_list_numbers(vehicle, has_aerodynamics)):
        mark = f"\0{at}\0"  # XML cannot contain this character
        if unit == _CONSTANT:
            if path not in constants:
                raise InputError(f"{model}: the model has no constant {path}")
            constants[path].set("value", mark)
            continue
        element, _, axis = path.rpartition("/") if unit == _POSITION else (path, "", "")
        found = _child(root, element)
        if unit:
            found.set("unit", "IN" if axis else unit)
        (_child(found, axis) if axis else found).text = mark
    if rotors:
        for axis in "xyz":
            ET.SubElement(_child(root, "flight_control"), "property", value="0").text = MOMENTUM_PROPERTY.format(axis)
        for axis, turn in zip(("ROLL", "PITCH", "YAW"), ("xyz", "yzx", "zxy"), strict=True):
            _child(root, f"aerodynamics/axis[@name='{axis}']").append(_make_gyroscopic_function(*turn))
    xml = bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))
    return _Template(xml.split(b"\0"), has_aerodynamics)


def _list_numbers(vehicle: Vehicle, has_aerodynamics: bool) -> list[tuple[str, str, str]]:
    """Return the entries of a vehicle's numbers: path of the element that has each, unit, and number."""
    numbers = [
        *_mass_numbers(vehicle),
        *[
            entry
            for number, jet in enumerate(vehicle.jets, 1)
            for entry in _position_numbers(f"external_reactions/force[@name='jet{number}']/location", jet.position_m)
        ],
    ]
    for contact in vehicle.contacts:
        path = f"ground_reactions/contact[@name='{contact.name}']"
        numbers += [
            *_position_numbers(f"{path}/location", contact.position_m),
            (f"{path}/spring_coeff", "N/M", repr(float(contact.spring_n_m))),
            (f"{path}/damping_coeff", "N/M/SEC", repr(float(contact.damping_n_s_m))),
            (f"{path}/static_friction", "", repr(contact.friction_static)),
            (f"{path}/dynamic_friction", "", repr(contact.friction_dynamic)),
        ]
    if not has_aerodynamics:
        numbers += _aerodynamic_numbers(vehicle)
    return numbers


def _position_numbers(path: str, body: Vector3) -> list[tuple[str, str, str]]:
    """Return the entries of a body-frame position (m, FRD), in inches of the structural frame."""
    values = zip("xyz", to_structural(body), strict=True)
    return [(f"{path}/{axis}", _POSITION, repr(value + 0.0)) for axis, value in values]


def _mass_numbers(vehicle: Vehicle) -> list[tuple[str, str, str]]:
    """Return the entries of mass and inertia, and of the position of burnt fuel if there is a tank."""
    pounds = vehicle.mass_kg / SLUG * JSBSIM_POUNDS_PER_SLUG
    numbers = [("mass_balance/emptywt", "LBS", repr(float(pounds)))]
    for axis, inertia in zip(("ixx", "iyy", "izz"), vehicle.inertia_kg_m2, strict=True):
        numbers.append((f"mass_balance/{axis}", "SLUG*FT2", repr(float(inertia / SLUG_FT2))))
    if any(vehicle.products_kg_m2):  # zero products keep those of the file
        for axis, product in zip(PRODUCTS_OF_INERTIA, vehicle.products_kg_m2, strict=True):
            size = PRODUCT_SIGN[axis] * product / SLUG_FT2
            numbers.append((f"mass_balance/{axis}", "SLUG*FT2", repr(float(size))))
    if vehicle.fuel:
        numbers += _position_numbers("mass_balance/pointmass[last()]/location", vehicle.fuel.position_m)
    return numbers


def _add_optional_masses(balance: ET.Element, vehicle: Vehicle) -> None:
    """Add elements for products of inertia and burnt fuel, a point mass, if the vehicle has them."""
    if any(vehicle.products_kg_m2):
        balance.set("negated_crossproduct_inertia", "true")
        for axis in PRODUCTS_OF_INERTIA:
            if balance.find(axis) is None:
                ET.SubElement(balance, axis)
    if vehicle.fuel:
        burnt = ET.SubElement(balance, "pointmass", name="burnt fuel")
        ET.SubElement(burnt, "weight", unit="LBS").text = "0"
        _ensure_location(burnt)


def _aerodynamic_numbers(vehicle: Vehicle) -> list[tuple[str, str, str]]:
    """Return the entries of drag and damping, which are constants of the model."""
    numbers = [
        ("metrics/wingspan", "M", repr(float(vehicle.aero.span_m))),
        *_position_numbers("metrics/location[@name='AERORP']", vehicle.aero.centre_m),
    ]
    for axis, area in zip("xyz", vehicle.aero.drag_area_m2, strict=True):
        numbers.append((f"aero/drag-area-{axis}-ft2", _CONSTANT, repr(area / FOOT**2)))
    for name, damping in zip(AXES, vehicle.aero.damping_n_m_s, strict=True):
        numbers.append((f"aero/damping-{name}-lbf_ft_s", _CONSTANT, repr(damping / POUND_FOOT)))
    return numbers


def add_missing_parts(root: ET.Element, vehicle: Vehicle, model: Path) -> bool:
    """Add parts that a flight needs; return whether the model has its own aerodynamics.

    The origin of the structural frame becomes the centre of gravity, where it is not.  Raises InputError for engines,
    contacts and point masses of its own: engines are FMUs, and the others are stated in ``vehicle.toml``.
    """
    for key, value in (("name", vehicle.name), ("version", "2.0"), ("release", "ALPHA")):
        root.attrib.setdefault(key, value)
    for at, tag in enumerate(_SCHEMA_ORDER):
        if root.find(tag) is None:
            before = [list(root).index(part) for earlier in _SCHEMA_ORDER[:at] for part in root.findall(earlier)]
            part = ET.Element(tag, {"name": "constants"} if tag == "flight_control" else {})
            root.insert(max(before, default=len(root.findall("fileheader")) - 1) + 1, part)
    _complete_metrics(_child(root, "metrics"))
    _complete_mass_balance(_child(root, "mass_balance"), model)
    _shift_origin(root, model)
    _complete_contacts(_child(root, "ground_reactions"), vehicle, model)
    _complete_forces(_child(root, "external_reactions"), len(vehicle.jets))
    if root.find("propulsion/engine") is not None:
        raise InputError(f"{model}: propulsion/engine: engines are FMUs here, named by the scenario; leave it out")
    constants = {element.text or "" for element in root.findall("flight_control/property")}
    has_aerodynamics = root.find("aerodynamics/axis") is not None and not any(
        name.startswith("aero/drag-area-") for name in constants
    )
    aerodynamics = _child(root, "aerodynamics")
    if not has_aerodynamics and root.find("aerodynamics/axis") is None:
        _add_drag(_child(root, "flight_control"), aerodynamics)
    for name in ("ROLL", "PITCH", "YAW"):
        _ensure_child(aerodynamics, "axis", name)
    if {axis.get("name") for axis in aerodynamics.findall("axis")} <= {"ROLL", "PITCH", "YAW"}:
        _ensure_child(aerodynamics, "axis", "X")  # otherwise JSBSim prints a warning
    return has_aerodynamics


def _child(root: ET.Element, tag: str) -> ET.Element:
    element = root.find(tag)
    assert element is not None, tag
    return element


def _ensure_child(parent: ET.Element, tag: str, name: str) -> ET.Element:
    element = parent.find(f"{tag}[@name='{name}']")
    return element if element is not None else ET.SubElement(parent, tag, name=name)


def _ensure_location(element: ET.Element) -> ET.Element:
    location = element if element.tag == "location" else element.find("location")
    if location is None:
        location = ET.SubElement(element, "location", unit="IN")
    for axis in "xyz":
        if location.find(axis) is None:
            ET.SubElement(location, axis).text = "0"
    return element


def _complete_metrics(metrics: ET.Element) -> None:
    for tag, unit in (("wingarea", "M2"), ("wingspan", "M"), ("chord", "M")):
        if metrics.find(tag) is None:
            ET.SubElement(metrics, tag, unit=unit).text = "1"
    for name in ("AERORP", "EYEPOINT", "VRP"):
        _ensure_location(_ensure_child(metrics, "location", name))


def _complete_mass_balance(masses: ET.Element, model: Path) -> None:
    for tag, unit in (("ixx", "KG*M2"), ("iyy", "KG*M2"), ("izz", "KG*M2"), ("emptywt", "KG")):
        if masses.find(tag) is None:
            ET.SubElement(masses, tag, unit=unit).text = "0"
    _ensure_location(_ensure_child(masses, "location", "CG"))
    for mass in masses.findall("pointmass"):
        if mass.get("name") != PAYLOAD_NAME and _element_number(mass.find("weight"), model):
            raise InputError(
                f"{model}: pointmass {mass.get('name')}: mass_kg in vehicle.toml is the whole vehicle's; leave it out"
            )
    payload = masses.find("pointmass")
    if payload is None or payload.get("name") != PAYLOAD_NAME:  # payload first: it is known by its number
        payload = ET.Element("pointmass", name=PAYLOAD_NAME)
        ET.SubElement(payload, "weight", unit="KG").text = "0"
        first = masses.find("pointmass")
        masses.insert(len(masses) if first is None else list(masses).index(first), payload)
    _ensure_location(payload)


def _shift_origin(root: ET.Element, model: Path) -> None:
    """Move the origin of all positions to the centre of gravity, where sensors and disturbances act."""
    cg = _child(root, "mass_balance/location[@name='CG']")
    unit = _inches_per_unit(cg, model)
    origin = [_element_number(cg.find(axis), model) * unit for axis in "xyz"]
    reset_locations = [_child(root, f"metrics/location[@name='{name}']") for name in ("EYEPOINT", "VRP")]
    reset_locations += root.findall("external_reactions/force[@name='push']/location")
    if not any(origin) and not any(
        _element_number(element, model) for location in reset_locations for element in location
    ):
        return
    for location in root.iter("location"):
        scale = _inches_per_unit(location, model)
        location.set("unit", "IN")
        for axis, shift in zip("xyz", origin, strict=True):
            element = location.find(axis)
            if element is not None:
                element.text = repr(_element_number(element, model) * scale - shift)
    for element in (element for location in reset_locations for element in location):
        element.text = "0"


def _element_number(element: ET.Element | None, model: Path) -> float:
    """Return an element's number, 0 if missing or empty.  Raises InputError if it is not a number."""
    text = "" if element is None else (element.text or "").strip()
    try:
        return float(text or 0.0)
    except ValueError:
        assert element is not None
        raise InputError(f"{find_line(model, text)}: {element.tag}: {text!r} is no number") from None


def _inches_per_unit(location: ET.Element, model: Path) -> float:
    unit = location.get("unit", "IN").upper()
    if unit not in _INCHES_BY_UNIT:
        label = f"location {location.get('name', '')}".strip()
        raise InputError(f"{model}: {label}: unit {unit!r}: must be one of {', '.join(_INCHES_BY_UNIT)}")
    return _INCHES_BY_UNIT[unit]


def _complete_contacts(ground: ET.Element, vehicle: Vehicle, model: Path) -> None:
    """Complete the contacts to those of ``vehicle.toml``, in its order, which JSBSim's numbers follow."""
    names = [contact.name for contact in vehicle.contacts]
    present = {contact.get("name", ""): contact for contact in ground.findall("contact")}
    for name in present:
        if name not in names:
            allowed = ", ".join(names)
            raise InputError(f"{model}: contact {name}: vehicle.toml states none of this name; there are: {allowed}")
    if list(present) != names:
        for contact in present.values():
            ground.remove(contact)
        present = {name: present.get(name, ET.Element("contact", type="STRUCTURE", name=name)) for name in names}
        ground.extend(present.values())
    for contact in present.values():
        _ensure_location(contact)
        for tag in ("static_friction", "dynamic_friction", "spring_coeff", "damping_coeff"):
            if contact.find(tag) is None:
                ET.SubElement(contact, tag).text = "0"


def _complete_forces(reactions: ET.Element, jets: int) -> None:
    for name in (*(f"jet{number}" for number in range(1, jets + 1)), "push"):
        force = _ensure_child(reactions, "force", name)
        force.set("frame", "BODY")
        _ensure_location(force)
        _ensure_direction(force, "z", "-1")
    twist = _ensure_child(reactions, "moment", "twist")
    twist.set("frame", "BODY")
    _ensure_direction(twist, "x", "1")


def _ensure_direction(element: ET.Element, along: str, value: str) -> None:
    if element.find("direction") is None:
        direction = ET.SubElement(element, "direction")
        for axis in "xyz":
            ET.SubElement(direction, axis).text = value if axis == along else "0"


def _add_drag(constants: ET.Element, aerodynamics: ET.Element) -> None:
    """Add forces ``-0.5 rho CdA |v| v`` at the aerodynamic reference point and moments ``-damping w``, by body axis."""
    for axis, speed in zip("xyz", "uvw", strict=True):
        name = f"aero/drag-area-{axis}-ft2"
        ET.SubElement(constants, "property", value="0").text = name
        tag = f"<property>velocities/{speed}-aero-fps</property>"
        product = f"<property>atmosphere/rho-slugs_ft3</property><property>{name}</property><abs>{tag}</abs>{tag}"
        _add_function(aerodynamics, axis.upper(), f"aero/force/drag-{axis}", f"<value>-0.5</value>{product}")
    for axis, rate in zip(AXES, "pqr", strict=True):
        name = f"aero/damping-{axis}-lbf_ft_s"
        ET.SubElement(constants, "property", value="0").text = name
        product = f"<property>{name}</property><property>velocities/{rate}-aero-rad_sec</property>"
        _add_function(aerodynamics, axis.upper(), f"aero/moment/damping-{axis}", f"<value>-1</value>{product}")


def _add_function(aerodynamics: ET.Element, axis: str, name: str, product: str) -> None:
    text = f'<function name="{name}"><product>{product}</product></function>'
    _ensure_child(aerodynamics, "axis", axis).append(ET.fromstring(text))


def _make_gyroscopic_function(axis: str, second: str, third: str) -> ET.Element:
    """Return JSBSim's function for one component of ``H x omega``: ``H_second omega_third - H_third omega_second``."""

    def product(momentum: str, rate: str) -> str:
        letter = "pqr"["xyz".index(rate)]
        return (
            f"<product><property>{MOMENTUM_PROPERTY.format(momentum)}</property>"
            f"<property>velocities/{letter}i-rad_sec</property></product>"
        )

    return ET.fromstring(
        f'<function name="rotors/gyroscopic-moment-{axis}-lbf_ft">'
        f"<difference>{product(second, third)}{product(third, second)}</difference></function>"
    )
