"""A tool without any force sensor: pokes are the places of its tip, made here point by point and sent as records.

Nothing of the simulator or of the fit is used. The ball touches the part at its own radius; the tool comes along its push,
rests, and goes back.
"""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.cli.output import poke_counts, poke_lines
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.contacts.touch_detector import RestWatch, _Seen
from skincal.following.results import SessionResults
from skincal.guide.verdict import Check, is_believed
from skincal.journal.writer import create_session
from skincal.mesh.load import load_surface
from skincal.model.actions import AskLandmark, AtLandmark, DroveToLandmark, FoundAtLandmark, MissedLandmark
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Stream
from skincal.model.scene import Landmark, load_scene
from skincal.rig.part_pose import PartPoseState
from skincal.session.importing import unnamed_landmarks
from skincal.session.landmark_pokes import LandmarkFinder, misses_of_landmarks, nearest_landmarks
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.session.tool_streams import check_tool_streams
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Method
from skincal.words.mistake_words import setup_sentences
from skincal.words.outcome_words import outcome_headline
from skincal.words.part_words import tip_shift_sentence
from skincal.words.poke_words import rejection_advice, rejection_words, short_rejection
from skincal.words.tool_words import tool_findings
from skincal.words.units import ChannelNames
from skincal.words.verdict_words import figures, verdict_sentence
from tests.skincal.session.test_tool_rig import ANCHOR, BASE_FROM_PART, LAYOUT, MESH, STREAMS, TAXELS, TIP, line

RADIUS, ABOVE = 0.002, 0.03
OUT = np.array([0.0, 0.0, RADIUS])
MARKS = np.array([[-0.035, -0.035, 0.0], [0.035, -0.03, 0.0], [0.03, 0.035, 0.0], [-0.03, 0.03, 0.0]])
HZ = 50
PAUSE_S, WAY_S, HOLD_S, MOVE_S = 0.66, 0.3, 0.5, 0.4
POKE_S = PAUSE_S + 2 * WAY_S + HOLD_S + 0.3 + MOVE_S


def scene_text(more="", landmarks=True):
    marks = "".join(f'[[landmarks]]\nname = "m{row}"\nplace = {place.tolist()}\n' for row, place in enumerate(MARKS))
    return (
        'name = "plate"\nlink = "plate"\n[skin]\nchannels = 9\n'
        f'[tool]\nsensor = "none"\ntip_mm = {(TIP * 1e3).tolist()}\ntip_radius_mm = {RADIUS * 1e3}\ntip_sd_mm = 0.2\n{more}'
        "[surface]\nmesh = 'plate.stl'\nunit = 'mm'\n[noise]\nradius = 1.0\n" + (marks if landmarks else "")
    )


def scene_of(folder, text):
    (folder / "plate.stl").write_text(MESH)
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def pushes(rng, count):
    lean, around = rng.uniform(0.05, 0.4, count), rng.uniform(-np.pi, np.pi, count)
    return np.stack([np.sin(lean) * np.cos(around), np.sin(lean) * np.sin(around), -np.cos(lean)], axis=1)


def heights(times, hold_s=HOLD_S):
    """Share of `ABOVE`, and share of the way to the next place."""
    down = np.clip((times - PAUSE_S) / WAY_S, 0.0, 1.0)
    up = np.clip((times - PAUSE_S - WAY_S - hold_s) / WAY_S, 0.0, 1.0)
    return 1.0 - down + up, np.clip((times - (POKE_S - HOLD_S + hold_s - MOVE_S)) / MOVE_S, 0.0, 1.0)


