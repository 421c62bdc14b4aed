"""The one exception family of the package.

Every error that the library raises on purpose derives from `InfomapError`, so that a node or a
script can translate all of them in one place. An error names the thing that is wrong and carries
the offending values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import FunctionType


class InfomapError(Exception):
    """Base of all errors raised by infomap_ros; they pass from one process to another."""

    def __reduce__(self) -> tuple[Callable[..., InfomapError], tuple[object, ...]]:
        """Pickle message and attributes, as Python would call `__init__` with the message alone."""
        return _as_raised, (type(self), self.args, dict(self.__dict__))


def _as_raised(
    kind: type[InfomapError], args: tuple[object, ...], values: Mapping[str, object]
) -> InfomapError:
    """An error as it was in another process."""
    takes_more = isinstance(kind.__init__, FunctionType)  # than the message
    error = kind.__new__(kind, *args) if takes_more else kind(*args)
    error.__dict__.update(values)
    return error


class ConfigError(InfomapError, ValueError):
    """A parameter has an impossible value.

    Attributes:
        parameter: Name of the parameter, or the option of a command, which begins with ``--``.
        value: The value that was refused.
        expected: What would have been accepted, in words.
    """

    def __init__(self, parameter: str, value: object, expected: str) -> None:
        name = parameter if parameter.startswith("--") else f"parameter '{parameter}'"
        super().__init__(f"{name} is {value!r}, expected {expected}")
        self.parameter = parameter
        self.value = value
        self.expected = expected


class InvalidInputError(InfomapError, ValueError):
    """An array argument has the wrong shape, type or content.

    Attributes:
        name: Name of the argument.
        problem: What is wrong with it, in words.
    """

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name}: {problem}")
        self.name = name
        self.problem = problem


class CalibrationError(InfomapError, ValueError):
    """Camera calibrations are impossible or do not fit each other or the image."""


class MalformedMessageError(InfomapError, ValueError):
    """A message contradicts itself or holds what its type does not allow.

    Attributes:
        message_type: ROS type name, for example ``sensor_msgs/msg/Image``.
        problem: What is wrong with it, in words.
    """

    def __init__(self, message_type: str, problem: str) -> None:
        super().__init__(f"malformed {message_type}: {problem}")
        self.message_type = message_type
        self.problem = problem


class SensorFaultError(InfomapError, RuntimeError):
    """What a sensor delivers is not what it should be; nothing is measured by it meanwhile.

    Attributes:
        fault: its name, for counting.
    """

    def __init__(self, fault: str) -> None:
        super().__init__(f"camera fault: {fault}")
        self.fault = fault


class FrameError(InfomapError, LookupError):
    """A coordinate frame is unknown or two frames that must agree do not."""


class PoseUnavailableError(InfomapError, LookupError):
    """No pose is known at the stamp that asks for one.

    Attributes:
        reason: why, in a few fixed words, for counting.
        may_arrive: True where a pose that is still to come can change that.
    """

    def __init__(
        self, message: str, reason: str = "no pose at the stamp", may_arrive: bool = False
    ) -> None:
        super().__init__(message)
        self.reason = reason
        self.may_arrive = may_arrive


class UpdateRefusedError(InfomapError, ValueError):
    """A message of another robot must not change the map.

    Attributes:
        reason: why, in a few fixed words, for counting.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class BagError(InfomapError):
    """A bag cannot be read, is truncated, or lacks the topics that a task needs."""


class MapFileError(InfomapError):
    """A map file is corrupt, truncated, or of an unknown version."""


class MissionFileError(InfomapError):
    """A mission file is missing, corrupt, or holds impossible numbers."""


class RunLogError(InfomapError, ValueError):
    """A run log, or one of its lines, cannot be used; says which line and why."""


class ExplorationError(InfomapError, RuntimeError):
    """An exploration cannot go on; says what failed."""


class TeammatesBusyError(ExplorationError):
    """There is nothing to do for this robot until teammates have done what they are at."""


class CapacityError(InfomapError, MemoryError):
    """An operation would need more memory than the configuration allows."""


class RobotModelError(InfomapError, ValueError):
    """A robot description cannot be used: malformed URDF, unknown joint or frame."""


class MissingExtraError(InfomapError, ImportError):
    """A function needs an optional dependency that is not installed."""

    def __init__(self, extra: str, package: str) -> None:
        super().__init__(
            f"{package} is not installed: pip install 'infomap_ros[{extra}]' or {package}"
        )


class ResourceError(InfomapError, FileNotFoundError):
    """A file that belongs to the package is not where it should be."""


class SimulationError(InfomapError, RuntimeError):
    """The simulation cannot run: no way to render, or a scene that cannot be built."""


class ProcessError(InfomapError, RuntimeError):
    """A process of the package has ended when it should run, or runs when it should have ended."""
