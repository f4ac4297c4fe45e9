"""Traces of RTAEval, in and out: read and write them, measure them, export runs as such."""

from __future__ import annotations

from .evaluation import evaluate_trace
from .export import Export, export_run, to_trace
from .legacy import LegacyMetrics, evaluate_legacy
from .model import (
    NORMAL,
    SAFETY,
    UNTRUSTED,
    AgentTrace,
    BallTrace,
    PointTrace,
    PolytopeTrace,
    RectangleTrace,
    Trace,
    UnsafeTrace,
)
from .reading import parse_trace, read_trace
from .results import AgentMetrics, Separation, Spread, TraceMetrics
from .settings import Heading, restamp
from .writing import trace_data, write_trace

__all__ = [
    "NORMAL",
    "SAFETY",
    "UNTRUSTED",
    "AgentMetrics",
    "AgentTrace",
    "BallTrace",
    "Export",
    "Heading",
    "LegacyMetrics",
    "PointTrace",
    "PolytopeTrace",
    "RectangleTrace",
    "Separation",
    "Spread",
    "Trace",
    "TraceMetrics",
    "UnsafeTrace",
    "evaluate_legacy",
    "evaluate_trace",
    "export_run",
    "parse_trace",
    "read_trace",
    "restamp",
    "to_trace",
    "trace_data",
    "write_trace",
]
