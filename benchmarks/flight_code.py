"""Time of one call of the flight code, compiled with gcc, beside the same call in Python.

    python -m benchmarks.flight_code RUN                a run folder whose schedule is proved

A flight of S is called period by period, and one in which U asks the online monitor in every period; the best
of several blocks counts, as the machine may be busy with other things.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from pathlib import Path

from polaris.certificate.code.answers import FlightStep
from polaris.certificate.code.text import PRECISIONS
from polaris.flight.export import export_c, flight_tables
from polaris.runs.read_schedule import certificate_of

BLOCKS, CALLS = 20, 100_000

TIMER = """
#include "bench.h"
#include <stdio.h>
#include <time.h>
int main(void)
{
    double best = 1e9;
    for (int block = 0; block < BLOCKS; block++) {
        bench_memory memory;
        bench_input input = {0};
        bench_output output;
        bench_start(&memory);
        const clock_t begun = clock();
        for (int i = 0; i < CALLS; i++) {
            input.period = i % (BENCH_CELLS * BENCH_PARTS);
            if (input.period == 0) bench_start(&memory);
            bench_step(&memory, &input, &output);
        }
        const double spent = (double)(clock() - begun) / CLOCKS_PER_SEC / CALLS;
        if (spent < best) best = spent;
    }
    printf("%g", best);
    return 0;
}
"""

DECIDED = (
    ("bench_memory", "bench_online"),
    ("bench_start", "bench_online_start"),
    ("bench_step", "bench_online_step"),
    ("{0}", "{.controller = 1}"),
    ("BENCH_CELLS", "BENCH_STEPS"),
    ("CALLS", "(CALLS / 50)"),
)
"""What the timer calls instead for decisions, whose loops are as long for every state."""


def in_c(run: str, precision: str, monitor: bool) -> float:
    """Time of a call [s] by the processor's clock."""
    text = TIMER
    for old, new in DECIDED if monitor else ():
        text = text.replace(old, new)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "code"
        export_c(run, folder, precision, "bench", monitor=monitor)
        timer = Path(place) / "timer.c"
        timer.write_text(text.replace("BLOCKS", str(BLOCKS)).replace("CALLS", str(CALLS)))
        command = ["gcc", "-std=c99", "-O2", "-ffp-contract=off", f"-I{folder}", folder / "bench.c", timer]
        subprocess.run([*command, "-o", Path(place) / "timer"], check=True)
        return float(subprocess.run([Path(place) / "timer"], check=True, capture_output=True).stdout)


def in_python(run: str) -> float:
    """Time of a call [s] by the processor's clock."""
    tables = flight_tables(certificate_of(Path(run)))
    n, m, seconds, calls = len(tables.gain[0]), len(tables.limit), 1e9, CALLS // 100
    for _ in range(BLOCKS):
        step, start = FlightStep(tables), time.process_time()
        for i in range(calls):
            step.step(i, [0.0] * n, 0, [0.0] * m)
        seconds = min(seconds, (time.process_time() - start) / calls)
    return seconds


def main() -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("run", help="a run folder")
    run = parser.parse_args().run
    for precision in PRECISIONS:
        for monitor in (False, True):
            unit = "decision" if monitor else "call"
            print(f"{precision:8} {in_c(run, precision, monitor) * 1e9:9.1f} ns a {unit} in C")
    print(f"{'double':8} {in_python(run) * 1e9:9.1f} ns a call in Python")


if __name__ == "__main__":
    main()
