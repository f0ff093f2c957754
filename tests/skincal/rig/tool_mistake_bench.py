"""Sessions of the independent simulator with one mistake made on purpose, and what the program says within 20 pokes."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from skincal.following.tool_check import check_tool_setup
from skincal.mesh.lay import place_layout
from skincal.mesh.surface import make_surface
from skincal.session.session import Session
from skincal.simulation.example_parts import forearm
from skincal.studies.tool_simulator import NO_LANDMARK, TOOL_RIGS, simulate_tool_session
from skincal.studies.tool_study import POSE_FOUND, POSE_GIVEN, ToolCase, contacts_of, scene_of, touch_landmarks
from skincal.words.mistake_words import setup_sentences

LANDMARKS, SKIN_POKES = 6, 14
RIG = "good_wrist"


def poked(seed=1, skin=SKIN_POKES):
    """A session of six touches at landmarks and some pokes on the skin."""
    part = forearm()
    model = TOOL_RIGS[RIG]
    made = simulate_tool_session(part.scene, part.surface.vertices, part.surface.triangles, model, seed, (LANDMARKS, skin))
    first = np.flatnonzero(made.landmark != NO_LANDMARK)[:LANDMARKS]
    rows = np.concatenate([first, np.flatnonzero(made.landmark == NO_LANDMARK)])
    picked = {
        name: getattr(made, name)[rows]
        for name in ("wrench", "rest_wrench", "base_from_tool", "responses", "landmark", "contact")
    }
    return replace(made, **picked)


def with_poses(made, change):
    return replace(made, base_from_tool=np.array([change(pose) for pose in made.base_from_tool]))


def turned(pose, rotation):
    changed = pose.copy()
    changed[:3, :3] = rotation
    return changed


def other_tip(made):
    return replace(made, tip=made.tip - np.array([0.0, 0.0, 0.045]))


def flange_for_tip(made):
    """The pose of the tool centre point is read as that of the flange: the tip of the scene is added again."""
    pose = np.eye(4)
    pose[:3, 3] = made.tip
    return replace(made, base_from_tool=made.base_from_tool @ pose)


def inverse(made):
    return with_poses(made, np.linalg.inv)


def scalar_first(made):
    def read(pose):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        return turned(pose, Rotation.from_quat([w, x, y, z]).as_matrix())

    return with_poses(made, read)


def vector_as_angles(made):
    return with_poses(
        made, lambda pose: turned(pose, Rotation.from_euler("xyz", Rotation.from_matrix(pose[:3, :3]).as_rotvec()).as_matrix())
    )


def left_handed(made):
    """Positions with y and z exchanged, rotations as they are: a tracker whose driver swaps two axes."""

    def read(pose):
        changed = pose.copy()
        changed[:3, 3] = pose[[0, 2, 1], 3]
        return changed

    return with_poses(made, read)


def sensor_turned(made):
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()

    def read(wrench):
        return np.concatenate([wrench[:, :3] @ turn.T, wrench[:, 3:] @ turn.T], axis=1)

    return replace(made, wrench=read(made.wrench), rest_wrench=read(made.rest_wrench))


def force_sign(made):
    return replace(made, wrench=-made.wrench, rest_wrench=-made.rest_wrench)


def part_moved(made):
    """The part is shifted by 25 mm after half of the pokes on the skin."""
    shift = np.eye(4)
    shift[:3, 3] = [0.018, -0.015, 0.008]
    poses = made.base_from_tool.copy()
    half = LANDMARKS + (len(poses) - LANDMARKS) // 2
    poses[half:] = shift @ poses[half:]
    return replace(made, base_from_tool=poses)


MADE = {
    "right": lambda made: made,
    "tool centre point of another tool": other_tip,
    "pose of the tip read as that of the flange": flange_for_tip,
    "inverse poses": inverse,
    "quaternion scalar first": scalar_first,
    "rotation vector read as angles": vector_as_angles,
    "left-handed tracker": left_handed,
    "sensor turned on the flange": sensor_turned,
    "sign of the force": force_sign,
    "part moved in the middle": part_moved,
}


def said(made, *, is_given=False, landmarks=LANDMARKS, form=None):
    """Sentences of the program on a session's scene, as the window lists them."""
    case = ToolCase(RIG, POSE_GIVEN if is_given else POSE_FOUND, landmarks, has_mesh=True)
    scene = scene_of(case, made)
    if form is not None:
        scene = replace(scene, tool=replace(scene.tool, form=form, metres_per_unit=1.0))
    surface = make_surface(made.vertices, forearm().surface.triangles)
    session = Session(scene, surface)
    touch_landmarks(session, made)
    for contact in contacts_of(made, scene):
        session.add(contact)
    snapshot = session.snapshot()
    laid = place_layout(scene.skin.layout, scene.skin.anchor, surface)
    return setup_sentences(check_tool_setup(snapshot, scene, laid, surface))
