"""Compares the numbers of a submitted record with those measured from its codec file on this machine."""

import json
import math
from collections.abc import Iterator
from typing import Any

from bench.codec import settings_dict
from bench.codecs.container import Header
from bench.codecs.registry import COMMAND, make_codec
from bench.inputs.errors import InputError
from bench.records import CLAIM, OUTSIDE, Record, kept

DECIBELS, RELATIVE = 0.01, 1e-3  # the largest change by rounding on another processor


def differences(claimed: Record, here: Record) -> Iterator[str]:
    """The claims that differ from the measurements here by more than rounding on another processor, in words."""
    here = json.loads(json.dumps(here))
    for name, value in kept(claimed, CLAIM).items():
        yield from _unlike(name, value, here[name])


def _unlike(place: str, claimed: Any, measured: Any) -> Iterator[str]:
    if isinstance(claimed, dict) and isinstance(measured, dict):
        for name, value in claimed.items():
            if place in ("scores", "pairs") and name in ("scene", OUTSIDE):
                continue  # scores in a scene: archives hold no demand, and these are not published
            yield from _unlike(f"{place}/{name}", value, measured.get(name))
        return
    close = claimed == measured
    if float in (type(claimed), type(measured)) and None not in (claimed, measured):
        decibels = "/psnr" in place or place.startswith("footprints/")
        limit = DECIBELS if decibels else RELATIVE * abs(measured)
        close = math.isclose(claimed, measured, rel_tol=0, abs_tol=limit)
    if not close:
        yield f"{place} is {measured}, not {claimed}"


def misnamed(claimed: Record, header: Header) -> Iterator[str]:
    """Why the names of a job do not fit its file: a label holds the codec and the settings that are not defaults."""
    label, curve = str(claimed["label"]), str(claimed["curve"])
    given = header.settings if header.codec == COMMAND else {}
    own = {key: given[key] for key in ("called", "encode", "decode") if key in given}
    called = str(own.get("called", header.codec))
    words = label.removeprefix(called).split()
    try:
        settings = dict(word.split("=", 1) for word in words)
        named = settings_dict(make_codec(header.codec, own | settings))
        whole = settings_dict(make_codec(header.codec, header.settings))
    except (InputError, ValueError):
        named, whole = {}, {"": None}
    if not label.startswith(called) or named != whole:
        yield f"label is {label!r}, but the file's codec and settings have another label"
    if not curve.startswith(called) or not {*curve.removeprefix(called).split()} <= {*words}:
        yield f"curve is {curve!r}, which does not belong to the label"
    if (name := f"{claimed['material']}/{label}/{claimed['seed']}") != claimed["job"]:
        yield f"job is {claimed['job']!r}, not {name!r}"
