"""Other orders of a skin's channels that a wrong cable or program makes: blocks, rows or columns exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.skin import Layout

CONNECTOR_SIZES = (8, 10, 12, 16, 20, 24, 32, 40, 48, 64)
"""Lines of a connector or a multiplexer."""
MAX_BLOCKS = 8
"""Blocks of channels whose exchange is tried; of more there are too many pairs to tell from a few pokes."""
MAX_GRID_LINES = 16


def channel_orders(layout: Layout) -> Iterator[tuple[str, str, IntArray]]:
    """Yield orders of the channels: what is exchanged, the taxels whose places are exchanged, and the order.

    The order (width,) says for each channel whose planned place it has.
    """
    seen = {np.arange(layout.width).tobytes()}
    for what, how, order in (*_blocks(layout), *_lines(layout)):
        if (key := order.tobytes()) not in seen:
            seen.add(key)
            yield what, how, order


def exchanged_order(layout: Layout, one: IntArray, other: IntArray) -> IntArray:
    """Return the order (width,) that exchanges the places of channels `one` and `other`, both (k,)."""
    order = np.arange(layout.width)
    order[one], order[other] = other, one
    return order


def _blocks(layout: Layout) -> Iterator[tuple[str, str, IntArray]]:
    """Exchange two blocks of channels: halves, quarters, eighths, or blocks of a connector's size."""
    channels = layout.channels
    count = len(channels)
    sizes = [count // parts for parts in (2, 3, 4, 6, 8) if count % parts == 0] + [
        size for size in CONNECTOR_SIZES if count % size == 0
    ]
    for size in dict.fromkeys(size for size in sizes if size > 1 and 2 <= count // size <= MAX_BLOCKS):
        for one, other in combinations(channels.reshape(-1, size), 2):
            what = f"channels {_range(one)} and {_range(other)} are exchanged"
            yield (
                what,
                f"exchange their connectors, or the places of these channels in the layout{_pads(layout, one, other)}",
                (exchanged_order(layout, one, other)),
            )


def _lines(layout: Layout) -> Iterator[tuple[str, str, IntArray]]:
    """Exchange two rows or columns of a grid, or its halves, or number every second line backwards."""
    for name, axis in (("row", 1), ("column", 0)):
        lines = _grid_lines(layout, axis)
        if lines is None:
            continue
        for one, other in combinations(range(len(lines)), 2):
            what = f"{name}s {one + 1} and {other + 1} of the layout's grid are exchanged (channels {_list(lines[one])} and "
            how = (
                f"exchange their wires, or the places of these channels in the layout{_pads(layout, lines[one], lines[other])}"
            )
            yield f"{what}{_list(lines[other])})", how, exchanged_order(layout, lines[one], lines[other])
        if len(lines) % 2 == 0:
            one, other = (np.concatenate(half) for half in (lines[: len(lines) // 2], lines[len(lines) // 2 :]))
            what = f"the halves of the layout's {name}s are exchanged, {name}s 1 to {len(lines) // 2} and the others"
            yield (
                what,
                "exchange their connectors, or the places of their channels in the layout",
                exchanged_order(layout, one, other),
            )
        for first in (0, 1):
            order = np.arange(layout.width)
            for line in lines[first::2]:
                order[line] = line[::-1]
            what = f"every second {name} of the layout's grid is numbered backwards, from {name} {first + 1} on"
            yield what, "turn the order of the places of these channels round in the layout", order


def _grid_lines(layout: Layout, axis: int) -> list[IntArray] | None:
    """Group the channels of a grid by their coordinate along an axis, each in the order of the other; `None` without a grid."""
    channels = layout.channels
    places: FloatArray = layout.places[channels]
    step = np.rint((places - places.min(axis=0)) / layout.spacing).astype(np.int64)
    found = [np.flatnonzero(step[:, axis] == at) for at in np.unique(step[:, axis])]
    if not 2 <= len(found) <= MAX_GRID_LINES or len({len(each) for each in found}) != 1 or len(found[0]) < 2:
        return None
    return [channels[each[np.argsort(step[each, 1 - axis], kind="stable")]] for each in found]


def _range(channels: IntArray) -> str:
    if len(channels) == int(channels[-1] - channels[0]) + 1:
        return f"{channels[0]} to {channels[-1]}"
    return f"{channels[0]} ... {channels[-1]}"


def _list(channels: IntArray) -> str:
    shown = ", ".join(map(str, channels[:4].tolist()))
    return shown + (", ..." if len(channels) > 4 else "")


def _pads(layout: Layout, one: IntArray, other: IntArray) -> str:
    """Name the entries of the layout file that place these channels: lines of pads_mm, or first_channel of modules."""
    count = len(layout.modules)
    exchanged = np.bincount(layout.module_of[np.concatenate([one, other])], minlength=count)
    if np.count_nonzero(exchanged) == 1:
        return " (exchange these lines of its pads_mm)"
    is_whole = exchanged == np.bincount(layout.module_of[layout.channels], minlength=count)
    return " (exchange the first_channel of their modules)" if is_whole[exchanged > 0].all() else ""
