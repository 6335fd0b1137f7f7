"""Every picture of docs/neubtf.md, and the figures beside them.

    python benchmarks/neubtf_pictures.py --out docs/images --keep FOLDER [NAME ...]

`--keep` holds the fitted files, which are not fitted again: NeuBTF on the left half of brick, gravel and satin (128²
texels, as `benchmarks/propagation.py` fits them), once more on that of brick, at several scales; at 64² and in full,
with the curves of the fits, what fails on cable-knit, and both codecs on satin. NAMEs choose among the pictures; by
default all are drawn. Prints the figures that the page quotes.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from propagation import BRIEF, fitted, frontal, guided, left_half
from scipy.spatial import cKDTree
from skimage import data

from bench.btf import BTF
from bench.codec import Codec, Fit
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.data.materials import load
from bench.data.materials.maps import resize
from bench.hemisphere import from_degrees, to_degrees
from bench.material import Material
from bench.metrics import default_names
from bench.metrics.angular import THETA_EDGES_DEG
from bench.metrics.display import decode_srgb, encode_srgb, exposure, to_display
from bench.metrics.scoring import Scorer
from bench.records import SSIM, metric_of
from bench.threads import torch_threads
from neubtf import latents
from neubtf.codec import NeuBTF
from neubtf.guidance import RADIANCE, Treatment
from neubtf.propagation import FittedMaterial
from neubtf.renderer import NeuBTFMaterial
from neubtf.tileable import seam_of

Array = np.ndarray
SIZE = 128
SMALL = 64  # of what is fitted in full
FAILING = "cable-knit"
UP = (0.0, 0.0)  # θ and φ in degrees
PAIRS = ((UP, UP), (UP, (45.0, 0.0)), (UP, (60.0, 135.0)), ((45.0, 270.0), (45.0, 90.0)))  # view, light
EDITED = ((UP, UP), (UP, (30.0, 90.0)), (UP, (55.0, 135.0)))
SCALES = (1, 3 / 4, 1 / 2, 3 / 8, 1 / 4, 1 / 8)
# Half the steps show other slices, and half of those another scale, or none of them.
SCALED = BRIEF | {"smallest": 0.5, "explore": 0.5, "steps": 3600}


class Bench:
    """The materials, their fits, and where pictures go."""

    def __init__(self, out: Path, keep: Path):
        self.out, self.keep = out, keep

    def btf(self, name: str) -> BTF:
        return load(name, size=SIZE, split="validation")

    def half(self, name: str, kind: str = "0", settings: dict[str, Any] = BRIEF) -> FittedMaterial:
        """NeuBTF, fitted to the left half of a material."""
        path = self.keep / f"{name}-{SIZE}-left-{kind}.nbtf"
        return FittedMaterial.read(fitted(left_half(self.btf(name)), NeuBTF(keep_encoder=True, **settings), path))

    def whole(self, name: str, codec: Codec) -> tuple[Material, list[dict[str, float]]]:
        """A codec, fitted to the whole of a material at 64², and the curve of its fit."""
        path = self.keep / f"{name}-{SMALL}-{codec.name}.nbtf"
        curve = path.with_suffix(".json")
        if not curve.exists():
            btf, fit = load(name, size=SMALL, split="validation"), Fit()
            container.save(path, codec, codec.encode(btf.subset(btf.split().train), fit))
            curve.write_text(json.dumps(fit.history))
        return loading.load(path)[1], json.loads(curve.read_text())

    def save(self, figure: Figure, name: str) -> None:
        path = self.out / f"neubtf-{name}"
        options = {"pil_kwargs": {"quality": 78, "optimize": True}} if path.suffix == ".jpg" else {}
        figure.savefig(path, dpi=100, **options)
        print(f"wrote {path}: {path.stat().st_size / 1e3:.0f} kB")


def direction(angles: tuple[float, float]) -> list[float]:
    found: list[float] = from_degrees(*angles).tolist()
    return found


def shot(material: Material, pair: Any, shown: float) -> Array:
    """A slice of a material as it is displayed, (H, W, 3)."""
    wo, wi = pair
    return to_display(material.slice(direction(wo), direction(wi)).numpy(), shown)


def lit_from(pair: Any) -> str:
    (view, _), (light, azimuth) = pair
    seen = f"seen from {view:g}°, " if view else ""
    return f"{seen}lit from {light:g}°" + (f", φ {azimuth:g}°" if light else "")


def grid(rows: Sequence[Sequence[Array]], titles: Sequence[str], names: Sequence[str], side: float = 1.9) -> Figure:
    """Pictures in rows and columns, titles above and names beside."""
    shape = rows[0][0].shape
    high = side * shape[0] / shape[1]
    figure = Figure(figsize=(side * len(titles) + 0.3, high * len(rows) + 0.3), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0, hspace=0)  # type: ignore[union-attr]
    every: Any = figure.subplots(len(rows), len(titles), squeeze=False)
    for axes_row, pictures, name in zip(every, rows, names, strict=True):
        for axes, picture in zip(axes_row, pictures, strict=True):
            axes.imshow(picture, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        axes_row[0].set_ylabel(name, fontsize=8)
    for axes, title in zip(every[0], titles, strict=True):
        axes.set_title(title, fontsize=8)
    return figure


def draw_propagation(bench: Bench) -> None:
    """Fitted to the left of the line, guided by the whole: truth and what was propagated, at held-out pairs."""
    rows = []
    names = ("brick", "gravel", "satin")
    for name in names:
        btf, source = bench.btf(name), bench.half(name)
        material = guided(source, frontal(btf), Treatment(exposure=RADIANCE))
        shown = exposure(btf)
        row = [to_display(frontal(btf), shown)]
        for pair in _near(btf, PAIRS[1]), _near(btf, PAIRS[3]):
            ours = material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist()).numpy()
            row += [to_display(btf[pair], shown), to_display(ours, shown)]
        rows.append(row)
    titles = ["guidance", "truth, lit aslant", "NeuBTF", "truth, seen aslant", "NeuBTF"]
    figure = grid(rows, titles, names)
    for axes in figure.axes:
        axes.axvline(SIZE / 2 - 0.5, color="white", linewidth=0.8, linestyle=(0, (3, 3)))
    bench.save(figure, "propagation.jpg")


def _near(btf: BTF, pair: Any) -> int:
    """The held-out pair nearest to a view and a light."""
    held = btf.split().heldout["heldout"]
    wo, wi = (np.array(direction(angles)) for angles in pair)
    return int(held[np.argmax(btf.wo[held] @ wo + btf.wi[held] @ wi)])


def draw_photograph(bench: Bench) -> None:
    """The grey photographs that the built-in reliefs were cut from, whole, at the scale of the fitted texels."""
    rows = []
    for name, photograph, texels in (("gravel", data.gravel(), 210), ("grass on gravel", data.grass(), 210)):
        source = bench.half(name.split()[-1])
        picture = np.repeat(decode_srgb(photograph[..., None] / 255), 3, 2).astype(np.float32)
        material = guided(source, picture, Treatment(scale=SIZE / texels))
        small = resize(picture, material.size)
        rows.append([encode_srgb(small), *(shot(material, pair, source.exposure) for pair in PAIRS[:3])])
    rows = [[picture[:200, :200] for picture in row] for row in rows]
    titles = ["photograph, a part", *(lit_from(pair) for pair in PAIRS[:3])]
    bench.save(grid(rows, titles, ["gravel", "grass, as gravel"], 2.1), "photograph.jpg")


def draw_tileable(bench: Bench) -> None:
    """Four copies side by side, of a guidance as it is, and of one that was blended."""
    source = bench.half("gravel")
    picture = np.repeat(decode_srgb(data.gravel()[100:330, 240:470, None] / 255), 3, 2).astype(np.float32)
    pairs = np.array([[direction(wo), direction(wi)] for wo, wi in PAIRS])
    row, titles = [], []
    for margin, name in ((0.0, "as it is"), (1 / 6, "--make-tileable")):
        material = guided(source, picture, Treatment(scale=SIZE / 210, margin=margin))
        ratios = seam_of(material, pairs)
        told = " and ".join(f"{seam.of_mean:.2f}" for seam in ratios)
        titles.append(f"{name}: gradient across the\nborders over those inside: {told}")
        largest = ", ".join(f"{seam.of_largest:.2f}" for seam in ratios)
        print(f"tileable, {name}: of the mean {told}, of the largest {largest}")
        tile = np.tile(shot(material, PAIRS[2], source.exposure), (2, 2, 1))
        side = min(tile.shape[:2])
        row.append(tile[:side, :side])
    least = min(picture.shape[0] for picture in row)
    bench.save(grid([[picture[:least, :least] for picture in row]], titles, [""], 3.4), "tileable.jpg")


def draw_edits(bench: Bench) -> None:
    """Structures that the materials never had."""
    rows, names = [], []
    for name, structure, what in (
        ("brick", hexagons(), "a drawing, as brick"),
        ("satin", jacquard(), "a weaver's draft, as satin"),
        ("gravel", decode_srgb(data.coins()[2:290:2, 10:370:2] / 255), "coins, as gravel"),
    ):
        source = bench.half(name)
        picture = np.repeat(structure[..., None], 3, 2).astype(np.float32)
        material = guided(source, picture, Treatment())
        rows.append([encode_srgb(picture), *(shot(material, pair, source.exposure) for pair in EDITED)])
        names.append(what)
    bench.save(grid(rows, ["guidance", *(lit_from(pair) for pair in EDITED)], names, 2.3), "edits.jpg")


def hexagons(side: float = 26, joint: float = 3) -> Array:
    """A binary drawing (160, 200): hexagons `side` texels apart, with bright joints between them."""
    rows, columns = np.mgrid[-1:10, -1:10]
    centres = np.stack([rows * side * np.sqrt(3) / 2, (columns + rows % 2 / 2) * side], -1).reshape(-1, 2)
    texels = np.stack(np.mgrid[:160, :200], -1)
    nearest, _ = cKDTree(centres).query(texels, k=2)
    return np.where(nearest[..., 1] - nearest[..., 0] < joint, 0.5, 0.12)


def jacquard(thread: int = 13) -> Array:
    """A binary draft (208, 260): bright where the weft lies above. Satin, and inside a silhouette its other side."""
    warp, weft = np.meshgrid(np.arange(20), np.arange(16))
    silhouette = np.asarray(
        Image.fromarray(data.horse()[25:310, 20:380]).resize(warp.shape[::-1], Image.Resampling.NEAREST)
    )
    above = (2 * warp + weft) % 5 == 0
    return np.where(np.kron(above ^ ~silhouette, np.ones((thread, thread), bool)), 0.45, 0.06)


def draw_levels(bench: Bench) -> None:
    """Does a smaller guidance give what a smaller picture of the material shows? On the half that was fitted."""
    print("| scale | R(A(G↓)) to truth↓ | R(A(G))↓ to truth↓ | R(A(G↓)) to R(A(G))↓ |\n|" + " --- |" * 4)
    for scale, psnr in zip(SCALES, levels(bench.half("brick", "scaled", SCALED), bench.btf("brick")), strict=True):
        print(f"| {scale:g} | " + " | ".join(f"{x:.2f}" if x < 100 else "same" for x in psnr) + " |")


def levels(source: FittedMaterial, btf: BTF) -> list[list[float]]:
    """PSNR at each scale, pooled over a third of the held-out pairs: see the heads of `draw_levels`."""
    half, shown = btf.shape[1] // 2, exposure(btf)
    own = decode_srgb(source.guidance.numpy() / 255).astype(np.float32)
    whole = guided(source, own, Treatment(exposure="1"))
    found = []
    for scale in SCALES:
        small = guided(source, own, Treatment(scale=scale, exposure="1"))
        errors = []
        for pair in btf.split().heldout["heldout"][::3]:
            at = (btf.wo[pair].tolist(), btf.wi[pair].tolist())
            truth, after, before = (
                to_display(resize(each, small.size), shown)
                for each in (btf[pair][:, :half], whole.slice(*at).numpy(), small.slice(*at).numpy())
            )
            errors.append([np.square(a - b).mean() for a, b in ((before, truth), (after, truth), (before, after))])
        found.append((-10 * np.log10(np.maximum(np.mean(errors, 0), 1e-12))).tolist())
    return found


def draw_latents(bench: Bench) -> None:
    """The channels of two neural textures, as `neubtf-bench latents` draws them."""
    for name in ("brick", "satin"):
        material = loading.load(bench.keep / f"{name}-{SIZE}-left-0.nbtf")[1]
        assert isinstance(material, NeuBTFMaterial)
        latents.draw(material.texture[:64], bench.out / f"neubtf-latents-{name}.png")


def draw_failure(bench: Bench) -> None:
    """Relief so strong that it hides itself: NeuBTF without parallax against NeuMIP, which shifts its texels."""
    btf = load(FAILING, size=SMALL, split="validation")
    codecs = [load_codec(name)() for name in ("neubtf", "neubtf-direct", "neumip")]
    materials = [bench.whole(FAILING, codec)[0] for codec in codecs]
    ssim = metric_of(default_names(btf.periodic), SSIM)
    scorer = Scorer(btf, ["psnr_display", ssim], threads=1)
    held = btf.split().heldout["heldout"]
    ring = np.digitize(to_degrees(btf.wo[held])[0], THETA_EDGES_DEG[1:-1])
    figure = Figure(figsize=(9, 7), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 1.5])
    panels: Any = top.subplots(1, 2)
    print("| θ_o in degrees | pairs | " + " | ".join(f"{c.name}, dB | {c.name}, SSIM" for c in codecs) + " |")
    print("|" + " --- |" * (2 + 2 * len(codecs)))
    columns = []
    for codec, material, style in zip(codecs, materials, ("o-", "^:", "s--"), strict=True):
        scores = scorer.score(held, lambda i, m=material: m.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy())
        rings = [ring == i for i in range(5)]
        psnr = [-10 * np.log10(scores.raw["psnr_display"][here].mean()) for here in rings]
        alike = [scores.raw[ssim][here].mean() for here in rings]
        columns += [psnr, alike]
        for axes, values in zip(panels, (psnr, alike), strict=True):
            axes.plot(np.arange(5) * 15 + 7.5, values, style, label=codec.name)
    for i, values in enumerate(zip(*columns, strict=True)):
        cells = [f"{15 * i}–{15 * i + 15}", str(int((ring == i).sum()))]
        print(
            "| " + " | ".join(cells + [f"{v:.2f}" if k % 2 == 0 else f"{v:.3f}" for k, v in enumerate(values)]) + " |"
        )
    for axes, what in zip(panels, ("display PSNR, dB", "SSIM"), strict=True):
        axes.set(xlabel="angle of view θₒ in degrees", ylabel=what, xticks=range(0, 76, 15))
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False)
    _draw_slices(bottom, btf, codecs, materials)
    bench.save(figure, "failure.png")


def _draw_slices(place: Any, btf: BTF, codecs: Sequence[Codec], materials: Sequence[Material]) -> None:
    """Truth and codecs, from above and from a grazing view."""
    shown = exposure(btf)
    every = place.subplots(2, 1 + len(codecs))
    for row, pair in enumerate((_near(btf, (UP, (30.0, 45.0))), _near(btf, ((70.0, 270.0), (30.0, 45.0))))):
        at = (btf.wo[pair].tolist(), btf.wi[pair].tolist())
        pictures = [btf[pair], *(material.slice(*at).numpy() for material in materials)]
        view = float(to_degrees(btf.wo[pair])[0])
        for axes, picture, name in zip(every[row], pictures, ["truth", *(c.name for c in codecs)], strict=True):
            axes.imshow(to_display(picture, shown), interpolation="nearest")
            axes.set_axis_off()
            axes.set_title(f"{name}, θₒ = {view:.0f}°", fontsize=7)


def draw_speed(bench: Bench) -> None:
    """How soon each of the two codecs is how good: the curves of their fits, one thread each."""
    figure = Figure(figsize=(6.4, 3), layout="constrained")
    axes = figure.subplots()
    for name, style in (("neubtf-direct", "--"), ("neubtf", "-")):
        _, curve = bench.whole("satin", load_codec(name)())
        steps, seconds, psnr = ([point[key] for point in curve] for key in ("step", "seconds", "psnr"))
        axes.plot(seconds, psnr, style, label=name)
        print(f"{name}: {psnr[-1]:.2f} dB after {steps[-1]} steps and {seconds[-1]:.0f} s")
    axes.set(xlabel="seconds of the fit", ylabel="display PSNR, dB", xscale="log")
    axes.legend(frameon=False)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    bench.save(figure, "speed.png")


DRAWINGS: dict[str, Callable[[Bench], None]] = {
    name.removeprefix("draw_"): function for name, function in globals().items() if name.startswith("draw_")
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(DRAWINGS)} (default: all)")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--keep", type=Path, required=True, help="a folder for the fitted files")
    chosen = parser.parse_args()
    chosen.keep.mkdir(parents=True, exist_ok=True)
    bench = Bench(chosen.out, chosen.keep)
    with torch_threads(1):
        for name in chosen.names or DRAWINGS:
            DRAWINGS[name](bench)


if __name__ == "__main__":
    main()
