"""Tries settings of every learned codec to choose its defaults, with the same budget of trials for each.

    python tools/sweep.py OUT.jsonl [--codecs NAME ...] [--surfaces NAME ...] [--steps 2500] [--seeds 0 ...] [--size 64]
    python tools/sweep.py OUT.jsonl --table

The first trial of a codec is its default, each other one changes one thing. A trial is the fit of one surface, on one
thread; its score is the mean over validation pairs of the display PSNR of what was decoded from the written file. OUT
keeps a line a trial: what is there is not fitted again. `--table` prints, as Markdown, what each change gains over the
default.
"""

import argparse
import itertools
import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import bench
from bench.btf import BTF
from bench.codec import silent
from bench.codecs.registry import load_codec, make_codec
from bench.data.open import open_material
from bench.data.spec import Preparation
from bench.inputs.errors import EncodeError, InputError
from bench.metrics.psnr import DisplayPSNR
from bench.metrics.scoring import Scorer
from bench.runs.suite import load_suite, with_changes
from bench.training.stored_texture import VERSION as STORE_VERSION

SURFACES = ("satin", "cable-knit", "corduroy")
APART = {"impalla", "bricks", "hammered-copper", "wicker", "leather", "pavingstones", "metal"}  # docs/materials.md
SCORED = 300  # the most validation pairs of a measured surface, which has thousands
GRIDS: dict[str, Any] = {"half": 4, "quarter": 8}  # with about half of the channels at full resolution
# What a codec differs in from others, besides the trials that all have: its base, then two changes of its own.
BASE: dict[str, dict[str, Any]] = {"neuralbtf": {"width": 32}}  # at its default, 512, weights outweigh a texture
OWN: dict[str, list[dict[str, Any]]] = {
    "relief": [{"half": 2, "quarter": 16}, {"offset": 16}],
    "neubtf-direct": [{"latents": 7} | GRIDS, {"offset": 32}],
    "neubtf": [{"encoder_rate": 1e-3}, {"encoder_rate": 4e-3}],
    "neumip": [{"offset": False}, {"weights_start": "pytorch"}],
    "hierarchical": [{"offset": False}, {"patch": 4}],
    "neuralbtf": [{"levels": 2}, {"reduction": 8}],
    "rainer2019": [{"latents": 4} | GRIDS, {"offset": 32}],
    "zeltner2024": [{"latents": 4} | GRIDS, {"offset": 32}],
    "ntc": [{"rounding": "noise"}, {"reduction": 2}],
    "bcf": [{"textures": 4, "half": 8, "quarter": 8}, {"offset": 32}],
    "triple-plane": [{"channels": 4} | GRIDS, {"offset": 32}],
}
START = {"neubtf": "encoder", "rainer2019": "encoder"}  # of others, whose start is mixed: components
LOSSES = {"relief": ("l1", "both"), "neubtf": ("l1", "l2")}  # beside the default


def trials(codec: str) -> list[dict[str, Any]]:
    """The settings of a codec's trials as changes of its base, the base itself first."""
    default = vars(make_codec(codec, BASE.get(codec, {})).settings)
    adam = default["optimiser"] == "adam"
    batch = "batch" if "batch" in default else "texels"  # `rainer2019` draws texels × pairs
    hidden = "latent_rate" if adam else "hidden_rate"  # Adam has no rate of hidden matrices
    changes: list[dict[str, Any]] = [{}, {"optimiser": "muon" if adam else "adam"}]
    changes += [{"rate": default["rate"] * factor} for factor in (0.5, 2)]
    changes.append({hidden: default[hidden] / 2})
    changes += [{batch: int(default[batch] * factor)} for factor in (0.5, 2)]
    changes.append({"start": START.get(codec, "components")})
    changes += [{"loss": loss} for loss in LOSSES.get(codec, ("l1", "display"))]
    changes.append({"weights": "half" if default["weights"] == "int8" else "int8"})
    return changes + OWN[codec]


def opened(surface: str, size: int) -> BTF:
    """A surface with validation pairs held out. `InputError` for one that is kept apart: nothing is chosen on it."""
    if Path(surface).name in APART:
        raise InputError(f"{surface} is kept apart: choose settings on another surface")
    suite = with_changes(load_suite("budgets"), [surface], codecs=[], changes={})
    return open_material(suite.materials[0], Preparation(size=size, texels=size, split="validation"), silent)


def score(file: Path, btf: BTF) -> float:
    """The mean over held-out pairs of the display PSNR of a file, in dB; each pair counts at most 48.13 dB."""
    material = bench.load(file)
    pairs = np.concatenate([*btf.split().heldout.values()])
    pairs = np.sort(np.random.default_rng(0).permutation(pairs)[:SCORED])
    metric = "psnr_display"
    scorer = Scorer(btf, [metric], threads=1)
    scores = scorer.score(pairs, lambda i: material.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy())
    return float(DisplayPSNR().values(scores.raw[metric]).mean())


