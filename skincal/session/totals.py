"""How many readings a session has had, and lost, by link: for a report that does not play the bytes again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from skincal.model.readings import LinkHealth, Loss


@dataclass(frozen=True, slots=True)
class LinkTotals:
    """Counts of one link over a whole session."""

    link: str
    format: str
    """Name of the format found last; empty while unknown."""
    readings: int
    losses: Mapping[Loss, int] = field(default_factory=dict[Loss, int])


@dataclass(frozen=True, slots=True)
class Totals:
    """Counts of a whole session, through all its segments."""

    links: tuple[LinkTotals, ...] = ()
    unpaired: int = 0
    """Skin frames that found no wrench."""

    def plus(self, health: Sequence[LinkHealth], unpaired: int) -> Totals:
        """Return the totals with the counts of one more segment."""
        links = {link.link: link for link in self.links}
        for new in health:
            old = links.get(new.link, LinkTotals(new.link, "", 0))
            losses = Counter(old.losses) + Counter(new.losses)
            links[new.link] = LinkTotals(new.link, new.format or old.format, old.readings + new.readings, losses)
        return Totals(tuple(links.values()), self.unpaired + unpaired)


def totals_to_json(totals: Totals) -> dict[str, Any]:
    """Return totals as a JSON object."""
    links = {
        link.link: {
            "format": link.format,
            "readings": link.readings,
            "lost": {loss.name: count for loss, count in link.losses.items() if count},
        }
        for link in totals.links
    }
    return {"links": links, "unpaired": totals.unpaired}


def totals_from_json(document: Mapping[str, Any]) -> Totals:
    """Return what `totals_to_json` was given.

    Raises
    ------
    KeyError, TypeError, ValueError
        It is not one that skincal wrote.
    """
    links = tuple(
        LinkTotals(
            str(name), str(link["format"]), int(link["readings"]), {Loss[loss]: int(n) for loss, n in link["lost"].items()}
        )
        for name, link in document["links"].items()
    )
    return Totals(links, int(document["unpaired"]))
