"""Decodes a codec file: finds its codec, its shared network if it needs one, and the scene it was fitted to."""

import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from bench.btf import Source
from bench.codec import Codec, Parts, TrainedNetwork
from bench.codecs import registry, shared
from bench.codecs.container import PARTS, SHARED, Header, read_parts
from bench.codecs.scene_material import SceneMaterial
from bench.inputs.errors import ContainerError, InputError, answered, said_by
from bench.material import Material
from bench.training.decoder import decoding

# A picture may have `LEAST_TEXELS` texels, or `MOST_TEXELS` for each number in its file if that is more. No codec
# exceeds both, and slices of such a picture still fit into memory.
LEAST_TEXELS = 1 << 24
MOST_TEXELS = 64


class Loaded(NamedTuple):
    """A codec file's header, the decoded material, and the shared network used to decode it, if any."""

    header: Header
    material: Material
    network: TrainedNetwork | None = None


def load(path: Path, device: torch.device | str = "cpu", network: TrainedNetwork | None = None) -> Loaded:
    """Read a codec file and decode it with the codec it names. `ContainerError` says what is wrong with the file;
    any other `InputError` that its codec is not installed or cannot be imported.

    If the file needs a shared network, `network` is used where its hash agrees; else `shared.find_named_by` finds one.
    """
    path = Path(path)
    header, parts = read_parts(path)
    codec_class = _codec_of(header)
    needed = _needed_network(header, codec_class, network)
    numbers = _count_numbers(parts)
    if needed is not None:
        numbers += _count_numbers(needed.parts)
    try:
        with decoding(numbers):  # no decoder may have more weights than such a file can hold
            codec = _with_settings(codec_class, header)
            material = decoded(codec, dataclasses.replace(parts, network=needed), torch.device(device))
        _check_answers(material)
        if header.scene:
            material = SceneMaterial(material, header.scene, str(path)).to(material.device)
        if math.prod(material.size) > max(LEAST_TEXELS, MOST_TEXELS * numbers):
            fault = f"a picture of {material.size} texels is far too large for {numbers:,} numbers"
            raise ContainerError(f"{fault}: encode it again")
    except ContainerError as error:
        raise ContainerError(f"{path}: {error}") from error
    except InputError as error:  # of its codec
        raise ContainerError(f"{path}: cannot be decoded: {error}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # tensors that no encoder made may raise any error in a decoder
        what = said_by(error)
        raise ContainerError(f"{path}: its tensors are not what codec {header.codec} wrote ({what})") from error
    return Loaded(header, material, needed)


def _with_settings(codec_class: type[Codec], header: Header) -> Codec:
    """The codec with the settings of a file. `ContainerError`, which does not name the file, if it refuses any."""
    try:
        return codec_class(**header.settings)
    except InputError as error:
        raise ContainerError(f"cannot be decoded: {error}: encode it again") from error


def _codec_of(header: Header) -> type[Codec]:
    """The class of the codec that wrote a material's file.

    `ContainerError` if the file holds no material, or if another version of the codec is installed; any other
    `InputError` if none is, or it cannot be imported.
    """
    if header.kind == SHARED:
        fault = f"not a material, but the network that codec {header.codec} shares over materials"
        raise ContainerError(f"{header.path}: {fault}: give the file of a material")
    codec_class = registry.load_codec(header.codec, wanted_by=str(header.path))
    installed = codec_class.version_of(header.settings)
    if header.version != installed:
        raise ContainerError(
            f"{header.path}: written by version {header.version} of codec {header.codec}, but installed is version "
            f"{installed}: encode it again, or install the version that wrote it"
        )
    return codec_class


def decoded(codec: Codec, parts: Parts, device: torch.device) -> Material:
    """The material of the tensors of a file, which fades below the lowest light of its fit. `CodecError` if the codec
    decodes to anything else."""
    material = codec.decode(parts, device)
    if not isinstance(material, Material):
        raise answered(codec.decode, material, "a Material")
    material.lowest_light = parts.lowest_light
    return material


def _needed_network(header: Header, codec_class: type[Codec], network: TrainedNetwork | None) -> TrainedNetwork | None:
    """The shared network that a file names: `network` if its hash agrees, else the one found; None if it names none."""
    if not header.network:
        return None
    if network is not None and network.sha256 == header.network:
        return network
    shipped = codec_class.network.shipped if codec_class.network else None  # what comes with the codec
    return shared.find_named_by(header, shipped)


def _count_numbers(parts: Parts) -> int:
    """How many numbers the tensors of all parts hold together."""
    return sum(tensor.numel() for part in PARTS for tensor in getattr(parts, part).values())


def _check_answers(material: Material) -> None:
    """Query each corner of the picture once, so that tensors which contradict each other are found when a file is read.

    Raises `ValueError` if the picture's size is not two positive numbers, or if an answer is not finite.
    """
    if not all(isinstance(side, int) and side > 0 for side in material.size):
        raise ValueError(f"a picture of {material.size} texels")
    uv = torch.tensor([[0.0, 0.0], [0.0, 0.999], [0.999, 0.0], [0.999, 0.999]], device=material.device)
    # The view is along the normal, the light 37° from it.
    up = torch.tensor([0.0, 0.0, 1.0], device=material.device).expand(4, 3)
    tilted = torch.tensor([0.6, 0.0, 0.8], device=material.device).expand(4, 3)
    if not material.query(uv, up, tilted).isfinite().all():
        raise ValueError("its answers are not finite")


class DecodedSource(Source):
    """A decoded material at the pairs wo, wi (N, 3), to be written like any BTF."""

    def __init__(self, material: Material, wo: np.ndarray, wi: np.ndarray, identity: str):
        """`identity` is the hash of the material's file, which stands for its content."""
        self.material = material
        self.wo = wo
        self.wi = wi
        self.identity = identity
        self.shape = material.size
        self.count = len(wo)

    def slice(self, pair: int) -> np.ndarray:
        return self.material.slice(self.wo[pair].tolist(), self.wi[pair].tolist()).numpy()

    def fingerprint(self) -> str:
        return self.identity
