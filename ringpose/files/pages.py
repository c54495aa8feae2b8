"""HTML pages."""

from pathlib import Path

from ringpose.files import atomic


def write_page(path: Path, html: str, *, force: bool = False) -> None:
    """Write one page."""
    with atomic.replacing(path, force) as stream:
        stream.write(html.encode(errors="backslashreplace"))  # names of files may have bytes that are no UTF-8
