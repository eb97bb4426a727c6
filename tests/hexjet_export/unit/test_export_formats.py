"""MCAP, MAT and Parquet of one run, read back by the libraries of others: values, units, frames, events, what is drawn."""

from __future__ import annotations

import builtins
import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from flights import record, samples, scenario, setup
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.io import loadmat

from cosim.base.errors import InputError
from cosim.base.frames import jet_axis
from cosim.base.protocols import Column
from cosim.base.signals import EngineOutput
from cosim.results.export import export_log
from cosim.results.log.columns import COLUMNS, NAMES, log_columns
from cosim.results.run import LOG, SCENARIO, Run, begin_run
from hexjet_export.logs.mat import fields
from hexjet_export.logs.mcap_file import CUSTOM, SUBJECTS, TIME, group_by_channel
from hexjet_export.logs.scene import hover_n

STEPS = 125  # half a second
LONG = Column("_" + "own_" * 20 + "rad", "rad", "body", "shown by a block; longer than MATLAB has names")
NORTH_EAST = (22.35, 113.59)  # where a scenario is that says nothing
FAULT = {"kind": "flame_out", "start_s": 0.1, "duration_s": 0.2, "jet": 6}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Half a second with a fault, tilted servos, a thrust per jet, and a column of a block's own."""
    recording = begin_run(
        setup(scenario="doublet-ä"),
        scenario(name="roll-doublet", fault=[FAULT]),
        tmp_path_factory.mktemp("runs") / "run",
        columns=log_columns(custom=[LONG]),
    )
    for sample in samples(STEPS):
        acts = tuple(float(n == 5 and 25 <= sample.k < 75) for n in range(len(sample.faults)))
        recording.observe(
            sample._replace(
                faults=acts,
                tilt=(0.2, -0.1),
                engines=EngineOutput(tuple(7.0 + jet for jet in range(6)), *sample.engines[1:]),
                own=(0.25 * sample.k,),
            )
        )
    return recording.finish("crashed", "fell over")


