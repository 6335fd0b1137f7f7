"""Full models against models of the scenes that ship: bytes at equal quality in the scene, over seeds.

    python benchmarks/scenes.py [--material cable-knit] [--scene wall ...] [--seeds 3] CODEC[:SETTING=VALUE,...] ...
    python benchmarks/scenes.py --control pca vq                # how far full models can shrink, for comparison
    python benchmarks/scenes.py --pictures docs/images          # those of docs/scenes.md

For instance `python benchmarks/scenes.py pca vq neubtf-direct:steps=400`; the default is `pca vq`. The data are 64²
texels and 25 × 25 training pairs. A seed is that of the fits and of the demand. Prints a Markdown table: what
`neubtf-bench encode --demand` finds against the full model at the PSNR of the scene's frames, as mean ± standard
deviation over the seeds, and what it costs outside the scene.
"""

import argparse
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from fits import parse
from neubtf_pictures import grid

from bench import atomic
from bench.btf import BTF
from bench.codec import Codec, Fit
from bench.data.open import open_material
from bench.data.spec import Preparation, named
from bench.demand.collect import collect
from bench.demand.demand import Demand
from bench.demand.fitting import Search, SearchResult, as_good_as, rows
from bench.demand.frame_scorer import FrameScorer, table_of
from bench.demand.scene import named_scene
from bench.demand.text_scene import TextScene
from bench.metrics.display import to_display
from bench.threads import torch_threads

SCENES = ("table-top", "turntable", "walk-through", "wall")  # those that ask different things of a material
QUERIES = 100_000
PICTURED = 1_000_000  # queries of the pictures: frames of an environment's samples are coarse and noisy with fewer
HEADS = (
    "scene", "codec", "bytes full", "bytes scene", "share %", "PSNR full dB", "PSNR scene dB", "FLIP full",
    "FLIP scene", "ns full", "ns scene", "outside full dB", "outside scene dB", "fit s full", "search s",
)  # fmt: skip


def demand_of(scene: str, queries: int, seed: int = 0) -> Demand:
    return collect(TextScene(named_scene(scene)), queries, seed)


def search(codec: Codec, btf: BTF, scorer: FrameScorer, seed: int, folder: Path) -> SearchResult:
    """What a search for a model of the scene finds, with one thread."""
    training = btf.subset(btf.split().train)
    return Search(codec, training, scorer, lambda: Fit(seed=seed), folder).run()


def measure(codec: Codec, btf: BTF, scorer: FrameScorer, seed: int) -> list[float]:
    """The numbers of one row, from `bytes full` on."""
    with tempfile.TemporaryDirectory() as folder:
        found = search(codec, btf, scorer, seed, Path(folder))
        table = rows(found, scorer, 1)
    full, scene = table[0], table[-1]
    both = [[row[name] for row in (full, scene)] for name in ("psnr", "flip", "ns", "outside")]
    numbers = [np.nan if value is None else value for pair in both for value in pair]
    sizes = [full["bytes"], scene["bytes"], 100 * scene["bytes"] / full["bytes"]]
    return [*sizes, *numbers, full["seconds"], found.seconds]


def written(values: Sequence[float]) -> str:
    """Mean ± standard deviation; a dash where there is nothing to measure."""
    if np.isnan(values).any():
        return "—"
    mean = statistics.fmean(values)
    digits = 0 if abs(mean) >= 100 else 3 if abs(mean) < 1 else 1 if abs(mean) >= 30 else 2
    spread = f" ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else ""
    return f"{mean:,.{digits}f}{spread}"


def compare(options: argparse.Namespace) -> None:
    btf = open_material(named(options.material), Preparation(), lambda *_: None)
    print("| " + " | ".join(HEADS) + " |\n|" + "---|" * len(HEADS), flush=True)
    for scene in options.scene or SCENES:
        scorers = [FrameScorer(table_of(btf), demand_of(scene, options.queries, seed)) for seed in range(options.seeds)]
        for text in options.codecs or ["pca", "vq"]:
            found = [measure(parse(text), btf, scorer, seed) for seed, scorer in enumerate(scorers)]
            print("| " + " | ".join([scene, text, *map(written, zip(*found, strict=True))]) + " |", flush=True)


def control(options: argparse.Namespace) -> None:
    """Bytes of the smallest model of the whole BTF, of those of fewer sizes, that does as well as the full one."""
    btf = open_material(named(options.material), Preparation(), lambda *_: None)
    training = btf.subset(btf.split().train)
    print("| scene | codec | bytes full | bytes smallest |\n|---|---|---|---|", flush=True)
    for scene in options.scene or SCENES:
        scorer = FrameScorer(table_of(btf), demand_of(scene, options.queries))
        for text in options.codecs or ["pca", "vq"]:
            codec = parse(text)
            with tempfile.TemporaryDirectory() as folder:
                look = Search(codec, training, scorer, Fit, Path(folder))
                full = look.model(codec, "full")
                goal = as_good_as(full)
                size = min(model.header.file_bytes for model in look.ladder(goal, scene=False) if goal.met(model))
            print(f"| {scene} | {text} | {full.header.file_bytes:,} | {size:,} |", flush=True)


def pictures(options: argparse.Namespace) -> None:
    """Frames of full and scene model, with their FLIP."""
    btf = open_material(named(options.material), Preparation(), lambda *_: None)
    codec = parse(options.codecs[0] if options.codecs else "pca")
    for scene in options.scene or SCENES:
        scorer = FrameScorer(table_of(btf), demand_of(scene, PICTURED))
        with tempfile.TemporaryDirectory() as folder:
            found = search(codec, btf, scorer, 0, Path(folder))
            draw_models(scorer, found, options.pictures / f"scene-{scene}.jpg")


def draw_models(scorer: FrameScorer, found: SearchResult, path: Path) -> None:
    """The first frame: reference table, full model, scene model, and below their FLIP."""
    rows, titles = [[to_display(scorer.truth[0], scorer.exposure)], []], [f"{scorer.demand.name}: reference table"]
    rows[1].append(np.ones_like(rows[0][0]))
    for name, model in {"full model": found.full, "scene model": found.scene}.items():
        if model:
            frames = scorer.frames(model.material)
            rows[0].append(to_display(frames[0], scorer.exposure))
            rows[1].append(scorer.flip_map(frames))
            titles.append(f"{name}: {model.header.file_bytes:,} bytes, {model.psnr:.1f} dB, FLIP {model.flip:.3f}")
    with atomic.replacing(path) as partial:
        grid(rows, titles, ["", "FLIP"], 5.0).savefig(partial, format="jpg", dpi=80, pil_kwargs={"quality": 85})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("codecs", nargs="*")
    parser.add_argument("--material", default="cable-knit")
    parser.add_argument("--scene", action="append", default=[])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--queries", type=int, default=QUERIES)
    parser.add_argument("--control", action="store_true")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    with torch_threads(1):
        (pictures if options.pictures else control if options.control else compare)(options)


if __name__ == "__main__":
    main()
