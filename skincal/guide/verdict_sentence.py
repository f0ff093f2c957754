"""The verdict on a session in one sentence: for the window, the commands and the files."""

from __future__ import annotations

from skincal.guide.progress import Why
from skincal.guide.verdict import Verdict
from skincal.taxels.result import Method


def verdict_sentence(verdict: Verdict) -> str:
    """Return what the session has come to: `"All 84 taxels are done, predicted to 3 mm, and the held-out pokes agree."`.

    Taxels that are predicted to so much and not done, because they need something else, are not counted.
    """
    if not verdict.used:
        return "No taxel is used." if verdict.left else "No taxel has answered yet."
    if verdict.done == verdict.used:
        used = "used " if any(left.why is Why.DEAD for left in verdict.left) else ""
        done = f"All {_taxels(verdict.used, used)} are done, predicted to {1e3 * verdict.wanted:g} mm"
        if verdict.method is Method.MODULES:
            done = f"{done} among each other"
    else:
        done = f"{verdict.done} of {_taxels(verdict.used)} are done"
    early = "" if verdict.enough else "Not enough yet: "
    return f"{early}{done}{_agreement(verdict)}."


def _agreement(verdict: Verdict) -> str:
    check, landmarks = verdict.check, verdict.landmarks
    if not check.believed:
        return ", but the held-out pokes speak against it"
    if landmarks is not None and not landmarks.agrees:
        return ", but the landmarks speak against it"
    if not check.tells:
        return "; too few pokes are held out to check it" if verdict.done else ""
    if not check.agrees:
        return ", but the held-out pokes hardly agree"
    if landmarks is None:
        return ", and the held-out pokes agree; whether the whole skin is shifted, only landmarks show"
    return ", and the held-out pokes and the landmarks agree"


def _taxels(count: int, which: str = "") -> str:
    return f"{count} {which}taxel{'' if count == 1 else 's'}"
