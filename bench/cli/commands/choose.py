"""pick the codec and settings that meet a wish for quality, bytes or time

If no measured setting meets the wish, and some settings of the suite are not measured yet, the command first fits and
measures these. It says how many, and after each fit about how long the others take. Validation pairs decide, test
pairs are only shown; with --scene the frames of a scene decide, whose truth is interpolated between training pairs. If
none meets the wishes, it says which of them the nearest one misses. `--json` writes the chosen setting, or the nearest
one, and which of `size`, `time`, `score` and `gpu` it has `missed`.

examples:
  neubtf-bench choose satin --min-psnr 30
  neubtf-bench choose satin --max-bytes 300k --max-ns 500 -o satin.nbtf
  neubtf-bench choose satin --max-bytes 300k --json choice.json
  neubtf-bench choose satin --max-bytes 300k --scene table-top
  neubtf-bench choose satin --min-psnr 30 --codec neumip --codec pca --steps 300 --jobs 0
"""

import argparse
import math
import re
import shlex
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from bench.cli.commands import jobs_option, json_option, json_writer, say_line, several, usable_device, workers
from bench.cli.commands._scene import demand_file, scene_options
from bench.cli.console import Console
from bench.codecs import container, shared
from bench.codecs.loading import load
from bench.compare.choosing import (
    TIE_DB,
    Limits,
    Rung,
    best_rung,
    choice_in_words,
    longest_ns,
    nearest,
    usable_rungs,
)
from bench.data.kinds import kind_of
from bench.data.spec import MaterialSpec
from bench.demand.demand import load as load_demand
from bench.files import atomic
from bench.inputs.errors import FAILED, FINE, NO, ContainerError, InputError
from bench.program.recording import program_of
from bench.records import PSNR, Job, Run, Timing, counted, load_run, run_so_far, timed_on
from bench.runs.runner import Options
from bench.runs.suite import Suite, canonical, load_suite, with_changes
from bench.runs.trade import run_and_measure, timed_jobs
from reports import artefacts
from reports.shaders.dialects import GLSL
from reports.shaders.generator import shader

