"""One thread a process: threads that wait for each other cost more than they give on pictures this small."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when NumPy and PyTorch are first imported, after this file
