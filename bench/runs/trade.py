"""Measures the trade-offs of a suite: quality, bytes and time of every setting, execution and precision.

A *choice* is a codec file with a variant: an execution (eager, compiled, network or fused) and a precision. Variants do
not change the file: all are scored and timed from the same one. An entry of the suite may be a *sweep* over the values
of a setting; only the files of other entries are tried in several variants. *Ceilings* are the rates of arithmetic and
memory that were measured on the device. The results are timings among the run's records. A choice gets one when it is
scored, and another, with its time, when it is timed; then it is not measured again.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType
from typing import NamedTuple

import numpy as np
import torch

from bench import records, timing
from bench.codec import Progress, silent
from bench.codecs.loading import load
from bench.compare.choosing import validation_of
from bench.data.spec import MaterialSpec
from bench.demand.mitsuba.lobes import fitted
from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError, installed
from bench.machine.threads import torch_threads
from bench.material import Material
from bench.metrics import metric_of
from bench.metrics.angular import as_number
from bench.metrics.display import display_error
from bench.metrics.psnr import psnr as decibels
from bench.metrics.scoring import summarise
from bench.records import (
    CONDITIONS,
    FLIP,
    PSNR,
    VALIDATION,
    Ceiling,
    Job,
    Run,
    Timing,
    deciding_group,
    load_run,
    metrics_of,
)
from bench.records.schema import job_name, trade_name
from bench.runs import runner
from bench.runs.evaluation import Slices, material_of_job
from bench.runs.suite import CodecSpec, Suite, canonical
from bench.runs.workbench import Opening, Workbench, open_workbench
from bench.timing import native
from bench.timing.execution import Variant, exists_on, networks, prepared
from bench.timing.roofline import least_ns, roofline

BATCH = 65_536  # whole chunks of every execution


def run_and_measure(
    suite: Suite,
    options: runner.Options,
    tell: Callable[[runner.Outcome], None],
    *,
    emulated: bool = False,
    noise: bool = False,
) -> list[str]:
    """Run a suite, with `tell` called for each outcome, then score and time its choices.

    Returns the status of each job: "ok", "failed" or "unavailable". For the options see `measure`. `InputError` for a
    wrong variant, for `noise` without Mitsuba, and as `bench.runs.runner.run` raises it.
    """
    # What the measurement needs after the run is tried first, so that its errors come before the fits.
    for variant in suite.variants:
        Variant.parse(variant)  # a wrong word stops here
    if noise:
        _path_tracer()  # and a missing Mitsuba
    states: list[str] = []
    for outcome in runner.run(suite, options):
        states.append(outcome.record["status"])
        tell(outcome)
    if "ok" in states:
        run = load_run(options.folder)
        options.say(f"{states.count('ok')} of {len(states)} jobs have a file: they are scored and timed now")
        measure(suite, run, options.device, show=options.show, emulated=emulated, noise=noise)
    return states


def measure(
    suite: Suite,
    run: Run,
    device: str,
    *,
    show: Progress = silent,
    emulated: bool = False,
    noise: bool = False,
) -> None:
    """Score and time every choice of a finished run of a suite that is not measured yet; adds the timings to the run
    and to its records.

    `emulated` also measures precisions that the processor only emulates; `noise` measures the noise of a path tracer
    with each file as material.
    """
    suite = canonical(suite)  # jobs are recorded under its names
    measured_variants, left_out = _variants_on_device(suite, torch.device(device), emulated)
    trade = _Trade(replace(suite, variants=tuple(measured_variants)), run, device, left_out, show)
    for spec in suite.materials:
        jobs = _jobs_of(run, suite, spec)
        with_file = [job for job in jobs if job["status"] == "ok"]
        for job in jobs:
            if job["status"] != "ok":
                why = f"{job['status']}: {_on_one_line(job['error'])}"
                trade.write(trade.choice_row(job, Variant()) | {"error": why})
        _measure_choices(trade, spec, with_file)
        if noise:
            for job in with_file:
                _add_noise(trade, job)


@dataclass(frozen=True)
class _Trade:
    """The choices of a suite's variants on a device, in a run."""

    suite: Suite
    run: Run
    device: str
    left_out: list[str]  # variants that the device only emulates, and that are not measured
    show: Progress

    def choice_row(self, job: Job, variant: Variant) -> Timing:
        """What is known of a choice before it is measured."""
        row = self.row_with_conditions(job["job"], job["material"], job["label"], variant)
        row |= {"of": job["job"], "codec": job["codec"]}
        if job["status"] == "ok":
            row |= {"settings": job["settings"], "score_key": job["score_key"]}
            row |= {"bytes": job["bytes"]["total"], "parameters": job["parameters"]}
        if native.emulated(variant.precision, torch.device(self.device)):
            row["emulated"] = True
        return row

    def row_with_conditions(self, of: str, material: str, label: str, variant: Variant) -> Timing:
        """The name and conditions of a choice or of the floor."""
        row: Timing = {
            "kind": "timing",
            "job": trade_name(of, self.device, str(variant)),
            "material": material,
            "label": label,
        }
        row |= timing.conditions(self.suite.threads, self.device)
        row |= {"batch": timing.batch_on(self.device, BATCH)}
        row |= {"execution": variant.execution, "dtype": variant.precision}
        return row

    def measured_before(self, row: Timing) -> Timing:
        """What was measured of a choice before, of the same file and under the same conditions; empty if nothing."""
        before = self.run.timings.latest(row["job"])
        if before is None or "error" in before:
            return {}
        same = ("score_key", "gpu", *CONDITIONS)
        if any(before.get(name) != row.get(name) for name in same):
            return {}
        return before

    def write(self, row: Timing) -> None:
        """Add a timing to the run, as one of its last start, and to its records."""
        of_run: Timing = {**row, "run": self.run.start_of({}).get("run", "")}
        records.append(self.run.folder, of_run)
        self.run.timings.put(row["job"], of_run)


