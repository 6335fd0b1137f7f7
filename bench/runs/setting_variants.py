"""Times each setting of a suite in every execution, precision and batch, and the steps of fits: for a GPU above all.

It is sized for a GPU that is at hand for minutes: it ends by itself, writes after each setting, and goes on where an
earlier process stopped. First comes one setting of each codec, the last that the suite lists, then the steps of fits,
then all other settings. Before a variant is timed, its answers are compared with those of float64.
"""

import copy
import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from bench import records, timing
from bench.codec import Codec, Fit, Progress, settings_dict, silent
from bench.codecs import shared
from bench.codecs.encoding import fitted
from bench.codecs.registry import make_codec
from bench.data.open import open_material
from bench.demand.mitsuba import load_path_tracer
from bench.inputs.errors import InputError
from bench.machine.devices import is_gpu
from bench.material import Material
from bench.records import Record, Run, load_run
from bench.records.schema import setting_name
from bench.runs import lock
from bench.runs.setting_times import decoded, new_run, start_of, surfaces_of
from bench.runs.suite import CodecSpec, Suite, canonical
from bench.timing import Queries
from bench.timing.execution import DTYPES, TOLERANCES, Variant, exists_on, is_whole, networks, prepared
from bench.timing.profile import limit_ns, roofline

log = logging.getLogger(__name__)

TURNS = 10  # of a variant
CHECKED = 4_096  # random samples whose answers are compared with float64's
BATCHES = tuple(1 << power for power in range(14, 23, 2))
SWEPT = 6  # settings that are timed in each of `BATCHES`, one a codec
FIT_STEPS = 100  # that are timed of a fit, beyond its first
PRECISIONS = {"eager": tuple(DTYPES), "compiled": ("float32", "float16"), "fused": tuple(DTYPES)}


class Clock:
    """The time that is left of so many minutes."""

    def __init__(self, minutes: float):
        self.end = time.monotonic() + 60 * minutes

    @property
    def over(self) -> bool:
        return time.monotonic() >= self.end


def time_variants(suite: Suite, folder: Path, device: str, minutes: float, show: Progress = silent) -> list[Record]:
    """Time the variants of a suite's settings, on its first surface, and steps of fits; returns what it recorded.

    No setting is begun after so many minutes.
    """
    suite, clock, run, on = canonical(suite), Clock(minutes), new_run(), torch.device(device)
    last_of_each = tuple({spec.codec: spec for spec in suite.codecs}.values())
    others = tuple(spec for spec in suite.codecs if spec not in last_of_each)
    found: list[Record] = []
    swept: set[str] = set()
    with lock.locked(folder, run):
        known = load_run(folder) if (folder / records.FILE).exists() else Run(folder)
        done = {timed["job"] for timed in known.timings if timed.get("device") == device}
        ceilings = [ceiling(on, suite.threads, precision) for precision in DTYPES if is_measured(precision, on)]
        records.append(folder, start_of(suite, run, device) | {"ceilings": ceilings})

        def keep(timed: Iterator[Record]) -> None:
            for record in timed:
                records.append(folder, record | {"run": run})
                found.append(record)

        def time_all(specs: tuple[CodecSpec, ...], sweep: bool) -> None:
            settings = decoded(replace(suite, codecs=specs), surfaces_of(suite)[:1], folder, device, show)
            while not clock.over and (each := next(settings, None)):
                (_, label), material = each
                if sweep and networks(material) and len(swept) < SWEPT:
                    swept.add(label)
                batches = BATCHES if label in swept else (timing.batch_on(on),)
                show(f"{label}: executions and precisions", len(found), len(suite.codecs))
                keep(_variants(label, material, batches, suite.threads, ceilings, done))

        time_all(last_of_each, sweep=True)
        keep(_fits(suite, device, clock, done, show))
        time_all(others, sweep=False)
    return found


def _variants(
    label: str,
    material: Material,
    batches: Sequence[int],
    threads: int,
    ceilings: list[dict[str, Any]],
    done: set[str],
) -> Iterator[Record]:
    """The times of a setting in each variant and batch that is not done, each in turns with the others."""
    on = material.device
    exact = copy.deepcopy(material).to(dtype=torch.float64)
    for batch in batches:
        timed: dict[str, tuple[Variant, Material, float]] = {}
        for variant in _possible(material):
            name = f"{setting_name(label, material.cost.flops_per_sample)}/{variant}/{batch}"
            if name in done:
                continue
            try:
                ready = prepared(material, variant)
                timed[name] = variant, ready, difference(ready, exact, variant.precision)
            except Exception as error:  # an error in one variant must not lose the times of the others
                log.warning("%s, %s: not timed: %s", label, variant, " ".join(str(error).split())[:300])
        if not timed:
            continue
        queries = Queries(batch).draw(material.size, on)
        calls = {name: partial(ready.query, *queries) for name, (_, ready, _) in timed.items()}
        measured = timing.in_turns(calls, batch, material.size, threads, on, turns=TURNS)
        for name, (variant, ready, off) in timed.items():
            row: Record = {"kind": "timing", "job": name, "label": label, "flops": material.cost.flops_per_sample}
            row |= timing.conditions(threads, str(on)) | {"batch": batch, "execution": variant.execution}
            row |= {"dtype": variant.precision, "of_tolerance": off, "limit_ns": _limit(ready, variant, ceilings)}
            yield row | measured[name].summary()


