"""Sentences of the verdict on a session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skincal.guide.progress import MIN_CHECKED_POKES, GuideSettings, Need, Why
from skincal.guide.surroundings import SURROUNDING_MAX_SPACINGS
from skincal.guide.verdict import Left, Verdict
from skincal.model.errors import list_channels
from skincal.rig.closing import Closing
from skincal.rig.correction_fit import MIN_LANDMARK_POKES, MIN_LANDMARKS, LandmarkAgreement
from skincal.taxels.result import Method
from skincal.words.poke_words import poke_count_words
from skincal.words.rig_words import closing_sentence, earlier_closings
from skincal.words.taxel_words import counted_states_words, error_words, predicted_words
from skincal.words.units import count, duration, millimetres

NEED_WORDS: Mapping[Need, str] = {
    Need.POKES: "own pokes",
    Need.ACCURACY: "a smaller expected error",
    Need.SIDES: "pokes leaning to other sides",
    Need.BALANCE: "a poke on its other side",
    Need.DEPTH: "pokes that balance its depth",
    Need.SETTLED: "one more poke, since the last one moved its position",
    Need.DECISION: "a poke that decides between two positions",
    Need.TOUCH: "a poke on it, or on taxels on all its sides",
    Need.AGREEMENT: "a poke that agrees with its place",
    Need.TURN: "leaning pokes that show its turn",
}
WHY_WORDS: Mapping[Why, str] = {
    Why.DEAD: "disabled",
    Why.NEVER_FIRED: "never answered at its planned position",
    Why.OUT_OF_REACH: "out of reach: every side of it was skipped",
    Why.TILT: "the tool did not lean far enough to determine its depth",
    Why.AMBIGUOUS: "two positions fit its pokes",
    Why.NOT_CONVERGED: "many pokes were not enough",
    Why.TURN_UNKNOWN: "many pokes did not show its turn",
    Why.CONTRADICTED: "its pokes contradict the place that its module gives it",
    Why.NOT_POKED_ENOUGH: "not pressed enough yet",
}


def verdict_sentence(verdict: Verdict) -> str:
    """Summarize the verdict: `"All 84 taxels are finished. 60 touched, 24 inferred. ..."`."""
    return " ".join(filter(None, (verdict_headline(verdict), verdict_details(verdict))))


def verdict_headline(verdict: Verdict) -> str:
    """Say whether the session is finished, and what speaks against its result.

    Taxels with a small expected error that still need something else are not counted as finished.
    """
    if not verdict.used:
        return "All taxels are disabled." if verdict.left else "No taxel has answered yet."
    doubts = " and ".join(_doubts(verdict))
    return f"{_progress_words(verdict)}{f', but {doubts}' if doubts else ''}."


def _progress_words(verdict: Verdict) -> str:
    """Count the finished taxels, or name what is missing."""
    taxels, given_up = count(verdict.used, "taxel"), verdict.used - verdict.done
    missing = list[str]()
    if verdict.is_finished:
        if given_up:
            return f"{verdict.done} of {taxels} are finished, {given_up} could not be finished"
        used = "used " if any(left.why is Why.DEAD for left in verdict.left) else ""
        return f"All {count(verdict.used, f'{used}taxel')} are finished" if verdict.used > 1 else "The only taxel is finished"
    if verdict.enough and not verdict.done:
        return f"Not finished: none of {taxels} could be finished"
    if given_up:
        missing.append(f"{verdict.done} of {taxels} are finished")
    if verdict.landmarks_left:
        missing.append(f"{count(verdict.landmarks_left, 'landmark poke')} left")
    if verdict.tests_missing and verdict.enough:
        missing.append(f"only {verdict.check.checked} of {MIN_CHECKED_POKES} test pokes could be predicted")
    elif verdict.tests_missing:
        missing.append(f"{count(verdict.tests_missing, 'test poke')} left")
    return f"Not finished: {', '.join(missing)}" if missing else "Not finished yet"


def _doubts(verdict: Verdict) -> list[str]:
    """List what speaks against the result."""
    check, landmarks = verdict.check, verdict.landmarks
    found, against = list[str](), list[str]()
    if verdict.frame_in_doubt:
        found.append("the frame of the force/torque readings is not settled")
    if verdict.off_mesh is not None:
        found.append(f"the touches lie {millimetres(verdict.off_mesh, 0)} off the mesh")
    if verdict.wrong_scale is not None:
        found.append("the drawing of the part seems to have another scale")
    if verdict.has_moved:
        found.append("something has moved since the start")
    elif not verdict.frame_in_doubt:
        # A movement, or a wrong frame, makes test pokes meaningless.
        against += [] if check.believed else ["test pokes"]
        found += ["taxels answer off the plan of their modules"] if check.believed and check.off_plan is not None else []
    found += _contradiction_words(verdict)
    if verdict.axes is not None:
        from skincal.words.axis_words import axes_doubt_words  # other skins do without

        found += filter(None, [axes_doubt_words(verdict.axes)])
    against += [] if landmarks is None or landmarks.agrees else ["landmarks"]
    return [*found, *([f"{' and '.join(against)} contradict it"] if against else [])]


def _contradiction_words(verdict: Verdict) -> list[str]:
    """Name the channels that look exchanged, and the others whose pokes contradict their places."""
    found = list[str]()
    if verdict.exchanged:
        pairs = ", ".join(f"{one} and {other}" for one, other in verdict.exchanged)
        found.append(f"channels {pairs} look exchanged")
    paired = {channel for pair in verdict.exchanged for channel in pair}
    alone = [channel for channel in verdict.contradicted if channel not in paired]
    if alone:
        word = "channel" if len(alone) == 1 else "channels"
        where = "the place that its module gives it" if len(alone) == 1 else "the places that their modules give them"
        found.append(f"all pokes on {word} {list_channels(alone)} contradict {where}")
    return found


def verdict_details(verdict: Verdict) -> str:
    """Complete the headline: states of the taxels, their expected error, test pokes and landmarks."""
    if not verdict.used:
        return ""
    states = counted_states_words(verdict.states)
    error = ""
    if verdict.done == verdict.used and verdict.predicted is not None:
        unchecked = verdict.unchecked
        words = _error_words(verdict) if unchecked else predicted_words(verdict.predicted, apart=False)
        error = f"Expected error {words}."
    return " ".join(filter(None, (f"{states}." if states else "", error, _skin_words(verdict), _landmark_words(verdict))))


def _skin_words(verdict: Verdict) -> str:
    """Say whether test pokes agree, where the headline has no doubt about them."""
    check = verdict.check
    if verdict.frame_in_doubt:
        return (
            f"The messages of the force/torque sensor name the frame {verdict.frame_in_doubt}, and what they mean is not "
            "settled: do not use the positions before it is."
        )
    if verdict.has_moved or not check.believed:
        return ""
    if check.off_plan is not None:
        return off_plan_sentence(check.off_plan)
    if not check.has_enough:
        return ""
    return "Test pokes agree." if check.agrees else "Test pokes hardly agree."


def off_plan_sentence(off_plan: float) -> str:
    """Warn of taxels that answer `off_plan` metres (sd in each direction) off the plan of their modules."""
    return (
        f"Taxels answer about {millimetres(off_plan)} off the plan of their modules (a wrong plan, or uneven sensitivities). "
        "The expected error leaves this out. "
        "Use the surface method, or the free one if there is no mesh: they do not need the plan."
    )


def _landmark_words(verdict: Verdict) -> str:
    """Say whether landmarks agree, where the headline has no doubt: only they reveal a common shift of all taxels."""
    landmarks = verdict.landmarks
    if landmarks is None and verdict.touched_landmarks:
        return (
            f"{count(verdict.touched_landmarks, 'landmark')} cannot check it: a landmark with a wrong place, and so a common "
            f"shift of all taxels, would go unnoticed. Touch {MIN_LANDMARKS}."
        )
    if landmarks is None:
        return "Not checked with landmarks: a common shift of all taxels would go unnoticed."
    if not landmarks.agrees:
        return ""
    if landmarks.driven:
        return driven_sentence(landmarks)
    return f"Landmarks agree only {_noise_words(landmarks)}." if landmarks.by_noise else "Landmarks agree."


def driven_sentence(landmarks: LandmarkAgreement) -> str:
    """Warn of landmarks that a robot drove to by a pose of the part."""
    return (
        f"A robot drove to {landmarks.driven} of {count(landmarks.pokes, 'landmark poke')} by a pose of the part: they agree "
        "under any such pose, and a common shift of all taxels would go unnoticed. "
        f"Guide the tip to {MIN_LANDMARKS} landmarks by hand."
    )


def _error_words(verdict: Verdict) -> str:
    return error_words(verdict.predicted, verdict.unchecked, has_arm=verdict.has_arm)


def _noise_words(landmarks: LandmarkAgreement) -> str:
    return f"with {landmarks.noisier:g} x the noise of the scene file"


def figures(verdict: Verdict) -> tuple[tuple[str, str], ...]:
    """List the numbers behind the verdict, each with its name."""
    states = f": {counted_states_words(verdict.states)}" if verdict.states else ""
    return (
        ("Finished", f"{verdict.done} of {count(verdict.used, 'taxel')} by the {verdict.method.value} method{states}"),
        ("Expected error", _error_words(verdict)),
        ("Finished means", done_words(verdict.method, verdict.wanted)),
        ("Test pokes", check_words(verdict)),
        ("Landmarks", landmark_figure(verdict)),
        ("Final check", closing_words(verdict.closings, has_tool=verdict.has_tool)),
        ("Work", f"{duration(verdict.seconds)}, {poke_count_words(verdict.counts)}"),
    )


def done_words(method: Method, wanted: float) -> str:
    """Describe a finished taxel, `wanted` in metres: `"an expected error of 3 mm or less, 3 own pokes evenly ..."`."""
    settings, most = GuideSettings(), f"{1e3 * wanted:g} mm or less"
    if method is Method.MODULES:
        return (
            f"{most} of its error that more pokes would reduce, {settings.module_pokes} pokes on its module or sheet, and a "
            f"poke on the taxel or on taxels on all its sides within {SURROUNDING_MAX_SPACINGS:g} spacings. The expected error "
            "also has errors that more pokes do not reduce, so it may be larger"
        )
    sides = " and leaning to several sides" if method is Method.FREE else ""
    return f"an expected error of {most}, {settings.own_pokes} own pokes evenly around it{sides}, and a stable position"


def check_words(verdict: Verdict) -> str:
    """Count the test pokes inside their expected range, and say what too few mean."""
    check = verdict.check
    if not check.checked:
        return "none yet"
    words = f"{check.inside} of {count(check.checked, 'test poke')} inside the expected range"
    if check.believed and not check.has_enough:
        return f"{words}: too few for a statement, {MIN_CHECKED_POKES} are needed"
    if check.believed and check.off_plan is not None:
        return f"{words}. {off_plan_sentence(check.off_plan)}"
    if check.agrees:
        return words
    if check.believed:
        return f"{words}, 95 % should be: errors may be larger than expected"
    moved = "the part or the tip moved, and tip_mm and flange of [tool]" if verdict.has_tool else ""
    moved = moved or "the part or the sensor moved, and the frames in the scene"
    return f"{words}: errors are larger than expected. Check whether {moved}."


def landmark_figure(verdict: Verdict) -> str:
    """Say whether landmarks agree, or what the check needs."""
    touched = verdict.touched_landmarks
    if verdict.landmarks is None and touched is not None:
        return f"not checked: {touched} of the {MIN_LANDMARKS} landmarks that it needs were touched"
    return agreement_words(verdict.landmarks, has_arm=verdict.has_arm)


def agreement_words(landmarks: LandmarkAgreement | None, *, has_arm: bool) -> str:
    """Compare the errors at landmarks with their expected size."""
    if landmarks is None:
        return f"not checked: needs {MIN_LANDMARK_POKES} pokes at {MIN_LANDMARKS} landmarks"
    rig = "sensor and arm" if has_arm else "sensor"
    how = f"{rig} corrected without them" if landmarks.corrected else f"{rig} not corrected"
    how = "each predicted from all other touches" if landmarks.by_part else how
    how += f", {_noise_words(landmarks)}" if landmarks.by_noise else ""
    words = f"errors of {count(landmarks.pokes, 'landmark poke')} are {landmarks.ratio:.1f} x the expected size ({how})"
    if landmarks.agrees and landmarks.driven:
        return f"{words}. {driven_sentence(landmarks)}"
    if landmarks.agrees:
        return words
    things = "the landmarks, the sensor and the arm" if has_arm else "the landmarks and the sensor"
    things = "the landmarks and of the tip, and the mesh" if landmarks.by_part else things
    return f"{words}: too large. Check the positions of {things}."


def closing_words(closings: Sequence[Closing], *, has_tool: bool = False) -> str:
    """Say whether anything moved since the start, by the last final check and those before it."""
    if not closings:
        return "not made: it presses a few early points again at the end"
    return " ".join([closing_sentence(closings[-1], has_tool=has_tool), *earlier_closings(closings)])


def left_words(left: Left) -> str:
    """Say why a taxel is not finished: `"not pressed enough yet: needs own pokes"`."""
    why, needs = WHY_WORDS[left.why], needs_clause(left.needs)
    if left.refusal:
        why = f"the robot cannot press it ({left.refusal})"
    return f"{why}: {needs}" if needs else why


def needs_clause(needs: Sequence[Need]) -> str:
    """List the missing things: `"needs own pokes, pokes leaning to other sides"`; empty if nothing is missing."""
    return f"needs {', '.join(NEED_WORDS[need] for need in needs)}" if needs else ""
