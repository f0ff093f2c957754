"""Sentences on results, for the operator: the commands print them, the window shows them, files carry some of them.

The mathematics returns numbers and enums; each of them is put into words here and nowhere else. Pure functions: millimetres
and degrees appear only in their text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import BeforePokes, Rejection
from skincal.model.actions import MissedLandmark
from skincal.model.errors import SENTENCE_MOST, plural
from skincal.model.readings import LinkAnswer, LinkHealth, LinkVerdict, SideReading, Stream
from skincal.model.scene import ContactSettings
from skincal.modules.health import LayoutMend, Misfit, MisfitKind, ModuleChange, Unmended, UnmendedKind
from skincal.rig.closing import Closing, ClosingPlaces
from skincal.rig.correction import FRAME, UsedCorrection
from skincal.rig.correction_fit import DOUBTED, FEWEST, FEWEST_POINTS, RigAnswer
from skincal.rig.frame_check import GRAVITY, FrameCorrection, FrameDiagnosis
from skincal.taxels.result import MISS_MAX, SD_MAX, Cause, StateReason
from skincal.taxels.shared_errors import PredictedError

if TYPE_CHECKING:
    from skincal.modules.distances import TriedDistance

MOST_NAMED = 4
"""Modules that one sentence names; of more the first."""
OF_RIG = 0.005
"""m. Pokes that pass their landmarks at more under a right frame show errors of the rig: noise and a hand make 1 to 3 mm."""

_STATES = {
    Cause.UNPOKED: "No accepted poke touched this taxel.",
    Cause.ONE_AXIS: "One axis only: the depth along it is unknown. Poke once more with another tilt.",
    Cause.ALIKE_AXES: (
        "All {count} axes lie within {degrees:.1f} degrees of one direction: the depth along it {depth} (limit {sd_max}). "
        "Poke with another tilt."
    ),
    Cause.AXES_APART: (
        "The axes pass each other at {mm:.0f} mm from their middle (limit {miss_max}): check the arm poses, or exclude the "
        "wrong pokes."
    ),
    Cause.OPPOSED: "The {count} pokes push from opposite sides: exclude the wrong ones.",
    Cause.NO_TRIANGLE: (
        "No triangle of the surface faces the pokes: check that its normals point outward and the wrench's sign."
    ),
    Cause.OFF_SURFACE: "The axes pass the surface at {mm:.0f} mm (limit {miss_max}): check the mesh's unit and pose.",
    Cause.GRAZING: "The pokes graze the surface, so that their axes do not fix a point on it to {sd_max}: poke steeper.",
    Cause.MODULE_UNPOKED: "No accepted poke touched its module.",
    Cause.MODULE_UNPLACED: (
        "Its module answered only beside others, or the plan does not say where it is: poke its own taxels."
    ),
    Cause.MODULE_OFF: (
        "The axes pass its module at {mm:.0f} mm (limit {miss_max}): check the mesh's unit and pose, the arm poses, and which "
        "channels the module has."
    ),
    Cause.MODULE_MOVING: (
        "Where its module lies does not settle (to {mm:.1f} mm): poke taxels farther apart, with other tilts."
    ),
    Cause.MODULE_BEHIND: "The pokes push its module from behind: check the wrench's sign and the surface's normals.",
    Cause.MODULE_ONE_POKE: "One poke on its module does not tell how that is turned. Poke another of its taxels.",
    Cause.MODULE_LOOSE: ("The {count} pokes on its module {tell} how that lies: poke taxels farther apart, with other tilts."),
    Cause.BY_MODULE: "Not poked itself; known by its module.",
    Cause.SHARED_ERRORS: (
        "With the errors that its pokes share, slow ones and the rig's, it {depth} (limit {sd_max}): poke with other tilts, "
        "and more landmarks."
    ),
    Cause.MEAN_OF_POSES: "Mean of {count} poses{left_out}.",
    Cause.BLIND_IN_POSES: "Blind in each of its {count} poses. In the one with most pokes: {inner}",
    Cause.GIVEN: "{text}",
}
"""Sentences on a taxel's state, filled in by `state_sentence`."""


