"""How kernels are compiled that run for every pixel or voxel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function on arrays that makes no arrays itself.

    Otherwise numba counts references: every array handed to a function, or taken from a tuple, is
    one atomic addition, and with ten arrays and few instructions of work that is most of the time.
    Two threads that share the arrays also wait for each other's additions. A kernel keeps no
    reference and needs none counted. One that makes an array does not compile, as does copying
    from slice to slice; one that calls a function which returns a new array would leak it.

    Division by zero gives infinity or NaN, as in numpy: without the branch to an exception, loops
    can work on several numbers at once.
    """
    return njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(function)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """As `kernel`, but copied into each kernel that calls it.

    For what is called every few hundred nanoseconds with many arrays: each is handed over as seven
    numbers, a tuple of ten as seventy. Elsewhere it brings nothing but larger code.
    """
    return njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)(function)
