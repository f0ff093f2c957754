"""A sensor on the poking tool: a part that stays still, poked by hand-made readings, is found within its predicted errors.

The readings are made here, point by point: nothing of the simulator or of the fit is used. Each poke has its own pose of the
tool; the tool has a weight, which the sensor feels, and its poses come late and noisy.
"""

import binascii
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.following.review import ReviewRequest, diagnose_rig
from skincal.geometry import inverse_pose
from skincal.mesh.lay import place_layout
from skincal.mesh.load import load_surface
from skincal.model.actions import AtLandmark
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.model.scene import load_scene
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.setup_check import check_setup
from skincal.rig.tool_mistakes import find_part_motion
from skincal.session.corrections import offered
from skincal.session.pipeline import Pipeline
from skincal.session.skin_findings import session_skin_sentences
from skincal.session.tool_streams import check_tool_streams
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Method
from skincal.words.mistake_words import frame_sentence, setup_sentences
from skincal.words.poke_words import rejection_advice, rejection_words
from skincal.words.rig_words import rig_sentences

TAXELS = np.array([[x, y, 0.0] for y in (-0.01, 0.0, 0.01) for x in (-0.01, 0.0, 0.01)])
BASE_FROM_PART = np.eye(4)
BASE_FROM_PART[:3, :3] = Rotation.from_rotvec([0.3, -0.4, 1.1]).as_matrix()
BASE_FROM_PART[:3, 3] = [0.45, -0.2, 0.15]
TOOL_FROM_SENSOR = np.eye(4)
TOOL_FROM_SENSOR[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()
TOOL_FROM_SENSOR[:3, 3] = [0.0, 0.0, -0.03]
TIP = np.array([0.002, -0.001, 0.12])
BELOW = np.eye(4)
BELOW[:3, 3] = [0.0, 0.0, -0.05]
WEIGHT, CENTRE = np.array([0.0, 0.0, -2.5]), np.array([0.0, 0.0, 0.05])
OFFSET = np.array([3.0, -1.0, 12.0, 0.2, 0.1, -0.3])
HZ = 50
REST_S, RAMP_S, HOLD_S, MOVE_S = 0.66, 0.1, 0.42, 0.3
POKE_S = REST_S + 2 * RAMP_S + HOLD_S + REST_S + MOVE_S
STREAMS = {"wrench": Stream.WRENCH, "skin": Stream.SKIN, "tool": Stream.TOOL}
MESH = """solid plate
facet normal 0 0 1
outer loop
vertex -40 -40 0
vertex 40 -40 0
vertex 40 40 0
endloop
endfacet
facet normal 0 0 1
outer loop
vertex -40 -40 0
vertex 40 40 0
vertex -40 40 0
endloop
endfacet
endsolid plate
"""

LAYOUT = f"""[kinds.board]
pads_mm = {(TAXELS[:, :2] * 1e3).tolist()}
outline_mm = [[-15.0, -15.0], [15.0, -15.0], [15.0, 15.0], [-15.0, 15.0]]
centre_pad = 4
[[modules]]
id = 1
kind = "board"
first_channel = 0
place_mm = [0.0, 0.0]
"""
ANCHOR = """modules = "m.toml"
[skin.anchor]
at_mm = [0.0, 0.0]
point_mm = [0.0, 0.0, 0.0]
x = [1.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]
"""


@dataclass
class Imperfect:
    force_sd: float = 0.05
    moment_sd: float = 0.003
    place_sd: float = 0.00005
    turn_sd: float = 0.0002
    aim_sd: float = 0.0008
    delay_s: float = 0.02


EXACT = Imperfect(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def scene_text(part):
    rows = np.round(BASE_FROM_PART, 12).tolist(), np.round(TOOL_FROM_SENSOR, 12).tolist()
    sensor = (
        f"[sensor]\npose = {BELOW.tolist()}\n" if part == "below" else '[tool]\nsensor = "tool"\nflange = ' + f"{rows[1]}\n"
    )
    known = f"base_from_link = {rows[0]}\n[surface]\nmesh = 'plate.stl'\nunit = 'mm'\n" if part == "known" else ""
    mesh = "[surface]\nmesh = 'plate.stl'\nunit = 'mm'\n" if part == "below" else ""
    link = "base" if part == "unknown" else "plate"
    return f'name = "plate"\nlink = "{link}"\n[skin]\nchannels = 9\n{sensor}{known}{mesh}[noise]\nradius = 1.0\n'


def scene_of(folder, part="known", change=str):
    (folder / "plate.stl").write_text(MESH)
    (folder / "scene.toml").write_text(change(scene_text(part)))
    return load_scene(folder / "scene.toml")


def load_at(times):
    """Share of the force at each time of a poke, and of the way to the next one."""
    t = np.asarray(times)
    share = np.clip(np.minimum((t - REST_S) / RAMP_S, (REST_S + 2 * RAMP_S + HOLD_S - t) / RAMP_S), 0.0, 1.0)
    return share, np.clip((t - (POKE_S - MOVE_S)) / MOVE_S, 0.0, 1.0)


def line(letter, number, time_s, values):
    # The status of a wrench is a whole number.
    text = f"{letter},{number & 0xFFFF},{round(time_s * 1e6)},{','.join(f'{v:.9f}' for v in values)}".encode().removesuffix(
        b".000000000"
    )
    return text + b"*%04X\n" % binascii.crc_hqx(text, 0xFFFF)


def pokes(per_taxel, rng, errors):
    """Contact, push and twist of the tool of each poke, in the part's frame."""
    for _ in range(per_taxel):
        for taxel in TAXELS:
            lean, azimuth = rng.uniform(0.1, 0.6), rng.uniform(-np.pi, np.pi)
            push = np.array([np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), -np.cos(lean)])
            yield taxel + np.append(errors.aim_sd * rng.standard_normal(2), 0.0), push, rng.uniform(-1.5, 1.5)


def tool_pose(contact, push, twist):
    """Place the tool in the base: its z axis along the push, its tip at the contact."""
    side = np.cross(push, [0.36, 0.48, 0.8])
    side /= np.linalg.norm(side)
    turn = BASE_FROM_PART[:3, :3] @ np.column_stack([side, np.cross(push, side), push])
    turn = turn @ Rotation.from_rotvec([0, 0, twist]).as_matrix()
    return turn, BASE_FROM_PART[:3, :3] @ contact + BASE_FROM_PART[:3, 3] - turn @ TIP


def readings(per_taxel, seed, errors, *, on_tool):
    """Yield stream, time and values of each reading."""
    rng = np.random.default_rng(seed)
    planned = list(pokes(per_taxel, rng, errors))
    poses = [tool_pose(*each) for each in planned]
    for number, (contact, push, _) in enumerate(planned):
        turn, place = poses[number]
        next_turn, next_place = poses[min(number + 1, len(poses) - 1)]
        way = Rotation.from_matrix(next_turn @ turn.T).as_rotvec()
        begin = 1.0 + number * POKE_S

        def at(times, begin=begin, turn=turn, place=place, next_place=next_place, way=way):
            share, moved = load_at(times - begin)
            turns = Rotation.from_rotvec(moved[:, None] * way).as_matrix() @ turn
            return share, turns, place + moved[:, None] * (next_place - place)

        times = begin + np.arange(0, POKE_S, 1 / HZ)
        share, turns, _ = at(times)
        near = np.exp(-np.sum((TAXELS - contact) ** 2, axis=1) / (2 * 0.004**2))
        frames = np.round(20 + 150 * share[:, None] * np.where(near > 0.2, near, 0.0))
        force = 8.0 * share[:, None] * push
        if on_tool:
            axes = (turns @ TOOL_FROM_SENSOR[:3, :3]).transpose(0, 2, 1)
            felt = np.einsum("nij,nj->ni", axes, -force @ BASE_FROM_PART[:3, :3].T)
            lever, weight = TOOL_FROM_SENSOR[:3, :3].T @ (TIP - TOOL_FROM_SENSOR[:3, 3]), axes @ WEIGHT
            wrenches = np.concatenate([felt + weight, np.cross(lever, felt) + np.cross(CENTRE, weight)], axis=1)
        else:
            wrenches = np.concatenate([force, np.cross(contact - BELOW[:3, 3], force)], axis=1)
        wrenches += OFFSET + np.repeat([errors.force_sd, errors.moment_sd], 3) * rng.standard_normal((len(times), 6))
        _, turns, places = at(times - errors.delay_s)
        shaken = Rotation.from_rotvec(errors.turn_sd * rng.standard_normal((len(times), 3))) * Rotation.from_matrix(turns)
        poses_sent = np.concatenate([places + errors.place_sd * rng.standard_normal((len(times), 3)), shaken.as_quat()], axis=1)
        for t, wrench, frame, pose in zip(times, wrenches, frames, poses_sent, strict=True):
            yield from (("tool", t, pose), ("wrench", t, wrench), ("skin", t, frame))[0 if on_tool else 1 :]


def chunks(per_taxel, seed, errors=None, *, on_tool=True, change=None, until_s=1e9):
    letter, number = {"wrench": "F", "skin": "T", "tool": "P"}, dict.fromkeys(STREAMS, 0)
    for name, t, given in readings(per_taxel, seed, errors or Imperfect(), on_tool=on_tool):
        if t > until_s:
            break
        values = given if change is None else change(name, t, given)
        if values is not None:
            number[name] += 1
            sent = (*values, 0.0) if name == "wrench" else values
            text = sent if isinstance(sent, bytes) else line(letter[name], number[name], t, sent)
            yield Chunk(name, round(t * 1e9), text)


def calibrate(scene, items, names=("wrench", "skin", "tool"), *, ends=True):
    surface = None if scene.surface is None else load_surface(scene.surface)[0]
    pipeline = Pipeline(scene, [LinkSpec(name, f"simulated:{name}", (STREAMS[name],)) for name in names], surface)
    for name in names:
        pipeline.feed(LinkEvent(name, 1, LinkState.OPEN))
    pipeline.feed_many(list(items))
    if ends:
        pipeline.close()
    return pipeline


def found_by(pipeline, method):
    estimates = pipeline.snapshot().estimates[method]
    return np.array([each.position for each in estimates]), np.array([each.covariance for each in estimates])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return calibrate(scene_of(tmp_path_factory.mktemp("tool")), chunks(3, 1))


def outcomes_of(pipeline):
    return [record.outcome for record in pipeline.snapshot().pokes]


def test_each_poke_on_a_still_part_counts(recorded):
    outcomes = outcomes_of(recorded)
    assert len(outcomes) == 27
    assert [rejection_words(each) for each in outcomes if isinstance(each, Rejection)] == []
    assert {each.pose for each in outcomes} == {"tool"}


@pytest.mark.parametrize("method", [Method.FREE, Method.SURFACE])
def test_the_taxels_are_found_within_their_predicted_errors(recorded, method):
    positions, covariances = found_by(recorded, method)
    off = positions - TAXELS
    squares = [each @ np.linalg.pinv(cov) @ each for each, cov in zip(off, covariances, strict=True)]
    assert np.linalg.norm(off, axis=1).mean() < 0.0015
    assert np.median(squares) < 7.8


def test_the_same_pokes_give_the_same_taxels_with_the_sensor_on_either_side(tmp_path):
    on_tool = calibrate(scene_of(tmp_path), chunks(2, 2, EXACT))
    below = calibrate(scene_of(tmp_path, "below"), chunks(2, 2, EXACT, on_tool=False), ("wrench", "skin"))
    for method in (Method.FREE, Method.SURFACE):
        positions = [found_by(each, method)[0] for each in (on_tool, below)]
        np.testing.assert_allclose(positions[0], TAXELS, atol=2e-6)
        np.testing.assert_allclose(positions[0], positions[1], atol=2e-6)


def test_without_the_parts_pose_the_taxels_are_in_the_base(tmp_path):
    scene = scene_of(tmp_path, "unknown")
    positions, _ = found_by(calibrate(scene, chunks(2, 2, EXACT)), Method.FREE)
    np.testing.assert_allclose(positions, TAXELS @ BASE_FROM_PART[:3, :3].T + BASE_FROM_PART[:3, 3], atol=2e-6)


def first_pokes(folder, count, change=None, scene_change=str):
    """Poke the part `count` times; `change(name, seconds since the first press, values)` changes or drops readings."""
    scene = scene_of(folder, change=scene_change)
    begin = 1.0 + REST_S
    items = chunks(
        1, 5, EXACT, change=change and (lambda name, t, values: change(name, t - begin, values)), until_s=1.0 + count * POKE_S
    )
    pipeline = calibrate(scene, items)
    (health,) = (link for link in pipeline.live(0).links if link.link == "tool")
    return outcomes_of(pipeline), health


def test_lost_and_mirrored_poses_are_dropped_and_counted(tmp_path):
    def spoil(name, since_s, values):
        if name != "tool" or not 0.2 < since_s < 0.29:
            return values
        return np.append(values[:3], np.zeros(4)) if since_s < 0.25 else np.append(np.nan, values[1:])

    outcomes, health = first_pokes(tmp_path, 1, spoil)
    assert isinstance(outcomes[0], Contact)
    assert health.losses[Loss.NO_POSE] + health.losses[Loss.NOT_A_NUMBER] in (4, 5)
    assert min(health.losses[Loss.NO_POSE], health.losses[Loss.NOT_A_NUMBER]) >= 2
    assert "not of length 1" in health.text


def test_a_poke_whose_poses_come_late_is_rejected_with_their_age(tmp_path):
    outcomes, _ = first_pokes(tmp_path, 2, lambda name, t, values: None if name == "tool" and -0.3 < t < 0.7 else values)
    assert isinstance(outcomes[1], Contact)
    assert outcomes[0].reason is Reason.NO_POSE
    words = rejection_words(outcomes[0])
    assert words.startswith("tool pose unknown: its last pose is 0.")
    assert words.endswith("s old (limit 0.10 s)")


def test_a_poke_with_a_tool_that_turns_is_rejected(tmp_path):
    def turn(name, since_s, values):
        if name != "tool" or not 0.25 < since_s < 0.5:
            return values
        return np.append(values[:3], (Rotation.from_rotvec([0.0, 0.04, 0.0]) * Rotation.from_quat(values[3:])).as_quat())

    outcomes, _ = first_pokes(tmp_path, 1, turn)
    assert outcomes[0].reason is Reason.ARM_MOVED
    assert rejection_words(outcomes[0]).startswith("tool turned: 2")
    assert "Turn the tool first" in rejection_advice(outcomes[0])


def test_a_tip_that_slides_is_seen_by_the_tools_poses(tmp_path):
    def slide(name, since_s, values):
        on_its_way = np.clip((since_s - 0.1) / 0.42, 0.0, 1.0)
        return values + np.append([0.006 * on_its_way, 0.004 * on_its_way], np.zeros(5)) if name == "tool" else values

    outcomes, _ = first_pokes(tmp_path, 1, slide)
    assert outcomes[0].reason is Reason.SLID


def as_line(_, values, name="tool"):
    return " ".join(f"{v:.6f}" for v in values).encode() + b"\n" if name == "tool" else values


def in_degrees(name, _, values):
    """Write a pose as many robots do: millimetres, roll, pitch and yaw in degrees."""
    if name != "tool":
        return values
    angles = Rotation.from_quat(values[3:]).as_euler("xyz", degrees=True)
    return as_line(name, np.concatenate([values[:3] * 1e3, angles]))


def test_plain_lines_are_read_in_the_form_that_the_scene_names(tmp_path):
    form = 'rotation = "rpy"\nunit = "mm"\ndegrees = true\n'
    outcomes, health = first_pokes(tmp_path, 2, in_degrees, lambda text: text.replace("flange", form + "flange"))
    by_records, _ = first_pokes(tmp_path, 2)
    assert [type(each) for each in outcomes] == [Contact, Contact]
    assert health.losses[Loss.NO_POSE] == 0
    for one, other in zip(outcomes, by_records, strict=True):
        np.testing.assert_allclose(one.link_from_sensor, other.link_from_sensor, atol=2e-6)


def test_plain_lines_without_a_form_ask_for_it(tmp_path):
    outcomes, health = first_pokes(tmp_path, 1, in_degrees)
    assert not any(isinstance(each, Contact) for each in outcomes)
    assert health.losses[Loss.NO_POSE] > 50
    assert "set rotation and unit in [tool] of the scene" in health.text


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("[tool]", "[sensor]\n[tool]"), r"\[tool\] excludes \[arm\] and \[sensor\]"),
        (lambda text: text.replace('"tool"', '"flange"'), "sensor is 'flange'; expected one of tool"),
        (lambda text: text.replace("base_from_link", "rotation = 'rpy'\nunit = 'm'\nbase_from_link"), "degrees is missing"),
        (lambda text: text.replace("base_from_link", "unit = 'm'\nbase_from_link"), "rotation is missing"),
        (
            lambda text: text.replace("base_from_link", "rotation = 'vector'\nbase_from_link"),
            r"\[tool\]: unit is missing; expected one of [a-z, ]*; degrees is missing; expected true or false for .* vector",
        ),
        (
            lambda text: text.replace("base_from_link", "rotation = 'xyzw'\nbase_from_link"),
            r"\[tool\]: unit is missing; expected one of [a-z, ]*\.$",
        ),
        (
            lambda text: text.replace("base_from_link", "degrees = true\nbase_from_link"),
            r"rotation is missing; expected one of .*; unit is missing; expected one of [a-z, ]*\.$",
        ),
        (lambda text: text.replace("base_from_link", "tolerance_deg = 0\nbase_from_link"), "expected a number above 0"),
        (
            lambda text: "\n".join(s for s in text.splitlines() if "base_from" not in s).replace(
                'link = "plate"', 'link = "base"'
            ),
            r"\[surface\] lies in the part's frame; expected the name of that frame as link",
        ),
    ],
)
def test_a_scene_with_a_wrong_tool_is_refused(tmp_path, change, says):
    with pytest.raises(InputError, match=says):
        scene_of(tmp_path, change=change)