def state_sentence(reason: StateReason | None) -> str:
    """Return why a taxel's state is what it is; empty for None."""
    if reason is None:
        return ""
    size = reason.size
    return _STATES[reason.cause].format(
        count=reason.count,
        mm=0.0 if size is None else size * 1e3,
        degrees=max(float(np.degrees(reason.angle)), 0.1),
        depth="is unknown" if size is None else f"is known to {_coarse(size)} only",
        tell="do not tell" if size is None else f"tell it to worse than {SD_MAX * 1e3:.0f} mm",
        left_out=f"; {reason.blind} are blind and left out" if reason.blind else "",
        inner=state_sentence(reason.inner),
        text=reason.text,
        miss_max=f"{MISS_MAX * 1e3:.0f} mm",
        sd_max=f"{SD_MAX * 1e3:.0f} mm",
    )


def beside_words(beside: Mapping[str, SideReading]) -> str:
    """Return what a device measured beside its readings: the newest, and between what it was."""
    named = ((*name.partition(", ")[::2], found) for name, found in beside.items())
    return ", ".join(f"{what} {at.now:.1f} {unit} ({at.least:.1f} to {at.most:.1f})" for what, unit, at in named)


def _coarse(metres: float) -> str:
    return f"{metres * 1e3:.0f} mm" if metres < 1.0 else "over 1 m"


def closing_sentence(closing: Closing) -> str:
    """Return whether anything moved between a session's first pokes and those made once more at its end."""
    moved, limit = f"{closing.shift * 1e3:.1f} mm", f"{closing.limit * 1e3:.1f} mm"
    across = "" if closing.seen == 3 else ", across their pushes"
    where = f"{len(closing.names)} {closing.at.value} that were poked once more{across}"
    what = "the sensor or the arm" if closing.at is ClosingPlaces.LANDMARKS else "the sensor, the arm or the skin"
    if closing.hangs_on_one:
        place = closing.place if closing.at is ClosingPlaces.LANDMARKS else f"taxel {closing.place}"
        return (
            f"Only poke {closing.poke} at {place} says that {what} has moved since the start, by {moved} ({where}; noise alone "
            f"makes up to {limit}). The others do not, so it may have slipped: poke {place} once more, or check again."
        )
    if not closing.moved:
        return f"Nothing is seen to have moved since the start: {moved} at {where}, and noise alone makes up to {limit}."
    return (
        f"Since the start {what} has moved by {moved} ({where}; noise alone makes up to {limit}): fasten it, and check again."
    )


def earlier_closings(closings: Sequence[Closing]) -> list[str]:
    """Return what the closing checks before the last one found, in a sentence; none where there was none."""
    found = [f"{each.shift * 1e3:.1f} mm after poke {each.after}{_judged(each)}" for each in closings[:-1]]
    return [f"Checked before: {', '.join(found)}."] if found else []


def _judged(closing: Closing) -> str:
    if closing.hangs_on_one:
        return f" (only poke {closing.poke} says so)"
    return " (moved)" if closing.moved else ""


def rejection_words(outcome: Rejection) -> str:
    """Return why a poke does not count: `"too soft (2.1, limit 4 N)"`."""
    return f"{outcome.reason.value} ({f'{outcome.value:.4g}, limit {outcome.limit:.4g} {outcome.unit}'.rstrip()})"


def missed_words(missed: MissedLandmark) -> str:
    """Return how far a poke passed the landmark that was asked for: `"passes wrist, top at 52 mm, at most 34 mm"`."""
    if missed.behind:
        return f"pushes at another side than that of {missed.name}"
    return f"passes {missed.name} at {missed.miss * 1e3:.0f} mm, at most {missed.limit * 1e3:.0f} mm"


def misfit_sentence(misfit: Misfit) -> str:
    """Return what is wrong with a module, what would put it right, and how far its taxels lie off then and now."""
    turn = f"{np.degrees(misfit.turn):.0f}"
    too = f", and its angle_deg by {turn} degrees" if misfit.turn else ""
    what = {
        MisfitKind.MIRRORED: f"is mirrored against the layout: change its mirror{too}",
        MisfitKind.TURNED: f"is turned by {turn} degrees: change its angle_deg by that",
        MisfitKind.SWAPPED: f"lies where module {misfit.other} is planned: give that one its first_channel",
    }[misfit.kind]
    off = f"{misfit.after * 1e3:.0f} mm off, not {misfit.before * 1e3:.0f} mm"
    return f"Module {misfit.module} {what}. Its taxels then lie {off}."


def change_words(change: ModuleChange) -> str:
    """Return what a layout is to say of one module: `"module 17: angle_deg = -60, mirror = true"`."""
    values = ", ".join(f"{key} = {str(value).lower()}" for key, value in change.keys.items())
    return f"module {change.module}: {values}"


