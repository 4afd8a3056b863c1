"""The viewer's page in headless Chromium: what a user does in it, what it sends, and whom its server answers."""

import http.client
import io
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.view.browser import sessions
from lfmesh.view.rays.exact_ghosts import exact_ghosts
from tests.processor_time import HANGS_S

pytestmark = [pytest.mark.drawing, pytest.mark.browser]

LFMESH = [sys.executable, "-m", "lfmesh"]

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")

SCENE = """
schema_version = 1
name = "small camera"

[camera]
focus_mm = 500.0
lens = {{ file = "{lens}", stop_semi_diameter_mm = 4.77 }}

[camera.mla]
count = [14, 12]
pitch_mm = 0.125
focal_length_mm = 0.5
index = 1.5
thickness_mm = 0.3

[camera.sensor]
pixels = [150, 130]
pixel_mm = 0.0125

[[targets]]
name = "chart"
shape = {{ kind = "plane", width_mm = 20.0, height_mm = 20.0 }}
position_mm = [0.0, 0.0, -420.0]
material = {{ reflectance = 0.0, radiance_w_m2_sr = 1.0, texture = "{texture}" }}

[transport]
samples = 4
replicates = 2
split = "transmit"
threads = 1
"""

SCREEN = {"width": 1000, "height": 640}
"""Pixels of the browser's window: a small one, as each is drawn by the processor."""

ANY = 10**9
"""Number of pixels that no picture has."""

RAY_COLOUR = ((225, 256), (110, 190), (0, 110))
"""Red, green and blue of a ray at 587.6 nm in a screenshot."""


def scene_text() -> str:
    return SCENE.format(
        lens=asset_path("lenses/double_gauss_50mm.toml").as_posix(),
        texture=asset_path("charts/siemens.png").as_posix(),
    )


class Server:
    """`lfmesh view ... --browser` as a process of its own."""

    def __init__(self, *arguments: str) -> None:
        command = [*LFMESH, "view", *arguments, "--browser", "--no-open"]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=Path(lf.__file__).parents[1]
        )
        assert self.process.stdout is not None
        self.line = self.process.stdout.readline()
        found = [word for word in self.line.split() if word.startswith("http://")]
        assert found, f"no address in {self.line!r}: {self.process.communicate()[1]}"
        self.url = found[0]
        parts = urlsplit(self.url)
        self.host, self.port, self.token = parts.hostname, parts.port, parse_qs(parts.query)["token"][0]

    def stop(self) -> tuple[int, str]:
        """Press Ctrl-C; return the exit code and what was written to standard error."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        _, errors = self.process.communicate(timeout=HANGS_S)
        return self.process.returncode, errors

    def answer(self, path: str = "/index.html", **headers: str) -> http.client.HTTPResponse:
        """Ask for something as no browser would, with any headers."""
        connection = http.client.HTTPConnection(self.host, self.port, timeout=HANGS_S)
        connection.putrequest("GET", path, skip_host=True)
        for name, value in ({"Host": f"{self.host}:{self.port}", "Cookie": self.cookie} | headers).items():
            connection.putheader(name, value)
        connection.endheaders()
        return connection.getresponse()

    def websocket(self, **headers: str) -> http.client.HTTPResponse:
        """Open the websocket; the status is 101 where it is granted."""
        wish = {
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        }
        return self.answer("/ws", **wish, **headers)

    @property
    def cookie(self) -> str:
        return f"lfmesh-{self.port}={self.token}"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered run, without the files that decode and depth add."""
    folder = tmp_path_factory.mktemp("page") / "run"
    lf.save(lf.render(lf.loads(scene_text())), folder)
    return folder


@pytest.fixture(scope="module")
def server(run: Path) -> Iterator[Server]:
    served = Server(str(run), "--rays", "field 0,1.5,-420", "--count", "36", "--split", "both")
    yield served
    served.stop()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    chromium = next(filter(None, map(shutil.which, CHROMIUM)))
    with sync_playwright() as driver:
        # Chromium's sandbox does not run as root, as tests do in containers.
        running = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield running
        running.close()


