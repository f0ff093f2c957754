"""Sentences on the estimates of taxels and their expected errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.model.errors import list_channels
from skincal.taxels.poke_figures import miss_of
from skincal.taxels.result import (
    FORCE_AXIS_MAX_MISS_M,
    MIN_TRUST_OF_A_TOUCH,
    POSITION_MAX_SD_M,
    Cause,
    Estimate,
    State,
    StateReason,
)
from skincal.taxels.shared_errors import PredictedError, known_error, predicted_error
from skincal.words.units import ChannelNames, count, grouped, millimetres, number

_STATE_OF = attrgetter("state")
STATE_SENTENCES = {
    Cause.UNPOKED: "No accepted poke touched this taxel.",
    Cause.ONE_AXIS: "All pokes came from one direction, so the depth is unknown. Press again, leaning another way.",
    Cause.ALIKE_AXES: (
        "All {count} pokes came from directions within {degrees:.1f} degrees, so the depth {depth} (limit {sd_max}). "
        "Press again, leaning another way."
    ),
    Cause.AXES_APART: (
        "The force axes of its pokes miss each other by {mm:.0f} mm (limit {miss_max}). Check the arm poses, or exclude the "
        "wrong pokes."
    ),
    Cause.OPPOSED: "The {count} pokes press from opposite sides. Exclude the wrong ones.",
    Cause.NO_TRIANGLE: (
        "No part of the mesh faces the pokes. Check that its normals point outward, and the sign of the force."
    ),
    Cause.OFF_SURFACE: "The force axes miss the mesh by {mm:.0f} mm (limit {miss_max}). Check unit and pose of the mesh.",
    Cause.GRAZING: "The pokes are almost parallel to the surface, so the position is worse than {sd_max}. Press more upright.",
    Cause.MODULE_UNPOKED: "No accepted poke touched its module.",
    Cause.MODULE_UNPLACED: (
        "Its module answered only together with others, or the layout does not place it. Press its own taxels."
    ),
    Cause.MODULE_OFF: (
        "The force axes miss its module by {mm:.0f} mm (limit {miss_max}). Check the unit and pose of the mesh, the arm "
        "poses, and the channels of the module."
    ),
    Cause.MODULE_MOVING: (
        "The position of its module still changes by {mm:.1f} mm. Press taxels farther apart, leaning other ways."
    ),
    Cause.MODULE_BEHIND: "The pokes press its module from behind. Check the sign of the force and the normals of the mesh.",
    Cause.MODULE_ONE_POKE: "One poke on its module does not show how the module is turned. Press another of its taxels.",
    Cause.MODULE_LOOSE: "The {count} pokes on its module {tell}. Press taxels farther apart, leaning other ways.",
    Cause.BY_MODULE: "Inferred: no accepted poke touched it, or outliers alone; its module places it.",
    Cause.CONTRADICTED: (
        "The force axes of its own pokes ({count}) miss the place that its module gives it by {mm:.0f} mm. Press it again. If "
        "they still miss it, its channel may be exchanged with another: check the layout."
    ),
    Cause.CLAIMED: (
        "Channel {count} answers at its place, and it does not: the two channels may be exchanged. Check the layout."
    ),
    Cause.PART_UNPLACED: "The part's pose in the base of the tool's poses is not known yet.",
    Cause.SHARED_ERRORS: (
        "With the errors of the rig included, its position {depth} (limit {sd_max}). Press again, leaning other ways, and "
        "press more landmarks."
    ),
    Cause.MEAN_OF_POSES: "Mean of {count} arm poses{left_out}.",
    Cause.BLIND_IN_POSES: "Undetermined in each of {count} arm poses. In the one with most pokes: {inner}",
    Cause.EXTERNAL_TEXT: "{text}",
}
"""Sentences on a taxel's state, filled in by `state_sentence`."""


def state_sentence(reason: StateReason | None) -> str:
    """Say why a taxel has its state; empty for `None`."""
    if reason is None:
        return ""
    size = reason.size
    coarse = "" if size is None else millimetres(size, 0) if size < 1.0 else "over 1 m"
    return STATE_SENTENCES[reason.cause].format(
        count=reason.count,
        mm=0.0 if size is None else size * 1e3,
        degrees=max(float(np.degrees(reason.angle)), 0.1),
        depth="is unknown" if size is None else f"is only known to {coarse}",
        tell="do not determine its pose" if size is None else f"determine its pose only to {millimetres(POSITION_MAX_SD_M, 0)}",
        left_out=f"; {reason.blind} undetermined poses are left out" if reason.blind else "",
        inner=state_sentence(reason.inner),
        text=reason.text,
        miss_max=millimetres(FORCE_AXIS_MAX_MISS_M, 0),
        sd_max=millimetres(POSITION_MAX_SD_M, 0),
    )


STATE_WORDS = {
    State.TOUCHED: "accepted contacts of their own",
    State.INFERRED: "no contact of their own that counts, placed by their module or neighbours",
    State.BLIND: "no position: contacts do not determine it, or contradict it",
    State.UNSEEN: "no position: no contact",
    State.DEAD: "no position: not used",
}
"""Meanings of the states, for files."""


def state_count_words(estimates: Iterable[Estimate]) -> str:
    """Count taxels by state: `"28 touched, 20 inferred, 3 untouched"`; states of no taxel are left out."""
    # By identity: Python hashes an enum slowly, and this is asked after each poke on a whole body.
    counts = Counter(map(id, map(_STATE_OF, estimates)))
    return counted_states_words({state: counts[id(state)] for state in State})


