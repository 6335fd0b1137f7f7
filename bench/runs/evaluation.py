"""Scores one codec file against its material: figures go into the record, large arrays into files beside it.

A file is scored at the pairs `workbench.scored`, and apart from these at pairs of low light, between texels, and over
footprints of 1, 2, 4 and 8 texels.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from bench.btf import BTF
from bench.codec import Progress
from bench.codecs import loading, registry, shared
from bench.codecs.command import ProgramMaterial
from bench.codecs.container import Header
from bench.codecs.loading import Loaded
from bench.codecs.scene_material import without_warnings
from bench.codecs.slices_material import SlicesMaterial
from bench.directions.hemisphere import to_degrees
from bench.inputs.errors import ContainerError, InputError
from bench.machine.threads import torch_threads
from bench.material import Material, parameters, resident_bytes, texel_centres
from bench.metrics import get as get_metric
from bench.metrics import metric_of, read_scores, scoring
from bench.metrics.description import Metric
from bench.metrics.display import to_display
from bench.metrics.flip import magma
from bench.program.recording import program_of
from bench.records import (
    FLIP,
    LOW_LIGHT,
    PSNR,
    SCENE_HELDOUT,
    Between,
    Bytes,
    Cost,
    Job,
    MetricFacts,
    Provenance,
    ScoreKey,
    Statistics,
    deciding_group,
)
from bench.runs.identity import identity
from bench.runs.workbench import Workbench

DRAWN_FLOATS = 2_000_000  # the most floats of a texture that a page draws live
COARSE = (2, 4, 8)  # footprints in texels that are scored in addition to slices, whose footprint is one texel
Keep = Callable[[str, dict[str, Any]], str]  # stores content under a name, and returns the name for the record


def score_key(workbench: Workbench, header: Header) -> ScoreKey:
    """Everything that the figures of a file depend on. A file is not scored again if a record has the same key."""
    codec_class = registry.load_codec(header.codec, wanted_by=str(header.path))
    codec = codec_class(**header.settings)
    modules_of_metrics = [type(metric).__module__ for metric in workbench.scorer.metrics.values()]
    code = identity(codec, __name__, *modules_of_metrics)["code"]  # a hash of the source of decoder and scores
    key: ScoreKey = {"sha256": header.sha256, "code": code}
    return key | conditions(workbench)


def conditions(workbench: Workbench) -> ScoreKey:
    """Everything besides the file that scores depend on: the part of a score key that comparable rows share."""
    versions = {name: get_metric(name).version for name in workbench.scorer.names}
    key: ScoreKey = {"btf": workbench.btf.fingerprint, "exposure": workbench.exposure}
    key |= {"metrics": versions, "footprints": scoring.FOOTPRINTS_VERSION}
    if workbench.demand:
        key["demand"] = workbench.demand.fingerprint
    if LOW_LIGHT in workbench.groups:
        key["low_light"] = len(workbench.groups[LOW_LIGHT])
    if workbench.btf.between is not None:
        key["between"] = len(workbench.btf.between)
    if len(workbench.scored) < len(workbench.groups["all"]):  # not all pairs are scored
        key["scored"] = len(workbench.scored)
    # The pairs whose mean ranks codecs. If only some of them are scored, the mean depends on which.
    all_deciding = workbench.groups[deciding_group(workbench.groups)]
    if len(workbench.deciding) < len(all_deciding):
        key["deciding"] = sha256(workbench.deciding.astype("<i8").tobytes()).hexdigest()[:16]
    return key


def evaluate(workbench: Workbench, file: Loaded, threads: int, keep: Keep, show: Progress) -> Job:
    """Score the material decoded from a codec file; returns settings, bytes, scores and costs for its record.

    `keep(name, content)` stores what is too large for the record, and returns the name that the record holds.
    `InputError` if the file's shared network was trained on this material: it may not be scored on it.
    """
    shared.refuse_training_material(file.network, workbench.btf)
    material = without_warnings(file.material)  # it is asked outside its scene, too, on purpose
    figures = record_of_scores(workbench, material, file.header.path.stem, threads, keep, show)
    sizes = cast(Bytes, file.header.part_bytes() | {"total": file.header.file_bytes})
    if file.network:
        sizes["shared"] = file.network.file_bytes
    record: Job = {"settings": file.header.settings, "bytes": sizes}
    return record | figures


def record_of_scores(
    workbench: Workbench, material: Material, stem: str, threads: int, keep: Keep, show: Progress
) -> Job:
    """Score any material: its record without settings and bytes; kept files are called after `stem`.

    Pairs are scored by `threads` threads of PyTorch. `keep` stores scores by slice, angular maps and pictures in files.
    """
    # What needs answers of the material: scores of pairs and of footprints, pictures and frames.
    slices = Slices(workbench, material, show)
    with torch_threads(threads):
        scores = workbench.scorer.score(workbench.scored, slices.slice_with_progress)
        at_low_light = _at_low_light(workbench, slices)
        coarse = scoring.footprint_errors(workbench.btf, workbench.deciding, slices.boxes, workbench.exposure, COARSE)
        between = _between_texels(workbench, slices)
        pictures = _pictures(workbench, slices)
        in_scene = _in_scene(workbench, material, stem, keep)
    summary = _summary_of_groups(workbench, scores) | at_low_light
    finest = summary[deciding_group(workbench.groups)]["metrics"][PSNR]
    # A slice is the footprint of one texel, so its scores stand beside those of larger footprints, in their form.
    at_one_texel: Statistics = {PSNR: finest["pooled"]} | {key: finest[key] for key in ("mean", "exact", "slices")}
    angular = {"polar": scoring.polar_maps(scores, workbench.btf.wo, workbench.btf.wi)}
    record: Job = {
        "shape": list(workbench.btf.shape),
        "pairs": {group: len(pairs) for group, pairs in workbench.groups.items()},
        "views": len(workbench.btf.without_low_light().layout.views),
        "provenance": cast(Provenance, workbench.btf.provenance),
        **_costs(material),
        "metrics": {metric: metric_facts(get_metric(metric)) for metric in workbench.scorer.names},
        "scores": read_scores(summary),
        "footprints": {"1": at_one_texel} | scoring.summarise_footprints(coarse),
        "slices": keep(f"slices/{stem}.npz", _arrays_of_slices(workbench, scores, coarse)),
        "angular": keep(f"angular/{stem}.json", angular),
        "pictures": keep(f"pictures/{stem}.npz", pictures),
    }
    if workbench.exposed.fault:
        record["black"] = workbench.exposed.black
    return record | between | in_scene


def _costs(material: Material) -> Job:
    """What a material takes, as fields of a record; after it was asked, because a program's queries are counted."""
    costs: Job = {"parameters": None, "resident": None, "cost": cast(Cost, dataclasses.asdict(material.cost))}
    if not material.opaque:  # an opaque material, such as another program, does not tell them
        costs |= {"parameters": parameters(material), "resident": resident_bytes(material)}
    # A program's own time is not known: what is measured includes the exchange of files, so it has fields of its own.
    if isinstance(material, ProgramMaterial):
        nanoseconds = 1e9 * material.waited / max(1, material.queries)
        costs["program"] = {"queries": material.queries, "ns_per_query": nanoseconds}
    return costs


