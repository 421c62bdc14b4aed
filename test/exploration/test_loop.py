"""The loop ends for a reason, obeys, and writes down what it does."""

from __future__ import annotations

import dataclasses
import itertools
import threading
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, MissionFileError, TeammatesBusyError
from infomap_ros.exploration.loop import EndReason, Exploration
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.robot import (
    Choice,
    Interrupted,
    Motion,
    RobotState,
    path_length,
    planar_pose,
)
from infomap_ros.exploration.rules import Control, Request
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry import make_transform

from .fakes import FakePlanner, FakeRobot, Notes, nothing, route_to, view


class Run:
    """An exploration with its parts at hand."""

    def __init__(self, *script: object, task: TaskConfig | None = None, **options: object) -> None:
        self.robot, self.notes, self.control = FakeRobot(), Notes(), Control()
        self.planner = FakePlanner(*script)  # type: ignore[arg-type]
        self.states: list[str] = []
        self.exploration = Exploration(
            self.robot,
            self.planner,
            task or TaskConfig(),
            self.notes,
            self.control,
            on_step=lambda run: self.states.append(run.state),
            **options,  # type: ignore[arg-type]
        )


def test_done_when_expanse_and_resolution_suffice() -> None:
    run = Run(view(1.0), view(2.0, known=0.97))
    ending = run.exploration.run()
    assert ending.reason is EndReason.DONE
    assert "97.0 %" in ending.detail and "10.0 mm" in ending.detail
    assert run.robot.deeds == ["look", "arm", "drive", "arm", "look"]
    assert run.exploration.mission.views == 2
    assert run.exploration.mission.distance == pytest.approx(1.0)


def test_goes_back_to_the_last_look_once_where_a_look_fails() -> None:
    run = Run(view(1.0), view(2.0), view(3.0), view(4.0, known=0.97))
    looks, places = iter([True, True, False, True, False, False, True]), []

    def lose(deed: str) -> None:
        if deed == "look":
            places.append(run.robot.place[0])
            run.robot.problems = {} if next(looks) else {"look": "the camera is lost"}

    run.robot.during = lose
    assert run.exploration.run().reason is EndReason.DONE
    # from 2 back to 1, where it looks; from 3 back to 1, in vain; it goes on as it would
    assert places[:5] == [0.0, 1.0, 2.0, 1.0, 3.0]
    assert len(run.planner.failures) == 2
    back = [note for note in run.notes.of("motion") if note["action"] == "last look"]
    assert [note["outcome"] for note in back] == ["", ""]


def test_a_robot_that_is_lost_after_a_restart_goes_back_to_the_last_look(tmp_path: Path) -> None:
    path = tmp_path / "mission.json"
    first = Run(view(1.0), view(2.0), task=TaskConfig(max_views=2))
    first.exploration.run()
    first.exploration.mission.save(path)
    second = Run(view(3.0), task=TaskConfig(max_views=4), mission=Mission.load(path))
    second.robot.place = (1.7, 0.0)
    looks, places = iter([False, True, True]), []

    def lose(deed: str) -> None:
        if deed == "look":
            places.append(second.robot.place[0])
            second.robot.problems = {} if next(looks) else {"look": "the camera is lost"}

    second.robot.during = lose
    second.exploration.run()
    assert places == [1.7, 1.0, 3.0]


def test_ends_where_views_bring_nothing_any_more() -> None:
    known = [0.3, 0.5, 0.4, 0.55, 0.56, 0.5602, 0.5601, 0.5603, 0.9]
    script = [view(float(n), share) for n, share in enumerate(known)]
    clock = map(float, itertools.count())
    run = Run(*script, task=TaskConfig(unproductive_views=3, min_rate=0.02), clock=clock.__next__)
    ending = run.exploration.run()
    assert ending.reason is EndReason.NOTHING_LEFT
    assert "the last 3 views brought 10 bits and made 1.02 % more of the surface" in ending.detail
    assert run.exploration.mission.views == 7


def test_views_that_make_the_map_as_fine_as_asked_are_not_in_vain() -> None:
    script = [view(float(n), 0.97, share) for n, share in enumerate((0.5, 0.7, 0.9, 0.96))]
    task = TaskConfig(known_fraction=0.95, unproductive_views=2)
    assert Run(*script, task=task).exploration.run().reason is EndReason.DONE


def test_looks_and_chooses_again_where_the_pose_is_lost_on_the_way() -> None:
    run = Run(view(1.0), view(2.0), view(3.0, known=0.97), task=TaskConfig(max_drift=0.06))
    sigmas = {"drive": iter([0.1, 0.12]), "look": iter([0.002, 0.08, 0.01])}

    def grow(deed: str) -> None:
        run.robot.sigma = next(sigmas[deed]) if deed in sigmas else run.robot.sigma

    run.robot.during = grow
    assert run.exploration.run().reason is EndReason.DONE
    drive = ["arm", "drive"]  # the second grows from 80 mm to 120 mm, and goes on
    assert run.robot.deeds == ["look", *drive, "look", *drive, "arm", "look"]
    assert run.planner.failures == []
    assert any("too uncertain" in note["text"] for note in run.notes.of("message"))


