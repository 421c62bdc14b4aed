"""The interfaces that the set-up builds, read by ROS's own parser."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import pytest
from rosidl_adapter.parser import (
    parse_action_string,
    parse_message_string,
    parse_service_string,
)

from infomap_ros.nodes.common.message_packages import PACKAGES, MessagePackage

_PARSERS = {
    "msg": parse_message_string,
    "srv": parse_service_string,
    "action": parse_action_string,
}
_PARTS = {"msg": (), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
INTERFACES = [(package, file) for package in PACKAGES for file in package.interfaces]


@pytest.mark.parametrize(("package", "file"), INTERFACES, ids=[file for _, file in INTERFACES])
def test_its_definition_is_one_that_ros_reads(package: MessagePackage, file: str) -> None:
    kind, _, name = file.partition("/")
    text, stem = package.interfaces[file], name.partition(".")[0]
    names = _PARTS[kind]
    definition = _PARSERS[kind](package.name, stem, text)
    parts = [getattr(definition, name.lower()) for name in names] or [definition]
    used = {field.type.pkg_name for part in parts for field in part.fields} - {None, package.name}
    assert used <= set(package.depends)
    if find_spec(package.name) is None:
        return
    built = getattr(import_module(f"{package.name}.{kind}"), stem)
    classes = [getattr(built, name) for name in names] or [built]
    for part, each in zip(parts, classes, strict=True):
        fields = [field.name for field in part.fields]
        assert list(each.get_fields_and_field_types())[: len(fields)] == fields
