"""Files that are there as they were or as they are to be, whenever the process ends."""

from __future__ import annotations

import json
import os
from pathlib import Path


def write_json(path: Path, content: object) -> None:
    """Write JSON beside a file and put it in its place when it is on the disk.

    Raises:
        OSError: the file cannot be written; what was there before stays.
    """
    beside = path.with_name(path.name + ".new")
    with beside.open("w", encoding="utf-8") as file:
        json.dump(content, file)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
