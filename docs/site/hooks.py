"""What the site has beside the pages under docs: those of the repository's root, and what the code generates."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

import python_page
from mkdocs.structure.files import File

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]

#: Pages of the site, by the files of the repository's root.
PAGES = {
    "README.md": "index.md",
    "DESIGN.md": "design.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not under docs."""
    generated = {page: (ROOT / file).read_text("utf-8") for file, page in PAGES.items()}
    generated["reference/python.md"] = python_page.page()
    for page, text in generated.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_: object) -> str:
    """Have links lead to pages of the site, and to the repository where they leave it."""
    of_root = page.file.src_uri in PAGES.values()

    def target(found: re.Match[str]) -> str:
        link, _, anchor = found[1].partition("#")
        if not link or "://" in link or link.startswith("mailto:"):
            return found[0]
        folder = posixpath.dirname(page.file.src_uri)
        path = posixpath.normpath(link if of_root else posixpath.join("docs", folder, link))
        if path not in PAGES and not path.startswith("docs/"):
            return f"]({config.repo_url}/blob/main/{path})"
        link = posixpath.relpath(PAGES.get(path, path.removeprefix("docs/")), folder or ".")
        return f"]({link}{'#' if anchor else ''}{anchor})"

    # Pictures of the README, which have a width.
    markdown = markdown.replace('src="docs/', 'src="')
    return re.sub(r"\]\(([^)\s]+)\)", target, markdown)
