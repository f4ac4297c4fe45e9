"""Whole pages: the folder's numbers, nothing raw, nothing that a file's text could start, no network."""

import base64
import hashlib
import json
import re
import shutil
from unittest import mock

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli import app as cli
from polaris.cli.show.schedule import show_summary
from polaris.report import write_report
from polaris.report.html.assets import own_script, plotly
from polaris.report.html.timelines import drawn_samples
from polaris.runs.run import read_run
from tests.polaris.report.folders import EVIL, rename, rewrite_json, write_comparison, write_tiny
from tests.polaris.report.test_pieces import Tags

HIDDEN = re.compile(r"<(script|style)\b.*?</\1>", re.DOTALL)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("runs") / "tiny")


@pytest.fixture(scope="module")
def html(run, tmp_path_factory):
    return write_report(run, tmp_path_factory.mktemp("page") / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def comparison(run, tmp_path_factory):
    target = tmp_path_factory.mktemp("comparison")
    shutil.copytree(run, target / "run")
    opened = read_run(target / "run")
    return write_comparison(target, opened, opened.plot_data().flights)


def data_of(html):
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    return json.loads(text[1])


def words(html):
    """Return the text that a reader sees, scripts and styles apart."""
    return " ".join(" ".join(Tags(HIDDEN.sub("", html)).texts).split())


def report_of(folder, tmp_path):
    """A report with something else in place of plotly: five megabytes take long to read."""
    with mock.patch("polaris.report.html.page.plotly", lambda: "var Plotly;"):
        return write_report(folder, tmp_path / "report.html", force=True).read_text(encoding="utf-8")


def test_page_can_be_read_without_sight(html):
    tags = Tags(HIDDEN.sub("", html)).tags
    names = [tag for tag, _ in tags]
    assert ("html", {"lang": "en"}) in tags and names.count("h1") == 1 and names.count("title") == 1
    sections = [attrs for tag, attrs in tags if tag == "section"]
    heads = {attrs.get("id") for tag, attrs in tags if tag == "h2"}
    assert sections and all(attrs["aria-labelledby"] in heads for attrs in sections)
    assert all("scope" in attrs for tag, attrs in tags if tag == "th")
    assert names.count("caption") == names.count("table") - 1  # the table of values at a time has a label
    for control in ("play", "time", "run"):
        assert any(attrs.get("id") == control for _, attrs in tags)


def test_nothing_is_asked_of_the_network(html):
    tags = Tags(HIDDEN.sub("", html)).tags
    urls = [attrs[key] for _, attrs in tags for key in ("src", "href", "action", "srcset") if key in attrs]
    assert all(value.startswith(("#", "data:")) for value in urls)
    assert "url(" not in re.sub(r"<script>.*?</script>", "", html, flags=re.DOTALL)
    policy = next(attrs["content"] for _, attrs in tags if attrs.get("http-equiv"))
    assert "default-src 'none'" in policy and "connect-src 'none'" in policy and "unsafe-eval" not in policy
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)  # those and no others are admitted
    assert scripts == [plotly(), own_script()]
    assert "<script" not in own_script() and "eval(" not in own_script()
    for text in scripts:
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


