"""Reports in a real browser: they load in silence, draw, and their controls do what they say.

Skipped where there is no Chromium.  Graphics are rendered in software; a picture counts as
changed when 0.2 % of its pixels have, which no noise does: a view is looked at only when two
pictures in a row are equal.

Loading a view in software takes seconds, so the tests of one screen share a page, each from the
state that :func:`fresh` brings it to.  Its names are all an attack.
"""

import time
from contextlib import contextmanager

import numpy as np
import pytest
from browsers import pixels
from report_pages import ATTACK, attacked_page, cloud, plain_page

from slbench.core.show.document import Page
from slbench.report.page import write_page

#: Loading and drawing in software on a busy machine, ms.
PATIENCE = 60_000
#: A browser as if it had no WebGL.
NO_WEBGL = """
  const before = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
    return kind.includes('webgl') ? null : before.call(this, kind, ...rest);
  };
"""
PHONE = {"viewport": {"width": 360, "height": 640}, "has_touch": True, "is_mobile": True}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    for name, page in (("plain", plain_page()), ("attack", attacked_page())):
        write_page(page, folder / f"{name}.html")
    return {name: f"file://{folder / name}.html" for name in ("plain", "attack")}


@contextmanager
def opened(browser, address, script=None, **options):
    """Open a page in a context of its own; it may fetch nothing and report no error."""
    context = browser.new_context(**{"viewport": {"width": 480, "height": 420}} | options)
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    problems, requests = [], []
    page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("dialog", lambda dialog: problems.append(dialog.message))
    page.on("request", lambda request: requests.append(request.url))
    if script:
        page.add_init_script(script)
    page.goto(address)
    yield page
    assert problems == []
    assert [url for url in requests if not url.startswith(("data:", "blob:"))] == [address]
    context.close()


@pytest.fixture(scope="module")
def desktop(browser, files):
    with opened(browser, files["attack"]) as page:
        drawn(page)
        yield page


def drawn(page):
    """Bring the first view into sight and wait until it is drawn."""
    page.locator("figure.cloud").first.scroll_into_view_if_needed()
    page.wait_for_selector("figure.cloud[data-ready]")


def fresh(page):
    """Bring a page to the state it was loaded in, its view in sight; return view and picture."""
    page.emulate_media(media="screen", color_scheme="light")
    page.locator("input[type=radio]").first.check()
    page.get_by_label("measured").check()
    page.get_by_label("truth").uncheck()
    page.get_by_role("button", name="Reset view").click()
    stage = page.locator(".stage")
    # The same place every time, to a fraction of a pixel.
    stage.evaluate("(s) => s.scrollIntoView({ block: 'center' })")
    page.mouse.move(1, 1)
    return stage, settled(stage)


def share_changed(before, after):
    return np.mean(np.any(np.abs(before.astype(int) - after) > 8, axis=-1))


def settled(stage):
    """Return the view's picture once two in a row are equal."""
    last = pixels(stage.screenshot())
    for _ in range(60):
        time.sleep(0.1)
        now = pixels(stage.screenshot())
        if np.array_equal(now, last):
            return now
        last = now
    raise AssertionError("the view does not come to rest")


def changed(stage, before):
    """Return the view's picture once it differs from an earlier one and rests."""
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        if share_changed(before, pixels(stage.screenshot())) > 0.002:
            return settled(stage)
        time.sleep(0.1)
    raise AssertionError("the view has not changed")


def coloured(image):
    """Return the share of pixels that are neither grey nor the background's tint."""
    return np.mean(np.ptp(image.astype(int), axis=-1) > 40)


def distance(page):
    """Return how far the eye is from the middle of the view, as the scene itself has it."""
    return page.evaluate("""() => {
      const { eye, center } = document.querySelector('.stage')._fullLayout.scene._scene.getCamera();
      return Math.hypot(eye.x - center.x, eye.y - center.y, eye.z - center.z);
    }""")


# -- a desktop ------------------------------------------------------------------------------------


