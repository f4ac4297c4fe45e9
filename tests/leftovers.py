"""Leftovers of a process that is killed while it writes."""

import subprocess
import sys
from pathlib import Path

from polaris.runs.files import ownership


def left_by_a_dead_process(target: Path, word: str = "new") -> Path:
    """A half-written folder beside `target`."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    leftover = target.with_name(f".{target.name}.{word}-{ownership.host()}-{process.pid}-0123abcd")
    leftover.mkdir()
    ownership.start_list(leftover)
    (leftover / "half").write_bytes(b"half")
    return leftover
