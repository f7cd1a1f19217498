"""MkDocs hooks: add pages made from other files, rewrite links, and check the finished site.

`mkdocs build --strict` calls the functions below; see mkdocs.yml.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import pkgutil
import re
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

import labyrinth_core
from labyrinth_core.command.arguments import parser

ROOT = Path(__file__).parents[1]

ROOT_PAGES = {"changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
"""Page of the site -> the file at the top of the repository that it shows."""

LOGS = ("measurements/", "results/")
"""Folders of pages that are not searchable: the output of benchmarks and evaluations."""

NO_ALTERNATIVE = "No description has been provided for this image"
"""The alt text that nbconvert gives every picture."""


@event_priority(100)  # Before the plugins that look at files.
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and examples that lie outside docs/."""
    for page, source in ROOT_PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    for path in sorted((ROOT / "examples").iterdir()):
        if path.suffix in (".ipynb", ".py"):
            name = f"examples/{path.name}"
            files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Return the text of a page with links resolved and placeholders replaced."""
    source = page.file.src_uri
    if source.startswith(LOGS):
        page.meta["search"] = {"exclude": True}
    if source in ROOT_PAGES:
        markdown = re.sub(r"\]\(docs/", "](", markdown)
    else:
        markdown = markdown.replace("](../examples/", "](examples/")
    return re.sub(r"<!-- (modules|help) of (\S+) -->", _filled, markdown)


def on_page_content(html: str, *, page: Any, **_: Any) -> str:
    """Return the body of a page; in notebooks, resolve links to pages and add alt texts."""
    if page.file.src_uri.endswith(".ipynb"):
        html = re.sub(r'href="\.\./docs/([\w/-]+)\.md', r'href="../\1.html', html)
        for words in alternatives(ROOT / page.file.src_uri):
            html = html.replace(NO_ALTERNATIVE, words, 1)
    return html


def alternatives(notebook: Path) -> Iterator[str]:
    """Yield the alt text of each picture of a notebook, which nbconvert drops."""
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", {}):
                yield output["metadata"].get("image/png", {}).get("alt", NO_ALTERNATIVE)


def _filled(mark: re.Match[str]) -> str:
    """Return the text that replaces a mark in a page."""
    kind, of = mark.groups()
    if kind == "modules":
        return "\n\n".join(
            f"::: {name}\n    options: {{show_root_full_path: true}}"
            for name in modules(of.replace("/", "."))
        )
    return "\n\n".join(f"```text\n{text.rstrip()}\n```" for text in helps(of))


def modules(package: str) -> Iterator[str]:
    """Yield the names of a package's public modules."""
    folder = ROOT / package.replace(".", "/")
    for module in pkgutil.iter_modules([str(folder)]):
        if not module.name.startswith("_"):
            yield f"{package}.{module.name}"


def helps(program: str) -> Iterator[str]:
    """Yield the `--help` text of a program, and of each of its commands."""
    if program == "labyrinth-datasets":
        command = [sys.executable, str(ROOT / "run.py"), "--help"]
        yield subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout
        return
    os.environ["COLUMNS"] = "90"
    grammar = parser()
    yield grammar.format_help()
    for action in grammar._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from (each.format_help() for each in action.choices.values())


def on_post_build(config: MkDocsConfig) -> None:
    """Check the reference, the alt texts of pictures, and the links.

    Raises:
        PluginError: A public name has no entry, a picture has no alt text, or a link is broken;
            the message lists all of them.
    """
    site = Path(config.site_dir)
    missing = public_names() - entries(site / "objects.inv")
    problems = [f"{name} is not in the reference" for name in sorted(missing)]
    for page in sorted(site.rglob("*.html")):
        html = page.read_text(encoding="utf-8")
        problems += [
            f"{page.relative_to(site)}: {image}"
            for image in re.findall(r"<img [^>]*>", html)
            if NO_ALTERNATIVE in image or not re.search(r'alt="[^"]', image)
        ]
        problems += [
            f"{page.relative_to(site)}: broken link {link}" for link in dead_links(page, html)
        ]
    if problems:
        raise PluginError("; ".join(problems))


def dead_links(page: Path, html: str) -> Iterator[str]:
    """Yield the broken relative links of a page; MkDocs does not check all of them."""
    for link in re.findall(r'<(?:a|img|link|script) [^>]*?(?:href|src)="?([^">#?\s]+)', html):
        if not re.match(r"[a-z]+:|/", link) and not (page.parent / unquote(link)).exists():
            yield link


def public_names() -> set[str]:
    """Return the dotted names of all public functions and classes, and of `__all__`."""
    names = {f"labyrinth_core.{name}" for name in labyrinth_core.__all__}
    for path in (ROOT / "labyrinth_core").glob("*/*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        if path.parent.name == "command" or path.name == "__init__.py":
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            kinds = (ast.FunctionDef, ast.ClassDef)
            if isinstance(node, kinds) and not node.name.startswith("_"):
                names.add(f"{module}.{node.name}")
    return names


def entries(inventory: Path) -> set[str]:
    """Return the names in the site's inventory of objects, to which other sites can link.

    The format is that of Sphinx: four lines of text, then lines compressed by zlib.
    """
    compressed = inventory.read_bytes().split(b"\n", 4)[4]
    return {line.split(" ", 1)[0] for line in zlib.decompress(compressed).decode().splitlines()}