@pytest.mark.parametrize(("known", "precise"), [(0.97, 0.94), (0.9, 0.9)])
def test_not_done_while_too_little_is_known_precisely(known: float, precise: float) -> None:
    ending = Run(view(1.0, known, precise), nothing()).exploration.run()
    assert ending.reason is EndReason.NOTHING_LEFT


def test_asks_again_where_teammates_are_at_all_that_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = Run(view(1.0), view(2.0, known=0.97))
    choose, asked = run.planner.choose, iter([True, False, True, False])

    def busy_at_first(state: RobotState) -> Choice:
        if next(asked):
            raise TeammatesBusyError("waiting for teammates: 2 looks there")
        return choose(state)

    monkeypatch.setattr(run.planner, "choose", busy_at_first)
    monkeypatch.setattr("infomap_ros.exploration.rules.PAUSE", 0.0)
    assert run.exploration.run().reason is EndReason.DONE
    assert run.states.count("waiting for teammates") == 2
    assert run.exploration.mission.views == 2


def test_ends_when_nothing_is_worth_its_cost_and_says_why() -> None:
    ending = Run(view(1.0), nothing("the best view tells 3 bits")).exploration.run()
    assert ending == type(ending)(EndReason.NOTHING_LEFT, "the best view tells 3 bits")


@pytest.mark.parametrize(
    ("budget", "word"),
    [({"max_views": 3}, "3 views"), ({"max_distance": 5.0}, "6.0 m"), ({"max_time": 1.0}, " s ")],
)
def test_ends_when_a_budget_is_spent(budget: dict[str, float], word: str) -> None:
    ticks = iter(np.arange(0.0, 1e4, 0.1))
    script = [view(x) for x in (1.0, 3.0, 6.0, 7.0)]
    run = Run(*script, task=TaskConfig(**budget), clock=lambda: float(next(ticks)))
    ending = run.exploration.run()
    assert ending.reason is EndReason.BUDGET_SPENT
    assert word in ending.detail


@pytest.mark.parametrize(
    ("changed", "end"),
    [({"max_views": 2}, EndReason.BUDGET_SPENT), ({"known_fraction": 0.3}, EndReason.DONE)],
)
def test_a_task_that_is_changed_on_the_way_counts_from_then_on(
    changed: dict[str, float], end: EndReason
) -> None:
    run = Run(*[view(float(x), known=0.5 + 0.02 * x) for x in range(1, 9)])

    def change(deed: str) -> None:
        if deed == "drive":
            run.exploration.change_task(TaskConfig(**changed))

    run.robot.during = change
    assert run.exploration.run().reason is end
    assert run.exploration.mission.views == 2


def test_says_that_nothing_is_left_where_a_budget_is_spent_too() -> None:
    run = Run(view(1.0), nothing(), task=TaskConfig(max_views=2))
    assert run.exploration.run().reason is EndReason.NOTHING_LEFT
    assert run.exploration.mission.views == 2


@pytest.mark.parametrize("deed", ["look", "drive", "arm"])
def test_repeated_failure_ends_with_its_name(deed: str) -> None:
    run = Run(view(1.0), task=TaskConfig(max_failures=3))
    run.robot.problems[deed] = "broken cable"
    ending = run.exploration.run()
    assert ending.reason is EndReason.FAILED
    assert f"{deed}: broken cable" in ending.detail and "3 failures" in ending.detail
    assert run.notes.of("message")[0]["text"] == f"{deed}: broken cable"


def test_view_that_could_not_be_reached_is_reported_to_the_planner() -> None:
    run = Run(view(1.0), view(2.0), nothing())
    problems = iter(["wheel stuck", ""])
    run.robot.during = lambda deed: run.robot.problems.update(
        {"drive": next(problems)} if deed == "drive" else {}
    )
    assert run.exploration.run().reason is EndReason.NOTHING_LEFT
    assert run.planner.failures == ["drive: wheel stuck"]
    assert run.robot.place == (2.0, 0.0)


def test_a_success_in_between_resets_the_count_of_failures() -> None:
    run = Run(view(1.0), task=TaskConfig(max_failures=2, max_views=5))
    drives = iter([True, False] * 50)

    def every_other(deed: str) -> None:
        if deed == "drive":
            run.robot.problems["drive"] = "slipped" if next(drives) else ""

    run.robot.during = every_other
    assert run.exploration.run().reason is EndReason.BUDGET_SPENT


