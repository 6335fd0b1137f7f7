"""Lays the site of `mkdocs.yml` out as the repository is, so that the links of its pages hold on both.

MkDocs reads the folder `docs` alone. This adds the pages at the root, `reference.md` with the names that
docs/adding-a-codec.md lists as public, and a page for every other file or folder that a page links to.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
MODULE = re.compile(r"^\| `(bench[\w.]*)` \| (.*) \|$", re.M)  # a row of public names, each in backticks
LINK = re.compile(r"(?<=\]\()[\w./-]+(?=\))")  # the target of a link without a scheme or an anchor


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The files of the site under their paths in the repository, and the theme's."""
    of_docs = [Path(config.docs_dir, file.src_uri) for file in files if file.src_dir == config.docs_dir]
    site = Files([file for file in files if file.src_dir != config.docs_dir])
    site.append(File.generated(config, "reference.md", content=_reference(Path(config.docs_dir))))
    for path in (*ROOT.glob("*.md"), *of_docs):
        site.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    for page in site.documentation_pages():
        for source in {_from_root(page, target) for target in LINK.findall(page.content_string)}:
            if source not in site.src_uris and f"{source}.md" not in site.src_uris and (ROOT / source).exists():
                text = _source_page(ROOT / source)
                site.append(File.generated(config, f"{source}.md", content=text, inclusion=InclusionLevel.NOT_IN_NAV))
    return site


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The text of a page with its links to such files and folders leading to their pages."""

    def target_on_site(link: re.Match[str]) -> str:
        of_source = files.get_file_from_path(f"{_from_root(page.file, link[0])}.md")
        return f"{link[0]}.md" if of_source else link[0]

    return LINK.sub(target_on_site, markdown)


def _reference(docs: Path) -> str:
    """The text of `reference.md`, then each name that codecs may import and that is not in it yet."""
    text = Path(__file__).with_name("reference.md").read_text(encoding="utf-8")
    lines = ["", "## What codecs may import", ""]
    for module, names in MODULE.findall((docs / "adding-a-codec.md").read_text(encoding="utf-8")):
        for name in re.findall(r"`(\w+)`", names):
            if not name.isupper() and f"::: {module}.{name}\n" not in text:  # constants have no docstring
                lines += [f"::: {module}.{name}", ""]
    return text + "\n".join(lines)


def _from_root(page: File, target: str) -> str:
    """The path in the repository to which a link of a page leads."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(page.src_uri), target))


def _source_page(path: Path) -> str:
    """A page that shows a file, or all files of a folder, as code; searches leave it out."""
    shown = [path] if path.is_file() else sorted(file for file in path.iterdir() if file.is_file())
    header = f"---\ntitle: {path.relative_to(ROOT).as_posix()}\nsearch: {{exclude: true}}\n---\n"
    codes = [f"## `{file.name}`\n\n``````{file.suffix[1:]}\n{file.read_text()}\n``````\n" for file in shown]
    return header + "\n".join(codes)