def test_paths_are_those_of_the_folder(run, html):
    data, flights = data_of(html), read_run(run).plot_data().flights["polaris"]
    controller = next(one for one in data["pilots"] if one["key"] == "polaris")
    chosen = drawn_samples(len(flights.times))
    assert controller["labels"] == list(flights.labels) and controller["labels"][0] == "nominal"
    for one, states in zip(controller["runs"], flights.states, strict=True):
        assert np.allclose(np.array(one["p"]).T, states[chosen, :2], rtol=1e-5, atol=1e-9)
    modes = np.repeat(flights.modes, (len(flights.times) - 1) // len(flights.modes))
    assert controller["runs"][0]["modes"] == modes[chosen[:-1]].tolist()


def test_timelines_are_those_of_the_folder(run, html):
    folder, data = read_run(run), data_of(html)
    panels = {panel["key"]: panel for panel in data["panels"]}
    (margin,) = panels["margin"]["series"]
    margins = [step["margin"] for step in folder.json("schedule.json")["steps"]]
    printed, real = (np.array(values, dtype=float) for values in (margin["y"], margins))
    np.testing.assert_allclose(printed, real, rtol=1e-5)
    shares = [float(text.removeprefix("margin ").split(",")[0]) for text in margin["text"]]
    assert all(v is None or 0 <= v - printed < 1e-3 for v, printed in zip(margins, shares, strict=True))
    flights = folder.plot_data().flights["polaris"]
    series = next(one for one in panels["input0"]["series"] if one["pilot"] == "polaris")
    assert np.allclose(series["runs"][0][:-1], flights.inputs[0][:, 0], rtol=1e-5, atol=1e-9)
    assert [one["y"] for one in panels["input0"]["limits"]] == [-1, 1]
    assert all(set(one) == {"t", "text", "panel"} for one in data["marks"]) and data["marks"]


def test_band_and_proof_lie_around_the_simulated_distances(run, html):
    (panel,) = [panel for panel in data_of(html)["panels"] if panel["key"] == "distance"]
    flights = read_run(run).plot_data().flights["polaris"]
    series = next(one for one in panel["series"] if one["pilot"] == "polaris")
    assert np.allclose(series["band"], flights.nearest[[0, 2]], rtol=1e-5)
    assert np.allclose(np.min(series["runs"], axis=1).min(), flights.nearest[0].min(), rtol=1e-5)
    proven = next(one for one in panel["series"] if one["pilot"] is None)
    at = np.searchsorted(proven["t"], flights.times, side="right") - 1
    assert np.all(np.array(proven["y"])[at] <= flights.nearest[0] + 1e-5)
    assert max(proven["y"]) > 0


def test_first_screen_answers_what_a_reader_asks(run, html):
    summary, page = read_run(run).summary, words(html)
    head = page[: page.index("The flight")]
    goal, search = summary["guarantee"]["goal"], summary["synthesis"]
    assert goal["reached"] is True and f"Does it arrive? at {goal['by_s']:.6g} s proven, within" in head
    assert "Is it safe? ✓ proved" in head
    texts = {"distance_m": r"within ([\d.]+) m of the goal", "delta_v_max_m_s": r"at most ([\d.]+) m/s"}
    for key, text in texts.items():
        (bound,) = re.findall(text, head)
        assert goal[key] <= float(bound) <= goal[key] * 1.001
    for source in ("polaris", "safety"):
        assert f"{summary[source]['delta_v_m_s']:.4g} m/s" in head
    assert f"U {100 * search['experimental_share']:.1f} %" in head and f"{search['switches']} switch" in head
    modes = read_run(run).plot_data().modes
    bar = [int(width) for width in re.findall(r'<i style="flex: (\d+)', html)]
    assert sum(bar) == len(modes) and len(bar) == 1 + search["switches"]
    for source in ("safety", "experimental", "polaris"):
        assert f"{summary[source]['min_distance_m']:.4g} m" in page
        assert f"{100 * summary[source]['experimental_share']:.1f} %" in page
    assert all(assumption in page for assumption in summary["guarantee"]["assumptions"])
    assert "What is not proven" in page and "How far it reaches" in page and "✓ proved" in page


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"goal": {"reached": "not_proven", "by_s": None}}, "Does it arrive? not proven at best within"),
        ({"goal": {"reached": False, "by_s": None}}, "Does it arrive? no at best within"),
        ({"kind": "none"}, "Does it arrive? no claim"),
        ({"horizon": "infinite", "until_s": None}, "for all time"),
        ({"horizon": "none", "until_s": 12.0}, "until 12 s (end of the schedule)"),
    ],
)
def test_first_screen_says_no_more_than_is_proven(run, tmp_path, change, told):
    folder = shutil.copytree(run, tmp_path / "run")

    def less(data):
        claim = data["guarantee"]
        claim |= change | {"goal": claim["goal"] | change.get("goal", {})}

    rewrite_json(folder / "summary.json", less)
    html = report_of(folder, tmp_path)
    assert told in words(html)
    assert "horizon" in change or "of the goal at" not in words(html)
    assert "horizon" in change or "That the schedule reaches the goal:" in words(html)
    assert ("NOTHING IS PROVEN" in words(html)) == ("What is proven" not in words(html)) == ("kind" in change)
    names = [one.get("name") or "" for panel in data_of(html)["panels"] for one in panel["series"]]
    assert "kind" not in change or not (data_of(html)["marks"] or any("proven" in name for name in names))


