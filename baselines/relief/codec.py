"""Relief: the height of the surface, found in the training slices and marched at decoding, under a neural texture.

Every published neural texture blurs a texel over the places where its views saw it. Here a plane sweep first finds the
height of each texel; latents then belong to surface points, and the network learns only their reflectance. A height
that fails the test on other views is not written. See docs/relief.md.
"""

from dataclasses import dataclass
from typing import Annotated

import torch

from baselines.pyramids import fitted_levels, level_count
from baselines.relief import sweep
from baselines.relief.fitting import HIGHEST, ReliefObjective
from baselines.relief.geometry import Surface, restored, stepped
from baselines.relief.material import Network, ReliefMaterial
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.settings import Layers, Natural, Positive, Range, Width
from bench.material import Material
from bench.training import Loss, Samples, TextureSettings, compress, expand, gain_of, load_texture, train
from bench.training.decoder import load_network, store_network


class Relief(Codec):
    """Relief: heights found in the slices and marched, latents of few bits, directions in learned shading frames."""

    name, version = "relief", 3
    sizes = ("latents", "width")

    @dataclass(frozen=True)
    class Settings(TextureSettings):
        steps: Natural = 2_600  # steps of the fit
        latents: Width = 14  # channels of the neural texture
        bits: Annotated[int, Range(0, 8)] = 0  # bits of a stored latent on average; 0: as few as add little error
        layers: Layers = 3  # hidden layers of the network
        width: Width = 32  # channels of each hidden layer
        omega: Positive = 2.0  # frequency of the sine
        relief: bool = True  # look for a height; it is written only if the slices show one
        frames: bool = True  # turn the directions into two learned shading frames
        refine: bool = True  # refine the height in the second half of the fit
        shadow: bool = True  # also march toward the light, if there is a height
        latent_rate: Positive = 1e-2  # highest learning rate of the latents
        loss: Loss = "both"  # error of log radiance: absolute, squared, or their sum

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        gain = gain_of(btf, fit)
        levels = Samples.levels(btf, fitted_levels(btf, fit, level_count(btf.shape)), gain, fit)
        swept = sweep.find(btf, gain, fit) if self.settings.relief else None
        height = swept.height if swept is not None and swept.stands else None
        fitting = ReliefObjective(levels, height, self.settings, fit)
        train(fitting, fit, self.settings.steps)
        rounding = fitting.rounding
        codes = compress(rounding.codes(fitting.latents).unflatten(0, btf.shape), rounding.bits.tolist())
        texture = {"latents": codes, "low": rounding.low, "step": rounding.step}
        if fitting.height is not None:
            codes, extent, _ = stepped(fitting.height.detach().cpu())
            bits = max(1, int(codes.max()).bit_length())
            texture |= {"height": compress(codes[..., None], [bits]), "height.range": extent}
        other = {"gain": torch.tensor([gain]), "size": torch.tensor(btf.shape, dtype=torch.int32)}
        return Parts(store_network(fitting.network, self.settings.weights), texture, other=other)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        height, width = parts.other["size"].tolist()
        surface = None
        if "height" in parts.texture:
            codes = expand(parts.texture["height"], (height, width, 1))[..., 0]
            # Larger heights are from an altered file, but a search through them must still end.
            surface = Surface(restored(codes, parts.texture["height.range"]).nan_to_num(0).clamp(-HIGHEST, HIGHEST))
        network = load_network(Network(self.settings, surface is not None), parts.decoder)
        steps = {f"latents.{name}": parts.texture[name] for name in ("low", "step")}
        latents = load_texture("latents", {**parts.texture, **steps, "latents.size": parts.other["size"]})
        gain = float(parts.other["gain"])
        return ReliefMaterial(network, (height, width), latents.flatten(0, 1), surface, gain).to(device)