def test_without_the_parts_pose_the_link_must_be_the_base(tmp_path):
    with pytest.raises(InputError, match="expected link = \"base\", not 'plate'"):
        scene_of(tmp_path, "unknown", lambda text: text.replace('"base"', '"plate"'))


def test_streams_must_fit_where_the_sensor_sits(tmp_path):
    tool, below = scene_of(tmp_path), scene_of(tmp_path, "below")
    check_tool_streams(tool, {Stream.TOOL: "a"})
    check_tool_streams(below, {Stream.TIP: "a"})
    with pytest.raises(InputError, match="field Tool, or --tool"):
        check_tool_streams(tool, {Stream.TOOL: None})
    with pytest.raises(InputError, match="leave out --joints"):
        check_tool_streams(tool, {Stream.TOOL: "a", Stream.JOINTS: "b"})
    with pytest.raises(InputError, match=r"plate has no \[tool\]"):
        check_tool_streams(below, {Stream.TOOL: "a"})


def test_a_known_tip_places_a_taxel_along_the_push(tmp_path):
    scene = scene_of(
        tmp_path, change=lambda text: text.replace("base_from_link", f"tip_mm = {(TIP * 1e3).tolist()}\nbase_from_link")
    )
    outcome = outcomes_of(calibrate(scene, chunks(1, 5, EXACT, until_s=1.0 + POKE_S)))[0]
    np.testing.assert_allclose(outcome.tip, TAXELS[0], atol=2e-6)


