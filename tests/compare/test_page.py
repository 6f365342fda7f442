"""The comparison page in a real browser: what a person sees, points at, types and reads.

Needs Chromium (Debian: ``apt-get install chromium``) and playwright (the ``dev`` extra).
"""

import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("playwright")
pytest.importorskip("flip_evaluator")
pytest.importorskip("skimage")
pytest.importorskip("matplotlib")

import OpenImageIO
from matplotlib import colormaps
from playwright.sync_api import expect, sync_playwright

from stillray.cli import main
from stillray.compare import metrics
from stillray.compare.display import display_exposure, tone_map
from stillray.io.exr.new_file import write_channels

HEIGHT, WIDTH = 30, 44
NAMES = ["psnr", "ssim", "smape", "relmse", "flip"]
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"
)

# Two drawings: one that follows the change, and one that follows pixels unpacked meanwhile.
SETTLE = """async () => {
  const tooLate = performance.now() + 60_000;
  const turn = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 0)));
  do {
    await turn(); await turn();
    if (performance.now() > tooLate) throw new Error("the pictures are not there after a minute");
  }
  while (document.getElementById("stage").getAttribute("aria-busy") === "true");
}"""
# by way of a copy: the page's own canvas stays what it is
READ = """([x, y]) => {
  const copy = document.createElement("canvas");
  const surface = copy.getContext("2d", { willReadFrequently: true });
  surface.drawImage(view, x, y, 1, 1, 0, 0, 1, 1);
  return Array.from(surface.getImageData(0, 0, 1, 1).data.slice(0, 3));
}"""


def write(path, image):
    write_channels(
        path, {name: image[..., i] for i, name in enumerate("RGB")},
        formats=dict.fromkeys("RGB", "float"),
    )  # fmt: skip


