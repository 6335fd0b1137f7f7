"""The findings on a BTF as named numbers, which `info` prints and writes as JSON."""

from dataclasses import asdict
from typing import Any

import numpy as np

from bench.btf import BTF, Array, Layout
from bench.data.half_vectors import LEAST_PAIRS
from bench.data.portrait import Look
from bench.directions.hemisphere import to_degrees


def btf_fields(portrait: Look) -> dict[str, Any]:
    """Size, directions, split, range of values, exposure, fingerprint and reader's notes of a BTF, what was found of
    its azimuths, warnings, and notes on what the data do not tell."""
    btf, halves = portrait.btf, portrait.half_vectors
    split = btf.split()
    low, high = portrait.extremes
    return {
        "name": btf.name,
        "shape": btf.shape,
        "pairs": len(btf),
        "periodic": btf.periodic,
        "training": _pairs_fields(btf, split.train),
        "heldout": {name: _pairs_fields(btf, pairs) for name, pairs in split.heldout.items()},
        "low_light": _pairs_fields(portrait.low_light, np.arange(len(portrait.low_light))),
        "slices_read": portrait.read,
        "values": {"minimum": float(low), "median": float(np.median(portrait.values)), "maximum": float(high)},
        "exposed": portrait.exposed._asdict(),
        "views": len(portrait.layout.views),
        "half_vectors": asdict(halves) | {"likely": halves.likely} if halves else None,
        "lobe": asdict(portrait.lobe) if portrait.lobe else None,
        "fingerprint": btf.fingerprint,
        "provenance": btf.provenance,
        "warnings": portrait.warnings(),
        "notes": _notes(portrait),
    }


def _notes(portrait: Look) -> list[str]:
    """Sentences on what the data do not tell: other views, and whether their frame is right."""
    if len(portrait.layout.views) < 2:
        return ["one view: a codec's answers from other views are not measured"]
    if portrait.half_vectors or portrait.lobe:
        return []
    return [
        "frame: not checked: views and lights share no ring of azimuths with all pairs, or all is dark there, and "
        f"fewer than {LEAST_PAIRS} training pairs are lit"
    ]


def _pairs_fields(btf: BTF, pairs: Array) -> dict[str, Any]:
    """The number of some pairs of a BTF, of their views and lights, the largest angles of these from the normal, and
    whether the pairs are the product of both."""
    if not len(pairs):
        return {"pairs": 0}
    layout = Layout.of(btf.wo[pairs], btf.wi[pairs])
    view_theta, _ = to_degrees(layout.views)
    light_theta, _ = to_degrees(layout.lights)
    return {
        "pairs": len(pairs),
        "views": len(layout.views),
        "view_theta_deg": float(view_theta.max()),
        "lights": len(layout.lights),
        "light_theta_deg": float(light_theta.max()),
        "product": layout.grid is not None,
    }
