"""Each usual mistake of a scene, made on purpose with the public iCub: it is named, with its remedy, within 20 pokes."""

import shutil
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.cli import main
from skincal.contacts.outcome import Reason, Rejection
from skincal.contacts.press import _closest_to_limit
from skincal.files.layout_sources import read_layout_file
from skincal.following.background import run_at_once
from skincal.following.setup_follower import SetupFollower
from skincal.mesh.lay import PlacedLayout, place_layout
from skincal.model.scene import load_scene, resource
from skincal.part.draft_preview import PartPreviewer
from skincal.part.part import load_part
from skincal.part.part_draft import PartDraft
from skincal.part.scene_draft import write_scene
from skincal.rig.correction import FRAME, Correction, UsedCorrection
from skincal.rig.setup_check import SETUP_CHECK_MIN_POKES, check_setup, mirrored_layout, other_side
from skincal.session.decisions import Decisions
from skincal.simulation.operator import Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.virtual_session import simulate_session
from skincal.words.mistake_words import setup_sentences
from skincal.words.poke_words import POLARITY_ADVICE, rejection_advice, rejection_words
from tests.skincal.sim_support import SLOW_DEVICES

POSES = "[robot.poses]\na = [94.0, 0.0]\nb = [60.0, -40.0]\nc = [30.0, 30.0]\n[contacts]\npitch_max = 0.025\n"
ANCHOR_MM = np.array([0.0, -75.0, 46.0])


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """The part, and 20 contacts of a session with the errors of the paper's rig, its arm poses in turn."""
    try:
        files = metadata.files("icub-models")
    except metadata.PackageNotFoundError:
        pytest.skip("icub-models is not installed here")
    urdf = Path(next(file for file in files if str(file).endswith("iCubGenova02/model.urdf")).locate())
    folder = tmp_path_factory.mktemp("icub")
    out = folder / "scene.toml"
    layout = read_layout_file(resource("scenes/icub-forearm/modules.toml"))
    described = PartDraft(urdf=urdf, link="l_forearm_dh_frame", sensor="l_arm_ft", layout_text=layout, polarity="down")
    write_scene(described, out, ANCHOR_MM)
    out.write_text(out.read_text() + POSES)
    part = load_part(out)
    habits = Habits.careful().at_pace(4.0)
    errors = RigErrors.paper()
    pipeline = simulate_session(
        part.scene, part.surface, folder / "s", 30, 1, errors,
        poses=("a", "b", "c"), habits=habits, settings=SLOW_DEVICES,
    )  # fmt: skip
    third = len(pipeline.session.contacts) // 3
    contacts = [
        contact for row in zip(*(pipeline.session.contacts[k * third :] for k in range(3)), strict=False) for contact in row
    ]
    assert len(contacts) >= 20
    return part, contacts[:20]


def wrenches(change):
    """Contacts with their wrenches changed by (3, 3)."""
    return lambda part, contacts: (part.scene, part.laid, [
        replace(each, force=change @ each.force, moment=change @ each.moment) for each in contacts
    ])  # fmt: skip


def turned(axis, degrees):
    return wrenches(Rotation.from_euler(axis, degrees, degrees=True).as_matrix())


def angles(change):
    """Contacts as the joint stream with changed angles gives them."""

    def apply(part, contacts):
        return part.scene, part.laid, [posed(part.scene, part.scene.arm.arm, change, each) for each in contacts]

    return apply


def posed(scene, arm, change, contact):
    new = change(scene.arm.poses[contact.pose])
    name = ", ".join(f"{angle:.0f} deg" for angle in np.degrees(new))
    return replace(contact, link_from_sensor=arm.link_from_sensor(new), pose=name)


def fixed_joint(part, contacts):
    """The scene holds the elbow at 60 degrees, and it is at 94."""
    scene, robot = part.scene, part.scene.robot
    chain, _ = robot.urdf.chain(scene.link, robot.sensor, ["l_wrist_prosup"], {"l_elbow": np.radians(60.0)}, "test")
    columns, arm = ("l_wrist_prosup",), replace(scene.arm, arm=chain, poses={})
    wrong = replace(scene, robot=replace(robot, chain=chain, columns=columns), arm=arm)
    bent = [each for each in contacts if each.pose == "a"]
    return wrong, part.laid, [posed(scene, chain, lambda angles: angles[1:], each) for each in bent]


