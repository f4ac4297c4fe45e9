"""Small traces that the tests are made of."""

import json

import numpy as np

from polaris.traces import AgentTrace, Trace


def agent(rows, modes=None, **options):
    """An agent's entry of a trace, from rows [t, s0, ...]."""
    return {"state_trace": rows, "mode_trace": [2] * len(rows) if modes is None else modes, **options}


def entry(kind, *rows):
    """An unsafe set's entry."""
    return {"set_type": kind, "state_trace": list(rows)}


def trace(agents=None, **unsafe):
    """A whole trace; by default one agent that approaches the origin along x at 1 m/s."""
    if agents is None:
        agents = {"chaser": agent([[t, 10.0 - t, 0, 0, -1.0, 0, 0] for t in range(5)])}
    return {"agents": agents, "unsafe": unsafe}


def save(folder, data):
    """The file of a trace."""
    path = folder / "trace.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data), encoding="utf-8")
    return path


def moving(p, v, times=(0.0, 1.0, 2.0)):
    """A trace of one agent from p at the constant velocity v."""
    t = np.asarray(times, dtype=float)
    x = np.asarray(p, dtype=float) + t[:, None] * np.asarray(v, dtype=float)
    states = np.hstack([x, np.broadcast_to(np.asarray(v, dtype=float), x.shape)])
    return Trace({"a": AgentTrace(t, states)})
