"""Tables of what each codec is worth against each other, over their fronts of rate and distortion."""

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from reports.numbers import NONE
from reports.rows import MaterialRows
from reports.table import Table

if TYPE_CHECKING:
    from bench.compare.rates import Deltas
    from bench.metrics.bd import Array

LITTLE = 0.25  # share of what two fronts cover below which their delta rests on little


def compared(material: MaterialRows) -> "dict[str, Array]":
    """The fronts of a material's codecs that are long enough to be compared; empty if fewer than two are."""
    files = Counter(codec.label.split()[0] for codec in material.codecs if codec.measured)
    if not files or files.most_common(1)[0][1] < 2:  # most tables have none, and are made without NumPy
        return {}
    from bench.compare.rates import fronts
    from bench.metrics.bd import FEWEST

    by_codec = fronts(row.job for row in material.measured)
    long = {name: points for name, points in by_codec.items() if len(points) >= FEWEST}
    return long if len(long) > 1 else {}


def rate_tables(material: MaterialRows) -> Iterator[Table]:
    """BD-rate and BD-PSNR of each codec against each other, where two or more have fronts."""
    if not (fronts := compared(material)):
        return
    from bench.compare.rates import codec_of, deltas

    worth, measured = deltas(fronts), Counter(codec_of(row.job) for row in material.measured)
    for kind, unit, digits, about in (
        ("BD-rate", "% ↓", 0, "bytes in % of the column's at equal PSNR: negative is less"),
        ("BD-PSNR", "dB ↑", 2, "dB above the column's at equal bytes"),
    ):
        headers = [("codec", ""), ("files", ""), *((str(number), "") for number in range(1, len(fronts) + 1))]
        rows = [
            [
                f"{number} {test}",
                f"{len(points)} of {measured[test]}",
                *(_cell(worth, test, anchor, kind, digits) for anchor in fronts),
            ]
            for number, (test, points) in enumerate(fronts.items(), 1)
        ]
        notes = [
            "A codec's front is those of its files that no smaller one of its own beats. A column is the codec of its "
            f"number. {NONE}: the two share no {'PSNR' if kind == 'BD-rate' else 'size'}. In brackets: they share less "
            "than a quarter of what they cover. Files: on the front, of those measured. Bytes are of a material's own "
            "file, without a network that is shared over materials."
        ]
        yield Table("rate", f"{material.name}: {kind}, {unit}: {about}", headers, rows, notes, material=material.name)


def _cell(worth: "dict[tuple[str, str], Deltas]", test: str, anchor: str, kind: str, digits: int) -> str:
    if test == anchor:
        return ""
    both = worth[test, anchor]
    delta = both.rate if kind == "BD-rate" else both.quality
    if delta is None:
        return NONE
    text = f"{delta.value:+,.{digits}f}"
    return text if delta.overlap >= LITTLE else f"({text})"
