"""Numbers inside a decoder at the extremes: in its file, in its layers, in its gradients, in short floats.

These changes apply to any decoder: to the tensors of its file, and to the linear, norm and sine layers of its material.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from bench.codecs.encoding import fit_codec
from bench.conformance.check import CheckError
from bench.conformance.stress.case import Case, Measured, NotApplicable, Subject, Test, applicable, require
from bench.conformance.stress.data import SAME_RATIO, firefly, ordinary
from bench.conformance.stress.queries import UP, Queries, grazing, query_in_words, spread, with_directions
from bench.material import HALF_MAX, Material
from bench.metrics.display import display_error, exposure_of
from bench.metrics.psnr import psnr
from bench.training.decoder import Decoder

Kind = TypeVar("Kind", bound=nn.Module)

SHORT_FLOATS = {"fp16": torch.float16, "bf16": torch.bfloat16}
ARGUMENT = 1e5  # of sines: far beyond any that a network reaches
COMPARED = 1024  # queries that show what a short float costs
FINITE = "finite and not negative"


def scaled_texture(subject: Subject) -> Material:
    """The stored texture times 1e4; for a texture of eight bits, its scale and offset times 1e4."""
    stored = subject.parts.texture
    applicable(stored, "stores no texture")
    floats = {name: values.float() * 1e4 for name, values in stored.items() if values.is_floating_point()}
    applicable(floats, "stores only indices, and no other numbers, a texel")
    return subject.decode(dataclasses.replace(subject.parts, texture=stored | floats))


def largest_weights(subject: Subject) -> Material:
    """Every stored weight at half's maximum, its sign kept."""
    if subject.parts.network:  # shared over materials: its weights are in another file
        material = subject.decode(subject.parts)
        for network in material.modules():
            for weights in network.parameters():
                weights.data = weights.sign() * HALF_MAX
        return material
    stored = subject.parts.decoder
    floats = {name: values.sign() * HALF_MAX for name, values in stored.items() if values.is_floating_point()}
    applicable(floats, "stores no decoder")
    return subject.decode(dataclasses.replace(subject.parts, decoder=stored | floats))


def of_kind(material: Material, kind: type[Kind]) -> list[Kind]:
    """Every module of a kind, such as `nn.Linear`, in the networks of a material."""
    layers: list[Kind] = []
    for network in material.modules():
        layers += [layer for layer in network.modules() if isinstance(layer, kind)]
    return layers


@torch.no_grad()
def constant_vector(subject: Subject) -> Material:
    """Linear layers give the same number in every channel, so that layer norms divide by a deviation of 0."""
    material = subject.decode(subject.parts)
    applicable(of_kind(material, nn.LayerNorm), "has no layer norm")
    for layer in of_kind(material, nn.Linear):
        layer.weight.zero_()
        if layer.bias is not None:
            layer.bias.fill_(0.7)  # any number but 0
    return material


@torch.no_grad()
def large_arguments(subject: Subject) -> Material:
    """Sines of arguments up to ±1e5, through the bias of the layer right before them: a layer norm, or else linear."""
    material = subject.decode(subject.parts)
    decoders = [decoder for decoder in of_kind(material, Decoder) if decoder.architecture.activation == "sine"]
    applicable(decoders, "has no sine")
    for decoder in decoders:
        if decoder.norms is not None:
            before_sines = decoder.norms
        else:
            before_sines = decoder.layers[:-1]  # no sine follows the last layer
        largest_bias = ARGUMENT / decoder.architecture.omega  # a sine's argument is ω times its input
        for layer in before_sines:
            bias = layer.get_parameter("bias")
            bias.copy_(torch.linspace(-1, 1, len(bias)) * largest_bias)
    return material


@torch.no_grad()
def overflowing_level(subject: Subject) -> Material:
    """A last layer whose bias gives a log radiance of about 1,000, whose expm1 overflows a float."""
    material = subject.decode(subject.parts)
    applicable(material.modules(), "has no network")
    last = _answering(material)
    applicable(last.bias is not None, "its last layer has no bias")
    last.bias.fill_(1e3)  # of a log radiance: expm1 of a float32 overflows above 88
    return material


def _answering(material: Material) -> nn.Linear:
    """The linear layer that gives the radiance: the last one to run, whatever its position in the network."""
    ran: list[nn.Linear] = []
    layers = of_kind(material, nn.Linear)
    hooks = [layer.register_forward_hook(lambda layer, *_: ran.append(layer)) for layer in layers]
    material.query(*spread(1))  # each layer that it runs is noted in turn
    for hook in hooks:
        hook.remove()
    applicable(ran, "runs no linear layer")
    return ran[-1]


SPOILED: dict[str, Callable[[Subject], Material]] = {
    "stored texture × 1e4": scaled_texture,
    "weights at half's maximum": largest_weights,
    "layer norm of a constant vector": constant_vector,
    "sine of 1e5": large_arguments,
    "expm1 overflow": overflowing_level,
}


def random_and_grazing() -> Queries:
    """Random queries and grazing ones."""
    random = spread()
    low = spread(seed=1)._replace(wo=grazing(), wi=grazing(89.0))
    columns = [torch.cat([of_random, of_low]) for of_random, of_low in zip(random, low, strict=True)]
    return Queries(*columns)


def require_valid_answers(material: Material, queries: Queries, what: str = "") -> None:
    """Raise `CheckError` if an answer is negative or not finite; `what` begins its message."""
    answers = material.query(*queries)
    bad = ~(answers.isfinite() & (answers >= 0)).all(1)
    if bad.any():
        row = int(bad.nonzero()[0])
        fault = f"{what}{answers[row].tolist()} at {query_in_words(queries, row)}"
        if material.dtype == torch.float16:
            fault += f": a half overflows above {HALF_MAX:,.0f}: put `bench.material.saturated` around each layer"
        raise CheckError(fault, f"{int(bad.sum())} bad")


