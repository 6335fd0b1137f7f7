"""Measures the trade-offs of a suite: quality, bytes and time of every setting, execution and precision.

A *choice* is a codec file with an execution (eager, compiled or fused) and a precision; the two together are a variant.
Variants do not change the file: all are scored and timed from the same one. An entry of the suite may be a *sweep* over
the values of a setting; only the files of other entries are tried in several variants. *Ceilings* are the rates of
arithmetic and memory that were measured on the device. The results go into `trade.json` beside the run's records, which
is rewritten each time.
"""

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
import torch

from bench import timing
from bench.codec import Progress, silent
from bench.codecs.loading import load
from bench.compare.choosing import answers, validation_of
from bench.data.spec import MaterialSpec
from bench.demand.mitsuba.lobes import fitted
from bench.files import atomic
from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError, installed
from bench.machine.devices import device_name, is_gpu
from bench.machine.threads import torch_threads
from bench.material import Material
from bench.metrics import metric_of
from bench.metrics.angular import as_number
from bench.metrics.display import display_error
from bench.metrics.psnr import psnr as decibels
from bench.metrics.scoring import summarise
from bench.records import (
    FILE,
    FLIP,
    PSNR,
    VALIDATION,
    Ceiling,
    Job,
    Run,
    Trade,
    TradeChoice,
    deciding_group,
    metrics_of,
)
from bench.records.lines import TRADE, TRADE_FORMAT, load_run, load_trade
from bench.runs import runner
from bench.runs.estimate import duration
from bench.runs.evaluation import Slices, material_of_job
from bench.runs.provenance import machine
from bench.runs.suite import CodecSpec, Suite, canonical
from bench.runs.unfinished import Unfinished, forget
from bench.runs.workbench import Opening, Workbench, open_workbench
from bench.timing import Queries, native
from bench.timing.execution import Variant, exists_on, is_whole, networks, prepared
from bench.timing.profile import ceiling_calls, limit_ns, profile, rates, roofline
from bench.timing.turns import KeptTurns

BATCH = 65_536  # whole chunks of every execution
USUAL_NS = 1000.0  # of a query on a CPU, if no time is known: most codecs take 200 to 5,000
BATCHES = (1, 64, 1024, timing.BATCH, 1 << 18)  # sizes of batches that a profile times


def run_and_measure(
    suite: Suite,
    options: runner.Options,
    tell: Callable[[runner.Outcome], None],
    full: bool = False,
    emulated: bool = False,
    noise: bool = False,
    profiles: bool = True,
) -> list[str]:
    """Run a suite, with `tell` called for each outcome, then score and time its choices into `trade.json`.

    Returns the status of each job: "ok", "failed" or "unavailable". For the options see `measure`.
    """
    # What the measurement needs after the run is tried first, so that its errors come before the fits.
    for variant in suite.variants:
        Variant.parse(variant)  # a wrong word stops here
    if noise:
        _path_tracer()  # and a missing Mitsuba
    load_trade(options.folder)  # an unreadable file stops here
    states: list[str] = []
    folder = options.folder
    suite = canonical(suite)
    before = Run(folder)  # without records
    if (folder / FILE).exists():
        before = load_run(folder)
    options = replace(options, then=_timing_in_words(suite, before, options.device, _timed_jobs(suite)))
    for outcome in runner.run(suite, options):
        states.append(outcome.record["status"])
        tell(outcome)
    if "ok" in states:
        run = load_run(options.folder)
        options.say(_announcement(suite, run, options.device))
        for spec in suite.materials:  # written after each material
            of_material = replace(suite, materials=(spec,))
            result = measure(of_material, run, options.device, full, options.show, emulated, noise, profiles)
            write(options.folder, merged(load_trade(options.folder), result))
    return states


