"""Counts of a session's pokes. Header, verdict, report and commands show these, so that they agree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from skincal.contacts.outcome import Contact, Outcome, Reason


@dataclass(frozen=True, slots=True)
class PokeCounts:
    """Pokes by what became of them; each is counted once."""

    on_skin: int = 0
    """Accepted, and not at a landmark."""
    at_landmarks: int = 0
    """At a landmark, where no taxel needs to answer."""
    on_both: int = 0
    """Accepted, and at a landmark."""
    rejected: Mapping[Reason, int] = field(default_factory=dict[Reason, int])
    excluded: int = 0
    """Taken out by the operator, by undo too."""

    @property
    def pokes(self) -> int:
        """All pokes."""
        return self.on_skin + self.at_landmarks + self.on_both + self.rejections + self.excluded

    @property
    def accepted(self) -> int:
        """Pokes that count for the taxels."""
        return self.on_skin + self.on_both

    @property
    def rejections(self) -> int:
        """Rejected pokes."""
        return sum(self.rejected.values())


def count_pokes(outcomes: Iterable[tuple[Outcome, bool, bool]]) -> PokeCounts:
    """Count pokes; each comes with whether the operator took it out, and whether it is at a landmark."""
    kinds, reasons = Counter[tuple[bool, bool]](), Counter[Reason]()
    excluded = 0
    for outcome, is_out, is_at_landmark in outcomes:
        if is_out:
            excluded += 1
        elif isinstance(outcome, Contact) or is_at_landmark:
            kinds[isinstance(outcome, Contact), is_at_landmark] += 1
        else:
            reasons[outcome.reason] += 1
    rejected = dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0].value)))
    return PokeCounts(kinds[True, False], kinds[False, True], kinds[True, True], rejected, excluded)
