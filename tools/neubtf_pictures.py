"""Every picture of docs/neubtf.md, and the figures beside them.

    python tools/neubtf_pictures.py --out docs/images --keep FOLDER [NAME ...]

`--keep` holds the fitted files, which are not fitted again: NeuBTF on the upper left quarter of 256² texels of brick,
gravel, satin and wool (measured, `$NEUBTF_DATA`), by the paper's recipe and in some minutes; at several scales on the
quarter of 128² texels of brick; at 64² and with 2,500 steps, what fails on cable-knit; and by the paper's recipe the
fits of Table 1 to bricks (`$NEUBTF_DATA`), satin and wool. By the paper's recipe a quarter takes an hour of a core, and
a whole material 1.7 hours. NAMEs choose among the pictures; by default all are drawn. Prints the figures that
the page quotes.
"""

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import cKDTree
from skimage import data
from threadpoolctl import threadpool_limits

from bench.btf import BTF
from bench.codec import Codec, Fit, settings_dict, silent
from bench.codecs import container, loading
from bench.codecs.encoding import new_fit
from bench.codecs.registry import load_codec
from bench.data.materials.maps import resize
from bench.data.open import open_material
from bench.data.spec import Preparation, named
from bench.directions.hemisphere import from_degrees, to_degrees
from bench.inputs.errors import did_you_mean
from bench.material import Material
from bench.metrics import DEFAULTS, chosen_names, metric_of
from bench.metrics.angular import THETA_EDGES_DEG
from bench.metrics.display import decode_srgb, encode_srgb, exposure, to_display
from bench.metrics.scoring import Scorer
from bench.records import SSIM
from bench.runs.suite import load_suite
from neubtf import latents, propagation
from neubtf.codec import NeuBTF
from neubtf.guidance import RADIANCE, Treatment, guidance_of
from neubtf.propagation import FittedMaterial
from neubtf.renderer import NeuBTFMaterial
from neubtf.seam import seam_of

Array = np.ndarray
SIZE = 256
SCALED_SIZE = 128  # of what is fitted at several scales
SMALL = 64  # of cable-knit, which `draw_failure` fits whole
LARGE = 13  # points of text that a telephone shows, too
FAILING = "cable-knit"
CUT = 210  # texels a side of the photographs from which the built-in reliefs were made
UP = (0.0, 0.0)  # θ and φ in degrees
PAIRS = ((UP, UP), (UP, (45.0, 0.0)), (UP, (60.0, 135.0)), ((45.0, 270.0), (45.0, 90.0)))  # view, light
EDITED = ((UP, UP), (UP, (30.0, 90.0)), (UP, (55.0, 135.0)))
SCALES = (1, 3 / 4, 1 / 2, 1 / 4, 1 / 8)
PAPER: dict[str, Any] = {"recipe": "paper"}
# End to end from the first step, on single samples alone: the way to a useful encoder in some minutes of one core.
BRIEF: dict[str, Any] = {"steps": 1800, "direct": 0.0, "taught": 0.0, "explore": 0.1}
# By the name of a fit's file: its settings, and what pictures call it.
FITS = {"paper": (PAPER, "the paper's\nrecipe"), "brief": (BRIEF, "short fit")}
# "ours": half the steps show random slices, half of which are rescaled. "paper": all are random and rescaled.
SCALED = {
    "ours": BRIEF | {"smallest": 0.25, "explore": 0.5, "steps": 3600},
    "paper": {"recipe": "paper", "smallest": 0.25, "steps": 3600},
}


