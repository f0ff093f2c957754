"""A wrench in another frame than the sensor's: said, and converted where the URDF knows the way. Truth: a simulated bench."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from skincal.cli import main
from skincal.devices.decoding import pack
from skincal.devices.ros2 import write_head, write_message
from skincal.following.background import run_at_once
from skincal.following.results import SessionResults, use_offered
from skincal.following.review import ReviewRequest, diagnose_rig
from skincal.following.setup_follower import SetupFollower
from skincal.journal.documents import SegmentHeader
from skincal.model.actions import AtLandmark
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, Loss, Stream
from skincal.model.scene import load_scene
from skincal.model.wrench_frames import FrameKind, rigid_points
from skincal.ros.dds import message_types
from skincal.ros.topics import TopicChoice
from skincal.session.corrections import offered
from skincal.session.pipeline import Pipeline
from skincal.session.replay import apply_item, load, replay
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import LinkIntake
from skincal.streams.links import LinkSpec
from skincal.words.frame_words import frame_sentences
from skincal.words.mistake_words import frame_sentence, setup_sentences
from skincal.words.verdict_words import verdict_sentence
from tests.skincal.ros_support import WRENCH_TYPE, make_message, wrench_message
from tests.skincal.wrench_frame_support import (
    IN_BASE,
    IN_BASE_AXES,
    IN_TOOL,
    PADS_M,
    TOOL_SHIFT_M,
    largest_difference,
    positions,
    true_readings,
    write_bag,
    write_scene,
)

AS_IT_IS = lambda wrench: wrench  # noqa: E731
EQUAL_M = 1e-9


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    """Positions of the recording in the sensor's own frame, without and with a layout."""
    folder = tmp_path_factory.mktemp("right")
    bag = write_bag(folder / "bag", lambda _: "ft_link", AS_IT_IS)
    return {
        with_layout: positions(imported(folder / f"{with_layout}", bag, with_layout=with_layout)[0])
        for with_layout in (False, True)
    }


def assert_verdict_doubts(session, frame):
    """Every method's verdict names the frame that is not settled, and believes nothing; without one, it does not."""
    results = SessionResults(load(session))
    for method in results.session.methods:
        verdict = results.verdict(method)
        assert verdict.frame_in_doubt == frame
        assert (f"name the frame {frame}, and what they mean is not settled" in verdict_sentence(verdict)) is bool(frame)
        assert not frame or (verdict.doubted and not verdict.believed)


def imported(folder, bag, capsys=None, **scene):
    """Import a bag; the session, and what was printed."""
    path = write_scene(folder, **scene)
    if capsys is not None:
        capsys.readouterr()
    assert main(["import", "rosbag", str(bag), "--scene", str(path), "--out", str(folder / "session")]) == 0
    return folder / "session", "" if capsys is None else capsys.readouterr().out


CASES = {
    "rigid, turned and shifted": ("tool", IN_TOOL),
    "ROS 1 writes a slash": ("/tool", IN_TOOL),
    "a joint names the frame of its child": ("tool_joint", IN_TOOL),
    "another name at the same place": ("ft_same_place", AS_IT_IS),
    "the sensor's own name": ("wrist_ft", AS_IT_IS),
    "the parent link": ("base_link", IN_BASE),
    "no frame": ("", AS_IT_IS),
}


@pytest.mark.parametrize(
    ("case", "kind"),
    [*((case, "mcap") for case in CASES), ("rigid, turned and shifted", "ros1"), ("ROS 1 writes a slash", "ros1")],
)
def test_a_wrench_in_a_frame_that_is_rigid_to_the_sensor_gives_the_right_positions(tmp_path, capsys, right, case, kind):
    name, made = CASES[case]
    session, said = imported(tmp_path / "part", write_bag(tmp_path / "bag", lambda _: name, made, kind), capsys)
    assert largest_difference(positions(session), right[False]) < EQUAL_M
    assert (f"(geometry_msgs/msg/WrenchStamped), in the frame {name.removeprefix('/')}." in said) == bool(name)
    assert ("it is turned by 90.0 degrees and moved by" in said) == (made is not AS_IT_IS)
    # A second decoding gives the same bits.
    again = replay(session).snapshot().contacts
    for one, other in zip(load(session).snapshot().contacts, again, strict=True):
        assert one.moment.tobytes() == other.moment.tobytes()
        assert one.force.tobytes() == other.force.tobytes()


