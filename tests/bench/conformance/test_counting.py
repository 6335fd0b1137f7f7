"""Every number that a decoder needs is counted once, whatever holds it, and a wrong declaration is named."""

import re

import pytest
import torch
from torch import nn

from baselines.mean_colour import MeanColourMaterial
from bench.codec import Parts
from bench.conformance.counting import constant_bytes, decoder_floats, fault, texture_channels
from bench.material import DecoderCost, layers, parameters

TEXTURE = torch.rand(8, 8, 3)


def holding(cost, **held):
    material = MeanColourMaterial(TEXTURE)
    material.cost = DecoderCost(texture_channels=3, texture_floats=TEXTURE.numel(), **cost)
    for name, value in held.items():
        setattr(material, name, value)
    return material


def file_of(decoder):
    return Parts(decoder=decoder, texture={"mean": TEXTURE})


def network():
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(9, 16), nn.Linear(16, 16), nn.Linear(16, 16), nn.Linear(16, 3))


def tied():
    net = network()
    net[2].weight = net[1].weight
    return net


def test_a_layer_that_shares_its_weights_has_its_bias_alone():
    material = holding({"parameters": 499}, net=tied())
    assert [count for _, _, count in layers(material)] == [160, 272, 16, 51]
    stored = {name: values.clone() for name, values in tied().state_dict().items()}  # the shared weights twice
    assert fault(material, file_of(stored)) == ""


def test_a_network_under_two_names_and_one_inside_another_count_once():
    net = network()
    assert parameters(holding({}, net=net, again=net, part=net[1])) == 755
    assert parameters(holding({}, part=net[1], net=net)) == 755


def test_frozen_parameters_count_and_so_do_those_of_the_material_itself():
    frozen = nn.Linear(9, 64).requires_grad_(False)
    assert parameters(holding({}, net=frozen)) == 640
    assert parameters(holding({}, weight=nn.Parameter(torch.zeros(4, 5)))) == 20
    said = fault(holding({}, net=frozen), file_of(frozen.state_dict()))
    assert said.endswith("DecoderCost(parameters=640)")


def test_plain_tensors_of_the_decoder_part_must_be_declared():
    weights = {"weight": torch.rand(9, 64), "bias": torch.rand(64)}
    said = fault(holding({}, **weights), file_of(weights))
    assert "DecoderCost(parameters=640)" in said
    assert "table_floats=640" in said
    assert fault(holding({"parameters": 640}, **weights), file_of(weights)) == ""
    assert fault(holding({"table_floats": 640}, **weights), file_of(weights)) == ""
    assert re.search(r"\b700\b.*\b0\b", fault(holding({"parameters": 700}), file_of(weights)))
    said = fault(holding({"parameters": 640}, **weights), file_of(weights | {"basis": torch.rand(10, 5)}))
    assert re.search(r"\b690\b.* 50 of them.*parameters=690\b.*table_floats=50\b", said)


def test_what_a_network_does_not_explain_is_named_beside_it():
    net = network()
    stored = net.state_dict() | {"basis": torch.rand(10, 5)}
    said = fault(holding({"parameters": 755}, net=net), file_of(stored))
    assert re.search(r"\b805\b.*\b50\b", said)
    assert fault(holding({"parameters": 755, "table_floats": 50}, net=net), file_of(stored)) == ""


def test_scales_beside_a_tensor_are_not_numbers_of_the_decoder():
    assert decoder_floats({"weights": torch.zeros(7), "weights.scale": torch.ones(1)}) == range(7, 8)


def test_weights_beside_codes_are_numbers_of_the_decoder():
    decoder = {"weights": torch.zeros(7), "weights.step": torch.ones(1), "weights.other": torch.rand(5)}
    assert decoder_floats(decoder) == range(12, 13)


@pytest.mark.parametrize(
    ("shapes", "channels"),
    [
        (((8, 8, 3),), 3),
        (((8, 8, 3), (4, 4, 5)), 3),
        (((4, 4, 5),), 5),  # of a coarser texture alone
        (((4, 4, 5), (4, 4, 2), (2, 2, 9)), 7),
        (((8, 8, 3), (3,), ()), 3),  # beside a vector of scales and a single one
    ],
)
def test_the_channels_are_those_of_the_finest_textures(shapes, channels):
    texture = {str(place): torch.zeros(shape) for place, shape in enumerate(shapes)}
    assert texture_channels(texture, (8, 8)) == channels


@pytest.mark.parametrize("part", ["decoder", "texture", "encoder", "sampling", "other"])
@pytest.mark.parametrize("value", [0.0, 3.5])
def test_a_number_that_a_file_stores_many_times_is_counted(part, value):
    tensors = {"same": torch.full((40, 50), value), "few": torch.zeros(999), "other": torch.arange(2_000)}
    assert constant_bytes(Parts(**{part: tensors})) == {f"{part}/same": 8_000}