class Page:
    """The page in the browser, with all that it asked for and all that went wrong in it."""

    def __init__(self, browser: Any, server: Server) -> None:
        self.requests: list[str] = []
        self.faults: list[str] = []
        self.first: dict[str, str] = {}
        self.tab = browser.new_page(viewport=SCREEN)
        self.tab.set_default_timeout(1000.0 * HANGS_S)
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.on("websocket", lambda socket: self.requests.append(socket.url))
        self.tab.on("pageerror", lambda fault: self.faults.append(str(fault)))
        self.tab.goto(server.url)
        self.tab.wait_for_selector("#paths tbody tr")
        self.wait("document.querySelector('#view3d img')?.naturalWidth > 100")
        self.settle()

    def wait(self, condition: str, argument: Any = None) -> None:
        """Wait until a condition in JavaScript holds; `old` is its argument."""
        self.tab.wait_for_function(f"old => {condition}", arg=argument)

    def text(self, selector: str) -> str:
        return str(self.tab.inner_text(selector))

    def picture(self, selector: str) -> np.ndarray:
        """What the user sees of an element, (height, width, 3)."""
        return np.asarray(PIL.Image.open(io.BytesIO(self.tab.locator(selector).screenshot())).convert("RGB"))

    def redrawn(self, act: Any) -> None:
        """Do something that has the 3D view drawn anew, and wait until it is."""
        old = self.tab.get_attribute("#view3d img", "src")
        act()
        self.wait("document.querySelector('#view3d img').src !== old", old)
        self.settle()

    def settle(self) -> None:
        """Wait until the server has answered everything and no more pictures of the 3D view arrive."""
        self.tab.evaluate(
            """() => new Promise(done => {
                const image = document.querySelector('#view3d img');
                const busy = document.querySelector('.busy');
                let last = image.src, still = 0;
                const look = () => {
                    still = image.src === last && !busy.classList.contains('on') ? still + 1 : 0;
                    last = image.src;
                    still < 8 ? setTimeout(look, 50) : done();
                };
                look();
            })"""
        )

    def where_rays_are(self) -> np.ndarray:
        """Where rays are seen in the 3D view, (n, 2) of column and row, legend and caption left out."""
        picture = self.picture("#view3d")
        low, high = np.array(RAY_COLOUR).T
        of_ray = ((low <= picture) & (picture < high)).all(axis=2)
        of_ray[:90] = of_ray[-60:] = False
        return np.argwhere(of_ray)[:, ::-1]

    def rays_seen(self, least: int, most: int) -> np.ndarray:
        """Wait until so many pixels of the 3D view show rays; return where they are."""
        until = time.monotonic() + HANGS_S
        while time.monotonic() < until:
            if least <= len(places := self.where_rays_are()) <= most:
                return places
            self.tab.wait_for_timeout(100)
        raise AssertionError(f"{len(places)} pixels show rays, not {least} to {most}")

    def click_view(self, place: np.ndarray) -> None:
        box = self.tab.locator("#view3d").bounding_box()
        self.tab.mouse.click(box["x"] + float(place[0]) + 0.5, box["y"] + float(place[1]) + 0.5)


@pytest.fixture(scope="module")
def page(browser: Any, server: Server) -> Iterator[Page]:
    opened = Page(browser, server)
    fields = ("#launch", "#point-x", "#point-y", "#point-z", "#count", "#split")
    opened.first = {name: str(opened.tab.locator(name).input_value()) for name in fields}
    opened.tab.fill("#count", "40")
    opened.tab.select_option("#split", "both")
    opened.redrawn(lambda: opened.tab.click("#preset-lens"))
    yield opened
    opened.tab.close()


@pytest.fixture
def fresh(page: Page) -> Page:
    """The shared page with all rays of a field point, unfiltered."""
    page.tab.click("#tab-rays")
    page.tab.click("#side-paths")
    page.tab.fill("#filter", "")
    page.tab.select_option("#launch", "point")
    page.tab.fill("#point-z", "-420")
    page.redrawn(lambda: page.tab.click("#go"))
    return page


