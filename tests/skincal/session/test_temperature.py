"""A sensor's temperature is a channel of the session: kept, counted through breaks, said, read by other programs."""

import json
import struct

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from skincal.cli import main
from skincal.journal.writer import create_session
from skincal.model.readings import TEMPERATURE_NAME, Chunk, LinkEvent, LinkState, SideReading, Stream
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from skincal.simulation.emulated_devices import X25, _crc
from skincal.streams.links import LinkSpec
from tests.skincal.poke_script import write_scene

LINKS = (LinkSpec("wrench", "bota:/dev/none", (Stream.WRENCH,)), LinkSpec("skin", "/dev/none2", (Stream.SKIN,)))
SECOND_NS = 1_000_000_000


def frame(number, celsius):
    data = struct.pack("<H6fIf", 0, 1, 2, 3, 0.1, 0.2, 0.3, number * 10_000 + 1, celsius)
    return b"\xaa" + data + struct.pack("<H", _crc(X25, data) ^ 0xFFFF)


def feed(pipeline, temperatures, from_s):
    pipeline.feed(LinkEvent("wrench", from_s * SECOND_NS, LinkState.OPEN))
    for number, celsius in enumerate(temperatures):
        at_ns = from_s * SECOND_NS + number * 10_000_000
        pipeline.feed(Chunk("wrench", at_ns, frame(number, celsius)))
        pipeline.tick(at_ns)


@pytest.fixture
def folder(tmp_path):
    scene = write_scene(tmp_path)
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    feed(pipeline, [31.0, 30.5, *(31.0 + 0.01 * k for k in range(200))], 1)
    # The device is unplugged, and warmer when it comes back.
    feed(pipeline, [33.0] * 100, 10)
    pipeline.close()
    return tmp_path / "s"


def test_least_most_and_newest_come_back_loaded_and_played_and_go_on(folder):
    for opened in (load(folder), replay(folder)):
        (of,) = [link.beside for link in opened.totals().links if link.beside]
        assert of.keys() == {TEMPERATURE_NAME}
        assert of[TEMPERATURE_NAME] == SideReading(30.5, 33.0, 33.0)
    again = resume(folder)
    feed(again, [34.0, 32.25], 30)
    again.close()
    (of,) = [link.beside for link in load(folder).totals().links if link.beside]
    assert of[TEMPERATURE_NAME] == SideReading(30.5, 34.0, 32.25)


def test_other_programs_read_it(folder):
    with (folder / "segment-0001.mcap").open("rb") as file:
        found = [
            (message.log_time, decoded)
            for _, _, message, decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                topics=["/temperature"]
            )
        ]
    assert 5 <= len(found) <= 8  # two a second
    assert all(decoded.header.frame_id == "wrench" and decoded.variance == 0 for _, decoded in found)
    assert all(30.4 < decoded.temperature < 33.1 for _, decoded in found)
    assert found[-1][1].temperature == 33.0
    log_ns, first = found[0]
    assert first.header.stamp.sec * SECOND_NS + first.header.stamp.nanosec == log_ns


def test_solve_says_it(folder, capsys):
    assert main(["solve", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["links"]["wrench"]["beside"] == {
        TEMPERATURE_NAME: {"least": 30.5, "most": 33.0, "now": 33.0}
    }
    assert main(["solve", str(folder)]) == 0
    assert "temperature 33.0 degC (30.5 to 33.0)" in capsys.readouterr().out
