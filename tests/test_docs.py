"""Pages are checked by running them: code blocks, commands and the output they show, links, tables.

Blocks of ``python`` are executed in one namespace per page, blocks of ``console`` by a shell, in the order of
the page and in one folder; a ``text`` block right after a ``python`` block is its output. Output is compared
with white space set aside and numbers within 20 per cent; ``...`` stands for anything. A comment before a
block changes that: ``<!-- check: words -->`` (numbers may differ), ``file NAME`` (its contents), ``make``
(targets of the Makefile), ``install`` (is not run) and ``slow`` (run by the slow tests).
"""

import contextlib
import importlib
import io
import json
import math
import os
import re
import shlex
import shutil
import stat
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.testing import CliRunner

import polaris
import reach
from docs.generate import notebooks
from docs.generate.scenario_docs import INSPECTION_FILE, SCHEMA_FILE, texts
from polaris.cli.app import app
from polaris.synthesis.schedule import synthesize
from tests.kept import printed, scheduled

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
FOLLOWED = ("tour", "orbits", "tradeoff", "tutorial", "training", "reach-tutorial")
RUN = [ROOT / "README.md", *(DOCS / f"{name}.md" for name in FOLLOWED)]

BLOCK = re.compile(
    r"(?:^<!-- check: (?P<check>.+?) -->\n)?^```(?P<kind>\w*)\n(?P<body>.*?)^```$", re.M | re.S
)
NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
CLOSE = 0.2


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    page: str
    line: int
    kind: str
    check: str
    body: str


def blocks(path):
    text = path.read_text(encoding="utf-8")
    for match in BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("body")) + 1
        yield Block(path.name, line, match["kind"], match["check"] or "", match["body"])


def assert_shown(printed, real, place, numbers):
    """Every piece of the shown output between dots occurs in the real one, in order."""
    at = 0
    real = " ".join(real.split())
    for piece in filter(None, (" ".join(part.split()) for part in printed.split("..."))):
        parts = re.split(f"({NUMBER})", piece)
        pattern = "".join(f"({NUMBER})" if i % 2 else re.escape(part) for i, part in enumerate(parts))
        match = re.compile(pattern).search(real, at)
        assert match, f"{place}: no such output\n  {piece}\nin\n  {real[at:]}"
        at = match.end()
        for expected, actual in zip(map(float, parts[1::2]), map(float, match.groups()), strict=True):
            same = math.isclose(expected, actual, rel_tol=CLOSE, abs_tol=1e-9)
            assert same or not numbers, f"{place}: shows {expected:g}, is {actual:g}\n  {piece}"


class Shell:
    """Runs console blocks in one folder; a command that two pages show is run once."""

    def __init__(self, folder):
        self.folder = folder
        scripts = folder / ".bin"
        scripts.mkdir()
        # The command of the interpreter that runs the tests, installed or not.
        command = scripts / "polaris"
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m polaris "$@"\n', encoding="utf-8")
        command.chmod(command.stat().st_mode | stat.S_IXUSR)
        places = [str(scripts), str(Path(sys.executable).parent), os.environ.get("PATH", "")]
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        changed = {"PATH": os.pathsep.join(places), "PYTHONPATH": path, "COLUMNS": "100", "MPLBACKEND": "agg"}
        self.environment = {**os.environ, **changed, "PYTHONIOENCODING": "utf-8"}
        self.known = {}

    def run(self, command):
        """Output (both streams) and exit code."""
        if command not in self.known and re.fullmatch(r"polaris [^|<>;&$`*?~]+", command):
            self.known[command] = self.here(shlex.split(command)[1:])
        if command not in self.known:
            options = {"cwd": self.folder, "env": self.environment, "encoding": "utf-8", "timeout": 600}
            both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
            done = subprocess.run(command, shell=True, **options, **both, check=False)
            self.known[command] = done.stdout, done.returncode
        return self.known[command]

    def here(self, arguments):
        """Run the package's own command in this process: output and exit code."""
        with contextlib.chdir(self.folder):
            done = CliRunner().invoke(app, arguments, env={"COLUMNS": "100", "MPLBACKEND": "agg"})
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.output, done.exit_code

    def write(self, block):
        """Write the file whose contents a block shows."""
        (self.folder / block.check.removeprefix("file ")).write_text(block.body, encoding="utf-8")

    def check(self, block):
        """Run the commands of a block and compare what they print and how they end."""
        pieces = re.split(r"^\$ (.+)\n", block.body, flags=re.M)
        assert not pieces[0], f"{block.page}:{block.line}: output without a command"
        commands, outputs = pieces[1::2], pieces[2::2]
        code = 0
        for i, (command, expected) in enumerate(zip(commands, outputs, strict=True)):
            place = f"{block.page}:{block.line}: {command}"
            if command == "echo $?":
                assert expected.strip() == str(code), f"{place}: was {code}"
                continue
            real, code = self.run(command)
            assert code == 0 or "echo $?" in commands[i + 1 : i + 2], f"{place}: exit code {code}\n{real}"
            assert_shown(expected, real, place, block.check != "words")