def test_a_moving_joint_between_frame_and_sensor_is_named_before_anything_else(tmp_path, capsys):
    # The stand's axes are those of the base at angle 0: the pokes miss by half a metre.
    bag = write_bag(tmp_path / "bag", lambda _: "stand", IN_BASE)
    session, said = imported(tmp_path / "part", bag, capsys, with_layout=True)
    assert said.startswith("The wrench is in the frame stand, and yaw may move between it and the sensor wrist_ft")
    assert "it is not known in which frame the wrench is: its messages name stand" in said
    for wrong_remedy in ("turned by", "must move", "kilogram-force", "correct the sensor's pose"):
        assert wrong_remedy not in said
    assert main(["solve", str(session)]) == 0
    assert "it is not known in which frame the wrench is: its messages name stand" in capsys.readouterr().out


def test_an_angle_that_the_scene_holds_fixed_makes_a_rigid_way(tmp_path, right):
    bag = write_bag(tmp_path / "bag", lambda _: "stand", IN_BASE)
    scene = write_scene(tmp_path / "part")
    scene.write_text(f"{scene.read_text()}\n[robot.fixed]\nyaw = 0.0\n")
    assert main(["import", "rosbag", str(bag), "--scene", str(scene), "--out", str(tmp_path / "session")]) == 0
    assert largest_difference(positions(tmp_path / "session"), right[False]) < EQUAL_M


def test_a_frame_that_the_urdf_does_not_have_is_settled_by_adding_it(tmp_path, capsys, right):
    bag = write_bag(tmp_path / "bag", lambda _: "tool0_controller", lambda wrench: IN_TOOL(wrench))
    session, said = imported(tmp_path / "before", bag, capsys, with_layout=True)
    assert said.startswith("The wrench is in the frame tool0_controller, which is not in bench.urdf: the tool centre point")
    assert "its messages name tool0_controller. Settle that first" in said
    assert_verdict_doubts(session, "tool0_controller")
    assert "turned by" not in said
    assert "must move" not in said
    assert largest_difference(positions(session), right[True]) > 0.05
    # The advice, followed: a link at the tool centre point.
    joint = '<joint name="tcp" type="fixed"><parent link="tool"/><child link="tool0_controller"/></joint>'
    more = f'<link name="tool0_controller"/>{joint}'
    session, said = imported(tmp_path / "after", bag, capsys, with_layout=True, more=more)
    assert largest_difference(positions(session), right[True]) < EQUAL_M
    assert "not in bench.urdf" not in said
    assert "do not fit" not in said


@pytest.mark.parametrize("name", ["my_sensor", "stand", "tool"])
def test_a_wrong_name_of_the_sensors_own_frame_is_settled_in_the_scene(tmp_path, capsys, right, name):
    bag = write_bag(tmp_path / "bag", lambda _: name, AS_IT_IS)
    _, said = imported(tmp_path / "before", bag, capsys, with_layout=True)
    advice = 'frame = "wrist_ft"'
    assert f"write {advice} in [wrench] of the scene" in said
    session, said = imported(tmp_path / "after", bag, capsys, with_layout=True, wrench=advice)
    assert largest_difference(positions(session), right[True]) < EQUAL_M
    assert f"name the frame {name}; it is taken as wrist_ft, as [wrench] of the scene says" in said


