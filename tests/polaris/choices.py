"""Forged choices of a certificate, and claims that are better than what follows from the choices."""

import json

from tests.polaris.corruptions import hexed, opposite, plain, scaled
from tests.polaris.forging import CERTIFICATE


class Folder:
    """Trees of a run folder, changed together."""

    def __init__(self, forger):
        self.certificate = forger.tree(CERTIFICATE)
        self.schedule = forger.tree("schedule.json")
        self.summary = forger.tree("summary.json")
        self.rows = forger.rows("schedule.csv")

    @property
    def told(self):
        """The guarantee as ``schedule.json`` tells it."""
        return self.schedule["guarantee"]

    def files(self):
        """Texts of the files by name; the summary and the table repeat what the schedule tells."""
        self.summary["guarantee"] = self.told
        steps = [["" if x is None else x for x in step.values()] for step in self.schedule["steps"]]
        table = "\n".join(",".join(map(str, row)) for row in [self.rows[0], *steps]) + "\n"
        return {
            CERTIFICATE: json.dumps(self.certificate),
            "schedule.json": json.dumps(self.schedule),
            "summary.json": json.dumps(self.summary),
            "schedule.csv": table,
        }


def forged(forger, change):
    """Return the files of a folder with one thing forged, in all files that tell of it."""
    folder = Folder(forger)
    change(folder)
    return folder.files()


def changes(forger):
    """Yield (label, function of a folder) of all that is forged."""
    for group in (_choices, _feedback_bound, _branches, _ways, _drifts, _claims):
        yield from group(Folder(forger))


def _on(*path, to):
    """Change of a folder: what lies at a path in its certificate becomes what `to` makes of it."""

    def change(folder):
        place = folder.certificate
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to(place[path[-1]])

    return change


def _exchanged(i, j):
    def exchange(rows):
        rows = list(rows)
        rows[i], rows[j] = rows[j], rows[i]
        return rows

    return exchange


def _choices(honest):
    data, K = honest.certificate, honest.certificate["sampling"]["steps"]
    inputs = data["reference"]["inputs"]
    for k in range(K):
        yield f"another mode in step {k}", _on("modes", k, to=lambda mode: 1 - mode)
    for k in range(K - 1):
        if inputs[k] != inputs[k + 1]:
            swap = _on("reference", "inputs", to=_exchanged(k, k + 1))
            yield f"inputs of steps {k} and {k + 1} exchanged", swap
    for cell, chosen in enumerate(data["facets"]):
        for o, facet in enumerate(chosen):
            other = opposite(plain(data["unsafe_sets"][o]["normals"]), facet)
            yield f"facet {o} of cell {cell}", _on("facets", cell, o, to=lambda _, other=other: other)
    gains = [law["gain"] for law in data["controllers"][1::-1]]
    laws = [law | {"gain": gain} for law, gain in zip(data["controllers"], gains, strict=False)]
    yield "gains exchanged", _on("controllers", to=lambda old: laws + old[2:])
    for horizon in {"infinite", "one_period", "none"} - {data["horizon"]}:
        yield f"horizon {horizon}", _on("horizon", to=lambda _, to=horizon: to)


BOUND = {
    "without its begin": lambda rows: rows[-1:],
    "that ends in nothing": lambda rows: [*rows[:-1], scaled(rows[-1], 1e-3)],
    "that grows": lambda rows: rows[::-1],
}


def _feedback_bound(honest):
    for factor in (0.05, 0.3, 0.6):
        less = _on("feedback_bound", to=lambda rows, by=factor: scaled(rows, by))
        yield f"feedback bound times {factor}", less
    for label, to in BOUND.items():
        yield f"feedback bound {label}", _on("feedback_bound", to=to)


BRANCH = {
    "inputs of branch {}": ("inputs", lambda rows: scaled(rows, 0.9)),
    "inputs of branch {} turned": ("inputs", lambda rows: rows[::-1]),
    "facets of branch {}": ("facets", lambda rows: [[(x + 2) % 4 for x in r] for r in rows]),
    "branch {} leaves later": ("step", lambda step: step + 1),
    "tolerance of branch {}": ("tolerance", lambda x: scaled(x, 2.0)),
    "nothing tolerated of branch {}": ("tolerance", lambda x: scaled(x, 1e-3)),
    "branch {} for ever": ("horizon", lambda _: "infinite"),
}


def _branches(honest):
    branches = honest.certificate["powered"]["branches"]
    for place, branch in enumerate(branches):
        for label, (key, to) in BRANCH.items():
            yield label.format(place), _on("powered", "branches", place, key, to=to)
        for i in range(len(branch["tail"])):
            altered = _on("powered", "branches", place, "tail", i, to=lambda x: hexed(plain(x) + 0.2))
            yield f"tail of branch {place}, state {i}", altered
    if len(branches) > 1:
        yield "branches exchanged", _on("powered", "branches", to=lambda rows: rows[::-1])


def _ways(honest):
    for k, way in enumerate(honest.certificate["powered"]["steps"]):
        if way is not None:
            label = f"abort in step {k} is cheaper"
            yield label, lambda f, k=k: _less(f.told["powered_abort"]["steps"][k], "delta_v_m_s", 0.6)
            yield f"abort in step {k} arrives sooner", lambda f, k=k: _sooner(f, k)


def _sooner(folder, k):
    folder.certificate["powered"]["steps"][k]["cell"] -= 2
    folder.told["powered_abort"]["steps"][k]["by_s"] -= 2 * folder.schedule["step_s"]


def _drifts(honest):
    for k, parts in enumerate(honest.certificate["drift"]["steps"]):
        if parts is not None:
            at = ("drift", "steps", k, 0)
            yield f"departures of step {k} smaller", _on(*at, "axes", to=lambda rows: scaled(rows, 0.4))
            yield (
                f"departures of step {k} elsewhere",
                _on(*at, "center", 0, to=lambda x: hexed(plain(x) + 1.0)),
            )
    yield "a shorter drift", _on("drift", "horizon", to=lambda x: scaled(x, 0.5))
    yield "a drift further away", lambda f: _less(f.told["abort"], "least_m", 1.5)


def _claims(honest):
    for key, factor in (("distance_m", 0.5), ("delta_v_max_m_s", 0.6), ("by_s", 0.9), ("tolerance_m", 20.0)):
        yield f"goal: {key}", lambda f, key=key, by=factor: _less(f.told["goal"], key, by)
    for key in ("rate_m_s2", "until_settled_m_s"):
        if honest.told["upkeep"]:
            yield f"upkeep: {key}", lambda f, key=key: _less(f.told["upkeep"], key, 0.6)
    for k, step in enumerate(honest.schedule["steps"]):
        if step["mode"]:
            yield f"margin of step {k}", lambda f, k=k: _bolder(f.schedule["steps"][k])


def _bolder(step):
    """Nearly all of the room is left; the checker derives a margin at both ends of a step, not within it."""
    step["margin"] = 0.999
    step["tightening"] = (1 - step["margin"]) * step["clearance"]


def _less(table, key, factor):
    table[key] *= factor
