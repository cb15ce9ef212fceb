"""What the site has beside the pages of docs/: start page, reference, and files that pages link to.

mkdocs calls these functions (`hooks` in mkdocs.yml).
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Final

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

sys.path.insert(0, str(Path(__file__).parent))

import alphabetical
import reference

ROOT: Final = Path(__file__).parents[2]
_LINK: Final = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
_PAGES: Final = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "security.md": "SECURITY.md",
                 "changelog.md": "CHANGELOG.md", "results.md": "results/README.md"}  # fmt: skip
"""Pages of the site that are files of the project outside docs/."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and files that are not in docs/."""
    for name, source in _PAGES.items():
        files.append(File.generated(config, name, content=_moved((ROOT / source).read_text(), source)))
    files.append(File.generated(config, "reference/configuration.md", content=reference.configuration()))
    files.append(File.generated(config, "reference/messages.md", content=reference.messages()))
    files.append(File.generated(config, "reference/index-a-z.md", content=alphabetical.page()))
    for name, page in reference.public_names().items():
        files.append(File.generated(config, f"reference/{name}.md", content=page))
    for path in sorted((ROOT / "docs" / "examples" / "notebooks").glob("*.py")):
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=notebook(path.read_text())))
    for source in sorted(_linked()):
        files.append(File.generated(config, f"files/{source}", content=(ROOT / source).read_text()))
    return files


def notebook(text: str) -> str:
    """A notebook in the percent format as a page: its text, and its code in blocks."""
    _, *parts = re.split(r"^# %%(.*)\n", text, flags=re.MULTILINE)
    cells = []
    for kind, content in zip(parts[::2], parts[1::2], strict=True):
        if "[markdown]" in kind:
            cells.append(re.sub(r"^# ?", "", content, flags=re.MULTILINE))
        else:
            cells.append(f"```python\n{content.strip()}\n```\n")
    return "\n".join(cells)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links to files outside docs/ lead to their copies in the site."""
    if page.file.generated_by is not None:
        return markdown
    return _moved(markdown, f"docs/{page.file.src_uri}")


def _linked() -> set[str]:
    """Files outside docs/ that a page links to, and that are no page of the site."""
    found = set()
    for path in [*(ROOT / "docs").glob("*.md"), *(ROOT / source for source in _PAGES.values())]:
        for _, _, target in _LINK.findall(path.read_text()):
            if (file := _file(path.relative_to(ROOT), target)) is not None:
                found.add(file)
    return found


def _file(source: Path, target: str) -> str | None:
    """The file outside docs/ that a link of a page leads to; None if it leads elsewhere."""
    if "://" in target or target.startswith(("#", "mailto:")):
        return None
    path = (ROOT / source.parent / target.partition("#")[0]).resolve()
    if not path.is_file() or not path.is_relative_to(ROOT):
        return None
    name = str(path.relative_to(ROOT))
    return None if name.startswith("docs/") or name in _PAGES.values() else name


def _moved(markdown: str, source: str) -> str:
    """The text of the file `source` with links that hold in the site, where its page is at the top."""

    def link(match: re.Match[str]) -> str:
        mark, text, target = match.groups()
        name, sign, anchor = target.partition("#")
        if "://" in target or not name:
            return match[0]
        path = (ROOT / Path(source).parent / name).resolve()
        inside = str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else name
        if path.is_dir():
            return f"{text} (`{inside}`)"
        pages = {value: key for key, value in _PAGES.items()}
        where = pages.get(inside) or inside.removeprefix("docs/")
        if where == inside:
            where = f"files/{inside}"
        return f"{mark}[{text}]({where}{sign}{anchor})"

    return _LINK.sub(link, markdown)