def _variants_on_device(suite: Suite, device: torch.device, emulated: bool) -> tuple[list[str], list[str]]:
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
    """The jobs on one material that are timed, as far as the run has them."""
    jobs = []
    for name in timed_jobs(replace(suite, materials=(spec,))):
        job = run.job(name)
        if job is not None:  # None: its record is missing
            jobs.append(job)
    return jobs


def timed_jobs(suite: Suite) -> dict[str, CodecSpec]:
    """The entries of a suite by the names of the jobs that are timed: those of the first seed of each entry."""
    entries = {}
    for material, codec, seed in suite.cells:
        first_seed, *_ = codec.seeds or suite.seeds
        if seed == first_seed:
            entries[job_name(material.name, codec.label, seed)] = codec
    return entries


def _ceilings(suite: Suite, device: torch.device, cores: int) -> list[Ceiling]:
    """Rooflines of the device: on the suite's threads (also in bfloat16 if a variant uses it), and on all cores."""
    ceilings = [roofline(device, threads) for threads in dict.fromkeys((suite.threads, cores))]
    if any(Variant.parse(text).precision == "bfloat16" for text in suite.variants):
        ceilings.append(roofline(device, suite.threads, torch.bfloat16))
    return ceilings


def _measure_choices(trade: _Trade, spec: MaterialSpec, jobs: list[Job]) -> None:
    """Measure every choice of one material that was not timed yet: quality, bytes, and time in turns with the others.

    First each file is scored in each variant; then all that could be are timed together. The floor, one bilinear fetch
    of a colour, has a timing, too.
    """
    suite = trade.suite
    timed: dict[str, Material] = {}  # by name of the choice
    for choice in _untimed_choices(trade, jobs):
        opening = Opening("trade", spec, suite.data, suite.metrics)
        with open_workbench(opening, trade.show) as workbench:  # which stays open for the next choice
            row = trade.choice_row(choice.job, choice.variant)
            row |= trade.measured_before(row)
            try:
                ready = choice.plain
                if not ready.opaque:  # else another program answers, whose process cannot be copied
                    ready = prepared(ready, choice.variant)
                if "psnr" not in row:
                    row |= _figures_of_choice(trade, workbench, choice, ready)
                if ready.opaque:  # its time would be that of exchanging files
                    row["error"] = "its time cannot be measured"
                else:
                    timed[row["job"]] = ready
            except Exception as error:  # an error in one variant must not lose the figures of the others
                words = _on_one_line(str(error))
                row["error"] = words if isinstance(error, InputError) else f"{type(error).__name__}: {words}"
            trade.write(row)
    if timed:
        _time_choices(trade, spec, timed)


class _Choice(NamedTuple):
    """A job's file in a variant; `plain` is the decoded file in eager float32."""

    job: Job
    variant: Variant
    plain: Material


def _untimed_choices(trade: _Trade, jobs: list[Job]) -> list[_Choice]:
    """The choices of some jobs' files that were not timed yet."""
    untimed = []
    for job in jobs:
        material = material_of_job(trade.run.folder, job, trade.device)
        variants = [Variant()]
        if not material.opaque:
            variants += _variants_of_job(trade.suite, job, material)
        for variant in variants:
            if "ns_per_sample" not in trade.measured_before(trade.choice_row(job, variant)):
                untimed.append(_Choice(job, variant, material))
    return untimed


def _figures_of_choice(trade: _Trade, workbench: Workbench, choice: _Choice, ready: Material) -> Timing:
    """The figures of a choice, whose material in the execution and precision of its variant is `ready`.

    In eager float32 the run has scored the file. In others it is scored now, and its answers are compared with those.
    """
    if choice.variant == Variant():
        return _figures_of_run(trade.run, choice.job)
    scores = _figures_scored_now(workbench, ready, trade.suite.threads, trade.show)
    return scores | _deviation(workbench, ready, choice.plain, trade.show)


def _on_one_line(text: str) -> str:
    """A text with a blank for each line break and other white space."""
    return " ".join(text.split())


