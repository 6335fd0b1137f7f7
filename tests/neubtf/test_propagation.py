import subprocess
import sys
from pathlib import Path

import numpy as np
import png
import pytest
import torch
from PIL import Image
from torch import Tensor

import bench
from bench import cli
from bench.codec import Fit
from bench.codecs import container, loading
from bench.conformance.check import tiny_btf
from bench.data.readers import open_btf
from bench.files.exr import write_exr
from bench.material import parameters
from neubtf.autoencoder import FAINT, Autoencoder, Encoder, as_guidance
from neubtf.codec import NeuBTF
from neubtf.direct import NeuBTFDirect
from neubtf.propagation import FittedMaterial, textured

ROUNDING = 1e-5  # float32 sums in another order
SIZE = 12


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A material of codec neubtf, barely fitted, with its encoder."""
    path = tmp_path_factory.mktemp("propagation") / "tiny.nbtf"
    codec = NeuBTF(steps=20, batch=256, keep_encoder=True, bits=32)
    container.save(path, codec, codec.encode(tiny_btf(SIZE), Fit()))
    return path


@pytest.fixture
def own(file: Path, tmp_path: Path) -> Path:
    path = tmp_path / "own.png"
    Image.fromarray(FittedMaterial.read(file).guidance.numpy()).save(path)
    return path


def propagate(file: Path, picture: Path, out: Path, *words: str) -> int:
    return cli.main(["propagate", str(file), "--guidance", str(picture), "-o", str(out), *words])


@pytest.mark.long
def test_a_photograph_of_2000_texels_a_side_takes_at_most_a_gigabyte_and_a_half(file: Path, tmp_path: Path) -> None:
    """The paper's own size. The process tells its seconds and its memory at the peak; docs/neubtf.md has both."""
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (2000, 2000, 3), np.uint8)).save(tmp_path / "large.png")
    words = ["propagate", str(file), "--guidance", str(tmp_path / "large.png"), "-o", str(tmp_path / "large.nbtf")]
    told = """
import sys, time
import torch
from bench import cli
from bench.machine.memory import peak_bytes
start = time.process_time()
code = cli.main(sys.argv[1:])
peak = (peak_bytes(torch.device("cpu")) or 0) / 2**20  # of this process alone, unlike `getrusage`
print(f"{time.process_time() - start:.0f} processor seconds, {peak:.0f} MiB")
sys.exit(code or (peak > 1536))
"""
    done = subprocess.run([sys.executable, "-c", told, *words], capture_output=True, text=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert loading.load(tmp_path / "large.nbtf").material.size == (2000, 2000)


def picture(height: int, width: int) -> Tensor:
    return torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(2))


@torch.no_grad()
@pytest.mark.parametrize("size", [(96, 160), (97, 66), (3, 3), (1, 130)])
def test_tiles_give_what_the_whole_gives(size: tuple[int, int]) -> None:
    encoder = Encoder(Autoencoder(14, torch.Generator().manual_seed(1)), 0.4, 0.2)
    encoder.autoencoder.head.weight.div_(FAINT)  # stronger than a fitted texture, so that rounding counts
    guidance = picture(*size)
    whole = encoder(guidance)[0].movedim(0, -1)
    assert whole.std() > 0.5
    torch.testing.assert_close(textured(encoder, guidance, tile=32), whole, rtol=0, atol=ROUNDING)


def test_its_own_guidance_gives_the_same_material(file: Path, own: Path, tmp_path: Path) -> None:
    out, twin = tmp_path / "again.nbtf", tmp_path / "twin.nbtf"
    assert (propagate(file, own, out), propagate(file, own, twin)) == (0, 0)
    assert out.read_bytes() == twin.read_bytes()
    ours, theirs = (container.read_parts(path)[1] for path in (out, file))
    torch.testing.assert_close(ours.texture["latents"], theirs.texture["latents"], rtol=0, atol=ROUNDING)
    assert ours.decoder["weights"].equal(theirs.decoder["weights"])
    assert ours.encoder == {}


@pytest.mark.long
@pytest.mark.parametrize(
    "settings", [{}, {"offset": 32}, {"recipe": "paper", "crop": 16}], ids=["ours", "offset", "paper"]
)
def test_a_grey_copy_of_the_own_guidance_guides_within_a_decibel(settings: dict, tmp_path: Path, capsys) -> None:
    """Without random saturation it loses 6 dB by our recipe and 7 by the paper's."""
    btf = bench.open("satin", size=64, directions="ubo2003", views=25, lights=25, heldout=150, split="validation")
    file, grey, out = (tmp_path / name for name in ("satin.nbtf", "grey.png", "grey.nbtf"))
    bench.encode(btf, "neubtf", file, steps=600, keep_encoder=True, **settings)
    Image.fromarray(FittedMaterial.read(file).guidance.numpy()).convert("L").save(grey)
    assert propagate(file, grey, out) == 0
    own, copy = (bench.score(path, btf)["scores"]["heldout"]["metrics"]["psnr_display"]["mean"] for path in (file, out))
    assert copy > own - 1


