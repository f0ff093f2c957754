"""`scene`: write the scene of a new part from a URDF, a mesh or neither, and show what a scene says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from skincal.cli.solve import Json
from skincal.model.errors import InputError, plural
from skincal.model.length_units import LengthUnit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from skincal.files.paxini_points import PaxiniModule
    from skincal.geometry import FloatArray
    from skincal.model.robot import RobotSpec
    from skincal.model.scene import Scene
    from skincal.part.part import Part
    from skincal.part.tool_draft import Rig, ToolDraft

_scenes = typer.Typer(
    help="Write the scene file of a new part, or show the content of one.",
    no_args_is_help=True,
    epilog="Example: skincal scene new --urdf robot.urdf --link forearm --sensor arm_ft --grid 6x8@9mm --out part/scene.toml",
)


def add_to(app: typer.Typer) -> None:
    """Add the commands of this module."""
    of_robot = "skincal scene new --urdf robot.urdf --link forearm --sensor arm_ft --layout modules.toml --out part/scene.toml"
    of_mesh = "skincal scene new --mesh part.stl --unit mm --grid 6x8@9mm --out part/scene.toml"
    of_tip = "skincal scene new --mesh tip.stl --paxini PXSR-STDDP03D --out tip/scene.toml"
    of_tool = "skincal scene new --urdf robot.urdf --link hand --sensor none --tip 0,0,120 --grid 6x8@9mm --out hand/scene.toml"
    of_pad = "skincal scene new --channels 16 --out pad/scene.toml"
    _scenes.command("new", epilog=f"Examples: {of_robot}; {of_mesh}; {of_pad}; {of_tip}; {of_tool}")(new_scene)
    _scenes.command("show", epilog="Example: skincal scene show part/scene.toml --joints 94,0")(show_scene)
    app.add_typer(_scenes, name="scene")


def new_scene(
    out: Annotated[Path, typer.Option(help="Scene file to write (*.toml).")],
    urdf: Annotated[
        Path | None,
        typer.Option(help="URDF of the robot that carries the part; ros2:/robot_description takes it from a running robot."),
    ] = None,
    link: Annotated[str, typer.Option(help="Link of the part: the frame of every position.")] = "part",
    sensor: Annotated[
        str,
        typer.Option(
            help="Force/torque sensor of the URDF, or a joint or link at it; tool for one on the tool that pokes, none for a "
            "rig without one (docs/tool.md)."
        ),
    ] = "",
    tip: Annotated[
        str, typer.Option(help="X,Y,Z of the tool's tip in the frame of its poses, mm; with --sensor tool or none.")
    ] = "",
    tip_radius: Annotated[float | None, typer.Option(min=0.0, help="Radius of the tip's ball, mm.")] = None,
    poses: Annotated[
        str,
        typer.Option(
            help="Form and unit of the tool's poses, such as vector:m, xyzw:mm or rpy:mm:degrees. Default: as the stream "
            "defines them (ROS, RTDE, P records)."
        ),
    ] = "",
    joints: Annotated[str, typer.Option(help="Columns of the joint stream, by joint name, separated by commas.")] = "",
    fixed: Annotated[list[str] | None, typer.Option(help="NAME=DEGREES of a joint that is not streamed; repeatable.")] = None,
    package: Annotated[
        list[str] | None, typer.Option(help="NAME=FOLDER of a ROS package that the URDF names; repeatable.")
    ] = None,
    reference: Annotated[
        bool,
        typer.Option("--reference", help="Refer to the robot's files where they are. Default: copy them to the folder of OUT."),
    ] = False,
    mesh: Annotated[Path | None, typer.Option(help="Mesh of the part; with a URDF it replaces the URDF's own mesh.")] = None,
    sign: Annotated[Literal["1", "-1"] | None, typer.Option(help="-1 if the sensor reports the reaction force.")] = None,
    unit: Annotated[
        LengthUnit | None,
        typer.Option(
            help="Unit of MESH, or of the URDF's own mesh. Default: mm, or the unit that a COLLADA or glTF file names; "
            "of a file that the URDF names, as the URDF scales it."
        ),
    ] = None,
    channels: Annotated[int | None, typer.Option(min=1, help="Number of taxels; default: those of the layout.")] = None,
    polarity: Annotated[Literal["up", "down"], typer.Option(help="Values rise or fall under pressure.")] = "up",
    layout: Annotated[
        Path | None, typer.Option(help="Layout: a file of skincal (*.toml), an iCub .ini, or a table of positions.")
    ] = None,
    grid: Annotated[str, typer.Option(help="Taxels in a grid: ROWSxCOLUMNS@PITCHmm, such as 6x8@9mm.")] = "",
    paxini: Annotated[
        str,
        typer.Option(
            help="PaXini modules in the order of the stream, separated by commas: part code, model or number of taxels. Their "
            "points are read from your own package paxini-sdk."
        ),
    ] = "",
    paxini_sdk: Annotated[
        Path | None, typer.Option(help="Folder or wheel of paxini-sdk; default: the installed package.")
    ] = None,
    axes: Annotated[
        Literal["1", "3"] | None, typer.Option(help="Values of a taxel: 3 for a force vector. Default: 1; PaXini 3.")
    ] = None,
    skin_unit: Annotated[
        Literal["raw", "N"] | None, typer.Option(help="Unit of the values of --axes 3. Default: raw; PaXini N.")
    ] = None,
    kind: Annotated[
        Literal["board", "sheet"] | None,
        typer.Option(
            help="What the skin is: rigid boards, or a soft sheet that stretches. Default: as the layout file says; "
            "a grid or a table of positions is a sheet, modules of an .ini are boards."
        ),
    ] = None,
    anchor_mm: Annotated[
        str,
        typer.Option(help="X,Y,Z of the layout's middle in the link frame, mm. Default: the middle of the largest free face."),
    ] = "",
    as_json: Json = False,
) -> None:
    """Write the scene file of a new part."""
    from skincal.cli import output
    from skincal.part.part import load_part
    from skincal.part.part_draft import PartDraft
    from skincal.part.scene_draft import write_scene
    from skincal.part.tool_draft import Rig

    _check_layout_options(layout, grid, paxini, paxini_sdk)
    columns = _joint_columns(joints)
    modules = _paxini_modules(paxini, paxini_sdk) if paxini else []
    rig = _rig_of(sensor)
    tool = _tool_of(rig, tip, tip_radius, poses)
    if rig is not Rig.BELOW:
        _refuse_chain(urdf, sensor, [("--joints", columns), ("--fixed", fixed)], is_meant=bool(tip or poses))
    axes_of_taxel = int(axes or ("3" if modules else "1"))
    draft = PartDraft(
        rig=rig,
        tool=tool,
        urdf=_saved_description(str(urdf), out) if str(urdf).startswith("ros2:") else urdf,
        link=link,
        sensor=sensor if rig is Rig.BELOW else "",
        joints=tuple(columns),
        fixed=tuple((name, _degrees(name, text)) for name, text in _pairs(fixed or [], "--fixed", "DEGREES")),
        packages=tuple((name, Path(folder)) for name, folder in _pairs(package or [], "--package", "FOLDER")),
        copies_robot=not reference,
        mesh=mesh,
        sign=None if sign is None else int(sign),
        unit=unit or "",
        channels=channels,
        polarity=polarity,
        axes=axes_of_taxel,
        skin_unit=_skin_unit(skin_unit, axes_of_taxel, is_paxini=bool(modules)),
        layout_text=_layout_text(layout, grid, modules, kind),
    )
    write_scene(draft, out, _numbers(anchor_mm, 3, "--anchor-mm") if anchor_mm else None)
    part, points = load_part(out), _write_points(modules, out)
    result = scene_result(part, None)
    lines = [f"wrote {out}{_copy_words(out)}", *points, *_lines(result), *_limit_lines(part.scene)]
    output.print_result(result, lines, as_json)


def _check_layout_options(layout: Path | None, grid: str, paxini: str, paxini_sdk: Path | None) -> None:
    """Refuse two layouts, and the folder of a maker's points without a module."""
    if sum((layout is not None, bool(grid), bool(paxini))) > 1:
        raise InputError("--layout, --grid and --paxini exclude each other; keep one.")
    if paxini_sdk is not None and not paxini:
        raise InputError("--paxini-sdk says where the points of --paxini are; name the modules by --paxini, or leave it out.")