def readings(contacts, seed=1, noise=0.0001, aim_sd=0.0008, slide=None, hold_s=HOLD_S):
    """Yield stream, time and values of pokes at contacts (n, 3) of the part; `slide` moves the tip while it holds."""
    poke_s = POKE_S - HOLD_S + hold_s
    rng = np.random.default_rng(seed)
    ways = pushes(rng, len(contacts))
    contacts = contacts + np.append(aim_sd, [aim_sd, 0.0]) * rng.standard_normal(contacts.shape)
    spins = rng.uniform(-1.5, 1.5, len(contacts))
    for number, (contact, push) in enumerate(zip(contacts, ways, strict=True)):
        side = np.cross(push, [0.36, 0.48, 0.8])
        side /= np.linalg.norm(side)
        turn = np.column_stack([side, np.cross(push, side), push]) @ Rotation.from_rotvec([0, 0, spins[number]]).as_matrix()
        turn = BASE_FROM_PART[:3, :3] @ turn
        # The ball touches the plate with its own lowest point.
        centre = contact + OUT
        following = min(number + 1, len(contacts) - 1)
        away = contacts[following] + OUT - ABOVE * ways[following] - (centre - ABOVE * push)
        times = np.arange(0, poke_s, 1 / HZ)
        height, moved = heights(times, hold_s)
        near = np.exp(-np.sum((TAXELS - contact) ** 2, axis=1) / (2 * 0.004**2))
        near, quaternion, tip = np.where(near > 0.2, near, 0.0), Rotation.from_matrix(turn).as_quat(), turn @ TIP
        for t, high, share in zip(times, height, moved, strict=True):
            place = centre - high * ABOVE * push + share * away
            if slide is not None and PAUSE_S + WAY_S < t < PAUSE_S + WAY_S + hold_s:
                place = place + np.array(slide) * (t - PAUSE_S - WAY_S) / hold_s
            place = BASE_FROM_PART[:3, :3] @ place + BASE_FROM_PART[:3, 3] + noise * rng.standard_normal(3)
            pressed = np.clip(1.0 - high / 0.05, 0.0, 1.0)
            at = 1.0 + number * poke_s + t
            yield "tool", at, np.concatenate([place - tip, quaternion])
            yield "skin", at, np.round(20 + 150 * pressed * near + rng.normal(0.0, 0.4, len(TAXELS)))


def chunks(contacts, **more):
    number = {"skin": 0, "tool": 0}
    for name, t, values in readings(contacts, **more):
        number[name] += 1
        yield Chunk(name, round(t * 1e9), line({"skin": "T", "tool": "P"}[name], number[name], t, values))


def pipeline_of(scene):
    surface = None if scene.surface is None else load_surface(scene.surface)[0]
    names = ("skin", "tool")
    pipeline = Pipeline(scene, [LinkSpec(name, f"simulated:{name}", (STREAMS[name],)) for name in names], surface)
    for name in names:
        pipeline.feed(LinkEvent(name, 1, LinkState.OPEN))
    return pipeline


def calibrate(scene, items):
    pipeline = pipeline_of(scene)
    pipeline.feed_many(list(items))
    pipeline.close()
    return pipeline


def outcomes_of(pipeline):
    return [record.outcome for record in pipeline.snapshot().pokes]


EVERY = np.concatenate([MARKS, np.repeat(TAXELS, 2, axis=0)])


@cache
def on_taxels():
    """Two touches of each taxel."""
    return tuple(chunks(EVERY[4:]))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    pipeline = calibrate(scene_of(tmp_path_factory.mktemp("none"), scene_text()), chunks(EVERY))
    for row in range(len(MARKS)):
        pipeline.act(AtLandmark(row + 1, f"m{row}"), 0)
    return pipeline


def test_a_leaning_ball_touches_below_its_middle_not_along_the_push(recorded):
    snapshot = recorded.snapshot()
    rng = np.random.default_rng(1)
    pushes(rng, len(EVERY))
    true = (EVERY + np.append(0.0008, [0.0008, 0.0]) * rng.standard_normal(EVERY.shape))[len(MARKS) :]
    tips = np.array([contact.tip for contact in snapshot.contacts])
    # What all share is the error of the part's pose: 2 mm of the ball at 3 to 23 degrees are 0.1 to 0.8 mm along the push.
    off = tips - true
    assert np.abs(off - off.mean(axis=0)).max() < 0.0004
    for contact in snapshot.contacts:
        turn, origin = contact.link_from_sensor[:3, :3], contact.link_from_sensor[:3, 3]
        force, moment = turn @ contact.force, turn @ contact.moment
        np.testing.assert_allclose(moment, np.cross(contact.tip - origin, force), atol=1e-12)


def test_each_touch_is_a_poke_at_the_contact_of_the_ball(recorded):
    outcomes = outcomes_of(recorded)
    assert [type(each) for each in outcomes] == [Rejection] * 4 + [Contact] * 18
    assert {each.reason for each in outcomes[:4]} == {Reason.NO_TAXEL}
    for outcome, at in zip(outcomes[4:], EVERY[4:], strict=True):
        # 0.8 mm of aim, and 2 mm x sin(lean) of the ball.
        assert np.linalg.norm(outcome.tip - at) < 0.004
        assert outcome.strongest_channel == int(np.argmin(np.linalg.norm(TAXELS - at, axis=1)))


