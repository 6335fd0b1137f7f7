"""Functions for scripts, most of them in `bench`: open a BTF, encode it, load the file, score it; see docs/api.md.

The commands of `neubtf-bench` call the same code, so that a script measures the same as a run.
"""

import dataclasses
import json
import logging
import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bench.btf import BTF
from bench.codec import Codec, Fit, Progress, SharedNetwork, silent
from bench.codecs import container, loading, shared
from bench.codecs.encoding import fit_to_file, naming_faults, new_fit
from bench.codecs.registry import make_codec
from bench.codecs.slices_material import SlicesMaterial
from bench.compare.frame import load_runs
from bench.data.materials.variations import load_variation
from bench.data.open import open_named
from bench.data.readers import open_btf
from bench.data.readers.checks import negative_fault, refuse_extremes, some_slices
from bench.demand import UNIFORM, fitting
from bench.demand.demand import Demand
from bench.demand.demand import load as load_demand
from bench.demand.frame_scorer import PSNR, FrameScorer, table_of
from bench.files import atomic
from bench.inputs.errors import InputError
from bench.machine.devices import require_present
from bench.machine.threads import torch_threads
from bench.material import Material
from bench.records import ARTEFACT, Bytes, Job, SceneModel, counted, field_names
from bench.runs import executors, runner
from bench.runs.evaluation import conditions, evaluate, record_of_scores, score_key
from bench.runs.suite import load_suite, parse_suite, require_materials, with_changes
from bench.runs.workbench import Workbench

if TYPE_CHECKING:
    import pandas as pd

log = logging.getLogger(__name__)
MATERIALS = 224  # the default number of variations, which are random materials, that a shared network is trained on
ALIASED_DB = 1.0  # frames that are less than this below those of the BTF asked at points are limited by aliasing
UNSEEN = range(100_000, 100_016)  # variations for its curve, kept out of training


def open(name: str | Path, **data: Any) -> BTF:
    """Open the BTF of a built-in material (`neubtf-bench list materials`) or of a path.

    `data` are the `[data]` settings of a suite (`bench.runs.suite`). `InputError` says what cannot be opened, and why.
    """
    if not isinstance(name, str | os.PathLike):
        raise InputError(
            f"bench.open: give the name of a material or a path, not a {type(name).__name__}: "
            "arrays become a BTF by bench.from_arrays(radiance, wo, wi)"
        )
    return open_named(str(name), {f"data.{key}": value for key, value in data.items()}, words=False)


def encode(
    btf: BTF,
    codec: str | Codec,
    out: str | Path,
    *,
    seed: int = 0,
    threads: int = 1,
    device: str = "cpu",
    demand: str | Path | None = None,
    show: Progress = silent,
    **settings: Any,
) -> container.Header:
    """Fit a codec to the training pairs of a BTF and write its file; returns the header of the file.

    `codec` is a name, with its `settings`, or a codec. `seed` is the repetition, as in the `seeds` of a suite: with the
    same data and name of the material a run writes the same file. With `scene=True` among the settings, the fit is to
    the scene of `demand`, a demand file. The fit calls `show(label, done, total)` as it progresses. `InputError` says
    what cannot be used, and why; `EncodeError`, which is one, that the codec failed.
    """
    if not isinstance(btf, BTF):
        raise InputError(f"bench.encode: give a BTF, not {_wrong_type(btf)}: bench.open(name) opens one")
    require_present(device, "device")
    instance = _instance(codec, settings)
    scene_demand = _load_demand_if_given(demand)
    if scene_demand is not None and not instance.scene:
        raise InputError("encode: a demand is for a fit to its scene: give scene=True, too, or leave out demand")
    encode_parts = fitting.encode_of(instance, scene_demand)  # fits to the scene where there is one
    network = shared.find_for(instance)
    train = _checked_training(btf)
    container.refuse_other_file(Path(out))
    fit = new_fit(instance, train, seed, network, device=device, threads=threads, show=show)
    return fit_to_file(instance, train, fit, Path(out), naming_faults(instance, encode_parts)).header