def spoiled(make: Callable[[Subject], Material], subject: Subject) -> None:
    """Check the answers of a material that was spoiled in one way."""
    require_valid_answers(make(subject), random_and_grazing())


def exact_sine(subject: Subject) -> None:
    """Check the answers, and the sine itself: float32 against float64 at the same arguments."""
    require_valid_answers(large_arguments(subject), random_and_grazing())
    arguments = torch.linspace(-ARGUMENT, ARGUMENT, 100_001)
    worst = float((arguments.sin().double() - arguments.double().sin()).abs().max())
    require(worst <= 2**-23, f"{worst:.1g}", f"the sine of arguments up to {ARGUMENT:g} is off by {worst:.3g}")


def short_float(subject: Subject, dtype: torch.dtype) -> Measured:
    """Check all answers in a short float; the figure is what it costs the ordinary material."""
    all_spoiled(subject, dtype)
    queries = spread(COMPARED, theta_max_deg=75.0)
    double = subject.decode(subject.parts).to(dtype=torch.float64).query(*queries)
    ours = subject.decode(subject.parts).to(dtype=dtype).query(*queries)
    return Measured(decibels(ours, double))


def decibels(ours: Tensor, exact: Tensor) -> str:
    """The display PSNR of answers (n, 3) against exact ones, in words."""
    truth, answers = exact.double().numpy(), ours.double().numpy()
    error = display_error(answers, truth, exposure_of(truth[None]))
    return f"{float(psnr(error, 1.0)):.0f} dB" if error else "exact"


def all_spoiled(subject: Subject, dtype: torch.dtype | None = None) -> None:
    """Check the answers of the ordinary material and of all spoiled ones, in another float type if one is given."""
    makes = {"ordinary": lambda subject: subject.decode(subject.parts), **SPOILED}
    for name, make in makes.items():
        try:
            material = make(subject)
        except NotApplicable:
            continue
        if dtype:
            material = material.to(dtype=dtype)
        require_valid_answers(material, random_and_grazing(), f"{name}: ")


def eight_bits(subject: Subject) -> None:
    """Try `all_spoiled` with the texture stored at eight bits, if the codec can."""
    applicable("bits" in vars(subject.tested.codec.settings), "cannot store a texture at eight bits")
    codec = subject.codec(bits=8)
    tested = dataclasses.replace(subject.tested, codec=codec)
    all_spoiled(Subject(tested, stored=fit_codec(codec, ordinary(), subject.fit()).parts))


def gradients_at_zero(subject: Subject) -> None:
    """Check that gradients of the answers are finite where every stored number and weight is 0 and views are straight
    from above."""
    material = subject.decode(subject.parts)
    leaves: list[Tensor] = []
    for network in material.modules():
        leaves += network.parameters()
    for name, value in vars(material).items():
        if isinstance(value, Tensor) and value.is_floating_point():  # a texture, perhaps stored in a shorter type
            setattr(material, name, torch.zeros_like(value.float()).requires_grad_())
            leaves.append(getattr(material, name))
    for leaf in leaves:
        leaf.data.zero_()
    queries = with_directions(wo=UP)()
    inputs = [column.clone().requires_grad_() for column in queries]
    material.evaluate(*inputs).sum().backward()
    for leaf in (*leaves, *inputs):
        if leaf.grad is not None:
            require(leaf.grad.isfinite().all(), "not finite", f"a gradient of shape {tuple(leaf.shape)} is not finite")


def trained_with_firefly(subject: Subject) -> Measured:
    """Measure by how many dB the PSNR of the other texels changes by a firefly; they must stay no worse than
    mean-colour."""
    others = np.ones(ordinary().shape, bool)
    others[3, 5] = False  # the texel of `firefly`
    encoded = subject.encode(firefly())
    plain = subject.usual
    truth = plain.truth[:, others]
    colours = np.broadcast_to(truth.mean(0), truth.shape)
    exposure = exposure_of(truth)
    of_mean_colours = display_error(colours, truth, exposure)
    before = display_error(plain.decoded[:, others], truth, exposure)
    after = display_error(encoded.decoded[:, others], truth, exposure)
    mean_colours_db, before_db, after_db = (float(psnr(error, 1.0)) for error in (of_mean_colours, before, after))
    require(
        after <= of_mean_colours * SAME_RATIO,
        f"{after_db:.1f} dB",
        f"the other texels have a PSNR of {after_db:.2f} dB, {mean_colours_db:.2f} dB as mean colours",
    )
    change = round(after_db - before_db, 1)
    return Measured(f"{change + 0.0:+.1f} dB")  # avoids −0.0


def case(name: str, test: Test, holds: str = FINITE, cheap: bool = True) -> Case:
    """A case of this group; see `Case`."""
    return Case("networks", name, holds, test, cheap)


CASES = (
    *(case(name, partial(spoiled, make)) for name, make in SPOILED.items() if make is not large_arguments),
    case("sine of 1e5", exact_sine, f"{FINITE}; the sine of a float within 2⁻²³"),
    case("gradients at exact zero", gradients_at_zero, "finite"),
    *(case(f"{name}, all of the above", partial(short_float, dtype=dtype)) for name, dtype in SHORT_FLOATS.items()),
    case("int8 texture, all of the above", eight_bits, cheap=False),
    case(
        "fitted with a firefly (reported)",
        trained_with_firefly,
        "the other texels no worse than mean-colour; by how much their PSNR changes is reported",
        cheap=False,
    ),
)
