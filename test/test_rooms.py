"""The rooms of the package import only rooms to their left, and ROS stays in nodes/."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "infomap_ros"

# In the order in which data flows; rooms of one rank do not import each other.
RANKS = (
    {"errors"},
    {"geometry"},
    {"stereo"},
    {"mapping"},
    {"team", "localization", "views"},
    {"motion"},
    {"exploration"},
    {"messages", "viewer"},
    {"pipeline"},
    {"replay"},
    {"simulation"},
    {"studies"},
    {"nodes"},
    {"cli"},
)
RANK_OF = {room: rank for rank, rooms in enumerate(RANKS) for room in rooms}

ROS_NAMES = {"rclpy", "ament_index_python", "launch", "launch_ros", "tf2_ros"}
ROS_ENDINGS = ("_msgs", "_srvs", "_interfaces")

Imports = Iterator[tuple[str, int, bool]]


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def absolute_name(path: Path, node: ast.ImportFrom) -> str:
    """The module that a `from ... import` names, relative dots resolved."""
    if node.level == 0:
        return node.module or ""
    package = path.relative_to(PACKAGE.parent).parent.parts
    parts = package[: len(package) - node.level + 1]
    return ".".join((*parts, *([node.module] if node.module else [])))


def imports_of(path: Path, tree: ast.Module) -> Imports:
    """Every import as (dotted name, line, whether it runs when the module is imported)."""
    at_import = {id(node) for node in run_at_import(tree)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno, id(node) in at_import
        elif isinstance(node, ast.ImportFrom):
            module = absolute_name(path, node)
            for alias in node.names:
                yield f"{module}.{alias.name}", node.lineno, id(node) in at_import


def run_at_import(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes outside functions and outside ``if TYPE_CHECKING``."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        yield child
        yield from run_at_import(child)


MODULES = {path: ast.parse(path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
NAMES = {module_name(path): path for path in MODULES}


def room_of(name: str) -> str:
    """The room of a module; empty for the package itself and its private modules."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and not parts[1].startswith("_") else ""


def module_of(name: str) -> str:
    """The module of the package that a dotted name means: itself, or the one that defines it."""
    return name if name in NAMES else name.rpartition(".")[0]


def own_imports(path: Path, only_at_import: bool = False) -> Iterator[tuple[str, int]]:
    for name, line, at_import in imports_of(path, MODULES[path]):
        if name.split(".")[0] == PACKAGE.name and (at_import or not only_at_import):
            yield name, line


def test_rooms_import_only_rooms_to_their_left() -> None:
    assert not [
        f"{module}:{line} imports {name}"
        for module, path in NAMES.items()
        for name, line in own_imports(path)
        if (target := room_of(name)) != (room := room_of(module))
        and target in RANK_OF
        and (not room or RANK_OF[target] >= RANK_OF[room])
    ]


def test_every_room_has_its_place_in_the_order() -> None:
    rooms = {room_of(name) for name in NAMES} - {""}
    assert rooms <= set(RANK_OF)


def test_only_nodes_import_ros() -> None:
    assert not [
        f"{module}:{line} imports {name}"
        for module, path in NAMES.items()
        if room_of(module) != "nodes"
        for name, line, _ in imports_of(path, MODULES[path])
        if (top := name.split(".")[0]) in ROS_NAMES or top.endswith(ROS_ENDINGS)
    ]


def test_only_motion_imports_ompl() -> None:
    assert not [
        f"{module}:{line}"
        for module, path in NAMES.items()
        if room_of(module) != "motion"
        for name, line, _ in imports_of(path, MODULES[path])
        if name.split(".")[0] == "ompl"
    ]


def test_no_module_imports_itself_through_others() -> None:
    edges = {
        module: {module_of(name) for name, _ in own_imports(path, only_at_import=True)} - {module}
        for module, path in NAMES.items()
    }
    while leaves := {module for module, targets in edges.items() if not targets & set(edges)}:
        for leaf in leaves:
            del edges[leaf]
    assert not edges, f"in or before a circle: {sorted(edges)}"


def test_an_arrow_to_the_right_is_seen() -> None:
    path = PACKAGE / "geometry" / "imagined.py"
    tree = ast.parse("def f():\n    from ..nodes.common import base\nimport rclpy.node\n")
    found = {name: at_import for name, _, at_import in imports_of(path, tree)}
    assert found == {"infomap_ros.nodes.common.base": False, "rclpy.node": True}
    assert RANK_OF[room_of("infomap_ros.nodes.common.base")] > RANK_OF[room_of(module_name(path))]
