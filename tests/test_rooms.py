"""Who may import whom: the rows of the table in docs/architecture.md from top to bottom, and no circles.

Imports inside functions and under TYPE_CHECKING count. A new room is a new row of that table.
"""

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def rooms_in(text: str) -> dict[str, int]:
    """Modules, and folders with a slash at the end, of the table's first column: the number of their row."""
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {name: row for row, cell in enumerate(cells) for name in re.findall(r"`([\w/]+)`", cell)}


def imports_in(package: Path) -> dict[str, set[str]]:
    """What each module imports of the package. Modules are named as in the table, `sweeping/store`, the
    package's own front by its name."""
    files = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    short = {name: "/".join(name.split(".")[1:]) or name for name in files}
    return {
        short[name]: {short[x] for x in _imported(ast.parse(path.read_text()), files)}
        for name, path in files.items()
    }


def _imported(tree: ast.AST, known: dict[str, Path]) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are written in full"
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in known else str(node.module) for name in whole}
    return found & set(known)


def faults_of(imports: dict[str, set[str]], rooms: dict[str, int]) -> list[str]:
    """What breaks the order, in words."""

    def row(module: str) -> int | None:
        return rooms.get(module, rooms.get(module.split("/")[0] + "/"))

    found = [f"{module} is in no room" for module in imports if row(module) is None]
    found += [
        f"{module} imports {other}, from a room below"
        for module, others in imports.items()
        for other in sorted(others)
        if (row(other) or 0) > (row(module) or 0)
    ]
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        found.append("a circle: " + " <- ".join(error.args[1]))
    return found


def test_modules_import_from_rooms_above_and_in_no_circle():
    rooms = rooms_in((ROOT / "docs" / "architecture.md").read_text())
    assert faults_of(imports_in(ROOT / "pedjax"), rooms) == []
    for name in rooms:
        place = ROOT / "pedjax" / name
        assert place.is_dir() or place.with_suffix(".py").is_file() or name == "pedjax", name


MADE_UP = {
    "__init__": "from made_up.high import run",
    "low": "import numpy",
    "middle/__init__": "",
    "middle/one": "from made_up import low\nfrom made_up.middle import two",
    "middle/two": "from made_up.low import something",
    "high": "import made_up.middle.one",
}
TABLE = "| `low` | |\n| `middle/` | |\n| `high` | |\n| `made_up` | |"


@pytest.mark.parametrize(
    ("module", "line", "fault"),
    [
        ("high", "", []),
        (
            "middle/two",
            "from made_up.middle import one",
            ["a circle: middle/one <- middle/two <- middle/one"],
        ),
        ("low", "def f():\n    from made_up.low import x", ["a circle: low <- low"]),
        ("middle/two", "def f():\n    from made_up.high import run", None),
        ("low", "if TYPE_CHECKING:\n    import made_up.middle.two", None),
        ("stray", "", ["stray is in no room"]),
    ],
)
def test_what_is_put_in_by_hand_is_found(tmp_path, module, line, fault):
    for name, text in {**MADE_UP, module: f"{MADE_UP.get(module, '')}\n{line}"}.items():
        path = tmp_path / "made_up" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = faults_of(imports_in(tmp_path / "made_up"), rooms_in(TABLE))
    if fault is None:
        assert f"{module} imports" in found[0]
        assert "a circle" in found[1]
    else:
        assert sorted(map(sorted, found)) == sorted(map(sorted, fault))
