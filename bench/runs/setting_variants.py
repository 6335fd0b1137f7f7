"""Times each setting of a suite in every execution, precision and batch, and the steps of fits: for a GPU above all.

A setting is a codec with the values of its settings, such as `pca components=4`. A variant is an execution (eager,
compiled, network or fused) with a precision: it answers the same queries from the same file. All this is for a GPU that
is at hand for minutes: it ends by itself, writes after each setting, and goes on where an earlier process stopped.
First comes one setting of each codec, the last that the suite lists, then the steps of fits, batches of other sizes,
and all other settings. Before a variant is timed, its answers are compared with float64's.
"""

import copy
import logging
import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from bench import records, timing
from bench.btf import BTF
from bench.codec import Codec, Fit, Progress, ended_bars, followed, settings_dict, silent
from bench.codecs import shared
from bench.codecs.encoding import fit_codec
from bench.codecs.registry import make_codec
from bench.data.open import open_material
from bench.demand.mitsuba import load_path_tracer
from bench.files import atomic
from bench.inputs.errors import InputError
from bench.machine.devices import is_gpu, watts
from bench.machine.memory import forget_peak, peak_bytes
from bench.material import Material
from bench.records import Ceiling, RunStart, Timing
from bench.records.schema import setting_name
from bench.runs import lock
from bench.runs.provenance import new_run, start_of
from bench.runs.setting_times import decoded_settings, surfaces_of
from bench.runs.suite import CodecSpec, Suite, canonical
from bench.timing import native, random_queries
from bench.timing.execution import DTYPES, TOLERANCES, Variant, exists_on, networks, prepared
from bench.timing.roofline import least_ns, read_bytes, roofline

log = logging.getLogger(__name__)

TURNS = 10  # of a variant
CHECKED = 4_096  # random samples whose answers are compared with float64's
BATCHES = tuple(1 << power for power in range(14, 23, 2))
LARGEST_ON_CPU = 1 << 18  # queries: a larger batch takes minutes on a CPU, and no longer a sample
SWEPT = 6  # settings that are timed in each of `BATCHES`, one a codec
# Files in the folder: the variant that is being tried, and those that ended a process.
TRIED = "tried.txt"
GIVEN_UP = "given-up.txt"
FIT_STEPS = 100  # that are timed of a fit, beyond its first
PRECISIONS: dict[str, tuple[str, ...]] = {  # by execution
    "eager": tuple(DTYPES),
    "compiled": ("float32", "float16"),
    "network": tuple(DTYPES),
    "fused": ("float32",),
}


class Clock:
    """The time that is left of so many minutes."""

    def __init__(self, minutes: float):
        """The minutes begin now."""
        self.end = time.monotonic() + 60 * minutes

    @property
    def over(self) -> bool:
        """Whether no time is left."""
        return time.monotonic() >= self.end


def time_variants(suite: Suite, folder: Path, device: str, minutes: float, show: Progress = silent) -> list[Timing]:
    """Time the variants of a suite's settings, on its first surface, and steps of fits; returns what it recorded.

    Nothing is begun after `minutes`. `InputError` if the suite has no surface, if another run uses the folder, if it
    cannot be written, or if the surface cannot be opened to time steps of fits.
    """
    if not suite.materials:
        raise InputError(f"suite {suite.name}: it has no materials: name one")
    run = new_run()
    with lock.locked(folder, run), ended_bars(show) as show_in_bars:
        measuring = _Measuring(canonical(suite), folder, torch.device(device), run, Clock(minutes), show_in_bars)
        measuring.measure_all()
    return measuring.rows