def _summary_of_groups(workbench: Workbench, scores: scoring.Scores) -> dict[str, Any]:
    """The means of scores over each group of pairs, and over the pairs that a scene asks for, by name of the group."""
    groups = {name: pairs for name, pairs in workbench.groups.items() if name != LOW_LIGHT}
    decides = deciding_group(workbench.groups)  # "heldout", or "all" if no pairs are held out
    if decides != "all" and len(workbench.scored) < len(workbench.groups["all"]):
        del groups["all"]  # if only some training pairs are scored, a mean over all scored pairs represents neither set
    summary: dict[str, Any] = scoring.summarise(scores, workbench.btf.wo, workbench.btf.wi, groups)
    if workbench.scene_shares is not None:
        summary["scene"] = scoring.weighted(scores, workbench.scene_shares)
    if workbench.heldout_shares is not None:
        summary[SCENE_HELDOUT] = scoring.weighted(scores, workbench.heldout_shares)
    return summary


def _at_low_light(workbench: Workbench, slices: "Slices") -> dict[str, Any]:
    """The means of scores over the pairs of low light, as the group of that name; empty without such pairs.

    They are scored apart, so that no map, bin or mean of the other pairs holds them.
    """
    pairs = workbench.groups.get(LOW_LIGHT)
    if pairs is None:
        return {}
    scores = workbench.scorer.score(pairs, slices.slice)
    summary = scoring.summarise(scores, workbench.btf.wo, workbench.btf.wi, {LOW_LIGHT: pairs})
    return {LOW_LIGHT: summary[LOW_LIGHT]}