def measure(
    suite: Suite,
    run: Run,
    device: str,
    full: bool = False,
    show: Progress = silent,
    emulated: bool = False,
    noise: bool = False,
    profiles: bool = True,
) -> Trade:
    """Score and time every choice of a finished run of a suite; returns the content of `trade.json`.

    `full` profiles batches up to 2^22 instead of 2^18, which takes half an hour more; `emulated` also measures
    precisions that the processor only emulates; `noise` measures the noise of a path tracer with each file as material;
    without `profiles` the choices alone are timed, in a fraction of the time.
    """
    suite = canonical(suite)  # jobs are recorded under its names
    target = torch.device(device)
    cores = torch.get_num_threads()
    batches: tuple[int, ...] = BATCHES
    if full:
        batches = (*BATCHES, 1 << 20, 1 << 22)
    measured_variants, left_out = _variants_on(suite, target, emulated)
    suite = replace(suite, variants=tuple(measured_variants))
    ceilings = _ceilings(suite, target, cores)
    result: Trade = {  # `answers`, sentences that a reader wants first, come last
        "format": TRADE_FORMAT,
        "suite": suite.name,
        "ceilings": ceilings,
        "left_out": left_out,
        "choices": [],
        "profiles": [],
    }
    for spec in suite.materials:
        jobs = []  # those that have a file
        for job in _jobs_of(run, suite, spec):
            if job["status"] == "ok":
                jobs.append(job)
            else:
                result["choices"].append(_failed_row(job, device))
        if not jobs:
            continue
        with open_workbench(Opening("trade", spec, suite.data, suite.seeds[0], suite.metrics), show) as workbench:
            choices = _choices(workbench, jobs, suite, run, device, ceilings, show)
        if noise:
            for row in choices:
                _add_noise(run, row, show)
        result["choices"] += choices
        if profiles:
            profiled = _materials_to_profile(suite, run, jobs, device)
            if profiled:
                result["profiles"] += profile(spec.name, profiled, cores, batches)
    lines: list[str] = []
    for spec in suite.materials:
        lines += answers(spec.name, result["choices"])
    result["answers"] = lines
    return result


def _materials_to_profile(suite: Suite, run: Run, jobs: list[Job], device: str) -> dict[str, Material]:
    """By label, the material of each job whose entry of the suite is no sweep; of the first job, if all are sweeps.

    None of them is one that another program decodes: its time cannot be measured.
    """
    materials = {}
    for job in jobs:
        if _without_sweep(suite, job):
            material = material_of_job(run.folder, job, device)
            if not material.opaque:
                materials[job["label"]] = material
    if materials:
        return materials
    for job in jobs:
        material = material_of_job(run.folder, job, device)
        if not material.opaque:
            return {job["label"]: material}
    return {}


def _variants_on(suite: Suite, device: torch.device, emulated: bool) -> tuple[list[str], list[str]]:
    """The variants of a suite that are measured on a device, in words, and those that are left out because the device
    only emulates them; with `emulated` none is. Variants that it does not have are in neither list."""
    measured_variants = []
    left_out = []
    for text in suite.variants:
        variant = Variant.parse(text)
        if not exists_on(variant, device):
            continue
        if native.emulated(variant.precision, device) and not emulated:
            left_out.append(text)
        else:
            measured_variants.append(text)
    return measured_variants, left_out


def _jobs_of(run: Run, suite: Suite, spec: MaterialSpec) -> list[Job]:
    """The jobs of a suite's codecs on one material, of its first seed, as far as the run has them."""
    jobs = []
    for codec in suite.codecs:
        job = run.job(f"{spec.name}/{codec.label}/{suite.seeds[0]}")
        if job is not None:  # None: its record is missing
            jobs.append(job)
    return jobs


def _announcement(suite: Suite, run: Run, device: str) -> str:
    """How many files are timed now, and about how long: `5 files to score and time, about 2 min of timing`."""
    done = []  # names of jobs that have a file
    for name in _timed_jobs(suite):
        job = run.job(name)
        if job is not None and job["status"] == "ok":
            done.append(name)
    files = f"{len(done)} file{'s' * (len(done) != 1)}"
    return f"{files} to score and time, {_timing_in_words(suite, run, device, done)}"