def test_names_from_a_scene_are_text(desktop):
    assert desktop.title() == ATTACK
    assert desktop.locator("h1").inner_text() == ATTACK
    assert desktop.locator("h2").first.inner_text() == ATTACK
    # The line that says what lies under the pointer.
    stage, first = fresh(desktop)
    desktop.locator("input[type=radio]").nth(1).check()
    changed(stage, first)
    assert desktop.locator(".bar .what").inner_text() == f"{ATTACK} / {ATTACK}"
    box, readout = stage.bounding_box(), desktop.locator(".readout")
    for k in range(60):
        share = 0.35 + 0.005 * k
        desktop.mouse.move(box["x"] + box["width"] * share, box["y"] + box["height"] * 0.55)
        time.sleep(0.05)
        if readout.inner_text().startswith("x "):
            break
    assert ATTACK in readout.inner_text()
    assert desktop.evaluate("window.pwned") is None
    # The picture and the still; the library draws no image of its own.
    assert desktop.locator("img").count() == 2


def test_colours_and_layers(desktop):
    stage, first = fresh(desktop)
    assert coloured(first) > 0.02
    bar = desktop.locator(".bar")
    # A view opens on the shape; errors are asked for.
    assert bar.locator(".what").inner_text() == "height / mm"
    desktop.locator("input[type=radio]").nth(1).check()
    by_error = changed(stage, first)
    # Errors of both signs: as far down as up.
    assert bar.locator(".low").inner_text() == "\u2212" + bar.locator(".high").inner_text()
    desktop.get_by_label("σ").check()
    by_sigma = changed(stage, by_error)
    assert bar.locator(".what").inner_text() == "σ / µm"
    assert share_changed(by_sigma, first) > 0.002
    # Without its points the view has no colour; the truth is drawn in one, nearly black.
    desktop.get_by_label("measured").uncheck()
    nothing = changed(stage, by_sigma)
    assert coloured(nothing) < 0.001
    desktop.get_by_label("truth").check()
    truth = changed(stage, nothing)
    assert np.mean(truth.max(axis=-1) < 60) > np.mean(nothing.max(axis=-1) < 60) + 0.003
    _, back = fresh(desktop)
    assert share_changed(back, first) < 0.002


def test_the_mouse_turns_and_zooms_and_reset_goes_back(desktop):
    stage, first = fresh(desktop)
    far, box = distance(desktop), stage.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    desktop.mouse.move(x, y)
    desktop.mouse.down()
    desktop.mouse.move(x + 60, y + 10, steps=4)
    desktop.mouse.up()
    turned = changed(stage, first)
    assert distance(desktop) == pytest.approx(far, rel=1e-3)
    desktop.mouse.wheel(0, -300)
    changed(stage, turned)
    assert distance(desktop) < 0.95 * far
    _, back = fresh(desktop)
    assert distance(desktop) == pytest.approx(far, rel=1e-6)
    assert share_changed(back, first) < 0.002


def test_buttons_and_keys(desktop):
    stage, first = fresh(desktop)
    far = distance(desktop)

    def goes_to(share):
        end = time.monotonic() + 10.0
        while time.monotonic() < end and abs(distance(desktop) / far - share) > 1e-6:
            time.sleep(0.05)
        assert distance(desktop) == pytest.approx(share * far, rel=1e-6)

    for name, share in (("Zoom in", 0.8), ("Zoom out", 1.0)):
        desktop.get_by_role("button", name=name).click()
        goes_to(share)
    desktop.get_by_role("button", name="Reset view").focus()
    desktop.keyboard.press("Tab")
    assert desktop.evaluate("document.activeElement.className").startswith("stage")
    desktop.keyboard.press("ArrowLeft")
    changed(stage, first)
    goes_to(1.0)
    desktop.keyboard.press("+")
    goes_to(0.8)
    desktop.keyboard.press("0")
    goes_to(1.0)
    assert share_changed(settled(stage), first) < 0.01  # the outline of the focus


def test_dark_follows_a_change_of_the_system(desktop):
    stage, light = fresh(desktop)
    assert np.median(light) > 230
    desktop.emulate_media(color_scheme="dark")
    dark = changed(stage, light)
    assert np.median(dark) < 60
    assert coloured(dark) > 0.02