def key(row: dict[str, Any]) -> str:
    """What tells a trial from others, as text."""
    of_fit = {name: row[name] for name in ("codec", "version", "change", "surface", "seed", "steps", "size")}
    return json.dumps(of_fit | {"store": row.get("store", 4)})  # the first trials, of version 4, do not name it


def tried(row: dict[str, Any], btf: BTF) -> dict[str, Any]:
    """The row of a trial with its score in dB and the bytes of its file; with an error if the fit failed."""
    settings = BASE.get(row["codec"], {}) | row["change"] | {"steps": row["steps"]}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "trial.nbtf"
        try:
            header = bench.encode(btf, row["codec"], file, seed=row["seed"], **settings)
        except EncodeError as error:  # such as a fit that diverged
            return row | {"error": str(error)}
        return row | {"psnr": round(score(file, btf), 4), "bytes": header.file_bytes}


def read(out: Path) -> list[dict[str, Any]]:
    """The rows of earlier trials; a last line that a killed process left unfinished does not count."""
    text = out.read_text(encoding="utf-8") if out.exists() else ""
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


def words(change: dict[str, Any]) -> str:
    """A change as on a command line, `KEY=VALUE …`; `default` if nothing is changed."""
    assigned = []
    for name, value in change.items():
        text = value if isinstance(value, str) else json.dumps(value)  # JSON for `true` and `false`
        assigned.append(f"{name}={text}")
    return " ".join(assigned) or "default"


def run(options: argparse.Namespace) -> None:
    """Make the trials that are not in the file yet, one after the other."""
    rows = read(options.out)
    options.out.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")  # without half a line
    done = {key(row) for row in rows}
    for surface in options.surfaces:
        btf = opened(surface, options.size)
        for codec in options.codecs:
            row = {"codec": codec, "version": load_codec(codec).version, "store": STORE_VERSION, "surface": surface}
            row |= {"steps": options.steps, "size": options.size}
            for seed, change in itertools.product(options.seeds, trials(codec)):
                trial = row | {"seed": seed, "change": change}
                if key(trial) in done:
                    continue
                trial = tried(trial, btf)
                add(trial, options.out)
                result = trial.get("error") or f"{trial['psnr']:.2f} dB, {trial['bytes']:,} bytes"
                print(f"{surface}, {codec} {words(change)}, seed {seed}: {result}", flush=True)


def add(trial: dict[str, Any], out: Path) -> None:
    """Add the row of a trial to the file, at once on the disk, so that a fit is not lost."""
    with out.open("a", encoding="utf-8") as file:
        file.write(json.dumps(trial) + "\n")
        file.flush()
        os.fsync(file.fileno())


def table(rows: list[dict[str, Any]]) -> str:
    """What each change gains over the default of the same surface, seed, size and steps, as Markdown."""
    scored = {key(row): row for row in rows if "error" not in row}
    gains = []
    for row in scored.values():
        default = scored.get(key(row | {"change": {}}))
        if default:
            gain = {"dB": row["psnr"] - default["psnr"], "log": math.log(row["bytes"] / default["bytes"])}
            gains.append(row | gain | {"change": words(row["change"])})
    trial = ["size", "steps", "codec", "version", "change"]
    frame = pd.DataFrame(gains, columns=[*trial, "surface", "dB", "log"])
    by_surface = frame.groupby([*trial, "surface"], sort=False).agg(
        dB=("dB", "mean"), log=("log", "mean"), fits=("dB", "size")
    )
    means = by_surface.groupby(trial, sort=False).agg(dB=("dB", "mean"), log=("log", "mean"), fits=("fits", "sum"))
    means = means.reset_index().sort_values(trial[:-1], kind="stable")  # changes stay in their order
    lines = [
        "| size, steps | codec, version | setting | Δ dB | bytes | fits |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for each in means.itertuples():
        name = f"{each.size}², {each.steps:,} steps | {each.codec} {each.version} | {each.change}"
        lines.append(f"| {name} | {each.dB:+.2f} | × {math.exp(each.log):.2f} | {each.fits} |")
    lines += [f"\nFailed: {row['surface']}, {row['codec']} {words(row['change'])}" for row in rows if "error" in row]
    return "\n".join(lines)


def main(given: list[str] | None = None) -> None:
    """Make trials, or print the table of those that were made."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--codecs", nargs="+", choices=OWN, default=list(OWN))
    parser.add_argument("--surfaces", nargs="+", default=SURFACES)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--steps", type=int, default=2_500)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args(given)
    if options.table:
        print(table(read(options.out)))
    else:
        run(options)


if __name__ == "__main__":
    main()
