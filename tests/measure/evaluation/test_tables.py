"""Texts of the tables."""

from yesnt.measure.evaluation.margins import margins
from yesnt.measure.evaluation.rows import ROWS
from yesnt.measure.evaluation.summary import spread
from yesnt.measure.evaluation.table import as_markdown, number, tables


def test_spread_is_mean_and_population_deviation_of_what_is_finite():
    assert spread([1.0, 3.0, None, float("inf")]) == {"mean": 2.0, "std": 1.0, "n": 2}
    assert spread([]) == {"n": 0}


def test_numbers_have_the_digits_of_their_definition():
    assert number("psnr", {"mean": 30.188, "std": 2.4, "n": 3}) == "30.19 ± 2.40"
    assert number("ssim", 0.95804) == "0.9580"
    assert number("ssim", {"n": 0}) == number("ssim", None) == "-"


def document(full, constant, true):
    cells = {
        row: {"a / b": {"psnr": value, "ssim": 0.9, "ssim_whole": 0.97}}
        for row, value in (("full", full), ("no_decomposition", constant), ("full_true", true), ("no_relighting", 10.0))
    }
    rows = [
        {"name": r.name, "title": r.title, "group": r.group, "definition": r.definition, "partly": "",
         "values": {m: spread([v]) for m, v in cells.get(r.name, {}).get("a / b", {}).items()},
         "absent": "" if r.name in cells else "not rendered"}
        for r in ROWS.values() if r.group != "separation"
    ]  # fmt: skip
    own = {"stage": "decomposition", "definition": "d", "psnr": {"n": 0}, "rmse": 0.1, "n": 1, "largest": True}
    shot = {"name": "a", "width": 8, "height": 8, "maps": {"b": [1]}, "quality": "draft", "lacking": ""}
    nothing = {"mean": {"roughness": {"observed": {}}}, "flow": {}, "shots": {}}
    video = {"mean": {row: {} for row in ("unregularised", "full", "truth")}}
    constants = {"a": {"no_decomposition": [0.5, 0.0], "no_decomposition_each": [0.5, 0.0]}}
    made = {"rows": rows, "cells": cells, "separation": [own], "shots": [shot], "material": nothing, "video": video}
    made |= {"constants": constants, "worst": []}
    return made | {"margins": margins(made)}


def find(made, title):
    return next(m for m in made["margins"] if m["title"].startswith(title))


def test_a_margin_that_fails_says_whose_fault_it_is():
    ours = find(document(full=29.0, constant=28.5, true=31.0), "Full over No Decomposition")
    assert ours["holds"] is False
    assert "with true materials it is 2.5 and would hold: the decomposition costs 2" in ours["why"]
    sets = find(document(full=29.0, constant=28.5, true=29.5), "Full over No Decomposition")
    assert "even with true materials it is 1" in sets["why"]


def test_a_margin_that_holds_needs_no_words():
    found = find(document(full=31.0, constant=28.5, true=32.0), "Full over No Decomposition")
    assert found["holds"] is True
    assert found["why"] == ""


def test_empty_tables_are_left_out_and_the_main_one_is_first():
    made = document(30.0, 28.0, 31.0)
    titles = [table.title for table in tables(made)]
    assert titles[0].startswith("Accuracy")
    assert "Videos" not in titles
    assert "roughness 0.5, metallic 0" in as_markdown(made)