def test_landmarks_and_mesh_place_the_part_and_taxels_are_within_their_errors(recorded):
    snapshot = recorded.snapshot()
    assert snapshot.part_pose.state is PartPoseState.KNOWN
    assert snapshot.part_pose.landmarks == 4
    off = snapshot.part_pose.base_from_link @ np.linalg.inv(BASE_FROM_PART)
    assert np.linalg.norm(off[:3] @ np.append(BASE_FROM_PART[:3, 3], 1.0) - BASE_FROM_PART[:3, 3]) < 0.0015
    for method in (Method.FREE, Method.SURFACE):
        estimates = snapshot.estimates[method]
        errors = np.array([each.position for each in estimates]) - TAXELS
        squares = [x @ np.linalg.pinv(e.covariance) @ x for x, e in zip(errors, estimates, strict=True)]
        assert np.linalg.norm(errors, axis=1).mean() < 0.0018
        # The hand aims to 0.8 mm here, and the scene counts 1.5 mm.
        assert 0.1 < np.median(squares) < 7.8


def test_a_landmark_far_below_the_touch_is_not_found_by_the_line_of_the_push(recorded):
    session = recorded.session
    below = Landmark("below", MARKS[0] + [0.0, 0.0, -0.05], None)
    (outcome,) = session.frame_corrected([1])
    by_axis = nearest_landmarks([outcome], [below], None)
    assert by_axis[1].sure, "its axis passes it within 20 mm"
    by_tip = nearest_landmarks([outcome], [below], None, session.contact_of)
    assert not by_tip[1].sure
    assert by_tip[1].miss == pytest.approx(0.05, abs=0.005)
    found = nearest_landmarks([outcome], [*session.decisions.landmarks, below], None, session.contact_of)[1]
    assert (found.name, found.sure) == ("m0", True)
    assert found.miss < 0.004


def test_a_requested_landmark_far_below_the_touch_is_missed_although_the_line_of_the_push_passes_it(recorded):
    session = recorded.session
    below = Landmark("below", MARKS[0] + [0.0, 0.0, -0.05], None)

    def found(**measured):
        finder = LandmarkFinder(dict, None, **measured)
        finder.ask("below", 0.0)
        marks = [*session.decisions.landmarks, below]
        outcomes, noise = session.frame_corrected([1]), session.scene.noise
        (action,) = finder.find_landmark_pokes(outcomes, session.landmark_pokes, marks, (), (), noise)
        return action

    assert isinstance(found(), FoundAtLandmark), "by the line alone"
    missed = found(contact_at=session.contact_at)
    assert isinstance(missed, MissedLandmark)
    assert missed.miss == pytest.approx(0.05, abs=0.003)


def test_misses_at_landmarks_are_those_of_the_touched_points(recorded):
    rng = np.random.default_rng(1)
    pushes(rng, len(EVERY))
    true = (0.0008 * rng.standard_normal(EVERY.shape))[: len(MARKS), :2]
    pokes = recorded.session.landmark_pokes
    misses = misses_of_landmarks(pokes, recorded.session.contact_at)
    # The pose of the part follows from these touches, so it takes some of their errors.
    assert np.abs(misses - np.linalg.norm(true, axis=1)).max() < 0.001
    centres = misses_of_landmarks(pokes, lambda poke: recorded.session.contact_at(poke) + OUT)
    assert (centres > misses).all()
    assert misses_of_landmarks(pokes, lambda _: None).tolist() == pokes.landmark_miss.tolist()


def test_the_live_tool_and_press_are_in_the_frame_of_the_part_once_it_is_known(recorded):
    part = recorded.snapshot().part_pose
    _, in_base = recorded.poses.current
    live = recorded.live(0)
    shift = np.eye(4)
    shift[:3, 3] = part.tip_shift
    assert live.link_from_sensor == pytest.approx(part.link_from_base @ in_base @ shift, abs=1e-12)
    assert np.linalg.norm(live.link_from_sensor[:3, 3]) < 0.2 < np.linalg.norm(in_base[:3, 3]), "near the part"


def test_one_poke_places_a_taxel_of_a_part_without_mesh_in_the_base(tmp_path):
    text = (
        scene_text(landmarks=False)
        .replace('link = "plate"', 'link = "base"')
        .replace("[surface]\nmesh = 'plate.stl'\nunit = 'mm'\n", "")
    )
    snapshot = calibrate(scene_of(tmp_path, text), chunks(TAXELS[:3], aim_sd=0.0, noise=0.0)).snapshot()
    places = TAXELS @ BASE_FROM_PART[:3, :3].T + BASE_FROM_PART[:3, 3]
    for channel in range(3):
        estimate = snapshot.estimate_of(channel, Method.FREE)
        assert np.linalg.norm(estimate.position - places[channel]) < 0.0015
        assert estimate.rms < 0.006


