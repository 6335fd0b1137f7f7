"""Times every setting of a suite on one machine, in one run: tables then compare times of nothing else.

The time of a query depends on the settings and on what a file was found to need (`relief` needs a height on some
surfaces), not on what was fitted. So each setting is fitted for one step, on few surfaces, and all of them take turns
with the floor. Files of one setting with the same operations a query are one entry, over surfaces and rounds.
"""

import logging
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from bench import records, timing
from bench.codec import Codec, Progress, settings_dict, silent
from bench.codecs import loading
from bench.codecs.registry import make_codec
from bench.codecs.scene_material import unreported
from bench.data.open import open_material
from bench.data.spec import MaterialSpec
from bench.demand.mitsuba import load_path_tracer
from bench.inputs.errors import InputError, MissingDataError
from bench.material import Material
from bench.records import Record
from bench.records.schema import setting_name
from bench.runs import library, lock
from bench.runs.provenance import provenance
from bench.runs.suite import CodecSpec, Suite, canonical

log = logging.getLogger(__name__)

SURFACES = 2  # of the suite; the built-in ones first, which need no download
ROUNDS = 2  # the same contestants again, after everything else: what a machine does for minutes disturbs one of them
TURNS = 20  # of a contestant in a round


@dataclass
class Entry:
    """A setting, with what its files need: the ratios of all its turns, and the times of a sample in ns."""

    label: str
    flops: int  # operations of a query
    ratios: list[np.ndarray] = field(default_factory=list)  # one array a surface and round
    samples: list[np.ndarray] = field(default_factory=list)
    between: list[np.ndarray] = field(default_factory=list)  # ratios between texels, where quality is of texels

    def record(self, run: str) -> Record:
        """The record of its times, without those of single turns."""
        pooled = timing.Timing(np.concatenate(self.samples), np.concatenate(self.ratios)).summary()
        row: Record = {"kind": "timing", "job": setting_name(self.label, self.flops), "run": run, "label": self.label}
        row |= {"flops": self.flops, "rounds": [float(np.median(each)) for each in self.ratios]} | pooled
        if self.between:
            row["ratio_between_texels"] = float(np.median(np.concatenate(self.between)))
        return row


def time_settings(suite: Suite, folder: Path, device: str = "cpu", show: Progress = silent) -> list[Record]:
    """Time the settings of a suite, and write their records into a folder; returns them, the quickest first.

    Raises `InputError` if nothing can be timed. Codecs that cannot be fitted here are left out, with a warning.
    """
    suite = canonical(suite)
    run = f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}"
    entries: dict[tuple[str, int], Entry] = {}
    with lock.locked(folder, run), tempfile.TemporaryDirectory(prefix="neubtf-times-") as scratch:
        contestants = dict(_contestants(suite, Path(scratch), device, show))
        if not contestants:
            raise InputError(f"suite {suite.name}: none of its settings could be fitted, so none is timed")
        for _ in range(ROUNDS):
            _round(contestants, entries, suite.threads, show)
        start: Record = {"kind": "run", "run": run, "suite": suite.name, "text": suite.text, "device": device}
        start |= {"threads": suite.threads, "seeds": [], "jobs": [], "materials": []}
        records.append(folder, start | provenance())
        conditions = timing.conditions(suite.threads, device)
        found = [entry.record(run) | conditions for entry in entries.values()]
        for record in found:
            records.append(folder, record)
    return sorted(found, key=lambda record: float(record["ratio_to_floor"]))


Contestant = tuple[tuple[str, str], Material]  # surface and label of a setting, and what its file decodes to


def _contestants(suite: Suite, scratch: Path, device: str, show: Progress) -> Iterator[Contestant]:
    """Each setting on each surface, decoded from a file of one step."""
    for surface in _surfaces(suite):
        try:
            btf = open_material(surface, suite.data, show, path_tracer=load_path_tracer)
        except MissingDataError as error:
            log.warning("%s: not timed on it: %s", surface.name, error)
            continue
        specs = [spec for spec in suite.codecs if not spec.materials or surface.name in spec.materials]
        for count, spec in enumerate(specs):
            show(f"{surface.name}: fits of one step", count, len(specs))
            try:
                header = library.encode(btf, _short(spec), scratch / f"{count}.nbtf", threads=suite.threads)
            except InputError as error:
                log.warning("%s: not timed: %s", spec.label, error)
                continue
            material = unreported(loading.load(header.path, device).material)
            if not material.opaque:
                yield (surface.name, spec.label), material


def _surfaces(suite: Suite) -> list[MaterialSpec]:
    built_in = [material for material in suite.materials if not material.path]
    others = [material for material in suite.materials if material.path]
    return [*built_in, *others][:SURFACES]


def _short(spec: CodecSpec) -> Codec:
    """The codec of a setting, with one step if it takes any."""
    codec = make_codec(spec.codec, spec.settings)
    return make_codec(spec.codec, spec.settings | {"steps": 1}) if "steps" in settings_dict(codec) else codec


def _round(
    contestants: dict[tuple[str, str], Material], entries: dict[tuple[str, int], Entry], threads: int, show: Progress
) -> None:
    """Time all contestants in turns, and add what was measured to their entries.

    The quality of a codec that answers texels is that of texels: where a query between them takes longer, the time at
    one texel is the entry's.
    """
    timed: dict[str, Material] = {}
    for (surface, label), material in contestants.items():
        timed[f"{surface}/{label}"] = material
        if one := material.at_one_texel():
            timed[f"{surface}/{label} at one texel"] = one
    found = timing.time_materials(timed, threads, show=show, turns=TURNS)
    for (surface, label), material in contestants.items():
        flops = material.cost.flops_per_sample
        entry = entries.setdefault((label, flops), Entry(label, flops))
        whole, at_one = found[f"{surface}/{label}"], found.get(f"{surface}/{label} at one texel")
        decides = at_one or whole
        entry.ratios.append(decides.ratios)
        entry.samples.append(decides.samples)
        if at_one:
            entry.between.append(whole.ratios)
