"""Corrections of the rig in a session: used, taken back, journalled, played again, and exported so that they can be redone."""

import json
from dataclasses import replace

import numpy as np
import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact, PressPhase, Progress
from skincal.files.export import write_calibration
from skincal.geometry import axis_point, move_wrench
from skincal.methods import estimate_taxels
from skincal.model.actions import AtLandmark, Correct, Exclude, Uncorrect, Undo, action_from_json, action_to_json
from skincal.model.errors import InputError
from skincal.rig.correction import FRAME, MAX_ARM_POSES_WITH_UNCERTAINTY, RIG, Correction, CorrectionErrors, UsedCorrection
from skincal.rig.correction_fit import RigRequest, correct_rig
from skincal.rig.frame_check import check_frame
from skincal.session.corrections import correct_action, corrected_progress, used_of
from skincal.session.replay import load, replay
from skincal.session.session import Session
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import Method
from skincal.words.rig_words import correction_words
from tests.approved import approved
from tests.build import landmark_outcome, noted_session, recording, session_of
from tests.skincal.files.json_reader import read_json
from tests.skincal.poke_script import as_chunks, same_estimates, small_scene, some_pokes, write_scene
from tests.skincal.sim_support import make_rig

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def poked():
    """A rig with the paper's errors, contacts on it, and three landmark pokes in each arm pose."""
    rig, rng = make_rig(RigErrors.paper(), 1), np.random.default_rng(8)
    contacts = simulate_contacts(rig, unguided(rig, 2, rng), rng)
    return rig, contacts, poke_landmarks(rig, rig.scene.landmarks, 3, rng, 5001)


@pytest.fixture
def bad(poked):
    """A session of these pokes, and the rig."""
    rig, contacts, landmarks = poked
    session = session_of(contacts, rig.scene, rig.surface, landmarks)
    return session, rig


def found_in(session):
    answer = correct_rig(session.rig_request())
    assert answer.used
    return correct_action(
        UsedCorrection(RIG, answer.correction, answer.before, answer.after, len(session.landmark_pokes), answer.ratio)
    )


def mean_error(session, rig, method=Method.MODULES):
    truth = dict(zip(rig.channels.tolist(), rig.places, strict=True))
    off = [
        np.linalg.norm(estimate.position - truth[estimate.channel])
        for estimate in session.snapshot().estimates[method]
        if estimate.position is not None and estimate.channel in truth
    ]
    return float(np.mean(off))


def test_a_correction_in_use_is_that_of_every_contact_and_can_be_taken_back(bad):
    session, rig = bad
    before, error = session.snapshot(), mean_error(session, rig)
    reported = [record.outcome for record in before.pokes if not record.excluded]
    action = found_in(session)
    session.act(action)
    now = session.snapshot()
    assert now.can_undo == approved("rig.undo_correction")
    assert mean_error(session, rig) < 0.5 * error
    correction = now.decisions.corrections[RIG].correction
    contacts = [correction.corrected(poke) for poke in reported if isinstance(poke, Contact)]
    solved = estimate_taxels(
        contacts,
        session.channels,
        session.methods,
        session.scene.noise,
        session.surface,
        session.dead,
        model=session.module_model,
    )
    for method, found in solved.items():
        for first, second in zip(now.estimates[method], found.values(), strict=True):
            assert np.array_equal(first.position, second.position), method
            assert (first.moved is None) is (first.position is None)
            if first.moved is not None:
                assert np.linalg.eigvalsh(first.covariance - first.moved @ first.moved.T).min() > -1e-12
    assert found_in(session) == action, "what is asked for does not hang on what is in use"
    session.act(Undo())
    assert same_estimates(session.snapshot(), before)
    assert not session.snapshot().decisions.corrections


def test_a_poke_that_comes_later_is_corrected_too(bad):
    session, _ = bad
    session.act(found_in(session))
    reported = session.outcome(7)
    session.add(replace(reported, poke=6000))
    first, last = (next(r.outcome for r in session.snapshot().pokes if r.outcome.poke == n) for n in (7, 6000))
    assert np.array_equal(first.force, last.force)
    assert not np.array_equal(last.force, reported.force)
    assert session.outcome(6000).force is reported.force
    session.act(Exclude(6000))
    session.act(Uncorrect(RIG))
    assert np.array_equal(session.snapshot().pokes[-1].outcome.force, reported.force)