def test_metres_that_are_read_as_millimetres_are_no_poses(tmp_path):
    form = 'rotation = "xyzw"\nunit = "mm"\n'
    outcomes, health = first_pokes(tmp_path, 1, as_line_of, lambda text: text.replace("flange", form + "flange"))
    assert not any(isinstance(each, Contact) for each in outcomes)
    assert health.losses[Loss.NO_POSE] > 50
    assert "within 5 mm of the origin; check the unit" in health.text


def as_line_of(name, _, values):
    return as_line(name, values, name)


def test_a_pose_near_the_origin_counts_once_the_tool_was_away_from_it(tmp_path):
    def move(name, since_s, values):
        return values if name != "tool" or since_s < -0.5 else np.append(np.zeros(3), values[3:])

    outcomes, health = first_pokes(tmp_path, 1, move)
    assert isinstance(outcomes[0], Contact)
    assert health.losses[Loss.NO_POSE] == 0


def test_a_stream_that_repeats_one_pose_is_named(recorded):
    snapshot, first = recorded.snapshot(), outcomes_of(recorded)[0]
    condition = recorded.totals().skin
    assert not any("repeats one pose" in each for each in session_skin_sentences(snapshot, condition, recorded.scene))
    pokes = [
        replace(each, outcome=replace(each.outcome, link_from_sensor=first.link_from_sensor)) for each in snapshot.pokes[:5]
    ]
    said = session_skin_sentences(replace(snapshot, pokes=tuple(pokes)), condition, recorded.scene)
    assert said[-1].startswith("tool: 5 pokes on 5 taxels have the same pose of the tool")


