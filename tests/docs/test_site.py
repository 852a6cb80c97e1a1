"""The built site in headless Chromium, opened from disk: no page scrolls sideways, and the search finds pages.

Needs Debian's packages chromium and chromium-driver; without them the tests are skipped. Building the site takes a
minute or two.
"""

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, unquote

import pytest
import yaml
from support import webdriver

ROOT = Path(__file__).parents[2]
QUESTIONS = yaml.safe_load(Path(__file__).with_name("search_questions.yaml").read_text())
WIDTHS = (360, 390, 768, 1024, 1366, 1400, 1920)
MAX_BYTES = 1_000_000  # of a page with its pictures
pytestmark = pytest.mark.slow
needs_chromium = pytest.mark.skipif(
    not (webdriver.CHROMIUM and webdriver.DRIVER),
    reason="no chromium, or no chromedriver: apt-get install chromium-driver",
)
# Elements outside the window that no box around them scrolls or cuts
OVERFLOWING = """
    const scrolls = (box) => {
        const style = getComputedStyle(box);
        return style.overflowX !== "visible" || style.position === "fixed";
    };
    const cut = (element) => {
        for (let box = element; box && box !== document.body; box = box.parentElement)
            if (scrolls(box)) return true;
        return false;
    };
    const width = arguments[0]; // a phone's innerWidth grows with what overflows
    if (document.documentElement.scrollWidth <= width) return [];
    const wide = [...document.querySelectorAll("body *")]
        .filter((element) => element.getBoundingClientRect().right > width + 1 && !cut(element))
        .map((element) => `${element.tagName} ${element.className} ${element.textContent.trim().slice(0, 40)}`);
    return [`${document.documentElement.scrollWidth} px`, ...wide.slice(0, 4)];
"""
RESULTS = """
    return [...document.querySelectorAll("#search-results li")].map((item) =>
        [item.querySelector("a").getAttribute("href"), item.querySelector("p").textContent]);
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", ROOT / "docs", folder]
    subprocess.run(command, check=True)
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Browser]:
    with webdriver.browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


def pages_of(site: Path) -> list[Path]:
    found = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]
    assert len(found) > 80
    return found


@needs_chromium
@pytest.mark.parametrize("width", WIDTHS)
def test_no_page_scrolls_sideways(site: Path, browser: webdriver.Browser, width: int) -> None:
    browser.width(width)
    found = {}
    for page in pages_of(site):
        browser.open(page.as_uri())
        if wide := browser.run(OVERFLOWING, width):
            found[page.name] = wide
    browser.devtools("Emulation.clearDeviceMetricsOverride")
    assert found == {}


@needs_chromium
def test_the_first_column_stays_on_a_phone(site: Path, browser: webdriver.Browser) -> None:
    browser.width(360)
    browser.open((site / "products.html").as_uri())
    left = browser.run(
        """
        const box = [...document.querySelectorAll(".table-wrapper")].find((b) => b.scrollWidth > b.clientWidth);
        const cell = box.querySelector("td");
        const before = cell.getBoundingClientRect().left;
        box.scrollLeft = 100;
        return [before, cell.getBoundingClientRect().left, box.scrollLeft, box.getBoundingClientRect().left];
        """
    )
    browser.devtools("Emulation.clearDeviceMetricsOverride")
    before, after, scrolled, box = left
    assert scrolled > 0 and before >= after >= box - 1


def results_of(browser: webdriver.Browser, site: Path, question: str) -> list[list[str]]:
    """Return [(link, lines)] that the site's search shows, the first first."""
    browser.open(f"{(site / 'search.html').as_uri()}?q={quote(question)}")
    for _ in range(100):
        if browser.run("return document.querySelector('.search-summary')?.innerText"):
            break
        time.sleep(0.05)
    return browser.run(RESULTS)


@needs_chromium
def test_each_question_finds_its_page_first(site: Path, browser: webdriver.Browser) -> None:
    """Fifty questions and more, with lines of the page below each result, from a site opened from disk."""
    browser.messages()
    assert len(QUESTIONS) >= 50
    wrong, without_lines = {}, []
    for question, page in QUESTIONS.items():
        results = results_of(browser, site, question)
        first = results[0][0].split("#")[0] if results else None
        if first != f"{page}.html":
            wrong[question] = first
        without_lines += [link for link, lines in results[:5] if "api.html#" not in link and not lines]
    assert wrong == {}
    assert without_lines == []
    assert browser.messages() == []


@needs_chromium
@pytest.mark.parametrize("question", ["zzyzx", "the", "<&>", "constructor __proto__", "mag_r"])
def test_any_question_ends_with_a_summary(site: Path, browser: webdriver.Browser, question: str) -> None:
    browser.messages()
    results = results_of(browser, site, question)
    assert bool(results) == (question == "mag_r")
    assert browser.run("return document.querySelector('.search-summary').innerText")
    assert browser.messages() == []


def test_no_page_is_heavy(site: Path) -> None:
    """A page and its pictures have less than MAX_BYTES."""
    heavy = {}
    for page in pages_of(site):
        text = page.read_text()
        pictures = {page.parent / unquote(name) for name in re.findall(r'<img [^>]*src="([^":]+)"', text)}
        size = len(text.encode()) + sum(path.stat().st_size for path in pictures)
        if size > MAX_BYTES:
            heavy[page.name] = size
    assert heavy == {}


def test_each_page_has_a_description(site: Path) -> None:
    without = [
        page.name
        for page in pages_of(site)
        if page.stem not in ("genindex", "py-modindex", "search")
        and not re.search(r'<meta name="description" content="[^"]{20,}"', page.read_text())
    ]
    assert without == []
