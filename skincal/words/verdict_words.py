"""The verdict on a session, put into words, for the window, the commands, files and reports: pure functions."""

from __future__ import annotations

from collections.abc import Sequence

from skincal.guide.progress import GuideSettings, Why
from skincal.guide.verdict import Left, Verdict
from skincal.model.errors import plural
from skincal.rig.closing import Closing
from skincal.rig.correction_fit import FEWEST, FEWEST_POINTS, LandmarkAgreement
from skincal.taxels.result import Method
from skincal.words.rig_words import closing_sentence, earlier_closings
from skincal.words.taxel_words import error_words


def verdict_sentence(verdict: Verdict) -> str:
    """Return what the session has come to: `"All 84 taxels are done, predicted to 3 mm, and the held-out pokes agree."`.

    Taxels that are predicted to so much and not done, because they need something else, are not counted.
    """
    if not verdict.used:
        return "No taxel is used." if verdict.left else "No taxel has answered yet."
    if verdict.done == verdict.used:
        used = "used " if any(left.why is Why.DEAD for left in verdict.left) else ""
        done = f"All {plural(verdict.used, used + 'taxel')} are done, predicted to {1e3 * verdict.wanted:g} mm"
        if verdict.method is Method.MODULES:
            done = f"{done} among each other"
    else:
        given_up = f", {verdict.used - verdict.done} given up" if verdict.enough else ""
        done = f"{verdict.done} of {plural(verdict.used, 'taxel')} are done{given_up}"
    early = "" if verdict.enough else "Not enough yet: "
    if early and verdict.done == verdict.used:
        early, done = "Not enough yet, though ", f"all{done.removeprefix('All')}"
    left = verdict.landmarks_left if verdict.done == verdict.used else 0
    asked = f", {plural(left, 'poke')} at landmarks to go" if left else ""
    return f"{early}{done}{asked}{_agreement(verdict)}."


def _agreement(verdict: Verdict) -> str:
    """Return what held-out pokes say, then what landmarks say, whatever the pokes said: only they show a shift of all."""
    if verdict.believed and not verdict.moved:
        return ", and the held-out pokes and the landmarks agree"
    return f"{_skin_words(verdict)}; {_landmark_clause(verdict.landmarks)}"


def _skin_words(verdict: Verdict) -> str:
    check = verdict.check
    if verdict.moved:
        return ", but something has moved since the start"
    if not check.believed:
        return ", but the held-out pokes speak against it"
    if not check.tells:
        return "; too few pokes are held out to check it" if verdict.done else ""
    return ", and the held-out pokes agree" if check.agrees else ", but the held-out pokes hardly agree"


def _landmark_clause(landmarks: LandmarkAgreement | None) -> str:
    if landmarks is None:
        return "landmarks did not check it, so a shift that all taxels share would not show"
    if not landmarks.agrees:
        return "the landmarks speak against it"
    return f"the landmarks agree only {_noise_words(landmarks)}" if landmarks.by_noise else "the landmarks agree"


def _noise_words(landmarks: LandmarkAgreement) -> str:
    return f"with noise {landmarks.noisier:g} times the scene's"


def figures(verdict: Verdict) -> tuple[tuple[str, str], ...]:
    """Return the numbers behind the sentence, each with its name."""
    return (
        ("Done", f"{verdict.done} of {plural(verdict.used, 'taxel')}, {verdict.method.value} method"),
        ("Needs", done_words(verdict.method, verdict.wanted)),
        ("Check", check_words(verdict)),
        ("Landmarks", landmark_words(verdict.landmarks)),
        ("Closing", closing_words(verdict.closings)),
        ("Predicted error", error_words(verdict.predicted, verdict.unchecked)),
        ("Work", f"{plural(verdict.pokes, 'poke')} on the skin that count, in {_minutes(verdict.seconds)}"),
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
    words = f"{check.inside} of {plural(check.checked, 'held-out poke')} fell where the others predicted"
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
    how += f", {_noise_words(landmarks)}" if landmarks.by_noise else ""
    words = f"{plural(landmarks.pokes, 'poke')}, {how}, pass them at {landmarks.ratio:.1f} times what is predicted"
    if landmarks.agrees:
        return words
    return f"{words}: the errors are larger than predicted. Look at the landmarks' places and at the rig."


def closing_words(closings: Sequence[Closing]) -> str:
    """Return whether anything moved since the start, by the last check, and what those before it found."""
    if not closings:
        return "not checked: at the end some of the first places are poked once more"
    return " ".join([closing_sentence(closings[-1]), *earlier_closings(closings)])


def left_words(left: Left) -> str:
    """Return why a taxel is not done: `"not poked enough yet: needs pokes of its own"`."""
    needs = ", ".join(need.value for need in left.needs)
    return f"{left.why.value}: needs {needs}" if needs else left.why.value


def _minutes(seconds: float) -> str:
    return f"{max(1, round(seconds / 60.0))} min"
