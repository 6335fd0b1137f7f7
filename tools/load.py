"""How far the ratio of each codec's time to the floor moves when other processes are busy.

    python tools/load.py [--busy 2] [CODEC ...]

Fits some codecs for a few steps to a tiny material, which changes no time, and times them in turns twice: with nothing
beside, and beside processes that multiply matrices or copy memory without end. Prints a Markdown table of the ratios
with their 95 % intervals; a time holds on any machine where the two agree within a tenth.
"""

import argparse
import multiprocessing
import sys
from typing import Any

import numpy as np
import torch

from bench.btf import BTF
from bench.codec import Fit
from bench.codecs import registry
from bench.conformance.check import tiny_btf
from bench.material import Material
from bench.timing import FLOOR, time_materials

CODECS = ("pca", "vq", "neubtf-direct", "neumip", "rainer2019", "zeltner2024", "bcf", "ntc", "relief")


def busy(multiplies: bool) -> None:
    """Multiply or copy until the process is ended."""
    torch.set_num_threads(1)
    one = np.ones((512, 512), np.float32) if multiplies else np.ones(1 << 23, np.float32)
    while True:
        one = one @ one / 512 if multiplies else one.copy()


def decoded(name: str, btf: BTF) -> Material:
    """The material of a codec after a fit of a few steps."""
    codec = registry.load_codec(name)
    settings: dict[str, Any] = {"steps": 5} if "steps" in codec.Settings.__dataclass_fields__ else {}
    made = codec(**settings)
    return made.decode(made.encode(btf, Fit()), torch.device("cpu"))


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--busy", type=int, default=2, help="processes beside (default: 2)")
    parser.add_argument("codec", nargs="*", default=CODECS)
    options = parser.parse_args()
    materials = {name: decoded(name, tiny_btf()) for name in options.codec}
    alone = time_materials(materials, 1)
    others = [multiprocessing.Process(target=busy, args=(i % 2 == 0,), daemon=True) for i in range(options.busy)]
    for each in others:
        each.start()
    beside = time_materials(materials, 1)
    for each in others:
        each.terminate()
    print(f"| codec | × floor, alone | × floor, beside {options.busy} | moved |\n| --- | --- | --- | --- |")
    worst = 0.0
    for name in materials:
        one, two = alone[name].summary(), beside[name].summary()
        moved = two["ratio_to_floor"] / one["ratio_to_floor"] - 1
        worst = max(worst, abs(moved))
        cells = (
            f"{s['ratio_to_floor']:.3g} ({s['ratio_interval95'][0]:.3g} to {s['ratio_interval95'][1]:.3g})"
            for s in (one, two)
        )
        print(f"| {name} | {' | '.join(cells)} | {100 * moved:+.0f} % |")
    floors = (times[FLOOR].summary()["ns_per_sample"] for times in (alone, beside))
    print(f"\nThe floor: {' and '.join(f'{ns:.3g} ns' for ns in floors)}. Largest move: {100 * worst:.0f} %.")


if __name__ == "__main__":
    sys.exit(main())
