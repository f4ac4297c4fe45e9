"""The checker's own table of scenario keys is that of the models, and what it does not know is refused."""

import random

import pytest

pytest.importorskip("flint")

from docs.generate.scenario_docs import schema
from polaris.certificate.files.scenario_keys import SCENARIO, check_keys
from polaris.certificate.files.structure import AnyOf, Int, Items, OneOf, Real, Text, conform, strict_json
from polaris.certificate.kernel.verdict import Rejected
from polaris.certificate.model.perception import RIGID
from polaris.certificate.model.references import GOALS
from polaris.model.errors import ScenarioError
from polaris.scenario.reading import read_document, validate
from polaris.scenario.scenario import bundled_scenarios, load_scenario, locate
from polaris.scenario.tables.schedule import ScenarioModel
from tests.polaris.forging import chosen, places, replaced
from tests.polaris.tiny import TINY

SCENES = [*bundled_scenarios(), TINY]


def raw(scene):
    """The file's data as the checker reads it."""
    return read_document(locate(scene))[0]


def of_shape(shape):
    """A shape in a form that can be compared."""
    match shape:
        case dict():
            every = {key.removesuffix("?"): of_shape(item) for key, item in shape.items()}
            return {"keys": every, "required": sorted(key for key in shape if not key.endswith("?"))}
        case OneOf(tables):
            kinds = {kind: {"kind": Text((kind,)), **table} for kind, table in tables.items()}
            return {"kinds": {kind: of_shape(table) for kind, table in kinds.items()}}
        case Items(item, least, most, _):
            return ["rows", of_shape(item), least, None if most == float("inf") else most]
        case AnyOf(shapes):
            return ["either", *(of_shape(item) for item in shapes)]
        case Real(least, most, above, below):
            low = ("above", above) if above is not None else ("least", least)
            high = ("below", below) if below is not None else ("most", most)
            return ["number", *(None if abs(end[1]) == float("inf") else end for end in (low, high))]
        case Int(least, most):
            return ["whole", least, None if most == float("inf") else most]
        case Text(known):
            return ["text", sorted(known)]
    assert shape is bool, shape
    return ["flag"]


def of_schema(part, defs):
    """A JSON Schema in the same form; a scenario file has no null."""
    if "$ref" in part:
        return of_schema(defs[part["$ref"].rpartition("/")[2]], defs)
    for word in ("anyOf", "oneOf"):
        if word in part:
            options = [of_schema(item, defs) for item in part[word] if item.get("type") != "null"]
            return options[0] if len(options) == 1 else _joined(options)
    if part.get("type") == "object":
        every = {key: of_schema(item, defs) for key, item in part["properties"].items()}
        table = {"keys": every, "required": sorted(part.get("required", []))}
        kinds = every.get("kind", ["", []])[1]
        return _by_kind(table, kinds) if table["required"] and "kind" in table["required"] else table
    if part.get("type") == "array":
        return ["rows", of_schema(part["items"], defs), part.get("minItems", 0), part.get("maxItems")]
    if part.get("type") == "number":
        low, high = (
            (strict, part[f"exclusive{end}"]) if f"exclusive{end}" in part else (loose, part.get(end.lower()))
            for end, strict, loose in (("Minimum", "above", "least"), ("Maximum", "below", "most"))
        )
        return ["number", *(None if end[1] is None else end for end in (low, high))]
    if part.get("type") == "integer":
        only = part.get("const")
        return ["whole", part.get("minimum", only), part.get("maximum", only)]
    if part.get("type") == "string":
        return ["text", sorted(part.get("enum", [part["const"]] if "const" in part else []))]
    return {"boolean": ["flag"]}[part["type"]]


def _by_kind(table, kinds):
    """One table per word that ``kind`` may be."""
    return {"kinds": {kind: {**table, "keys": {**table["keys"], "kind": ["text", [kind]]}} for kind in kinds}}