def left_sentences(mend: LayoutMend) -> list[str]:
    """Return what another layout cannot put right, and why, one sentence each."""
    return [_unmended_sentence(left) for left in mend.left]


def _unmended_sentence(left: Unmended) -> str:
    numbers = left.modules
    if left.kind is UnmendedKind.STILL_OFF:
        return f"Module {numbers[0]} lies {left.off * 1e3:.0f} mm off its place even so: poke the modules beside it."
    if left.kind is UnmendedKind.NO_RING:
        start, other = numbers
        return (
            f"Module {start} lies where module {other} is planned, but no exchange leads around to it: "
            f"poke modules {start} and {other} and those beside them, so that it is seen where each of them lies."
        )
    if left.kind is UnmendedKind.UNLIKE:
        return (
            f"Modules {_named(numbers)} lie in each other's places, but they are of different kinds: exchange what the "
            "layout says of their places by hand."
        )
    many = len(numbers) > 1
    return (
        f"Module{'s' if many else ''} {_named(numbers)} {'do' if many else 'does'} not lie as planned, but no change of the "
        f"layout lies nearer to {'their' if many else 'its'} taxels: poke {'them' if many else 'it'} more, and look at "
        f"{'them' if many else 'it'} on the part."
    )


def _named(numbers: Sequence[int]) -> str:
    named = [str(number) for number in numbers[:MOST_NAMED]]
    if len(numbers) > MOST_NAMED:
        return f"{', '.join(named)} and {len(numbers) - MOST_NAMED} more"
    return " and ".join(filter(None, (", ".join(named[:-1]), named[-1])))


def correction_words(used: UsedCorrection) -> str:
    """Return what was corrected, with the miss before and after; no full stop, since files put it into comments."""
    after, before = f"{used.after * 1e3:.1f} mm", f"{used.before * 1e3:.1f} mm"
    who = "they" if used.of == FRAME else "held-out ones"
    what = "the sensor's frame" if used.of == FRAME else "the rig"
    misses = f"{who} pass their landmarks at {after} with it, at {before} without"
    return f"{what} is corrected from {used.pokes} landmark pokes: {misses}"


def correction_sentence(used: UsedCorrection) -> str:
    """Return `correction_words` as a sentence."""
    words = correction_words(used)
    return f"{words[0].upper()}{words[1:]}."


def rig_sentences(answer: RigAnswer) -> tuple[str, ...]:
    """Return whether a rig can be corrected, then which landmark pokes count less."""
    if answer.correction is None:
        needs = f"it needs {FEWEST} pokes at landmarks, {FEWEST_POINTS} different ones"
        return (f"No correction of the rig: {needs}; {len(answer.trust)} pokes at {answer.points} are there.",)
    before, after = f"{answer.before * 1e3:.1f} mm", f"{answer.after * 1e3:.1f} mm"
    misses = f"held-out pokes pass their landmarks at {after} with a correction made without them, at {before} without any"
    first = f"The rig can be corrected: {misses}." if answer.used else f"The rig is left as it is: {misses}."
    doubted = [
        f"Landmark poke {poke} lies {answer.distances[poke] * 1e3:.0f} mm off its landmark and counts "
        + ("for nothing: was it another point?" if trust <= 0 else f"{trust:.0%}.")
        for poke, trust in answer.trust.items()
        if trust < DOUBTED
    ]
    return (first, *doubted)


def distance_sentences(tried: Sequence[TriedDistance]) -> list[str]:
    """Return how many known distances between modules are used, then of each other one why not; none where none is known."""
    if not tried:
        return []
    said = [f"{sum(each.used for each in tried)} of {plural(len(tried), 'known distance')} between modules used."]
    for each in (each for each in tried if not each.used):
        kind, (one, other) = "taxels" if each.told.of_taxels else "modules", each.told.ends
        found, told = "", f"{each.told.length * 1e3:.1f} mm"
        if each.found is not None and each.sd is not None:
            found = f" (pokes alone make it {each.found * 1e3:.1f} mm, and should lie within {2e3 * each.sd:.1f} mm of it)"
        said.append(f"The distance between {kind} {one} and {other}, {told}, is not used: {each.use.value}{found}.")
    return said