def _between_texels(workbench: Workbench, slices: "Slices") -> Job:
    """The field `between` of a record: the mean display PSNR between texels, and that of the same pairs at texel
    centres.

    Empty without a rendering of the truth there, and for stored slices, which answer nowhere but at texel centres.
    """
    truth = workbench.btf.between
    if truth is None or isinstance(slices.material, SlicesMaterial):
        return {}
    between = scoring.footprint_errors(truth, range(len(truth)), slices.between, workbench.exposure, [1])
    centres = scoring.footprint_errors(workbench.btf, workbench.at_centres, slices.boxes, workbench.exposure, [1])
    means: Between = {
        "mean": _mean_at_one_texel(between),
        "centres": _mean_at_one_texel(centres),
        "slices": len(truth),
    }
    return {"between": means}


def _mean_at_one_texel(errors: dict[int, np.ndarray]) -> float:
    """The mean display PSNR in dB of slices, given their errors by footprint."""
    mean = scoring.summarise_footprints(errors)["1"]["mean"]
    return cast(float, mean)  # never None: a slice without an error counts, too


def metric_facts(metric: Metric) -> MetricFacts:
    """What the record of a job says of a metric, which tables show with its numbers."""
    return {
        "unit": metric.unit,
        "direction": metric.direction,
        "space": metric.space,
        "version": metric.version,
    }


def store_drawing(file: Loaded, keep: Keep) -> Job:
    """Store what a page needs to draw the material live.

    Returns the part of a record: `drawing`, the name of the stored file, or `not_drawn`, the reason in words.
    """
    if file.material.cost.texture_floats > DRAWN_FLOATS:
        return {"not_drawn": f"its texture has more than {DRAWN_FLOATS:,} floats"}
    try:
        program = program_of(file.material)
    except InputError as error:
        return {"not_drawn": str(error)}
    return {"drawing": keep(f"drawings/{file.header.path.stem}.npz", program.arrays())}


def material_of_job(folder: Path, job: Job, device: str) -> Material:
    """Decode the file of a job. `ContainerError` if it is not the file that the record describes."""
    file = loading.load(folder / job["file"], device)
    if file.header.sha256 != job["score_key"]["sha256"]:
        raise ContainerError(f"{file.header.path}: not the file that {job['job']} recorded: run the suite again")
    return file.material


@dataclass
class Slices:
    """Slices of the decoded material at the pairs of its BTF."""

    workbench: Workbench
    material: Material
    show: Progress

    def slice(self, pair: int) -> np.ndarray:
        """Linear radiance (H, W, 3) of one pair."""
        return self.boxes(pair, [1])[1]

    def boxes(self, pair: int, factors: Sequence[int]) -> dict[int, np.ndarray]:
        """Linear radiance (H // factor, W // factor, 3) of one pair by factor: means over whole boxes of factor²
        texels."""
        btf = self.workbench.btf
        answers = self.material.boxes(btf.wo[pair].tolist(), btf.wi[pair].tolist(), factors, btf.shape)
        return {factor: rgb.numpy() for factor, rgb in answers.items()}

    def between(self, number: int, factors: Sequence[int] = (1,)) -> dict[int, np.ndarray]:
        """Linear radiance (H, W, 3) of pair `number` of `BTF.between`, half a texel down and to the right of texel
        centres, as factor 1, the only one that there is: asked for in place of `boxes`."""
        truth = cast(BTF, self.workbench.btf.between)
        height, width = truth.shape
        uv = texel_centres(height, width) + torch.tensor([0.5 / width, -0.5 / height])
        wo = torch.tensor(truth.wo[number]).expand(len(uv), 3)
        wi = torch.tensor(truth.wi[number]).expand(len(uv), 3)
        answers = self.material.query(uv, wo, wi, 1 / max(height, width))
        return {1: answers.reshape(height, width, 3).numpy()}

    def slice_with_progress(self, pair: int) -> np.ndarray:
        """The slice of one pair; also moves the progress bar."""
        # `scored` ascends, and pairs are scored in its order: the place of a pair is the number of those before it.
        done = int(np.searchsorted(self.workbench.scored, pair)) + 1
        self.show("scoring", done, len(self.workbench.scored))
        return self.slice(pair)


