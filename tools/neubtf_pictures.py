"""Every picture of docs/neubtf.md, and the figures beside them.

    python tools/neubtf_pictures.py --out docs/images --keep FOLDER [NAME ...]

`--keep` holds the fitted files, which are not fitted again: NeuBTF on the upper left quarter of 256² texels of brick,
gravel, satin and wool (measured, `$NEUBTF_DATA`), by the paper's recipe and in some minutes; and at 64² and with 2,500
steps, what fails on cable-knit. By the paper's recipe a quarter takes an hour and a half of a core. NAMEs choose among
the pictures; by default all are drawn. Prints the figures that the page quotes.
"""

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

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
from bench.codecs.registry import load_codec
from bench.data.materials.maps import resize
from bench.data.open import open_material
from bench.data.spec import Preparation, named
from bench.demand import still
from bench.demand.scene import named_scene
from bench.directions.hemisphere import from_degrees, to_degrees
from bench.inputs.errors import did_you_mean
from bench.material import Material
from bench.metrics import DEFAULTS, chosen_names, metric_of
from bench.metrics.angular import RINGS, THETA_EDGES_DEG
from bench.metrics.display import decode_srgb, encode_srgb, exposure, to_display
from bench.metrics.psnr import psnr
from bench.metrics.scoring import Scorer
from bench.records import SSIM
from bench.training import load_texture
from neubtf import latents, propagation
from neubtf.codec import NeuBTF
from neubtf.guidance import RADIANCE, Treatment, guidance_of
from neubtf.propagation import FittedMaterial
from neubtf.renderer import Decoded
from neubtf.seam import seam_of

Array = np.ndarray
SIZE = 256
SMALL = 64  # of cable-knit, which `draw_failure` fits whole
LARGE = 13  # points of text that a telephone shows, too
FAILING = "cable-knit"
CUT = 210  # texels a side of the photographs from which the built-in reliefs were made
UP = (0.0, 0.0)  # θ and φ in degrees
PAIRS = ((UP, UP), (UP, (45.0, 0.0)), (UP, (60.0, 135.0)), ((45.0, 270.0), (45.0, 90.0)))  # view, light
EDITED = ((UP, UP), (UP, (30.0, 90.0)), (UP, (55.0, 135.0)))
SCALES = (3 / 4, 1 / 2, 1 / 4)
SEEN_FROM = 3 / 4  # the least scale that a fit by the paper's recipe sees
BLENDED = 1 / 6  # of each side, so that a picture is tileable
DRAPE_WIDTH = 320  # pixels
PAPER: dict[str, Any] = {"recipe": "paper"}
# End to end from the first step, on single samples alone: the way to a useful encoder in some minutes of one core.
BRIEF: dict[str, Any] = {"steps": 1800, "direct": 0.0, "taught": 0.0, "explore": 0.1}
FITS = {"paper": "the paper's\nrecipe", "brief": "short fit"}  # by kind of fit: what pictures call it
SETTINGS: dict[str, dict[str, Any]] = {"paper": PAPER, "brief": BRIEF}  # by kind of fit, which is in the file's name
MOST_PAIRS = 150  # held-out pairs over which a figure is a mean