def test_a_tip_that_moves_while_it_presses_is_rejected_with_its_way(tmp_path):
    pipeline = calibrate(scene_of(tmp_path, scene_text()), chunks(TAXELS[4:5], slide=[0.004, 0.003, 0.0], aim_sd=0.0))
    (outcome,) = outcomes_of(pipeline)
    assert outcome.reason is Reason.SLID
    assert rejection_words(outcome).startswith("tip moved ")
    assert rejection_words(outcome).endswith("mm (limit 1.50 mm)")
    assert "hold the tip still" in rejection_advice(outcome)


def test_a_requested_landmark_is_found_by_the_tip_that_turns_back(tmp_path):
    pipeline = pipeline_of(scene_of(tmp_path, scene_text()))
    asked = 0
    for item in chunks(MARKS[:3]):
        if asked < 3 and item.host_ns > (1.0 + asked * POKE_S) * 1e9:
            pipeline.act(AskLandmark(f"m{asked}"), item.host_ns)
            asked += 1
        pipeline.feed(item)
    pipeline.close()
    assert pipeline.session.decisions.landmark_of_poke == {1: "m0", 2: "m1", 3: "m2"}


@pytest.mark.parametrize(
    ("hold_s", "slide"), [(2.5, None), (12.0, None), (10.0, [0.002, 0.0, 0.0])], ids=["2.5", "12", "drift"]
)
def test_a_landmark_and_a_taxel_are_held_for_any_time(tmp_path, hold_s, slide):
    """A hand or a robot may hold for ten seconds, and a hand drifts by 2 mm meanwhile: the way that it came is still known."""
    places = np.concatenate([MARKS[:1], TAXELS[4:5]])
    pipeline = calibrate(scene_of(tmp_path, scene_text()), chunks(places, hold_s=hold_s, aim_sd=0.0, slide=slide))
    outcomes = outcomes_of(pipeline)
    assert [isinstance(each, Contact) for each in outcomes] == [False, True]
    ways = pushes(np.random.default_rng(1), len(places))
    for outcome, place, way in zip(outcomes, places, ways, strict=True):
        moved = outcome.link_from_sensor[:3, 3] - (BASE_FROM_PART[:3, :3] @ (place + OUT) + BASE_FROM_PART[:3, 3])
        assert np.linalg.norm(moved) < (0.0005 if slide is None else 0.0025)
        push = outcome.link_from_sensor[:3, :3] @ outcome.force
        # The push starts 5 mm before the place, of which a drift moves the end by up to 2 mm.
        assert push @ BASE_FROM_PART[:3, :3] @ way > (0.99 if slide is None else 0.85)


def test_a_tool_that_is_parked_for_long_needs_no_memory_and_keeps_its_way():
    watch, start = RestWatch(0.3), np.array([0.0, 0.0, 0.03])
    for k in range(300):
        watch.feed(_Seen(k / 50, start * (1.0 - min(k, 30) / 30), None, 0.0, 10.0))
    for k in range(300, 6_000):
        watch.feed(_Seen(k / 50, np.zeros(3), None, 0.0, 10.0))
    assert len(watch.places_before()) < 250
    left = [watch.feed(_Seen(120 + k / 50, start * k / 30, None, 0.0, 10.0)) for k in range(30)]
    (touch,) = [each for each in left if each is not None]
    np.testing.assert_allclose(touch.push, [0.0, 0.0, -1.0], atol=1e-12)
    assert touch.end_s - touch.start_s > 110


def test_a_rest_has_the_mean_of_its_places_and_its_strongest_answer():
    watch, start = RestWatch(0.3), np.array([0.0, 0.0, 0.03])
    answers = {40: (6.0, 10.0), 45: (8.0, 20.0), 46: (np.nan, 10.0)}
    for k in range(60):
        tremble = [0.0002 * (k % 2) if k >= 30 else 0.0, 0.0, 0.0]
        response, needed = answers.get(k, (1.0, 10.0))
        watch.feed(_Seen(k / 50, start * (1.0 - min(k, 30) / 30) + tremble, None, response, needed))
    left = [watch.feed(_Seen((60 + k) / 50, start * k / 30, None, 0.0, 10.0)) for k in range(30)]
    (touch,) = [each for each in left if each is not None]
    assert touch.place[0] == pytest.approx(0.0001, abs=0.00001)
    assert (touch.response, touch.needed) == (6.0, 10.0), "the largest share of what an answer needs"


