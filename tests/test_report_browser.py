"""The report in a real browser: the wipe moves, the read-out is right, nothing leaves the page."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import proof_folders
import pytest

from usdskin.cli import main
from usdskin.images import read_image, read_spectral

OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
SIZES = [(1440, 900), (390, 844)]
SCHEMES = ["light", "dark"]


@pytest.fixture(scope="module")
def browser():
    """Chromium from USDSKIN_CHROMIUM or the path; without one these tests are skipped."""
    driver = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    given = os.environ.get("USDSKIN_CHROMIUM")
    program = given or next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip("no chromium on the path; set USDSKIN_CHROMIUM to one")
    with driver.sync_playwright() as started:
        running = started.chromium.launch(executable_path=program, args=OPTIONS)
        yield running
        running.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("shown")
    content = proof_folders.write_proof(folder, set_name="</script><b>hostile")
    content["layers"] = {"capture": "capture.usda"}
    content["spectra"]["items"] *= 8
    content["steps"][0]["command"] += " --option" * 60
    proof_folders.save(folder, content)
    assert main(["report", str(folder)]) == 0
    return folder


class Shown:
    """A page with everything that it said and asked for."""

    def __init__(self, browser, folder: Path, size=(1440, 900), scheme="light", waits=True) -> None:
        self.context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=scheme
        )
        self.page = self.context.new_page()
        self.said: list[str] = []
        self.asked: list[str] = []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto((folder / "report.html").as_uri())
        if waits:
            self.settle()

    def settle(self) -> None:
        """Wait until the read-out has caught up."""
        self.page.locator("#readout[data-pixel]").wait_for()

    def point(self, part: str, x: int, y: int) -> None:
        """Point at the middle of a pixel of the picture."""
        self.page.locator(part).scroll_into_view_if_needed()
        box = self.page.locator(part).bounding_box()
        at_x = box["x"] + box["width"] * (x + 0.5) / proof_folders.WIDTH
        self.page.mouse.move(at_x, box["y"] + box["height"] * (y + 0.5) / proof_folders.HEIGHT)
        self.page.locator(f"#readout[data-pixel='{x},{y}']").wait_for()

    def text(self, identifier: str) -> str:
        return self.page.locator(f"#{identifier}").text_content().replace("−", "-")

    def choose(self, group: str, value: str) -> None:
        """Choose as a mouse does, on the label, and wait for the read-out."""
        option = self.page.locator(f'input[name="{group}"][value="{value}"]')
        if option.is_checked():
            return
        identifier = option.get_attribute("id")
        self.page.evaluate("delete document.getElementById('readout').dataset.pixel")
        self.page.locator(f'label[for="{identifier}"]').click()
        self.settle()

    def where_line_is(self) -> float:
        """Return where the line stands, as a share of the picture's width."""
        stage = self.page.locator("#wipe").bounding_box()
        line = self.page.locator("#wipe .divider").bounding_box()
        return (line["x"] + line["width"] / 2 - stage["x"]) / stage["width"]


@pytest.fixture
def shown(browser, folder):
    page = Shown(browser, folder)
    yield page
    page.context.close()
    assert page.said == []
    assert [url for url in page.asked if not url.startswith("data:")] == [
        (folder / "report.html").as_uri()
    ]


def pixel_of(folder: Path, name: str, channel: str, x: int, y: int) -> float:
    image = read_image(folder / name)
    return float(image.pixels[y, x, image.channel_names.index(channel)])


def test_dragging_moves_the_line_and_what_is_seen(shown):
    stage = shown.page.locator("#wipe")
    stage.scroll_into_view_if_needed()
    box = stage.bounding_box()
    assert shown.where_line_is() == pytest.approx(0.5, abs=0.005)
    shown.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 50)
    shown.page.mouse.down()
    shown.page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 60, steps=4)
    shown.page.mouse.up()
    assert shown.where_line_is() == pytest.approx(0.8, abs=0.01)
    assert shown.page.locator("#wipe-at").input_value() == "800"
    clip = shown.page.evaluate("getComputedStyle(document.querySelector('#wipe .above')).clipPath")
    assert clip.startswith("inset(0px 0px 0px 80")
    shown.page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 60)
    assert shown.where_line_is() == pytest.approx(0.8, abs=0.01)


