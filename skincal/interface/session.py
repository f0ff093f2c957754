"""A session as a script uses it: recorded, imported, simulated, or made from the user's own arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from skincal.contacts.outcome import Outcome, Rejection
from skincal.files.export import write_calibration
from skincal.files.formats import ExportFormat, ExportOptions
from skincal.files.importers.registry import RECORDING_IMPORTERS, RecordedPlace
from skincal.files.reference import TaxelPositions, find_truth
from skincal.following.results import SessionResults, use_offered
from skincal.interface.arrays import pipeline_of_arrays
from skincal.interface.scene import Scene
from skincal.interface.taxels import Taxels, taxels_at, taxels_of
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.session.importing import check_recorded_tool, find_topics, joint_columns, play_recording, stream_findings
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.taxels.result import Method
from skincal.words.poke_words import rejection_words
from skincal.words.verdict_words import verdict_sentence

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike

    from skincal.axes.module_axes import AxisFindings
    from skincal.axes.skin_turns import SkinTurns
    from skincal.reporting.session_facts import SessionFacts


@dataclass(frozen=True)
class Judgement:
    """Verdict on the estimates of one method."""

    sentence: str
    enough: bool
    """No more pokes are requested: every taxel is finished or given up."""
    finished: bool
    """It is enough, a taxel is finished, and enough pokes test the result."""
    believed: bool
    """Test pokes or landmarks confirm the predicted errors."""
    doubted: bool
    """Something contradicts the predicted errors: do not use the positions."""

    def __str__(self) -> str:
        """Return the sentence."""
        return self.sentence


class Session:
    """Pokes on a part and the estimates from them. Make one with `load`, `skincal.solve`, `skincal.simulate` or a reader.

    `name` is that of its folder or file, `results` are the values behind, as the program's commands use them.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        name: str,
        read_truth: Callable[[], TaxelPositions | None] = lambda: None,
        findings: tuple[str, ...] = (),
    ) -> None:
        self.results, self.name = SessionResults(pipeline), name
        self._read_truth, self._findings = read_truth, findings

    @classmethod
    def load(
        cls, folder: str | Path, *, layout: str | Path | None = None, replayed: bool = False, correct: bool = False
    ) -> Session:
        """Load a recorded session; nothing in its folder changes.

        Parameters
        ----------
        folder
            Of the session, as the window or `skincal record` wrote it.
        layout
            Layout file in place of the session's own.
        replayed
            Decode and judge the recorded bytes again, in place of the recorded pokes.
        correct
            Use the corrections of sensor and arm that landmark pokes support.

        Raises
        ------
        InputError
            The folder is no session, or no correction is supported.
        """
        path = Path(folder)
        pipeline = (replay if replayed else load)(path, None if layout is None else Path(layout))
        if correct:
            use_offered(pipeline.session)
        channels = list(pipeline.session.channels)
        return cls(pipeline, path.resolve().name, lambda: find_truth(path, pipeline.scene.link, channels))

    @cached_property
    def scene(self) -> Scene:
        """The part that was calibrated."""
        return Scene(self.results.part)

    @property
    def method(self) -> str:
        """Leading method: the one with the smallest predicted error among the nearly complete ones."""
        return self.results.choose_method(None).value

    @property
    def pokes(self) -> tuple[Outcome, ...]:
        """Every poke in order: a `Contact`, or a `Rejection` that does not count."""
        return tuple(record.outcome for record in self.results.snapshot.pokes)

    @property
    def rejections(self) -> Mapping[int, str]:
        """By the number of each rejected poke, the reason in words."""
        return {each.poke: rejection_words(each) for each in self.pokes if isinstance(each, Rejection)}

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on the recording: what was lost, paused or unusual."""
        return (*self.results.pipeline.findings, *self._findings)

    @cached_property
    def _truth(self) -> TaxelPositions | None:
        return self._read_truth()

    @property
    def truth(self) -> Taxels | None:
        """True taxels of a simulated session; `None` for a real one. Raises InputError: its file cannot be read."""
        return None if self._truth is None else taxels_at(self._truth, self.results.session.scene.link)

    def taxels(self, method: str | None = None) -> Taxels:
        """Return the estimates of `free`, `surface` or `modules`; `None` for the leading method.

        Raises
        ------
        InputError

            The scene lacks what the method needs.
        """
        chosen, snapshot = self._method(method), self.results.snapshot
        # The normals of the smooth part and the frame of the positions, as in files.
        calibration = self.results.session.calibration()
        turns = None if calibration.axes is None else calibration.axes.usable_turns(chosen)
        return taxels_of(calibration.estimates[chosen], calibration.scene, chosen, snapshot.part_size, turns)

    def turns(self, method: str | None = None) -> tuple[SkinTurns, AxisFindings]:
        """Find the turns of taxels of three axes, and what they say of modules and of the scene (`docs/three-axes.md`).

        The plans of modules are placed by the positions of a method; `None` for the leading one.

        Raises
        ------
        InputError

            The skin has one axis, or no accepted poke has a reading.
        """
        scene, found = self.results.session.scene, self.results.session.axis_results()
        if scene.skin.axes is None:
            raise InputError(f"{scene.path}: the turn of a taxel needs its three axes; set axes = 3 in [skin].")
        if found is None or not found.turns.skin.taxels:
            raise InputError(f"{scene.path}: no accepted poke has a reading of three axes; poke the skin first.")
        return found.turns.skin, found.findings(self._method(method))

    def verdict(self, method: str | None = None) -> Judgement:
        """Judge the estimates of a method; `None` for the leading one. Raises as `taxels`."""
        found = self.results.verdict(self._method(method))
        return Judgement(verdict_sentence(found), found.enough, found.is_finished, found.believed, found.doubted)

    def export(
        self,
        path: str | Path,
        format: str,  # noqa: A002 - as in the command
        method: str | None = None,
        options: ExportOptions | None = None,
    ) -> tuple[str, ...]:
        """Write the calibration file; an older one is kept as `.bak`.

        Parameters
        ----------
        path
            File to write.
        format
            Such as `"icub"`, `"urdf"`, `"json"`; `skincal export --help` lists all.
        method
            Whose positions are written; `None` for the leading one.
        options
            That only some formats have, such as `skincal.ExportOptions(prefix="left_")`.

        Returns
        -------
        tuple of str
            Sentences on faults of the positions and on what the format leaves out.

        Raises
        ------
        InputError
            An option does not fit the format, or the file cannot be written.
        """
        written, chosen = _member(ExportFormat, format, "format"), options or ExportOptions()
        chosen.require_use(written)
        return write_calibration(self.results.calibration(), written, Path(path), self._method(method), chosen)

    def facts(self, method: str | None = None) -> SessionFacts:
        """Gather everything that the report shows; raises as `taxels`."""
        from skincal.reporting.session_facts import gather_facts

        return gather_facts(self.results, self.name, self._truth, self._method(method))

    def report(self, path: str | Path, method: str | None = None) -> str:
        """Write the report, a page for the browser, and return the verdict; an older file is kept as `.bak`.

        Raises
        ------
        InputError

            The scene lacks what the method needs, or the file cannot be written.
        """
        from skincal.reporting.page import write_report

        return write_report(self.facts(method), Path(path))

    def __repr__(self) -> str:
        """Count the pokes in a line."""
        return f"Session({self.name}: {len(self.pokes)} pokes, {len(self.rejections)} of them rejected)"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}. {escape(str(self.verdict()))}</p>{self.taxels().html()}"

    def _method(self, asked: str | None) -> Method:
        return self.results.choose_method(None if asked is None else _member(Method, asked, "method"))


def solve(
    scene: Scene,
    wrenches: ArrayLike,
    responses: ArrayLike,
    poses: ArrayLike | None = None,
    times: ArrayLike | None = None,
) -> Session:
    """Estimate the taxels from arrays, a row a poke: the experiment of Del Prete et al. (2011) in one call.

    A force f at the point c of the skin has the moment m = c x f, so that each poke gives the line of its force. A taxel is the
    point nearest to the lines of its pokes (the paper's equation 5), on the mesh with the surface method, and of a module that
    all its pokes share with the modules method. `docs/method.md` has the equations with their weights and covariances.

    Parameters
    ----------
    scene
        Part that was poked.
    wrenches
        (n, 6) float, N and N m, sensor frame, about its origin: the mean of each poke without that at rest, with the sign that
        the scene's sensor has.
    responses
        (n, channels) float, raw units: change of each channel from its rest, as the skin reports it; NaN if unknown.
    poses
        (n, 4, 4) float, metres: the sensor in the frame of the link; `None` if nothing moves between them.
    times
        (n,) float, seconds; `None` if unknown: the work's duration is 0 then.

    Returns
    -------
    Session
        Without recording. Pokes that the scene's limits reject do not count; `rejections` has the reasons.

    Raises
    ------
    InputError
        An array has another shape, a wrench or a pose is none, or the scene's arm moves and `poses` are missing.
    """
    return Session(pipeline_of_arrays(scene.part, wrenches, responses, poses, times), "arrays")


def simulate(
    scene: Scene,
    pokes: int = 252,
    seed: int = 1,
    errors: str = "noise",
    folder: str | Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> Session:
    """Simulate a session of random pokes on a rig with known taxels (`Session.truth`).

    Parameters
    ----------
    scene
        Part with a layout that is placed on it.
    pokes
        Number of pokes; some are rejected, as on a real rig.
    seed
        Equal seeds give equal sessions.
    errors
        Of the rig: `"none"`, `"noise"` (a good rig), or `"paper"` (those of the paper's rig).
    folder
        For the recording; `None` to keep none.
    progress
        Called with the number of each poke that begins.

    Raises
    ------
    InputError
        The scene's layout has no place on the part, or the folder cannot be used.
    """
    from skincal.simulation.rig_errors import RigErrors
    from skincal.simulation.virtual_session import simulate_session

    if errors not in ("none", "noise", "paper"):
        raise InputError(f"errors: is {errors!r}; expected 'none', 'noise' or 'paper'.")
    part = scene.part
    rig: RigErrors = getattr(RigErrors, errors)()
    with TemporaryDirectory() as temporary:
        place = Path(temporary) / "simulated" if folder is None else Path(folder)
        pipeline = simulate_session(part.scene, part.surface, place, pokes, seed, rig, progress=progress)
        truth = find_truth(place, scene.link, part.channels.tolist())
        return Session(pipeline, place.name, lambda: truth)


def read_csv(
    scene: Scene,
    wrench: str | Path | None,
    skin: str | Path,
    joints: str | Path | None = None,
    pose: str | None = None,
    tool: str | Path | None = None,
) -> Session:
    """Read tables of readings over time, as `skincal import csv` does. Streams may be in one file, or in a file each.

    Columns are found by their names, which also state units: `fx [N]`, `mx_nmm`, `t_ms`. Without a unit, forces are newtons,
    moments newton metres, times seconds. Wrenches are in the frame of the sensor.

    Parameters
    ----------
    scene
        Part that was poked.
    wrench
        File with time and `fx fy fz mx my mz`; `None` for a rig without a force sensor.
    skin
        File with time and a column for each channel.
    joints
        File with time and a column for each joint; `None` if the arm did not move.
    pose
        Name of the scene's arm pose, if joints were not recorded.
    tool
        File with time and a pose of the tool a row, in the form of `[tool]` of the scene; `None` for a scene without it.

    Raises
    ------
    InputError
        A file is no such table, or its columns do not fit the scene.
    """
    paths = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints, Stream.TOOL: tool}
    places = {stream: RecordedPlace.parse(str(path)) for stream, path in paths.items() if path is not None}
    return _read("csv", scene, places, pose)


def read_bag(
    scene: Scene,
    path: str | Path,
    wrench: str = "",
    skin: str = "",
    joints: str = "",
    pose: str | None = None,
    tool: str = "",
) -> Session:
    """Read a recording of ROS (rosbag2, MCAP, ROS 1), as `skincal import rosbag` does.

    Wrenches are N and N m, angles rad, as ROS defines them. A wrench is in the frame that its messages name, and about its
    origin; it is converted to that of the sensor if the scene's URDF has both.

    Parameters
    ----------
    scene
        Part that was poked.
    path
        File or folder of the recording.
    wrench
        Topic of the force/torque sensor; empty for the likely one.
    skin
        Topic of the skin; empty for the likely one.
    joints
        Topic of the joint angles; empty for the likely one.
    pose
        Name of the scene's arm pose, if joints were not recorded.
    tool
        Topic of the tool's poses, such as `/tf?frame=tool0&base=base`; empty for a likely one of a scene with `[tool]`.

    Raises
    ------
    InputError
        The file is no such recording, or has no such topic.
    """
    named = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints, Stream.TOOL: tool}
    asked = {stream: topic for stream, topic in named.items() if topic}
    places, others = find_topics(Path(path), asked, scene.part.scene, pose)
    return _read("rosbag", scene, places, pose, tuple(others))


def _read(
    name: str, scene: Scene, places: Mapping[Stream, RecordedPlace], pose: str | None, findings: tuple[str, ...] = ()
) -> Session:
    importer = next(each for each in RECORDING_IMPORTERS if each.name == name)
    part = scene.part
    check_recorded_tool(part.scene, places)
    recording = importer.open_recording(places, joint_columns(part.scene), channels=part.scene.skin.frame_width)
    pipeline = Pipeline(part.scene, recording.links, part.surface, laid=part.laid)
    play_recording(pipeline, recording, pose)
    first = next(iter(places.values())).path
    return Session(pipeline, first.stem, findings=(*findings, *recording.findings, *stream_findings(pipeline)))


def _member(kind: Any, name: str, what: str) -> Any:
    try:
        return kind(name)
    except ValueError:
        known = ", ".join(each.value for each in kind)
        raise InputError(f"{what}: is {name!r}; expected one of {known}.") from None