class _Measuring:
    """The timing of a suite's variants on one device, into one folder, until a clock is over."""

    def __init__(self, suite: Suite, folder: Path, device: torch.device, run: str, clock: Clock, show: Progress):
        """Find what earlier processes have timed, measure the ceilings, and record the start."""
        self.suite = suite
        self.folder = folder
        self.device = device
        self.run = run
        self.clock = clock
        self.show = show
        self.rows: list[Timing] = []  # that this process recorded
        earlier = records.run_so_far(folder)
        gpu = timing.hardware(device).get("gpu")  # its name; None on a CPU
        on_device = [row for row in earlier.timings if row.get("device") == str(device) and row.get("gpu") == gpu]
        # Names of what an earlier process has timed on this device, and of what cannot be timed.
        self.done = {row["job"] for row in on_device} | self.give_up_tried()
        native_precisions = [precision for precision in DTYPES if _is_native(precision, device)]
        self.ceilings = [ceiling(device, suite.threads, precision) for precision in native_precisions]
        start: RunStart = {**start_of(suite, run, str(device), jobs=[]), "ceilings": self.ceilings}
        records.append(folder, start)

    def measure_all(self) -> None:
        """Time one setting of each codec, then steps of fits, batches of other sizes, and all other settings.

        Batches of other sizes are those of networks alone, of the first `SWEPT` settings that have one: a small batch
        costs more because of the launches of its layers.
        """
        usual = timing.batch_on(self.device)  # queries
        # Of one codec the last setting replaces the others: suites list the largest last.
        last_of_each = tuple({spec.codec: spec for spec in self.suite.codecs}.values())
        others = tuple(spec for spec in self.suite.codecs if spec not in last_of_each)
        swept: list[CodecSpec] = []
        for spec, material in self.settings(last_of_each):
            self.time(spec.label, material, usual)
            if networks(material) and len(swept) < SWEPT:
                swept.append(spec)
        self.record(_timings_of_steps(self.suite, str(self.device), self.clock, self.done, self.show))
        batches = [batch for batch in BATCHES if is_gpu(self.device) or batch <= LARGEST_ON_CPU]
        for spec, material in self.settings(tuple(swept)):
            for batch in batches:
                self.time(spec.label, material, batch)
        for spec, material in self.settings(others):
            self.time(spec.label, material, usual)

    def settings(self, specs: tuple[CodecSpec, ...]) -> Iterator[tuple[CodecSpec, Material]]:
        """Each setting with its material, decoded from a file of one step, while there is time."""
        suite = replace(self.suite, codecs=specs)
        decoded = decoded_settings(suite, surfaces_of(suite)[:1], self.folder, str(self.device), self.show)
        while not self.clock.over:
            contestant = next(decoded, None)
            if contestant is None:
                return
            yield contestant.spec, contestant.material

    def time(self, label: str, material: Material, batch: int) -> None:
        """Time a setting in each variant that is not done, each in turns with the others, and write the records.

        `batch` counts the queries of a call.
        """
        flops = material.cost.flops_per_sample
        setting = setting_name(label, flops)
        variants = _possible_variants(material)
        names = {f"{setting}/{variant}/{batch}/{self.device}": variant for variant in variants}
        missing = {name: variant for name, variant in names.items() if name not in self.done}
        queries = random_queries(batch, self.device)
        ready = self.ready_variants(label, material, missing, queries)
        if not ready:
            return
        materials = {name: each.material for name, each in ready.items()}
        measured = timing.time_materials(materials, self.suite.threads, batch, turns=TURNS)
        rows = []
        for name, (prepared_material, of_tolerance) in ready.items():
            execution, precision = missing[name].execution, missing[name].precision
            row: Timing = {"kind": "timing", "job": name, "label": label, "flops": flops}
            row |= timing.conditions(self.suite.threads, str(self.device))
            row |= {"batch": batch, "execution": execution, "dtype": precision, "of_tolerance": of_tolerance}
            row |= {"limit_ns": least_ns(prepared_material, precision, self.ceilings), **measured[name].summary()}
            row |= _gpu_figures(prepared_material, queries, precision)
            rows.append(row)
        self.record(rows)

    def ready_variants(
        self, label: str, material: Material, missing: dict[str, Variant], queries: tuple[Tensor, ...]
    ) -> dict[str, "_Ready"]:
        """Each missing variant by name, prepared and compared with float64's answers, while there is time.

        A variant that fails at this, or at the queries that are to be timed, is left out, with a warning.
        """
        exact = copy.deepcopy(material).to(dtype=torch.float64)
        ready = {}
        for name, variant in followed(self.show, missing.items(), f"{label}: executions and precisions", len(missing)):
            if self.clock.over:
                break
            # A fault of a GPU may end this process. The next one then finds the variant's name in this file.
            tried = self.folder / TRIED
            atomic.write(tried, name.encode())
            try:
                prepared_material = prepared(material, variant)
                of_tolerance = difference_from_exact(prepared_material, exact, variant.precision)
                prepared_material.query(*queries)
                wait_for_gpu(self.device)
                ready[name] = _Ready(prepared_material, of_tolerance)
            except Exception as error:  # an error in one variant must not lose the times of the others
                log.warning("%s, %s: not timed: %s", label, variant, " ".join(str(error).split())[:300])
                wait_for_gpu(self.device)  # after a fault of a GPU everything fails: the next process goes on
            except KeyboardInterrupt:
                tried.unlink()
                raise
            tried.unlink()
        return ready

    def give_up_tried(self) -> set[str]:
        """Give up the variant that ended an earlier process, as a fault of a GPU does; returns all that were given up:
        none is tried again."""
        tried = self.folder / TRIED
        given_up = self.folder / GIVEN_UP
        names = given_up.read_text(encoding="utf-8").splitlines() if given_up.exists() else []
        if tried.exists():  # a process that goes on removes it after each variant
            names.append(tried.read_text(encoding="utf-8"))
            atomic.write(given_up, "".join(f"{name}\n" for name in names).encode())
            tried.unlink()
        for name in names:
            log.warning("%s: not timed: it ended an earlier process; remove %s to try it again", name, given_up)
        return set(names)

    def record(self, rows: Iterable[Timing]) -> None:
        """Write records, each as it comes, and note them as done."""
        for row in rows:
            row_of_run: Timing = {**row, "run": self.run}
            records.append(self.folder, row_of_run)
            self.rows.append(row)
            self.done.add(row["job"])


