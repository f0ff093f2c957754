"""Side of a flat skin from which a tool pushes: a wrong sign and a mirrored layout look alike to the force axes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.contacts.outcome import Contact
from skincal.following.tool_check import check_tool_setup
from skincal.mesh.lay import place_layout
from skincal.model.scene import load_scene
from skincal.session.session import Session
from skincal.words.mistake_words import setup_sentences

TIP = 0.15
BASE_FROM_PAD = np.eye(4)
BASE_FROM_PAD[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 0.9]).as_matrix()
BASE_FROM_PAD[:3, 3] = [0.4, -0.2, 0.05]
PADS = np.array([[10.0 * (column - 2.5), 10.0 * (row - 1.5)] for row in range(4) for column in range(6)])  # mm


def write_scene(folder, sensor, *, sign=-1, mirrored=False):
    """A flat pad that is poked by a tool; the pokes show its pose."""
    pads = PADS * [-1.0, 1.0] if mirrored else PADS
    layout = (
        f'[[modules]]\nid = 1\nkind = "grid"\nfirst_channel = 0\nplace_mm = [0, 0]\n[kinds.grid]\npads_mm = {pads.tolist()}\n'
        "outline_mm = [[-30, -20], [30, -20], [30, 20], [-30, 20]]\ncentre_pad = 0\n"
    )
    (folder / "modules.toml").write_text(layout, encoding="utf-8")
    wrench = f"[wrench]\nsign = {sign}\n" if sensor == "tool" else ""
    (folder / "scene.toml").write_text(
        'name = "pad"\nlink = "pad"\n[skin]\nchannels = 24\nmodules = "modules.toml"\n[skin.anchor]\nat_mm = [0, 0]\n'
        "point_mm = [0, 0, 10]\nx = [1, 0, 0]\nnormal = [0, 0, 1]\n"
        f'[tool]\nsensor = "{sensor}"\ntip_mm = [0, 0, {1e3 * TIP}]\n{wrench}',
        encoding="utf-8",
    )
    return load_scene(folder / "scene.toml")


def sentences(folder, sensor, *, pokes=20, reported=-1.0, **mistake):
    """What the program says of pokes on the taxels; the sensor reports `reported` times the force on the part."""
    scene, rng = write_scene(folder, sensor, **mistake), np.random.default_rng(4)
    assert scene.tool is not None
    assert scene.skin.layout is not None
    session = Session(scene, None)
    for number in range(1, pokes + 1):
        channel = int(rng.integers(24))
        pose = np.eye(4)
        lean = Rotation.from_rotvec([*rng.uniform(-0.25, 0.25, 2), 0.0]) * Rotation.from_rotvec([np.pi, 0.0, 0.0])
        pose[:3, :3] = (lean * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-3.0, 3.0)])).as_matrix()
        touched = np.append(1e-3 * PADS[channel], 0.01) + np.append(rng.normal(0.0, 0.001, 2), 0.0)
        pose[:3, 3] = touched - pose[:3, :3] @ [0.0, 0.0, TIP]
        push = np.array([0.0, 0.0, 8.0]) if sensor == "none" else scene.wrench_sign * reported * np.array([0.0, 0.0, 8.0])
        session.add(
            Contact(
                poke=number, start_s=4.0 * number, end_s=4.0 * number + 0.3, force=push, moment=np.zeros(3),
                channels=np.array([channel]), responses=np.array([100.0]),
                link_from_sensor=scene.tool.link_from_sensor(BASE_FROM_PAD @ pose), pose=scene.tool.arm_pose,
                tare_change=0.0, final=True,
            )
        )  # fmt: skip
    snapshot = session.snapshot()
    laid = place_layout(scene.skin.layout, scene.skin.anchor, None)
    return setup_sentences(check_tool_setup(snapshot, scene, laid, None))


@pytest.mark.parametrize("sensor", ["tool", "none"])
def test_a_right_scene_is_not_blamed(tmp_path, sensor):
    assert sentences(tmp_path, sensor) == ()


@pytest.mark.parametrize("sensor", ["tool", "none"])
def test_a_mirrored_layout_is_named_and_no_wrong_sign(tmp_path, sensor):
    (sentence,) = sentences(tmp_path, sensor, mirrored=True)
    assert "the layout of the skin is mirrored" in sentence
    assert "sign" not in sentence.split("To mend it")[0]


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_wrong_sign_is_named_also_where_a_mirrored_layout_hides_it(tmp_path, mirrored):
    (sentence,) = sentences(tmp_path, "tool", sign=1, mirrored=mirrored)
    assert "but the pokes show the reaction force" in sentence


def test_few_pokes_are_not_judged(tmp_path):
    assert sentences(tmp_path, "tool", pokes=5, mirrored=True) == ()
