"""Joins two tables of one surface into one BTF: the product of training pairs, and the held-out pairs."""

import hashlib
from typing import Any

import numpy as np

from bench.btf import BTF, Array, Source


class Joined(Source):
    """The pairs of one source, then those of another of the same shape."""

    def __init__(self, first: Source, second: Source):
        if first.shape != second.shape:
            raise ValueError(f"pictures of {first.shape} and of {second.shape} cannot be of one surface")
        self.parts = (first, second)
        self.shape, self.count = first.shape, first.count + second.count

    def slice(self, pair: int) -> Array:
        first, second = self.parts
        return first.slice(pair) if pair < first.count else second.slice(pair - first.count)

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        out = np.empty((len(rows), len(pairs), 3), np.float32)
        for chosen, part, inside in self._parts(pairs):
            out[:, chosen] = part.texels(rows, cols, inside)
        return out

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        out = np.empty((len(pair), 3), np.float32)
        for chosen, part, inside in self._parts(pair):
            out[chosen] = part.gather(inside, row[chosen], col[chosen])
        return out

    def _parts(self, pairs: Array) -> list[tuple[Array, Source, Array]]:
        """Group some pairs by part: for each part their positions, the part, and their indices in it."""
        first, second = self.parts
        late = pairs >= first.count
        halves = [(np.flatnonzero(~late), first, 0), (np.flatnonzero(late), second, first.count)]
        return [(chosen, part, pairs[chosen] - start) for chosen, part, start in halves if len(chosen)]

    def window(self, top: int, left: int, height: int, width: int) -> Source:
        return Joined(*(part.window(top, left, height, width) for part in self.parts))

    def only(self, pairs: Array) -> Source:
        first = self.parts[0]
        return first.only(pairs) if len(pairs) and int(pairs.max()) < first.count else self

    def fingerprint(self) -> str:
        return hashlib.sha256(" and ".join(part.digest for part in self.parts).encode()).hexdigest()


def with_heldout(product: BTF, drawn: BTF, **provenance: Any) -> BTF:
    """A product of views and lights, followed by the held-out pairs of another table of the surface."""
    return BTF(
        product.name,
        np.concatenate([product.wo, drawn.wo]),
        np.concatenate([product.wi, drawn.wi]),
        Joined(product.source, drawn.source),
        heldout=np.arange(len(product) + len(drawn)) >= len(product),
        periodic=product.periodic,
        provenance=product.provenance | provenance,
    )


def with_validation(btf: BTF, drawn: BTF, words: str) -> BTF:
    """A BTF with declared held-out pairs, followed by its validation pairs, by which settings are chosen."""
    joined = with_heldout(btf, drawn, validation=words)
    joined.validation = joined.heldout
    joined.heldout = np.concatenate([btf.heldout, np.zeros(len(drawn), bool)])
    return joined
