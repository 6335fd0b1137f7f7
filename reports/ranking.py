"""The ranking of the codecs of a run, and the difference of each to the best one; both are computed only once."""

import math
from functools import lru_cache

from bench.compare.paired import Against, against
from bench.compare.standings import Standing, standings
from bench.records import Run
from reports.rows import materials


@lru_cache(maxsize=1)
def ranked(run: Run) -> list[Standing]:
    """Every measured codec, the best first."""
    return standings(
        {
            material.name: {
                codec.label: [row.job for row in codec.measured] for codec in material.codecs if codec.measured
            }
            for material in materials(run)
            if material.measured
        }
    )


@lru_cache(maxsize=1)
def against_the_best(run: Run) -> Against:
    """The paired differences to the best codec that has an error; empty if nothing can be compared."""
    ranking = ranked(run)
    best = next((each.label for each in ranking if each.rank is not None and math.isfinite(each.psnr)), "")
    return against(run, best, [each.label for each in ranking if each.label != best])
