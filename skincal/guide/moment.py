"""One moment of a session, as guide and verdict read it. `Snapshot` of the room `session` is one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

from skincal.contacts.outcome import Contact
from skincal.contacts.poke_counts import PokeCounts
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import Estimate, Method


class Moment(Protocol):
    """The contacts that count, and the estimates that follow from them."""

    @property
    def contacts(self) -> Sequence[Contact]:
        """In the order of their numbers."""
        ...

    @property
    def estimates(self) -> Mapping[Method, Sequence[Estimate]]:
        """One estimate a taxel by each method."""
        ...

    @property
    def poke_counts(self) -> PokeCounts:
        """Counts of all pokes."""
        ...

    @property
    def part_size(self) -> float:
        """m, of `known_error`."""
        ...

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Gather the evidence of those of `channels` that answered, all with full weight."""
        ...
