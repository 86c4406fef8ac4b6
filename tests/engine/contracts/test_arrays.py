"""Arrays in scene files and jobs: a list of numbers becomes one, with every numpy that a QGIS may bring."""

import types
from typing import Any, TypeVar

import numpy as np
import pytest

from repm_qgis.contracts.arrays import FloatArray
from repm_qgis.contracts.checks import typed

Number = TypeVar("Number")


class _Alias:
    """What ``numpy.typing.NDArray`` is since numpy 2.5 where Python has the statement ``type``: a name for a type."""

    __value__ = np.ndarray[Any, np.dtype[Number]] if hasattr(np.dtype, "__class_getitem__") else np.ndarray


@pytest.mark.parametrize("kind", [FloatArray, types.GenericAlias(_Alias(), (np.float64,))], ids=["ours", "numpy 2.5"])
def test_a_list_becomes_an_array_whatever_numpy_calls_the_type(kind):
    found = typed(kind, [[1, 2.5], [3, 4]])
    assert isinstance(found, np.ndarray) and found.tolist() == [[1.0, 2.5], [3.0, 4.0]]
