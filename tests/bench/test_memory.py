"""What a fit held at once: it is counted by the system, and only since it was asked to."""

from pathlib import Path

import pytest
import torch

from bench.machine.memory import forget_peak, peak_bytes


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux counts it")
def test_the_peak_is_that_since_it_was_forgotten():
    cpu = torch.device("cpu")
    assert forget_peak(cpu)
    before = peak_bytes(cpu)
    large = torch.ones(1 << 26)  # 256 MiB
    during = peak_bytes(cpu)
    del large
    after = peak_bytes(cpu)
    forget_peak(cpu)
    anew = peak_bytes(cpu)
    assert during - before > 200 << 20
    assert after > during - (8 << 20)  # what was freed was held; the kernel counts with some slack
    assert during - anew > 200 << 20


def test_a_device_that_counts_no_memory_has_no_peak(gpu):
    assert not forget_peak(gpu.type)
    assert peak_bytes(gpu.type) is None
