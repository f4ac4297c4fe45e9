"""Reports in a browser without a network: they draw, time moves all of the page, nothing is asked for."""

import io
import json
import re
import shutil
import socket
import time

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
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--window-size=900,700"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "about:blank"),
    "--proxy-server=127.0.0.1:1",  # nobody answers there
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small run in the plane, with a title that tries to run a script."""
    path = write_tiny(tmp_path_factory.mktemp("pages") / "run")
    rename(path, EVIL)
    return path


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
def others(tmp_path_factory):
    """Addresses of reports of inspection flights: in space, into the fuel limit, of many flights."""
    place, addresses = tmp_path_factory.mktemp("inspections"), {}
    for kind, command in (
        ("in space", "inspection --set flight.duration_s=20"),
        ("fuel", "fuel-limit"),
        ("campaign", "inspection-monte-carlo --set campaign.runs=2"),
    ):
        arguments = f"run {command} --out {place / kind.replace(' ', '-')} --no-figures -q".split()
        assert CliRunner().invoke(cli.app, arguments).exit_code == 0
        addresses[kind] = write_report(place / kind.replace(" ", "-")).as_uri()
    return addresses


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('browser')}"):
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
    t, end = browser.execute_script(MOVE, share)
    return wait(browser, FOLLOWED, t, end / 1000)[0]


MOVE = """const slider = document.getElementById('time');
slider.value = slider.max * arguments[0];
slider.dispatchEvent(new Event('input'));
return [Number(slider.value), Number(slider.max)];"""
FOLLOWED = """const x = document.getElementById('timelines').layout.shapes[0].x0;
return Math.abs(x - arguments[0]) <= arguments[1] && [x];"""  # a decision nearby takes its place
TRACE = """const one = document.getElementById('scene').data.find((one) => one.uid === arguments[0]);
return one && [one.x, one.y];"""
OF_NAME = "return document.getElementById('scene').data.find((one) => one.name === arguments[0]).x"
READOUT = "return ['now', 'readout'].map((id) => document.getElementById(id).textContent)"


def trace(browser, uid, unlike=()):
    """Coordinates of one trace of the scene, once they differ from `unlike`."""
    until = time.monotonic() + MOST
    while (points := browser.execute_script(TRACE, uid)) == unlike:
        assert time.monotonic() < until
        time.sleep(0.1)
    return points


def test_slider_moves_scene_cursor_moving_sets_and_table(browser, page):
    open_page(browser, page)
    at, frames = trace(browser, "pilotpolarisnow"), []
    for share in (0.3, 1.0):
        t = move_slider(browser, share)
        at = trace(browser, "pilotpolarisnow", at)
        sets = [np.array(browser.execute_script(OF_NAME, name)) for name in ("trolley", "pillar")]
        time_text, table = browser.execute_script(READOUT)
        assert time_text.startswith(f"{t:.2f}"[:3])
        frames.append((t, len(trace(browser, "pilotpolaris1")[0]), *sets, table))
    (t, count, trolley, pillar, table), after = frames
    np.testing.assert_allclose(after[2] - trolley, -0.05 * (after[0] - t), atol=1e-3)
    assert after[1] > count and after[4] != table and np.array_equal(after[3], pillar)
    assert_quiet(browser)


def assert_quiet(browser):
    """No error on the console, and no request but for the page itself and what it holds."""
    logged = [one for one in browser.get_log("browser") if one["level"] == "SEVERE"]
    assert [one for one in logged if not one["message"].startswith("chrome")] == []
    sent = [json.loads(one["message"])["message"] for one in browser.get_log("performance")]
    urls = [one["params"]["request"]["url"] for one in sent if one["method"] == "Network.requestWillBeSent"]
    urls = [url for url in urls if not url.startswith("chrome")]  # the tab with which the browser opens
    assert all(url.startswith(("file:", "data:", "blob:")) for url in urls), urls
    assert len({url for url in urls if url.startswith("file:")}) == 1


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
    for share in (None, 0.0, 0.13, 0.376, 0.62, 0.99):
        if share is not None:
            before = trace(browser, "pilotpolarisnow")
            t = move_slider(browser, share)
            trace(browser, "pilotpolarisnow", before)
        else:
            t = browser.execute_script("return document.getElementById('timelines').layout.shapes[0].x0")
        drawn = wait(browser, SLICE)
        edge = np.array(drawn["outline"]).T
        along, current = np.diff(edge, axis=0), abs(drawn["t"] - t) < 1e-3
        offset = np.array(drawn["here" if current else "place"]) - edge[:-1]
        assert np.all(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0] > -1e-4)
        assert drawn["text"] == f"recoverable at {drawn['t']:.4g} s" and drawn["t"] < t + 1e-3
        assert (drawn["filled"], drawn["dash"]) == ((True, "solid") if current else (False, "dash"))
        assert current or drawn["place"] != drawn["here"]
        filled += current
    assert 2 <= filled < 6  # where it opens, and at the start
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


OVERFLOW = """return [document.documentElement.scrollWidth - arguments[0],
  ...[...document.querySelectorAll('.scroll')].map((one) => one.scrollWidth - one.clientWidth)];"""


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


def assert_readable(browser, dark):
    """Texts and lines stand out against the page, which is dark or light all over."""
    tones = browser.execute_script(LUMINANCES)
    (paper,) = tones["paper"]
    assert (paper < 0.05) if dark else (paper > 0.9)
    assert all(one is None or abs(one - paper) < 0.01 or one == 0 for one in tones["plots"])
    for key, least in (("ink", 4), ("words", 2.4), ("lines", 2 if dark else 1.2)):
        pairs = [sorted((one + 0.05, paper + 0.05)) for one in tones[key]]
        assert pairs and min(high / low for low, high in pairs) > least, key


NAMES = """const scene = document.getElementById('scene'), frame = scene.getBoundingClientRect();
return Object.fromEntries([...scene.querySelectorAll('.annotation-text-g')].map((one) => {
  const { left, top, right, bottom } = one.getBoundingClientRect();
  return [one.textContent, [left - frame.left, top - frame.top, right - frame.left, bottom - frame.top]];
}))"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_report_fits_a_phone_and_its_names_are_apart(browser, page, screen, scheme):
    screen(390, scheme)
    open_page(browser, page)
    assert max(browser.execute_script(OVERFLOW, 390)) <= 0
    assert_readable(browser, scheme == "dark")
    for share in (0.1, 0.6):
        move_slider(browser, share)
        time.sleep(0.5)  # until names are placed anew
        wait(browser, "return document.querySelectorAll('#scene .annotation-text-g').length > 1")
        boxes = np.array(list(browser.execute_script(NAMES).values()))
        assert np.all(boxes[:, :2] >= -1) and np.all(boxes[:, 2] <= 371)
        over = np.minimum(boxes[:, None, 2:], boxes[:, 2:]) - np.maximum(boxes[:, None, :2], boxes[:, :2])
        assert not np.any(np.triu(np.all(over > 0, axis=2), 1))
    assert_quiet(browser)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["page", "comparison", "in space", "fuel", "campaign"])
