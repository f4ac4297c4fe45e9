"""Forge a run folder: every field of every file, one at a time, with all digests and hashes right again.

A forgery is a changed text of one file. `Forger.judge` puts it into a copy of the folder, mends the hashes in
the certificate and the certificate's own digest, and asks the checker.
"""

import copy
import csv
import hashlib
import io
import json
import math
import random
import shutil
import tomllib
from collections import defaultdict
from fnmatch import fnmatchcase

import numpy as np

from polaris.certificate.checker import verify
from polaris.certificate.files.document import canonical, digest
from polaris.certificate.files.entries import last_instant
from polaris.certificate.files.file_keys import REPEATED
from polaris.runs.run import run
from polaris.scenario.reading import write_toml
from tests.polaris.corruptions import restate
from tests.polaris.tiny import TINY

CERTIFICATE = "certificate.json"
TREES = (CERTIFICATE, "scenario.toml", "schedule.json", "gains.json", "summary.json")
TABLES = ("schedule.csv", "reference.csv")


COARSE = "feedback={period_s=0.5}"
"""Two periods a step instead of nine: sets of few generators, in which a forgery is soon refused for good."""


QUARTER = COARSE.replace("0.5", "0.25")
"""Four of them, where U must fly or S be proven as with nine."""


def make(assignments, folder):
    """A run of a variant of the tiny scene in which U flies in the middle, too."""
    variant = ["tracking.R=[60,60]", "simulation.runs=2", *assignments]
    target = run(TINY, folder / "run", overrides=variant)
    assert target.summary["guarantee"]["kind"] == "proved" and 1 in target.json("schedule.json")["modes"]
    return target.path


class Forger:
    """A run folder and a copy of it to forge in."""

    def __init__(self, run, scratch):
        self.run, self.folder = run, scratch / "forged"
        shutil.copytree(run, self.folder, ignore=shutil.ignore_patterns("figures"))
        self.honest = json.loads((run / CERTIFICATE).read_text(encoding="utf-8"))

    def judge(self, files):
        """Verdict on the folder with some files replaced: name to text; the certificate may be one."""
        certificate = files.get(CERTIFICATE)
        data = self.tree(CERTIFICATE) if certificate is None else json.loads(certificate.replace("\x00", ""))
        try:
            for name, text in files.items():
                if name != CERTIFICATE:
                    (self.folder / name).write_text(text, encoding="utf-8", newline="")
            text = files.get(CERTIFICATE, "")
            if isinstance(data, dict) and isinstance(data.get("artefacts"), dict):
                for name in data["artefacts"]:
                    if name in files:
                        sha = hashlib.sha256((self.folder / name).read_bytes()).hexdigest()
                        data["artefacts"][name] = sha
            if "\x00" not in text:  # a text with duplicate keys is kept as it is
                if isinstance(data, dict) and "digest" in data:
                    data["digest"] = digest(data)
                text = canonical(data)
            (self.folder / CERTIFICATE).write_text(text.replace("\x00", ""), encoding="utf-8")
            return verify(self.folder)
        finally:
            for name in (*files, CERTIFICATE):
                shutil.copyfile(self.run / name, self.folder / name)

    def forged(self, change):
        """Verdict on the folder with a change of its certificate."""
        data = copy.deepcopy(self.honest)
        change(data)
        return self.judge({CERTIFICATE: json.dumps(data)})

    def tree(self, name):
        """Data of a JSON or TOML file."""
        text = (self.run / name).read_text(encoding="utf-8")
        return tomllib.loads(text) if name.endswith(".toml") else json.loads(text)

    def rows(self, name):
        """Cells of a CSV file."""
        return list(csv.reader(io.StringIO((self.run / name).read_text(encoding="utf-8"))))


def written(name, data):
    """Text of a file from its data."""
    if name in TABLES:
        text = io.StringIO(newline="")
        csv.writer(text, lineterminator="\n").writerows(data)
        return text.getvalue()
    return write_toml(data) if name.endswith(".toml") else json.dumps(data)


SETS = {"margins", "separation", "recoverable", "goal"}
"""Claims that fail of a run whose sets leave something out: what is left of a room, or what there is."""


def repeat(certificate, gains):
    """Let ``gains.json`` repeat what the certificate says."""
    gains |= {key: decimals(certificate[key]) for key in REPEATED}


