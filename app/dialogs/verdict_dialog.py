"""Dialog with the verdict on a session: a sentence, figures, the unfinished taxels, and the way to the calibration file."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QFont, QFontMetrics, QKeyEvent, QShowEvent
from PySide6.QtWidgets import QDialogButtonBox, QLabel, QSizePolicy, QWidget

from app.dialogs.dialog import Dialog, StandardButton
from app.dialogs.form_widgets import BUTTON_ELLIPSIS
from app.panels.layouts import make_column, make_form, make_row, scrolled
from app.panels.widgets import fit_to_screen, put_rows, secondary_label, set_bold, table
from app.text_size import scaled
from app.theme import HEADLINE_FONT_SIZE_PT, RESULT_FONT_SIZE_PT, WIDGET_GAP_PX
from skincal.guide.verdict import Verdict
from skincal.words.units import ChannelNames, count
from skincal.words.verdict_words import figures, left_words, verdict_details, verdict_headline

HEADINGS = ("Taxel", "Why it is not finished")
HEADLINE_SIZES_PT = (HEADLINE_FONT_SIZE_PT, 22.0, 18.0, RESULT_FONT_SIZE_PT)
"""A short verdict is read from two metres, a long one from one metre."""
HEADLINE_LINES, HEADLINE_FILL = 2, 0.9  # Lines of the headline, and the share of a line that words fill
DIALOG_MIN_WIDTH_PX = 680
DIALOG_WIDTH_PX = 840
LIST_MIN_HEIGHT_PX = 100
DIALOG_MAX_HEIGHT_PX = 660  # A higher dialog scrolls; a screen of 720 pixels shows all of it


def _headline_points(sentence: str) -> float:
    """Return the size of a headline in points at 100 %: as large as lets the sentence take two lines."""
    for points in HEADLINE_SIZES_PT:
        font = QFont()
        font.setBold(True)
        font.setPointSizeF(points)
        if QFontMetrics(font).horizontalAdvance(sentence) <= HEADLINE_LINES * HEADLINE_FILL * DIALOG_WIDTH_PX:
            return points
    return HEADLINE_SIZES_PT[-1]


class VerdictDialog(Dialog):
    """Dialog with the verdict; the space bar continues to the file after a good verdict, else to the session.

    Parameters
    ----------
    rig : sentences on the errors of the rig
    settled : no correction is available that would change the estimates
    """

    export_wanted = Signal()
    report_wanted = Signal()  # The dialog stays open
    taxel_wanted = Signal(int)

    def __init__(
        self,
        verdict: Verdict,
        names: ChannelNames,
        parent: QWidget | None = None,
        *,
        rig: str = "",
        can_export: bool = True,
        settled: bool = True,
    ) -> None:
        super().__init__("Verdict", parent, StandardButton.NoButton)
        self.setMinimumWidth(DIALOG_MIN_WIDTH_PX)
        self._channels = [left.channel for left in verdict.left]
        self.sentence = QLabel(verdict_headline(verdict), wordWrap=True)
        self.details = QLabel(verdict_details(verdict), wordWrap=True)
        thing = "Tool and part" if verdict.has_tool else "Sensor and arm" if verdict.has_arm else "Sensor"
        shown = (*figures(verdict), *(((thing, rig),) if rig else ()))
        self.figures = [(name, QLabel(value, wordWrap=True)) for name, value in shown]
        self.heading = secondary_label(f"{count(len(verdict.left), 'taxel')} not finished. Enter selects one in the views.")
        self.left = table("unfinished taxels", HEADINGS)
        put_rows(self.left, [(names.short(left.channel), left_words(left)) for left in verdict.left])
        self.go_on = self.buttons.addButton("Continue poking", QDialogButtonBox.ButtonRole.RejectRole)
        self.report = self.buttons.addButton(f"Report{BUTTON_ELLIPSIS}", QDialogButtonBox.ButtonRole.ActionRole)
        self.export = self.buttons.addButton(f"Export{BUTTON_ELLIPSIS}", QDialogButtonBox.ButtonRole.AcceptRole)
        self.export.setEnabled(can_export)
        self.left.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
        # It gets the remaining height, and scrolls before the whole dialog does.
        self.left.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        self.show_headline()
        self.sentence.setAccessibleName("verdict")
        self.details.setAccessibleName("details of the verdict")
        form = make_form(*((secondary_label(name), value) for name, value in self.figures))
        row, self.words = make_row(self.left), QWidget()
        row.addStrut(scaled(LIST_MIN_HEIGHT_PX) if self._channels else 0)
        make_column(self.sentence, self.details, form, self.heading, (row, 1), within=self.words, gap=2 * WIDGET_GAP_PX)
        for widget in (self.heading, self.left):
            widget.setVisible(bool(self._channels))
        self.area = scrolled(self.words)
        self.area.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.area.setAccessibleName("verdict and figures")
        self.fill((self.area, 1))
        is_good = verdict.is_finished and not verdict.doubted and settled
        first = self.export if is_good and can_export else self.go_on
        first.setDefault(True)
        first.setFocus()
        self.buttons.accepted.connect(self._export)
        self.report.clicked.connect(self.report_wanted)
        self.left.itemActivated.connect(
            lambda item: self.taxel_wanted.emit(self._channels[self.left.indexOfTopLevelItem(item)])
        )

    def show_headline(self) -> None:
        """Give the verdict the size of its type, as large as lets it take two lines."""
        set_bold(self.sentence, _headline_points(self.sentence.text()))

    def showEvent(self, event: QShowEvent) -> None:
        """Resize the dialog to its wrapped text, at most to the size of the screen."""
        super().showEvent(event)
        fit_to_screen(self, (DIALOG_WIDTH_PX, DIALOG_MAX_HEIGHT_PX))
        height = (
            self.words.heightForWidth(self.width() - 4 * WIDGET_GAP_PX) + self.buttons.sizeHint().height() + 4 * WIDGET_GAP_PX
        )
        fit_to_screen(self, (DIALOG_WIDTH_PX, DIALOG_MAX_HEIGHT_PX if self._channels else min(height, DIALOG_MAX_HEIGHT_PX)))

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Handle Enter in the list, so that it does not press the dialog's default button."""
        if not (self.left.hasFocus() and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter)):
            super().keyPressEvent(event)

    def _export(self) -> None:
        self.accept()
        self.export_wanted.emit()
