"""Taxels as a frozen table of arrays, from estimates, a file, a plan or a truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.files.reference import Comparison, TaxelPositions, compare_sets
from skincal.following.named_places import find_places
from skincal.model.errors import InputError
from skincal.model.scene import Scene as SceneFile
from skincal.taxels.result import Estimate, Method
from skincal.taxels.shared_errors import known_error

if TYPE_CHECKING:
    from skincal.axes.session_turns import ShownTurn
    from skincal.geometry import FloatArray, IntArray
    from skincal.part.part import Part

ROWS_SHOWN_IN_NOTEBOOK = 12
"""A longer table is cut in the middle, as pandas does it."""


@dataclass(frozen=True, eq=False)
class Taxels:
    """Positions of taxels in the frame of a link, a row a taxel, by channel. Arrays cannot be written to."""

    link: str
    """Frame of the positions; empty if their source names none."""
    source: str
    """Such as `"modules method"`, for people."""
    channel: IntArray
    """(n,) channels of the skin's frame, ascending."""
    position: FloatArray
    """(n, 3) float, metres; NaN if unknown."""
    normal: FloatArray
    """(n, 3) float, unit, outward; NaN if unknown."""
    covariance: FloatArray
    """(n, 3, 3) float, m^2, of the position; NaN if unknown."""
    error: FloatArray
    """(n,) float, metres: predicted error, square root of the covariance's trace; NaN above a tenth of the part, too."""
    state: Sequence[str]
    """n words: `touched`, `inferred`, `undetermined`, `untouched` or `disabled` (`skincal.taxels.result.State`); `known` in a
    file, plan or truth."""
    contacts: IntArray
    """(n,) pokes that the taxel answered and that count."""
    module: IntArray
    """(n,) id of the taxel's module; -1 if there is none."""
    axes: FloatArray | None = None
    """(n, 3, 3) float: x, y and z of a taxel that measures three axes, in columns; NaN while unknown. `None` for one axis."""
    axes_error: FloatArray | None = None
    """(n, 2) float, rad: standard deviations of the direction of z, and of the turn about it; NaN while unknown, and in a file,
    plan or truth. `None` for one axis."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for values in vars(self).values():
            if isinstance(values, np.ndarray):
                values.flags.writeable = False

    @classmethod
    def load(cls, named: str | Path) -> Taxels:
        """Read positions: of a file, or of a recorded session's method, plan or truth, such as `"monday:plan"`.

        Raises
        ------
        InputError

            As for `skincal compare`.
        """
        return taxels_at(find_places(str(named)))

    def __len__(self) -> int:
        """Return the number of taxels, known or not."""
        return len(self.channel)

    def __repr__(self) -> str:
        """Count the taxels in a line."""
        return f"Taxels({self.source}: {self.is_known.sum()} of {len(self)} known, link {self.link!r})"

    @cached_property
    def is_known(self) -> Any:
        """(n,) bool: whether the position is known."""
        return np.isfinite(self.position).all(axis=1)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` with a row a taxel, metres; pandas must be installed."""
        try:
            pandas: Any = import_module("pandas")
        except ImportError:
            raise InputError("to_pandas needs the package pandas; install it: pip install pandas.") from None
        return pandas.DataFrame(self._columns()).set_index("channel")

    def compare(self, other: Taxels | str | Path) -> Comparison:
        """Compare with other positions of the same taxels: a table, or what `load` reads.

        Raises
        ------
        InputError

            The frames have different names, or `other` cannot be read.
        """
        there = other if isinstance(other, Taxels) else Taxels.load(other)
        return compare_sets(self.places(), there.places())

    def plot(self) -> Any:
        """Draw the taxels from three sides with matplotlib, coloured by module; return the figure."""
        from skincal.interface.drawing import draw_three_sides

        known = self.is_known
        title = f"{self.source}, frame {self.link}: {known.sum()} of {len(self)} taxels known"
        return draw_three_sides(self.position[known], self.covariance[known], self.module[known], title)

    def plot_3d(self, part: Part | None = None, picture: str | Path | None = None) -> Any:
        """Draw the taxels in space with pyvista; return its plotter, whose `show()` opens a window or shows a notebook's view.

        Parameters
        ----------
        part
            Of the scene (`Scene.part`), whose mesh is drawn, too.
        picture
            File to write in place of a view, such as `"taxels.png"`.

        Raises
        ------
        InputError
            The package pyvista is not installed.
        """
        from skincal.interface.drawing import draw_in_space

        known, surface = self.is_known, None if part is None else part.surface
        place = None if picture is None else Path(picture)
        return draw_in_space(self.position[known], self.normal[known], self.module[known], surface, place)

    def _repr_html_(self) -> str:
        return self.html()

    def html(self) -> str:
        """Return the table as notebooks show it, in millimetres."""
        half = ROWS_SHOWN_IN_NOTEBOOK // 2
        rows = list(range(len(self)))
        if len(rows) > ROWS_SHOWN_IN_NOTEBOOK:
            rows = [*rows[:half], -1, *rows[-half:]]
        names = (
            "channel",
            "module",
            "state",
            "contacts",
            "x",
            "y",
            "z",
            "error",
            *(() if self.axes is None else ("turn, deg",)),
        )
        head = "".join(f"<th>{name}</th>" for name in names)
        body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in self._cells(row))}</tr>" for row in rows)
        return f"<p>{escape(repr(self))}; millimetres</p><table><tr>{head}</tr>{body}</table>"

    def _cells(self, row: int) -> list[str]:
        if row < 0:
            return ["..."] * (8 if self.axes is None else 9)
        module = self.module[row]
        numbers = [*self.position[row], self.error[row]]
        lengths = ["" if np.isnan(number) else f"{number * 1e3:.2f}" for number in numbers]
        whole = [str(self.channel[row]), "" if module < 0 else str(module), escape(self.state[row]), str(self.contacts[row])]
        return [*whole, *lengths, *self._turn_cells(row)]

    def _turn_cells(self, row: int) -> list[str]:
        """Make the cell on the turn: whether it is known, and its errors."""
        if self.axes is None:
            return []
        if np.isnan(self.axes[row, 0, 2]):
            return ["unknown"]
        if self.axes_error is None or np.isnan(self.axes_error[row, 0]):
            return ["known"]
        z, plane = np.degrees(self.axes_error[row]).tolist()
        return [f"z &plusmn;{z:.1f}, in the plane {'unknown' if np.isnan(plane) else f'&plusmn;{plane:.1f}'}"]

    def _columns(self) -> dict[str, Any]:
        vectors = {"": self.position, "n": self.normal}
        return {
            "channel": self.channel,
            "module": self.module,
            "state": list(self.state),
            "contacts": self.contacts,
            **{prefix + axis: values[:, column] for prefix, values in vectors.items() for column, axis in enumerate("xyz")},
            "error": self.error,
            **self._turn_columns(),
        }

    def _turn_columns(self) -> dict[str, Any]:
        """Columns of the axes: nine numbers and two errors in rad; none for one axis."""
        if self.axes is None:
            return {}
        found: dict[str, Any] = {
            f"{axis}_axis_{part}": self.axes[:, row, column]
            for column, axis in enumerate("xyz")
            for row, part in enumerate("xyz")
        }
        if self.axes_error is not None:
            found |= {"z_axis_error": self.axes_error[:, 0], "in_plane_error": self.axes_error[:, 1]}
        return found

    def places(self) -> TaxelPositions:
        """Return the known positions by channel, as the program's own functions compare them."""
        rows = np.flatnonzero(self.is_known).tolist()
        channels = self.channel.tolist()
        modules = {channels[row]: int(self.module[row]) for row in rows if self.module[row] >= 0}
        axes = self.axes
        turned = {} if axes is None else {channels[row]: axes[row] for row in rows if np.isfinite(axes[row, :, 2]).all()}
        return TaxelPositions(self.source, self.link, {channels[row]: self.position[row] for row in rows}, modules, axes=turned)


