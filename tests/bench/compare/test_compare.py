"""Comparisons of explainers on the same episodes: computed by hand, refused without pairs, drawn."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image
from scipy import stats

from tests.conftest import RunCli
from tests.helpers.made_entries import made_entry
from xmarl_bench.compare.comparison import BETTER, compare
from xmarl_bench.compare.matching import blocks_of, read_named, shared_states
from xmarl_bench.compare.picture import figure_of
from xmarl_bench.entry.file import write_entry
from xmarl_bench.entry.schema import Entry, make_entry
from xmarl_bench.errors import InputError
from xmarl_bench.metrics.statistics import holm

Values = Sequence[float | None]


@pytest.fixture(scope="module")
def entry() -> Entry:
    made = made_entry("small", "random", 0.5, episodes=4)
    (cell,) = made.results
    unplayed = cell.model_copy(update={"not_measured": {"success_on_explanation": "no episode was played"}})
    return made.model_copy(update={"results": (unplayed,)})


def like(
    entry: Entry,
    explainer: str,
    values: Values,
    *,
    policy: str = "small",
    seed: int | None = None,
    **changes: object,
) -> Entry:
    """Another entry on the same states, with these values of FidDelta and GEF per episode."""
    (cell,) = entry.results
    rows = tuple(
        row.model_copy(update={"fid_delta": value, "gef": value})
        for row, value in zip(cell.episodes, values, strict=True)
    )
    content = {name: getattr(entry, name) for name in Entry.model_fields if name != "entry_id"}
    content |= {
        "explainer": entry.explainer.model_copy(update={"name": explainer}),
        "policy": entry.policy.model_copy(update={"name": policy, "training_seed": seed}),
        "results": (cell.model_copy(update={"episodes": rows}),),
    }
    return make_entry(**(content | changes))


@pytest.mark.slow
def test_a_comparison_by_hand(entry: Entry) -> None:
    worse, better = [0.1, 0.2, 0.3, 0.4], [0.34, 0.46, 0.54, 0.66]
    blocks = blocks_of([like(entry, "worse", worse), like(entry, "better", better)])
    comparison = compare(blocks, "fid_delta")
    assert [each.explainer for each in comparison.standings] == ["better", "worse"]
    assert [each.tie_group for each in comparison.standings] == [1, 2]
    (pair,) = comparison.pairs
    assert (pair.first, pair.second) == ("better", "worse")
    assert pair.difference.value == pytest.approx(0.25)
    half = 3.182446 * (4 * 0.01**2 / 3 / 4) ** 0.5  # paired differences are 0.24 and 0.26
    assert pair.difference.interval == pytest.approx((0.25 - half, 0.25 + half))
    assert pair.improvement == 15 / 16  # of 16 pairs of episodes, all but 0.34 < 0.4
    assert pair.p_holm == pair.difference.p
    assert comparison.standings[0].iqm == pytest.approx(0.5)
    profile = comparison.standings[0].profile  # over the episodes of a single policy
    assert (profile.taus, profile.shares) == ((0.34, 0.46, 0.54, 0.66), (1.0, 0.75, 0.5, 0.25, 0.0))
    assert compare(blocks, "gef").pairs[0].improvement == 15 / 16  # of "worse", because lower is better
    assert [each.explainer for each in compare(blocks, "gef").standings] == ["worse", "better"]


def test_p_values_are_corrected_for_all_pairs(entry: Entry) -> None:
    values = [[0.1, 0.2, 0.3, 0.4], [0.12, 0.2, 0.31, 0.41], [0.7, 0.85, 0.9, 1.0]]
    entries = [like(entry, name, each) for name, each in zip("abc", values, strict=True)]
    pairs = compare(blocks_of(entries), "fid_delta").pairs
    assert len(pairs) == 3
    p = {(pair.first, pair.second): pair.difference.p or 0.0 for pair in pairs}
    ours = [pair.p_holm for pair in pairs]
    assert ours == pytest.approx(holm(list(p.values())))
    assert p["c", "a"] == pytest.approx(stats.ttest_rel(values[2], values[0]).pvalue)


def test_several_policies_each_count_once(entry: Entry) -> None:
    entries = [
        like(entry, name, [value] * 4, policy=policy)
        for name, policy, value in [("a", "p", 0.0), ("a", "q", 1.0), ("b", "p", 0.0), ("b", "q", 0.0)]
    ]
    comparison = compare(blocks_of(entries), "fid_delta")
    assert len(comparison.states) == 2
    assert comparison.standings[0].mean.value == 0.5
    expected = stats.ttest_1samp([0.0, 1.0], 0.0).confidence_interval(0.95)
    assert comparison.pairs[0].difference.interval == pytest.approx(tuple(expected))  # two units, not eight
    assert comparison.pairs[0].improvement == 0.5 * (0.5 + 0.5) + 0.25
    assert [each.profile.shares for each in comparison.standings] == [(1.0, 0.5, 0.0), (1.0, 0.0)]  # of runs
    assert [each.tie_group for each in comparison.standings] == [1, 1]


def test_policies_of_one_seed_are_one_unit(run_cli: RunCli, entry: Entry, tmp_path: Path) -> None:
    entries = [
        like(entry, name, [value] * 4, policy=f"{kind}-{seed}", seed=seed)
        for seed in (1, 2)
        for kind in ("with", "without")
        for name, value in (("a", 0.5 * seed), ("b", 0.0))
    ]
    difference = compare(blocks_of(entries), "fid_delta").pairs[0].difference
    assert difference.units == 2
    expected = stats.ttest_1samp([0.5, 1.0], 0.0).confidence_interval(0.95)
    assert difference.interval == pytest.approx(tuple(expected))
    for each in entries:
        write_entry(tmp_path, each)
    ran = run_cli("compare", tmp_path, "--metric", "fid_delta")
    assert "They are of 2 trainings: policies of one seed" in ran.out


def test_cells_weigh_the_same(entry: Entry) -> None:
    four = made_entry("small", "random", 0.5, n_agents=4, episodes=4)
    entries = [
        like(cell, name, [value] * 4, policy=policy, seed=None)
        for cell, policy, value in ((entry, "p", 0.9), (entry, "q", 0.7), (four, "r", 0.4))
        for name, value in (("a", value), ("b", 0.0))
    ]
    assert compare(blocks_of(entries), "fid_delta").pairs[0].difference.value == pytest.approx(0.6)


def test_the_result_does_not_depend_on_the_order_of_entries_and_rows(entry: Entry) -> None:
    rng = np.random.default_rng(0)
    entries = [like(entry, name, rng.random(4).tolist()) for name in "abcd"]
    assert compare(blocks_of(entries), "fid_delta") == compare(blocks_of(entries[::-1]), "fid_delta")


def test_entries_that_cannot_be_paired_are_refused(entry: Entry) -> None:
    one = like(entry, "a", [0.0] * 4)
    (cell,) = one.results
    other = cell.model_copy(
        update={"episodes": tuple(row.model_copy(update={"seed": row.seed + 1}) for row in cell.episodes)}
    )
    fewer = entry.protocol.model_copy(update={"timesteps": 1})
    refused: list[tuple[list[Entry], str]] = [
        ([one, like(entry, "b", [0.0] * 4, results=(other,))], "different states"),
        ([one, like(entry, "b", [0.0] * 4, protocol=fewer)], "different states or by different protocols"),
        ([one, one], "there are two entries of 'a'"),
        ([one], "needs two explainers, got a"),
        ([one, like(entry, "b", [0.0] * 4, policy="another")], "no entry on"),
    ]
    for entries, said in refused:
        with pytest.raises(InputError, match=said):
            blocks_of(entries)


def test_metrics_that_were_not_measured_are_refused(entry: Entry) -> None:
    blocks = blocks_of([like(entry, "a", [None] * 4), like(entry, "b", [0.0] * 4)])
    with pytest.raises(InputError, match="fid_delta is not a number in any episode of 'a'"):
        compare(blocks, "fid_delta")
    with pytest.raises(InputError, match="success_on_explanation was not measured for"):
        compare(blocks, "success_on_explanation")
    with pytest.raises(InputError, match=r"unknown metric 'makespan'.*comm_budgeted_fidelity"):
        compare(blocks, "makespan")
    assert "comm_budgeted_fidelity" in BETTER


def test_explainers_named_are_compared_on_the_states_they_share(entry: Entry) -> None:
    few = entry.protocol.model_copy(update={"timesteps": 1})
    both = [like(entry, "fast", [0.0] * 4), like(entry, "fast", [0.0] * 4, protocol=few)]
    slow = like(entry, "slow", [0.0] * 4, protocol=few)
    assert {each.protocol.timesteps for each in shared_states([*both, slow])} == {1}
    with pytest.raises(InputError, match="fast, slow have no states in common"):
        shared_states([both[0], slow])


def test_scores_of_two_seeds_are_not_chosen_between(entry: Entry) -> None:
    other = entry.protocol.model_copy(update={"seeds": tuple(seed + 7 for seed in entry.protocol.seeds)})
    entries = [
        like(entry, name, [0.0] * 4, protocol=protocol)
        for protocol in (entry.protocol, other)
        for name in ("a", "b")
    ]
    for listed in (entries, entries[::-1]):
        with pytest.raises(InputError, match="were scored on small more than once, on different states"):
            shared_states(listed)


def test_cells_without_numbers_are_left_out(entry: Entry) -> None:
    four = made_entry("small", "random", 0.5, n_agents=4, episodes=4)
    entries = [
        like(cell, name, [value] * 4, policy=policy)
        for cell, policy, value in ((entry, "p", 0.9), (entry, "q", 0.7), (four, "r", None))
        for name, value in (("a", value), ("b", None if value is None else 0.0))
    ]
    comparison = compare(blocks_of(entries), "fid_delta")
    (pair,) = comparison.pairs
    assert pair.improvement == 1.0
    assert pair.difference.value == pytest.approx(0.8)


@pytest.mark.slow
def test_the_command_prints_json_and_draws(run_cli: RunCli, entry: Entry, tmp_path: Path) -> None:
    folder = tmp_path / "entries"
    files = [
        write_entry(folder, like(entry, name, [value, value + 0.1, value, value]))
        for name, value in (("one", 0.1), ("two", 0.2))
    ]
    plot = tmp_path / "picture.png"
    ran = run_cli("compare", *files, "--metric", "fid_delta", "--metric", "gef", "--plot", plot)
    assert ran.code == 0, ran.err
    assert "two - one" in ran.out
    with Image.open(plot) as picture:
        assert picture.width > 1000
        assert len(set(picture.convert("L").tobytes())) > 10
    as_json = run_cli("compare", "one", "two", "--entries", folder, "--metric", "fid_delta", "--json")
    (record,) = json.loads(as_json.out)
    assert [each["explainer"] for each in record["standings"]] == ["two", "one"]
    assert record["pairs"][0]["difference"]["value"] == pytest.approx(0.1)
    assert record["standings"][0]["profile"]["shares"] == [1.0, 0.25, 0.0]


@pytest.mark.slow
def test_of_many_explainers_the_pairs_with_the_first_are_printed(
    run_cli: RunCli, entry: Entry, tmp_path: Path
) -> None:
    for k in range(8):
        write_entry(tmp_path, like(entry, f"e{k}", [0.1 * k, 0.1 * k, 0.1, 0.2]))
    ran = run_cli("compare", tmp_path, "--metric", "fid_delta")
    assert ran.out.count("e7 - ") == 7
    assert "e6 - " not in ran.out
    assert "--json has all 28" in ran.out


@pytest.mark.slow
@pytest.mark.parametrize(("n", "length"), [(2, 3), (25, 12), (8, 100)])
def test_the_picture_numbers_every_tie_group_and_cuts_nothing(n: int, length: int, entry: Entry) -> None:
    names = [f"{k:02}".ljust(length, "x") for k in range(n)]
    noise = np.array([0.0, 1e-3, -1e-3, 0.0])
    entries = [
        like(entry, name, (noise * (-1) ** k * (1 + k) - k // 2).tolist()) for k, name in enumerate(names)
    ]
    compared = compare(blocks_of(entries), "fid_delta")
    groups = {each.tie_group for each in compared.standings}
    assert len(groups) == (n + 1) // 2
    figure = figure_of([compared])
    figure.draw_without_rendering()
    texts = [text.get_text() for text in figure.findobj(Text)]
    assert {str(group) for group in groups} <= set(texts)
    assert min(texts.count(name) for name in names) >= 4  # beside means, rows, columns, and in the legend
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()  # all that is drawn, in inches
    assert min(drawn.x0, drawn.y0) >= 0
    assert drawn.x1 <= width
    assert drawn.y1 <= height


def test_names_of_explainers_come_before_folders_in_the_working_directory(
    run_cli: RunCli, entry: Entry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, value in (("one", 0.1), ("two", 0.2)):
        write_entry(tmp_path / "results" / "entries", like(entry, name, [value] * 4))
    write_entry(tmp_path / "one", like(entry, "three", [0.3] * 4))
    (tmp_path / "two").write_text("no entry")
    (tmp_path / "results" / "leaderboard.json").write_text("{}")  # as `score` leaves it

    def explainers(*arguments: object) -> set[str]:
        ran = run_cli("compare", *arguments, "--metric", "fid_delta", "--json")
        assert ran.code == 0, ran.err
        return {each["explainer"] for each in json.loads(ran.out)[0]["standings"]}

    assert explainers("results") == {"one", "two"}
    assert explainers("one", "two", "--entries", "results") == {"one", "two"}
    assert explainers("./one", "two", "--entries", "results") == {"three", "two"}
    assert explainers("one", "results") == {"one", "two", "three"}  # no explainer: no leaderboard here
    checked = run_cli("validate", "results").out
    assert "results: small.one." in checked
    assert "leaderboard.json" not in checked


def test_invalid_input_is_refused_with_one_sentence(run_cli: RunCli, entry: Entry, tmp_path: Path) -> None:
    folder = tmp_path / "entries"
    file = write_entry(folder, like(entry, "one", [0.1] * 4))
    for arguments, said in [
        ((file, tmp_path / "missing.json"), "missing.json"),
        (("one", "tow", "--entries", folder), "unknown explainer with entries in"),
        (
            ("one", "two", "--entries", tmp_path / "none"),
            "none holds no entries, so 'one' names no explainer",
        ),
        ((file, file), "needs two explainers"),
        ((file, "--plot", "picture.bmp"), "a name that ends in one of"),
    ]:
        ran = run_cli("compare", *arguments)
        assert (ran.code, ran.out, len(ran.err.splitlines())) == (2, "", 1), ran
        assert said in ran.err


def test_files_are_not_filtered_to_shared_states(entry: Entry, tmp_path: Path) -> None:
    few = entry.protocol.model_copy(update={"timesteps": 1})
    pair = like(entry, "a", [0.0] * 4), like(entry, "b", [0.0] * 4, protocol=few)
    files = [str(write_entry(tmp_path, each)) for each in pair]
    with pytest.raises(InputError, match="different states"):
        blocks_of(read_named(files, tmp_path))
