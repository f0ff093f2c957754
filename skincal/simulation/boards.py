"""Boards that send readings: header, clock and encoder of a stream, for the simulated rig and the physics engine's robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skincal.model.readings import Stream
from skincal.model.scene import Scene
from skincal.simulation.board_formats import Encoder, make_encoder

US_PER_S = 1_000_000
BOARD_CLOCK_WRAP_US = 2**32
"""us, range of a board's clock."""
BOARD_HEADER_PERIOD_S = 2.0
"""s between two headers of a board."""
VECTOR_BITS = 32
"""Of a value of a skin of three axes: a float."""


@dataclass(frozen=True, slots=True)
class BoardHeader:
    """Header of a board, and the number of values in its readings."""

    fields: str
    """`key=value,...`."""
    width: int


def board_headers(scene: Scene, hz: Mapping[Stream, float], top: float, *, rises: bool) -> dict[Stream, BoardHeader]:
    """Make the headers of a scene's boards: wrench with a sensor, joints with an arm, poses with a tool.

    Parameters
    ----------
    hz : rate of each stream
    top : largest raw value of the skin; a skin of three axes sends floats
    rises : whether raw values rise under pressure
    """
    skin, arm = scene.skin, scene.arm
    polarity, unit, bits = "up" if rises else "down", "raw", VECTOR_BITS
    if skin.axes is None:
        bits = int(np.ceil(np.log2(top + 1)))
    else:
        unit = skin.axes.unit
    of_skin = f"board={scene.name},n={skin.frame_width},rate={hz[Stream.SKIN]:g},unit={unit},bits={bits}"
    headers = {
        Stream.WRENCH: BoardHeader(f"board=ft,rate={hz[Stream.WRENCH]:g},unit=N,kind=ft,fw=1", 6),
        Stream.SKIN: BoardHeader(f"{of_skin},kind=taxel,polarity={polarity},fw=1", skin.frame_width),
    }
    if not scene.has_sensor:
        del headers[Stream.WRENCH]
    if arm is not None:
        fields = f"board=arm,rate={hz[Stream.JOINTS]:g},unit=deg,kind=joints,fw=1"
        headers[Stream.JOINTS] = BoardHeader(fields, max(arm.arm.joints, default=-1) + 1)
    if scene.tool is not None:
        headers[Stream.TOOL] = BoardHeader(f"board=tool,rate={hz[Stream.TOOL]:g},unit=m,kind=pose,fw=1", 7)
    return headers


def board_encoder(format_: str, stream: Stream, top: float, width: int) -> Encoder:
    """Make the encoder of a board; see `make_encoder`. `top` is infinite for a skin of three axes."""
    # Poses have a record in SKT/1 only.
    return make_encoder("skt" if stream is Stream.TOOL else format_, top, width if stream is Stream.SKIN else 0)


def encode_header(encoder: Encoder, header: BoardHeader, time_us: int) -> bytes:
    """Encode a header with the time of the board's clock, which wraps."""
    return encoder.header(time_us % BOARD_CLOCK_WRAP_US, header.fields, header.width)