def _timing_in_words(suite: Suite, run: Run, device: str, names: Collection[str]) -> str:
    """About how long it takes to time these jobs, in words.

    A query is expected to take what a run measured before or, where it did not, what it takes with most codecs. Each
    contestant, a file in one variant, is timed in `timing.TURNS` turns, and each turn is followed by one of the floor,
    a look-up of a colour, which times are multiples of. No turn is shorter than about `timing.SPAN_NS`.
    """
    target = torch.device(device)
    entries = _timed_jobs(suite)
    batch = timing.batch_on(target, BATCH)
    timed_variants, _ = _variants_on(suite, target, emulated=False)  # besides eager float32
    seconds = 0.0
    for name in names:
        # A turn calls the job's decoder once for `batch` queries, or as often as fill the shortest turn.
        turn_ns = max(timing.SPAN_NS, batch * _expected_ns(run, name, target))
        floor_ns = timing.SPAN_NS  # the floor is quick, so its turn is the shortest
        contestants = 1 + len(timed_variants)
        if entries[name].swept:  # it is timed in eager float32 alone
            contestants = 1
        seconds += 1e-9 * timing.TURNS * (turn_ns + floor_ns) * contestants
    return f"about {duration(seconds)} of timing"


def _expected_ns(run: Run, name: str, device: torch.device) -> float:
    """How many ns a query of a job takes: as measured in a run before or, without that, as with most codecs."""
    job = run.job(name)
    if job is not None:
        measured = run.timing(job)
        if measured is not None:
            return measured["ns_per_sample"]
    if is_gpu(device):
        return 0.0  # a turn on a GPU is the shortest possible
    return USUAL_NS


def _timed_jobs(suite: Suite) -> dict[str, CodecSpec]:
    """The entries of a suite by the names of the jobs that are timed: those of its first seed."""
    first_seed = suite.seeds[0]
    entries = {}
    for material, codec, seed in suite.cells:
        if seed == first_seed:
            entries[f"{material.name}/{codec.label}/{seed}"] = codec
    return entries


def merged(earlier: Trade | None, result: Trade) -> Trade:
    """A result, extended by the choices and profiles that only an earlier result holds.

    A choice of the earlier result is dropped if the new one has its material, label and device; a profile, if the new
    one has any of its material.
    """
    choices = result["choices"]
    profiles = result["profiles"]
    if earlier is not None:
        scored = {(row["material"], row["label"], row["device"]) for row in choices}
        other_choices = [
            row for row in earlier["choices"] if (row["material"], row["label"], row["device"]) not in scored
        ]
        choices = [*other_choices, *choices]
        profiled = {row["material"] for row in profiles}
        other_profiles = [row for row in earlier["profiles"] if row["material"] not in profiled]
        profiles = [*other_profiles, *profiles]
    lines: list[str] = []
    for name in dict.fromkeys(row["material"] for row in choices):
        lines += answers(name, choices)
    return {**result, "choices": choices, "profiles": profiles, "answers": lines}


def _ceilings(suite: Suite, device: torch.device, cores: int) -> list[Ceiling]:
    """Rooflines of the device: on the suite's threads (also in bfloat16 if a variant uses it), and on all cores."""
    ceilings = [roofline(device, threads) for threads in dict.fromkeys((suite.threads, cores))]
    if any(Variant.parse(text).precision == "bfloat16" for text in suite.variants):
        ceilings.append(roofline(device, suite.threads, torch.bfloat16))
    return ceilings


def write(folder: Path, result: Trade) -> None:
    """Store the result beside the records, atomically; removes what an unfinished measurement had kept for it."""
    atomic.write(folder / TRADE, json.dumps(result, allow_nan=False).encode())
    forget(folder)


def _failed_row(job: Job, device: str) -> TradeChoice:
    """A row with the error of a job that has no result."""
    return {
        "material": job["material"],
        "label": job["label"],
        "codec": job["codec"],
        "device": device,
        "execution": "eager",
        "precision": "float32",
        "error": f"{job['status']}: {' '.join(job['error'].split())}",
    }


def _without_sweep(suite: Suite, job: Job) -> bool:
    """Whether a job belongs to a codec entry without a sweep; such a job represents its codec."""
    return any(spec.label == job["label"] and not spec.swept for spec in suite.codecs)