def test_both_pictures_of_the_wipe_lie_on_one_another_and_differ(shown):
    below = shown.page.locator("#wipe .below")
    above = shown.page.locator("#wipe .above")
    assert below.bounding_box() == above.bounding_box()
    assert below.get_attribute("src") != above.get_attribute("src")
    loaded = "[...document.images].every(image => image.complete && image.naturalWidth > 0)"
    assert shown.page.evaluate(loaded)


def test_keys_move_the_line(shown):
    shown.page.locator("#wipe-at").focus()
    before = shown.where_line_is()
    for _ in range(5):
        shown.page.keyboard.press("PageUp")
    assert shown.where_line_is() > before + 0.2
    shown.page.keyboard.press("Home")
    assert shown.where_line_is() == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize(("x", "y"), [(20, 30), (38, 43), (10, 36)])
@pytest.mark.parametrize("part", ["#wipe", "#heat"])
def test_readout_shows_the_difference_in_the_file(shown, folder, part, x, y):
    shown.point(part, x, y)
    exact = pixel_of(folder, "differences/light_map.exr", "dE2000", x, y)
    assert shown.text("where") == f"Pixel {x}, {y}"
    assert abs(float(shown.text("delta")) - exact) <= 0.00501


def test_readout_follows_the_choice_of_picture_and_integrator(shown, folder):
    shown.point("#wipe", 25, 40)
    seen = set()
    for name in ("light", "chain"):
        for integrator in ("map", "traced"):
            shown.choose("reproduction", name)
            shown.choose("integrator", integrator)
            exact = pixel_of(folder, f"differences/{name}_{integrator}.exr", "dE2000", 25, 40)
            assert abs(float(shown.text("delta")) - exact) <= 0.00501
            seen.add(shown.page.locator("#wipe .above").get_attribute("src"))
    assert len(seen) == 4


def test_readout_shows_the_colours_of_both_pictures(shown, folder):
    shown.point("#heat", 30, 30)
    for axis, channel in (("L", "dL"), ("a", "da"), ("b", "db")):
        exact = pixel_of(folder, "differences/light_map.exr", channel, 30, 30)
        true, found = float(shown.text(f"truth-{axis}")), float(shown.text(f"lab-{axis}"))
        assert abs(found - true - exact) <= 0.1001
        assert abs(float(shown.text(f"change-{axis}")) - exact) <= 0.1001
    assert shown.page.locator("#swatch-truth").get_attribute("fill").startswith("rgb(")


def test_readout_draws_the_spectra_of_the_pixel(shown, folder):
    shown.point("#heat", 30, 30)
    content = json.loads(shown.page.locator("#pixels").text_content())
    packed = content["views"]["map"]["spectra"]
    near = [
        packed[axis] + packed["stride"] * round((30 - packed[axis]) / packed["stride"])
        for axis in ("x", "y")
    ]
    assert f"Spectra at {near[0]}, {near[1]}" in shown.text("spectra-said")
    nm, cube = read_spectral(folder / "renders/truth_map.spectral.exr")
    other = read_spectral(folder / "renders/light_map.spectral.exr")[1]
    true, found = cube[near[1], near[0]], other[near[1], near[0]]
    points = shown.page.locator("#pixel-spectra polyline.truth").get_attribute("points").split()
    drawn = np.array([float(point.split(",")[1]) for point in points])
    assert len(drawn) == len(nm)
    expected = 122.0 - 104.0 * true / max(true.max(), found.max())
    np.testing.assert_allclose(drawn, expected, atol=1.0)


def test_readout_says_where_nothing_was_judged(shown):
    shown.point("#wipe", 0, 0)
    assert shown.text("where") == "Pixel 0, 0: not judged"
    assert shown.text("delta") == "–"


