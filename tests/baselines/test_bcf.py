from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from baselines import bc1
from baselines.bcf import BCF, BlockTexture, colours_of_blocks, lines
from bench.codec import Parts
from bench.directions import hemisphere
from tests.baselines.made import coded, normed_sines


def codec(**settings: Any) -> BCF:
    return BCF(**{"steps": 10, "batch": 256} | settings)


def oracle_block(data: bytes) -> np.ndarray:
    """The colours (4, 4, 3) of one block by the format's description, texel by texel."""
    words = [int.from_bytes(data[i : i + 2], "little") for i in (0, 2)]
    colours = []
    for word in words:
        r, g, b = word >> 11, (word >> 5) & 63, word & 31
        colours.append([(r << 3) | (r >> 2), (g << 2) | (g >> 4), (b << 3) | (b >> 2)])
    a, b = np.array(colours)
    four, three = [(2 * a + b + 1) // 3, (a + 2 * b + 1) // 3], [(a + b) // 2, 0 * a]
    palette = [a, b, *(four if words[0] > words[1] else three)]
    codes = int.from_bytes(data[4:], "little")
    return np.array([palette[(codes >> (2 * i)) & 3] for i in range(16)]).reshape(4, 4, 3)


def test_any_block_is_read_by_the_rules_of_the_format() -> None:
    blocks = torch.randint(0, 256, (500, 8), generator=torch.Generator().manual_seed(0)).to(torch.uint8)
    blocks[::50, 2:4] = blocks[::50, :2]  # equal colours
    found = bc1.read(blocks).reshape(-1, 4, 4, 3).numpy()
    np.testing.assert_array_equal(found, [oracle_block(bytes(block)) for block in blocks.numpy()])


def test_another_decoder_reads_the_same_colours() -> None:
    generator = torch.Generator().manual_seed(1)
    ends = torch.stack([torch.randint(0, 2**b, (64, 2), generator=generator) for b in bc1.BITS], -1)
    ends[:4, 1] = ends[:4, 0]
    steps = torch.randint(0, 4, (64, 16), generator=generator)
    data = bc1.write(ends, steps)
    theirs = np.asarray(Image.frombytes("RGBA", (32, 32), data.numpy().tobytes(), "bcn", (1, "")))
    ours = colours_of_blocks(data[:, None], (32, 32))[:, :, 0].numpy()
    assert (theirs[..., 3] == 255).all()  # no block falls into the mode of three colours and black
    # Pillow cuts thirds off where Direct3D's description rounds them.
    assert np.abs(theirs[..., :3].astype(int) - ours).max() <= 1
    assert np.abs(ours.std()) > 50


@pytest.mark.parametrize("size", [(8, 8), (5, 7), (1, 1), (3, 8)])
def test_the_fit_sees_what_the_file_gives_back(size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(0)
    texture = BlockTexture(torch.randn(*size, 6, generator=generator))
    with torch.no_grad():
        texture.ends += 0.1 * torch.randn(texture.ends.shape, generator=generator)
    seen = texture(as_stored=True)
    blocks, low, span = texture.stored()
    stored = low + span * (colours_of_blocks(blocks.reshape(-1, 2, 8), size).flatten(2) / 255)
    torch.testing.assert_close(stored, seen, rtol=0, atol=0)


def answer(parts: Parts, row: int, col: int, wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
    """Radiance (3,) at a texel's centre, from the tensors of a file of 8 × 8 texels, loop by loop."""
    latents = []
    blocks = parts.texture["latents.blocks"].numpy().reshape(2, 2, 8, 8)[row // 4, col // 4]
    for block in blocks:
        latents += list(oracle_block(bytes(block))[row % 4, col % 4])
    low, span = (parts.texture[f"latents.{name}"].double().numpy() for name in ("low", "span"))
    h = (wo + wi) / np.linalg.norm(wo + wi)
    x = np.concatenate([low + span * np.array(latents) / 255, wo, wi, h])
    x = normed_sines(x, parts.decoder["weights"], (32, 33), (32, 32), (32, 32), (3, 32))
    return np.expm1(x).clip(0) / float(parts.other["gain"])


def test_a_decoded_file_answers_as_the_equations() -> None:
    parts, material = coded(codec(steps=30, weights="float32"))
    wo, wi = hemisphere.from_degrees(50.0, 20.0), hemisphere.from_degrees(35.0, 140.0)
    found = material.slice(wo.tolist(), wi.tolist())
    for row, col in ((0, 0), (3, 5), (7, 2)):
        expected = answer(parts, row, col, wo.astype(float), wi.astype(float))
        # Float32 sums of some tens of terms.
        np.testing.assert_allclose(found[row, col], expected, rtol=2e-4, atol=1e-5)


def test_each_grid_has_its_blocks() -> None:
    """A texture at half the resolution has a quarter of the blocks."""
    parts, _ = coded(codec(textures=2, half=1, quarter=3, offset=8))
    blocks = {name.split(".")[0]: len(tensor) // 8 for name, tensor in parts.texture.items() if "blocks" in name}
    assert blocks == {"latents": 4 * 2, "latents2": 1, "latents4": 3, "offset": 1}  # of 8 × 8 texels


def test_the_first_ends_and_shares_lie_on_the_blocks_principal_axis() -> None:
    """Latents on a line are met exactly; the ends are those texels that lie farthest out."""
    along = torch.linspace(-2, 3, 16)
    axis = torch.tensor([0.6, 0.0, 0.8])
    ends, shares = lines((torch.tensor([1.0, 2.0, 3.0]) + along[:, None] * axis)[None, :, None])
    found = ends[0, :, None] + shares[..., None] * (ends[1] - ends[0])[:, None]
    torch.testing.assert_close(found[0, :, 0] - torch.tensor([1.0, 2.0, 3.0]), along[:, None] * axis)
    assert sorted([float(shares.min()), float(shares.max())]) == pytest.approx([0, 1], abs=1e-5)
