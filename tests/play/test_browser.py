"""The live page in Chromium: type, watch, drop a picture, reload in flight, two tabs."""

import shutil
import time

import pytest
from play_person import PAGE, playing, png

from cognitivedrone.play.config import PlayPlan

sync_api = pytest.importorskip("playwright.sync_api", reason="needs `pip install playwright`")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
WAIT_MS = 60_000
ARGUMENTS = ["--no-sandbox", "--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]
"""With a camera that shows a moving pattern."""


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with playing(PlayPlan(page=PAGE, out=tmp_path_factory.mktemp("play") / "out")) as found:
        yield found


@pytest.fixture
def page(browser, address):
    made = browser.new_page(viewport={"width": 1400, "height": 900})
    problems = []
    made.on("pageerror", lambda error: problems.append(str(error)))
    made.goto(address)
    phase(made, "ready")
    yield made
    made.close()
    assert problems == []


def phase(page, name):
    page.wait_for_function("name => document.getElementById('phase').textContent === name", arg=name, timeout=WAIT_MS)


def say(page, text):
    page.fill("#text", text)
    page.press("#text", "Enter")


def painted(page, canvas):
    """Whether a canvas shows more than one colour."""
    return page.evaluate(
        """id => { const c = document.getElementById(id), all = [0, 0, c.width, c.height];
                   const data = c.getContext("2d").getImageData(...all).data;
                   return data.some((value, i) => Math.abs(value - data[i % 4]) > 20); }""",
        canvas,
    )


def test_one_types_a_sentence_and_watches_it_fly_through_the_right_gate(page):
    say(page, "fly to the dog")
    phase(page, "flying")
    output = "() => document.getElementById('directive').textContent.includes('Fly through the')"
    page.wait_for_function(output, timeout=WAIT_MS)
    page.wait_for_function("() => document.querySelector('.panel.chosen') !== null", timeout=WAIT_MS)
    assert page.locator(".panel").count() == 3
    for canvas in ("camera", "chase", "map", "sticks"):
        assert painted(page, canvas), canvas
    phase(page, "ready")
    assert page.inner_text("#outcome strong") == "Passed"
    assert page.inner_text("#history") == "fly to the dog"


def test_a_reload_in_flight_and_a_second_tab_show_the_same_flight(page, browser, address):
    say(page, "fly to the elephant")
    phase(page, "flying")
    other = browser.new_page()
    other.goto(address)
    phase(other, "flying")
    page.reload()
    phase(page, "flying")
    other.fill("#text", "land")
    other.press("#text", "Enter")
    phase(page, "ready")
    assert "land" in page.inner_text("#history").splitlines()
    assert page.inner_text("#outcome") == other.inner_text("#outcome")
    other.close()


def test_a_picture_is_dropped_on_a_panel_and_what_is_none_is_refused(page, tmp_path):
    page.click("[data-mode=mine]")
    page.wait_for_selector("#slots .slot:nth-child(3)")
    (tmp_path / "red thing.png").write_bytes(png())
    (tmp_path / "evil <img src=x onerror=alert(1)>.png").write_bytes(png((0, 0, 200)))
    (tmp_path / "a.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    for slot, name in ((1, "red thing.png"), (2, "evil <img src=x onerror=alert(1)>.png")):
        page.set_input_files(f"#slots .slot:nth-child({slot}) input[type=file]", str(tmp_path / name))
        page.wait_for_function("n => document.querySelectorAll('#slots .away').length === n", arg=slot, timeout=WAIT_MS)
    assert page.input_value("#slots .slot:nth-child(1) input[type=text]") == "red thing"
    assert page.input_value("#slots .slot:nth-child(2) input[type=text]") == "evil img src x onerror alert 1"
    page.set_input_files("#slots .slot:nth-child(3) input[type=file]", str(tmp_path / "a.svg"))
    refused = "() => document.getElementById('notice').textContent.includes('it is an SVG drawing')"
    page.wait_for_function(refused, timeout=WAIT_MS)


def test_the_camera_takes_a_picture_for_a_panel(page):
    page.click("[data-mode=mine]")
    panel = "#slots .slot:nth-child(3)"
    page.fill(f"{panel} input[type=text]", "my mug")
    page.click(f"{panel} >> text=camera")
    page.wait_for_function("() => document.querySelector('#slots video')?.videoWidth > 0", timeout=WAIT_MS)
    page.click(f"{panel} >> text=take it")
    page.wait_for_selector(f"{panel} .away", timeout=WAIT_MS)
    assert page.input_value(f"{panel} input[type=text]") == "my mug"
    assert page.query_selector("#slots video") is None
    size = "() => { const i = document.querySelector('#slots .slot:nth-child(3) img'); return i.naturalWidth }"
    page.wait_for_function(f"() => ({size})() > 0", timeout=WAIT_MS)
    page.click(f"{panel} .away")


def test_the_keyboard_takes_over_and_hands_back(page):
    page.click("[data-mode=suite]")
    page.wait_for_selector("#own:visible")
    page.click("#own")
    phase(page, "flying")
    page.click("h1")
    page.keyboard.down("s")
    page.wait_for_selector("#release:visible", timeout=WAIT_MS)
    page.keyboard.up("s")
    page.keyboard.press("Enter")
    page.wait_for_selector("#release", state="hidden", timeout=WAIT_MS)
    page.keyboard.press("l")
    phase(page, "ready")


def test_it_fits_a_phone(page):
    page.set_viewport_size({"width": 390, "height": 844})
    time.sleep(0.3)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
