"""Times every setting of a suite on one machine, in one run: tables then compare times of nothing else.

A setting is a codec with the values of its settings, such as `pca components=4`. The time of a query depends on the
settings and on what a file was found to need (`relief` needs a height on some surfaces), not on what was fitted. So
each setting is fitted for one step, on few surfaces, and all of them take turns with the floor. Files of one setting
with the same operations a query are one entry, over surfaces and rounds.
"""

import dataclasses
import hashlib
import json
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench import records, timing
from bench.btf import BTF
from bench.codec import Codec, Progress, followed, settings_dict, silent
from bench.codecs import container, loading
from bench.codecs.registry import make_codec
from bench.codecs.scene_material import without_warnings
from bench.data.open import open_material
from bench.data.spec import MaterialSpec
from bench.demand.mitsuba import load_path_tracer
from bench.inputs.errors import InputError
from bench.machine.devices import is_gpu
from bench.material import Material
from bench.records.schema import setting_name
from bench.runs import library, lock
from bench.runs.provenance import new_run, start_of
from bench.runs.runner import time_decoders
from bench.runs.suite import CodecSpec, Suite, canonical

log = logging.getLogger(__name__)

SURFACES = 2  # of the suite; the built-in ones first, which need no download
ROUNDS = 2  # so that what disturbs the machine for minutes disturbs one round alone
TURNS = 20  # of a contestant in a round


@dataclass
class Entry:
    """A setting, with what its files need: the ratios of all its turns to the floor, and the times of a sample in ns.

    A codec that answers at texels is scored and timed there. A query between texels blends several, and takes longer:
    its ratios stand beside.
    """

    label: str
    flops: int  # operations of a query
    ratios: list[np.ndarray] = field(default_factory=list)  # one array a surface and round
    samples: list[np.ndarray] = field(default_factory=list)
    between: list[np.ndarray] = field(default_factory=list)  # ratios between texels; empty for most codecs

    def record(self, run: str) -> records.Timing:
        """The record of its times in a run, given by its name; without the times of single turns, which are many."""
        pooled = timing.Timing(np.concatenate(self.samples), np.concatenate(self.ratios)).summary()
        row: records.Timing = {
            "kind": "timing",
            "job": setting_name(self.label, self.flops),
            "run": run,
            "label": self.label,
            "flops": self.flops,
            "rounds": [float(np.median(each)) for each in self.ratios],
        }
        row |= pooled
        if self.between:
            row["ratio_between_texels"] = float(np.median(np.concatenate(self.between)))
        return row


class Contestant(NamedTuple):
    """A setting on a surface, and what its file decodes to."""

    surface: str
    spec: CodecSpec
    material: Material


def time_settings(suite: Suite, folder: Path, device: str = "cpu", show: Progress = silent) -> list[records.Timing]:
    """Time the settings of a suite on its first surfaces, and write their records into a folder; returns them, the
    quickest first.

    Files of one step lie in the folder, and are made only once. Raises `InputError` if nothing can be timed, if
    another run uses the folder, or if it cannot be written. Codecs that cannot be fitted here are left out, with a
    warning.
    """
    suite = canonical(suite)
    run = new_run()
    entries: dict[tuple[str, int], Entry] = {}
    with lock.locked(folder, run):
        contestants = list(decoded_settings(suite, surfaces_of(suite), folder, device, show))
        if not contestants:
            remedy = "name surfaces that are here, and codecs that can be fitted and are no programs of their own"
            raise InputError(f"suite {suite.name}: none of its settings can be timed: {remedy}")
        for _ in range(ROUNDS):
            _add_round(contestants, entries, suite.threads, show)
        records.append(folder, start_of(suite, run, device, jobs=[]))
        conditions = timing.conditions(suite.threads, device)
        rows = [entry.record(run) | conditions for entry in entries.values()]
        for row in rows:
            if is_gpu(device):  # tables of budgets look for the processor's time, which this one does not replace
                row["job"] = f"{row['job']}/{device}"
            records.append(folder, row)
    return sorted(rows, key=lambda row: float(row["ratio_to_floor"]))


def decoded_settings(
    suite: Suite, surfaces: Sequence[MaterialSpec], folder: Path, device: str, show: Progress
) -> Iterator[Contestant]:
    """What the file of each setting of a suite decodes to on some surfaces, one by one.

    Fits and writes the files that are missing in `folder`. What cannot be fitted here is left out, with a warning. Also
    left out, without one, are codecs whose answers come from another program: their time cannot be measured.
    """
    for surface in surfaces:
        btf: BTF | None = None
        specs = [spec for spec in suite.codecs if not spec.materials or surface.name in spec.materials]
        for spec in followed(show, specs, f"{surface.name}: fits of one step", len(specs)):
            try:
                codec = one_step_codec(spec)
                path = folder / "files" / _file_name(suite, surface, codec)
                if not path.exists():
                    if btf is None:  # opened once a surface, and only if a file is missing
                        btf = open_material(surface, suite.data, show, path_tracer=load_path_tracer)
                    library.encode(btf, codec, path, threads=suite.threads)
                material = without_warnings(loading.load(path, device).material)
            except InputError as error:
                log.warning("%s on %s: not timed: %s", spec.label, surface.name, error)
                continue
            if not material.opaque:  # no other program answers
                yield Contestant(surface.name, spec, material)


def _file_name(suite: Suite, surface: MaterialSpec, codec: Codec) -> str:
    """The name of a setting's file; another codec version, setting or preparation has another."""
    settings = settings_dict(codec)
    # What the bytes of the file depend on.
    determining = [surface.name, codec.name, codec.version_of(settings), settings, dataclasses.asdict(suite.data)]
    digest = hashlib.sha256(json.dumps(determining, sort_keys=True).encode()).hexdigest()
    return f"{surface.name}-{codec.name}-{digest[:12]}{container.SUFFIX}"


def surfaces_of(suite: Suite) -> list[MaterialSpec]:
    """The surfaces that settings are timed on: the first `SURFACES` of a suite, the built-in ones before others."""
    built_in = [material for material in suite.materials if not material.path]
    others = [material for material in suite.materials if material.path]
    return [*built_in, *others][:SURFACES]


def one_step_codec(spec: CodecSpec) -> Codec:
    """The codec of a setting; with a single step if it is fitted in steps."""
    codec = make_codec(spec.codec, spec.settings)
    if "steps" not in settings_dict(codec):
        return codec
    return make_codec(spec.codec, spec.settings | {"steps": 1})


def _add_round(
    contestants: list[Contestant], entries: dict[tuple[str, int], Entry], threads: int, show: Progress
) -> None:
    """Time all contestants in turns, and add what was measured to their entries, which are by label and operations."""
    named = {f"{surface}/{spec.label}": material for surface, spec, material in contestants}
    all_times = time_decoders(named, threads, show, TURNS).values()
    for (_, spec, material), (anywhere, at_one_texel) in zip(contestants, all_times, strict=True):
        flops = material.cost.flops_per_sample
        entry = entries.setdefault((spec.label, flops), Entry(spec.label, flops))
        where_scored = anywhere
        if at_one_texel is not None:
            where_scored = at_one_texel
            entry.between.append(anywhere.ratios)
        entry.ratios.append(where_scored.ratios)
        entry.samples.append(where_scored.samples)