def test_the_new_file_is_a_material_like_any_other(file: Path, tmp_path: Path, capsys) -> None:
    codes = np.random.default_rng(0).integers(0, 256, (20, 31, 3), np.uint8)
    Image.fromarray(codes).save(tmp_path / "large.png")
    out = tmp_path / "new.nbtf"
    assert propagate(file, tmp_path / "large.png", out) == 0
    assert "seam" in capsys.readouterr().out
    header, material, _ = loading.load(out)
    assert (header.codec, header.settings["keep_encoder"]) == ("neubtf", False)
    assert material.size == (20, 31)
    assert (parameters(material), material.cost.texture_channels) == (3171, 14)
    assert header.provenance["file_sha256"] == container.read_header(file).sha256
    assert header.provenance["guidance"] == "large.png"
    assert header.provenance["guidance_pixels"] == "31 x 20"
    assert cli.main(["info", str(out)]) == 0
    assert "large.png" in capsys.readouterr().out
    assert cli.main(["decode", str(out), "--count", "2", "-o", str(tmp_path / "slices")]) == 0
    assert open_btf(tmp_path / "slices").shape == (20, 31)


def save_deep(path: Path, codes: np.ndarray) -> None:
    height, width, planes = codes.shape
    with open(path, "wb") as stream:
        writer = png.Writer(width, height, bitdepth=16, greyscale=planes < 3, alpha=planes in (2, 4))
        writer.write(stream, codes.reshape(height, -1))


@pytest.mark.parametrize("kind", ["RGB", "RGBA", "L", "LA", "P", "1", "16 bits", "16 bits and alpha", "exr"])
def test_pictures_of_every_kind_guide(file: Path, tmp_path: Path, kind: str) -> None:
    codes = np.random.default_rng(0).integers(0, 256, (9, 8, 4), np.uint8)
    path = tmp_path / "picture"
    if kind == "exr":
        path = path.with_suffix(".exr")
        write_exr(path, codes[..., :3].astype(np.float32) / 99)
    elif kind.startswith("16"):
        save_deep(path, codes[..., : 4 if "alpha" in kind else 3].astype(np.uint16) * 257)
    else:
        Image.fromarray(codes).convert("RGB" if kind in ("P", "1") else "RGBA").convert(kind).save(path, "png")
    assert propagate(file, path, tmp_path / "new.nbtf") == 0
    assert loading.load(tmp_path / "new.nbtf")[1].size == (9, 8)


def test_what_is_too_large_is_refused_with_a_scale_that_fits(file: Path, tmp_path: Path, capsys) -> None:
    Image.new("1", (8192, 4096)).save(tmp_path / "wide.png")
    assert propagate(file, tmp_path / "wide.png", tmp_path / "new.nbtf") == 2
    told = capsys.readouterr().err
    assert "8192 × 4096" in told
    scale = float(told.split("--scale ")[1])
    assert 0.9 * (1 << 24) < round(8192 * scale) * round(4096 * scale) <= 1 << 24
    assert not (tmp_path / "new.nbtf").exists()


@pytest.mark.parametrize(
    ("codec", "told"),
    [(NeuBTF(steps=1), "keep_encoder=true"), (NeuBTFDirect(steps=1), "codec is neubtf-direct: only neubtf")],
)
def test_a_file_without_autoencoder_is_refused(
    codec: NeuBTF | NeuBTFDirect, told: str, own: Path, tmp_path: Path, capsys
) -> None:
    path = tmp_path / "bare.nbtf"
    container.save(path, codec, codec.encode(tiny_btf(SIZE), Fit()))
    assert propagate(path, own, tmp_path / "new.nbtf") == 2
    assert told in capsys.readouterr().err


def test_bad_paths_and_pictures_are_refused(file: Path, own: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "text.png").write_text("no picture at all")
    for picture, out, told in (
        (tmp_path / "none.png", tmp_path / "new", "none.png: "),
        (tmp_path / "text.png", tmp_path / "new", "text.png: "),
        (own, tmp_path / "nowhere" / "new", "nowhere"),
        (own, file, f"{file.name}: "),
    ):
        assert propagate(file, picture, out) == 2
        assert told in capsys.readouterr().err
    for out in (tmp_path / "new", file):  # one of them is there
        assert propagate(tmp_path / "none.nbtf", own, out) == 2
        assert "none.nbtf: " in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("--scale", "0"),
        ("--scale", "1e308"),
        ("--make-tileable", "0.6"),
        ("--exposure", "bright"),
        ("--device", "no-device"),
    ],
)
def test_settings_without_sense_are_refused(file: Path, own: Path, tmp_path: Path, words: tuple[str, str], capsys):
    assert propagate(file, own, tmp_path / "new", *words) == 2
    assert words[0] in capsys.readouterr().err


def test_a_repeated_guidance_repeats_the_texture(file: Path, tmp_path: Path) -> None:
    source = FittedMaterial.read(file)
    twice = as_guidance(source.guidance.repeat(2, 3, 1))
    once = textured(source.encoder, as_guidance(source.guidance))
    torch.testing.assert_close(textured(source.encoder, twice), once.repeat(2, 3, 1), rtol=0, atol=ROUNDING)