def _joint_columns(joints: str) -> list[str]:
    """Read `--joints`. Raises InputError: a joint is named twice."""
    columns = [name.strip() for name in joints.split(",") if name.strip()]
    _refuse_twice(columns, "--joints")
    return columns


def _skin_unit(unit: str | None, axes: int, *, is_paxini: bool) -> str:
    """Read `--skin-unit`: `"N"`, or nothing for raw values. Raises InputError: taxels have one axis."""
    if unit is not None and axes == 1:
        raise InputError("--skin-unit is for taxels of three axes; add --axes 3, or leave it out.")
    return "N" if axes != 1 and (unit or ("N" if is_paxini else "raw")) == "N" else ""


def _limit_lines(scene: Scene) -> list[str]:
    """List the limits that a new scene of three axes has by the distance of its taxels and by their unit."""
    axes, layout = scene.skin.axes, scene.skin.layout
    if axes is None:
        return []
    unit = "newtons" if axes.unit == "N" else 'raw; write unit = "N" in [skin] if the device sends newtons (--skin-unit N)'
    lines = [f"  values are {unit}; a taxel answers above {scene.contacts.response_min:g}"]
    if layout is not None:
        lines.append(
            f"  a poke may press {scene.contacts.taxels_max} taxels (taxels_max): by a tip of 4 mm radius and taxels "
            f"{layout.spacing * 1e3:.1f} mm apart; write more for a larger tip"
        )
    return lines