def _in_scene(workbench: Workbench, material: Material, stem: str, keep: Keep) -> Job:
    """The fields of a record on a scene: the quality in its `frames`, and the stored file of a few small ones.

    Empty without a scene.
    """
    frame_scorer = workbench.frame_scorer
    if frame_scorer is None:  # the workbench has no demand
        return {}
    frames = frame_scorer.frames(material)
    pictures = keep(f"frames/{stem}.npz", frame_scorer.pictures(frames))
    return {"scene": frame_scorer.record(frames), "frames": pictures}


def _arrays_of_slices(
    workbench: Workbench, scores: scoring.Scores, coarse: dict[int, np.ndarray]
) -> dict[str, np.ndarray]:
    """The scores of every slice as arrays (n,), and its directions (n, 2) as (θ, φ) in degrees.

    `footprint_2` and so on are the errors at larger footprints, which are measured at deciding pairs alone; NaN at
    others. `coarse` has these errors by footprint, of the deciding pairs in order.
    """
    heldout = np.isin(scores.pairs, workbench.groups.get("heldout", []))
    # `abrdf` (H, W) is the error of each texel over all directions. `raw` has each metric by slice, before any mean.
    arrays = {"pairs": scores.pairs, "heldout": heldout, "abrdf": scores.abrdf} | scores.raw
    arrays["wo_deg"] = np.stack(to_degrees(workbench.btf.wo[scores.pairs]), 1)
    arrays["wi_deg"] = np.stack(to_degrees(workbench.btf.wi[scores.pairs]), 1)
    is_deciding = np.isin(workbench.scored, workbench.deciding)  # (n,)
    for factor, errors in coarse.items():
        errors_of_all = np.full(len(is_deciding), np.nan)
        errors_of_all[is_deciding] = errors
        arrays[f"footprint_{factor}"] = errors_of_all
    return arrays


def _pictures(workbench: Workbench, slices: Slices) -> dict[str, np.ndarray]:
    """The n shown slices as 8-bit pictures (n, H, W, 3): `truth` and `decoded` for a display, and `flip`, FLIP maps in
    magma, which too small slices lack.

    `sheet` (n,) is a mask of those that a contact sheet holds, `pairs` (n,) are their pairs in the BTF, and `wo_deg`
    and `wi_deg` (n, 2) their directions as (θ, φ) in degrees.
    """
    truth = np.stack([workbench.btf[pair] for pair in workbench.shown])
    decoded = np.stack([slices.slice(pair) for pair in workbench.shown])
    pictures = {
        "truth": np.round(to_display(truth, workbench.exposure) * 255).astype(np.uint8),
        "decoded": np.round(to_display(decoded, workbench.exposure) * 255).astype(np.uint8),
        "wo_deg": np.stack(to_degrees(workbench.btf.wo[workbench.shown]), 1),
        "wi_deg": np.stack(to_degrees(workbench.btf.wi[workbench.shown]), 1),
        "pairs": workbench.shown,
        "sheet": np.isin(workbench.shown, workbench.sheet),
    }
    flip = workbench.scorer.metrics.get(metric_of(workbench.scorer.names, FLIP))
    if flip and min(workbench.btf.shape) >= flip.smallest:  # FLIP filters over an area; smaller slices have no map
        error = flip.error_map(flip.prepare(truth, workbench.exposure), np.maximum(decoded, 0))
        pictures["flip"] = np.round(magma(error) * 255).astype(np.uint8)
    return pictures
