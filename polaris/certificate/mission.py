"""Check the certificate of a mission: its legs one by one, the joints between them, and its sums."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

from flint import arb, fmpq

from .assumptions import hand_over
from .claims.joint import Joint
from .files.document import Document, digest, untrusted
from .files.file_keys import BOUND, NOT_NEGATIVE, TEXT, VECTOR
from .files.scenario_keys import NAME
from .files.structure import LARGEST_SCENARIO, Int, Items, Named, conform, contents, sha256, strict_json
from .kernel.balls import dot, plain
from .kernel.verdict import Failed, Record, Rejected
from .model.plants import plant_of
from .model.state_limits import rotate
from .model.timing import carried_impulse

FORMAT = "polaris-mission"
CERTIFICATE, SCENARIO, SUMMARY = "certificate.json", "scenario.toml", "summary.json"
OWN = "kind", "legs"  # keys at the top that no leg has
PLANT = "kind", "A", "B", "C", "D", "mass", "mean_motion", "input_names"  # of the system, one in all legs
SETS = "obstacles", "keep_in"  # tables of sets, some of which may move
PLACED = 1e-9  # rounding of places of moving sets, and of instants, relative to their size

_NODES = Items(Items(Int(), 2, 2))
_LEG = {"name": NAME, "digest": TEXT, "leaves_s": NOT_NEGATIVE, "delta_v_max_m_s": BOUND}
_LEG |= {"waiting_m_s2": BOUND, "safe_until_s": BOUND, "drift_s": BOUND}
_JOINT = {"center": VECTOR, "half_widths": VECTOR, "first": _NODES, "later": _NODES, "assured": bool}
KEYS = {
    **dict.fromkeys(("format", "digest"), TEXT),
    "schema_version": Int(1, 1),
    "artefacts": Named(TEXT),
    "legs": Items(_LEG, 2, 32),
    "joints": Items(_JOINT, 1, 31),
    "delta_v_max_m_s": BOUND,
    "assumptions": Items(TEXT),
}
"""Every key of the certificate of a mission."""

CheckRun = Callable[[Document, Path, Record, Joint | None], list[str]]


@dataclass(frozen=True)
class CheckedLeg:
    """One leg as its own folder has it."""

    name: str
    folder: Path
    document: Document
    scenario: dict[str, Any]  # as the mission describes it
    start: Fraction  # when it starts as planned [s]
    stay: Fraction  # from its end until GO, as planned [s]
    claim: dict[str, Any]  # guarantee that its run states

    @property
    def period(self) -> Fraction:
        """Control period [s]."""
        return Fraction(self.document.delta) / self.document.q

    @property
    def T(self) -> Fraction:
        """Horizon [s]."""
        return Fraction(self.document.delta) * self.document.steps


def check_mission(data: dict[str, Any], folder: Path, record: Record, check_run: CheckRun) -> list[str]:
    """Check a mission's certificate, with data read from JSON; return the assumptions trusted besides."""
    if data.get("digest") != digest(data):
        raise Rejected("digest", "the certificate was changed")
    certificate = conform(data, KEYS, "format", "certificate")
    for name in (SCENARIO, "trace.npz"):
        if certificate["artefacts"].get(name) != sha256(folder / name):
            raise Rejected("artefacts", f"the hash of {name} differs from the certificate")
    mission = _toml(folder / SCENARIO)
    legs = _legs(mission, certificate, folder)
    if len(certificate["joints"]) != len(legs) - 1:
        raise Rejected("legs", "there must be a joint between any two legs")
    assumed = hand_over(any(map(_moves, legs)), any(leg.document.allocation for leg in legs))
    if certificate["assumptions"] != list(assumed):
        raise Rejected("assumptions", "the mission rests on other assumptions than those of its format")
    trusted = dict.fromkeys(certificate["assumptions"])
    record.holds("legs", ", then ".join(leg.name for leg in legs))
    joints = [_joint(legs, i, each) for i, each in enumerate(certificate["joints"])]
    for i, leg in enumerate(legs):
        leg_record = Record()
        try:
            trusted |= dict.fromkeys(check_run(leg.document, leg.folder, leg_record, [*joints, None][i]))
        except Failed as error:
            raise type(error)(error.claim, f"leg {leg.name}: {error.witness}", error.excess) from error
        if joints[i:] and "joint" not in dict(leg_record.checked):
            raise Rejected("joint", f"the end of leg {leg.name} was not derived")
        if leg_record.sampled or leg.document.guarantee != "proved":
            raise Rejected("guarantee", f"leg {leg.name} is not proved")
        record.checked += [(f"{leg.name}: {claim}", statement) for claim, statement in leg_record.checked]
        record.unchecked += [line for line in leg_record.unchecked if line not in record.unchecked]
    record.holds("delta_v", _sums(legs, certificate))
    _check_summary(folder / SUMMARY, certificate)
    return list(trusted)


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(contents(path, LARGEST_SCENARIO).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise Rejected("artefacts", f"{path.name} cannot be read: {error}") from error


def _legs(mission: Mapping[str, Any], claims: Mapping[str, Any], folder: Path) -> list[CheckedLeg]:
    """Return the legs; the scenario of each run is the mission's statement of it, in the mission's order."""
    specs, start, legs = mission.get("legs"), Fraction(0), list[CheckedLeg]()
    if mission.get("kind") != "mission" or not isinstance(specs, list) or len(specs) != len(claims["legs"]):
        raise Rejected("legs", "the certificate has other legs than the mission")
    shared = {key: value for key, value in mission.items() if key not in OWN}
    for i, (spec, leg_claim) in enumerate(zip(specs, claims["legs"], strict=True)):
        if not isinstance(spec, dict) or spec.get("name") != leg_claim["name"]:
            raise Rejected("legs", f"leg {i + 1} is {leg_claim['name']}, but another one in the mission")
        run_folder = folder / f"{i + 1}-{leg_claim['name']}"
        data = untrusted(run_folder / CERTIFICATE)
        document = Document(data)
        if data["digest"] != leg_claim["digest"]:
            reason = f"the run of leg {leg_claim['name']} differs from that of the mission"
            raise Rejected("legs", reason)
        heading = {"title": f"{mission.get('title', '')}: {spec['name']}"[:200], "description": ""}
        scenario = {**shared, **heading, **spec}
        stay = _number(scenario.pop("stay_s", 0.0))
        _check_run(scenario, _toml(run_folder / SCENARIO), start, leg_claim["name"])
        claim = strict_json(contents(run_folder / "schedule.json"))["guarantee"]
        legs.append(CheckedLeg(leg_claim["name"], run_folder, document, scenario, start, stay, claim))
        start += legs[-1].T + stay
    return legs


def _number(x: Any) -> Fraction:
    if isinstance(x, bool) or not isinstance(x, int | float) or not 0 <= x < 1e12:
        raise Rejected("scenario", f"stay_s: {x!r} is no time")
    return Fraction(x)


def _check_run(planned: Mapping[str, Any], run: Mapping[str, Any], start: Fraction, name: str) -> None:
    """Refuse a run of another scenario; sets that move are where they are when the leg starts."""
    other_keys = [{key: x for key, x in each.items() if key not in SETS} for each in (planned, run)]
    sets = [[each.get(key, []) for key in SETS] for each in (planned, run)]
    if other_keys[0] != other_keys[1] or [*map(len, sets[0])] != [*map(len, sets[1])]:
        raise Rejected("legs", f"the run of leg {name} is of another scenario than the mission says")
    for a, b in zip(*(chain(*each) for each in sets), strict=True):
        places = _places(a, start)
        if {**a, **dict.fromkeys(places)} != {**b, **dict.fromkeys(places)}:
            raise Rejected("legs", f"leg {name}: {a.get('name')} is another set than in the mission")
        for key, place in places.items():
            for x, y in zip(place, _flat(b.get(key, 0.0)), strict=True):
                if not abs(x - y) <= PLACED * (1 + abs(x)):
                    message = f"leg {name}: {a['name']} is not where it is after {float(start):.6g} s"
                    raise Rejected("legs", message, float(abs(x - y).mid()))


def _flat(table: Any) -> list[float]:
    """Return the numbers of a key of a scenario, row by row."""
    return [x for each in table for x in _flat(each)] if isinstance(table, list) else [table]


def _places(table: Mapping[str, Any], start: Fraction) -> dict[str, list[arb]]:
    """Return the numbers that say where a set is that moves or turns, at a time [s]; none of any other."""
    t, v = arb(fmpq(start.numerator, start.denominator)), [arb(x) for x in table.get("velocity_m_s") or ()]
    if table.get("kind") == "turning":
        angle, error = table["rate_rad_s"] * t, table.get("rate_error_rad_s", 0.0) * t * 180 / arb.pi()
        sides = [[arb(x) for x in row] for row in table["normals"]]
        normals = [x for side in sides for x in rotate(side, table.get("axis"), angle)]
        return {"normals": normals, "angle_error_deg": [table.get("angle_error_deg", 0.0) + error]}
    if table.get("kind") == "satellite" or not any(table.get("velocity_m_s") or ()):
        return {}
    if table.get("kind") == "polytope":
        speeds = [dot([arb(a) for a in row], v) for row in table["normals"]]
        return {"offsets_m": [b + x * t for b, x in zip(table["offsets_m"], speeds, strict=True)]}
    return {"center_m": [x + y * t for x, y in zip(table["center_m"], v, strict=True)]}


def _moves(leg: CheckedLeg) -> bool:
    """Return True if a leg has a set that moves or turns."""
    sets = (each for key in SETS for each in leg.scenario.get(key, ()))
    return any(
        each["kind"] in ("satellite", "turning") or any(each.get("velocity_m_s") or ()) for each in sets
    )


def _joint(legs: list[CheckedLeg], i: int, claim: Mapping[str, Any]) -> Joint:
    """Return the claim of a joint, once its instants and its boxes are those of the legs on both sides."""
    leg, next_leg = legs[i], legs[i + 1]
    context = f"from {leg.name} to {next_leg.name}"
    box = next_leg.scenario["initial_set"]
    if box["kind"] != "box" or claim["center"] != box["center"]:
        raise Rejected("joint", f"{context}: the GO box is not about the middle of the next leg's start set")
    if len(claim["half_widths"]) != len(box["half_widths"]) or len(box["center"]) != len(leg.document.A):
        raise Rejected("joint", f"{context}: the GO box is one of other states")
    _check_craft(leg.document, next_leg.document, context)
    if any(map(_moves, legs[i + 1 :])):
        node = leg.stay / leg.period
        if abs(node - round(node)) > PLACED * (1 + node):
            raise Rejected("joint", f"{context}: GO must be planned at a node, as later sets move")
        if claim["later"] or claim["first"] != [[round(node)] * 2]:
            raise Rejected("joint", f"{context}: GO must be given as planned or never, as later sets move")
    if any(_satellite(each) for each in legs[i + 1 :]):
        raise Rejected("joint", f"{context}: another satellite in a later leg")
    terms = claim["half_widths"], claim["first"], claim["later"], claim["assured"]
    return Joint(box["center"], box["half_widths"], *terms)


def _satellite(leg: CheckedLeg) -> bool:
    return any(each["kind"] == "satellite" for each in leg.scenario.get("obstacles", ()))


def _check_craft(one: Document, two: Document, context: str) -> None:
    """Refuse legs of two craft, and, where a loop remembers more than the error, of two loops."""
    if one.transients or two.transients:
        raise Rejected("joint", f"{context}: a fault may last across the hand-over")
    if (one.observer or {}).get("initial") or (two.observer or {}).get("initial"):
        raise Rejected("joint", f"{context}: an observer's first errors are those of the first leg alone")
    remembers = any(each.timing or each.observer for each in (one, two))
    for key in {*one.system, *two.system} if remembers else PLANT:
        if one.system.get(key) != two.system.get(key):
            raise Rejected("joint", f"{context}: {key} of the system differs")


def _delta_v(leg: CheckedLeg, leaves: float) -> arb | None:
    """Bound the velocity change of a leg until it is left, from its run's claims [m/s]."""
    goal, upkeep = leg.claim["goal"], leg.claim["upkeep"]
    if goal["reached"] is True and leaves <= goal["by_s"]:
        return arb(goal["delta_v_max_m_s"])
    if upkeep is None:
        return None
    waited = arb(leaves) - upkeep["settled_s"]
    return arb(upkeep["until_settled_m_s"]) + (waited * upkeep["rate_m_s2"] if waited > 0 else 0)


def _sums(legs: list[CheckedLeg], certificate: Mapping[str, Any]) -> str:
    """Check when legs are left, their spending until then and in all, and for how long they are safe."""
    total: arb | None = arb(0)
    for i, (leg, leg_claim) in enumerate(zip(legs, certificate["legs"], strict=True)):
        leaves, doc = leg_claim["leaves_s"], leg.document
        node = (Fraction(leaves) - leg.T) / leg.period
        if abs(node - round(node)) > PLACED * (1 + abs(node)) or Fraction(leaves) < (leg.T + leg.stay) * (
            1 - PLACED
        ):
            raise Rejected("delta_v", f"leg {leg.name} is left at {leaves:g} s, which is no node from GO on")
        if i < len(certificate["joints"]) and not _within(certificate["joints"][i], round(node), leg):
            raise Rejected("delta_v", f"leg {leg.name} is left at {leaves:g} s, but GO is not given then")
        delta_v = _delta_v(leg, leaves)
        if delta_v is not None and i:  # impulses that the leg before leaves behind
            delta_v += carried_impulse(plant_of(doc)) / doc.mass
        _no_less(f"velocity change of leg {leg.name}", leg_claim["delta_v_max_m_s"], delta_v)
        total = None if total is None or delta_v is None else total + delta_v
        rate = None if leg.claim["upkeep"] is None else arb(leg.claim["upkeep"]["rate_m_s2"])
        _no_less(f"velocity change per second of leg {leg.name}", leg_claim["waiting_m_s2"], rate)
        if leg_claim["safe_until_s"] != doc.claim_end:
            raise Rejected("end", f"leg {leg.name} is safe until another instant in its run")
        drift, clear_s = doc.drift, 0.0
        if drift is not None and all(part is not None for part in drift.steps):
            clear_s = drift.horizon
        if leg_claim["drift_s"] is not None and leg_claim["drift_s"] > clear_s:
            raise Rejected("passive", f"the drift of leg {leg.name} is not clear from all steps for so long")
    _no_less("velocity change of the mission", certificate["delta_v_max_m_s"], total)
    return "nothing claimed" if total is None else f"at most {plain(total)} m/s in all"


def _within(joint: Mapping[str, Any], node: int, leg: CheckedLeg) -> bool:
    """Return True if GO may be given so many periods after the leg's horizon."""
    if any(a <= node <= b for a, b in joint["first"]):
        return True
    doc = leg.document
    if not node > (doc.cells - doc.steps) * doc.q:
        return False
    if doc.system_kind != "clohessy_wiltshire":
        return bool(joint["later"])
    turn = 2 * arb.pi() / arb(doc.mean_motion or 0.0) / (arb(leg.document.delta) / doc.q)
    phase = node - (arb(node) / turn).floor() * turn
    return any(a <= phase and phase <= b for a, b in joint["later"])


def _no_less(quantity: str, claimed: float | None, derived: arb | None) -> None:
    """Refuse a figure below the derived one; null claims nothing."""
    if claimed is not None and not (derived is not None and derived <= arb(claimed) * (1 + PLACED)):
        bound = "nothing" if derived is None else plain(derived)
        raise Rejected("delta_v", f"{quantity}: {claimed:g} claimed, {bound} derived")


def _check_summary(path: Path, certificate: Mapping[str, Any]) -> None:
    """Refuse a summary that claims something else than the certificate."""
    if path.exists():
        claims = strict_json(contents(path))["mission"]
        legs = [{key: value for key, value in leg.items() if key != "digest"} for leg in certificate["legs"]]
        for key in ("legs", "joints", "delta_v_max_m_s", "assumptions"):
            if claims.get(key) != (legs if key == "legs" else certificate[key]):
                raise Rejected("summary", f"{key} in {path.name} is not what the certificate says")
