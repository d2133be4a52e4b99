"""The HTML page of an evaluation: one file, every name escaped, pictures beside their numbers."""

import base64
from html.parser import HTMLParser

import pytest

from tests.measure.evaluation.test_tables import document
from yesnt.io.templates import render
from yesnt.measure.evaluation.page import write_page

NAME = "<img src=x> & b"


class Page(HTMLParser):
    """Tags with their attributes, and the text between them."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.words = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.words.append(" ".join(data.split()))


@pytest.fixture
def page(tmp_path):
    made = document(30.0, 28.0, 31.0)
    made["cells"]["full"][NAME] = {"psnr": 12.345, "flip": 0.25}
    made["definitions"] = {"psnr": 'what "PSNR" is', "flip": "what FLIP is"}
    made["worst"] = [
        {"row": "full", "cell": NAME, "picture": "worst.jpg"},
        {"row": "full", "cell": NAME, "picture": "not_rendered.jpg"},
    ]
    rmse = {plane: {"own": {"rmse": 0.125, "bias": -0.5}} for plane in ("roughness", "metallic")}
    curves = {plane: {"oracle": [0.4, 0.1], "spread": [0.4, 0.2]} for plane in ("roughness", "metallic")}
    made["material"]["shots"] = {"a": {"material": rmse, "sparsification": curves}}
    (tmp_path / "worst.jpg").write_bytes(b"worst picture")
    strip = tmp_path / "shots/a/out/pictures/materials.jpg"
    strip.parent.mkdir(parents=True)
    strip.write_bytes(b"materials")
    write_page(tmp_path / "page.html", made, tmp_path)
    return Page((tmp_path / "page.html").read_text())


def test_pictures_are_inside_the_page_and_absent_ones_are_left_out(page):
    sources = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    prefix = "data:image/jpeg;base64,"
    assert [base64.b64decode(source.removeprefix(prefix)) for source in sources] == [b"worst picture", b"materials"]
    assert not [attributes for tag, attributes in page.tags if tag in ("link", "script") or "href" in attributes]


def test_names_are_escaped_in_text_and_in_attributes(page):
    alternatives = [attributes["alt"] for tag, attributes in page.tags if tag == "img"]
    assert alternatives == [NAME, "a"]
    assert NAME in page.words
    assert {"title": 'what "PSNR" is'} in [attributes for _, attributes in page.tags]


def test_numbers_stand_beside_their_picture(page):
    start = page.words.index(NAME)
    beside = [word for word in page.words[start:] if word][1:5]
    assert beside == ["psnr", "12.35", "flip", "0.2500"]
    assert "roughness rmse" in page.words
    assert page.words.count("-0.500") == 2


def test_every_curve_is_drawn_from_the_top_left(page):
    lines = [attributes for tag, attributes in page.tags if tag == "polyline"]
    assert [line["points"] for line in lines[:2]] == ["20,20.0 35,95.0", "20,20.0 35,70.0"]
    assert len(lines) == 4


def test_margins_that_fail_are_marked(page):
    kinds = [attributes.get("class") for tag, attributes in page.tags if tag == "td"]
    assert "good" in kinds
    assert "bad" in kinds


def test_a_value_that_a_template_lacks_is_an_error():
    import jinja2

    with pytest.raises(jinja2.UndefinedError, match="headline"):
        render("evaluation.html.jinja", title="x")