# The option of each limit.
OPTION_OF = {"size": "--max-bytes", "time": "--max-ns", "score": "--min-psnr", "gpu": "--max-gpu-bytes"}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("material", help="a built-in material or the path of a BTF")
    add("--min-psnr", type=float, metavar="DB", help="the least PSNR of validation pairs")
    add("--max-bytes", metavar="BYTES", help="the largest size of the file: 300k, 1.5M, 20000")
    time = "the longest time of a sample (a whole query); the upper end of its 95 %% interval must not exceed it: "
    time += "CPU time on the suite's threads, one in a built-in suite "
    add("--max-ns", type=float, metavar="NS", help=f"{time}(GPU time with --device cuda)")
    gpu = "the largest size of the textures on a GPU, as `export` writes them; what it cannot export does not count"
    add("--max-gpu-bytes", metavar="BYTES", help=gpu)
    scene_options(parser, "choose by the PSNR of the frames of a scene (--min-psnr is then theirs)")
    several(parser, "--codec", "fit and choose only this codec; repeatable")
    add("--steps", type=int, metavar="N", help="fit missing settings in N steps (default: the suite's)")
    jobs_option(parser, "fits")
    add("--suite", default="trade", help="the suite whose settings are fitted if missing (default: trade)")
    add("--out", type=Path, help="the folder of a `trade`, extended if need be (default: runs/SUITE)")
    add("--device", default="cpu", help="cpu or cuda (default: cpu)")
    add("-o", "--copy", type=Path, metavar="FILE", help="copy the chosen codec file to this place")
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Print the best setting that meets the wishes, after fitting what is missing if nothing measured meets them.

    Returns `FINE`, `NO` if no setting meets them, or `FAILED` if nothing could be measured.
    """
    wishes = _wishes(options)
    if options.copy:
        container.refuse_other_file(options.copy)
    write_json = json_writer(options.json)
    suite = _suite_of_material(options)
    folder = options.out or Path("runs") / suite.name
    with Console() as console:
        demand = demand_file(options, folder, console)
    if demand:
        suite = replace(suite, demand=str(demand))
    material = suite.materials[0].name
    if not suite.data.validation:
        why = f"suite {suite.name} has no validation pairs to choose by"
        raise InputError(f"choose: {why}: add `validation = true` to [data]")
    _refuse_other_material(folder, suite.materials[0])
    rungs = _rungs_after_measuring(folder, suite, options, wishes)
    if not rungs:
        say_line(f"{material}: nothing could be measured; the reasons are in {folder}")
        return FAILED
    measured = load_run(folder)
    best = best_rung(rungs, wishes, TIE_DB)
    if best is None:
        nearest_rung = nearest(rungs, wishes)
        _say_nearest(material, nearest_rung, wishes, options)
        _say_other(folder, suite, options, wishes)
        write_json(_choice_fields(measured, nearest_rung.of) | {"missed": wishes.missed(nearest_rung)})
        return NO
    say_line(f"{material}: {choice_in_words(best.of)}{_frames_in_words(best, options)}")
    say_line(f"every setting: neubtf-bench table trade {shlex.quote(str(folder))} --all")
    fields = _choice_fields(measured, best.of)
    _say_cost(best.of, fields["gpu_bytes"])
    _say_and_copy_file(measured, best.of, options.copy)
    command = _encode_command(suite, best.of, options.device, options.copy)
    if command:
        say_line(command)
    write_json(fields | {"missed": [], "command": command or None})
    return FINE


def _wishes(options: argparse.Namespace) -> Limits:
    """The limits that the options set; `InputError` if they set none, or one that no setting can meet."""
    most_bytes = parse_bytes(options, "max_bytes")
    most_gpu_bytes = parse_bytes(options, "max_gpu_bytes")
    wishes = Limits(size=most_bytes, time=options.max_ns, score=options.min_psnr, gpu=most_gpu_bytes)
    if wishes == Limits():
        raise InputError("choose: no wish is given: give --min-psnr, --max-bytes, --max-gpu-bytes or --max-ns")
    if options.max_ns is not None and not options.max_ns > 0:
        raise InputError(f"--max-ns {options.max_ns:g}: give a number above 0")
    if options.min_psnr is not None and not math.isfinite(options.min_psnr):
        raise InputError(f"--min-psnr {options.min_psnr:g}: give a number of dB")
    return wishes


def _say_nearest(material: str, rung: Rung, wishes: Limits, options: argparse.Namespace) -> None:
    """Print that no setting meets the wishes, the nearest one, and which of them it misses."""
    time = f" (up to {longest_ns(rung.of):,.0f}, 95 % interval)" if wishes.time else ""
    frames = _frames_in_words(rung, options)
    say_line(f"{material}: no setting meets that; the nearest is {choice_in_words(rung.of)}{frames}{time}")
    say_line(f"it misses {' and '.join(OPTION_OF[field] for field in wishes.missed(rung))}")


def _frames_in_words(rung: Rung, options: argparse.Namespace) -> str:
    """The PSNR of a scene's frames, which chose, to follow the figures of a setting; "" without a scene."""
    return f", {rung.score:.2f} dB in the frames of {options.scene}" if options.scene else ""


def _choice_fields(run: Run, row: Timing) -> dict[str, Any]:
    """What `--json` says of a measured setting of a run: its names, settings, costs and scores, and its file."""
    job = run.job(row["of"])
    file = job.get("file") if job else None
    names = ("material", "label", "codec", "settings", "execution", "device", "threads")
    return {name: row.get(name) for name in names} | {
        "precision": row["dtype"],
        "sha256": row["score_key"]["sha256"],
        "bytes": row["bytes"],
        "gpu_bytes": _gpu_bytes(run.folder, job),
        "ns_per_sample": row["ns_per_sample"],
        "longest_ns": longest_ns(row),
        "psnr": {"validation": row["validation"]["mean"], "test": row["psnr"]},
        "file": str(run.folder / file) if file else None,
    }


def _say_other(folder: Path, suite: Suite, options: argparse.Namespace, wishes: Limits) -> None:
    """Print the best measured setting of all codecs that meets the wishes, if --codec left some of them out of
    `suite`."""
    if not options.codec:
        return
    of_all_codecs = argparse.Namespace(**vars(options) | {"codec": []})
    whole = replace(_suite_of_material(of_all_codecs), demand=suite.demand)
    rungs, _ = _measured_rungs(folder, whole, options)
    best = best_rung(rungs, wishes, TIE_DB)
    if best is not None:
        say_line(f"without --codec: {choice_in_words(best.of)}")