@pytest.mark.parametrize("with_layout", [False, True])
def test_axes_of_the_base_with_moments_about_the_sensor_are_found_out(tmp_path, capsys, right, with_layout):
    bag = write_bag(tmp_path / "bag", lambda _: "base_link", IN_BASE_AXES)
    session, said = imported(tmp_path / "before", bag, capsys, with_layout=with_layout)
    advice = 'about = "wrist_ft"'
    assert_verdict_doubts(session, "base_link")
    assert "Its moments are taken about the origin of base_link, the rule of ROS" in said
    assert "by the rule the pokes pass the sensor at" in said
    assert f"write {advice} in [wrench] of the scene" in said
    if with_layout:
        assert (
            "the moments of the wrench are about wrist_ft, not about the origin of base_link. To mend it, write about" in said
        )
        assert "must move" not in said
        assert "turned by -90" not in said
    # The operator knows that the rule holds: the same positions, and no doubt.
    by_rule = 'about = "base_link"'
    assert f"If they are about base_link, write {by_rule}; a layout or landmarks show which" in said
    kept, _ = imported(tmp_path / "kept", bag, capsys, with_layout=with_layout, wrench=by_rule)
    assert largest_difference(positions(kept), positions(session)) < EQUAL_M
    assert_verdict_doubts(kept, "")
    session, said = imported(tmp_path / "after", bag, capsys, with_layout=with_layout, wrench=advice)
    assert largest_difference(positions(session), right[with_layout]) < EQUAL_M
    assert_verdict_doubts(session, "")
    assert "Its moments are taken about wrist_ft, as [wrench] of the scene says" in said


def test_moments_about_a_link_at_the_sensor_are_found_by_the_layout(tmp_path, capsys, right):
    # The axes of the base about the tool, as Universal Robots' controller has them.
    made = lambda wrench: IN_BASE_AXES(np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(TOOL_SHIFT_M, wrench[:, :3])]))  # noqa: E731
    bag = write_bag(tmp_path / "bag", lambda _: "base_link", made)
    _, said = imported(tmp_path / "before", bag, capsys, with_layout=True)
    assert "the moments of the wrench are about tool, not about the origin of base_link" in said
    session, _ = imported(tmp_path / "after", bag, with_layout=True, wrench='about = "tool"')
    assert largest_difference(positions(session), right[True]) < EQUAL_M


def test_two_publishers_with_frames_that_the_urdf_knows_are_each_converted(tmp_path, capsys, right):
    wrench, _ = true_readings()
    rows = np.where(np.arange(len(wrench))[:, None] % 2, IN_TOOL(wrench), wrench)
    session, said = imported(
        tmp_path / "part", write_bag(tmp_path / "bag", lambda n: "tool" if n % 2 else "ft_link", rows), capsys
    )
    assert "in 2 frames: ft_link (850 readings), tool (850 readings)" in said
    assert "name 2 frames, ft_link and tool: two programs publish on its topic" in said
    assert largest_difference(positions(session), right[False]) < EQUAL_M


def test_readings_of_a_second_frame_that_is_not_known_are_left_out_and_counted(tmp_path, capsys, right):
    wrench, _ = true_readings()
    rows = np.where(np.arange(len(wrench))[:, None] % 2, IN_TOOL(wrench), wrench)
    bag = write_bag(tmp_path / "bag", lambda n: "unheard_of" if n % 2 else "ft_link", rows)
    session, said = imported(tmp_path / "part", bag, capsys)
    assert "Only readings in ft_link are used. Record the topic of one publisher." in said
    assert f"lost: 850 {Loss.OTHER_FRAME.value}" in said
    assert largest_difference(positions(session), right[False]) < 0.003  # half the readings, the same truth
    assert load(session).totals().links[0].losses[Loss.OTHER_FRAME] == 850
    assert [each.name for each in load(session).session.wrench_frames] == ["ft_link", "unheard_of"]


def test_without_a_urdf_the_frame_is_said_and_nothing_else(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text('name = "plate"\nlink = "plate"\n[skin]\nchannels = 16\n')
    bag = write_bag(tmp_path / "bag", lambda _: "base_link", IN_BASE)
    asked = ["import", "rosbag", str(bag), "--scene", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "session")]
    capsys.readouterr()
    assert main(asked) == 0
    said = capsys.readouterr().out
    assert said.startswith("wrench: /ft/wrench (geometry_msgs/msg/WrenchStamped), in the frame base_link.")