def _joined(options):
    if all(isinstance(item, dict) and "kinds" in item for item in options):
        return {"kinds": {kind: table for item in options for kind, table in item["kinds"].items()}}
    return ["either", *options]


def differences(ours, theirs, at="scenario"):
    """Yield the places at which two forms differ, for the message."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        for key in sorted({*ours, *theirs}):
            pair = (table.get(key, "no such key") for table in (ours, theirs))
            yield from differences(*pair, f"{at}.{key}")
    elif ours != theirs:
        yield f"{at}: {ours} in the checker's table, {theirs} in the models"


def test_the_table_is_that_of_the_models():
    """A key that is new in the models: does a claim rest on it? Then check it; then add it to the table."""
    tables = schema()
    assert not list(differences(of_shape(SCENARIO), of_schema(tables, tables["$defs"])))


def test_every_kind_that_is_known_is_checked():
    assert set(RIGID) == set(SCENARIO["obstacles?"].item.tables) - {"satellite", "states"}
    assert set(GOALS) == set(SCENARIO["goal"].tables)


@pytest.mark.parametrize("scene", SCENES, ids=str)
def test_every_bundled_scenario_is_known_with_and_without_its_defaults(scene):
    check_keys(raw(scene))
    check_keys(load_scenario(scene).to_dict())


@pytest.mark.parametrize("scene", SCENES, ids=str)
def test_an_unknown_or_misspelt_key_is_refused_at_every_level(scene):
    data, count = raw(scene), 0
    for at, value in places(data):
        if not isinstance(value, dict):
            continue
        changed = [value | {key: 0.0} for key in ("unknown", "disturbance_max_N", "Kind", "", "name ")]
        changed += [{(f"{k}s" if k == key else k): v for k, v in value.items()} for key in value]
        for table in changed:
            count += 1
            with pytest.raises(Rejected) as caught:
                check_keys(replaced(data, at, table))
            assert caught.value.claim == "scenario"
    assert count >= 36


def refused(check, *data):
    try:
        check(*data)
    except (ScenarioError, Rejected):
        return True
    return False


OTHERS = (True, 1, 0, -2, 3.0, 0.5, -1.5, 2.0**200, float("nan"), float("inf"), "word", [], {}, [0.5])


@pytest.mark.parametrize(
    "scene", ["robot", *(pytest.param(s, marks=pytest.mark.slow) for s in SCENES if s != "robot")], ids=str
)
def test_the_table_and_the_models_refuse_the_same(scene):
    """Any place replaced by a value of any type, in and out of every range."""
    data, counts = raw(scene), {True: 0, False: 0}
    for at, _ in chosen(data, random.Random(0), 3):
        for other in OTHERS:
            changed = replaced(data, at, other)
            expected = refused(validate, ScenarioModel, changed)
            assert refused(conform, changed, SCENARIO, "scenario", "file") == expected, (at, other)
            counts[expected] += 1
    assert min(counts.values()) >= 20


def test_rules_that_join_keys():
    data = raw("robot")
    for change in (
        {"system": data["system"] | {"C": [[1.0, 0.0, 0.0, 0.0]]}},
        {"experimental": [data["experimental"][0] | {"gain": [[1.0] * 4] * 2}]},
        {"experimental": [{k: v for k, v in data["experimental"][0].items() if k != "R"}]},
        {"experimental": data["experimental"] * 2},
        {"obstacles": [*data["obstacles"], data["obstacles"][0]]},
        {"obstacles": [data["obstacles"][2] | {"offsets_m": [-7.0, -7.0]}]},
    ):
        with pytest.raises(Rejected):
            check_keys({**data, **change})


@pytest.mark.parametrize(
    "text",
    ['{"a":1,"a":1}', '{"a":{"b":[{"c":1,"c":2}]}}', '{"a":NaN}', '{"a":1e999}', "[-Infinity]", '{"a":1} {}'],
)
def test_json_with_double_keys_or_no_numbers_is_refused(text):
    with pytest.raises(ValueError):
        strict_json(text.encode())
