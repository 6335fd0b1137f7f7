"""The ranking of the codecs of a run, and the difference of each to one of them; both are computed only once."""

from functools import lru_cache

from bench.compare.paired import AGAINST, Against, against
from bench.compare.ranks import Standing, standings
from bench.records import Record, Run
from reports.rows import materials


@lru_cache(maxsize=1)
def ranked(run: Run) -> list[Standing]:
    """Every measured codec, the best first."""
    jobs: dict[str, dict[str, list[Record]]] = {}
    for material in materials(run):
        for codec in (codec for codec in material.codecs if codec.measured):
            jobs.setdefault(material.name, {})[codec.label] = [row.job for row in codec.measured]
    return standings(jobs)


@lru_cache(maxsize=1)
def against_one(run: Run) -> Against:
    """The paired differences to `AGAINST` or, without it, to the suite's first codec: no result chooses it."""
    ranking = [each.label for each in ranked(run) if each.rank is not None]
    order = dict.fromkeys(codec.label for material in materials(run) for codec in material.codecs)
    racing = [label for label in order if label in ranking]
    first = next((label for label in racing if label.split()[0] == AGAINST), racing[0] if racing else "")
    return against(run, first, [label for label in ranking if label != first])