def _rig_of(sensor: str) -> Rig:
    """Read `--sensor`: a rig of a tool, or the name of a sensor below the part."""
    from skincal.part.tool_draft import Rig

    return {"tool": Rig.ON_TOOL, "none": Rig.NONE}.get(sensor, Rig.BELOW)


def _refuse_chain(urdf: Path | None, sensor: str, others: list[tuple[str, Any]], *, is_meant: bool) -> None:
    """Refuse options of a sensor below the part, and a word that may also be the name of a link or a joint of the URDF."""
    from skincal.model.urdf import read_urdf

    given = next((option for option, value in others if value), None)
    if given is not None:
        raise InputError(f"{given} is of joints between part and sensor, and --sensor {sensor} needs none; leave it out.")
    robot = None if urdf is None or str(urdf).startswith("ros2:") else read_urdf(urdf)
    if robot is not None and not is_meant and (sensor in robot.links or sensor in robot.joints):
        raise InputError(
            f"--sensor {sensor} means a rig, and {robot.path.name} has a link or joint of this name. For the rig also give "
            "--tip or --poses; for a sensor there name another joint or link at it."
        )


def _tool_of(rig: Rig, tip: str, radius: float | None, poses: str) -> ToolDraft:
    """Read the options of a tool. Raises InputError: they make no sense, or the sensor is below the part."""
    from skincal.model.length_units import METRES_PER_UNIT
    from skincal.part.tool_draft import FORM_OF_NAME, NO_TOOL, Rig, ToolDraft

    given = [name for name, value in (("--tip", tip), ("--tip-radius", radius), ("--poses", poses)) if value not in ("", None)]
    if rig is Rig.BELOW:
        if given:
            raise InputError(f"{given[0]} is of a tool that pokes; expected --sensor tool or --sensor none with it.")
        return NO_TOOL
    form, _, rest = poses.partition(":")
    unit, _, angles = rest.partition(":")
    has_angles = form in FORM_OF_NAME and FORM_OF_NAME[form].has_angles
    is_right = form in FORM_OF_NAME and unit in METRES_PER_UNIT and angles in ("", "radians", "degrees")
    if poses and (not is_right or (angles and not has_angles)):
        forms, units = ", ".join(FORM_OF_NAME), ", ".join(METRES_PER_UNIT)
        raise InputError(
            f"--poses is {poses}; expected FORM:UNIT, or FORM:UNIT:degrees for a form with angles, with one of {forms}; and of "
            f"{units}."
        )
    point = None if not tip else _numbers(tip, 3, "--tip")
    return ToolDraft(
        rotation=form,
        unit=unit,
        degrees=angles == "degrees" if has_angles else None,
        tip_mm=None if point is None else (float(point[0]), float(point[1]), float(point[2])),
        tip_radius_mm=radius,
    )


