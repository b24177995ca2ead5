"""The page of a report: valid, self-contained, small, and nothing in it can be taken for HTML."""

import base64
import gzip
import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from report_pages import (
    ATTACK,
    Document,
    attacked_page,
    cloud,
    luminance,
    picture,
    plain_page,
    table,
    unpacked,
)

from slbench.core.errors import InputError
from slbench.core.show.document import Cloud, Page, Picture, Table
from slbench.report.cloud import MOST_POINTS, MOST_TRUE_POINTS, Colouring, cloud_view
from slbench.report.page import check_page_path, render_page, script_json, write_page


@pytest.fixture(scope="module")
def attacked():
    return Document(render_page(attacked_page()))


@pytest.fixture(scope="module")
def plain():
    return Document(render_page(plain_page()))


# -- the document --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["plain", "attacked"])
def test_references_and_labels_are_whole(name, request):
    document = request.getfixturevalue(name)
    ids = [attributes["id"] for _, attributes in document.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in document.tags:
        if "aria-labelledby" in attributes:
            assert attributes["aria-labelledby"] in ids
        if attributes.get("href", "").startswith("#"):
            assert attributes["href"][1:] in ids
    for image in document.all("img"):
        assert image["alt"]
        assert int(image["width"]) > 0
    kinds = [tag for tag, _ in document.tags]
    assert kinds.count("h1") == kinds.count("main") == kinds.count("title") == 1
    assert {"header", "footer"} <= set(kinds)
    assert document.all("html")[0]["lang"] == "en"


@pytest.mark.parametrize("name", ["plain", "attacked"])
def test_nothing_is_fetched(name, request):
    document = request.getfixturevalue(name)
    for _, attributes in document.tags:
        for key in ("src", "href", "data", "action", "srcset", "poster"):
            assert re.match(r"(#|data:image/png;base64,|$)", attributes.get(key, ""))
    assert "url(" not in document.style
    assert "@import" not in document.style
    assert not document.all("link")
    assert not document.all("base")


def policy(document):
    metas = document.all("meta")
    text = next(m["content"] for m in metas if m.get("http-equiv") == "Content-Security-Policy")
    return {rule.split()[0]: rule.split()[1:] for rule in text.split("; ")}


def sha256(text):
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def test_the_policy_allows_the_pages_own_scripts_and_no_other(attacked):
    rules = policy(attacked)
    assert rules["default-src"] == ["'none'"]
    library, script = (
        next(text for a, text in attacked.raw if a.get("type") == kind)
        for kind in ("application/gzip", None)
    )
    source = gzip.decompress(base64.b64decode(library)).decode()
    assert "plotly.js v" in source[:200]
    assert set(rules["script-src"]) == {sha256(script), sha256(source)}
    # No attribute of the template's own is a script or a style.
    for _, attributes in attacked.tags:
        assert not [key for key in attributes if key == "style" or key.startswith("on")]


def test_without_a_cloud_there_is_no_script(plain):
    assert plain.raw == []
    assert "script-src" not in policy(plain)
    assert policy(plain)["style-src"] == [sha256(plain.style)]


def test_text_is_text(attacked):
    # Title and h1; four times in the contents and as h2; a heading, a cell and a note of the
    # table; a paragraph; two captions; a way to colour; name and value of a fact, above and
    # below; name and value of a parameter, where JSON has escaped the quotation mark.
    assert attacked.text.count(ATTACK) == 2 + 8 + 3 + 1 + 1 + 1 + 4
    assert attacked.text.count(ATTACK.replace('"', '\\"')) == 2
    assert len(attacked.all("img")) == 2  # the picture and the cloud's still
    assert len(attacked.raw) == 3  # data, library, program
    # JSON cannot end its element: what a parser reads is what was written.
    (data,) = attacked.data()
    assert "<" not in data
    assert json.loads(data)["colourings"][1]["what"] == ATTACK
    assert json.loads(data)["colourings"][1]["unit"] == ATTACK


def test_script_json_is_json():
    values = {"</script>": ["<!--", "a&b", "\u2028", "\\", '"', 1.5, None]}
    text = script_json(values)
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == values


def test_sizes(tmp_path):
    own = plain_page()
    own = replace(own, parts=tuple(p for p in own.parts if not isinstance(p, Picture)))
    # Style and frame, and a table of 24 columns.
    assert len(render_page(own)) < 30_000
    # A picture costs 4/3 of itself.
    ramp = picture()
    more = len(render_page(replace(own, parts=(*own.parts, ramp)))) - len(render_page(own))
    assert more < 1.34 * len(ramp.png) + 2000
    # The library once, however many clouds; 60,000 points with two colours, height, and truth:
    # 6 x 60,000 + 3 x 20,000 numbers of 4 bytes, 4/3 of that, and the still picture.
    one, two = (
        len(render_page(replace(own, parts=tuple(cloud(70_000) for _ in range(n))))) for n in (1, 2)
    )
    assert one < 5.3e6
    assert 2.2e6 < two - one < 2.8e6


def test_same_page_same_bytes():
    assert render_page(attacked_page()) == render_page(attacked_page())


def test_numbers_are_flush_right():
    rows = (("a", 1.5, "+2.10", None), ("b", float("nan"), "−", 3))
    document = Document(render_page(Page("T", (Table("T", ("a", "b", "c", "d"), rows),), {})))
    assert [cell.get("class") for cell in document.all("td")[:4]] == [
        None,
        "number",
        None,
        "number",
    ]
    assert "1.5" in document.text


def test_an_empty_page_and_an_empty_table():
    assert "Nothing" in Document(render_page(Page("Nothing", (), {}))).text
    empty = Page("T", (Table("Empty", ("a",), ()),), {})
    assert len(Document(render_page(empty)).all("td")) == 0


def test_what_is_beside_slbench_is_named_where_there_is_any():
    extensions = {"packages": {}, "modules": []}
    bare = render_page(Page("t", (), {"slbench": "1", "extensions": extensions}))
    assert "extensions" not in bare
    assert "modules" not in bare
    extensions = {"packages": {"slbench-outside": "0.1"}, "modules": []}
    assert "slbench-outside" in render_page(Page("t", (), {"extensions": extensions}))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast(plain, scheme):
    blocks = re.findall(r":root \{(.*?)\}", plain.style, re.DOTALL)
    colours = dict(re.findall(r"(--\w+): (#[0-9a-f]{6})", blocks[("light", "dark").index(scheme)]))
    for text in ("--ink", "--soft", "--link"):
        for ground in ("--page", "--panel"):
            high, low = sorted((luminance(colours[text]), luminance(colours[ground])), reverse=True)
            # WCAG 2.2, level AA, text of any size.
            assert (high + 0.05) / (low + 0.05) > 4.5, (text, ground)


# -- files ----------------------------------------------------------------------------------------


def test_write_page(tmp_path):
    path = tmp_path / "new" / "report.html"
    page = plain_page()
    write_page(page, path)
    assert path.read_text(encoding="utf-8") == render_page(page)
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    "name", ["report", "report.htm", "report.pdf", "folder.html", "file/a.html"]
)
def test_paths_that_are_refused(tmp_path, name):
    (tmp_path / "folder.html").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"^--report: "):
        check_page_path(tmp_path / name)
    with pytest.raises(InputError, match=r"^report: "):
        write_page(plain_page(), tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.html"]


def test_a_picture_that_is_none_is_refused(tmp_path):
    page = Page("T", (Picture("Broken", b"GIF89a"),), {})
    with pytest.raises(InputError, match="Broken"):
        write_page(page, tmp_path / "a.html")
    assert list(tmp_path.iterdir()) == []


# -- clouds ---------------------------------------------------------------------------------------


def test_the_points_are_those_of_the_cloud():
    given = cloud(500)
    view = cloud_view(given)
    shown = np.column_stack([unpacked(text) for text in view.data["points"]])
    # float32 has 24 bits: 1 nm at 10 mm.
    assert np.abs(shown - given.points).max() < 1e-6
    truth = np.column_stack([unpacked(text) for text in view.data["truth"]])
    assert np.abs(truth - given.truth).max() < 1e-6
    assert [c["what"] for c in view.data["colourings"]] == ["height", "error", "σ"]
    values = unpacked(view.data["colourings"][1]["values"])
    assert np.array_equal(np.isnan(values), np.isnan(given.values["error / µm"]))


def test_equal_scales():
    view = cloud_view(cloud(500))
    box = np.array(view.data["box"])
    ratio = np.array(view.data["aspect"]) / (box[:, 1] - box[:, 0])
    assert np.ptp(ratio) < 1e-12 * ratio.mean()


def test_large_clouds_are_thinned_the_same_way_every_time():
    given = cloud(MOST_POINTS + 30_000)
    first, second = cloud_view(given), cloud_view(given)
    assert first.data == second.data
    assert first.shown == MOST_POINTS
    assert len(unpacked(first.data["truth"][0])) == MOST_TRUE_POINTS
    assert "60,000 of 90,000 measured points" in first.note
    assert "20,000 of 90,000 true points" in first.note
    # Points and values belong together still: z is what the height says.
    assert first.data["points"][2] == first.data["colourings"][0]["values"]


def test_gross_errors_are_counted_and_do_not_rule_the_box():
    given = cloud(1000)
    points = given.points.copy()
    points[:3] *= 1000.0
    points[3] = np.nan
    view = cloud_view(replace(given, points=points))
    assert view.shown == 996
    assert "3 points lie far outside" in view.note
    assert "1 points are not finite" in view.note
    assert np.abs(view.data["box"]).max() < 12.0


def test_ranges_of_colours():
    rng = np.random.default_rng(0)
    both = Colouring.of("e", np.append(rng.normal(3.0, 10.0, 10_000), 1e6))
    assert both.diverging
    # Symmetric about zero, and the larger percentile: 3 + 2.05 x 10.
    assert both.low == -both.high
    assert both.high == pytest.approx(23.5, rel=0.05)
    one = Colouring.of("s", rng.uniform(5.0, 6.0, 10_000))
    assert (one.diverging, round(one.low, 1), round(one.high, 1)) == (False, 5.0, 6.0)
    assert not Colouring.of("z", np.array([-1.0, 1.0]), np.ones(2)).diverging
    for same in (np.zeros(5), np.full(5, 7.0), np.full(5, np.nan)):
        alike = Colouring.of("s", same)
        assert alike.low < alike.high


def test_clouds_without_points():
    for points in (np.empty((0, 3)), np.full((4, 3), np.nan)):
        view = cloud_view(Cloud("Empty", points))
        assert view.shown == 0
        document = Document(render_page(Page("T", (Cloud("Empty", points), table()), {})))
        assert document.raw == []
        assert "points" in document.text


def test_one_point_and_a_flat_plate():
    for points in (
        np.ones((1, 3)),
        np.column_stack((*np.mgrid[:9, :9].reshape(2, -1), np.zeros(81))),
    ):
        view = cloud_view(Cloud("Flat", points.astype(float)))
        sides = np.ptp(view.data["box"], axis=1)
        assert sides.min() > 0.1 * sides.max()
        assert view.shown == len(points)
