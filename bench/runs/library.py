"""Functions for scripts, available from `bench`: open a BTF, encode it, load the file, score it; see docs/api.md.

The commands of `neubtf-bench` call the same code, so that a script measures the same as a run.
"""

from pathlib import Path
from typing import Any

import torch

from bench.btf import BTF
from bench.codec import Codec, Fit, Progress, silent
from bench.codecs import container, loading, shared
from bench.codecs.registry import load_codec
from bench.data.open import open_named
from bench.demand import fitting, require_demand
from bench.demand.demand import load as load_demand
from bench.errors import InputError
from bench.material import Material
from bench.records import ARTEFACT, Record, field_names
from bench.runs.evaluation import evaluate, score_key
from bench.runs.workbench import Workbench


def open(name: str | Path, **data: Any) -> BTF:
    """Open the BTF of a built-in material (`neubtf-bench list materials`) or of a path.

    `data` are the `[data]` settings of a suite. Rendered materials have `size`, `views`, `lights`, `heldout` and
    `directions`; measured ones have `pairs` and `repair`. `split` chooses the held-out pairs: "test" for reported
    figures, "validation" for choosing settings. `InputError` says what cannot be opened, and why.
    """
    changes = {
        f"data.{key}": str(value).lower() if isinstance(value, bool) else str(value) for key, value in data.items()
    }
    return open_named(str(name), changes)


def encode(
    btf: BTF,
    codec: str | Codec,
    out: str | Path,
    *,
    seed: int = 0,
    threads: int = 1,
    device: str = "cpu",
    show: Progress = silent,
    **settings: Any,
) -> container.Header:
    """Fit a codec to the training pairs of a BTF and write its file; returns the header of the file.

    `codec` is a name, with its `settings`, or a codec. The fit calls `show(label, done, total)` as it progresses.
    """
    if isinstance(codec, Codec) and settings:
        raise InputError(f"encode: codec {codec.name} has its settings already: give {min(settings)} where it is made")
    instance = codec if isinstance(codec, Codec) else load_codec(codec)(**settings)
    require_demand(instance, None)
    fit = Fit(torch.device(device), threads, seed, show, network=shared.find_for(instance))
    return container.save(Path(out), instance, fitting.encode(instance, btf.subset(btf.split().train), fit))


def load(file: str | Path, device: str = "cpu") -> Material:
    """The material that a codec file holds. `ContainerError` says what is wrong with the file."""
    return loading.load(Path(file), device).material


def score(
    file: str | Path,
    btf: BTF,
    *,
    demand: str | Path | None = None,
    threads: int = 1,
    device: str = "cpu",
    show: Progress = silent,
) -> Record:
    """Decode a codec file and score it against its BTF, as a run does; returns the numbers of a job's record.

    `scores` holds every metric over groups of pairs (`heldout`, `train`, `all`, …), `footprints` the PSNR at footprints
    of several texels; `bytes`, `parameters` and `cost` are those of the file. `demand` is the demand file of a scene to
    judge by as well. Raises `ContainerError` for a bad file, `InputError` if the BTF has another resolution.
    """
    loaded = loading.load(Path(file), device)
    if loaded.material.size != btf.shape:
        decoded, wanted = (" × ".join(map(str, sides)) for sides in (loaded.material.size, btf.shape))
        raise InputError(
            f"{file}: decodes to {decoded} texels, and {btf.name} has {wanted}: open the BTF as it was encoded"
        )
    bench = Workbench(btf, btf.name, demand=load_demand(Path(demand)) if demand else None)
    figures = evaluate(bench, loaded, threads, lambda name, content: name, show)
    for name in field_names(ARTEFACT):  # a run keeps these files, `score` does not
        figures.pop(name, None)
    return {"codec": loaded.header.codec, "score_key": score_key(bench, loaded.header)} | figures