class Bench:
    """The materials, their fits, and where pictures go."""

    def __init__(self, out: Path, keep: Path):
        self.out, self.keep = out, keep

    def btf(self, name: str, size: int = SIZE) -> BTF:
        """A material with validation pairs; of a measured one about 1,000 pairs."""
        return open_material(named(name), Preparation(size=size, texels=size, pairs=1_000, split="validation"), silent)

    def quarter(self, name: str, kind: str = "paper", size: int = SIZE) -> FittedMaterial:
        """NeuBTF, fitted to the upper left quarter of a material, which is not periodic, by one of `SETTINGS`."""
        btf = self.btf(name, size)
        part = btf.subset(btf.split().train).crop(0, 0, btf.shape[0] // 2, btf.shape[1] // 2)
        codec = NeuBTF(keep_encoder=True, **SETTINGS[kind])
        return FittedMaterial.read(self.file(part, codec, Path(name).name, kind))

    def file(self, btf: BTF, codec: Codec, name: str, kind: str) -> Path:
        """The file of a fit, kept from an earlier time if it has the same size, settings and version."""
        path = self.keep / f"{name}-{kind}-{btf.shape[0]}-{codec.name}.nbtf"
        if path.exists():
            header = container.read_header(path)
            settings = settings_dict(codec)
            if header.settings == settings and header.version == codec.version_of(settings):
                return path
        container.save(path, codec, codec.encode(btf, Fit()))
        return path

    def save(self, figure: Figure, name: str) -> None:
        """Write a figure as `neubtf-NAME`, JPEG or PNG by its ending, and print its size."""
        path = self.out / f"neubtf-{name}"
        options = {"pil_kwargs": {"quality": 78, "optimize": True}} if path.suffix == ".jpg" else {}
        figure.savefig(path, dpi=100, **options)
        print(f"wrote {path}: {path.stat().st_size / 1e3:.0f} kB")


def heldout(btf: BTF) -> Array:
    """At most `MOST_PAIRS` of the held-out pairs, validation or test, evenly spread."""
    pairs = np.sort(np.concatenate([*btf.split().heldout.values()]))
    return pairs[:: math.ceil(len(pairs) / MOST_PAIRS)]


def guided(source: FittedMaterial, picture: Array, treatment: Treatment) -> Decoded:
    """The material of a fit with the texture that a linear picture (H, W, 3) gives."""
    image, _ = guidance_of(picture, treatment, source.guidance, source.exposure)
    codec, parts = source.guided(propagation.textured(source.encoder, image))
    material = codec.decode(parts, torch.device("cpu"))
    assert isinstance(material, Decoded)
    return material


def frontal(btf: BTF) -> Array:
    """What a photograph with a flash shows, linear (H, W, 3)."""
    trained = btf.subset(btf.split().train)
    return btf[int((trained.wo[:, 2] + trained.wi[:, 2]).argmax())]


def psnr_of_parts(btf: BTF, material: Decoded) -> list[float]:
    """Pooled display PSNR in dB: of the quarter that was seen, of the rest, and, on the rest, of the mean ABRDF of the
    quarter."""
    shown = exposure(btf)
    seen = np.zeros(btf.shape, bool)
    seen[: btf.shape[0] // 2, : btf.shape[1] // 2] = True
    errors = []
    for pair in heldout(btf):
        radiance = btf[pair]
        truth = to_display(radiance, shown)
        mean = to_display(radiance[seen].mean(0), shown)
        error = np.square(to_display(decoded(material, btf, pair), shown) - truth)
        errors.append([error[seen].mean(), error[~seen].mean(), np.square(truth[~seen] - mean).mean()])
    return pooled(errors)


def pooled(errors: Sequence[Sequence[float]]) -> list[float]:
    """The PSNR in dB of each column's mean; a row has the mean squared errors of one pair."""
    return list(map(float, psnr(np.mean(errors, 0))))


def decoded(material: Material, btf: BTF, pair: int) -> Array:
    """The slice (H, W, 3) of a material, linear, at a pair of a BTF."""
    return material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist()).numpy()


def direction(angles: tuple[float, float]) -> list[float]:
    """The unit vector (3,) of θ and φ in degrees."""
    return list(map(float, from_degrees(*angles)))


def shot(material: Material, pair: Any, shown: float) -> Array:
    """A slice of a material as it is displayed, (H, W, 3), at a view and a light in degrees."""
    wo, wi = pair
    return to_display(material.slice(direction(wo), direction(wi)).numpy(), shown)


def shots(source: FittedMaterial, picture: Array, treatment: Treatment, pairs: Sequence[Any]) -> list[Array]:
    """A linear picture (H, W, 3) as guidance shows it, and the slices at some pairs of the material that it gives."""
    material = guided(source, picture, treatment)
    guidance = encode_srgb(resize(picture, material.size))
    return [guidance, *(shot(material, pair, source.exposure) for pair in pairs)]


def grey(values: Array) -> Array:
    """A picture (H, W) of one linear value a texel as one of three equal channels, (H, W, 3)."""
    return np.repeat(values[..., None], 3, 2).astype(np.float32)


def lit_from(pair: Any) -> str:
    """View and light of a pair of angles in words; the view is left out if it is from above."""
    (view, _), (light, azimuth) = pair
    words = f"lit from {light:g}°"
    if light:
        words += f", φ {azimuth:g}°"
    return f"seen from {view:g}°,\n{words}" if view else words


def grid(rows: Sequence[Sequence[Array]], titles: Sequence[str], names: Sequence[str], side: float = 1.9) -> Figure:
    """Pictures in rows and columns, each `side` inches wide, with titles above and names beside."""
    pixels_high, pixels_wide, _ = rows[0][0].shape
    line = LARGE / 27  # inches
    lines = 1 + max(title.count("\n") for title in titles)
    width = side * len(titles) + line
    height = side * pixels_high / pixels_wide * len(rows) + lines * line
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0, hspace=0)  # type: ignore[union-attr]
    every: Any = figure.subplots(len(rows), len(titles), squeeze=False)
    for axes_row, pictures, name in zip(every, rows, names, strict=True):
        for axes, picture in zip(axes_row, pictures, strict=True):
            axes.imshow(picture, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        axes_row[0].set_ylabel(name, fontsize=LARGE)
    for axes, title in zip(every[0], titles, strict=True):
        axes.set_title(title, fontsize=LARGE)
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
            told = " | ".join(f"{value:.2f}" for value in psnr_of_parts(btf, material))
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
                row.append(to_display(decoded(material, btf, pair), shown))
        rows.append(row)
    titles = ["guidance", "truth,\nlit aslant", *FITS.values(), "truth,\nseen aslant", *FITS.values()]
    figure = grid(rows, titles, labels)
    middle = SIZE / 2 - 0.5
    for axes in figure.axes:  # two sides of the quarter
        dashed = {"color": "white", "linewidth": 0.8, "linestyle": (0, (3, 3))}
        axes.plot([middle, middle, -0.5], [-0.5, middle, middle], **dashed)
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
        picture = grey(decode_srgb(photograph / 255))
        for kind, recipe in FITS.items():
            pictures = shots(bench.quarter("gravel", kind), picture, Treatment(scale=SIZE / CUT), PAIRS[:3])
            rows.append([each[:200, :300] for each in pictures])
            names.append(f"{what},\n{recipe}")
    titles = ["photograph,\na part", *map(lit_from, PAIRS[:3])]
    bench.save(grid(rows, titles, names, 2.4), "photograph.jpg")


def draw_tileable(bench: Bench) -> None:
    """Four copies side by side, of a guidance as it is, and of one that was blended."""
    source = bench.quarter("gravel")
    picture = grey(decode_srgb(data.gravel()[100:330, 240:470] / 255))
    pairs = np.array([[direction(wo), direction(wi)] for wo, wi in PAIRS])
    row, titles = [], []
    for margin, name in ((0.0, "as it is"), (BLENDED, "--make-tileable")):
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
    bench.save(grid([[picture[:least, :least] for picture in row]], titles, [""], 3.4), "tileable.jpg")


class Edit(NamedTuple):
    """A structure that a material never had, a linear picture (H, W), and what the two are called."""

    name: str
    structure: Array
    what: str


def edits() -> list[Edit]:
    """A drawing, a weaver's draft and a photograph, each for one material."""
    coins = decode_srgb(data.coins()[2:162, 10:210] / 255)
    return [
        Edit("brick", hexagons(side=52, joint=6), "a drawing,\nas brick"),
        Edit("satin", jacquard(thread=26)[:160, :200], "a draft,\nas satin"),
        Edit("gravel", coins, "coins,\nas gravel"),
    ]


def draw_edits(bench: Bench) -> None:
    """Structures that the materials never had."""
    rows, names = [], []
    for name, structure, what in edits():
        for kind, recipe in FITS.items():
            rows.append(shots(bench.quarter(name, kind), grey(structure), Treatment(), EDITED))
            names.append(f"{what},\n{recipe}")
    bench.save(grid(rows, ["guidance", *map(lit_from, EDITED)], names, 2.3), "edits.jpg")


def draw_drape(bench: Bench) -> None:
    """The same structures, tileable, on a cloth over a ball."""
    scene = still.changed(named_scene("drape"), "environment", 0.5, DRAPE_WIDTH)
    rows = []
    for kind in FITS:
        pictures = []
        for edit in edits():
            material = guided(bench.quarter(edit.name, kind), grey(edit.structure), Treatment(margin=BLENDED))
            (picture,) = still.render(scene, [still.of_material(material)], rays=3)
            pictures.append(on_white(picture))
        rows.append(pictures)
    bench.save(grid(rows, [edit.what for edit in edits()], [*FITS.values()], 3.2), "drape.jpg")


def on_white(picture: Array) -> Array:
    """The rows that show the surface of a rendered picture (H, W, 4), linear, as they are displayed on white."""
    picture = picture[picture[..., 3].any(1)]
    share = picture[..., 3:]
    surface = picture[..., :3] / np.maximum(share, 1e-6)
    return share * to_display(surface, still.exposure_for(picture)) + 1 - share


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


def draw_detail(bench: Bench) -> None:
    """Smaller guidance, and smaller pictures, at scales that a fit by the paper's recipe has seen and has not."""
    btf = bench.btf("brick")
    shown = exposure(btf)
    scaled = at_scales(bench.quarter("brick"))
    rows, names = [], []
    for scale in SCALES:
        rows.append(triptych(btf, _near(btf, PAIRS[1]), scaled[1], scaled[scale], shown))
        names.append(f"{scale:g},\n{'seen' if scale >= SEEN_FROM else 'not seen'}")
    bench.save(grid(rows, ["truth↓", "R(A(G))↓", "R(A(G↓))"], names, 2.6), "detail.jpg")
    for name in ("brick", "satin"):
        print_levels(name, bench.btf(name), at_scales(bench.quarter(name)))


def at_scales(source: FittedMaterial) -> dict[float, Decoded]:
    """The material of a fit by its own guidance, whole and at `SCALES`."""
    own = decode_srgb(source.guidance.numpy() / 255).astype(np.float32)
    return {scale: guided(source, own, Treatment(scale=scale, exposure="1")) for scale in (1, *SCALES)}


def triptych(btf: BTF, pair: int, whole: Decoded, small: Decoded, shown: float) -> list[Array]:
    """A slice of the quarter of a BTF that was fitted, of the material that it gave, and of that of smaller guidance,
    all as displayed at the size of the last."""
    rows, columns = whole.size
    truth = resize(btf[pair][:rows, :columns], small.size)
    after = resize(decoded(whole, btf, pair), small.size)
    return [to_display(picture, shown) for picture in (truth, after, decoded(small, btf, pair))]


def print_levels(name: str, btf: BTF, scaled: Mapping[float, Decoded]) -> None:
    """Print a table of display PSNR in dB at each scale, pooled over a third of the held-out pairs."""
    print(f"{name}:\n| scale | R(A(G↓)) to R(A(G))↓ | R(A(G↓)) to truth↓ | R(A(G))↓ to truth↓ |\n|" + " --- |" * 4)
    shown = exposure(btf)
    for scale in SCALES:
        errors = []
        for pair in heldout(btf)[::3]:
            truth, after, before = triptych(btf, pair, scaled[1], scaled[scale], shown)
            differences = (before - after, before - truth, after - truth)
            errors.append([np.square(difference).mean() for difference in differences])
        decibels = " | ".join(f"{value:.1f}" for value in pooled(errors))
        print(f"| {scale:g} | {decibels} |", flush=True)


def draw_latents(bench: Bench) -> None:
    """The channels of two neural textures, as `neubtf-bench latents` draws them."""
    for name in ("brick", "satin"):
        texture = load_texture("latents", bench.quarter(name).parts.texture)
        latents.draw(texture, bench.out / f"neubtf-latents-{name}.png")


def draw_failure(bench: Bench) -> None:
    """Relief so strong that it hides itself: NeuBTF without parallax and with an offset, and NeuMIP, which has one."""
    btf = bench.btf(FAILING, SMALL)
    codecs = {
        "neubtf": NeuBTF(steps=2_500),
        "neubtf, offset=32": NeuBTF(steps=2_500, offset=32),
        "neumip": load_codec("neumip")(steps=2_500),
    }
    files = {}
    for number, (name, codec) in enumerate(codecs.items()):  # a file for each, also of two fits by one codec
        files[name] = bench.file(btf.subset(btf.split().train), codec, FAILING, f"{SMALL}-{number}")
    materials = {name: loading.load(path).material for name, path in files.items()}
    by_ring = {name: _by_ring(btf, material) for name, material in materials.items()}
    _print_rings(by_ring)
    figure = Figure(figsize=(10.6, 9), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 2])
    sizes = {name: path.stat().st_size for name, path in files.items()}
    _draw_rings(top, {f"{name}, {sizes[name] / 1e3:.0f} kB": rings for name, rings in by_ring.items()})
    _draw_slices(bottom, btf, materials)
    bench.save(figure, "failure.png")