def exchanged(pose):
    """Write a pose's quaternion scalar first, and read it scalar last."""
    read = pose.copy()
    read[:3, :3] = Rotation.from_quat(Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)).as_matrix()
    return read


def shaken(pose):
    read = pose.copy()
    read[:3, 3] = 0.3 * np.sin(1e4 * pose[:3, 3])
    return read


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda pose: pose, None),
        (inverse_pose, "the poses of the tool are inverse"),
        (lambda pose: np.diag([-1.0, -1.0, 1.0, 1.0]) @ pose, "turned by half a turn about its z axis"),
        (exchanged, "the rotation of the tool's poses is a quaternion w x y z"),
        (shaken, "no known mistake explains it. Make the fixed-point test"),
    ],
)
def test_wrong_poses_of_the_tool_are_named(recorded, tmp_path, wrong, says):
    (tmp_path / "m.toml").write_text(LAYOUT)
    scene = scene_of(tmp_path, change=lambda text: text.replace("channels = 9\n", "channels = 9\n" + ANCHOR))
    into_base, into_tool = BASE_FROM_PART, inverse_pose(TOOL_FROM_SENSOR)
    contacts = [
        replace(
            each,
            link_from_sensor=inverse_pose(into_base) @ wrong(into_base @ each.link_from_sensor @ into_tool) @ TOOL_FROM_SENSOR,
        )
        for each in outcomes_of(recorded)
    ]
    assert_named(contacts, scene, says)


