"""Objects as an experiment may hand them over: whatever is asked of them, something else happens."""

import numpy as np


class Raises:
    """Every way of reading it raises, lazily."""

    def __init__(self, error=RuntimeError):
        object.__setattr__(self, "error", error)

    def _raise(self, *_, **__):
        raise object.__getattribute__(self, "error")("no")

    __array__ = __len__ = __iter__ = __float__ = __int__ = __index__ = __eq__ = __repr__ = __str__ = _raise
    __bool__ = __getitem__ = __getattr__ = __array_ufunc__ = __array_function__ = __lt__ = __hash__ = _raise
    __copy__ = __deepcopy__ = __reduce__ = __complex__ = __format__ = __sizeof__ = __dir__ = _raise


class Masquerade(Raises):
    """Even its class cannot be asked for."""

    @property
    def __class__(self):
        raise RuntimeError("no")


class Nameless(type):
    """Classes that do not tell their name."""

    @property
    def __name__(cls):
        raise RuntimeError("no")


class Unnamed(metaclass=Nameless):
    pass


class UnnamedError(Exception, metaclass=Nameless):
    pass


class NeedsGradient:
    """As tensors that require gradients do."""

    dtype, shape = "float32", (2,)

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy()")


class Late:
    """Fails the second time it is read."""

    def __init__(self, good):
        self.good, self.read = good, 0

    def __array__(self, dtype=None, copy=None):
        self.read += 1
        if self.read > 1:
            raise RuntimeError("read twice")
        return np.array(self.good)

    def __float__(self):
        return float(self.__array__())


class Changing:
    """Another value each time it is read."""

    def __init__(self, good):
        self.good = np.array(good)

    def __array__(self, dtype=None, copy=None):
        state, self.good = self.good, self.good + 1e3
        return state


class Stubborn(np.ndarray):
    """A subclass whose arithmetic is its own."""

    def __array_ufunc__(self, *_, **__):
        raise RuntimeError("no arithmetic")

    def __array_finalize__(self, other):
        pass

    def tolist(self):
        raise RuntimeError("no list")

    def copy(self, *_):
        raise RuntimeError("no copy")

    astype = tobytes = __getitem__ = __iter__ = __len__ = copy


class Text(float):
    """A number whose text is not a number."""

    def __repr__(self):
        raise RuntimeError("no text")

    __str__ = __float__ = __repr__


class OwnSequence(list):
    def __iter__(self):
        raise RuntimeError("no")

    __len__ = __getitem__ = __iter__


class NeverEnding(list):
    def __iter__(self):
        while True:
            yield 0.0


class Endless:
    def __len__(self):
        return 10**18

    def __getitem__(self, i):
        raise IndexError


def ring():
    inner = []
    inner.extend([inner, inner])
    return inner


def bomb():
    out = [1.0]
    for _ in range(60):
        out = [out, out]
    return out


def unreadable(n):
    """Objects that are no n real numbers, by name; made anew each time."""
    return {
        "None": None,
        "raises": Raises(),
        "raises SystemExit": Raises(SystemExit),
        "raises KeyboardInterrupt": Raises(KeyboardInterrupt),
        "raises GeneratorExit": Raises(GeneratorExit),
        "masquerade": Masquerade(),
        "unnamed": Unnamed(),
        "gradient": NeedsGradient(),
        "gradients in a list": [NeedsGradient()] * n,
        "string": "full thrust",
        "strings": ["1.0"] * n,
        "bytes": b"12345678",
        "ragged": [[0.0], [1.0, 2.0]],
        "complex": np.full(n, 1j),
        "complex, real": np.zeros(n, dtype=complex),
        "bool": np.zeros(n, dtype=bool),
        "objects": _objects(n),
        "dates": np.zeros(n, dtype="datetime64[s]"),
        "records": np.zeros(n, dtype=[("a", float)]),
        "too few": np.zeros(n - 1),
        "too many": np.zeros((n, n + 1)),
        "huge": np.zeros(10**6),
        "scalar": 0.0,
        "huge integer": 10**5000,
        "huge integers": [10**400] * n,
        "dict": {"u": 1},
        "set": {1.0, 2.0},
        "generator": (x for x in range(n)),
        "function": lambda: 0,
        "class": Raises,
        "ring": ring(),
        "bomb": bomb(),
        "own sequence": OwnSequence([0.0]),
        "endless": Endless(),
        "never ending": NeverEnding([0.0] * n),
        "masked scalar": np.ma.masked,
        "matrix": np.zeros((1, n)).view(np.matrix),
    }


def _objects(n):
    out = np.empty(n, dtype=object)
    for i in range(n):
        out[i] = Raises()
    return out


def not_finite(n):
    """Objects that are n real numbers, but not all of them finite."""
    masked = np.ma.MaskedArray(np.zeros(n), mask=np.arange(n) == 0)
    return {
        "nan": np.full(n, np.nan),
        "infinite": [np.inf] * n,
        "masked": masked,
        "masked whole numbers": np.ma.MaskedArray(np.zeros(n, dtype=int), mask=True),
        "longer than floats": np.full(n, np.longdouble(10) ** 400),
        "half of nan": np.full(n, np.nan, dtype=np.float16),
    }


def readable(values):
    """Objects that are these numbers, in odd clothes."""
    values = np.asarray(values, dtype=float)
    return {
        "list": values.tolist(),
        "tuple": tuple(values.tolist()),
        "late": Late(values),
        "changing": Changing(values),
        "stubborn": values.view(Stubborn),
        "texts": [Text(x) for x in values],
        "objects of numpy": [np.float64(x) for x in values],
        "read only": _read_only(values),
        "strided": np.repeat(values, 3)[::3],
        "byte order": values.astype(">f8"),
        "masked nowhere": np.ma.MaskedArray(values, mask=False),
        "memory": memoryview(values.copy()),
    }


def _read_only(values):
    out = values.copy()
    out.flags.writeable = False
    return out


ERRORS = (
    ValueError, RecursionError, MemoryError, StopIteration, UnnamedError, Warning, OSError, AssertionError,
    SystemExit, KeyboardInterrupt, GeneratorExit, BaseException, BaseExceptionGroup,
)  # fmt: skip


def raising(error):
    """A controller that raises it."""

    def law(*_):
        if error is BaseExceptionGroup:
            raise error("many", [KeyboardInterrupt()])
        raise error

    return law
