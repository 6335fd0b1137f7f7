"""The ranking of the codecs of a run, and the difference of each to one of them; both are computed only once."""

from collections.abc import Sequence
from dataclasses import replace

from bench.compare.paired import AGAINST, Against, against
from bench.compare.ranks import Standing, standings
from bench.inputs.errors import InputError
from bench.records import Job, Run, view
from reports.rows import materials


@view
def ranked(run: Run) -> list[Standing]:
    """Every measured codec, the best first; models of a scene come last, without a rank."""
    whole: dict[str, dict[str, list[Job]]] = {}
    of_scene: dict[str, dict[str, list[Job]]] = {}
    for material in materials(run):
        for codec in material.codecs:
            if codec.measured:
                jobs = of_scene if codec.of_scene else whole
                jobs.setdefault(material.name, {})[codec.label] = [row.job for row in codec.measured]
    last = [replace(each, rank=None, wins=None) for each in standings(of_scene)]
    return [*standings(whole), *last]


@view
def against_one(run: Run, wanted: str = "") -> Against:
    """The paired differences of the ranked codecs to the row `wanted`, a label or the name of a codec with one row.

    By default that is the first row of the codec `AGAINST` or, without one, the first row in the order of the suite, so
    that no result decides which row it is. Raises `InputError` for a row that is not there, or that was not measured
    on all materials.
    """
    ranking = [each.label for each in ranked(run) if each.rank is not None]
    order = dict.fromkeys(codec.label for material in materials(run) for codec in material.codecs)
    racing = [label for label in order if label in ranking]  # those with a rank, in the order of the suite
    if wanted:
        first = _row_named(wanted, racing)
    elif racing:
        usual = [label for label in racing if label.split()[0] == AGAINST]
        first = usual[0] if usual else racing[0]
    else:
        return Against("", {}, {})
    return against(run, first, [label for label in ranking if label != first])


def rows_of(codec: str, run: Run) -> int:
    """The number of rows that a codec has among those that are ranked."""
    return sum(each.rank is not None and each.label.split()[0] == codec for each in ranked(run))


def _row_named(wanted: str, labels: Sequence[str]) -> str:
    """The label of the one row that is meant by `wanted`: a label, which may lack "(our recipe)", or a codec's name."""
    named = [label for label in labels if wanted in (label, label.replace(" (our recipe)", ""))]
    if not named:
        named = [label for label in labels if label.split()[0] == wanted]
    if len(named) != 1:
        why = "it has several rows" if named else "no row on all materials has this label"
        raise InputError(f"--against {wanted}: {why}: name one of {'; '.join(named or labels)}")
    return named[0]