def test_a_long_press_of_something_else_beside_a_parked_tip_is_no_poke(tmp_path):
    at_rest, on_taxel = np.random.default_rng(1), np.arange(len(TAXELS)) == 4
    turn = Rotation.from_matrix(BASE_FROM_PART[:3, :3])

    def items():
        for k in range(15 * 20):
            t = k / 20
            # The tool comes, and rests beside the skin; a hand then lies on a taxel from 3 s on.
            place = BASE_FROM_PART[:3, 3] + [0.0, 0.05, 0.05 + 0.03 * max(0.0, 1.0 - t)]
            yield Chunk("tool", round((1 + t) * 1e9), line("P", k, 1 + t, [*(place - turn.apply(TIP)), *turn.as_quat()]))
            skin = 20 + np.round(0.4 * at_rest.standard_normal(len(TAXELS)) + 150 * (t > 3) * on_taxel)
            yield Chunk("skin", round((1 + t) * 1e9), line("T", k, 1 + t, skin))

    (outcome,) = outcomes_of(calibrate(scene_of(tmp_path, scene_text()), items()))
    assert outcome.reason is Reason.NO_TARE


def test_landmarks_without_a_poke_are_named_with_the_command_that_finds_them(tmp_path):
    pipeline = calibrate(scene_of(tmp_path, scene_text()), chunks(EVERY[:5]))
    by_shape = pipeline.session.landmarks_by_shape({})
    assert by_shape.names == {1: "m0", 2: "m1", 3: "m2", 4: "m3"}
    assert by_shape.rival is None
    assert by_shape.miss < 0.0015
    assert pipeline.session.landmarks_by_shape({2: "m2"}) is None, "a name that was given stays, and fits no shape"
    (before,) = unnamed_landmarks(pipeline, tmp_path / "monday")
    assert before.startswith("4 landmarks have no poke, and no taxel answered 4 pokes: ")
    assert f"`skincal landmarks {tmp_path / 'monday'} --find`" in before
    assert "--order in their order" in before
    for row in range(3):
        pipeline.act(AtLandmark(row + 1, f"m{row}"), 0)
    assert pipeline.snapshot().is_placed
    (after,) = unnamed_landmarks(pipeline, tmp_path / "monday")
    assert after.startswith("1 landmark has no poke, and no taxel answered 1 poke: ")
    assert "--find` names them" in after
    assert pipeline.session.sure_landmarks() == {4: "m3"}
    pipeline.act(AtLandmark(4, "m3"), 0)
    pipeline.act(AtLandmark(3, ""), 0)
    assert pipeline.snapshot().is_placed
    assert pipeline.session.sure_landmarks() == {}, "the operator took poke 3 from its landmark"
    pipeline.act(AtLandmark(3, "m2"), 0)
    assert unnamed_landmarks(pipeline, tmp_path / "monday") == []


def test_a_pause_above_the_skin_is_no_poke(tmp_path):
    # Each poke pauses above before and after: three rests, one poke.
    assert len(outcomes_of(calibrate(scene_of(tmp_path, scene_text()), chunks(MARKS[:2])))) == 2


def test_a_replay_is_equal_to_the_last_bit(tmp_path):
    scene, items = scene_of(tmp_path, scene_text()), list(chunks(EVERY[:10]))
    first = calibrate(scene, items)
    pipeline = pipeline_of(scene)
    for number, item in enumerate(items):
        pipeline.feed(item)
        if number % 97 == 0:
            pipeline.snapshot()
    pipeline.close()
    for one, other in zip(outcomes_of(first), outcomes_of(pipeline), strict=True):
        assert one.link_from_sensor.tobytes() == other.link_from_sensor.tobytes()
        assert one.force.tobytes() == other.force.tobytes()


def test_results_say_nothing_of_a_sensor_and_landmarks_check_the_part(recorded):
    results = SessionResults(recorded)
    assert results.frame is None
    assert results.rig is None
    verdict = results.verdict(Method.SURFACE)
    assert verdict.unchecked is None
    assert "Landmarks agree" in verdict_sentence(verdict)
    said, of_delay = results.tool
    assert said.startswith("Part: its pose in the base is known to")
    assert re.match(r"Poses of the tool come \d ms (later|earlier) than the skin \(known to \d ms", of_delay)
    shown = {link.link: link.pose_delay for link in recorded.live(0).links}
    assert shown == {"skin": "", "tool": of_delay}, "the Devices tab has it, too"
    names = ChannelNames(None)
    contact = next(each for each in outcomes_of(recorded) if isinstance(each, Contact))
    assert outcome_headline(contact, names) == f"accepted: taxel {contact.strongest_channel}"


