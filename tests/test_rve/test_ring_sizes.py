"""Makers' spelling of rings: every pair of sizes is one ring, printed gauges, and what is refused in a sentence."""

import json
import re
import shlex
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from macro_fem.demand import demand_options
from rve import Cell, InputError, read_table
from rve.common import gauge_mm, radii_in, radii_of, ring_sizes
from tests.commands import run


@given(st.floats(0.2, 150.0), st.floats(0.002, 0.99))
def test_any_two_sizes_of_a_ring_are_the_ring_and_all_of_them_agree(r1, ratio):
    r2 = ratio * r1
    told = ring_sizes(r1, r2)
    assert told["inner_mm"] + 2.0 * told["wire_mm"] == pytest.approx(told["outer_mm"])
    assert told["inner_mm"] / told["wire_mm"] == pytest.approx(told["aspect_ratio"], rel=1e-9)
    sizes = {key.removesuffix("_mm"): size for key, size in told.items()}
    sizes["ar"] = sizes.pop("aspect_ratio")
    for pair in combinations(sizes, 2):
        if set(pair) != {"r2", "wire"}:
            assert radii_of({key: sizes[key] for key in pair}) == pytest.approx((r1, r2), rel=1e-9, abs=1e-11 * r1)
    assert radii_of(sizes) == pytest.approx((r1, r2))


@pytest.mark.parametrize(
    ("text", "mm"),  # as tables of ASTM B258 and BS 3737 print them
    [
        *(("0000 awg", 11.684), ("4/0 awg", 11.684), ("1/0 AWG", 8.2515), ("0 awg", 8.2515), ("10awg", 2.5882)),
        *(("16 awg", 1.2908), ("18 AWG", 1.0237), ("AWG 24", 0.5106), ("36 awg", 0.127), ("40 awg", 0.0799)),
        *(("7/0 swg", 12.7), ("2/0 swg", 8.839), ("0 swg", 8.23), ("1 swg", 7.62), ("10 swg", 3.251)),
        *(("14 SWG", 2.032), ("swg16", 1.626), ("18 swg", 1.219), ("20 swg", 0.914), ("26 swg", 0.457)),
        *(("30 swg", 0.315), ("40 swg", 0.122), ("50 swg", 0.0254)),
    ],
)
def test_gauges_are_those_of_printed_tables(text, mm):
    assert gauge_mm(text) == pytest.approx(mm, rel=1e-3)


@pytest.mark.parametrize(
    "text",
    ["16", "awg", "16 awg swg", "16 bwg", "41 awg", "5/0 awg", "8/0 swg", "51 swg", "-1 awg", ""],
)
def test_other_trade_sizes_are_refused(text):
    with pytest.raises(InputError, match=r"gauge = '.*': (is no trade size; write 16 awg|[as]wg has the sizes [47]/0)"):
        gauge_mm(text)


def test_makers_cells_are_those_of_radii():
    assert Cell.of(inner=8, wire=1.6, grain="x") == Cell(4.8, 0.8, grain="x")
    assert Cell.of(outer=11.2, ar=5, weave="4-in-1") == Cell(4.8, 0.8)
    assert Cell.of(r1=5, r2=0.5, weave="6-in-1") == Cell(weave="6-in-1")
    thin = Cell.of(inner=8, gauge="18 swg", material="copper")
    assert thin.r2 == pytest.approx(0.5 * 0.048 * 25.4)
    assert (thin.material.name, thin.r1 - thin.r2) == ("copper", pytest.approx(4.0))
    assert radii_in("inner=8,gauge=18 swg", "--cell") == (thin.r1, thin.r2)
    assert radii_in("5,0.5", "--cell") == (5.0, 0.5)


def test_a_command_takes_both_spellings_and_answers_in_both():
    load = ("support", "--S", "0.5,0,0.5", "--json")
    one = json.loads(run("rve", *load, "--inner", 8, "--wire", 1.6).output)
    assert one == json.loads(run("rve", *load, "--r1", 4.8, "--r2", 0.8).output)
    assert (one["r1_mm"], one["inner_mm"], one["outer_mm"]) == pytest.approx((4.8, 8.0, 11.2))
    assert one["h"] != json.loads(run("rve", *load).output)["h"]


@pytest.mark.slow
def test_a_sweep_takes_lists_in_makers_spelling(tmp_path):
    words = ("--inner", "8", "--gauge", "16 awg,18 awg", "--alpha", 0, "--beta", "45")
    run("rve", "sweep", "--out", tmp_path, *words, "--quiet")
    made = {(read_table(path).cell.r1_mm, read_table(path).cell.r2_mm) for path in tmp_path.glob("4-in-1*.csv")}
    wires = gauge_mm("16 awg"), gauge_mm("18 awg")
    assert made == {radii_of({"inner": 8.0, "wire": wire}) for wire in wires}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--inner 8", "--inner = 8: makes no ring yet; give two sizes"),
        ("--wire 1 --gauge '18 awg'", "--wire = 1, --gauge = 18 awg: makes no ring yet"),
        ("--inner 8 --r2 0.8 --ar 6", "--ar = 6: contradicts --r2 = 0.8, --inner = 8, which is r1 = 4.8"),
        ("--inner 8 --outer 7", "--inner = 8, --outer = 7: makes no ring; its r1 would be 3.75 mm, its r2 -0.25 mm"),
        (
            "--inner 0.008 --wire 0.001",
            "r1 = 0.0045: rings are from 0.1 to 200 mm; lengths are in mm",
        ),
        ("--r1 0.005", "--r1 = 0.005: rings are from 0.1 to 200 mm; lengths are in mm, did you mean 5?"),
        ("--ar 4 --wire 1 --weave 6-in-1", "too thick for the 6-in-1 weave, which jams at r1/r2 = 5.9432 (AR 4.943)"),
        ("--inner nan --wire 1", "--inner = nan: expected a number"),
        ("--ar 0 --wire 1", "--ar = 0.0: expected a number > 0"),
    ],
)
def test_sizes_that_make_no_ring_are_refused_in_a_sentence(words, said):
    done = run("rve", "case", "--alpha", 0, "--beta", 45, *shlex.split(words), codes=[2])
    assert said in done.output
    assert done.output.count("\n") == 1


def test_the_cell_of_a_curtain_takes_names():
    assert demand_options("inner=8, wire=1.6", no_cache=True).cell == Cell(4.8, 0.8)
    for text, said in (
        ("inner=8,wier=1.6", "--cell wier: unknown size; did you mean wire?"),
        ("inner=8,wire=x", "--cell: wire = 'x': give finite numbers"),
        ("inner=8", "--cell: inner = 8: makes no ring yet"),
        ("5", "--cell = '5': give R1,R2 in mm, or two sizes by name, inner=8,wire=1.6"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            demand_options(text)