def test_a_wrong_entry_of_the_scene_is_refused(tmp_path, capsys):
    for entry, expected in (
        ('frame = "nowhere"', "frame is 'nowhere', which is not in bench.urdf"),
        ('about = "stand"', "about is 'stand', and yaw may move between it and the sensor wrist_ft"),
    ):
        scene = write_scene(tmp_path / entry[:5], wrench=entry)
        assert main(["scene", "show", str(scene)]) == 2
        assert expected in capsys.readouterr().err
    plain = tmp_path / "plain.toml"
    plain.write_text('name = "plate"\nlink = "plate"\n[skin]\nchannels = 16\n[wrench]\nframe = "tool"\n')
    assert main(["scene", "show", str(plain)]) == 2
    assert "frame is 'tool', and the scene has no [robot]" in capsys.readouterr().err


def test_frames_and_points_agree_with_the_poses_of_the_urdf(tmp_path):
    scene = load_scene(write_scene(tmp_path))
    tool = scene.wrench_frame("tool")
    assert tool.kind is FrameKind.RIGID
    np.testing.assert_allclose(tool.sensor_from_frame[:3, 3], TOOL_SHIFT_M, atol=1e-15)
    assert scene.wrench_frame("stand").joints == ("yaw",)
    assert scene.wrench_frame("nowhere").kind is FrameKind.UNKNOWN
    points = rigid_points(scene.robot)
    assert list(points) == ["wrist_ft", "base_link", "tool", "patch"]
    np.testing.assert_allclose(points["patch"], [0, 0, 0.045], atol=1e-15)


# ------------------------------------------------------------------ live


def live_packets(frames, rows):
    """Packets of the link `dds`, and messages of a rosbridge."""
    types, packets, texts = message_types(), [write_head(TopicChoice(("/ft",)), [WRENCH_TYPE], {})], []
    texts.append(write_head(TopicChoice(("/ft",)), (WRENCH_TYPE,), {}))
    for number, (frame, row) in enumerate(zip(frames, rows, strict=True)):
        content = wrench_message(10**12 + number * 10**7, row)
        content["header"] |= {"frame_id": frame}
        data = types.encode(make_message(types, WRENCH_TYPE, content), WRENCH_TYPE)
        packets.append(write_message(0, 10**12 + number * 10**7, 10**12 + number * 10**7, data))
        texts.append(pack(1, json.dumps({"op": "publish", "topic": "/ft", "msg": content}).encode()))
    return packets, texts


def values_of(packets, format_name, scene, per_chunk):
    spec = LinkSpec("wrench", "file:x", (Stream.WRENCH,), format_name)
    link = LinkIntake(ExpectedReadings(16), spec, find_frame=scene.wrench_frame)
    found = [
        each.batch.values
        for at in range(0, len(packets), per_chunk)
        for each in link.feed(Chunk("wrench", 1 + at, b"".join(packets[at : at + per_chunk])))
    ]
    return np.concatenate(found), link.health(0)


@pytest.mark.parametrize("format_name", ["ros2", "rosbridge"])
def test_live_messages_are_converted_the_same_in_runs_and_one_by_one(tmp_path, format_name):
    scene = load_scene(write_scene(tmp_path))
    wrench = true_readings()[0][200:260]
    frames = ["tool"] * 50 + ["ft_link"] * 10
    rows = np.vstack([IN_TOOL(wrench[:50]), wrench[50:]])
    packets = live_packets(frames, rows)[format_name == "rosbridge"]
    many, health = values_of(packets, format_name, scene, 30)
    single, _ = values_of(packets, format_name, scene, 1)
    assert many.tobytes() == single.tobytes()
    np.testing.assert_allclose(many, wrench, atol=1e-12)
    assert health.frames == ("tool", "ft_link")
    assert health.units.endswith("in the frame tool and ft_link")


