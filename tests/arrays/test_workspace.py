import numpy as np
import pytest

from stillray.arrays.workspace import Workspace


def test_a_name_has_one_array_of_one_type():
    workspace = Workspace()
    large = workspace.array("light", (3, 4))
    large[:] = 7
    small = workspace.array("light", (2, 3))
    assert np.shares_memory(large, small)
    assert (small == 7).all()
    assert workspace.array("mask", (2,), np.uint8).dtype == np.uint8
    with pytest.raises(ValueError, match=r"dtype of workspace array 'light' must be float32, got"):
        workspace.array("light", (2,), np.uint8)
