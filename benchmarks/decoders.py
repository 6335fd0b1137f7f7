"""The decoder of NeuBTF, 3,011 parameters, in every execution: ns a sample and the ratio to one eager batch.

    GOMP_SPINCOUNT=5000 python benchmarks/decoders.py [--samples 1048576] [--threads 0] [--rounds 15]

One batch is the network as one writes it down, each operation into new memory. The variable is what `neubtf-bench`
sets, see docs/trade.md. All contestants take turns in one process and answer the same samples; a ratio is the median
over the turns, with its bootstrap 95 % interval. The default is timed twice: on a quiet machine the two differ by at
most 5 %. Targets, of the decoder alone on all threads of a CPU: the default at most 0.30 of one batch, compiled 0.15,
compiled bfloat16 0.10 with at most 0.1 dB lost, fused 0.08. On a GPU `--device cuda` times whole evaluations, the
texture's fetch included. The dB are those of a fit of satin in `--fit` steps: the same file, scored in float32 and in
bfloat16.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from torch import Tensor

from bench.codec import Fit, silent
from bench.codecs.registry import load_codec
from bench.data.open import open_material
from bench.data.spec import Preparation, named
from bench.decoder import Architecture, Decoder
from bench.errors import InputError
from bench.material import CHUNK, Material, keep_buffers
from bench.metrics.display import exposure, to_display
from bench.threads import torch_threads
from bench.timing import interval95
from bench.timing.clock import calibrated, elapsed
from bench.timing.execution import DTYPES, FUSED_CHUNK, LONG_CHUNK, Variant, needs_compiler, prepared
from bench.timing.fused.lean import Lean, compiled
from bench.timing.machine import Watch, unrest
from bench.timing.queries import Queries

NEUBTF = Architecture(18, (32, 32, 32), activation="sine", omega=2.0, norm=True, residual=True)
TARGETS = {"eager": 0.30, "compiled": 0.15, "compiled bfloat16": 0.10, "fused": 0.08}
AGAIN = "eager, again"
Call = Callable[[], object]


def in_chunks(network: Callable[[Tensor], Tensor], x: Tensor, out: Tensor, chunk: int) -> None:
    for start in range(0, len(x), chunk):
        out[start : start + chunk] = network(x[start : start + chunk])


def textbook(decoder: Decoder, x: Tensor) -> Tensor:
    """What the decoder answers, as one writes it down: an operation after the other, each into new memory."""
    assert decoder.norms is not None
    for layer, norm in zip(decoder.layers, decoder.norms, strict=False):
        hidden = torch.sin(decoder.architecture.omega * norm(layer(x)))
        x = x + hidden if x.shape == hidden.shape else hidden
    answer: Tensor = decoder.layers[-1](x)
    return answer


def on_cpu(samples: int) -> dict[str, Call]:
    """The decoder alone, as each execution computes it. What cannot be computed here is told and left out."""
    decoder = Decoder(NEUBTF, torch.Generator().manual_seed(0)).requires_grad_(False)
    x, out = torch.randn(samples, 18, generator=torch.Generator().manual_seed(1)), torch.empty(samples, 3)
    calls: dict[str, Call] = {
        "one batch": partial(textbook, decoder, x),
        "eager, one batch": partial(decoder, x),
        "eager": partial(in_chunks, decoder, x, out, CHUNK),
    }
    try:
        needs_compiler(x.device)
        for name, precision, chunk in (("", "float32", CHUNK), (" bfloat16", "bfloat16", LONG_CHUNK)):
            network = compiled(Lean(Decoder(NEUBTF).requires_grad_(False).to(DTYPES[precision])), dynamic=False)
            calls["compiled" + name] = partial(in_chunks, network, x, out, chunk)
    except InputError as error:
        print(f"not here: {error}")
    try:
        from bench.timing.fused.with_drjit import DrJitNetwork

        calls["fused"] = partial(in_chunks, DrJitNetwork(decoder), x, out, FUSED_CHUNK)
    except InputError as error:
        print(f"not here: {error}")
    return calls


def on_gpu(samples: int, material: Material) -> dict[str, Call]:
    """Whole evaluations of a material, the fetch included, one batch at once."""
    queries = Queries(samples).draw(material.size, material.device)
    names = ("eager", "compiled", "compiled tf32", "compiled bfloat16", "fused", "fused tf32", "fused bfloat16")
    calls: dict[str, Call] = {}
    for name in names:
        ready = prepared(material, Variant.parse(name))
        ready.chunk = samples
        calls[name] = partial(ready.evaluate, *queries)
    return {"one batch": calls["eager"]} | calls


def fitted(steps: int, device: str) -> tuple[Material, Callable[[Material], float]]:
    """A fitted material, and what gives the held-out display PSNR of it however it is computed."""
    btf = open_material(named("satin"), Preparation(), silent)
    split = btf.split()
    codec = load_codec("neubtf-direct")(steps=steps)
    material = codec.decode(codec.encode(btf.subset(split.train), Fit()), torch.device(device))
    pairs, scale = split.heldout["heldout"], exposure(btf)

    def psnr(ready: Material) -> float:
        errors = [
            np.square(
                to_display(btf[i], scale)
                - to_display(ready.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy(), scale)
            ).mean()
            for i in pairs
        ]
        return -10 * float(np.log10(np.mean(errors)))

    return material, psnr


def measure(calls: dict[str, Call], samples: int, rounds: int, device: torch.device) -> None:
    """Time all in turns, the default execution at both ends, and print the table."""
    calls = {"eager": calls["eager"]} | calls | {AGAIN: calls["eager"]}
    with torch.no_grad():
        for call in calls.values():
            calibrated(call, device)  # compiles and warms up
        with Watch() as watch:
            turns = np.array([[elapsed(call, 1, device) for call in calls.values()] for _ in range(rounds)]) / samples
    times = dict(zip(calls, turns.T, strict=True))
    print(f"| execution | ns a sample | × one batch (95 %) | target |\n|{' --- |' * 4}")
    for name, ns in times.items():
        ratios = ns / times["one batch"]
        median, (low, high) = float(np.median(ratios)), interval95(ratios)
        wanted = TARGETS.get(name) if device.type == "cpu" else None
        target = f"≤ {wanted:.2f}: {'met' if median <= wanted else 'missed'}" if wanted else ""
        print(f"| {name} | {np.median(ns):.3g} | {median:.3f} ({low:.3f} to {high:.3f}) | {target} |")
    again = float(np.median(times[AGAIN]) / np.median(times["eager"]))
    reason = unrest(watch.state() | {"floor_again": again})
    print(f"The default, timed twice, differs by {100 * abs(again - 1):.1f} %.")
    print(f"The machine was not quiet: {reason}." if reason else "The machine was quiet.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1 << 20)
    parser.add_argument("--threads", type=int, default=0, help="0: all")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fit", type=int, default=1000, help="steps of the fit whose loss of dB is told")
    chosen = parser.parse_args()
    keep_buffers()
    device = torch.device(chosen.device)
    with torch_threads(chosen.threads or torch.get_num_threads()):
        print(f"{chosen.samples:,} samples, {torch.get_num_threads()} threads, {time.strftime('%Y-%m-%d %H:%M')}\n")
        material, psnr = fitted(max(1, chosen.fit), chosen.device)
        calls = on_cpu(chosen.samples) if device.type == "cpu" else on_gpu(chosen.samples, material)
        measure(calls, chosen.samples, chosen.rounds, device)
        plain, half = psnr(material), psnr(prepared(material, Variant("compiled", "bfloat16")))
        print(f"held-out PSNR {plain:.3f} dB, compiled bfloat16 {half:.3f} dB: {plain - half:+.3f} dB lost")


if __name__ == "__main__":
    main()