class Ring(NamedTuple):
    """What a codec reaches at the held-out pairs whose view lies in a ring of 15°."""

    pairs: int
    psnr: float  # in dB, as displayed, pooled
    ssim: float  # mean


def _by_ring(btf: BTF, material: Material) -> list[Ring]:
    """What a material reaches in each ring of views, from above to the horizon."""
    pairs = heldout(btf)
    number = np.digitize(to_degrees(btf.wo[pairs])[0], THETA_EDGES_DEG[1:-1])  # of each pair's ring
    ssim = metric_of(chosen_names(DEFAULTS, btf.periodic), SSIM)
    scorer = Scorer(btf, ["psnr_display", ssim], threads=1)
    raw = scorer.score(pairs, lambda pair: decoded(material, btf, pair)).raw
    rings = []
    for ring in range(RINGS - 1):  # no views lie in the last one
        inside = number == ring
        decibels = float(psnr(raw["psnr_display"][inside].mean()))
        rings.append(Ring(int(inside.sum()), decibels, float(raw[ssim][inside].mean())))
    return rings


def _draw_rings(place: Any, by_label: Mapping[str, Sequence[Ring]]) -> None:
    """Draw two panels, PSNR and SSIM by angle of view, with a curve for each of three codecs."""
    panels: Any = place.subplots(1, 2)
    for axes, what, field in zip(panels, ("display PSNR, dB", "SSIM"), ("psnr", "ssim"), strict=True):
        for (label, rings), style in zip(by_label.items(), ("o-", "s--", "^:"), strict=True):
            axes.plot(np.arange(len(rings)) * 15 + 7.5, [getattr(ring, field) for ring in rings], style, label=label)
        axes.set_xlabel("angle of view θₒ in degrees", fontsize=LARGE)
        axes.set_title(what, fontsize=LARGE)
        axes.set_xticks(range(0, 76, 15))
        axes.tick_params(labelsize=LARGE)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    panels[1].legend(frameon=False, fontsize=LARGE)