def _say_cost(row: Timing, gpu_bytes: int | None) -> None:
    """Print the time of the chosen setting, and the bytes of its textures on a GPU."""
    on_a_gpu = f"{gpu_bytes:,} bytes of textures, as `export` writes them" if gpu_bytes else "not exported"
    longest = f"up to {longest_ns(row):,.0f} ns a sample by its 95 % interval"
    print(f"time: on {timed_on(row)}, {longest}; on a GPU: {on_a_gpu}")


def _gpu_bytes(folder: Path, job: Job | None) -> int | None:
    """The bytes of a job's textures on a GPU, as `export` counts them; None if it cannot be exported."""
    if not job or "file" not in job:
        return None
    try:
        if "drawing" in job:
            program = artefacts.program(folder / job["drawing"])
        else:  # a run draws its first seed alone, and no large textures
            program = program_of(load(folder / job["file"]).material)
        return shader(program, GLSL).gpu_bytes
    except InputError:
        return None


def _say_and_copy_file(run: Run, row: Timing, copy: Path | None) -> None:
    """Print where the chosen file of a run is, and copy it with the network that it needs; `copy` is None for no copy.

    `InputError` if another file took its place, or if it is to be copied and is gone or damaged.
    """
    job = run.job(row["of"])
    if job is None or "file" not in job:
        return
    file = run.folder / job["file"]
    try:
        header = container.read_header(file)
    except ContainerError:  # the file is gone or damaged, which matters only if it is to be copied
        if copy:
            raise
        return
    if header.sha256 != row["score_key"]["sha256"]:
        raise InputError(f"{file}: not the file that was chosen: give another --out, and it is fitted there again")
    say_line(f"file: {file}, sha256 of its content {header.sha256}")
    if not copy:
        return
    if header.network:
        network = shared.hashed_name(header.codec, header.network)
        atomic.write(copy.parent / network, (file.parent / network).read_bytes())
    atomic.write(copy, file.read_bytes())
    say_line(f"wrote {copy}")


def _encode_command(suite: Suite, row: Timing, device: str, out: Path | None) -> str:
    """The command that makes the chosen file again, byte for byte, as `out` if that is given; "" where only a run can
    make it."""
    spec = suite.materials[0]
    data = suite.data
    kind = kind_of(spec)
    if suite.demand or kind.needs_a_run(data):
        return ""
    words = ["encode", spec.path or spec.name, "--codec", row["codec"]]
    for key, value in row["settings"].items():
        words += ["--set", f"{key}={value}"]
    # Only what differs from the defaults is given.
    defaults = asdict(type(data)())
    for key, value in asdict(data).items():
        if value != defaults[key] and not kind.ignores(spec, f"data.{key}"):
            word = "true" if value is True else value
            words += ["--set", f"data.{key}={word}"]
    seed = row["of"].rpartition("/")[2]  # the name of a job ends with it
    if seed != "0":
        words += ["--seed", seed]
    if suite.threads != 1:
        words += ["--threads", str(suite.threads)]
    if device != "cpu":
        words += ["--device", device]
    file = out or Path(spec.name).with_suffix(container.SUFFIX)
    return f"neubtf-bench {shlex.join([*words, '-o', str(file)])}"


def parse_bytes(options: argparse.Namespace, name: str) -> int | None:
    """The size in bytes that an option gives, such as `300k`, `1.5M` or `20000`; None if it is not given.

    `name` is that of its field, such as `max_bytes`. `InputError` for any other text, and for less than a byte.
    """
    text = getattr(options, name)
    if text is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([kM]?)B?", text)
    size = round(float(match[1]) * {"": 1, "k": 1_000, "M": 1_000_000}[match[2]]) if match else 0
    if size < 1:
        raise InputError(f"--{name.replace('_', '-')} {text}: write a number, or a number with k or M, such as 300k")
    return size


def _suite_of_material(options: argparse.Namespace) -> Suite:
    """The suite that the options name, for one material."""
    suite = with_changes(load_suite(options.suite), [options.material], options.codec, changes={})
    if options.steps is None:
        return suite
    try:
        return with_changes(suite, materials=[], codecs=[], changes={"steps": str(options.steps)})
    except InputError as error:
        raise InputError(f"--steps {options.steps}: {error}") from error