@pytest.mark.parametrize("entry", ["", 'frame = "tool"'])
def test_a_session_of_an_old_format_is_replayed_as_it_was_unless_its_scene_names_the_frame(tmp_path, entry):
    scene = load_scene(write_scene(tmp_path, wrench=entry))
    link = LinkSpec("wrench", "file:x", (Stream.WRENCH,), "ros2")
    wrench = true_readings()[0][200:240]
    packets, _ = live_packets(["tool"] * 20 + ["unheard_of"] * 20, IN_TOOL(wrench))
    pipeline = Pipeline(scene, [link], None)
    apply_item(pipeline, SegmentHeader(1, 0, (link,), 4, None, continues=False))
    pipeline.feed(Chunk("wrench", 1, b"".join(packets)))
    _, found = pipeline._intake.recent_wrench()
    if entry:
        np.testing.assert_allclose(found, wrench[:20], atol=1e-12)
    else:
        assert found.tobytes() == IN_TOOL(wrench).tobytes()
        assert frame_sentences(pipeline.session.wrench_frames[:1]) == ()


def test_landmarks_offer_no_correction_that_hides_the_frame_of_the_wrench(tmp_path):
    bag = write_bag(tmp_path / "bag", lambda _: "unheard_of", IN_TOOL)
    scene = write_scene(tmp_path / "part")
    marks = "".join(
        f'\n[[landmarks]]\nname = "pad {n}"\nplace = [{x}, {y}, 0.0]\nnormal = [0, 0, 1]\n'
        for n, (x, y) in enumerate(PADS_M.tolist())
    )
    scene.write_text(scene.read_text() + marks)
    session = tmp_path / "session"
    assert main(["import", "rosbag", str(bag), "--scene", str(scene), "--out", str(session)]) == 0
    pipeline = load(session)
    for contact in pipeline.session.contacts:
        pipeline.act(AtLandmark(contact.poke, f"pad {contact.poke - 1}"), 10**15)
    frame, rig = diagnose_rig(ReviewRequest.from_session(pipeline.session))
    assert not frame.right
    assert frame.wrench_frame == "unheard_of"
    assert offered(frame, rig, len(pipeline.session.landmark_pokes), {}) is None
    assert "First settle the wrench's frame, unheard_of" in frame_sentence(frame, has_arm=True)
    with pytest.raises(InputError, match="First settle the wrench's frame, unheard_of"):
        use_offered(pipeline.session)
    # Without the doubt the same pokes do offer one: the frame alone holds it back.
    assert offered(replace(frame, wrench_frame=""), rig, len(pipeline.session.landmark_pokes), {}) is not None


def test_live_readings_in_a_second_frame_without_a_urdf_are_left_out():
    wrench = true_readings()[0][200:240]
    packets, _ = live_packets(["a"] * 20 + ["b"] * 20, wrench)
    link = LinkIntake(ExpectedReadings(16), LinkSpec("wrench", "file:x", (Stream.WRENCH,), "ros2"))
    assert sum(len(each.batch.seq) for each in link.feed(Chunk("wrench", 1, b"".join(packets)))) == 20
    assert link.health(0).losses == Counter({Loss.OTHER_FRAME: 20})


def test_an_open_session_says_the_frame_once(tmp_path):
    bag = write_bag(tmp_path / "bag", lambda _: "stand", IN_BASE)
    session, _ = imported(tmp_path / "part", bag, with_layout=True)
    results = SessionResults(load(session))
    follower = SetupFollower(results.part, run_at_once)
    for _ in range(2):
        follower.check_snapshot(results.snapshot, results.session.wrench_frames)
    first, second = follower.take_news()
    assert first.startswith("The wrench is in the frame stand, and yaw may move")
    assert "Settle that first" in second
    assert follower.sentences == (first, second)
    assert follower.take_news() == []
    assert setup_sentences(results.setup) == (second,)