def _instance(codec: str | Codec, settings: dict[str, Any]) -> Codec:
    """The codec of that name with its settings, or the codec itself, which has them: `InputError` if any are given."""
    if not isinstance(codec, Codec):
        return make_codec(codec, settings)
    if settings:
        raise InputError(f"encode: codec {codec.name} already has its settings: give {min(settings)} when you make it")
    return codec


def _checked_training(btf: BTF) -> BTF:
    """The training pairs of a BTF; warns of negative radiance. `InputError` if their values are too extreme."""
    train = btf.subset(btf.split().train)
    refuse_extremes(train)
    warning = negative_fault(np.stack(list(some_slices(train))))  # in words; "" if there is none
    if warning:
        log.warning("%s: %s", btf.name, warning)
    return train


def run(
    suite: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    materials: Sequence[str] = (),
    codecs: Sequence[str] = (),
    jobs: int = 1,
    device: str = "cpu",
    show: Progress = silent,
) -> "pd.DataFrame":
    """Run a suite into the folder `out`, as `neubtf-bench run` does; returns `load_runs(out)`, a row a job.

    `suite` is the name of a built-in suite, a TOML file, or a dictionary with the keys of one. `materials` take the
    place of its own, `codecs` chooses among its codecs. More than one job at once runs in processes of their own. What
    was measured before is not measured again; a failed job is a row with its `error`. `InputError` if the suite, a
    material or the folder cannot be used.
    """
    require_present(device, "device")
    whole = parse_suite("script", _as_toml(suite)) if isinstance(suite, Mapping) else load_suite(str(suite))
    chosen = with_changes(whole, list(materials), list(codecs), changes={})
    require_materials(chosen, "materials")
    workers = None if jobs == 1 else partial(executors.processes, jobs, chosen.threads, device)
    for _ in runner.run(chosen, runner.Options(Path(out), device, show=show, workers=workers)):
        pass
    return load_runs(out)


def _as_toml(suite: Mapping[str, Any]) -> str:
    """The text of a suite that is given as a dictionary: records keep it, so that the run can be made again."""
    return "".join(f"{key} = {_toml_value(value)}\n" for key, value in suite.items())


def _toml_value(value: Any) -> str:
    """A value as TOML writes it; a dictionary is an inline table."""
    if isinstance(value, Mapping):
        entries = [f"{json.dumps(key)} = {_toml_value(each)}" for key, each in value.items()]
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, os.PathLike):
        return _toml_value(os.fspath(value))
    if not isinstance(value, str | bool | int | float):
        fault = f"a suite holds numbers, texts, lists and dictionaries, not {_wrong_type(value)}"
        remedy = "name a material of yours by its path" if isinstance(value, BTF) else "give one of these"
        raise InputError(f"bench.run: {fault}: {remedy}")
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # inf or nan, which JSON lacks: who reads the suite says which key refuses it
    # TOML writes these as JSON does, but knows no pair of escapes for one character, as JSON has for an emoji.
    return json.dumps(value, ensure_ascii=False)


def _load_demand_if_given(file: str | Path | None) -> Demand | None:
    """The demand that a file holds; None without a file."""
    return load_demand(Path(file)) if file else None


@dataclass(frozen=True)
class SceneGoal:
    """A scene, by its demand or its file, and what its frames must reach: by default 0.2 dB below the full model."""

    demand: str | Path | Demand
    psnr: float | None = None  # dB, at least
    flip: float | None = None  # at most
    uniform: float = UNIFORM  # the share of samples that are spread evenly