def test_nothing_is_wider_than_the_window(browser, screen, page, comparison, others, kind):
    address = {"page": page, "comparison": comparison, **others}[kind]
    for width, scheme in ((390, "light"), (700, "dark"), (1280, "light")):
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
        if kind == "page" and scheme == "dark":
            browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
            screen(width, "dark", medium="print")
            wait(browser, "return document.getElementById('timelines').layout.paper_bgcolor === '#fff'")
            assert_readable(browser, dark=False)
        text = browser.execute_script("return document.body.innerText")
        assert "{'" not in text and not re.search(r"\de-1[0-9]\b", text)


@pytest.mark.slow
def test_run_and_controller_are_chosen_and_time_plays(browser, page):
    open_page(browser, page)
    move_slider(browser, 1.0)
    nominal = trace(browser, "pilotpolarisall")
    choose = "const run = document.getElementById('run'); run.value = 'closest';"
    browser.execute_script(choose + "run.dispatchEvent(new Event('change'));")
    trace(browser, "pilotpolarisall", nominal)
    assert trace(browser, "pilotexperimentalall") is None
    browser.execute_script("document.querySelectorAll('#pilots input')[2].click()")
    trace(browser, "pilotexperimentalall", None)
    assert browser.execute_script("return document.querySelectorAll('#readout tbody tr').length") == 2
    at = "return Number(document.getElementById('time').value)"
    move_slider(browser, 0.0)
    press = "const play = document.getElementById('play'); play.click(); return play.textContent"
    assert browser.execute_script(press) == "Pause"
    wait(browser, at + " > 0.1")
    assert browser.execute_script(press) == "Play"
    stopped = browser.execute_script(at)
    time.sleep(0.3)
    assert 0.1 < stopped < 12 and browser.execute_script(at) == stopped


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
    series = """return document.getElementById('timelines').data
    .filter((one) => one.type === 'scatter').map((one) => one.name)"""
    assert {"Polaris schedule", "S alone", "U alone", "filter 0"} <= set(browser.execute_script(series))
    assert_quiet(browser)


@pytest.mark.slow
def test_scene_in_space_is_not_blank(browser, others):
    from matplotlib import image

    open_page(browser, others["in space"])
    if not browser.execute_script("return !!document.createElement('canvas').getContext('webgl')"):
        pytest.skip("this browser has no WebGL")
    move_slider(browser, 0.9)
    wait(browser, "return document.querySelector('#scene canvas') !== null")
    time.sleep(1.0)
    picture = image.imread(io.BytesIO(browser.find_element("css selector", "#scene").screenshot_as_png))
    colours = np.unique((picture[..., :3] * 15).astype(int).reshape(-1, 3), axis=0)
    assert len(colours) > 20
    assert_quiet(browser)