def _gpu_figures(ready: Material, queries: tuple[Tensor, ...], precision: str) -> Timing:
    """What a batch of queries takes of a GPU besides time: the bytes that a sample reads; the most memory that is
    held and the power in watts, where the GPU tells them. Empty on a CPU."""
    if not is_gpu(ready.device):
        return {}
    figures: Timing = {"read_bytes": read_bytes(ready.cost, precision)}
    call = partial(ready.query, *queries)
    if forget_peak(ready.device):
        call()
        held = peak_bytes(ready.device)
        if held is not None:
            figures["memory"] = held
    power = watts(ready.device, call)
    if power is not None:
        figures["watts"] = power
    return figures


class _Ready(NamedTuple):
    """A material that was prepared for a variant, and its largest difference from float64's answers, as a multiple of
    the largest that the precision may have."""

    material: Material
    of_tolerance: float


def _possible_variants(material: Material) -> list[Variant]:
    """The variants that the material's device has and computes in natively. Of a material without a network, only those
    of eager execution, and those that change a whole material instead of its networks."""
    possible = []
    for execution, precisions in PRECISIONS.items():
        for precision in precisions:
            variant = Variant(execution, precision)
            if exists_on(variant, material.device) and _is_native(precision, material.device):
                possible.append(variant)
    if networks(material):
        return possible
    return [variant for variant in possible if variant.execution in ("eager", "fused")]


def _is_native(precision: str, device: torch.device) -> bool:
    """Whether a device has a precision, and computes in it instead of emulating it."""
    return exists_on(Variant("eager", precision), device) and not native.emulated(precision, device)


def wait_for_gpu(device: torch.device) -> None:
    """Wait until a GPU has done all; raises `RuntimeError` if it has a fault. A CPU has, when a call returns."""
    if is_gpu(device):
        torch.get_device_module(device).synchronize(device)


@torch.no_grad()
def difference_from_exact(ready: Material, exact: Material, precision: str) -> float:
    """The largest difference of answers from float64's, as a multiple of the largest that the precision may have.

    `InputError` if it is not finite: a short type may overflow, and no record holds such a number.
    """
    queries = random_queries(CHECKED, exact.device)
    answers = ready.query(*queries).double()
    truth = exact.query(*queries).double()
    absolute, relative = TOLERANCES[precision]
    allowed = absolute + relative * float(truth.abs().max())
    largest = float((answers - truth).abs().max())
    if not math.isfinite(largest):
        raise InputError("answers are not finite")
    return largest / allowed


