"""What installed codecs say of themselves: a line, what to cite, and their settings as ours and as published."""

from typing import Any

from bench.codec import described_settings
from bench.codecs import registry
from bench.inputs.errors import InputError

_SUITE = """@software{neubtfbench,
  author = {{The NeuBTF bench authors}},
  title = {neubtf-bench: a benchmark of neural codecs of bidirectional texture functions}
}"""  # as CITATION.cff says


def described_codecs() -> dict[str, dict[str, Any]]:
    """Of each installed codec `about`, `origin`, `bibtex`, links of its `paper` and `code`, and its `settings`.

    A setting is its name, its meaning, its default, and the one that was published, "" where the codec has but one.
    There are none of a codec that cannot be imported.
    """
    found = {}
    for name, entry in registry.codec_entries().items():
        about = registry.describe(entry)
        settings: list[tuple[str, str, str, str]] = []
        try:
            codec = registry.load_codec(name)
        except InputError:
            about += " It cannot be imported here."
        else:
            paper = codec.recipes.get("paper")
            published = {}  # the settings of the recipe `paper`, if the codec has one
            if paper is not None:
                published = {"recipe": "paper"} | dict(paper)
            for each in described_settings(codec):
                # A setting that the recipe does not name has its default there.
                theirs = str(published.get(each.name, each.default)) if published else ""
                settings.append((each.name, each.meaning, each.default, theirs))
        cited = registry.reference(entry)
        if not cited["bibtex"] and not registry.from_outside(name):
            cited["bibtex"] = _SUITE  # of this suite, without a paper of its own
        origin = f"{entry.value} of {registry.origin(entry)}"
        found[name] = {"about": about, "origin": origin, "settings": settings} | cited
    return found
