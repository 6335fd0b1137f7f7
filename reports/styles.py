"""The colour, marker and line of each codec, the same in every figure; codecs known here keep theirs in every run."""

from typing import Any

from bench.records import Run, shown_label

# Okabe and Ito, "Color universal design", 2008, without its yellow, which is too light for a line on white. The
# marker changes together with the colour, so that no two of 14 are alike even in grey. Each further 14 begin one
# marker later, so that no two of 98 share both.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9", "#E69F00")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*", "d", "8")
LINES = ("-", "--", ":", "-.")
KNOWN = (
    *("pca", "neubtf", "neubtf-direct", "neumip", "relief", "rainer2019", "vq", "rainer2020", "mean-colour", "table"),
    *("hsh", "zeltner2024", "tucker", "triple-plane", "ntc", "biplane", "bcf", "svbrdf", "neuralbtf"),
)


class Styles:
    """The styles of a run's codecs. A codec at several settings has one colour and marker, and a line for each."""

    def __init__(self, run: Run):
        labels = dict.fromkeys(map(shown_label, run.jobs))
        codecs = dict.fromkeys([*KNOWN, *(_codec(label) for label in labels)])
        self.places = {codec: place for place, codec in enumerate(codecs)}
        self.variants = {codec: [label for label in labels if _codec(label) == codec] for codec in codecs}

    def of_codec(self, label: str) -> dict[str, Any]:
        """How `plot` draws a label, or a ladder of rates; markers are hollow at every second setting."""
        codec = _codec(label)
        place, variants = self.places.get(codec, len(self.places)), self.variants.get(codec, [])
        variant = variants.index(label) if label in variants else 0
        colour = COLOURS[place % len(COLOURS)]
        hollow = variant % 2
        return {
            "color": colour,
            "marker": MARKERS[(place + place // len(MARKERS)) % len(MARKERS)],
            "markerfacecolor": "white" if hollow else colour,
            "linestyle": LINES[variant % len(LINES)],
        }


def _codec(label: str) -> str:
    return label.split(maxsplit=1)[0] if label.split() else label