def _choices(
    workbench: Workbench,
    jobs: list[Job],
    suite: Suite,
    run: Run,
    device: str,
    ceilings: list[Ceiling],
    show: Progress,
) -> list[TradeChoice]:
    """Every choice of one material: quality, bytes, time in turns with all others, and whether it is on a front.

    First each file is scored in each variant, a row each; then all that could be are timed together, and the times join
    the rows. The last row is the floor, one bilinear fetch of a colour; there is none if nothing could be timed. Keeps
    what it measured in the run's folder, for the case that it is interrupted.
    """
    unfinished = Unfinished(run.folder)
    rows: list[TradeChoice] = []
    timed: dict[int, Material] = {}  # by the number of the row
    for job in jobs:
        material = material_of_job(run.folder, job, device)
        if material.opaque:  # another program answers: its time would be that of exchanging files
            rows.append(_row_without_time(run, job, device))
            continue
        for variant in (Variant(), *_variants(suite, job, material)):
            row = _row(job, variant, device)
            if native.emulated(variant.precision, material.device):
                row["emulated"] = True
            try:
                ready = prepared(material, variant)  # the material in that execution and precision
                if variant == Variant():  # eager float32, in which the run has scored the file
                    row |= _figures_of_run(run, job)
                else:
                    key = json.dumps([job["score_key"], variant.execution, variant.precision, device, suite.threads])
                    score_variant = partial(_figures_of_variant, workbench, ready, material, suite.threads, show)
                    row |= unfinished.figures_of(key, score_variant)
            except Exception as error:  # an error in one variant must not lose the figures of the others
                row["error"] = _on_one_line(error)
            else:
                timed[len(rows)] = ready
            rows.append(row)
    if not timed:  # every row has an error: no time, and no floor that times are compared with
        return rows
    floor = _add_times(workbench.name, rows, timed, suite.threads, device, ceilings, unfinished, show)
    _mark_fronts([row for row in rows if "error" not in row])
    return [*rows, floor]


def _on_one_line(error: Exception) -> str:
    """An error in words, on one line; of an unexpected one also its class."""
    words = " ".join(str(error).split())
    if isinstance(error, InputError):
        return words
    return f"{type(error).__name__}: {words}"


def _row(job: Job, variant: Variant, device: str) -> TradeChoice:
    """What is known of a choice before it is measured."""
    return {
        "material": job["material"],
        "job": job["job"],
        "label": job["label"],
        "codec": job["codec"],
        "settings": job["settings"],
        "execution": variant.execution,
        "precision": variant.precision,
        "bytes": job["bytes"]["total"],
        "parameters": job["parameters"],
        "device": device,
        "sha256": job["score_key"]["sha256"],
    }


def _row_without_time(run: Run, job: Job, device: str) -> TradeChoice:
    """The row of a file that another program decodes: its figures of quality, and why it has no time."""
    row = _row(job, Variant(), device)
    row["error"] = "its time cannot be measured"
    try:
        row |= _figures_of_run(run, job)
    except Exception as error:  # the figures of others must not be lost
        row["error"] = _on_one_line(error)
    return row


def _figures_of_run(run: Run, job: Job) -> TradeChoice:
    """The figures of a file as the run scored it, from its record and the errors of its slices."""
    slices = read_arrays(run.folder / str(job["slices"]), MAX_FILE)
    squared_errors = slices[PSNR]
    if deciding_group(job["scores"]) == "heldout":
        squared_errors = squared_errors[slices["heldout"]]
    return _figures(job, squared_errors)


def _add_times(
    material_name: str,
    rows: list[TradeChoice],
    timed: dict[int, Material],
    threads: int,
    device: str,
    ceilings: list[Ceiling],
    unfinished: Unfinished,
    show: Progress,
) -> TradeChoice:
    """Time materials in turns and add the times to their rows, of which `timed` gives the numbers; returns the
    floor's."""
    batch = timing.batch_on(device, BATCH)
    conditions: TradeChoice = {"batch": batch, "threads": threads, "device": device}
    if is_gpu(device):
        conditions["gpu"] = device_name(device)
    # Turns of an interrupted timing count again only if the same contestants were timed under the same conditions.
    contestants = [[rows[i]["sha256"], rows[i]["execution"], rows[i]["precision"]] for i in timed]
    kept_turns = unfinished.turns(json.dumps([material_name, conditions, machine(), contestants]))
    of_these_threads = [ceiling for ceiling in ceilings if ceiling["threads"] == threads]
    materials = {str(i): ready for i, ready in timed.items()}
    measured = _time_in_turns(materials, of_these_threads, batch, show, kept_turns)
    for i, ready in timed.items():
        times = _times(measured[str(i)])
        least = _limit(ready, ceilings)
        rows[i] |= times | conditions
        rows[i] |= {"limit_ns": least, "of_limit": least / times["ns_per_sample"]}
    floor: TradeChoice = {
        "material": material_name,
        "label": timing.FLOOR,
        "execution": "eager",
        "precision": "float32",
    }
    return floor | conditions | _times(measured[timing.FLOOR])


