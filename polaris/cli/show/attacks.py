"""What the command line shows of attempts to prove a run wrong."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from ...simulation.falsification.search import Falsification
    from ...simulation.orbit.model_error import ModelError


def show_falsification(name: str, found: Falsification) -> None:
    """Print the least margin of every limit against what is proven, and a violation."""
    from ...synthesis.recoverable import directed

    told = found.summary()
    typer.echo(f"{name}: {told['runs']} trajectories, {told['runs_per_s']:.0f} per second")
    typer.echo(f"{'limit':24} {'least margin':>13} {'proven':>11} {'proven/least':>13} {'at':>9}")
    for row in told["limits"]:
        proven = directed(row["proven"], ".4g") if math.isfinite(row["proven"]) else "nothing"
        share = f"{row['proven_share']:.0%}" if math.isfinite(row["proven_share"]) else "-"
        typer.echo(f"{row['limit']:24} {row['least']:13.4g} {proven:>11} {share:>13} {row['time_s']:7g} s")
    typer.echo("No violation." if found.failure is None else f"VIOLATED: {found.failure}")


def show_model_error(found: ModelError) -> None:
    """Print the parts of the bound, what is declared, and where it is largest."""
    told = found.summary()
    worst = told["worst"]
    typer.echo(f"{told['scenario']}: what the linear model leaves out where the schedule flies [m/s^2]")
    for name, value in told["parts_m_s2"].items():
        typer.echo(f"  {name.replace('_', ' '):16} {value:9.3g}")
    typer.echo(f"  {'bound':16} {told['bound_m_s2']:9.3g}   (sampled: {told['sampled_share']:.0%} of it)")
    typer.echo(
        f"  {'declared':16} {told['declared_m_s2']:9.3g}   {'covers it' if found.covered else 'TOO SMALL'}"
    )
    typer.echo(
        f"Largest at t = {worst['time_s']:g} s under {worst['controller']}: within"
        f" {worst['distance_m']:.0f} m of the target, {worst['radial_m']:.0f} m in height,"
        f" {worst['speed_m_s']:.2f} m/s."
    )
    for name, time in told["satellites_covered_until_s"].items():
        until = "as long as it is perceived" if time is None else f"until t = {time:g} s"
        typer.echo(f"The motion declared for {name} covers its own model error {until}.")