class Bench:
    """The materials, their fits, and where pictures go."""

    def __init__(self, out: Path, keep: Path):
        self.out, self.keep = out, keep

    def btf(self, name: str, size: int = SIZE) -> BTF:
        """A material with validation pairs; of a measured one about 1,000 pairs."""
        return open_material(named(name), Preparation(size=size, texels=size, pairs=1_000, split="validation"), silent)

    def quarter(
        self, name: str, kind: str = "paper", settings: dict[str, Any] | None = None, size: int = SIZE
    ) -> FittedMaterial:
        """The fitted material in `file_of_quarter`."""
        return FittedMaterial.read(self.file_of_quarter(name, kind, settings, size))

    def file_of_quarter(
        self, name: str, kind: str = "paper", settings: dict[str, Any] | None = None, size: int = SIZE
    ) -> Path:
        """The file of NeuBTF, fitted to the upper left quarter of a material, which is not periodic.

        `kind` is part of the file's name; without `settings` it chooses them in `FITS`.
        """
        if settings is None:
            settings, _ = FITS[kind]
        btf = self.btf(name, size)
        part = btf.subset(btf.split().train).crop(0, 0, btf.shape[0] // 2, btf.shape[1] // 2)
        return self.file(part, NeuBTF(keep_encoder=True, **settings), Path(name).name, kind)

    def of_table_1(self, name: str) -> tuple[FittedMaterial, BTF]:
        """NeuBTF by the paper's recipe, fitted to a whole material as in `paper-nearest`, and that material."""
        suite = load_suite("paper-nearest")
        (spec,) = (each for each in suite.materials if each.name == name)
        (chosen,) = (each for each in suite.codecs if each.settings.get("recipe") == "paper")
        btf = open_material(spec, suite.data, silent)
        training = btf.subset(btf.split().train)
        codec = NeuBTF(**chosen.settings, keep_encoder=True)
        path = self.file(training, codec, name, "table-1", new_fit(codec, training, 0, None))
        return FittedMaterial.read(path), btf

    def file(self, btf: BTF, codec: Codec, name: str, kind: str, fit: Fit | None = None) -> Path:
        """The file of a fit, kept from an earlier time if it has the same size, settings and version."""
        path = self.keep / f"{name}-{kind}-{btf.shape[0]}-{codec.name}.nbtf"
        if path.exists():
            header = container.read_header(path)
            settings = settings_dict(codec)
            if header.settings == settings and header.version == codec.version_of(settings):
                return path
        container.save(path, codec, codec.encode(btf, fit or Fit()))
        return path

    def save(self, figure: Figure, name: str) -> None:
        """Write a figure as `neubtf-NAME`, JPEG or PNG by its ending, and print its size."""
        path = self.out / f"neubtf-{name}"
        options = {"pil_kwargs": {"quality": 78, "optimize": True}} if path.suffix == ".jpg" else {}
        figure.savefig(path, dpi=100, **options)
        print(f"wrote {path}: {path.stat().st_size / 1e3:.0f} kB")


def heldout(btf: BTF) -> Array:
    """At most 150 of the held-out pairs, validation or test, evenly spread."""
    pairs = np.sort(np.concatenate(list(btf.split().heldout.values())))
    return pairs[:: -(-len(pairs) // 150)]


def guided(source: FittedMaterial, picture: Array, treatment: Treatment) -> NeuBTFMaterial:
    """The material of a fit with the texture that a linear picture (H, W, 3) gives."""
    image, _ = guidance_of(picture, treatment, source.guidance, source.exposure)
    codec, parts = source.guided(propagation.textured(source.encoder, image))
    material = codec.decode(parts, torch.device("cpu"))
    assert isinstance(material, NeuBTFMaterial)
    return material


def frontal(btf: BTF) -> Array:
    """What a photograph with a flash shows, linear (H, W, 3)."""
    trained = btf.subset(btf.split().train)
    return btf[int((trained.wo[:, 2] + trained.wi[:, 2]).argmax())]


def propagated(btf: BTF, material: NeuBTFMaterial) -> list[float]:
    """Pooled display PSNR in dB: of the quarter that was seen, of the rest, and, on the rest, of the mean ABRDF of the
    quarter."""
    shown, seen = exposure(btf), np.zeros(btf.shape, bool)
    seen[: btf.shape[0] // 2, : btf.shape[1] // 2] = True
    found = []
    for pair in heldout(btf):
        linear = btf[pair]
        truth, mean = to_display(linear, shown), to_display(linear[seen].mean(0), shown)
        error = np.square(to_display(material.slice(*at(btf, pair)).numpy(), shown) - truth)
        found.append([error[seen].mean(), error[~seen].mean(), np.square(truth[~seen] - mean).mean()])
    decibels: list[float] = (-10 * np.log10(np.mean(found, 0))).tolist()
    return decibels


def at(btf: BTF, pair: int) -> tuple[list[float], list[float]]:
    """View and light of a pair, unit vectors, as `Material.slice` takes them."""
    return btf.wo[pair].tolist(), btf.wi[pair].tolist()


def direction(angles: tuple[float, float]) -> list[float]:
    """The unit vector (3,) of θ and φ in degrees."""
    found: list[float] = from_degrees(*angles).tolist()
    return found


def shot(material: Material, pair: Any, shown: float) -> Array:
    """A slice of a material as it is displayed, (H, W, 3)."""
    wo, wi = pair
    return to_display(material.slice(direction(wo), direction(wi)).numpy(), shown)


def lit_from(pair: Any) -> str:
    """View and light of a pair of angles in words; the view is left out if it is from above."""
    (view, _), (light, azimuth) = pair
    seen = f"seen from {view:g}°,\n" if view else ""
    return f"{seen}lit from {light:g}°" + (f", φ {azimuth:g}°" if light else "")


def grid(
    rows: Sequence[Sequence[Array]], titles: Sequence[str], names: Sequence[str], side: float = 1.9, text: float = 8
) -> Figure:
    """Pictures in rows and columns, each `side` inches wide; titles above and names beside have `text` points."""
    shape = rows[0][0].shape
    high, lines = side * shape[0] / shape[1], 1 + max(title.count("\n") for title in titles)
    figure = Figure(
        figsize=(side * len(titles) + text / 27, high * len(rows) + lines * text / 27), layout="constrained"
    )
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0, hspace=0)  # type: ignore[union-attr]
    every: Any = figure.subplots(len(rows), len(titles), squeeze=False)
    for axes_row, pictures, name in zip(every, rows, names, strict=True):
        for axes, picture in zip(axes_row, pictures, strict=True):
            axes.imshow(picture, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        axes_row[0].set_ylabel(name, fontsize=text)
    for axes, title in zip(every[0], titles, strict=True):
        axes.set_title(title, fontsize=text)
    return figure


def draw_propagation(bench: Bench) -> None:
    """Fitted within the lines, guided by the whole: truth and what was propagated, at held-out pairs."""
    rows, labels = [], []
    print("| material | recipe | seen, dB | not seen, dB | mean ABRDF there, dB |\n|" + " --- |" * 5)
    for name in ("brick", "gravel", "satin", "ubo2003_local_pca/wool"):
        btf = bench.btf(name)
        materials = []
        for kind in FITS:
            material = guided(bench.quarter(name, kind), frontal(btf), Treatment(exposure=RADIANCE))
            told = " | ".join(f"{value:.2f}" for value in propagated(btf, material))
            print(f"| {Path(name).name} | {kind} | {told} |", flush=True)
            materials.append(material)
        if "/" in name:  # pictures of measured data are not published
            continue
        labels.append(name)
        shown = exposure(btf)
        row = [to_display(frontal(btf), shown)]
        for pair in _near(btf, PAIRS[1]), _near(btf, PAIRS[3]):
            row.append(to_display(btf[pair], shown))
            for material in materials:
                row.append(to_display(material.slice(*at(btf, pair)).numpy(), shown))
        rows.append(row)
    names = [what for _, what in FITS.values()]
    titles = ["guidance", "truth,\nlit aslant", *names, "truth,\nseen aslant", *names]
    figure = grid(rows, titles, labels, text=LARGE)
    for axes in figure.axes:
        line, middle = {"color": "white", "linewidth": 0.8, "linestyle": (0, (3, 3))}, SIZE / 2 - 0.5
        axes.plot([middle, middle, -0.5], [-0.5, middle, middle], **line)
    bench.save(figure, "propagation.jpg")


def _near(btf: BTF, pair: Any) -> int:
    """The held-out pair nearest to a view and a light."""
    held = heldout(btf)
    wo, wi = (np.array(direction(angles)) for angles in pair)
    return int(held[np.argmax(btf.wo[held] @ wo + btf.wi[held] @ wi)])


def draw_photograph(bench: Bench) -> None:
    """The grey photographs that the built-in reliefs were cut from, whole, at the scale of the fitted texels."""
    rows, names = [], []
    for photograph, what in ((data.gravel(), "gravel"), (data.grass(), "grass, as gravel")):
        for kind, (_, recipe) in FITS.items():
            source = bench.quarter("gravel", kind)
            picture = np.repeat(decode_srgb(photograph[..., None] / 255), 3, 2).astype(np.float32)
            material = guided(source, picture, Treatment(scale=SIZE / CUT))
            small = resize(picture, material.size)
            pictures = [encode_srgb(small), *(shot(material, pair, source.exposure) for pair in PAIRS[:3])]
            rows.append([picture[:200, :300] for picture in pictures])
            names.append(f"{what},\n{recipe}")
    titles = ["photograph,\na part", *(lit_from(pair) for pair in PAIRS[:3])]
    bench.save(grid(rows, titles, names, 2.4, LARGE), "photograph.jpg")


def draw_tileable(bench: Bench) -> None:
    """Four copies side by side, of a guidance as it is, and of one that was blended."""
    source = bench.quarter("gravel")
    picture = np.repeat(decode_srgb(data.gravel()[100:330, 240:470, None] / 255), 3, 2).astype(np.float32)
    pairs = np.array([[direction(wo), direction(wi)] for wo, wi in PAIRS])
    row, titles = [], []
    for margin, name in ((0.0, "as it is"), (1 / 6, "--make-tileable")):
        material = guided(source, picture, Treatment(scale=SIZE / CUT, margin=margin))
        ratios = seam_of(material, pairs)
        told = " and ".join(f"{seam.of_mean:.2f}" for seam in ratios)
        titles.append(f"{name}\n{told}")
        largest = ", ".join(f"{seam.of_largest:.2f}" for seam in ratios)
        print(f"tileable, {name}: of the mean {told}, of the largest {largest}")
        tile = np.tile(shot(material, PAIRS[2], source.exposure), (2, 2, 1))
        side = min(tile.shape[:2])
        row.append(tile[:side, :side])
    least = min(picture.shape[0] for picture in row)
    bench.save(grid([[picture[:least, :least] for picture in row]], titles, [""], 3.4, LARGE), "tileable.jpg")


def draw_edits(bench: Bench) -> None:
    """Structures that the materials never had."""
    rows, names = [], []
    for name, structure, what in (
        ("brick", hexagons(side=52, joint=6), "a drawing,\nas brick"),
        ("satin", jacquard(thread=26)[:160, :200], "a draft,\nas satin"),
        ("gravel", decode_srgb(data.coins()[2:162, 10:210] / 255), "coins,\nas gravel"),
    ):
        for kind, (_, recipe) in FITS.items():
            source = bench.quarter(name, kind)
            picture = np.repeat(structure[..., None], 3, 2).astype(np.float32)
            material = guided(source, picture, Treatment())
            rows.append([encode_srgb(picture), *(shot(material, pair, source.exposure) for pair in EDITED)])
            names.append(f"{what},\n{recipe}")
    bench.save(grid(rows, ["guidance", *(lit_from(pair) for pair in EDITED)], names, 2.3, LARGE), "edits.jpg")


def draw_published(bench: Bench) -> None:
    """Structures that the materials never had, by the paper's recipe, and how well it keeps to smaller guidance."""
    coins = decode_srgb(data.coins() / 255)
    structures = {
        "bricks": [(hexagons(side=34, joint=4), 1.0, "a drawing,\nas bricks"), (coins, 0.6, "coins,\nas bricks")],
        "satin": [(jacquard(thread=26), 1.0, "a draft,\nas satin")],
        "wool": [],  # measured: its pictures are not published
    }
    rows = []
    names = []
    for name, edits in structures.items():
        source, btf = bench.of_table_1(name)
        for structure, scale, what in edits:
            picture = np.repeat(structure[..., None], 3, 2).astype(np.float32)
            material = guided(source, picture, Treatment(scale=scale))
            small = resize(picture, material.size)
            pictures = [encode_srgb(small), *(shot(material, pair, source.exposure) for pair in EDITED)]
            rows.append([each[:160, :200] for each in pictures])
            names.append(what)
        print_levels(name, levels(source, btf, btf.shape))
    bench.save(grid(rows, ["guidance", *(lit_from(pair) for pair in EDITED)], names, 2.3, LARGE), "published.jpg")


def hexagons(side: float, joint: float) -> Array:
    """A binary drawing (160, 200): hexagons `side` texels apart, with bright joints between them."""
    rows, columns = np.mgrid[-1:10, -1:10]
    centres = np.stack([rows * side * np.sqrt(3) / 2, (columns + rows % 2 / 2) * side], -1).reshape(-1, 2)
    texels = np.stack(np.mgrid[:160, :200], -1)
    nearest, _ = cKDTree(centres).query(texels, k=2)
    return np.where(nearest[..., 1] - nearest[..., 0] < joint, 0.5, 0.12)


def jacquard(thread: int) -> Array:
    """A binary draft (16 · thread, 20 · thread): bright where the weft lies above.

    It is satin, and inside a silhouette satin's other side.
    """
    warp, weft = np.meshgrid(np.arange(20), np.arange(16))
    silhouette = np.asarray(
        Image.fromarray(data.horse()[25:310, 20:380]).resize(warp.shape[::-1], Image.Resampling.NEAREST)
    )
    above = (2 * warp + weft) % 5 == 0
    return np.where(np.kron(above ^ ~silhouette, np.ones((thread, thread), bool)), 0.45, 0.06)


def draw_levels(bench: Bench) -> None:
    """Does a smaller guidance give what a smaller picture of the material shows? On the quarter that was fitted."""
    btf = bench.btf("brick", SCALED_SIZE)
    rows, columns = btf.shape
    for kind, settings in SCALED.items():
        source = bench.quarter("brick", f"scaled-{kind}", settings, SCALED_SIZE)
        print_levels(kind, levels(source, btf, (rows // 2, columns // 2)))


def print_levels(name: str, found: list[list[float]]) -> None:
    """Print what `levels` found as a table with this name above it."""
    print(f"{name}:\n| scale | R(A(G↓)) to truth↓ | R(A(G))↓ to truth↓ | R(A(G↓)) to R(A(G))↓ |\n|" + " --- |" * 4)
    for scale, psnr in zip(SCALES, found, strict=True):
        cells = [f"{scale:g}"]
        for value in psnr:
            cells.append(f"{value:.2f}" if value < 100 else "same")
        print(f"| {' | '.join(cells)} |", flush=True)


def levels(source: FittedMaterial, btf: BTF, fitted: tuple[int, int]) -> list[list[float]]:
    """Display PSNR in dB at each scale, pooled over a third of the held-out pairs: see the heads of `print_levels`.

    `fitted` are the rows and columns of the material, from the upper left, that the fit saw.
    """
    rows, columns = fitted
    shown = exposure(btf)
    own = decode_srgb(source.guidance.numpy() / 255).astype(np.float32)
    whole = guided(source, own, Treatment(exposure="1"))
    found = []
    for scale in SCALES:
        small = guided(source, own, Treatment(scale=scale, exposure="1"))
        errors = []
        for pair in heldout(btf)[::3]:
            truth = to_display(resize(btf[pair][:rows, :columns], small.size), shown)
            after = to_display(resize(whole.slice(*at(btf, pair)).numpy(), small.size), shown)
            before = to_display(resize(small.slice(*at(btf, pair)).numpy(), small.size), shown)
            compared = ((before, truth), (after, truth), (before, after))
            errors.append([np.square(a - b).mean() for a, b in compared])
        found.append((-10 * np.log10(np.maximum(np.mean(errors, 0), 1e-12))).tolist())
    return found


def draw_latents(bench: Bench) -> None:
    """The channels of two neural textures, as `neubtf-bench latents` draws them."""
    for name in ("brick", "satin"):
        material = loading.load(bench.file_of_quarter(name))[1]
        assert isinstance(material, NeuBTFMaterial)
        latents.draw(material.texture, bench.out / f"neubtf-latents-{name}.png")


def draw_failure(bench: Bench) -> None:
    """Relief so strong that it hides itself: NeuBTF without parallax against NeuMIP, which shifts its texels."""
    btf = bench.btf(FAILING, SMALL)
    codecs = [load_codec(name)(steps=2_500) for name in ("neubtf", "neumip")]
    files = {codec.name: bench.file(btf.subset(btf.split().train), codec, FAILING, str(SMALL)) for codec in codecs}
    materials = {name: loading.load(path)[1] for name, path in files.items()}
    held = heldout(btf)
    ring = np.digitize(to_degrees(btf.wo[held])[0], THETA_EDGES_DEG[1:-1])
    rings = [ring == i for i in range(5)]
    columns = [column for material in materials.values() for column in _by_ring(btf, material, held, rings)]
    _print_rings(materials, rings, columns)
    figure = Figure(figsize=(8, 8.6), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 2])
    labels = [f"{name}, {path.stat().st_size / 1e3:.0f} kB" for name, path in files.items()]
    _draw_rings(top, labels, columns)
    _draw_slices(bottom, btf, materials)
    bench.save(figure, "failure.png")


def _by_ring(btf: BTF, material: Material, held: Array, rings: Sequence[Array]) -> tuple[list[float], list[float]]:
    """Pooled display PSNR in dB, and mean SSIM, of a material at the pairs `held` (n,), for each ring, a mask (n,)."""
    ssim = metric_of(chosen_names(DEFAULTS, btf.periodic), SSIM)
    scorer = Scorer(btf, ["psnr_display", ssim], threads=1)
    scores = scorer.score(held, lambda pair: material.slice(*at(btf, pair)).numpy())
    psnr = [float(-10 * np.log10(scores.raw["psnr_display"][ring].mean())) for ring in rings]
    alike = [float(scores.raw[ssim][ring].mean()) for ring in rings]
    return psnr, alike


def _draw_rings(place: Any, labels: Sequence[str], columns: Sequence[Sequence[float]]) -> None:
    """Draw two panels, PSNR and SSIM by angle of view, with a curve for each of two codecs; `columns` are those of
    `_print_rings`."""
    panels: Any = place.subplots(1, 2)
    for axes, what, curves in zip(panels, ("display PSNR, dB", "SSIM"), (columns[::2], columns[1::2]), strict=True):
        for label, values, style in zip(labels, curves, ("o-", "s--"), strict=True):
            axes.plot(np.arange(5) * 15 + 7.5, values, style, label=label)
        axes.set_xlabel("angle of view θₒ in degrees", fontsize=LARGE)
        axes.set_title(what, fontsize=LARGE)
        axes.set_xticks(range(0, 76, 15))
        axes.tick_params(labelsize=LARGE)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    panels[1].legend(frameon=False, fontsize=LARGE)


def _print_rings(names: Iterable[str], rings: Sequence[Array], columns: Sequence[Sequence[float]]) -> None:
    """Print a table of PSNR and SSIM by angle of view.

    `rings` are masks of the held-out pairs of each ring of 15°; `columns` are PSNR and SSIM by ring, codec by codec.
    """
    print("| θₒ in degrees | pairs | " + " | ".join(f"{name}, dB | SSIM" for name in names) + " |")
    print("|" + " --- |" * (2 + len(columns)))
    for i, ring in enumerate(rings):
        cells = [f"{15 * i}–{15 * i + 15}", str(int(ring.sum()))]
        for psnr, ssim in zip(columns[::2], columns[1::2], strict=True):
            cells += [f"{psnr[i]:.1f}", f"{ssim[i]:.3f}"]
        print(f"| {' | '.join(cells)} |")


def _draw_slices(place: Any, btf: BTF, materials: Mapping[str, Material]) -> None:
    """Truth and codecs, from above and from a grazing view, with the PSNR of each slice."""
    shown = exposure(btf)
    every = place.subplots(2, 1 + len(materials))
    for row, pair in enumerate((_near(btf, (UP, (30.0, 45.0))), _near(btf, ((70.0, 270.0), (30.0, 45.0))))):
        truth = to_display(btf[pair], shown)
        pictures = {f"truth, θₒ = {float(to_degrees(btf.wo[pair])[0]):.0f}°": truth}
        for name, material in materials.items():
            ours = to_display(material.slice(*at(btf, pair)).numpy(), shown)
            pictures[f"{name}, {-10 * np.log10(np.square(ours - truth).mean()):.1f} dB"] = ours
        for axes, (name, picture) in zip(every[row], pictures.items(), strict=True):
            axes.imshow(picture, interpolation="nearest")
            axes.set_axis_off()
            axes.set_title(name, fontsize=LARGE)


DRAWINGS: dict[str, Callable[[Bench], None]] = {
    name.removeprefix("draw_"): function for name, function in globals().items() if name.startswith("draw_")
}


def main() -> None:
    """Draw the pictures that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(DRAWINGS)} (default: all)")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--keep", type=Path, required=True, help="a folder for the fitted files")
    chosen = parser.parse_args()
    for name in chosen.names:
        if name not in DRAWINGS:
            parser.error(f"no picture is named {name!r}{did_you_mean(name, DRAWINGS)}")
    chosen.keep.mkdir(parents=True, exist_ok=True)
    bench = Bench(chosen.out, chosen.keep)
    torch.set_num_threads(1)  # the bits of a fit depend on the number of threads
    with threadpool_limits(1):
        for name in chosen.names or DRAWINGS:
            DRAWINGS[name](bench)


if __name__ == "__main__":
    main()
