"""A sensor whose axes are swapped or whose signs are turned: landmarks show it, through the device's bytes, and say what."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.cli import main
from skincal.devices.netft_page import keep_transform
from skincal.journal.writer import create_session
from skincal.model.actions import AskLandmark
from skincal.model.readings import Chunk, LinkEvent, LinkState, Stream
from skincal.robot.target_lines import NoTarget, PokeTarget
from skincal.session.pipeline import Pipeline
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.emulated_devices import MAKERS
from skincal.simulation.operator import GuidedOperator, Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.streams.links import LinkSpec
from tests.approved import approved
from tests.skincal.sim_support import make_rig

POSE = "2"
START_NS = 1_000_000_000
ADDRESSES = {"netft": "netft://192.168.1.1?cpf=1000000&cpt=1000000", "bota": "bota:/dev/ttyUSB0", "yarp": "yarp:/x/analog:o"}
WIRINGS = {
    "signs": (np.diag([1.0, -1.0, -1.0]), approved("sensor_frame.signs_turned", axes="y, z")),
    "axes": (np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), approved("sensor_frame.axes_order", order="-y, x, z")),
    "reaction": (-np.eye(3), approved("sensor_frame.reaction")),
}  # fmt: skip


TRANSFORM_PAGE = (
    b"<netft><cfgcpf>1000000</cfgcpf><scfgfu>N</scfgfu><cfgcpt>1000000</cfgcpt><scfgtu>Nm</scfgtu>"
    b"<cfgtfx>12;-8;132.71;15;-20;40</cfgtfx><scfgtdu>mm</scfgtdu><scfgtau>degrees</scfgtau></netft>"
)


def through_tool_transform():
    """The matrix (6, 6) from a wrench in the sensor's own frame to that of `TRANSFORM_PAGE`, by the rotations of scipy."""
    turn = Rotation.from_euler("XYZ", [15, -20, 40], degrees=True).as_matrix().T
    reported = np.kron(np.eye(2), turn)
    x, y, z = 0.012, -0.008, 0.13271
    reported[3:, :3] = -turn @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return reported


def recorded(folder, maker, wiring, page=None):
    """A session of pokes at the scene's landmarks with a sensor whose reported axes are `wiring` times the right ones.

    `wiring` is (3, 3), or (6, 6) for the whole wrench; `page` is that of a Net F/T.
    """
    rig = make_rig(RigErrors.noise())
    scene = rig.scene
    operator = GuidedOperator(rig, replace(Habits.careful().at_pace(4.0), ignores=0.0), np.random.default_rng(1), poses=(POSE,))
    operator.show(NoTarget.WAIT)
    speakers = {Stream.WRENCH: maker}
    line = DeviceTimeline(rig, operator, np.random.default_rng(2), DeviceSettings(emulated=speakers, wrench_hz=500.0))
    board = next(board for board in line._boards if board.stream is Stream.WRENCH)
    send, both = board.encoder.encode, wiring if len(wiring) == 6 else np.kron(np.eye(2), wiring)
    board.encoder.encode = lambda stream, t_us, wrenches: send(stream, t_us, wrenches @ both.T)
    links = [
        LinkSpec(name, ADDRESSES[maker] if stream is Stream.WRENCH else f"simulated:{name}", (stream,))
        for name, stream in line.links.items()
    ]
    pipeline = Pipeline(scene, links, rig.surface, create_session(folder, scene, links))
    for link in links:
        pipeline.feed(LinkEvent(link.name, START_NS, LinkState.OPEN))
    if maker == "netft":
        from skincal.devices.decoding import pack
        from skincal.devices.netft import PAGE, RECORDS
        from skincal.devices.netft_page import given_page

        pipeline.feed(Chunk("wrench", START_NS, pack(PAGE, page or given_page(1e6, 1e6, "Net F/T"))))
        size = 36
        wrap = lambda data: b"".join(pack(RECORDS, data[at : at + size]) for at in range(0, len(data), size))  # noqa: E731
    elif maker == "yarp":
        pipeline.feed(Chunk("wrench", START_NS, b"YA\x29\x00\x00\x00RP"))
        wrap = bytes
    else:
        wrap = bytes

    def play(pokes):
        while len(pipeline.snapshot().pokes) < pokes and line.now < 60:
            for at_ns, link, data in line.advance():
                pipeline.feed(Chunk(link, START_NS + at_ns, wrap(data) if link == "wrench" else data))
            pipeline.tick(START_NS + round(line.now * 1e9))

    for count, mark in enumerate(scene.landmarks, 1):
        pipeline.act(AskLandmark(mark.name), START_NS + round(line.now * 1e9))
        operator.show(PokeTarget(count, None, mark.place, -mark.normal, known=True))
        play(count)
        operator.show(NoTarget.WAIT)
    pipeline.close()


@pytest.mark.parametrize(("maker", "wiring"), [("netft", "signs"), ("bota", "axes"), ("yarp", "reaction")])
def test_landmarks_name_what_is_wrong_with_the_wires(tmp_path, capsys, maker, wiring):
    turn, words = WIRINGS[wiring]
    assert MAKERS[maker].carries[0] is Stream.WRENCH
    recorded(tmp_path / "s", maker, turn)
    assert main(["solve", str(tmp_path / "s"), "--json"]) == 0
    frame = json.loads(capsys.readouterr().out)["rig"]["frame"]
    assert (frame["right"], frame["sure"]) == (False, True)
    assert f"The sensor frame looks wrong: {words}." in frame["words"]


@pytest.mark.parametrize("kept", [False, True], ids=["undone", "kept"])
def test_a_tool_transform_of_the_box_is_undone_for_a_scene_at_the_sensor_itself(tmp_path, capsys, kept):
    """Turned by 40 degrees and moved by 133 mm: undone, the landmarks fit; kept, they show a wrong frame."""
    page = keep_transform(TRANSFORM_PAGE) if kept else TRANSFORM_PAGE
    recorded(tmp_path / "s", "netft", through_tool_transform(), page)
    assert main(["solve", str(tmp_path / "s"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rig"]["frame"]["right"] is not kept


def test_a_sensor_that_is_right_is_said_to_be(tmp_path, capsys):
    recorded(tmp_path / "s", "bota", np.eye(3))
    assert main(["solve", str(tmp_path / "s"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rig"]["frame"]["right"] is True