def test_a_claim_that_ends_at_T_is_named_as_the_cause_of_a_missed_goal(run, tmp_path, capsys):
    folder = shutil.copytree(run, tmp_path / "run")

    def returns(data):
        reason = (
            "not proven after T = 12 s, though S flies on: a: b at t = 17 s: needs 2.4 m, available -18.8 m"
        )
        data["guarantee"] |= {"horizon": "none", "until_s": 12.0, "reason": reason}
        data["guarantee"]["goal"] |= {"reached": "not_proven", "by_s": None}

    rewrite_json(folder / "summary.json", returns)
    text = words(report_of(folder, tmp_path))
    show_summary(read_run(folder).summary, "run")
    cause = "the claim ends at T = 12 s because of a: b at t = 17 s, and S needs time after T to settle"
    assert text.count(cause) == 3 and "a flight need not" not in text
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("Goal: not proven"))
    assert f"; {cause}. Delta-v" in line


def test_velocity_change_adds_up_to_what_was_flown(run, html):
    folder = read_run(run)
    picture, (panel,) = folder.plot_data(), [one for one in data_of(html)["panels"] if one["key"] == "spent"]
    (bound,) = panel["limits"]
    assert bound["y"] == pytest.approx(folder.summary["guarantee"]["goal"]["delta_v_max_m_s"], rel=1e-5)
    for series in panel["series"]:
        flights = picture.flights[series["pilot"]]
        for inputs, drawn in zip(flights.inputs, series["runs"], strict=True):
            total = (np.abs(inputs) * np.diff(flights.times)[:, None]).sum() / picture.system.mass
            assert drawn[-1] == pytest.approx(total, rel=1e-5)
            assert drawn[0] == 0 and np.all(np.diff(drawn) >= 0)
            assert series["pilot"] != "polaris" or drawn[-1] <= bound["y"]


def test_what_is_proven_to_be_left_is_rounded_down(run, tmp_path, capsys):
    folder = shutil.copytree(run, tmp_path / "run")

    def nearly(data):
        data["synthesis"]["start_margin"] = 0.99996
        data["synthesis"]["planner"]["margin_m"] = 29.99996

    rewrite_json(folder / "summary.json", nearly)
    text = words(report_of(folder, tmp_path))
    assert "99.9% of the clearance (limiting: " in text and "29.99 m" in text
    show_summary(read_run(folder).summary, "run")
    printed = capsys.readouterr().out
    assert "Start margin: 99.9% of the clearance" in printed and "clearance 29.99 m" in printed


def test_no_raw_value_is_ever_printed(run, tmp_path):
    folder = shutil.copytree(run, tmp_path / "run")

    def empty(data):
        for source in ("safety", "experimental", "polaris"):
            data[source] |= {"min_ttc_s": None, "min_distance_m": None, "max_thrust_ratio_safety": None}
        data["synthesis"]["start_margin"] = None
        del data["definitions"]  # they explain what null means

    rewrite_json(folder / "summary.json", empty)
    text = words(report_of(folder, tmp_path))
    assert not re.search(r"\b(null|nan|NaN|inf|Infinity|None|undefined)\b", text)
    assert "∞" in text and "none" in text


@pytest.mark.parametrize(
    "title", [EVIL, "</script><script>alert(1)</script>", '"><svg onload=alert(1)>', "<!--", "&lt;"]
)
def test_titles_are_inert(run, tmp_path, title):
    folder = shutil.copytree(run, tmp_path / "run")
    rename(folder, title)
    html = report_of(folder, tmp_path)
    tags = Tags(html).tags
    assert len([tag for tag, _ in tags if tag == "script"]) == 3 and "svg" not in dict(tags)
    assert title in words(html)


def test_names_of_methods_are_inert(comparison, tmp_path):
    folder, name = shutil.copytree(comparison, tmp_path / "folder"), "</script><script>alert(1)</script>"
    rewrite_json(folder / "comparison.json", lambda data: data["methods"][1].update(name=name, key="safety"))
    html = report_of(folder, tmp_path)
    assert len(re.findall(r"<script", html)) == 3 and data_of(html)["pilots"][1]["name"] == name