def counted_states_words(counts: Mapping[State, int]) -> str:
    """List the number of taxels in each state; see `state_count_words`."""
    return ", ".join(f"{grouped(counts[state])} {state.value}" for state in State if counts.get(state))


def state_lines(estimates: Iterable[Estimate]) -> list[str]:
    """List the channels of each state, for a file's comments: `"inferred (...): channels 3-5, 9"`."""
    channels: dict[State, list[int]] = {state: [] for state in State}
    for estimate in estimates:
        channels[estimate.state].append(estimate.channel)
    return [
        f"{state.value} ({STATE_WORDS[state]}): channels {list_channels(some, max_ranges=len(some))}"
        for state, some in channels.items()
        if some
    ]


NOT_KNOWN_YET = "not known yet"


def taxel_error_words(estimate: Estimate, part_size: float) -> str:
    """Format the expected error of a taxel: `"1.1 mm"`, or that it is not known yet (`known_error`)."""
    error = known_error(estimate, part_size)
    return NOT_KNOWN_YET if error is None and estimate.rms is not None else millimetres(error)


def predicted_words(found: PredictedError, *, apart: bool = True) -> str:
    """Format the expected error of a skin: `"1.1 mm mean, 1.7 mm worst"`.

    Parameters
    ----------
    apart : also split it into the shared shift of the whole skin and the error of taxels relative to each other
    """
    if np.isnan(found.mean):
        return NOT_KNOWN_YET
    words = f"{millimetres(found.mean)} mean, {millimetres(found.worst)} worst"
    if found.unknown:
        words += f", {NOT_KNOWN_YET} for {count(found.unknown, 'taxel')}"
    if not apart or not found.whole:
        return words
    return (
        f"{words}: the whole skin may be shifted by {millimetres(found.whole)}, "
        f"single taxels relative to it by {millimetres(found.among)}"
    )


def error_words(found: PredictedError | None, off: float | None, *, has_arm: bool) -> str:
    """Format the expected error of a skin and what it leaves out; without a full stop, since files use it in comments.

    Parameters
    ----------
    found : `None` if no taxel is estimated
    off : m, additional error of an uncorrected sensor and arm; `None` if `found` includes it
    """
    if found is None:
        return "no taxel is estimated"
    if off is None or np.isnan(found.mean):
        return predicted_words(found)
    return f"{predicted_words(found, apart=False)}; errors of {rig_name(has_arm)} may add about {millimetres(off)}"


def rig_name(has_arm: bool) -> str:
    """Name the parts of a rig whose errors shift taxels."""
    return "sensor and arm" if has_arm else "the sensor"


def unchecked_sentence(off: float, landmark_pokes: int, *, has_arm: bool) -> str:
    """Format the possible shift of the taxels by an uncorrected sensor and arm: `off` metres, root mean square."""
    advice = "Press landmarks to measure them."
    if landmark_pokes:
        where = ", also in other arm poses" if has_arm else ""
        advice = (
            f"{count(landmark_pokes, 'landmark poke')} cannot rule that out. Press landmarks again{where}: "
            "more pokes narrow it down."
        )
    return (
        f"The expected error leaves out errors of {rig_name(has_arm)}. "
        f"They usually shift the skin by about {millimetres(off)}. {advice}"
    )


def summary_words(estimates: Sequence[Estimate]) -> str:
    """Count the taxels of one method by their state: `"48 taxels: 28 touched, 20 inferred"`."""
    return f"{count(len(estimates), 'taxel')}: {state_count_words(estimates)}"


def skin_error_words(estimates: Sequence[Estimate], part_size: float) -> str:
    """Say the expected error of the estimated taxels; empty if there are none. `part_size` is that of the snapshot."""
    found = predicted_error(estimates, part_size)
    return "" if found is None else f"expected error {predicted_words(found, apart=False)}"


def doubt_mark(poke: int, doubters: Sequence[Estimate], names: ChannelNames) -> str:
    """Mark of a doubted poke in the list: `"weight 0.2 for taxel 205"`; may be empty."""
    marked = [e for e in doubters if e.doubted[poke] < MIN_TRUST_OF_A_TOUCH]
    if not marked:
        return ""
    more = f" +{len(marked) - 1}" if len(marked) > 1 else ""
    return f"weight {number(marked[0].doubted[poke], 1)} for {names.taxel(marked[0].channel)}{more}"


def doubt_words(contact: Contact, estimate: Estimate, names: ChannelNames) -> str:
    """Give the trust in a poke for a taxel, and the reason."""
    words = f"weight {number(estimate.doubted[contact.poke], 2)} for {names.taxel(estimate.channel)}"
    miss = miss_of(contact, estimate)
    return words if miss is None else f"{words}: its force axis is {millimetres(miss)} from the position by the other pokes"


def rival_words(estimate: Estimate | None) -> str:
    """Describe a second possible position of a taxel and what to do; empty if there is none."""
    if estimate is None or estimate.rival is None or estimate.position is None:
        return ""
    away = millimetres(float(np.linalg.norm(estimate.rival.position - estimate.position)), 0)
    odds = number(estimate.rival.odds, 0)
    return f"A second position {away} away fits almost as well (odds {odds} to 1). Press from another side."
