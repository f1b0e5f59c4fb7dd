"""Entries are strict JSON, and their id is a hash of their numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from tests.conftest import MakeBundle
from tests.helpers.made_entries import made_entry
from xmarl_bench.entry.aggregation import Acted, cell_metrics, metrics_of_cell, summarise
from xmarl_bench.entry.file import read_entry, write_entry
from xmarl_bench.entry.metric_records import EpisodeRow, Metrics, Summary
from xmarl_bench.entry.schema import Entry, Verification, entry_id
from xmarl_bench.errors import InputError
from xmarl_bench.records.files import canonical_json, write_json
from xmarl_bench.scoring.score import score


@pytest.fixture(scope="module")
def entry() -> Entry:
    return made_entry("small", "attention", 0.5, episodes=3)


def test_round_trip(tmp_path: Path, entry: Entry) -> None:
    path = write_entry(tmp_path, entry)
    assert path.name.startswith("small.attention.")
    assert read_entry(path) == entry


def test_the_id_does_not_cover_provenance_cost_and_verification(entry: Entry) -> None:
    assert entry_id(entry) == entry.entry_id
    cost = entry.cost.model_copy(update={"explain_seconds_per_timestep": 9.0})
    provenance = entry.provenance.model_copy(update={"cpu": "another"})
    verification = Verification(status="recomputed", by="x", when="2026-01-01", max_abs_diff=0.0)
    same = entry.model_copy(update={"cost": cost, "provenance": provenance, "verification": verification})
    assert entry_id(same) == entry.entry_id
    assert entry_id(entry.model_copy(update={"submitter": "x"})) != entry.entry_id


def edited(entry: Entry, edit: Any) -> str:
    value = entry.model_dump(mode="json")
    edit(value)
    return json.dumps(value)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda value: value.update(extra=1), "extra"),
        (lambda value: value["results"][0]["metrics"].update(fid_squared=1), "fid_squared"),
        (lambda value: value["results"][0]["episodes"].pop("gef"), "gef"),
        (lambda value: value["results"][0]["episodes"]["gef"].append("0.5"), "gef.3"),
        (lambda value: value["results"][0]["episodes"]["gef"].append(float("nan")), "holds NaN"),
        (lambda value: value["results"][0]["episodes"]["gef"].append(float("inf")), "holds Infinity"),
        (lambda value: value.update(schema_version=1), "has schema_version 1, .* reads 5: score it again"),
        (lambda value: value["results"][0]["episodes"]["gef"].pop(), "gef has 2 values, others have 3"),
        (lambda value: value["results"][0]["episodes"]["gef"].reverse(), "changed after it was written"),
        (lambda value: value["results"][0]["episodes"].update(seed=[]), "seed has 0 values, others have 3"),
        (lambda value: value["results"][0]["episodes"].update(seed=None), "seed"),
        (lambda value: value["results"][0].update(episodes=[]), "episodes"),
    ],
)
def test_invalid_entries_are_refused_with_the_reason(
    tmp_path: Path, entry: Entry, edit: Any, said: str
) -> None:
    path = tmp_path / "entry.json"
    path.write_text(edited(entry, edit))
    with pytest.raises(InputError, match=said):
        read_entry(path)


def test_a_truncated_entry_is_refused(tmp_path: Path, entry: Entry) -> None:
    path = write_entry(tmp_path, entry)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match="is not an entry"):
        read_entry(path)


def test_nan_is_never_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical_json({"x": float("nan")})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "x.json", [float("inf")])
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValidationError):
        Summary(value=float("nan"), interval=None, n=1, n_nan=0)


def test_nan_is_counted_and_left_out() -> None:
    summary = summarise([1.0, None, 3.0, None], np.random.default_rng(0))
    assert (summary.value, summary.n, summary.n_nan) == (2.0, 2, 2)
    nothing = summarise([None, None], np.random.default_rng(0))
    assert (nothing.value, nothing.interval, nothing.n, nothing.n_nan) == (None, None, 0, 2)


@pytest.mark.slow
def test_aggregates_follow_from_the_rows(make_bundle: MakeBundle) -> None:
    entry = score(make_bundle(), "attention", episodes=3, max_cycles=6)
    (cell,) = entry.results
    assert metrics_of_cell(cell, entry.explainer.seed) == cell.metrics
    rows = [row.model_copy(update={"gef": None}) if k == 0 else row for k, row in enumerate(cell.episodes)]
    holed = cell_metrics(rows, 0, {}, Acted(3, 0)).gef
    assert holed is not None
    assert (holed.n, holed.n_nan) == (2, 1)
    assert holed.value == pytest.approx(
        np.mean([row.gef for row in cell.episodes[1:] if row.gef is not None])
    )


def test_every_metric_of_a_row_is_summarised() -> None:
    assert set(EpisodeRow.model_fields) - set(Metrics.model_fields) == {
        "seed", "length", "timesteps", "budget", "comm_budget", "mean_budget", "resample_budget",
        "renormalised_budget",
    }  # fmt: skip


def test_intervals_cover_the_mean_and_constants_have_width_zero() -> None:
    x = np.random.default_rng(1).normal(3.0, 1.0, 50).tolist()
    summary = summarise(x, np.random.default_rng(0))
    assert summary.value is not None
    assert summary.interval is not None
    low, high = summary.interval
    assert low < summary.value < high
    assert high - low == pytest.approx(2 * 1.96 * np.std(x) / np.sqrt(50), rel=0.1)
    assert summarise(x, np.random.default_rng(0)) == summary
    assert summarise([2.0] * 9, np.random.default_rng(0)).interval == (2.0, 2.0)
    assert summarise([2.0], np.random.default_rng(0)).interval is None
