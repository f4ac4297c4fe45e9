"""Reports in a browser without a network: they draw, time moves all of the page, nothing is asked for."""

import io
import json
import re
import shutil
import socket
import time
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli import app as cli
from polaris.report import write_report
from polaris.runs.run import read_run
from tests.polaris.report.folders import EVIL, rename, write_comparison, write_tiny

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
MOST = 120.0
"""Seconds that any one wait may take: far more than it needs, and an end if the browser hangs."""

pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs chromium and chromedriver, which are not installed"
)

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--proxy-server=127.0.0.1:1",  # nobody answers there
    "--window-size=900,700",
    "about:blank",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small run in the plane, with a title that tries to run a script."""
    made = write_tiny(tmp_path_factory.mktemp("pages") / "run")
    rename(made, EVIL)
    return made


@pytest.fixture(scope="module")
def page(folder):
    """The address of its report."""
    return write_report(folder).as_uri()


@pytest.fixture(scope="module")
def comparison(folder, tmp_path_factory):
    """The address of a report of a comparison."""
    place = tmp_path_factory.mktemp("compared")
    shutil.copytree(folder, place / "run")
    opened = read_run(place / "run")
    return write_report(write_comparison(place, opened, opened.plot_data().flights)).as_uri()


@pytest.fixture(scope="module")
def in_space(tmp_path_factory):
    """The address of a report with a scene in space."""
    place = tmp_path_factory.mktemp("space") / "flight"
    command = f"run inspection --set flight.duration_s=20 --out {place} --no-figures -q"
    assert CliRunner().invoke(cli.app, command.split()).exit_code == 0
    return write_report(place).as_uri()


@pytest.fixture(scope="module")
def fuel(tmp_path_factory):
    """The address of a report of a flight into the fuel limit."""
    place = tmp_path_factory.mktemp("fuel") / "flight"
    assert CliRunner().invoke(cli.app, f"run fuel-limit --out {place} --no-figures -q".split()).exit_code == 0
    return write_report(place).as_uri()


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """The address of a report of many flights: tables alone."""
    place = tmp_path_factory.mktemp("many") / "runs"
    command = f"run inspection-monte-carlo --set campaign.runs=2 --out {place} --no-figures -q"
    assert CliRunner().invoke(cli.app, command.split()).exit_code == 0
    return write_report(place).as_uri()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('feedback_bound')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(2 * MOST)  # selenium takes it over for all that it asks the driver
    try:
        driver = webdriver.Chrome(service=webdriver.ChromeService(DRIVER), options=options)
    finally:
        socket.setdefaulttimeout(before)
    driver.set_page_load_timeout(MOST)
    driver.set_script_timeout(MOST)
    yield driver
    driver.quit()


def wait(browser, script, *args, most=MOST):
    """Ask until the answer is true."""
    until = time.monotonic() + most
    while not (answer := browser.execute_script(script, *args)):
        assert time.monotonic() < until, script
        time.sleep(0.1)
    return answer


def open_page(browser, address):
    browser.get_log("browser"), browser.get_log("performance")  # what came before
    browser.get(address)
    wait(browser, "return ['scene', 'timelines'].every((id) => document.getElementById(id)._fullLayout)")


def move_slider(browser, share):
    """Move the slider as a hand would, and wait until the scene has followed."""
    script = """const slider = document.getElementById('time');
    slider.value = slider.max * arguments[0];
    slider.dispatchEvent(new Event('input'));
    return [Number(slider.value), Number(slider.max)];"""
    t, end = browser.execute_script(script, share)
    # A decision nearby takes its place.
    script = """const x = document.getElementById('timelines').layout.shapes[0].x0;
    return Math.abs(x - arguments[0]) <= arguments[1] && [x];"""
    return wait(browser, script, t, end / 1000)[0]


def trace(browser, uid):
    """Coordinates of one trace of the scene as plotly holds it."""
    script = """const found = document.getElementById('scene').data.find((one) => one.uid === arguments[0]);
    return found && [found.x, found.y];"""
    return browser.execute_script(script, uid)


def assert_quiet(browser):
    """No error on the console, and no request but for the page itself and what it holds."""
    logged = [one for one in browser.get_log("browser") if one["level"] == "SEVERE"]
    assert [one for one in logged if not one["message"].startswith("chrome")] == []
    sent = [json.loads(one["message"])["message"] for one in browser.get_log("performance")]
    urls = [one["params"]["request"]["url"] for one in sent if one["method"] == "Network.requestWillBeSent"]
    urls = [url for url in urls if not url.startswith("chrome")]  # the tab with which the browser opens
    assert all(url.startswith(("file:", "data:", "blob:")) for url in urls), urls
    assert len({url for url in urls if url.startswith("file:")}) == 1


def test_slider_moves_scene_cursor_and_table(browser, page):
    open_page(browser, page)
    move_slider(browser, 0.1)  # away from where it opens
    before, table = trace(browser, "pilotpolarisnow"), browser.execute_script(READOUT)
    t = move_slider(browser, 0.5)
    wait(
        browser, "return document.getElementById('now').textContent.startsWith(arguments[0])", f"{t:.2f}"[:3]
    )
    wait(browser, MOVED, "pilotpolarisnow", before[0][0])
    flown = trace(browser, "pilotpolaris1")
    assert trace(browser, "pilotpolarisnow") != before and browser.execute_script(READOUT) != table
    move_slider(browser, 1.0)
    wait(browser, LONGER, "pilotpolaris1", len(flown[0]))
    assert_quiet(browser)


READOUT = "return document.getElementById('readout').textContent"
AT_START = """const one = document.getElementById('scene').data.find((one) => one.uid === 'pilotpolarisnow');
const all = document.getElementById('scene').data.find((one) => one.uid === 'pilotpolarisall');
return one.x[0] === all.x[0];"""
MOVED = """const one = document.getElementById('scene').data.find((one) => one.uid === arguments[0]);
return one.x[0] !== arguments[1];"""
LONGER = """const one = document.getElementById('scene').data.find((one) => one.uid === arguments[0]);
return one.x.length > arguments[1];"""


@pytest.mark.slow
def test_moving_sets_and_tubes_follow_the_time(browser, page):
    open_page(browser, page)
    script = """return Object.fromEntries(document.getElementById('scene').data
    .filter((one) => arguments[0].includes(one.name)).map((one) => [one.name, one.x]));"""
    names = ["trolley", "reachable now", "pillar"]
    move_slider(browser, 0.0)
    wait(browser, AT_START)
    early = browser.execute_script(script, names)
    before = trace(browser, "pilotpolarisnow")
    move_slider(browser, 0.75)
    wait(browser, MOVED, "pilotpolarisnow", before[0][0])
    late = browser.execute_script(script, names)
    assert set(late) == set(names) and late["pillar"] == early["pillar"]
    assert all(late[name] != early[name] for name in names[:2])
    assert np.allclose(np.array(late["trolley"]) - early["trolley"], -0.05 * 9, atol=1e-4)


SLICE = """const seen = document.getElementById('scene').data;
const name = (document.getElementById('notes').textContent.match(/drawn: at ([^ ]+) s/) || [])[1];
const [area, edge, place, here] = ['slice', 'sliceedge', 'sliceplace', 'pilotpolarisnow']
  .map((uid) => seen.find((one) => one.uid === uid));