def as_half(image):
    return image.astype(np.float16).astype(np.float32)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Pages, and the radiance of their images; every pixel has a colour of its own."""
    folder = tmp_path_factory.mktemp("pages")
    rng = np.random.default_rng(5)
    truth = as_half(rng.uniform(0.05, 1.5, (HEIGHT, WIDTH, 3)))
    images = {
        "noisy": as_half(truth * rng.exponential(1, (HEIGHT, WIDTH, 1))),
        "clean": as_half(truth * rng.uniform(0.9, 1.15, (HEIGHT, WIDTH, 1))),
        "reference": truth,
    }
    for name, image in images.items():
        write(folder / f"{name}.exr", image)
    page = folder / "page.html"
    command = ["compare", f"{folder}/noisy.exr", f"{folder}/clean.exr", "-o", str(page)]
    assert main([*command, "-r", f"{folder}/reference.exr"]) == 0
    return SimpleNamespace(folder=folder, images=images, page=page)


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM)
        yield browser
        browser.close()


class Viewer:
    """A page in the browser, and the ways to look at it."""

    def __init__(self, page):
        self.page = page

    def settle(self):
        self.page.evaluate(SETTLE)

    def press(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)
        self.settle()

    def colour(self, x, y):
        """The canvas at a point of the canvas."""
        return np.array(self.page.evaluate(READ, [int(x), int(y)]))

    def canvas(self):
        """Width and height of the canvas, its own pixels."""
        return self.page.evaluate("(({width, height}) => [width, height])(view)")

    def point(self, row, column):
        """The middle of an image pixel on the canvas, where the image is fitted into it."""
        width, height = self.canvas()
        scale = min(width / WIDTH, height / HEIGHT)
        return (
            width / 2 + (column + 0.5 - WIDTH / 2) * scale,
            height / 2 + (row + 0.5 - HEIGHT / 2) * scale,
        )

    def on_screen(self, row, column):
        """The same on the window, where the mouse is."""
        x, y = self.point(row, column)
        box = self.page.locator("#view").bounding_box()
        return box["x"] + x, box["y"] + y

    def stops(self):
        return float(self.page.get_by_label("Exposure", exact=True).input_value())

    def table(self, name):
        rows = self.page.locator(f"#{name} tbody tr")
        return [row.locator("th, td").all_inner_texts() for row in rows.all()]

    def choose(self, name):
        """Choose a layout or a map by the words on its button."""
        self.page.get_by_role("radio", name=name, exact=True).check()
        self.settle()


@pytest.fixture
def open_page(browser):
    """Opens pages; afterwards nothing may have been fetched, logged or thrown."""
    contexts, troubles = [], []

    def open_one(path, width=1280, height=800, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: troubles.append(message.text))
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on(
            "request",
            lambda request: request.url == path.as_uri() or troubles.append(request.url),
        )
        page.goto(path.as_uri())
        viewer = Viewer(page)
        viewer.settle()
        return viewer

    yield open_one
    for context in contexts:
        context.close()
    assert troubles == []


@pytest.fixture
def viewer(files, open_page):
    return open_page(files.page)


def shown(image, stops):
    """What eight bits of the screen should be."""
    return np.rint(255 * tone_map(image, 2.0**stops))


def magma(error, full_scale):
    return 255 * np.array(colormaps["magma"](min(error / full_scale, 1.0))[:3])


def test_divider_shows_the_left_image_left_of_it_and_the_right_one_right_of_it(viewer, files):
    noisy, clean = files.images["noisy"], files.images["clean"]
    divider = viewer.page.get_by_role("slider", name="Divider")
    for share in (0.5, 0.3, 0.75):
        box = viewer.page.locator("#stage").bounding_box()
        handle = divider.bounding_box()
        viewer.page.mouse.move(handle["x"] + 14, handle["y"] + 40)
        viewer.page.mouse.down()
        viewer.page.mouse.move(box["x"] + share * box["width"], handle["y"] + 90)
        viewer.page.mouse.up()
        viewer.settle()
        assert divider.get_attribute("aria-valuenow") == str(round(100 * share))
        cut = share * viewer.canvas()[0]
        sides = set()
        for row, column in [(2, 3), (15, 10), (9, 17), (29, 24), (0, 30), (20, 43)]:
            x, y = viewer.point(row, column)
            side = noisy if x < cut else clean
            sides.add(x < cut)
            expected = shown(side[row, column], viewer.stops())
            np.testing.assert_allclose(viewer.colour(x, y), expected, atol=1)
        assert sides == {True, False}


def test_divider_moves_by_keyboard(viewer):
    divider = viewer.page.get_by_role("slider", name="Divider")
    divider.focus()
    viewer.press("ArrowRight", "ArrowRight", "Shift+ArrowLeft")
    assert divider.get_attribute("aria-valuenow") == "42"
    viewer.press("End")
    assert divider.get_attribute("aria-valuenow") == "100"
    viewer.press("Home")
    assert divider.get_attribute("aria-valuenow") == "0"


def test_one_stop_doubles_radiance_before_the_tone_curve(viewer, files):
    image = files.images["noisy"]
    start = viewer.stops()
    assert start == pytest.approx(
        np.log2(display_exposure(files.images["reference"])), abs=0.051
    )  # a tenth of a stop is the slider's step
    row, column = np.argwhere(np.abs(image.mean(-1) - 0.25) < 0.1)[0]
    viewer.press("1", "Shift+Digit1")  # on both sides, wherever the divider is
    point = viewer.point(row, column)
    before = viewer.colour(*point)
    viewer.press("e", "e")
    after = viewer.colour(*point)
    assert viewer.stops() == pytest.approx(start + 1)
    np.testing.assert_allclose(after, shown(image[row, column], start + 1), atol=1)
    unclipped = after < 255
    ratio = (after[unclipped] / 255) ** 2.2 / (before[unclipped] / 255) ** 2.2
    np.testing.assert_allclose(ratio, 2, rtol=0.08)  # eight bits
    viewer.press("Shift+E", "Shift+E")
    np.testing.assert_array_equal(viewer.colour(*point), before)
    viewer.page.get_by_label("Exposure", exact=True).fill("-6")
    viewer.settle()
    np.testing.assert_allclose(viewer.colour(*point), shown(image[row, column], -6), atol=1)
    viewer.page.get_by_role("button", name="Reset the exposure").click()
    assert viewer.stops() == start


def pane_sums(viewer):
    """A checksum of each half of the canvas where a pair is shown."""
    return viewer.page.evaluate(
        """() => {
          const wide = Math.floor((view.width - 2) / 2);
          const copy = document.createElement("canvas");
          [copy.width, copy.height] = [view.width, view.height];
          const surface = copy.getContext("2d", { willReadFrequently: true });
          surface.drawImage(view, 0, 0);
          return [0, wide + 2].map((x) => {
            const pixels = surface.getImageData(x, 0, wide, view.height).data;
            return pixels.reduce((sum, value) => (Math.imul(sum, 31) + value) | 0, 7);
          });
        }"""
    )


def test_pair_shares_zoom_and_place(viewer):
    viewer.choose("Pair")
    viewer.press("2", "Shift+Digit2")  # one image twice: the panes must always be equal
    fitted = pane_sums(viewer)
    assert fitted[0] == fitted[1]
    box = viewer.page.locator("#view").bounding_box()
    x, y = box["x"] + 0.3 * box["width"], box["y"] + 0.6 * box["height"]
    viewer.page.mouse.move(x, y)
    viewer.settle()
    pixel = viewer.page.locator("#pixel-title").inner_text()
    viewer.page.mouse.wheel(0, -600)
    viewer.settle()
    # what lies under the pointer stays there
    assert viewer.page.locator("#pixel-title").inner_text() == pixel
    viewer.page.mouse.move(box["x"] + 2, box["y"] - 20)  # no marks of the pointer in the way
    viewer.settle()
    zoomed = pane_sums(viewer)
    assert zoomed[0] == zoomed[1] != fitted[0]
    viewer.page.mouse.move(box["x"] + 0.8 * box["width"], y)
    viewer.page.mouse.down()
    viewer.page.mouse.move(box["x"] + 0.8 * box["width"] - 90, y + 35, steps=3)
    viewer.page.mouse.up()
    viewer.page.mouse.move(box["x"] + 2, box["y"] - 20)
    viewer.settle()
    moved = pane_sums(viewer)
    assert moved[0] == moved[1] != zoomed[0]
    viewer.press("f")
    assert pane_sums(viewer) == fitted


def test_one_to_one_is_pixel_on_pixel(viewer, files):
    viewer.press("1", "Shift+Digit1", "z")
    width, height = viewer.canvas()
    left, top = round(width / 2 - WIDTH / 2), round(height / 2 - HEIGHT / 2)
    expected = shown(files.images["noisy"], viewer.stops())
    for row, column in [(0, 0), (29, 43), (12, 31)]:
        found = viewer.colour(left + column, top + row)
        np.testing.assert_allclose(found, expected[row, column], atol=1)
    assert viewer.page.locator("#zoom-value").inner_text() == "100 %"


def test_all_shows_every_image_with_its_name(viewer):
    viewer.choose("All")
    assert viewer.page.locator("#names span").all_inner_texts() == ["noisy", "clean", "reference"]


def test_metrics_table_is_what_the_library_measures(viewer, files):
    formats = {metric.name: metric.format for metric in metrics.METRICS}
    rows = viewer.table("metrics")
    best = viewer.page.locator("#metrics td.best").all_inner_texts()
    assert [row[0] for row in rows] == ["noisy", "clean"]
    for row in rows:
        values = metrics.evaluate([files.images[row[0]]], [files.images["reference"]], names=NAMES)
        figures = [text.split()[0] for text in row[1:]]  # "best" is there to be heard
        assert figures == [format(values[name], formats[name]) for name in NAMES]
    assert best == rows[1][1:]  # the clean image, in everything


def parse(text):
    return float(text.replace("−", "-"))


def test_pixel_values_are_those_of_the_files(viewer, files):
    row, column = 7, 12
    viewer.page.mouse.move(*viewer.on_screen(row, column))
    viewer.settle()
    title = viewer.page.locator("#pixel-title")
    assert title.inner_text() == f"Pixel {column}, {row}"
    truth = files.images["reference"][row, column]
    flips = {
        name: metrics.flip(files.images[name], files.images["reference"])[0][row, column]
        for name in ("noisy", "clean")
    }
    floor = 0.01 / display_exposure(files.images["reference"])
    for name, *texts in viewer.table("pixel"):
        value = files.images[name.strip()][row, column]
        np.testing.assert_allclose([parse(text) for text in texts[:3]], value, rtol=6e-4)
        if name.strip() == "reference":
            assert texts[3:] == ["–", "–", "–"]
            continue
        difference = np.abs(value - truth)
        assert parse(texts[3]) == pytest.approx(difference.mean(), rel=6e-4)
        assert parse(texts[4]) == pytest.approx((difference / (truth + floor)).mean(), rel=2e-3)
        assert parse(texts[5]) == pytest.approx(flips[name.strip()], abs=0.5 / 255 + 1e-4)


def test_a_picked_pixel_stays_and_moves_by_arrows(viewer):
    viewer.page.mouse.click(*viewer.on_screen(7, 12))
    viewer.page.mouse.move(*viewer.on_screen(20, 30))
    viewer.settle()
    title = viewer.page.locator("#pixel-title")
    assert title.inner_text() == "Pixel 12, 7, kept"
    viewer.page.locator("#stage").focus()
    viewer.press("ArrowLeft", "Shift+ArrowDown")
    assert title.inner_text() == "Pixel 11, 17, kept"
    viewer.press("Escape")
    assert title.inner_text() == "Pixel 30, 20"
    viewer.page.mouse.move(1, 1)
    viewer.press("Enter")
    assert title.inner_text() == f"Pixel {WIDTH // 2}, {HEIGHT // 2}, kept"


def test_error_maps_show_the_error_in_the_legend_s_colours(viewer, files):
    noisy, truth = files.images["noisy"], files.images["reference"]
    viewer.press("1", "Shift+Digit1")
    exposed = 2.0 ** viewer.stops()
    difference = noisy - truth
    floor = 0.01 / display_exposure(truth)
    maps = {
        "Absolute": np.abs(difference).mean(-1) * exposed,
        "Relative": (np.abs(difference) / (truth + floor)).mean(-1),
        "FLIP": metrics.flip(noisy, truth)[0],
    }
    points = [(2, 3), (15, 10), (29, 24), (20, 43), (8, 8)]
    for name, errors in maps.items():
        viewer.choose(name)
        for full_scale in ("0.25", "1"):
            viewer.page.get_by_label("Full scale").select_option(full_scale)
            viewer.settle()
            assert viewer.page.locator("#ramp-high").inner_text() == full_scale
            for row, column in points:
                found = viewer.colour(*viewer.point(row, column))
                expected = magma(errors[row, column], float(full_scale))
                # sixteenths of magma, and a step of FLIP's 255 is four of them here
                np.testing.assert_allclose(found, expected, atol=14 if name == "FLIP" else 6)
    viewer.choose("Signed")
    mean = difference.mean(-1)
    for row, column in (np.unravel_index(f(mean), mean.shape) for f in (np.argmax, np.argmin)):
        red, _, blue = viewer.colour(*viewer.point(row, column))
        assert (red > blue + 20) == (mean[row, column] > 0)
    viewer.press("3", "Shift+Digit3")
    assert viewer.colour(*viewer.point(9, 9)).max() < 0x20  # the reference has no error
    viewer.choose("Absolute")
    assert viewer.colour(*viewer.point(9, 9)).max() < 0x20


def test_keys_and_menus_choose_the_images(viewer, files):
    left, right = viewer.page.get_by_label("Left image"), viewer.page.get_by_label("Right image")
    viewer.press("3", "Shift+Digit1")
    assert (left.input_value(), right.input_value()) == ("2", "0")
    viewer.press("x")
    assert (left.input_value(), right.input_value()) == ("0", "2")
    left.select_option(label="clean")
    viewer.settle()
    expected = shown(files.images["clean"][4, 2], viewer.stops())
    np.testing.assert_allclose(viewer.colour(*viewer.point(4, 2)), expected, atol=1)
    left.focus()
    viewer.press("l")
    assert viewer.page.get_by_role("radio", name="Slider").is_checked()  # menus keep letters
    viewer.page.locator("#stage").focus()
    viewer.press("l", "m")
    assert viewer.page.get_by_role("radio", name="Pair").is_checked()
    assert viewer.page.get_by_role("radio", name="Absolute").is_checked()
    viewer.press("?")
    assert viewer.page.get_by_role("dialog", name="Keyboard and mouse").is_visible()
    viewer.press("Escape")
    assert not viewer.page.get_by_role("dialog").is_visible()


def test_everything_that_can_be_focused_has_a_name(viewer):
    tree = viewer.page.locator("body").aria_snapshot()
    nameless = re.findall(
        r"- (?:button|combobox|slider|radio|table|img)(?: \[.*\])?:?$", tree, re.M
    )
    assert nameless == []
    assert 'slider "Exposure"' in tree


@pytest.mark.parametrize(("width", "layout"), [(390, "Slider"), (390, "All"), (1280, "Pair")])
def test_nothing_is_wider_than_the_window(files, open_page, width, layout):
    viewer = open_page(files.page, width=width, height=844, device_scale_factor=2)
    viewer.choose(layout)
    viewer.choose("Signed")
    assert viewer.page.evaluate("document.scrollingElement.scrollWidth") <= width
    for control in viewer.page.locator("button, select, output, #zoom-value, #legend > *").all():
        if control.is_visible():
            box = control.bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width
    assert viewer.canvas()[0] == 2 * viewer.page.locator("#view").bounding_box()["width"]


@pytest.fixture(scope="module")
def bare(files):
    """A page without a reference, with alpha, and with a layer that one image has."""
    page = files.folder / "bare.html"
    for name in ("noisy", "clean"):
        image = files.images[name]
        planes = {c: image[..., i] for i, c in enumerate("RGB")}
        planes["A"] = np.linspace(0, 1, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
        if name == "clean":
            planes |= {f"diffuse.{c}": image[..., i] / 2 for i, c in enumerate("RGB")}
        write_channels(
            files.folder / f"{name}_a.exr", planes, formats=dict.fromkeys(planes, "float")
        )
    arguments = [f"{files.folder}/{name}_a.exr" for name in ("noisy", "clean")]
    assert main(["compare", *arguments, "--layer", "diffuse", "-o", str(page)]) == 0
    return page


def test_without_a_reference_images_differ_from_each_other(files, bare, open_page):
    viewer = open_page(bare)
    assert not viewer.page.get_by_role("radio", name="FLIP").is_visible()
    assert not viewer.page.locator("#metrics").is_visible()
    noisy, clean = files.images["noisy"], files.images["clean"]
    viewer.press("1", "Shift+Digit1")
    viewer.choose("Absolute")
    exposed = 2.0 ** viewer.stops()
    expected = magma(exposed * np.abs(noisy - clean).mean(-1)[4, 2], 0.25)
    np.testing.assert_allclose(viewer.colour(*viewer.point(4, 2)), expected, atol=6)
    viewer.page.get_by_label("Against").select_option(label="noisy_a")
    viewer.settle()
    assert viewer.colour(*viewer.point(4, 2)).max() < 0x20


def test_view_transforms_are_those_of_the_standards(files, bare, open_page):
    viewer = open_page(bare)
    viewer.press("1", "Shift+Digit1")
    view = viewer.page.get_by_label("View")
    light = files.images["noisy"] * 2.0 ** viewer.stops()
    view.select_option("srgb")
    viewer.settle()
    for row, column in ((4, 2), (20, 30)):
        x = np.clip(light[row, column], 0, 1)
        expected = 255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
        np.testing.assert_allclose(viewer.colour(*viewer.point(row, column)), expected, atol=1)
    view.select_option("aces")
    viewer.settle()
    shown = OpenImageIO.ImageBufAlgo.ociodisplay(
        OpenImageIO.ImageBuf(light.astype(np.float32)), "sRGB - Display",
        view.locator("option").last.inner_text(), "Linear Rec.709 (sRGB)",
        unpremult=False, colorconfig="ocio://default",
    ).get_pixels(OpenImageIO.FLOAT)  # fmt: skip
    for row, column in ((4, 2), (20, 30), (11, 7)):
        found = viewer.colour(*viewer.point(row, column))
        np.testing.assert_allclose(found, 255 * shown[row, column], atol=3)


def test_single_channels_and_alpha_are_shown_as_grey(files, bare, open_page):
    viewer = open_page(bare)
    viewer.press("1", "Shift+Digit1")
    channel = viewer.page.get_by_label("Channel")
    light = files.images["noisy"][20, 30]
    for name, value in (
        ("green", light[1]), ("luminance", light @ [0.2126, 0.7152, 0.0722]),
    ):  # fmt: skip
        channel.select_option(name)
        viewer.settle()
        expected = shown(np.full(3, value), viewer.stops())
        np.testing.assert_allclose(viewer.colour(*viewer.point(20, 30)), expected, atol=1)
    channel.select_option("alpha")
    viewer.settle()
    alpha = 255 * (20 * WIDTH + 30) / (HEIGHT * WIDTH - 1)
    np.testing.assert_allclose(viewer.colour(*viewer.point(20, 30)), [alpha] * 3, atol=1)


def test_a_layer_is_shown_and_its_absence_said(files, bare, open_page):
    viewer = open_page(bare)
    viewer.page.get_by_label("Layer").select_option("diffuse")
    viewer.settle()
    assert viewer.page.locator("#message").inner_text() == "noisy_a: no layer diffuse."
    viewer.press("2", "Shift+Digit2")
    expected = shown(files.images["clean"][4, 2] / 2, viewer.stops())
    np.testing.assert_allclose(viewer.colour(*viewer.point(4, 2)), expected, atol=1)


def test_pixels_that_are_not_finite_stand_out(files, open_page):
    broken = files.images["noisy"].copy()
    broken[4, 2, 1] = np.nan
    broken[5, 2] = np.inf
    write(files.folder / "broken.exr", broken)
    page = files.folder / "broken.html"
    arguments = [f"{files.folder}/broken.exr", "-r", f"{files.folder}/reference.exr"]
    assert main(["compare", *arguments, "-o", str(page)]) == 0
    viewer = open_page(page)
    assert viewer.colour(*viewer.point(4, 2)).tolist() == [255, 0, 255]
    assert viewer.colour(*viewer.point(5, 2)).tolist() == [255, 0, 255]
    assert "broken: 2 pixels are NaN or infinite" in viewer.page.locator("#notes").inner_text()
    viewer.page.mouse.move(*viewer.on_screen(4, 2))
    viewer.settle()
    assert viewer.table("pixel")[0][2] == "NaN"
    viewer.choose("Absolute")
    assert viewer.colour(*viewer.point(4, 2)).tolist() == [0, 255, 0]
    viewer.choose("FLIP")
    assert "No FLIP of broken" in viewer.page.locator("#message").inner_text()


def test_sequence_shows_its_frames_and_their_figures(files, open_page):
    folder, names = files.folder, ("noisy", "clean", "reference")
    for number in (1, 2, 3):
        for name in names:
            if (number, name) != (1, "reference"):
                write(folder / f"{name}.{number}.exr", files.images[name] * np.float32(number))
    page = folder / "shot.html"
    patterns = [f"{folder}/{name}.#.exr" for name in names]
    assert main(["compare", *patterns[:2], "-r", patterns[2], "-o", str(page)]) == 0
    viewer = open_page(page)
    slider = viewer.page.get_by_role("slider", name="Frame")
    point = viewer.point(4, 2)
    for index, number in enumerate((1, 2, 3)):
        slider.fill(str(index))
        viewer.settle()
        expected = shown(files.images["noisy"][4, 2] * number, viewer.stops())
        np.testing.assert_allclose(viewer.colour(*point), expected, atol=1)
        beside = shown(files.images["clean"][20, 40] * number, viewer.stops())
        np.testing.assert_allclose(viewer.colour(*viewer.point(20, 40)), beside, atol=1)
        assert slider.get_attribute("aria-valuetext") == f"frame {number} ({index + 1} of 3)"
    assert viewer.page.get_by_role("radio", name="Mean of 2 frames").is_checked()
    psnr = [
        metrics.evaluate([files.images["noisy"] * np.float32(n)],
                         [files.images["reference"] * np.float32(n)], names=["psnr"])["psnr"]
        for n in (2, 3)
    ]  # fmt: skip
    assert viewer.table("metrics")[0][1] == f"{np.mean(psnr):.2f}"
    viewer.choose("This frame")
    assert viewer.table("metrics")[0][1] == f"{psnr[1]:.2f}"
    viewer.page.locator("#stage").focus()
    viewer.press(".")  # around to the first, which has no reference
    assert {text for row in viewer.table("metrics") for text in row[1:]} == {"–"}
    viewer.choose("Absolute")
    assert viewer.page.locator("#message").inner_text() == "This frame has no reference."
    viewer.press("l", "l")  # all images, of which one is not there
    viewer.choose("Image")
    assert viewer.page.locator("#message").inner_text() == "This frame has no reference."
    viewer.page.get_by_role("button", name="Play").click()
    expect(slider).to_have_value("2", timeout=60_000)
    viewer.page.get_by_role("button", name="Stop").click()
