"""What studies share: bands and kept runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from infomap_ros.errors import InvalidInputError
from infomap_ros.studies.figure_style import band, curve_band, ratio_band
from infomap_ros.studies.runs import Kept, markdown, run_all


@dataclass(frozen=True, eq=False)
class Doubled:
    values: np.ndarray
    count: int
    ended: str


@dataclass(frozen=True)
class Doubling:
    number: int
    scale: float = 2.0

    @property
    def file_name(self) -> str:
        return f"{self.number}.npz"

    def fingerprint(self) -> str:
        return f"{self.number} {self.scale}"

    def run(self) -> Doubled:
        return Doubled(np.full(3, self.scale * self.number), self.number, "done")


def test_band_holds_the_true_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    found = [band(rng.normal(5.0, 2.0, 6)) for _ in range(2000)]
    share = np.mean([abs(each.mean - 5.0) <= each.half for each in found])
    assert share == pytest.approx(0.95, abs=0.02)


def test_band_is_the_interval_of_the_t_distribution() -> None:
    values = np.array([1.0, 2.0, 4.0, 8.0])
    low, high = stats.t.interval(0.95, 3, values.mean(), values.std(ddof=1) / 2.0)
    found = band(values)
    assert (found.mean - found.half, found.mean + found.half) == pytest.approx((low, high))
    mean, half = curve_band(np.stack([values, values[::-1]], axis=1))
    np.testing.assert_allclose([mean, half], [[3.75, 3.75], [found.half, found.half]])


def test_ratio_of_ratios_and_its_inverse_agree() -> None:
    own, other = np.array([2.0, 6.0, 9.0]), np.array([1.0, 2.0, 3.0])
    found = ratio_band(own, other)
    assert found.mean == pytest.approx(18.0 ** (1.0 / 3.0))
    assert ratio_band(other, own).mean == pytest.approx(1.0 / found.mean)
    assert ratio_band(2.0 * other, other).half == pytest.approx(0.0)


def test_single_world_has_no_band() -> None:
    assert band(np.array([3.0])).text(2.0, 1) == "6.0"
    assert band(np.empty(0)).text() == "-"
    assert band(np.array([1.0, 3.0])).text(1.0, 1) == "2.0 ± 12.7"


def test_kept_results_come_back_unless_they_are_stale(tmp_path: Path) -> None:
    kept, task = Kept(tmp_path, Doubled), Doubling(4)
    assert kept.load(task) is None
    kept.save(task, task.run())
    found = kept.load(task)
    assert found is not None and (found.count, found.ended) == (4, "done")
    np.testing.assert_array_equal(found.values, np.full(3, 8.0))
    assert kept.load(replace(task, scale=3.0)) is None


def test_only_what_is_kept_is_returned_where_nothing_is_computed(tmp_path: Path) -> None:
    kept, tasks, seen = Kept(tmp_path, Doubled), [Doubling(1), Doubling(2)], list[int]()
    kept.save(tasks[1], tasks[1].run())
    results = run_all(tasks, kept, 1, seen.append, compute=False)
    assert list(results) == [tasks[1]]
    assert seen == [1]


def test_nothing_kept_and_nothing_computed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"--draw-only: .* holds no run"):
        run_all([Doubling(1)], Kept(tmp_path, Doubled), 1, compute=False)


def test_markdown_table() -> None:
    assert markdown(["a", "b"], [[1, "x"]]) == "| a | b |\n| --- | --- |\n| 1 | x |\n"
