"""Simulations that fly the compiled code: every command goes through its step function."""

from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

from polaris.simulation.integration import Integrator


@contextmanager
def aboard(library):
    """Let every simulation fly a `FlightLibrary`; yields how often it answers which mode and fault."""
    plain, faults, memories = Integrator.command, {}, {}

    def command(self, number, k, at, x):
        step = k * self.steps_per_cell + at
        seen = self.estimate(step, x)
        u, by_s = np.zeros((len(x), self.system.m)), np.zeros(len(x), dtype=bool)
        if number:
            if self.failing is not None:
                by_s = self.failing.by_s(step)
            failing, self.failing = self.failing, None
            with patch.object(self, "estimate", lambda *given: seen):  # an observer filters once a step
                u = plain(self, number, k, at, x)
            self.failing = failing
        if not step:
            memories.clear()
        answers = []
        for run, (state, given) in enumerate(zip(seen.tolist(), u.tolist(), strict=True)):
            if run not in memories:
                memories[run] = library.memory()
                library.start(memories[run])
            called = step // self.substeps, state, 0 if by_s[run] else number, given
            answer = library.step(*called, memory=memories[run])
            assert answer.mode == (0 if by_s[run] else number)
            key = answer.mode, answer.fault
            faults[key] = faults.get(key, 0) + 1
            answers.append(answer.command)
        return np.array(answers)

    with (
        patch.object(Integrator, "command", command),
        patch.object(Integrator, "_unclipped", lambda self, *cell: None),
    ):
        yield faults
