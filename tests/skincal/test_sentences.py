"""Sentences on results, word for word: files and the window say the same."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.modules.health import LayoutMend, Misfit, MisfitKind, ModuleChange, Unmended, UnmendedKind
from skincal.modules.pose import rotations
from skincal.rig.correction import FRAME, RIG, Correction, UsedCorrection
from skincal.rig.correction_fit import RigAnswer
from skincal.rig.frame_check import GRAVITY, FrameCorrection, FrameDiagnosis, Slip
from skincal.sentences import (
    change_words,
    correction_sentence,
    correction_words,
    frame_sentence,
    left_sentences,
    misfit_sentence,
    rig_sentences,
    state_sentence,
)
from skincal.taxels.result import Cause, StateReason

NEITHER = np.empty(0)

STATES = (
    (None, ""),
    (StateReason(Cause.UNPOKED), "No accepted poke touched this taxel."),
    (StateReason(Cause.ONE_AXIS), "One axis only: the depth along it is unknown. Poke once more with another tilt."),
    (
        StateReason(Cause.ALIKE_AXES, 3, size=0.0417, angle=float(np.radians(1.24))),
        "All 3 axes lie within 1.2 degrees of one direction: the depth along it is known to 42 mm only (limit 30 mm). Poke "
        "with another tilt.",
    ),
    (
        StateReason(Cause.ALIKE_AXES, 2, angle=1e-9),
        "All 2 axes lie within 0.1 degrees of one direction: the depth along it is unknown (limit 30 mm). Poke with another "
        "tilt.",
    ),
    (
        StateReason(Cause.ALIKE_AXES, 4, size=1.5, angle=0.01),
        "All 4 axes lie within 0.6 degrees of one direction: the depth along it is known to over 1 m only (limit 30 mm). Poke "
        "with another tilt.",
    ),
    (
        StateReason(Cause.AXES_APART, size=0.15),
        "The axes pass each other at 150 mm from their middle (limit 50 mm): check the arm poses, or exclude the wrong pokes.",
    ),
    (StateReason(Cause.OPPOSED, 2), "The 2 pokes push from opposite sides: exclude the wrong ones."),
    (
        StateReason(Cause.NO_TRIANGLE),
        "No triangle of the surface faces the pokes: check that its normals point outward and the wrench's sign.",
    ),
    (
        StateReason(Cause.OFF_SURFACE, size=0.3),
        "The axes pass the surface at 300 mm (limit 50 mm): check the mesh's unit and pose.",
    ),
    (
        StateReason(Cause.GRAZING),
        "The pokes graze the surface, so that their axes do not fix a point on it to 30 mm: poke steeper.",
    ),
    (StateReason(Cause.MODULE_UNPOKED), "No accepted poke touched its module."),
    (
        StateReason(Cause.MODULE_UNPLACED),
        "Its module answered only beside others, or the plan does not say where it is: poke its own taxels.",
    ),
    (
        StateReason(Cause.MODULE_OFF, size=0.061),
        "The axes pass its module at 61 mm (limit 50 mm): check the mesh's unit and pose, the arm poses, and which channels "
        "the module has.",
    ),
    (
        StateReason(Cause.MODULE_MOVING, size=0.0044),
        "Where its module lies does not settle (to 4.4 mm): poke taxels farther apart, with other tilts.",
    ),
    (
        StateReason(Cause.MODULE_BEHIND),
        "The pokes push its module from behind: check the wrench's sign and the surface's normals.",
    ),
    (
        StateReason(Cause.MODULE_ONE_POKE),
        "One poke on its module does not tell how that is turned. Poke another of its taxels.",
    ),
    (
        StateReason(Cause.MODULE_LOOSE, 5),
        "The 5 pokes on its module do not tell how that lies: poke taxels farther apart, with other tilts.",
    ),
    (
        StateReason(Cause.MODULE_LOOSE, 5, size=0.04),
        "The 5 pokes on its module tell it to worse than 30 mm how that lies: poke taxels farther apart, with other tilts.",
    ),
    (StateReason(Cause.BY_MODULE), "Not poked itself; known by its module."),
    (StateReason(Cause.MEAN_OF_POSES, 3), "Mean of 3 poses."),
    (StateReason(Cause.MEAN_OF_POSES, 2, blind=1), "Mean of 2 poses; 1 are blind and left out."),
    (
        StateReason(Cause.BLIND_IN_POSES, 2, inner=StateReason(Cause.OPPOSED, 4)),
        "Blind in each of its 2 poses. In the one with most pokes: The 4 pokes push from opposite sides: exclude the wrong "
        "ones.",
    ),
    (StateReason(Cause.GIVEN, text="stuck at 255"), "stuck at 255"),
)


@pytest.mark.parametrize(("reason", "sentence"), STATES)
def test_each_state_is_explained(reason, sentence):
    assert state_sentence(reason) == sentence


def test_every_cause_has_a_sentence():
    assert {reason.cause for reason, _ in STATES if reason is not None} == set(Cause)


def test_a_mirrored_module_says_its_turn_only_where_it_has_one():
    plain = Misfit(17, MisfitKind.MIRRORED, 0.0104, 0.0021)
    said = "Module 17 is mirrored against the layout: change its mirror. Its taxels then lie 2 mm off, not 10 mm."
    assert misfit_sentence(plain) == said
    too = replace(plain, turn=float(np.radians(180.0)))
    assert "change its mirror, and its angle_deg by 180 degrees." in misfit_sentence(too)


def test_turned_and_swapped_modules_say_what_to_change():
    turned = Misfit(29, MisfitKind.TURNED, 0.01, 0.002, turn=float(np.radians(-120.0)))
    assert "Module 29 is turned by -120 degrees: change its angle_deg by that." in misfit_sentence(turned)
    swapped = Misfit(3, MisfitKind.SWAPPED, 0.04, 0.001, other=5)
    assert "Module 3 lies where module 5 is planned: give that one its first_channel." in misfit_sentence(swapped)


def test_a_change_says_what_the_file_is_to_say():
    change = ModuleChange(17, angle=float(np.radians(-60.0)), mirror=True)
    assert change_words(change) == "module 17: angle_deg = -60, mirror = true"


@pytest.mark.parametrize(
    ("left", "sentence"),
    [
        (
            Unmended(UnmendedKind.STILL_OFF, (11,), 0.018),
            "Module 11 lies 18 mm off its place even so: poke the modules beside it.",
        ),
        (
            Unmended(UnmendedKind.NO_RING, (3, 7)),
            "Module 3 lies where module 7 is planned, but no exchange leads around to it: poke modules 3 and 7 and those "
            "beside them, so that it is seen where each of them lies.",
        ),
        (
            Unmended(UnmendedKind.UNLIKE, (10, 11)),
            "Modules 10 and 11 lie in each other's places, but they are of different kinds: exchange what the layout says "
            "of their places by hand.",
        ),
        (
            Unmended(UnmendedKind.NO_NEARER, (28,)),
            "Module 28 does not lie as planned, but no change of the layout lies nearer to its taxels: poke it more, and look "
            "at it on the part.",
        ),
        (
            Unmended(UnmendedKind.NO_NEARER, (1, 2, 3, 4, 5, 6)),
            "Modules 1, 2, 3, 4 and 2 more do not lie as planned, but no change of the layout lies nearer to their taxels: "
            "poke them more, and look at them on the part.",
        ),
    ],
)
def test_what_no_layout_puts_right_is_explained(left, sentence):
    assert left_sentences(LayoutMend((), None, (), (left,))) == [sentence]


def test_a_correction_in_use_says_its_misses():
    rig = UsedCorrection(RIG, Correction(np.eye(6)), 0.0074, 0.0012, 21)
    words = "is corrected from 21 landmark pokes: held-out ones pass their landmarks at 1.2 mm with it, at 7.4 mm without"
    assert correction_words(rig) == f"the rig {words}"
    assert correction_sentence(rig) == f"The rig {words}."
    frame = replace(rig, of=FRAME)
    assert correction_words(frame) == f"the sensor's frame {words.replace('held-out ones', 'they')}"


def test_an_answer_on_the_rig_says_what_it_needs_or_found_and_which_pokes_are_doubted():
    trust = {1: 1.0, 2: 0.0, 3: 0.5}
    few = RigAnswer(None, False, np.nan, np.nan, 2, trust, {}, NEITHER, NEITHER)
    needs = "it needs 6 pokes at landmarks, 4 different ones"
    assert rig_sentences(few) == (f"No correction of the rig: {needs}; 3 pokes at 2 are there.",)
    distances = {1: 0.001, 2: 0.014, 3: 0.006}
    good = RigAnswer(Correction(np.eye(6)), True, 0.0074, 0.0012, 6, trust, distances, NEITHER, NEITHER)
    misses = "held-out pokes pass their landmarks at 1.2 mm with a correction made without them, at 7.4 mm without any"
    doubted = (
        "Landmark poke 2 lies 14 mm off its landmark and counts for nothing: was it another point?",
        "Landmark poke 3 lies 6 mm off its landmark and counts 50%.",
    )
    assert rig_sentences(good) == (f"The rig can be corrected: {misses}.", *doubted)
    assert rig_sentences(replace(good, used=False)) == (f"The rig is left as it is: {misses}.", *doubted)


RIGHT = FrameDiagnosis(True, True, True, 0.0024, 0.0024, FrameCorrection())


def wrong(correction):
    return replace(RIGHT, right=False, miss=0.051, corrected_miss=0.006, correction=correction)


def test_a_right_frame_is_said_to_be_and_errors_of_the_rig_are_named():
    assert frame_sentence(RIGHT) == "The sensor's frame is right: pokes pass their landmarks at 2 mm."
    assert frame_sentence(replace(RIGHT, sure=False)).startswith("The sensor's frame looks right: ")
    assert frame_sentence(replace(RIGHT, corrected_miss=0.0074)).endswith(
        "at 7 mm. That is errors of the rig, not of its frame."
    )
    slip = replace(RIGHT, slip=Slip(12, "wrist", 0.044))
    assert frame_sentence(slip).endswith("at 2 mm, but poke 12 passes wrist at 44 mm: was it another point?")
    nothing = replace(RIGHT, right=False, explained=False, miss=0.05)
    assert frame_sentence(nothing).startswith(
        "No known mistake of the frame explains these pokes: they pass their landmarks at 50"
    )


@pytest.mark.parametrize(
    ("correction", "words"),
    [
        (FrameCorrection(-np.eye(3)), "it reports the reaction: all signs are turned"),
        (FrameCorrection(np.diag([-1.0, 1.0, -1.0])), "the sign of x, z is turned"),
        (FrameCorrection(np.eye(3)[[1, 0, 2]]), "its axes are reported in another order: x, y, z are y, x, z"),
        (FrameCorrection(np.diag([1.0, 1.0, -1.0])[[2, 0, 1]]), "its axes are reported in another order: x, y, z are -z, x, y"),
        (FrameCorrection(moment_scale=1e-3), "the moments are newton millimetres, not newton metres"),
        (FrameCorrection(moment_scale=1e-2), "the moments are newton centimetres, not newton metres"),
        (FrameCorrection(moment_scale=GRAVITY), "the moments are kilogram-force metres beside newtons"),
        (FrameCorrection(force_scale=GRAVITY), "the forces are kilogram-force beside newton metres"),
        (
            FrameCorrection(-np.eye(3), GRAVITY),
            "it reports the reaction: all signs are turned; the forces are kilogram-force beside newton metres",
        ),
    ],
)
def test_a_wrong_frame_says_its_mistake_and_both_misses(correction, words):
    said = f"The sensor's frame looks wrong: {words}. As reported, pokes pass their landmarks at 51 mm; so corrected, at 6 mm."
    assert frame_sentence(wrong(correction)) == said


@pytest.mark.parametrize("degrees", [0.0, 25.0, 100.0, 180.0])
def test_a_sensor_that_sits_elsewhere_says_by_how_much(degrees):
    motion = np.eye(4)
    motion[:3, :3] = rotations(np.radians(degrees) * np.array([[0.6, 0.0, 0.8]]))[0]
    motion[:3, 3] = [0.0, 0.03, 0.04]
    said = frame_sentence(wrong(FrameCorrection(motion=motion)))
    assert (
        f"sits elsewhere on the arm than reported, by about {degrees:.0f} degrees and 50 mm, or its matrix is far off." in said
    )
