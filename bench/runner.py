"""Runs a suite: encode → file → decode → score → record, for every job, and times the decoders of each material.

Everything is scored from the decoded file. A job has two keys. The *fit key* names what shapes the file (codec,
settings, training pairs, seed, threads, device class, PyTorch): where a file of that key is there, nothing is fitted
again. The *score key* names what shapes the numbers (the file's hash, the pairs, metric versions, exposure): where a
record of that key is there, nothing is scored again. Timing is measured anew in every run.
"""

import dataclasses
import hashlib
import json
import re
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench import container, records, timing
from bench.btf import BTF, Split
from bench.codec import Codec, Fit, Progress, settings_dict, silent
from bench.counting import parameters
from bench.directions import PairInterpolator
from bench.errors import InputError, MissingDataError
from bench.hemisphere import to_degrees
from bench.material import Material
from bench.metrics import get as get_metric
from bench.metrics.display import to_display
from bench.metrics.magma import magma
from bench.open import open_material
from bench.provenance import provenance
from bench.rates import rate_records
from bench.records import Record
from bench.registry import load_codec
from bench.scoring import Scorer, polar_maps, score_footprints, summarise
from bench.suite import CodecSpec, MaterialSpec, Suite

COARSE = (2, 4, 8)  # footprints in texels that are scored besides the slices themselves, which are those of one
SHOWN = ((10, 40), (40, 20), (68, 30), (30, 68))  # (θ_o, θ_i) in degrees of the slices that reports show


@dataclass(frozen=True)
class Options:
    """How to run, besides what: the run's folder, the device, and what to do with what is already there."""

    folder: Path
    device: str = "cpu"
    fresh: bool = False  # fit and score everything again
    retry_failed: bool = False
    show: Progress = silent


@dataclass(frozen=True)
class Outcome:
    """One job's record, and how much of it was taken from earlier runs: "", "file" or "record"."""

    record: Record
    cached: str = ""


def seed_of(*parts: object) -> int:
    """A seed that depends on the named parts alone, 63 bits of their sha256."""
    return int.from_bytes(hashlib.sha256("\n".join(map(str, parts)).encode()).digest()[:8], "big") >> 1


def run(suite: Suite, options: Options) -> Iterator[Outcome]:
    """Run every job of a suite, yielding each as it ends. Records are on the disk before they are yielded."""
    codecs = [(spec, load_codec(spec.codec)(**spec.settings)) for spec in suite.codecs]  # bad settings stop here
    try:
        options.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{options.folder}: cannot be made ({error.strerror}): choose another --out") from error
    earlier = {}
    if (options.folder / records.FILE).exists():
        earlier = {job["job"]: job for job in records.load_run(options.folder).jobs}
    start: Record = {
        "kind": "run",
        "run": f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}",
        "suite": suite.name,
        "text": suite.text,
    }
    start |= {"device": options.device, "threads": suite.threads, "seeds": list(suite.seeds)} | provenance()
    records.append(options.folder, start)
    for spec in suite.materials:
        yield from _run_material(suite, spec, codecs, options, start["run"], earlier)


def _run_material(
    suite: Suite,
    spec: MaterialSpec,
    codecs: list[tuple[CodecSpec, Codec]],
    options: Options,
    run_id: str,
    earlier: dict[str, Record],
) -> Iterator[Outcome]:
    jobs = [(codec_spec, codec, seed) for codec_spec, codec in codecs for seed in suite.seeds]
    try:
        btf = open_material(spec, suite.data, options.show)
    except MissingDataError as error:
        for codec_spec, _, seed in jobs:
            name = f"{spec.name}/{codec_spec.label}/{seed}"
            record: Record = {
                "kind": "job",
                "job": name,
                "run": run_id,
                "material": spec.name,
                "label": codec_spec.label,
            }
            record |= {"status": "unavailable", "seed": seed, "error": str(error)}
            records.append(options.folder, record)
            yield Outcome(record)
        return
    bench = Workbench(btf, spec.name, suite.threads, options, run_id)
    done: list[Record] = []
    decoded: dict[str, Material] = {}
    for codec_spec, codec, seed in jobs:
        job = Job(bench, codec, codec_spec, seed)
        outcome = job.run(earlier.get(job.name))
        yield outcome
        if outcome.record["status"] == "ok":
            done.append(outcome.record)
            decoded[job.name] = container.load(options.folder / outcome.record["file"], options.device)[1]
    if decoded:
        _time(decoded, suite.threads, options, run_id)
    for record in rate_records(done):
        records.append(options.folder, record | {"material": spec.name, "run": run_id})


def _time(decoded: dict[str, Material], threads: int, options: Options, run_id: str) -> None:
    conditions = timing.conditions(threads, options.device)
    for name, measured in timing.compare(decoded, threads).items():
        if name != timing.FLOOR:
            samples = {"samples_ns": measured.samples.tolist(), "floor_ratios": measured.ratios.tolist()}
            record = {"kind": "timing", "job": name, "run": run_id} | conditions | measured.summary() | samples
            records.append(options.folder, record)