def test_on_a_narrow_screen_each_panel_has_the_whole_width(fresh: Page) -> None:
    fresh.tab.set_viewport_size({"width": 390, "height": 844})
    try:
        fresh.wait("document.querySelector('#view3d').getBoundingClientRect().height > 400")
        boxes = [each.bounding_box() for each in fresh.tab.locator("section.panel").all() if each.is_visible()]
        assert len(boxes) == 4
        assert all(box["x"] >= 0.0 and box["width"] > 350.0 and box["x"] + box["width"] <= 390.0 for box in boxes)
        assert all(above["y"] + above["height"] <= below["y"] for above, below in pairwise(boxes))
    finally:
        fresh.redrawn(lambda: fresh.tab.set_viewport_size(SCREEN))


def test_a_click_on_a_ray_shows_its_history(fresh: Page) -> None:
    assert fresh.tab.locator("#history").count() == 0
    places = fresh.rays_seen(1, ANY)
    fresh.click_view(places[len(places) // 2])
    fresh.tab.wait_for_selector("#history tbody tr")
    rows = [row.split("\t") for row in fresh.tab.locator("#history tbody tr").all_inner_texts()]
    assert rows[0][:2] == ["start", "start"]
    assert rows[1][:2] == ["L1a", "transmitted"]
    reflectance, transmittance = float(rows[1][3]), float(rows[1][4])
    assert reflectance + transmittance == pytest.approx(1.0, abs=1e-4), "printed with four digits"
    assert fresh.tab.locator("#history tr.on").count() == 1, "the segment that was clicked is marked"


def test_the_form_says_from_the_start_what_is_drawn(page: Page) -> None:
    values = ("point", "0", "1.5", "-420", "36", "both")
    assert tuple(page.first.values()) == values


def test_a_history_fits_beside_the_view_on_a_small_screen(fresh: Page) -> None:
    places = fresh.rays_seen(1, ANY)
    fresh.click_view(places[len(places) // 2])
    fresh.tab.wait_for_selector("#history tbody tr")
    wide = "(e => e.scrollWidth - e.clientWidth)(document.querySelector('#history').parentElement)"
    assert fresh.tab.evaluate(wide) <= 0


def test_what_is_drawn_and_from_where_stands_below_the_picture(fresh: Page) -> None:
    words = fresh.text("#drawn")
    assert "axis marked" in words
    assert "z = -420 mm" in words


def test_a_click_on_glass_shows_its_prescription(fresh: Page) -> None:
    fresh.tab.fill("#filter", "events > 1000")
    fresh.redrawn(lambda: fresh.tab.click("#apply"))
    height, width = fresh.picture("#view3d").shape[:2]
    fresh.click_view(np.array([width // 2, height // 2]))
    fresh.wait("document.querySelector('#picked').innerText.startsWith('lens[')")
    facts = fresh.text("#history")
    assert "glass" in facts
    assert "R " in facts
    assert "mm" in facts


def test_a_path_chosen_in_the_table_is_drawn_alone(fresh: Page) -> None:
    every = len(fresh.rays_seen(1, ANY))
    count = int(fresh.tab.locator("#paths tbody tr").nth(1).locator("td").nth(2).inner_text())
    fresh.redrawn(lambda: fresh.tab.locator("#paths tbody tr").nth(1).click())
    assert fresh.text("#drawn").startswith(f"{count} path")
    alone = len(fresh.rays_seen(1, every - 1))
    fresh.redrawn(lambda: fresh.tab.locator("#paths tbody tr.on").first.click())
    fresh.rays_seen(alone + 1, ANY)  # a second click draws all again


def test_a_filter_keeps_what_it_says(fresh: Page) -> None:
    every = fresh.tab.locator("#paths tbody tr").count()
    fresh.tab.fill("#filter", "reflects(lens[0].front)")
    fresh.redrawn(lambda: fresh.tab.press("#filter", "Enter"))
    rows = fresh.tab.locator("#paths tbody tr")
    assert 0 < rows.count() < every
    assert all("L1a R" in rows.nth(i).get_attribute("title") for i in range(rows.count()))


def test_a_filter_with_a_mistake_shows_its_error(fresh: Page) -> None:
    rows = fresh.tab.locator("#paths tbody tr").count()
    fresh.tab.fill("#filter", "hits(mal) and not ghost")
    fresh.tab.click("#apply")
    fresh.tab.wait_for_selector("#filter-fault")
    fault = fresh.text("#filter-fault")
    assert "mal" in fault
    assert "mla" in fault, "what is valid"
    assert fault.splitlines()[-1].strip() == "^"
    assert fresh.tab.locator("#paths tbody tr").count() == rows, "the table stays as it was"
    fresh.tab.fill("#filter", "")
    fresh.tab.click("#apply")
    fresh.tab.wait_for_selector("#filter-fault", state="detached")


def test_a_mistake_in_a_launch_shows_its_error(fresh: Page) -> None:
    fresh.tab.fill("#point-z", "5")
    fresh.tab.click("#go")
    fresh.tab.wait_for_selector("#fault")
    assert "in front of the lens" in fresh.text("#fault")
    fresh.tab.fill("#point-z", "-420")
    fresh.redrawn(lambda: fresh.tab.click("#go"))
    assert fresh.tab.locator("#fault").count() == 0


def test_the_table_is_saved_as_csv(fresh: Page) -> None:
    with fresh.tab.expect_download() as download:
        fresh.tab.click("#csv")
    lines = Path(download.value.path()).read_text().splitlines()
    assert lines[0].startswith("path,")
    assert len(lines) == 1 + fresh.tab.locator("#paths tbody tr").count()


def test_pixels_clicked_and_areas_drawn_launch_their_rays(fresh: Page) -> None:
    fresh.tab.click("#side-sensor")
    fresh.tab.wait_for_selector("#sensor img[src^=data]")
    box = fresh.tab.locator("#sensor").bounding_box()

    def place(x: float, y: float) -> tuple[float, float]:
        return box["x"] + x * box["width"], box["y"] + y * box["height"]

    fresh.redrawn(lambda: fresh.tab.mouse.click(*place(0.25, 0.4)))
    assert "m² sr" in fresh.text("#kept")
    # The picture stands upright: an inverting lens' has the columns of the sensor reversed, and its rows as they are.
    assert abs(int(fresh.tab.input_value("#row")) - 0.4 * 130) <= 1
    assert abs(int(fresh.tab.input_value("#column")) - 0.75 * 150) <= 1
    fresh.tab.mouse.move(*place(0.2, 0.2))
    fresh.tab.mouse.down()
    fresh.tab.mouse.move(*place(0.3, 0.3), steps=3)
    fresh.redrawn(fresh.tab.mouse.up)
    marked = fresh.tab.locator("#sensor .marked").bounding_box()
    assert marked["width"] == pytest.approx(0.1 * box["width"], abs=1.5 * box["width"] / 150)
    fresh.tab.click("#side-paths")
    fresh.tab.fill("#filter", "pixel in (25:42, 104:121)")
    every = fresh.text("#kept").split()[2]
    fresh.redrawn(lambda: fresh.tab.click("#apply"))
    assert fresh.text("#kept").split()[0] == every, "all of them start in the area"


def test_a_filter_and_a_form_count_as_they_were_when_the_button_was_pressed(fresh: Page) -> None:
    """A page that waits for an answer keeps what is written in it to itself until that has come."""
    every = fresh.text("#kept").split()[0]
    fresh.redrawn(lambda: fresh.tab.evaluate("trame.trigger('filter', ['ghost'])"))
    assert fresh.tab.input_value("#filter") == "ghost"
    assert 0 < int(fresh.text("#kept").split()[0].replace(",", "")) < int(every.replace(",", ""))
    form = "{ launch: 'point', point_x: 1.25, point_y: 0.0, point_z: -420.0, unknown: 1 }"
    fresh.redrawn(lambda: fresh.tab.evaluate(f"trame.trigger('launch', [{form}])"))
    assert fresh.tab.input_value("#point-x") == "1.25"
    fresh.tab.fill("#point-x", "0")


def test_ghosts_are_those_of_the_sequences(fresh: Page, run: Path) -> None:
    fresh.tab.click("#side-ghosts")
    fresh.wait("document.querySelector('#ghosts-note')?.innerText.startsWith('Origin quadrature')")
    fresh.settle()
    rows = [row.split("\t") for row in fresh.tab.locator("#ghost-table tbody tr").all_inner_texts()]
    point = [float(fresh.tab.input_value(f"#point-{axis}")) for axis in "xyz"]
    exact = exact_ghosts(lf.build(lf.open_run(run).scene), point)
    found = {cells[0]: cells for cells in rows}
    for row in exact.ghosts[:3]:
        cells = found["\N{EN DASH}".join(row.mirrors)]
        assert cells[4].startswith("quadrature")
        assert float(cells[1]) == pytest.approx(row.power, rel=0.02), "rays through several lenslets are added"
    assert any(cells[4].startswith("quadrature") and "MLA" in cells[0] for cells in rows)
    fresh.tab.click("#ghosts")
    fresh.tab.wait_for_selector("#ghosts-full img[src^=data]")
    fresh.tab.click("#ghosts-full")
    fresh.tab.wait_for_selector("#ghosts-full", state="detached")
    fresh.tab.click("#side-paths")
    image = fresh.tab.locator("#paths tbody tr", has_text="image path").first.locator("td")
    assert image.nth(5).inner_text() == "", "no standard error"
    assert float(image.nth(3).inner_text()) == pytest.approx(exact.image.power, rel=1e-2)
    fresh.tab.fill("#filter", "ghost")
    fresh.redrawn(lambda: fresh.tab.click("#apply"))
    fresh.tab.click("#side-ghosts")
    fresh.wait("document.querySelector('#ghosts-note')?.innerText.includes('filter')")
    assert not any("quadrature" in row for row in fresh.tab.locator("#ghost-table tbody tr").all_inner_texts())


def test_refocusing_changes_the_picture(page: Page) -> None:
    page.tab.click("#tab-field")
    page.tab.wait_for_selector("#refocused[src^=data]")
    before, words = page.picture("#refocused"), page.text("#focus-note")
    page.tab.locator("#focus").fill("20")
    page.wait("document.querySelector('#focus-note').innerText !== old", words)
    assert "mm" in page.text("#focus-note")
    assert np.abs(page.picture("#refocused").astype(float) - before).mean() > 2.0


def test_the_mouse_on_the_raw_image_chooses_the_view_and_a_click_the_epi(page: Page) -> None:
    page.tab.click("#tab-field")
    page.tab.wait_for_selector("#raw img[src^=data]")
    box = page.tab.locator("#raw").bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.25 * box["height"]
    views = set()
    for i in range(12):
        page.tab.mouse.move(x + i, y)
        page.settle()
        views.add(page.text("#view-note"))
        if len(views) > 1:
            break
    assert len(views) > 1, "neighbouring pixels belong to different views"
    words, before = page.text("#epi-note"), page.tab.get_attribute("#epi", "src")
    page.tab.mouse.click(x, y)
    page.wait("document.querySelector('#epi-note').innerText !== old", words)
    assert page.tab.get_attribute("#epi", "src") != before
    lenslets = "document.querySelectorAll('#raw svg circle').length"
    page.wait(f"{lenslets} === 14 * 12")
    page.tab.mouse.wheel(0, -600)
    page.wait(f"{lenslets} < 14 * 12 && {lenslets} > 0")
    page.tab.mouse.dblclick(x, y)
    page.wait(f"{lenslets} === 14 * 12")


def test_an_epi_is_of_a_row_or_of_a_column(page: Page) -> None:
    page.tab.click("#tab-field")
    page.wait("document.querySelector('#epi')?.src.startsWith('data:')")
    of_row = page.tab.get_attribute("#epi", "src")
    assert page.text("#epi-note").startswith("row t")
    page.tab.click("#epi-column")
    page.wait("document.querySelector('#epi').src !== old", of_row)
    assert page.text("#epi-note").startswith("column s")
    page.tab.click("#epi-row")
    page.wait("document.querySelector('#epi').src === old", of_row)


def test_parallax_goes_through_the_views_until_it_is_stopped(page: Page) -> None:
    page.tab.click("#tab-field")
    page.wait("document.querySelector('#view')?.src.startsWith('data:')")
    still = page.tab.get_attribute("#view", "src")
    page.tab.click("#parallax")
    page.wait("document.querySelector('#view').src !== old", still)
    shown = {still}
    while len(shown) < 5:
        page.wait("!old.includes(document.querySelector('#view').src)", sorted(shown))
        shown.add(page.tab.get_attribute("#view", "src"))
    page.tab.click("#parallax")
    page.wait("document.querySelector('#view').src === old", still)


def test_depth_is_found_by_a_button(page: Page, run: Path) -> None:
    page.tab.click("#tab-field")
    page.tab.click("#find-depth")
    page.tab.wait_for_selector("#depth[src^=data]")
    assert (run / "depth.exr").is_file()
    assert page.tab.locator("#fault").count() == 0


def test_each_page_has_its_own_camera_rays_filter_and_history(fresh: Page, browser: Any, server: Server) -> None:
    places = fresh.rays_seen(1, ANY)
    fresh.click_view(places[len(places) // 2])
    fresh.tab.wait_for_selector("#history tbody tr")
    fresh.settle()

    def seen(page: Page) -> list[str]:
        values = [page.tab.locator(name).input_value() for name in ("#point-y", "#count", "#filter", "#colour")]
        return [*values, *map(page.text, ("#kept", "#paths", "#picked", "#drawn", "#history"))]

    words, picture = seen(fresh), fresh.tab.get_attribute("#view3d img", "src")
    other = Page(browser, server)
    try:
        assert other.tab.locator("#history").count() == 0, "it starts as the command line says"
        assert other.tab.input_value("#count") == "36"
        other.tab.fill("#point-y", "-4")
        other.redrawn(lambda: other.tab.click("#go"))
        other.tab.fill("#filter", "ghost")
        other.redrawn(lambda: other.tab.click("#apply"))
        other.redrawn(lambda: other.tab.select_option("#colour", "power"))
        other.redrawn(lambda: other.tab.click("#preset-side"))
        other.tab.click("#tab-field")
        other.tab.wait_for_selector("#refocused[src^=data]")
        other.settle()
        assert seen(fresh) == words
        assert fresh.tab.locator("#tab-rays.on").count() == 1
        assert fresh.tab.get_attribute("#view3d img", "src") == picture, "it was not drawn again"
        theirs = other.text("#kept")
        fresh.tab.fill("#filter", "not ghost")
        fresh.redrawn(lambda: fresh.tab.click("#apply"))
        other.tab.click("#tab-rays")
        assert other.text("#kept") == theirs
        assert other.tab.input_value("#filter") == "ghost"
    finally:
        other.tab.close()
    fresh.tab.fill("#filter", "")
    fresh.redrawn(lambda: fresh.tab.click("#apply"))


def test_a_tab_that_is_loaded_again_finds_its_page_as_it_was_left(browser: Any, server: Server) -> None:
    own = Page(browser, server)
    try:
        for axis, value in (("x", "0.5"), ("y", "-3")):
            own.tab.fill(f"#point-{axis}", value)
        own.redrawn(lambda: own.tab.click("#go"))
        own.tab.fill("#filter", "ghost")
        own.redrawn(lambda: own.tab.click("#apply"))
        own.redrawn(lambda: own.tab.select_option("#colour", "power"))
        own.redrawn(lambda: own.tab.click("#preset-side"))
        box = own.tab.locator("#view3d").bounding_box()
        own.tab.mouse.move(box["x"] + 200, box["y"] + 200)
        own.tab.mouse.down()
        own.tab.mouse.move(box["x"] + 300, box["y"] + 240, steps=4)
        own.redrawn(own.tab.mouse.up)
        own.tab.click("#tab-field")
        own.tab.wait_for_selector("#refocused[src^=data]")
        own.tab.locator("#focus").fill("20")
        own.settle()
        names = ("#point-x", "#point-y", "#filter", "#colour", "#count", "#focus")

        def left() -> list[Any]:
            values: list[Any] = [own.tab.locator(name).input_value() for name in names]
            return [*values, *(own.tab.text_content(name) for name in ("#kept", "#paths", "#drawn", "#focus-note"))]

        before = left()
        own.tab.click("#tab-rays")
        own.settle()
        turned = own.picture("#view3d").astype(float)
        for _ in range(2):
            own.tab.click("#tab-field")
            own.settle()
            own.tab.reload()
            own.tab.wait_for_selector("#tab-field.on")
            own.tab.wait_for_selector("#refocused[src^=data]")
            assert left() == before
            own.tab.click("#tab-rays")
            own.wait("document.querySelector('#view3d img')?.naturalWidth > 100")
            own.settle()
            assert np.abs(own.picture("#view3d") - turned).mean() < 1.0, "the camera and what it sees"
        own.tab.fill("#filter", "")
        own.redrawn(lambda: own.tab.click("#apply"))
        assert "paths" in own.text("#kept")
        assert "sessionURL" not in own.tab.url
    finally:
        own.tab.close()


def test_pages_are_limited_and_those_that_are_left_make_room(page: Page, browser: Any, server: Server) -> None:
    ours = f"http://{server.host}:{server.port}"
    held = [server.websocket(Origin=ours) for _ in range(sessions.MOST_SOCKETS + 2)]
    assert [answer.status for answer in held[-3:]] == [503, 503, 503]
    assert {answer.status for answer in held[:-3]} == {101}, "one more is the page of the other tests"
    for answer in held[sessions.MOST_PAGES + 2 :]:
        answer.close()
    late = browser.new_page()
    late.set_default_timeout(1000.0 * HANGS_S)
    try:
        late.goto(server.url)
        late.wait_for_selector("#fault")
        assert "Close one, then reload" in late.inner_text("#fault")
        for answer in held:
            answer.close()
        late.reload()
        late.wait_for_selector("#paths tbody tr")
    finally:
        late.close()
    page.tab.click("#tab-rays")
    page.redrawn(lambda: page.tab.click("#preset-side"))
    page.redrawn(lambda: page.tab.click("#preset-lens"))


def test_no_request_leaves_loopback(page: Page, server: Server) -> None:
    own = f"{server.host}:{server.port}"
    abroad = [url for url in page.requests if urlsplit(url).scheme in ("http", "https", "ws", "wss")]
    assert any(url.startswith("ws://") for url in abroad), "the websocket was recorded"
    assert {urlsplit(url).netloc for url in abroad} == {own}
    assert all(url.startswith(("data:", "blob:")) for url in set(page.requests) - set(abroad))
    assert not page.faults


def test_the_browser_itself_would_let_no_request_out(page: Page) -> None:
    refused = page.tab.evaluate("fetch('http://127.0.0.2:9/').then(() => '', fault => String(fault))")
    assert "Failed to fetch" in refused
    policy = page.tab.evaluate("fetch('index.html').then(answer => answer.headers.get('Content-Security-Policy'))")
    assert "default-src 'self'" in policy


def test_other_origins_are_refused(server: Server) -> None:
    ours = f"http://{server.host}:{server.port}"
    assert server.websocket(Origin=ours).status == 101
    for origin in ("http://evil.example", f"http://evil.example:{server.port}", "null", f"http://{server.host}:1"):
        assert server.websocket(Origin=origin).status == 403, origin
        assert server.answer(Origin=origin).status == 403, origin


def test_names_that_are_pointed_at_loopback_are_refused(server: Server) -> None:
    assert server.answer().status == 200
    for host in ("evil.example", f"evil.example:{server.port}", f"127.0.0.1.evil.example:{server.port}"):
        assert server.answer(Host=host).status == 403, host
        assert server.websocket(Host=host, Origin=f"http://{host}").status == 403, host


def test_whoever_does_not_have_the_token_is_refused(server: Server) -> None:
    ours = f"http://{server.host}:{server.port}"
    for cookie in ("", f"lfmesh-{server.port}=guess"):
        refusal = server.answer(Cookie=cookie)
        assert refusal.status == 403
        assert b"token" in refusal.read()
        assert server.websocket(Cookie=cookie, Origin=ours).status == 403
    assert server.answer("/?token=guess", Cookie="").status == 403
    admitted = server.answer(f"/?token={server.token}", Cookie="")
    assert admitted.status == 302
    assert "HttpOnly" in admitted.headers["Set-Cookie"]
    assert "SameSite=Strict" in admitted.headers["Set-Cookie"]
    assert server.token not in admitted.headers["Location"]


def test_a_websocket_that_is_asked_for_as_a_page_is_refused_in_words(server: Server) -> None:
    refusal = server.answer("/ws")
    assert refusal.status == 426
    assert b"websockets only" in refusal.read()


def test_only_this_machine_is_served(server: Server) -> None:
    assert server.host == "127.0.0.1"
    for address in other_addresses():
        with pytest.raises(OSError):
            socket.create_connection((address, server.port), timeout=2.0).close()


def other_addresses() -> list[str]:
    """Addresses of this machine but 127.0.0.1; no packet is sent to find them."""
    found = ["127.0.0.2"] if sys.platform == "linux" else []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outward:
        try:
            outward.connect(("192.0.2.1", 9))  # TEST-NET-1, which nobody has
        except OSError:
            return found
        return [*found, outward.getsockname()[0]]


def test_a_taken_port_is_one_clear_line_before_anything_is_read(server: Server) -> None:
    second = subprocess.run(
        [*LFMESH, "view", "no_such_scene.toml", "--browser", "--port", str(server.port)],
        capture_output=True, text=True, timeout=HANGS_S, cwd=Path(lf.__file__).parents[1],
    )  # fmt: skip
    assert second.returncode == 2
    assert second.stdout == ""
    (line,) = second.stderr.strip().splitlines()
    assert f"port = {server.port}:" in line


def test_two_hundred_open_sockets_keep_nobody_out(server: Server) -> None:
    with ExitStack() as held:
        for number in range(200):
            client = held.enter_context(socket.create_connection((server.host, server.port), timeout=HANGS_S))
            if number % 2:  # a slow one, in the middle of its request
                client.sendall(b"GET /index.html HT")
        assert server.answer().status == 200


def test_the_page_starts_as_the_command_line_says(browser: Any, run: Path) -> None:
    said = ("--colour", "power", "--fade", "--cut", "--filter", "not ghost")
    served = Server(str(run), "--rays", "field 0,0,-420", "--count", "12", *said)
    opened = Page(browser, served)
    try:
        assert opened.tab.locator("#colour").input_value() == "power"
        assert opened.tab.locator("#fade").is_checked()
        assert opened.tab.locator("#cut").is_checked()
        assert opened.tab.locator("#filter").input_value() == "not ghost"
        opened.tab.fill("#filter", "")
        opened.redrawn(lambda: opened.tab.click("#apply"))
        opened.tab.goto(served.url)
        opened.tab.wait_for_selector("#paths tbody tr")
        assert opened.tab.locator("#filter").input_value() == "not ghost", "whose address is opened again begins anew"
    finally:
        code, errors = served.stop()
        opened.tab.close()
    assert (code, errors) == (0, ""), "with a page that is open"


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from lfmesh.view.browser import serve

    monkeypatch.setitem(sys.modules, "trame_server", None)
    with pytest.raises(lf.LfmeshError, match=r'pip install "lfmesh\[browser\]"'):
        serve(lf.loads(scene_text()))


def test_the_written_page_draws_without_a_network(browser: Any, run: Path, tmp_path: Path) -> None:
    written = tmp_path / "page.html"
    subprocess.run(
        [*LFMESH, "view", str(run), "--html", str(written)],
        check=True, capture_output=True, timeout=HANGS_S, cwd=Path(lf.__file__).parents[1],
    )  # fmt: skip
    context = browser.new_context(offline=True, viewport={"width": 640, "height": 480})
    try:
        tab = context.new_page()
        tab.set_default_timeout(1000.0 * HANGS_S)
        asked: list[str] = []
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(written.as_uri())
        tab.wait_for_selector("canvas")
        assert any(not_blank(tab) or tab.wait_for_timeout(250) for _ in range(int(4 * HANGS_S)))
        assert all(url.startswith(("file:", "data:", "blob:")) for url in asked), asked
    finally:
        context.close()


def not_blank(tab: Any) -> bool:
    """Whether the canvas shows something: many colours, none of which fills it."""
    picture = np.asarray(PIL.Image.open(io.BytesIO(tab.locator("canvas").first.screenshot())).convert("RGB"))
    colours, counts = np.unique(picture.reshape(-1, 3) // 8, axis=0, return_counts=True)
    return len(colours) > 30 and counts.max() < 0.98 * counts.sum()