def decimals(data):
    """A tree of a certificate with its numbers as decimals."""
    if isinstance(data, dict):
        return {key: decimals(value) for key, value in data.items()}
    if isinstance(data, list):
        return [decimals(value) for value in data]
    return float.fromhex(data) if _hexadecimal(data) else data


class Lie:
    """Data of every file of a folder, to be changed and judged together."""

    def __init__(self, forger):
        self.forger = forger
        for name in ("certificate", "schedule", "gains", "summary"):
            setattr(self, name, forger.tree(f"{name}.json"))
        self.scenario = forger.tree("scenario.toml")
        self.reference = forger.rows("reference.csv")

    def judge(self, claims):
        """The verdict names one of the claims."""
        verdict = self.verdict()
        assert verdict.outcome != "VERIFIED"
        assert verdict.claim in claims, verdict.text()

    def verdict(self, **texts):
        """The verdict, with some files as other text: name, its dot as an underscore, to text."""
        repeat(self.certificate, self.gains)
        header = list(self.schedule["steps"][0])
        steps = [["" if x is None else x for x in step.values()] for step in self.schedule["steps"]]
        files = {f"{name}.json": json.dumps(getattr(self, name)) for name in ("schedule", "gains", "summary")}
        files |= {
            CERTIFICATE: json.dumps(self.certificate),
            "scenario.toml": written("scenario.toml", self.scenario),
            "schedule.csv": written("schedule.csv", [header, *steps]),
            "reference.csv": written("reference.csv", self.reference),
        }
        return self.forger.judge(files | {name.replace("_", "."): text for name, text in texts.items()})

    def guarantee(self):
        """The certificate's end and assumptions, repeated in the other files."""
        restate(self.certificate)
        data, claimed = self.certificate, self.schedule["guarantee"]
        step, steps = float.fromhex(data["sampling"]["step"]), data["sampling"]["steps"]
        claimed["horizon"] = data["horizon"]
        claimed["until_s"] = last_instant(data["horizon"], steps, len(data["facets"]), step)
        claimed["assumptions"] = [*self.certificate["assumptions"], claimed["assumptions"][-1]]
        self.summary["guarantee"] = claimed

    def modes(self, modes):
        """Another schedule, everywhere."""
        names = [item["name"] for item in self.certificate["controllers"]]
        self.certificate["modes"] = self.schedule["modes"] = modes
        for step, mode in zip(self.schedule["steps"], modes, strict=True):
            step["mode"], step["controller"] = mode, names[mode]
        count = sum(a != b for a, b in zip(modes[:-1], modes[1:], strict=True))
        share = sum(mode > 0 for mode in modes) / len(modes)
        self.schedule["switches"], self.schedule["experimental_share"] = count, share
        self.schedule["share"] = {name: modes.count(i) / len(modes) for i, name in enumerate(names)}
        for part in (self.summary["synthesis"], self.summary["polaris"]):
            part["switches"], part["experimental_share"] = count, share

    def gain(self, mode, K):
        """Another gain, everywhere."""
        self.certificate["controllers"][mode]["gain"] = [[float(x).hex() for x in row] for row in K]

    def own(self, mode, states, inputs):
        """Another reference of its own, everywhere."""
        for name, rows in (("reference_states", states), ("reference_inputs", inputs)):
            self.certificate["controllers"][mode][name] = [[float(x).hex() for x in row] for row in rows]

    def plant(self):
        """A, B as arrays."""
        return (np.array(self.gains["system"][key]) for key in "AB")

    def follow(self):
        """(states, inputs) of U's own reference."""
        controller = self.gains["controllers"][1]
        return np.array(controller["reference_states"]), np.array(controller["reference_inputs"])


def places(data, at=()):
    """Every place of a tree, containers included."""
    yield at, data
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield from places(value, (*at, key))


def pattern(at):
    """A place with its indices left out: ``controllers.*.gain``."""
    return ".".join("*" if isinstance(key, int) else key for key in at)


def chosen(data, rng, few):
    """Some places of every pattern: all keys, and of lists the ends and some random entries."""
    groups = defaultdict(list)
    for at, value in places(data):
        groups[pattern(at)].append((at, value))
    for items in groups.values():
        if len(items) > few:
            ends = [] if few < 3 else [items[0], items[-1]]
            items = [*ends, *rng.sample(items[1:-1], few - 2)] if ends else [rng.choice(items)]
        yield from items


def replaced(data, at, value):
    """A tree with one place replaced; what does not lie on the way there is shared."""
    if not at:
        return value
    changed = copy.copy(data)
    changed[at[0]] = replaced(data[at[0]], at[1:], value)
    return changed