def _paxini_modules(names: str, package: Path | None) -> list[PaxiniModule]:
    """Read the modules that `--paxini` names, from the user's own package."""
    from skincal.files.paxini_points import read_modules

    named = [name for name in names.split(",") if name.strip()]
    if not named:
        raise InputError(f"--paxini {names!r} names no module; expected a part code, a model or a number of taxels.")
    return read_modules(named, package)


def _layout_text(layout: Path | None, grid: str, modules: Sequence[PaxiniModule], kind: str | None) -> str:
    """Make the text of the layout file from a file, a grid, or modules of a maker; empty without a layout.

    Raises InputError: the layout cannot be read, or a kind of skin is named without a layout.
    """
    from skincal.files.layout_sources import parse_grid, read_layout_file, text_with_kind
    from skincal.model.skin import SkinKind

    text = parse_grid(grid).layout_text() if grid else "" if layout is None else read_layout_file(layout)
    if modules:
        from skincal.files.paxini_points import layout_text

        text = layout_text(modules)
    if kind is None:
        return text
    if not text:
        raise InputError(
            "--kind says what the skin of a layout is; name the layout by --layout, --grid or --paxini, or leave it out."
        )
    return text_with_kind(text, SkinKind(kind))


def _copy_words(out: Path) -> str:
    """Return words for the size of the robot that was copied next to a scene; empty without a robot."""
    from skincal.part.robot_copy import ROBOT_FOLDER, size_words

    copied = [path for path in (out.parent / ROBOT_FOLDER).rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in copied)
    return f"; copied the robot, {size_words(len(copied), size)}" if copied else ""


def _write_points(modules: Sequence[PaxiniModule], out: Path) -> list[str]:
    """Write the points of a single module next to the scene, to compare a calibration with; return a line on it."""
    if len(modules) != 1:
        return []
    from skincal.files.atomic import write_atomically
    from skincal.files.paxini_points import positions_as_json

    path = out.parent / f"{modules[0].code}_points.json"
    write_atomically(path, positions_as_json(modules).encode())
    return [f"wrote {path}: the maker's points in the frame of the module, for `skincal compare SESSION {path}`"]


def _saved_description(address: str, out: Path) -> Path:
    """Save the URDF of a running robot next to the scene. Raises InputError: none comes, or another file is there."""
    from skincal.streams.ros_topics import read_robot_description

    text, file = read_robot_description(address), out.with_suffix(".urdf")
    if file.exists() and file.read_bytes() != text:
        raise InputError(f"{file} is another robot description; move it away, or name it by --urdf.")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text)
    except OSError as error:
        raise InputError(f"{file} cannot be written ({error.strerror}); choose another --out.") from None
    return file


def show_scene(
    scene: Annotated[Path, typer.Argument(help="Scene file, or the name of one that ships.", show_default=False)],
    joints: Annotated[str, typer.Option(help="Angles of the joint stream's columns, degrees, separated by commas.")] = "",
    as_json: Json = False,
) -> None:
    """Show the chain between sensor and part, the sensor's pose and all findings."""
    from skincal.cli import output
    from skincal.model.scene import scene_file
    from skincal.part.part import load_part

    result = scene_result(load_part(scene_file(scene)), _numbers(joints, None, "--joints") if joints else None)
    output.print_result(result, _lines(result), as_json)


