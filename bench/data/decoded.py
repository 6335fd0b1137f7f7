"""A decoded material as the source of a BTF, so that what writes BTFs writes decoded ones."""

import numpy as np

from bench.btf import Array, Source
from bench.material import Material


class DecodedSource(Source):
    """The slices of a material at given pairs wo, wi (N, 3); `identity` names the file it was decoded from."""

    def __init__(self, material: Material, wo: Array, wi: Array, identity: str):
        self.material, self.wo, self.wi, self.identity = material, wo, wi, identity
        self.shape, self.count = material.size, len(wo)

    def slice(self, pair: int) -> np.ndarray:
        return self.material.slice(self.wo[pair].tolist(), self.wi[pair].tolist()).numpy()

    def fingerprint(self) -> str:
        return self.identity