def test_another_frame_drops_what_was_found_under_the_one_before(bad):
    session, _ = bad
    rig = found_in(session)
    frame = correct_action(UsedCorrection(FRAME, Correction(np.eye(6)), 0.05, 0.004, 3))
    session.act(rig)
    session.act(frame)
    assert list(session.snapshot().decisions.corrections) == [FRAME]
    session.act(rig)
    assert list(session.snapshot().decisions.corrections) == [FRAME, RIG]
    session.act(Uncorrect(FRAME))
    assert not session.snapshot().decisions.corrections
    session.act(Undo())
    assert list(session.snapshot().decisions.corrections) == [FRAME, RIG]
    for _ in range(3):
        session.act(Undo())
    assert not session.snapshot().decisions.corrections


def test_a_frame_that_is_named_wrong_is_put_right():
    """Axes turned by 90 degrees and newton millimetres: the offer makes the axes pass the landmarks again."""
    rig, rng = make_rig(RigErrors()), np.random.default_rng(3)
    session = Session(rig.scene, rig.surface)
    for poke in poke_landmarks(rig, rig.scene.landmarks, 6, rng)[:6]:
        session.add(landmark_outcome(replace(poke, force=TURN @ poke.force, moment=1e3 * TURN @ poke.moment)))
        session.act(AtLandmark(int(poke.number), str(poke.name)))
    normals = {landmark.name: landmark.normal for landmark in session.decisions.landmarks}

    def diagnosis():
        return check_frame(session.landmark_pokes, [normals[name] for name in session.landmark_pokes.name])

    found = diagnosis()
    assert not found.right
    correction = found.mistake.correction
    np.testing.assert_array_equal(correction.matrix, np.kron(np.diag([1.0, 1e-3]), TURN.T))
    session.act(correct_action(UsedCorrection(FRAME, correction, found.miss, found.corrected_miss, 6)))
    again = diagnosis()
    assert again.right
    assert again.miss == pytest.approx(found.corrected_miss)
    assert 3.0 * again.miss < found.miss


@pytest.mark.parametrize("again", [replay, load])
def test_a_corrected_session_played_again_is_the_same(tmp_path, rng, again):
    scene = write_scene(tmp_path / "source")
    pipeline = recording(scene, tmp_path / "s", as_chunks(some_pokes(scene, 3).samples))
    reported, motion = pipeline.snapshot(), np.eye(4)
    motion[:3, 3] = 1e-3, -2e-3, 1 / 3
    root, quadratic = np.triu(1e-3 * rng.standard_normal((168, 168))), 1e-5 * rng.standard_normal((6, 21))
    matrix = np.eye(6) + 0.02 * rng.standard_normal((6, 6))
    correction = Correction(matrix, motions={reported.pokes[0].outcome.pose: motion}, root=root, quadratic=quadratic)
    pipeline.act(correct_action(UsedCorrection(RIG, correction, 0.007, 0.001, 21, 1.3)), 10**18)
    assert not same_estimates(pipeline.snapshot(), reported)
    pipeline.close()
    other = again(tmp_path / "s")
    assert same_estimates(other.snapshot(), pipeline.snapshot())
    here, there = (moment.session.snapshot().decisions.corrections[RIG] for moment in (pipeline, other))
    for name in ("matrix", "root", "quadratic"):
        assert getattr(here.correction, name).tobytes() == getattr(there.correction, name).tobytes()
    assert (there.before, there.after, there.pokes, there.ratio) == (0.007, 0.001, 21, 1.3)


@pytest.mark.parametrize(
    "change",
    [
        {"of": "arm"},
        {"matrix": (1.0,) * 35},
        {"matrix": (0.0,) * 36},
        {"everywhere": (float("inf"),) * 16},
        {"poses": ("one",)},
        {"ratio": float("nan")},
        {"ratio": -1.0},
        {"noisier": 0.9},
        {"noisier": float("nan")},
        {"spread": (1e-3,) * 665},
        {"spread": (float("inf"),) * 666},
        {"quadratic": (1e-3,) * 125},
        {"quadratic": (1e-3,) * 126},
        {"quadratic": (1e-3,) * 126, "spread": (1e-3,) * 666},
        {"quadratic": (float("nan"),) * 126, "spread": ()},
    ],
    ids=lambda change: " ".join(
        f"{name} {len(value) if isinstance(value, tuple) else value}" for name, value in change.items()
    ),
)
def test_what_is_no_correction_is_refused(change):
    session = Session(small_scene(), None)
    good = correct_action(UsedCorrection(RIG, Correction(np.eye(6), root=1e-3 * np.eye(36)), 0.007, 0.001, 21, 1.2))
    session.act(good)
    session.act(Undo())
    assert action_from_json(json.loads(json.dumps(action_to_json(good)))) == good
    with pytest.raises(InputError, match="expected"):
        session.act(replace(good, **change))
    assert not session.snapshot().decisions.corrections
    with pytest.raises(InputError, match="expected"):
        action_from_json({**action_to_json(good), "matrix": ["1.0"] * 36})
    assert isinstance(action_from_json(action_to_json(good)), Correct)