def test_paper_has_the_picture_and_all_details(desktop):
    fresh(desktop)
    desktop.emulate_media(media="print")
    assert desktop.locator(".still").is_visible()
    assert desktop.locator("pre").bounding_box()["height"] > 20
    for part in (".stage", ".controls", ".bar", ".readout", "nav"):
        assert not desktop.locator(part).is_visible()
    desktop.emulate_media(media="screen")


# -- a phone --------------------------------------------------------------------------------------


def scrolls_one_way_only(page):
    page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.evaluate("innerWidth") == 360
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    for image in page.locator("img:visible").all():
        # Wide pictures are moved sideways in a box of their own, at a size that can be read.
        box = image.locator("xpath=..") if image.evaluate("(i) => !!i.closest('.pan')") else image
        assert box.bounding_box()["width"] <= 340
    for box in page.locator(".pan").all():
        assert box.locator("img").bounding_box()["width"] > 700


def test_a_phone_scrolls_one_way_only(browser, files):
    with opened(browser, files["plain"], **PHONE) as page:
        scrolls_one_way_only(page)
        # The wide table scrolls in its own box.
        assert page.locator(".scroll").nth(1).evaluate("(b) => b.scrollWidth > b.clientWidth")
        assert page.locator("img").evaluate("(i) => [i.complete, i.naturalWidth]") == [True, 900]


@pytest.mark.slow
def test_a_view_on_a_phone(browser, files):
    with opened(browser, files["attack"], **PHONE) as page:
        drawn(page)
        scrolls_one_way_only(page)
        assert page.locator(".stage").bounding_box()["height"] < 0.7 * 640  # room to scroll past
        fingers_turn_and_zoom(page)


def fingers_turn_and_zoom(page):
    stage, first = fresh(page)
    far, box = distance(page), stage.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    fingers = page.context.new_cdp_session(page)

    def touch(kind, *places):
        points = [{"x": a, "y": b, "id": k} for k, (a, b) in enumerate(places)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", (x, y))
    for step in range(1, 6):
        touch("touchMove", (x + 12 * step, y))
    touch("touchEnd")
    turned = changed(stage, first)
    assert distance(page) == pytest.approx(far, rel=1e-3)
    assert page.evaluate("scrollX") == 0

    touch("touchStart", (x - 30, y))
    touch("touchStart", (x - 30, y), (x + 30, y))
    for step in range(1, 6):
        touch("touchMove", (x - 30 - 6 * step, y), (x + 30 + 6 * step, y))
    touch("touchEnd")
    changed(stage, turned)
    # Fingers twice as far apart: half the distance.
    assert distance(page) == pytest.approx(0.5 * far, rel=0.02)


# -- no view --------------------------------------------------------------------------------------


def test_without_webgl_it_says_so(browser, files):
    with opened(browser, files["attack"], script=NO_WEBGL) as page:
        assert "no WebGL" in page.locator(".words").inner_text()
        assert page.locator(".still").is_visible()
        assert not page.locator(".stage").is_visible()
        assert not page.locator(".controls").is_visible()


def test_without_javascript_there_is_a_picture(browser, files):
    with opened(browser, files["attack"], java_script_enabled=False) as page:
        assert "needs JavaScript" in page.locator(".words").inner_text()
        assert page.locator(".still").is_visible()
        assert not page.locator(".stage").is_visible()


@pytest.mark.slow
def test_many_views_take_turns(browser, tmp_path):
    clouds = tuple(cloud(300, f"Cloud {k}") for k in range(6))
    write_page(Page("Many", clouds, {}), tmp_path / "many.html")
    with opened(browser, f"file://{tmp_path / 'many.html'}") as page:
        for k in [*range(6), 0]:
            figure = page.locator("figure.cloud").nth(k)
            figure.scroll_into_view_if_needed()
            page.wait_for_selector(f"#part-{k + 1} figure[data-ready]")
            stage = figure.locator(".stage")
            stage.scroll_into_view_if_needed()
            assert coloured(settled(stage)) > 0.02
        # Those that are out of sight and more than four have given their contexts back.
        page.wait_for_function("document.querySelectorAll('figure[data-ready]').length <= 4")
