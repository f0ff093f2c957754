"""Sentences on results, word for word: files and the window say the same."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.geometry import rotations
from skincal.model.errors import InputError
from skincal.model.readings import LinkAnswer, LinkHealth, LinkState, LinkVerdict, Loss, Outages, Stream
from skincal.modules.health import LayoutRepair, MisplacedModule, MisplacementKind, ModuleChange, Unrepaired, UnrepairedKind
from skincal.rig.correction import FRAME, RIG, Correction, UsedCorrection
from skincal.rig.correction_fit import RigAnswer
from skincal.rig.frame_check import FrameDiagnosis, PokeAtOtherPoint
from skincal.rig.scene_mistakes import STANDARD_GRAVITY, Mistake, MistakeKind
from skincal.taxels.result import Cause, StateReason
from skincal.taxels.shared_errors import PredictedError
from skincal.words.layout_words import change_words, left_sentences, misfit_sentence
from skincal.words.link_words import STREAM_NAMES, link_verdict_words, outage_words, silent_links
from skincal.words.mistake_words import frame_sentence
from skincal.words.rig_words import correction_sentence, correction_words, rig_error_sentences, rig_sentences
from skincal.words.taxel_words import error_words, state_sentence, unchecked_sentence
from tests.approved import approved

NEITHER = np.empty(0)


@pytest.mark.parametrize(("count", "told"), [(1, True), (3, False)])
def test_of_three_links_that_are_silent_each_is_named_and_nothing_is_cut(count, told):
    streams = list(Stream)[:count]
    why = approved("links.no_port", port="/dev/pts/0")
    links = [LinkHealth(each.value, LinkState.FAILED, why, (each,), "", 0, 0.0, 0, {}) for each in streams]
    said = str(InputError(f"{silent_links(links)} No session was made."))
    assert "\N{HORIZONTAL ELLIPSIS}" not in said
    assert all(approved("links.nothing_usable_no_port", link=STREAM_NAMES[each], port="/dev/pts/0") in said for each in streams)
    assert (why in said) is told


def test_a_file_without_readings_has_no_baud_rate():
    losses = {Loss.MISSING: 2, Loss.UNREADABLE: 6}
    link = LinkHealth("skin", LinkState.ENDED, "", (Stream.SKIN,), "CSV", 0, 0.0, 1, losses, address="file:/data/skin.csv")
    assert silent_links([link]) == (
        "No usable readings from the skin: its lines hold none (6 not a record of this format, 2 numbers missing in the "
        "sequence). Check which file is named for it, and the columns and format of that file."
    )
    assert "it holds none. Check" in silent_links([replace(link, losses={}, last_host_ns=0)])


STATES = (
    (None, ""),
    (StateReason(Cause.UNPOKED), approved("taxel.unpoked")),
    (StateReason(Cause.ONE_AXIS), approved("taxel.one_axis")),
    (
        StateReason(Cause.ALIKE_AXES, 3, size=0.0417, angle=float(np.radians(1.24))),
        approved("taxel.alike_axes", count=3, degrees=1.2, depth="42 mm"),
    ),
    (
        StateReason(Cause.ALIKE_AXES, 2, angle=1e-9),
        approved("taxel.alike_axes_blind", count=2, degrees=0.1),
    ),
    (
        StateReason(Cause.ALIKE_AXES, 4, size=1.5, angle=0.01),
        approved("taxel.alike_axes", count=4, degrees=0.6, depth="over 1 m"),
    ),
    (
        StateReason(Cause.AXES_APART, size=0.15),
        approved("taxel.axes_apart", miss_mm=150),
    ),
    (StateReason(Cause.OPPOSED, 2), approved("taxel.opposed", count=2)),
    (
        StateReason(Cause.NO_TRIANGLE),
        approved("taxel.no_triangle"),
    ),
    (
        StateReason(Cause.OFF_SURFACE, size=0.3),
        approved("taxel.off_surface", miss_mm=300),
    ),
    (
        StateReason(Cause.GRAZING),
        approved("taxel.grazing"),
    ),
    (StateReason(Cause.MODULE_UNPOKED), approved("taxel.module_unpoked")),
    (
        StateReason(Cause.MODULE_UNPLACED),
        approved("taxel.module_unplaced"),
    ),
    (
        StateReason(Cause.MODULE_OFF, size=0.061),
        approved("taxel.module_off", miss_mm=61),
    ),
    (
        StateReason(Cause.MODULE_MOVING, size=0.0044),
        approved("taxel.module_moving", step_mm=4.4),
    ),
    (
        StateReason(Cause.MODULE_BEHIND),
        approved("taxel.module_behind"),
    ),
    (
        StateReason(Cause.MODULE_ONE_POKE),
        approved("taxel.module_one_poke"),
    ),
    (
        StateReason(Cause.MODULE_LOOSE, 5),
        approved("taxel.module_loose_blind", count=5),
    ),
    (
        StateReason(Cause.MODULE_LOOSE, 5, size=0.04),
        approved("taxel.module_loose", count=5),
    ),
    (StateReason(Cause.BY_MODULE), approved("taxel.by_module")),
    (StateReason(Cause.CONTRADICTED, 2, size=0.0362), approved("taxel.contradicted", count=2, mm=36)),
    (StateReason(Cause.CLAIMED, 8), approved("taxel.claimed", channel=8)),
    (StateReason(Cause.SHARED_ERRORS, size=0.0351), approved("taxel.shared_errors", depth="35 mm")),
    (StateReason(Cause.PART_UNPLACED), approved("taxel.part_unplaced")),
    (StateReason(Cause.MEAN_OF_POSES, 3), "Mean of 3 arm poses."),
    (StateReason(Cause.MEAN_OF_POSES, 2, blind=1), approved("taxel.mean_of_poses_without", count=2, blind=1)),
    (
        StateReason(Cause.BLIND_IN_POSES, 2, inner=StateReason(Cause.OPPOSED, 4)),
        approved("taxel.blind_in_poses", count=2, inner=approved("taxel.opposed", count=4)),
    ),
    (StateReason(Cause.EXTERNAL_TEXT, text="stuck at 255"), "stuck at 255"),
)


@pytest.mark.parametrize(("reason", "sentence"), STATES)
def test_each_state_is_explained(reason, sentence):
    assert state_sentence(reason) == sentence


def test_every_cause_has_a_sentence():
    assert {reason.cause for reason, _ in STATES if reason is not None} == set(Cause)


def test_a_mirrored_module_says_its_turn_only_where_it_has_one():
    plain = MisplacedModule(17, MisplacementKind.MIRRORED, 0.0104, 0.0021)
    said = approved("modules_check.mirrored", module=17, then_mm=2, now_mm=10)
    assert misfit_sentence(plain) == said
    too = replace(plain, turn=float(np.radians(180.0)))
    assert approved("modules_check.mirrored_and_turned", degrees=180) in misfit_sentence(too)


def test_turned_and_swapped_modules_say_what_to_change():
    turned = MisplacedModule(29, MisplacementKind.TURNED, 0.01, 0.002, turn=float(np.radians(-120.0)))
    assert approved("modules_check.turned", module=29, degrees=-120) in misfit_sentence(turned)
    swapped = MisplacedModule(3, MisplacementKind.SWAPPED, 0.04, 0.001, other=5)
    assert approved("modules_check.swapped", module=3, other=5) in misfit_sentence(swapped)


def test_a_change_says_what_the_file_is_to_say():
    change = ModuleChange(17, angle=float(np.radians(-60.0)), mirror=True)
    assert change_words(change) == approved("modules_check.change_angle_and_mirror", module=17, degrees=-60, mirror="true")


@pytest.mark.parametrize(
    ("left", "sentence"),
    [
        (
            Unrepaired(UnrepairedKind.STILL_OFF, (11,), 0.018),
            approved("modules_check.still_off", module=11, miss_mm=18),
        ),
        (
            Unrepaired(UnrepairedKind.NO_RING, (3, 7)),
            approved("modules_check.no_ring", module=3, other=7),
        ),
        (
            Unrepaired(UnrepairedKind.UNLIKE, (10, 11)),
            approved("modules_check.unlike", module=10, other=11),
        ),
        (
            Unrepaired(UnrepairedKind.NO_NEARER, (28,)),
            approved("modules_check.no_nearer", module=28),
        ),
        (
            Unrepaired(UnrepairedKind.NO_NEARER, (1, 2, 3, 4, 5, 6)),
            approved("modules_check.no_nearer_many", modules="1, 2, 3, 4", more=2),
        ),
    ],
)
def test_what_no_layout_puts_right_is_explained(left, sentence):
    assert left_sentences(LayoutRepair((), None, (), (left,))) == [sentence]


def test_a_correction_in_use_says_its_misses():
    rig = UsedCorrection(RIG, Correction(np.eye(6)), 0.0074, 0.0012, 21)
    words = approved("rig.corrected", pokes=21, with_mm=1.2, without_mm=7.4)
    assert correction_words(rig, has_arm=True) == f"sensor and arm {words}"
    assert correction_sentence(rig, has_arm=True) == f"Sensor and arm {words}."
    frame = replace(rig, of=FRAME)
    assert correction_words(frame, has_arm=True) == approved("rig.frame_corrected", pokes=21, with_mm=1.2, without_mm=7.4)
    sign = replace(frame, before=0.0012)
    assert correction_words(sign, has_arm=True) == approved("rig.sign_corrected", pokes=21, miss_mm=1.2)


def test_an_answer_on_the_rig_says_what_it_needs_or_found_and_which_pokes_are_doubted():
    trust = {1: 1.0, 2: 0.0, 3: 0.5}
    few = RigAnswer(None, False, np.nan, np.nan, 2, trust, {}, NEITHER, NEITHER)
    needs = approved("rig.pokes_needed", pokes=6, landmarks=4)
    assert rig_sentences(few, has_arm=True) == (approved("rig.too_few", needs=needs, pokes=3, landmarks=2),)
    distances = {1: 0.001, 2: 0.014, 3: 0.006}
    good = RigAnswer(Correction(np.eye(6)), True, 0.0074, 0.0012, 6, trust, distances, NEITHER, NEITHER)
    misses = approved("rig.held_out_misses", with_mm=1.2, without_mm=7.4)
    doubted = (
        approved("rig.poke_not_counted", poke=2, miss_mm=14),
        approved("rig.poke_half_counted", poke=3, miss_mm=6, percent=50),
    )
    assert rig_sentences(good, has_arm=True) == (approved("rig.correctable", misses=misses), *doubted)
    left = approved("rig.left_as_is", with_mm="6.0", without_mm=7.4, below_mm=5.2)
    assert rig_sentences(replace(good, used=False, after=0.006), has_arm=True) == (left, *doubted)


def test_a_correction_in_use_takes_the_place_of_the_offered_one_unless_the_pokes_no_longer_support_it():
    frame, rig = (UsedCorrection(of, Correction(np.eye(6)), 0.0074, 0.0012, 21) for of in (FRAME, RIG))
    trust, distances = {1: 1.0, 2: 0.0}, {1: 0.001, 2: 0.014}
    good = RigAnswer(Correction(np.eye(6)), True, 0.0074, 0.0012, 6, trust, distances, NEITHER, NEITHER)
    offer, doubted = rig_sentences(good, has_arm=True)
    begin, in_use = (
        [frame_sentence(RIGHT, has_arm=True), correction_sentence(frame, has_arm=True)],
        correction_sentence(rig, has_arm=True),
    )
    assert rig_error_sentences(RIGHT, {FRAME: frame}, good, has_arm=True) == [*begin, offer, doubted]
    assert rig_error_sentences(RIGHT, {FRAME: frame, RIG: rig}, good, "Moved.", has_arm=True) == [
        *begin,
        in_use,
        "Moved.",
        doubted,
    ]
    bad = replace(good, used=False, after=0.006)
    left = rig_sentences(bad, has_arm=True)[0]
    unsupported = f"{approved('rig.unsupported')} {left}"
    assert rig_error_sentences(None, {RIG: rig}, bad, has_arm=True) == [in_use, unsupported, doubted]
    assert rig_error_sentences(None, {}, None, has_arm=True) == []


def test_a_part_without_joints_hears_of_its_sensor_alone():
    found = RigAnswer(Correction(np.eye(6)), True, 0.0074, 0.0012, 6, {1: 1.0}, {1: 0.001}, NEITHER, NEITHER)
    used = UsedCorrection(RIG, Correction(np.eye(6)), 0.0074, 0.0012, 21)
    said = (
        *rig_sentences(found, has_arm=False),
        correction_sentence(used, has_arm=False),
        frame_sentence(replace(RIGHT, corrected_miss=0.0074), has_arm=False),
    )
    assert [each for each in said if "arm" in each] == []
    assert all("the sensor" in each.lower() for each in said)


RIGHT = FrameDiagnosis(True, True, True, 0.0024, 0.0024, Mistake(MistakeKind.NONE))


def wrong(mistake):
    return replace(RIGHT, right=False, miss=0.051, corrected_miss=0.006, mistake=mistake)


def test_a_landmark_error_that_stays_is_not_the_reason_for_a_sign():
    mistake = Mistake(MistakeKind.AXES, axes=-np.eye(3))
    said = frame_sentence(replace(wrong(mistake), miss=0.001, corrected_miss=0.001), has_arm=True)
    assert said == approved("sensor_frame.wrong_sign", mistake=approved("sensor_frame.reaction"), miss_mm=1)


def test_a_right_frame_is_said_to_be_and_errors_of_the_rig_are_named():
    assert frame_sentence(RIGHT, has_arm=True) == approved("sensor_frame.right", miss_mm=2)
    assert frame_sentence(replace(RIGHT, sure=False), has_arm=True).startswith(approved("sensor_frame.looks_right_begin"))
    assert frame_sentence(replace(RIGHT, corrected_miss=0.0074), has_arm=True).endswith(
        approved("sensor_frame.rig_errors", miss_mm=7)
    )
    slip = replace(RIGHT, other_point=PokeAtOtherPoint(12, "wrist", 0.044))
    assert frame_sentence(slip, has_arm=True).endswith(
        approved("sensor_frame.slip", miss_mm=2, poke=12, landmark="wrist", slip_mm=44)
    )
    nothing = replace(RIGHT, right=False, explained=False, miss=0.05)
    assert frame_sentence(nothing, has_arm=True).startswith(approved("sensor_frame.unexplained_misses", miss_mm=50))


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (Mistake(MistakeKind.AXES, axes=-np.eye(3)), approved("sensor_frame.reaction")),
        (Mistake(MistakeKind.AXES, axes=np.diag([-1.0, 1.0, -1.0])), approved("sensor_frame.signs_turned", axes="x, z")),
        (Mistake(MistakeKind.AXES, axes=np.eye(3)[[1, 0, 2]]), approved("sensor_frame.axes_order", order="y, x, z")),
        (
            Mistake(MistakeKind.AXES, axes=np.diag([1.0, 1.0, -1.0])[[2, 0, 1]]),
            approved("sensor_frame.axes_order", order="-z, x, y"),
        ),
        (Mistake(MistakeKind.UNITS, moment_scale=1e-3), approved("sensor_frame.moments_in_nmm")),
        (Mistake(MistakeKind.UNITS, moment_scale=1e-2), approved("sensor_frame.moments_in_ncm")),
        (Mistake(MistakeKind.UNITS, moment_scale=STANDARD_GRAVITY), approved("sensor_frame.moments_in_kgfm")),
        (Mistake(MistakeKind.UNITS, force_scale=STANDARD_GRAVITY), approved("sensor_frame.forces_in_kgf")),
        (
            Mistake(MistakeKind.AXES, axes=-np.eye(3), force_scale=STANDARD_GRAVITY),
            approved("sensor_frame.reaction_and_force_unit"),
        ),
    ],
)
def test_a_wrong_frame_says_its_mistake_and_both_misses(mistake, words):
    said = approved("sensor_frame.wrong", mistake=words, miss_mm=51, then_mm=6)
    assert frame_sentence(wrong(mistake), has_arm=True) == said


@pytest.mark.parametrize("degrees", [0.0, 25.0, 100.0, 180.0])
def test_a_sensor_that_sits_elsewhere_says_by_how_much(degrees):
    motion = np.eye(4)
    motion[:3, :3] = rotations(np.radians(degrees) * np.array([[0.6, 0.0, 0.8]]))[0]
    motion[:3, 3] = [0.0, 0.03, 0.04]
    said = frame_sentence(wrong(Mistake(MistakeKind.MOUNT, motion=motion)), has_arm=True)
    assert approved("sensor_frame.elsewhere", degrees=f"{degrees:.0f}", aside_mm=50) in said


def test_landmarks_are_recommended_only_where_none_was_poked():
    assert unchecked_sentence(0.0075, 0, has_arm=True) == approved("rig.unchecked", off_mm=7.5)
    assert unchecked_sentence(0.0075, 4, has_arm=True) == approved("rig.unchecked_poked", off_mm=7.5, pokes=4)


def test_without_an_arm_only_the_sensor_is_named():
    assert unchecked_sentence(0.0075, 4, has_arm=False) == approved("rig.unchecked_without_arm", off_mm=7.5, pokes=4)
    found = PredictedError(0.0011, 0.0017, 0.0, 0.0011)
    words = approved("rig.predicted_without_arm", mean_mm=1.1, worst_mm=1.7, unchecked_mm=7.5)
    assert error_words(found, 0.0075, has_arm=False) == words


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (LinkVerdict(LinkAnswer.GOOD, tried=(115200,)), "good"),
        (LinkVerdict(LinkAnswer.GOOD, unchanged=True), approved("links.unchanged")),
        (LinkVerdict(LinkAnswer.LISTENING), "listening"),
        (LinkVerdict(LinkAnswer.NO_ANSWER, Stream.SKIN), "no answer"),
        (LinkVerdict(LinkAnswer.NO_READING, Stream.SKIN), approved("links.no_reading")),
        (
            LinkVerdict(LinkAnswer.NO_READING, Stream.SKIN, tried=(115200, 460800, 1000000)),
            approved("links.no_reading_tried", tried="115200, 460800, 1000000"),
        ),
        (
            LinkVerdict(LinkAnswer.OTHER_STREAM, Stream.WRENCH, Stream.SKIN, 384),
            approved("links.other_stream", found="skin", width=384),
        ),
        (
            LinkVerdict(LinkAnswer.OTHER_STREAM, Stream.SKIN, Stream.WRENCH, 6),
            approved("links.other_stream", found="force/torque sensor", width=6),
        ),
        (
            LinkVerdict(LinkAnswer.OTHER_WIDTH, Stream.SKIN, width=20, expected=64),
            approved("links.other_width", width=20, of="the scene has", expected=64),
        ),
        (LinkVerdict(LinkAnswer.FROZEN, Stream.WRENCH), approved("links.frozen")),
    ],
)
def test_what_is_found_of_a_link_is_said_in_few_words(verdict, words):
    assert link_verdict_words(verdict) == words


def test_breaks_of_a_connection_are_counted():
    assert outage_words(Outages()) == ""
    assert outage_words(Outages(1, 15.2)) == approved("links.interrupted_once", seconds=15)
    assert outage_words(Outages(3, 40.0)) == approved("links.interrupted", times=3, seconds=40)
