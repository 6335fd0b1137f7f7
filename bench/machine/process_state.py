"""Restores what a codec may change of this process: its working directory, settings, and random generators."""

import os
import random
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import torch


@contextmanager
def restored_process_state() -> Iterator[None]:
    """Restore the working directory, settings and global generators of the CPU (PyTorch's, NumPy's and Python's) when
    the block ends: a codec may change them, and the next job and the scores must not depend on that."""
    folder = os.getcwd()
    dtype = torch.get_default_dtype()
    device = torch.get_default_device()
    threads = torch.get_num_threads()
    gradients = torch.is_grad_enabled()
    deterministic = torch.get_deterministic_debug_mode()
    precision = torch.get_float32_matmul_precision()
    numpy_errors = np.geterr()
    torch_generator = torch.get_rng_state()
    numpy_generator = np.random.get_state()
    python_generator = random.getstate()
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            os.chdir(folder)
        torch.set_default_dtype(dtype)
        if torch.get_default_device() != device:  # setting it, even to the same device, slows every call down
            torch.set_default_device(None if device.type == "cpu" else device)
        torch.set_num_threads(threads)
        torch.set_grad_enabled(gradients)
        torch.set_deterministic_debug_mode(deterministic)  # the other setter imports the compiler
        torch.set_float32_matmul_precision(precision)
        np.seterr(**numpy_errors)
        torch.set_rng_state(torch_generator)
        np.random.set_state(numpy_generator)
        random.setstate(python_generator)