def predicted_words(found: PredictedError, *, apart: bool = True) -> str:
    """Return the predicted error of a skin: `"1.1 mm mean, 1.7 mm worst"`.

    Parameters
    ----------
    apart : also what of it the whole skin and taxels among each other have, where errors are known that all share
    """
    words = f"{found.mean * 1e3:.1f} mm mean, {found.worst * 1e3:.1f} mm worst"
    if not apart or not found.whole:
        return words
    return (
        f"{words}: the whole skin may be off by {found.whole * 1e3:.1f} mm, "
        f"taxels among each other by {found.among * 1e3:.1f} mm"
    )


def error_words(found: PredictedError | None, off: float | None) -> str:
    """Return the predicted error of a skin and what it leaves out; no full stop, since files put it into comments.

    Parameters
    ----------
    found : None where no taxel is known
    off : m, by how much an ordinary rig's own errors move the taxels besides; None where they are predicted, too
    """
    if found is None:
        return "no taxel is known"
    if off is None:
        return predicted_words(found)
    return f"{predicted_words(found, apart=False)}, for a right rig; an ordinary one's own errors add about {off * 1e3:.1f} mm"


def unchecked_sentence(off: float, landmark_pokes: int) -> str:
    """Return by how much the errors of a rig that is not corrected may move the taxels, `off` metres, root mean square.

    `landmark_pokes` is how many were made, which `off` knows of.
    """
    leave = "leaves" if landmark_pokes == 1 else "leave"
    tell = f"{plural(landmark_pokes, 'poke')} at landmarks {leave} that open." if landmark_pokes else "Pokes at landmarks tell."
    return (
        f"The rig's own errors are not in the predicted ones: an ordinary rig's move the taxels by about {off * 1e3:.1f} mm, "
        f"most of it alike. {tell}"
    )


def frame_sentence(found: FrameDiagnosis) -> str:
    """Return what landmark pokes say of the sensor's frame, with the miss as reported and as corrected."""
    reported = f"{found.miss * 1e3:.0f} mm"
    if not found.explained:
        return (
            f"No known mistake of the frame explains these pokes: they pass their landmarks at {reported}; poke again, and "
            "look at the landmarks' places."
        )
    slip = "."
    if found.slip is not None:
        off = f"{found.slip.miss * 1e3:.0f} mm"
        slip = f", but poke {found.slip.poke} passes {found.slip.name} at {off}: was it another point?"
    passes = f"{found.corrected_miss * 1e3:.0f} mm{slip}"
    if found.right:
        # Right, and off by a centimetre, reads like a contradiction.
        whose = " That is errors of the rig, not of its frame." if found.corrected_miss > OF_RIG else ""
        return f"The sensor's frame {'is' if found.sure else 'looks'} right: pokes pass their landmarks at {passes}{whose}"
    wrong = f"The sensor's frame looks wrong: {_mistake_words(found.correction)}."
    return f"{wrong} As reported, pokes pass their landmarks at {reported}; so corrected, at {passes}"


def _mistake_words(found: FrameCorrection) -> str:
    """Return what is wrong with a frame that needs this correction."""
    if not np.array_equal(found.motion, np.eye(4)):
        turn, shift = found.motion[:3, :3], 1e3 * float(np.linalg.norm(found.motion[:3, 3]))
        # Of a small turn the cosine has no digits, of one near a half turn the sine has none.
        sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        angle = np.degrees(np.arctan2(sine, np.trace(turn) - 1.0))
        return (
            f"the sensor sits elsewhere on the arm than reported, by about {angle:.0f} degrees and {shift:.0f} mm, or its "
            "matrix is far off"
        )
    return "; ".join(filter(None, (_axes_words(found.axes), _unit_words(found))))


def _unit_words(found: FrameCorrection) -> str:
    if found.force_scale == GRAVITY:
        return "the forces are kilogram-force beside newton metres"
    return {
        1.0: "",
        1e-3: "the moments are newton millimetres, not newton metres",
        1e-2: "the moments are newton centimetres, not newton metres",
        GRAVITY: "the moments are kilogram-force metres beside newtons",
    }[found.moment_scale]


def _axes_words(axes: np.ndarray) -> str:
    """Return what an order of the axes with signs is, in words; empty for the one reported."""
    # A row holds a single entry, 1 or -1: its sum is the sign.
    order, signs = np.abs(axes).argmax(axis=1).tolist(), axes.sum(axis=1).tolist()
    if order == [0, 1, 2]:
        turned = ["xyz"[axis] for axis, sign in enumerate(signs) if sign < 0]
        if len(turned) == 3:
            return "it reports the reaction: all signs are turned"
        return f"the sign of {', '.join(turned)} is turned" if turned else ""
    named = [f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True)]
    return f"its axes are reported in another order: x, y, z are {', '.join(named)}"