@dataclass(frozen=True)
class SceneFit:
    """What a fit to a scene found: the models, and a row of named numbers of each."""

    search: fitting.SearchResult
    rows: list[SceneModel]
    at_points: float  # PSNR in dB of the frames of the BTF itself, asked at points
    filters: bool  # whether the codec has a level of detail: its answers depend on the footprint

    def described(self) -> str:
        """The verdict in one line, such as "The scene model takes 60% of the bytes: …"."""
        search = self.search
        if not search.met:
            kind = "full" if search.scene is None else "scene"
            verdict = f"The target is not reached; this is the {kind} model"
        elif search.scene is None:
            verdict = f"This is the full model: {search.why}"
        else:
            share = search.scene.header.file_bytes / search.full.header.file_bytes
            verdict = f"The scene model takes {share:.0%} of the bytes: {search.why}"
        effort = f"{search.fits} fits to the scene took {search.seconds:.1f} s of processor time."
        return f"{verdict}. {effort}{self._note_on_aliasing()}"

    def _note_on_aliasing(self) -> str:
        """A sentence where a missing level of detail limits the frames, not the bytes; else ""."""
        frames = self.search.chosen.psnr
        if self.filters or frames < self.at_points - ALIASED_DB:
            return ""
        return (
            f" The codec has no level of detail, which limits it here: without one the uncompressed BTF has "
            f"{self.at_points:.2f} dB in these frames. More bytes do not help, a codec that filters does."
        )


def encode_for_scene(
    btf: BTF,
    codec: str | Codec,
    out: str | Path,
    scene: SceneGoal,
    *,
    seed: int = 0,
    threads: int = 1,
    device: str = "cpu",
    show: Progress = silent,
    **settings: Any,
) -> SceneFit:
    """Write the smallest file whose frames of a scene reach a goal; the full model's if none is smaller.

    The full model is fitted first; the rest as in `encode`. `InputError` says what is wrong with the demand or the
    codec.
    """
    if not isinstance(btf, BTF):
        raise InputError(f"bench.encode_for_scene: give a BTF, not {_wrong_type(btf)}: bench.open(name) opens one")
    if not isinstance(scene, SceneGoal):
        raise InputError(f"bench.encode_for_scene: give a bench.SceneGoal(demand), not {_wrong_type(scene)}")
    require_present(device, "device")
    instance = _instance(codec, settings)
    demand = scene.demand if isinstance(scene.demand, Demand) else load_demand(Path(scene.demand))
    wanted = fitting.Goal(scene.psnr, scene.flip)
    container.refuse_other_file(Path(out))
    well_lit = btf.without_low_light()
    network = shared.find_for(instance)
    shared.refuse_training_material(network, well_lit)  # `new_fit` would refuse it only once the frames are rendered
    scorer = FrameScorer(table_of(well_lit), demand, show)
    # The search calls this for each of its fits.
    fit = partial(new_fit, instance, well_lit, seed, network, device=device, threads=threads, show=show)
    training = well_lit.split().train  # indices of pairs
    held_out = well_lit.subset(np.setdiff1d(np.arange(len(well_lit)), training))
    with tempfile.TemporaryDirectory() as folder, torch_threads(threads):
        search = fitting.Search(instance, _checked_training(well_lit), scorer, fit, Path(folder), scene.uniform)
        # Without figures of its own, the goal is relative to the full model, which the search fits first.
        result = search.run(None if wanted == fitting.Goal() else wanted)
        rows = fitting.rows(result, scorer, threads, held_out)
        at_points = counted(scorer.compare(scorer.at_points, (PSNR,))[PSNR])
        filters = scorer.filters(result.chosen.material)
        atomic.write(Path(out), result.chosen.header.path.read_bytes())
    return SceneFit(result, rows, at_points, filters)


def load(file: str | Path, device: str = "cpu") -> Material:
    """The material that a codec file holds. `ContainerError` says what is wrong with the file."""
    require_present(device, "device")
    return loading.load(Path(file), device).material