def other_arm(part, contacts):
    """The scene names the right arm. In the iCub's frames its skin lies at (x, -y, -z)."""
    scene, robot = part.scene, part.scene.robot
    columns = ["r_elbow", "r_wrist_prosup"]
    chain, _ = robot.urdf.chain("r_forearm_dh_frame", "r_arm_ft", columns, {}, "test")
    wrong = replace(
        scene,
        link="r_forearm_dh_frame",
        robot=replace(robot, chain=chain, columns=tuple(columns), sensor="r_arm_ft"),
        arm=replace(scene.arm, arm=chain, poses={}),
    )
    flip = np.array([1.0, -1.0, -1.0])
    laid = PlacedLayout(part.laid.places * flip, part.laid.normals * flip, ())
    return wrong, laid, [posed(scene, chain, lambda angles: angles, each) for each in contacts]


def layout(change):
    """The scene's layout and anchor are changed; the skin is not."""

    def apply(part, contacts):
        planned, anchor = change(part.scene.skin.layout, part.scene.skin.anchor)
        skin = replace(part.scene.skin, layout=planned, anchor=anchor)
        return replace(part.scene, skin=skin), place_layout(planned, anchor, part.surface), contacts

    return apply


def exchanged(part, contacts):
    """The cables of modules 24 and 26 are exchanged."""
    modules = {module.id: module for module in part.scene.skin.layout.modules}
    new = np.arange(part.scene.skin.channels)
    for one, other in ((24, 26), (26, 24)):
        new[modules[one].channels] = modules[other].channels
    return part.scene, part.laid, [replace(each, channels=new[each.channels]) for each in contacts]


def moved(part, contacts):
    shift = np.array([0.1, 0.0, 0.0])
    return part.scene, PlacedLayout(part.laid.places + shift, part.laid.normals, ()), contacts


def quarter(planned, anchor):
    return planned, replace(anchor, x=np.cross(anchor.normal, anchor.x))


def mirror(planned, anchor):
    return mirrored_layout(planned, anchor.at), anchor


MISTAKES = {
    "sensor turned by 90": (turned("z", 90), "turned by -90 degrees about its z axis", "press three landmarks"),
    "sensor turned by 180": (turned("x", 180), "turned by 180 degrees about its x axis", "origin in the URDF"),
    "sensor turned by 45": (turned("z", 45), "turned by about -45 degrees about its z axis", "correct the sensor's pose"),
    "sign of the wrench": (wrenches(-np.eye(3)), "the force on the part, but the pokes show the reaction", "invert that sign"),
    "mesh origin": (moved, "mesh and layout must move by (-1", "correct the origin of the mesh"),
    "joint columns": (angles(lambda a: a[::-1]), "columns of l_elbow and l_wrist_prosup are exchanged", "exchange them"),
    "radians": (angles(np.radians), "joint angles are in radians", "send degrees"),
    "joint missing": (fixed_joint, "joint l_elbow, which the scene holds fixed, is at about", "[robot.fixed]"),
    "layout mirrored": (layout(mirror), "layout of the skin is mirrored", "change mirror"),
    "layout turned": (layout(quarter), "layout of the skin is turned by -90", "turn x of [skin.anchor]"),
    "modules": (exchanged, "modules 24 and 26 are exchanged", "exchange their first_channel"),
    "other arm": (other_arm, "arm on the other side, with the sensor l_arm_ft", "link l_forearm_dh_frame"),
}  # fmt: skip