def _times(measured: timing.Timing) -> TradeChoice:
    """The fields of a choice that its timing gives."""
    return cast(TradeChoice, measured.summary())


def _time_in_turns(
    materials: dict[str, Material], ceilings: list[Ceiling], batch: int, show: Progress, kept: KeptTurns
) -> dict[str, timing.Timing]:
    """Time materials in turns with each other and with the ceilings, which rise where a turn reaches more."""
    first = next(iter(materials.values()))  # its size and device stand for those of all
    queries = Queries(batch).draw(first.size, first.device)
    # What takes turns, by name: each material, and for each ceiling a matrix product and a copy of memory.
    calls: dict[str, Callable[[], Any]] = {name: partial(each.query, *queries) for name, each in materials.items()}
    for ceiling in ceilings:
        dtype = ceiling["dtype"]
        product_call, copy_call = ceiling_calls(first.device, getattr(torch, dtype))
        calls[f"product {dtype}"] = product_call
        calls[f"copy {dtype}"] = copy_call
    measured = timing.in_turns(calls, batch, first.size, ceilings[0]["threads"], first.device, show, kept)
    for ceiling in ceilings:
        dtype = ceiling["dtype"]
        # `samples` are ns of a turn over the batch: times the batch, they are ns of the whole product or copy.
        product = batch * float(measured[f"product {dtype}"].samples.min())
        copied = batch * float(measured[f"copy {dtype}"].samples.min())
        flops, read = rates(product, copied, first.device)
        ceiling["flops_per_ns"] = max(ceiling["flops_per_ns"], flops)
        ceiling["bytes_per_ns"] = max(ceiling["bytes_per_ns"], read)
    return measured


def _variants(suite: Suite, job: Job, material: Material) -> list[Variant]:
    """The variants of the suite that a job's file is tried in, besides eager float32.

    None for an entry with a sweep, whose many files would take too long. Without a network only the variants that
    change a whole material remain.
    """
    if not _without_sweep(suite, job):
        return []
    variants = [Variant.parse(text) for text in suite.variants]
    if networks(material):
        return variants
    return [variant for variant in variants if is_whole(variant, material.device)]


def _limit(material: Material, ceilings: list[Ceiling]) -> float:
    """The machine's lower bound in ns per sample: short types read fewer bytes, and may multiply faster."""
    # `cost` counts bytes of float32. A short type may be widened to float32, so the rates of both count.
    share_of_bytes = material.dtype.itemsize / 4
    cost = replace(material.cost, bytes_per_sample=round(material.cost.bytes_per_sample * share_of_bytes))
    usable = ("float32", str(material.dtype).removeprefix("torch."))
    threads = ceilings[0]["threads"]
    limits = []
    for ceiling in ceilings:
        if ceiling["threads"] == threads and ceiling["dtype"] in usable:
            limits.append(limit_ns(cost, ceiling))
    return min(limits)


def _figures_of_variant(
    workbench: Workbench, ours: Material, plain: Material, threads: int, show: Progress
) -> TradeChoice:
    """The figures of a material in another execution or precision, and how far it answers from eager float32."""
    return _score(workbench, ours, threads, show) | _deviation(workbench, ours, plain, show)


def _score(workbench: Workbench, material: Material, threads: int, show: Progress) -> TradeChoice:
    """The figures of a material in another execution or precision, scored now at deciding and validation pairs."""
    groups = {deciding_group(workbench.groups): workbench.deciding}
    if VALIDATION in workbench.groups:
        groups[VALIDATION] = np.intersect1d(workbench.scored, workbench.groups[VALIDATION])
    pairs = np.unique(np.concatenate([*groups.values()]))
    with torch_threads(threads):
        scores = workbench.scorer.score(pairs, Slices(workbench, material, show).slice)
    summary = summarise(scores, workbench.btf.wo, workbench.btf.wi, groups)
    return _figures({"scores": summary}, scores.raw[PSNR][np.isin(scores.pairs, workbench.deciding)])


