"""What team/agents costs, and what becomes of mutated messages on it.

    python benchmarks/team_agents.py cost
    python benchmarks/team_agents.py fuzz --count 1000000

A mutated message is a whole one with one to four changes: letters, numbers, words of JSON, parts
that are left out or doubled. None may end the process; with a team key all must be refused that say
anything else.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from infomap_ros.errors import InfomapError, UpdateRefusedError
from infomap_ros.exploration.robot import RobotState
from infomap_ros.exploration.team.teammate_places import TeamBodies
from infomap_ros.exploration.team.teamwork import Presence, Teamwork
from infomap_ros.geometry import PinholeCamera, PoseRecord, make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.messages.agents import decode_agent_texts, encode_agent
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.team.membership import TeamKey

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
KEY = TeamKey(b"a key for the fuzzing of teams")
WORDS = ("null", "true", "NaN", "1e999", "-1", "[]", "{}", '""', "[[0,0,0]]", "9" * 30)


def presence(x: float, stamp: int) -> Presence:
    """The rover at a place [m] and a time [ns]."""
    robot = RobotModel.from_urdf(
        find_share("config/rover.urdf"), "left_camera_optical_frame", "base_link"
    )
    joints = {joint.name: 0.1 for joint in robot.joints}
    base = make_transform(np.eye(3), (x, 0.0, 0.0))
    camera = base @ robot.forward_kinematics(joints, robot.camera_frame)
    state = RobotState(base, camera, 1e-5 * np.eye(6), joints)
    return Presence(stamp, state, robot, CAMERA, 4.0, "looking", "/rover1/robot_description")


def teamwork(key: TeamKey | None = None) -> Teamwork:
    """A robot that is heading for a view."""
    team = Teamwork(1, 1, 1, key=key)
    path = np.cumsum(np.full((60, 3), 0.05), axis=0)
    team.claim(make_transform(np.eye(3), (3.0, 3.0, 0.7)), path, {2: 17, 3: 21})
    return team


def milliseconds(action: Callable[[], object], count: int = 200) -> float:
    """Processor time of an action [ms]."""
    action()
    start = time.process_time()
    for _ in range(count):
        action()
    return round((time.process_time() - start) / count * 1e3, 2)


def costs() -> dict[str, float]:
    """Processor time of what is done for each message or scan [ms]."""
    one, two, types = teamwork(), Teamwork(2, 2, 2), RclpyMessageTypes()
    me = presence(2.0, 10**9)
    agent, text = teamwork().announcement(me)
    message = encode_agent(types, "map", agent, text, 5.0)
    bodies = TeamBodies()
    bodies.describe(1, me.robot)
    bodies.receive(agent)
    rotation = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    camera = PoseRecord(10**9, "map", make_transform(rotation, (0, 0, 0.7)), 1e-6 * np.eye(6))
    points = CAMERA.back_project(np.full((480, 640), 3.0))
    spread = np.float32(1e-4) * np.eye(3, dtype=np.float32)
    covariances = np.broadcast_to(spread, (480, 640, 3, 3))

    def announce() -> None:
        encode_agent(types, "map", *one.announcement(me), 5.0)

    def receive() -> None:
        for _, received in decode_agent_texts(message):
            two.receive(received, 0.0)

    return {
        "bytes of the text": len(text),
        "announce [ms]": milliseconds(announce),
        "receive [ms]": milliseconds(receive),
        "cut from a scan of 640x480 [ms]": milliseconds(
            lambda: bodies.mask(points, covariances, camera), 20
        ),
    }


def mutated(text: str, rng: np.random.Generator) -> str:
    """The text with one to four changes."""
    for _ in range(rng.integers(1, 5)):
        place, what = int(rng.integers(len(text))), rng.integers(10)
        if what < 5:
            text = text[:place] + chr(rng.integers(1, 256)) + text[place + 1 :]
        elif what < 8:
            end = place + int(rng.integers(1, 12))
            text = text[:place] + WORDS[rng.integers(len(WORDS))] + text[end:]
        elif what == 8:
            text = text[:place] + text[place + int(rng.integers(1, 60)) :]
        else:
            text = text[:place] + text[max(0, place - 40) :]
        text = text or " "
    return text


def fuzz(count: int, seed: int, key: TeamKey | None) -> Counter[str]:
    """Have a robot hear mutated messages; returns what became of them."""
    rng, results = np.random.default_rng(seed), Counter[str]()
    one, two, me = teamwork(key), Teamwork(2, 2, 2, team=(1, 2), key=key), presence(2.0, 10**9)
    for number in range(count):
        if number % 1000 == 0:
            whole = one.announcement(replace(me, stamp=me.stamp + number)).text
        text = mutated(whole, rng)
        try:
            two.receive(text, number * 1e-3)
            same = text.partition("\n")[0] == whole.partition("\n")[0]
            results["as it was" if same else "taken for genuine"] += 1
        except InfomapError as error:
            reason = error.reason if isinstance(error, UpdateRefusedError) else type(error).__name__
            results[f"refused: {reason}"] += 1
    return results


def main() -> int:
    """Run; exits with 1 when a forged message was taken for genuine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("cost", "fuzz"))
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.what == "cost":
        print(json.dumps(costs(), indent=1))
        return 0
    plain = fuzz(arguments.count // 2, arguments.seed, None)
    signed = fuzz(arguments.count // 2, arguments.seed + 1, KEY)
    print(json.dumps({"without key": plain, "with key": signed}, indent=1))
    return int(signed["taken for genuine"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
