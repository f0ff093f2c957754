"""Wrong poses and tips of a tool on a part of unknown pose: touches of landmarks show them, and the mistake is named."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.contacts.outcome import Rejection
from skincal.following.setup_follower import SetupFollower
from skincal.model.actions import AtLandmark
from skincal.model.readings import Chunk
from skincal.model.scene import load_scene
from skincal.part.part import lay_part
from skincal.rig import part_mistakes
from skincal.rig.part_mistakes import explain_misfit
from skincal.rig.part_pose import PartPoseState
from skincal.words.mistake_words import mistake_words
from tests.skincal.session.test_no_sensor import POKE_S, calibrate, outcomes_of, readings, scene_of
from tests.skincal.session.test_tool_rig import TIP, line

MARKS = np.array(
    [[-0.035, -0.035, 0.0], [0.035, -0.03, 0.03], [0.03, 0.035, 0.0], [-0.03, 0.03, 0.05],
     [0.0, -0.04, 0.06], [0.04, 0.0, 0.02], [-0.04, 0.0, 0.03], [0.0, 0.04, 0.01]]
)  # fmt: skip


def scene_text(tip=TIP):
    marks = "".join(f'[[landmarks]]\nname = "m{row}"\nplace = {place.tolist()}\n' for row, place in enumerate(MARKS))
    return (
        'name = "posts"\nlink = "posts"\n[skin]\nchannels = 9\n'
        f'[tool]\nsensor = "none"\ntip_mm = {(tip * 1e3).tolist()}\ntip_radius_mm = 2.0\ntip_sd_mm = 0.2\n' + marks
    )


@cache
def touches():
    """Touches of all landmarks, by leaning pushes; nobody changes them."""
    return tuple(readings(MARKS, aim_sd=0.0003))


def chunks(wrong):
    """The touches with each pose (4, 4) changed by `wrong`."""
    number = {"skin": 0, "tool": 0}
    for name, t, given in touches():
        values = given
        if name == "tool":
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = Rotation.from_quat(given[3:]).as_matrix(), given[:3]
            pose = wrong(pose)
            values = np.concatenate([pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat()])
        number[name] += 1
        yield Chunk(name, round(t * 1e9), line({"skin": "T", "tool": "P"}[name], number[name], t, values))


def part_of(folder, wrong, tip=TIP, marked=8):
    pipeline = calibrate(scene_of(folder, scene_text(tip)), chunks(wrong))
    for outcome in outcomes_of(pipeline)[:marked]:
        assert isinstance(outcome, Rejection)
        pipeline.act(AtLandmark(outcome.poke, f"m{int((outcome.start_s - 1.0) / POKE_S)}"), 0)
    return pipeline.snapshot()


def scalar_first(pose):
    read = pose.copy()
    read[:3, :3] = Rotation.from_quat(Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)).as_matrix()
    return read


def left_handed(pose):
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    return mirror @ pose @ mirror


def turned_base(pose):
    return np.diag([-1.0, -1.0, 1.0, 1.0]) @ pose


def test_right_poses_show_the_part(tmp_path):
    snapshot = part_of(tmp_path, lambda pose: pose)
    assert snapshot.part_pose.state is PartPoseState.KNOWN
    assert snapshot.part_misfit is None


def test_a_turned_base_is_no_mistake_of_a_part_whose_pose_is_found(tmp_path):
    assert part_of(tmp_path, turned_base).part_pose.state is PartPoseState.KNOWN


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (scalar_first, "the rotation of the tool's poses is a quaternion w x y z"),
        (left_handed, "left-handed axes"),
    ],
)
def test_wrong_poses_are_named(tmp_path, wrong, says):
    snapshot = part_of(tmp_path, wrong)
    assert snapshot.part_pose.state is PartPoseState.DISAGREES
    what, _ = mistake_words(snapshot.part_misfit.explain())
    assert says in what


@pytest.mark.parametrize("off", [[0.0, 0.0, 0.04], [0.0, 0.0, -0.12]])
def test_the_tip_of_another_tool_is_named_with_its_shift(tmp_path, off):
    snapshot = part_of(tmp_path, lambda pose: pose, TIP + off)
    assert snapshot.part_pose.state is PartPoseState.DISAGREES
    mistake = snapshot.part_misfit.explain()
    assert "the tip is elsewhere in the tool's frame than tip_mm" in mistake_words(mistake)[0]
    np.testing.assert_allclose(mistake.shift, -np.array(off), atol=0.006)


def test_the_window_explains_a_misfit_in_its_slow_work_and_no_snapshot_does(tmp_path, monkeypatch):
    """Ten fits would stop the window for seconds. Of seven touches the closed solution of `touch_mistakes` names nothing."""
    explained = []

    def record(*values):
        explained.append(len(values))
        return explain_misfit(*values)

    monkeypatch.setattr(part_mistakes, "explain_misfit", record)
    snapshot = part_of(tmp_path, left_handed, marked=7)
    assert explained == []
    jobs = []
    scene = load_scene(tmp_path / "scene.toml")
    follower = SetupFollower(lay_part(scene, None, ()), lambda work, done, *, ended: jobs.append((work, done, ended)))
    follower.check_snapshot(snapshot)
    assert explained == []
    ((work, done, ended),) = jobs
    done(work())
    ended()
    assert explained == [4]
    (said,) = follower.sentences
    assert said.startswith("The scene does not fit the pokes: the poses of the tool have left-handed axes")
    assert "miss" not in said
