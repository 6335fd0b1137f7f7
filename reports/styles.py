"""The colour, marker and line of each codec, the same in every figure; codecs known here keep theirs in every run."""

from typing import Any

from bench.records import Run, shown_label

# A colour of its own for each codec of the package: any two differ by at least 20 in CIELAB, and each has a contrast of
# 3 or more on white and on the page's dark paper. Markers tell apart what a reader without one kind of cone, or a grey
# print, confuses: no two of 231 codecs share both.
COLOURS = (
    *("#006CA8", "#E47818", "#18A884", "#C0186C", "#9084FC", "#906C00", "#846054", "#009CB4", "#909084", "#B4849C"),
    *("#FC6060", "#007800", "#9000FC", "#849C00", "#FC30F0", "#6C6090", "#486C60", "#CC0000", "#0054FC", "#A830A8"),
    "#A85430",
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h")
LINES = ("-", "--", ":", "-.")
KNOWN = (
    *("pca", "neubtf", "neubtf-direct", "neumip", "relief", "rainer2019", "vq", "rainer2020", "mean-colour", "table"),
    *("hsh", "zeltner2024", "tucker", "triple-plane", "ntc", "biplane", "bcf", "svbrdf", "hierarchical", "neuralbtf"),
    "local-pca",
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
            "marker": MARKERS[place % len(MARKERS)],
            "markerfacecolor": "white" if hollow else colour,
            "linestyle": LINES[variant % len(LINES)],
        }


def _codec(label: str) -> str:
    return label.split(maxsplit=1)[0] if label.split() else label