def some_correction(poses, rng, quadratic=True):
    """A correction with all that one can have."""
    names, size = [f"pose {i}" for i in range(poses)], 36 + (126 if quadratic else 0)
    size += 6 * poses if poses <= MAX_ARM_POSES_WITH_UNCERTAINTY else 0
    return Correction(
        np.eye(6) + 0.01 * rng.standard_normal((6, 6)),
        motions={name: np.eye(4) for name in names},
        root=np.triu(1e-3 * rng.standard_normal((size, size))),
        quadratic=1e-4 * rng.standard_normal((6, 21)) if quadratic else np.empty((6, 0)),
    )


@pytest.mark.parametrize("poses", [0, 2, MAX_ARM_POSES_WITH_UNCERTAINTY, MAX_ARM_POSES_WITH_UNCERTAINTY + 1, 300])
@pytest.mark.parametrize("quadratic", [True, False])
def test_an_action_is_the_correction_again(rng, poses, quadratic):
    """To six digits of what is not known, and to the bit of the rest; as JSON it takes no more with hundreds of poses."""
    there = some_correction(poses, rng, quadratic)
    action = correct_action(UsedCorrection(RIG, there, 0.007, 0.001, 21, 1.25, 2.8))
    line = json.dumps(action_to_json(action))
    assert len(line) < 2e6
    used = used_of(action_from_json(json.loads(line)))
    assert (used.ratio, used.noisier) == (1.25, 2.8)
    for name in ("matrix", "quadratic"):
        assert np.array_equal(getattr(used.correction, name), getattr(there, name))
    np.testing.assert_allclose(used.correction.root, there.root, rtol=1e-5, atol=0)
    assert correct_action(UsedCorrection(RIG, used.correction, 0.007, 0.001, 21, 1.25, 2.8)) == action, (
        "again it is the same to the bit"
    )


def test_an_action_of_old_is_a_correction_that_is_taken_for_exact(bad):
    session, _ = bad
    document = action_to_json(found_in(session))
    old = {key: value for key, value in document.items() if key not in ("spread", "quadratic", "ratio", "noisier")}
    session.act(action_from_json(document))
    known = session.snapshot().estimates
    session.act(action_from_json(old))
    used = session.snapshot().decisions.corrections[RIG]
    assert used.correction.exact
    assert np.isnan(used.ratio)
    assert used.noisier == 1.0
    for method, estimates in session.snapshot().estimates.items():
        for estimate, other in zip(estimates, known[method], strict=True):
            assert estimate.moved is None
            if estimate.position is not None and not used.correction.quadratic.size:
                assert estimate.rms < other.rms
    session.act(Undo())
    assert same_estimates(session.snapshot(), replace(session.snapshot(), estimates=known)), "its uncertainty is back"


def test_a_frame_and_the_rig_together_are_uncertain_as_the_rig_is_under_that_frame(bad):
    session, _ = bad
    frame = correct_action(UsedCorrection(FRAME, Correction(np.eye(6)), 0.05, 0.004, 3))
    rig = found_in(session)
    session.act(rig)
    alone = session.snapshot()
    session.act(Undo())
    session.act(frame)
    session.act(rig)
    assert same_estimates(session.snapshot(), alone)
    session.act(Uncorrect(FRAME))
    assert all(estimate.moved is None for estimate in session.snapshot().estimates[Method.FREE])


@pytest.mark.parametrize("at_once", [True, False])
def test_a_pose_poked_only_after_the_correction_is_uncertain_and_played_again_to_the_bit(bad, at_once):
    """Also where other new poses came between, were taken out, and where it is solved after each poke or at its end."""
    session, rig = bad
    session.act(found_in(session))
    first = session.snapshot().estimates[Method.FREE]
    late = [replace(session.outcome(poke), poke=7000 + poke) for poke in (7, 11, 9)]
    for poke, pose in zip(late, ("twenty deg", "ten deg", "thirty deg"), strict=True):
        session.add(replace(poke, pose=pose))
        if not at_once:
            session.snapshot()
    session.act(Exclude(7007))
    now = session.snapshot()
    assert max(estimate.moved.shape[1] for estimate in now.estimates[Method.FREE] if estimate.moved is not None) == max(
        estimate.moved.shape[1] for estimate in first if estimate.moved is not None
    )
    again = session_of([session.outcome(record.outcome.poke) for record in now.pokes], rig.scene, rig.surface)
    again.act(Exclude(7007))
    for poke, name in now.at_landmarks.items():
        again.act(AtLandmark(poke, name))
    used = now.decisions.corrections[RIG]
    again.act(correct_action(UsedCorrection(RIG, used.correction, used.before, used.after, used.pokes, used.ratio)))
    assert same_estimates(again.snapshot(), now)


