"""Flight code compiled into a shared library, called from Python."""

import ctypes
import shutil
import subprocess

import pytest

from polaris.certificate.code.answers import FlightAnswer
from polaris.certificate.code.text import parsed

STRICT = "-std=c99 -pedantic -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -Werror"
FLAGS = [*STRICT.split(), "-ffp-contract=off"]


def tool(name):
    """Path of a program; the test is skipped where it is missing."""
    place = shutil.which(name)
    if place is None:
        pytest.skip(f"{name} is not installed")
    return place


def built(folder, compiler, sources, out, *more):
    """Compile without a word; returns the file made."""
    command = [tool(compiler), *FLAGS, *more, *[str(folder / name) for name in sources], "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), done.stderr[:2000]
    return out


def read_code(folder):
    """(prefix, tables, precision) of the code in a folder."""
    (header,) = folder.glob("*.h")
    texts = header.read_text(), header.with_suffix(".c").read_text()
    tables, precision, _ = parsed(*texts, header.stem)
    return header.stem, tables, precision


class FlightLibrary:
    """Calls of the compiled step function; `settling` makes what it keeps of a flight."""

    def __init__(self, folder, out, compiler="gcc"):
        prefix, tables, precision = read_code(folder)
        real = ctypes.c_double if precision == "double" else ctypes.c_float
        n, m = len(tables.waypoints[0]), len(tables.limit)

        observed = [
            ("sent", real * m * len(tables.later)),
            ("newest", ctypes.c_int32),
            ("unseen", ctypes.c_int32),
        ]

        class Input(ctypes.Structure):
            _fields_ = [
                ("period", ctypes.c_int32),
                ("controller", ctypes.c_int32),
                ("state", real * n),
                *([("measured", real * len(tables.seen))] if tables.seen else []),
                ("command", real * m),
            ]

        class Output(ctypes.Structure):
            _fields_ = [
                ("mode", ctypes.c_int32),
                ("fault", ctypes.c_uint32),
                ("command", real * m),
                ("margin", real),
            ]

        class Memory(ctypes.Structure):
            _fields_ = [
                ("last", ctypes.c_int32),
                ("latched", ctypes.c_int32),
                ("state", real * n),
                *(observed if tables.seen else []),
                ("answer", Output),
            ]

        class Online(ctypes.Structure):
            _fields_ = [
                ("safe", Memory),
                ("flown", ctypes.c_int32),
                ("lost", ctypes.c_int32),
                ("answer", Output),
            ]

        sources = [f"{prefix}.c"]
        library = ctypes.CDLL(built(folder, compiler, sources, out, "-O2", "-fPIC", "-shared"))
        self._start, self._step = library[f"{prefix}_start"], library[f"{prefix}_step"]
        self.settling, self._input, self._output = Memory, Input(), Output()
        self._own = Memory()
        if tables.rows:
            self.online, self._decide = Online(), library[f"{prefix}_online_step"]
            self._begin = library[f"{prefix}_online_start"]
        self._at = ctypes.byref(self._input), ctypes.byref(self._output)

    def start(self, settling=None):
        """Begin a flight, with a memory of its own if one is given."""
        self._start(ctypes.byref(settling or self._own))

    def decide_from(self, period):
        """Begin a flight of the online monitor, as if S had flown it until a period."""
        self._begin(ctypes.byref(self.online))
        self.online.safe.last = period - 1

    def decide(self, *call):
        """Answer one call of the flight that the online monitor decides."""
        return self.step(*call, settling=self.online, called=self._decide)

    def step(self, period, state, controller, command, measured=None, settling=None, called=None):
        """Answer one call."""
        inputs, out = self._input, self._output
        if measured is not None:
            inputs.measured[:] = measured
        inputs.period, inputs.controller = period, controller
        inputs.state[:], inputs.command[:] = state, command
        (called or self._step)(ctypes.byref(settling or self._own), *self._at)
        return FlightAnswer(out.mode, out.fault, tuple(out.command), out.margin)


def sources(folder):
    """Return the names of the C files of a folder."""
    return sorted(path.name for path in folder.glob("*.c"))


def copied(source, target):
    target.mkdir()
    for path in source.glob("*.[ch]"):
        (target / path.name).write_bytes(path.read_bytes())
    return target
