"""Environment variables under which the nodes run best: the one place that knows them.

Launch files, `infomap_ros.nodes.live.demo` and the benchmarks start their processes with
`process_environment`; a shell gets the same by
``eval "$(python -m infomap_ros.nodes.common.environment)"``.
"""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

from infomap_ros.geometry.resources import find_share

_SHARED_MEMORY = Path("/dev/shm")
_WANTED_SHARED_MEMORY = 512 * 1024**2  # [bytes], for eight processes


def process_environment(base: Mapping[str, str] | None = None) -> dict[str, str]:
    """Environment for a process that runs a node.

    What `base` already sets stays as it is. Added are:

    - ``FASTRTPS_DEFAULT_PROFILES_FILE``: shared memory in which images and clouds fit, as far as
      the machine has it.
    - ``RMW_IMPLEMENTATION``: the middleware that the profile is for.

    Args:
        base: default the environment of this process.

    Raises:
        ResourceError: the profile is not installed.
    """
    environment = dict(os.environ if base is None else base)
    return {**environment, **additions(environment)}


def additions(base: Mapping[str, str] | None = None) -> dict[str, str]:
    """The variables that `process_environment` adds to `base`."""
    present = os.environ if base is None else base
    wanted = {
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(find_share(f"config/{_profile()}.xml")),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    }
    return {name: value for name, value in wanted.items() if name not in present}


def _profile() -> str:
    """Name of the Fast DDS profile for the shared memory that this machine has."""
    if not _SHARED_MEMORY.is_dir():
        return "fastdds_small"
    free = shutil.disk_usage(_SHARED_MEMORY).free
    return "fastdds" if free >= _WANTED_SHARED_MEMORY else "fastdds_small"


def reliable_inputs(topics: Iterable[str], namespace: str = "/") -> dict[str, str]:
    """Parameters that make a node's subscriptions reliable.

    Within one graph whose publishers are all reliable nothing is lost then, however busy the
    machine is.

    Args:
        topics: relative names.
        namespace: of the node.
    """
    prefix = "/".join(["", *filter(None, namespace.split("/"))])
    return {
        f"qos_overrides.{prefix}/{topic}.subscription.reliability": "reliable" for topic in topics
    }


if __name__ == "__main__":
    for name, value in additions().items():
        print(f"export {name}={shlex.quote(value)}")