def ceiling(device: torch.device, threads: int, precision: str) -> Ceiling:
    """The measured rates of arithmetic and memory of a device in a precision, which the field `dtype` names.

    For the measurement it changes how PyTorch multiplies matrices, and restores it.
    """
    products = torch.backends.cuda.matmul  # how PyTorch multiplies matrices on a GPU
    before = products.allow_tf32
    products.allow_tf32 = precision == "tf32"  # of the type float32, and so a setting instead of a type
    try:
        measured = roofline(device, threads, DTYPES[precision])
    finally:
        products.allow_tf32 = before
    measured["dtype"] = precision
    return measured


def _timings_of_steps(suite: Suite, device: str, clock: Clock, done: set[str], show: Progress) -> Iterator[Timing]:
    """The time of a step of each codec that is fitted in steps, at its largest setting, while there is time.

    `done` are the names of those that an earlier process has timed.
    """
    specs = [spec for spec in _largest_in_steps(suite) if _name_of_step(spec, device) not in done]
    if clock.over or not specs:
        return
    surface = surfaces_of(suite)[0]
    btf = open_material(surface, suite.data, show, path_tracer=load_path_tracer)
    train = btf.subset(btf.split().train)
    for spec in followed(show, specs, "timing steps of fits", len(specs)):
        if clock.over:
            return
        try:
            # The first fit of a codec in a process pays for imports and compilations: it is not counted.
            _seconds_of_fit(spec, steps=1, train=train, device=device, threads=suite.threads)
            one_step = _seconds_of_fit(spec, steps=1, train=train, device=device, threads=suite.threads)
            many_steps = _seconds_of_fit(spec, steps=1 + FIT_STEPS, train=train, device=device, threads=suite.threads)
        except Exception as error:  # a fit may take more memory than a GPU has
            log.warning("%s: its fit is not timed: %s", spec.label, error)
            continue
        step_ns = 1e9 * (many_steps - one_step) / FIT_STEPS  # without what a fit takes besides its steps
        if step_ns <= 0:
            log.warning("%s: its fit is not timed: %d steps took no longer than one", spec.label, 1 + FIT_STEPS)
            continue
        yield _timing_of_step(_name_of_step(spec, device), spec.label, step_ns, suite.threads, device)


def _name_of_step(spec: CodecSpec, device: str) -> str:
    """The name in records of the time of a step of a setting's fit on a device."""
    return f"fit/{spec.label}/{device}"


def _largest_in_steps(suite: Suite) -> list[CodecSpec]:
    """The last entry of each codec that is fitted in steps: suites list the largest setting last.

    What cannot be made here is left out, with a warning.
    """
    last_of_each: dict[str, CodecSpec] = {}  # by codec
    for spec in suite.codecs:
        try:
            codec = make_codec(spec.codec, spec.settings)
        except InputError as error:
            log.warning("%s: its fit is not timed: %s", spec.label, error)
            continue
        if "steps" in settings_dict(codec):
            last_of_each[spec.codec] = spec
    return list(last_of_each.values())


def _timing_of_step(name: str, label: str, step_ns: float, threads: int, device: str) -> Timing:
    """The record of the time of a fit's step, in the form of a time of a query."""
    row: Timing = {"kind": "timing", "job": name, "label": label}
    row |= timing.conditions(threads, device)
    row |= {"batch": 1, "execution": "fit step", "queries": "one step"}
    return row | {"ns_per_sample": step_ns, "interval95_ns": [step_ns, step_ns]}  # one measurement has no interval


def _seconds_of_fit(spec: CodecSpec, steps: int, train: BTF, device: str, threads: int) -> float:
    """Wall seconds of a fit of so many steps to the training pairs `train`."""
    codec: Codec = make_codec(spec.codec, spec.settings | {"steps": steps})
    fit = Fit(torch.device(device), threads, network=shared.find_for(codec))
    start = time.perf_counter()
    fit_codec(codec, train, fit)
    wait_for_gpu(torch.device(device))
    return time.perf_counter() - start