def _print_rings(by_codec: Mapping[str, Sequence[Ring]]) -> None:
    """Print a table of PSNR and SSIM by angle of view, two columns a codec."""
    print("| θₒ in degrees | pairs | " + " | ".join(f"{name}, dB | SSIM" for name in by_codec) + " |")
    print("|" + " --- |" * (2 + 2 * len(by_codec)))
    for number, of_codecs in enumerate(zip(*by_codec.values(), strict=True)):
        cells = [f"{15 * number}–{15 * number + 15}", str(of_codecs[0].pairs)]
        for ring in of_codecs:
            cells += [f"{ring.psnr:.1f}", f"{ring.ssim:.3f}"]
        print(f"| {' | '.join(cells)} |")


def _draw_slices(place: Any, btf: BTF, materials: Mapping[str, Material]) -> None:
    """Truth and codecs, from above and from a grazing view, with the PSNR of each slice."""
    shown = exposure(btf)
    every = place.subplots(2, 1 + len(materials))
    from_above, grazing = (UP, (30.0, 45.0)), ((70.0, 270.0), (30.0, 45.0))
    for row, angles in enumerate((from_above, grazing)):
        pair = _near(btf, angles)
        truth = to_display(btf[pair], shown)
        pictures = {f"truth, θₒ = {float(to_degrees(btf.wo[pair])[0]):.0f}°": truth}
        for name, material in materials.items():
            ours = to_display(decoded(material, btf, pair), shown)
            pictures[f"{name}, {psnr(np.square(ours - truth).mean()):.1f} dB"] = ours
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
