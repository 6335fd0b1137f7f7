"""The ranking of the codecs of a run, and the difference of each to one of them.

A *codec* is here one with its settings, a row of the summary. Its *standing* is its place by PSNR over all materials.
It has a *rank* only if it was measured on every material of the run.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import nan

import pandas as pd

from bench.compare.paired import AGAINST, Against, against_jobs
from bench.compare.statistics import mean_ranks
from bench.inputs.errors import InputError
from bench.records import Run
from reports.rows import MaterialRows

SAME_DB = 0.005  # tables do not show a smaller difference, so such codecs share a rank


def ranked(materials: Iterable[MaterialRows]) -> pd.DataFrame:
    """The `standings` of all measured codecs. Models of a scene come last and without a rank, because their quality
    over a whole material is not what they were fitted for."""
    psnr_of: dict[str, dict[int, float]] = {}  # by label, then by number of material: a mean over slices, then seeds
    of_scene: list[str] = []  # labels
    for number, material in enumerate(materials):
        for codec in material.codecs:
            if codec.psnr is not None:
                psnr_of.setdefault(codec.label, {})[number] = codec.psnr
            if codec.of_scene:
                of_scene.append(codec.label)
    labels = pd.Index(list(psnr_of), dtype=object)  # strings of pandas cannot hold every name
    return standings(pd.DataFrame(list(psnr_of.values()), labels), of_scene)


def standings(psnr: pd.DataFrame, unranked: Sequence[str] = ()) -> pd.DataFrame:
    """A row for each codec of a table (codecs, materials) of PSNR in dB, the best rank first, then the best PSNR.

    Columns: on how many `materials` it was measured; the mean `psnr` over these; its mean `rank`, 1 for the best; and
    how many it `won`. The last two are NaN of a codec that lacks a material, because a rank among fewer would not be
    comparable, and of those `unranked`, which come last.
    """
    is_unranked = psnr.index.isin(unranked)
    complete = psnr[~is_unranked].dropna(axis="columns", how="all").dropna()
    table = pd.DataFrame({"materials": psnr.count(axis=1), "psnr": psnr.mean(axis=1), "unranked": is_unranked})
    table["rank"] = nan
    if len(complete):  # NumPy warns of a mean over nothing
        table["rank"] = pd.Series(mean_ranks(complete.to_numpy(), SAME_DB), complete.index)
    table["won"] = (complete + SAME_DB >= complete.max()).sum(axis=1)
    return table.sort_values(["unranked", "rank", "psnr"], ascending=[True, True, False])


def with_rank(materials: Iterable[MaterialRows], ranking: pd.DataFrame) -> dict[str, str]:
    """The name of the codec of each label that has a rank, in the order of the suite."""
    ranked_labels = ranking.index[ranking["rank"].notna()]
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
