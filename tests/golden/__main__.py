"""Compare what every scene proves today with the golden table: ``python -m tests.golden``.

Better results pass; a lost proof, a smaller margin, a wider tube or a share of U that falls by more than one
point is a fault. The exit code is 1 if there is a fault.
"""

import argparse
import sys
import time
from collections.abc import Sequence

from tests.golden.comparison import BETTER, WORSE, compare
from tests.golden.rows import make_row, read_table, write_table
from tests.golden.scenes import SMALL, scenes


def main(arguments: Sequence[str] | None = None) -> int:
    """Make rows, print how they differ from the stored ones, and return the exit code."""
    options = _parser().parse_args(arguments)
    available, table, counts = scenes(), read_table(), {WORSE: 0, BETTER: 0}
    if unknown := set(options.only or ()) - set(available):
        print(f"--only: no scene is called {', '.join(sorted(unknown))}")
        return 2
    names = options.only or (SMALL if options.part == "small" else list(available))
    if options.missing:
        names = [name for name in names if name not in table]
    for name in names:
        start = time.process_time()
        row, message = make_row(available[name])
        seconds = time.process_time() - start
        outcome = ", ".join(filter(None, [f"exit code {row['exit_code']}", row.get("verdict"), message]))
        print(f"{name}: {outcome} ({seconds:.1f} CPU-s)")
        differences = compare(table[name], row) if name in table else []
        for difference in differences:
            counts[difference.kind] = counts.get(difference.kind, 0) + 1
            print(f"  {difference}")
        if options.write:
            merged = table | {name: row}
            table = {each: merged[each] for each in available if each in merged}
            write_table(table)
        elif name not in table:
            counts[WORSE] += 1
            print("  worse  it is not in the table (--write adds it)")
        sys.stdout.flush()
    print(f"{len(names)} rows: {counts[WORSE]} faults, {counts[BETTER]} better")
    return int(counts[WORSE] > 0 and not options.write)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("--write", action="store_true", help="store the rows of today")
    parser.add_argument("--missing", action="store_true", help="make only rows that the table lacks")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--only", action="append", metavar="NAME", help="make this row; repeatable")
    which.add_argument("--part", choices=("small", "all"), default="all", help="which rows (default: all)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
