"""Names of topics with their options, the same in addresses of running robots and in bags: `/skin/a+/skin/b?field=values`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlencode

from skincal.model.errors import InputError

TOPIC_OPTIONS = ("field", "msg", "joints", "frame", "base")
"""Options of a topic: path of the values in a message, `.msg` file of the type, names of the joints in their order; of a tool's
poses the frame of the tool and that of the base."""
_TOPIC_RE = re.compile(r"/?[A-Za-z~][\w/]*")


@dataclass(frozen=True, slots=True)
class TopicChoice:
    """Topics that make one stream, in the order of the channels, and how their messages are read."""

    topics: tuple[str, ...]
    field: str = ""
    """Path of the values in a message; empty for the usual field of the type."""
    msg: Path | None = None
    """File with the type's definition; `None` if it is known."""
    joints: tuple[str, ...] = ()
    """Names of the joints in their order, "" for an unused one; empty if the scene names them, or for all of them."""
    frame: str = ""
    """Frame of the tool; empty for the only one."""
    base: str = ""
    """Frame that the tool's poses are in; empty for that of the first one."""

    @classmethod
    def parse(cls, text: str) -> TopicChoice:
        """Read what `str` returns. Raises InputError: there is no topic, or an option is unknown."""
        topics, _, options = text.partition("?")
        # A plus sign would become a space; topics and fields have none, paths may.
        found = dict(parse_qsl(options.replace("+", "%2B"), keep_blank_values=True))
        unknown = [key for key in found if key not in TOPIC_OPTIONS]
        if unknown:
            raise InputError(f"{text}: unknown option {unknown[0]!r}. Allowed options: {', '.join(TOPIC_OPTIONS)}.")
        return cls.make(topics, found)

    @classmethod
    def make(cls, topics: str, options: Mapping[str, str]) -> TopicChoice:
        """Combine topics, joined by `+`, with options by name; other options are ignored. Raises InputError: no topic."""
        names = tuple(topics.split("+"))
        wrong = [name for name in names if not _TOPIC_RE.fullmatch(name)]
        if wrong:
            raise InputError(f"{topics!r} is no topic; expected a name such as /ft/wrench, or several: /skin/a+/skin/b.")
        joints = tuple(options["joints"].split(",")) if options.get("joints") else ()
        msg = Path(options["msg"]) if options.get("msg") else None
        return cls(names, options.get("field", ""), msg, joints, options.get("frame", ""), options.get("base", ""))

    def __str__(self) -> str:
        """Return the topics joined by `+`, and after `?` the options."""
        chosen = {"field": self.field, "msg": "" if self.msg is None else str(self.msg), "joints": ",".join(self.joints)}
        chosen |= {"frame": self.frame, "base": self.base}
        options = urlencode({key: value for key, value in chosen.items() if value}, safe="/[],.:")
        return "+".join(self.topics) + (f"?{options}" if options else "")