def test_landmarks_to_which_a_robot_drove_confirm_nothing_and_the_verdict_says_so(tmp_path):
    """They agree with the pose by which it drove, and so with each other."""
    pipeline = calibrate(scene_of(tmp_path, scene_text()), chunks(EVERY[:5]))
    for row in range(len(MARKS)):
        pipeline.act(AtLandmark(row + 1, f"m{row}"), 0)
    verdict = SessionResults(pipeline).verdict(Method.SURFACE)
    assert verdict.landmarks.driven == 0
    for row in range(len(MARKS)):
        pipeline.act(DroveToLandmark(f"m{row}"), 0)
    results = SessionResults(pipeline)
    assert any("a robot drove to 4 landmark touches" in each for each in results.tool), "in solve, report and files"
    driven = results.verdict(Method.SURFACE)
    assert (driven.landmarks.driven, driven.landmarks.ratio) == (4, verdict.landmarks.ratio)
    assert driven.landmarks.agrees
    enough = Check(30, 30)
    assert is_believed(enough, verdict.landmarks)
    assert not is_believed(enough, driven.landmarks)
    assert "A robot drove to 4 of 4 landmark pokes" in verdict_sentence(driven)
    assert "by hand" in dict(figures(driven))["Landmarks"]


def test_three_landmarks_give_the_pose_and_every_place_says_that_they_cannot_check_it(tmp_path):
    pipeline = calibrate(scene_of(tmp_path, scene_text()), chunks(EVERY[:5]))
    for row in range(3):
        pipeline.act(AtLandmark(row + 1, f"m{row}"), 0)
    results = SessionResults(pipeline)
    verdict = results.verdict(Method.SURFACE)
    assert (results.snapshot.part_pose.is_known, verdict.landmarks) == (True, None)
    assert not is_believed(Check(30, 30), verdict.landmarks)
    assert "3 landmarks cannot check it" in verdict_sentence(verdict)
    assert dict(figures(verdict))["Landmarks"].startswith("not checked: 3 of the 4 landmarks")
    assert "3 landmarks give the pose and cannot check it" in results.tool[0]
    pipeline.act(AtLandmark(4, "m3"), 0)
    results = SessionResults(pipeline)
    assert "Landmarks agree" in verdict_sentence(results.verdict(Method.SURFACE))
    assert "cannot check it" not in results.tool[0]


def test_a_tip_that_the_touches_show_elsewhere_is_named_with_its_way(recorded):
    part, tool = recorded.snapshot().part_pose, recorded.scene.tool
    assert tip_shift_sentence(part, tool) == "", "a right tip"
    wrong = replace(part, tip_shift=np.array([0.0, -0.005, 0.0]), tip_shift_chi2=25.0)
    assert "(0.0  \N{MINUS SIGN}5.0  0.0) mm from tip_mm" in tip_shift_sentence(wrong, tool)


def test_a_landmark_to_which_a_robot_drives_later_changes_no_pose_that_three_others_give(tmp_path):
    pipeline = calibrate(scene_of(tmp_path, scene_text()), chunks(EVERY[:4]))
    for row in range(3):
        pipeline.act(AtLandmark(row + 1, f"m{row}"), 0)
    by_hand = pipeline.snapshot().part_pose
    pipeline.act(AtLandmark(4, "m3"), 0)
    assert pipeline.snapshot().part_pose.landmarks == 4
    pipeline.act(DroveToLandmark("m3"), 0)
    after = pipeline.snapshot()
    assert after.driven_to_landmarks == 0
    np.testing.assert_array_equal(after.part_pose.link_from_base, by_hand.link_from_base)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("tip_mm", "# tip_mm"), "tip_mm is missing; without a sensor the tip alone"),
        (lambda text: text.replace("tip_radius_mm", "tolerance_deg = 2.0\ntip_radius_mm"), "leave tolerance_deg out"),
        (
            lambda text: text.replace("radius = 1.0", "radius = 1.0\nforce = 0.2"),
            r"force of \[noise\] is of a force/torque sensor",
        ),
        (lambda text: text + "[wrench]\nsign = 1\n", r"\[wrench\] is of a force/torque sensor"),
        (lambda text: text.replace("tip_sd_mm = 0.2", "tip_sd_mm = 0"), "tip_sd_mm is 0; expected 0.01 to 10"),
    ],
)
def test_a_scene_without_a_sensor_refuses_what_belongs_to_one(tmp_path, change, says):
    with pytest.raises(InputError, match=says):
        scene_of(tmp_path, change(scene_text()))