def _figures_of_run(run: Run, job: Job) -> Timing:
    """The figures of a file as the run scored it, from its record and the errors of its slices."""
    slices = read_arrays(run.folder / str(job["slices"]), MAX_FILE)
    squared_errors = slices[PSNR]
    if deciding_group(job["scores"]) == "heldout":
        squared_errors = squared_errors[slices["heldout"]]
    return _figures(job, squared_errors)


def _time_choices(trade: _Trade, spec: MaterialSpec, timed: dict[str, Material]) -> None:
    """Time choices, given by name, in turns with each other and the floor, and write their timings."""
    threads = trade.suite.threads
    ceilings = _ceilings(trade.suite, torch.device(trade.device), torch.get_num_threads())
    own_ceilings = [ceiling for ceiling in ceilings if ceiling["threads"] == threads]
    measured = timing.time_materials(timed, threads, timing.batch_on(trade.device, BATCH), trade.show)
    for name, ready in timed.items():
        row = trade.run.timings.latest(name)
        assert row is not None  # it was written when it was scored
        trade.write({**row, **measured[name].summary(), "limit_ns": least_ns(ready, row["dtype"], own_ceilings)})
    floor = trade.row_with_conditions(f"{spec.name}/{timing.FLOOR}", spec.name, timing.FLOOR, Variant())
    floor |= {"ceilings": ceilings, "left_out": trade.left_out}
    trade.write(floor | measured[timing.FLOOR].summary())


def _variants_of_job(suite: Suite, job: Job, material: Material) -> list[Variant]:
    """The variants of the suite that a job's file is tried in, besides eager float32.

    None for an entry with a sweep, whose many files would take too long. Without a network only the variants that
    change a whole material remain.
    """
    if not any(spec.label == job["label"] and not spec.swept for spec in suite.codecs):
        return []
    variants = [Variant.parse(text) for text in suite.variants]
    if networks(material):
        return variants
    return [variant for variant in variants if variant.execution == "fused"]


def _figures_scored_now(workbench: Workbench, material: Material, threads: int, show: Progress) -> Timing:
    """The figures of a material in another execution or precision, scored now at deciding and validation pairs."""
    groups = {deciding_group(workbench.groups): workbench.deciding}
    if VALIDATION in workbench.groups:
        groups[VALIDATION] = np.intersect1d(workbench.scored, workbench.groups[VALIDATION])
    pairs = np.unique(np.concatenate([*groups.values()]))
    with torch_threads(threads):
        scores = workbench.scorer.score(pairs, Slices(workbench, material, show).slice)
    summary = summarise(scores, workbench.btf.wo, workbench.btf.wi, groups)
    squared_errors = scores.raw[PSNR][np.isin(scores.pairs, workbench.deciding)]
    return _figures({"scores": summary}, squared_errors)


def _deviation(workbench: Workbench, ours: Material, plain: Material, show: Progress) -> Timing:
    """`from_float32`: display PSNR in dB against the answers of `plain`, the file in eager float32, of the deciding
    slice that differs most; None if none differs."""
    ours_slices = Slices(workbench, ours, show)
    plain_slices = Slices(workbench, plain, show)
    exposure = workbench.scorer.exposure
    errors = []  # mean squared display errors
    for pair in workbench.deciding.tolist():
        errors.append(display_error(ours_slices.slice(pair), plain_slices.slice(pair), exposure))
    return {"from_float32": as_number(float(decibels(max(errors))))}


def _figures(job: Job, squared_errors: np.ndarray) -> Timing:
    """PSNR in dB, FLIP and the PSNR of the worst slice, of deciding pairs; of validation pairs the statistics of PSNR.

    `job` has at least the `scores` of a record; `squared_errors` (n,) are the mean squared display errors of the
    deciding pairs. FLIP is None if it was not measured, and `validation` missing without such pairs.
    """
    metrics = metrics_of(job)
    flip_name = metric_of(metrics, FLIP)  # the full name of the FLIP that was measured; "" if none was
    figures: Timing = {
        "psnr": metrics[PSNR]["mean"],
        "flip": metrics[flip_name]["mean"] if flip_name else None,
        "worst": as_number(float(decibels(squared_errors.max()))),
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


def _add_noise(trade: _Trade, job: Job) -> None:
    """Add to the choice of a file in eager float32 the noise of a path tracer with it as material, or why it was not
    measured.

    Other executions and precisions have the same noise, and get none.
    """
    row = trade.run.timings.latest(trade.choice_row(job, Variant())["job"])
    if row is None or "noise" in row:
        return
    path_tracer = _path_tracer()
    file = trade.run.folder / job["file"]
    try:
        lobes = fitted(load(file).material, show=trade.show)
        noises = path_tracer.reached(file, [None, lobes])  # sampling by the cosine, and by the fitted lobes
    except (InputError, RuntimeError) as error:  # the second is Mitsuba's; keep the figures of other files
        trade.write({**row, "noise_error": _on_one_line(str(error))})
        return
    samples, seconds = [each.samples for each in noises], [each.seconds for each in noises]
    with_noise: Timing = {**row, "noise": {"scene": path_tracer.EVEN, "samples": samples, "seconds": seconds}}
    with_noise.pop("noise_error", None)
    trade.write(with_noise)
