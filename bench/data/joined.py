"""Joins tables of one surface into one BTF: pairs to train on, to test, to choose settings by, and of low light.

A *table* is the pairs of one of these four kinds (`bench.data.spec.Table`), or some held-out pairs between texels. Each
is rendered into a file of its own, so that another draw of test pairs renders only their table again. A *part* of a
joined source holds the values of a table.
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from bench.btf import BTF, MASKS, Array, Source
from bench.data.spec import Table


class Joined(Source):
    """The pairs of one source, then those of another of the same shape."""

    def __init__(self, first: Source, second: Source):
        if first.shape != second.shape:
            raise ValueError(f"pictures of {first.shape} and of {second.shape} cannot be of one surface")
        self.parts = (first, second)
        self.shape = first.shape
        self.count = first.count + second.count
        self.at_once = max(first.at_once, second.at_once)

    def slices(self, pairs: Array) -> list[Array]:
        """As `Source.slices`: each part reads its own pairs together."""
        slices: dict[int, Array] = {}  # by place in `pairs`
        for places, part, part_pairs in self._by_part(pairs):
            slices |= zip(places.tolist(), part.slices(part_pairs), strict=True)
        return [slices[place] for place in range(len(pairs))]

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        """As `Source.texels`: each part fills in its own pairs."""
        out = np.empty((len(rows), len(pairs), 3), np.float32)
        for places, part, part_pairs in self._by_part(pairs):
            out[:, places] = part.texels(rows, cols, part_pairs)
        return out

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        """As `Source.gather`: each part fills in the values of its own pairs."""
        out = np.empty((len(pair), 3), np.float32)
        for places, part, part_pairs in self._by_part(pair):
            out[places] = part.gather(part_pairs, row[places], col[places])
        return out

    def _by_part(self, pairs: Array) -> list[tuple[Array, Source, Array]]:
        """Some pairs grouped by the part that holds them: (their places in `pairs`, the part, their indices in it).

        A part that holds none of them is left out.
        """
        first, second = self.parts
        is_second = pairs >= first.count
        groups = []
        for mask, part, start in ((~is_second, first, 0), (is_second, second, first.count)):
            places = np.flatnonzero(mask)
            if len(places):
                groups.append((places, part, pairs[places] - start))
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
        """A hash of the fingerprints of both parts, in their order."""
        described = " and ".join(part.digest for part in self.parts)
        return hashlib.sha256(described.encode()).hexdigest()


def appended(btf: BTF, further: BTF, kind: str, words: str) -> BTF:
    """A BTF with the pairs of `further`, of the same surface, behind its own; `words` describe them in the provenance.

    `kind` is what these pairs are for, the name of a mask of the BTF: `heldout`, `validation`, by which settings are
    chosen, or `low_light`. No pair of the BTF may be of this kind yet.
    """
    masks: dict[str, Any] = {kind: np.arange(len(btf) + len(further)) >= len(btf)}
    for name in MASKS:  # none of the further pairs is of another kind
        before = getattr(btf, name)
        if name != kind and before is not None:
            masks[name] = np.concatenate([before, np.zeros(len(further), bool)])
    wo, wi = np.concatenate([btf.wo, further.wo]), np.concatenate([btf.wi, further.wi])
    source = Joined(btf.source, further.source)
    provenance = btf.provenance | {kind: words}
    return BTF(btf.name, wo, wi, source, **masks, periodic=btf.periodic, provenance=provenance)


def joined(tables: list[Table], open_table: Callable[[Table], BTF]) -> BTF:
    """The tables of a surface in one BTF, in their order; the first holds the training pairs.

    The table between texels, if there is one, is the last; it becomes a BTF apart, `BTF.between`. `open_table` makes
    the BTF of one table, in which no pair is marked as held out.
    """
    btf = open_table(tables[0])
    for table in tables[1:]:
        further = open_table(table)
        if table.kind == "between":
            btf = replace(btf, between=further)
        else:
            btf = appended(btf, further, table.kind, table.words)
    return btf
