"""Parameters over MAVLink: the list, reading, setting, refusals, loss; metadata; and what is kept on the disk."""

from __future__ import annotations

import itertools
import json
import lzma
import struct
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mavlink_bench import Bench, StandInPeer, Station, mav, refuse

from cosim.base.errors import InputError
from cosim.control.autopilot.parameters import Parameter, Parameters, table
from cosim.control.autopilot.requests import Answer, Request, Result, SetParameter
from cosim.groundstation.mavlink.services.metadata import GENERAL, PARAMETERS, Metadata, describe_parameter
from cosim.groundstation.mavlink.services.params import ParameterService
from cosim.groundstation.mavlink.services.service import crc32
from cosim.groundstation.parameter_store import ParameterStore
from cosim.spec.vehicle import load_vehicle

CONTROL = load_vehicle("hexjet")[0].control
REAL32, INT32 = mav.MAV_PARAM_TYPE_REAL32, mav.MAV_PARAM_TYPE_INT32
NONE, UNKNOWN, RANGE, NOT_PERMITTED, READ_ONLY, NO_TYPE, OTHER_TYPE = 0, 1, 2, 3, 5, 6, 7
TO = (1, 1)


def as_float(kind: str, number: int) -> float:
    """The bits of an integer as a float, as PX4's protocol wants it."""
    return float(struct.unpack("<f", struct.pack(kind, number))[0])


