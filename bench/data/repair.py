"""Masks radiance that is NaN or infinite, for `--repair`."""

import hashlib
import logging

import numpy as np

from bench.btf import BTF, Array, NotFiniteError, Source
from bench.codec import Progress, followed, silent
from bench.inputs.errors import InputError

log = logging.getLogger(__name__)


class Repaired(Source):
    """Wraps a source: values that are not finite become the mean of the finite ones of their pair and channel.
    Scattered reads use the scratch file of `Source`, so every value is repaired only once."""

    def __init__(self, source: Source):
        self.source, self.shape, self.count = source, source.shape, source.count

    def slice(self, pair: int) -> Array:
        return self.mended(pair)[0]

    def mended(self, pair: int) -> tuple[Array, int]:
        """The slice of a pair (H, W, 3), and the number of its masked values. Raises `InputError` if one of its
        channels has no finite value."""
        try:
            picture = self.source.slice(pair)
        except NotFiniteError as error:
            picture = error.values
        bad = ~np.isfinite(picture)
        if not bad.any():
            return picture, 0
        if bad.all((0, 1)).any():
            raise InputError(f"pair {pair}: a channel without finite values cannot be repaired: leave the pair out")
        mean = np.mean(picture, (0, 1), where=~bad, dtype=np.float64)
        return np.where(bad, mean, picture).astype(np.float32), int(bad.sum())

    def fingerprint(self) -> str:
        return hashlib.sha256(f"{self.source.digest} repaired".encode()).hexdigest()


def repaired(btf: BTF, show: Progress = silent) -> BTF:
    """Mask values that are not finite; a warning and `provenance["repaired"]` give their number and pairs. Reads every
    slice once. A finite BTF is returned unchanged. `Repaired` describes the replacement."""
    source = Repaired(btf.source)
    masked = {}
    pairs = followed(show, btf.pairs.tolist(), "looking for values that are not finite", len(btf))
    for done, pair in enumerate(pairs):
        if count := source.mended(pair)[1]:
            masked[done] = count
    if not masked:
        return btf
    listed = ", ".join(map(str, list(masked)[:10])) + (", …" if len(masked) > 10 else "")
    note = f"{sum(masked.values())} values that were not finite, masked by the mean of their pair: pairs {listed}"
    log.warning("%s: %s", btf.name, note)
    return btf.over(source, repaired=note)
