"""The pokes as rows, newest first; numbers are worked out for the rows on the screen only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QPersistentModelIndex, Qt
from PySide6.QtGui import QColor

from app.display_units import DASH, ChannelNames, degrees, in_millimetres, number
from app.evidence_words import doubt_mark, doubt_words, doubting
from app.theme import LIGHT, Colours
from app.words import force_of, peak_channel, pitch_of, reason_short, reason_words, tilt_of
from skincal.contacts.outcome import Contact, Rejection
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.taxels.result import Estimate

_Index = QModelIndex | QPersistentModelIndex
HEADINGS = ("#", "Outcome", "Taxel", "N", "Tilt", "Pitch")
_HINTS = (
    "Number of the poke in the session",
    "Accepted, or why not",
    "Taxel that answered most, and how many more did",
    "Force, newtons",
    "Angle between the push and the inward normal, degrees",
    "Pitch |f . m| / |f|\N{SUPERSCRIPT TWO}, millimetres: beyond the noise it tells a second contact or a torque",
)


class PokeTable(QAbstractTableModel):
    """Rows of `Snapshot.pokes` in falling order of their numbers."""

    def __init__(self, names: ChannelNames) -> None:
        super().__init__()
        self._names = names
        self._records: tuple[PokeRecord, ...] = ()
        self._estimates: Mapping[int, Estimate] = {}
        self._doubting: Mapping[int, Sequence[Estimate]] = {}
        self._at_landmarks: Mapping[int, str] = {}
        self._colours = LIGHT

    def show(self, snapshot: Snapshot, estimates: Mapping[int, Estimate]) -> None:
        """Show another snapshot's pokes, telling the view no more than what changed."""
        records = snapshot.pokes
        self._estimates, self._at_landmarks = estimates, snapshot.at_landmarks
        self._doubting = doubting(estimates.values())
        old, added = self._records, len(records) - len(self._records)
        if added < 0 or any(a.outcome.poke != b.outcome.poke for a, b in zip(old[-1:], records[len(old) - 1 :], strict=False)):
            self.beginResetModel()
            self._records = records
            self.endResetModel()
            return
        if added:
            self.beginInsertRows(QModelIndex(), 0, added - 1)
            self._records = records
            self.endInsertRows()
        self._records = records
        self._tell_changed(old, records)

    def _tell_changed(self, old: Sequence[PokeRecord], new: Sequence[PokeRecord]) -> None:
        if new:
            # What a poke counts for, and its tilt, follow the estimates, and these all pokes.
            self.dataChanged.emit(self.index(0, 1), self.index(len(new) - 1, 4))
        changed = [i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a is not b and a != b]
        if changed:
            rows = [len(new) - 1 - i for i in changed]
            self.dataChanged.emit(self.index(min(rows), 0), self.index(max(rows), len(HEADINGS) - 1))

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours

    def record(self, row: int) -> PokeRecord:
        """Return the record of a row."""
        return self._records[len(self._records) - 1 - row]

    def row_of(self, poke: int) -> int | None:
        """Return the row of a poke's number."""
        return next((len(self._records) - 1 - i for i, r in enumerate(self._records) if r.outcome.poke == poke), None)

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008
        """Return the number of pokes."""
        return 0 if parent.isValid() else len(self._records)

    def columnCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008
        """Return the number of columns."""
        return 0 if parent.isValid() else len(HEADINGS)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Return a column's heading and its hint."""
        if orientation is not Qt.Orientation.Horizontal:
            return None
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return int(_alignment(section) | Qt.AlignmentFlag.AlignVCenter)
        return {Qt.ItemDataRole.DisplayRole: HEADINGS[section], Qt.ItemDataRole.ToolTipRole: _HINTS[section]}.get(
            Qt.ItemDataRole(role)
        )

    def data(self, index: _Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Return a cell's text, colour or hint."""
        record = self.record(index.row())
        if role == Qt.ItemDataRole.DisplayRole:
            return self._text(record, index.column())
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return int(_alignment(index.column()) | Qt.AlignmentFlag.AlignVCenter)
        if role == Qt.ItemDataRole.ForegroundRole:
            return self._colour(record, index.column())
        if role == Qt.ItemDataRole.ToolTipRole:
            return self._hint(record)
        return None

    def _colour(self, record: PokeRecord, column: int) -> QColor | None:
        if record.excluded:
            return QColor(self._colours.muted)
        if isinstance(record.outcome, Rejection) and record.outcome.poke not in self._at_landmarks:
            return QColor(self._colours.bad if column == 1 else self._colours.muted)
        return QColor(self._colours.accent) if column == 1 else None

    def _hint(self, record: PokeRecord) -> str:
        outcome = record.outcome
        if isinstance(outcome, Rejection):
            name = self._at_landmarks.get(outcome.poke)
            return reason_words(outcome) if name is None else f"at the landmark {name}; {outcome.reason.value}, and none need"
        answered = ", ".join(self._names.short(int(c)) for c in outcome.channels)
        pose = f"\narm pose {outcome.pose}" if outcome.pose else ""
        change = f"\ntare changed by {number(outcome.tare_change, 2)} N" if outcome.tare_change == outcome.tare_change else ""
        doubters = () if record.excluded else self._doubting.get(outcome.poke, ())
        doubts = "".join(f"\n{doubt_words(outcome, estimate, self._names)}" for estimate in doubters)
        return f"answered: {answered}{pose}{change}{doubts}"

    def _text(self, record: PokeRecord, column: int) -> str:
        outcome = record.outcome
        if column == 0:
            return str(outcome.poke)
        if column == 1 and not record.excluded and outcome.poke in self._at_landmarks:
            return f"\N{WHITE DIAMOND} {self._at_landmarks[outcome.poke]}"
        if column == 1:
            return _outcome_text(record, doubt_mark(outcome.poke, self._doubting.get(outcome.poke, ()), self._names))
        if column == 2:
            return self._taxel(record)
        return self._measured(outcome, column) if isinstance(outcome, Contact) else ""

    def _taxel(self, record: PokeRecord) -> str:
        peak = peak_channel(record.outcome)
        if peak is None:
            return DASH
        more = len(record.outcome.channels) - 1
        return self._names.short(peak) + (f" +{more}" if more else "")

    def _measured(self, contact: Contact, column: int) -> str:
        if column == 3:
            return number(force_of(contact), 1)
        if column == 4:
            return degrees(tilt_of(contact, self._estimates))
        return number(in_millimetres(pitch_of(contact)), 1)


def _outcome_text(record: PokeRecord, doubt: str) -> str:
    if isinstance(record.outcome, Rejection):
        return f"\N{BALLOT X} {reason_short(record.outcome)}"
    if record.excluded:
        return "\N{CIRCLED MINUS} excluded"
    return f"\N{CIRCLE WITH LEFT HALF BLACK} {doubt}" if doubt else "\N{CHECK MARK} accepted"


def _alignment(column: int) -> Qt.AlignmentFlag:
    return Qt.AlignmentFlag.AlignLeft if column in (1, 2) else Qt.AlignmentFlag.AlignRight
