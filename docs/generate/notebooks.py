"""Execute the notebooks of the documentation and store their outputs in them.

Run it by ``python -m docs.generate.notebooks``.
"""

import os
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
LONGEST = 900  # of a cell [s]


def executed(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with new outputs, executed in an empty folder; a cell that fails raises its error."""
    book = nbformat.read(path, as_version=4)
    os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            book,
            timeout=LONGEST,
            record_timing=False,
            coalesce_streams=True,
            resources={"metadata": {"path": folder}},
        )
        client.execute(env=os.environ | {"PYTHONPATH": str(FOLDER.parents[1])})
    return book


def printed(book: nbformat.NotebookNode) -> list[str]:
    """Return the printed output of each code cell."""
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    return ["".join(one.text for one in cell.outputs if "text" in one) for cell in cells]


def main() -> None:
    """Execute all notebooks and write them back."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        nbformat.write(executed(path), path)
        print(path.name)


if __name__ == "__main__":
    main()
