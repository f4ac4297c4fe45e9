"""Files of a run folder, read once and within bounds: whoever made the folder may not exhaust the checker.

Raised are `Rejected` (claim ``artefacts``) for a folder, or a device or pipe, whose end may never come;
`Undecided` for a file that is too large; `OSError` for one that cannot be read.
"""

import hashlib
from pathlib import Path

from .verdict import Rejected, Undecided

LARGEST = 256 * 2**20  # largest file whose contents are read [bytes]
LARGEST_SCENARIO = 4 * 2**20  # largest scenario file [bytes]
LARGEST_HASHED = 16 * 2**30  # largest file that is hashed [bytes]


def contents(path: Path, most: int = LARGEST) -> bytes:
    """The bytes of a regular file, or of what a link to one leads to."""
    _regular(path, most)
    with path.open("rb") as file:
        data = file.read(most + 1)  # it may have grown since
    if len(data) > most:
        raise Undecided("artefacts", f"{ascii(path.name)} is larger than {most} bytes")
    return data


def found(path: Path) -> bool:
    """Whether a folder has an entry of this name, be it a link that leads nowhere."""
    return path.exists() or path.is_symlink()


def sha256(path: Path) -> str:
    """SHA-256 of a file, piece by piece."""
    _regular(path, LARGEST_HASHED)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _regular(path: Path, most: int) -> None:
    if found(path) and not path.is_file():
        raise Rejected("artefacts", f"{ascii(path.name)} is no regular file")
    if path.stat().st_size > most:
        raise Undecided("artefacts", f"{ascii(path.name)} is larger than {most} bytes")
