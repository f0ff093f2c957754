"""The verdict on a session, put into words: pure functions, without Qt."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from app.state.policies import Offer
from app.text.outcomes import METHOD_NAMES
from app.text.rig_text import offer_words
from app.units import count, millimetres, minutes, number
from skincal.guide.progress import GuideSettings
from skincal.guide.verdict import Left, Verdict
from skincal.rig.correction import UsedCorrection
from skincal.rig.correction_fit import FEWEST, FEWEST_POINTS, LandmarkAgreement
from skincal.sentences import correction_sentence, rig_sentences
from skincal.session.review import Review
from skincal.taxels.result import Method


def figures(verdict: Verdict) -> tuple[tuple[str, str], ...]:
    """Return the numbers behind the sentence, each with its name."""
    return (
        ("Done", f"{verdict.done} of {count(verdict.used, 'taxel')}, {METHOD_NAMES[verdict.method]} method"),
        ("Needs", done_words(verdict.method, verdict.wanted)),
        ("Check", check_words(verdict)),
        ("Landmarks", landmark_words(verdict.landmarks)),
        ("Predicted", predicted_words(verdict)),
        ("Work", f"{count(verdict.pokes, 'poke')} in {minutes(verdict.seconds)}"),
    )


def done_words(method: Method, wanted: float) -> str:
    """Return what makes a taxel done, `wanted` in metres: `"a predicted error of 3 mm or less, and 4 pokes on its module"`."""
    settings = GuideSettings()
    error = f"a predicted error of {1e3 * wanted:g} mm or less"
    if method is Method.MODULES:
        return f"{error} beside what all taxels share, and {settings.module_pokes} pokes on its module"
    sides = "tilted to several sides and " if method is Method.FREE else ""
    return f"{error}, {settings.own_pokes} pokes of its own {sides}evenly around it, and the last hardly moved it"


def check_words(verdict: Verdict) -> str:
    """Return how many held-out pokes fell where they were predicted, and what it means where these are too few."""
    check = verdict.check
    if not check.checked:
        return "no poke could be held out yet"
    words = f"{check.inside} of {count(check.checked, 'held-out poke')} fell where the others predicted"
    if check.believed and not check.tells:
        return f"{words}: too few to say anything"
    if check.agrees:
        return words
    if check.believed:
        return f"{words}, of 20 it should be 19: the errors may be larger than predicted"
    return (
        f"{words}: the errors are larger than predicted. Look whether the part or the sensor moved, and at the scene's frames."
    )


def landmark_words(landmarks: LandmarkAgreement | None) -> str:
    """Return how landmarks are passed, over what is predicted for them."""
    if landmarks is None:
        return f"not checked: it needs {FEWEST} pokes at {FEWEST_POINTS} landmarks"
    how = "held out of the correction" if landmarks.corrected else "without a correction"
    words = f"{count(landmarks.pokes, 'poke')}, {how}, pass them at {number(landmarks.ratio, 1)} times what is predicted"
    if landmarks.agrees:
        return words
    return f"{words}: the errors are larger than predicted. Look at the landmarks' places and at the rig."


def predicted_words(verdict: Verdict) -> str:
    """Return the predicted error, told apart: the whole skin, and taxels among each other."""
    predicted, unchecked = verdict.predicted, verdict.unchecked
    if predicted is None:
        return "no taxel is known"
    if unchecked is None:
        return (
            f"{millimetres(predicted.every)}: the whole skin may be off by {millimetres(predicted.whole)}, "
            f"taxels among each other by {millimetres(predicted.among)}"
        )
    return f"{millimetres(predicted.every)} for a right rig; an ordinary one's own errors add about {millimetres(unchecked)}"


def rig_state(offers: Sequence[Offer], used: Iterable[UsedCorrection], review: Review | None) -> str:
    """Return what is known of the rig's own errors, which held-out pokes of the skin hardly show."""
    if offers:
        return f"{offer_words(offers[0])} C uses that, the Rig tab says more."
    in_use = " ".join(correction_sentence(correction) for correction in used)
    if in_use:
        return in_use
    if review is not None and review.pokes:
        return rig_sentences(review.rig)[0]
    return "not checked, since landmarks were not poked: an error of the sensor's matrix or of the arm moves all taxels alike"


def left_words(left: Left) -> str:
    """Return why a taxel is not done: `"not poked enough yet: needs pokes of its own"`."""
    needs = ", ".join(need.value for need in left.needs)
    return f"{left.why.value}: needs {needs}" if needs else left.why.value
