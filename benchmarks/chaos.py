"""Chaos: faults at random times in a live exploration, and what becomes of it after each.

Simulator, localization, range, map, choice and loop are processes, as in the demo. Again and again
one of them is killed and started anew, stopped for 10 s, or starved; a sensor tells a wrong time;
the map's disk is full; half of the times while the robot moves. After each fault the mission has to
go on, the poses to be within 3 sigma of the simulator's truth, and the robot to touch nothing. The
faults are drawn from the seed; when they come depends on the machine.

Prints one JSON line per fault, and a table for docs/robustness.md at the end; exits with 1 where
one of them was not survived. Takes 1 to 3 minutes a fault.

    python benchmarks/chaos.py --faults 200 --seed 1 --out out/chaos
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, JointState

from infomap_ros.errors import ProcessError
from infomap_ros.geometry.atomic_file import write_json
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.live.demo_command import demo_world, empty_folder, task_parameters
from infomap_ros.nodes.live.live_exploration import LiveExploration
from infomap_ros.nodes.live.live_truth import LiveTruth, live_map_frame
from infomap_ros.nodes.simulated.simulated_driver import has_actions

SIZE = 6.0  # of the world [m]
STOPPED, STARVED = 10.0, 20.0  # [s]
RUNS, SLEEPS = 0.05, 0.20  # of a starved process, in turn [s]
FULL_DISK = 4096  # bytes that fit into a file
WRONG_CLOCK = 3600.0  # [s] by which a stamp is wrong
PATIENCE = 240.0  # [s] until the mission goes on; a loaded machine takes its time to choose
STARTING = 1800.0  # [s]; kernels may have to be compiled
MOVING = 45.0  # [s] to wait for the robot to move
LEAST_SPEED = 0.03  # [m/s, rad/s]
CHI_SQUARE = 20.06  # of six degrees of freedom, as likely as 3 sigma of one
NODES = (
    "simulator",
    "robot_driver",
    "fiducial_localization",
    "stereo_range",
    "map_fusion",
    "next_best_view",
    "explorer",
)
SENSORS: dict[str, tuple[str, type]] = {
    "left image": ("left/image_raw", Image),
    "odometry": ("odom", Odometry),
    "joints": ("joint_states", JointState),
}
KINDS = ("kill", "stop", "starve", "clock", "disk")


@dataclass(frozen=True)
class Fault:
    """What is done, to whom.

    Attributes:
        kind: one of `KINDS`.
        victim: a node, or a sensor for a wrong clock.
        in_motion: whether to wait for the robot to move.
    """

    kind: str
    victim: str
    in_motion: bool


def drawn_faults(count: int, seed: int) -> Iterator[Fault]:
    """Faults of all kinds and victims, in an order drawn from the seed."""
    rng = np.random.default_rng(seed)
    nodes = NODES if has_actions() else tuple(name for name in NODES if name != "robot_driver")
    victims: dict[str, tuple[str, ...]] = dict.fromkeys(("kill", "stop", "starve"), nodes)
    victims |= {"clock": tuple(SENSORS), "disk": ("map_fusion",)}
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        yield Fault(kind, str(rng.choice(victims[kind])), bool(rng.random() < 0.5))


class ChaosRun:
    """One exploration, and the faults that it meets.

    Args:
        out: folder of the run; what was in it is gone.
        seed: of the world.
    """

    def __init__(self, out: Path, seed: int) -> None:
        empty_folder(out)
        world = demo_world("mars", seed, SIZE)
        task = task_parameters(world, {"known_fraction": 1.0, "max_views": 10_000})
        simulator = {"world": "mars", "world_seed": seed, "world_size": SIZE}
        camera = {"camera.width": 320, "camera.height": 240, "camera.supersampling": 1}
        quick = {"arm_views": 50, "choice.candidates.candidates": 200}
        self.run = LiveExploration(
            out,
            {
                "simulator": {**simulator, **camera},
                "map_fusion": {"voxel_size": 0.1},
                "next_best_view": {**task, **quick},
                "explorer": task,
            },
        )
        self._frame = live_map_frame(world)
        self._judged = 0
        self._last: dict[str, Any] = {}
        self._contacts = 0

    def start(self) -> None:
        """Start all nodes and wait for the first view."""
        self._truth = LiveTruth(self.run)
        self._publishers = {}
        for topic, kind in SENSORS.values():
            self.run.subscribe(kind, topic, self._keeper(topic), qos.stream())
            self._publishers[topic] = self.run.publisher(kind, topic)
        self.run.start()
        self.run.spin_until(lambda: self.views > 0 or self.run.ended, "the first view", STARTING)

    def meet(self, fault: Fault) -> dict[str, object]:
        """Let the run meet a fault; returns what came of it.

        Raises:
            ProcessError: a node has died of it.
        """
        run = self.run
        if fault.in_motion:
            with contextlib.suppress(ProcessError):
                run.spin_until(lambda: self.is_moving or run.ended, "a motion", MOVING)
        known = {
            "fault": fault.kind,
            "victim": fault.victim,
            "in_motion": self.is_moving,
            "state": run.figures.get("state", ""),
        }
        self._begin_poses()
        before, begin = self.views, time.monotonic()
        getattr(self, f"_{fault.kind}")(fault.victim)
        goes_on = True
        try:
            run.spin_until(lambda: self.views > before or run.ended, "the next view", PATIENCE)
        except ProcessError:
            run.check()
            goes_on = False
        goes_on &= run.figures.get("state") != "ended: failed"
        return known | self._verdict(goes_on) | {"seconds": round(time.monotonic() - begin, 1)}

    @property
    def views(self) -> int:
        """Views that the explorer has reached."""
        return int(self.run.figures.get("views", "0"))

    @property
    def is_moving(self) -> bool:
        """Whether base or arm move, as odometry and joints say."""
        odometry, joints = (self._last.get(SENSORS[name][0]) for name in ("odometry", "joints"))
        if odometry is None or joints is None:
            return False
        twist = odometry.twist.twist
        speeds = [twist.linear.x, twist.angular.z, *joints.velocity]
        return float(np.abs(speeds).max()) > LEAST_SPEED

    def _verdict(self, goes_on: bool) -> dict[str, object]:
        nees = [pose.nees for pose in self._truth.poses(self._frame)[self._judged :]]
        beyond = sum(value > CHI_SQUARE for value in nees)
        touched = self._truth.contacts - self._contacts
        is_true = bool(nees) and beyond <= max(1, round(0.05 * len(nees)))
        reason = "" if goes_on else self.run.figures.get("last reason", "")
        complaints = self.run.state.complaints
        return {
            "goes_on": goes_on,
            "poses": len(nees),
            "beyond_3_sigma": beyond,
            "worst_nees": round(max(nees, default=0.0), 1),
            "contacts": touched,
            "survived": goes_on and is_true and not touched,
            "said": "; ".join(f"{name}: {text}" for name, text in complaints.items())[:400],
            "reason": reason,
            "ended": self.run.figures.get("state", "") if self.run.ended else "",
            "memory [MB]": {name: memory_of(pid) for name, pid in self.run.pids.items()},
        }

    def _begin_poses(self) -> None:
        self._judged = len(self._truth.poses(self._frame))
        self._contacts = self._truth.contacts
        self.run.state.complaints.clear()

    def _kill(self, victim: str) -> None:
        self.run.kill_node(victim)

    def _stop(self, victim: str) -> None:
        with stopped(self.run.pids[victim]):
            self.run.spin_for(STOPPED)

    def _starve(self, victim: str) -> None:
        end = time.monotonic() + STARVED
        while time.monotonic() < end:
            with stopped(self.run.pids[victim]):
                self.run.spin_for(SLEEPS)
            self.run.spin_for(RUNS)

    def _clock(self, victim: str) -> None:
        """Repeat the last message of a sensor with a wrong time, of the future and of the past."""
        topic, _ = SENSORS[victim]
        for seconds in (WRONG_CLOCK, -WRONG_CLOCK):
            message = self._last[topic]
            right = message.header.stamp.sec
            message.header.stamp.sec = max(0, right + int(seconds))
            self._publishers[topic].publish(message)
            message.header.stamp.sec = right
            self.run.spin_for(2.0)

    def _disk(self, victim: str) -> None:
        """Leave room for nothing on the disk of a node, for several of its saves."""
        pid = self.run.pids[victim]
        _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (FULL_DISK, most))
        try:
            self.run.spin_for(STARVED)
        finally:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (most, most))

    def _keeper(self, topic: str) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            self._last[topic] = message

        return keep


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[None]:
    """Hold a process."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def memory_of(pid: int) -> int:
    """Memory of a process that it shares with no other [MB]."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) // 1000


def table(rows: list[dict[str, Any]]) -> str:
    """A Markdown table with one row per kind of fault."""
    lines = ["| fault | times | in motion | mission went on | until the next view, median, most "
             "| poses beyond 3 sigma | contacts | survived |", "|" + " --- |" * 8]  # fmt: skip
    for kind in dict.fromkeys(row["fault"] for row in rows):
        of = [row for row in rows if row["fault"] == kind]
        seconds = [row["seconds"] for row in of]
        sums = {key: sum(int(row[key]) for row in of)
                for key in ("in_motion", "goes_on", "beyond_3_sigma", "poses", "contacts",
                            "survived")}  # fmt: skip
        lines.append(
            f"| {kind} | {len(of)} | {sums['in_motion']} | {sums['goes_on']} "
            f"| {np.median(seconds):.0f} s, {max(seconds):.0f} s "
            f"| {sums['beyond_3_sigma']} of {sums['poses']} | {sums['contacts']} "
            f"| {sums['survived']} |"
        )
    return "\n".join(lines)


def died(fault: Fault, error: ProcessError) -> dict[str, object]:
    """The row of a fault of which a node has died."""
    none = {"poses": 0, "beyond_3_sigma": 0, "contacts": 0, "seconds": 0.0}
    known = {"fault": fault.kind, "victim": fault.victim, "in_motion": fault.in_motion}
    return known | none | {"goes_on": False, "survived": False, "reason": str(error)}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hours", type=float, default=12.0, help="after which none begins")
    parser.add_argument("--out", type=Path, default=Path("out/chaos"))
    given = parser.parse_args()
    faults, rows, worlds = drawn_faults(given.faults, given.seed), list[dict[str, Any]](), 0
    end, fault = time.monotonic() + 3600.0 * given.hours, next(faults, None)
    while fault is not None and time.monotonic() < end:
        worlds += 1
        chaos = ChaosRun(given.out / f"world_{worlds}", worlds)
        with chaos.run:
            chaos.start()
            while fault is not None and not chaos.run.ended and time.monotonic() < end:
                try:
                    rows.append(chaos.meet(fault))
                except ProcessError as error:
                    rows.append(died(fault, error))
                print(json.dumps(rows[-1]), flush=True)
                write_json(given.out / "faults.json", {"faults": rows})
                fault = next(faults, None)
                if not rows[-1]["goes_on"]:
                    break
    print(table(rows))
    return 0 if rows and all(row["survived"] for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