@pytest.fixture(scope="module")
def mcap(run: Run, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Everything of the MCAP: by topic the messages with their times, and what else is in the file."""
    assert run.folder is not None
    path = tmp_path_factory.mktemp("exported") / "flight.mcap"
    export_log("mcap", run.folder, path)
    messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        for _, channel, message, decoded in reader.iter_decoded_messages():
            messages[channel.topic].append((message.log_time, decoded))
        return {
            "messages": messages,
            "channels": {channel.topic: channel for channel in summary.channels.values()},
            "schemas": {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()},
            "compression": {chunk.compression for chunk in summary.chunk_indexes},
            "attachments": {each.name: each.data for each in reader.iter_attachments()},
            "metadata": {each.name: each.metadata for each in reader.iter_metadata()},
        }


def test_every_column_of_every_flight_has_a_subject() -> None:
    found = group_by_channel(COLUMNS)
    assert set(found) == {*SUBJECTS, TIME}
    assert sorted(column.name for columns in found.values() for column in columns) == sorted(NAMES)


def test_mcap_has_every_digit_of_every_column_with_its_unit(run: Run, mcap: dict[str, Any]) -> None:
    for topic, columns in group_by_channel(run.log.described).items():
        rows = mcap["messages"][topic]
        assert [time for time, _ in rows] == [4_000_000 * k for k in range(STEPS)]
        for column in columns:
            found = [getattr(message, column.name) for _, message in rows]
            np.testing.assert_array_equal(found, run.log[column.name], err_msg=column.name)  # NaN equals NaN here
            assert mcap["channels"][topic].metadata[column.name].startswith(f"[{column.unit}] ")
    assert [column.name for column in group_by_channel(run.log.described)[CUSTOM]] == [LONG.name]
    assert mcap["compression"] == {"zstd"}


def test_mcap_says_what_was_flown_and_what_happened(run: Run, mcap: dict[str, Any]) -> None:
    assert run.folder is not None
    assert mcap["attachments"][SCENARIO] == (run.folder / SCENARIO).read_bytes()
    assert mcap["metadata"]["hexjet"]["scenario"] == "doublet-ä"
    assert mcap["metadata"]["hexjet.columns"]["mass_kg"] == "[kg] mass, payload included"
    said = [(time, message.level, message.name, message.message) for time, message in mcap["messages"]["/log"]]
    assert said == [
        (100_000_000, 3, "fault", "jet 6: flame-out"),
        (300_000_000, 2, "fault", "over: jet 6: flame-out"),
        (500_000_000, 4, "outcome", "crashed: fell over"),
    ]


def turned(q: Any, vector: tuple[float, float, float]) -> np.ndarray[Any, Any]:
    """A vector turned by a quaternion."""
    axis, v = np.array([q.x, q.y, q.z]), np.array(vector)
    return v + 2.0 * q.w * np.cross(axis, v) + 2.0 * np.cross(axis, np.cross(axis, v))


def test_frames_are_where_the_log_has_the_vehicle(run: Run, mcap: dict[str, Any]) -> None:
    assert mcap["schemas"]["/tf"] == "foxglove.FrameTransforms"
    jets = run.scenario.resolved_vehicle()[0].jets
    for time, message in mcap["messages"]["/tf"]:
        k = time // 4_000_000
        frames = {frame.child_frame_id: frame for frame in message.transforms}
        assert [frame.timestamp.ToNanoseconds() for frame in message.transforms] == [time] * len(frames)
        world, body = frames["ned"], frames["body"]
        for axis, expected in ((1, 0, 0), (0, 1, 0)), ((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 0, -1)):
            np.testing.assert_allclose(turned(world.rotation, axis), expected, atol=1e-12)  # north is y, down is -z
        at = body.translation
        assert (at.x, at.y, at.z) == tuple(run.log[f"{axis}_m"][k] for axis in ("north", "east", "down"))
        # the body's y axis: to the right, downwards by the sine of roll (with next to no pitch)
        roll, pitch = run.log["roll_rad"][k], run.log["pitch_rad"][k]
        assert turned(body.rotation, (0, 1, 0))[2] == pytest.approx(np.sin(roll) * np.cos(pitch), abs=1e-12)
        for number, jet in enumerate(jets, 1):
            frame = frames[f"jet_{number}"]
            assert (frame.translation.x, frame.translation.y, frame.translation.z) == jet.position_m
            tilt = run.log[f"tilt_{jet.servo}_rad"][k]
            np.testing.assert_allclose(turned(frame.rotation, (0, 0, -1)), jet_axis(tilt), atol=1e-12)
    assert mcap["messages"]["/tf"][-1][0] == 4_000_000 * (STEPS - 1)
    poses = mcap["messages"]["/pose"]
    assert len(poses) == 26  # every 20 ms of half a second, and the last step
    assert {message.frame_id for _, message in poses} == {"ned"}


def test_scene_and_map_show_the_vehicle_its_thrust_and_its_place(run: Run, mcap: dict[str, Any]) -> None:
    vehicle = run.scenario.resolved_vehicle()[0]
    ((_, drawn),) = mcap["messages"]["/scene"]
    assert [entity.id for entity in drawn.entities] == ["body", *(f"jet_{n}" for n in range(1, 7))]
    legs = [c.position_m for c in vehicle.contacts if c.kind == "leg"]
    assert [(p.x, p.y, p.z) for p in drawn.entities[0].lines[0].points][1::2] == legs
    cube = drawn.entities[0].cubes[0]
    assert (cube.size.x, cube.size.y, cube.size.z) == pytest.approx(
        (0.4, 0.4, 0.13)
    )  # the hull's contacts, to the c.g.
    _, arrows = mcap["messages"]["/scene/arrows"][0]
    for jet, entity in enumerate(arrows.entities[:6]):
        (arrow,) = entity.arrows
        assert entity.frame_id == f"jet_{jet + 1}"
        np.testing.assert_allclose(turned(arrow.pose.orientation, (1, 0, 0)), (0, 0, -1), atol=1e-12)
        length = arrow.shaft_length + arrow.head_length
        assert length == pytest.approx(0.2 * (7.0 + jet) / hover_n(vehicle))  # hover is as long as the vehicle reaches
    wind = arrows.entities[6]
    blows = [run.log[f"wind_{axis}_m_s"][0] for axis in ("north", "east", "down")]
    np.testing.assert_allclose(
        turned(wind.arrows[0].pose.orientation, (1, 0, 0)), blows / np.linalg.norm(blows), atol=1e-12
    )
    _, fix = mcap["messages"]["/location"][-1]
    north, east = run.log["north_m"][-1], run.log["east_m"][-1]
    # a degree of latitude at 22 deg is 110.7 km, of longitude 103 km, to a part in a hundred (WGS 84)
    assert fix.latitude - NORTH_EAST[0] == pytest.approx(north / 110.7e3, rel=0.01)
    assert fix.longitude - NORTH_EAST[1] == pytest.approx(east / 103.0e3, rel=0.01)
    assert fix.altitude == pytest.approx(run.log["altitude_m"][-1])


def test_mcap_without_a_readable_scenario_has_the_rest(run: Run, tmp_path: Path) -> None:
    assert run.folder is not None
    folder = tmp_path / "run"
    shutil.copytree(run.folder, folder)
    (folder / SCENARIO).write_text("steam = true\n")
    export_log("mcap", folder, tmp_path / "x.mcap")
    with open(tmp_path / "x.mcap", "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"/tf", "/pose", "/attitude", "/log"} <= topics
    assert not topics & {"/scene", "/scene/arrows", "/location"}


def test_mat_is_one_structure_with_every_digit(run: Run, tmp_path: Path) -> None:
    assert run.folder is not None
    export_log("mat", run.folder, tmp_path / "flight.mat")
    flight = loadmat(tmp_path / "flight.mat", simplify_cells=True)["flight"]
    names = fields(run.log.columns)
    assert set(flight["columns"]) == set(names.values())
    for name, field in names.items():
        np.testing.assert_array_equal(flight["columns"][field], run.log[name], err_msg=name)
    np.testing.assert_array_equal(flight["time"], run.log["time_s"])
    for column in run.log.described:
        field = names[column.name]
        assert flight["meanings"][field] == column.meaning
        assert (flight["units"][field] if column.unit else "") == column.unit
    assert flight["names"] == {names[LONG.name]: LONG.name}
    assert len(names[LONG.name]) == 63
    assert flight["metadata"]["scenario"] == "doublet-ä"
    assert flight["metrics"]["roll_rmse_rad"] == run.summary.flat_metrics["roll.rmse_rad"]
    assert list(flight["events"]["text"]) == ["jet 6: flame-out", "over: jet 6: flame-out", "crashed: fell over"]
    np.testing.assert_allclose(flight["events"]["time"], [0.1, 0.3, 0.5])


def test_names_that_matlab_cannot_have_are_others_and_all_differ() -> None:
    made = fields(("end", "xend", "_a", "roll.rmse_rad", "b" * 70, "b" * 71, "fine"))
    assert made == {
        "end": "xend_2", "xend": "xend", "_a": "x_a", "roll.rmse_rad": "roll_rmse_rad", "b" * 70: "b" * 63,
        "b" * 71: "b" * 61 + "_2", "fine": "fine",
    }  # fmt: skip


def test_parquet_is_a_copy_that_says_what_was_flown(run: Run, tmp_path: Path) -> None:
    assert run.folder is not None
    own = pq.read_table(run.folder / LOG)
    # an older run's file says nothing of its columns
    folder = tmp_path / "run"
    shutil.copytree(run.folder, folder)
    pq.write_table(pa.table({name: own[name] for name in own.column_names}), folder / LOG)
    for source in (run.folder, folder):
        export_log("parquet", source, tmp_path / "x.parquet")
        table = pq.read_table(tmp_path / "x.parquet")
        assert table.column_names == own.column_names
        for name in own.column_names:
            np.testing.assert_array_equal(table[name], own[name], err_msg=name)  # NaN equals NaN here
        assert table.schema.metadata[b"controller"] == b"smith"
        assert table.schema.field("mass_kg").metadata[b"unit"] == b"kg"
    with pytest.raises(
        InputError, match=r"the log is Parquet already; another file \(out\) is a copy that says what was flown"
    ):
        export_log("parquet", run.folder, run.folder / LOG)


def test_a_missing_extra_is_one_line(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name.split(".")[0] == "mcap":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    assert run.folder is not None
    with pytest.raises(
        InputError, match=r"^MCAP needs mcap.*: pip install mcap mcap-protobuf-support foxglove-schemas-protobuf$"
    ):
        export_log("mcap", run.folder, tmp_path / "x.mcap")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("to", ["mcap", "mat", "parquet"])
@pytest.mark.parametrize("rows", [0, 1])
def test_flights_of_next_to_nothing(tmp_path: Path, to: str, rows: int) -> None:
    record(rows, tmp_path / "run", "failed", "no engine")
    export_log(to, tmp_path / "run", tmp_path / f"x.{to}")
