"""Pages of the site, made of what is in the repository: each README at its own place, the reference, and formulas.

A hook of MkDocs. Links between pages stay as they are. A link to anything else, a program or a folder, becomes its
text, for the site has no copy of it. The reference is made of the public names of each package. `$...$` becomes MathML,
which browsers draw without a program.
"""

from __future__ import annotations

import re
import sys
from importlib import import_module
from pathlib import Path
from posixpath import dirname, join, normpath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("teleop", "channel", "master", "slave")
FIGURES = ".figures/"
LINK = re.compile(r"(!?)\[((?:[^\]\[]|\[[^\]]*\])*)\]\(([^)\s]+)\)")

def on_files(files: Files, config: Any) -> Files:
    """Add the pages and figures of the repository, and the reference."""
    sys.path.insert(0, str(ROOT))  # while a hook is loaded MkDocs has a path of its own
    folders = ("", *(f"{each}/**/" for each in (*PACKAGES, "scenarios", "tests")))
    for path in sorted({path for folder in folders for path in ROOT.glob(f"{folder}*.md")}):
        files.append(File.generated(config, path.relative_to(ROOT).as_posix(), content=path.read_text()))
    for path in (ROOT / FIGURES).glob("*.*"):
        if path.suffix != ".py":
            files.append(File.generated(config, f"figures/{path.name}", abs_src_path=str(path)))
    for package in PACKAGES:
        files.append(File.generated(config, f"reference/{package}.md", content=reference(package)))
    return files


def reference(package: str) -> str:
    """The public names of a package, in the order of the alphabet, each from its own module."""
    homes = {name: f"{package}.{module}" for module, names in import_module(package)._HOMES.items() for name in names}
    names = sorted(homes, key=str.lower)
    return "\n\n".join([f"# {package}", *[f"::: {homes[name]}.{name}" for name in names]])


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:  # noqa: ARG001 - MkDocs calls it so
    """Point figures at their copies, take out links that lead out of the site, and write formulas as MathML."""
    def target(match: re.Match[str]) -> str:
        picture, text, where = match.groups()
        path = where.partition("#")[0]
        place = normpath(join(dirname(page.file.src_uri), path)) if path else page.file.src_uri
        if place.startswith(FIGURES):
            up = "../" * page.file.src_uri.count("/")
            return f"{picture}[{text}]({up}figures/{place.removeprefix(FIGURES)})"
        if "://" in where or files.get_file_from_path(place) is not None:
            return match[0]
        return text

    blocks = re.split(r"(```.*?```)", markdown, flags=re.DOTALL)
    blocks[::2] = [LINK.sub(target, block) for block in blocks[::2]]
    text = "".join(blocks)
    if page.file.src_uri != "laws.md":
        return text
    text = re.sub(r"\$\$(.+?)\$\$", lambda match: convert(match[1], display="block"), text, flags=re.DOTALL)
    # In a span, for Markdown takes a line that begins with <math> for a block; and | would part cells of a table.
    return re.sub(r"\$([^$]+)\$", lambda match: f"<span>{convert(match[1])}</span>".replace("|", "&#124;"), text)
