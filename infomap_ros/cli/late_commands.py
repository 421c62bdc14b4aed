"""Commands that are known by name before anything of theirs is loaded.

The rooms of the package take seconds to load, all together; a command line that answers ``--help``,
or runs one of many commands, needs few of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NamedTuple

import typer

PASSED_ON = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": [],  # --help is the other command's
}
"""Context settings of a command that hands all its arguments to another one."""
_HELPS = {"help_option_names": ["-h", "--help"]}


class LateCommand(NamedTuple):
    """A command, or a group of them, that is loaded when it is called.

    Attributes:
        place: ``module:name`` of a function that typer can make a command of, or of a group.
        help: what the list of commands says: the first line of its docstring, or of the group.
        example: a command line that its help ends with; empty for a group.
    """

    place: str
    help: str
    example: str = ""

    def load(self) -> Any:
        """The function or group."""
        module, name = self.place.split(":")
        return getattr(import_module(module), name)


def add_commands(app: typer.Typer, commands: Mapping[str, LateCommand]) -> None:
    """Add commands by their names to an application."""
    for name, command in commands.items():
        app.command(name, help=command.help, context_settings=PASSED_ON)(_passing_on(command))


def new_app(help: str, has_completion: bool = False) -> typer.Typer:
    """An application in the manner of all of the package's."""
    return typer.Typer(
        help=help,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",  # leaves the brackets of units alone
        add_completion=has_completion,
        context_settings=_HELPS,
    )


def _passing_on(command: LateCommand) -> Callable[[typer.Context], None]:
    def pass_on(context: typer.Context) -> None:
        loaded = command.load()
        app = loaded
        if not isinstance(loaded, typer.Typer):
            app = new_app(command.help)
            example = f"Example: `{command.example}`"
            app.command(context_settings=_HELPS, epilog=example)(loaded)
        app(context.args, prog_name=context.command_path)

    return pass_on