def score(
    decoded: str | Path | Material | BTF,
    btf: BTF,
    *,
    demand: str | Path | None = None,
    threads: int = 1,
    device: str = "cpu",
    show: Progress = silent,
) -> Job:
    """Score a decoded material against its BTF, as a run does; returns the numbers of a job's record.

    `decoded` is a codec file; or slices at the pairs of the BTF, as a folder with `pairs.csv` or as a BTF; or a
    material. Slices and materials have no file, so no bytes are counted. With `demand`, a demand file, the scores
    include those in its scene. Raises `ContainerError` for a bad file; `InputError` if the BTF has another resolution,
    for slices with a demand, and for what is none of these.
    """
    if not isinstance(btf, BTF):
        raise InputError(f"bench.score: the truth must be a BTF, not {_wrong_type(btf)}: bench.open(name) opens one")
    if not isinstance(decoded, str | os.PathLike | Material | BTF):
        given = f"not {_wrong_type(decoded)}: arrays become a BTF by bench.from_arrays(radiance, wo, wi)"
        raise InputError(f"bench.score: give a codec file, a folder, a material or a BTF, {given}")
    require_present(device, "device")
    workbench = Workbench(btf, btf.name, demand=_load_demand_if_given(demand))
    if isinstance(decoded, str | os.PathLike) and not Path(decoded).is_dir():
        loaded = loading.load(Path(decoded), device)
        require_same_size(str(decoded), loaded.material.size, btf)
        figures: Job = {"codec": loaded.header.codec, "score_key": score_key(workbench, loaded.header)}
        figures |= evaluate(workbench, loaded, threads, _store_nothing, show)
    else:
        name, material = _name_and_material(decoded, btf)
        if demand and isinstance(material, SlicesMaterial):
            raise InputError(f"{name}: slices cannot be scored in a scene, which needs more pairs: leave out demand")
        figures = {"codec": name, "settings": {}, "bytes": cast(Bytes, {}), "score_key": conditions(workbench)}
        figures |= record_of_scores(workbench, material, name, threads, _store_nothing, show)
    names_of_files = field_names(ARTEFACT)  # fields that name files, which a run stores and `score` does not
    return cast(Job, {name: value for name, value in figures.items() if name not in names_of_files})


def _store_nothing(name: str, content: dict[str, Any]) -> str:
    """In place of what stores large content: `score` writes no files."""
    return name


def _wrong_type(value: object) -> str:
    """A value of a wrong type in words, for a message: a text itself, of any other value the type."""
    if isinstance(value, str):
        return repr(value)
    return f"an object of type {type(value).__name__}"


def _name_and_material(decoded: str | Path | Material | BTF, btf: BTF) -> tuple[str, Material]:
    """The name and the material of what has no codec file: a material, or slices as a BTF or in a folder."""
    if isinstance(decoded, Material):
        name = type(decoded).__name__
        require_same_size(name, decoded.size, btf)
        return name, decoded
    slices = decoded
    if not isinstance(slices, BTF):
        slices = open_btf(slices)
        slices.name = str(decoded)  # a folder of decoded slices states the name of the BTF
    require_same_size(slices.name, slices.shape, btf)
    return slices.name, SlicesMaterial(slices, btf)


def require_same_size(name: str, size: tuple[int, int], btf: BTF) -> None:
    """Raise `InputError` unless what was decoded has the texels of the BTF."""
    if size != btf.shape:
        decoded = " × ".join(map(str, size))
        wanted = " × ".join(map(str, btf.shape))
        raise InputError(
            f"{name}: it decodes to {decoded} texels, but {btf.name} has {wanted}: open the BTF as it was encoded, "
            f"such as with --set data.size={max(size)}, or of measured data --set data.texels={min(size)}"
        )


def pretrain(
    network: SharedNetwork, fit: Fit, path: Path, materials: int = MATERIALS, added: Sequence[BTF] = ()
) -> container.Header:
    """Train a network on the first `materials` variations and on the BTFs in `added`, and write its file to `path`.

    A network is what a codec shares over materials; a variation is a random material, rendered here. Appends to
    `fit.history` the curve of training: the PSNR on the variations `UNSEEN`. The default needs no data, so everybody
    can make the same file. `InputError` if there is no material to train on, and for a negative number of variations.
    """
    if materials < 0 or materials + len(added) < 1:
        given = f"{materials} variations and {len(added)} BTFs"
        raise InputError(f"{given}: a network needs at least one training material, and no number below 0")
    numbers = fit.progress([*range(materials), *UNSEEN], "rendering materials to train on")
    btfs = [load_variation(number) for number in numbers]  # those to train on, then the unseen ones
    with torch_threads(fit.threads):
        fit_with_curve = dataclasses.replace(fit, unseen=btfs[materials:])
        return shared.make(network, [*btfs[:materials], *added], fit_with_curve, path)