def test_stop_while_driving_ends_and_moves_no_more() -> None:
    run = Run(view(1.0))
    run.robot.during = lambda deed: deed == "drive" and run.control.ask(Request.STOP)  # type: ignore[return-value, func-returns-value]
    ending = run.exploration.run()
    assert ending.reason is EndReason.STOPPED
    assert run.robot.deeds == ["look", "arm", "drive"]
    assert run.planner.failures == []
    assert not run.control.ask(Request.RUN)


def test_pause_and_resume_choose_anew() -> None:
    run = Run(view(1.0), view(2.0), nothing())
    paused = threading.Event()

    def pause_once(deed: str) -> None:
        if deed == "drive" and not paused.is_set():
            run.control.ask(Request.PAUSE)
            threading.Timer(0.0, paused.set).start()

    def resume() -> None:
        paused.wait()
        run.control.ask(Request.RUN)

    run.robot.during = pause_once
    thread = threading.Thread(target=resume)
    thread.start()
    assert run.exploration.run().reason is EndReason.NOTHING_LEFT
    thread.join()
    assert len(run.planner.states) == 3


def test_home_drives_to_where_the_mission_began_and_waits() -> None:
    run = Run(view(1.0), view(2.0))
    looks = iter(range(100))

    def ask(deed: str) -> None:
        if deed == "look" and next(looks) == 2:
            run.control.ask(Request.HOME)

    def when_home(exploration: Exploration) -> None:
        if exploration.state == "paused":
            run.control.ask(Request.STOP)

    run.robot.during = ask
    run.exploration._on_step = when_home
    assert run.exploration.run().reason is EndReason.STOPPED
    assert run.robot.place == (0.0, 0.0)
    assert run.exploration.mission.distance == pytest.approx(1.0 + 1.0 + 2.0)
    assert run.exploration.last_reason != ""


def test_home_that_cannot_be_reached_is_said() -> None:
    run = Run(view(1.0))
    run.planner.home = nothing("no path: a rock")
    run.robot.during = lambda deed: deed == "drive" and run.control.ask(Request.HOME)  # type: ignore[return-value, func-returns-value]
    reasons: list[str] = []

    def when_paused(exploration: Exploration) -> None:
        if exploration.state == "paused":
            reasons.append(exploration.last_reason)
            run.control.ask(Request.STOP)

    run.exploration._on_step = when_paused
    run.exploration.run()
    assert reasons == ["home: no path: a rock"]


def test_plan_only_moves_nothing() -> None:
    run = Run(view(1.0), view(2.0), view(3.0), nothing(), plan_only=True)
    run.exploration.control.wait = lambda seconds: None  # type: ignore[method-assign]
    assert run.exploration.run().reason is EndReason.NOTHING_LEFT
    assert set(run.robot.deeds) == {"look"}
    assert len(run.notes.of("decision")) == 4


def test_every_step_is_in_the_log() -> None:
    run = Run(view(1.0), nothing())
    run.exploration.run()
    kinds = [kind for kind, _ in run.notes.entries]
    look, choose = ["motion"], ["progress", "decision"]
    assert kinds == look + choose + ["motion"] * 3 + look + choose + ["end"]
    assert [entry["action"] for entry in run.notes.of("motion")] == run.robot.deeds
    assert run.notes.of("progress")[1]["views"] == 2
    assert {"looking", "choosing"} <= set(run.states)


def test_mission_survives_the_process(tmp_path: Path) -> None:
    path = tmp_path / "mission.json"
    first = Run(view(1.0), view(2.0), task=TaskConfig(max_views=3))
    first.exploration.run()
    first.exploration.mission.save(path)
    again = Mission.load(path)
    assert again == first.exploration.mission
    second = Run(view(3.0), task=TaskConfig(max_views=4), mission=again)
    second.robot.place = (2.0, 0.0)
    second.exploration.run()
    assert second.exploration.mission.views == 4
    assert second.exploration.mission.home.base == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(second.exploration.mission.home_pose, np.eye(4))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        '{"views": 1}',
        '{"views": -1, "distance": 0, "seconds": 0, "home_base": [], "home_joints": {}}',
        '{"views": 1, "distance": 0, "seconds": 0, "home_base": [1], "home_joints": {}}',
        '{"views": 1, "distance": 0, "seconds": 0, "home_base": [], "home_joints": {}, '
        '"look_base": [0, 0, NaN]}',
        '{"views": 1, "distance": 0, "seconds": 0, "home_base": [], "home_joints": {}, '
        '"home_pose": [[1, 2], [3, 4]]}',
        "[1, 2]",
    ],
)
def test_bad_mission_file_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mission.json"
    path.write_text(text)
    with pytest.raises(MissionFileError, match=r"mission\.json"):
        Mission.load(path)