def scene_result(part: Part, degrees: FloatArray | None) -> dict[str, Any]:
    """Convert a part to JSON: chain, sensor pose (4 x 4, metres) at the given joint columns (degrees), and findings."""
    import numpy as np

    from skincal.words.tool_words import tool_facts

    scene, robot = part.scene, part.scene.robot
    angles, of_joints = _joint_angles(scene, degrees)
    pose = scene.sensor_pose if scene.arm is None or angles is None else scene.arm.arm.link_from_sensor(angles)
    findings = [*part.findings, *of_joints, *_scene_findings(part, pose)]
    return {
        "scene": str(scene.path),
        "link": scene.link,
        "sensor": None if robot is None else robot.sensor or None,
        "chain": [] if robot is None else [
            {
                "joint": step.joint.name, "kind": step.joint.kind, "streamed": step.joint in robot.chain.moving,
                "follows": step.follows,
            }
            for step in reversed(robot.chain.steps)
        ],
        "joints_deg": None if angles is None else np.degrees(angles).tolist(),
        # A sensor on the tool has another pose at each poke.
        "link_from_sensor": None if scene.tool is not None else pose.tolist(),
        "tool": None if scene.tool is None else tool_facts(scene.tool),
        "wrench_sign": scene.wrench_sign,
        "mesh": None if scene.surface is None else str(scene.surface.path),
        "channels": scene.skin.channels,
        "frame_width": scene.skin.frame_width,
        "taxels": None if scene.skin.layout is None else len(scene.skin.layout.channels),
        "kind": None if scene.skin.layout is None else scene.skin.layout.kind.value,
        "findings": findings,
    }  # fmt: skip


def _joint_angles(scene: Scene, degrees: FloatArray | None) -> tuple[FloatArray | None, list[str]]:
    """Choose the joint angles (rad) between sensor and part: the given ones, else of an arm pose. Return them and findings."""
    import numpy as np

    from skincal.geometry import Arm

    if scene.arm is None:
        if degrees is not None:
            raise InputError("--joints: the scene has no joints between sensor and part; leave it out.")
        return None, []
    arm = scene.arm.arm
    if degrees is not None:
        if len(degrees) <= max(arm.joints):
            raise InputError(f"--joints has {len(degrees)} angles; the scene needs columns {list(arm.joints)}.")
        angles = np.radians(degrees)[list(arm.joints)]
    else:
        zero = np.zeros(len(arm.joints)) if isinstance(arm, Arm) else arm.middle_angles()
        angles = next(iter(scene.arm.poses.values()), zero)
    warning = None if isinstance(arm, Arm) else arm.limit_warning(angles)
    return angles, [] if warning is None else [warning]


def _scene_findings(part: Part, pose: FloatArray) -> list[str]:
    """List what is unusual about robot, layout and landmarks of a scene, with its sensor at `pose` (4, 4), metres."""
    import numpy as np

    from skincal.mesh.laid_check import landmark_findings
    from skincal.part.robot_mesh import describe_shapes
    from skincal.words.layout_words import frame_findings, kind_findings
    from skincal.words.tool_words import tool_findings

    scene, robot = part.scene, part.scene.robot
    findings: list[str] = []
    # Without [sensor] its place is not known.
    is_placed = robot is not None or scene.arm is not None or not np.array_equal(pose, np.eye(4))
    if scene.tool is not None:
        findings += tool_findings(scene.tool, scene.wrench_sign, finds_part_pose=scene.finds_part_pose)
    elif not is_placed:
        findings.append("the sensor is taken at the origin of the link, with the link's axes; [sensor] gives another pose")
    if robot is not None:
        findings += robot_findings(robot, scene.link, scene.wrench_sign)
        if scene.surface is None:
            joint = robot.urdf.sensor_named(robot.sensor, str(scene.path)).joint if robot.sensor else ""
            seen = describe_shapes(robot.urdf, scene.link, joint)
            findings.append(f"no mesh: {seen}. Name the part's mesh by --mesh of scene new, or in [surface]")
    findings += frame_findings(scene.skin)
    findings += _placement_findings(part, pose[:3, 3] if is_placed else None)
    if scene.skin.layout is None:
        findings.append("no layout: the modules method is not available, and the guide searches for the taxels")
    else:
        findings += kind_findings(scene.skin.layout, is_on_mesh=part.surface is not None)
    findings += landmark_findings({mark.name: mark.place for mark in scene.landmarks}, part.surface)
    if not scene.landmarks and scene.finds_part_pose:
        findings.append(
            "no landmarks: three or more show the part's pose by a few touches. Click them on the window's page (Change a "
            "part), or write [[landmarks]] into the scene"
        )
    elif not scene.landmarks:
        findings.append("no landmarks: a shift that all taxels share would go unnoticed")
    return findings


