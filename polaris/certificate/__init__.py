"""A checker of certificates of a switching schedule, which shares nothing with the synthesis.

`polaris.runs.certificate` turns a schedule into a JSON document. The modules of this package import the
standard library and python-flint (ball arithmetic with outward rounding), nothing else of Polaris, and
re-derive the safety argument from the document's primary data. Run the checker with
``polaris verify RUN`` or, without the rest of Polaris, ``python -m polaris.certificate FILE``.

docs/certificate.md states the format, every check, and what is trusted.
"""
