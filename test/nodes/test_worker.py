"""The worker does jobs in order, outside the caller's thread, from a bounded queue."""

from __future__ import annotations

import threading

from infomap_ros.nodes.common.worker import MOST_WAITING, Worker


def blocked_worker(capacity: int) -> tuple[Worker, threading.Event, list[int]]:
    """A worker that is busy until the event is set; the list counts overflows."""
    overflows: list[int] = []
    worker = Worker("test", capacity, lambda: overflows.append(1))
    started, release = threading.Event(), threading.Event()

    def block() -> None:
        started.set()
        release.wait(10.0)

    worker.submit(block)
    assert started.wait(10.0)
    return worker, release, overflows


def finish(worker: Worker, release: threading.Event) -> None:
    done = threading.Event()
    worker.submit_always(done.set)
    release.set()
    assert done.wait(10.0)
    worker.stop()


def test_jobs_are_done_in_order_in_another_thread() -> None:
    worker, release, _ = blocked_worker(10)
    done: list[tuple[int, int]] = []
    for number in range(5):
        worker.submit(lambda number=number: done.append((number, threading.get_ident())))

    finish(worker, release)

    assert [number for number, _ in done] == [0, 1, 2, 3, 4]
    assert {ident for _, ident in done} != {threading.get_ident()}


def test_a_full_queue_gives_up_what_waits_and_says_so() -> None:
    worker, release, overflows = blocked_worker(2)
    done: list[int] = []
    for number in range(5):
        worker.submit(lambda number=number: done.append(number))

    finish(worker, release)

    assert done == [4]
    assert len(overflows) == 4


def test_a_worker_that_is_always_too_slow_does_not_lag_by_its_whole_queue() -> None:
    """Five jobs come while four are done: in the mean fewer than a whole queue came meanwhile."""
    capacity, clock, ages = 10, 0, []
    worker, release, _ = blocked_worker(capacity)
    turn, finished = threading.Semaphore(0), threading.Semaphore(0)

    def job(came: int) -> None:
        turn.acquire()
        ages.append(clock - came)
        finished.release()

    worker.submit(lambda: job(0))
    release.set()
    for clock in range(1, 400):
        worker.submit(lambda came=clock: job(came))
        if clock % 5:
            turn.release()
            assert finished.acquire(timeout=10.0)
    for _ in range(capacity + 1):
        turn.release()
    finish(worker, release)

    assert 0.0 < sum(ages) / len(ages) < 0.7 * capacity


def test_messages_of_robots_are_bounded_and_who_sends_most_gives_way() -> None:
    worker, release, overflows = blocked_worker(1)
    done: list[str] = []
    for source, count in (("quiet", 5), ("loud", 200), ("quiet", 5)):
        for _ in range(count):
            worker.submit_from(source, 1_000_000, lambda source=source: done.append(source))
    assert worker.waiting < 70

    finish(worker, release)

    assert done.count("quiet") == 10
    assert 50 < done.count("loud") < 64
    assert len(overflows) == 200 - done.count("loud")


def test_small_messages_are_bounded_too() -> None:
    worker, release, overflows = blocked_worker(1)
    for number in range(20_000):
        worker.submit_from(f"robot {number % 64}", 0, lambda: None)
    assert worker.waiting <= MOST_WAITING // 4000 + 1
    assert len(overflows) == 20_000 - (worker.waiting - 1)
    finish(worker, release)


def test_orders_never_give_way() -> None:
    worker, release, overflows = blocked_worker(1)
    done: list[str] = []
    worker.submit_always(lambda: done.append("save"))
    worker.submit(lambda: done.append("old"))
    worker.submit(lambda: done.append("new"))

    finish(worker, release)

    assert done == ["save", "new"]
    assert len(overflows) == 1


def test_the_worker_remembers_how_many_jobs_have_waited_at_most() -> None:
    worker, release, _ = blocked_worker(3)
    for _ in range(3):
        worker.submit(lambda: None)
    before = worker.most_waiting

    finish(worker, release)

    assert before == 3
    assert worker.most_waiting == 4, "with the order of the end"


def test_clear_forgets_data_but_not_orders() -> None:
    worker, release, _ = blocked_worker(5)
    done: list[str] = []
    worker.submit(lambda: done.append("scan"))
    worker.submit_always(lambda: done.append("save"))

    assert worker.clear() == 1

    finish(worker, release)
    assert done == ["save"]


def test_stop_ends_the_thread_after_the_job_at_hand() -> None:
    worker, release, _ = blocked_worker(5)
    release.set()

    worker.stop()

    assert not worker.alive
