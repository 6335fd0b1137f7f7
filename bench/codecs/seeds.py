"""The seed of a fit: the same for a command, a script and a run, so that all three write the same file."""

import hashlib


def seed_of(material: str, codec: str, repetition: int) -> int:
    """The seed of a fit of a codec to a material: 63 bits of the sha256 of both names and the repetition.

    The name of the material is that of its BTF, which does not depend on how a suite calls it.
    """
    parts = f"{material}\n{codec}\n{repetition}"
    digest = hashlib.sha256(parts.encode()).digest()
    first_64_bits = int.from_bytes(digest[:8], "big")
    return first_64_bits >> 1  # without the lowest bit it fits into a signed int64