@dataclass
class Workbench:
    """One material of a run, and what its jobs share: split, exposure, scorer."""

    btf: BTF
    name: str
    threads: int
    options: Options
    run_id: str
    split: Split = field(init=False)

    def __post_init__(self) -> None:
        self.split = self.btf.split()
        if not len(self.split.train):
            raise InputError(f"{self.name}: no pair is left to train on")

    @cached_property
    def training(self) -> BTF:
        return self.btf.subset(self.split.train)

    @cached_property
    def scorer(self) -> Scorer:
        return Scorer(self.btf)

    @property
    def exposure(self) -> float:
        return self.scorer.exposure

    @cached_property
    def groups(self) -> dict[str, np.ndarray]:
        """Pair indices by the name under which reports show them."""
        heldout = np.sort(np.concatenate([np.empty(0, int), *self.split.heldout.values()])).astype(int)
        groups = {"all": np.arange(len(self.btf)), "train": self.split.train, "heldout": heldout}
        if len(self.split.heldout) > 1:
            groups |= {f"heldout, {name}": pairs for name, pairs in self.split.heldout.items()}
        if len(heldout):
            directions = (torch.from_numpy(w[heldout]) for w in (self.btf.wo, self.btf.wi))
            outside = PairInterpolator(self.training.layout).outside(*directions).numpy()
            groups |= {"heldout, inside hull": heldout[~outside], "heldout, outside hull": heldout[outside]}
        return {name: pairs for name, pairs in groups.items() if len(pairs)}

    @cached_property
    def shown(self) -> np.ndarray:
        """The few pairs that reports show, held-out ones where there are any."""
        pairs = self.groups.get("heldout", self.groups["all"])
        theta = np.stack([to_degrees(self.btf.wo[pairs])[0], to_degrees(self.btf.wi[pairs])[0]], 1)
        nearest = [int(np.linalg.norm(theta - wanted, axis=1).argmin()) for wanted in np.array(SHOWN)]
        return pairs[np.unique(nearest)]


