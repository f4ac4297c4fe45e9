"""Certificates of a switching schedule, and a checker that shares nothing with the synthesis.

`writer` turns a schedule into a JSON document. All other modules of this package form the checker: they
import the standard library and python-flint (ball arithmetic with outward rounding), nothing else of
Polaris, and re-derive the safety argument from the document's primary data. Run it with
``polaris verify RUN`` or, without the rest of Polaris, ``python -m polaris.certificate FILE``.

docs/certificate.md states the format, every check, and what is trusted.
"""
