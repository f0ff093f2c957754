"""Address of one stream on the page, with a preview; its readings help to describe the part."""

from __future__ import annotations

from PySide6.QtCore import QTimer, Signal
from PySide6.QtWidgets import QGridLayout, QWidget

from app.dialogs.new_session import LINK_PREVIEW_UPDATE_PERIOD_MS, StreamRow
from app.session.previews import Previews, list_ports
from app.workers.threads import ThreadService
from skincal.model.errors import InputError
from skincal.model.pose_form import SentPose
from skincal.model.readings import Stream
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.links import parse_address


class LiveRow(QWidget):
    """Reads a device while its step is open."""

    read = Signal(object)  # List of readings, (n,) float each, since the last signal

    def __init__(self, stream: Stream) -> None:
        super().__init__()
        self._stream = stream
        self.row = StreamRow(stream)
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setColumnStretch(2, 1)
        self.row.add_to(grid)
        self._expected = ExpectedReadings(1)
        self.skin_unit = ""
        """Unit that the device names for the skin's values; empty for raw values."""
        self.sent_pose: SentPose | None = None
        """Numbers of the newest pose of the tool; `None` before the first."""
        self._is_open = False
        self._previews = previews = Previews()
        self.destroyed.connect(lambda: previews.stop_readers())
        self._ports = ThreadService("ports", self)
        self._has_ports = False
        self._timer = QTimer(self, interval=LINK_PREVIEW_UPDATE_PERIOD_MS)
        self._timer.timeout.connect(self._update)
        self.row.agreed.connect(self._choose)

    def expect(self, expected: ExpectedReadings) -> None:
        """Set the values that the readings should have."""
        if expected != self._expected:
            self._expected = expected
            self._choose()

    def resume(self) -> None:
        self._is_open = True
        if not self._has_ports:
            self._has_ports = True
            self._ports.submit(list_ports, self.row.set_ports, lambda _: None)
        self._choose()

    def pause(self) -> None:
        self._is_open = False
        self._choose()

    def stop(self) -> None:
        """Release the device for good."""
        self._timer.stop()
        self._previews.stop_readers()
        self._ports.close(0.0)

    def _choose(self) -> None:
        address = self.row.named if self._is_open else ""
        if address:
            try:
                parse_address(address)
            except InputError as error:
                self.row.show_preview(None, str(error))
                address = ""
        self._previews.choose_expected({self._stream: address} if address else {}, self._expected)
        if address:
            self._timer.start()
        else:
            self._timer.stop()

    def _update(self) -> None:
        preview = self._previews.update().get(self._stream)
        if preview is not None:
            self.row.show_preview(preview)
            self.skin_unit = preview.health.skin_unit
            self.sent_pose = preview.health.sent_pose
            if preview.frames:
                self.read.emit(list(preview.frames))
