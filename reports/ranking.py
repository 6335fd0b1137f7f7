"""The ranking of the codecs of a run, and the difference of each to one of them.

A *codec* is here one with its settings, a row of the summary. Its *standing* is its place by PSNR over all materials.
It has a *rank* only if it was measured on every material of the run.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from bench.compare.paired import AGAINST, Against, against_jobs
from bench.compare.ranks import Standing, standings
from bench.inputs.errors import InputError
from bench.records import Job, Run
from reports.rows import MaterialRows


def ranked(materials: Iterable[MaterialRows]) -> list[Standing]:
    """The standing of every measured codec, the best first. Models of a scene come last and without a rank, because
    their quality over a whole material is not what they were fitted for."""
    # Jobs by material and label, those of models of whole materials apart from those of models of a scene.
    whole: dict[str, dict[str, list[Job]]] = {}
    of_scene: dict[str, dict[str, list[Job]]] = {}
    for material in materials:
        for codec in material.codecs:
            if codec.measured:
                jobs = of_scene if codec.of_scene else whole
                jobs.setdefault(material.name, {})[codec.label] = [row.job for row in codec.measured]
    without_rank = [replace(standing, rank=None, wins=None) for standing in standings(of_scene)]
    return [*standings(whole), *without_rank]


def with_rank(materials: Iterable[MaterialRows], ranking: Iterable[Standing]) -> dict[str, str]:
    """The name of the codec of each label that has a rank, in the order of the suite."""
    ranked_labels = {standing.label for standing in ranking if standing.rank is not None}
    codec_of_label = {codec.label: codec.codec for material in materials for codec in material.codecs}
    return {label: codec for label, codec in codec_of_label.items() if label in ranked_labels}


def against_one(run: Run, materials: Iterable[MaterialRows], codecs: Mapping[str, str], wanted: str = "") -> Against:
    """The differences of the codecs with a rank, see `with_rank`, to the row `wanted`, a label or the name of a codec
    with one row. They are mean differences of PSNR in dB, paired slice by slice.

    By default that is the first row of the codec `AGAINST` or, without one, the first row in the order of the suite, so
    that no result decides which row it is. Raises `InputError` for a row that is not there or was not measured on all
    materials, and for the name of a codec with several rows.
    """
    if wanted:
        reference = _row_named(wanted, codecs)
    elif codecs:
        of_usual_codec = [label for label, codec in codecs.items() if codec == AGAINST]
        reference = [*of_usual_codec, *codecs][0]
    else:  # no codec has a rank
        return Against(first="", over={}, on={})
    rows = [row for material in materials for row in material.measured if row.label in codecs]
    return against_jobs(run, reference, *(row.job["job"] for row in rows))


def _row_named(wanted: str, codecs: Mapping[str, str]) -> str:
    """The label of the one row that is meant by `wanted`: a label, or a codec's name; `codecs` has that of each label.

    `InputError` if `wanted` means no row, or several.
    """
    if wanted in codecs:  # a name alone counts only if no whole label is the same: "pca" may be both
        return wanted
    if not codecs:
        remedy = "choose with --material those that it was measured on"
        raise InputError(f"--against {wanted}: no codec was measured on all materials: {remedy}")
    matches = [label for label, codec in codecs.items() if codec == wanted]
    if len(matches) != 1:
        why = "it has several rows" if matches else "no row on all materials has this label"
        raise InputError(f"--against {wanted}: {why}: name one of {'; '.join(matches or codecs)}")
    return matches[0]