def require_extra(path):
    """Skip a page about an optional package that is not there."""
    if path.name == "training.md":
        pytest.importorskip("gymnasium")


@pytest.fixture(scope="module")
def shell(tmp_path_factory):
    return Shell(tmp_path_factory.mktemp("docs"))


def test_the_command_runs_in_a_process_of_its_own(shell):
    assert shell.run("polaris --version | cat") == (f"polaris {polaris.__version__}\n", 0)


@pytest.fixture
def kept_schedules(monkeypatch):
    """Bundled scenarios, as they are or as the algorithms are printed, are not synthesised again."""

    def known(scenario, *arguments, **options):
        name = getattr(scenario, "name", None)
        for changes, build in (([], scheduled), (["recoverable.recourse=none"], printed)):
            bundled = name in polaris.bundled_scenarios() and not (arguments or options)
            if bundled and scenario.model == polaris.load_scenario(name, changes).model:
                return build(name)[1]
        return real(scenario, *arguments, **options)

    real = synthesize.synthesize
    monkeypatch.setattr(polaris, "synthesize", known)  # first: the door looks the name up
    monkeypatch.setattr(synthesize, "synthesize", known)
    monkeypatch.setattr("polaris.runs.build_plot_data.SLICES", 2)  # pages say nothing of slices


MARKED = [pytest.param(path, marks=[pytest.mark.slow] * (path.name == "tutorial.md")) for path in RUN]


@pytest.mark.parametrize("path", MARKED, ids=lambda path: path.name)
def test_page_does_what_it_shows(path, shell, monkeypatch, kept_schedules):
    require_extra(path)
    monkeypatch.chdir(shell.folder)
    monkeypatch.setenv("MPLBACKEND", "agg")
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    namespace, printed = {"__name__": path.stem}, None
    for block in blocks(path):
        place = f"{block.page}:{block.line}"
        if block.check == "make":
            targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
            assert set(re.findall(r"^\$ make (\S+)$", block.body, re.M)) <= set(targets), place
        elif block.check == "install":
            assert block.body == "$ python -m pip install .\n", place
        elif block.check.startswith("file "):
            shell.write(block)
        elif block.check == "slow":
            assert block.kind == "console", place
        elif block.kind == "console":
            shell.check(block)
        elif block.kind == "python":
            code = compile("\n" * (block.line - 1) + block.body, str(path), "exec")
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(code, namespace)
            printed = out.getvalue()
            continue
        elif block.kind == "text":
            assert printed is not None, f"{place}: output of what?"
            assert_shown(block.body, printed, place, block.check != "words")
        else:
            raise AssertionError(f"{place}: nothing runs this block")
        printed = None
    plt.close("all")


@pytest.mark.slow
@pytest.mark.parametrize("path", RUN, ids=lambda path: path.name)
def test_slow_commands_do_what_they_show(path, shell, kept_schedules):
    require_extra(path)
    for block in blocks(path):
        if block.check.startswith("file "):  # slow tests may be the only ones that are run
            shell.write(block)
        elif block.check == "slow":
            shell.check(block)


def scenario_rows():
    text = (DOCS / "tour.md").read_text(encoding="utf-8")
    table = text.split("## The bundled scenarios", 1)[1].split("\n\n")[1]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()[2:]]
    return {row[0].strip("`"): row[2:] for row in cells}