def _possible(material: Material) -> list[Variant]:
    """The variants that this kind of device has; without a network those of whole materials alone."""
    every = [Variant(execution, precision) for execution, each in PRECISIONS.items() for precision in each]
    there = [variant for variant in every if exists_on(variant, material.device)]
    if networks(material):
        return there
    return [variant for variant in there if variant.execution == "eager" or is_whole(variant, material.device)]


@torch.no_grad()
def difference(ready: Material, exact: Material, precision: str) -> float:
    """The largest difference of answers from float64's, over the largest that the precision may have."""
    queries = Queries(CHECKED).draw(exact.size, exact.device)
    answers, truth = ready.query(*queries).double(), exact.query(*queries).double()
    absolute, relative = TOLERANCES[precision]
    allowed = absolute + relative * float(truth.abs().max())
    return float((answers - truth).abs().max()) / allowed


def is_measured(precision: str, device: torch.device) -> bool:
    """Whether a precision has a ceiling of its own on a device."""
    return exists_on(Variant("eager", precision), device)


def ceiling(device: torch.device, threads: int, precision: str) -> dict[str, Any]:
    """The measured rates of a device in a precision; `dtype` names the precision, such as tf32."""
    rounds = torch.backends.cuda.matmul
    before = rounds.allow_tf32
    rounds.allow_tf32 = precision == "tf32"
    try:
        return roofline(device, threads, DTYPES[precision]) | {"dtype": precision}
    finally:
        rounds.allow_tf32 = before


def _limit(material: Material, variant: Variant, ceilings: list[dict[str, Any]]) -> float:
    """The fewest ns a sample that the measured ceilings allow in a variant's precision."""
    dtype = DTYPES[variant.precision]
    cost = replace(material.cost, bytes_per_sample=round(material.cost.bytes_per_sample * dtype.itemsize / 4))
    usable = {"float32", variant.precision}  # short types may be widened where that is quicker
    return min(limit_ns(cost, each) for each in ceilings if each["dtype"] in usable)


def _fits(suite: Suite, device: str, clock: Clock, done: set[str], show: Progress) -> Iterator[Record]:
    """The seconds of a step of each codec that is fitted in steps, of its largest setting, while there is time."""
    specs = {
        spec.codec: spec for spec in suite.codecs if "steps" in settings_dict(make_codec(spec.codec, spec.settings))
    }
    surface = surfaces_of(suite)[0]
    btf = open_material(surface, suite.data, show, path_tracer=load_path_tracer)
    train = btf.subset(btf.split().train)
    for spec in specs.values():
        name = f"fit/{spec.label}/{device}"
        if clock.over:
            return
        if name in done:
            continue
        show(f"{spec.label}: steps of its fit", 0, 1)
        try:
            seconds = [_fitted(spec, steps, train, device, suite.threads) for steps in (1, 1 + FIT_STEPS)]
        except InputError as error:
            log.warning("%s: its fit is not timed: %s", spec.label, error)
            continue
        step = max(1.0, 1e9 * (seconds[1] - seconds[0]) / FIT_STEPS)  # ns
        row: Record = {"kind": "timing", "job": name, "label": spec.label, "execution": "fit step", "dtype": "float32"}
        row |= {"batch": 1, "threads": suite.threads, "device": device, "queries": "one step", "texture_fetch": True}
        yield row | {"ns_per_sample": step, "interval95_ns": [step, step]} | timing.hardware(device)


def _fitted(spec: CodecSpec, steps: int, train: Any, device: str, threads: int) -> float:
    """Wall seconds of a fit of so many steps."""
    codec: Codec = make_codec(spec.codec, spec.settings | {"steps": steps})
    fit = Fit(torch.device(device), threads, network=shared.find_for(codec))
    start = time.perf_counter()
    fitted(codec, train, fit)
    if is_gpu(device):
        torch.get_device_module(device).synchronize()
    return time.perf_counter() - start
