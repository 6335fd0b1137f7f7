"""What installed codecs say of themselves: a line, what to cite, and their settings as ours and as published."""

from typing import Any

from bench.codec import Codec, described_settings
from bench.codecs import registry
from bench.inputs import plugins
from bench.inputs.errors import InputError
from bench.inputs.settings import as_typed

_SUITE = """@software{neubtfbench,
  author = {{The NeuBTF bench authors}},
  title = {neubtf-bench: a benchmark of neural codecs of bidirectional texture functions}
}"""  # as CITATION.cff says


def described_codecs() -> dict[str, dict[str, Any]]:
    """What each installed codec says of itself, by name: `about`, `origin`, `bibtex`, the links of its `paper` and
    `code`, and its `settings` as `_settings_in_words` gives them, none if it cannot be imported.
    """
    descriptions = {}
    for name, entry in registry.codec_entries().items():
        about = registry.describe(entry)
        settings: list[tuple[str, str, str, str]] = []
        try:
            codec = registry.load_codec(name)
        except InputError:
            about += " It cannot be imported here."
        else:
            settings = _settings_in_words(codec)
        cited = registry.reference(entry)
        if not cited["bibtex"] and not registry.from_outside(name):
            cited["bibtex"] = _SUITE  # of this suite, without a paper of its own
        origin = f"{entry.value} of {plugins.origin(entry)}"
        descriptions[name] = {"about": about, "origin": origin, "settings": settings} | cited
    return descriptions


def _settings_in_words(codec: type[Codec]) -> list[tuple[str, str, str, str]]:
    """The name, meaning, default and published value of each setting of a codec.

    The published value is that of the codec's recipe `paper`; "" without such a recipe.
    """
    paper = codec.recipes.get("paper")
    settings = []
    for each in described_settings(codec):
        published = ""
        if paper is not None:
            # A setting that the recipe does not name has its default there.
            published = as_typed("paper" if each.name == "recipe" else paper.get(each.name, each.default))
        settings.append((each.name, each.meaning, each.default, published))
    return settings
