"""An array on the device and the one on the host that stands for it."""

import numpy as np
import warp as wp

from kernels.mirror import Mirror


@wp.kernel
def square(value: wp.array2d(dtype=wp.float64), square_out: wp.array2d(dtype=wp.float64)):
    i, j = wp.tid()
    square_out[i, j] = value[i, j] * value[i, j]


def test_a_kernel_reads_what_the_host_pushed_and_the_host_what_it_pulls():
    given, squared = (Mirror((3, 2), dtype=wp.float64, device="cpu") for _ in range(2))
    assert given.host.shape == (3, 2) and not given.host.any()
    for seed in range(2):
        values = np.random.default_rng(seed).normal(size=(3, 2))
        given.host[:] = values
        given.push()
        wp.launch(square, dim=(3, 2), inputs=[given.device], outputs=[squared.device], device="cpu")
        squared.pull()
        np.testing.assert_array_equal(squared.host, values * values)


def test_without_shared_memory_nothing_passes_but_by_push_and_pull():
    mirror = Mirror(4, dtype=wp.int32, device="cpu")
    mirror._shared, mirror.host = False, np.arange(4, dtype=np.int32)  # as on a GPU
    assert not mirror.device.numpy().any()
    mirror.push()
    assert mirror.device.numpy().tolist() == [0, 1, 2, 3]
    mirror.device.fill_(7)
    assert mirror.host.tolist() == [0, 1, 2, 3]
    mirror.pull()
    assert mirror.host.tolist() == [7] * 4