def test_readout_begins_at_the_largest_difference(shown, folder):
    image = read_image(folder / "differences/light_map.exr")
    delta = image.pixels[..., image.channel_names.index("dE2000")]
    assert abs(float(shown.text("delta")) - np.nanmax(delta)) <= 0.00501


def test_arrows_move_the_readout(shown):
    shown.point("#wipe", 25, 40)
    shown.page.mouse.move(2, 2)
    shown.page.locator("#wipe").focus()
    shown.page.keyboard.press("ArrowRight")
    shown.page.keyboard.press("Shift+ArrowUp")
    shown.page.locator("#readout[data-pixel='26,30']").wait_for()
    assert shown.text("where") == "Pixel 26, 30"
    shown.page.locator("#said", has_text="Pixel 26, 30, difference ").wait_for(state="attached")


def test_commands_are_copied_whole(shown, folder):
    shown.context.grant_permissions(["clipboard-read", "clipboard-write"])
    steps = json.loads((folder / "proof.json").read_text())["steps"]
    expected = "\n".join(step["command"] for step in steps)
    for index, wanted in ((0, expected), (2, steps[1]["command"])):
        shown.page.locator("button.copy").nth(index).click()
        for _ in range(50):
            if shown.page.evaluate("navigator.clipboard.readText()") == wanted:
                break
            shown.page.wait_for_timeout(100)
        assert shown.page.evaluate("navigator.clipboard.readText()") == wanted


def test_policy_stops_what_would_leave_the_page(browser, folder):
    page = Shown(browser, folder)
    asked = "fetch('data:text/plain,x').then(() => 'fetched', () => 'stopped')"
    assert page.page.evaluate(asked) == "stopped"
    page.page.evaluate(
        "{ const made = document.createElement('script'); made.textContent = 'window.ran = 1';"
        " document.body.append(made); }"
    )
    assert page.page.evaluate("window.ran") is None
    page.context.close()


def test_without_maps_the_wipe_still_moves(browser, tmp_path):
    content = proof_folders.write_proof(tmp_path)
    content["layers"] = {}
    for comparison in content["comparisons"]:
        del comparison["maps"]
    proof_folders.save(tmp_path, content)
    assert main(["report", str(tmp_path)]) == 0
    shown = Shown(browser, tmp_path, waits=False)
    shown.point("#wipe", 30, 36)
    assert shown.text("where") == "Pixel 30, 36: not judged"
    shown.page.locator("#wipe-at").focus()
    shown.page.keyboard.press("End")
    assert shown.where_line_is() == pytest.approx(1.0, abs=0.005)
    assert shown.page.locator("#heat").count() == 0
    assert shown.said == []
    shown.context.close()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("size", SIZES)
def test_page_fits_the_screen_in_its_colours(browser, folder, size, scheme):
    shown = Shown(browser, folder, size, scheme)
    page = shown.page
    for part in page.locator("details").all():
        part.evaluate("part => { part.open = true; }")
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    ink = page.evaluate("getComputedStyle(document.body).color")
    assert contrast(ground, ink) >= 7.0
    for part in (".note", "figcaption", ".compare figcaption", "nav a", ".verdict", "td .missed"):
        color, behind = page.evaluate(
            """selector => {
                let part = document.querySelector(selector);
                const color = getComputedStyle(part).color;
                const clear = "rgba(0, 0, 0, 0)";
                while (getComputedStyle(part).backgroundColor === clear) part = part.parentElement;
                return [color, getComputedStyle(part).backgroundColor];
            }""",
            part,
        )
        assert contrast(color, behind) >= 4.5, part
    assert (luminance(ground) > 0.5) == (scheme == "light")
    assert shown.said == []
    shown.context.close()


def luminance(color: str) -> float:
    values = [float(value) / 255.0 for value in color[color.index("(") + 1 : -1].split(",")[:3]]
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: str, second: str) -> float:
    """Return the contrast of WCAG 2.2, "Contrast (Minimum)"."""
    high, low = sorted((luminance(first), luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)