def _deviation(workbench: Workbench, ours: Material, plain: Material, show: Progress) -> TradeChoice:
    """`from_float32`: PSNR against the answers of eager float32, of the deciding slice that differs most; None if none
    differs.
    """
    ours_slices = Slices(workbench, ours, show)
    plain_slices = Slices(workbench, plain, show)
    exposure = workbench.scorer.exposure
    errors = []  # mean squared display errors
    for pair in workbench.deciding.tolist():
        errors.append(display_error(ours_slices.slice(pair), plain_slices.slice(pair), exposure))
    return {"from_float32": as_number(float(decibels(max(errors))))}


def _figures(job: Job, squared: np.ndarray) -> TradeChoice:
    """PSNR, FLIP and worst-slice PSNR of the deciding pairs, and PSNR of validation pairs, if a record has them.

    `squared` (n,) are the mean squared display errors of the deciding pairs.
    """
    metrics = metrics_of(job)
    flip_name = metric_of(metrics, FLIP)  # the full name of the FLIP that was measured; "" if none was
    flip = None
    if flip_name:
        flip = metrics[flip_name]["mean"]
    figures: TradeChoice = {
        "psnr": metrics[PSNR]["mean"],
        "flip": flip,
        "worst": as_number(float(decibels(squared.max()))),
    }
    validation = validation_of(job)  # empty if the job was scored at no validation pair
    if validation:
        figures["validation"] = dict(validation)
    return figures


def _path_tracer() -> ModuleType:
    """The module that measures noise with the path tracer Mitsuba, which is set up for it.

    `InputError` if Mitsuba is not installed, or cannot run here.
    """
    remedy = "install it, pip install neubtf-bench[mitsuba], or leave out --noise"
    with installed(f"--noise path-traces with Mitsuba 3: {remedy}"):
        from bench.demand.mitsuba import noise, scene
    scene.set_variant()
    return noise


def _add_noise(run: Run, row: TradeChoice, show: Progress) -> None:
    """Add to a row the noise of a path tracer with its file as material, or why it was not measured.

    Other executions and precisions have the same noise, and get none. Neither does the floor, which has no file.
    """
    is_eager_float32 = (row["execution"], row["precision"]) == (Variant().execution, Variant().precision)
    if "sha256" not in row or not is_eager_float32:
        return
    job = run.job(row["job"])
    assert job is not None  # the choice is one of its file
    path_tracer = _path_tracer()
    file = run.folder / job["file"]
    try:
        lobes = fitted(load(file).material, show=show)
        noises = path_tracer.reached(file, [None, lobes])  # sampling by the cosine, and by the fitted lobes
    except (InputError, RuntimeError) as error:  # the second is Mitsuba's; keep the figures of other files
        row["noise_error"] = " ".join(str(error).split())
        return
    row["noise"] = {
        "scene": path_tracer.EVEN,
        "samples": [each.samples for each in noises],
        "seconds": [each.seconds for each in noises],
    }


def _mark_fronts(rows: list[TradeChoice]) -> None:
    """Mark each choice that is on a Pareto front: no other is at least as good and as cheap, and better in one."""
    quality = [round(cast(float, row["psnr"]), 2) for row in rows]  # executions of one file differ by rounding
    fastest = _on_front(quality, [row["ns_per_sample"] for row in rows])
    smallest = _on_front(quality, [row["bytes"] for row in rows])
    for row, is_fastest, is_smallest in zip(rows, fastest, smallest, strict=True):
        row["fastest"] = is_fastest
        row["smallest"] = is_smallest


def _on_front(quality: Sequence[float], costs: Sequence[float]) -> list[bool]:
    """Whether each place of quality and cost is on the Pareto front."""
    places = list(zip(quality, costs, strict=True))
    on_front = []
    for place in places:
        beaten = any(_beats(other, place) for other in places)
        on_front.append(not beaten)
    return on_front


def _beats(other: tuple[float, float], place: tuple[float, float]) -> bool:
    """Whether another place of quality and cost is at least as good and as cheap, and better in one."""
    other_quality, other_cost = other
    quality, cost = place
    return other_quality >= quality and other_cost <= cost and other != place