def no_poke_sentence(seen: BeforePokes, thresholds: ContactSettings) -> str:
    """Return what a recording without a poke showed, what a poke would have been, and what may be put right."""
    if not seen.samples:
        return (
            "No poke was found: no skin frame has a wrench of its time; expected both to be recorded at the same time. "
            "Check that the recordings belong together."
        )
    looked = f"No poke was found in {plural(seen.samples, 'frame')} of the skin with their wrenches, over {seen.seconds:.0f} s"
    if not seen.tared:
        return (
            f"{looked}: the force never rested; expected {thresholds.quiet_s:g} s without a touch before a poke. Check the "
            "force sensor's noise and the unit of its readings."
        )
    if seen.answered:
        skin, check = f"{plural(seen.answered, 'taxel')} answered", "the unit of the wrenches"
    elif seen.fell:
        skin = f"no taxel answered, but {seen.fell} fell below their rest"
        check = "the skin's polarity in the scene and the unit of the wrenches"
    else:
        skin, check = "no taxel answered", "that the part was poked, and the unit of the wrenches"
    return (
        f"{looked}: the strongest force beside its rest is {seen.strongest:.2g} N, and {skin}; expected a touch of "
        f"{thresholds.touch_force:g} N or more. Check {check}, or lower touch_force in the scene's [contacts]."
    )


SENTENCE_ROOM = 30
"""Characters for what follows on silent links: `"No session was made."`."""


def silent_links(links: Sequence[LinkHealth]) -> str:
    """Return sentences on the links that gave no reading that could be used; empty if all gave some."""
    said = [
        " ".join(
            f"{link.link} gave no reading that can be used: {_why_silent(link, brief=brief).rstrip('.')}."
            for link in links
            if not link.readings
        )
        for brief in (False, True)
    ]
    return said[0] if len(said[0]) < SENTENCE_MOST - SENTENCE_ROOM else said[1]


def _why_silent(link: LinkHealth, *, brief: bool) -> str:
    verdict = link.verdict
    if verdict.answer is LinkAnswer.OTHER_STREAM and verdict.found is not None:
        return (
            f"this is the {STREAM_NAMES[verdict.found]}: its lines have {verdict.width} values; give each address to its stream"
        )
    if link.text:  # the device's own last words say more than what can be guessed from its bytes
        # What to do was said as it failed.
        return link.text.partition(";")[0] if brief else link.text
    if not link.last_host_ns:
        return "nothing arrived; check the device's power, its cable and its baud rate"
    expected = " and ".join(stream.value for stream in link.carries)
    return f"bytes arrived, but none of them {expected} readings; check the baud rate and what the device sends"


STREAM_NAMES = {Stream.WRENCH: "F/T sensor", Stream.SKIN: "skin", Stream.JOINTS: "joints"}
_HAS = {Stream.WRENCH: "a wrench has", Stream.SKIN: "the scene has", Stream.JOINTS: "the arm needs"}


def link_verdict_words(verdict: LinkVerdict) -> str:
    """Return what is found of a link, in few words; a sentence on why it does not open is the link's own."""
    match verdict.answer:
        case LinkAnswer.GOOD:
            return "good; no value has changed yet, press the skin once" if verdict.unchanged else "good"
        case LinkAnswer.NO_READING:
            tried = f" (tried {', '.join(map(str, verdict.tried))})" if verdict.tried else " Another device?"
            return f"bytes arrive but none is a reading: another baud rate?{tried}"
        case LinkAnswer.OTHER_STREAM:
            found = STREAM_NAMES[verdict.found or Stream.SKIN]
            return f"this is the {found}: its lines have {verdict.width} values. Swap?"
        case LinkAnswer.OTHER_WIDTH:
            return f"{plural(verdict.width, 'value')} where {_HAS[verdict.stream or Stream.SKIN]} {verdict.expected}"
        case LinkAnswer.FROZEN:
            return "values never change: the sensor stopped, or its driver repeats one reading"
        case LinkAnswer.LISTENING | LinkAnswer.NO_ANSWER:
            return verdict.answer.value