@dataclass
class Job:
    """One cell of a suite: a material, a codec with its settings, a seed."""

    bench: Workbench
    codec: Codec
    spec: CodecSpec
    repetition: int

    @property
    def name(self) -> str:
        return f"{self.bench.name}/{self.spec.label}/{self.repetition}"

    @property
    def seed(self) -> int:
        return seed_of(self.bench.name, self.codec.name, self.repetition)

    @cached_property
    def fit_key(self) -> dict[str, Any]:
        return {
            "codec": self.codec.name,
            "version": self.codec.version,
            "settings": settings_dict(self.codec),
            "training": self.bench.training.fingerprint,
            "seed": self.seed,
            "device": torch.device(self.bench.options.device).type,
            "threads": self.bench.threads,
            "torch": torch.__version__,
        }

    @property
    def file(self) -> str:
        digest = hashlib.sha256(json.dumps(self.fit_key, sort_keys=True).encode()).hexdigest()
        return f"files/{re.sub('[^A-Za-z0-9.=_-]+', '-', self.name)}-{digest[:12]}{container.SUFFIX}"

    def run(self, earlier: Record | None) -> Outcome:
        """Encode, decode, score and record; or find that it is done. A failure is a record with its error."""
        options = self.bench.options
        failed_before = earlier and earlier["status"] == "failed" and earlier.get("fit_key") == self.fit_key
        if earlier and failed_before and not (options.retry_failed or options.fresh):
            return Outcome(earlier, "record")
        base: Record = {"kind": "job", "job": self.name, "run": self.bench.run_id, "material": self.bench.name}
        base |= {"codec": self.codec.name, "label": self.spec.label, "curve": self.spec.curve}
        base |= {"seed": self.repetition, "fit_key": self.fit_key}
        try:
            header, fitted = self._fit(earlier)
            score_key = self._score_key(header)
            if earlier and earlier.get("score_key") == score_key and not options.fresh:
                return Outcome(earlier, "record")
            record = base | fitted | {"status": "ok", "score_key": score_key} | self._score(header)
        except (Exception, MemoryError) as error:  # an error is data: it is recorded, shown, and decides the exit code
            record = base | {"status": "failed", "error": f"{type(error).__name__}: {error}"}
            record["traceback"] = traceback.format_exc()
            fitted = {}
        records.append(options.folder, record)
        return Outcome(record, "file" if fitted.get("fit_cached") else "")

    def _fit(self, earlier: Record | None) -> tuple[container.Header, Record]:
        """The codec file, from an earlier run where its key is the same, else encoded now."""
        options, path = self.bench.options, self.bench.options.folder / self.file
        if options.fresh:
            path.with_suffix(".state").unlink(missing_ok=True)
        if path.exists() and not options.fresh:
            known = {k: earlier[k] for k in ("fit_seconds", "history") if earlier and k in earlier}
            return container.read_header(path), known | {"fit_cached": True}
        path.parent.mkdir(exist_ok=True)
        checkpoint = path.with_suffix(".state")
        fit = Fit(torch.device(options.device), self.bench.threads, self.seed, options.show, checkpoint)
        with timing.torch_threads(self.bench.threads):
            start = time.perf_counter()
            parts = self.codec.encode(self.bench.training, fit)
            seconds = time.perf_counter() - start
        header = container.save(path, self.codec, parts)
        checkpoint.unlink(missing_ok=True)
        return header, {"fit_seconds": seconds, "fit_cached": False, "history": fit.history}

    def _score_key(self, header: container.Header) -> dict[str, Any]:
        return {
            "sha256": header.sha256,
            "btf": self.bench.btf.fingerprint,
            "exposure": self.bench.exposure,
            "metrics": {name: get_metric(name).version for name in self.bench.scorer.names},
        }

    def _score(self, header: container.Header) -> Record:
        bench, folder = self.bench, self.bench.options.folder
        _, material = container.load(header.path, bench.options.device)
        btf = bench.btf

        def decode(pair: int, factor: int = 1) -> np.ndarray:
            size = (btf.shape[0] // factor, btf.shape[1] // factor)
            return material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist(), size).numpy()

        def watched(pair: int) -> np.ndarray:
            bench.options.show(f"scoring {self.name}", pair + 1, len(btf))
            return decode(pair)

        with timing.torch_threads(bench.threads):
            scores = bench.scorer.score(bench.groups["all"], watched)
            gate = "heldout" if "heldout" in bench.groups else "all"
            footprints = score_footprints(btf, bench.groups[gate], decode, bench.exposure, COARSE)
        summary = summarise(scores, btf.wo, btf.wi, bench.groups)
        finest = summary[gate]["metrics"]["psnr_display"]
        footprints["1"] = {"psnr_display": finest["pooled"], "exact": finest["exact"], "slices": finest["slices"]}
        angular = {"bins": {name: group.pop("bins") for name, group in summary.items()}}
        angular["polar"] = polar_maps(scores, btf.wo, btf.wi)
        heldout = np.isin(scores.pairs, bench.groups.get("heldout", []))
        slices = {"pairs": scores.pairs, "heldout": heldout, "abrdf": scores.abrdf} | scores.raw
        slices |= {f"{w}_deg": np.stack(to_degrees(getattr(btf, w)[scores.pairs]), 1) for w in ("wo", "wi")}
        return {
            "shape": list(btf.shape),
            "pairs": {name: len(pairs) for name, pairs in bench.groups.items()},
            "provenance": btf.provenance,
            "settings": header.settings,
            "file": str(header.path.relative_to(folder)),
            "bytes": header.part_bytes() | {"total": header.file_bytes},
            "parameters": parameters(material),
            "cost": dataclasses.asdict(material.cost),
            "metrics": {name: self._described(name) for name in bench.scorer.names},
            "scores": summary,
            "footprints": footprints,
            "slices": self._keep(f"slices/{header.path.stem}.npz", slices),
            "angular": self._keep(f"angular/{header.path.stem}.json", angular),
            "pictures": self._keep(f"pictures/{header.path.stem}.npz", self._pictures(decode)),
        }

    @staticmethod
    def _described(name: str) -> dict[str, Any]:
        """What a table must say of a metric beside its numbers."""
        metric = get_metric(name)
        return {word: getattr(metric, word) for word in ("unit", "direction", "space", "version")}

    def _pictures(self, decode: Any) -> dict[str, np.ndarray]:
        """The shown slices, truth and decoded, display-transformed, 8 bit, and their FLIP maps in magma."""
        bench = self.bench
        truth = np.stack([bench.btf[i] for i in bench.shown])
        decoded = np.stack([decode(i) for i in bench.shown])
        eight = [np.round(to_display(x, bench.exposure) * 255).astype(np.uint8) for x in (truth, decoded)]
        angles = [np.stack(to_degrees(w[bench.shown]), 1) for w in (bench.btf.wo, bench.btf.wi)]
        pictures = {"truth": eight[0], "decoded": eight[1], "wo_deg": angles[0], "wi_deg": angles[1]}
        pictures["pairs"] = bench.shown
        flip = next((metric for name, metric in bench.scorer.metrics.items() if name.startswith("flip_ldr")), None)
        if flip and min(bench.btf.shape) >= flip.smallest:
            error = flip.error_map(flip.prepare(truth, bench.exposure), np.maximum(decoded, 0))
            pictures["flip"] = np.round(magma(error) * 255).astype(np.uint8)
        return pictures

    def _keep(self, name: str, content: dict[str, Any]) -> str:
        """Store what is too much for a record beside it, as .npz or .json; returns the name."""
        path = self.bench.options.folder / name
        path.parent.mkdir(exist_ok=True)
        if path.suffix == ".json":
            path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
        else:
            np.savez_compressed(path, **content)
        return name
