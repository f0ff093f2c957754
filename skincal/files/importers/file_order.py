"""Messages of a bag in the order of its file, if the recorder's clock was set back by a simulation that began again.

Readers of bags sort messages by their arrival. If the recorder's clock was a simulation's, and this was reset, the messages of
two runs alternate then. In the file one run follows the other, so that the times of one topic go back.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any, TypeAlias

from skincal.files.importers.mcap_bag import McapFile
from skincal.files.importers.timeline import MAX_TIME_STEP_BACK_S

Arrived: TypeAlias = tuple[Any, int, bytes]
"""Connection, arrival (ns) and bytes of a message."""
_MAX_STEP_BACK_NS = round(MAX_TIME_STEP_BACK_S * 1e9)


def messages_in_file_order(reader: Any, wanted: Collection[Any]) -> Callable[[], Iterator[Arrived]] | None:
    """Return the messages of some connections in the order of the file if the times of one go back; `None` if none does."""
    if isinstance(reader, McapFile):
        if reader.may_go_back and _steps_back((each.id, ns) for each, ns, _ in reader.in_file_order(wanted)):
            return lambda: reader.in_file_order(wanted)
        return None
    database = getattr(getattr(reader, "storage", None), "dbconn", None)
    return None if database is None else _rows_in_file_order(database, wanted)


def _rows_in_file_order(database: Any, wanted: Collection[Any]) -> Callable[[], Iterator[Arrived]] | None:
    """Do the same for a database of ROS 2, whose rows have the order in which they were written."""
    # A folder and its file number the topics differently.
    of_topic = {each.topic: each for each in wanted}
    names = ",".join("?" for _ in of_topic)
    rows = f"FROM messages JOIN topics ON messages.topic_id = topics.id WHERE topics.name IN ({names}) ORDER BY messages.id"
    if not _steps_back(database.execute(f"SELECT topics.name, messages.timestamp {rows}", list(of_topic))):
        return None

    def messages() -> Iterator[Arrived]:
        for name, ns, data in database.execute(f"SELECT topics.name, messages.timestamp, messages.data {rows}", list(of_topic)):
            yield of_topic[name], ns, data

    return messages


def _steps_back(arrivals: Iterable[tuple[Any, int]]) -> bool:
    """Whether the times (ns) of one topic go back by more than late messages do."""
    last: dict[Any, int] = {}
    for topic, ns in arrivals:
        if ns < last.get(topic, ns) - _MAX_STEP_BACK_NS:
            return True
        last[topic] = ns
    return False
