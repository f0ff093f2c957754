"""Decoders: bytes in, readings out. The registry of formats, and the detection of a format by its content.

A decoder knows no port, no clock and no thread, and how the bytes were cut never matters. It is made for a number of
channels and the streams that its link carries, and counts what it could not use.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from importlib import import_module
from typing import ClassVar, Protocol, cast

from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, Stream

AUTO = "auto"

_CLASSES = {
    "skb": ("skincal.streams.formats.skb", "Skb"),
    "skt": ("skincal.streams.formats.skt", "Skt"),
    "text": ("skincal.streams.formats.text", "Text"),
    "yarp": ("skincal.streams.formats.yarp", "Yarp"),
    "yarp-tx-rx": ("skincal.streams.formats.yarp", "YarpTxRx"),
    "yarp-rx": ("skincal.streams.formats.yarp", "YarpRx"),
    "csv": ("skincal.streams.formats.yarp", "Csv"),
}
"""Name in a link's description to the module and class; a module is imported when a link asks for it."""

NAMES = (AUTO, *_CLASSES)


class Format(Protocol):
    """What every decoder offers."""

    name: ClassVar[str]
    """Name for the operator, such as `"SKB/1"`."""

    @property
    def counts(self) -> Counter[Loss]:
        """What was lost so far, by reason."""
        ...

    def feed(self, data: bytes) -> list[Batch]:
        """Take the next bytes of the link and return the readings that they complete."""
        ...


def make_format(name: str, channels: int | None, carries: tuple[Stream, ...]) -> Format:
    """Return a new decoder by its name.

    Raises
    ------
    InputError : no format has this name
    """
    if name not in _CLASSES:
        raise InputError(f"A link's format is {name!r}; expected one of {', '.join(NAMES)}.")
    module, class_name = _CLASSES[name]
    maker = cast("Callable[[int | None, tuple[Stream, ...]], Format]", getattr(import_module(module), class_name))
    return maker(channels, carries)
