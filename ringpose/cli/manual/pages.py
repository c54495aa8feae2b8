"""The manual pages of this installation, by topic."""

from collections.abc import Sequence
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

from ringpose.cli.manual.mdoc import unescaped
from ringpose.errors import NoInputError, UsageError
from ringpose.files.schema import hint

PREFIX = "ringpose-"


class ManualPage(NamedTuple):
    """A page, and the one line that its NAME section has."""

    topic: str
    section: str
    path: Path

    @property
    def description(self) -> str:
        """The text of the page's `.Nd` line."""
        lines = self.path.read_text(encoding="utf-8").splitlines()
        return next(unescaped(line.removeprefix(".Nd ")) for line in lines if line.startswith(".Nd "))


def manual_pages() -> dict[str, ManualPage]:
    """All pages by topic: commands first, then file formats (5) and other subjects (7)."""
    pages = {}
    for path in sorted(_files(), key=lambda path: (path.suffix, path.stem)):
        topic = path.stem.removeprefix(PREFIX)
        pages[topic] = ManualPage(topic, path.suffix[1:], path)
    if not pages:
        raise NoInputError("", "the manual pages are not installed", "install ringpose again, with pip")
    return pages


def page_of(words: Sequence[str]) -> ManualPage:
    """The page that `pose`, `ringpose-pose`, `ringpose-pose.1` or two words such as `simulate serve` name."""
    pages = manual_pages()
    named = "-".join(words)
    topic = named.removesuffix(f".{named[-1:]}") if named[-1:].isdigit() else named
    topic = topic.removeprefix(PREFIX)
    if topic not in pages and words[0] in pages and f".Nm ringpose {' '.join(words)}\n" in _text(pages[words[0]]):
        topic = words[0]  # a command of two words stands in the page of the first
    if topic not in pages:
        remedy = hint(topic, pages) or "see the topics: ringpose help"
        raise UsageError("", f"there is no manual page on {' '.join(words)!r:.60}", remedy)
    return pages[topic]


def _text(page: ManualPage) -> str:
    return page.path.read_text(encoding="utf-8")


def _files() -> list[Path]:
    """Of a checkout its folder man/, which is newer than what was installed from it; else what pip has installed."""
    checkout = Path(__file__).parents[3] / "man"
    if (checkout / "ringpose.1").exists():
        return list(checkout.glob("ringpose*.[1-9]"))
    installed = distribution("ringpose").files or []
    return [Path(str(file.locate())).resolve() for file in installed if file.parent.parent.name == "man"]