def _placement_findings(part: Part, sensor: FloatArray | None) -> tuple[str, ...]:
    from skincal.mesh.laid_check import examine_layout

    layout = part.scene.skin.layout
    return () if layout is None else examine_layout(layout, part.scene.skin.anchor, part.laid, part.surface, sensor).sentences


def robot_findings(robot: RobotSpec, link: str, wrench_sign: int) -> list[str]:
    """List what is unusual or unknown about a robot's sensor, and where its mesh is from."""
    from skincal.words.robot_words import replaced_mesh_findings, sensor_findings

    findings: list[str] = []
    if not robot.sensor:
        pass  # [tool] says where it is
    elif robot.sign is None:
        findings.append("the URDF does not say whether the sensor reports the force or its reaction: see [wrench] sign")
    elif robot.sign != wrench_sign:
        findings.append(f"[wrench] sign is {wrench_sign:+d}, and the URDF says {robot.sign:+d}: check one of them")
    findings += sensor_findings(robot.urdf, robot.sensor, link) if robot.sensor else []
    if robot.mesh is not None and robot.mesh[3]:
        findings += replaced_mesh_findings(robot.urdf.meshes[robot.mesh_link], robot.mesh[0])
    if robot.mesh_link and robot.mesh_link != link:
        findings.append(f"the mesh has the pose of that of link {robot.mesh_link}, which is fixed to {link}")
    others = robot.urdf.meshes[robot.mesh_link].others if robot.mesh_link else 0
    if others:
        findings.append(
            f"link {robot.mesh_link} has {plural(others, 'further visual shape')} without use here: if taxels lie there, merge "
            "them into one mesh, and name it in [robot] mesh"
        )
    return findings


def _lines(result: dict[str, Any]) -> list[str]:
    from skincal.model.skin import SkinKind
    from skincal.words.layout_words import SKIN_KIND_WORDS

    of = "" if result["kind"] is None else f" on {SKIN_KIND_WORDS[SkinKind(result['kind'])]}"
    lines = [f"link {result['link']}, {result['channels']} channels, {result['taxels'] or 'unknown'} taxels{of}"]
    if result["sensor"] is not None:
        lines.append(f"sensor {result['sensor']}, sign {result['wrench_sign']:+d}")
    for joint in result["chain"]:
        words = "streamed" if joint["streamed"] else f"follows {joint['follows']}" if joint["follows"] else joint["kind"]
        lines.append(f"  joint {joint['joint']}: {words}")
    if result["joints_deg"] is not None:
        lines.append("at " + ", ".join(f"{angle:g}" for angle in result["joints_deg"]) + " degrees")
    if result["link_from_sensor"] is not None:
        lines.append("pose of the sensor in the link, metres:")
        lines += ["  " + " ".join(f"{value + 0.0:10.6f}" for value in row) for row in result["link_from_sensor"]]
    if result["tool"] is not None:
        lines += ["tool:", *(f"  {what}: {said}" for what, said in result["tool"].items())]
    return [*lines, f"mesh: {result['mesh'] or 'none'}", *(f"- {finding}" for finding in result["findings"])]


def _pairs(given: list[str], option: str, value: str) -> list[tuple[str, str]]:
    pairs = [text.partition("=") for text in given]
    if not all(name and after for name, _, after in pairs):
        raise InputError(f"{option} {' '.join(given)}: expected NAME={value}.")
    _refuse_twice([name for name, _, _ in pairs], option)
    return [(name, after) for name, _, after in pairs]


def _refuse_twice(names: list[str], option: str) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{option} has {twice} twice; expected different names.")


def _numbers(text: str, count: int | None, option: str) -> FloatArray:
    import numpy as np

    try:
        values = np.array([float(word) for word in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if not len(values) or (count is not None and len(values) != count) or not np.isfinite(values).all():
        expected = {None: "numbers separated by commas", 1: "a number"}.get(count, f"{count} numbers separated by commas")
        raise InputError(f"{option} is {text}; expected {expected}.")
    return values


def _degrees(name: str, text: str) -> float:
    from skincal.model.tables import check_degrees

    angle = _numbers(text, 1, f"--fixed {name}")
    check_degrees(angle, f"--fixed {name}")
    return float(angle[0])
