"""A study that is interrupted, or whose command was killed, ends with all its processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

_STUDY = """
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

from infomap_ros.studies.runs import Kept, run_all


@dataclass(frozen=True)
class Nothing:
    count: int


@dataclass(frozen=True)
class Work:
    number: int

    @property
    def file_name(self):
        return f"{self.number}.npz"

    def fingerprint(self):
        return str(self.number)

    def run(self):
        if self.number == 0 and sys.argv[1] == "interrupted":
            os.killpg(0, signal.SIGINT)  # as Ctrl-C does
        elif self.number == 0:
            os.kill(os.getppid(), signal.SIGKILL)
            signal.pause()
        return Nothing(self.number)


if __name__ == "__main__":
    run_all([Work(number) for number in range(9)], Kept(Path(sys.argv[2]), Nothing), 1)
"""


def study(tmp_path: Path, how: str) -> tuple[int, list[str]]:
    """Exit code and kept results; waits until all processes have closed their output."""
    script = tmp_path / "study.py"
    script.write_text(_STUDY)
    done = subprocess.run(
        [sys.executable, str(script), how, str(tmp_path / "runs")],
        capture_output=True,
        timeout=120.0,
        start_new_session=True,
        check=False,
    )
    return done.returncode, [path.name for path in (tmp_path / "runs").iterdir()]


def test_interrupt_ends_a_study_at_once(tmp_path: Path) -> None:
    code, kept = study(tmp_path, "interrupted")
    assert code != 0
    assert kept == []


def test_workers_end_with_the_command(tmp_path: Path) -> None:
    code, kept = study(tmp_path, "killed")
    assert code != 0
    assert kept == []
