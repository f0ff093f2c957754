"""One moment of a session, as guide and verdict read it. `Snapshot` of the room `session` is one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from skincal.contacts.outcome import Contact, Outcome
from skincal.contacts.poke_columns import PokeColumns
from skincal.contacts.poke_counts import PokeCounts
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import Estimate, Method

if TYPE_CHECKING:
    from skincal.axes.session_turns import SessionTurns


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

    @property
    def turns(self) -> SessionTurns | None:
        """Turns of taxels of three axes; `None` for other skins."""
        ...

    @property
    def columns(self) -> PokeColumns:
        """All pokes."""
        ...

    def contact(self, poke: int) -> Contact:
        """Find a contact that counts; raise `KeyError` if there is none of that number."""
        ...

    def changes_since(self, earlier: Any) -> Mapping[int, Outcome | None]:
        """Map the pokes that may have changed since an earlier moment, ascending, to outcomes; `None` for excluded contacts."""
        ...

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Gather the evidence of those of `channels` that answered, all with full weight."""
        ...
