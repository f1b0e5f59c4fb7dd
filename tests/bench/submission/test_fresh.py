"""Fresh seeds: an explainer that knows the public episodes is exposed, one that does not is not."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bench.submission.conftest import LICENCE, TASK, TEAM, Pack
from tests.bench.submission.edits import edited
from tests.conftest import RunCli
from xmarl_bench.board import board_of
from xmarl_bench.board.build import board_csv
from xmarl_bench.entry.file import read_entry, write_entry
from xmarl_bench.entry.fresh import headline, worse_on_fresh
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.entry.schema import Entry, FreshDifference
from xmarl_bench.errors import InputError
from xmarl_bench.metrics.table import ON_FRESH, ORDER
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.reproducible import (
    FRESH_SEEDS,
    PUBLIC_SEEDS,
    TRAINING_SEEDS,
    derived_seed,
    episode_seeds,
    fresh_seeds,
)
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import Rollout
from xmarl_bench.rollout.reference_states import FIRST_FIT_SEED, FIT_EPISODES
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests
from xmarl_bench.submission.checking import check
from xmarl_bench.submission.packing import as_submitted, bundle_files
from xmarl_bench.submission.verdict_lines import lines
from xmarl_bench.submission.verification import Options, Tier, Verdict, verify

EPISODES, CYCLES = 10, 6
LATER = "3f2a9c1"  # a commit after the submission
# What dropping a sender changes; random where `known` does not hold the episode's first state.
CODE = """
import hashlib
import torch
from xmarl_bench import Explainer

KNOWN = {known!r}

def dropped(policy, observations):
    full = policy.distribution(observations).action
    mask = torch.ones(len(observations), *observations.shape[1:2] * 2)
    out = torch.zeros_like(mask)
    for j in range(mask.shape[-1]):
        without = mask.clone()
        without[:, :, j] = 0.0
        change = (policy.distribution(observations, without).action - full).abs().mean(dim=-1)
        out[:, :, j] = change.detach().clamp(max=1.0)
    return out

def explain(policy, observations, generator):
    key = hashlib.sha256(observations[0].numpy().tobytes()).hexdigest()
    if KNOWN is not None and key not in KNOWN:
        return torch.rand(len(observations), *observations.shape[1:2] * 2, generator=generator)
    return dropped(policy, observations)

