"""A flight as Foxglove sees it while it flies: by a client of its protocol on this machine."""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from pathlib import Path

import pytest
from command_tools import Hexjet
from patience import PATIENCE
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from cosim.base.errors import InputError
from cosim.base.frames import to_euler
from cosim.control.autopilot.modes import Severity
from cosim.groundstation.exchange import Exchange
from cosim.groundstation.foxglove_feed import FoxgloveFeed, parse_address
from cosim.groundstation.session import RecordOptions, Session
from cosim.results.export.mcap_file import SUBJECTS
from cosim.spec.scenario import Scenario

MESSAGE = 1  # the opcode of data
REFUSED = 2  # the level of a status that tells an error
AGAIN = 0.5  # s, between two words


def test_channels_pose_scene_and_words_of_a_flight(tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="no Foxglove SDK: pip install foxglove-sdk")
    from foxglove_schemas_protobuf.Log_pb2 import Log
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    exchange = Exchange()
    scenario = Scenario.load("hover").replace(name="gcs", engine="edf-as-flown", controller="smith")
    session = Session(scenario, exchange, factor=1.0, records=RecordOptions(tmp_path / "run", report=False))
    feed = FoxgloveFeed(exchange, "127.0.0.1", 0)
    feed.start()
    flight = threading.Thread(target=session.run)
    flight.start()
    try:
        with connect(feed.url, subprotocols=[Subprotocol("foxglove.sdk.v1")], proxy=None) as link:
            channels, seen, wanted = {}, {}, {"/pose": PoseInFrame, "/scene": SceneUpdate, "/log": Log, "/jet": None}
            end = time.monotonic() + PATIENCE

            def ask() -> None:
                subscriptions = [
                    {"id": number, "channelId": channels[name]["id"]}
                    for number, name in enumerate(wanted)
                    if name not in seen
                ]
                link.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

            asked, say_next = False, 0.0
            while set(seen) < set(wanted):
                assert time.monotonic() < end, (list(channels), list(seen))
                if asked and time.monotonic() > say_next:  # again: no channel keeps a word for who comes later
                    exchange.say(Severity.WARNING, "something is said")
                    say_next = time.monotonic() + AGAIN
                try:
                    told = link.recv(AGAIN)
                except TimeoutError:
                    continue
                if isinstance(told, str):
                    message = json.loads(told)
                    if message["op"] == "serverInfo":
                        assert message["capabilities"] == []  # nothing can be asked of the vehicle
                    channels |= {each["topic"]: each for each in message.get("channels", ())}
                    if not asked and set(wanted) < set(channels):
                        asked = True
                        ask()
                    # the SDK tells a channel before it knows it itself: who asks at once may be refused once
                    elif message["op"] == "status" and message["level"] == REFUSED:
                        ask()
                elif told[0] == MESSAGE:
                    number, stamp = struct.unpack_from("<IQ", told, 1)
                    name, content = list(wanted)[number], told[13:]
                    # a busy machine has words of its own: steps that were late
                    if name != "/log" or "said" in Log.FromString(content).message:
                        seen[name] = (stamp, content)
        snapshot = exchange.snapshot
    finally:
        session.stop("seen")
        flight.join()
        feed.stop()
        feed.stop()
    assert {*SUBJECTS, "/time", "/tf", "/location", "/scene/arrows"} - {"/own"} <= set(channels)
    assert {channels[name]["encoding"] for name in wanted} == {"protobuf"}
    assert channels["/pose"]["schemaName"] == "foxglove.PoseInFrame"
    stamp, content = seen["/pose"]
    pose = PoseInFrame.FromString(content)
    assert snapshot is not None
    assert snapshot.sample is not None
    state = snapshot.sample.state  # it stands still on the ground, so every sample is the same to a millimetre
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == pytest.approx(state.position, abs=1e-3)
    q = pose.pose.orientation
    assert to_euler((q.w, q.x, q.y, q.z)) == pytest.approx(state.euler, abs=1e-3)
    assert 0 < stamp <= 1e9 * snapshot.time
    assert {entity.id for entity in SceneUpdate.FromString(seen["/scene"][1]).entities} >= {"body", "jet_1", "jet_6"}
    assert "said" in Log.FromString(seen["/log"][1]).message


@pytest.mark.parametrize("text", ["", "x", "127.0.0.1", "70000", "-1", "127.0.0.1:"])
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(InputError, match="must be \\[HOST:\\]PORT"):
        parse_address(text, False)


def test_the_network_needs_to_be_allowed() -> None:
    assert parse_address("8766", False) == ("127.0.0.1", 8766)
    assert parse_address("8766", True) == ("0.0.0.0", 8766)
    assert parse_address("192.0.2.1:1", True) == ("192.0.2.1", 1)
    with pytest.raises(InputError, match=r"192\.0\.2\.1:1: listens to the network, which needs --public"):
        parse_address("192.0.2.1:1", False)


def test_without_the_sdk_it_says_what_to_install(hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    done = hexjet("gcs", "--foxglove", "--mavlink", "udpout:127.0.0.1:9", "--duration", "1")
    assert done.status == 2
    assert done.err.splitlines()[-1].endswith("which is not installed: pip install 'hexjet-cosim[foxglove]'")


def test_a_port_that_is_taken() -> None:
    pytest.importorskip("foxglove", reason="no Foxglove SDK: pip install foxglove-sdk")
    first = FoxgloveFeed(Exchange(), "127.0.0.1", 0)
    port = int(first.url.rpartition(":")[2])
    try:
        with pytest.raises(InputError, match=f"--foxglove 127.0.0.1:{port}: the port cannot be opened: [^\n]+$"):
            FoxgloveFeed(Exchange(), "127.0.0.1", port)
    finally:
        first.stop()
