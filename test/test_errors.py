"""Errors pass from one process to another as they are."""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Iterator
from types import FunctionType

import pytest

from infomap_ros import errors


def family(kind: type[errors.InfomapError]) -> Iterator[type[errors.InfomapError]]:
    yield kind
    for child in kind.__subclasses__():
        yield from family(child)


def example(kind: type[errors.InfomapError]) -> errors.InfomapError:
    """One whose arguments are the names of its parameters."""
    takes_more = isinstance(kind.__init__, FunctionType)
    names = list(inspect.signature(kind).parameters) if takes_more else ["message"]
    return kind(*names)


@pytest.mark.parametrize("kind", sorted(set(family(errors.InfomapError)), key=str))
def test_error_comes_back_from_another_process(kind: type[errors.InfomapError]) -> None:
    error = example(kind)
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is kind
    assert (str(back), vars(back)) == (str(error), vars(error))
