"""Bags that are mapped in parts, here or by workers of Dask, and become one map.

The parts do not depend on who maps them, and are added as a tree: the map is the same to the bit.
"""

from __future__ import annotations

import operator
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib import import_module
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple

from infomap_ros.errors import BagError, CapacityError, InvalidInputError
from infomap_ros.geometry import ImageRecord, Record
from infomap_ros.mapping import VoxelMap
from infomap_ros.replay.bags.reader import BagRecord
from infomap_ros.replay.bags.source import EVER
from infomap_ros.replay.localize_run import records_of
from infomap_ros.replay.map_inputs import MapInputs, MapOptions
from infomap_ros.replay.map_run import MapRun, Progress
from infomap_ros.replay.mapped_bag import Recording, open_recording
from infomap_ros.team.merging import NamedMap, merge_maps, sum_of_maps

_PART_FRAMES = 500
"""A part of a bag. To begin one costs as much as some ten frames, and the read ones beside it."""
_JITTER = 1_000_000_000  # by which delays of messages may differ [ns]
_ADDED = ("frames", "points", "points_beyond", "dropped", "camera_path")


class Span(NamedTuple):
    """The images of a bag that are one part of it: each is in one part, pairs are in the same.

    Attributes:
        received: times at which they were received [ns], but for differences of their delays.
        delay: of the bag's first image [ns].
        beside: what of poses and joints is read before and after [ns].
    """

    received: range = EVER
    delay: int = 0
    beside: int = 0

    def has(self, image: BagRecord) -> bool:
        """Whether an image is in it: by its stamp, where that fits the time it was received."""
        usual, least = image.record.stamp + self.delay, image.received - _JITTER
        return min(max(usual, least), image.received + _JITTER) in self.received

    def records(self, bag: Recording, inputs: MapInputs) -> Iterator[tuple[str, Record]]:
        """Records of the part with their topics, in order of time."""
        if self.received == EVER:
            yield from records_of(bag, inputs.topics)
            return
        for topic in inputs.perception.sources.infos:  # may have been told once
            yield from ((topic, entry.record) for entry in islice(bag.records([topic]), 1))
        first, last = self.received.start - self.beside, self.received.stop + self.beside
        read = range(max(first, 0), min(last, EVER.stop))
        for entry in bag.records(inputs.topics, read):
            if not isinstance(entry.record, ImageRecord) or self.has(entry):
                yield entry.topic, entry.record


