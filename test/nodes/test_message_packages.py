"""The interfaces that the set-up builds, read by ROS's own parser."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import pytest
from rosidl_adapter.parser import parse_action_string, parse_message_string

from infomap_ros.nodes.common.message_packages import PACKAGES, MessagePackage

INTERFACES = [(package, file) for package in PACKAGES for file in package.interfaces]


@pytest.mark.parametrize(("package", "file"), INTERFACES, ids=[file for _, file in INTERFACES])
def test_its_definition_is_one_that_ros_reads(package: MessagePackage, file: str) -> None:
    kind, _, name = file.partition("/")
    text, stem = package.interfaces[file], name.partition(".")[0]
    parse = parse_action_string if kind == "action" else parse_message_string
    definition = parse(package.name, stem, text)
    parts = [definition]
    if kind == "action":
        parts = [definition.goal, definition.result, definition.feedback]
    used = {field.type.pkg_name for part in parts for field in part.fields} - {None, package.name}
    assert used <= set(package.depends)
    if find_spec(package.name) is None:
        return
    built = getattr(import_module(f"{package.name}.{kind}"), stem)
    classes = [built.Goal, built.Result, built.Feedback] if kind == "action" else [built]
    for part, each in zip(parts, classes, strict=True):
        names = [field.name for field in part.fields]
        assert list(each.get_fields_and_field_types())[: len(names)] == names