def _refuse_other_material(folder: Path, spec: MaterialSpec) -> None:
    """`InputError` if a start in the folder measured another file under the name of this material: its numbers would
    pass for those of this one."""
    for start in run_so_far(folder).starts:
        for measured in start.get("materials") or []:  # absent, or null in the record
            if measured["name"] == spec.name and Path(measured["path"]).resolve() != Path(spec.path).resolve():
                place = measured["path"] or "the built-in material"
                raise InputError(f"{folder}: {spec.name} was measured there from {place}: give another --out")


def _rungs_after_measuring(folder: Path, suite: Suite, options: argparse.Namespace, wishes: Limits) -> list[Rung]:
    """The measured settings; if none of them meets the wishes, the settings of the suite that are missing are fitted
    and measured first, which takes minutes to hours."""
    rungs, missing = _measured_rungs(folder, suite, options)
    if best_rung(rungs, wishes) or not missing:
        return rungs
    named_as_recorded = canonical(suite)  # which loads the codecs
    _, missing = _measured_rungs(folder, named_as_recorded, options)
    if not missing:
        return rungs
    _measure(folder, named_as_recorded, options, missing)
    rungs, _ = _measured_rungs(folder, named_as_recorded, options)
    return rungs


def _measured_rungs(folder: Path, suite: Suite, options: argparse.Namespace) -> tuple[list[Rung], list[str]]:
    """The settings of the suite's codecs that were measured on the device for its material, and the labels of those of
    the suite that were not tried.

    With --max-gpu-bytes, each knows the bytes of its textures on a GPU.
    """
    material = suite.materials[0].name
    run = run_so_far(folder)
    codecs = {codec.codec for codec in suite.codecs}
    of_material = [row for row in run.choices if (row["material"], row["device"]) == (material, options.device)]
    rows = [row for row in of_material if row.get("codec") in codecs]
    tried = {row["label"] for row in rows if "error" in row}  # these are not tried again
    rungs = usable_rungs(rows, material)
    if options.scene:
        rungs = _rungs_in_scene(run, rungs, load_demand(suite.demand).fingerprint)
        tried |= {rung.of["label"] for rung in rungs}
    else:
        tried |= {row["label"] for row in rows if "validation" in row}
    if options.max_gpu_bytes:
        jobs = {rung.of["of"] for rung in rungs}
        gpu_bytes_of = {name: _gpu_bytes(folder, run.job(name)) for name in jobs}
        rungs = [replace(rung, gpu=gpu_bytes_of[rung.of["of"]]) for rung in rungs]
    return rungs, [codec.label for codec in suite.codecs if codec.label not in tried]


def _rungs_in_scene(run: Run, rungs: list[Rung], demand: str) -> list[Rung]:
    """The rungs whose jobs were scored in a scene, by the fingerprint of its demand; their score is the PSNR of its
    frames."""
    in_scene: list[Rung] = []
    for rung in rungs:
        job = run.job(rung.of["of"])
        if job and job["score_key"].get("demand") == demand:
            psnr = job["scene"]["metrics"].get(PSNR)
            in_scene.append(replace(rung, score=counted(psnr)))
    return in_scene


def _measure(folder: Path, suite: Suite, options: argparse.Namespace, missing: list[str]) -> None:
    """Run a trade over the suite, which fits only the missing settings that no earlier start has fitted."""
    # An earlier start may have fitted a setting, and ended before it timed it.
    fitted = {job["job"] for job in run_so_far(folder).jobs if job["status"] == "ok"}
    jobs = timed_jobs(suite).items()
    to_fit = sum(codec.label in missing and name not in fitted for name, codec in jobs)
    settings = f"{len(missing)} of {len(suite.codecs)} settings of {suite.name}"
    with Console() as console:
        console.say(
            f"{suite.materials[0].name}: {settings} are not measured in {folder}: {to_fit} to fit and score, all to "
            "time"
        )
        device = usable_device(options.device)
        seats = workers(options.jobs, suite.threads, options.device)
        run_options = Options(folder, device, show=console.show, say=console.say, workers=seats)
        run_and_measure(suite, run_options, console.ended)