def test_every_bundled_scenario_is_in_the_table():
    assert sorted(scenario_rows()) == list(polaris.bundled_scenarios())


SLOW = [
    pytest.param(name, marks=pytest.mark.slow)
    for name in ("dynamic", "keep_out", "hold_point", "robot", "cubesat")
]


@pytest.mark.parametrize("name", ["static", *SLOW])
def test_table_of_scenarios_is_what_a_run_gives(name, shell, kept_schedules):
    share, switches, delta_v, proven, goal, alone, under = scenario_rows()[name]
    _, code = shell.run(f"polaris run {name}")
    assert code == 0
    summary = json.loads((shell.folder / "runs" / name / "summary.json").read_text(encoding="utf-8"))
    end = summary["guarantee"]
    until = "" if end["until_s"] is None else f"{end['until_s']:g}"
    expected = {"infinite": "for all time", "one_period": f"until {until} s", "none": "up to T"}
    assert (end["kind"], expected[end["horizon"]]) == ("proved", proven)
    assert float(share.split()[0]) == pytest.approx(100 * summary["polaris"]["experimental_share"], abs=3.0)
    assert int(switches) == pytest.approx(summary["polaris"]["switches"], abs=1)
    assert float(delta_v.split()[0]) == pytest.approx(summary["polaris"]["delta_v_m_s"], rel=0.05)
    assert end["goal"]["reached"] is True
    assert float(goal.split()[0]) == pytest.approx(end["goal"]["by_s"], rel=0.02)
    for text, source in ((alone, "experimental"), (under, "polaris")):
        metres = summary[source]["min_distance_m"]
        assert float(text.split()[0]) == pytest.approx(metres, rel=CLOSE, abs=0.06)


INTERFACES = {"polaris": "api.md", "polaris.inspection": "inspection-api.md", "reach": "reach-api.md"}


def documented(page):
    """Names of which a page shows the docstrings."""
    return re.findall(r"^::: (\S+)$", (DOCS / page).read_text(encoding="utf-8"), re.M)


@pytest.mark.parametrize("package", INTERFACES)
def test_interface_page_has_every_public_name_once(package):
    """A name taken over from `reach` is a link to the page of `reach`: two places are ambiguous."""
    door = importlib.import_module(package)
    public = set(door.__all__) - {"__version__"}
    same = {name for name in public if getattr(reach, name, None) is getattr(door, name)}
    links = same if package != "reach" else set()
    assert sorted(documented(INTERFACES[package])) == sorted(f"{package}.{name}" for name in public - links)
    text = (DOCS / INTERFACES[package]).read_text(encoding="utf-8")
    assert all(f"](reach-api.md#reach.{name})" in text for name in links)


def anchors(path):
    """Anchors of a page's headings, as GitHub and MkDocs make them, and of the names it documents."""
    yield from documented(path.name) if path.parent == DOCS else ()
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for heading in re.findall(r"^#+ (.+)$", text, re.M):
        plain = re.sub(r"[^\w\s-]", "", heading.replace("`", "")).strip().lower()
        yield re.sub(r"\s", "-", plain)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://")):
            continue
        file, _, anchor = target.partition("#")
        place = (path.parent / file) if file else path
        generated = file in (SCHEMA_FILE, INSPECTION_FILE)  # when pages are built
        assert generated or place.is_file(), f"{path.name}: {target}"
        if anchor and place.suffix == ".md":
            assert anchor in anchors(place), f"{path.name}: {target}"


