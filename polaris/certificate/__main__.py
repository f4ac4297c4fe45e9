"""``python -m polaris.certificate FILE [--code DIR]``: check a certificate without the rest of Polaris."""

import sys


def main(arguments: list[str]) -> int:
    """Check one certificate, and flight code made of it, and print the verdict.

    Gives 0 verified, 5 rejected, 6 unknown, 7 statistical, 2 if there was nothing to check.
    """
    has_code = arguments[1:2] == ["--code"] and len(arguments) == 3
    if not (len(arguments) == 1 or has_code) or arguments[0].startswith("-"):
        print("usage: python -m polaris.certificate RUN_OR_FILE [--code DIR]", file=sys.stderr)
        return 2
    try:
        from .checker import verify
    except ModuleNotFoundError as error:
        if error.name != "flint":
            raise
        print(MISSING, file=sys.stderr)
        return 2
    try:
        verdict = verify(arguments[0], arguments[2] if has_code else None)
    except OSError as error:
        print(f"error: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    # No terminal obeys a name in it.
    print("".join(c if c == "\n" or c.isprintable() else f"\\u{ord(c):04x}" for c in verdict.text()))
    return verdict.exit_code


MISSING = "error: checking a certificate needs the package python-flint: pip install python-flint"

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