def as_int(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def parameters() -> Parameters:
    return Parameters(table(CONTROL, CONTROL.pilot, "smith", 25.0))


class Vehicle:
    """Parameters behind their service."""

    def __init__(self, personality: Any = "px4", **link: Any) -> None:
        self.bench = Bench(**link)
        self.parameters = parameters()
        self.service = ParameterService(self.parameters, self.bench.ask, personality)
        self.bench.services.append(self.service)
        self.bench.pilot = self.pilot
        self.station = self.bench.station()

    def pilot(self, request: Request) -> Answer:
        assert isinstance(request, SetParameter)
        try:
            self.parameters.set(request.name, request.value)
        except InputError as error:
            return refuse(str(error))
        return Answer(True, Result.ACCEPTED, "")


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle()


def fetch(station: Station) -> dict[str, Any]:
    """The whole list as QGroundControl gets it: what is missing is asked for by index."""
    station.send("PARAM_REQUEST_LIST", *TO)
    found: dict[int, Any] = {}
    count = None
    while (value := station.wait("PARAM_VALUE", seconds=1.0)) is not None:
        count = value.param_count
        found[value.param_index] = value
    if count is None:
        return fetch(station)
    for index in range(count):
        if index not in found:
            read = ("PARAM_REQUEST_READ", *TO, b"", index)
            found[index] = station.insist(read, "PARAM_VALUE", match=lambda m, i=index: m.param_index == i)
    return {value.param_id: value for value in found.values()}


@pytest.mark.parametrize("personality", ["px4", "ardupilot", "generic"])
def test_the_list_has_every_parameter_once_with_index_and_count(personality: str) -> None:
    vehicle = Vehicle(personality)
    found = fetch(vehicle.station)
    names = sorted(vehicle.parameters.values)
    assert sorted(found) == names + (["_HASH_CHECK"] if personality == "px4" else [])
    for index, name in enumerate(names):
        value = found[name]
        assert (value.param_index, value.param_count) == (index, len(names))
        line = vehicle.parameters.table[name]
        whole = line.kind == "int" and personality != "generic"
        number = as_int(value.param_value) if whole and personality == "px4" else value.param_value
        assert (value.param_type, number) == (INT32 if whole else REAL32, np.float32(line.default))


def test_the_list_is_paced(vehicle: Vehicle) -> None:
    """No more at once than a burst, then the rate; two stations have a list each."""
    other = vehicle.bench.station(245)
    count = len(vehicle.parameters.values) + 1
    for station in (vehicle.station, other):
        station.send("PARAM_REQUEST_LIST", *TO)
    vehicle.bench.tick()
    assert len(vehicle.station.inbox) == len(other.inbox) <= 10
    vehicle.bench.tick(0.5)
    assert len(vehicle.station.inbox) == pytest.approx(10 + 0.5 * 100.0, abs=2)
    vehicle.bench.tick(2.0)
    assert len(vehicle.station.inbox) == len(other.inbox) == count


def test_a_list_waits_for_a_slow_link(vehicle: Vehicle) -> None:
    """While bytes wait to be sent, nothing is added to them."""

    vehicle.station.peer.is_behind = True
    vehicle.station.send("PARAM_REQUEST_LIST", *TO)
    vehicle.bench.tick(5.0)
    assert not vehicle.station.inbox
    vehicle.station.peer.is_behind = False
    vehicle.bench.tick(5.0)
    assert len(vehicle.station.inbox) == len(vehicle.parameters.values) + 1


def test_a_list_that_is_asked_for_again_begins_again_and_is_not_doubled(vehicle: Vehicle) -> None:
    for _ in range(5):
        vehicle.station.send("PARAM_REQUEST_LIST", *TO)
    vehicle.bench.tick(3.0)
    assert len(vehicle.station.inbox) == len(vehicle.parameters.values) + 1
    assert not vehicle.service.is_busy


@pytest.mark.parametrize("seed", range(3))
def test_list_and_set_with_a_fifth_of_the_frames_lost(seed: int) -> None:
    vehicle = Vehicle(loss=0.2, seed=seed)
    assert set(vehicle.parameters.values) <= set(fetch(vehicle.station))
    send = ("PARAM_SET", *TO, b"HJ_ROLL_P", 0.021, REAL32)
    vehicle.station.insist(send, "PARAM_VALUE", match=lambda m: m.param_id == "HJ_ROLL_P")
    assert vehicle.parameters["HJ_ROLL_P"] == 0.021


def test_reading_by_name_and_by_index(vehicle: Vehicle) -> None:
    vehicle.station.send("PARAM_REQUEST_READ", *TO, b"HJ_PRED_DELAY", -1)
    vehicle.station.send("PARAM_REQUEST_READ", *TO, b"HJ_ROLL_P", 0)  # the index counts
    by_name, by_index = vehicle.station.take()
    assert (by_name.param_id, by_name.param_value) == ("HJ_PRED_DELAY", 25.0)
    assert by_index.param_id == sorted(vehicle.parameters.values)[0]


@pytest.mark.parametrize(
    ("name", "index"),
    [
        (b"NO_SUCH", -1),
        (b"", -1),
        (b"HJ_ROLL_P\xff", -1),
        (b"hj_roll_p", -1),
        (b"", 500),
        (b"", 32767),
        (b"NO", -32768),
    ],
)
def test_an_unknown_parameter_is_an_error_at_once(vehicle: Vehicle, name: bytes, index: int) -> None:
    vehicle.station.send("PARAM_REQUEST_READ", *TO, name, index)
    (error,) = vehicle.station.take()
    assert (error.get_type(), error.error) == ("PARAM_ERROR", UNKNOWN)
    assert (error.target_system, error.target_component) == (255, 190)
    assert error.param_index == (index if index >= 0 else -1)


def test_what_is_set_reads_back_equal_and_every_station_hears_it(vehicle: Vehicle) -> None:
    other = vehicle.bench.station(245)
    vehicle.station.send("PARAM_SET", *TO, b"HJ_ROLL_P", 0.023, REAL32)
    assert not vehicle.bench.asked  # the stepping thread does it
    vehicle.bench.tick()
    assert vehicle.bench.asked == [SetParameter("HJ_ROLL_P", 0.023)]
    for station in (vehicle.station, other):
        (value,) = station.take()
        assert (value.param_id, value.param_value) == ("HJ_ROLL_P", np.float32(0.023))


@given(st.floats(5.0, 720.0, width=32))
def test_any_32_bit_number_comes_back_as_it_was_sent(sent: float) -> None:
    vehicle = Vehicle()
    vehicle.station.send("PARAM_SET", *TO, b"HJ_RLIM_ROLL", sent, REAL32)
    (value,) = [m for m in [vehicle.station.wait("PARAM_VALUE")] if m]
    assert value.param_value == sent
    assert np.float32(vehicle.parameters["HJ_RLIM_ROLL"]) == np.float32(sent)


def test_a_default_that_went_to_a_station_and_back_is_the_default(vehicle: Vehicle) -> None:
    """Bit for bit, though no parameter of a vehicle need fit into 32 bits."""
    for name, value in fetch(vehicle.station).items():
        if name != "_HASH_CHECK":
            vehicle.station.send("PARAM_SET", *TO, name.encode(), value.param_value, value.param_type)
    vehicle.bench.tick(0.1)
    assert not vehicle.parameters.changed()
    vehicle.parameters.set("HJ_ROLL_P", 0.03)
    vehicle.station.send("PARAM_SET", *TO, b"HJ_ROLL_P", vehicle.parameters.table["HJ_ROLL_P"].default, REAL32)
    vehicle.bench.tick(0.1)
    assert not vehicle.parameters.changed()
    line = vehicle.parameters.table["HJ_RLIM_ROLL"]
    vehicle.parameters.table[line.name] = replace(line, default=100.0 / 3.0)  # no short number in 32 bits
    vehicle.service.replace(vehicle.parameters)
    vehicle.station.send("PARAM_SET", *TO, b"HJ_RLIM_ROLL", 100.0 / 3.0, REAL32)
    vehicle.bench.tick(0.1)
    assert vehicle.parameters["HJ_RLIM_ROLL"] == 100.0 / 3.0
    wide = [line.name for line in vehicle.parameters if float(np.float32(line.default)) != line.default]
    assert wide  # else the test says nothing


def test_a_change_from_elsewhere_is_told(vehicle: Vehicle) -> None:
    vehicle.bench.tick()
    vehicle.parameters.set("HJ_PRED_DELAY", 30.0)
    vehicle.bench.tick(1.0)
    (value,) = vehicle.station.take()
    assert (value.param_id, value.param_value) == ("HJ_PRED_DELAY", 30.0)


@pytest.mark.parametrize(
    ("personality", "name", "value", "kind", "code"),
    [
        ("px4", b"NO_SUCH", 1.0, REAL32, UNKNOWN),
        ("px4", b"HJ_ROLL_P", float("nan"), REAL32, RANGE),
        ("px4", b"HJ_ROLL_P", float("inf"), REAL32, RANGE),
        ("px4", b"HJ_ROLL_P", -1.0, REAL32, RANGE),
        ("px4", b"HJ_ROLL_P", 3e38, REAL32, RANGE),
        ("px4", b"HJ_ROLL_P", as_float("<i", 1), INT32, OTHER_TYPE),
        ("px4", b"HJ_PRED_TYPE", 1.0, REAL32, OTHER_TYPE),
        ("px4", b"HJ_PRED_TYPE", as_float("<i", 99), INT32, RANGE),
        ("px4", b"HJ_PRED_TYPE", as_float("<i", -1), INT32, RANGE),
        ("px4", b"SYS_AUTOSTART", as_float("<i", 1), INT32, READ_ONLY),
        ("px4", b"HJ_ROLL_P", 0.02, 10, NO_TYPE),  # 64 bits
        ("px4", b"HJ_ROLL_P", 0.02, 0, NO_TYPE),
        ("px4", b"HJ_ROLL_P", 0.02, 255, NO_TYPE),
        ("ardupilot", b"HJ_PRED_TYPE", 1.5, INT32, RANGE),
        ("ardupilot", b"HJ_PRED_TYPE", float("nan"), INT32, RANGE),
        ("generic", b"HJ_PRED_TYPE", as_float("<i", 1), INT32, OTHER_TYPE),
        ("generic", b"HJ_PRED_TYPE", 0.5, REAL32, RANGE),
    ],
)
def test_a_refused_set_says_why_and_changes_nothing(
    personality: str, name: bytes, value: float, kind: int, code: int
) -> None:
    vehicle = Vehicle(personality)
    vehicle.station.send("PARAM_SET", *TO, name, value, kind)
    vehicle.bench.tick(0.1)
    assert not vehicle.bench.asked
    assert not vehicle.parameters.changed()
    error, *values = vehicle.station.take()
    assert (error.get_type(), error.error, error.param_id.encode()) == ("PARAM_ERROR", code, name)
    if code != UNKNOWN:  # and who does not know that message sees the value as it is
        assert values[0].param_id.encode() == name


@pytest.mark.parametrize(
    ("personality", "value", "kind"),
    [("px4", as_float("<i", 2), INT32), ("px4", as_float("<Bxxx", 2), 1), ("ardupilot", 2.0, INT32), ("ardupilot", 2.0, REAL32), ("generic", 2.0, REAL32)],
)  # fmt: skip
def test_whole_numbers_are_set_in_the_words_of_each_autopilot(personality: str, value: float, kind: int) -> None:
    vehicle = Vehicle(personality)
    vehicle.station.send("PARAM_SET", *TO, b"HJ_PRED_TYPE", value, kind)
    vehicle.bench.tick(0.1)
    assert vehicle.parameters["HJ_PRED_TYPE"] == 2


@pytest.mark.parametrize(
    ("refusal", "name", "value", "kind", "code"),
    [
        (refuse("no model"), "HJ_PRED_TYPE", as_float("<i", 2), INT32, RANGE),
        # in the air for what it does to a loop: no value is out of range
        (refuse("the loop is unstable", Result.TEMPORARILY_REJECTED), "HJ_ROLL_P", 0.0, REAL32, NOT_PERMITTED),
    ],
)
def test_the_pilots_refusal_is_told(
    vehicle: Vehicle, refusal: Answer, name: str, value: float, kind: int, code: int
) -> None:
    vehicle.bench.pilot = lambda request: refusal
    vehicle.station.send("PARAM_SET", *TO, name.encode(), value, kind)
    vehicle.bench.tick(0.1)
    error, kept = vehicle.station.take()
    assert (error.get_type(), error.error, kept.param_id) == ("PARAM_ERROR", code, name)
    shown = as_int(kept.param_value) if kind == INT32 else kept.param_value
    assert shown == np.float32(vehicle.parameters.table[name].default)


def test_a_flood_of_sets_is_bounded(vehicle: Vehicle) -> None:
    for _ in range(1000):
        vehicle.station.send("PARAM_SET", *TO, b"HJ_ROLL_P", 0.02, REAL32)
    vehicle.bench.tick(0.1)
    assert len(vehicle.bench.asked) == 100
    vehicle.station.send("PARAM_SET", *TO, b"HJ_ROLL_P", 0.021, REAL32)
    vehicle.bench.tick(0.1)
    assert vehicle.parameters["HJ_ROLL_P"] == 0.021


def bitwise(data: bytes, crc: int = 0) -> int:
    """CRC32 bit by bit: reflected polynomial 0xEDB88320, nothing inverted."""
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc


@given(st.binary(max_size=40), st.integers(0, 2**32 - 1))
def test_the_checksum_is_mavlinks(data: bytes, start: int) -> None:
    assert crc32(data, start) == bitwise(data, start)


def test_the_hash_is_the_one_that_the_list_gives(vehicle: Vehicle) -> None:
    """As QGroundControl computes it from its cache: names in order, then the four bytes of each value."""
    ardupilot = Vehicle("ardupilot").station
    ardupilot.send("PARAM_REQUEST_READ", *TO, b"_HASH_CHECK", -1)
    assert ardupilot.take()[0].error == UNKNOWN
    vehicle.parameters.set("HJ_ROLL_P", 0.03)
    found = fetch(vehicle.station)
    stated = struct.pack("<f", found.pop("_HASH_CHECK").param_value)
    state = 0
    for name in sorted(found):
        state = bitwise(struct.pack("<f", found[name].param_value), bitwise(name.encode(), state))
    assert stated == struct.pack("<I", state)


def test_a_station_that_has_the_set_cached_stops_the_list(vehicle: Vehicle) -> None:
    vehicle.station.send("PARAM_REQUEST_READ", *TO, b"_HASH_CHECK", -1)
    (value,) = vehicle.station.take()
    stated = (value.param_index, value.param_type, value.param_count)
    assert stated == (65535, mav.MAV_PARAM_TYPE_UINT32, len(vehicle.parameters.values))
    vehicle.station.send("PARAM_REQUEST_LIST", *TO)
    vehicle.bench.tick()
    vehicle.station.send("PARAM_SET", *TO, b"_HASH_CHECK", 1.0, 5)  # a wrong hash stops nothing
    assert vehicle.service.is_busy
    vehicle.station.send("PARAM_SET", *TO, b"_HASH_CHECK", value.param_value, 5)
    assert not vehicle.service.is_busy
    assert "PARAM_ERROR" not in vehicle.station.counts


def test_a_peer_that_goes_takes_its_list_along_and_a_restart_begins_lists_anew(vehicle: Vehicle) -> None:
    vehicle.station.send("PARAM_REQUEST_LIST", *TO)
    vehicle.service.forget(StandInPeer("somebody"))
    assert vehicle.service.is_busy
    vehicle.bench.tick(0.2)
    vehicle.service.replace(parameters())
    vehicle.station.take()
    vehicle.bench.tick(3.0)
    assert len(vehicle.station.take()) == len(vehicle.parameters.values)
    vehicle.station.send("PARAM_REQUEST_LIST", *TO)
    vehicle.service.forget(vehicle.station.peer)
    assert not vehicle.service.is_busy


def test_lists_for_endless_stations_are_bounded(vehicle: Vehicle) -> None:
    for system, component in itertools.product(range(1, 30), range(1, 30)):
        vehicle.bench.station(system, component).send("PARAM_REQUEST_LIST", *TO)
    assert len(vehicle.service._lists) == 16


# What general.schema.json and parameter.schema.json of the MAVLink project allow; both refuse other keys.
GENERAL_KEYS = {"version", "vendorName", "modelName", "firmwareVersion", "hardwareVersion", "metadataTypes"}
PARAMETER_KEYS = {
    "name", "type", "shortDesc", "longDesc", "units", "default", "decimalPlaces", "min", "max", "increment",
    "rebootRequired", "group", "category", "volatile", "values", "bitmask", "readOnly",
}  # fmt: skip


def test_metadata_describes_every_parameter() -> None:
    lines = parameters()
    files = Metadata(lines, "hexjet", "0.1.0.dev3").files
    inner = json.loads(lzma.decompress(files[PARAMETERS]))
    assert set(inner) == {"version", "parameters"}
    assert inner["version"] == 1  # QGroundControl reads no other
    described = {each["name"]: each for each in inner["parameters"]}
    assert set(described) == set(lines.values)
    for line in lines:
        found = described[line.name]
        assert set(found) <= PARAMETER_KEYS
        assert found["type"] == {"int": "Int32", "float": "Float"}[line.kind]
        assert (found["min"], found["max"], found["default"]) == (line.least, line.most, line.default)
        assert found.get("units", "") == line.unit
        assert found["group"] == line.group
        assert found["shortDesc"].lower() == line.text.lower()
        assert found.get("readOnly", False) == line.read_only
        assert [(v["value"], v["description"]) for v in found.get("values", [])] == list(line.values)


def test_the_way_to_the_metadata() -> None:
    metadata = Metadata(parameters(), "hexjet", "0.1.0.dev3")
    general = json.loads(lzma.decompress(metadata.files[GENERAL]))
    assert set(general) <= GENERAL_KEYS
    assert general["firmwareVersion"] == "0.1.0"
    (kind,) = general["metadataTypes"]
    assert kind == {"type": 1, "uri": f"mftp:///{PARAMETERS}", "fileCrc": bitwise(metadata.files[PARAMETERS])}
    for number, crc, uri in ((397, "file_crc", "uri"), (395, "general_metadata_file_crc", "general_metadata_uri")):
        message = metadata.on_request[number](12)
        sent = mav.MAVLink(None).parse_buffer(message.pack(mav.MAVLink(None)))[0]
        assert getattr(sent, uri) == f"mftp:///{GENERAL}"
        assert getattr(sent, crc) == bitwise(metadata.files[GENERAL])
        assert sent.time_boot_ms == 12


def test_xz_has_a_check_that_small_readers_know() -> None:
    """The third byte of the stream flags: 1 is CRC32, which every reader must know."""
    for data in Metadata(parameters(), "hexjet", "1.2.3").files.values():
        assert data[:6] == b"\xfd7zXZ\0"
        assert data[7] & 0x0F == 1


def test_another_table_has_another_checksum() -> None:
    """Ground stations keep metadata by its checksum."""
    one, other = parameters(), parameters()
    line = other.table["HJ_ROLL_P"]
    other.table["HJ_ROLL_P"] = Parameter(line.name, line.kind, line.default, line.least, 2 * line.most, "", "", "x")
    first, second = (Metadata(each, "hexjet", "1").on_request[397](0).file_crc for each in (one, other))
    assert first != second
    assert describe_parameter(other.table["HJ_ROLL_P"]).get("units") is None


def test_saved_parameters_come_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "hexjet.toml"
    before = parameters()
    before.set("HJ_ROLL_P", 0.1 + 0.2 - 0.28)
    before.set("HJ_PRED_TYPE", 2)
    ParameterStore(path, "hexjet").save(before.changed())
    after = parameters()
    assert ParameterStore(path, "hexjet").restore(after.set) == []
    assert dict(after.values) == dict(before.values)
    assert tomllib.loads(path.read_text())["vehicle"] == "hexjet"


def test_nothing_changed_makes_no_file_and_defaults_empty_it(tmp_path: Path) -> None:
    path = tmp_path / "hexjet.toml"
    store = ParameterStore(path, "hexjet")
    store.save({})
    assert not path.exists()
    store.save({"HJ_ROLL_P": 0.02})
    store.save({})
    assert ParameterStore(path, "hexjet").load() == {}


def test_what_the_vehicle_refuses_is_told_and_stays_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "hexjet.toml"
    ParameterStore(path, "hexjet").save({"HJ_OLD_NAME": 1.0, "HJ_ROLL_P": 99.0, "HJ_RLIM_ROLL": 100.0})
    store, live = ParameterStore(path, "hexjet"), parameters()
    complaints = store.restore(live.set)
    assert len(complaints) == 2
    assert all(str(path) in line and "\n" not in line for line in complaints)
    assert live.changed() == {"HJ_RLIM_ROLL": 100.0}
    live.set("HJ_ROLL_P", 0.03)
    store.save(live.changed())
    assert ParameterStore(path, "hexjet").load() == {"HJ_OLD_NAME": 1.0, "HJ_RLIM_ROLL": 100.0, "HJ_ROLL_P": 0.03}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("format = 1\nvehicle = ", "not valid TOML"),
        ("format = 2\nvehicle = 'hexjet'", "format = 2: must be 1"),
        ("vehicle = 'hexjet'", "format = None"),
        ("format = 1\nvehicle = 'other'", "these are not the parameters of hexjet"),
        ("format = 1\nvehicle = 'hexjet'\nparameters = 3", "must be a table"),
        ("format = 1\nvehicle = 'hexjet'\n[parameters]\nA = 'x'", "parameters.A = 'x': must be a number"),
        ("format = 1\nvehicle = 'hexjet'\n[parameters]\nA = true", "parameters.A = True: must be a number"),
        ("format = 1\nvehicle = 'hexjet'\nmore = 1", "unknown key 'more'"),
    ],
)
def test_a_broken_file_is_one_line_and_is_never_lost(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "hexjet.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=complaint) as caught:
        ParameterStore(path, "hexjet").load()
    assert str(path) in str(caught.value)
    ParameterStore(path, "hexjet").save({"HJ_ROLL_P": 0.02})
    assert (tmp_path / "hexjet.toml.broken").read_text() == text
    assert ParameterStore(path, "hexjet").load() == {"HJ_ROLL_P": 0.02}
    path.write_text(text + " ")
    ParameterStore(path, "hexjet").save({"HJ_ROLL_P": 0.03})
    assert (tmp_path / "hexjet.toml.broken-2").read_text() == text + " "
    assert not list(tmp_path.glob(".*"))


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        ParameterStore(tmp_path / "file" / "hexjet.toml", "hexjet").save({"HJ_ROLL_P": 0.02})