@pytest.mark.parametrize(("make", "what", "remedy"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_with_its_remedy_within_20_pokes(rig, make, what, remedy):
    part, contacts = rig
    scene, laid, seen = make(part, contacts)
    sentences = setup_sentences(check_setup(seen, scene, laid, part.surface))
    assert what in sentences[0]
    assert remedy in sentences[0]


def test_a_right_scene_is_not_doubted(rig):
    part, contacts = rig
    for count in range(SETUP_CHECK_MIN_POKES, len(contacts) + 1):
        assert setup_sentences(check_setup(contacts[:count], part.scene, part.laid, part.surface)) == ()
    assert check_setup(contacts[: SETUP_CHECK_MIN_POKES - 1], part.scene, part.laid, part.surface) is None
    assert check_setup(contacts, part.scene, None, part.surface) is None


def snapshot_of(contacts, corrections=None):
    """What the follower reads of a session whose pokes are contacts that count."""
    counting = SimpleNamespace(counting=np.ones(len(contacts), dtype=bool))
    decisions = Decisions(corrections=corrections or {})
    return SimpleNamespace(contacts=contacts, columns=counting, decisions=decisions, value_order=None)


def test_an_open_session_says_it_once(rig):
    part, contacts = rig
    _, _, wrong = turned("z", 90)(part, contacts)
    follower = SetupFollower(part, run_at_once)
    said = []
    for count in range(len(wrong) + 1):
        follower.check_snapshot(snapshot_of(wrong[:count]))
        said.append(follower.take_news())
    assert [count for count, news in enumerate(said) if news] == [SETUP_CHECK_MIN_POKES]
    assert "about its z axis" in follower.sentences[0]


def test_a_finding_goes_when_a_correction_begins_and_returns_when_it_ends(rig):
    part, contacts = rig
    _, _, wrong = wrenches(-np.eye(3))(part, contacts)
    jobs = []
    follower = SetupFollower(part, lambda work, done, *, ended: jobs.append((work, done, ended)))

    def follow(seen, corrections):
        follower.check_snapshot(snapshot_of(seen, corrections))

    def work_off():
        while jobs:
            work, done, ended = jobs.pop(0)
            done(work())
            ended()

    follow(wrong, {})
    work_off()
    (told,) = follower.take_news()
    assert follower.sentences == (told,)
    assert follower.take_untrue() == []

    corrections = {FRAME: UsedCorrection(FRAME, Correction(-np.eye(6)), 0.001, 0.001, 6)}
    follow(contacts, corrections)
    assert follower.sentences == ()
    assert (follower.take_untrue(), follower.take_news()) == ([told], [])
    work_off()
    assert follower.sentences == ()
    assert follower.take_news() == []

    follow(wrong, {})
    follow(contacts, corrections)
    work_off()
    assert follower.sentences == (), "the check began before the correction"
    follow(wrong, {})
    work_off()
    assert follower.sentences == (told,)
    assert follower.take_news() == [told]


def test_a_check_that_fails_is_made_again_with_more_pokes(rig, monkeypatch):
    part, contacts = rig
    _, _, wrong = turned("z", 90)(part, contacts)
    follower = SetupFollower(part, run_at_once)

    def broken(*_):
        raise RuntimeError("of the check")

    def follow(count):
        follower.check_snapshot(snapshot_of(wrong[:count]))

    with monkeypatch.context() as fault:
        fault.setattr("skincal.following.setup_follower.check_setup", broken)
        with pytest.raises(RuntimeError, match="of the check"):
            follow(SETUP_CHECK_MIN_POKES)
    assert follower.sentences == ()
    follow(SETUP_CHECK_MIN_POKES + 2)
    assert "about its z axis" in follower.sentences[0]


def test_a_wrong_polarity_is_named_at_the_first_poke(rig, tmp_path):
    part, _ = rig
    wrong = replace(part.scene, skin=replace(part.scene.skin, polarity=1))
    pipeline = simulate_session(
        part.scene, part.surface, tmp_path / "s", 3, 1, RigErrors.noise(), settings=SLOW_DEVICES, seen_as=wrong
    )
    outcomes = [poke.outcome for poke in pipeline.snapshot().pokes]
    assert rejection_advice(outcomes[0]) == POLARITY_ADVICE
    assert "against the scene's polarity" in rejection_words(outcomes[0])


def test_a_press_that_turns_the_skin_the_other_way_is_named():
    """Later in a session: the channel that fell most is the one of the rejection."""
    response, limit = np.array([2.0, -40.0, np.nan, -80.0]), np.full(4, 10.0)
    assert _closest_to_limit(response, limit) == (-80.0, 10.0)
    assert _closest_to_limit(np.array([2.0, -9.0]), limit[:2]) == (2.0, 10.0)
    slip = Rejection(1, 0.0, 1.0, Reason.NO_TAXEL, -80.0, 10.0, "raw", np.empty(0, dtype=np.int64), True)
    assert rejection_advice(slip) == POLARITY_ADVICE
    assert rejection_advice(replace(slip, value=2.0)) != POLARITY_ADVICE


VISUAL = '<visual>\n      <origin xyz="{}688696737542175 0 -0.07955060152271212" rpy="0 0 0"/>\n      <geometry>\n        <mesh filename="package://iCub/meshes/simmechanics/2-5_plus/sim_sea_2-5_l_forearm_prt'
GAZEBO_SENSOR = 'name="l_arm_ft" type="force_torque">\n      <always_on>'
SENSOR = """<parent joint="l_arm_ft_sensor"/>
    <force_torque>
      <frame>{frame}</frame>
      <measure_direction>child_to_parent</measure_direction>
    </force_torque>
    <origin rpy="{rpy}" xyz="{xyz}"/>"""
"""Of the iCub's URDF."""
RIGHT = {
    "frame": "child",
    "rpy": "-4.3625653762663687e-16 -1.3089970069677406 -3.1415926535897922",
    "xyz": "0.05093014324520106 1.3877787807814457e-17 0.029175829465900395",
}
TURNED = {"frame": "sensor", "rpy": "0 0 1.5707963", "xyz": "0 0 0"}


def with_mesh_moved(folder, part):
    """The URDF has the mesh 100 mm along the forearm, and the layout was placed on that mesh."""
    edited("robot/model.urdf", (VISUAL.format("-0.29"), VISUAL.format("-0.19")))(folder, part)
    skin = {"layout_text": part.scene.skin.layout.text, "polarity": "down"}
    moved = PartDraft(urdf=folder / "robot/model.urdf", link=part.scene.link, sensor="l_arm_ft", **skin)
    there = PartPreviewer().preview(moved, {}).surface.vertices.mean(axis=0)
    out = folder / "moved/scene.toml"
    write_scene(moved, out, ANCHOR_MM + 1e3 * (there - part.surface.vertices.mean(axis=0)))
    return out


def edited(name, *changes):
    """Replace texts in a file of the scene."""

    def edit(folder, _):
        text = (folder / name).read_text()
        for before, after in changes:
            assert text.count(before) == 1
            text = text.replace(before, after)
        (folder / name).write_text(text)
        return folder / "scene.toml"

    return edit


SCENES = {
    "mesh origin": (with_mesh_moved, "mesh and layout must move by (", "correct the origin of the mesh"),
    "joint columns": (
        edited("scene.toml", ('"l_elbow", "l_wrist_prosup"', '"l_wrist_prosup", "l_elbow"')),
        "columns of l_wrist_prosup and l_elbow are exchanged", "exchange them",
    ),
    "sign": (edited("scene.toml", ("[contacts]", "[wrench]\nsign = -1\n[contacts]")), "reports the reaction force", "sign"),
    "sensor turned": (
        edited(
            "robot/model.urdf", (GAZEBO_SENSOR, GAZEBO_SENSOR.replace("l_arm_ft", "other")),
            (SENSOR.format(**RIGHT), SENSOR.format(**TURNED)),
        ),
        "turned by -90 degrees about its z axis", "origin in the URDF",
    ),
}  # fmt: skip
"""Mistakes in the files of a scene, with the words that name each and its remedy."""


@pytest.mark.parametrize(("edit", "what", "remedy"), SCENES.values(), ids=SCENES)
def test_solve_names_a_mistake_in_the_files_from_the_bytes_of_the_devices(rig, tmp_path, capsys, edit, what, remedy):
    part, _ = rig
    folder = tmp_path / "wrong"
    shutil.copytree(part.scene.path.parent, folder, ignore=shutil.ignore_patterns("s"))
    wrong = edit(folder, part)
    if "[robot.poses]" not in wrong.read_text():
        wrong.write_text(wrong.read_text() + POSES)
    simulate_session(
        part.scene, part.surface, tmp_path / "s", 12, 1, RigErrors.noise(), poses=("a", "b"),
        habits=Habits.careful().at_pace(4.0), settings=SLOW_DEVICES, seen_as=load_scene(wrong),
    )  # fmt: skip
    capsys.readouterr()
    assert main(["solve", str(tmp_path / "s")]) == 0
    said = capsys.readouterr().out
    assert what in said
    assert remedy in said


@pytest.mark.parametrize(
    ("name", "other"),
    [("l_arm_ft", "r_arm_ft"), ("Left_Wrist", "Right_Wrist"), ("ft_R", "ft_L"), ("left2right", "right2left"), ("elbow", "")],
)
def test_names_of_the_other_side(name, other):
    assert other_side(name) == other