def assert_named(contacts, scene, says):
    surface = load_surface(scene.surface)[0]
    laid = place_layout(scene.skin.layout, scene.skin.anchor, surface)
    said = setup_sentences(check_setup(contacts, scene, laid, surface))
    assert (said == ()) if says is None else (says in said[0])


def test_a_wrench_with_the_axes_of_the_base_is_named(recorded, tmp_path):
    (tmp_path / "m.toml").write_text(LAYOUT)
    scene = scene_of(tmp_path, change=lambda text: text.replace("channels = 9\n", "channels = 9\n" + ANCHOR))
    contacts = []
    for each in outcomes_of(recorded):
        turn = BASE_FROM_PART[:3, :3] @ each.link_from_sensor[:3, :3]
        contacts.append(replace(each, force=turn @ each.force, moment=turn @ each.moment))
    assert_named(contacts, scene, "the wrench has the axes of the base")


def moved(shift):
    motion = np.eye(4)
    motion[:3, 3] = shift
    return motion


def test_landmarks_tell_a_wrong_pose_of_the_part_from_a_wrong_sensor(recorded):
    def found(change):
        contacts = [replace(each, link_from_sensor=change(each.link_from_sensor)) for each in outcomes_of(recorded)]
        places = [TAXELS[each.strongest_channel] for each in contacts]
        return find_part_motion(LandmarkPokes.at(Pokes.collect(contacts), [""] * len(places), places))

    assert found(lambda pose: pose) is None
    by_part = found(lambda pose: moved([0.02, 0.0, 0.0]) @ pose)
    np.testing.assert_allclose(by_part.motion[:3, 3], [0.02, 0.0, 0.0], atol=0.002)
    assert by_part.miss < 0.0015
    by_sensor = found(lambda pose: pose @ moved([0.02, 0.0, 0.0]))
    assert by_sensor is None or by_sensor.miss > 0.01


