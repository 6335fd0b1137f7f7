"""Joins tables of one surface into one BTF: training pairs, held-out pairs, and those that choose settings."""

import hashlib
from collections.abc import Callable

import numpy as np

from bench.btf import BTF, Array, Source
from bench.data.spec import Table


class Joined(Source):
    """The pairs of one source, then those of another of the same shape."""

    def __init__(self, first: Source, second: Source):
        if first.shape != second.shape:
            raise ValueError(f"pictures of {first.shape} and of {second.shape} cannot be of one surface")
        self.parts = (first, second)
        self.shape = first.shape
        self.count = first.count + second.count

    def slice(self, pair: int) -> Array:
        first, second = self.parts
        return first.slice(pair) if pair < first.count else second.slice(pair - first.count)

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        """As `Source.texels`: each part fills in its own pairs."""
        out = np.empty((len(rows), len(pairs), 3), np.float32)
        for chosen, part, inner in self._parts(pairs):
            out[:, chosen] = part.texels(rows, cols, inner)
        return out

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        """As `Source.gather`: each part fills in the values of its own pairs."""
        out = np.empty((len(pair), 3), np.float32)
        for chosen, part, inner in self._parts(pair):
            out[chosen] = part.gather(inner, row[chosen], col[chosen])
        return out

    def _parts(self, pairs: Array) -> list[tuple[Array, Source, Array]]:
        """Group some pairs by part: for each part their positions, the part, and their indices in it."""
        first, second = self.parts
        late = pairs >= first.count
        groups = []
        for mask, part, start in ((~late, first, 0), (late, second, first.count)):
            chosen = np.flatnonzero(mask)
            if len(chosen):
                groups.append((chosen, part, pairs[chosen] - start))
        return groups

    def window(self, top: int, left: int, height: int, width: int) -> Source:
        return Joined(*(part.window(top, left, height, width) for part in self.parts))

    def only(self, pairs: Array) -> Source:
        """The first part alone where all pairs are its own: training then never opens the held-out data."""
        first, _ = self.parts
        if len(pairs) and int(pairs.max()) < first.count:
            return first.only(pairs)  # its pairs come first, so their indices stay
        return self

    def fingerprint(self) -> str:
        described = " and ".join(part.digest for part in self.parts)
        return hashlib.sha256(described.encode()).hexdigest()


def followed(btf: BTF, drawn: BTF, kind: str, words: str) -> BTF:
    """A BTF, followed by the pairs of another table of the surface. `words` describe that table in the provenance.

    `kind` is what these pairs are for: `heldout`, which may only follow a BTF that holds none out, or `validation`, by
    which settings are chosen.
    """
    marks = {kind: np.arange(len(btf) + len(drawn)) >= len(btf)}
    if kind == "validation":
        marks["heldout"] = np.concatenate([btf.heldout, np.zeros(len(drawn), bool)])
    wo, wi = np.concatenate([btf.wo, drawn.wo]), np.concatenate([btf.wi, drawn.wi])
    source = Joined(btf.source, drawn.source)
    provenance = btf.provenance | {kind: words}
    return BTF(btf.name, wo, wi, source, **marks, periodic=btf.periodic, provenance=provenance)


def joined(tables: list[Table], opened: Callable[[Table], BTF]) -> BTF:
    """The tables of a surface, each as `opened` makes it, in one BTF."""
    btf = opened(tables[0])
    for table in tables[1:]:
        btf = followed(btf, opened(table), table.kind, table.words)
    return btf
