"""The report in headless Chromium: no console errors, images decode, the focal plane zooms, moves and resets.

Needs Debian's packages chromium and chromium-driver; without them the tests are skipped.
"""

import pytest
from report_page import Reader
from support import webdriver
from support.csst import LOOKS
from support.readout_state import small_camera
from test_thumbnail import level0

from csstsim.report.mosaic import mosaic, take_exposure
from csstsim.report.page import ReportContent, write_report
from csstsim.report.parts import Link

pytestmark = pytest.mark.skipif(
    not (webdriver.CHROMIUM and webdriver.DRIVER),
    reason="no chromium, or no chromedriver: apt-get install chromium-driver",
)
TRANSFORM = """
    const t = document.querySelector(".view").transform.baseVal.consolidate();
    return t ? [t.matrix.a, t.matrix.e, t.matrix.f] : [1, 0, 0];
"""
UNDER = """
    const view = document.querySelector(".view").getScreenCTM().inverse();
    const place = new DOMPoint(...arguments).matrixTransform(view);
    return [place.x, place.y];
"""  # the focal plane's point at a point of the screen
HOME = [1, 0, 0]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with webdriver.browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture
def page(browser, reported):
    """The browser at the report of a campaign; afterwards nothing may have been said on the console."""
    browser.devtools("Emulation.clearDeviceMetricsOverride")
    browser.open(reported[1].paths.report.resolve().as_uri())
    yield browser
    assert browser.messages() == []


def zoom_of(browser):
    return browser.run(TRANSFORM)


def centre(browser):
    """Return the middle of the focal plane on the screen, scrolled into view."""
    return browser.run(
        """
        const plane = document.querySelector(".plane");
        plane.scrollIntoView({block: "center"});
        const box = plane.getBoundingClientRect();
        return [Math.round(box.x + box.width / 2), Math.round(box.y + box.height / 2)];
        """
    )


def test_images_decode_and_nothing_is_fetched(page):
    sizes = page.run(
        """
        const embedded = [...document.querySelectorAll("svg image")].map((image) => image.href.baseVal);
        const decoded = embedded.map((source) => {
            const image = new Image();
            image.src = source;
            return image.decode().then(() => image.naturalWidth);
        });
        const shown = [...document.images].map((image) => image.naturalWidth);
        return Promise.all(decoded).then((widths) => [...widths, ...shown]);
        """
    )
    assert len(sizes) >= 4 and min(sizes) > 0  # a chip, the sky, and a brick or more
    fetched = page.run("return performance.getEntriesByType('resource').map((entry) => entry.name)")
    assert [name for name in fetched if not name.startswith("data:")] == []


def test_links_within_the_page_lead_somewhere(page):
    lost = page.run(
        """
        return [...document.querySelectorAll('a[href^="#"]')].map((a) => a.getAttribute("href").slice(1))
            .filter((id) => !document.getElementById(id));
        """
    )
    assert lost == []


def test_buttons_zoom_and_reset(page):
    page.click('[data-zoom="reset"]')
    assert zoom_of(page) == HOME
    page.click('[data-zoom="in"]')
    page.click('[data-zoom="in"]')
    scale, x, y = zoom_of(page)
    assert scale == pytest.approx(2.25)
    page.click('[data-zoom="out"]')
    assert zoom_of(page)[0] == pytest.approx(1.5)
    page.click('[data-zoom="reset"]')
    assert zoom_of(page) == HOME
    page.click('[data-zoom="exposure"]')
    scale, x, y = zoom_of(page)
    assert scale > 3 and (x, y) != (0, 0)  # one chip of 30
    for _ in range(3):
        page.click('[data-zoom="out"]')
    page.click('[data-zoom="reset"]')
    assert zoom_of(page) == HOME


def test_wheel_zooms_about_the_pointer_and_a_drag_moves(page):
    page.click('[data-zoom="reset"]')
    x, y = centre(page)
    scroll = {"type": "scroll", "x": x + 100, "y": y, "deltaX": 0, "deltaY": -400, "duration": 0}
    before, top = page.run(UNDER, x + 100, y), page.run("return scrollY")
    page.act("wheel", scroll)
    scale, *_ = zoom_of(page)
    assert scale > 1.3 and page.run("return scrollY") == top  # the page stays
    assert page.run(UNDER, x + 100, y) == pytest.approx(before, abs=0.5)
    _, tx, ty = zoom_of(page)
    page.act(
        "pointer", {"type": "pointerMove", "x": x, "y": y, "duration": 0}, {"type": "pointerDown", "button": 0},
        {"type": "pointerMove", "x": x - 40, "y": y + 30, "duration": 50}, {"type": "pointerUp", "button": 0},
        parameters={"pointerType": "mouse"},
    )  # fmt: skip
    moved, mx, my = zoom_of(page)
    assert moved == scale and mx < tx and my > ty
    page.act("wheel", scroll | {"deltaY": 4000})
    page.act("wheel", scroll | {"deltaY": 4000})
    page.act("wheel", scroll | {"deltaY": 4000})
    assert zoom_of(page) == HOME  # no further out than the focal plane


