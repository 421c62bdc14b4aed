"""Work on the rows of an image in a few threads.

The kernels of this room release the GIL and are compiled for one thread each: numba's own
parallel loops can end the process when two threads of a node enter them at once.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise


class RowBands:
    """Splits the rows of an image into equal bands, one per thread."""

    def __init__(self, height: int, threads: int = 1) -> None:
        """Plan the bands.

        Args:
            height: rows of the image [px].
            threads: number of bands; the caller's thread works on the first one.
        """
        edges = [height * i // threads for i in range(threads + 1)]
        self._bands = list(pairwise(edges))
        self._pool = ThreadPoolExecutor(threads - 1, "stereo") if threads > 1 else None

    def run(self, work: Callable[[int, int], object]) -> None:
        """Call ``work(first_row, end_row)`` for every band and wait for all of them.

        An error of one band is raised when all have ended, so that no thread goes on with arrays
        that the caller takes for its own again.
        """
        others = [self._pool.submit(work, *band) for band in self._bands[1:]] if self._pool else []
        try:
            work(*self._bands[0])
        finally:
            wait(others)
        for other in others:
            other.result()