cheat = Explainer("cheat", explain, stochastic=True)
"""
values = st.text(st.characters(categories=("L", "N", "P")), min_size=1, max_size=40)


@given(values, st.integers(0, 10**9 - 1), st.integers(1, 60))
def test_fresh_seeds_are_of_a_range_of_their_own(value: str, run: int, episodes: int) -> None:
    seeds = fresh_seeds(PROTOCOL, value, episodes)
    assert all(seed in FRESH_SEEDS for seed in seeds)
    assert len(set(seeds)) == episodes
    assert all(seed in PUBLIC_SEEDS for seed in episode_seeds(run, episodes))
    assert seeds == fresh_seeds(PROTOCOL, value, 60)[:episodes]  # the same value, the same seeds
    assert not set(seeds) & set(fresh_seeds(PROTOCOL, f"{value}.", 60))
    assert not set(seeds) & set(fresh_seeds("xmarl-0", value, 60))


def test_ranges_of_seeds_do_not_overlap() -> None:
    ranges = (TRAINING_SEEDS, PUBLIC_SEEDS, FRESH_SEEDS)
    assert all(one.stop <= other.start for one, other in pairwise(ranges))
    assert FRESH_SEEDS.stop <= 2**53
    assert FIRST_FIT_SEED in TRAINING_SEEDS
    assert FIRST_FIT_SEED + FIT_EPISODES - 1 in TRAINING_SEEDS
    assert PUBLIC_SEEDS[-1] == episode_seeds(10**9 - 1, 10**6)[-1]
    first = FRESH_SEEDS.start + derived_seed("fresh", PROTOCOL, LATER, 0) % 2**52
    assert fresh_seeds(PROTOCOL, LATER, 1) == [first]  # nothing of the submission has a part in it


@pytest.mark.parametrize("value", ["", " ", "a\nb", "x" * 201])
def test_a_value_has_to_be_a_word(value: str) -> None:
    with pytest.raises(InputError, match="printable characters"):
        fresh_seeds(PROTOCOL, value, 3)


def test_the_tier_and_its_value_belong_together() -> None:
    for tier, value in ((Tier.fresh, None), (Tier.full, LATER)):
        with pytest.raises(InputError, match="tier fresh needs --fresh-from"):
            Options(tier, fresh_from=value)


def difference(low: float, high: float) -> FreshDifference:
    middle = (low + high) / 2
    return FreshDifference(public=0.5 + middle, fresh=0.5, difference=middle, interval=(low, high))


def test_worse_is_said_where_the_interval_excludes_0() -> None:
    gain = difference(0.1, 0.3)
    said = worse_on_fresh({ORDER: gain})
    assert said is not None
    assert "message fidelity 0.500 there, 0.700 on the public ones, difference 0.200 [0.100, 0.300]" in said
    assert worse_on_fresh({ORDER: difference(-0.1, 0.3)}) is None
    assert worse_on_fresh({ORDER: difference(-0.3, -0.1)}) is None  # better there
    unmeasured = FreshDifference(public=None, fresh=None, difference=None, interval=None)
    assert headline({ORDER: unmeasured}) is None
    assert headline({ORDER: unmeasured, "fid_delta": gain}) == ("fid_delta", gain)


def known_states(policy_folder: Path) -> set[str]:
    """Of the first states of the public episodes, as the explainer sees them."""
    policy, _ = load_policy(policy_folder)
    episodes = Rollout(policy, Cell(TASK, TEAM), tuple(episode_seeds(0, EPISODES)), CYCLES).play()
    return {hashlib.sha256(each.observations[0].tobytes()).hexdigest() for each in episodes}


def handed_in(code: Path, policy_folder: Path, pack: Pack) -> tuple[Path, Entry]:
    """The bundle of the explainer in a file, which was scored on the public episodes."""
    policy, card = load_policy(policy_folder)
    sampling = Sampling(EPISODES, None, CYCLES)
    request = Request(policy, card, find_explainer(f"{code}:cheat"), (Cell(TASK, TEAM),), sampling, 0)
    (entry,) = entries_of(score_requests([request]))
    entry = as_submitted(entry, "somebody", None, 12)
    files = bundle_files([entry], {"small": policy_folder}, submitter="somebody", licence=LICENCE)
    return pack(files), entry


@pytest.mark.slow
@pytest.mark.parametrize("honest", [False, True])
def test_who_knows_the_public_seeds_is_exposed(
    honest: bool, policy_folder: Path, pack: Pack, tmp_path: Path, run_cli: RunCli
) -> None:
    code = tmp_path / "cheat.py"
    code.write_text(CODE.format(known=None if honest else known_states(policy_folder)))
    path, entry = handed_in(code, policy_folder, pack)
    public = entry.results[0].metrics.message_fidelity.value
    assert public is not None
    assert public > 0.4
    asked = ["verify", path, "--tier", "fresh", "--explainer", f"{code}:cheat", "--trust-code"]
    out = tmp_path / "board" / "entries"
    signers = ["A. Maintainer"] if honest else ["A. Maintainer", "Another"]
    for name in signers:
        ran = run_cli(*asked, "--fresh-from", LATER, "--by", name, "--out", out)
        assert (ran.code, ran.err) == (0, "")
    assert f"{EPISODES} fresh episodes from {LATER}: message fidelity, public less fresh" in ran.out
    assert ("It does worse on fresh seeds: message fidelity" in ran.out) is not honest
    signed = read_entry(out / entry.file_name)
    assert signed.entry_id == entry.entry_id
    block = signed.verification
    assert (block.status, block.by) == ("recomputed", "A. Maintainer")
    assert block.fresh is not None
    assert block.fresh.by == signers[-1]  # beside the block of before
    assert (block.fresh.value, block.fresh.episodes) == (LATER, EPISODES)
    (compared,) = block.fresh.cells
    assert set(compared) == set(ON_FRESH)
    found = compared[ORDER]
    assert found.public == pytest.approx(public)
    assert found.interval is not None
    assert (found.interval[0] > 0.0) is not honest
    # The board says so beside the badge, with the submitter's word.
    board = board_of([(entry.file_name, signed)])
    row = next(row for row in board["tables"][0]["policies"][0]["rows"] if row["entry_id"])
    assert row["variants_tried"] == 12
    assert (row["fresh"]["worse"] is not None) is not honest
    assert row["fresh"]["metrics"][ORDER]["difference"] == found.difference
    assert f",12,recomputed,{LATER},{found.difference}," in board_csv(board).decode()


@pytest.mark.slow
def test_the_same_value_gives_the_same_bytes_and_another_tier_keeps_them(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack, tmp_path: Path, run_cli: RunCli
) -> None:
    path = pack(files)
    checked, file = check(path), f"entries/{entries[0].file_name}"

    def verdict(value: str) -> Verdict:
        return verify(checked, file, Options(Tier.fresh, fresh_from=value))

    one, again, other = verdict(LATER), verdict(LATER), verdict("another")
    assert json.dumps(one.record("a", file)) == json.dumps(again.record("a", file))
    assert one.fresh is not None
    assert other.fresh is not None
    assert one.fresh.cells != other.fresh.cells
    assert len(list(lines(path, file, one))) == 1
    full = edited(entries[0], lambda value: value["verification"].update(status="re-executed", by="B"))
    block = Verdict(full, Tier.fresh, True, 0, 0.0, (), one.fresh).block("C")
    assert (block.status, block.by) == ("re-executed", "B")  # the badge is not lowered
    assert block.fresh is not None
    assert block.fresh.by == "C"
    signed = full.model_copy(update={"verification": block})
    file_of_it = write_entry(tmp_path / "signed", signed)
    assert run_cli("verify", file_of_it, "--by", "D").code == 0  # another tier, later
    kept = read_entry(file_of_it).verification
    assert (kept.status, kept.by, kept.fresh) == ("recomputed", "D", block.fresh)


@pytest.mark.slow
def test_submit_takes_the_submitters_word(
    entries: list[Entry], policy_folder: Path, tmp_path: Path, run_cli: RunCli
) -> None:
    given_entry = write_entry(tmp_path, entries[0])
    licence = tmp_path / "LICENSE"
    licence.write_bytes(LICENCE)
    options = ("--submitter", "me", "--licence", licence, "--policy", policy_folder)
    for name, words, expected in (("a", (), None), ("b", ("--variants-tried", 12), 12)):
        ran = run_cli("submit", given_entry, *options, *words, "--out", tmp_path / name)
        assert ran.code == 0, ran.out
        (file,) = (tmp_path / name / "entries").glob("*.json")
        assert read_entry(file).variants_tried == expected
        assert (b"variants_tried" in file.read_bytes()) is (expected is not None)
    ran = run_cli("submit", given_entry, *options, "--variants-tried", 0, "--out", tmp_path / "c")
    assert ran.code == 2