def test_keys(page):
    page.run("document.querySelector('.plane').focus()")
    seen = []
    for key in ("0", "+", "\ue014", "\ue015", "-", "0", "1", "0"):  # two of them arrows: right, down
        page.act("key", {"type": "keyDown", "value": key}, {"type": "keyUp", "value": key})
        seen.append(zoom_of(page))
    start, closer, right, down, back, home, exposure, last = seen
    assert start == home == last == HOME
    assert closer[0] == right[0] == down[0] == pytest.approx(1.5) and back == HOME
    assert right[1] < closer[1] and right[2] == closer[2] and down[2] < right[2]
    assert exposure[0] > 3


@pytest.mark.parametrize("width", [320, 390])
def test_a_phone_does_not_scroll_sideways(page, width):
    page.width(width)
    assert page.run("return [document.documentElement.scrollWidth, innerWidth]") == [width, width]
    page.click('[data-zoom="exposure"]')
    assert zoom_of(page)[0] > 3


def test_exposures_to_choose_from_a_cutout_and_folded_sections(browser, tmp_path):
    """Two exposures, one of a window so large that it is reduced; names with markup do nothing."""
    camera = small_camera(tmp_path)
    chips = list(camera.chips.values())
    some = [(chip, level0(camera, tmp_path / f"{chip.id}.fits", chip=chip.id)) for chip in chips[:2]]
    one = take_exposure("first", 20.0, some)
    two = take_exposure("<b>second", 0.0, [(chips[8], level0(camera, tmp_path / "b.fits"))], max_side=16)
    assert one.detail is None and two.detail is not None
    evil = "</script><script>console.error('run')</script><img src=x onerror=alert(1)>"
    path = tmp_path / "index.html"
    rows = [{"obsid": evil, "file": Link(evil, "b.fits")}] * 60
    content = ReportContent(exposures=rows, mosaic=mosaic(chips, [one, two], LOOKS))
    write_report(path, {"name": evil, "seed": 1}, [], content)
    Reader(path.read_text())
    browser.open(f"{path.as_uri()}#exposures")
    shown = "return [...document.querySelectorAll('.exposure')].map((g) => getComputedStyle(g).display !== 'none')"
    assert browser.run(shown) == [True, False]
    assert browser.run("return document.querySelector('[data-zoom=detail]').disabled")
    assert browser.run("return document.querySelector('#exposures details').open")  # the link opened it
    browser.run(
        """
        const select = document.querySelector("select");
        select.value = "1";
        select.dispatchEvent(new Event("change"));
        """
    )
    assert browser.run(shown) == [False, True]
    whole = zoom_of(browser)[0]
    browser.click('[data-zoom="detail"]')
    assert zoom_of(browser)[0] > 2 * whole
    assert browser.run("return document.title").startswith(evil)
    assert browser.messages() == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_follows_the_dark_mode_of_the_system(page, scheme):
    page.devtools("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    read = "const s = getComputedStyle(document.body); return [s.color, s.backgroundColor].map((c) => c.match(/\\d+/g))"
    text, paper = (sum(map(int, colour[:3])) for colour in page.run(read))
    assert (paper < 150 < 500 < text) if scheme == "dark" else (text < 150 < 700 < paper)


@pytest.mark.parametrize("width", [768, 1400])
def test_the_contents_stay_at_the_side(page, width):
    page.devtools("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
    side = "const r = document.querySelector('nav').getBoundingClientRect(); return [r.top, r.right]"
    top, right = page.run(side)
    page.run("scrollTo(0, 3000)")
    assert page.run("return scrollY") > 500 and page.run(side) == [top, right]
    assert page.run("return document.querySelector('main').getBoundingClientRect().left") >= right


def test_a_figure_is_shown_in_full_size_and_back(page):
    page.width(390)
    size = "return document.querySelector('.chart img').getBoundingClientRect().width"
    small = page.run(size)
    page.click(".chart img")
    assert page.run(size) > 2 * small and page.run("return document.documentElement.scrollWidth") == 390
    page.click(".chart img")
    assert page.run(size) == small
