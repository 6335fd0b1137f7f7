"""The parameters of decoders and the channels of textures, ours beside those published.

Those of NeuBTF, NeuMIP and both of Rainer's are from Table 2 of Rodriguez-Pardo, Kazatzis, Lopez-Moreno, Garces:
"NeuBTF", Computers & Graphics 114 (2023); the others follow from the layers that their papers or authors' code state.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from bench.records import Record
from reports.numbers import NONE, integer
from reports.table import Table


@dataclass(frozen=True)
class Published:
    """What a paper states, and what our channels consist of."""

    method: str
    parameters: int
    channels: int
    made_of: str


_PYRAMID = "7 latents of the finest level of the pyramid, coarser ones not counted, and 7 of the offset"
_STATISTICS = "and the mean and the deviation of each colour of a texel's ABRDF (6)"
_NEUBTF = Published("NeuBTF", 3_011, 14, "14 latents")
PUBLISHED = {
    "neubtf": _NEUBTF,
    "neubtf-direct": _NEUBTF,
    "neumip": Published("NeuMIP", 3_332, 14, _PYRAMID),
    "rainer2019": Published("Rainer 2019", 35_725, 14, f"8 latents, {_STATISTICS}"),
    "rainer2020": Published("Rainer 2020", 38_269, 38, f"32 latents, {_STATISTICS}"),
    "zeltner2024": Published("Zeltner 2024", 1_923, 8, "8 latents"),
    "triple-plane": Published("Triple plane", 3_011, 8, "8 latents of the plane over the texels"),
    "biplane": Published(
        "Biplane", 136_451, 18, "6 latents of the plane over the texels, a matrix (9) and an offset (3)"
    ),
    "neuralbtf": Published(
        "NeuralBTF", 556_038, 8, "8 latents of the finest level; two coarser ones and the offset's are not counted"
    ),
}  # by codec


def parameters_table(jobs: Iterable[Record]) -> Table | None:
    """A row for each different decoder among finished jobs of the codecs in `PUBLISHED`; None where there is none."""
    decoders: dict[tuple[str, int, int], list[str]] = {}
    for job in jobs:
        if job["status"] == "ok" and job["codec"] in PUBLISHED:
            key = (job["codec"], job["parameters"], job["cost"]["texture_channels"])
            decoders.setdefault(key, []).append(job["label"])
    if not decoders:
        return None
    order = list(PUBLISHED)
    keys = sorted(decoders, key=lambda key: order.index(key[0]))
    codecs = [codec for codec, _, _ in keys]
    labels = [codec if codecs.count(codec) == 1 else decoders[key][0] for codec, key in zip(codecs, keys, strict=True)]
    headers = [("method", ""), ("codec", "")]
    headers += [(what, whose) for what in ("param.", "channels") for whose in ("ours", "paper", "diff.")]
    rows = [_cells(label, *key) for label, key in zip(labels, keys, strict=True)]
    title = "Decoder parameters and texture channels, beside those published"
    return Table("parameters", title, headers, rows, _notes(codecs), words=2)


def _cells(label: str, codec: str, parameters: int, channels: int) -> list[str]:
    paper = PUBLISHED[codec]
    ours = [(parameters, paper.parameters), (channels, paper.channels)]
    numbers = [
        [integer(mine), integer(theirs), f"{mine - theirs:+,}" if mine != theirs else "0"] for mine, theirs in ours
    ]
    return [paper.method, label, *numbers[0], *numbers[1]]


def _notes(codecs: list[str]) -> list[str]:
    notes = ["Ours: trainable parameters of the decoder, counted by torchinfo in what a codec file decodes to."]
    notes += [f"Channels of {paper.method}: {paper.made_of}." for paper in dict.fromkeys(PUBLISHED[c] for c in codecs)]
    absent = dict.fromkeys(paper.method for paper in PUBLISHED.values())
    for codec in codecs:
        absent.pop(PUBLISHED[codec].method, None)
    return notes + ([f"{NONE} {', '.join(absent)}: no codec of it has been measured."] if absent else [])