def around(data, at):
    """Size of the numbers about a place, for perturbations of numbers that are zero."""
    place = data
    for key in at[:-1]:
        place = place[key]
    near = [abs(x) for _, x in _numbers(place)] if isinstance(place, list) else []
    return max([x for x in near if math.isfinite(x)], default=0.0) or 1.0


def _numbers(tree):
    for at, value in places(tree):
        if _hexadecimal(value):
            yield at, float.fromhex(value)
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            yield at, float(value)


def _hexadecimal(value):
    return isinstance(value, str) and value.lstrip("-").startswith("0x")


def forgeries(data, at, value, share):
    """(what was done, new value) for one place; numbers move by a share of themselves, both ways."""
    number = float.fromhex(value) if _hexadecimal(value) else value
    if isinstance(number, float):
        step = share * abs(number) or share * around(data, at)
        steps = {"up": number + step, "down": number - step}
    if isinstance(value, bool):
        edits = {"negated": not value, "as text": str(value)}
    elif _hexadecimal(value):
        edits = {tag: x.hex() for tag, x in steps.items()} | {"a number": number, "nan": "nan", "null": None}
    elif isinstance(value, int):
        edits = {"up": value + 1, "down": value - 1, "as text": str(value), "true": True}
        edits["a half more"] = value + 0.5
    elif isinstance(value, float):
        edits = steps | {"as text": repr(value), "true": True}
    elif isinstance(value, str):
        edits = {"another text": f"{value}-other", "no text": "", "a number": 1}
    elif value is None:
        edits = {"a number": 1.0, "no text": ""}
    elif isinstance(value, list):
        edits = {"a number": 1}
        if value:
            edits |= {"emptied": [], "last dropped": value[:-1], "first dropped": value[1:]}
            edits["last repeated"] = [*value, value[-1]]
        if value != value[::-1]:
            edits |= {"reversed": value[::-1], "rotated": [*value[1:], value[0]]}
    else:
        edits = {f"without {key}": {k: v for k, v in value.items() if k != key} for key in value}
        edits |= {"an unknown key": value | {"unknown_key": 1}, "a list": []}
    yield from edits.items()


def one_at_a_time(forger, seed, few, share, names=(*TREES, *TABLES)):
    """(what, what and where, files) of forgeries of every file, a few places of every pattern."""
    rng = random.Random(seed)
    for name in names:
        data = forger.rows(name) if name in TABLES else forger.tree(name)
        for at, value in chosen(data, rng, few):
            if name in TABLES and isinstance(value, str):
                cases = _cells(value, share)
            else:
                cases = forgeries(data, at, value, share)
            for change, new in cases:
                label = f"{name}: {pattern(at) or 'all of it'} {change}"
                try:
                    text = written(name, replaced(data, at, new))
                except (AttributeError, TypeError, csv.Error):
                    continue  # this cannot be written in this kind of file
                yield label, f"{label} at {at}", {name: text}


def _cells(value, share):
    try:
        x = float(value)
    except ValueError:
        yield "another text", f"{value}-other"
        yield "emptied", "" if value else "0"
        return
    yield "up", repr(x + (share * abs(x) or share))
    yield "down", repr(x - (share * abs(x) or share))
    yield "one bit up", repr(math.nextafter(x, math.inf))
    yield "nan", "nan"
    yield "emptied", ""


def twice(forger, name):
    """(label, files): every key of every table of a JSON file given twice, the second time as it was."""
    data = forger.tree(name)
    mark = "\x01"
    for at, value in places(data):
        if not isinstance(value, dict) or any(isinstance(key, int) and key > 1 for key in at):
            continue
        for key in value:
            other = replaced(data, at, {f"{mark}": 1} | value)
            text = json.dumps(other).replace(json.dumps(mark), json.dumps(key), 1)
            label = f"{name}: {pattern((*at, key))} twice"
            yield label, label, {name: text + ("\x00" if name == CERTIFICATE else "")}


def excused(label, rules):
    """Rules that a label matches."""
    return [rule for rule in rules if fnmatchcase(label, rule)]


def accepted(forger, cases, rules):
    """Labels of forgeries that are verified without an excuse, and the excuses that were needed."""
    wrong, used = [], set()
    for short, label, files in cases:
        if forger.judge(files).outcome == "VERIFIED":
            excuses = excused(short, rules)
            used.update(excuses)
            if not excuses:
                wrong.append(label)
    return wrong, used
