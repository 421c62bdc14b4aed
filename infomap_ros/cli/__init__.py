"""The command line ``infomap``: its commands, their options, and nothing that computes."""

from infomap_ros.cli.app import COMMANDS, app, main

__all__ = ["COMMANDS", "app", "main"]
