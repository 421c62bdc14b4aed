"""The ROS graph of the node tests."""

from test.nodes.conftest import graph

__all__ = ["graph"]