def test_what_is_felt_now_is_corrected_as_its_poke_will_be(bad):
    """A poke in progress, reported in the link frame, is the poke that comes of it, but for a moment along the force."""
    session, _ = bad
    session.act(found_in(session))
    reported = session.outcome(7)
    reported = replace(reported, moment=np.cross(axis_point(reported.force, reported.moment), reported.force))
    session.add(reported)
    force, moment = move_wrench(reported.link_from_sensor, reported.force, reported.moment)
    nobody = np.empty(0)
    felt = Progress(PressPhase.PRESSING, force, axis_point(force, moment), nobody.astype(np.int64), nobody, 0.0)
    true = corrected_progress(felt, reported.link_from_sensor, reported.pose, session.decisions.corrections)
    poke = next(record.outcome for record in session.snapshot().pokes if record.outcome.poke == 7)
    force, moment = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
    np.testing.assert_allclose(true.force, force, atol=1e-12)
    np.testing.assert_allclose(true.axis_point, axis_point(force, moment), atol=1e-9)
    assert corrected_progress(felt, None, "", session.decisions.corrections) is felt
    session.act(Undo())
    assert corrected_progress(felt, reported.link_from_sensor, reported.pose, session.decisions.corrections) is felt


def test_an_exported_correction_can_be_computed_again(bad, tmp_path):
    session, _ = bad
    session.act(replace(found_in(session), noisier=2.8))
    sentences = write_calibration(session.calibration(), "json", tmp_path / "c.json", Method.MODULES)
    assert any(approved("rig.held_out_clause") in sentence for sentence in sentences)
    file = read_json(tmp_path / "c.json")
    assert np.array_equal(file.contacts[0].force, session.outcome(file.contacts[0].poke).force), "as the rig reported it"
    solved = estimate_taxels(
        file.used_contacts, file.channels, session.methods, file.noise, session.surface, file.dead, model=session.module_model,
        shared=CorrectionErrors(file.corrections[0].correction, {poke.poke: poke for poke in file.used_contacts}.__getitem__),
    )  # fmt: skip
    for method, found in solved.items():
        for first, second in zip(file.estimates[method], found.values(), strict=True):
            assert np.array_equal(first.position, second.position), method
            assert np.array_equal(first.covariance, second.covariance), method
    (used,), (written,) = session.snapshot().decisions.corrections.values(), file.corrections
    kept = ("before", "after", "ratio", "noisier")
    assert [getattr(written, name) for name in kept] == [getattr(used, name) for name in kept]
    for name in ("matrix", "root", "quadratic"):
        assert np.array_equal(getattr(written.correction, name), getattr(used.correction, name))
    for kind in ("icub", "ply"):
        write_calibration(session.calibration(), kind, tmp_path / kind, Method.MODULES)
        assert correction_words(used, has_arm=True) in (tmp_path / kind).read_text(encoding="utf-8")


def test_comments_on_a_part_without_joints_name_its_sensor_alone(bad):
    session, _ = bad
    session.act(found_in(session))
    scene, method = replace(session.scene, arm=None), Method.MODULES
    calibration = replace(
        session.calibration(), scene=scene, verdicts={method: "Finished"}, unmodelled_rig_error_m={method: 0.004}
    )
    said = (*calibration.correction_comments(), *calibration.verdict_comments(method))
    assert len(said) == 3
    assert [each for each in said if " arm" in each] == []


