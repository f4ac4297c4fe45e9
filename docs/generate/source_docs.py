"""Write the table of ``CONTRIBUTING.md`` that says where each declared error enters, from the code.

Run ``python -m docs.generate.source_docs`` after a change to a source; a test compares the page.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from polaris.certificate.files.document import Document
from polaris.certificate.files.file_keys import CERTIFICATE
from polaris.certificate.files.structure import conform
from polaris.certificate.kernel.balls import matrix
from polaris.certificate.model.craft.craft import Craft
from polaris.certificate.model.craft.states import craft_of
from polaris.certificate.model.plants import plant_of
from polaris.model.errors import ScenarioError
from polaris.model.scene.obstacle import chaser_radius
from polaris.rta.decision_grid import met_by_decisions
from polaris.runs.certificate import hexadecimal
from polaris.runs.files.controllers import system_table
from polaris.scenario.scenario import load_scenario
from polaris.simulation.delayed import flies
from polaris.simulation.integration import columns
from polaris.synthesis.safety.problem import Problem
from polaris.synthesis.sources.craft import assumed, sources
from polaris.synthesis.sources.estimate import step_errors
from polaris.synthesis.tracker.loop import Loop

from .method_docs import put

PAGE = Path(__file__).parents[2] / "CONTRIBUTING.md"

HEAD = {
    "Source": "",
    "Table": "",
    "Loop": "polaris.synthesis.sources.craft.craft_loop",
    "Beside the loop": "polaris.scenario.schedule.ScheduleScenario.problem",
    "Checker": "polaris.certificate.model.craft.states.craft_of",
    "Assumption": "polaris.synthesis.sources.craft.assumed",
    "Simulation, `falsify`": "polaris.simulation.delayed.flies",
    "Run-time methods": "polaris.rta.decision_grid.DecisionGrid.from_schedule",
}
"""Columns, and the one function that puts the errors of all rows in its place."""

CAMERA = "navigation.measurement.position_error_m=0.1"
PHASE = "from_s=600.0,position_error_m=0.02,velocity_error_m_s=0.001"
ESTIMATE = "navigation.position_error_m=0.05", "navigation.velocity_error_m_s=0.002"
BIT = "thrusters.impulse_bit_N_s=0.005"
MOVING = "obstacles[0].velocity_m_s=[0.01,0.0,0.0]"
LATE = 'faults=[{kind="loss",share=0.2,isolation_s=4.0}]'


@dataclass(frozen=True)
class Row:
    """One declared error: its table in the scenario, an example, and the errors that it is added to."""

    name: str
    table: str
    example: tuple[str, ...]
    beside: tuple[str, ...] = ()


ROWS = (
    Row("Disturbance", "system.disturbance_max", ("system.disturbance_max_m_s2=6e-5",)),
    Row("Constant disturbance", "system.bias_max", ("system.bias_max_m_s2=[0.0,1e-6,0.0]",)),
    Row("Estimate of the state", "navigation", ESTIMATE),
    Row("Phases of navigation", "navigation.phases", (f"navigation.phases=[{{{PHASE}}}]",), ESTIMATE),
    Row(
        "Range of a phase",
        "navigation.phases.within_m",
        (f"navigation.phases=[{{{PHASE},within_m=2000.0}}]",),
        (f"navigation.phases=[{{{PHASE}}}]",),
    ),
    Row(
        "Range and bearing",
        "navigation.bearing_error_deg",
        ("navigation={range_error_m=0.1,bearing_error_deg=0.1,within_m=2000.0}",),
    ),
    Row("Measurements of an observer", "navigation.measurement", (CAMERA,)),
    Row(
        "First estimate of an observer",
        "navigation.measurement.initial",
        ("navigation.measurement.initial={position_error_m=0.3,velocity_error_m_s=0.01}",),
        (CAMERA,),
    ),
    Row(
        "Constant errors of measurements",
        "navigation.measurement.constant_share",
        ("navigation.measurement.constant_share=0.8",),
        (CAMERA,),
    ),
    Row("Periods that an observer misses", "timing.missed_periods", ("timing.missed_periods=2",), (CAMERA,)),
    Row(
        "Thrusters, mass",
        "thrusters",
        ("thrusters.magnitude_error=0.05", "thrusters.misalignment_deg=2.0", "thrusters.mass_error=0.03"),
    ),
    Row(
        "Errors that never vary",
        "thrusters.errors_vary",
        ('thrusters.errors_vary="never"',),
        ("thrusters.magnitude_error=0.05",),
    ),
    Row("Impulse bit, the rest dropped", "thrusters.impulse_bit_N_s", (BIT,)),
    Row(
        "Impulse bit, more in any size",
        "thrusters.resolution",
        ('thrusters.resolution="continuous"',),
        (BIT,),
    ),
    Row("Impulse bit, the rest carried", "thrusters.remainder", (BIT, 'thrusters.remainder="carried"')),
    Row(
        "The same with missed periods",
        "thrusters.remainder",
        (BIT, 'thrusters.remainder="carried"'),
        ("timing.missed_periods=2",),
    ),
    Row("Pulses", "thrusters.pulse", ('thrusters.pulse="centred"',)),
    Row("Pulses from the start of a period on", "thrusters.pulse", ('thrusters.pulse="start"',)),
    Row("Staggered pulses", "thrusters.pulse", ('thrusters.pulse="staggered"',)),
    Row(
        "Rise and fall of pulses",
        "thrusters.rise_s",
        ("thrusters.rise_s=0.02",),
        ('thrusters.pulse="centred"',),
    ),
    Row("Delay", "timing.delay_s", ("timing.delay_s=2.0",)),
    Row("Missed periods", "timing.missed_periods", ("timing.missed_periods=2",)),
    Row("Jitter of commands", "timing.jitter_s", ("timing.jitter_s=0.01",)),
    Row("Clocks", "timing.clock_error_s", ("timing.clock_error_s=0.5",), (MOVING,)),
    Row("Faults known at once", "faults", ('faults=[{kind="loss",share=0.2}]',)),
    Row("Faults isolated late", "faults", (LATE,), ('faults=[{kind="loss",share=0.2}]',)),
    Row("Navigation lost", "faults", ('faults=[{kind="navigation_lost",lasts_s=20.0}]',), ESTIMATE),
    Row("Faults that mislead an observer", "faults", (LATE,), (CAMERA,)),
    Row("Size of the chaser", "chaser", ("chaser.radius_m=0.5",)),
)
"""In the order of the page."""

PARTS = "beside", "checked", "assumed", "flown"
"""Columns that say what a declaration changes."""


@dataclass(frozen=True)
class Declared:
    """Scene ``static`` with a control period of 2 s and some errors."""

    given: tuple[str, ...]

    @cached_property
    def problem(self) -> Problem:
        """Problem that is synthesised."""
        return load_scenario("static").with_assignments(["feedback.period_s=2.0", *self.given]).problem()

    @cached_property
    def loop(self) -> dict[bytes, str]:
        """Each source with the number of states that it adds, by all that it adds."""
        system, texts = self.problem.system, {}
        loop = Loop.from_plant(system.A, system.B, self.problem.period)
        for source in sources(system, self.problem.period):
            before, loop = loop, source.extend(loop)
            states, channels = loop.N - before.N, loop.channels[len(before.channels) :]
            values = [(c.name, c.size, c.rate, c.noise, c.lag, c.share is None) for c in channels]
            key = pickle.dumps((type(source).__name__, states, values))
            texts[key] = f"`{type(source).__name__}`" + f" ({states} states)" * bool(states)
        return texts

    @cached_property
    def craft(self) -> Craft:
        """Loop that the checker builds from what a certificate says of the system."""
        problem, document = self.problem, Document.__new__(Document)
        table = conform(hexadecimal(system_table(problem)), CERTIFICATE["system"], "format", "system")
        nodes = round(problem.delta / problem.period)
        document._take_system(table, {"steps": problem.K, "nodes_per_step": nodes, "step": problem.delta})
        return craft_of(document, plant_of(document), matrix(problem.gain.tolist()))

    @cached_property
    def checked(self) -> dict[str, str]:
        """Parts of the checker's loop beside the tracking error, by what they are called."""
        craft, states = self.craft, self.craft.F.nrows() - self.problem.system.n
        plant = craft.plant
        shares = plant.along, plant.across, *(str(each) for row in plant.shares for each in row)
        return {
            f"{states} states": str(states or ""),
            "values per period": "".join(
                str(size) for size in (*(each.size for each in craft.samples), craft.errors)
            ),
            "pushes": "".join(str(push.cover) for push in (*craft.steady, *craft.bits)),
            "shares of commands": str((shares, craft.lag)) if any(shares) else "",
            "constants": "".join(map(str, craft.constants)) + "shares" * plant.constant,
        }

    @cached_property
    def beside(self) -> dict[str, object]:
        """Return the parts of a problem that depend on errors and are not in the loop."""
        system, by_step = self.problem.system, step_errors(self.problem.system)
        initial = None if system.observer is None or by_step.any() else system.observer.initial
        return {
            "set at the start": pickle.dumps(initial) if initial is not None else b"",
            "errors by step": pickle.dumps(by_step) if np.any(by_step) else b"",
            "once in a flight": pickle.dumps(system.transients) if system.transients else b"",
            "limits of inputs": pickle.dumps(system.u_max),
            "unsafe sets": pickle.dumps(self.problem.unsafe),
        }

    @cached_property
    def assumed(self) -> dict[str, str]:
        """Return the sentences that are printed with the guarantee, by their first words."""
        premises = assumed(self.problem.system, self.problem.period)
        allocated, radius = self.problem.allocation is not None, chaser_radius(self.problem.unsafe)
        sentences = replace(premises, allocated=allocated, chaser=radius).sentences()
        return {sentence.split(":")[0]: sentence for sentence in sentences}

    @cached_property
    def flown(self) -> dict[str, object]:
        """Errors that simulations draw, and the kind of their flights."""
        system, kind = self.problem.system, f"`{flies(self.problem.system).__name__}`"
        first = None if system.observer is None else system.observer.initial
        constants = system.bias, None if system.observer is None else system.observer.constant
        constants = *constants, system.on_time.constant
        sizes = system.w_max, (system.navigation, system.error_by_step, first), system.thrusters
        drawn = zip(("disturbance", "estimates", "thrusters"), columns(system), sizes, strict=False)
        return {
            kind: kind,
            **{name: pickle.dumps(size) for name, part, size in drawn if part.start != part.stop},
            "constants": pickle.dumps([each for each in constants if each is not None and np.any(each)]),
            "impulses": system.timing.carried_impulse,
            "pulses": system.timing.pulse_thrust,
            "faults": pickle.dumps(system.transients) if system.transients else b"",
        }

    @property
    def online(self) -> str:
        """Answer of run-time methods."""
        try:
            met_by_decisions(self.problem.system, 1, 0, self.problem.period)
        except ScenarioError:
            return "refused"
        return "booked"


def differing(values: Mapping[Any, Any], base: Mapping[Any, Any]) -> str:
    """Names of what is not empty and differs from the same in another dictionary."""
    names = [name for name, value in values.items() if value and base.get(name) != value]
    return ", ".join(names) or "-"


def table() -> str:
    """Return the table, one row for each declared error."""
    head = (f"{name}: `{place}`" if place else name for name, place in HEAD.items())
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(HEAD)]
    for row in ROWS:
        declared, base = Declared((*row.beside, *row.example)), Declared(row.beside)
        added = ", ".join(text for key, text in declared.loop.items() if key not in base.loop) or "-"
        pairs = ((getattr(declared, part), getattr(base, part)) for part in PARTS)
        cells = row.name, f"`{row.table}`", added, *(differing(*pair) for pair in pairs), declared.online
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Rewrite the page if the table changed."""
    before = PAGE.read_text(encoding="utf-8")
    text = put(before, "sources", table())
    if text != before:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
