"""How much of the package a reader, a robot and each node carry; it may shrink, not grow."""

from __future__ import annotations

import re
from collections import defaultdict

import pytest

from test.test_rooms import MODULES, NAMES, PACKAGE, module_of, own_imports, room_of

NOT_ON_A_ROBOT = {"simulation", "studies"}
_OVERFLOW = 110  # lines, below which a module with one user in its own folder is overflow of it

USED = {
    module: {module_of(name) for name, _ in own_imports(path)} & set(NAMES) - {module}
    for module, path in NAMES.items()
}
AT_IMPORT = {
    module: {module_of(name) for name, _ in own_imports(path, only_at_import=True)} & set(NAMES)
    for module, path in NAMES.items()
}
LINES = {module: len(path.read_text("utf-8").splitlines()) for module, path in NAMES.items()}


def nodes() -> list[str]:
    """The modules of the programs that setup.py installs, but for the command line."""
    setup = (PACKAGE.parent / "setup.py").read_text("utf-8")
    return re.findall(r"= (infomap_ros\.nodes\.\w+):main", setup)


def closure(module: str) -> set[str]:
    """What importing a module imports of the package, the packages above each included."""
    found: set[str] = set()
    open_ends = {module}
    while open_ends:
        found |= open_ends
        parents = {name.rpartition(".")[0] for name in open_ends} & set(NAMES)
        open_ends = parents.union(*(AT_IMPORT[name] for name in open_ends)) - found
    return found


def single_users() -> list[str]:
    """Short modules that one module alone uses, which lies in the same folder."""
    folders_of_users = defaultdict(list)
    for user, targets in USED.items():
        for target in targets:
            folders_of_users[target].append(NAMES[user].parent)
    return [
        module
        for module, path in NAMES.items()
        if folders_of_users[module] == [path.parent]
        and path.name != "__init__.py"
        and LINES[module] < _OVERFLOW
    ]


@pytest.mark.parametrize(
    ("what", "measured", "most"),
    [
        (
            "lines that a robot installs",
            sum(LINES[name] for name in NAMES if room_of(name) not in NOT_ON_A_ROBOT),
            86_160,  # 390 IMU, 590 frames apart, 435 changes, 165 sensors, 445 octrees, distances
        ),
        ("modules", len(MODULES), 480),
        ("short modules with one user in their folder", len(single_users()), 2),
    ],
)
def test_the_package_does_not_grow(what: str, measured: int, most: int) -> None:
    print(f"{what}: {measured}, at most {most}")
    assert measured <= most


MOST_LINES = {
    "stereo_range": 9_610,
    "map_fusion": 30_600,
    "bag_player": 9_130,
    "simulator": 29_890,
    "next_best_view": 46_860,
    "explorer": 42_220,
    "fiducial_localization": 38_630,
    "dead_reckoning": 11_960,
    "robot_driver": 13_620,
    "web_viewer": 32_640,
}
"""Of what importing a node's module imports; to be lowered with each of them."""


@pytest.mark.parametrize("node", nodes())
def test_a_node_imports_no_more_than_it_did(node: str) -> None:
    lines = sum(LINES[name] for name in closure(node))
    print(f"{node}: {lines} lines in {len(closure(node))} modules")
    assert lines <= MOST_LINES[node.rpartition(".")[2]]
