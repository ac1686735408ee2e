from __future__ import annotations

import numpy as np

from capture.arrays import frozen_view, reused_empty

SHAPE = (1200, 1600, 3)  # 23 MB


def test_memory_is_reused_only_when_no_view_of_it_is_left():
    first = reused_empty(SHAPE)
    place = first.ctypes.data
    first[:] = 1
    kept = frozen_view(first[100:200, ::2], np.float32)
    del first
    second = reused_empty(SHAPE)
    second[:] = 2
    assert second.ctypes.data != place
    assert (kept == 1).all()
    del kept
    assert reused_empty(SHAPE).ctypes.data == place


def test_small_and_odd_arrays_are_what_was_asked_for():
    assert reused_empty((3, 4), np.uint8).shape == (3, 4)
    large = reused_empty((3000, 3000), np.float64)
    assert (large.shape, large.dtype, large.flags.writeable) == ((3000, 3000), np.float64, True)