def test_what_a_correction_is_found_from_is_exported_and_finds_it_again(bad, tmp_path):
    session, _ = bad
    found = correct_rig(session.rig_request())
    session.act(correct_action(UsedCorrection(RIG, found.correction, found.before, found.after, 21)))
    session.act(Exclude(session.contacts[0].poke))
    calibration = replace(session.calibration(), rig=found)
    write_calibration(calibration, "json", tmp_path / "c.json", Method.MODULES)
    file = read_json(tmp_path / "c.json")
    assert file.landmark_check == {
        "landmark_pokes": 21, "miss_before_m": found.before, "miss_after_m": found.after, "worth_using": True,
    }  # fmt: skip
    assert len(file.landmark_pokes) == 21
    reported = session.outcome(int(file.landmark_pokes.number[0]))
    assert np.array_equal(file.landmark_pokes[0].force, reported.force), "as the rig reported it"

    contacts = [contact for contact in file.contacts if contact.poke not in file.excluded]
    again = correct_rig(RigRequest(session.scene, session.surface, contacts, file.landmark_pokes, file.dead))
    session.act(Uncorrect(RIG))
    expected = correct_rig(session.rig_request())
    assert np.array_equal(again.correction.matrix, expected.correction.matrix)
    assert (again.before, again.after) == (expected.before, expected.after)


@pytest.fixture(scope="module")
def recorded(poked, tmp_path_factory):
    """A recorded session on the bad rig: its pokes are written as a detector's, without bytes."""
    rig, contacts, landmarks = poked
    folder = tmp_path_factory.mktemp("bad") / "s"
    outcomes = [*contacts, *(landmark_outcome(landmark) for landmark in landmarks)]
    pipeline = noted_session(folder, rig.scene, rig.surface, outcomes)
    for poke in landmarks:
        number = int(poke.number)
        pipeline.act(AtLandmark(number, str(poke.name)), 2 + number)
    pipeline.close()
    return folder


def test_the_commands_use_what_is_offered_where_they_are_told_to(recorded, tmp_path, capsys):
    assert main(["solve", str(recorded), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["rig"]["corrections"] == []
    assert plain["unchecked_rig_mm"] > 2.0
    assert plain["methods"]["modules"]["predicted_error_mm"]["whole_skin"] == 0.0
    apart = plain["methods"]["modules-corrected"]["predicted_error_mm"]
    assert plain["rig"]["held_out_over_predicted"] < 1.5
    assert main(["solve", str(recorded), "--correct", "--json", "--out", str(tmp_path)]) == 0
    reported = json.loads(capsys.readouterr().out)
    (used,) = reported["rig"]["corrections"]
    assert used["of"] == "rig"
    assert used["after_mm"] < used["before_mm"]
    assert "modules-corrected" in plain["methods"]
    assert "modules-corrected" not in reported["methods"]
    assert reported["unchecked_rig_mm"] is None
    assert reported["methods"]["modules"]["predicted_error_mm"] == pytest.approx(apart, rel=1e-4)
    assert min(apart.values()) > 0.2
    file = read_json(tmp_path / "calibration.json")
    assert len(file.corrections) == 1
    assert file.landmark_check["worth_using"]
    assert file.landmark_check["miss_after_m"] < file.landmark_check["miss_before_m"]
    assert main(["export", str(recorded), "--correct", "--format", "icub", "--out", str(tmp_path / "p.txt")]) == 0
    assert approved("rig.corrected_clause", pokes=21) in (tmp_path / "p.txt").read_text(encoding="utf-8")
    assert main(["solve", str(recorded)]) == 0
    said = capsys.readouterr().out
    assert approved("rig.correctable_begin") in said, "the recording is as it was"
    pokes = plain["rig"]["landmark_pokes"]
    assert approved("rig.unchecked_poked", off_mm=f"{plain['unchecked_rig_mm']:.1f}", pokes=pokes) in said.splitlines()
    assert f"{plain['verdict']}." in said.splitlines()
    assert plain["verdict"].startswith("Not finished")
    mean, worst, whole, among = (f"{value:.1f}" for value in apart.values())
    (line,) = [line for line in said.splitlines() if line.startswith("modules-corrected")]
    said = approved("verdict.predicted_apart", mean_mm=mean, worst_mm=worst, whole_mm=whole, among_mm=among)
    assert f"expected error {said};" in line
    assert main(["solve", str(recorded), "--correct", "--per-pose", "--json"]) == 0
    methods = json.loads(capsys.readouterr().out)["methods"]
    assert methods["modules-per-pose"]["predicted_error_mm"]["whole_skin"] > 0.2


def test_where_nothing_is_offered_a_command_says_so(tmp_path, capsys):
    scene = write_scene(tmp_path / "source")
    recording(scene, tmp_path / "s", as_chunks(some_pokes(scene, 1).samples)).close()
    assert main(["solve", str(tmp_path / "s"), "--correct"]) == 2
    assert approved("rig.needs_landmarks") in capsys.readouterr().err