def test_planar_pose_and_path_length() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(planar_pose(make_transform(turn, (1, 2, 3))), (1, 2, np.pi / 2))
    assert path_length([[0, 0, 0], [3, 4, 0], [3, 4, 2]]) == pytest.approx(7.0)
    assert path_length([]) == 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"region_low": (0.0, 0.0)},
        {"region_high": (-9.0, 3.0, 1.0)},
        {"known_fraction": 1.5},
        {"max_views": 0},
    ],
)
def test_impossible_task_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        TaskConfig(**wrong)  # type: ignore[arg-type]


def test_a_blocked_route_is_left_and_another_view_chosen() -> None:
    run = Run(view(1.0), view(2.0, known=0.6), view(3.0, known=0.97))
    drives = iter([True, False])

    def block(deed: str) -> None:
        if deed == "drive":
            run.planner.blocked = "a box at (0.50, 0.00)" if next(drives) else ""
        elif deed == "look":
            run.planner.blocked = ""

    run.robot.during = block
    assert run.exploration.run().reason is EndReason.DONE
    blocked = ["look", "arm", "drive"]  # and nothing more of that route
    assert run.robot.deeds == [*blocked, "look", "arm", "drive", "arm", "look"]
    assert run.planner.failures == ["drive: interrupted: a box at (0.50, 0.00)"]
    assert run.robot.place == (2.0, 0.0)


def test_the_arm_is_planned_again_from_where_the_base_has_stopped() -> None:
    run = Run(view(1.0), nothing())
    run.exploration.run()
    np.testing.assert_array_equal(run.planner.aims, [view(1.0).pose])


def test_the_arm_moves_until_the_camera_has_arrived_or_the_log_says_why_not() -> None:
    run = Run(view(1.0), nothing())
    drive = run.robot.drive

    def slip(poses: np.ndarray, interrupted: object) -> object:
        motion = drive(poses, lambda: False)
        run.robot.place = (run.robot.place[0] + 0.2, 0.0)
        return motion

    run.robot.drive = slip  # type: ignore[method-assign, assignment]
    run.exploration.run()
    assert len(run.planner.aims) == 4
    (miss,) = run.notes.of("message")
    assert miss["text"].startswith("the camera is 0.200 m and 0.000 rad off the view")
    assert run.exploration.mission.views == 2


def test_where_the_arm_comes_only_near_the_view_is_taken_from_there() -> None:
    run = Run(view(1.0), nothing())
    run.planner.why_not_there = "no inverse kinematics"
    run.exploration.run()
    assert len(run.planner.aims) == 1
    assert run.robot.deeds == ["look", "arm", "drive", "arm", "look"]


def stop_beside(run: Run, *gaps: float) -> None:
    """Have the base come to stand so far beyond the ends of its paths, one after the other."""
    drive, left = run.robot.drive, iter(gaps)

    def slip(poses: np.ndarray, interrupted: Interrupted) -> Motion:
        motion = drive(poses, interrupted)
        run.robot.place = (run.robot.place[0] + next(left), 0.0)
        return motion

    run.robot.drive = slip  # type: ignore[method-assign]


def test_a_short_drive_brings_the_camera_where_the_arm_does_not_reach() -> None:
    run = Run(view(1.0), nothing())
    stop_beside(run, 0.2, 0.05)
    plan_arm = run.planner.plan_arm

    def drive_first(state: RobotState, T_map_camera: np.ndarray) -> Choice:
        choice = plan_arm(state, T_map_camera)
        x = state.T_map_base[0, 3]
        if len(run.planner.aims) == 1:
            choice = dataclasses.replace(choice, route=route_to(1.0, start=(x, 0.0)))
        return choice

    run.planner.plan_arm = drive_first  # type: ignore[method-assign]
    run.exploration.run()
    assert run.robot.deeds == ["look", "arm", "drive", "arm", "drive", "arm", "look"]
    assert run.notes.of("message") == []
    assert run.robot.place[0] == pytest.approx(1.05)
    assert run.exploration.mission.distance == pytest.approx(1.0 + 0.2)


def test_a_view_that_was_missed_has_failed_before_the_next_is_chosen() -> None:
    run = Run(view(1.0), view(2.0), view(3.0, known=0.97))
    stop_beside(run, 0.2, 0.0)
    assert run.exploration.run().reason is EndReason.DONE
    (failure,) = run.planner.failures
    assert failure.startswith("the camera is 0.200 m")
    assert run.robot.place == (2.0, 0.0)


def test_a_view_that_was_reached_has_not_failed() -> None:
    run = Run(view(1.0), view(2.0), nothing())
    stop_beside(run, 0.0, 0.0)
    run.exploration.run()
    assert run.planner.failures == []
    assert run.robot.place == (2.0, 0.0)
