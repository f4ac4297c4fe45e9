"""Public reachability benchmarks in one table.

    python -m benchmarks.arch [--data DIR] [--only NAME ...] [--json]

The matrices of the building and of the space station have no closed description: `--data` names a
folder with `building.npz` and `iss.npz`, each with the arrays A, B, C, x0_center, x0_radius, u_low
and u_high. The matrices are in the examples of the tool Hylaa (`build.mat`, `iss.mat`), the sets in
the ARCH-COMP packages of JuliaReach. The same folder may hold the networks that `benchmarks.arch.networks`
names. Everything else is generated here.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from benchmarks.arch import brake, gearbox, linear, networks, platoon, powertrain, rendezvous
from benchmarks.arch.row import Row

PEERS = {
    "building BLDF01 BDS01": "Hylaa 4.2 s (sample times), CORA in Python 0.19 s",
    "building BLDC01 BDS01": "Hylaa 1.07 s",
    "space station ISSF01 ISS01": "Hylaa 40 s, CORA in Python 2.4 s",
    "space station ISSC01 ISS02": "Hylaa 39 s",
}
"""Measured on a machine with two cores, elsewhere."""

FAMILIES: dict[str, Callable[[Path | None], Iterator[Row]]] = {
    "linear": linear.rows,
    "platoon": lambda data: platoon.rows(),
    "rendezvous": lambda data: rendezvous.rows(),
    "gearbox": lambda data: gearbox.rows(),
    "brake": lambda data: brake.rows(),
    "powertrain": lambda data: powertrain.rows(),
    "networks": networks.rows,
}


def number(value: float | None) -> str:
    """Return a figure for the table."""
    return "" if value is None else f"{value:.6g}"


def main() -> int:
    """Run the benchmarks; 1 if a verdict is the opposite of the expected one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder with building.npz and iss.npz")
    parser.add_argument("--only", nargs="+", choices=list(FAMILIES), default=list(FAMILIES))
    parser.add_argument("--json", action="store_true", help="one JSON object per line")
    options = parser.parse_args()
    wrong = []
    if not options.json:
        print(
            f"{'benchmark':22}{'instance':16}{'verdict':10}{'expected':10}{'bound':>12}{'known':>12}"
            f"{'reached':>12}{'s':>9}  note"
        )
    for name in options.only:
        for row in FAMILIES[name](options.data):
            peers = PEERS.get(f"{row.benchmark} {row.instance}", "")
            if options.json:
                print(json.dumps({**asdict(row), "peers": peers}), flush=True)
            else:
                figures = "".join(f"{number(v):>12}" for v in (row.bound, row.known, row.reached))
                note = "; ".join(part for part in (row.note, peers) if part)
                print(
                    f"{row.benchmark:22}{row.instance:16}{row.verdict:10}{row.expected:10}{figures}"
                    f"{row.seconds:9.3f}  {note}",
                    flush=True,
                )
            if not row.right:
                wrong.append(f"{row.benchmark} {row.instance}")
    if wrong:
        print(f"WRONG: {', '.join(wrong)}")
    elif options.data is None and "linear" in options.only and not options.json:
        print("building, space station and networks left out: no --data")
    return bool(wrong)


if __name__ == "__main__":
    raise SystemExit(main())
