"""Opens a recording, new or recorded; done in the background, without Qt.

The imports stand inside the functions so that they, too, happen beside the window.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skincal.session.part import Part
    from skincal.session.road import Road
    from skincal.streams.links import LinkSpec


def new_road(part: Part, links: Sequence[LinkSpec], folder: Path) -> Road:
    """Start a recording in a new folder.

    Raises
    ------
    InputError
        The folder cannot be made or is taken.
    """
    from skincal.journal.writer import create_session
    from skincal.session.road import Road

    folder.parent.mkdir(parents=True, exist_ok=True)
    return _solved(Road(part.scene, links, part.surface, create_session(folder, part.scene, links), part.laid))


def open_road(folder: Path, links: Sequence[LinkSpec]) -> tuple[Part, Road]:
    """Open a recorded session where it stopped.

    Parameters
    ----------
    links : where readings come from now; none for those of the recording

    Raises
    ------
    InputError
        The folder is no session.
    """
    from skincal.session.part import lay_part
    from skincal.session.replay import resume

    road = _solved(resume(folder, links or None))
    part = lay_part(road.scene, road.session.surface, road.findings)
    road.laid = part.laid
    return part, road


def _solved(road: Road) -> Road:
    """Return the road after its first snapshot, which looks at every taxel and so takes long."""
    road.snapshot()
    return road