def test_streams_of_a_rig_without_a_sensor(tmp_path):
    scene = scene_of(tmp_path, scene_text())
    check_tool_streams(scene, {Stream.TOOL: "a", Stream.SKIN: "b"})
    with pytest.raises(InputError, match="there is no force/torque sensor; leave it out"):
        check_tool_streams(scene, {Stream.TOOL: "a", Stream.WRENCH: "b"})
    with pytest.raises(InputError, match="field Tool, or --tool"):
        check_tool_streams(scene, {Stream.TOOL: None})
    said = tool_findings(scene.tool, scene.wrench_sign, finds_part_pose=scene.finds_part_pose)
    assert said[0].startswith("there is no force sensor")
    assert not any("wrench" in each for each in said)


def test_a_summary_names_the_poses_of_the_tool_and_no_arm(tmp_path):
    pipeline = calibrate(
        scene_of(tmp_path, scene_text()),
        (chunk for chunk in chunks(TAXELS[:2]) if chunk.link == "skin" or not 1.5e9 < chunk.host_ns < 2.9e9),
    )
    (late, _) = outcomes_of(pipeline)
    assert rejection_words(late).startswith("tool pose unknown: its last pose is")
    (line_of_pokes,) = poke_lines(poke_counts(pipeline.snapshot()), pipeline.scene)
    assert line_of_pokes == "2 pokes: 1 accepted, 1 rejected (tool pose unknown: 1)"


TYPED_POSE = f"base_from_link = {np.round(BASE_FROM_PART, 12).tolist()}\n"


def wrong_tip_text(off, *, layout):
    """The scene with the part's pose, and tip_mm that lies `off` (3,) metres from the tip, in the tool's frame."""
    right, wrong = (f"tip_mm = {(tip * 1e3).tolist()}" for tip in (TIP, TIP + off))
    text = scene_text(TYPED_POSE, landmarks=False).replace(right, wrong)
    return text.replace("channels = 9\n", f"channels = 9\n{ANCHOR}") if layout else text


def test_a_tip_that_is_wrong_sideways_is_named_and_no_sensor_is_blamed(tmp_path):
    (tmp_path / "m.toml").write_text(LAYOUT)
    off = np.array([0.02, 0.0, 0.0])
    results = SessionResults(calibrate(scene_of(tmp_path, wrong_tip_text(off, layout=True)), on_taxels()))
    (said,) = setup_sentences(results.setup)
    assert "the tip lies" in said
    assert "correct tip_mm of [tool]" in said
    assert not any(word in said for word in ("sensor", "wrench", "force"))
    named = np.array(results.setup.mistakes[0].names, dtype=float)
    np.testing.assert_allclose(named, -1e3 * off, atol=4.0)


def test_a_long_hold_with_few_frames_of_the_skin_names_their_number(tmp_path):
    """Five frames a second: a still window of 0.3 s needs four, and a hold of 0.5 s has three."""
    pipeline = calibrate(
        scene_of(tmp_path, scene_text()),
        (chunk for chunk in chunks(TAXELS) if chunk.link == "tool" or round(chunk.host_ns * 1e-9 * HZ) % 10 == 0),
    )
    few = [each for each in outcomes_of(pipeline) if isinstance(each, Rejection) and each.unit == ""]
    assert few
    for each in few:
        assert (each.reason, each.threshold, each.end_s - each.start_s >= 0.3) == (Reason.NOT_STILL, "still_s", True)
        assert rejection_words(each) == "held still for only 3 skin frames in a row (needs 4)"
        assert short_rejection(each) == "held 3 skin frames in a row"
        assert rejection_advice(each).startswith("The skin sends too few readings")


def test_a_press_before_the_first_pose_of_the_tool_names_the_frames_without_one(tmp_path):
    begins_ns = round((1.0 + PAUSE_S + WAY_S + 0.9 * HOLD_S) * 1e9)
    pipeline = calibrate(
        scene_of(tmp_path, scene_text()),
        (chunk for chunk in chunks(TAXELS[:1]) if chunk.link == "skin" or chunk.host_ns > begins_ns),
    )
    (outcome,) = outcomes_of(pipeline)
    assert outcome.reason is Reason.NO_POSE
    pressed = round(outcome.value)
    assert HOLD_S * 0.9 * HZ <= pressed <= (HOLD_S + WAY_S) * HZ
    assert rejection_words(outcome) == f"tool pose unknown: {pressed} skin frames without a pose"


