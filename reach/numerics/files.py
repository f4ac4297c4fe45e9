"""Files from outside: regular ones of a bounded size, never a pipe, a device or a folder."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

LARGEST = 2**28  # most bytes of a file that is read whole, if the reader states no other limit


def open_regular(path: str | Path, most: int = LARGEST) -> BufferedReader:
    """Open a regular file for reading.

    Opening does not wait for the other end of a pipe, and devices are refused before they are read.

    Raises
    ------
    OSError
        If it is no regular file, has more than `most` bytes, or cannot be opened.
    """
    flags = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
    try:
        descriptor = os.open(path, os.O_RDONLY | flags)
    except ValueError as error:  # a zero byte in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            kind = "a directory" if stat.S_ISDIR(status.st_mode) else "not a regular file"
            raise OSError(errno.EINVAL, f"is {kind}", str(path))
        if status.st_size > most:
            raise OSError(errno.EFBIG, f"has {status.st_size} bytes; must have at most {most}", str(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: str | Path, most: int = LARGEST) -> bytes:
    """Return the bytes of a regular file; raises as `open_regular`."""
    with open_regular(path, most) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(min(size, most) + 1)  # a reader of more would set that much memory aside
    if len(data) > size:
        raise OSError(errno.EIO, "has grown while it was read", str(path))
    if len(data) > most:
        raise OSError(errno.EFBIG, f"must have at most {most} bytes", str(path))
    return data
