"""Topics by a rosbridge server, played by a websocket server of its own: ROS 1 and ROS 2, lost and found again, refused."""

import base64
import json
import time
from contextlib import closing, contextmanager
from threading import Thread

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

from skincal.devices.link import FailureKind, LinkError
from skincal.model.readings import LinkState, Stream
from skincal.streams.decoders.auto_detect import make_decoder
from skincal.streams.links import LinkSpec, open_link
from tests.skincal.meanwhile import PATIENCE_S
from tests.skincal.streams.test_ros2_link import Recorded

pytest.importorskip("rosbags", reason="the extra rosbag is not installed")
FORCE, TORQUE = {"x": 1.0, "y": 2.0, "z": 3.0}, {"x": 0.1, "y": 0.2, "z": None}


def wrench(number, ros):
    words = ("secs", "nsecs") if ros == 1 else ("sec", "nanosec")
    header = {"stamp": dict(zip(words, (1_700_000_000 + number, 500_000_000), strict=True)), "frame_id": "ft"}
    return {"header": header, "wrench": {"force": FORCE, "torque": {**TORQUE, "z": float(number)}}}


def skin(number, _):
    return {"layout": {}, "data": base64.b64encode(bytes([number % 256, 7, 200])).decode()}


TOPICS = {"/ft": ("geometry_msgs/{}WrenchStamped", wrench), "/skin": ("std_msgs/{}UInt8MultiArray", skin)}


class Bridge:
    """A rosbridge server with its node rosapi."""

    def __init__(self, ros, port=0):
        self._ros, self.asked = ros, []
        self._server = serve(self._serve_client, "127.0.0.1", port)
        self.port = self._server.socket.getsockname()[1]
        self._clients = []
        Thread(target=self._server.serve_forever).start()

    def _serve_client(self, client):
        self._clients.append(client)
        wanted, number = [], 0
        while True:
            try:
                message = json.loads(client.recv(timeout=0.01))
                self.asked.append(message)
                wanted += self._answer(client, message)
            except TimeoutError:
                pass
            except ConnectionClosed:
                return
            number += 1
            for topic in wanted:
                said = {"op": "publish", "topic": topic, "msg": TOPICS[topic][1](number, self._ros)}
                client.send(json.dumps(said))

    def _answer(self, client, message):
        if message["op"] == "subscribe":
            return [message["topic"]]
        name = TOPICS.get(message["args"]["topic"], ("",))[0].format("msg/" if self._ros == 2 else "")
        client.send(json.dumps({"op": "status", "level": "info", "msg": "fine"}))
        client.send(json.dumps({"op": "service_response", "id": message["id"], "values": {"type": name}, "result": True}))
        return []

    def close(self):
        for client in self._clients:
            client.close()
        self._server.shutdown()


@contextmanager
def bridge(ros, port=0):
    with closing(Bridge(ros, port)) as server:
        yield server


def spec(server, topics, *carries):
    return LinkSpec("link", f"rosbridge://127.0.0.1:{server.port}{topics}", carries)


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(
    ("topics", "stream", "last"),
    [
        ("/ft", Stream.WRENCH, [1.0, 2.0, 3.0, 0.1, 0.2]),
        ("/skin+/ft?field=", Stream.SKIN, None),
        ("/skin", Stream.SKIN, [7.0, 200.0]),
        ("/ft?type=geometry_msgs/WrenchStamped&field=wrench.force", Stream.SKIN, [1.0, 2.0, 3.0]),
    ],
)
def test_both_versions_are_read(ros, topics, stream, last):
    with bridge(ros) as server, closing(open_link(spec(server, topics, stream))) as link:
        data, end_s = b"", time.monotonic() + PATIENCE_S
        while len(data) < 5000 and time.monotonic() < end_s:
            data += link.read(0.1)
    decoder = make_decoder("rosbridge", None, (stream,))
    batches = decoder.feed(data)
    if last is None:
        assert "/ft has messages of geometry_msgs/msg/WrenchStamped, which are not known as skin" in decoder.device_message
        return
    (batch,) = batches
    found = batch.values[-1].tolist()
    assert found[: len(last)] == last or found[-len(last) :] == last
    assert decoder.counts.total() == 0
    assert bool(batch.device_s[0] > 1.7e9) == ("ft" in topics)  # a skin without stamps is dated by its count
    assert [each["op"] for each in server.asked][-1] == "subscribe"


def test_a_server_that_goes_away_is_connected_again():
    with bridge(2) as first, closing(Recorded(spec(first, "/ft", Stream.WRENCH))) as link:
        link.until(lambda got: len(got.data) > 3000)
        first.close()
        link.until(lambda got: len(got.states) > 1)
        with bridge(2, first.port):
            link.until(lambda got: len(got.states) > 2 and len(got.data) > 3000)
        assert [state for state, _ in link.states] == [LinkState.OPEN, LinkState.LOST, LinkState.OPEN]
        (batch,) = make_decoder("rosbridge", None, (Stream.WRENCH,)).feed(link.data)
        assert batch.values[-1][:3].tolist() == [1.0, 2.0, 3.0]


def test_a_server_that_closes_at_once_is_lost_and_not_a_fault():
    def close_after_answers(client):
        for _ in range(2):
            asked = json.loads(client.recv())
            answer = {"op": "service_response", "id": asked["id"], "values": {"type": "geometry_msgs/WrenchStamped"}}
            client.send(json.dumps(answer))
        client.close()

    with serve(close_after_answers, "127.0.0.1", 0) as server:
        Thread(target=server.serve_forever).start()
        address = f"rosbridge://127.0.0.1:{server.socket.getsockname()[1]}/ft+/skin"

        def read_on():
            with closing(open_link(LinkSpec("link", address, (Stream.SKIN,)))) as link:
                end_s = time.monotonic() + PATIENCE_S
                while time.monotonic() < end_s:
                    link.read(0.1)
                    link.write(b"{}")

        with pytest.raises(LinkError) as raised:
            read_on()
        server.shutdown()
    assert raised.value.kind is FailureKind.VANISHED


@pytest.mark.parametrize(
    ("topics", "message"),
    [
        ("/nobody", r"it knows no type of /nobody; start its publisher"),
        ("/ft?msg=x.msg", r"needs type=package/Type"),
        ("/ft?msg=/none/x.msg&type=lab_msgs/X", r"x\.msg"),
    ],
)
def test_what_cannot_be_read_is_a_sentence(topics, message):
    with bridge(2) as server, pytest.raises(LinkError, match=message):
        open_link(spec(server, topics, Stream.WRENCH))