const named = (document.getElementById('scene').layout.annotations || []).map((one) => one.text);
const drawn = here && named.includes(`recoverable at ${name} s`) && named.includes(edge.name);
return drawn && { t: Number(name), filled: area.x.length > 0, dash: edge.line.dash, text: edge.name,
  here: [here.x[0], here.y[0]], place: [place.x[0], place.y[0]], outline: [edge.x, edge.y] };"""


def test_a_recoverable_set_holds_the_chaser_or_bears_its_own_time(browser, page):
    open_page(browser, page)
    filled = 0
    for share in (None, 0.0, 0.04, 0.13, 0.25, 0.376, 0.5, 0.62, 0.75, 0.99):
        if share is not None:
            before = trace(browser, "pilotpolarisnow")
            t = move_slider(browser, share)
            until = time.monotonic() + MOST
            while trace(browser, "pilotpolarisnow") == before:
                assert time.monotonic() < until
                time.sleep(0.1)
        else:
            t = browser.execute_script("return document.getElementById('timelines').layout.shapes[0].x0")
        drawn = wait(browser, SLICE)
        edge = np.array(drawn["outline"]).T
        along, now = np.diff(edge, axis=0), abs(drawn["t"] - t) < 1e-3
        beside = np.array(drawn["here" if now else "place"]) - edge[:-1]
        assert np.all(along[:, 0] * beside[:, 1] - along[:, 1] * beside[:, 0] > -1e-4)
        assert drawn["text"] == f"recoverable at {drawn['t']:.4g} s" and drawn["t"] < t + 1e-3
        assert (drawn["filled"], drawn["dash"]) == ((True, "solid") if now else (False, "dash"))
        assert now or drawn["place"] != drawn["here"]
        filled += now
    assert 2 <= filled < 10  # where it opens, and at the start
    assert_quiet(browser)


@pytest.mark.slow
def test_pointing_at_a_timeline_moves_the_scene(browser, page):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    open_page(browser, page)
    move_slider(browser, 0.0)
    area = browser.find_element(By.CSS_SELECTOR, "#timelines .nsewdrag[data-subplot='xy2']")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", area)
    ActionChains(browser).move_to_element_with_offset(area, 10, 0).move_by_offset(5, 0).perform()
    wait(browser, "return Number(document.getElementById('time').value) > 0")
    t = float(browser.execute_script("return document.getElementById('time').value"))
    assert browser.execute_script(
        "return document.getElementById('timelines').layout.shapes[0].x0"
    ) == pytest.approx(t, abs=0.05)
    assert 4 < t < 9  # a little to the right of the middle of 12 s


PLAY = """const done = arguments[0], play = document.getElementById('play');
const slider = document.getElementById('time');
play.click();
const seen = [play.textContent];
(function next() {
  if (Number(slider.value) <= 0.1) { requestAnimationFrame(next); return; }
  play.click();
  seen.push(play.textContent, slider.value);
  setTimeout(() => done([...seen, slider.value]), 300);
})();"""


OVERFLOW = """return [document.documentElement.scrollWidth - arguments[0],
  ...[...document.querySelectorAll('.scroll')].map((one) => one.scrollWidth - one.clientWidth)];"""

WIDTHS = (390, 700, 1280)


@pytest.fixture
def screen(browser):
    """Set width [px], colour scheme and medium of the page that is opened next."""

    def choose(width, scheme, medium="screen"):
        size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        scheme = [{"name": "prefers-color-scheme", "value": scheme}]
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": medium, "features": scheme})

    yield choose
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


LUMINANCES = r"""const light = (colour) => {
  const found = (colour || '').match(/[\d.]+/g);
  if (!found || colour.startsWith('#')) return null;
  const [r, g, b] = found.slice(0, 3).map((v) => (v <= 10 ? v / 3295 : ((v / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const seen = (selector, key) => [...document.querySelectorAll(selector)]
  .filter((one) => one.getClientRects().length).map((one) => light(getComputedStyle(one)[key]));
return { paper: seen('body', 'backgroundColor'), ink: seen('h1, h2, h3, p, td, th, li, dd, button', 'color'),
  plots: seen('.main-svg', 'backgroundColor'), words: seen('#timelines text', 'fill'),
  lines: seen('.scatterlayer .js-line', 'stroke') };"""


def contrast(a, b):
    return (max(a, b) + 0.05) / (min(a, b) + 0.05)


def assert_readable(browser, dark):
    """Texts and lines stand out against the page, which is dark or light all over."""
    tones = browser.execute_script(LUMINANCES)
    (paper,) = tones["paper"]
    assert (paper < 0.05) if dark else (paper > 0.9)
    assert all(one is None or abs(one - paper) < 0.01 or one == 0 for one in tones["plots"])
    assert tones["ink"] and min(contrast(one, paper) for one in tones["ink"]) > 4
    assert tones["words"] and min(contrast(one, paper) for one in tones["words"]) > 2.4
    assert tones["lines"] and min(contrast(one, paper) for one in tones["lines"]) > (2 if dark else 1.2)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_report_fits_a_phone_in_light_and_dark(browser, page, screen, scheme):
    screen(390, scheme)
    open_page(browser, page)
    assert max(browser.execute_script(OVERFLOW, 390)) <= 0
    scene = (
        "const box = document.getElementById('scene').getBoundingClientRect(); return [box.left, box.right]"
    )
    left, right = browser.execute_script(scene)
    assert left >= 0 and right <= 390
    assert_readable(browser, scheme == "dark")
    assert_quiet(browser)


TITLES = """const own = document.getElementById('timelines'), frame = own.getBoundingClientRect();
return [...own.querySelectorAll('.annotation-text')].map((one) => (
  [one.textContent, one.getBoundingClientRect().right - frame.right]));"""


@pytest.mark.parametrize("width", [390, 1200])
def test_titles_of_diagrams_are_not_cut(browser, page, screen, width):
    screen(width, "light")
    open_page(browser, page)
    beyond = dict(browser.execute_script(TITLES))
    assert any("Margin of each" in title for title in beyond) and max(beyond.values()) <= 1, beyond


NAMES = """const scene = document.getElementById('scene'), frame = scene.getBoundingClientRect();
return Object.fromEntries([...scene.querySelectorAll('.annotation-text-g')].map((one) => {
  const { left, top, right, bottom } = one.getBoundingClientRect();
  return [one.textContent, [left - frame.left, top - frame.top, right - frame.left, bottom - frame.top]];
}))"""


def assert_names_apart(browser, wanted, width):
    """All names are in the scene, within its frame, and none covers another."""
    until = time.monotonic() + MOST
    while not set(named := browser.execute_script(NAMES)) >= wanted:
        assert time.monotonic() < until, (wanted, named)
        time.sleep(0.1)
    boxes = np.array(list(named.values()))
    assert np.all(boxes[:, :2] >= -1) and np.all(boxes[:, 2] <= width + 1)
    over = np.minimum(boxes[:, None, 2:], boxes[:, 2:]) - np.maximum(boxes[:, None, :2], boxes[:, :2])
    assert not np.any(np.triu(np.all(over > 0, axis=2), 1)), named


def test_names_in_the_plane_are_apart_on_a_phone(browser, page, screen):
    screen(390, "light")
    open_page(browser, page)
    for share in (0.1, 0.4, 0.6):
        move_slider(browser, share)
        time.sleep(0.5)
        assert_names_apart(browser, {"pillar", "trolley"}, 370)
    assert_quiet(browser)


CROWD = {f"set number {i}": [4.0 * i, 0.0, 2.0 * i] for i in range(6)}


@pytest.mark.slow
def test_names_in_space_are_apart_on_a_phone_however_the_scene_is_turned(browser, in_space, screen, tmp_path):
    text = Path(url2pathname(urlsplit(in_space).path)).read_text(encoding="utf-8")
    head, middle, tail = re.split(r'(?<=id="data">)(.*?)(?=</script>)', text, maxsplit=1)
    data = json.loads(middle)
    look = {
        "kind": "points",
        "group": "unsafe",
        "colour": "#C0202B",
        "opacity": 1,
        "symbol": "circle",
        "size": 4,
    }
    for name, place in CROWD.items():
        data["scene"]["layers"].append({"name": name, "label": name, "p": [[v] for v in place]} | look)
    (tmp_path / "crowded.html").write_text(head + json.dumps(data) + tail, encoding="utf-8")
    screen(390, "light")
    open_page(browser, (tmp_path / "crowded.html").as_uri())
    if not browser.execute_script("return !!document.createElement('canvas').getContext('webgl')"):
        pytest.skip("this browser has no WebGL")
    assert_names_apart(browser, set(CROWD), 370)
    before = browser.execute_script(NAMES)
    turn = "Plotly.relayout('scene', {'scene.camera.eye': {x: 1.6, y: 0.4, z: 0.2}})"
    browser.execute_script(turn)
    until = time.monotonic() + MOST
    while browser.execute_script(NAMES) == before:
        assert time.monotonic() < until
    time.sleep(1.0)  # and places the names anew
    assert_names_apart(browser, set(CROWD), 370)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["page", "comparison", "in_space", "fuel", "campaign"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_window(browser, screen, request, kind, width):
    address = request.getfixturevalue(kind)
    for scheme in ("light", "dark"):
        screen(width, scheme)
        if kind == "campaign":
            browser.get(address)  # tables alone
        else:
            open_page(browser, address)
        browser.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert max(browser.execute_script(OVERFLOW, width)) <= 0
        image = "return [...document.querySelectorAll('img')].map((one) => one.naturalWidth)"
        assert all(wide > 0 for wide in browser.execute_script(image))
        if kind in ("page", "comparison"):
            assert_readable(browser, scheme == "dark")
        text = browser.execute_script("return document.body.innerText")
        assert "{'" not in text and not re.search(r"\de-1[0-9]\b", text)


@pytest.mark.slow
def test_a_dark_page_follows_the_scheme_and_prints_light(browser, page, screen):
    screen(1280, "dark")
    open_page(browser, page)
    assert_readable(browser, dark=True)
    screen(1280, "light")
    wait(browser, "return document.getElementById('timelines').layout.paper_bgcolor === '#fff'")
    assert_readable(browser, dark=False)
    screen(1280, "dark")
    wait(browser, "return document.getElementById('timelines').layout.paper_bgcolor !== '#fff'")
    browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    screen(1280, "dark", medium="print")
    wait(browser, "return document.getElementById('timelines').layout.paper_bgcolor === '#fff'")
    assert_readable(browser, dark=False)


@pytest.mark.slow
def test_page_opens_where_it_is_closest_with_all_of_it_in_view(browser, page):
    open_page(browser, page)
    script = """const data = JSON.parse(document.getElementById('data').textContent);
    const { xaxis, yaxis } = document.getElementById('scene')._fullLayout;
    const trolley = document.getElementById('scene').data.find((one) => one.name === 'trolley');
    return [Number(document.getElementById('time').value), data.open, xaxis.range, yaxis.range,
      data.scene.range, trolley.x, trolley.y];"""
    t, opened, x, y, shown, *trolley = browser.execute_script(script)
    assert t == pytest.approx(opened, abs=0.02) and opened > 0
    for axis, known, points in zip((x, y), shown, trolley, strict=True):
        assert axis[0] <= known[0] + 1e-6 and axis[1] >= known[1] - 1e-6
        assert axis[0] < min(points) and max(points) < axis[1]


@pytest.mark.slow
def test_play_runs_and_pauses(browser, page):
    open_page(browser, page)
    pause, play, stopped, later = browser.execute_async_script(PLAY)
    assert (pause, play) == ("Pause", "Play") and stopped == later
    assert 0.1 < float(stopped) < 12


@pytest.mark.slow
def test_run_and_controller_are_chosen(browser, page):
    open_page(browser, page)
    move_slider(browser, 1.0)
    nominal = trace(browser, "pilotpolarisall")
    choose = "const run = document.getElementById('run'); run.value = 'closest';"
    browser.execute_script(choose + "run.dispatchEvent(new Event('change'));")
    wait(browser, MOVED, "pilotpolarisall", nominal[0][0])
    assert trace(browser, "pilotexperimentalall") is None
    browser.execute_script("document.querySelectorAll('#pilots input')[2].click()")
    wait(
        browser,
        "return document.getElementById('scene').data.some((one) => one.uid === 'pilotexperimentalall')",
    )
    assert browser.execute_script("return document.querySelectorAll('#readout tbody tr').length") == 2


@pytest.mark.slow
def test_title_is_inert_and_the_policy_holds(browser, page):
    open_page(browser, page)
    assert browser.find_element("css selector", "h1").text == EVIL and EVIL in browser.title
    script = """const done = arguments[0];
    fetch('http://127.0.0.1:9/').then(() => done('asked'), () => done('refused'));"""
    assert browser.execute_async_script(script) == "refused"
    refused = [one["message"] for one in browser.get_log("browser")]
    assert any("Content Security Policy" in message for message in refused)
    inline = """const script = document.createElement('script');
    script.textContent = 'window.ran = 1';
    document.body.append(script);
    return window.ran;"""
    assert browser.execute_script(inline) is None


@pytest.mark.slow
def test_methods_are_sorted_and_overlaid(browser, comparison):
    open_page(browser, comparison)
    names = """return [...document.querySelectorAll('#methods table.sortable tbody th')]
    .map((one) => one.textContent)"""
    assert browser.execute_script(names)[0] == "Polaris schedule"
    browser.execute_script("document.querySelectorAll('#methods thead button')[2].click()")
    ordered = browser.execute_script(names)
    assert ordered[0] == "filter 0" and ordered[-1].startswith("needs a licence")  # without a value: last
    shown = """return document.getElementById('timelines').data
    .filter((one) => one.type === 'scatter').map((one) => one.name)"""
    assert {"Polaris schedule", "S alone", "U alone", "filter 0"} <= set(browser.execute_script(shown))
    assert_quiet(browser)


@pytest.mark.slow
def test_scene_in_space_is_not_blank(browser, in_space):
    from matplotlib import image

    open_page(browser, in_space)
    if not browser.execute_script("return !!document.createElement('canvas').getContext('webgl')"):
        pytest.skip("this browser has no WebGL")
    move_slider(browser, 0.9)
    wait(browser, "return document.querySelector('#scene canvas') !== null")
    time.sleep(1.0)
    size = browser.get_window_size()
    browser.set_window_size(1000, 1400)  # a picture of an element shows what of it is in the window
    time.sleep(1.0)
    picture = image.imread(io.BytesIO(browser.find_element("css selector", "#scene").screenshot_as_png))
    colours = np.unique((picture[..., :3] * 15).astype(int).reshape(-1, 3), axis=0)
    assert len(colours) > 20
    browser.set_window_size(size["width"], size["height"])
    # It fills its frame and is within it; the frame's own edge and plotly's buttons apart.
    drawn = np.any(picture[45:-3, 3:-3, :3] < 0.75, axis=2)
    high, wide = drawn.shape
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    assert rows[-1] - rows[0] > 0.6 * high or columns[-1] - columns[0] > 0.7 * wide
    assert rows[-1] < high - 3 and columns[0] > 3 and columns[-1] < wide - 3
    assert_quiet(browser)