@pytest.mark.parametrize("layout", [False, True])
def test_touches_far_off_the_mesh_are_named_with_the_remedy_and_the_verdict_does_not_believe(tmp_path, layout):
    """A tip that is 30 mm too short puts all positions off along the push; test pokes agree with each other."""
    (tmp_path / "m.toml").write_text(LAYOUT)
    results = SessionResults(calibrate(scene_of(tmp_path, wrong_tip_text([0, 0, -0.03], layout=layout)), on_taxels()))
    (said,) = [each for each in results.tool if "the mesh (median)" in each]
    # The tool leans by 3 to 23 degrees.
    assert re.match(r"\d+ touches lie (28|29|30) mm outside the mesh", said)
    assert all(name in said for name in ("tip_mm", "tip_radius_mm", "base_from_link"))
    verdict = results.verdict(Method.FREE)
    assert verdict.doubted
    assert not verdict.believed
    assert re.search(r"but .*the touches lie (28|29|30) mm off the mesh", verdict_sentence(verdict))


def test_touches_of_a_tip_that_is_too_long_lie_inside_the_mesh(tmp_path):
    results = SessionResults(calibrate(scene_of(tmp_path, wrong_tip_text([0, 0, 0.03], layout=False)), on_taxels()))
    assert any(re.search(r"touches lie (28|29|30) mm inside the mesh", each) for each in results.tool)


@pytest.mark.parametrize("off", [0.0, 0.002])
def test_touches_of_a_right_tip_are_on_the_mesh(tmp_path, off):
    results = SessionResults(calibrate(scene_of(tmp_path, wrong_tip_text([0, 0, off], layout=False)), on_taxels()))
    assert results.snapshot.off_mesh is None
    assert not any("the mesh (median)" in each for each in results.tool)


def late_chunks(contacts, late_s, every=1):
    """Chunks whose poses come `late_s` after their time, and repeat each `every` times."""
    items, held = [], None
    for row, (name, t, values) in enumerate(readings(contacts)):
        if name == "tool":
            held = values if held is None or (row // 2) % every == 0 else held
        items.append((t + late_s, name, held) if name == "tool" else (t, name, values))
    for number, (t, name, values) in enumerate(sorted(items, key=lambda each: each[0])):
        yield Chunk(name, round(t * 1e9), line({"skin": "T", "tool": "P"}[name], number, t, values))


def test_late_poses_are_measured_named_and_corrected(tmp_path):
    pipeline = calibrate(scene_of(tmp_path, scene_text()), late_chunks(EVERY[4:16], 0.16))
    found = pipeline.pose_delays.leading
    assert abs(found.delay_s - 0.16) < 2.0 * found.sd_s
    results = SessionResults(pipeline)
    assert any(each.startswith("Poses of the tool come 1") for each in results.tool)
    (said,) = [each for each in results.skin if each.startswith("Poses of the tool are 1")]
    assert "buffer" in said
    (warned,) = [link.warning for link in pipeline.live(0).links if link.warning]
    assert warned == said
    # A press is then paired with the poses of its own time.
    true = outcomes_of(calibrate(scene_of(tmp_path, scene_text()), late_chunks(EVERY[4:16], 0.0)))[-1]
    last = outcomes_of(pipeline)[-1]
    assert last.link_from_sensor == pytest.approx(true.link_from_sensor, abs=2e-4)
    assert last.end_s == pytest.approx(true.end_s, abs=0.03)


def test_a_stream_that_repeats_its_poses_is_named(tmp_path):
    pipeline = calibrate(scene_of(tmp_path, scene_text()), late_chunks(EVERY[4:8], 0.0, every=10))
    assert pipeline.pose_delays.repeated_s == pytest.approx(0.2, abs=0.021)
    assert any("changes only every 0.20 s" in each for each in SessionResults(pipeline).skin)


def test_delays_are_kept_on_the_disk_and_a_replay_has_the_same(tmp_path):
    scene = scene_of(tmp_path, scene_text())
    links = [LinkSpec(name, f"simulated:{name}", (STREAMS[name],)) for name in ("skin", "tool")]
    pipeline = Pipeline(scene, links, load_surface(scene.surface)[0], create_session(tmp_path / "s", scene, links))
    pipeline.feed_many([LinkEvent("skin", 1, LinkState.OPEN), LinkEvent("tool", 1, LinkState.OPEN)])
    pipeline.feed_many(list(late_chunks(EVERY[4:10], 0.16)))
    pipeline.close()
    for again in (replay(tmp_path / "s"), load(tmp_path / "s")):
        assert again.pose_delays.of_skin.tolist() == pipeline.pose_delays.of_skin.tolist() != []
        assert "later than the skin" in next(link.pose_delay for link in again.live(0).links if link.link == "tool")
        for one, other in zip(outcomes_of(again), outcomes_of(pipeline), strict=True):
            assert np.array_equal(one.link_from_sensor, other.link_from_sensor)
