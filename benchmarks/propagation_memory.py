"""Time and peak memory of `neubtf-bench propagate`, the whole process.

    python benchmarks/propagation_memory.py [--size 2000] [--threads 1]

A picture of noise, size² pixels, guides a material that was barely fitted: what it looks like does not matter here.
Prints seconds (clock and processor), the peak of the resident memory, and the size of the file. Exit code 1 above the
aim, 1.5 GB for 2000².
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from bench.codec import Fit
from bench.codecs import container
from bench.conformance.check import tiny_btf
from neubtf.codec import NeuBTF

AIM = 1.5e9


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=1)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file, picture, out = (Path(folder) / name for name in ("file.nbtf", "picture.png", "new.nbtf"))
        codec = NeuBTF(steps=10, batch=256, keep_encoder=True)
        container.save(file, codec, codec.encode(tiny_btf(), Fit()))
        noise = np.random.default_rng(0).integers(0, 256, (chosen.size, chosen.size, 3), np.uint8)
        Image.fromarray(noise).save(picture, compress_level=1)
        words = ["propagate", str(file), "--guidance", str(picture), "-o", str(out)]
        start, threads = time.perf_counter(), {"OMP_NUM_THREADS": str(chosen.threads)}
        subprocess.run([sys.executable, "-m", "bench.cli", *words], check=True, env=os.environ | threads)
        seconds, used = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        peak, busy = used.ru_maxrss * 1024, used.ru_utime + used.ru_stime  # Linux counts memory in KiB
        print(f"{chosen.size} × {chosen.size} texels: {seconds:.0f} s, {busy:.0f} s of processor time")
        print(f"peak memory {peak / 1e9:.2f} GB, file {out.stat().st_size / 1e6:.1f} MB")
    return 0 if peak <= AIM else 1


if __name__ == "__main__":
    sys.exit(main())
