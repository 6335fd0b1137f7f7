"""The ranking of the codecs of a run, and the difference of each to one of them; both are computed only once.

A *codec* is here one with its settings, a row of the summary. Its *standing* is its place by PSNR over all materials.
It has a *rank* only if it was measured on every material of the run.
"""

from collections.abc import Mapping
from dataclasses import replace

from bench.compare.paired import AGAINST, Against, against
from bench.compare.ranks import Standing, standings
from bench.inputs.errors import InputError
from bench.records import Job, Run, view
from reports.rows import materials


@view
def ranked(run: Run) -> list[Standing]:
    """The standing of every measured codec, the best first. Models of a scene come last and without a rank, because
    their quality over a whole material is not what they were fitted for. Kept with the run."""
    # Jobs by material and label, those of models of whole materials apart from those of models of a scene.
    whole: dict[str, dict[str, list[Job]]] = {}
    of_scene: dict[str, dict[str, list[Job]]] = {}
    for material in materials(run):
        for codec in material.codecs:
            if codec.measured:
                jobs = of_scene if codec.of_scene else whole
                jobs.setdefault(material.name, {})[codec.label] = [row.job for row in codec.measured]
    without_rank = [replace(standing, rank=None, wins=None) for standing in standings(of_scene)]
    return [*standings(whole), *without_rank]


@view
def against_one(run: Run, wanted: str = "") -> Against:
    """The differences of the ranked codecs to the row `wanted`, a label or the name of a codec with one row. They are
    mean differences of PSNR in dB, paired slice by slice.

    By default that is the first row of the codec `AGAINST` or, without one, the first row in the order of the suite, so
    that no result decides which row it is. Raises `InputError` for a row that is not there, or that was not measured
    on all materials. Kept with the run.
    """
    codecs = codecs_of(run)
    ranked_labels = [standing.label for standing in ranked(run) if standing.rank is not None]
    in_suite_order = {label: codec for label, codec in codecs.items() if label in ranked_labels}
    if wanted:
        reference = _row_named(wanted, in_suite_order)
    elif in_suite_order:
        of_usual_codec = [label for label, codec in in_suite_order.items() if codec == AGAINST]
        reference = [*of_usual_codec, *in_suite_order][0]
    else:  # no codec has a rank
        return Against(first="", over={}, on={})
    others = [label for label in ranked_labels if label != reference]
    return against(run, reference, others)


@view
def codecs_of(run: Run) -> dict[str, str]:
    """The name of the codec of each label, in the order of the suite. Kept with the run."""
    return {codec.label: codec.codec for material in materials(run) for codec in material.codecs}


def settings_of(codec: str, run: Run) -> int:
    """The number of rows, one for each of its settings, that a codec of this name has among those that are ranked."""
    codecs = codecs_of(run)
    return sum(codecs[standing.label] == codec for standing in ranked(run) if standing.rank is not None)


def _row_named(wanted: str, codecs: Mapping[str, str]) -> str:
    """The label of the one row that is meant by `wanted`: a label, or a codec's name; `codecs` has that of each label.

    `InputError` if `wanted` means no row, or several.
    """
    if wanted in codecs:  # a name alone counts only if no whole label is the same: "pca" may be both
        return wanted
    matches = [label for label, codec in codecs.items() if codec == wanted]
    if len(matches) != 1:
        why = "it has several rows" if matches else "no row on all materials has this label"
        raise InputError(f"--against {wanted}: {why}: name one of {'; '.join(matches or codecs)}")
    return matches[0]
