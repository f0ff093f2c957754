"""Contacts as arrays, which reach another process in milliseconds; as pickled objects they would hold Python's lock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.pokes import Pokes


@dataclass(frozen=True, slots=True, eq=False)
class SkinPokes(Sequence[Contact]):
    """n pokes on the skin with the m answers of its taxels. It reads as a sequence of final contacts without tip and tares."""

    pokes: Pokes
    times: FloatArray
    """(n, 2) float, seconds: start and end of the still window."""
    starts: IntArray
    """(n + 1,): poke i has the answers starts[i] to starts[i + 1]."""
    channels: IntArray
    """(m,) taxels that answered, poke by poke."""
    responses: FloatArray
    """(m,) float > 0, raw units."""
    clipped: NDArray[np.bool_]
    """(m,) whether the response is at the end of the skin's range."""

    @staticmethod
    def collect(contacts: Sequence[Contact]) -> SkinPokes:
        """Collect contacts."""
        counts = [len(contact.channels) for contact in contacts]
        clipped = [
            np.zeros(count, dtype=bool) if contact.clipped is None else np.isin(contact.channels, contact.clipped)
            for contact, count in zip(contacts, counts, strict=True)
        ]
        return SkinPokes(
            Pokes.collect(contacts),
            np.array([(contact.start_s, contact.end_s) for contact in contacts], dtype=np.float64).reshape(-1, 2),
            np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]),
            np.concatenate([np.empty(0, dtype=np.int64), *(contact.channels for contact in contacts)]),
            np.concatenate([np.empty(0), *(contact.responses for contact in contacts)]),
            np.concatenate([np.empty(0, dtype=bool), *clipped]),
        )

    def __len__(self) -> int:
        return len(self.pokes)

    @overload
    def __getitem__(self, index: int) -> Contact: ...
    @overload
    def __getitem__(self, index: slice) -> list[Contact]: ...
    def __getitem__(self, index: int | slice) -> Contact | list[Contact]:
        if isinstance(index, slice):
            return [self[row] for row in range(len(self))[index]]
        poke, answers = self.pokes[index], slice(*self.starts[range(len(self))[index] :][:2].tolist())
        channels, clipped = self.channels[answers], self.clipped[answers]
        return Contact(
            poke=int(poke.number),
            start_s=float(self.times[index, 0]),
            end_s=float(self.times[index, 1]),
            force=poke.force,
            moment=poke.moment,
            channels=channels,
            responses=self.responses[answers],
            link_from_sensor=poke.link_from_sensor,
            pose=str(poke.pose),
            tare_change=float("nan"),
            final=True,
            clipped=channels[clipped] if clipped.any() else None,
        )