def test_every_method_is_in_the_tables_and_in_the_scene(comparison, tmp_path):
    html = report_of(comparison, tmp_path)
    text, data = words(html), data_of(html)
    assert [one["key"] for one in data["pilots"]] == ["schedule", "safety", "experimental", "filter_0"]
    assert "slice" not in {layer["group"] for layer in data["scene"]["layers"]}  # they are not of these runs
    for name in ("Polaris schedule", "S alone", "U alone", "filter 0", "needs a licence"):
        assert name in text
    assert "4.5 to 5.5" in text and "worst 4" in text and "never heard of (m)" in text
    assert "-1.5 to -0.5" in text and "Method minus Polaris schedule" in text
    assert {one["mode"] for one in data["modes"]} == {-1, 0, 1}
    assert "40 decisions in 2 stretches" in text and EVIL in text
    assert "alert(1)</script>" not in HIDDEN.sub("", html)
    assert (
        html.index("<h1>")
        < html.index('<img src="data:image/png;base64,')
        < html.index('<section id="flight"')
    )
    tables = [attrs.get("class", "") for tag, attrs in Tags(HIDDEN.sub("", html)).tags if tag == "table"]
    assert sum("sortable" in name for name in tables) == 2 and any("wide" in name for name in tables)
    saved = np.load(comparison / "comparison.npz")
    near = [saved[f"{key}_distance_m"][0] for key in ("schedule", "safety", "experimental", "filter_0")]
    assert data["open"] == pytest.approx(saved["schedule_t_s"][np.argmin(min(near, key=np.min))])


@pytest.fixture(scope="module")
def inspections(tmp_path_factory):
    place = tmp_path_factory.mktemp("inspection")
    campaign = "campaign inspection-monte-carlo --runs 2 --workers 1 --set campaign.duration_s=5"
    flight = "--set flight.duration_s=20"
    commands = {"flight": f"run inspection {flight}", "fuel": f"run fuel-limit {flight}"}
    commands["campaign"] = f"{campaign} --set campaign.deputies=2"
    for kind, command in commands.items():
        arguments = [*command.split(), "--out", str(place / kind), "--no-figures", "-q"]
        assert CliRunner().invoke(cli.app, arguments).exit_code == 0
    return {kind: place / kind for kind in commands}


def test_flight_of_deputies(inspections, tmp_path):
    html = report_of(inspections["flight"], tmp_path)
    data, text = data_of(html), words(html)
    assert [one["name"] for one in data["pilots"]] == [f"deputy {i}" for i in range(5)]
    lines = {one["name"]: one for panel in data["panels"] for one in panel["series"] if one["pilot"] is None}
    assert set(lines) == {f"phi{i}" for i in range(1, 12)}
    summary = json.loads((inspections["flight"] / "summary.json").read_text())
    for row in summary["constraints"]:
        least = min(lines[row["constraint"]]["y"])
        assert least == pytest.approx(row["least_at_samples"], rel=1e-5, abs=1e-9)
        assert f"{row['least']:.4g} {row['unit']}".replace("^2", "²") in text
    assert "No constraint is violated" in text and "What is claimed" in text


def test_flight_into_the_fuel_limit(inspections, tmp_path):
    data, saved = data_of(report_of(inspections["fuel"], tmp_path)), np.load(inspections["fuel"] / "fuel.npz")
    panel = next(panel for panel in data["panels"] if panel["key"] == "fuel")
    assert np.allclose(panel["series"][0]["runs"][0], saved["delta_v_m_s"], rtol=1e-5, atol=1e-9)
    assert panel["limits"] == [{"y": 20, "text": "fuel limit", "unsafe": "above"}]


def test_campaign_is_tables_alone(inspections, tmp_path):
    html = report_of(inspections["campaign"], tmp_path)
    assert data_of(html) == {} and "var Plotly" not in html and len(html) < 100_000
    text = words(html)
    assert "statistical" in text and "decentralized-no-h5" in text


def invoke(*args):
    return CliRunner().invoke(cli.app, ["report", *map(str, args)])


def test_one_error_for_what_is_no_folder_of_ours(run, tmp_path):
    (tmp_path / "empty").mkdir()
    damaged = shutil.copytree(run, tmp_path / "damaged")
    (damaged / "trajectories.npz").write_bytes(b"nothing")
    cases = [(tmp_path / "empty",), (tmp_path / "missing",), (damaged,), (run, "--out", tmp_path)]
    cases.append((run, "--out", tmp_path / "no" / "where.html"))
    for case in cases:
        done = invoke(*case)
        assert done.exit_code == 2 and done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert not list(damaged.glob("*report*"))
