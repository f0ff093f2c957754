"""The frame of each taxel for files, lists and pictures: its turn with its state, never one that the pokes do not show."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from skincal.axes.module_axes import AxisFindings
from skincal.axes.session_turns import SessionTurns, ShownTurn
from skincal.axes.skin_turns import TurnState
from skincal.geometry import FloatArray

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable


class FrameState(Enum):
    """State of a taxel's turn; the value is its word in files."""

    KNOWN = TurnState.KNOWN.value
    """By its own pokes."""
    BY_MODULE = "by module"
    """The taxels of its module share one turn, which all pokes on the module show."""
    IN_PLANE_UNKNOWN = TurnState.IN_PLANE_UNKNOWN.value
    """No poke leaned enough."""
    MIRRORED = "mirrored axes"
    """x, y and z of its readings are no right-handed axes, so no rotation describes them."""
    WRONG_ORDER = "order of values wrong"
    """The frames have another order of values than the scene: its readings are those of other taxels."""
    DEAD_AXIS = "an axis does not answer"
    """x, y or z of the taxel is dead or stuck."""
    UNKNOWN = "unknown"
    """No poke has a reading of it."""


@dataclass(frozen=True, slots=True, eq=False)
class TaxelFrame:
    """The turn of one taxel."""

    channel: int
    state: FrameState
    rotation: FloatArray | None = None
    """(3, 3) float: columns are x, y and z of its readings in the link frame; `None` unless the whole turn is known."""
    covariance: FloatArray | None = None
    """(3, 3) float, rad^2, of the turn in the link frame, with the scatter of the module's taxels; `None` without a turn."""
    pokes: int = 0
    """Pokes with a reading of it."""

    @property
    def is_known(self) -> bool:
        """Whether all three axes are known."""
        return self.rotation is not None

    @property
    def normal_sd(self) -> float:
        """rad, standard deviation of the direction of z, in its worse direction; NaN if the turn is unknown."""
        local = self._local_covariance()
        return float("nan") if local is None else float(np.sqrt(np.linalg.eigvalsh(local[:2, :2])[-1]))

    @property
    def in_plane_sd(self) -> float:
        """rad, standard deviation of the turn about z; NaN if the turn is unknown."""
        local = self._local_covariance()
        return float("nan") if local is None else float(np.sqrt(local[2, 2]))

    def _local_covariance(self) -> FloatArray | None:
        """Covariance in the axes of the taxel."""
        if self.rotation is None or self.covariance is None:
            return None
        return self.rotation.T @ self.covariance @ self.rotation


def turn_or_reason(
    turns: SessionTurns, channel: int, *, is_order_wrong: bool, dead_z: Collection[int] = ()
) -> ShownTurn | FrameState | None:
    """Give the turn of a taxel; why its readings show none, if they do not; `None` before a poke shows one.

    Parameters
    ----------
    is_order_wrong : whether the values of a frame have another order than the scene
    dead_z : channels whose z does not answer
    """
    if is_order_wrong:
        return FrameState.WRONG_ORDER
    turn = turns.of_channel(channel)
    is_dead = channel in turns.channels_with_dead_axis or channel in dead_z
    return FrameState.DEAD_AXIS if turn is not None and is_dead else turn


def frames_of_taxels(
    turns: SessionTurns, findings: AxisFindings, channels: Iterable[int], dead_z: Collection[int] = ()
) -> dict[int, TaxelFrame]:
    """Choose the frame of each channel: the turn of its module if its taxels share one, else its own; with its state.

    `dead_z` are the channels whose z does not answer.
    """
    mirrored = {mistake.module for mistake in findings.mistakes if mistake.is_mirrored}
    if turns.is_mirrored:
        mirrored.add(None)

    def frame(channel: int) -> TaxelFrame:
        own = turns.skin.taxels.get(channel)
        pokes = 0 if own is None else own.pokes
        turn = turn_or_reason(turns, channel, is_order_wrong=findings.is_value_order_wrong, dead_z=dead_z)
        if turn is None:
            return TaxelFrame(channel, FrameState.UNKNOWN)
        if isinstance(turn, FrameState):
            return TaxelFrame(channel, turn, pokes=pokes)
        if None in mirrored or turns.module_of.get(channel, -1) in mirrored:
            return TaxelFrame(channel, FrameState.MIRRORED, pokes=pokes)
        if not turn.is_in_plane_known:
            return TaxelFrame(channel, FrameState.IN_PLANE_UNKNOWN, pokes=pokes)
        state = FrameState.KNOWN if turn.module is None else FrameState.BY_MODULE
        return TaxelFrame(channel, state, turn.fit.rotation, turn.covariance, pokes)

    return {channel: frame(channel) for channel in channels}
