"""The sentence that says who leads in a run, for the top of a page.

A run without validation pairs has no budgets (`reports.rungs`), so its codecs are compared as they were measured.
"""

from typing import Any

from bench.compare.paired import AGAINST
from bench.records import Run
from reports.of_rungs import in_words
from reports.ranking import ranked, with_rank
from reports.rows import materials
from reports.rungs import ENOUGH, rungs_of

LEVEL = 0.05  # dB: a smaller lead would read as 0.0


def leads(run: Run) -> str:
    """Who leads, and by how much: within the budget `ENOUGH` or, without budgets, as measured. "" where there are not
    two codecs to compare."""
    clauses = _within_budget(run)
    if clauses:
        return f"At {in_words(ENOUGH)}, medians of test PSNR: {'; '.join(clauses)}."
    return _as_measured(run)


def _within_budget(run: Run) -> list[str]:
    """A clause for each kind of surface: "relief leads on rendered surfaces, 2.5 dB before neubtf-direct".

    The lead, in median PSNR at the budget `ENOUGH`, is that before the codec `AGAINST` or, where it leads itself or is
    missing, before the second. Kinds with fewer than two codecs, or without a best, have no clause.
    """
    rungs = rungs_of(run)
    clauses: list[str] = []
    for kind, surfaces in rungs.kinds.items():
        medians = rungs.readings(ENOUGH, surfaces)["value"]  # by codec, the best first
        has_best = not (rungs.absent_leader(ENOUGH, surfaces) or rungs.is_outdone(ENOUGH, surfaces))
        if len(medians) > 1 and has_best:
            best, *others = medians.index
            other = AGAINST if AGAINST in others else others[0]
            lead = medians[best] - medians[other]
            if lead < LEVEL:
                clauses.append(f"{best} and {other} are level on {kind} surfaces")
            else:
                clauses.append(f"{best} leads on {kind} surfaces, {lead:.1f} dB before {other}")
    return clauses


def _as_measured(run: Run) -> str:
    """A sentence: the best mean PSNR over all materials, and its lead before the best setting of another codec, or that
    both are level; "" unless two codecs were measured on all materials."""
    measured = materials(run)
    ranking = ranked(measured)
    codec_of_label = with_rank(measured, ranking)
    psnr_of: dict[Any, float] = ranking["psnr"][ranking["rank"].notna()].to_dict()
    best_first = sorted(psnr_of, key=lambda label: -psnr_of[label])
    others = [label for label in best_first if codec_of_label[label] != codec_of_label[best_first[0]]]
    if not others:
        return ""
    best, second = best_first[0], others[0]
    lead = psnr_of[best] - psnr_of[second]
    if lead < LEVEL:
        return f"{best} and {second} are level in mean PSNR, and no other codec is better."
    return f"{best} leads: {psnr_of[best]:.1f} dB of mean PSNR, {lead:.1f} dB before {second}."