def test_a_wrong_pose_of_the_part_is_named_and_no_correction_of_the_sensor_offered(tmp_path):
    wrong = BASE_FROM_PART @ moved([0.02, 0.0, 0.0])
    right = f"base_from_link = {np.round(BASE_FROM_PART, 12).tolist()}"
    corners = (0, 2, 6, 8)
    known = "".join(f'[[landmarks]]\nname = "{at}"\nplace = {TAXELS[at].tolist()}\n' for at in corners)
    scene = scene_of(
        tmp_path, change=lambda text: text.replace(right, f"base_from_link = {np.round(wrong, 12).tolist()}") + known
    )
    pipeline = calibrate(scene, chunks(2, 3))
    for row, outcome in enumerate(outcomes_of(pipeline)):
        if row % len(TAXELS) in corners:
            pipeline.act(AtLandmark(outcome.poke, str(row % len(TAXELS))), 0)
    frame, rig = diagnose_rig(ReviewRequest.from_session(pipeline.session))
    said = frame_sentence(frame, has_arm=True)
    assert said.startswith("The part is not where the scene says: it must move by (-")
    np.testing.assert_allclose(frame.mistake.shift, [-0.02, 0.0, 0.0], atol=0.002)
    assert said.endswith("Correct base_from_link of [tool].")
    assert offered(frame, rig, 8, {}) is None
    assert not (rig.after < 0.5 * rig.before and "would be offered" in rig_sentences(rig, has_arm=True)[0])


