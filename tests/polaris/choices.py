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
    for group in (_choices, _profile, _branches, _ways, _drifts, _claims):
        yield from group(Folder(forger))


def _choices(honest):
    data, K = honest.certificate, honest.certificate["sampling"]["steps"]
    for k in range(K):
        yield f"another mode in step {k}", lambda f, k=k: _swap(f.certificate["modes"], k)
    for k in range(K - 1):
        inputs = data["reference"]["inputs"]
        if inputs[k] != inputs[k + 1]:
            yield (
                f"inputs of steps {k} and {k + 1} exchanged",
                lambda f, k=k: _exchange(f.certificate["reference"]["inputs"], k, k + 1),
            )
    for cell, chosen in enumerate(data["facets"]):
        for o, facet in enumerate(chosen):
            other = opposite(plain(data["unsafe_sets"][o]["normals"]), facet)
            yield (
                f"facet {o} of cell {cell}",
                lambda f, at=(cell, o), to=other: _put(f.certificate["facets"], at, to),
            )
    yield "gains exchanged", lambda f: _exchange_keys(f.certificate["controllers"], 0, 1, "gain")
    for horizon in {"infinite", "one_period", "none"} - {data["horizon"]}:
        yield f"horizon {horizon}", lambda f, to=horizon: f.certificate.update(horizon=to)


def _profile(honest):
    feedback_bound = honest.certificate["feedback_bound"]
    for factor in (0.05, 0.3, 0.6):
        yield (
            f"profile times {factor}",
            lambda f, by=factor: f.certificate.update(
                feedback_bound=[scaled(row, by) for row in feedback_bound]
            ),
        )
    low = feedback_bound[-1]
    yield "profile without its begin", lambda f: f.certificate.update(feedback_bound=[low])
    yield (
        "profile that ends in nothing",
        lambda f: f.certificate.update(feedback_bound=[*feedback_bound[:-1], scaled(low, 1e-3)]),
    )
    yield "profile that grows", lambda f: f.certificate.update(feedback_bound=feedback_bound[::-1])


def _branches(honest):
    branches = honest.certificate["powered"]["branches"]
    for place, branch in enumerate(branches):

        def change(key, to, place=place):
            def changed(folder):
                own = folder.certificate["powered"]["branches"][place]
                own[key] = to(own[key])

            return changed

        yield f"inputs of branch {place}", change("inputs", lambda rows: [scaled(u, 0.9) for u in rows])
        yield f"inputs of branch {place} turned", change("inputs", lambda rows: rows[::-1])
        yield (
            f"facets of branch {place}",
            change("facets", lambda rows: [[(x + 2) % 4 for x in r] for r in rows]),
        )
        yield f"branch {place} leaves later", change("step", lambda step: step + 1)
        yield f"tolerance of branch {place}", change("tolerance", lambda x: scaled(x, 2.0))
        yield f"nothing tolerated of branch {place}", change("tolerance", lambda x: scaled(x, 1e-3))
        yield f"branch {place} for ever", change("horizon", lambda _: "infinite")
        for i in range(len(branch["tail"])):
            yield (
                f"tail of branch {place}, state {i}",
                change("tail", lambda x, i=i: [hexed(plain(v) + 0.2 * (i == j)) for j, v in enumerate(x)]),
            )
    if len(branches) > 1:
        yield "branches exchanged", lambda f: f.certificate["powered"]["branches"].reverse()


def _ways(honest):
    for k, way in enumerate(honest.certificate["powered"]["steps"]):
        if way is not None:
            yield (
                f"abort in step {k} is cheaper",
                lambda f, k=k: _less(f.told["powered_abort"]["steps"][k], "delta_v_m_s", 0.6),
            )
            yield f"abort in step {k} arrives sooner", lambda f, k=k: _sooner(f, k)


def _sooner(folder, k):
    folder.certificate["powered"]["steps"][k]["cell"] -= 2
    folder.told["powered_abort"]["steps"][k]["by_s"] -= 2 * folder.schedule["step_s"]


def _drifts(honest):
    for k, parts in enumerate(honest.certificate["drift"]["steps"]):
        if parts is None:
            continue

        def change(key, to, k=k):
            def changed(folder):
                own = folder.certificate["drift"]["steps"][k][0]
                own[key] = to(own[key])

            return changed

        yield f"departures of step {k} smaller", change("axes", lambda rows: [scaled(x, 0.4) for x in rows])
        yield (
            f"departures of step {k} elsewhere",
            change("center", lambda x: [hexed(plain(x[0]) + 1.0), *x[1:]]),
        )
    yield (
        "a shorter drift",
        lambda f: f.certificate["drift"].update(horizon=scaled(f.certificate["drift"]["horizon"], 0.5)),
    )
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


def _swap(modes, k):
    modes[k] = 1 - modes[k]


def _exchange(rows, i, j):
    rows[i], rows[j] = rows[j], rows[i]


def _exchange_keys(tables, i, j, key):
    tables[i][key], tables[j][key] = tables[j][key], tables[i][key]


def _put(rows, at, to):
    rows[at[0]][at[1]] = to


def _less(table, key, factor):
    table[key] *= factor
