"""README, manual and help name the format for each program from one list, and every program of it has a test."""

from pathlib import Path

from skincal.files.consumers import EXPORT_CONSUMERS, consumers_help

CHECKOUT = Path(__file__).resolve().parents[2]
TESTED_BY = {
    "MuJoCo": "test_mujoco.py", "Drake": "by_name/test_programs.py", "pinocchio": "test_pinocchio.py",
    "iDynTree": "by_name/test_programs.py", "PyBullet": "by_name/test_programs.py", "Gazebo": "by_name/test_programs.py",
    "RViz": "by_name/test_programs.py", "Open3D": "by_name/test_programs.py", "MeshLab": "by_name/test_programs.py",
    "Blender": "by_name/test_programs.py", "nb-touch": "by_name/test_programs.py",
}  # fmt: skip


def table(*, with_hints: bool) -> str:
    rows = [("program", "`skincal export --format`", "what to know"), ("---", "---", "---")]
    rows += [(each.program, f"`{each.choice}`", each.hint) for each in EXPORT_CONSUMERS]
    return "\n".join(f"| {' | '.join(row if with_hints else row[:2])} |" for row in rows)


def test_readme_and_manual_have_the_table():
    for page, with_hints in (("README.md", False), ("docs/manual.md", True)):
        expected = table(with_hints=with_hints)
        assert expected in (CHECKOUT / page).read_text(encoding="utf-8"), f"expected in {page}:\n{expected}"


def test_the_help_names_every_program():
    assert [line.partition(":")[0] for line in consumers_help().split("\n\n")] == [each.program for each in EXPORT_CONSUMERS]


def test_every_program_has_a_test_of_its_own_export():
    assert list(TESTED_BY) == [each.program for each in EXPORT_CONSUMERS]
    for program, name in TESTED_BY.items():
        text = (Path(__file__).parent / name).read_text(encoding="utf-8")
        assert f'"{program}"' in text or each_format(program) in text, program


def each_format(program: str) -> str:
    (format_,) = (each.format_.value for each in EXPORT_CONSUMERS if each.program == program)
    return f'skin.write("{format_}"'