def taxels_of(
    estimates: Sequence[Estimate],
    scene: SceneFile,
    method: Method,
    part_size: float,
    turns: Mapping[int, ShownTurn] | None = None,
) -> Taxels:
    """Gather the estimates of one method, with turns of three axes by channel; `part_size` is as for `known_error`."""
    layout = scene.skin.layout
    channels = np.array([each.channel for each in estimates], dtype=np.int64)
    ids = np.full(len(channels), -1)
    if layout is not None:
        numbers = np.array([module.id for module in layout.modules])
        inside = channels < layout.width
        owners = layout.module_of[channels[inside]]
        ids[inside] = np.where(owners >= 0, numbers[owners], -1)
    errors = [known_error(each, part_size) for each in estimates]
    return Taxels(
        link=scene.link,
        source=f"{method.value} method",
        channel=channels,
        position=_vectors([each.position for each in estimates]),
        normal=_vectors([each.normal for each in estimates]),
        covariance=_vectors([None if each.covariance is None else each.covariance.ravel() for each in estimates], 9).reshape(
            -1, 3, 3
        ),
        error=np.array([np.nan if error is None or not np.isfinite(error) else error for error in errors], dtype=float),
        state=tuple(each.state.value for each in estimates),
        contacts=np.array([each.contacts for each in estimates], dtype=np.int64),
        module=ids.astype(np.int64),
        **({} if turns is None else _turns_of(turns, channels.tolist())),
    )


def _turns_of(turns: Mapping[int, ShownTurn], channels: Sequence[int]) -> dict[str, FloatArray]:
    from skincal.axes.turn_differences import axes_of_turns  # other skins do without

    axes, errors = np.full((len(channels), 3, 3), np.nan), np.full((len(channels), 2), np.nan)
    known = axes_of_turns(turns)
    for row, channel in enumerate(channels):
        turn = turns.get(channel)
        if turn is not None:
            axes[row] = known[channel]
            errors[row] = turn.normal_sd, turn.in_plane_sd if turn.is_in_plane_known else np.nan
    return {"axes": axes, "axes_error": errors}


def taxels_at(read: TaxelPositions, link: str = "") -> Taxels:
    """Make a table of known positions; `link` is the frame if their source names none."""
    channels = sorted(read.places)
    count = len(channels)
    return Taxels(
        link=read.link or link,
        source=read.name,
        channel=np.array(channels, dtype=np.int64),
        position=_vectors([read.places[channel] for channel in channels]),
        normal=np.full((count, 3), np.nan),
        covariance=np.full((count, 3, 3), np.nan),
        error=np.full(count, np.nan),
        state=("known",) * count,
        contacts=np.zeros(count, dtype=np.int64),
        module=np.array([read.modules.get(channel, -1) for channel in channels], dtype=np.int64),
        axes=_vectors([read.axes.get(channel) for channel in channels], (3, 3)) if read.axes else None,
    )


def _vectors(values: Sequence[Any], shape: int | tuple[int, int] = 3) -> FloatArray:
    unknown = np.full(shape, np.nan)
    return np.array([unknown if value is None else value for value in values], dtype=float).reshape(-1, *unknown.shape)
