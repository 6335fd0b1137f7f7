"""The colour, marker and line of each codec, the same in every figure; codecs known here keep theirs in every run.

A *setting* is one label of a codec. Codecs *from outside* are not of the package, so most likely the reader's *own*.
"""

from collections.abc import Collection, Sequence
from typing import Any

from bench.compare.frame import line_of
from bench.records import Job, method_of

# A colour of its own for each codec of the package: any two differ by at least 20 in CIELAB, and each has a contrast of
# 3 or more on white and on the page's dark paper. Markers tell apart what a reader without one kind of cone, or a grey
# print, confuses.
COLOURS = (
    *("#006CA8", "#E47818", "#18A884", "#C0186C", "#9084FC", "#906C00", "#846054", "#009CB4", "#909084", "#B4849C"),
    *("#FC6060", "#007800", "#9000FC", "#849C00", "#FC30F0", "#6C6090", "#486C60", "#CC0000", "#0054FC", "#A830A8"),
    *("#B454FC", "#9C4884", "#A84854"),
)
# Colours of codecs from outside, which differ as much from the ones above. There are 3 colours and 14 markers, so that
# no two of 42 such codecs share both.
OWN = ("#FC24B4", "#607830", "#CC7854")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*", "d", "8")
LINES = ("-", "--", ":", "-.")
# The codecs of the package. The place of each chooses its colour and marker: one added in the middle changes others.
KNOWN = (
    *("pca", "neubtf", "neubtf-direct", "neumip", "relief", "rainer2019", "vq", "rainer2020", "mean-colour", "table"),
    *("hsh", "zeltner2024", "tucker", "triple-plane", "ntc", "biplane", "bcf", "svbrdf", "hierarchical", "neuralbtf"),
    *("local-pca", "ptm", "pca-avif"),
)


class Styles:
    """One colour and marker a codec, a line for each of its settings; codecs from outside are drawn above others."""

    def __init__(self, jobs: Collection[Job]):
        self.codec_of: dict[str, str] = {}  # by label, ladder of rates and line of budgets, the name of the codec
        self.labels_of_codec: dict[str, list[str]] = {}  # each once, in the order of the suite
        for job in jobs:
            label, codec = job["label"], method_of(job)
            for name in (label, job.get("curve", codec), line_of(job)):
                self.codec_of[name] = codec
            labels = self.labels_of_codec.setdefault(codec, [])
            if label not in labels:
                labels.append(label)
        self.outside_codecs = list(filter(is_own, self.labels_of_codec))

    def of_codec(self, label: str) -> dict[str, Any]:
        """The keyword arguments by which Matplotlib's `plot` draws a label; markers are hollow at every second setting.

        `label` may also name a ladder of rates, the line through several settings of a codec, or a codec that the run
        lacks. Codecs from outside lie in a higher layer, so that they are drawn above others.
        """
        codec = self.codec_of.get(label, label)
        labels = self.labels_of_codec.get(codec, [])
        # A ladder of rates is named after its codec and has no label of its own: it looks like the first setting.
        setting = labels.index(label) if label in labels else 0
        codecs: Sequence[str]
        colours: Sequence[str]
        if is_own(codec):
            codecs, colours, layer = self.outside_codecs, OWN, 3
        else:
            codecs, colours, layer = KNOWN, COLOURS, 2
        place = codecs.index(codec) if codec in codecs else len(codecs)  # a codec from outside that the run lacks
        colour = colours[place % len(colours)]
        return {
            "color": colour,
            "zorder": layer,
            "marker": MARKERS[place % len(MARKERS)],
            "markerfacecolor": "white" if setting % 2 else colour,
            "linestyle": LINES[setting % len(LINES)],
        }

    def of_line(self, line: str) -> dict[str, Any]:
        """The arguments of `plot` for a line of budgets, "codec" or "codec, as published": as `of_codec`, not dashed.

        `KeyError` for a line of which the run has no job.
        """
        return self.of_codec(self.codec_of[line]) | {"linestyle": "-"}


def is_own(codec: str) -> bool:
    """Whether a codec is not one of the package, so most likely the reader's own."""
    return codec not in KNOWN
