"""What a process leaves that is killed while it writes."""

import subprocess
import sys
from pathlib import Path

from polaris.runs import ownership


def left_by_a_dead_process(target: Path, word: str = "new", *, folder: bool = False) -> Path:
    """A half-written file or folder beside `target`."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    left = target.with_name(f".{target.name}.{word}-{ownership.host()}-{process.pid}-0123abcd")
    if folder:
        left.mkdir()
        (left / "half").write_bytes(b"half")
    else:
        left.write_bytes(b"half")
    return left