def test_every_page_is_in_the_navigation():
    listed = re.findall(r"^ +- .+: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == sorted(path.name for path in DOCS.glob("*.md"))


def test_citations_and_references_fit():
    """A page cites by key, each key is explained in one place, and nothing is listed that nobody cites."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in PAGES}
    keys = re.findall(r"^### (\w+)$", texts.pop("references.md"), re.M)
    cited = re.findall(r"\[\[(\w+)\]\((?:docs/)?references\.md#(\w+)\)\]", "".join(texts.values()))
    assert {key for key, _ in cited} == set(keys)
    assert all(anchor == key.lower() for key, anchor in cited)


def test_recipes_name_files_that_exist():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    paths = set(re.findall(r"`((?:polaris|tests|docs|reach|scenarios)/[\w./-]*|[A-Z]+\.md)`", text))
    assert len(paths) > 20
    assert not [path for path in sorted(paths) if not (ROOT / path).exists()]
    within = re.findall(r"`([A-Za-z_.]+)`\s(?:of|in)\s`([\w/]+\.py)`", text)
    assert len(within) > 20
    for name, path in within:  # a method as Class.method
        source = (ROOT / path).read_text(encoding="utf-8")
        assert all(re.search(rf"\b{part}\b", source) for part in name.split(".")), (name, path)


LISTS = {
    "assurance",
    "references",
}  # sentences of the tool and names of tests; titles of other people's texts
PROSE = [*sorted({path.stem for path in DOCS.glob("*.md")} - LISTS), "../README", "../CONTRIBUTING"]


@pytest.mark.parametrize("name", PROSE)
def test_sentences_paragraphs_and_lines_are_short(name):
    """At most 40 words in a sentence, 25 on average, five sentences in a paragraph, 100 columns in a line."""
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    text = re.sub(r"^ *```.*?^ *```$|<!--.*?-->|^ *[|#][^\n]*$", "", text, flags=re.M | re.S)
    text = re.sub(r"^ *\$\$.*?\$\$[^\n]*$", "", text, flags=re.M | re.S)
    assert max(map(len, text.splitlines())) <= 100
    text = re.sub(r"`[^`]*`|\$[^$]*\$", "x", re.sub(r"\]\([^)]*\)", "]", text)).replace("*", "")
    words = []
    text = re.sub(r"^ *(?:-|\d+\.) ", "\n", text, flags=re.M)  # an item is a paragraph
    for paragraph in re.split(r"\n\s*\n", text):
        sentences = re.split(r"(?<=[.!?])[\"')\]]*\s+(?=[A-Z\[(x\"Θ])", paragraph.strip())
        assert len(sentences) <= 5, paragraph
        words += [len(sentence.split()) for sentence in sentences if sentence]
    assert max(words) <= 40 and sum(words) <= 25 * len(words)


def test_version_is_the_same_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"version: {project['version']}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def on_built_pages(test):
    """A test of the built pages: `.ci/run` runs it beside the quick tests, for building takes long."""
    return pytest.mark.slow(pytest.mark.built(test))


@pytest.fixture(scope="module")
def site():
    """The documentation, built by the command of the README."""
    done = subprocess.run(["make", "docs"], cwd=ROOT, capture_output=True, encoding="utf-8", timeout=600)
    assert done.returncode == 0, done.stderr
    return ROOT / "build" / "docs"


@on_built_pages
@pytest.mark.parametrize("page", INTERFACES.values())
def test_interface_page_shows_docstrings_as_tables(page, site):
    """Each name has a heading; sections of docstrings are tables, none a heading of the page."""
    text = (site / page.replace(".md", ".html")).read_text(encoding="utf-8")
    for name in documented(page):
        assert f' id="{name}"' in text, name
    tables = len(re.findall(r"(?s)Parameters:</span></p>\s*<table>", text))
    assert tables == text.count("Parameters:</span>") > len(documented(page)) / 3
    assert not re.findall(r"<h\d[^>]*>\s*(?:Parameters|Returns|Raises|Attributes|Notes)\b|-{5,}\s*<", text)


FORMULA = re.compile(r'<(div|span) class="arithmatex">(.*?)</\1>', re.S)
UNREAD = re.compile(r"<(pre|code|script|title|head)\b.*?</\1>", re.S)


def formulas(text, kind):
    """Formulas of a built page: ``div`` on display, ``span`` within a line."""
    return [match[2] for match in FORMULA.finditer(UNREAD.sub("", text)) if match[1] == kind]


@on_built_pages
@pytest.mark.parametrize("path", sorted(DOCS.glob("*.md")), ids=lambda path: path.name)
def test_every_formula_is_one(path, site):
    """No dollar and no command of TeX is left outside of what MathJax sets; display stays on display."""
    source = re.sub(r"```.*?```|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.S)
    text = (site / path.with_suffix(".html").name).read_text(encoding="utf-8")
    assert len(formulas(text, "div")) == len(re.findall(r"\$\$", source)) / 2
    rest = FORMULA.sub("", UNREAD.sub("", text))
    stray = [rest[max(0, at.start() - 60) : at.end() + 60] for at in re.finditer(r"\$|\\[A-Za-z]+", rest)]
    assert not stray


@on_built_pages
def test_pages_need_no_network(site):
    """Scripts and styles come with the pages, and so do the schemas; links may lead elsewhere."""
    foreign = r'<script[^>]+src="(?:https?:)?//|<link[^>]+stylesheet[^>]+href="https?://'
    for page in site.glob("*.html"):
        assert not re.findall(foreign, page.read_text(encoding="utf-8"))
    assert (site / "javascripts" / "mathjax" / "tex-svg.js").stat().st_size > 10**6
    for name in (SCHEMA_FILE, INSPECTION_FILE):
        assert json.loads((site / name).read_text(encoding="utf-8")) == json.loads(texts()[name])


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromium"), reason="needs chromium, which is not installed")
@pytest.mark.parametrize("name", ["theory", "inspection-theory", "certificate"])
def test_formulas_are_set_in_a_browser(name, site):
    page = site / f"{name}.html"
    command = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--proxy-server=127.0.0.1:1"]
    command += ["--virtual-time-budget=60000", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=300, check=True)
    text = page.read_text(encoding="utf-8")
    expected = sum(len(formulas(text, kind)) for kind in ("div", "span"))
    assert done.stdout.count("<mjx-container") == expected > 0
    assert not re.findall(r'<g [^>]*data-mml-node="merror"', done.stdout)


@pytest.mark.parametrize("name", ["compare", "own_scene", pytest.param("network", marks=pytest.mark.slow)])
def test_notebooks_print_what_they_show(name):
    path = DOCS / "notebooks" / f"{name}.ipynb"
    printed = notebooks.printed(notebooks.nbformat.read(path, as_version=4))
    real = notebooks.printed(notebooks.executed(path))
    assert len(printed) == len(real) and any(printed)
    for cell, (stored, new) in enumerate(zip(printed, real, strict=True)):
        assert_shown(stored, new, f"{name}, code cell {cell}", numbers=True)


def test_every_notebook_is_executed_by_a_test():
    assert {path.stem for path in (DOCS / "notebooks").iterdir()} == {"compare", "own_scene", "network"}


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


@on_built_pages
def test_search_shows_no_tex(site):
    """Formulas are an ellipsis in the index of the search, code stays."""
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    texts = [re.sub(r"<(code|pre)\b.*?</\1>", "", entry["text"], flags=re.S) for entry in index["docs"]]
    assert not [text for text in texts if re.search(r"\\[()\[\]A-Za-z]", text)]
    assert sum("…" in text for text in texts) > 50


WIDE_AND_LOST = """const across = document.documentElement.scrollWidth > document.documentElement.clientWidth;
const drawn = [...document.querySelectorAll("mjx-container > svg")];
return [across, drawn.filter((one) => one.getBoundingClientRect().width < 2).length, drawn.length];"""


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromedriver"), reason="needs chromedriver, which is not installed")
def test_pages_fit_a_phone(site, tmp_path):
    """No page is wider than 390 pixels; tables and formulas scroll by themselves, and none vanishes."""
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in ("--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}"):
        options.add_argument(flag)
    service = webdriver.ChromeService(shutil.which("chromedriver"))
    with webdriver.Chrome(service=service, options=options) as driver:
        phone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
        for page in sorted(site.rglob("*.html")):
            driver.get(page.as_uri())
            text = page.read_text(encoding="utf-8")
            expected = sum(len(formulas(text, kind)) for kind in ("div", "span"))
            until = time.monotonic() + 120
            while driver.execute_script(WIDE_AND_LOST)[2] < expected and time.monotonic() < until:
                time.sleep(0.1)
            assert driver.execute_script(WIDE_AND_LOST) == [False, 0, expected], page.name