def spans_of(run: MapRun, bag: Recording) -> list[Span]:
    """The parts into which a bag is cut; one where it is short or located by its images."""
    count = -(-run.inputs.frames // _PART_FRAMES)
    if run.inputs.located is not None or count < 2:
        return [Span()]
    image = next(iter(bag.records(run.inputs.perception.sources.images[:1])))
    waits = run.options.poses.max_gap + run.options.waiting.max_wait
    timing = image.received - image.record.stamp, 2 * _JITTER + round(1e9 * waits)
    cuts = [bag.start + (bag.end - bag.start) * k // count for k in range(1, count)]
    return [Span(range(*ends), *timing) for ends in pairwise([0, *cuts, EVER.stop])]


def tally_of(run: MapRun, bag: Recording) -> dict[str, Any]:
    """What adds over the parts of a survey, by name."""
    added = {name: getattr(run, name) for name in _ADDED}
    return {
        **added,
        "first": [run.first][: run.frames],
        "map_frame": [run.inputs.map_frame][: run.frames],
        "full": [run.full][: len(run.full)],
        "assumed_poses": run.builder.assumed_poses,
        "points_cut": run.builder.points_cut,
        "refused": run.refused,
        "skipped": bag.skipped,
        "problems": bag.problems,
    }


def take(run: MapRun, bag: Recording, survey: Mapped) -> None:
    """Take the map and the tally of a survey for those of a run.

    Raises:
        BagError: no frame could be mapped; says why.
        InvalidInputError: the bags have their poses in frames of different names.
    """
    tally = survey.tally
    frames = sorted(set(tally["map_frame"]))
    if len(frames) > 1:
        raise InvalidInputError(survey.name, f"have their poses in frames {', '.join(frames)}")
    run.inputs.poses.map_frame = "".join(frames)
    for name in _ADDED:
        setattr(run, name, tally[name])
    run.first, run.full = next(iter(tally["first"]), None), "; ".join(tally["full"])
    run.builder.replace(survey.map)
    run.builder.assumed_poses = tally["assumed_poses"]
    run.builder.points_cut = tally["points_cut"]
    run.refused.update(tally["refused"])
    bag.skipped, bag.problems[:] = tally["skipped"], dict.fromkeys(tally["problems"])
    run.check_frames()


class Part(NamedTuple):
    """What one worker maps: a bag, or some of its images.

    Attributes:
        path: of the bag.
        calibration: files, of a folder of images.
        options: all settings.
        span: of its images.
    """

    path: Path
    calibration: tuple[Path, ...]
    options: MapOptions
    span: Span

    def map(self) -> Mapped:
        """Map it.

        Raises:
            InfomapError: it lacks what mapping needs.
        """
        with open_recording(self.path, self.calibration) as bag:
            run = MapRun(bag, self.options, self.span.records)
            run.run()
        return Mapped(str(self.path), run.map, tally_of(run, bag))


class Mapped:
    """A map of some parts, which can be pickled; two of them add.

    Attributes:
        name: of the bags.
        map: the voxel map.
        tally: of the runs that made it, see `tally_of`.
    """

    def __init__(self, name: str, voxel_map: VoxelMap, tally: Mapping[str, Any]) -> None:
        self.name, self.map, self.tally = name, voxel_map, tally

    def __reduce__(self) -> tuple[Any, ...]:
        one = self.map
        return _unpacked, (self.name, one.config, one.state(), one.origin, one.sessions, self.tally)

    def __add__(self, other: Mapped) -> Mapped:
        """One map of both; parts of one bag are in one frame, bags are compared.

        Raises:
            InvalidInputError: the bags contradict each other or do not fit; names them.
            CapacityError: the map could exceed ``memory_limit``.
        """
        tally = {name: mine + other.tally[name] for name, mine in self.tally.items()}
        tally["first"] = tally["first"][:1]
        if self.name == other.name:
            return Mapped(self.name, sum_of_maps([self.map, other.map]), tally)
        maps = [NamedMap(one.name, one.map) for one in (self, other)]
        return Mapped(f"{self.name}, {other.name}", merge_maps(maps)[0], tally)


def _unpacked(
    name: str, config: Any, state: Any, origin: int, sessions: tuple[int, ...], tally: Any
) -> Mapped:
    voxel_map = VoxelMap.from_state(config, state)
    voxel_map.origin, voxel_map.sessions = origin, sessions
    return Mapped(name, voxel_map, tally)


def parts_of(
    paths: Sequence[Path], calibration: tuple[Path, ...], options: MapOptions
) -> list[list[Part]]:
    """The parts of each bag; all get the sizes that the scene of the first needs.

    They do not depend on who maps them, and so the map does not.

    Raises:
        InfomapError: a bag lacks what mapping needs, or is given twice.
    """
    parts: list[list[Part]] = []
    for number, path in enumerate(paths):
        if path.resolve() in [other.resolve() for other in paths[:number]]:
            raise InvalidInputError(str(path), "is given twice")
        with open_recording(path, calibration) as bag:
            run = MapRun(bag, options)
            options = run.options
            parts.append([Part(path, calibration, options, span) for span in spans_of(run, bag)])
    return parts


def sum_as_tree(items: Sequence[Any], add: Callable[[Any, Any], Any] = operator.add) -> Any:
    """The sum of neighbors, of these sums, and so on; the same whoever adds."""
    while len(items) > 1:
        pairs = [items[i : i + 2] for i in range(0, len(items), 2)]
        items = [add(*pair) if len(pair) == 2 else pair[0] for pair in pairs]
    return items[0]


def _sum_here(
    groups: list[list[Part]],
    compute: Callable[[Part], Mapped],
    is_stopped: Callable[[], bool],
    progress: Progress,
) -> Mapped | None:
    """As `sum_on_workers`, in this process."""
    sums, done, total = [], 0, sum(map(len, groups))
    for group in groups:
        mapped = []
        for part in group:
            if not is_stopped():
                mapped.append(compute(part))
                progress(done := done + 1, total)
        sums += [sum_as_tree(mapped)] if mapped else []
    return sum_as_tree(sums) if sums else None


def map_survey(
    run: MapRun,
    bag: Recording,
    parts: list[list[Part]],
    cluster: str,
    say: Callable[[str], object],
    progress: Progress,
) -> None:
    """Map the parts of bags, and take the map of all for that of a run.

    Args:
        run: of the first bag.
        bag: the first one.
        parts: of each bag.
        cluster: see `dask_client`; this process does it where empty.
        say: gets where the work of a cluster is shown.
        progress: told how many of how many parts are done.

    Raises:
        BagError: no frame could be mapped; says why.
        InfomapError: bags do not fit each other, one lacks what mapping needs, or there is no such
            cluster.
    """
    start = time.perf_counter()
    with dask_client(cluster) if cluster else nullcontext() as client:
        if client is not None:
            say(f"infomap: the work is shown at {client.dashboard_link}")
        sums = partial(sum_on_workers, client) if client is not None else _sum_here
        mapped = sums(parts, Part.map, lambda: run.stopped, progress)
    if mapped is None:
        raise BagError("interrupted before the first part was mapped")
    take(run, bag, mapped)
    run.name += f" and {len(parts) - 1} more" if len(parts) > 1 else ""
    run.seconds = time.perf_counter() - start


_POLL = 0.1  # [s]
_ANSWER = 30.0  # within which a scheduler has to answer [s]
LOCAL = "local"


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """A client of a scheduler.

    Args:
        address: of the scheduler, or `LOCAL` for one with a worker for each core, which end with
            the context.

    Raises:
        InvalidInputError: Dask is not installed, or no scheduler answers.
    """
    try:
        dask = import_module("distributed")
    except ImportError as error:
        problem = f"needs Dask (pip install 'infomap_ros[cluster]'): {error}"
        raise InvalidInputError("--cluster", problem) from error
    try:
        given = {"address": address} if address != LOCAL else {"threads_per_worker": 1}
        client = dask.Client(timeout=_ANSWER, **given)
    except (OSError, ValueError) as error:  # a time-out is an OSError
        raise InvalidInputError("--cluster", f"no scheduler at {address}: {error}") from error
    with client:
        yield client


def sum_on_workers(
    client: Any,
    parts: Sequence[Sequence[Any]],
    compute: Callable[[Any], Any],
    is_stopped: Callable[[], bool],
    progress: Progress,
) -> Any:
    """Let workers compute all parts, and add what they give, each group before the groups.

    A part whose worker is lost is computed again by another one.

    Args:
        client: of a scheduler.
        parts: by groups.
        compute: of a part.
        is_stopped: whether only what is done by now is wanted.
        progress: told how many of how many parts are done.

    Returns:
        The sum, None where nothing was done.

    Raises:
        CapacityError: the workers of one part were lost again and again.
        Exception: what `compute` or the addition raises.
    """
    groups = [client.map(compute, group, pure=False) for group in parts]
    futures = [future for group in groups for future in group]
    _wait(client, futures, is_stopped, progress)
    kept = [[one for one in group if one.status == "finished"] for group in groups]
    client.cancel([one for one in futures if one.status != "finished"])

    def add(first: Any, second: Any) -> Any:
        return client.submit(_add, first, second, pure=False)

    sums = [sum_as_tree(group, add) for group in kept if group]
    if not sums:
        return None
    total = sum_as_tree(sums, add)
    _wait(client, [total], lambda: False, lambda done, of: None)
    return total.result()


def _add(first: Any, second: Any) -> Any:
    return first + second


def _wait(
    client: Any, futures: Sequence[Any], is_stopped: Callable[[], bool], progress: Progress
) -> None:
    """Until all are done; the first failure cancels the others."""
    while not is_stopped():
        for failed in (one for one in futures if one.status == "error"):
            client.cancel([one for one in futures if one is not failed])
            error = failed.exception()
            if type(error).__name__ == "KilledWorker":
                problem = "workers that were to compute one part were lost, each time"
                raise CapacityError(f"{problem}; perhaps they lack memory: {error}") from error
            raise error
        done = sum(one.status == "finished" for one in futures)
        progress(done, len(futures))
        if done == len(futures):
            return
        time.sleep(_POLL)