@pytest.mark.parametrize("radius_mm", [0.0, 4.0])
def test_the_axis_of_a_press_in_progress_passes_the_contact_as_that_of_the_finished_poke(tmp_path, radius_mm):
    tip = f"tip_mm = {(TIP * 1e3).tolist()}\ntip_radius_mm = {radius_mm}\nbase_from_link"
    scene = scene_of(tmp_path, change=lambda text: text.replace("base_from_link", tip))
    # A moment of the sensor that is wrong by 40 N mm moves the axis by 5 mm.
    crossed = np.array([0.0, 0.0, 0.0, 0.04, 0.0, 0.0])
    in_press = (1.0 + REST_S + RAMP_S, 1.0 + REST_S + RAMP_S + 0.5 * HOLD_S)

    def disturb(name, t, values):
        return values + crossed if name == "wrench" and in_press[0] < t else values

    pipeline = calibrate(scene, chunks(1, 3, change=disturb, until_s=in_press[1]), ends=False)
    live = pipeline.live(0)
    force = live.progress.force
    assert np.linalg.norm(force) > 4.0
    centre = live.link_from_sensor[:3] @ np.append(scene.tool.tip_in_sensor, 1.0)
    # A leaning ball touches the plate with its lowest point.
    contact = centre - np.array([0.0, 0.0, 1e-3 * radius_mm])
    np.testing.assert_allclose(live.progress.axis_point, contact, atol=1e-9)
    assert np.linalg.norm(np.cross([0.0, 0.0, 1.0], force / np.linalg.norm(force))) > 0.02, "the push leans"
